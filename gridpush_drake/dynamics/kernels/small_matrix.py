"""Matrices so small that a call of LAPACK would cost more than the work, for use in kernels."""

from gridpush_drake.dynamics.kernels.compiled import kernel


@kernel(allocates=False, inlined=True)
def apply_row(M, i, x, y, z):
    """Multiplies row i of a matrix of three columns with the vector (x, y, z)."""
    return M[i, 0] * x + M[i, 1] * y + M[i, 2] * z


@kernel(allocates=False)
def solve_dense(A, B, size, columns):
    """Solves A X = B in place by Gaussian elimination with partial pivoting.

    Args:
        A: of which the first `size` rows and columns are used, and overwritten.
        B: right-hand sides in its first `columns` columns, overwritten with X.
        size, columns: see above.

    Returns:
        False where A is singular.
    """
    # Forward elimination: row j is exchanged with the one that has the largest pivot.
    for j in range(size):
        pivot = j
        for i in range(j + 1, size):
            if abs(A[i, j]) > abs(A[pivot, j]):
                pivot = i
        if A[pivot, j] == 0.0:
            return False
        if pivot != j:
            for c in range(j, size):
                A[j, c], A[pivot, c] = A[pivot, c], A[j, c]
            for c in range(columns):
                B[j, c], B[pivot, c] = B[pivot, c], B[j, c]
        inverse = 1.0 / A[j, j]
        for i in range(j + 1, size):
            factor = A[i, j] * inverse
            if factor != 0.0:
                for c in range(j + 1, size):
                    A[i, c] -= factor * A[j, c]
                for c in range(columns):
                    B[i, c] -= factor * B[j, c]
    # Back substitution, column by column.
    for c in range(columns):
        for i in range(size - 1, -1, -1):
            total = B[i, c]
            for j in range(i + 1, size):
                total -= A[i, j] * B[j, c]
            B[i, c] = total / A[i, i]
    return True

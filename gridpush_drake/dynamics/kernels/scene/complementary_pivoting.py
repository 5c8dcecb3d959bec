"""Lemke's method: complementary pivoting, which solves a linear complementarity problem.

    w = M z + q,    0 <= w ⟂ z >= 0

With one variable z_0 more, in w = M z + q + d z_0 and d > 0, some basis solves it that is
complementary but for one index. From there each pivot brings in the complement of what the last one
drove out, until z_0 leaves: then the problem is solved. No basis comes twice, so the method ends;
and it ends with a solution if M is copositive and the problem bounded, which those of contacts are
(Anitescu and Potra 1997; `contact_problem`). It needs no start and cannot cycle, but costs the
square of the problem's size for each pivot: it is for steps whose modes are not found otherwise.
"""

from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel

_PIVOTS = 8
"""Most pivots, as a multiple of the problem's size."""

_LEAST = 1e-11
"""Least size of a pivot; what is smaller is a rounding error."""

_LEFT = 1e-12
"""Value of z_0 at which the pivoting ends."""

_MOST_LEFT = 1e-8
"""Value of z_0 up to which the last basis counts as a solution if no pivot is left."""

_TIE = 1e-12
"""Difference of two ratios that is one."""


class Pivoting(NamedTuple):
    """A linear complementarity problem of at most n unknowns.

    Attributes:
        table: (n, n+2) M, d and q in; the dictionary of the last basis out.
        basic: (n,) what each row stands for: i of w_i, n+i of z_i, 2n of z_0.
        apart: (n+1,) what each column stands for.
        z: (n,) the solution.
    """

    table: Any
    basic: Any
    apart: Any
    z: Any


@kernel()
def make_pivoting(n):
    """Makes the workspace for problems of at most n unknowns."""
    return Pivoting(
        table=np.zeros((n, n + 2)),
        basic=np.zeros(n, np.int64),
        apart=np.zeros(n + 1, np.int64),
        z=np.zeros(n),
    )


@kernel(allocates=False)
def solve_complementarity(work, n):
    """Solves the problem in the first n rows and n+2 columns of `work.table`: M, d, q.

    Returns:
        False where no solution was found. Else `work.z` has it.
    """
    table = work.table
    basic = work.basic
    apart = work.apart
    cover = 2 * n
    # the first basis: w = q + d z_0, and z = 0
    for i in range(n):
        basic[i] = i
        apart[i] = n + i
        work.z[i] = 0.0
    apart[n] = cover
    # z_0 comes in where q is the most negative
    row = -1
    least = 0.0
    for i in range(n):
        ratio = table[i, n + 1] / table[i, n]
        if ratio < least:
            least = ratio
            row = i
    column = n
    cover_row = row
    for _ in range(_PIVOTS * n if row >= 0 else 0):
        leaving = basic[row]
        _exchange(table, row, column, n)
        basic[row] = apart[column]
        apart[column] = leaving
        # What is left of z_0 may be a rounding error, by which the last pivots would be lost.
        if leaving == cover or table[cover_row, n + 1] <= _LEFT:
            cover_row = -1
            break
        # the complement of what left comes in
        wanted = leaving + n if leaving < n else leaving - n
        column = 0
        while apart[column] != wanted:
            column += 1
        row = _find_row(table, basic, column, n, cover)
        if row < 0:
            break
    if cover_row >= 0 and table[cover_row, n + 1] > _MOST_LEFT:
        return False
    # the z of the last basis; all others are zero
    for i in range(n):
        if n <= basic[i] < cover:
            work.z[basic[i] - n] = max(table[i, n + 1], 0.0)
    return True


@kernel(allocates=False)
def _find_row(table, basic, column, n, cover):
    """Finds the row that reaches zero first as the column's variable grows; -1 where none does.

    Of several, that of z_0, else the one with the largest pivot.
    """
    best = np.inf
    row = -1
    for i in range(n):
        slope = table[i, column]
        if slope >= -_LEAST:
            continue
        ratio = max(table[i, n + 1], 0.0) / -slope
        if ratio < best - _TIE * (1.0 + ratio):
            best = ratio
            row = i
        elif ratio <= best + _TIE * (1.0 + ratio):
            if basic[row] == cover:
                continue
            if basic[i] == cover or slope < table[row, column]:
                best = min(best, ratio)
                row = i
    return row


@kernel(allocates=False)
def _exchange(table, row, column, n):
    """Exchanges the basic variable of a row with that of a column."""
    # the row, solved for the variable that comes in
    pivot = table[row]
    inverse = 1.0 / pivot[column]
    for c in range(n + 2):
        pivot[c] *= -inverse
    pivot[column] = inverse
    # and put into all others
    for i in range(n):
        if i == row:
            continue
        factor = table[i, column]
        if factor == 0.0:
            continue
        for c in range(n + 2):
            if c != column:
                table[i, c] += factor * pivot[c]
        table[i, column] = factor * inverse

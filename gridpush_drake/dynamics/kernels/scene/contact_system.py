"""The linear system of a linearized step whose contact modes are held: W and its solution.

See `contact_problem`. The unknowns are ordered along the chain of bodies (`order_unknowns`), so
that W is banded: filling and solving it cost in proportion to the number of bodies.
"""

from math import sqrt

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.contact_modes import (
    SEPARATE,
    SLIDE_MINUS,
    SLIDE_PLUS,
    STICK,
)
from gridpush_drake.dynamics.kernels.scene.contact_rows import (
    calc_row_velocity,
    couple,
    respond,
)
from gridpush_drake.dynamics.kernels.scene.records import FRICTION


@kernel(allocates=False)
def invert_hessians(bodies, H, rhs, xi, awake, eps, work):
    """Fills in S^-1, S^-1 rhs, the axes and their weights, of the bodies that are awake.

    Args:
        bodies: `BodyArrays`.
        H, rhs: (N, 3, 3), (N, 3) of the linearized step.
        xi: (N, 3) where it is linearized.
        awake: (N,) which bodies take part.
        eps: stiction tolerance, m/s; a body that is slower rests, and its H is regular.
        work: `ContactWork`.

    Returns:
        False where a matrix is singular.
    """
    first = work.rows.shape[0] - xi.shape[0]
    for b in range(awake.shape[0]):
        work.weight[b] = 0.0
        if not awake[b]:
            for i in range(3):
                work.free[b, i] = 0.0
            continue
        # The axis, in the metric of lengths in which a turn counts by the body's arm.
        axis = work.rows[first + b]
        arm2 = bodies.arm[b] * bodies.arm[b]
        ux = xi[b, 0]
        uy = xi[b, 1]
        w = xi[b, 2]
        speed2 = ux * ux + uy * uy + arm2 * w * w
        if speed2 > eps * eps:
            speed = sqrt(speed2)
            work.load[b] = bodies.load[b]
            work.weight[b] = bodies.load[b] / speed
            axis[0] = ux / speed
            axis[1] = uy / speed
            axis[2] = arm2 * w / speed
        if not _invert(H[b], axis, work.weight[b], work.inverse[b]):
            return False
        for i in range(3):
            row = work.inverse[b, i]
            work.free[b, i] = row[0] * rhs[b, 0] + row[1] * rhs[b, 1] + row[2] * rhs[b, 2]
    return True


@kernel(allocates=False)
def _invert(H, axis, weight, inverse):
    """Fills in (H + weight a a^T)^-1, symmetric (3, 3); returns False where it is singular."""
    x = axis[0]
    y = axis[1]
    z = axis[2]
    a00 = H[0, 0] + weight * x * x
    a01 = H[0, 1] + weight * x * y
    a02 = H[0, 2] + weight * x * z
    a11 = H[1, 1] + weight * y * y
    a12 = H[1, 2] + weight * y * z
    a22 = H[2, 2] + weight * z * z
    # its adjugate over its determinant
    c00 = a11 * a22 - a12 * a12
    c01 = a02 * a12 - a01 * a22
    c02 = a01 * a12 - a02 * a11
    c11 = a00 * a22 - a02 * a02
    c12 = a01 * a02 - a00 * a12
    c22 = a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    if not determinant > 0.0:
        return False
    scale = 1.0 / determinant
    inverse[0, 0] = scale * c00
    inverse[0, 1] = scale * c01
    inverse[1, 0] = scale * c01
    inverse[0, 2] = scale * c02
    inverse[2, 0] = scale * c02
    inverse[1, 1] = scale * c11
    inverse[1, 2] = scale * c12
    inverse[2, 1] = scale * c12
    inverse[2, 2] = scale * c22
    return True


@kernel(allocates=False)
def build_contact_matrix(contacts, compliance, work):
    """Fills in W = C S^-1 E + compliance for the contacts' modes, and S^-1 E.

    Returns:
        The size of W.
    """
    size = 0
    axes = work.rows.shape[0] - work.weight.shape[0]
    # no unknown of any body yet
    for b in range(work.weight.shape[0]):
        work.window[b, 0] = work.rows.shape[0]
        work.window[b, 1] = -1
    # The unknowns: a contact's forces, or the axis of a body that moves, with its tau.
    for s in range(work.length[0]):
        entry = work.sequence[s]
        if entry < 0:
            b = -1 - entry
            if work.weight[b] > 0.0:
                _use(axes + b, axes + b, 0.0, size, work)
                size += 1
            continue
        mode = contacts.modes[entry]
        if mode == SEPARATE:
            work.place[entry] = -1
            continue
        work.place[entry] = size
        slide = 0.0
        if mode == SLIDE_PLUS:
            slide = contacts.numbers[entry, FRICTION]
        elif mode == SLIDE_MINUS:
            slide = -contacts.numbers[entry, FRICTION]
        # a sliding contact's friction goes with its normal force
        _use(2 * entry, 2 * entry + 1, slide, size, work)
        size += 1
        if mode == STICK:
            _use(2 * entry + 1, 2 * entry + 1, 0.0, size, work)
            size += 1
    # W, of which only rows and columns that share a body are coupled
    for p in range(size):
        used = work.used[p]
        row = work.rows[used]
        i = work.ends[used, 0]
        j = work.ends[used, 1]
        # the unknowns of its one body, or of both
        left = work.window[i, 0]
        right = work.window[i, 1]
        if j >= 0:
            left = min(left, work.window[j, 0])
            right = max(right, work.window[j, 1])
        work.right[p] = right
        for q in range(size):
            work.W[p, q] = 0.0
        for q in range(left, right + 1):
            others = work.ends[work.used[q]]
            work.W[p, q] = couple(row, i, j, work.responses[q], others[0], others[1])
        if used < axes:
            work.W[p, p] += compliance[0 if j < 0 else 1]
        else:
            work.W[p, p] -= 1.0 / work.weight[i]
    return size


@kernel(allocates=False)
def _use(used, tangent, slide, unknown, work):
    """Makes a row of J an unknown: fills in its column of E, and S^-1 E.

    Args:
        used: the row.
        tangent: the row of friction that goes with it.
        slide: by which factor, ± mu.
        unknown: the place of the unknown.
        work: `ContactWork`.
    """
    work.used[unknown] = used
    column = work.columns[unknown]
    for a in range(6):
        column[a] = work.rows[used, a] + slide * work.rows[tangent, a]
    # S^-1 E, and how far the unknowns of the bodies reach
    i = work.ends[used, 0]
    j = work.ends[used, 1]
    respond(work.inverse, column, i, j, work.responses[unknown])
    for b in (i, j):
        if b >= 0:
            work.window[b, 0] = min(work.window[b, 0], unknown)
            work.window[b, 1] = max(work.window[b, 1], unknown)


@kernel(allocates=False)
def solve_banded(A, B, right, size, columns):
    """Solves A X = B in place by Gaussian elimination with partial pivoting, within the band.

    Args:
        A: of which the first `size` rows and columns are used, and overwritten.
        B: right-hand sides in its first `columns` columns, overwritten with X.
        right: (size,) the last column of each row that may not be zero; increased where the
            elimination fills more in. The rows that may not be zero in a column are the same.
        size, columns: see above.

    Returns:
        False where A is singular.
    """
    # the last row that may not be zero in this column
    bottom = 0
    for j in range(size):
        bottom = max(bottom, right[j])
        # the largest of the column, whose row is exchanged with this one
        pivot = j
        for i in range(j + 1, bottom + 1):
            if abs(A[i, j]) > abs(A[pivot, j]):
                pivot = i
        if A[pivot, j] == 0.0:
            return False
        if pivot != j:
            end = max(right[pivot], right[j])
            right[j], right[pivot] = right[pivot], right[j]
            for c in range(j, end + 1):
                A[j, c], A[pivot, c] = A[pivot, c], A[j, c]
            for c in range(columns):
                B[j, c], B[pivot, c] = B[pivot, c], B[j, c]
        # what the row fills in reaches as far as the row itself
        end = right[j]
        bottom = max(bottom, end)
        inverse = 1.0 / A[j, j]
        for i in range(j + 1, bottom + 1):
            factor = A[i, j] * inverse
            if factor == 0.0:
                continue
            right[i] = max(right[i], end)
            for c in range(j + 1, end + 1):
                A[i, c] -= factor * A[j, c]
            for c in range(columns):
                B[i, c] -= factor * B[j, c]
    # Back substitution, from the last row to the first.
    for i in range(size - 1, -1, -1):
        for j in range(i + 1, right[i] + 1):
            factor = A[i, j]
            if factor != 0.0:
                for c in range(columns):
                    B[i, c] -= factor * B[j, c]
        inverse = 1.0 / A[i, i]
        for c in range(columns):
            B[i, c] *= inverse
    return True


@kernel(allocates=False)
def solve_modes(contacts, xi, compliance, work):
    """Solves the linearized step for the contacts' modes.

    Args:
        contacts: `Contacts`, modes in, forces out.
        xi: (N, 3) filled with the twists of the bodies that are awake.
        compliance: of `calc_compliance`.
        work: `ContactWork`.

    Returns:
        False where the system is singular.
    """
    lam = contacts.lam
    size = build_contact_matrix(contacts, compliance, work)
    # b - C S^-1 rhs
    for p in range(size):
        used = work.used[p]
        ends = work.ends[used]
        free = calc_row_velocity(work.rows[used], ends[0], ends[1], work.free)
        work.B[p, 0] = work.asked[used] - free
    if not solve_banded(work.W, work.B, work.right, size, 1):
        return False
    # xi = S^-1 (rhs + E lam), and the forces by contact
    for b in range(xi.shape[0]):
        for a in range(3):
            xi[b, a] = work.free[b, a]
    for p in range(size):
        used = work.used[p]
        force = work.B[p, 0]
        i = work.ends[used, 0]
        j = work.ends[used, 1]
        response = work.responses[p]
        for a in range(3):
            xi[i, a] += response[a] * force
            if j >= 0:
                xi[j, a] += response[3 + a] * force
    # a sliding contact has the normal force alone as an unknown
    for r in range(contacts.counts[0]):
        mode = contacts.modes[r]
        lam[r, 0] = 0.0
        lam[r, 1] = 0.0
        if mode == SEPARATE:
            continue
        place = work.place[r]
        lam[r, 0] = work.B[place, 0]
        if mode == STICK:
            lam[r, 1] = work.B[place + 1, 0]
        elif mode == SLIDE_PLUS:
            lam[r, 1] = contacts.numbers[r, FRICTION] * lam[r, 0]
        else:
            lam[r, 1] = -contacts.numbers[r, FRICTION] * lam[r, 0]
    return True

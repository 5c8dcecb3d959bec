"""The contact problem of one linearized step: whether its contacts separate, stick or slide.

A step has at most two contacts.

With the 3x3 Hessian H, the rows J_n, J_t of the contacts and E = J_n^T (+ J_t^T, or + mu J_t^T
where it slides), the modes that are right solve

    [[H, -E], [C, 0]] (xi, lam) = (rhs, what the pusher asks for)

where C has the rows J_n of touching and J_t of sticking contacts, with lam_n >= 0 where a contact
touches, no approach where it does not, |lam_t| <= mu lam_n where it sticks, and slip against lam_t
where it slides. The last step's modes are tried first, then all. One contact by itself, as nearly
always, is solved in closed form (`_solve_one_contact`).
"""

from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.contact import CX, CY, GAP, NX, NY
from gridpush_drake.dynamics.kernels.small_matrix import apply_row, solve_dense

SEPARATE, STICK, SLIDE_PLUS, SLIDE_MINUS = range(4)
"""Contact modes; `SLIDE_PLUS` has lam_t = + mu_c lam_n."""

CONTACT_COMPLIANCE = 1e-9
"""Compliance of two contacts at once, as a fraction of speed/load.

It makes two sticking contacts, which are one more than the body needs, well posed."""

_MODE_TOLERANCE = 1e-9
"""Violation of the contact conditions, as a fraction of load and speed, that counts as none."""

_NORMAL_FRACTION = 1e-4
"""Weight of the normal rows where a jam's inconsistency is shared out, see `relax_jam`."""


class Touch(NamedTuple):
    """What the pusher asks of a step.

    Attributes:
        contacts: (2, 9) rows of `contact`, of which the first `n_contacts` are contacts.
        n_contacts: their number, 0 to 2.
        vpx, vpy: pusher's velocity v_p, frame of the step, m/s.
        mu: contact friction.
        dt: the step, s.
    """

    contacts: Any
    n_contacts: int
    vpx: float
    vpy: float
    mu: float
    dt: float


class Scales(NamedTuple):
    """What is large in a step.

    Attributes:
        arm: length by which moments are compared with forces, m.
        load: force that the table's friction and the drive can exert, N.
        speed: of pusher and body, m/s.
    """

    arm: float
    load: float
    speed: float


class Unknowns(NamedTuple):
    """What a step is solved for: a guess in, the solution out.

    Attributes:
        xi: (3,) twist, m/s and rad/s.
        lam: (2, 2) contact forces lam_n, lam_t, N.
        modes: (2,) contact modes.
    """

    xi: Any
    lam: Any
    modes: Any


@kernel(allocates=False, inlined=True)
def calc_compliance(touch, scales):
    """Calculates the compliance of the contacts, (m/s)/N."""
    return CONTACT_COMPLIANCE * scales.speed / scales.load if touch.n_contacts > 1 else 0.0


@kernel(allocates=False)
def build_contact_system(H, touch, modes, compliance, K):
    """Fills K with [[H, -E], [C, -compliance]] for the contacts that are not separate.

    C holds J_n of every touching contact and J_t of every sticking one; E holds J_n (and J_t) of a
    sticking contact, J_n ± mu J_t of a sliding one.

    Returns:
        The size of K.
    """
    contacts = touch.contacts
    mu = touch.mu
    for i in range(3):
        for j in range(3):
            K[i, j] = H[i, j]
    size = 3
    for c in range(touch.n_contacts):
        mode = modes[c]
        if mode == SEPARATE:
            continue
        nx = contacts[c, NX]
        ny = contacts[c, NY]
        cx = contacts[c, CX]
        cy = contacts[c, CY]
        # c × N and c × T
        n2 = cx * ny - cy * nx
        t2 = cx * nx + cy * ny
        slide = 0.0
        if mode == SLIDE_PLUS:
            slide = mu
        elif mode == SLIDE_MINUS:
            slide = -mu
        # The row of C, and the column of E, of the normal force with the friction that follows it.
        K[size, 0] = nx
        K[size, 1] = ny
        K[size, 2] = n2
        K[0, size] = -(nx - slide * ny)
        K[1, size] = -(ny + slide * nx)
        K[2, size] = -(n2 + slide * t2)
        size += 1
        if mode == STICK:
            # Where it sticks the tangential force is an unknown of its own.
            K[size, 0] = -ny
            K[size, 1] = nx
            K[size, 2] = t2
            K[0, size] = ny
            K[1, size] = -nx
            K[2, size] = -t2
            size += 1
    for i in range(3, size):
        for j in range(3, size):
            K[i, j] = 0.0
        K[i, i] = -compliance
    return size


@kernel(allocates=False)
def relax_jam(contacts, X, columns):
    """Makes the right-hand sides of two sticking contacts consistent, in rows 3 to 6 of X.

    Two contacts that stick ask for four velocities, a rigid body has three: z^T J = 0 with z a pair
    of opposite forces along the line d between the contacts, so z^T X must vanish too. What gaps
    leave of it is taken from the tangential rows, the normal ones only where d is normal to the
    outline: the disc slips a little to close its gaps. Else the two contacts would squeeze the body
    without bound.
    """
    dx = contacts[1, CX] - contacts[0, CX]
    dy = contacts[1, CY] - contacts[0, CY]
    # z: the pair of forces in the contacts' own directions N_0, T_0, N_1, T_1.
    z0 = contacts[0, NX] * dx + contacts[0, NY] * dy
    z1 = -contacts[0, NY] * dx + contacts[0, NX] * dy
    z2 = -contacts[1, NX] * dx - contacts[1, NY] * dy
    z3 = contacts[1, NY] * dx - contacts[1, NX] * dy
    size = _NORMAL_FRACTION * (z0 * z0 + z2 * z2) + z1 * z1 + z3 * z3
    if size == 0.0:
        return
    for j in range(columns):
        fraction = (z0 * X[3, j] + z1 * X[4, j] + z2 * X[5, j] + z3 * X[6, j]) / size
        X[3, j] -= fraction * _NORMAL_FRACTION * z0
        X[4, j] -= fraction * z1
        X[5, j] -= fraction * _NORMAL_FRACTION * z2
        X[6, j] -= fraction * z3


@kernel(allocates=False)
def _solve_contacts(H, rhs, touch, compliance, K, X, unknowns):
    """Solves the linearized step into xi and lam, for any modes, by elimination.

    Returns:
        Whether there is a solution.
    """
    contacts, count, vpx, vpy, mu, dt = touch
    xi, lam, modes = unknowns
    size = build_contact_system(H, touch, modes, compliance, K)
    for i in range(3):
        X[i, 0] = rhs[i]

    # What the pusher asks for: to close the gap, and no slip where it sticks.
    row = 3
    for c in range(count):
        if modes[c] == SEPARATE:
            continue
        nx = contacts[c, NX]
        ny = contacts[c, NY]
        X[row, 0] = nx * vpx + ny * vpy - contacts[c, GAP] / dt
        row += 1
        if modes[c] == STICK:
            X[row, 0] = nx * vpy - ny * vpx
            row += 1
    if size == 7:
        relax_jam(contacts, X, 1)
    if not solve_dense(K, X, size, 1):
        return False
    for i in range(3):
        xi[i] = X[i, 0]

    # The forces; where a contact slides, the tangential one follows the normal one.
    row = 3
    for c in range(count):
        lam[c, 0] = lam[c, 1] = 0.0
        if modes[c] == SEPARATE:
            continue
        lam[c, 0] = X[row, 0]
        row += 1
        if modes[c] == STICK:
            lam[c, 1] = X[row, 0]
            row += 1
        elif modes[c] == SLIDE_PLUS:
            lam[c, 1] = mu * lam[c, 0]
        else:
            lam[c, 1] = -mu * lam[c, 0]
    return True


@kernel(allocates=False, inlined=True)
def _solve_one_contact(H, rhs, touch, unknowns):
    """Solves the linearized step into xi and lam, where one contact sticks or slides.

    With z = (c_y, -c_x, 1), the twist of a turn about the contact c, and the velocity v of the
    contact, every twist is xi = (v, 0) + w z. A force at the contact does no work on z, so that

        stick:  v is the pusher's (its normal part less gap/dt), and z^T (H xi - rhs) = 0 gives w
        slide:  N·v is so, T·v = p is free; the force is along N ± mu T, so that besides
                (T -+ mu N, 0)^T (H xi - rhs) = 0

    and the force is the first two rows of H xi - rhs.

    Returns:
        Whether there is a solution.
    """
    contacts = touch.contacts
    xi, lam, modes = unknowns
    vpx = touch.vpx
    vpy = touch.vpy
    nx = contacts[0, NX]
    ny = contacts[0, NY]
    cx = contacts[0, CX]
    cy = contacts[0, CY]
    # H z, and z^T H z
    hz0 = apply_row(H, 0, cy, -cx, 1.0)
    hz1 = apply_row(H, 1, cy, -cx, 1.0)
    hz2 = apply_row(H, 2, cy, -cx, 1.0)
    zhz = cy * hz0 - cx * hz1 + hz2
    closing = nx * vpx + ny * vpy - contacts[0, GAP] / touch.dt
    along = 0.0
    slope = 0.0
    if modes[0] == STICK:
        along = nx * vpy - ny * vpx
    elif modes[0] == SLIDE_PLUS:
        slope = touch.mu
    else:
        slope = -touch.mu
    vx = nx * closing - ny * along
    vy = ny * closing + nx * along
    # rhs - H (v, 0), as far as v is known
    q0 = rhs[0] - H[0, 0] * vx - H[0, 1] * vy
    q1 = rhs[1] - H[1, 0] * vx - H[1, 1] * vy
    q2 = rhs[2] - H[2, 0] * vx - H[2, 1] * vy
    zq = cy * q0 - cx * q1 + q2
    if modes[0] == STICK:
        if zhz == 0.0:
            return False
        w = zq / zhz
    else:
        # H (T, 0), and y = T -+ mu N
        ht0 = -ny * H[0, 0] + nx * H[0, 1]
        ht1 = -ny * H[1, 0] + nx * H[1, 1]
        ht2 = -ny * H[2, 0] + nx * H[2, 1]
        yx = -ny - slope * nx
        yy = nx - slope * ny
        zht = cy * ht0 - cx * ht1 + ht2
        yhz = yx * hz0 + yy * hz1
        yht = yx * ht0 + yy * ht1
        yq = yx * q0 + yy * q1
        # [[z^T H z, z^T H T], [y^T H z, y^T H T]] (w, p) = (z^T q, y^T q)
        determinant = zhz * yht - zht * yhz
        if determinant == 0.0:
            return False
        w = (zq * yht - zht * yq) / determinant
        p = (zhz * yq - yhz * zq) / determinant
        vx -= p * ny
        vy += p * nx
        q0 -= p * ht0
        q1 -= p * ht1
    xi[0] = vx + w * cy
    xi[1] = vy - w * cx
    xi[2] = w
    # the force, H xi - rhs
    fx = w * hz0 - q0
    fy = w * hz1 - q1
    if modes[0] == STICK:
        lam[0, 0] = nx * fx + ny * fy
        lam[0, 1] = nx * fy - ny * fx
    else:
        dx = nx - slope * ny
        dy = ny + slope * nx
        lam[0, 0] = (dx * fx + dy * fy) / (1.0 + slope * slope)
        lam[0, 1] = slope * lam[0, 0]
    return True


@kernel(allocates=False, inlined=True)
def _try_modes(H, rhs, touch, scales, compliance, K, X, unknowns):
    """Solves the linearized step into xi and lam, for the modes in `unknowns`.

    Returns:
        The worst violation of what the modes promise, as a fraction of load and speed; infinite
        where there is no solution.
    """
    contacts, count, vpx, vpy, mu, dt = touch
    load = scales.load
    speed = scales.speed
    xi, lam, modes = unknowns
    if count == 1 and modes[0] != SEPARATE:
        solved = _solve_one_contact(H, rhs, touch, unknowns)
    else:
        solved = _solve_contacts(H, rhs, touch, compliance, K, X, unknowns)
    if not solved:
        return np.inf

    # How far the solution is from what its modes promise.
    worst = 0.0
    for c in range(count):
        mode = modes[c]
        nx = contacts[c, NX]
        ny = contacts[c, NY]
        cx = contacts[c, CX]
        cy = contacts[c, CY]
        slip_x = xi[0] - xi[2] * cy - vpx
        slip_y = xi[1] + xi[2] * cx - vpy
        if mode == SEPARATE:
            # The pusher must not approach.
            worst = max(worst, -(nx * slip_x + ny * slip_y + contacts[c, GAP] / dt) / speed)
            continue
        # It must not pull; where it sticks, stay in the cone; where it slides, oppose the slip.
        normal = lam[c, 0]
        worst = max(worst, -normal / load)
        slip = nx * slip_y - ny * slip_x
        if mode == STICK:
            worst = max(worst, (abs(lam[c, 1]) - mu * normal) / load)
        elif mode == SLIDE_PLUS:
            worst = max(worst, slip / speed)
        else:
            worst = max(worst, -slip / speed)
    return worst


@kernel(allocates=False, inlined=True)
def solve_modes(H, rhs, touch, scales, compliance, K, X, unknowns):
    """Enumerates the contact modes of a linearized step, those in `unknowns` first.

    Args:
        H, rhs: (3, 3), (3,) Hessian, and what H xi is without contacts.
        touch, scales, compliance: of the step.
        K, X: workspace (7, 7), each.
        unknowns: modes to begin with in, the best out.

    Returns:
        Their worst violation, as a fraction of load and speed.
    """
    modes = unknowns.modes
    count = touch.n_contacts
    choices = 4 if count == 1 else 16
    best = np.inf
    best0 = modes[0]
    best1 = modes[1]
    # First the last step's modes. If they do not fit, all in turn; if none does, the best of all.
    for attempt in range(choices + 2):
        if attempt > choices:
            modes[0] = best0
            modes[1] = best1
        elif attempt > 0:
            modes[0] = (attempt - 1 + STICK) % 4
            modes[1] = (attempt - 1) // 4
        worst = _try_modes(H, rhs, touch, scales, compliance, K, X, unknowns)
        if worst <= _MODE_TOLERANCE or count == 0 or attempt > choices:
            break
        if worst < best:  # which NaN never is
            best = worst
            best0 = modes[0]
            best1 = modes[1]
    return worst

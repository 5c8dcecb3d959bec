"""The contact problem of one linearized step: whether its contacts separate, stick or slide.

A step has at most two contacts.

With the 3x3 Hessian H, the rows J_n, J_t of the contacts and E = J_n^T (+ J_t^T, or + mu J_t^T
where it slides), the modes that are right solve

    [[H, -E], [C, 0]] (xi, lam) = (rhs, what the pusher asks for)

where C has the rows J_n of touching and J_t of sticking contacts, with lam_n >= 0 where a contact
touches, no approach where it does not, |lam_t| <= mu lam_n where it sticks, and slip against lam_t
where it slides. The last step's modes are tried first, then all.
"""

from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact import CX, CY, GAP, NX, NY
from gridpush_drake.dynamics.kernels.small_matrix import solve_dense

SEPARATE, STICK, SLIDE_PLUS, SLIDE_MINUS = range(4)
"""Contact modes; `SLIDE_PLUS` has lam_t = + mu_c lam_n."""

COMPLIANCE = 1e-9
"""Compliance of two contacts at once, as a share of speed/load.

It makes two sticking contacts, which are one more than the body needs, well posed."""

_MODE_TOLERANCE = 1e-9
"""Violation of the contact conditions, as a share of load and speed, that counts as none."""

_NORMAL_SHARE = 1e-4
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


@kernel(allocates=False)
def calc_compliance(touch, scales):
    """Calculates the compliance of the contacts, (m/s)/N."""
    return COMPLIANCE * scales.speed / scales.load if touch.n_contacts > 1 else 0.0


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
    size = _NORMAL_SHARE * (z0 * z0 + z2 * z2) + z1 * z1 + z3 * z3
    if size == 0.0:
        return
    for j in range(columns):
        share = (z0 * X[3, j] + z1 * X[4, j] + z2 * X[5, j] + z3 * X[6, j]) / size
        X[3, j] -= share * _NORMAL_SHARE * z0
        X[4, j] -= share * z1
        X[5, j] -= share * _NORMAL_SHARE * z2
        X[6, j] -= share * z3


@kernel(allocates=False)
def _try_modes(H, rhs, touch, scales, compliance, K, X, unknowns):
    """Solves the linearized step into xi and lam, for the modes in `unknowns`.

    Returns:
        The worst violation of what the modes promise, as a share of load and speed.
    """
    contacts, count, vpx, vpy, mu, dt = touch
    load = scales.load
    speed = scales.speed
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
        return np.inf
    for i in range(3):
        xi[i] = X[i, 0]

    # How far the solution is from what its modes promise.
    worst = 0.0
    row = 3
    for c in range(count):
        mode = modes[c]
        nx = contacts[c, NX]
        ny = contacts[c, NY]
        cx = contacts[c, CX]
        cy = contacts[c, CY]
        slip_x = xi[0] - xi[2] * cy - vpx
        slip_y = xi[1] + xi[2] * cx - vpy
        lam[c, 0] = lam[c, 1] = 0.0
        if mode == SEPARATE:
            # The pusher must not approach.
            worst = max(worst, -(nx * slip_x + ny * slip_y + contacts[c, GAP] / dt) / speed)
            continue
        normal = X[row, 0]
        row += 1
        # It must not pull; where it sticks, stay in the cone; where it slides, oppose the slip.
        worst = max(worst, -normal / load)
        lam[c, 0] = normal
        slip = nx * slip_y - ny * slip_x
        if mode == STICK:
            lam[c, 1] = X[row, 0]
            row += 1
            worst = max(worst, (abs(lam[c, 1]) - mu * normal) / load)
        elif mode == SLIDE_PLUS:
            lam[c, 1] = mu * normal
            worst = max(worst, slip / speed)
        else:
            lam[c, 1] = -mu * normal
            worst = max(worst, -slip / speed)
    return worst


@kernel(allocates=False)
def solve_modes(H, rhs, touch, scales, compliance, K, X, unknowns):
    """Enumerates the contact modes of a linearized step, those in `unknowns` first.

    Args:
        H, rhs: (3, 3), (3,) Hessian, and what H xi is without contacts.
        touch, scales, compliance: of the step.
        K, X: workspace (7, 7), each.
        unknowns: modes to begin with in, the best out.

    Returns:
        Their worst violation, as a share of load and speed.
    """
    modes = unknowns.modes
    count = touch.n_contacts
    worst = _try_modes(H, rhs, touch, scales, compliance, K, X, unknowns)
    if worst <= _MODE_TOLERANCE or count == 0:
        return worst

    # The last step's modes do not fit: try all, and keep the best should none fit.
    best = worst if worst == worst else np.inf  # NaN is no bound
    best0 = modes[0]
    best1 = modes[1]
    for choice in range(4 if count == 1 else 16):
        modes[0] = (choice + STICK) % 4
        modes[1] = choice // 4
        worst = _try_modes(H, rhs, touch, scales, compliance, K, X, unknowns)
        if worst <= _MODE_TOLERANCE:
            return worst
        if worst < best:
            best = worst
            best0 = modes[0]
            best1 = modes[1]
    modes[0] = best0
    modes[1] = best1
    return _try_modes(H, rhs, touch, scales, compliance, K, X, unknowns)

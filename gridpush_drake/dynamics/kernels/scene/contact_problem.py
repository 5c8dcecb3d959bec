"""The contact problem of one linearized step of several bodies.

With H the block diagonal Hessian of the bodies' friction with the table, with the rows J_n and J_t
of every contact (N and c × N on its first body, the opposite on its second), and E = J_n^T (+
J_t^T, or ± mu J_t^T where it slides), the modes that are right solve

    H xi - E lam = rhs
    C xi + compliance lam = b

where C has the rows J_n of touching and J_t of sticking contacts, and b what they ask for: the
pusher's velocity, and to close the gap.

Friction does not depend on how fast a body moves, so H all but vanishes along xi itself and cannot
be eliminated. With the axis a along xi and a weight sigma,

    (H + sigma a a^T) xi - a tau - E lam = rhs,    a·xi - tau/sigma = 0

is the same, with one unknown tau more for each body and a matrix S = H + sigma a a^T that can. A
body's tau is so treated as the force of one more contact, of compliance -1/sigma. What is left is

    (C S^-1 E + compliance) lam = b - C S^-1 rhs

Modes are found by an active set that starts from those of the step before: contacts that break what
their mode promises change it, all at once, and one by one should that not end. If neither does, a
projected Gauss-Seidel method on the same problem, each contact solved exactly in its turn, says
which modes to start from.
"""

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.contact_modes import (
    SEPARATE,
    SLIDE_MINUS,
    SLIDE_PLUS,
    STICK,
)
from gridpush_drake.dynamics.kernels.scene.compiled import kernel
from gridpush_drake.dynamics.kernels.scene.records import (
    FIRST_BODY,
    FRICTION,
    OTHER_CX,
    OTHER_CY,
    OTHER_NX,
    OTHER_NY,
    ROW_CX,
    ROW_CY,
    ROW_GAP,
    ROW_NX,
    ROW_NY,
    SECOND_BODY,
    TIP_VX,
    TIP_VY,
)
from gridpush_drake.dynamics.kernels.small_matrix import solve_dense

COMPLIANCE = 1e-9
"""Compliance of the pusher's contacts where there is more than one, as a share of speed/load.

It makes contacts that share a load in more than one way well posed."""

PAIR_COMPLIANCE = 1e-5
"""Compliance of two bodies' contacts, as a share of speed/load.

Bodies that touch at three places and more would squeeze each other by any force wherever their gaps
disagree by a rounding error. So soft, a contact that bears the whole load gives way by 10 µm for
each meter of the push, along the contact; across it, the gap that this leaves is closed again in
the next step."""

MODE_TOLERANCE = 1e-9
"""Violation of the contact conditions, as a share of load and speed, that counts as none."""

_ALL_AT_ONCE = 8
"""Attempts in which all contacts that break their promise change their modes."""

_ONE_BY_ONE = 24
"""Attempts in which only the worst one does."""

_CONTESTED = 4
"""Most contacts all of whose modes are tried together."""

UNFIT = 1.0
"""Violation that is told where no modes were found that fit."""

_SWEEPS = 200
"""Most sweeps of the Gauss-Seidel method."""

_SETTLED = 1e-12
"""Change of the contact forces in a sweep, as a share of the load, that ends the method."""


class SceneScales(NamedTuple):
    """What is large in a step.

    Attributes:
        load: friction with the table that all cells of all bodies can carry, N.
        speed: of the pusher and of the fastest approach, m/s.
        tip_speed: of the pusher; `speed` where it stands still, m/s.
    """

    load: float
    speed: float
    tip_speed: float


class ContactWork(NamedTuple):
    """What a linearized step is solved with, for N bodies and R contacts.

    Attributes:
        inverse: (N, 3, 3) S^-1, body by body.
        free: (N, 3) S^-1 rhs: the twists without contacts.
        weight: (N,) sigma; zero of a body that rests.
        load: (N,) sigma a·xi, N.
        start: (N, 3) twists without contacts of bodies that keep their speed.
        rows: (2R+N, 6) J_n and J_t of each contact, three numbers for each of its bodies; then the
            axis a of each body.
        ends: (2R+N, 2) the bodies of each row; -1 where there is no second one.
        asked: (2R+N,) what J_n xi and J_t xi should be.
        used: (2R+N,) which of them an equation stands for; its column is in `columns`.
        columns: (2R+N, 6) the columns of E.
        responses: (2R+N, 6) S^-1 E.
        W, B: workspace (2R+N, 2R+N) and (2R+N, 1).
        next_modes: (R,) the modes that the solution speaks for.
        D: (2R, 2R) workspace of the Gauss-Seidel method: J S^-1 J^T.
        velocity: (2R,) workspace.
        swept, swept_modes: (R, 2), (R,) forces and modes that the method found.
        changes: (R,) how often a contact changed its mode when only the worst did.
        contested: contacts all of whose modes are tried.
    """

    inverse: Any
    free: Any
    weight: Any
    load: Any
    start: Any
    rows: Any
    ends: Any
    asked: Any
    used: Any
    columns: Any
    responses: Any
    W: Any
    B: Any
    next_modes: Any
    D: Any
    velocity: Any
    swept: Any
    swept_modes: Any
    changes: Any
    contested: Any


@kernel()
def make_contact_work(n, room):
    """Makes the workspace for n bodies and so many contacts."""
    size = 2 * room + n
    return ContactWork(
        inverse=np.zeros((n, 3, 3)),
        free=np.zeros((n, 3)),
        weight=np.zeros(n),
        load=np.zeros(n),
        start=np.zeros((n, 3)),
        rows=np.zeros((size, 6)),
        ends=np.zeros((size, 2), np.int64),
        asked=np.zeros(size),
        used=np.zeros(size, np.int64),
        columns=np.zeros((size, 6)),
        responses=np.zeros((size, 6)),
        W=np.zeros((size, size)),
        B=np.zeros((size, 1)),
        next_modes=np.zeros(room, np.int64),
        D=np.zeros((2 * room, 2 * room)),
        velocity=np.zeros(2 * room),
        swept=np.zeros((room, 2)),
        swept_modes=np.zeros(room, np.int64),
        changes=np.zeros(room, np.int64),
        contested=np.zeros(_CONTESTED, np.int64),
    )


@kernel(allocates=False)
def fill_rows(contacts, dt, work):
    """Fills in J_n, J_t and what they ask for, which stay the same throughout a step."""
    for r in range(contacts.counts[0]):
        numbers = contacts.numbers[r]
        nx = numbers[ROW_NX]
        ny = numbers[ROW_NY]
        cx = numbers[ROW_CX]
        cy = numbers[ROW_CY]
        normal = work.rows[2 * r]
        tangent = work.rows[2 * r + 1]
        # (N, c × N) and (T, c × T), with T = z × N
        normal[0] = nx
        normal[1] = ny
        normal[2] = cx * ny - cy * nx
        tangent[0] = -ny
        tangent[1] = nx
        tangent[2] = cx * nx + cy * ny
        mx = numbers[OTHER_NX]
        my = numbers[OTHER_NY]
        dx = numbers[OTHER_CX]
        dy = numbers[OTHER_CY]
        if contacts.ids[r, SECOND_BODY] < 0:
            mx = 0.0
            my = 0.0
        normal[3] = -mx
        normal[4] = -my
        normal[5] = -(dx * my - dy * mx)
        tangent[3] = my
        tangent[4] = -mx
        tangent[5] = -(dx * mx + dy * my)
        vx = numbers[TIP_VX]
        vy = numbers[TIP_VY]
        for k in range(2 * r, 2 * r + 2):
            work.ends[k, 0] = contacts.ids[r, FIRST_BODY]
            work.ends[k, 1] = contacts.ids[r, SECOND_BODY]
        work.asked[2 * r] = nx * vx + ny * vy - numbers[ROW_GAP] / dt
        work.asked[2 * r + 1] = nx * vy - ny * vx
    first = 2 * contacts.modes.shape[0]
    for b in range(work.weight.shape[0]):
        work.ends[first + b, 0] = b
        work.ends[first + b, 1] = -1
        work.asked[first + b] = 0.0


@kernel(allocates=False)
def invert_hessians(bodies, H, rhs, xi, awake, eps, work):
    """Fills in S^-1, S^-1 rhs, the axes and their weights, of the bodies that are awake.

    Args:
        bodies: `Bodies`.
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
def calc_row_velocity(row, i, j, twists):
    """Multiplies a row of J, of the bodies i and j, with the twists (N, 3)."""
    mine = twists[i]
    total = row[0] * mine[0] + row[1] * mine[1] + row[2] * mine[2]
    if j >= 0:
        other = twists[j]
        total += row[3] * other[0] + row[4] * other[1] + row[5] * other[2]
    return total


@kernel(allocates=False)
def respond(inverse, column, i, j, response):
    """Fills in H^-1 times a column of E (6,) of the bodies i and j."""
    for a in range(3):
        row = inverse[i, a]
        response[a] = row[0] * column[0] + row[1] * column[1] + row[2] * column[2]
        if j >= 0:
            row = inverse[j, a]
            response[3 + a] = row[0] * column[3] + row[1] * column[4] + row[2] * column[5]


@kernel(allocates=False)
def couple(row, i, j, response, k, m):
    """Multiplies a row of C, of the bodies i and j, with a response of the bodies k and m."""
    total = 0.0
    # the part of each body that the two have in common
    if i == k:
        total += row[0] * response[0] + row[1] * response[1] + row[2] * response[2]
    elif i == m:
        total += row[0] * response[3] + row[1] * response[4] + row[2] * response[5]
    if j >= 0:
        if j == k:
            total += row[3] * response[0] + row[4] * response[1] + row[5] * response[2]
        elif j == m:
            total += row[3] * response[3] + row[4] * response[4] + row[5] * response[5]
    return total


@kernel(allocates=False)
def calc_compliance(contacts, scales):
    """Calculates the compliance of the pusher's contacts and of two bodies', (m/s)/N.

    That of two bodies goes with the pusher's speed, which does not hang on where the bodies are.
    """
    several = contacts.counts[0] > 1
    finger = COMPLIANCE * scales.speed / scales.load if several else 0.0
    return finger, PAIR_COMPLIANCE * scales.tip_speed / scales.load


@kernel(allocates=False)
def build_contact_matrix(contacts, compliance, work):
    """Fills in W = C S^-1 E + compliance for the contacts' modes, and S^-1 E.

    The axes of the bodies that move come last.

    Returns:
        The size of W.
    """
    size = 0
    for r in range(contacts.counts[0]):
        mode = contacts.modes[r]
        if mode == SEPARATE:
            continue
        slide = 0.0
        if mode == SLIDE_PLUS:
            slide = contacts.numbers[r, FRICTION]
        elif mode == SLIDE_MINUS:
            slide = -contacts.numbers[r, FRICTION]
        # a sliding contact's friction goes with its normal force
        work.used[size] = 2 * r
        for a in range(6):
            work.columns[size, a] = work.rows[2 * r, a] + slide * work.rows[2 * r + 1, a]
        size += 1
        if mode == STICK:
            work.used[size] = 2 * r + 1
            for a in range(6):
                work.columns[size, a] = work.rows[2 * r + 1, a]
            size += 1
    # the bodies' axes, each with its tau
    n = work.weight.shape[0]
    first = work.rows.shape[0] - n
    forces = size
    for b in range(n):
        if work.weight[b] > 0.0:
            work.used[size] = first + b
            for a in range(3):
                work.columns[size, a] = work.rows[first + b, a]
            size += 1
    # S^-1 E, column by column, and W
    for q in range(size):
        ends = work.ends[work.used[q]]
        respond(work.inverse, work.columns[q], ends[0], ends[1], work.responses[q])
    for p in range(size):
        row = work.rows[work.used[p]]
        ends = work.ends[work.used[p]]
        for q in range(size):
            others = work.ends[work.used[q]]
            work.W[p, q] = couple(row, ends[0], ends[1], work.responses[q], others[0], others[1])
        if p < forces:
            work.W[p, p] += compliance[0 if ends[1] < 0 else 1]
        else:
            work.W[p, p] -= 1.0 / work.weight[ends[0]]
    return size


@kernel(allocates=False)
def _solve_modes(contacts, xi, compliance, work):
    """Solves the linearized step for the contacts' modes; False where it is singular."""
    lam = contacts.lam
    size = build_contact_matrix(contacts, compliance, work)
    # b - C S^-1 rhs
    for p in range(size):
        used = work.used[p]
        ends = work.ends[used]
        free = calc_row_velocity(work.rows[used], ends[0], ends[1], work.free)
        work.B[p, 0] = work.asked[used] - free
    if not solve_dense(work.W, work.B, size, 1):
        return False
    # xi = S^-1 (rhs + E lam), and the forces by contact
    for b in range(xi.shape[0]):
        for a in range(3):
            xi[b, a] = work.free[b, a]
    for r in range(contacts.counts[0]):
        lam[r, 0] = 0.0
        lam[r, 1] = 0.0
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
        r = used // 2
        if r >= contacts.counts[0]:
            continue  # a body's axis
        lam[r, used % 2] = force
        if contacts.modes[r] == SLIDE_PLUS:
            lam[r, 1] = contacts.numbers[r, FRICTION] * force
        elif contacts.modes[r] == SLIDE_MINUS:
            lam[r, 1] = -contacts.numbers[r, FRICTION] * force
    return True


@kernel(allocates=False)
def check_modes(contacts, xi, scales, work):
    """Calculates how far a solution is from what its modes promise.

    Args:
        contacts: with the forces of the solution.
        xi: (N, 3) twists of the solution.
        scales: `SceneScales`.
        work: `ContactWork`; its `next_modes` are filled with the modes that would fit better.

    Returns:
        The worst violation, as a share of load and speed, and its contact; -1 if there is none.
    """
    load = scales.load
    speed = scales.speed
    ids = contacts.ids
    worst = 0.0
    worst_contact = -1
    for r in range(contacts.counts[0]):
        mode = contacts.modes[r]
        i = ids[r, FIRST_BODY]
        j = ids[r, SECOND_BODY]
        mu = contacts.numbers[r, FRICTION]
        normal = contacts.lam[r, 0]
        violation = 0.0
        better = mode
        if mode == SEPARATE:
            # The bodies must not approach.
            approach = work.asked[2 * r] - calc_row_velocity(work.rows[2 * r], i, j, xi)
            violation = approach / speed
            better = STICK
        else:
            # They must not pull; where they stick, stay in the cone; where they slide, oppose it.
            slip = calc_row_velocity(work.rows[2 * r + 1], i, j, xi) - work.asked[2 * r + 1]
            if mode == STICK:
                tangential = contacts.lam[r, 1]
                violation = (abs(tangential) - mu * normal) / load
                better = SLIDE_PLUS if tangential > 0.0 else SLIDE_MINUS
            elif mode == SLIDE_PLUS:
                violation = slip / speed
                better = STICK
            else:
                violation = -slip / speed
                better = STICK
            if normal < -MODE_TOLERANCE * load:
                violation = max(violation, -normal / load)
                better = SEPARATE
        work.next_modes[r] = better if violation > MODE_TOLERANCE else mode
        if violation > worst or violation != violation:
            worst = violation if violation == violation else np.inf
            worst_contact = r
    return worst, worst_contact


@kernel(allocates=False)
def _improve(contacts, xi, scales, compliance, work):
    """Solves the step for ever better modes; returns the violation that is left."""
    worst = np.inf
    for attempt in range(_ALL_AT_ONCE + _ONE_BY_ONE):
        if not _solve_modes(contacts, xi, compliance, work):
            return np.inf
        worst, contact = check_modes(contacts, xi, scales, work)
        if worst <= MODE_TOLERANCE:
            return worst
        # All that break their promise, and later the worst alone, lest they go round in circles.
        if attempt < _ALL_AT_ONCE:
            for r in range(contacts.counts[0]):
                contacts.modes[r] = work.next_modes[r]
        else:
            contacts.modes[contact] = work.next_modes[contact]
            work.changes[contact] += 1
    return worst


@kernel(allocates=False)
def _enumerate(contacts, xi, scales, compliance, work):
    """Tries all modes of the contacts that changed theirs most often, and all others as they are.

    Returns:
        The violation that is left by the best modes, which it leaves to the contacts.
    """
    count = contacts.counts[0]
    # those that changed most often
    chosen = 0
    while chosen < _CONTESTED:
        most = 0
        for r in range(count):
            if work.changes[r] > work.changes[most]:
                most = r
        if work.changes[most] == 0:
            break
        work.changes[most] = 0
        work.contested[chosen] = most
        chosen += 1
    # every combination of their modes
    best = np.inf
    best_choice = 0
    for choice in range(4**chosen):
        _choose(contacts, work.contested, chosen, choice)
        if not _solve_modes(contacts, xi, compliance, work):
            continue
        worst, _ = check_modes(contacts, xi, scales, work)
        if worst <= MODE_TOLERANCE:
            return worst
        if worst < best:
            best = worst
            best_choice = choice
    _choose(contacts, work.contested, chosen, best_choice)
    return best


@kernel(allocates=False)
def _choose(contacts, contested, chosen, choice):
    """Gives contested contacts the modes that the digits of a number to the base 4 stand for."""
    for k in range(chosen):
        contacts.modes[contested[k]] = choice % 4
        choice //= 4


@kernel(allocates=False)
def _fill_start(work):
    """Fills in the twists without contacts of bodies that keep the speed along their axes.

    They are S^-1 (rhs + sigma a (a·xi)), with a·xi the speed that goes with sigma.
    """
    n = work.weight.shape[0]
    first = work.rows.shape[0] - n
    for b in range(n):
        axis = work.rows[first + b]
        for i in range(3):
            row = work.inverse[b, i]
            along = row[0] * axis[0] + row[1] * axis[1] + row[2] * axis[2]
            kept = work.load[b] * along if work.weight[b] > 0.0 else 0.0
            work.start[b, i] = work.free[b, i] + kept


@kernel(allocates=False)
def _sweep(contacts, compliance, load, work):
    """Finds modes and forces by the projected Gauss-Seidel method, and writes them to the contacts.

    Every body is held to the speed along its axis that it had, by a spring: a proximal term.
    """
    lam = contacts.lam
    D = work.D
    count = contacts.counts[0]
    # J S^-1 J^T, and the velocities without contact forces, as if every body kept its speed.
    for q in range(2 * count):
        ends = work.ends[q]
        respond(work.inverse, work.rows[q], ends[0], ends[1], work.responses[q])
        lam[q // 2, q % 2] = 0.0
        work.velocity[q] = (
            calc_row_velocity(work.rows[q], ends[0], ends[1], work.start) - work.asked[q]
        )
    for p in range(2 * count):
        ends = work.ends[p]
        for q in range(2 * count):
            others = work.ends[q]
            D[p, q] = couple(
                work.rows[p], ends[0], ends[1], work.responses[q], others[0], others[1]
            )
        D[p, p] += compliance[0 if ends[1] < 0 else 1]
    for _ in range(_SWEEPS):
        change = 0.0
        for r in range(count):
            n = 2 * r
            t = n + 1
            # The velocities without this contact's own forces.
            normal = work.velocity[n] - D[n, n] * lam[r, 0] - D[n, t] * lam[r, 1]
            tangential = work.velocity[t] - D[t, n] * lam[r, 0] - D[t, t] * lam[r, 1]
            mode, new_n, new_t = _solve_contact(
                D[n, n], D[n, t], D[t, t], normal, tangential, contacts.numbers[r, FRICTION]
            )
            contacts.modes[r] = mode
            dn = new_n - lam[r, 0]
            dt = new_t - lam[r, 1]
            lam[r, 0] = new_n
            lam[r, 1] = new_t
            change = max(change, abs(dn), abs(dt))
            for p in range(2 * count):
                work.velocity[p] += D[p, n] * dn + D[p, t] * dt
        if change <= _SETTLED * load:
            return


@kernel(allocates=False)
def _solve_contact(nn, nt, tt, normal, tangential, mu):
    """Solves one contact by itself: velocity = (normal, tangential) + [[nn, nt], [nt, tt]] lam.

    Returns:
        The mode, lam_n and lam_t.
    """
    if normal >= 0.0:
        return SEPARATE, 0.0, 0.0
    determinant = nn * tt - nt * nt
    if determinant > 0.0:
        lam_n = (-tt * normal + nt * tangential) / determinant
        lam_t = (nt * normal - nn * tangential) / determinant
        if abs(lam_t) <= mu * lam_n:
            return STICK, lam_n, lam_t
    # It slides against the slip that there would be without friction; or, if that does not fit, the
    # other way.
    sign = -1.0 if tangential - nt * normal / nn > 0.0 else 1.0
    effective = nn + sign * mu * nt
    if effective <= 0.0:
        sign = -sign
        effective = nn + sign * mu * nt
    lam_n = -normal / effective
    mode = SLIDE_PLUS if sign > 0.0 else SLIDE_MINUS
    return mode, lam_n, sign * mu * lam_n


@kernel(allocates=False)
def _take_sweep(contacts, xi, work):
    """Fills in the twists that go with the forces which the Gauss-Seidel method found."""
    for b in range(xi.shape[0]):
        for a in range(3):
            xi[b, a] = work.start[b, a]
    for r in range(contacts.counts[0]):
        for k in range(2):
            force = contacts.lam[r, k]
            ends = work.ends[2 * r + k]
            column = work.rows[2 * r + k]
            response = work.responses[2 * r + k]
            respond(work.inverse, column, ends[0], ends[1], response)
            for a in range(3):
                xi[ends[0], a] += response[a] * force
                if ends[1] >= 0:
                    xi[ends[1], a] += response[3 + a] * force


@kernel(allocates=False)
def solve_contacts(contacts, xi, scales, work):
    """Solves the linearized step, with modes that fit it.

    Where no modes are found that do, it gives the solution of the Gauss-Seidel method: that of the
    step with a proximal term, from which the next iteration goes on.

    Args:
        contacts: `Contacts`, modes to begin with in, modes and forces out.
        xi: (N, 3) filled with the twists of the bodies that are awake.
        scales: `SceneScales`.
        work: `ContactWork`, with S^-1, S^-1 rhs and the rows of J.

    Returns:
        The worst violation of the contact conditions, as a share of load and speed.
    """
    compliance = calc_compliance(contacts, scales)
    worst = _improve(contacts, xi, scales, compliance, work)
    count = contacts.counts[0]
    if worst <= MODE_TOLERANCE or count == 0:
        return worst
    # Other modes to start from.
    _fill_start(work)
    _sweep(contacts, compliance, scales.load, work)
    for r in range(count):
        work.swept_modes[r] = contacts.modes[r]
        work.swept[r, 0] = contacts.lam[r, 0]
        work.swept[r, 1] = contacts.lam[r, 1]
        work.changes[r] = 0
    worst = _improve(contacts, xi, scales, compliance, work)
    if worst <= MODE_TOLERANCE:
        return worst
    worst = _enumerate(contacts, xi, scales, compliance, work)
    if worst <= MODE_TOLERANCE:
        return worst
    # None fit: the next iteration goes on from what the sweeps found.
    for r in range(count):
        contacts.modes[r] = work.swept_modes[r]
        contacts.lam[r, 0] = work.swept[r, 0]
        contacts.lam[r, 1] = work.swept[r, 1]
    _take_sweep(contacts, xi, work)
    return min(worst, UNFIT)

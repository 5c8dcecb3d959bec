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

(`contact_system`). Modes are found by an active set that starts from those of the step before:
contacts that break what their mode promises change it. That is fast, and nearly always ends.

Where it does not, the step is taken with a proximal term: tau = sigma (a·xi of the last iterate),
so that every body is held to the speed that it has by a spring. With D = J S^-1 J^T and u = J xi -
b, lam_t = beta_+ - beta_- and gamma the slip,

    0 <= u_n = D_nn lam_n + D_nt (beta_+ - beta_-) + q_n           ⟂ lam_n  >= 0
    0 <= gamma + u_t                                               ⟂ beta_+ >= 0
    0 <= gamma - u_t                                               ⟂ beta_- >= 0
    0 <= mu lam_n - beta_+ - beta_-                                ⟂ gamma  >= 0

is a linear complementarity problem which always has a solution, and Lemke's method finds it (S is
positive definite, so the matrix is copositive: Anitescu and Potra 1997). Its modes start the active
set anew; if that still does not end, the next iteration goes on from the proximal step itself. What
is a solution with the term and does not change any more is one without it.
"""

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.contact_modes import (
    SEPARATE,
    SLIDE_MINUS,
    SLIDE_PLUS,
    STICK,
)
from gridpush_drake.dynamics.kernels.scene.complementary_pivoting import solve_complementarity
from gridpush_drake.dynamics.kernels.scene.contact_rows import (
    CONTACT_UNKNOWNS,
    calc_compliance,
    calc_row_velocity,
    couple,
    respond,
)
from gridpush_drake.dynamics.kernels.scene.contact_system import solve_modes
from gridpush_drake.dynamics.kernels.scene.records import FIRST_BODY, FRICTION, SECOND_BODY

MODE_TOLERANCE = 1e-9
"""Violation of the contact conditions, as a fraction of load and speed, that counts as none."""

_ALL_AT_ONCE = 5
"""Attempts in which all contacts that break their promise change their modes."""

_ONE_BY_ONE = 5
"""Attempts in which only the worst one does."""

_SLIGHT = 1e-11
"""Force of a contact, as a fraction of the load, that is none; and distance from its cone."""


@kernel(allocates=False)
def check_modes(contacts, xi, scales, work):
    """Calculates how far a solution is from what its modes promise.

    Args:
        contacts: with the forces of the solution.
        xi: (N, 3) twists of the solution.
        scales: `SceneScales`.
        work: `ContactWork`; its `next_modes` are filled with the modes that would fit better.

    Returns:
        The worst violation, as a fraction of load and speed, and its contact; -1 if there is none.
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
        if not solve_modes(contacts, xi, compliance, work):
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
    return worst


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
def _include(contacts, work):
    """Chooses the contacts that take part: those that touch, or should; returns their number."""
    count = 0
    for r in range(contacts.counts[0]):
        if contacts.modes[r] != SEPARATE or work.next_modes[r] != SEPARATE:
            work.included[count] = r
            count += 1
    return count


@kernel(allocates=False)
def _include_more(contacts, xi, count, scales, work):
    """Adds the contacts in which two bodies approach each other; returns the new number."""
    more = count
    for r in range(contacts.counts[0]):
        if contacts.modes[r] != SEPARATE:
            continue
        ends = work.ends[2 * r]
        speed = calc_row_velocity(work.rows[2 * r], ends[0], ends[1], xi)
        known = False
        for c in range(count):
            known = known or work.included[c] == r
        if not known and work.asked[2 * r] - speed > MODE_TOLERANCE * scales.speed:
            work.included[more] = r
            more += 1
    return more


@kernel(allocates=False)
def _fill_pivoting(contacts, count, scales, compliance, work):
    """Fills in the complementarity problem of the proximal step, in units of speed and load.

    Args:
        contacts: `Contacts`.
        count: number of those that are included.
        scales: `SceneScales`.
        compliance: of `calc_compliance`.
        work: `ContactWork`.

    Returns:
        Its size.
    """
    table = work.pivoting.table
    size = CONTACT_UNKNOWNS * count
    unit = scales.load / scales.speed
    # nothing yet but d, which is one everywhere
    for i in range(size):
        for c in range(size + 2):
            table[i, c] = 0.0
        table[i, size] = 1.0
    # S^-1 J^T
    for c in range(count):
        for q in range(2 * work.included[c], 2 * work.included[c] + 2):
            ends = work.ends[q]
            respond(work.inverse, work.rows[q], ends[0], ends[1], work.responses[q])
    for c in range(count):
        r = work.included[c]
        first = CONTACT_UNKNOWNS * c
        i = work.ends[2 * r, 0]
        j = work.ends[2 * r, 1]
        for k in range(2):
            # the normal velocity, then the slip
            p = 2 * r + k
            row = work.rows[p]
            line = table[first + k]
            for d in range(count):
                other = work.included[d]
                column = CONTACT_UNKNOWNS * d
                ends = work.ends[2 * other]
                normal = couple(row, i, j, work.responses[2 * other], ends[0], ends[1])
                tangential = couple(row, i, j, work.responses[2 * other + 1], ends[0], ends[1])
                line[column] = unit * normal
                line[column + 1] = unit * tangential
            line[first + k] += unit * compliance[0 if j < 0 else 1]
            for d in range(count):
                line[CONTACT_UNKNOWNS * d + 2] = -line[CONTACT_UNKNOWNS * d + 1]
            velocity = calc_row_velocity(row, i, j, work.start) - work.asked[p]
            line[size + 1] = velocity / scales.speed
        # the slip the other way, gamma in both, and the cone
        for column in range(size):
            table[first + 2, column] = -table[first + 1, column]
        table[first + 2, size + 1] = -table[first + 1, size + 1]
        table[first + 1, first + 3] = 1.0
        table[first + 2, first + 3] = 1.0
        table[first + 3, first] = contacts.numbers[r, FRICTION]
        table[first + 3, first + 1] = -1.0
        table[first + 3, first + 2] = -1.0
    return size


@kernel(allocates=False)
def _read_pivoting(contacts, xi, count, scales, work):
    """Reads modes, forces and twists from the solution of the complementarity problem."""
    z = work.pivoting.z
    for b in range(xi.shape[0]):
        for a in range(3):
            xi[b, a] = work.start[b, a]
    # none touches but those that take part and are pressed
    for r in range(contacts.counts[0]):
        contacts.modes[r] = SEPARATE
        contacts.lam[r, 0] = 0.0
        contacts.lam[r, 1] = 0.0
    for c in range(count):
        r = work.included[c]
        normal = z[CONTACT_UNKNOWNS * c]
        tangential = z[CONTACT_UNKNOWNS * c + 1] - z[CONTACT_UNKNOWNS * c + 2]
        if normal <= _SLIGHT:
            mode = SEPARATE
        elif contacts.numbers[r, FRICTION] * normal - abs(tangential) > _SLIGHT:
            mode = STICK
        else:
            mode = SLIDE_PLUS if tangential > 0.0 else SLIDE_MINUS
        contacts.modes[r] = mode
        contacts.lam[r, 0] = normal * scales.load
        contacts.lam[r, 1] = tangential * scales.load
        # xi = start + S^-1 J^T lam
        for k in range(2):
            force = contacts.lam[r, k]
            ends = work.ends[2 * r + k]
            response = work.responses[2 * r + k]
            for a in range(3):
                xi[ends[0], a] += response[a] * force
                if ends[1] >= 0:
                    xi[ends[1], a] += response[3 + a] * force


@kernel(allocates=False)
def _take_proximal_step(contacts, xi, scales, compliance, work):
    """Finds twists, forces and modes of the proximal step; returns False where it does not."""
    _fill_start(work)
    # Most contacts are far from touching: they come in only where they are broken without.
    count = _include(contacts, work)
    for _ in range(contacts.counts[0] + 1):
        size = _fill_pivoting(contacts, count, scales, compliance, work)
        if not solve_complementarity(work.pivoting, size):
            return False
        _read_pivoting(contacts, xi, count, scales, work)
        more = _include_more(contacts, xi, count, scales, work)
        if more == count:
            break
        count = more
    return True


@kernel(allocates=False)
def solve_contacts(contacts, xi, scales, work):
    """Solves the linearized step, with modes that fit it.

    Where no modes are found that do, it gives the solution of the step with a proximal term.

    Args:
        contacts: `Contacts`, modes to begin with in, modes and forces out.
        xi: (N, 3) filled with the twists of the bodies that are awake.
        scales: `SceneScales`.
        work: `ContactWork`, with S^-1, S^-1 rhs and the rows of J.

    Returns:
        The worst violation of the contact conditions, as a fraction of load and speed.
    """
    compliance = calc_compliance(contacts, scales)
    worst = _improve(contacts, xi, scales, compliance, work)
    if worst <= MODE_TOLERANCE or contacts.counts[0] == 0:
        return worst
    # Other modes to start from.
    if not _take_proximal_step(contacts, xi, scales, compliance, work):
        return np.inf
    worst = _improve(contacts, xi, scales, compliance, work)
    if worst <= MODE_TOLERANCE:
        return worst
    # None fit: the next iteration goes on from the proximal step.
    _take_proximal_step(contacts, xi, scales, compliance, work)
    worst, _ = check_modes(contacts, xi, scales, work)
    return worst

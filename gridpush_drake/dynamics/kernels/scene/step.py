"""One quasi-static step of several bodies: friction with the table against contact.

`docs/theory/model.md`, section 9. For every body b the step finds the twist xi_b, and for every
contact the forces lam = (lam_n, lam_t), such that

    grad Psi_b(xi_b) = sum of J_n^T lam_n + J_t^T lam_t over the contacts of body b
    0 <= lam_n ⟂ J_n xi - N·v_p + gap/dt >= 0
    |lam_t| <= mu lam_n, opposing the slip J_t xi - T·v_p; no slip inside the cone

v_p is zero but for contacts of the pusher. It is the step of `dynamics.kernels.step` with more
bodies: Newton's method on grad Psi leaves the problem of `contact_problem`; where it stalls the
majorizing Hessian takes over, then continuation in the stiction tolerance. Only bodies that the
pusher can reach through contacts take part (`wake`); the others rest.

The step's certificate is two numbers: the residual of the balance of forces, body by body as a
fraction of what the body's friction and contacts exert, and the violation of the contact
conditions.
"""

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.friction.laws import add_derivatives, can_majorize
from gridpush_drake.dynamics.kernels.scene.body_laws import take_law
from gridpush_drake.dynamics.kernels.scene.contact_problem import solve_contacts
from gridpush_drake.dynamics.kernels.scene.contact_rows import (
    fill_rows,
    make_contact_work,
    order_unknowns,
)
from gridpush_drake.dynamics.kernels.scene.contact_system import invert_hessians
from gridpush_drake.dynamics.kernels.scene.records import (
    CONTACT_SIZE,
    FIRST_BODY,
    IDENTITY_SIZE,
    ROW_GAP,
    SECOND_BODY,
)
from gridpush_drake.dynamics.kernels.step import (
    FINAL_RESIDUAL,
    ITERATION_LIMIT,
    MAX_RESIDUAL,
    MIN_SHARPENING,
    NEWTON_LIMIT,
    NOT_CONVERGED,
    SLOW_REDUCTION,
    STEP_CONVERGED,
    STICTION_FACTOR,
)

WAKING_OVERLAP = 1e-7
"""Overlap from which on two bodies are awake by themselves, m."""


class SceneStepWork(NamedTuple):
    """What a step is solved with, for N bodies and R contacts.

    Attributes:
        awake: (N,) which bodies take part.
        g, H, rhs: (N, 3), (N, 3, 3), (N, 3) gradient and Hessian of the friction, and H xi - g.
        scratch: (3,) workspace.
        last, before: (N, 3) solutions of the continuation.
        order: (N,) bodies in the order in which contacts wake them.
        parent: (N,) the contact that woke each.
        contact: `ContactWork`.
        certificate: (2,) residual and violation of the solution.
    """

    awake: Any
    g: Any
    H: Any
    rhs: Any
    scratch: Any
    last: Any
    before: Any
    order: Any
    parent: Any
    contact: Any
    certificate: Any


@kernel()
def make_step_work(n, room):
    """Makes the workspace of a step."""
    return SceneStepWork(
        awake=np.zeros(n, np.bool_),
        g=np.zeros((n, 3)),
        H=np.zeros((n, 3, 3)),
        rhs=np.zeros((n, 3)),
        scratch=np.zeros(3),
        last=np.zeros((n, 3)),
        before=np.zeros((n, 3)),
        order=np.zeros(n, np.int64),
        parent=np.zeros(n, np.int64),
        contact=make_contact_work(n, room),
        certificate=np.zeros(2),
    )


@kernel(allocates=False)
def wake(contacts, work):
    """Finds the bodies that take part in a step, and drops the contacts between the others.

    They are those that the pusher reaches through contacts, and those that overlap.

    Args:
        contacts: `Contacts` of the step.
        work: `SceneStepWork`; its `awake`, `order` and `parent` are filled.

    Returns:
        The number of bodies that are awake.
    """
    count = _spread(contacts, work)
    total = contacts.counts[0]
    kept = 0
    for r in range(total):
        if not work.awake[contacts.ids[r, FIRST_BODY]]:
            continue
        if kept < r:
            for column in range(IDENTITY_SIZE):
                contacts.ids[kept, column] = contacts.ids[r, column]
            for column in range(CONTACT_SIZE):
                contacts.numbers[kept, column] = contacts.numbers[r, column]
            contacts.modes[kept] = contacts.modes[r]
        kept += 1
    if kept < total:
        contacts.counts[0] = kept
        count = _spread(contacts, work)
    return count


@kernel(allocates=False)
def _spread(contacts, work):
    """Finds the bodies that the pusher reaches through contacts, and those that overlap.

    Args:
        contacts: `Contacts` of the step.
        work: `SceneStepWork`; its `awake`, `order` and `parent` are filled.

    Returns:
        The number of bodies that are awake.
    """
    awake = work.awake
    count = 0
    for b in range(awake.shape[0]):
        awake[b] = False
    # First those that the pusher touches, or that overlap another one.
    for r in range(contacts.counts[0]):
        i = contacts.ids[r, FIRST_BODY]
        j = contacts.ids[r, SECOND_BODY]
        if j < 0 or contacts.numbers[r, ROW_GAP] < -WAKING_OVERLAP:
            if not awake[i]:
                awake[i] = True
                work.order[count] = i
                work.parent[i] = r if j < 0 else -1
                count += 1
            if j >= 0 and not awake[j]:
                awake[j] = True
                work.order[count] = j
                work.parent[j] = -1
                count += 1
    # Then, from each of them on, those that it touches.
    next_one = 0
    while next_one < count:
        b = work.order[next_one]
        next_one += 1
        for r in range(contacts.counts[0]):
            i = contacts.ids[r, FIRST_BODY]
            j = contacts.ids[r, SECOND_BODY]
            other = -1
            if i == b:
                other = j
            elif j == b:
                other = i
            if other >= 0 and not awake[other]:
                awake[other] = True
                work.order[count] = other
                work.parent[other] = r
                count += 1
    return count


@kernel(allocates=False)
def _add_friction(bodies, b, eps, xi, majorize, g, H):
    """Adds gradient and Hessian of body b's friction with the table to g (3,) and H (3, 3).

    A law that has no majorizing Hessian adds its own instead.
    """
    law, cells = take_law(bodies, b)
    majorize = majorize and can_majorize(law)
    add_derivatives(law, cells, eps, xi, majorize, g, H)


@kernel(allocates=False)
def calc_residual(bodies, contacts, work):
    """Calculates how far the balance of forces is from zero, for the worst body.

    Returns:
        The norm of g - J^T lam, whose moment is divided by the body's arm, as a fraction of what
        its friction with the table and its contacts exert.
    """
    worst = 0.0
    rows = work.contact.rows
    lam = contacts.lam
    for b in range(work.awake.shape[0]):
        if not work.awake[b]:
            continue
        r0 = work.g[b, 0]
        r1 = work.g[b, 1]
        r2 = work.g[b, 2]
        scale = bodies.load[b]
        for r in range(contacts.counts[0]):
            place = 0
            if contacts.ids[r, SECOND_BODY] == b:
                place = 3
            elif contacts.ids[r, FIRST_BODY] != b:
                continue
            normal = rows[2 * r]
            tangent = rows[2 * r + 1]
            fx = normal[place] * lam[r, 0] + tangent[place] * lam[r, 1]
            fy = normal[place + 1] * lam[r, 0] + tangent[place + 1] * lam[r, 1]
            r0 -= fx
            r1 -= fy
            r2 -= normal[place + 2] * lam[r, 0] + tangent[place + 2] * lam[r, 1]
            scale += abs(fx) + abs(fy)
        r2 /= bodies.arm[b]
        worst = max(worst, sqrt(r0 * r0 + r1 * r1 + r2 * r2) / scale)
    return worst


@kernel(allocates=False)
def _fill_friction(bodies, eps, xi, majorize, work):
    """Fills in gradient and Hessian, or the majorizing Hessian alone, of the bodies awake."""
    for b in range(xi.shape[0]):
        if not work.awake[b]:
            continue
        g = work.scratch if majorize else work.g[b]
        H = work.H[b]
        for i in range(3):
            g[i] = 0.0
            for j in range(3):
                H[i, j] = 0.0
        _add_friction(bodies, b, eps, xi[b], majorize, g, H)


@kernel(allocates=False)
def _iterate(bodies, contacts, scales, eps, xi, work, limit):
    """Solves a step at one stiction tolerance by Newton's method; as of `solve_scene_step`.

    Returns:
        (status, iterations).
    """
    previous = np.inf
    majorize = False
    for iteration in range(limit):
        _fill_friction(bodies, eps, xi, False, work)

        # The contact forces of the last iteration say how well it solved the step. Where Newton's
        # method hardly gets on, the next step is a majorizing one, which always descends.
        last = False
        if iteration > 0:
            residual = calc_residual(bodies, contacts, work)
            rounding = residual < MAX_RESIDUAL and residual > SLOW_REDUCTION * previous
            last = residual < FINAL_RESIDUAL or rounding
            majorize = not (last or majorize) and residual > SLOW_REDUCTION * previous
            previous = residual
            work.certificate[0] = residual
            if majorize:
                _fill_friction(bodies, eps, xi, True, work)

        # The linearized step, with the contact modes that fit it.
        for b in range(xi.shape[0]):
            if work.awake[b]:
                for i in range(3):
                    row = work.H[b, i]
                    work.rhs[b, i] = (
                        row[0] * xi[b, 0] + row[1] * xi[b, 1] + row[2] * xi[b, 2] - work.g[b, i]
                    )
        if not invert_hessians(bodies, work.H, work.rhs, xi, work.awake, eps, work.contact):
            return NOT_CONVERGED, iteration + 1
        worst = solve_contacts(contacts, xi, scales, work.contact)
        work.certificate[1] = worst
        if not (worst < np.inf):
            return NOT_CONVERGED, iteration + 1
        if last:
            status = STEP_CONVERGED if worst < MAX_RESIDUAL else NOT_CONVERGED
            return status, iteration + 1
    return NOT_CONVERGED, limit


@kernel(allocates=False)
def _set_zero(values):
    """Fills an array (N, 3) with zeros."""
    for b in range(values.shape[0]):
        for i in range(3):
            values[b, i] = 0.0


@kernel(allocates=False)
def solve_scene_step(bodies, contacts, count, dt, scales, eps, xi, work):
    """Solves one step of the bodies that are awake, from the guess in `xi`.

    Args:
        bodies: `BodyArrays`.
        contacts: `Contacts`; modes to begin with in, modes and forces out.
        count: number of bodies that are awake.
        dt: the step, s.
        scales: `SceneScales`.
        eps: stiction tolerance, m/s.
        xi: (N, 3) twists in the frames of the step, guess in, solution out.
        work: `SceneStepWork`; its S^-1 are those at the solution, and `certificate` is filled.

    Returns:
        (status, iterations).
    """
    fill_rows(contacts, dt, work.contact)
    order_unknowns(contacts, work.order, count, work.contact)
    status, iterations = _iterate(bodies, contacts, scales, eps, xi, work, NEWTON_LIMIT)
    if status == STEP_CONVERGED:
        return status, iterations
    # Continuation: start where friction is smooth on the scale of the motion, and sharpen, by
    # smaller factors where it fails. What sticks at the end moves in proportion to the tolerance,
    # so the secant through the last two solutions predicts the next.
    last = work.last
    before = work.before
    _set_zero(last)
    _set_zero(before)
    last_tolerance = np.inf
    before_tolerance = np.inf
    tolerance = scales.speed
    factor = STICTION_FACTOR
    _set_zero(xi)
    while True:
        status, used = _iterate(bodies, contacts, scales, tolerance, xi, work, ITERATION_LIMIT)
        iterations += used
        if status == STEP_CONVERGED:
            if tolerance == eps:
                return status, iterations
            for b in range(xi.shape[0]):
                for i in range(3):
                    before[b, i] = last[b, i]
                    last[b, i] = xi[b, i]
            before_tolerance = last_tolerance
            last_tolerance = tolerance
            factor = max(factor * factor, STICTION_FACTOR)
        elif last_tolerance < np.inf and factor < MIN_SHARPENING:
            # Once more from the last solution, with a smaller stride.
            factor = sqrt(factor)
        else:
            return status, iterations
        tolerance = max(factor * last_tolerance, eps)
        ahead = (tolerance - last_tolerance) / (last_tolerance - before_tolerance)
        for b in range(xi.shape[0]):
            for i in range(3):
                xi[b, i] = last[b, i] + ahead * (last[b, i] - before[b, i])

"""One step: support friction against contact, solved together.

In the body frame, with the twist xi = (ux, uy, w), the contact rows J_n = (N, c × N), J_t = (T, c ×
T) and the pusher's velocity v_p, a step finds xi and the contact forces lam = (lam_n, lam_t) of
each contact such that

    H0 xi - drive + grad Psi(xi) - sum_c (J_n^T lam_n + J_t^T lam_t) = 0
    0 <= lam_n ⟂ J_n xi - N·v_p + gap/dt >= 0
    |lam_t| <= mu_c lam_n, opposing the slip J_t xi - T·v_p; no slip inside the cone

H0 = M_B/dt and drive = M_B xi_hat/dt + W in the inertial regime, both zero in the quasi-static one.
In the inertial regime gap/dt is at least -RECOVERY_SPEED (`rollout`): a body keeps the speed at
which an overlap is undone. Newton's method on grad Psi leaves a complementarity problem with the
3x3 Hessian H; its modes {separate, stick, slide +, slide -} are enumerated, the last step's first.
Where Newton stalls, the majorizing Hessian takes over, then continuation in the stiction tolerance.

A Newton step leaves a residual in proportion to the square of the one before it. The forces that it
finds tell what that was: with g the gradient where the step begins,

    residual before = |g - sum_c J^T lam|

so that a short step from a small residual (`Scheme.early_end`) need not be checked by one more sum
over the cells. Pushes that are only compared with one another are simulated so.
"""

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.contact import CX, CY, NX, NY
from gridpush_drake.dynamics.kernels.contact.contact_modes import calc_compliance, solve_modes
from gridpush_drake.dynamics.kernels.friction.laws import add_derivatives, can_majorize
from gridpush_drake.dynamics.kernels.small_matrix import apply_row

STEP_CONVERGED = 0
"""Status of a step that was solved."""

NOT_CONVERGED = 1
"""Status of a step whose residual, or whose contact modes, are off by too much."""

NEWTON_LIMIT = 15
"""Most Newton iterations from the guess. If they do not suffice, continuation begins."""

ITERATION_LIMIT = 40
"""Most Newton iterations at each tolerance of the continuation."""

SLOW_REDUCTION = 0.5
"""If a Newton step leaves more than this fraction of the residual, a majorizing one follows."""

FINAL_RESIDUAL = 1e-8
"""Residual, as a fraction of the load, at which one last Newton step is taken: it squares the
rest."""

MAX_RESIDUAL = 1e-6
"""Greatest residual of a step that counts as solved, as a fraction of the load."""

MAX_EARLY_CHANGE = 0.02
"""Greatest change of the twist in a Newton step that is not checked, as a fraction of the speed.
Where H is nearly singular, a small residual alone does not say that the step is small."""

STICTION_FACTOR = 0.1
"""Factor by which each step of the continuation lowers the stiction tolerance."""

MIN_SHARPENING = 0.97
"""The continuation gives up where it fails even with a factor as near to 1 as this."""


class StepWork(NamedTuple):
    """What a step is solved with.

    Attributes:
        H0, drive: (3, 3), (3,) inertia over dt and what drives the body, N; zero in the
            quasi-static regime.
        g, H: (3,), (3, 3) gradient and Hessian of inertia and friction, left as last used.
        rhs, scratch, last, before: workspace (3,).
        K, X: workspace (7, 7).
    """

    H0: Any
    drive: Any
    g: Any
    H: Any
    rhs: Any
    scratch: Any
    K: Any
    X: Any
    last: Any
    before: Any


@kernel()
def make_step_work():
    """Makes a workspace for one step, filled with zeros."""
    return StepWork(
        H0=np.zeros((3, 3)),
        drive=np.zeros(3),
        g=np.zeros(3),
        H=np.zeros((3, 3)),
        rhs=np.zeros(3),
        scratch=np.zeros(3),
        K=np.zeros((7, 7)),
        X=np.zeros((7, 7)),
        last=np.zeros(3),
        before=np.zeros(3),
    )


@kernel(allocates=False, inlined=True)
def _calc_residual(g, touch, scales, lam):
    """Calculates how far the step's balance of forces is from zero.

    Returns:
        The norm of g - sum_c J^T lam, whose moment is divided by `scales.arm`, as a fraction of the
        load and the contact forces.
    """
    contacts = touch.contacts
    r0 = g[0]
    r1 = g[1]
    r2 = g[2]
    scale = scales.load
    for c in range(touch.n_contacts):
        nx = contacts[c, NX]
        ny = contacts[c, NY]
        cx = contacts[c, CX]
        cy = contacts[c, CY]
        # N lam_n + T lam_t with T = z × N, and its moment about B's origin
        fx = nx * lam[c, 0] - ny * lam[c, 1]
        fy = ny * lam[c, 0] + nx * lam[c, 1]
        r0 -= fx
        r1 -= fy
        r2 -= cx * fy - cy * fx
        scale += abs(fx) + abs(fy)
    r2 /= scales.arm
    return sqrt(r0 * r0 + r1 * r1 + r2 * r2) / scale


@kernel(allocates=False, inlined=True)
def _iterate(law, cells, touch, scales, eps, early_end, unknowns, work, limit):
    """Solves a step at one stiction tolerance by Newton's method.

    Args:
        limit: most iterations; the others are those of `solve_step`.

    Returns:
        (status, iterations).
    """
    H0 = work.H0
    drive = work.drive
    g = work.g
    H = work.H
    rhs = work.rhs
    scratch = work.scratch
    K = work.K
    X = work.X
    xi = unknowns.xi
    compliance = calc_compliance(touch, scales)
    previous = np.inf
    majorize = False
    residual = np.inf
    for iteration in range(limit):
        # Gradient H0 xi - drive + grad Psi, and its Hessian.
        for i in range(3):
            g[i] = apply_row(H0, i, xi[0], xi[1], xi[2]) - drive[i]
            for j in range(3):
                H[i, j] = H0[i, j]
        add_derivatives(law, cells, eps, xi, False, g, H)

        # The contact forces of the last iteration say how well it solved the step. Where Newton's
        # method hardly gets on, the next step is a majorizing one, which always descends.
        last = False
        if iteration > 0:
            residual = _calc_residual(g, touch, scales, unknowns.lam)
            rounding = residual < MAX_RESIDUAL and residual > SLOW_REDUCTION * previous
            last = residual < FINAL_RESIDUAL or rounding
            majorize = (
                not (last or majorize)
                and residual > SLOW_REDUCTION * previous
                and can_majorize(law)
            )
            previous = residual
            if majorize:
                for i in range(3):
                    for j in range(3):
                        H[i, j] = H0[i, j]
                add_derivatives(law, cells, eps, xi, True, scratch, H)

        # The linearized step, with the contact modes that fit it.
        ux = xi[0]
        uy = xi[1]
        w = xi[2]
        for i in range(3):
            rhs[i] = apply_row(H, i, xi[0], xi[1], xi[2]) - g[i]
        worst = solve_modes(H, rhs, touch, scales, compliance, K, X, unknowns)
        if not (worst < np.inf):
            return NOT_CONVERGED, iteration + 1
        if early_end > 0.0 and not (last or majorize):
            change = abs(xi[0] - ux) + abs(xi[1] - uy) + scales.arm * abs(xi[2] - w)
            last = change < MAX_EARLY_CHANGE * scales.speed and (
                _calc_residual(g, touch, scales, unknowns.lam) < early_end
            )
        if last:
            status = STEP_CONVERGED if worst < MAX_RESIDUAL else NOT_CONVERGED
            return status, iteration + 1
    return NOT_CONVERGED, limit


@kernel(allocates=False, inlined=True)
def solve_step(law, cells, touch, scales, eps, early_end, unknowns, work):
    """Solves one step from the guess in `unknowns`.

    Args:
        law: the friction law, see `friction`.
        cells: (2, n) cell centers, m.
        touch: `Touch`, what the pusher asks for.
        scales: `Scales`.
        eps: stiction tolerance, m/s.
        early_end: as in `Scheme`.
        unknowns: `Unknowns`, guess in, solution out.
        work: `StepWork`; its H is the Hessian at the solution.

    Returns:
        (status, iterations).
    """
    status, iterations = _iterate(
        law, cells, touch, scales, eps, early_end, unknowns, work, NEWTON_LIMIT
    )
    if status == STEP_CONVERGED:
        return status, iterations
    # Continuation: start where friction is smooth on the scale of the motion, and sharpen, by
    # smaller factors where it fails. Cells that stick at the end move in proportion to the
    # tolerance, so the secant through the last two solutions predicts the next.
    last = work.last
    before = work.before
    last[:] = 0.0
    before[:] = 0.0
    last_tolerance = np.inf
    before_tolerance = np.inf
    tolerance = scales.speed
    factor = STICTION_FACTOR
    xi = unknowns.xi
    xi[:] = 0.0
    while True:
        status, used = _iterate(
            law, cells, touch, scales, tolerance, 0.0, unknowns, work, ITERATION_LIMIT
        )
        iterations += used
        if status == STEP_CONVERGED:
            if tolerance == eps:
                return status, iterations
            for i in range(3):
                before[i] = last[i]
                last[i] = xi[i]
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
        for i in range(3):
            xi[i] = last[i] + ahead * (last[i] - before[i])

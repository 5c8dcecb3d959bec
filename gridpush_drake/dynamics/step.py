"""One step: support friction against contact, solved together.

In the body frame, with the twist xi = (ux, uy, w), the contact rows J_n = (N, c × N), J_t = (T, c × T) and the pusher's
velocity v_p, a step finds xi and the contact forces lam = (lam_n, lam_t) of each contact such that

    H0 xi - drive + grad Psi(xi) - sum_c (J_n^T lam_n + J_t^T lam_t) = 0
    0 <= lam_n ⟂ J_n xi - N·v_p + gap/dt >= 0
    |lam_t| <= mu_c lam_n, opposing the slip J_t xi - T·v_p; no slip inside the cone

H0 = M_B/dt and drive = M_B xi_hat/dt + W in the inertial regime, both zero in the quasi-static one. Newton's method on
grad Psi leaves a complementarity problem with the 3x3 Hessian H; its modes {separate, stick, slide +, slide -} are
enumerated, the last step's first. Where Newton stalls, the majorizing Hessian takes over, then continuation in the
stiction tolerance.
"""

from math import sqrt

import numpy as np

from gridpush_drake.dynamics.compiled import kernel
from gridpush_drake.dynamics.contact import CX, CY, NX, NY
from gridpush_drake.dynamics.friction import add_isotropic, add_lagged
from gridpush_drake.dynamics.modes import COMPLIANCE, solve_modes

CONVERGED, NOT_CONVERGED = 0, 1

_NEWTON_LIMIT = 15
_ITERATION_LIMIT = 40
_SLOW = 0.5  # a Newton step that leaves more of the residual than this is followed by a majorizing one
_FINAL_RESIDUAL = 1e-8  # of the load: one more Newton step squares it
_LARGEST_RESIDUAL = 1e-6  # of the load, for a step to count as solved
_SHARPEN = 0.1  # of the tolerance, in a step of the continuation
_LEAST_SHARPENING = 0.97


@kernel()
def _residual(g, contacts, count, lam, arm, load):
    """Norm of g - sum_c J^T lam, its moment over the arm, over the load and the contact forces."""
    r0, r1, r2 = g[0], g[1], g[2]
    scale = load
    for c in range(count):
        nx, ny, cx, cy = contacts[c, NX], contacts[c, NY], contacts[c, CX], contacts[c, CY]
        fx = nx * lam[c, 0] - ny * lam[c, 1]
        fy = ny * lam[c, 0] + nx * lam[c, 1]
        r0 -= fx
        r1 -= fy
        r2 -= cx * fy - cy * fx
        scale += abs(fx) + abs(fy)
    r2 /= arm
    return sqrt(r0 * r0 + r1 * r1 + r2 * r2) / scale


@kernel()
def _newton(
    px, py, k, kappa2, spin_load, lagged, dx, dy, spin_sign, H0, drive, contacts, count, vpx, vpy, mu, dt,
    eps, arm, load, speed, xi, lam, modes, g, H, rhs, scratch, K, X, limit,
):  # fmt: skip
    """Newton's method at one stiction tolerance; returns (status, iterations). H is left as last used."""
    compliance = COMPLIANCE * speed / load if count > 1 else 0.0
    previous = np.inf
    majorize = False
    residual = np.inf
    for iteration in range(limit):
        for i in range(3):
            g[i] = H0[i, 0] * xi[0] + H0[i, 1] * xi[1] + H0[i, 2] * xi[2] - drive[i]
            for j in range(3):
                H[i, j] = H0[i, j]
        if lagged:
            add_lagged(px, py, k, dx, dy, spin_load, spin_sign, eps, xi, g, H)
        else:
            add_isotropic(px, py, k, kappa2, spin_load, eps, xi, False, g, H)
        last = False
        if iteration > 0:
            residual = _residual(g, contacts, count, lam, arm, load)
            rounding = residual < _LARGEST_RESIDUAL and residual > _SLOW * previous
            last = residual < _FINAL_RESIDUAL or rounding
            majorize = not (lagged or last or majorize) and residual > _SLOW * previous
            previous = residual
            if majorize:
                for i in range(3):
                    for j in range(3):
                        H[i, j] = H0[i, j]
                add_isotropic(px, py, k, kappa2, spin_load, eps, xi, True, scratch, H)
        for i in range(3):
            rhs[i] = H[i, 0] * xi[0] + H[i, 1] * xi[1] + H[i, 2] * xi[2] - g[i]
        worst = solve_modes(
            H, rhs, contacts, modes, count, vpx, vpy, mu, dt, load, speed, compliance, K, X, xi, lam
        )  # fmt: skip
        if not (worst < np.inf):
            return NOT_CONVERGED, iteration + 1
        if last:
            status = CONVERGED if worst < _LARGEST_RESIDUAL else NOT_CONVERGED
            return status, iteration + 1
    return NOT_CONVERGED, limit


@kernel()
def solve_step(
    px, py, k, kappa2, spin_load, lagged, dx, dy, spin_sign, H0, drive, contacts, count, vpx, vpy, mu, dt,
    eps, arm, load, speed, xi, lam, modes, g, H, rhs, scratch, K, X,
):  # fmt: skip
    """Solves one step from the guess in `xi`.

    Args:
        px, py, k: (n,) cell centres (m) and the friction each can carry (N).
        kappa2, spin_load: the spin model, see `friction`.
        lagged, dx, dy, spin_sign: the paper's lagged directions instead of isotropic friction.
        H0, drive: (3, 3), (3,) inertia over dt and what drives the body; zero in the quasi-static regime.
        contacts, count: from `find_contacts`.
        vpx, vpy: pusher's velocity, m/s, body frame.
        mu: contact friction.
        dt: s.
        eps: stiction tolerance, m/s.
        arm, load, speed: scales of length (m), force (N) and speed (m/s).
        xi: (3,) guess in, twist out.
        lam: (2, 2) contact forces lam_n, lam_t out, N.
        modes: (2,) guess in, modes out.
        g, H, rhs, scratch, K, X: workspace (3,), (3, 3), (3,), (3,), (7, 7), (7, 7); H is the Hessian at the solution.

    Returns:
        (status, iterations).
    """
    status, iterations = _newton(
        px, py, k, kappa2, spin_load, lagged, dx, dy, spin_sign, H0, drive, contacts, count, vpx, vpy, mu, dt,
        eps, arm, load, speed, xi, lam, modes, g, H, rhs, scratch, K, X, _NEWTON_LIMIT,
    )  # fmt: skip
    if status == CONVERGED:
        return status, iterations
    # Continuation: start where friction is smooth on the scale of the motion, and sharpen, by smaller factors where it
    # fails. Cells that stick at the end move in proportion to the tolerance, so the secant through the last two
    # solutions predicts the next.
    last, before = np.zeros(3), np.zeros(3)
    last_tolerance, before_tolerance = np.inf, np.inf
    tolerance, factor = speed, _SHARPEN
    xi[:] = 0.0
    while True:
        status, used = _newton(
            px, py, k, kappa2, spin_load, lagged, dx, dy, spin_sign, H0, drive, contacts, count, vpx, vpy, mu, dt,
            tolerance, arm, load, speed, xi, lam, modes, g, H, rhs, scratch, K, X, _ITERATION_LIMIT,
        )  # fmt: skip
        iterations += used
        if status == CONVERGED:
            if tolerance == eps:
                return status, iterations
            for i in range(3):
                before[i], last[i] = last[i], xi[i]
            before_tolerance, last_tolerance = last_tolerance, tolerance
            factor = max(factor * factor, _SHARPEN)
        elif last_tolerance < np.inf and factor < _LEAST_SHARPENING:
            factor = sqrt(factor)
        else:
            return status, iterations
        tolerance = max(factor * last_tolerance, eps)
        ahead = (tolerance - last_tolerance) / (last_tolerance - before_tolerance)
        for i in range(3):
            xi[i] = last[i] + ahead * (last[i] - before[i])

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
from gridpush_drake.dynamics.contact import CX, CY, GAP, NX, NY
from gridpush_drake.dynamics.friction import add_isotropic, add_lagged

SEPARATE, STICK, SLIDE_PLUS, SLIDE_MINUS = range(4)
"""Contact modes; `SLIDE_PLUS` has lam_t = + mu_c lam_n."""

CONVERGED, NOT_CONVERGED = 0, 1

_NEWTON_LIMIT = 15
_ITERATION_LIMIT = 40
_SLOW = 0.5  # a Newton step that leaves more of the residual than this is followed by a majorizing one
_FINAL_RESIDUAL = 1e-8  # of the load: one more Newton step squares it
_LARGEST_RESIDUAL = 1e-6  # of the load, for a step to count as solved
_MODE_TOLERANCE = 1e-9
COMPLIANCE = 1e-9
"""Of two contacts at once, in speed/load: makes redundant sticking contacts well posed."""

_NORMAL_SHARE = 1e-4  # of a jam's inconsistency, left to the normal rows
_SHARPEN = 0.1  # of the tolerance, in a step of the continuation
_LEAST_SHARPENING = 0.97


@kernel()
def solve_dense(A, B, size, columns):
    """Solves A X = B in place (X in B) by Gaussian elimination with partial pivoting; False where A is singular."""
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
    for c in range(columns):
        for i in range(size - 1, -1, -1):
            total = B[i, c]
            for j in range(i + 1, size):
                total -= A[i, j] * B[j, c]
            B[i, c] = total / A[i, i]
    return True


@kernel()
def build_contact_system(H, contacts, modes, count, mu, compliance, K):
    """Fills K with [[H, -E], [C, -compliance]] for the contacts that are not separate; returns its size.

    C holds J_n of every touching contact and J_t of every sticking one; E holds J_n (and J_t) of a sticking contact,
    J_n ± mu J_t of a sliding one.
    """
    for i in range(3):
        for j in range(3):
            K[i, j] = H[i, j]
    size = 3
    for c in range(count):
        mode = modes[c]
        if mode == SEPARATE:
            continue
        nx, ny, cx, cy = contacts[c, NX], contacts[c, NY], contacts[c, CX], contacts[c, CY]
        n2 = cx * ny - cy * nx
        t2 = cx * nx + cy * ny
        slide = 0.0
        if mode == SLIDE_PLUS:
            slide = mu
        elif mode == SLIDE_MINUS:
            slide = -mu
        K[size, 0], K[size, 1], K[size, 2] = nx, ny, n2
        K[0, size], K[1, size], K[2, size] = -(nx - slide * ny), -(ny + slide * nx), -(n2 + slide * t2)
        size += 1
        if mode == STICK:
            K[size, 0], K[size, 1], K[size, 2] = -ny, nx, t2
            K[0, size], K[1, size], K[2, size] = ny, -nx, -t2
            size += 1
    for i in range(3, size):
        for j in range(3, size):
            K[i, j] = 0.0
        K[i, i] = -compliance
    return size


@kernel()
def relax_jam(contacts, X, columns):
    """Makes the right-hand sides of two sticking contacts consistent, in rows 3 to 6 of X.

    Two contacts that stick ask for four velocities, a rigid body has three: z^T J = 0 with z a pair of opposite forces
    along the line d between the contacts, so z^T X must vanish too. What gaps leave of it is taken from the tangential
    rows, the normal ones only where d is normal to the outline: the disc slips a little to close its gaps. Else the
    two contacts would squeeze the body without bound.
    """
    dx, dy = contacts[1, CX] - contacts[0, CX], contacts[1, CY] - contacts[0, CY]
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


@kernel()
def _try_modes(H, rhs, contacts, modes, count, vpx, vpy, mu, dt, load, speed, compliance, K, X, xi, lam):
    """Solves the linearised step for one choice of modes into xi (3,) and lam (2, 2); returns its worst violation."""
    size = build_contact_system(H, contacts, modes, count, mu, compliance, K)
    for i in range(3):
        X[i, 0] = rhs[i]
    row = 3
    for c in range(count):
        if modes[c] == SEPARATE:
            continue
        nx, ny = contacts[c, NX], contacts[c, NY]
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
    worst = 0.0
    row = 3
    for c in range(count):
        mode = modes[c]
        nx, ny, cx, cy = contacts[c, NX], contacts[c, NY], contacts[c, CX], contacts[c, CY]
        slip_x = xi[0] - xi[2] * cy - vpx
        slip_y = xi[1] + xi[2] * cx - vpy
        lam[c, 0] = lam[c, 1] = 0.0
        if mode == SEPARATE:
            worst = max(worst, -(nx * slip_x + ny * slip_y + contacts[c, GAP] / dt) / speed)
            continue
        normal = X[row, 0]
        row += 1
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


@kernel()
def _solve_modes(H, rhs, contacts, modes, count, vpx, vpy, mu, dt, load, speed, compliance, K, X, xi, lam):
    """Enumerates the contact modes of the linearised step, those in `modes` first; leaves the best in all outputs."""
    worst = _try_modes(
        H, rhs, contacts, modes, count, vpx, vpy, mu, dt, load, speed, compliance, K, X, xi, lam
    )
    if worst <= _MODE_TOLERANCE or count == 0:
        return worst
    best = worst if worst == worst else np.inf
    best0, best1 = modes[0], modes[1]
    for choice in range(4 if count == 1 else 16):
        modes[0] = (choice + STICK) % 4
        modes[1] = choice // 4
        worst = _try_modes(
            H, rhs, contacts, modes, count, vpx, vpy, mu, dt, load, speed, compliance, K, X, xi, lam
        )
        if worst <= _MODE_TOLERANCE:
            return worst
        if worst < best:
            best, best0, best1 = worst, modes[0], modes[1]
    modes[0], modes[1] = best0, best1
    return _try_modes(
        H, rhs, contacts, modes, count, vpx, vpy, mu, dt, load, speed, compliance, K, X, xi, lam
    )


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
    """Newton's method at one stiction tolerance; returns (status, iterations, residual). H is left as last used."""
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
            add_lagged(px, py, k, dx, dy, spin_load, spin_sign, eps, xi, 1.0, g, H)
        else:
            add_isotropic(px, py, k, kappa2, spin_load, eps, xi, 1.0, False, g, H)
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
                add_isotropic(px, py, k, kappa2, spin_load, eps, xi, 1.0, True, scratch, H)
        for i in range(3):
            rhs[i] = H[i, 0] * xi[0] + H[i, 1] * xi[1] + H[i, 2] * xi[2] - g[i]
        worst = _solve_modes(
            H, rhs, contacts, modes, count, vpx, vpy, mu, dt, load, speed, compliance, K, X, xi, lam
        )  # fmt: skip
        if not (worst < np.inf):
            return NOT_CONVERGED, iteration + 1, np.inf
        if last:
            status = CONVERGED if worst < _LARGEST_RESIDUAL else NOT_CONVERGED
            return status, iteration + 1, residual
    return NOT_CONVERGED, limit, residual


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
    status, iterations, _ = _newton(
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
        status, used, _ = _newton(
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

"""The exact derivative of one converged step, by the implicit function theorem, and its propagation in time.

Differentiating the step's equations F(xi, lam; z) = 0 at fixed modes gives K d(xi, lam) = -dF, with K as built in
`step.build_contact_system`. All z but the cell frictions reach the step through a few numbers: the disc's centre t and
velocity v_p in the body frame, mu_c, the momentum and four inertia moments. In the body frame, with alpha = T·dt,

    dN = -bend alpha T,   dT = bend alpha N,   dc = alpha T on an edge, 0 at a vertex,   dgap = -N·dt
    dt = -s_xy - s_theta z × t + R^T dtip,     dv_p = -s_theta z × v_p + R^T dv_tip

where s = (R^T dx, dtheta) is the variation of the pose seen from the body. Columns carried, P = n + OTHER in all:

    k_1..k_n | m, cx, cy, I | mu_c | start x, start y, direction, length | x, y, theta at the beginning
"""

from math import cos, sin, sqrt

from gridpush_drake.dynamics.compiled import kernel
from gridpush_drake.dynamics.contact import BEND, CX, CY, NX, NY
from gridpush_drake.dynamics.step import SEPARATE, SLIDE_PLUS, STICK, build_contact_system, solve_dense

(
    MASS,
    COM_X,
    COM_Y,
    INERTIA,
    CONTACT_FRICTION,
    START_X,
    START_Y,
    DIRECTION,
    LENGTH,
    POSE_X,
    POSE_Y,
    POSE_THETA,
) = range(12)
"""Offsets of the columns after those of the n cell frictions."""

OTHER = 12
"""Number of those columns."""

_SMALL_ANGLE = 1e-4


@kernel()
def calc_step_derivative(H, contacts, modes, count, mu, compliance, vpx, vpy, dt, xi, lam, K, X, F, Y, D):
    """Differentiates a converged step.

    Args:
        H, contacts, modes, count, mu, compliance: as the step used them.
        vpx, vpy: pusher's velocity in the body frame, m/s.
        dt: s.
        xi, lam: the solution.
        K, X, F: workspace (7, 7), (7, 7), (7, 5).
        Y: (3, 3) out, d xi / d(-F_1): response to a generalised force.
        D: (3, 5) out, d xi / d(t_x, t_y, v_px, v_py, mu_c).

    Returns:
        False where the modes leave the step without a derivative.
    """
    size = build_contact_system(H, contacts, modes, count, mu, compliance, K)
    F[:size, :] = 0.0
    row = 3
    for c in range(count):
        mode = modes[c]
        if mode == SEPARATE:
            continue
        nx, ny, cx, cy, bend = (
            contacts[c, NX], contacts[c, NY], contacts[c, CX], contacts[c, CY], contacts[c, BEND],
        )  # fmt: skip
        tx, ty = -ny, nx
        c_cross_n, c_cross_t = cx * ny - cy * nx, cx * ty - cy * tx
        dn0, dn1, dn2 = -bend * tx, -bend * ty, -bend * c_cross_t
        if bend == 0.0:
            dn2 = -1.0
        dt0, dt1, dt2 = bend * nx, bend * ny, bend * c_cross_n
        f0 = -(dn0 * lam[c, 0] + dt0 * lam[c, 1])
        f1 = -(dn1 * lam[c, 0] + dt1 * lam[c, 1])
        f2 = -(dn2 * lam[c, 0] + dt2 * lam[c, 1])
        F[0, 0] += f0 * tx
        F[0, 1] += f0 * ty
        F[1, 0] += f1 * tx
        F[1, 1] += f1 * ty
        F[2, 0] += f2 * tx
        F[2, 1] += f2 * ty
        along = dn0 * xi[0] + dn1 * xi[1] + dn2 * xi[2] - dn0 * vpx - dn1 * vpy
        F[row, 0] = along * tx - nx / dt
        F[row, 1] = along * ty - ny / dt
        F[row, 2], F[row, 3] = -nx, -ny
        row += 1
        if mode == STICK:
            along = dt0 * xi[0] + dt1 * xi[1] + dt2 * xi[2] - dt0 * vpx - dt1 * vpy
            F[row, 0], F[row, 1] = along * tx, along * ty
            F[row, 2], F[row, 3] = -tx, -ty
            row += 1
        else:
            slide = lam[c, 0] if mode == SLIDE_PLUS else -lam[c, 0]
            F[0, 4] -= slide * tx
            F[1, 4] -= slide * ty
            F[2, 4] -= slide * c_cross_t
    X[:size, :size] = 0.0
    for i in range(size):
        X[i, i] = 1.0
    if not solve_dense(K, X, size, size):
        return False
    for i in range(3):
        for j in range(3):
            Y[i, j] = X[i, j]
        for j in range(5):
            total = 0.0
            for m in range(size):
                total -= X[i, m] * F[m, j]
            D[i, j] = total
    return True


@kernel(fast_sums=True)
def fill_cell_forces(px, py, spin, eps2, xi, f):
    """Fills f (3, >= n) with a_i / s_i, the gradient of each cell's dissipation with respect to xi, per unit k_i."""
    kappa2 = spin[0]
    ux, uy, w = xi[0], xi[1], xi[2]
    spin_torque = spin[2] * w / sqrt(w * w + eps2)
    f0, f1, f2 = f[0], f[1], f[2]
    for i in range(px.shape[0]):
        x, y = px[i], py[i]
        vx, vy = ux - w * y, uy + w * x
        inverse = 1.0 / sqrt(vx * vx + vy * vy + kappa2 * w * w + eps2)
        f0[i] = vx * inverse
        f1[i] = vy * inverse
        f2[i] = (x * vy - y * vx + kappa2 * w) * inverse + spin_torque


@kernel()
def calc_displacement_maps(xi, dt, inertial, cx, cy, A, G, L):
    """Differentiates the pose update x' = x + R d(xi), theta' = theta + w dt of one step.

    Quasi-static: d = V(w dt) u dt, the body turns about its instantaneous centre (exact for a constant twist).
    Inertial: d = dt u_com + c - R(w dt) c, the centre of mass moves straight (exact for free flight).

    Args:
        xi: twist, body frame.
        dt: s.
        inertial: the regime.
        cx, cy: centre of mass, body frame, m.
        A, G, L: (3, 3) out: s' = A s + G dxi for the variation of the pose seen from the body, and
            v' = L dxi for that of the centre of mass's velocity, both in the new body frame.

    Returns:
        d (two numbers, m, in the old body frame).
    """
    ux, uy, w = xi[0], xi[1], xi[2]
    phi = w * dt
    c, s = cos(phi), sin(phi)
    if inertial:
        com_x, com_y = ux - w * cy, uy + w * cx
        d0 = dt * com_x + cx - (c * cx - s * cy)
        d1 = dt * com_y + cy - (s * cx + c * cy)
        g00, g01, g02 = dt, 0.0, -dt * cy + dt * (s * cx + c * cy)
        g10, g11, g12 = 0.0, dt, dt * cx - dt * (c * cx - s * cy)
    else:
        com_x, com_y = ux, uy
        if abs(phi) < _SMALL_ANGLE:
            sinc, cosc = 1.0 - phi * phi / 6.0, phi / 2.0 - phi * phi * phi / 24.0
            sinc_slope, cosc_slope = -phi / 3.0 + phi * phi * phi / 30.0, 0.5 - phi * phi / 8.0
        else:
            sinc, cosc = s / phi, (1.0 - c) / phi
            sinc_slope, cosc_slope = (c - sinc) / phi, (s - cosc) / phi
        d0 = dt * (sinc * ux - cosc * uy)
        d1 = dt * (cosc * ux + sinc * uy)
        g00, g01, g02 = dt * sinc, -dt * cosc, dt * dt * (sinc_slope * ux - cosc_slope * uy)
        g10, g11, g12 = dt * cosc, dt * sinc, dt * dt * (cosc_slope * ux + sinc_slope * uy)
    A[0, 0], A[0, 1], A[0, 2] = c, s, -c * d1 + s * d0
    A[1, 0], A[1, 1], A[1, 2] = -s, c, s * d1 + c * d0
    A[2, 0], A[2, 1], A[2, 2] = 0.0, 0.0, 1.0
    G[0, 0], G[0, 1], G[0, 2] = c * g00 + s * g10, c * g01 + s * g11, c * g02 + s * g12
    G[1, 0], G[1, 1], G[1, 2] = -s * g00 + c * g10, -s * g01 + c * g11, -s * g02 + c * g12
    G[2, 0], G[2, 1], G[2, 2] = 0.0, 0.0, dt
    new_x, new_y = c * com_x + s * com_y, -s * com_x + c * com_y
    L[0, 0], L[0, 1], L[0, 2] = c, s, -c * cy + s * cx + dt * new_y
    L[1, 0], L[1, 1], L[1, 2] = -s, c, s * cy + c * cx - dt * new_x
    L[2, 0], L[2, 1], L[2, 2] = 0.0, 0.0, 1.0
    return d0, d1

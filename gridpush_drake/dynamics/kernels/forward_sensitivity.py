"""The derivative of a whole push: columns of variations, carried forward from step to step.

All is seen from the body: s = (R^T dx, dtheta) the variation of the pose, v that of the velocity of
the center of mass (quasi-static: of B's origin, which is then only what the next step expects) with
the yaw rate. The disc's center and velocity vary by

    dt = -s_xy - s_theta z × t + R^T dtip,     dv_p = -s_theta z × v_p + R^T dv_tip

Columns, n + OTHER in all:

    k_1..k_n | m, cx, cy, I | mu_c | start x, start y, direction, length | x, y, theta at the
    beginning

Where loads shift (`support_loads`) the cells' columns are those of m_1..m_n, there is one more for
h and, where both are wanted, n for mu_1..mu_n; and the friction F with the table is carried along,
with H2 the first rows of its Hessian:

    F' = H2 dxi + f
"""

from math import cos, sin
from typing import Any, NamedTuple

from gridpush_drake.dynamics.kernels.compiled import kernel

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

F_ROW = 9
"""First of the rows that hold F."""


class Columns(NamedTuple):
    """The variations of every column, and workspace.

    Attributes:
        Q: (9, width) rows 0-2 s, 3-5 v; 6-8 f, the force of each column: cells' and inertia's;
            where loads shift, 9-10 F.
        N, Z, B: workspace (6, width), (6, 9), (3, 6).
    """

    Q: Any
    N: Any
    Z: Any
    B: Any


@kernel(allocates=False)
def start_columns(Q, n, state):
    """Fills in the variations at the beginning: the pose's own, and what pose and center of mass do to the velocity.

    Args:
        Q: (9, n + OTHER) zeros; rows 0-2 are s, 3-5 v.
        n: number of cells.
        state: `State` at the beginning.
    """
    c, s, body_vx, body_vy, yaw_rate = state.c, state.s, state.body_x, state.body_y, state.yaw_rate
    Q[0, n + POSE_X], Q[1, n + POSE_X] = c, -s
    Q[0, n + POSE_Y], Q[1, n + POSE_Y] = s, c
    Q[2, n + POSE_THETA] = 1.0
    Q[3, n + POSE_THETA], Q[4, n + POSE_THETA] = body_vy, -body_vx
    Q[4, n + COM_X] = yaw_rate
    Q[3, n + COM_Y] = -yaw_rate


@kernel(allocates=False)
def step_columns(
    columns, body, inertial, maps, derivative, xi, start, path_length, point, new_x, new_y, H2
):
    """Carries every column over one step: (s, v)' = Z (s, v, f) + what acts on a column directly.

        dxi = B (s, v) - Y f + direct;  s' = A s + G dxi + dt p v_w;  v' = L dxi + p v_w,  p = h z ×
        (new velocity)

    Args:
        columns: updated; the cells' f in Q is that of the step.
        body: `Body`.
        inertial: the regime.
        maps: `PoseMaps`.
        derivative: `StepDerivative`.
        xi: (3,) twist.
        start: `StepStart`.
        path_length: of the disc's whole path, m.
        point: (2,) where the applied force acts, m.
        new_x, new_y: velocity of the center of mass after the step, in the new body frame, m/s.
        H2: (2, 3) of the friction's Hessian its first two rows; used where loads shift.
    """
    n = body.cells.shape[1]
    Q, N, Z, B = columns
    _fill_step_matrix(Z, B, body, inertial, maps, derivative, xi, start, point, new_x, new_y)
    if inertial:
        _add_inertia_forces(Q, n, body, xi, start)
    if Q.shape[0] > F_ROW:
        _step_friction(Q, B, derivative.Y, H2)
    _multiply(Z, Q, N)
    for i in range(6):
        row, new = Q[i], N[i]
        for column in range(row.shape[0]):
            row[column] = new[column]
    if inertial:
        _add_com(Q, n, maps, derivative, xi, start, H2)
    G, L, E, c, s = maps.G, maps.L, derivative.E, start.c, start.s
    ray_x, ray_y, world_vx, world_vy = start.ray_x, start.ray_y, start.world_vx, start.world_vy
    _add_direct(Q, n + CONTACT_FRICTION, E[0, 7], E[1, 7], E[2, 7], G, L, H2)
    _add_tip(Q, n + START_X, E, 1.0, 0.0, 0.0, 0.0, c, s, G, L, H2)
    _add_tip(Q, n + START_Y, E, 0.0, 1.0, 0.0, 0.0, c, s, G, L, H2)
    _add_tip(Q, n + DIRECTION, E, -ray_y, ray_x, -world_vy, world_vx, c, s, G, L, H2)
    if path_length > 0.0:
        q = 1.0 / path_length
        _add_tip(Q, n + LENGTH, E, q * ray_x, q * ray_y, q * world_vx, q * world_vy, c, s, G, L, H2)


@kernel(allocates=False)
def _fill_step_matrix(Z, B, body, inertial, maps, derivative, xi, start, point, new_x, new_y):
    """Fills in Z = [A, 0, 0; 0, 0, 0] + [G; L] [B, -Y] and what the yaw rate does through the frame of the step."""
    A, G, L = maps
    Y, E = derivative.Y, derivative.E
    mass, com_x, com_y, inertia = body.mass, body.com_x, body.com_y, body.inertia
    dt, h, a, tx, ty, vpx, vpy = start.dt, start.h, start.a, start.tx, start.ty, start.vx, start.vy
    fx, fy, hat_x, hat_y = start.fx, start.fy, start.hat_x, start.hat_y
    ca, sa = cos(a), sin(a)
    for i in range(3):
        momentum_x, momentum_y = (
            mass / dt * (Y[i, 0] - com_y * Y[i, 2]),
            mass / dt * (Y[i, 1] + com_x * Y[i, 2]),
        )
        turned_force = Y[i, 0] * fy - Y[i, 1] * fx - Y[i, 2] * (point[0] * fx + point[1] * fy)
        B[i, 0], B[i, 1] = -E[i, 0], -E[i, 1]
        B[i, 2] = E[i, 0] * ty - E[i, 1] * tx + E[i, 2] * vpy - E[i, 3] * vpx + turned_force
        B[i, 3] = momentum_x * ca - momentum_y * sa + E[i, 4]
        B[i, 4] = momentum_x * sa + momentum_y * ca + E[i, 5]
        B[i, 5] = inertia / dt * Y[i, 2] + E[i, 6] + com_y * E[i, 4] - com_x * E[i, 5]
        B[i, 5] += h * (momentum_x * hat_y - momentum_y * hat_x + turned_force)
    for i in range(3):
        for j in range(6):
            Z[i, j] = G[i, 0] * B[0, j] + G[i, 1] * B[1, j] + G[i, 2] * B[2, j]
            Z[3 + i, j] = L[i, 0] * B[0, j] + L[i, 1] * B[1, j] + L[i, 2] * B[2, j]
        for j in range(3):
            Z[i, j] += A[i, j]
            Z[i, 6 + j] = -(G[i, 0] * Y[0, j] + G[i, 1] * Y[1, j] + G[i, 2] * Y[2, j])
            Z[3 + i, 6 + j] = -(L[i, 0] * Y[0, j] + L[i, 1] * Y[1, j] + L[i, 2] * Y[2, j])
    if inertial:
        Z[0, 5] -= dt * h * new_y
        Z[1, 5] += dt * h * new_x
        Z[3, 5] -= h * new_y
        Z[4, 5] += h * new_x


@kernel(allocates=False)
def _add_inertia_forces(Q, n, body, xi, start):
    """Adds the inertia's part of the step's equations by m, c and I: T_c^T diag(m, m, I) (T_c xi - eta_hat)/dt."""
    mass, com_x, com_y, dt, w = body.mass, body.com_x, body.com_y, start.dt, xi[2]
    e0, e1 = xi[0] - w * com_y - start.hat_x, xi[1] + w * com_x - start.hat_y
    if Q.shape[0] == F_ROW:
        Q[6:, n + MASS : n + INERTIA + 1] = 0.0
    Q[6, n + MASS] += e0 / dt
    Q[7, n + MASS] += e1 / dt
    Q[8, n + MASS] += (com_x * e1 - com_y * e0) / dt
    Q[8, n + INERTIA] += (w - start.yaw_rate) / dt
    Q[7, n + COM_X] += mass * w / dt
    Q[8, n + COM_X] += mass * (e1 + com_x * w) / dt
    Q[6, n + COM_Y] += -mass * w / dt
    Q[8, n + COM_Y] += mass * (-e0 + com_y * w) / dt


@kernel(allocates=False)
def _add_com(Q, n, maps, derivative, xi, start, H2):
    """Adds what the center of mass does directly, and as B's origin is what the expected twist is that of.

    x' = ... + dt R(a) w z × dc + dc - R(w dt) dc, turned into the new body frame; the same for the
    velocity.
    """
    G, L, E = maps.G, maps.L, derivative.E
    dt, w, a, yaw_rate = start.dt, xi[2], start.a, start.yaw_rate
    phi = w * dt
    cb, sb, turn_c, turn_s = cos(phi - a), sin(phi - a), cos(phi), sin(phi)
    Q[0, n + COM_X] += dt * w * sb + turn_c - 1.0
    Q[1, n + COM_X] += dt * w * cb - turn_s
    Q[0, n + COM_Y] += -dt * w * cb + turn_s
    Q[1, n + COM_Y] += dt * w * sb + turn_c - 1.0
    Q[3, n + COM_X] += w * sb
    Q[4, n + COM_X] += w * cb
    Q[3, n + COM_Y] += -w * cb
    Q[4, n + COM_Y] += w * sb
    _add_direct(
        Q, n + COM_X, -yaw_rate * E[0, 5], -yaw_rate * E[1, 5], -yaw_rate * E[2, 5], G, L, H2
    )
    _add_direct(Q, n + COM_Y, yaw_rate * E[0, 4], yaw_rate * E[1, 4], yaw_rate * E[2, 4], G, L, H2)


@kernel(allocates=False, fast_sums=True)
def _step_friction(Q, B, Y, H2):
    """Carries F, whose rows hold f, over the step but for what acts directly: F' = f + H2 (B (s, v) - Y f)."""
    q0, q1, q2, q3, q4, q5, q6, q7, q8 = Q[0], Q[1], Q[2], Q[3], Q[4], Q[5], Q[6], Q[7], Q[8]
    for i in range(2):
        h0, h1, h2 = H2[i, 0], H2[i, 1], H2[i, 2]
        b0, b1, b2, b3, b4, b5 = (
            h0 * B[0, 0] + h1 * B[1, 0] + h2 * B[2, 0], h0 * B[0, 1] + h1 * B[1, 1] + h2 * B[2, 1],
            h0 * B[0, 2] + h1 * B[1, 2] + h2 * B[2, 2], h0 * B[0, 3] + h1 * B[1, 3] + h2 * B[2, 3],
            h0 * B[0, 4] + h1 * B[1, 4] + h2 * B[2, 4], h0 * B[0, 5] + h1 * B[1, 5] + h2 * B[2, 5],
        )  # fmt: skip
        y0, y1, y2 = (
            h0 * Y[0, 0] + h1 * Y[1, 0] + h2 * Y[2, 0], h0 * Y[0, 1] + h1 * Y[1, 1] + h2 * Y[2, 1],
            h0 * Y[0, 2] + h1 * Y[1, 2] + h2 * Y[2, 2],
        )  # fmt: skip
        F = Q[F_ROW + i]
        for c in range(F.shape[0]):
            F[c] += (
                b0 * q0[c] + b1 * q1[c] + b2 * q2[c] + b3 * q3[c] + b4 * q4[c] + b5 * q5[c]
                - y0 * q6[c] - y1 * q7[c] - y2 * q8[c]
            )  # fmt: skip


@kernel(allocates=False, fast_sums=True)
def _multiply(Z, Q, N):
    """N = Z Q for Z (6, 9), faster than BLAS for so few rows."""
    q0, q1, q2, q3, q4, q5, q6, q7, q8 = Q[0], Q[1], Q[2], Q[3], Q[4], Q[5], Q[6], Q[7], Q[8]
    for i in range(6):
        z0, z1, z2, z3, z4 = Z[i, 0], Z[i, 1], Z[i, 2], Z[i, 3], Z[i, 4]
        z5, z6, z7, z8 = Z[i, 5], Z[i, 6], Z[i, 7], Z[i, 8]
        out = N[i]
        for c in range(out.shape[0]):
            out[c] = (
                z0 * q0[c] + z1 * q1[c] + z2 * q2[c] + z3 * q3[c] + z4 * q4[c]
                + z5 * q5[c] + z6 * q6[c] + z7 * q7[c] + z8 * q8[c]
            )  # fmt: skip


@kernel(allocates=False)
def record_columns(J, row, Q, c, s):
    """Writes the variations of the pose, turned into the world frame, to J[row] where row >= 0."""
    if row < 0:
        return
    s0, s1, s2 = Q[0], Q[1], Q[2]
    out0, out1, out2 = J[row, 0], J[row, 1], J[row, 2]
    for i in range(s0.shape[0]):
        out0[i] = c * s0[i] - s * s1[i]
        out1[i] = s * s0[i] + c * s1[i]
        out2[i] = s2[i]


@kernel(allocates=False)
def _add_tip(Q, column, E, dx, dy, dvx, dvy, c, s, G, L, H2):
    """Adds the effect of moving the disc by (dx, dy) and its velocity by (dvx, dvy), both in W, on one column."""
    bx, by, bvx, bvy = c * dx + s * dy, -s * dx + c * dy, c * dvx + s * dvy, -s * dvx + c * dvy
    _add_direct(
        Q, column,
        E[0, 0] * bx + E[0, 1] * by + E[0, 2] * bvx + E[0, 3] * bvy,
        E[1, 0] * bx + E[1, 1] * by + E[1, 2] * bvx + E[1, 3] * bvy,
        E[2, 0] * bx + E[2, 1] * by + E[2, 2] * bvx + E[2, 3] * bvy,
        G, L, H2,
    )  # fmt: skip


@kernel(allocates=False)
def _add_direct(Q, column, d0, d1, d2, G, L, H2):
    if Q.shape[0] > F_ROW:
        for i in range(2):
            Q[F_ROW + i, column] += H2[i, 0] * d0 + H2[i, 1] * d1 + H2[i, 2] * d2
    for i in range(3):
        Q[i, column] += G[i, 0] * d0 + G[i, 1] * d1 + G[i, 2] * d2
        Q[3 + i, column] += L[i, 0] * d0 + L[i, 1] * d1 + L[i, 2] * d2

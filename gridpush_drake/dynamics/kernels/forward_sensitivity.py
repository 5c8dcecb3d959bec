"""The derivative of a whole push: columns of variations, carried forward from step to step.

All is seen from the body: s = (R^T dx, dtheta) the variation of the pose, v that of the velocity of
the center of mass (quasi-static: of B's origin, which is then only what the next step expects) with
the yaw rate. The disc's center and velocity vary by

    dt = -s_xy - s_theta z × t + R^T dtip,     dv_p = -s_theta z × v_p + R^T dv_tip

Columns, n + OTHER_COLUMNS in all:

    k_1..k_n | m, cx, cy, I | mu_c | start x, start y, direction, length | first x, y, theta

Where loads shift (`support_loads`) the cells' columns are those of m_1..m_n, there is one more for
h and, where both are wanted, n for mu_1..mu_n; and the friction F with the table is carried along,
with H2 the first rows of its Hessian:

    F' = H2 dxi + f
"""

from math import cos, sin
from typing import Any, NamedTuple

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.small_matrix import apply_row

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

OTHER_COLUMNS = 12
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
    """Fills in the variations at the beginning.

    The pose varies by itself, and the velocity with the pose and with the center of mass.

    Args:
        Q: (9, n + OTHER_COLUMNS) zeros; rows 0-2 are s, 3-5 v.
        n: number of columns of cells.
        state: `State` at the beginning.
    """
    c = state.c
    s = state.s
    body_vx = state.body_x
    body_vy = state.body_y
    yaw_rate = state.yaw_rate
    Q[0, n + POSE_X] = c
    Q[1, n + POSE_X] = -s
    Q[0, n + POSE_Y] = s
    Q[1, n + POSE_Y] = c
    Q[2, n + POSE_THETA] = 1.0
    Q[3, n + POSE_THETA] = body_vy
    Q[4, n + POSE_THETA] = -body_vx
    Q[4, n + COM_X] = yaw_rate
    Q[3, n + COM_Y] = -yaw_rate


@kernel(allocates=False)
def step_columns(
    columns, n, body, inertial, maps, derivative, xi, start, path_length, point, new_x, new_y, H2
):
    """Carries every column over one step: (s, v)' = Z (s, v, f) + what acts on a column directly.

        dxi = B (s, v) - Y f + direct
        s' = A s + G dxi + dt p v_w
        v' = L dxi + p v_w,    p = h z × (new velocity)

    Args:
        columns: updated; the cells' f in Q is that of the step.
        n: number of columns of cells, which come first; 0 where only those of the push are wanted.
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
    Q, N, Z, B = columns

    # What all columns have in common: (s, v)' = Z (s, v, f).
    _fill_step_matrix(Z, B, body, inertial, maps, derivative, xi, start, point, new_x, new_y)
    if inertial:
        _add_inertia_forces(Q, n, body, xi, start)
    if Q.shape[0] > F_ROW:
        _step_friction(Q, B, derivative.Y, H2)
    _multiply(Z, Q, N)
    for i in range(6):
        row = Q[i]
        new = N[i]
        for column in range(row.shape[0]):
            row[column] = new[column]

    # What acts on single columns: center of mass, contact friction, and the pusher's path.
    if inertial:
        _add_com(Q, n, maps, derivative, xi, start, H2)
    G = maps.G
    L = maps.L
    E = derivative.E
    c = start.c
    s = start.s
    ray_x = start.ray_x
    ray_y = start.ray_y
    world_vx = start.world_vx
    world_vy = start.world_vy
    _add_direct(Q, n + CONTACT_FRICTION, E[0, 7], E[1, 7], E[2, 7], G, L, H2)
    _add_tip(Q, n + START_X, E, 1.0, 0.0, 0.0, 0.0, c, s, G, L, H2)
    _add_tip(Q, n + START_Y, E, 0.0, 1.0, 0.0, 0.0, c, s, G, L, H2)
    _add_tip(Q, n + DIRECTION, E, -ray_y, ray_x, -world_vy, world_vx, c, s, G, L, H2)
    if path_length > 0.0:
        # a longer path in the same time stretches places and velocities alike
        q = 1.0 / path_length
        _add_tip(Q, n + LENGTH, E, q * ray_x, q * ray_y, q * world_vx, q * world_vy, c, s, G, L, H2)


@kernel(allocates=False)
def _fill_step_matrix(Z, B, body, inertial, maps, derivative, xi, start, point, new_x, new_y):
    """Fills in Z = [A, 0, 0; 0, 0, 0] + [G; L] [B, -Y], and p v_w.

    p v_w is what the yaw rate does by turning the frame of the step.
    """
    A, G, L = maps
    Y = derivative.Y
    E = derivative.E
    mass = body.mass
    com_x = body.com_x
    com_y = body.com_y
    inertia = body.inertia
    dt = start.dt
    h = start.h
    a = start.a
    tx = start.tx
    ty = start.ty
    vpx = start.vx
    vpy = start.vy
    fx = start.fx
    fy = start.fy
    expected_vx = start.expected_vx
    expected_vy = start.expected_vy
    ca = cos(a)
    sa = sin(a)

    # B: dxi by s (through the disc's place and velocity, and the force turned with the body), and
    # by v (through the momentum M_B xi_hat/dt, and the look ahead). The frame turns by h v_w.
    force_moment = point[0] * fx + point[1] * fy
    for i in range(3):
        e = E[i]
        b = B[i]
        y0 = Y[i, 0]
        y1 = Y[i, 1]
        y2 = Y[i, 2]
        momentum_x = mass / dt * (y0 - com_y * y2)
        momentum_y = mass / dt * (y1 + com_x * y2)
        turned_force = y0 * fy - y1 * fx - y2 * force_moment
        by_turn = e[0] * ty - e[1] * tx + e[2] * vpy - e[3] * vpx
        by_yaw_rate = inertia / dt * y2 + e[6] + com_y * e[4] - com_x * e[5]
        by_frame = momentum_x * expected_vy - momentum_y * expected_vx + turned_force
        b[0] = -e[0]
        b[1] = -e[1]
        b[2] = by_turn + turned_force
        b[3] = momentum_x * ca - momentum_y * sa + e[4]
        b[4] = momentum_x * sa + momentum_y * ca + e[5]
        b[5] = by_yaw_rate + h * by_frame

    # Z = [A, 0, 0; 0, 0, 0] + [G; L] [B, -Y], and p v_w.
    for i in range(3):
        for j in range(6):
            Z[i, j] = apply_row(G, i, B[0, j], B[1, j], B[2, j])
            Z[3 + i, j] = apply_row(L, i, B[0, j], B[1, j], B[2, j])
        for j in range(3):
            Z[i, j] += A[i, j]
            Z[i, 6 + j] = -apply_row(G, i, Y[0, j], Y[1, j], Y[2, j])
            Z[3 + i, 6 + j] = -apply_row(L, i, Y[0, j], Y[1, j], Y[2, j])
    if inertial:
        Z[0, 5] -= dt * h * new_y
        Z[1, 5] += dt * h * new_x
        Z[3, 5] -= h * new_y
        Z[4, 5] += h * new_x


@kernel(allocates=False)
def _add_inertia_forces(Q, n, body, xi, start):
    """Adds the derivatives of the step's inertia by m, c and I.

    The inertia's part of the equations is T_c^T diag(m, m, I) (T_c xi - eta_hat)/dt.
    """
    mass = body.mass
    com_x = body.com_x
    com_y = body.com_y
    dt = start.dt
    w = xi[2]
    # (e0, e1) = v_com - v_com,hat; the rows are those of the balance of forces about B's origin.
    e0 = xi[0] - w * com_y - start.expected_vx
    e1 = xi[1] + w * com_x - start.expected_vy
    force_x = Q[6]
    force_y = Q[7]
    moment = Q[8]
    by_mass = n + MASS
    by_inertia = n + INERTIA
    by_com_x = n + COM_X
    by_com_y = n + COM_Y
    if Q.shape[0] == F_ROW:
        Q[6:, by_mass : by_inertia + 1] = 0.0
    force_x[by_mass] += e0 / dt
    force_y[by_mass] += e1 / dt
    moment[by_mass] += (com_x * e1 - com_y * e0) / dt
    moment[by_inertia] += (w - start.yaw_rate) / dt
    force_y[by_com_x] += mass * w / dt
    moment[by_com_x] += mass * (e1 + com_x * w) / dt
    force_x[by_com_y] += -mass * w / dt
    moment[by_com_y] += mass * (-e0 + com_y * w) / dt


@kernel(allocates=False)
def _add_com(Q, n, maps, derivative, xi, start, H2):
    """Adds what the center of mass does directly, and through the expected velocity of B's origin.

    x' = ... + dt R(a) w z × dc + dc - R(w dt) dc, turned into the new body frame; the same for the
    velocity.
    """
    G = maps.G
    L = maps.L
    E = derivative.E
    dt = start.dt
    w = xi[2]
    a = start.a
    yaw_rate = start.yaw_rate
    phi = w * dt
    cb = cos(phi - a)
    sb = sin(phi - a)
    turn_c = cos(phi)
    turn_s = sin(phi)
    # on the pose, then on the velocity, each turned into the new body frame
    x = Q[0]
    y = Q[1]
    vx = Q[3]
    vy = Q[4]
    by_com_x = n + COM_X
    by_com_y = n + COM_Y
    x[by_com_x] += dt * w * sb + turn_c - 1.0
    y[by_com_x] += dt * w * cb - turn_s
    x[by_com_y] += -dt * w * cb + turn_s
    y[by_com_y] += dt * w * sb + turn_c - 1.0
    vx[by_com_x] += w * sb
    vy[by_com_x] += w * cb
    vx[by_com_y] += -w * cb
    vy[by_com_y] += w * sb
    # through the look ahead, as the velocity of B's origin is v_com - w z × c
    _add_direct(
        Q, n + COM_X, -yaw_rate * E[0, 5], -yaw_rate * E[1, 5], -yaw_rate * E[2, 5], G, L, H2
    )
    _add_direct(Q, n + COM_Y, yaw_rate * E[0, 4], yaw_rate * E[1, 4], yaw_rate * E[2, 4], G, L, H2)


@kernel(allocates=False, fast_sums=True)
def _step_friction(Q, B, Y, H2):
    """Carries F, whose rows hold f, over the step: F' = f + H2 (B (s, v) - Y f).

    What acts on single columns is added later.
    """
    q0 = Q[0]
    q1 = Q[1]
    q2 = Q[2]
    q3 = Q[3]
    q4 = Q[4]
    q5 = Q[5]
    q6 = Q[6]
    q7 = Q[7]
    q8 = Q[8]
    for i in range(2):
        # the row of H2 times B and Y
        h0 = H2[i, 0]
        h1 = H2[i, 1]
        h2 = H2[i, 2]
        b0 = h0 * B[0, 0] + h1 * B[1, 0] + h2 * B[2, 0]
        b1 = h0 * B[0, 1] + h1 * B[1, 1] + h2 * B[2, 1]
        b2 = h0 * B[0, 2] + h1 * B[1, 2] + h2 * B[2, 2]
        b3 = h0 * B[0, 3] + h1 * B[1, 3] + h2 * B[2, 3]
        b4 = h0 * B[0, 4] + h1 * B[1, 4] + h2 * B[2, 4]
        b5 = h0 * B[0, 5] + h1 * B[1, 5] + h2 * B[2, 5]
        y0 = h0 * Y[0, 0] + h1 * Y[1, 0] + h2 * Y[2, 0]
        y1 = h0 * Y[0, 1] + h1 * Y[1, 1] + h2 * Y[2, 1]
        y2 = h0 * Y[0, 2] + h1 * Y[1, 2] + h2 * Y[2, 2]
        F = Q[F_ROW + i]
        for c in range(F.shape[0]):
            F[c] += (
                b0 * q0[c]
                + b1 * q1[c]
                + b2 * q2[c]
                + b3 * q3[c]
                + b4 * q4[c]
                + b5 * q5[c]
                - y0 * q6[c]
                - y1 * q7[c]
                - y2 * q8[c]
            )


@kernel(allocates=False, fast_sums=True)
def _multiply(Z, Q, N):
    """N = Z Q for Z (6, 9), faster than BLAS for so few rows."""
    q0 = Q[0]
    q1 = Q[1]
    q2 = Q[2]
    q3 = Q[3]
    q4 = Q[4]
    q5 = Q[5]
    q6 = Q[6]
    q7 = Q[7]
    q8 = Q[8]
    for i in range(6):
        z0 = Z[i, 0]
        z1 = Z[i, 1]
        z2 = Z[i, 2]
        z3 = Z[i, 3]
        z4 = Z[i, 4]
        z5 = Z[i, 5]
        z6 = Z[i, 6]
        z7 = Z[i, 7]
        z8 = Z[i, 8]
        out = N[i]
        for c in range(out.shape[0]):
            out[c] = (
                z0 * q0[c]
                + z1 * q1[c]
                + z2 * q2[c]
                + z3 * q3[c]
                + z4 * q4[c]
                + z5 * q5[c]
                + z6 * q6[c]
                + z7 * q7[c]
                + z8 * q8[c]
            )


@kernel(allocates=False)
def record_columns(J, row, Q, c, s):
    """Writes the variations of the pose, turned into the world frame, to J[row] where row >= 0."""
    if row < 0:
        return
    s0 = Q[0]
    s1 = Q[1]
    s2 = Q[2]
    out0 = J[row, 0]
    out1 = J[row, 1]
    out2 = J[row, 2]
    for i in range(s0.shape[0]):
        out0[i] = c * s0[i] - s * s1[i]
        out1[i] = s * s0[i] + c * s1[i]
        out2[i] = s2[i]


@kernel(allocates=False)
def _add_tip(Q, column, E, dx, dy, dvx, dvy, c, s, G, L, H2):
    """Adds a change of the disc's place, (dx, dy), and velocity, (dvx, dvy), in W, to a column."""
    # R^T (dx, dy) and R^T (dvx, dvy)
    bx = c * dx + s * dy
    by = -s * dx + c * dy
    bvx = c * dvx + s * dvy
    bvy = -s * dvx + c * dvy
    d0 = E[0, 0] * bx + E[0, 1] * by + E[0, 2] * bvx + E[0, 3] * bvy
    d1 = E[1, 0] * bx + E[1, 1] * by + E[1, 2] * bvx + E[1, 3] * bvy
    d2 = E[2, 0] * bx + E[2, 1] * by + E[2, 2] * bvx + E[2, 3] * bvy
    _add_direct(Q, column, d0, d1, d2, G, L, H2)


@kernel(allocates=False)
def _add_direct(Q, column, d0, d1, d2, G, L, H2):
    """Adds a change of the twist by (d0, d1, d2) to one column: to s by G, v by L, F by H2."""
    if Q.shape[0] > F_ROW:
        for i in range(2):
            Q[F_ROW + i, column] += apply_row(H2, i, d0, d1, d2)
    for i in range(3):
        Q[i, column] += apply_row(G, i, d0, d1, d2)
        Q[3 + i, column] += apply_row(L, i, d0, d1, d2)

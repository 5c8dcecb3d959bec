"""A whole push, step by step, and the derivative of every recorded pose with it.

The state is the pose (x, y, theta) of B in W and, in the inertial regime, the velocity of the centre of mass in the
body frame with the yaw rate. Everything happens in the body frame, where the support friction does not depend on the
pose; the disc's centre and velocity are brought there at each step.
"""

from math import cos, sin, sqrt

import numpy as np

from gridpush_drake.dynamics.compiled import kernel
from gridpush_drake.dynamics.contact import CX, CY, GAP, NX, NY, find_contacts
from gridpush_drake.dynamics.sensitivity import (
    COM_X,
    COM_Y,
    CONTACT_FRICTION,
    DIRECTION,
    INERTIA,
    LENGTH,
    MASS,
    OTHER,
    POSE_THETA,
    POSE_X,
    POSE_Y,
    START_X,
    START_Y,
    calc_displacement_maps,
    calc_step_derivative,
    fill_cell_forces,
)  # fmt: skip
from gridpush_drake.dynamics.step import _COMPLIANCE, CONVERGED, SEPARATE, solve_step

_RELATIVE_STICTION = 1e-7  # of the pusher's speed, quasi-static regime
_TINY_SPEED = 1e-12  # m/s
_REACH = 2.0  # contacts closer than this many steps' motion are watched


@kernel()
def rollout(
    cells, k, spin, lagged, edges, previous, radius, mu, moments, inertial, stiction, pose, velocity, tip, dts,
    force, force_point, row_of_step, poses, twists, velocities, contact_forces, contact_points, modes_out, gaps,
    statuses, J,
):  # fmt: skip
    """Simulates T steps.

    Args:
        cells: (2, n) cell centres p_BC, m.
        k: (n,) friction each cell can carry, N.
        spin: (3,) kappa² (m²), the spin load (N m) and the spin arm (m) by which k_i enters it, see `friction`.
        lagged: whether friction follows the paper's lagged directions.
        edges, previous: (4, E), (E,) the outline, see `contact`.
        radius: of the disc, m; negative where there is no pusher.
        mu: contact friction.
        moments: (5,) m (kg), centre of mass (m, m), inertia about it (kg m²), radius of gyration (m).
        inertial: the regime.
        stiction: tolerance, m/s, of the inertial regime.
        pose, velocity: (3,) q and nu at the beginning.
        tip: (T+1, 2) the disc's centre, m.
        dts: (T,) s.
        force: (T, 2) applied force in W, N, at `force_point` (2,) on the body, m.
        row_of_step: (T+1,) row of J that records this step, -1 for none.
        poses, twists, velocities, contact_forces, contact_points, modes_out, gaps, statuses: filled; (T+1, 3), (T, 3)
            body frame, (T+1, 3), (T, 2, 2) in W, (T, 2, 2) in W, (T, 2), (T+1,), (T, 2) status and iterations.
        J: (rows, 3, n + OTHER) filled; without columns where no derivative is wanted.
    """
    px, py = cells[0], cells[1]
    n = px.shape[0]
    steps = dts.shape[0]
    kappa2, spin_load = spin[0], spin[1]
    mass, com_x, com_y, inertia, arm = moments[0], moments[1], moments[2], moments[3], moments[4]
    differentiate = J.shape[2] > 0
    load0 = 0.0
    for i in range(n):
        load0 += k[i]
    zeros = np.zeros(3)
    g, rhs, unused, drive = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    H, H0 = np.zeros((3, 3)), np.zeros((3, 3))
    K, X, F = np.zeros((7, 7)), np.zeros((7, 7)), np.zeros((7, 5))
    Y, D = np.zeros((3, 3)), np.zeros((3, 5))
    xi, last_xi, guess = np.zeros(3), np.zeros(3), np.zeros(3)
    lam, contacts, modes = np.zeros((2, 2)), np.zeros((2, 6)), np.zeros(2, np.int64)
    dx, dy = np.zeros(n if lagged else 0), np.zeros(n if lagged else 0)
    A, G, L = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    half = 6 if inertial else 3
    columns = n + OTHER if differentiate else 0
    Q, N, Z = np.zeros((half + 3, columns)), np.zeros((half, columns)), np.zeros((half, half + 3))
    x, y, theta = pose[0], pose[1], pose[2]
    c, s = cos(theta), sin(theta)
    yaw_rate = velocity[2]
    hat_x = c * velocity[0] + s * velocity[1] - yaw_rate * com_y
    hat_y = -s * velocity[0] + c * velocity[1] + yaw_rate * com_x
    poses[0, 0], poses[0, 1], poses[0, 2] = x, y, theta
    velocities[0, 0], velocities[0, 1], velocities[0, 2] = velocity[0], velocity[1], velocity[2]
    if differentiate:
        _start_columns(Q, n, c, s, inertial, hat_x + yaw_rate * com_y, hat_y - yaw_rate * com_x, yaw_rate)
        _record(J, row_of_step[0], Q, c, s)
    path_length = 0.0
    for t in range(steps):
        path_length += sqrt((tip[t + 1, 0] - tip[t, 0]) ** 2 + (tip[t + 1, 1] - tip[t, 1]) ** 2)
    moving_steps = 0

    for t in range(steps):
        dt = dts[t]
        # The pusher, seen from the body.
        world_vx, world_vy = (tip[t + 1, 0] - tip[t, 0]) / dt, (tip[t + 1, 1] - tip[t, 1]) / dt
        vpx, vpy = c * world_vx + s * world_vy, -s * world_vx + c * world_vy
        tx = c * (tip[t, 0] - x) + s * (tip[t, 1] - y)
        ty = -s * (tip[t, 0] - x) + c * (tip[t, 1] - y)
        pusher_speed = sqrt(vpx * vpx + vpy * vpy)
        body_speed = sqrt(hat_x * hat_x + hat_y * hat_y) + arm * abs(yaw_rate) if inertial else 0.0
        count = 0
        gaps[t] = np.inf
        if radius > 0.0:
            reach = _REACH * (pusher_speed + body_speed) * dt
            count = find_contacts(
                edges[0], edges[1], edges[2], edges[3], previous, tx, ty, radius, reach, contacts
            )  # fmt: skip
            if count > 0:
                gaps[t] = contacts[0, GAP]
        closing = 0.0
        for j in range(count):
            closing = max(closing, contacts[j, NX] * vpx + contacts[j, NY] * vpy - contacts[j, GAP] / dt)
        for j in range(count, 2):
            modes[j] = SEPARATE

        # What drives the body.
        fx, fy = c * force[t, 0] + s * force[t, 1], -s * force[t, 0] + c * force[t, 1]
        if inertial:
            drive[0], drive[1] = mass * hat_x / dt + fx, mass * hat_y / dt + fy
            drive[2] = (
                inertia * yaw_rate / dt + mass * (com_x * hat_y - com_y * hat_x) / dt
                + force_point[0] * fy - force_point[1] * fx
            )  # fmt: skip
            H0[0, 0] = H0[1, 1] = mass / dt
            H0[0, 2] = H0[2, 0] = -mass * com_y / dt
            H0[1, 2] = H0[2, 1] = mass * com_x / dt
            H0[2, 2] = (inertia + mass * (com_x * com_x + com_y * com_y)) / dt
        drive_size = sqrt(drive[0] * drive[0] + drive[1] * drive[1]) + abs(drive[2]) / arm
        speed = pusher_speed + closing + body_speed + sqrt(fx * fx + fy * fy) * dt / mass + _TINY_SPEED
        eps = max(stiction if inertial else 0.0, _RELATIVE_STICTION * speed)
        load = load0 + drive_size

        at_rest = not inertial or (body_speed < 2.0 * stiction and fx == 0.0 and fy == 0.0)
        if at_rest and closing <= 0.0:
            xi[:] = 0.0
            lam[:] = 0.0
            modes[:] = SEPARATE
            status, iterations = CONVERGED, 0
            moving_steps = 0
            Y[:] = 0.0
            D[:] = 0.0
        else:
            if moving_steps >= 2:
                for i in range(3):
                    guess[i] = 2.0 * xi[i] - last_xi[i]
                    last_xi[i], xi[i] = xi[i], guess[i]
            elif moving_steps == 1:
                last_xi[:] = xi
            elif inertial and body_speed > 0.0:
                xi[0], xi[1], xi[2] = hat_x + yaw_rate * com_y, hat_y - yaw_rate * com_x, yaw_rate
            else:
                xi[0], xi[1], xi[2] = vpx, vpy, 0.0
            moving_steps += 1
            use_lagged = lagged
            spin_sign = 0.0
            if lagged:
                use_lagged, spin_sign = _lag_directions(
                    px, py, com_x, com_y, hat_x, hat_y, yaw_rate, fx, fy, force_point, mass, inertia, count,
                    stiction, arm, dx, dy,
                )  # fmt: skip
            status, iterations = solve_step(
                px, py, k, kappa2, spin_load, use_lagged, dx, dy, spin_sign, H0, drive, contacts, count, vpx, vpy,
                mu, dt, eps, arm, load, speed, xi, lam, modes, g, H, rhs, unused, K, X,
            )  # fmt: skip
            if differentiate:
                compliance = _COMPLIANCE * speed / load if count > 1 else 0.0
                if not calc_step_derivative(
                    H, contacts, modes, count, mu, compliance, vpx, vpy, dt, xi, lam, K, X, F, Y, D
                ):
                    Y[:] = 0.0
                    D[:] = 0.0

        statuses[t, 0], statuses[t, 1] = status, iterations
        d0, d1 = calc_displacement_maps(xi, dt, inertial, com_x, com_y, A, G, L)
        if differentiate:
            fill_cell_forces(px, py, spin, eps * eps, xi, Q[half:])
            _step_columns(
                Q, N, Z, n, half, inertial, A, G, L, Y, D, xi, dt, tx, ty, vpx, vpy, c, s, tip[t, 0] - tip[0, 0],
                tip[t, 1] - tip[0, 1], world_vx, world_vy, path_length, fx, fy, force_point, mass, com_x, com_y,
                inertia, hat_x, hat_y, yaw_rate,
            )  # fmt: skip

        for j in range(2):
            modes_out[t, j] = modes[j]
            touching = j < count and modes[j] != SEPARATE
            bx = contacts[j, NX] * lam[j, 0] - contacts[j, NY] * lam[j, 1] if touching else 0.0
            by = contacts[j, NY] * lam[j, 0] + contacts[j, NX] * lam[j, 1] if touching else 0.0
            contact_forces[t, j, 0], contact_forces[t, j, 1] = c * bx - s * by, s * bx + c * by
            contact_points[t, j, 0] = x + c * contacts[j, CX] - s * contacts[j, CY] if touching else np.nan
            contact_points[t, j, 1] = y + s * contacts[j, CX] + c * contacts[j, CY] if touching else np.nan

        twists[t, 0], twists[t, 1], twists[t, 2] = xi[0], xi[1], xi[2]
        x, y, theta = x + c * d0 - s * d1, y + s * d0 + c * d1, theta + xi[2] * dt
        c, s = cos(theta), sin(theta)
        if inertial:
            turn_c, turn_s = cos(xi[2] * dt), sin(xi[2] * dt)
            com_vx, com_vy = xi[0] - xi[2] * com_y, xi[1] + xi[2] * com_x
            hat_x, hat_y = turn_c * com_vx + turn_s * com_vy, -turn_s * com_vx + turn_c * com_vy
            yaw_rate = xi[2]
            body_x, body_y = hat_x + yaw_rate * com_y, hat_y - yaw_rate * com_x
        else:
            body_x, body_y = xi[0], xi[1]
        poses[t + 1, 0], poses[t + 1, 1], poses[t + 1, 2] = x, y, theta
        velocities[t + 1, 0], velocities[t + 1, 1] = c * body_x - s * body_y, s * body_x + c * body_y
        velocities[t + 1, 2] = xi[2]
        if differentiate:
            _record(J, row_of_step[t + 1], Q, c, s)
    gaps[steps] = np.inf
    if radius > 0.0:
        tx = c * (tip[steps, 0] - x) + s * (tip[steps, 1] - y)
        ty = -s * (tip[steps, 0] - x) + c * (tip[steps, 1] - y)
        if (
            find_contacts(edges[0], edges[1], edges[2], edges[3], previous, tx, ty, radius, radius, contacts)
            > 0
        ):
            gaps[steps] = contacts[0, GAP]


@kernel()
def _lag_directions(
    px, py, com_x, com_y, hat_x, hat_y, yaw_rate, fx, fy, point, mass, inertia, count, stiction, arm, dx, dy
):  # fmt: skip
    """Unit directions of the cells' current velocities or, at rest, of the motion the applied force would start.

    Returns:
        Whether they exist (else this step's friction is isotropic), and the sign of the yaw rate.
    """
    vx, vy, w = hat_x, hat_y, yaw_rate
    if sqrt(vx * vx + vy * vy) + arm * abs(w) < 2.0 * stiction:
        if count > 0 or (fx == 0.0 and fy == 0.0):
            return False, 0.0
        vx, vy = fx / mass, fy / mass
        w = ((point[0] - com_x) * fy - (point[1] - com_y) * fx) / inertia
    for i in range(px.shape[0]):
        cell_x, cell_y = vx - w * (py[i] - com_y), vy + w * (px[i] - com_x)
        size = sqrt(cell_x * cell_x + cell_y * cell_y)
        dx[i] = cell_x / size if size > 0.0 else 0.0
        dy[i] = cell_y / size if size > 0.0 else 0.0
    return True, np.sign(w)


@kernel()
def _start_columns(Q, n, c, s, inertial, body_vx, body_vy, yaw_rate):
    """The variations at the beginning: the pose's own columns, and what they and the centre of mass do to the velocity."""
    Q[0, n + POSE_X], Q[1, n + POSE_X] = c, -s
    Q[0, n + POSE_Y], Q[1, n + POSE_Y] = s, c
    Q[2, n + POSE_THETA] = 1.0
    if inertial:
        Q[3, n + POSE_THETA], Q[4, n + POSE_THETA] = body_vy, -body_vx
        Q[4, n + COM_X] = yaw_rate
        Q[3, n + COM_Y] = -yaw_rate


@kernel()
def _step_columns(
    Q, N, Z, n, half, inertial, A, G, L, Y, D, xi, dt, tx, ty, vpx, vpy, c, s, ray_x, ray_y, world_vx, world_vy,
    path_length, fx, fy, point, mass, com_x, com_y, inertia, hat_x, hat_y, yaw_rate,
):  # fmt: skip
    """Carries every column over one step: (s, v)' = Z (s, v, f) + what acts on a column directly.

    dxi = B_s s + B_v v - Y f + direct;  s' = A s + G dxi;  v' = L dxi
    """
    B = np.empty((3, 6))
    w = xi[2]
    for i in range(3):
        B[i, 0], B[i, 1] = -D[i, 0], -D[i, 1]
        B[i, 2] = D[i, 0] * ty - D[i, 1] * tx + D[i, 2] * vpy - D[i, 3] * vpx
        B[i, 2] += Y[i, 0] * fy - Y[i, 1] * fx - Y[i, 2] * (point[0] * fx + point[1] * fy)
        B[i, 3] = mass / dt * (Y[i, 0] - com_y * Y[i, 2])
        B[i, 4] = mass / dt * (Y[i, 1] + com_x * Y[i, 2])
        B[i, 5] = inertia / dt * Y[i, 2]
    for i in range(3):
        for j in range(half):
            total = A[i, j] if j < 3 else 0.0
            for m in range(3):
                total += G[i, m] * B[m, j]
            Z[i, j] = total
        for j in range(3):
            Z[i, half + j] = -(G[i, 0] * Y[0, j] + G[i, 1] * Y[1, j] + G[i, 2] * Y[2, j])
    if inertial:
        for i in range(3):
            for j in range(6):
                Z[3 + i, j] = L[i, 0] * B[0, j] + L[i, 1] * B[1, j] + L[i, 2] * B[2, j]
            for j in range(3):
                Z[3 + i, 6 + j] = -(L[i, 0] * Y[0, j] + L[i, 1] * Y[1, j] + L[i, 2] * Y[2, j])
        # dF_1 by the inertia moments: T_c^T diag(m, m, I) (T_c xi - eta_hat) / dt
        e0, e1 = xi[0] - w * com_y - hat_x, xi[1] + w * com_x - hat_y
        Q[6, n + MASS], Q[7, n + MASS] = e0 / dt, e1 / dt
        Q[8, n + MASS] = (com_x * e1 - com_y * e0) / dt
        Q[8, n + INERTIA] = (w - yaw_rate) / dt
        Q[7, n + COM_X] = mass * w / dt
        Q[8, n + COM_X] = mass * (e1 + com_x * w) / dt
        Q[6, n + COM_Y] = -mass * w / dt
        Q[8, n + COM_Y] = mass * (-e0 + com_y * w) / dt
    np.dot(Z, Q, N)
    for i in range(half):
        Q[i, :] = N[i, :]
    if inertial:
        turn_c, turn_s = cos(w * dt), sin(w * dt)
        # x' = ... + dt w z × dc + dc - R(w dt) dc, turned into the new frame; the same for the velocity.
        Q[0, n + COM_X] += turn_c + turn_s * dt * w - 1.0
        Q[1, n + COM_X] += -turn_s + turn_c * dt * w
        Q[0, n + COM_Y] += turn_s - turn_c * dt * w
        Q[1, n + COM_Y] += turn_c + turn_s * dt * w - 1.0
        Q[3, n + COM_X] += turn_s * w
        Q[4, n + COM_X] += turn_c * w
        Q[3, n + COM_Y] += -turn_c * w
        Q[4, n + COM_Y] += turn_s * w
    _add_direct(Q, n + CONTACT_FRICTION, D[0, 4], D[1, 4], D[2, 4], G, L, inertial)
    _add_tip(Q, n + START_X, D, 1.0, 0.0, 0.0, 0.0, c, s, G, L, inertial)
    _add_tip(Q, n + START_Y, D, 0.0, 1.0, 0.0, 0.0, c, s, G, L, inertial)
    _add_tip(Q, n + DIRECTION, D, -ray_y, ray_x, -world_vy, world_vx, c, s, G, L, inertial)
    if path_length > 0.0:
        q = 1.0 / path_length
        _add_tip(Q, n + LENGTH, D, q * ray_x, q * ray_y, q * world_vx, q * world_vy, c, s, G, L, inertial)


@kernel()
def _add_tip(Q, column, D, dx, dy, dvx, dvy, c, s, G, L, inertial):
    """Adds the effect of moving the disc by (dx, dy) and its velocity by (dvx, dvy), both in W, on one column."""
    bx, by, bvx, bvy = c * dx + s * dy, -s * dx + c * dy, c * dvx + s * dvy, -s * dvx + c * dvy
    _add_direct(
        Q, column,
        D[0, 0] * bx + D[0, 1] * by + D[0, 2] * bvx + D[0, 3] * bvy,
        D[1, 0] * bx + D[1, 1] * by + D[1, 2] * bvx + D[1, 3] * bvy,
        D[2, 0] * bx + D[2, 1] * by + D[2, 2] * bvx + D[2, 3] * bvy,
        G, L, inertial,
    )  # fmt: skip


@kernel()
def _add_direct(Q, column, d0, d1, d2, G, L, inertial):
    for i in range(3):
        Q[i, column] += G[i, 0] * d0 + G[i, 1] * d1 + G[i, 2] * d2
        if inertial:
            Q[3 + i, column] += L[i, 0] * d0 + L[i, 1] * d1 + L[i, 2] * d2


@kernel()
def _record(J, row, Q, c, s):
    """Writes the variations of the pose, turned into the world frame."""
    if row < 0:
        return
    s0, s1, s2 = Q[0], Q[1], Q[2]
    out0, out1, out2 = J[row, 0], J[row, 1], J[row, 2]
    for i in range(s0.shape[0]):
        out0[i] = c * s0[i] - s * s1[i]
        out1[i] = s * s0[i] + c * s1[i]
        out2[i] = s2[i]

"""A whole push, step by step, and the derivative of every recorded pose with it.

The state is the pose (x, y, theta) of B in W and the velocity: of the centre of mass, in the body frame, with the yaw
rate. In the quasi-static regime B's origin stands for the centre of mass, and the velocity tells nothing but how the
body will probably go on. Everything happens in the body frame, where the support friction does not depend on the pose;
the disc's centre and velocity are brought there at each step.

A step sees the body as it is expected to stand halfway through the step, were it to go on as before: turned by
h w, and the disc slid along its outline. The midpoint rule makes the motion between changes of the contact mode exact
to O(dt²) instead of O(dt). With h = 0 the step sees the body as it stands at the beginning, as the paper's LCP does.
"""

from math import cos, sin, sqrt

import numpy as np

from gridpush_drake.dynamics.columns import OTHER, record_columns, start_columns, step_columns
from gridpush_drake.dynamics.compiled import kernel
from gridpush_drake.dynamics.contact import BEND, COLUMNS, CX, CY, GAP, NX, NY, find_contacts, look_ahead
from gridpush_drake.dynamics.displacement import calc_displacement_maps
from gridpush_drake.dynamics.lagged import fill_lagged_directions
from gridpush_drake.dynamics.modes import COMPLIANCE, SEPARATE
from gridpush_drake.dynamics.sensitivity import calc_input_derivative, calc_step_derivative, fill_cell_forces
from gridpush_drake.dynamics.step import CONVERGED, solve_step
from gridpush_drake.dynamics.step_memory import MOVING, recall, remember

_TINY_SPEED = 1e-12  # m/s
_REACH = 2.0  # contacts closer than this many steps' motion are watched
_AT_REST = 2.0  # a body slower than so many stiction tolerances rests


@kernel()
def rollout(
    cells, k, spin, lagged, ahead, edges, previous, radius, mu, moments, inertial, stiction, pose, velocity, tip,
    path_length, dts, wrench, force_point, row_of_step, poses, twists, velocities, contact_forces, contact_points,
    modes_out, gaps, statuses, J, memory,
):  # fmt: skip
    """Simulates T steps.

    Args:
        cells: (2, n) cell centres p_BC, m.
        k: (n,) friction each cell can carry, N.
        spin: (3,) kappa² (m²), the spin load (N m) and the spin arm (m) by which k_i enters it, see `friction`.
        lagged: whether friction follows the paper's lagged directions.
        ahead: share of the step after which it looks at the body: 0.5, or 0.
        edges, previous: (4, E), (E,) the outline, see `contact`.
        radius: of the disc, m; negative where there is no pusher.
        mu: contact friction.
        moments: (6,) m (kg), centre of mass (m, m), inertia about it (kg m²), radius of gyration (m), cell size (m).
        inertial: the regime.
        stiction: (2,) tolerance of the inertial regime, m/s, and the least one as a share of the speed.
        pose, velocity: (3,) q and nu at the beginning.
        tip: (T+1, 2) the disc's centre, m.
        path_length: of the disc's whole path, m.
        dts: (T,) s.
        wrench: (T, 3) applied force in W, N, at `force_point` (2,) on the body, m, and a couple, N m.
        row_of_step: (T+1,) row of J that records this step, -1 for none.
        poses, twists, velocities, contact_forces, contact_points, modes_out, gaps, statuses: filled; (T+1, 3), (T, 3)
            in the frame of the step, (T+1, 3), (T, 2, 2) in W, (T, 2, 2) in W, (T, 2), (T+1,), (T, 2) status and
            iterations.
        J: (rows, 3, n + OTHER) filled; without columns where no derivative is wanted.
        memory: (MEMORY_SIZE,) of the step before, updated; see `step_memory`.
    """
    px, py = cells[0], cells[1]
    n = px.shape[0]
    steps = dts.shape[0]
    kappa2, spin_load = spin[0], spin[1]
    mass, com_x, com_y, inertia, arm, cell_size = moments[0], moments[1], moments[2], moments[3], moments[4], moments[5]
    if not inertial:
        mass = com_x = com_y = inertia = 0.0
    differentiate = J.shape[2] > 0
    load0 = 0.0
    for i in range(n):
        load0 += k[i]
    g, rhs, scratch, drive, push, hat = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    H, H0 = np.zeros((3, 3)), np.zeros((3, 3))
    K, X, F = np.zeros((7, 7)), np.zeros((7, 7)), np.zeros((7, 7))
    Y, D, E = np.zeros((3, 3)), np.zeros((3, 7)), np.zeros((3, 8))
    xi, last_xi = np.zeros(3), np.zeros(3)
    lam, modes = np.zeros((2, 2)), np.zeros(2, np.int64)
    found, contacts = np.zeros((2, COLUMNS)), np.zeros((2, COLUMNS))
    dx, dy = np.zeros(n if lagged else 0), np.zeros(n if lagged else 0)
    A, G, L = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    columns = n + OTHER if differentiate else 0
    Q, N, Z = np.zeros((9, columns)), np.zeros((6, columns)), np.zeros((6, 9))
    x, y, theta = pose[0], pose[1], pose[2]
    c, s = cos(theta), sin(theta)
    yaw_rate = velocity[2]
    body_x, body_y = c * velocity[0] + s * velocity[1], -s * velocity[0] + c * velocity[1]
    com_vx, com_vy = body_x - yaw_rate * com_y, body_y + yaw_rate * com_x
    poses[0, 0], poses[0, 1], poses[0, 2] = x, y, theta
    velocities[0, 0], velocities[0, 1], velocities[0, 2] = velocity[0], velocity[1], velocity[2]
    if differentiate:
        start_columns(Q, n, c, s, body_x, body_y, yaw_rate)
        record_columns(J, row_of_step[0], Q, c, s)
    moving_steps = recall(memory, xi, last_xi, modes)

    for t in range(steps):
        dt = dts[t]
        h = ahead * dt
        # The frame of the step: the body's, turned by a.
        a = h * yaw_rate
        ca, sa = cos(a), sin(a)
        step_c, step_s = c * ca - s * sa, s * ca + c * sa
        hat[0], hat[1], hat[2] = ca * com_vx + sa * com_vy, -sa * com_vx + ca * com_vy, yaw_rate
        # The pusher, seen from the body.
        world_vx, world_vy = (tip[t + 1, 0] - tip[t, 0]) / dt, (tip[t + 1, 1] - tip[t, 1]) / dt
        start_vx, start_vy = c * world_vx + s * world_vy, -s * world_vx + c * world_vy
        vpx, vpy = ca * start_vx + sa * start_vy, -sa * start_vx + ca * start_vy
        tx = c * (tip[t, 0] - x) + s * (tip[t, 1] - y)
        ty = -s * (tip[t, 0] - x) + c * (tip[t, 1] - y)
        rx, ry = start_vx - body_x + yaw_rate * ty, start_vy - body_y - yaw_rate * tx
        pusher_speed = sqrt(vpx * vpx + vpy * vpy)
        body_speed = sqrt(com_vx * com_vx + com_vy * com_vy) + arm * abs(yaw_rate) if inertial else 0.0
        count = 0
        gaps[t] = np.inf
        if radius > 0.0:
            reach = _REACH * (pusher_speed + body_speed) * dt
            count = find_contacts(edges[0], edges[1], edges[2], edges[3], previous, tx, ty, radius, reach, found)
            if count > 0:
                gaps[t] = found[0, GAP]
                if ahead > 0.0:
                    count = look_ahead(
                        edges[0], edges[1], edges[2], edges[3], previous, tx, ty, h * rx, h * ry, radius, reach, found,
                        contacts,
                    )  # fmt: skip
                else:
                    contacts[:] = found
        closing = 0.0
        for j in range(count):
            closing = max(closing, contacts[j, NX] * vpx + contacts[j, NY] * vpy - contacts[j, GAP] / dt)
        for j in range(count, 2):
            modes[j] = SEPARATE

        # What drives the body.
        fx, fy = step_c * wrench[t, 0] + step_s * wrench[t, 1], -step_s * wrench[t, 0] + step_c * wrench[t, 1]
        couple = wrench[t, 2]
        moment = force_point[0] * fy - force_point[1] * fx + couple
        if inertial:
            drive[0], drive[1] = mass * hat[0] / dt + fx, mass * hat[1] / dt + fy
            drive[2] = inertia * yaw_rate / dt + mass * (com_x * hat[1] - com_y * hat[0]) / dt + moment
            push[0], push[1], push[2] = fx / mass, fy / mass, (moment - com_x * fy + com_y * fx) / inertia
            H0[0, 0] = H0[1, 1] = mass / dt
            H0[0, 2] = H0[2, 0] = -mass * com_y / dt
            H0[1, 2] = H0[2, 1] = mass * com_x / dt
            H0[2, 2] = (inertia + mass * (com_x * com_x + com_y * com_y)) / dt
        drive_size = sqrt(drive[0] * drive[0] + drive[1] * drive[1]) + abs(drive[2]) / arm
        push_speed = (sqrt(push[0] * push[0] + push[1] * push[1]) + arm * abs(push[2])) * dt
        speed = pusher_speed + closing + body_speed + push_speed + _TINY_SPEED
        eps = max(stiction[0] if inertial else 0.0, stiction[1] * speed)
        load = load0 + drive_size

        slow = not inertial or body_speed < _AT_REST * stiction[0]
        if slow and push_speed == 0.0 and closing <= 0.0:
            xi[:] = 0.0
            lam[:] = 0.0
            modes[:] = SEPARATE
            status, iterations = CONVERGED, 0
            moving_steps = 0
            Y[:] = 0.0
            E[:] = 0.0
        else:
            if moving_steps >= MOVING:
                for i in range(3):
                    last_xi[i], xi[i] = xi[i], 2.0 * xi[i] - last_xi[i]
            elif moving_steps == 1:
                last_xi[:] = xi
            elif inertial and body_speed > 0.0:
                xi[0], xi[1], xi[2] = hat[0] + yaw_rate * com_y, hat[1] - yaw_rate * com_x, yaw_rate
            else:
                xi[0], xi[1], xi[2] = vpx, vpy, 0.0
            moving_steps += 1
            # A pusher's force is not known beforehand: from rest, friction against it is isotropic.
            use_lagged = lagged and not (slow and push_speed == 0.0)
            spin_sign = 0.0
            if use_lagged:
                spin_sign = fill_lagged_directions(px, py, com_x, com_y, hat, push, cell_size, dx, dy)
            status, iterations = solve_step(
                px, py, k, kappa2, spin_load, use_lagged, dx, dy, spin_sign, H0, drive, contacts, count, vpx, vpy,
                mu, dt, eps, arm, load, speed, xi, lam, modes, g, H, rhs, scratch, K, X,
            )  # fmt: skip
            if differentiate:
                compliance = COMPLIANCE * speed / load if count > 1 else 0.0
                if calc_step_derivative(
                    H, contacts, modes, count, mu, compliance, vpx, vpy, dt, xi, lam, K, X, F, Y, D
                ):
                    calc_input_derivative(
                        D, h, a, found[0, NX], found[0, NY], found[0, BEND], tx, ty, rx, ry, yaw_rate, vpx, vpy, E
                    )
                else:
                    Y[:] = 0.0
                    E[:] = 0.0

        statuses[t, 0], statuses[t, 1] = status, iterations
        d0, d1, new_x, new_y = calc_displacement_maps(xi, dt, inertial, a, com_x, com_y, A, G, L)
        if differentiate:
            fill_cell_forces(px, py, spin, eps * eps, xi, Q[6:])
            step_columns(
                Q, N, Z, n, inertial, A, G, L, Y, E, xi, dt, h, tx, ty, start_vx, start_vy, c, s,
                tip[t, 0] - tip[0, 0], tip[t, 1] - tip[0, 1], world_vx, world_vy, path_length, fx, fy, force_point,
                mass, com_x, com_y, inertia, hat[0], hat[1], new_x, new_y, yaw_rate,
            )  # fmt: skip

        forward_x, forward_y = c * d0 - s * d1, s * d0 + c * d1
        for j in range(2):
            modes_out[t, j] = modes[j]
            touching = j < count and modes[j] != SEPARATE
            bx = contacts[j, NX] * lam[j, 0] - contacts[j, NY] * lam[j, 1] if touching else 0.0
            by = contacts[j, NY] * lam[j, 0] + contacts[j, NX] * lam[j, 1] if touching else 0.0
            contact_forces[t, j, 0], contact_forces[t, j, 1] = step_c * bx - step_s * by, step_s * bx + step_c * by
            cx, cy = contacts[j, CX] if touching else np.nan, contacts[j, CY] if touching else np.nan
            contact_points[t, j, 0] = x + ahead * forward_x + step_c * cx - step_s * cy
            contact_points[t, j, 1] = y + ahead * forward_y + step_s * cx + step_c * cy

        twists[t, 0], twists[t, 1], twists[t, 2] = xi[0], xi[1], xi[2]
        x, y, theta = x + forward_x, y + forward_y, theta + xi[2] * dt
        c, s = cos(theta), sin(theta)
        com_vx, com_vy, yaw_rate = new_x, new_y, xi[2]
        body_x, body_y = com_vx + yaw_rate * com_y, com_vy - yaw_rate * com_x
        poses[t + 1, 0], poses[t + 1, 1], poses[t + 1, 2] = x, y, theta
        velocities[t + 1, 0], velocities[t + 1, 1] = c * body_x - s * body_y, s * body_x + c * body_y
        velocities[t + 1, 2] = yaw_rate
        if differentiate:
            record_columns(J, row_of_step[t + 1], Q, c, s)
    remember(memory, xi, last_xi, modes, moving_steps)
    gaps[steps] = np.inf
    if radius > 0.0:
        tx = c * (tip[steps, 0] - x) + s * (tip[steps, 1] - y)
        ty = -s * (tip[steps, 0] - x) + c * (tip[steps, 1] - y)
        if find_contacts(edges[0], edges[1], edges[2], edges[3], previous, tx, ty, radius, radius, found) > 0:
            gaps[steps] = found[0, GAP]

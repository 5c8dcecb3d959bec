"""A whole push, step by step, and the derivative of every recorded pose with it.

Everything happens in the body frame, where the support friction does not depend on the pose; the
disc's center and velocity are brought there at each step (`step_start`).

A step sees the body as it is expected to stand halfway through the step, were it to go on as
before: turned by h w, and the disc slid along its outline. The midpoint rule makes the motion
between changes of the contact mode exact to O(dt²) instead of O(dt). With h = 0 the step sees the
body as it stands at the beginning, as the paper's LCP does.
"""

from math import sqrt

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact import (
    COLUMNS,
    CX,
    CY,
    GAP,
    GX,
    GY,
    NX,
    NY,
    find_contacts,
    look_ahead,
)
from gridpush_drake.dynamics.kernels.contact_modes import (
    SEPARATE,
    Scales,
    Touch,
    Unknowns,
    calc_compliance,
)
from gridpush_drake.dynamics.kernels.forward_sensitivity import (
    F_ROW,
    OTHER,
    Columns,
    record_columns,
    start_columns,
    step_columns,
)
from gridpush_drake.dynamics.kernels.friction import begin_step, fill_load_derivatives, renew
from gridpush_drake.dynamics.kernels.inputs import Load, Steps
from gridpush_drake.dynamics.kernels.integrate_pose import PoseMaps, calc_displacement_maps
from gridpush_drake.dynamics.kernels.step import CONVERGED, make_step_work, solve_step
from gridpush_drake.dynamics.kernels.step_derivative import (
    StepDerivative,
    calc_input_derivative,
    calc_step_derivative,
)
from gridpush_drake.dynamics.kernels.step_memory import MEMORY_SIZE, MOVING, recall, remember
from gridpush_drake.dynamics.kernels.step_start import advance_state, make_state, make_step_start
from gridpush_drake.dynamics.kernels.support_loads import (
    add_load_variations,
    fill_load_columns,
    find_loads,
    make_loads,
)

_TINY_SPEED = 1e-12  # m/s
_REACH = 2.0  # contacts closer than this many steps' motion are watched
RECOVERY_SPEED = (
    0.02  # m/s at which an overlap is undone at most: the body keeps its speed when it is out
)
_AT_REST = 2.0  # a body slower than so many stiction tolerances rests


@kernel()
def rollout(
    law, body, support, edges, scheme, load, pose, velocity, dts, row_of_step, record, J, memory
):
    """Simulates T steps.

    Args:
        law: the friction law, see `friction`.
        body: `Body`.
        support: `Support`; where it is active, `law.k` is changed from step to step.
        edges: `Edges`, the outline.
        scheme: `Scheme`.
        load: `Load`.
        pose, velocity: (3,) q and nu at the beginning.
        dts: (T,) s.
        row_of_step: (T+1,) row of J that records this step, -1 for none.
        record: `Steps`, filled.
        J: (rows, 3, width) filled, see `forward_sensitivity`; without columns where no derivative
            is wanted.
        memory: (MEMORY_SIZE,) of the step before, updated; see `step_memory`.
    """
    n, steps = body.cells.shape[1], dts.shape[0]
    inertial, differentiate = scheme.inertial, J.shape[2] > 0
    load0 = 0.0
    for i in range(n):
        load0 += body.k[i]
    hat, push, last_xi = np.zeros(3), np.zeros(3), np.zeros(3)
    unknowns = Unknowns(np.zeros(3), np.zeros((2, 2)), np.zeros(2, np.int64))
    xi, lam, modes = unknowns
    found, contacts = np.zeros((2, COLUMNS)), np.zeros((2, COLUMNS))
    work = make_step_work()
    maps = PoseMaps(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))
    derivative = StepDerivative(
        np.zeros((7, 7)), np.zeros((3, 3)), np.zeros((3, 7)), np.zeros((3, 8))
    )
    width = J.shape[2]
    columns = Columns(
        np.zeros((F_ROW + 2 if support.active else F_ROW, width)),
        np.zeros((6, width)),
        np.zeros((6, 9)),
        np.zeros((3, 6)),
    )
    state = make_state(pose, velocity, body.com_x, body.com_y)
    # entry by entry: an array assigned to a slice would add a seventh to the time of compilation
    for i in range(3):
        record.poses[0, i] = pose[i]
        record.velocities[0, i] = velocity[i]
    if differentiate:
        start_columns(columns.Q, n, state)
        record_columns(J, row_of_step[0], columns.Q, state.c, state.s)
    loads = make_loads(support)
    moving_steps = recall(memory, xi, last_xi, modes, loads.tilt, loads.friction)

    for t in range(steps):
        dt = dts[t]
        start = make_step_start(state, load, t, dt, scheme.ahead * dt)
        hat[0], hat[1], hat[2] = start.hat_x, start.hat_y, start.yaw_rate
        pusher_speed = sqrt(start.vpx * start.vpx + start.vpy * start.vpy)
        body_speed = _calc_body_speed(state, body.gyration_radius) if inertial else 0.0
        reach = _REACH * (pusher_speed + body_speed) * dt
        count, record.gaps[t] = _find_step_contacts(
            edges, load.radius, scheme.ahead, start, reach, found, contacts
        )
        if inertial:
            _bound_recovery(contacts, count, RECOVERY_SPEED * dt)
        for j in range(count, 2):
            modes[j] = SEPARATE
        touch = Touch(contacts, count, start.vpx, start.vpy, body.contact_friction, dt)
        closing = _calc_closing_speed(touch)
        push_speed, drive_size = _fill_drive(body, inertial, start, load.point, work, push)
        speed = pusher_speed + closing + body_speed + push_speed + _TINY_SPEED
        eps = max(scheme.stiction if inertial else 0.0, scheme.relative_stiction * speed)
        scales = Scales(body.gyration_radius, load0 + drive_size, speed)

        record.load_centers[t, :] = np.nan
        record.tips[t] = False
        if support.active:
            _shift_loads(law, body, support, state, loads, record, t)

        slow = not inertial or body_speed < _AT_REST * scheme.stiction
        if slow and push_speed == 0.0 and closing <= 0.0:
            xi[:] = 0.0
            lam[:] = 0.0
            modes[:] = SEPARATE
            status, iterations = CONVERGED, 0
            moving_steps = 0
            derivative.Y[:] = 0.0
            derivative.E[:] = 0.0
            loads.friction[:] = 0.0
            if support.active:
                columns.Q[6:, :] = 0.0
        else:
            _guess(xi, last_xi, moving_steps, start, inertial and body_speed > 0.0, body)
            moving_steps += 1
            # A pusher's force is not known beforehand.
            known = not (slow and push_speed == 0.0)
            begin_step(law, body.cells, body.com_x, body.com_y, body.cell_size, hat, push, known)
            status, iterations = solve_step(law, body.cells, touch, scales, eps, unknowns, work)
            if support.active:
                _find_friction(touch, unknowns, work, loads)
            if differentiate:
                _differentiate_step(touch, scales, unknowns, work, found, start, derivative)

        record.statuses[t, 0], record.statuses[t, 1] = status, iterations
        d0, d1, new_x, new_y = calc_displacement_maps(
            xi, dt, inertial, start.a, body.com_x, body.com_y, maps
        )
        if differentiate:
            if not support.active:
                fill_load_derivatives(law, body.cells, eps, xi, columns.Q[6:])
            elif moving_steps > 0:
                columns.Q[6:F_ROW, n:] = 0.0
                fill_load_derivatives(law, body.cells, eps, xi, columns.Q[6:])
                fill_load_columns(support, body.cells, loads, law.k, columns.Q, OTHER)
                add_load_variations(loads, columns.Q)
            step_columns(
                columns, body, inertial, maps, derivative, xi, start, load.path_length, load.point, new_x, new_y,
                loads.H,
            )  # fmt: skip
        forward_x, forward_y = state.c * d0 - state.s * d1, state.s * d0 + state.c * d1
        _record_contacts(
            record,
            t,
            touch,
            unknowns,
            start,
            state.x + scheme.ahead * forward_x,
            state.y + scheme.ahead * forward_y,
        )
        for i in range(3):
            record.twists[t, i] = xi[i]
        state = advance_state(
            state, forward_x, forward_y, dt, new_x, new_y, xi[2], body.com_x, body.com_y
        )
        _record_state(record, t + 1, state)
        if differentiate:
            record_columns(J, row_of_step[t + 1], columns.Q, state.c, state.s)
    remember(memory, xi, last_xi, modes, moving_steps, loads.tilt, loads.friction)
    record.gaps[steps] = _measure_last_gap(edges, load, state, found)


@kernel()
def rollout_pushes(law, body, support, edges, scheme, pushes, row_of_step, poses, touched, J):
    """Simulates P pushes by a disc, one after another, each as `rollout` does it by itself.

    Args:
        law, body, support, edges, scheme: as of `rollout`.
        pushes: `Pushes`.
        row_of_step: (S+P,) rows of `poses` and J that record each step's end, and a push's
            beginning; -1 for none.
        poses: (rows, 3) filled.
        touched: (P,) filled: whether the disc touched the object, a step was not solved, or the
            object tipped.
        J: (rows, 3, width) filled; without columns where no derivative is wanted.
    """
    longest = 0
    for p in range(touched.shape[0]):
        longest = max(longest, pushes.first[p + 1] - pushes.first[p])
    whole = Steps(
        np.empty((longest + 1, 3)), np.empty((longest, 3)), np.empty((longest + 1, 3)), np.empty((longest, 2, 2)),
        np.empty((longest, 2, 2)), np.empty((longest, 2), np.int64), np.empty(longest + 1), np.empty((longest, 2)),
        np.empty(longest, np.bool_), np.empty((longest, 2), np.int64),
    )  # fmt: skip
    wrench, point, still = np.zeros((longest, 3)), np.zeros(2), np.zeros(3)
    for p in range(touched.shape[0]):
        first, last = pushes.first[p], pushes.first[p + 1]
        steps, begin, end = last - first, first + p, last + p + 1
        load = Load(
            pushes.tips[begin:end], pushes.path_lengths[p], pushes.radii[p], wrench[:steps], point
        )
        record = Steps(
            whole.poses[: steps + 1], whole.twists[:steps], whole.velocities[: steps + 1], whole.contact_forces[:steps],
            whole.contact_points[:steps], whole.modes[:steps], whole.gaps[: steps + 1], whole.load_centers[:steps],
            whole.tips[:steps], whole.statuses[:steps],
        )  # fmt: skip
        rows = row_of_step[begin:end]
        rollout(
            law, body, support, edges, scheme, load, pushes.poses[p], still, pushes.dts[first:last], rows, record, J,
            np.zeros(MEMORY_SIZE),
        )  # fmt: skip
        for t in range(steps + 1):
            if rows[t] >= 0:
                for i in range(3):
                    poses[rows[t], i] = record.poses[t, i]
        touched[p] = False
        for t in range(steps):
            modes = record.modes[t, 0] != SEPARATE or record.modes[t, 1] != SEPARATE
            if modes or record.tips[t] or record.statuses[t, 0] != CONVERGED:
                touched[p] = True


@kernel(allocates=False)
def _shift_loads(law, body, support, state, loads, record, t):
    """Calculates what the cells bear in step t, and records its center."""
    held = find_loads(support, body.cells, body.cell_size, state, loads, law.k)
    renew(law)
    center = loads.center
    record.load_centers[t, 0] = state.x + state.c * center[0] - state.s * center[1]
    record.load_centers[t, 1] = state.y + state.s * center[0] + state.c * center[1]
    record.tips[t] = not held


@kernel(allocates=False)
def _find_friction(touch, unknowns, work, loads):
    """Fills in the friction with the table, which balances contact, drive and inertia, and its Hessian's rows."""
    xi, lam, modes = unknowns
    contacts, H, H0, friction = touch.contacts, work.H, work.H0, loads.friction
    for i in range(2):
        friction[i] = work.drive[i] - H0[i, 0] * xi[0] - H0[i, 1] * xi[1] - H0[i, 2] * xi[2]
        for j in range(3):
            loads.H[i, j] = H[i, j] - H0[i, j]
    for j in range(touch.n_contacts):
        if modes[j] != SEPARATE:
            friction[0] += contacts[j, NX] * lam[j, 0] - contacts[j, NY] * lam[j, 1]
            friction[1] += contacts[j, NY] * lam[j, 0] + contacts[j, NX] * lam[j, 1]


@kernel(allocates=False)
def _calc_body_speed(state, arm):
    """The center of mass's speed, and that of what is an arm away from it, m/s."""
    return sqrt(state.com_vx * state.com_vx + state.com_vy * state.com_vy) + arm * abs(
        state.yaw_rate
    )


@kernel(allocates=False)
def _find_step_contacts(edges, radius, ahead, start, reach, found, contacts):
    """Fills in the contacts at the beginning and those that the step sees; returns their number and the gap, m."""
    if radius <= 0.0:
        return 0, np.inf
    count = find_contacts(edges, start.tx, start.ty, radius, reach, found)
    if count == 0:
        return 0, np.inf
    if ahead > 0.0:
        dx, dy = start.h * start.rx, start.h * start.ry
        count = look_ahead(edges, start.tx, start.ty, dx, dy, radius, reach, found, contacts)
    else:
        for j in range(found.shape[0]):
            for column in range(COLUMNS):
                contacts[j, column] = found[j, column]
    return count, found[0, GAP]


@kernel(allocates=False)
def _bound_recovery(contacts, count, depth):
    """Takes contacts that overlap by more than `depth`, m, to do so by that alone."""
    for j in range(count):
        if contacts[j, GAP] < -depth:
            contacts[j, GAP] = -depth
            contacts[j, GX] = contacts[j, GY] = 0.0


@kernel(allocates=False)
def _calc_closing_speed(touch):
    """The fastest approach of pusher and outline that the step must stop, m/s; zero where there is none."""
    closing = 0.0
    contacts = touch.contacts
    for j in range(touch.n_contacts):
        approach = (
            contacts[j, NX] * touch.vpx + contacts[j, NY] * touch.vpy - contacts[j, GAP] / touch.dt
        )
        closing = max(closing, approach)
    return closing


@kernel(allocates=False)
def _fill_drive(body, inertial, start, point, work, push):
    """Fills in H0, the drive and `push` (3,), the acceleration that the applied force alone gives the body.

    Returns:
        The speed that it gives in a step, m/s, and the size of the drive, N.
    """
    mass, com_x, com_y, inertia, arm = (
        body.mass,
        body.com_x,
        body.com_y,
        body.inertia,
        body.gyration_radius,
    )
    fx, fy, dt, yaw_rate = start.fx, start.fy, start.dt, start.yaw_rate
    H0, drive = work.H0, work.drive
    moment = point[0] * fy - point[1] * fx + start.couple
    if inertial:
        drive[0], drive[1] = mass * start.hat_x / dt + fx, mass * start.hat_y / dt + fy
        drive[2] = (
            inertia * yaw_rate / dt
            + mass * (com_x * start.hat_y - com_y * start.hat_x) / dt
            + moment
        )
        push[0], push[1], push[2] = (
            fx / mass,
            fy / mass,
            (moment - com_x * fy + com_y * fx) / inertia,
        )
        H0[0, 0] = H0[1, 1] = mass / dt
        H0[0, 2] = H0[2, 0] = -mass * com_y / dt
        H0[1, 2] = H0[2, 1] = mass * com_x / dt
        H0[2, 2] = (inertia + mass * (com_x * com_x + com_y * com_y)) / dt
    drive_size = sqrt(drive[0] * drive[0] + drive[1] * drive[1]) + abs(drive[2]) / arm
    push_speed = (sqrt(push[0] * push[0] + push[1] * push[1]) + arm * abs(push[2])) * dt
    return push_speed, drive_size


@kernel(allocates=False)
def _guess(xi, last_xi, moving_steps, start, moves, body):
    """Guesses the twist: extrapolated, as it was, the body's own where it moves, or the pusher's."""
    if moving_steps >= MOVING:
        for i in range(3):
            last_xi[i], xi[i] = xi[i], 2.0 * xi[i] - last_xi[i]
    elif moving_steps == 1:
        for i in range(3):
            last_xi[i] = xi[i]
    elif moves:
        yaw_rate = start.yaw_rate
        xi[0], xi[1], xi[2] = (
            start.hat_x + yaw_rate * body.com_y,
            start.hat_y - yaw_rate * body.com_x,
            yaw_rate,
        )
    else:
        xi[0], xi[1], xi[2] = start.vpx, start.vpy, 0.0


@kernel(allocates=False)
def _differentiate_step(touch, scales, unknowns, work, found, start, derivative):
    """Fills in the derivative of a step; zeros where it has none."""
    compliance = calc_compliance(touch, scales)
    if calc_step_derivative(work.H, touch, compliance, unknowns, work.K, work.X, derivative):
        calc_input_derivative(found[0], start, derivative)
    else:
        derivative.Y[:] = 0.0
        derivative.E[:] = 0.0


@kernel(allocates=False)
def _record_contacts(record, t, touch, unknowns, start, x, y):
    """Records modes, forces and points of step t; (x, y) is where B's origin is when the step looks at the body, m."""
    contacts, modes, lam, step_c, step_s = (
        touch.contacts,
        unknowns.modes,
        unknowns.lam,
        start.step_c,
        start.step_s,
    )
    forces, points = record.contact_forces, record.contact_points
    for j in range(2):
        record.modes[t, j] = modes[j]
        touching = j < touch.n_contacts and modes[j] != SEPARATE
        bx = contacts[j, NX] * lam[j, 0] - contacts[j, NY] * lam[j, 1] if touching else 0.0
        by = contacts[j, NY] * lam[j, 0] + contacts[j, NX] * lam[j, 1] if touching else 0.0
        forces[t, j, 0], forces[t, j, 1] = step_c * bx - step_s * by, step_s * bx + step_c * by
        cx, cy = contacts[j, CX] if touching else np.nan, contacts[j, CY] if touching else np.nan
        points[t, j, 0] = x + step_c * cx - step_s * cy
        points[t, j, 1] = y + step_s * cx + step_c * cy


@kernel(allocates=False)
def _record_state(record, t, state):
    """Records the pose, and the velocity of B's origin in W."""
    c, s, body_x, body_y = state.c, state.s, state.body_x, state.body_y
    record.poses[t, 0], record.poses[t, 1], record.poses[t, 2] = state.x, state.y, state.theta
    record.velocities[t, 0], record.velocities[t, 1] = (
        c * body_x - s * body_y,
        s * body_x + c * body_y,
    )
    record.velocities[t, 2] = state.yaw_rate


@kernel(allocates=False)
def _measure_last_gap(edges, load, state, found):
    """The gap when the push ends, m; infinite where the disc is further away than its radius."""
    if load.radius <= 0.0:
        return np.inf
    c, s, tip, last = state.c, state.s, load.tip, load.tip.shape[0] - 1
    tx = c * (tip[last, 0] - state.x) + s * (tip[last, 1] - state.y)
    ty = -s * (tip[last, 0] - state.x) + c * (tip[last, 1] - state.y)
    if find_contacts(edges, tx, ty, load.radius, load.radius, found) == 0:
        return np.inf
    return found[0, GAP]

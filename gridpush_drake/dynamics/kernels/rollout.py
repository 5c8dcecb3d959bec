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
from gridpush_drake.dynamics.kernels.contact.contact import (
    CONTACT_COLUMNS,
    CX,
    CY,
    GAP,
    GX,
    GY,
    NX,
    NY,
    find_contacts,
    find_contacts_near,
    look_ahead_near,
    make_near_edges,
)
from gridpush_drake.dynamics.kernels.contact.contact_modes import (
    SEPARATE,
    Scales,
    Touch,
    Unknowns,
    calc_compliance,
)
from gridpush_drake.dynamics.kernels.forward_sensitivity import (
    F_ROW,
    OTHER_COLUMNS,
    Columns,
    record_columns,
    start_columns,
    step_columns,
)
from gridpush_drake.dynamics.kernels.friction.laws import (
    begin_push,
    begin_step,
    fill_load_derivatives,
)
from gridpush_drake.dynamics.kernels.inputs import Load, make_steps, take_first_steps
from gridpush_drake.dynamics.kernels.integrate_pose import PoseMaps, calc_displacement_maps
from gridpush_drake.dynamics.kernels.step import STEP_CONVERGED, make_step_work, solve_step
from gridpush_drake.dynamics.kernels.step_derivative import (
    StepDerivative,
    calc_input_derivative,
    calc_step_derivative,
)
from gridpush_drake.dynamics.kernels.step_memory import (
    MEMORY_SIZE,
    MIN_MOVING_STEPS,
    recall,
    remember,
)
from gridpush_drake.dynamics.kernels.step_start import advance_state, make_state, make_step_start
from gridpush_drake.dynamics.kernels.support_loads import (
    add_load_variations,
    fill_load_columns,
    make_loads,
    shift_loads,
)

_TINY_SPEED = 1e-12
"""Added to the scale of speeds, m/s, so that it is never zero."""

_REACH = 2.0
"""Contacts are watched from as far away as pusher and body move in this many steps."""

RECOVERY_SPEED = 0.02
"""Greatest speed at which an overlap is undone, m/s. The body keeps its speed when it is out."""

_AT_REST = 2.0
"""A body slower than this many stiction tolerances is taken to rest."""


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
            is wanted. With OTHER_COLUMNS columns those of the cells are left out; loads must not
            shift.
        memory: (MEMORY_SIZE,) of the step before, updated; see `step_memory`.
    """
    n = body.cells.shape[1]
    steps = dts.shape[0]
    inertial = scheme.inertial
    differentiate = J.shape[2] > 0

    # The force that the table's friction can exert sets the scale of all forces.
    total_friction = 0.0
    for i in range(n):
        total_friction += body.k[i]

    # Room for all that a step calculates, made once.
    expected_velocity = np.zeros(3)
    force_acceleration = np.zeros(3)
    last_twist = np.zeros(3)
    unknowns = Unknowns(xi=np.zeros(3), lam=np.zeros((2, 2)), modes=np.zeros(2, np.int64))
    xi, lam, modes = unknowns
    near = make_near_edges(edges)
    found = np.zeros((2, CONTACT_COLUMNS))
    contacts = np.zeros((2, CONTACT_COLUMNS))
    work = make_step_work()
    maps = PoseMaps(A=np.zeros((3, 3)), G=np.zeros((3, 3)), L=np.zeros((3, 3)))
    derivative = StepDerivative(
        F=np.zeros((7, 7)), Y=np.zeros((3, 3)), D=np.zeros((3, 7)), E=np.zeros((3, 8))
    )
    width = J.shape[2]
    cell_columns = min(n, max(width - OTHER_COLUMNS, 0))
    rows = F_ROW + 2 if support.active else F_ROW
    columns = Columns(
        Q=np.zeros((rows, width)),
        N=np.zeros((6, width)),
        Z=np.zeros((6, 9)),
        B=np.zeros((3, 6)),
    )
    loads = make_loads(support)

    # The beginning, and what the solver remembers of the step before it.
    state = make_state(pose, velocity, body.com_x, body.com_y)
    # entry by entry: an array assigned to a slice would add a seventh to the time of compilation
    for i in range(3):
        record.poses[0, i] = pose[i]
        record.velocities[0, i] = velocity[i]
    if differentiate:
        start_columns(columns.Q, cell_columns, state)
        record_columns(J, row_of_step[0], columns.Q, state.c, state.s)
    begin_push(law)
    moving_steps = recall(memory, xi, last_twist, modes, loads.tilt, loads.friction)

    for t in range(steps):
        dt = dts[t]

        # What the step sees: how the body moves, where it is touched, and what drives it.
        start = make_step_start(state, load, t, dt, scheme.ahead * dt)
        expected_velocity[0] = start.expected_vx
        expected_velocity[1] = start.expected_vy
        expected_velocity[2] = start.yaw_rate
        pusher_speed = sqrt(start.vpx * start.vpx + start.vpy * start.vpy)
        body_speed = _calc_body_speed(state, body.gyration_radius) if inertial else 0.0
        reach = _REACH * (pusher_speed + body_speed) * dt
        count, record.gaps[t] = _find_step_contacts(
            edges, near, load.radius, scheme.ahead, start, reach, found, contacts
        )
        if inertial:
            _bound_recovery(contacts, count, RECOVERY_SPEED * dt)
        for j in range(count, 2):
            modes[j] = SEPARATE
        touch = Touch(
            contacts=contacts,
            n_contacts=count,
            vpx=start.vpx,
            vpy=start.vpy,
            mu=body.contact_friction,
            dt=dt,
        )
        closing = _calc_closing_speed(touch)
        force_speed, drive_size = _fill_drive(
            body, inertial, start, load.point, work, force_acceleration
        )

        # Friction is smoothed below eps, and errors are measured on these scales.
        speed = pusher_speed + closing + body_speed + force_speed + _TINY_SPEED
        eps = max(scheme.stiction if inertial else 0.0, scheme.relative_stiction * speed)
        scales = Scales(arm=body.gyration_radius, load=total_friction + drive_size, speed=speed)

        # What each cell bears now (section 8 of the theory).
        record.load_centers[t, 0] = np.nan
        record.load_centers[t, 1] = np.nan
        record.tips[t] = False
        if support.active:
            shift_loads(law, body.cells, body.cell_size, support, state, loads, record, t)

        slow = not inertial or body_speed < _AT_REST * scheme.stiction
        if slow and force_speed == 0.0 and closing <= 0.0:
            # Nothing moves it: the step is solved by rest, which depends on nothing.
            xi[:] = 0.0
            lam[:] = 0.0
            modes[:] = SEPARATE
            status = STEP_CONVERGED
            iterations = 0
            moving_steps = 0
            derivative.Y[:] = 0.0
            derivative.E[:] = 0.0
            loads.friction[:] = 0.0
            if support.active:
                columns.Q[6:, :] = 0.0
        else:
            _guess_twist(xi, last_twist, moving_steps, start, inertial and body_speed > 0.0, body)
            moving_steps += 1
            # From rest only an applied force says where the body goes; a pusher's force is not
            # known beforehand.
            known = not (slow and force_speed == 0.0)
            begin_step(
                law,
                body.cells,
                body.com_x,
                body.com_y,
                body.cell_size,
                expected_velocity,
                force_acceleration,
                known,
            )
            status, iterations = solve_step(
                law, body.cells, touch, scales, eps, scheme.early_end, unknowns, work
            )
            if support.active:
                _find_friction(touch, unknowns, work, loads)
            if differentiate:
                _differentiate_step(touch, scales, unknowns, work, found, start, derivative)

        # The pose moves by the twist (section 5 of the theory).
        record.statuses[t, 0] = status
        record.statuses[t, 1] = iterations
        d0, d1, new_x, new_y = calc_displacement_maps(
            xi, dt, inertial, start.a, body.com_x, body.com_y, maps
        )

        # The columns of the derivative go over the step before the state does: they need the old
        # one. Rows 6 to 8 of Q are the forces f that act on the step's equations.
        if differentiate:
            if cell_columns == 0:
                pass  # no friction varies
            elif not support.active:
                fill_load_derivatives(law, body.cells, eps, xi, columns.Q[6:])
            elif moving_steps > 0:
                columns.Q[6:F_ROW, n:] = 0.0
                fill_load_derivatives(law, body.cells, eps, xi, columns.Q[6:])
                fill_load_columns(support, body.cells, loads, law.k, columns.Q, OTHER_COLUMNS)
                add_load_variations(loads, columns.Q)
            step_columns(
                columns,
                cell_columns,
                body,
                inertial,
                maps,
                derivative,
                xi,
                start,
                load.path_length,
                load.point,
                new_x,
                new_y,
                loads.H,
            )

        # Displacement in W, and what is recorded of the step.
        forward_x = state.c * d0 - state.s * d1
        forward_y = state.s * d0 + state.c * d1
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
    remember(memory, xi, last_twist, modes, moving_steps, loads.tilt, loads.friction)
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

    # One record for the longest push, of which each push uses the beginning.
    whole = make_steps(longest)
    wrench = np.zeros((longest, 3))
    point = np.zeros(2)
    still = np.zeros(3)
    for p in range(touched.shape[0]):
        first = pushes.first[p]
        last = pushes.first[p + 1]
        steps = last - first
        begin = first + p
        end = last + p + 1
        load = Load(
            tip=pushes.tips[begin:end],
            path_length=pushes.path_lengths[p],
            radius=pushes.radii[p],
            wrench=wrench[:steps],
            point=point,
        )
        record = take_first_steps(whole, steps)
        rows = row_of_step[begin:end]
        # Every push begins at rest, and nothing is remembered of the one before.
        rollout(
            law,
            body,
            support,
            edges,
            scheme,
            load,
            pushes.poses[p],
            still,
            pushes.dts[first:last],
            rows,
            record,
            J,
            np.zeros(MEMORY_SIZE),
        )
        for t in range(steps + 1):
            if rows[t] >= 0:
                for i in range(3):
                    poses[rows[t], i] = record.poses[t, i]
        touched[p] = False
        for t in range(steps):
            modes = record.modes[t, 0] != SEPARATE or record.modes[t, 1] != SEPARATE
            if modes or record.tips[t] or record.statuses[t, 0] != STEP_CONVERGED:
                touched[p] = True


@kernel(allocates=False)
def _find_friction(touch, unknowns, work, loads):
    """Fills in the friction with the table, and the first two rows of its Hessian.

    It balances contact forces, drive and inertia.
    """
    xi, lam, modes = unknowns
    contacts = touch.contacts
    H = work.H
    H0 = work.H0
    friction = loads.friction
    for i in range(2):
        # drive - H0 xi is what inertia and the applied force leave for contact and friction
        friction[i] = work.drive[i] - H0[i, 0] * xi[0] - H0[i, 1] * xi[1] - H0[i, 2] * xi[2]
        for j in range(3):
            # the friction's part of the Hessian
            loads.H[i, j] = H[i, j] - H0[i, j]
    for j in range(touch.n_contacts):
        if modes[j] != SEPARATE:
            friction[0] += contacts[j, NX] * lam[j, 0] - contacts[j, NY] * lam[j, 1]
            friction[1] += contacts[j, NY] * lam[j, 0] + contacts[j, NX] * lam[j, 1]


@kernel(allocates=False, inlined=True)
def _calc_body_speed(state, arm):
    """Adds the center of mass's speed and that of turning about it at an arm's distance, m/s."""
    return sqrt(state.com_vx * state.com_vx + state.com_vy * state.com_vy) + arm * abs(
        state.yaw_rate
    )


@kernel(allocates=False, inlined=True)
def _find_step_contacts(edges, near, radius, ahead, start, reach, found, contacts):
    """Fills in the contacts at the beginning, `found`, and those that the step sees, `contacts`.

    Returns:
        The number of contacts that the step sees, and the gap at its beginning, m.
    """
    if radius <= 0.0:
        return 0, np.inf
    count = find_contacts_near(edges, near, start.tx, start.ty, radius, reach, found)
    if count == 0:
        return 0, np.inf
    if ahead > 0.0:
        dx = start.h * start.rx
        dy = start.h * start.ry
        count = look_ahead_near(
            edges, near, start.tx, start.ty, dx, dy, radius, reach, found, contacts
        )
    else:
        for j in range(found.shape[0]):
            for column in range(CONTACT_COLUMNS):
                contacts[j, column] = found[j, column]
    return count, found[0, GAP]


@kernel(allocates=False, inlined=True)
def _bound_recovery(contacts, count, depth):
    """Takes contacts that overlap by more than `depth`, m, to do so by that alone."""
    for j in range(count):
        if contacts[j, GAP] < -depth:
            contacts[j, GAP] = -depth
            contacts[j, GX] = contacts[j, GY] = 0.0


@kernel(allocates=False, inlined=True)
def _calc_closing_speed(touch):
    """Calculates the fastest approach of pusher and outline, m/s; zero if they part."""
    closing = 0.0
    contacts = touch.contacts
    for j in range(touch.n_contacts):
        approach = (
            contacts[j, NX] * touch.vpx + contacts[j, NY] * touch.vpy - contacts[j, GAP] / touch.dt
        )
        closing = max(closing, approach)
    return closing


@kernel(allocates=False, inlined=True)
def _fill_drive(body, inertial, start, point, work, force_acceleration):
    """Fills in H0, the drive, and the acceleration (3,) that the applied force alone would give.

    Returns:
        The speed that it gives in a step, m/s, and the size of the drive, N.
    """
    mass = body.mass
    com_x = body.com_x
    com_y = body.com_y
    inertia = body.inertia
    arm = body.gyration_radius
    fx = start.fx
    fy = start.fy
    dt = start.dt
    yaw_rate = start.yaw_rate
    H0 = work.H0
    drive = work.drive
    moment = point[0] * fy - point[1] * fx + start.couple
    if inertial:
        # M_B xi_hat/dt + W, about B's origin
        drive[0] = mass * start.expected_vx / dt + fx
        drive[1] = mass * start.expected_vy / dt + fy
        drive[2] = (
            inertia * yaw_rate / dt
            + mass * (com_x * start.expected_vy - com_y * start.expected_vx) / dt
            + moment
        )
        # F/m and the moment about the center of mass over I
        force_acceleration[0] = fx / mass
        force_acceleration[1] = fy / mass
        force_acceleration[2] = (moment - com_x * fy + com_y * fx) / inertia
        # M_B/dt
        H0[0, 0] = H0[1, 1] = mass / dt
        H0[0, 2] = H0[2, 0] = -mass * com_y / dt
        H0[1, 2] = H0[2, 1] = mass * com_x / dt
        H0[2, 2] = (inertia + mass * (com_x * com_x + com_y * com_y)) / dt
    drive_size = sqrt(drive[0] * drive[0] + drive[1] * drive[1]) + abs(drive[2]) / arm
    force_speed = (
        sqrt(
            force_acceleration[0] * force_acceleration[0]
            + force_acceleration[1] * force_acceleration[1]
        )
        + arm * abs(force_acceleration[2])
    ) * dt
    return force_speed, drive_size


@kernel(allocates=False, inlined=True)
def _guess_twist(xi, last_twist, moving_steps, start, moves, body):
    """Guesses the twist: extrapolated, as it was, the body's own if it moves, or the pusher's."""
    if moving_steps >= MIN_MOVING_STEPS:
        # the last two twists, continued
        for i in range(3):
            previous = xi[i]
            xi[i] = 2.0 * previous - last_twist[i]
            last_twist[i] = previous
    elif moving_steps == 1:
        for i in range(3):
            last_twist[i] = xi[i]
    elif moves:
        # that of a body that goes on as it was, u = v_com - w z × c
        yaw_rate = start.yaw_rate
        xi[0] = start.expected_vx + yaw_rate * body.com_y
        xi[1] = start.expected_vy - yaw_rate * body.com_x
        xi[2] = yaw_rate
    else:
        # from rest: as if the pusher took it along
        xi[0] = start.vpx
        xi[1] = start.vpy
        xi[2] = 0.0


@kernel(allocates=False)
def _differentiate_step(touch, scales, unknowns, work, found, start, derivative):
    """Fills in the derivative of a step, with zeros if it has none."""
    compliance = calc_compliance(touch, scales)
    if calc_step_derivative(work.H, touch, compliance, unknowns, work.K, work.X, derivative):
        calc_input_derivative(found[0], start, derivative)
    else:
        derivative.Y[:] = 0.0
        derivative.E[:] = 0.0


@kernel(allocates=False, inlined=True)
def _record_contacts(record, t, touch, unknowns, start, x, y):
    """Records modes, forces and points of the contacts in step t.

    (x, y) is the place in W, m, where B's origin is when the step looks at the body.
    """
    contacts = touch.contacts
    modes = unknowns.modes
    lam = unknowns.lam
    step_c = start.step_c
    step_s = start.step_s
    forces = record.contact_forces
    points = record.contact_points
    for j in range(2):
        record.modes[t, j] = modes[j]
        touching = j < touch.n_contacts and modes[j] != SEPARATE
        bx = contacts[j, NX] * lam[j, 0] - contacts[j, NY] * lam[j, 1] if touching else 0.0
        by = contacts[j, NY] * lam[j, 0] + contacts[j, NX] * lam[j, 1] if touching else 0.0
        forces[t, j, 0] = step_c * bx - step_s * by
        forces[t, j, 1] = step_s * bx + step_c * by
        cx = contacts[j, CX] if touching else np.nan
        cy = contacts[j, CY] if touching else np.nan
        points[t, j, 0] = x + step_c * cx - step_s * cy
        points[t, j, 1] = y + step_s * cx + step_c * cy


@kernel(allocates=False, inlined=True)
def _record_state(record, t, state):
    """Records the pose, and the velocity of B's origin in W."""
    c = state.c
    s = state.s
    body_x = state.body_x
    body_y = state.body_y
    record.poses[t, 0] = state.x
    record.poses[t, 1] = state.y
    record.poses[t, 2] = state.theta
    record.velocities[t, 0] = c * body_x - s * body_y
    record.velocities[t, 1] = s * body_x + c * body_y
    record.velocities[t, 2] = state.yaw_rate


@kernel(allocates=False)
def _measure_last_gap(edges, load, state, found):
    """The gap when the push ends, m; infinite where the disc is further away than its radius."""
    if load.radius <= 0.0:
        return np.inf
    c = state.c
    s = state.s
    tip = load.tip
    last = load.tip.shape[0] - 1
    tx = c * (tip[last, 0] - state.x) + s * (tip[last, 1] - state.y)
    ty = -s * (tip[last, 0] - state.x) + c * (tip[last, 1] - state.y)
    if find_contacts(edges, tx, ty, load.radius, load.radius, found) == 0:
        return np.inf
    return found[0, GAP]

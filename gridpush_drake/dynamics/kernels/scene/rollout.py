"""A whole push of several bodies, step by step, and the derivative of every recorded pose with it.

It goes as that of one body does (`dynamics.kernels.rollout`), in the quasi-static regime: a step
sees every body as it is expected to stand halfway through the step, were it to go on as before, and
each body turns about its own instantaneous center for the length of the step.
"""

from math import cos, sin

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.contact_modes import SEPARATE
from gridpush_drake.dynamics.kernels.friction.laws import begin_push, begin_step
from gridpush_drake.dynamics.kernels.integrate_pose import (
    PoseMaps,
    calc_displacement_maps,
    calc_turn,
)
from gridpush_drake.dynamics.kernels.scene.body_laws import take_law
from gridpush_drake.dynamics.kernels.scene.contact_rows import SceneScales
from gridpush_drake.dynamics.kernels.scene.contacts import (
    find_fastest_vertex,
    find_scene_contacts,
    make_contact_search,
    measure_finger_gap,
)
from gridpush_drake.dynamics.kernels.scene.records import (
    FIRST_BODY,
    IDENTITY_SIZE,
    OTHER_CX,
    OTHER_CY,
    ROW_CX,
    ROW_CY,
    ROW_GAP,
    ROW_NX,
    ROW_NY,
    SECOND_BODY,
    TIP_VX,
    TIP_VY,
    ToolMotion,
)
from gridpush_drake.dynamics.kernels.scene.step import (
    WAKING_OVERLAP,
    make_step_work,
    solve_scene_step,
    wake,
)
from gridpush_drake.dynamics.kernels.scene.step_derivative import (
    fill_step_derivative,
    make_derivative,
    start_columns,
    step_columns,
)
from gridpush_drake.dynamics.kernels.step import STEP_CONVERGED
from gridpush_drake.dynamics.kernels.step_memory import MIN_MOVING_STEPS
from gridpush_drake.dynamics.kernels.step_start import make_state
from gridpush_drake.dynamics.kernels.support_loads import make_loads, shift_loads

_TINY_SPEED = 1e-12
"""Added to the scale of speeds, m/s, so that it is never zero."""


@kernel()
def rollout_scene(
    bodies, support, pusher, tolerances, state, contacts, dts, row_of_step, record, J
):
    """Simulates T steps.

    Args:
        bodies: `BodyArrays`.
        support: `Support`; active of one body only, whose law's k is then changed from step to
            step.
        pusher: `PusherPath`.
        tolerances: `Tolerances`.
        state: `SceneState` at the beginning; that of the end when it is done.
        contacts: `Contacts` of the step before, likewise.
        dts: (T,) steps, s, or as `push.measure_steps` has them.
        row_of_step: (T+1,) row of J that records this step, -1 for none.
        record: `SceneSteps`, filled.
        J: (rows, N, 3, width) filled, see `step_derivative`; without columns where no derivative is
            wanted.
    """
    n = state.q.shape[0]
    cells = bodies.first_cell[n]
    room = contacts.modes.shape[0]
    width = J.shape[3]
    differentiate = width > 0
    load = 0.0
    for b in range(n):
        load += bodies.load[b]

    # Room for all that a step calculates, made once.
    search = make_contact_search(bodies, pusher.tool)
    xi = np.zeros((n, 3))
    expected = np.zeros(3)
    no_force = np.zeros(3)
    shift = np.zeros((n, 2))
    work = make_step_work(n, room)
    derivative = make_derivative(
        n, cells if differentiate else 0, room if differentiate else 0, width
    )
    loads = make_loads(support)
    for i in range(2):
        loads.tilt[i] = state.tilt[i]
        loads.friction[i] = state.friction[i]

    for b in range(n):
        state.turn[b, 0] = cos(state.q[b, 2])
        state.turn[b, 1] = sin(state.q[b, 2])
        _begin_push(bodies, b)
        for i in range(3):
            record.poses[0, b, i] = state.q[b, i]
    if differentiate:
        start_columns(bodies, pusher, derivative.S)
        _record_columns(J, row_of_step[0], derivative.S)

    for t in range(dts.shape[0]):
        dt = dts[t]
        h = tolerances.ahead * dt
        motion = _move_tool(pusher, t, t + 1, dt)

        # What each cell bears now (section 8 of the theory).
        if support.active:
            _shift_loads(bodies, support, state, no_force, loads, record, t)

        # Who touches whom, and whom that sets in motion.
        record.finger_gaps[t] = find_scene_contacts(bodies, state, motion, dt, h, search, contacts)
        awake = wake(contacts, work)
        closing = _calc_closing_speed(contacts, dt)
        tip_speed, _ = find_fastest_vertex(motion)
        speed = tip_speed + closing + _TINY_SPEED
        scales = SceneScales(
            load=load,
            speed=speed,
            tip_speed=tip_speed if tip_speed > 0.0 else speed,
            disc=pusher.tool.core.ax.shape[0] == 1,
        )
        eps = tolerances.relative_stiction * speed
        status = STEP_CONVERGED
        iterations = 0
        moving = awake > 0 and closing > 0.0
        if moving:
            _guess_twists(state, contacts, xi, work)
            _begin_friction(bodies, state, h, work.awake, expected, no_force)
            status, iterations = solve_scene_step(
                bodies, contacts, awake, dt, scales, eps, xi, work
            )
            if differentiate:
                fill_step_derivative(
                    bodies,
                    state,
                    motion,
                    contacts,
                    h,
                    dt,
                    scales,
                    xi,
                    work.awake,
                    work.contact,
                    derivative,
                )
        else:
            # Nothing moves any of them: the step is solved by rest, which depends on nothing.
            _rest(xi, contacts, work, derivative.F)
        if support.active:
            _find_friction(contacts, work, loads)
        record.statuses[t, 0] = status
        record.statuses[t, 1] = iterations
        record.residuals[t, 0] = work.certificate[0]
        record.residuals[t, 1] = work.certificate[1]

        # Every pose moves by its twist.
        for b in range(n):
            maps = PoseMaps(A=derivative.A, G=derivative.G[b], L=work.H[b])
            d0, d1, _, _ = calc_displacement_maps(xi[b], dt, False, 0.0, 0.0, 0.0, maps)
            shift[b, 0] = state.turn[b, 0] * d0 - state.turn[b, 1] * d1
            shift[b, 1] = state.turn[b, 1] * d0 + state.turn[b, 0] * d1
        if differentiate:
            step_columns(
                bodies,
                support,
                state,
                pusher,
                motion,
                t,
                eps,
                xi,
                dt,
                shift,
                loads,
                derivative,
            )
        _record_contacts(record, t, state, contacts, shift, h, tolerances.ahead)
        _advance(state, xi, shift, dt, moving, work.awake)
        for b in range(n):
            for i in range(3):
                record.poses[t + 1, b, i] = state.q[b, i]
                record.twists[t, b, i] = xi[b, i]
        if differentiate:
            _record_columns(J, row_of_step[t + 1], derivative.S)
    for i in range(2):
        state.tilt[i] = loads.tilt[i]
        state.friction[i] = loads.friction[i]
    last = dts.shape[0]
    at_end = _move_tool(pusher, last, last, 1.0)
    record.finger_gaps[last] = measure_finger_gap(bodies, state, at_end, search.found)


@kernel()
def _move_tool(pusher, t, after, dt):
    """The pusher's motion from sample t to the sample `after`, in a step dt."""
    tip = pusher.tip
    yaw = pusher.yaw
    c = cos(yaw[t])
    s = sin(yaw[t])
    return ToolMotion(
        x=tip[t, 0],
        y=tip[t, 1],
        yaw=yaw[t],
        vx=(tip[after, 0] - tip[t, 0]) / dt,
        vy=(tip[after, 1] - tip[t, 1]) / dt,
        rate=(yaw[after] - yaw[t]) / dt,
        turn_c=c,
        turn_s=s,
        turn_vc=(cos(yaw[after]) - c) / dt,
        turn_vs=(sin(yaw[after]) - s) / dt,
        tool=pusher.tool,
    )


@kernel(allocates=False)
def _begin_push(bodies, b):
    """Lets the law of body b forget another push."""
    law, _ = take_law(bodies, b)
    begin_push(law)


@kernel(allocates=False)
def _shift_loads(bodies, support, state, at_rest, loads, record, t):
    """Calculates what the cells of the one body bear in step t; `at_rest` is (3,) zeros."""
    law, cells = take_law(bodies, 0)
    place = make_state(state.q[0], at_rest, 0.0, 0.0)
    shift_loads(law, cells, bodies.cell_size[0], support, place, loads, record, t)


@kernel(allocates=False)
def _find_friction(contacts, work, loads):
    """Fills in one body's friction with the table, and the first two rows of its Hessian.

    It balances the contact forces.
    """
    rows = work.contact.rows
    for i in range(2):
        loads.friction[i] = 0.0
        for r in range(contacts.counts[0]):
            lam = contacts.lam[r]
            loads.friction[i] += rows[2 * r, i] * lam[0] + rows[2 * r + 1, i] * lam[1]
        for j in range(3):
            loads.H[i, j] = work.H[0, i, j]


@kernel(allocates=False)
def _calc_closing_speed(contacts, dt):
    """Calculates the fastest approach of pusher and outlines, or out of an overlap, m/s.

    It is zero where nothing approaches.
    """
    closing = 0.0
    for r in range(contacts.counts[0]):
        numbers = contacts.numbers[r]
        if contacts.ids[r, SECOND_BODY] < 0:
            approach = numbers[ROW_NX] * numbers[TIP_VX] + numbers[ROW_NY] * numbers[TIP_VY]
            closing = max(closing, approach - numbers[ROW_GAP] / dt)
        elif numbers[ROW_GAP] < -WAKING_OVERLAP:
            closing = max(closing, -numbers[ROW_GAP] / dt)
    return closing


@kernel(allocates=False)
def _guess_twists(state, contacts, xi, work):
    """Guesses the twists: extrapolated, as they were, or as what wakes a body takes it along."""
    for b in range(xi.shape[0]):
        for i in range(3):
            xi[b, i] = 0.0
    count = 0
    for b in range(xi.shape[0]):
        if work.awake[b]:
            count += 1
    # in the order in which they are woken: what comes is guessed before whom it takes along
    for k in range(count):
        b = work.order[k]
        twist = state.twist[b]
        if state.moved[b] > 0:
            further = 1.0 if state.moved[b] >= MIN_MOVING_STEPS else 0.0
            for i in range(3):
                xi[b, i] = twist[i] + further * (twist[i] - state.before[b, i])
            continue
        r = work.parent[b]
        if r < 0:
            continue
        numbers = contacts.numbers[r]
        other = contacts.ids[r, SECOND_BODY]
        if other < 0:
            xi[b, 0] = numbers[TIP_VX]
            xi[b, 1] = numbers[TIP_VY]
            continue
        # The velocity of the contact point on the body that comes, turned into this one's frame.
        if other == b:
            other = contacts.ids[r, FIRST_BODY]
            px = numbers[ROW_CX]
            py = numbers[ROW_CY]
        else:
            px = numbers[OTHER_CX]
            py = numbers[OTHER_CY]
        vx = xi[other, 0] - xi[other, 2] * py
        vy = xi[other, 1] + xi[other, 2] * px
        angle = state.q[other, 2] - state.q[b, 2]
        c = cos(angle)
        s = sin(angle)
        xi[b, 0] = c * vx - s * vy
        xi[b, 1] = s * vx + c * vy


@kernel(allocates=False)
def _begin_friction(bodies, state, h, awake, expected, no_force):
    """Lets the law of each body that takes part look at how that moved before the step.

    The contact forces are not known beforehand, and no other force acts.

    Args:
        bodies: `BodyArrays`.
        state: `BodyStates` at the step's beginning.
        h: time after which the step looks at the bodies, s.
        awake: (N,) which bodies take part.
        expected: (3,) workspace.
        no_force: (3,) zeros.
    """
    for b in range(awake.shape[0]):
        if not awake[b]:
            continue
        # the twist of the step before, in the frame of this one
        twist = state.twist[b]
        c, s = calc_turn(h * twist[2])
        expected[0] = c * twist[0] + s * twist[1]
        expected[1] = -s * twist[0] + c * twist[1]
        expected[2] = twist[2]
        law, cells = take_law(bodies, b)
        size = bodies.cell_size[b]
        begin_step(law, cells, 0.0, 0.0, size, expected, no_force, False)


@kernel(allocates=False)
def _rest(xi, contacts, work, F):
    """Makes a step in which nothing moves."""
    for b in range(xi.shape[0]):
        work.awake[b] = False
        for i in range(3):
            xi[b, i] = 0.0
    for r in range(contacts.counts[0]):
        contacts.lam[r, 0] = 0.0
        contacts.lam[r, 1] = 0.0
        contacts.modes[r] = SEPARATE
    work.certificate[0] = 0.0
    work.certificate[1] = 0.0
    for row in range(F.shape[0]):
        for column in range(F.shape[1]):
            F[row, column] = 0.0


@kernel(allocates=False)
def _advance(state, xi, shift, dt, moving, awake):
    """Moves the bodies on by the step, and remembers their twists."""
    for b in range(xi.shape[0]):
        for i in range(3):
            state.before[b, i] = state.twist[b, i]
            state.twist[b, i] = xi[b, i]
        state.moved[b] = min(state.moved[b] + 1, MIN_MOVING_STEPS) if moving and awake[b] else 0
        if state.moved[b] > 0:
            state.q[b, 0] += shift[b, 0]
            state.q[b, 1] += shift[b, 1]
            state.q[b, 2] += xi[b, 2] * dt
            state.turn[b, 0] = cos(state.q[b, 2])
            state.turn[b, 1] = sin(state.q[b, 2])


@kernel(allocates=False)
def _record_contacts(record, t, state, contacts, shift, h, ahead):
    """Records the contacts of step t, where they are halfway through it."""
    record.counts[t] = contacts.counts[0]
    for r in range(contacts.counts[0]):
        for column in range(IDENTITY_SIZE):
            record.ids[t, r, column] = contacts.ids[r, column]
        record.modes[t, r] = contacts.modes[r]
        # force and place, turned from the frame of the step into W
        numbers = contacts.numbers[r]
        record.gaps[t, r] = numbers[ROW_GAP]
        b = contacts.ids[r, FIRST_BODY]
        angle = state.q[b, 2] + h * state.twist[b, 2]
        c = cos(angle)
        s = sin(angle)
        nx = numbers[ROW_NX]
        ny = numbers[ROW_NY]
        normal = contacts.lam[r, 0]
        tangential = contacts.lam[r, 1]
        fx = nx * normal - ny * tangential
        fy = ny * normal + nx * tangential
        record.forces[t, r, 0] = c * fx - s * fy
        record.forces[t, r, 1] = s * fx + c * fy
        x = state.q[b, 0] + ahead * shift[b, 0]
        y = state.q[b, 1] + ahead * shift[b, 1]
        cx = numbers[ROW_CX]
        cy = numbers[ROW_CY]
        record.points[t, r, 0] = x + c * cx - s * cy
        record.points[t, r, 1] = y + s * cx + c * cy


@kernel(allocates=False)
def _record_columns(J, row, S):
    """Writes the variations of the poses to J[row] where row >= 0."""
    if row < 0:
        return
    for b in range(J.shape[1]):
        for i in range(3):
            for column in range(J.shape[3]):
                J[row, b, i, column] = S[3 * b + i, column]

"""Short pushes of a learned object by a finger that goes from place to place, compiled.

The finger is a disc, or another shape, which goes with its place and its angle. Each push is a
rollout of a few steps, quasi-static: of `dynamics.kernels.rollout` under a disc, and of
`dynamics.kernels.scene.rollout` under another shape. It is nothing at all where the finger is too
far away to touch. `measure_room` says how near object and finger come to what they must not touch.
`push_search` plans with both; `pose_track` carries late poses on.
"""

from math import cos, hypot, sin
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.walk_round import calc_distance2
from gridpush_drake.dynamics.kernels.inputs import Load, make_steps, take_first_steps
from gridpush_drake.dynamics.kernels.numba_internals import BORROWED_OPTIONS, get_record_class
from gridpush_drake.dynamics.kernels.rollout import rollout
from gridpush_drake.dynamics.kernels.scene.records import (
    PusherPath,
    make_body_states,
    make_contacts,
    make_scene_record,
)
from gridpush_drake.dynamics.kernels.scene.rollout import rollout_scene
from gridpush_drake.dynamics.kernels.step_memory import MEMORY_SIZE, MIN_MOVING_STEPS

X, Y, THETA, VX, VY, W, TIP_X, TIP_Y, TIP_YAW, MEMORY = range(10)
"""Places in a state: the object's pose, m and rad; its last velocity, by the finger's path; the
finger's center, m, and its angle, rad; and, from MEMORY on, what the solver remembers
(`kernels.step_memory`). Under a shape that is no disc the last velocity is the object's twist in
the frame of the last step, and MEMORY begins with the loads' tilt and friction."""

STATE_SIZE = MEMORY + MEMORY_SIZE
"""Numbers of a state."""

MAX_SUBSTEPS = 16
"""Most steps of the rollout in a decision."""

STILL_FINGER_DISTANCE = 1e-9
"""A finger that moves less than this in a decision rests, m."""


class PushedModel(NamedTuple):
    """A model of the object under a disc, as `kernel_call.prepare_rollout` makes it.

    Attributes:
        law, body, support, edges, scheme: the first arguments of `rollout`, quasi-static.
        reach: distance of the farthest corner from the body frame's origin, m.
        radius: of the finger, m.
        step: length of the finger's path in a step of the rollout, m.
    """

    law: Any
    body: Any
    support: Any
    edges: Any
    scheme: Any
    reach: Any
    radius: Any
    step: Any


class ShapedModel(NamedTuple):
    """A model of the object under a shape that is no disc.

    Attributes:
        bodies, support, tolerances: arguments of `rollout_scene`, for one body.
        tool: the finger's shape, `Tool`.
        edges: the object's outline.
        reach: distance of the farthest corner from the body frame's origin, m.
        radius: of the circle about the finger's center that holds all of it, m.
        step: length of the finger's path in a step of the rollout, m.
        contacts: greatest number of contacts for which there is room.
    """

    bodies: Any
    support: Any
    tolerances: Any
    tool: Any
    edges: Any
    reach: Any
    radius: Any
    step: Any
    contacts: Any


class FreeSpace(NamedTuple):
    """Where object and finger may be: fields of how far a point is from what is forbidden.

    Attributes:
        bounded: whether anything is forbidden at all.
        low: (2,) the first node of both fields, W, m.
        spacing: of the nodes, m.
        object_field: (K, L) by how much more a point of the object may move at each node, m.
        finger_field: (K, L) the same for the finger's center.
        points: (P, 2) points round the object, body frame, m.
    """

    bounded: Any
    low: Any
    spacing: Any
    object_field: Any
    finger_field: Any
    points: Any


class Bench(NamedTuple):
    """Memory of the search.

    Attributes:
        work: memory of a rollout, `DiscWork` or `ShapeWork`.
        at: (2,) of `find_way`.
        targets: (T, D) places of the candidate: x, y, m, and the angle, rad, of a shape.
        states: (T + 1, STATE_SIZE) its states.
    """

    work: Any
    at: Any
    targets: Any
    states: Any


class DiscWork(NamedTuple):
    """Memory of a rollout under a disc: arguments of `rollout`."""

    tip: Any
    wrench: Any
    point: Any
    dts: Any
    rows: Any
    record: Any
    J: Any
    memory: Any


class ShapeWork(NamedTuple):
    """Memory of a rollout under a shape: arguments of `rollout_scene`, and of its pusher's path."""

    tip: Any
    yaw: Any
    variations: Any
    dts: Any
    rows: Any
    record: Any
    J: Any
    state: Any
    contacts: Any


_make_states = kernel()(make_body_states)
_make_contacts = kernel()(make_contacts)
_make_scene_steps = kernel()(make_scene_record)


@kernel()
def _make_disc_work(model):
    """Makes the memory of a rollout under a disc."""
    n = MAX_SUBSTEPS
    return DiscWork(
        tip=np.zeros((n + 1, 2)),
        wrench=np.zeros((n, 3)),
        point=np.zeros(2),
        dts=np.zeros(n),
        rows=np.full(n + 1, -1),
        record=make_steps(n),
        J=np.empty((0, 3, 0)),
        memory=np.zeros(MEMORY_SIZE),
    )


@kernel()
def _make_shape_work(model):
    """Makes the memory of a rollout under a shape."""
    n = MAX_SUBSTEPS
    return ShapeWork(
        tip=np.zeros((n + 1, 2)),
        yaw=np.zeros(n + 1),
        variations=np.zeros((0, n + 1, 3)),
        dts=np.zeros(n),
        rows=np.full(n + 1, -1),
        record=_make_scene_steps(n, 1, model.contacts),
        J=np.empty((0, 1, 3, 0)),
        state=_make_states(1),
        contacts=_make_contacts(model.contacts),
    )


@kernel()
def make_bench(model, decisions, coordinates):
    """Makes the memory of a search over so many decisions, each of so many coordinates."""
    return Bench(
        work=make_push_work(model),
        at=np.zeros(2),
        targets=np.zeros((decisions, coordinates)),
        states=np.zeros((decisions + 1, STATE_SIZE)),
    )


@kernel(allocates=False)
def _is_near(model, state, reach):
    """Whether the finger's center is within a distance of the outline, m."""
    dx = state[TIP_X] - state[X]
    dy = state[TIP_Y] - state[Y]
    if dx * dx + dy * dy > (model.reach + reach) ** 2:
        return False
    c = cos(state[THETA])
    s = sin(state[THETA])
    px = c * dx + s * dy
    py = c * dy - s * dx
    edges = model.edges
    inside = False
    for i in range(edges.ax.shape[0]):
        ax = edges.ax[i]
        ay = edges.ay[i]
        bx = edges.bx[i]
        by = edges.by[i]
        if calc_distance2(ax, ay, bx, by, px, py) < reach * reach:
            return True
        # by how often a ray crosses the outline
        if (ay > py) != (by > py) and px < ax + (py - ay) / (by - ay) * (bx - ax):
            inside = not inside
    return inside


@kernel()
def advance_push(model, bench, state, target):
    """Moves finger and object evenly to the finger's place; changes the state (STATE_SIZE,).

    Args:
        model: `PushedModel`, or `ShapedModel`.
        bench: `Bench`.
        state: (STATE_SIZE,) changed.
        target: (D,) the place: x, y, m, and the angle, rad, of a shape.
    """
    length = hypot(target[0] - state[TIP_X], target[1] - state[TIP_Y])
    turn = target[2] - state[TIP_YAW] if target.shape[0] > 2 else 0.0
    # the way of the point that is farthest from the finger's center
    way = length + model.radius * abs(turn)
    if way < STILL_FINGER_DISTANCE:
        return
    if _is_near(model, state, model.radius + way):
        n = min(int(way / model.step) + 1, MAX_SUBSTEPS)
        push_object(model, bench.work, state, target[0], target[1], turn, way, n)
    else:
        for i in range(VX, W + 1):
            state[i] = 0.0
        for i in range(MEMORY, STATE_SIZE):
            state[i] = 0.0
    state[TIP_X] = target[0]
    state[TIP_Y] = target[1]
    state[TIP_YAW] += turn


@kernel()
def _push_by_disc(model, work, state, to_x, to_y, turn, way, n):
    """Simulates n steps of a disc's way to a place, m."""
    dx = to_x - state[TIP_X]
    dy = to_y - state[TIP_Y]
    for k in range(n + 1):
        work.tip[k, 0] = state[TIP_X] + dx * k / n
        work.tip[k, 1] = state[TIP_Y] + dy * k / n
    for k in range(n):
        work.dts[k] = way / n
    for i in range(MEMORY_SIZE):
        work.memory[i] = state[MEMORY + i]
    record = take_first_steps(work.record, n)
    load = Load(
        tip=work.tip[: n + 1],
        path_length=way,
        radius=model.radius,
        wrench=work.wrench[:n],
        point=work.point,
    )
    rollout(
        model.law,
        model.body,
        model.support,
        model.edges,
        model.scheme,
        load,
        state[X : THETA + 1],
        state[VX : W + 1],
        work.dts[:n],
        work.rows[: n + 1],
        record,
        work.J,
        work.memory,
    )
    for i in range(3):
        state[X + i] = record.poses[n, i]
        state[VX + i] = record.velocities[n, i]
    for i in range(MEMORY_SIZE):
        state[MEMORY + i] = work.memory[i]


@kernel()
def _push_by_shape(model, work, state, to_x, to_y, turn, way, n):
    """Simulates n steps of a shape's way to a place, m, in which it turns, rad.

    Of the step before, its twist is remembered, and the loads' tilt and friction.
    """
    dx = to_x - state[TIP_X]
    dy = to_y - state[TIP_Y]
    for k in range(n + 1):
        work.tip[k, 0] = state[TIP_X] + dx * k / n
        work.tip[k, 1] = state[TIP_Y] + dy * k / n
        work.yaw[k] = state[TIP_YAW] + turn * k / n
    for k in range(n):
        work.dts[k] = way / n
    body = work.state
    moved = False
    for i in range(3):
        body.q[0, i] = state[X + i]
        body.twist[0, i] = state[VX + i]
        body.before[0, i] = state[VX + i]
        moved = moved or state[VX + i] != 0.0
    body.moved[0] = MIN_MOVING_STEPS if moved else 0
    for i in range(2):
        body.tilt[i] = state[MEMORY + i]
        body.friction[i] = state[MEMORY + 2 + i]
    work.contacts.counts[0] = 0
    path = PusherPath(
        tip=work.tip,
        yaw=work.yaw,
        path_length=way,
        tool=model.tool,
        variations=work.variations,
    )
    rollout_scene(
        model.bodies,
        model.support,
        path,
        model.tolerances,
        body,
        work.contacts,
        work.dts[:n],
        work.rows,
        work.record,
        work.J,
    )
    for i in range(3):
        state[X + i] = body.q[0, i]
        state[VX + i] = body.twist[0, i]
    for i in range(2):
        state[MEMORY + i] = body.tilt[i]
        state[MEMORY + 2 + i] = body.friction[i]


def make_push_work(model):
    """Makes the memory of a rollout under the model's finger; compiled code only."""
    raise NotImplementedError


def push_object(model, work, state, to_x, to_y, turn, way, n):
    """Pushes the object on the finger's way to a place; compiled code only.

    Args:
        model: `PushedModel`, or `ShapedModel`, which decides what is called.
        work: `DiscWork`, or `ShapeWork`.
        state: (STATE_SIZE,) of which the object's part is changed.
        to_x, to_y: the place, m.
        turn: by how much the finger turns, rad.
        way: length of the way, m.
        n: steps.
    """
    raise NotImplementedError


@overload(make_push_work, jit_options=BORROWED_OPTIONS)
def _make_push_work(model):
    call = _make_shape_work if get_record_class(model) is ShapedModel else _make_disc_work
    return lambda model: call(model)


@overload(push_object, jit_options=BORROWED_OPTIONS)
def _push_object(model, work, state, to_x, to_y, turn, way, n):
    call = _push_by_shape if get_record_class(model) is ShapedModel else _push_by_disc
    return lambda model, work, state, to_x, to_y, turn, way, n: call(
        model, work, state, to_x, to_y, turn, way, n
    )


@kernel(allocates=False)
def _look_up(room, field, x, y):
    """Interpolates a field at a point; infinite beyond its nodes."""
    u = (x - room.low[0]) / room.spacing
    v = (y - room.low[1]) / room.spacing
    if not (0.0 <= u < field.shape[0] - 1 and 0.0 <= v < field.shape[1] - 1):
        return np.inf
    i = int(u)
    j = int(v)
    a = u - i
    b = v - j
    low = (1.0 - b) * field[i, j] + b * field[i, j + 1]
    high = (1.0 - b) * field[i + 1, j] + b * field[i + 1, j + 1]
    return (1.0 - a) * low + a * high


@kernel(allocates=False)
def measure_room(room, state):
    """Measures by how much more object and finger may move in a state, m; both at most."""
    if not room.bounded:
        return np.inf, np.inf
    c = cos(state[THETA])
    s = sin(state[THETA])
    least = np.inf
    for i in range(room.points.shape[0]):
        px = room.points[i, 0]
        py = room.points[i, 1]
        x = state[X] + c * px - s * py
        y = state[Y] + s * px + c * py
        least = min(least, _look_up(room, room.object_field, x, y))
    return least, _look_up(room, room.finger_field, state[TIP_X], state[TIP_Y])


@kernel()
def follow_tip(model, state, tips):
    """Moves the object along a path of the finger, (K, D); changes the state (STATE_SIZE,)."""
    bench = make_bench(model, 0, tips.shape[1])
    for k in range(tips.shape[0]):
        advance_push(model, bench, state, tips[k])

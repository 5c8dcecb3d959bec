"""Short pushes of a learned object by a finger that goes from place to place, compiled.

Each of them is a rollout of `dynamics.kernels.rollout` of a few steps, quasi-static, or nothing at
all where the finger is too far away to touch. `measure_room` says how near object and finger come
to what they must not touch. `push_search` plans with both; `pose_track` carries late poses on.
"""

from math import cos, hypot, sin
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.walk_round import calc_distance2
from gridpush_drake.dynamics.kernels.inputs import Load, make_steps, take_first_steps
from gridpush_drake.dynamics.kernels.rollout import rollout
from gridpush_drake.dynamics.kernels.step_memory import MEMORY_SIZE

X, Y, THETA, VX, VY, W, TIP_X, TIP_Y, MEMORY = range(9)
"""Places in a state: the object's pose, m and rad; its last velocity, by the finger's path; the
finger's center, m; and, from MEMORY on, what the solver remembers (`kernels.step_memory`)."""

STATE_SIZE = MEMORY + MEMORY_SIZE
"""Numbers of a state."""

MAX_SUBSTEPS = 16
"""Most steps of the rollout in a decision."""

STILL_FINGER_DISTANCE = 1e-9
"""A finger that moves less than this in a decision rests, m."""


class PushedModel(NamedTuple):
    """A model of the object, as `kernel_call.prepare_rollout` makes it.

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
        tip, wrench, point, dts, rows, record, J, memory: arguments of `rollout`.
        at: (2,) of `find_way`.
        targets: (T, 2) places of the candidate.
        states: (T + 1, STATE_SIZE) its states.
    """

    tip: Any
    wrench: Any
    point: Any
    dts: Any
    rows: Any
    record: Any
    J: Any
    memory: Any
    at: Any
    targets: Any
    states: Any


@kernel()
def make_bench(decisions):
    """Makes the memory of a search over so many decisions."""
    n = MAX_SUBSTEPS
    return Bench(
        tip=np.zeros((n + 1, 2)),
        wrench=np.zeros((n, 3)),
        point=np.zeros(2),
        dts=np.zeros(n),
        rows=np.full(n + 1, -1),
        record=make_steps(n),
        J=np.empty((0, 3, 0)),
        memory=np.zeros(MEMORY_SIZE),
        at=np.zeros(2),
        targets=np.zeros((decisions, 2)),
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
def advance_push(model, bench, state, to_x, to_y):
    """Moves finger and object evenly to the finger's place; changes the state (STATE_SIZE,)."""
    dx = to_x - state[TIP_X]
    dy = to_y - state[TIP_Y]
    length = hypot(dx, dy)
    if length < STILL_FINGER_DISTANCE:
        return
    if not _is_near(model, state, model.radius + length):
        for i in range(VX, W + 1):
            state[i] = 0.0
        for i in range(MEMORY, STATE_SIZE):
            state[i] = 0.0
        state[TIP_X] = to_x
        state[TIP_Y] = to_y
        return
    n = min(int(length / model.step) + 1, MAX_SUBSTEPS)
    for k in range(n + 1):
        bench.tip[k, 0] = state[TIP_X] + dx * k / n
        bench.tip[k, 1] = state[TIP_Y] + dy * k / n
    for k in range(n):
        bench.dts[k] = length / n
    for i in range(MEMORY_SIZE):
        bench.memory[i] = state[MEMORY + i]
    record = take_first_steps(bench.record, n)
    load = Load(
        tip=bench.tip[: n + 1],
        path_length=length,
        radius=model.radius,
        wrench=bench.wrench[:n],
        point=bench.point,
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
        bench.dts[:n],
        bench.rows[: n + 1],
        record,
        bench.J,
        bench.memory,
    )
    for i in range(3):
        state[X + i] = record.poses[n, i]
        state[VX + i] = record.velocities[n, i]
    state[TIP_X] = to_x
    state[TIP_Y] = to_y
    for i in range(MEMORY_SIZE):
        state[MEMORY + i] = bench.memory[i]


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
    """Moves the object along a path of the finger, (K, 2); changes the state (STATE_SIZE,)."""
    bench = make_bench(0)
    for k in range(tips.shape[0]):
        advance_push(model, bench, state, tips[k, 0], tips[k, 1])

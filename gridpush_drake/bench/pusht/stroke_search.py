"""Searches for a sequence of targets that brings a block to its goal, compiled.

A plan is a sequence of targets of the disc, one a decision. A candidate is made from the best plan
known by replacing its end with a *stroke* (go round the block to a place of its outline, and push
there), or by shifting some of its targets a little. Each candidate is simulated with the law of
`dynamics.kernels.steering.driven_disc`, and cut where its cost

    J = per_decision · (decisions made) + (cost-to-go of the pose then)

is least. The cost-to-go is per_coverage · (1 - coverage) once the goal is reached, where the
episode ends, and base + per_root · (distance from the goal)^1/2 elsewhere. A stroke's LENGTH is how
far the target leads the disc while it pushes; WALK is how many times as far away as the next point
of the way round the target is set. What this search shares with `push_search` is in
`dynamics.kernels.steering.plan_search`.

`docs/theory/feedback.md` has the equations, and `feedback_controller` the choice of the candidates.
"""

from math import cos, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.steering.driven_disc import (
    CONTACT_SIZE,
    MAX_CONTACTS,
    PX,
    PY,
    STATE_SIZE,
    THETA,
    X,
    Y,
    advance_disc,
    set_velocity,
)
from gridpush_drake.dynamics.kernels.steering.plan_search import (
    BEND,
    LENGTH,
    WALK,
    aim_primitive,
    begin_window,
    find_cut,
    keep_plan,
    shift_places,
    take_plan,
    walk_to_aim,
)

PATIENCE = 4
"""Decisions that a stroke goes on for without getting better, once it pushes."""


class Task(NamedTuple):
    """Where the block is wanted, and what a plan costs. Costs are in decisions.

    Attributes:
        goal: (3,) pose of the block.
        arm: radius of gyration of the block's area.
        middle: (2,) the area's centroid, body frame.
        area: of the block.
        success: coverage above which an episode ends.
        per_coverage: cost of what is not covered when it ends.
        near: distance of the centroid from the goal's beyond which no coverage is calculated.
        base: cost-to-go of a pose next to the goal.
        per_root: cost-to-go for the square root of the distance from the goal.
        per_decision: cost of a decision, 1 or less.
        low: least target of the disc, along both axes.
        high: greatest target.
    """

    goal: Any
    arm: Any
    middle: Any
    area: Any
    success: Any
    per_coverage: Any
    near: Any
    base: Any
    per_root: Any
    per_decision: Any
    low: Any
    high: Any


@kernel(allocates=False)
def _clip_area(parts, first, c, s, x, y, second, room):
    """Area that two of the parts have in common, `first` being turned and moved.

    Sutherland and Hodgman's clipping.
    """
    count = parts.shape[1]
    size = count
    for i in range(count):
        px = parts[first, i, 0]
        py = parts[first, i, 1]
        room[0, i, 0] = c * px - s * py + x
        room[0, i, 1] = s * px + c * py + y
    here = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        ax = parts[second, i, 0]
        ay = parts[second, i, 1]
        ex = parts[second, j, 0] - ax
        ey = parts[second, j, 1] - ay
        there = 1 - here
        kept = 0
        for k in range(size):
            m = k + 1 if k + 1 < size else 0
            qx = room[here, k, 0]
            qy = room[here, k, 1]
            rx = room[here, m, 0]
            ry = room[here, m, 1]
            q = ex * (qy - ay) - ey * (qx - ax)
            r = ex * (ry - ay) - ey * (rx - ax)
            if q >= 0.0:
                room[there, kept, 0] = qx
                room[there, kept, 1] = qy
                kept += 1
            if (q >= 0.0) != (r >= 0.0):
                fraction = q / (q - r)
                room[there, kept, 0] = qx + fraction * (rx - qx)
                room[there, kept, 1] = qy + fraction * (ry - qy)
                kept += 1
        size = kept
        here = there
        if size < 3:
            return 0.0
    area = 0.0
    for k in range(size):
        m = k + 1 if k + 1 < size else 0
        area += room[here, k, 0] * room[here, m, 1] - room[here, m, 0] * room[here, k, 1]
    return 0.5 * area


@kernel(allocates=False)
def _calc_coverage(block, task, x, y, theta, room):
    """Fraction of the goal that the block covers at a pose."""
    # the block's pose in the goal's frame
    c = cos(task.goal[2])
    s = sin(task.goal[2])
    dx = x - task.goal[0]
    dy = y - task.goal[1]
    px = c * dx + s * dy
    py = c * dy - s * dx
    cr = cos(theta - task.goal[2])
    sr = sin(theta - task.goal[2])
    area = 0.0
    for i in range(block.parts.shape[0]):
        for j in range(block.parts.shape[0]):
            area += _clip_area(block.parts, i, cr, sr, px, py, j, room)
    return area / task.area


@kernel()
def calc_coverage(block, task, pose):
    """Fraction of the goal that the block covers at a pose (3,)."""
    room = np.empty((2, 2 * block.parts.shape[1] + 2, 2))
    return _calc_coverage(block, task, pose[0], pose[1], pose[2], room)


@kernel(allocates=False)
def _calc_distance2(task, x, y, theta):
    """Mean squared distance of the block's points from where they are at the goal."""
    c = cos(theta)
    s = sin(theta)
    cg = cos(task.goal[2])
    sg = sin(task.goal[2])
    mx = task.middle[0]
    my = task.middle[1]
    dx = x + c * mx - s * my - (task.goal[0] + cg * mx - sg * my)
    dy = y + s * mx + c * my - (task.goal[1] + sg * mx + cg * my)
    return dx * dx + dy * dy + 2.0 * task.arm * task.arm * (1.0 - c * cg - s * sg)


@kernel(allocates=False)
def _rate(block, task, state, room):
    """Cost-to-go of a state, and whether the episode ends there."""
    distance2 = _calc_distance2(task, state[X], state[Y], state[THETA])
    if distance2 < task.near * task.near:
        coverage = _calc_coverage(block, task, state[X], state[Y], state[THETA], room)
        if coverage > task.success:
            return task.per_coverage * (1.0 - coverage), True
    return task.base + task.per_root * sqrt(sqrt(distance2)), False


class Candidates(NamedTuple):
    """What the search tries.

    Attributes:
        strokes: (N, STROKE) strokes, N at least 1.
        cuts: (N,) fraction of the plan, 0 to 1, that is kept before each of them.
        changes: (K, CHANGE) shifts of targets.
        scales: (K,) their sizes.
    """

    strokes: Any
    cuts: Any
    changes: Any
    scales: Any


class Room(NamedTuple):
    """Memory of the search.

    Attributes:
        contacts: (MAX_CONTACTS, CONTACT_SIZE) of `set_velocity`.
        nearest: (2,) likewise.
        clip: (2, C, 2) of `_clip_area`.
        targets: (T, 2) targets of the candidate.
        states: (T + 1, STATE_SIZE) its states.
    """

    contacts: Any
    nearest: Any
    clip: Any
    targets: Any
    states: Any


@kernel(allocates=False)
def _step_candidate(block, task, room, k):
    """Makes the k-th decision of the candidate.

    Returns its cost if it ended then, and whether the episode is over.
    """
    for i in range(STATE_SIZE):
        room.states[k + 1, i] = room.states[k, i]
    state = room.states[k + 1]
    room.targets[k, 0] = min(max(room.targets[k, 0], task.low), task.high)
    room.targets[k, 1] = min(max(room.targets[k, 1], task.low), task.high)
    advance_disc(block, state, room.targets[k, 0], room.targets[k, 1], room.contacts, room.nearest)
    to_go, over = _rate(block, task, state, room.clip)
    return task.per_decision * (k + 1) + to_go, over


@kernel(allocates=False)
def _roll_plan(block, task, room, first, length):
    """Follows the candidate's targets from `first` on.

    Returns its least cost and the number of decisions with which it is reached.
    """
    best = np.inf
    end = first
    for k in range(first, length):
        cost, over = _step_candidate(block, task, room, k)
        if cost < best:
            best = cost
            end = k + 1
        if over:
            break
    return best, end


@kernel(allocates=False)
def _roll_primitive(block, task, ways, room, first, limit, primitive):
    """Makes a stroke from `first` on, and fills its targets; returns as `_roll_plan`."""
    best = np.inf
    end = first
    aim = aim_primitive(ways, primitive)
    pushing = aim.pushing
    heading = aim.heading
    pushed = 0
    for k in range(first, limit):
        state = room.states[k]
        px = state[PX]
        py = state[PY]
        if not pushing:
            pushing = walk_to_aim(
                ways, primitive, aim, state[X], state[Y], state[THETA], px, py, room.nearest
            )
        if not pushing:
            # on the way round: the target lies beyond the next point, so that the disc is fast
            room.targets[k, 0] = px + primitive[WALK] * (room.nearest[0] - px)
            room.targets[k, 1] = py + primitive[WALK] * (room.nearest[1] - py)
        else:
            angle = state[THETA] + heading
            room.targets[k, 0] = px + primitive[LENGTH] * cos(angle)
            room.targets[k, 1] = py + primitive[LENGTH] * sin(angle)
            heading += primitive[BEND]
            pushed += 1
        cost, over = _step_candidate(block, task, room, k)
        if cost < best:
            best = cost
            end = k + 1
        if over or (pushed >= PATIENCE and k + 1 - end > PATIENCE):
            break
    return best, end


@kernel(allocates=False)
def _roll_change(block, task, room, plan, length, change, scale, kind):
    """Shifts targets within a window of the plan, and follows it from there.

    Every other candidate is one decision longer than the plan, and repeats the last target.

    Returns:
        As `_roll_plan`, and the first decision that was changed.
    """
    first = begin_window(kind, length)
    stop = min(length + kind % 2, plan.targets.shape[0])
    take_plan(room, plan, first, length)
    for k in range(length, stop):
        room.targets[k, 0] = plan.targets[length - 1, 0]
        room.targets[k, 1] = plan.targets[length - 1, 1]
    shift_places(room.targets, change, scale, first, stop)
    cost, end = _roll_plan(block, task, room, first, stop)
    return cost, end, first


@kernel()
def search(block, task, ways, plan, length, candidates):
    """Improves a plan, first by strokes that replace its end, then by small changes.

    Args:
        block: the block.
        task: what is wanted, and what it costs.
        ways: where the block can be touched.
        plan: the plan, changed in place. Of its states the first is given, without the block's
            velocity; the others are filled.
        length: decisions of the plan given; 0 for none.
        candidates: what to try.

    Returns:
        The cost of the plan, its decisions, and the cost-to-go of the first state.
    """
    limit = plan.targets.shape[0]
    room = Room(
        contacts=np.empty((MAX_CONTACTS, CONTACT_SIZE)),
        nearest=np.empty(2),
        clip=np.empty((2, 2 * block.parts.shape[1] + 2, 2)),
        targets=np.empty((limit, 2)),
        states=np.empty((limit + 1, STATE_SIZE)),
    )
    set_velocity(block, plan.states[0], room.contacts, room.nearest)
    to_go, _ = _rate(block, task, plan.states[0], room.clip)
    best = np.inf
    # The plan of the decision before, from where the block really is.
    if length > 0:
        take_plan(room, plan, 0, length)
        best, end = _roll_plan(block, task, room, 0, length)
        keep_plan(room, plan, 0, end)
        length = end
    # Strokes, after some of the plan or at once.
    for n in range(candidates.strokes.shape[0]):
        first = find_cut(candidates.cuts[n], length, limit)
        take_plan(room, plan, first, first)
        cost, end = _roll_primitive(block, task, ways, room, first, limit, candidates.strokes[n])
        if cost < best:
            best = cost
            keep_plan(room, plan, first, end)
            length = end
    # Small changes of the best of them.
    for n in range(candidates.changes.shape[0]):
        change = candidates.changes[n]
        scale = candidates.scales[n]
        cost, end, first = _roll_change(block, task, room, plan, length, change, scale, n)
        if cost < best:
            best = cost
            keep_plan(room, plan, first, end)
            length = end
    return best, length, to_go

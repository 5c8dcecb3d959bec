"""Searches for a path of the finger that makes a learned object follow what is wanted, compiled.

A plan is a sequence of places of the finger's center, one a decision, in W; of a finger that is no
disc each comes with an angle. Between two of them the finger moves evenly, and the object moves as
the learned model of its cells says: each decision is a short rollout, see
`dynamics.kernels.steering.finger_push`. A candidate is made from the best plan known by
replacing its end with a *stroke* (go round the object to a place of its outline, and push there),
or by shifting some of its places a little. Candidates whose object or finger comes too near to
something cost infinitely much. A stroke's LENGTH and WALK are how far the finger goes in a decision
while it pushes and on its way round, m. A finger that is no disc turns to face the outline on its
way round, comes near, and then pushes. What any search for plans shares is in
`dynamics.kernels.steering.plan_search`.

What a plan costs is in `docs/theory/feedback.md`, section 7; `push_follower` chooses the
candidates.
"""

from math import cos, hypot, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    STILL_FINGER_DISTANCE,
    THETA,
    TIP_X,
    TIP_Y,
    TIP_YAW,
    X,
    Y,
    advance_push,
    make_bench,
    measure_room,
)
from gridpush_drake.dynamics.kernels.steering.plan_search import (
    BEND,
    LENGTH,
    SPIN,
    WALK,
    Plan,
    aim_primitive,
    begin_window,
    find_cut,
    keep_plan,
    shift_places,
    take_plan,
    walk_to_aim,
)

MAX_STALL_STEPS = 6
"""Decisions that a stroke to a goal goes on for without getting better, once it pushes."""

NEAR_DISTANCE = 1e-3
"""A finger that is no disc pushes as soon as it is this near to where it comes near, m."""

FACING_ANGLE = 0.05
"""It comes near as soon as it faces the outline up to this angle, rad."""


class TrackingCost(NamedTuple):
    """What the object should do, and what a plan costs.

    Attributes:
        follows: whether a path is followed; otherwise a goal is to be reached.
        references: (T + 1, 3) where the cells' centroid should be, m, and the heading, rad, after
            so many decisions; of a goal each is the same.
        along: (T + 1, 2) unit vectors along the path there.
        weight_along: how much a distance along the path counts, against 1 of one beside it.
        weight_turn: how much a turn counts, times the radius of gyration.
        middle: (2,) the cells' centroid, body frame, m.
        arm: radius of gyration, m.
        position_tolerance: distance from the goal within which it is reached, m.
        angle_tolerance: turn from the goal within which it is reached, rad.
        per_decision: cost of a decision on the way to a goal.
        base: cost-to-go of a pose next to the goal, but not at it.
        per_length: cost-to-go for a distance from the goal, 1/m.
        per_root: cost-to-go for the square root of the distance from the goal.
        goal_fraction: fraction of the tolerances within which a plan ends.
    """

    follows: Any
    references: Any
    along: Any
    weight_along: Any
    weight_turn: Any
    middle: Any
    arm: Any
    position_tolerance: Any
    angle_tolerance: Any
    per_decision: Any
    base: Any
    per_length: Any
    per_root: Any
    goal_fraction: Any


class PushMoves(NamedTuple):
    """What the search tries.

    Attributes:
        strokes: (N, PRIMITIVE_SIZE) strokes.
        cuts: (N,) fraction of the plan, 0 to 1, that is kept before each of them.
        changes: (K, CHANGE_POINTS D) shifts of places, whose angles are by the scale, rad/m.
        scales: (K,) their sizes, m.
        longest: farthest that the finger may go in a decision, m.
        turn: farthest that a finger that is no disc may turn in a decision, rad.
        most_yaw: greatest size of its angle, rad.
    """

    strokes: Any
    cuts: Any
    changes: Any
    scales: Any
    longest: Any
    turn: Any
    most_yaw: Any


@kernel(allocates=False)
def _calc_off(cost_terms, state, k):
    """How far the object is from the reference after k decisions: (dx, dy), m, and the turn."""
    c = cos(state[THETA])
    s = sin(state[THETA])
    dx = (
        state[X] + c * cost_terms.middle[0] - s * cost_terms.middle[1] - cost_terms.references[k, 0]
    )
    dy = (
        state[Y] + s * cost_terms.middle[0] + c * cost_terms.middle[1] - cost_terms.references[k, 1]
    )
    turn = state[THETA] - cost_terms.references[k, 2]
    turn -= 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5)
    return dx, dy, turn


@kernel(allocates=False)
def rate_goal(cost_terms, state):
    """Cost-to-go of a state on the way to a goal, and whether the goal is reached."""
    dx, dy, turn = _calc_off(cost_terms, state, 0)
    position2 = dx * dx + dy * dy
    # how far off in tolerances, and with it the chance that the goal will not have been reached
    off2 = position2 / (cost_terms.position_tolerance * cost_terms.position_tolerance)
    off2 += turn * turn / (cost_terms.angle_tolerance * cost_terms.angle_tolerance)
    missed = off2 / (1.0 + off2)
    distance = sqrt(position2 + 2.0 * cost_terms.arm * cost_terms.arm * (1.0 - cos(turn)))
    to_go = (
        cost_terms.base + cost_terms.per_length * distance + cost_terms.per_root * sqrt(distance)
    )
    return missed * to_go, off2 < cost_terms.goal_fraction * cost_terms.goal_fraction


@kernel(allocates=False)
def rate_path(cost_terms, state, k):
    """Squared distance, m², from the reference after k decisions."""
    dx, dy, turn = _calc_off(cost_terms, state, k)
    ahead = dx * cost_terms.along[k, 0] + dy * cost_terms.along[k, 1]
    beside = dy * cost_terms.along[k, 0] - dx * cost_terms.along[k, 1]
    turned = cost_terms.arm * turn
    return (
        beside * beside
        + cost_terms.weight_along * ahead * ahead
        + cost_terms.weight_turn * turned * turned
    )


@kernel()
def _step_candidate(model, cost_terms, room, bench, k, least):
    """Makes the k-th decision of the candidate; `least` (2,) is the room that it must keep.

    Returns:
        What it costs, or would cost if it ended then; and whether it is over.
    """
    for i in range(STATE_SIZE):
        bench.states[k + 1, i] = bench.states[k, i]
    state = bench.states[k + 1]
    advance_push(model, bench, state, bench.targets[k])
    object_room, finger_room = measure_room(room, state)
    if object_room < least[0] or finger_room < least[1]:
        return np.inf, True
    if cost_terms.follows:
        return rate_path(cost_terms, state, k + 1), False
    to_go, over = rate_goal(cost_terms, state)
    return cost_terms.per_decision * (k + 1) + to_go, over


@kernel(allocates=False)
def _limit(bench, k, moves):
    """Shortens the way to the k-th place to what the finger may go, and turn, in a decision."""
    x = bench.states[k, TIP_X]
    y = bench.states[k, TIP_Y]
    dx = bench.targets[k, 0] - x
    dy = bench.targets[k, 1] - y
    length = hypot(dx, dy)
    longest = moves.longest
    if length > longest:
        bench.targets[k, 0] = x + dx * longest / length
        bench.targets[k, 1] = y + dy * longest / length
    if bench.targets.shape[1] > 2:
        _limit_turn(bench.states[k, TIP_YAW], bench.targets[k], moves)


@kernel(allocates=False)
def _limit_turn(yaw, target, moves):
    """Limits the angle of a place (3,) to what a finger that is no disc may turn in a decision."""
    target[2] = yaw + min(max(target[2] - yaw, -moves.turn), moves.turn)
    # one that is turned too far already turns no farther
    most = max(moves.most_yaw, abs(yaw))
    target[2] = min(max(target[2], -most), most)


@kernel()
def _roll_plan(model, cost_terms, room, bench, first, length, least, moves, before):
    """Follows the candidate's places from `first` on, where what was before cost `before`.

    Returns its least cost and the number of decisions with which it is reached; of a path the cost
    and number of all.
    """
    best = np.inf
    end = first
    total = before
    for k in range(first, length):
        _limit(bench, k, moves)
        cost, over = _step_candidate(model, cost_terms, room, bench, k, least)
        if cost_terms.follows:
            total += cost
            end = k + 1
            if not total < np.inf:
                break
        elif cost < best:
            best = cost
            end = k + 1
        if over:
            break
    if cost_terms.follows:
        best = total
    return best, end


@kernel(allocates=False)
def _come_near(primitive, aim, period, state, moves, target):
    """Finds the next place of a finger that is no disc, before it pushes.

    Args:
        primitive: (PRIMITIVE_SIZE,) the stroke.
        aim: its `Aim`.
        period: angle after which the finger looks the same, rad.
        state: (STATE_SIZE,) now.
        moves: `PushMoves`.
        target: (3,) filled: the place where it comes near, as far as it gets; before it faces the
            outline, where it is.

    Returns:
        Whether it has come near already.
    """
    # the smallest turn after which it faces the outline, or the next one that the wrist can make
    yaw = state[TIP_YAW]
    off = state[THETA] + aim.yaw - yaw
    off -= period * np.floor(off / period + 0.5)
    if abs(yaw + off) > moves.most_yaw:
        off -= np.copysign(period, yaw + off)
    target[2] = yaw + off
    _limit_turn(yaw, target, moves)
    c = cos(state[THETA])
    s = sin(state[THETA])
    dx = state[X] + c * aim.near_x - s * aim.near_y - state[TIP_X]
    dy = state[Y] + s * aim.near_x + c * aim.near_y - state[TIP_Y]
    distance = hypot(dx, dy)
    is_facing = abs(off) < FACING_ANGLE
    if is_facing and distance < NEAR_DISTANCE:
        return True
    fraction = min(1.0, primitive[WALK] / distance) if is_facing else 0.0
    target[0] = state[TIP_X] + fraction * dx
    target[1] = state[TIP_Y] + fraction * dy
    return False


@kernel()
def _roll_primitive(
    model, cost_terms, room, ways, bench, first, limit, primitive, least, moves, before
):
    """Makes a stroke from `first` on, and fills its places; returns as `_roll_plan`."""
    best = np.inf
    end = first
    total = before
    aim = aim_primitive(ways, primitive)
    walking = not aim.pushing
    coming = ways.comes_near and walking
    heading = aim.heading
    pushed = 0
    for k in range(first, limit):
        state = bench.states[k]
        tip_x = state[TIP_X]
        tip_y = state[TIP_Y]
        target = bench.targets[k]
        if coming and _come_near(primitive, aim, ways.period, state, moves, target):
            coming = False
            walking = False
        if walking:
            walking = not walk_to_aim(
                ways, primitive, aim, state[X], state[Y], state[THETA], tip_x, tip_y, bench.at
            )
        if walking:
            # on the way round, no farther than the finger goes in a decision
            dx = bench.at[0] - tip_x
            dy = bench.at[1] - tip_y
            fraction = min(1.0, primitive[WALK] / max(hypot(dx, dy), STILL_FINGER_DISTANCE))
            target[0] = tip_x + fraction * dx
            target[1] = tip_y + fraction * dy
        elif not coming:
            # the direction is held in the body frame, which turns
            angle = state[THETA] + heading
            target[0] = tip_x + primitive[LENGTH] * cos(angle)
            target[1] = tip_y + primitive[LENGTH] * sin(angle)
            if ways.comes_near:
                target[2] = state[TIP_YAW] + primitive[SPIN]
                _limit_turn(state[TIP_YAW], target, moves)
            heading += primitive[BEND]
            pushed += 1
        cost, over = _step_candidate(model, cost_terms, room, bench, k, least)
        if cost_terms.follows:
            total += cost
            end = k + 1
            if not total < np.inf:
                break
        elif cost < best:
            best = cost
            end = k + 1
        if over or (
            not cost_terms.follows and pushed >= MAX_STALL_STEPS and k + 1 - end > MAX_STALL_STEPS
        ):
            break
    if cost_terms.follows:
        best = total
    return best, end


@kernel(allocates=False)
def _cost_before(cost_terms, plan, first):
    """What the first decisions of the plan cost, on a path."""
    total = 0.0
    if cost_terms.follows:
        for k in range(first):
            total += rate_path(cost_terms, plan.states[k + 1], k + 1)
    return total


@kernel()
def search_push(model, cost_terms, room, ways, plan, length, candidates):
    """Improves a plan, first by strokes that replace its end, then by small changes.

    Args:
        model: the object, as it is learned.
        cost_terms: what the object should do.
        room: where object and finger may be.
        ways: where the object can be touched.
        plan: the plan, changed in place. Of its states the first is given; the others are filled.
        length: decisions of the plan given; 0 for none.
        candidates: what to try.

    Returns:
        The cost of the plan, its decisions, and the cost-to-go of the first state; on a path 0.
    """
    to_go = 0.0
    if not cost_terms.follows:
        to_go, _ = rate_goal(cost_terms, plan.states[0])
    limit = plan.targets.shape[0]
    size = plan.targets.shape[1]
    bench = make_bench(model, limit, size)
    # What is too near already may not come nearer still.
    least = np.zeros(2)
    least[0], least[1] = measure_room(room, plan.states[0])
    for i in range(2):
        least[i] = min(least[i] - STILL_FINGER_DISTANCE, 0.0)
    best = np.inf
    # The plan of the decision before, from where the object really is.
    if length > 0:
        take_plan(bench, plan, 0, length)
        if cost_terms.follows:
            for k in range(length, limit):
                for j in range(size):
                    step = bench.targets[length - 1, j] - bench.targets[max(length - 2, 0), j]
                    bench.targets[k, j] = bench.targets[length - 1, j] + step * (k + 1 - length)
            length = limit
        best, end = _roll_plan(model, cost_terms, room, bench, 0, length, least, candidates, 0.0)
        keep_plan(bench, plan, 0, end)
        length = end
    # Strokes, after some of the plan or at once.
    for n in range(candidates.strokes.shape[0]):
        first = find_cut(candidates.cuts[n], length, limit)
        take_plan(bench, plan, first, first)
        primitive = candidates.strokes[n]
        before = _cost_before(cost_terms, plan, first)
        cost, end = _roll_primitive(
            model, cost_terms, room, ways, bench, first, limit, primitive, least, candidates, before
        )
        if cost < best:
            best = cost
            keep_plan(bench, plan, first, end)
            length = end
    # Small changes of the best of them.
    for n in range(candidates.changes.shape[0]):
        if length == 0:
            break
        cost, end, first = _roll_change(
            model, cost_terms, room, bench, plan, length, candidates, n, least
        )
        if cost < best:
            best = cost
            keep_plan(bench, plan, first, end)
            length = end
    return best, length, to_go


@kernel()
def _roll_change(model, cost_terms, room, bench, plan, length, candidates, n, least):
    """Shifts places within a window of the plan, and follows it from there.

    Every other candidate for a goal is one decision longer than the plan, and goes on as it ended.

    Returns:
        As `_roll_plan`, and the first decision that was changed.
    """
    first = begin_window(n, length)
    stop = length if cost_terms.follows else min(length + n % 2, plan.targets.shape[0])
    take_plan(bench, plan, first, length)
    for k in range(length, stop):
        for j in range(bench.targets.shape[1]):
            bench.targets[k, j] = plan.targets[length - 1, j]
            if length > 1:
                bench.targets[k, j] += plan.targets[length - 1, j] - plan.targets[length - 2, j]
    shift_places(bench.targets, candidates.changes[n], candidates.scales[n], first, stop)
    before = _cost_before(cost_terms, plan, first)
    cost, end = _roll_plan(model, cost_terms, room, bench, first, stop, least, candidates, before)
    return cost, end, first


@kernel()
def roll_plans(model, cost_terms, room, start, targets, moves, states, costs):
    """Follows P plans from one state.

    Args:
        model, cost_terms, room: as of `search_push`.
        start: (STATE_SIZE,) state.
        targets: (P, T, D) places of the finger, changed where they are too far apart.
        moves: `PushMoves`, of which the farthest that the finger may go and turn counts.
        states: (P, T + 1, STATE_SIZE) filled.
        costs: (P,) filled: of a path, of all decisions; of a goal, the least.
    """
    limit = targets.shape[1]
    bench = make_bench(model, limit, targets.shape[2])
    least = np.zeros(2)
    least[0], least[1] = measure_room(room, start)
    for i in range(2):
        least[i] = min(least[i] - STILL_FINGER_DISTANCE, 0.0)
    for p in range(targets.shape[0]):
        plan = Plan(targets=targets[p], states=states[p])
        for i in range(STATE_SIZE):
            plan.states[0, i] = start[i]
        take_plan(bench, plan, 0, limit)
        costs[p], end = _roll_plan(model, cost_terms, room, bench, 0, limit, least, moves, 0.0)
        keep_plan(bench, plan, 0, end)
        for k in range(end, limit):
            for i in range(STATE_SIZE):
                plan.states[k + 1, i] = plan.states[end, i]


@kernel()
def check_moves(room, pose, moves, tips, margin, allowed):
    """Finds the moves (M, PARTS, 3) that are allowed from a pose (3,), and fills `allowed` (M,).

    A move is allowed if the object may be at all of its poses, with a margin, m, and the finger at
    its begin (M, 2).
    """
    state = np.zeros(STATE_SIZE)
    c = cos(pose[2])
    s = sin(pose[2])
    for m in range(moves.shape[0]):
        allowed[m] = True
        state[TIP_X] = pose[0] + c * tips[m, 0] - s * tips[m, 1]
        state[TIP_Y] = pose[1] + s * tips[m, 0] + c * tips[m, 1]
        for k in range(moves.shape[1]):
            state[X] = pose[0] + c * moves[m, k, 0] - s * moves[m, k, 1]
            state[Y] = pose[1] + s * moves[m, k, 0] + c * moves[m, k, 1]
            state[THETA] = pose[2] + moves[m, k, 2]
            object_room, finger_room = measure_room(room, state)
            if object_room < margin or finger_room < 0.0:
                allowed[m] = False
                break

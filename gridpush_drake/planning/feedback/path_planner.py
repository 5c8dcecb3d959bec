"""A path of an object among obstacles that a finger can push it along.

The planner searches over the object's poses by A*. From a pose it goes on by short pushes: a finger
that touches the outline at one of several places, at one of several angles, moves on by
MOVE_LENGTH. What these do to the object is simulated once by the learned model, in the body frame,
and holds at every pose, for the friction with the table does not depend on it. A move costs the
finger's way; a change to another place of the outline costs the way along the outline in addition.
What is still to go is estimated by `CostToGo`, which knows the obstacles, but takes the object for
one that slides freely.

The path ends at a pose near the goal, and then at the goal: the last bit is not a push that was
found, and is left to the controller (`push_follower`), as is whatever the path does not follow.
"""

from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    THETA,
    TIP_X,
    FreeSpace,
    X,
    follow_tip,
)
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, check_vector, compose, make_direction, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.feedback.follow_options import FOLLOW_REASONS, FollowStatus
from gridpush_drake.planning.feedback.pose_path import PosePath
from gridpush_drake.planning.feedback.push_search import check_moves
from gridpush_drake.planning.feedback.ways import make_outline_path
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import FeedbackFinger, SearchModel, make_model, make_room

MOVE_LENGTH = 0.03
"""Way of the finger in a move, m."""

POSES_PER_MOVE = 3
"""Poses of a move that are checked, and that are poses of the path, its end among them."""

PLACE_COUNT = 24
"""Places round the object where a move may touch."""

MOVE_ANGLES = (-0.5, -0.25, 0.0, 0.25, 0.5)
"""Angles of a move from the inward normal, rad."""

LEAST_MOVE = 0.3
"""Fraction of the finger's way that a move must move the object, for a move to be of use."""

CHANGE_COST = 0.02
"""What a change to another place of the outline costs beside the way along it, m."""

CHANGE_FRACTION = 0.3
"""Fraction of the way along the outline that a change costs: the finger is faster there."""

HEURISTIC_WEIGHT = 1.5
"""Weight of the estimate of what is to go. The path is at most so many times as long as need be."""

CELL_SIZE = 0.02
"""Two poses whose cells' centroids are in one square of this side count as one, m."""

TURN_SIZE = np.pi / 16
"""Two poses whose angles are in one interval of this width count as one, rad."""

GOAL_TOLERANCE = 0.02
"""Mean cell error at which the path has come near enough to the goal, m."""

PATH_MARGIN = 0.004
"""By how much more than the rules ask a path keeps clear, m, for it is not followed exactly."""

MAX_EXPANSIONS = 6000
"""Poses from which the search goes on, at most."""


@dataclass(frozen=True, eq=False)
class PathPlan:
    """A path among obstacles, or why there is none.

    Attributes:
        path: the path; None where there is none.
        status: "pushing" where there is a path, else why not.
        reason: the status in a sentence; empty where there is a path.
        expanded: number of poses from which the search went on.
    """

    path: PosePath | None
    status: FollowStatus
    reason: str
    expanded: int = 0


@dataclass(frozen=True, eq=False)
class _Moves:
    """What short pushes do to the object, in the body frame.

    Attributes:
        poses: (M, POSES_PER_MOVE, 3) the object's poses, m and rad.
        tips: (M, 2) the finger's center when each begins, m.
        places: (M,) where round the outline, as a length, m.
        perimeter: of the line on which the finger's center touches, m.
    """

    poses: Array
    tips: Array
    places: Array
    perimeter: float


def plan_pose_path(
    model: Model,
    start: ArrayLike,
    goal: ArrayLike,
    finger: FeedbackFinger,
    constraints: PushConstraints | None = None,
    *,
    speed: float,
) -> PathPlan:
    """Plans a path among obstacles and within the table that a finger can push the object along.

    Args:
        model: one object, with its parameters and physics.
        start: (3,) where it lies, X_WB, m and rad.
        goal: (3,) where it should go, m and rad.
        finger: the finger.
        constraints: table, obstacles, margins and the finger's region.
        speed: of the path, m/s.

    Returns:
        The path, or why there is none.

    Raises:
        PlanningError: an argument is out of range.
    """
    obj = model.obj
    begin = check_vector(PlanningError, "start", start, 3)
    aim = check_vector(PlanningError, "goal", goal, 3)
    require_positive(PlanningError, unit="m/s", speed=speed)
    rules = constraints or PushConstraints()
    on_table, blocked = rules.allow_pose(obj, aim)
    if not on_table:
        return _refuse(FollowStatus.GOAL_OFF_TABLE)
    if blocked:
        return _refuse(FollowStatus.GOAL_BLOCKED)
    # what can be done from anywhere, where that may be done, and how far it is to the goal
    pushed = make_model(obj, model.params, finger.radius, model.physics, shape=finger.shape)
    moves = _try_moves(obj, pushed, finger)
    room = make_room(obj, rules, finger, np.array([begin[:2], aim[:2]]))
    cost_to_go = CostToGo(obj, begin, aim, rules.start_at(obj, begin, finger.reach))
    if not np.isfinite(cost_to_go.calc_cost(begin)):
        return _refuse(FollowStatus.PATH_BLOCKED)
    poses, expanded = _search(obj, begin, aim, moves, room, cost_to_go)
    if poses is None:
        return _refuse(FollowStatus.PATH_BLOCKED, expanded)
    return PathPlan(PosePath(poses, speed), FollowStatus.PUSHING, "", expanded)


def _refuse(status: FollowStatus, expanded: int = 0) -> PathPlan:
    """Says that there is no path."""
    return PathPlan(None, status, FOLLOW_REASONS[status], expanded)


def _try_moves(obj: GridObject, model: SearchModel, finger: FeedbackFinger) -> _Moves:
    """Simulates all short pushes, and keeps those that move the object."""
    ways = make_outline_path(obj.outline, finger.radius, finger.shape)
    begins = ways.touch if finger.shape is None else ways.near
    chosen = np.arange(0, len(ways.touch), max(1, len(ways.touch) // PLACE_COUNT))
    perimeter = float(obj.outline.buffer(finger.radius).exterior.length)
    poses = []
    tips = []
    places = []
    for i in chosen:
        for angle in MOVE_ANGLES:
            state = np.zeros(STATE_SIZE)
            tip = np.append(begins[i], ways.inward[i])[: finger.coordinates]
            state[TIP_X : TIP_X + len(tip)] = tip
            step = np.zeros(len(tip))
            step[:2] = MOVE_LENGTH / POSES_PER_MOVE * make_direction(ways.inward[i] + angle)
            way = np.empty((POSES_PER_MOVE, 3))
            for k in range(POSES_PER_MOVE):
                follow_tip(model, state, (tip + (k + 1) * step)[None])
                way[k] = state[X : THETA + 1]
            if calc_goal_error(obj, way[-1], np.zeros(3)) > LEAST_MOVE * MOVE_LENGTH:
                poses.append(way)
                tips.append(begins[i])
                places.append(i / len(ways.touch) * perimeter)
    return _Moves(np.array(poses), np.array(tips), np.array(places), perimeter)


def _search(
    obj: GridObject, start: Array, goal: Array, moves: _Moves, room: FreeSpace, cost_to_go: CostToGo
) -> tuple[Array | None, int]:
    """Searches by A*; returns the poses (K, 3) of the path, if there is one, and its effort."""
    allowed = np.zeros(len(moves.poses), dtype=np.bool_)
    # poses that were met: how it came there, from which one, by which move
    met = [start]
    before = [-1]
    by_move = [-1]
    cost = [0.0]
    closed: set[tuple[int, ...]] = set()
    first = float(cost_to_go.estimate_costs(start[None])[0])
    queue = [(HEURISTIC_WEIGHT * first, 0)]
    expanded = 0
    while queue and expanded < MAX_EXPANSIONS:
        _, node = heappop(queue)
        pose = met[node]
        # of several ways to one cell the cheapest comes first; the others are passed over
        key = _name_cell(pose)
        if key in closed:
            continue
        closed.add(key)
        expanded += 1
        if calc_goal_error(obj, pose, goal) < GOAL_TOLERANCE and cost_to_go.is_clear(pose, goal):
            return _trace(node, met, before, by_move, moves, goal), expanded
        check_moves(room, pose, moves.poses, moves.tips, PATH_MARGIN, allowed)
        ways = np.flatnonzero(allowed)
        if not len(ways):
            continue
        ends = compose(pose, moves.poses[ways, -1])
        # a change of the place where it touches costs the way there
        costs = np.full(len(ways), MOVE_LENGTH)
        if by_move[node] >= 0:
            along = np.abs(moves.places[ways] - moves.places[by_move[node]])
            along = np.minimum(along, moves.perimeter - along)
            costs += np.where(along > 0, CHANGE_FRACTION * along + CHANGE_COST, 0.0)
        to_go = cost_to_go.estimate_costs(ends)
        # what cannot lead to the goal, or leads where it was before, is not kept
        for move, end, step, left in zip(ways, ends, costs, to_go, strict=True):
            if not np.isfinite(left) or _name_cell(end) in closed:
                continue
            met.append(end)
            before.append(node)
            by_move.append(int(move))
            cost.append(cost[node] + float(step))
            heappush(queue, (cost[-1] + HEURISTIC_WEIGHT * float(left), len(met) - 1))
    return None, expanded


def _name_cell(pose: Array) -> tuple[int, ...]:
    """The cell of a pose (3,): poses in one cell count as one."""
    x, y = np.floor(pose[:2] / CELL_SIZE)
    return int(x), int(y), int(np.floor(wrap_angle(pose[2]) / TURN_SIZE))


def _trace(
    node: int,
    met: list[Array],
    before: list[int],
    by_move: list[int],
    moves: _Moves,
    goal: Array,
) -> Array:
    """Poses (K, 3) from the start to a pose that was met, and then the goal."""
    pieces = [goal[None]]
    while before[node] >= 0:
        pieces.append(compose(met[before[node]], moves.poses[by_move[node]]))
        node = before[node]
    pieces.append(met[node][None])
    poses = np.concatenate(pieces[::-1])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses

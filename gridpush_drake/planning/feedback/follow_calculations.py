"""The calculations of a `FollowController`: a path, a place for the finger, what to do next.

Each of them is a function of what was learned and seen so far, and can be made in a worker. When
each is due is the controller's matter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from numpy.typing import ArrayLike

from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.feedback.follow_log import FollowLog, SeenPose
from gridpush_drake.planning.feedback.follow_options import (
    FOLLOW_REASONS,
    FollowDecision,
    FollowOptions,
    FollowStatus,
)
from gridpush_drake.planning.feedback.path_planner import plan_pose_path
from gridpush_drake.planning.feedback.pose_path import PathProgress, PosePath
from gridpush_drake.planning.feedback.pose_track import TrackOptions
from gridpush_drake.planning.feedback.push_follower import PushFollower
from gridpush_drake.planning.loop_run import Learner
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.pushes.push_log import PushLog

APPROACH_DIRECTIONS = 36
"""Directions around the object in which a place for the finger is looked for."""

MAX_PIECES = 8
"""Greatest number of pieces of the way so far that are learned from, the last ones."""


@dataclass(frozen=True, eq=False)
class FollowRules:
    """How an object is pushed along a path by a `FollowController`.

    Attributes:
        goal: (3,) X_WB at the end of the path, m and rad; with `path` that path's end counts.
        finger: the finger.
        speed: speed of a path that is planned, m/s.
        path: the path; None to plan one to the goal.
        constraints: table, obstacles and the finger's region.
        options: how the finger is steered.
        track: how poses are filtered.
        pokes: number of pokes that are learned from before.
        plans: number of paths that are planned at most.
        pose_delay: age of a pose when it comes to the port, s.
        seed: of the search.
    """

    goal: ArrayLike
    finger: FeedbackFinger
    speed: float = 0.05
    path: PosePath | None = None
    constraints: PushConstraints = field(default_factory=PushConstraints)
    options: FollowOptions = field(default_factory=FollowOptions)
    track: TrackOptions | None = None
    pokes: int = 3
    plans: int = 3
    pose_delay: float = 0.0
    seed: int = 0

    @property
    def end(self) -> Array:
        """(3,) X_WB at the end of the path, m and rad."""
        return np.array(self.goal if self.path is None else self.path.goal, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class FollowProgress:
    """What was seen while the finger was steered, from which is learned before a further path.

    Attributes:
        tips: (time, x, y) of the finger's center, s and m; (time, x, y, yaw) of a shape.
        seen: poses that came.
        path: the path that was followed last; None before the first.
        progress: how far the object came on it, m.
    """

    tips: tuple[tuple[float, ...], ...] = ()
    seen: tuple[SeenPose, ...] = ()
    path: PosePath | None = None
    progress: float = 0.0


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is made before the finger comes down.

    Attributes:
        status: "pushing" where there is a path, else why not.
        reason: the status in a sentence; empty where there is a path.
        path: the path; None where there is none.
        follower: steers along the path; None where there is none.
        places: (K, 2) where the finger may come down, W, the best first, m; (K, 3) with the angle,
            rad, of one that is no disc.
    """

    status: FollowStatus
    reason: str
    path: PosePath | None = None
    follower: PushFollower | None = None
    places: Array = field(default_factory=lambda: np.empty((0, 2)))


def prepare_after(
    obj: GridObject,
    learned: Identification,
    pose: Array,
    rules: FollowRules,
    *,
    pokes: PushLog,
    follow_run: FollowProgress,
) -> Prepared:
    """Prepares a further path, for which is learned from the way so far as well.

    Of a path that is told, what the object has left behind is not gone again.

    Args:
        obj: the object.
        learned: what was learned of it from the pokes.
        pose: (3,) where it lies, X_WB, m and rad.
        rules: where to, and how.
        pokes: the pokes.
        follow_run: what was seen while the finger was steered; empty before the first path.
    """
    again = learn_on(obj, learned, rules, pokes=pokes, follow_run=follow_run)
    if rules.path is not None and follow_run.path is not None:
        left = PathProgress(obj, follow_run.path).rest(follow_run.progress)
        rules = replace(rules, path=left)
    return prepare(obj, learned if again is None else again, pose, rules)


def learn_on(
    obj: GridObject,
    learned: Identification,
    rules: FollowRules,
    *,
    pokes: PushLog,
    follow_run: FollowProgress,
) -> Identification | None:
    """Learns from the pokes and the way so far; None where the way tells nothing yet.

    Args:
        obj: the object.
        learned: what was learned of it from the pokes, with which the search begins.
        rules: where to, and how.
        pokes: the pokes.
        follow_run: what was seen while the finger was steered.
    """
    log = FollowLog(obj, rules.finger.radius, shape=rules.finger.shape)
    for time, *tip in follow_run.tips:
        log.add_tip(time, np.array(tip))
    for each in follow_run.seen:
        log.add_pose(each)
    pieces = log.cut()[-MAX_PIECES:]
    if not pieces:
        return None
    pushes = PushLog((*pokes, *pieces))
    return Learner(memory=len(pushes), seed=rules.seed)(obj, pushes, learned)


def prepare(obj: GridObject, learned: Identification, pose: Array, rules: FollowRules) -> Prepared:
    """Plans a path, and makes what steers along it.

    Args:
        obj: the object.
        learned: what was learned of it.
        pose: (3,) where it lies, X_WB, m and rad.
        rules: where to, and how.
    """
    # The path, unless it is told, is planned with what was learned.
    path = rules.path
    if path is None:
        plan = plan_pose_path(
            Model(obj, learned.params, learned.physics),
            pose,
            rules.goal,
            rules.finger,
            rules.constraints,
            speed=rules.speed,
        )
        if plan.path is None:
            return Prepared(plan.status, plan.reason)
        path = plan.path
    # What steers along it also knows models that may be the true one.
    follower = PushFollower(
        obj,
        learned.params,
        path,
        rules.finger,
        draws=learned.draws(rules.options.ensemble, rules.seed),
        physics=learned.physics,
        constraints=rules.constraints,
        options=rules.options,
        track=rules.track,
        seed=rules.seed,
    )
    refused = follower.refusal
    if refused is not None:
        return Prepared(refused, FOLLOW_REASONS[refused], path)
    places = find_places(obj, pose, path, rules)
    if len(places):
        # A first decision compiles the search, which must not happen while the finger is down.
        decide(follower, [(0.0, *places[0].tolist())], [SeenPose(0.0, pose)])
    return Prepared(FollowStatus.PUSHING, "", path, follower, places)


def find_places(obj: GridObject, pose: Array, path: PosePath, rules: FollowRules) -> Array:
    """Finds places (K, D) beside the object where the finger may come down, W, m.

    The best, which is behind the object as its path begins, is the first. A finger that is no disc
    faces the object.
    """
    # Behind the object is where it comes from, seen from where its path leads first.
    centers = transform(path.poses, obj.p_BC.mean(axis=0)[None])[:, 0]
    center = transform(pose, obj.p_BC.mean(axis=0)[None])[0]
    away = np.linalg.norm(centers - centers[0], axis=1) > obj.radius_of_gyration
    ahead = centers[int(away.argmax())] if away.any() else centers[-1]
    behind = float(np.arctan2(*(center - ahead)[::-1]))
    # directions in the order of how far they are from that
    turns = np.linspace(-np.pi, np.pi, APPROACH_DIRECTIONS, endpoint=False)
    turns = turns[np.argsort(np.abs(turns), kind="stable")]
    finger = rules.finger
    places = [finger.place_beside(obj, pose, behind + turn) for turn in turns]
    free = [one for one in places if _allows_finger(rules.constraints, one[:2], finger.reach)]
    return np.array(free).reshape(-1, finger.coordinates)


def _allows_finger(rules: PushConstraints, place: Array, radius: float) -> bool:
    """Whether a finger of a radius, m, may be at a place (2,), m."""
    point = shapely.Point(place)
    if rules.finger_region is not None and not rules.finger_region.covers(point):
        return False
    if rules.surface is not None and not rules.surface.polygon.covers(point):
        return False
    least = radius + rules.obstacle_margin
    return all(obstacle.distance(point) >= least for obstacle in rules.obstacles)


def decide(
    follower: PushFollower,
    tips: Sequence[tuple[float, ...]],
    seen: Sequence[SeenPose],
    learned: Identification | None = None,
    *,
    lead: float = 0.0,
    velocity: ArrayLike | None = None,
) -> tuple[PushFollower, FollowDecision]:
    """Tells a copy of a follower what was seen since the last decision, and lets it decide.

    Args:
        follower: what decides; it stays as it is.
        tips: (time, x, y) of the finger's center, s and m, or (time, x, y, yaw) of a shape; the
            last one is now.
        seen: poses that came.
        learned: what was learned meanwhile; None if nothing was.
        lead: time until the finger will do what is decided, s.
        velocity: (2,) of the finger until then, W, m/s, or (3,) with rad/s; at rest if None.

    Returns:
        The copy, and what it decided.
    """
    after = follower.copy()
    if learned is not None:
        after.set_model(learned.params, learned.draws(after.options.ensemble))
    for time, *tip in tips:
        after.add_tip(time, tip)
    for each in seen:
        after.add_pose(each.time, each.pose)
    time, *tip = tips[-1]
    return after, after.decide(time, tip, lead=lead, velocity=velocity)

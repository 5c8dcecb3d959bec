"""What a `PushFollower` can be asked for, and what it answers: options, statuses, decisions."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.planning.feedback.pose_track import MAX_COORDINATE


class FollowStatus(StrEnum):
    """What a controller does; `FOLLOW_REASONS` says what each status means."""

    PUSHING = "pushing"
    REACHED = "reached"
    NO_GOAL = "no_goal"
    NO_POSE = "no_pose"
    NO_FINGER = "no_finger"
    DISTURBED = "disturbed"
    UNLIKE_MODEL = "unlike_model"
    STUCK = "stuck"
    GOAL_TOO_FAR = "goal_too_far"
    GOAL_OFF_TABLE = "goal_off_table"
    GOAL_BLOCKED = "goal_blocked"
    PATH_BLOCKED = "path_blocked"
    TOO_FAST = "too_fast"


FOLLOW_REASONS = {
    FollowStatus.PUSHING: "",
    FollowStatus.REACHED: "The object is where it is wanted, within the tolerance.",
    FollowStatus.NO_GOAL: "No goal is given.",
    FollowStatus.NO_POSE: "No pose of the object came for too long.",
    FollowStatus.NO_FINGER: "Where the finger is is not known.",
    FollowStatus.DISTURBED: (
        "The object is seen elsewhere again and again, and the finger did not move it there: "
        "somebody else moves it, or its poses are wrong."
    ),
    FollowStatus.UNLIKE_MODEL: (
        "The object moves unlike anything that its model can do: the model is of another object, "
        "its poses are wrong, or somebody else moves it."
    ),
    FollowStatus.STUCK: "The object does not get on, whatever the finger does.",
    FollowStatus.GOAL_TOO_FAR: (
        f"The goal is no place on a table: it is farther than {MAX_COORDINATE:g} m from the origin."
    ),
    FollowStatus.GOAL_OFF_TABLE: (
        "At the goal pose the object hangs over the table's edge further than it may."
    ),
    FollowStatus.GOAL_BLOCKED: (
        "At the goal pose the object touches an obstacle, or is nearer to one than it may be."
    ),
    FollowStatus.PATH_BLOCKED: (
        "On its path the object would touch an obstacle, or leave the table."
    ),
    FollowStatus.TOO_FAST: "The path is faster than the finger may push.",
}
"""What each status means, in a sentence."""

AT_GOAL = "The object is at its goal: the finger rests until the object was seen to lie there."
"""Reason of "pushing" if the object is within the goal's tolerances."""

NO_PUSH_FOUND = "No push was found that brings the object nearer: the finger rests until one is."
"""Reason of "pushing" if the search found nothing better than to stand still."""


@dataclass(frozen=True)
class FollowOptions:
    """How plans are searched for and what they cost. Lengths are in m unless said otherwise.

    Attributes:
        period: time of a decision, s.
        strokes: strokes that are tried at each decision.
        changes: small changes that are tried at each decision.
        horizon: decisions that a plan to a goal has at most.
        path_horizon: decisions that a plan on a path has.
        refinements: Gauss-Newton steps at each decision on a path.
        draws: models drawn from the posterior with which a plan on a path is refined, beside the
            estimate.
        ensemble: models drawn from the posterior with which the estimate is corrected while the
            finger is steered; with less than 2 it is not.
        position_tolerance: distance from the goal within which it is reached.
        angle_tolerance: turn from the goal within which it is reached, rad.
        weight_along: how much a distance along the path counts, against 1 of one beside it.
        weight_turn: how much a turn from the path's heading counts, times the radius of gyration;
            0 leaves the heading free.
        base: cost-to-go of a pose next to the goal, in decisions that it takes the finger to go
            half round the object. With less than 1 it would not go round for the last millimeter.
        slowness: cost-to-go for a distance from the goal, in decisions that a push straight there
            would take.
        per_root: cost-to-go for the square root of the distance from the goal, in radii of
            gyration.
        attempts: searches in one decision on the way to a goal, each of which counts decisions half
            as much.
        no_pose_after: age of the last pose from which the finger rests, s.
        unlike: fraction of the object's motion that the model does not explain, from which on it
            counts as one of another object.
        unlike_after: time for which this must last, s, until the finger rests.
        least_response: fraction of the motion which the finger should have caused that must be seen
            (`PoseTrack.response`); with less the object counts as one of another object, too.
        disturbances: number of disturbances on the way to one goal after which the finger rests
            for good.
        frequent_disturbances: number of disturbances within `disturbance_time` after which the
            finger rests until they are over, at least 2.
        disturbance_time: time within which these are counted, s.
        stuck_after: time without getting on after which the finger rests, s.
    """

    period: float = 0.1
    strokes: int = 80
    changes: int = 120
    horizon: int = 40
    path_horizon: int = 15
    refinements: int = 2
    draws: int = 4
    ensemble: int = 32
    position_tolerance: float = 0.002
    angle_tolerance: float = float(np.radians(1.0))
    weight_along: float = 0.3
    weight_turn: float = 0.3
    base: float = 1.2
    slowness: float = 1.5
    per_root: float = 20.0
    attempts: int = 2
    no_pose_after: float = 0.5
    unlike: float = 0.7
    unlike_after: float = 2.0
    least_response: float = 0.25
    disturbances: int = 12
    frequent_disturbances: int = 4
    disturbance_time: float = 5.0
    stuck_after: float = 15.0

    def __post_init__(self) -> None:
        counts = ("strokes", "changes", "horizon", "path_horizon", "attempts")
        for name in (*counts, "disturbances"):
            if not getattr(self, name) >= 1:
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected 1 or more")
        if not self.frequent_disturbances >= 2:
            raise PlanningError(
                f"frequent_disturbances is {self.frequent_disturbances!r}; expected 2 or more"
            )
        for name in ("refinements", "draws", "ensemble"):
            if not getattr(self, name) >= 0:
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected 0 or more")
        require_positive(
            PlanningError,
            period=self.period,
            position_tolerance=self.position_tolerance,
            angle_tolerance=self.angle_tolerance,
            no_pose_after=self.no_pose_after,
            unlike=self.unlike,
            unlike_after=self.unlike_after,
            disturbance_time=self.disturbance_time,
            stuck_after=self.stuck_after,
        )


@dataclass(frozen=True, eq=False)
class FollowDecision:
    """What a controller decided.

    Attributes:
        velocity: (2,) of the finger, W, m/s, until the next decision; (3,) with rad/s of one that
            is no disc.
        status: what the controller does.
        reason: the status in a sentence; empty while it pushes and the finger moves.
        pose: (3,) where the object is now, as the controller thinks, m and rad; NaN before it was
            seen.
        progress: how far the object came on its path, m; 0 on the way to a goal.
    """

    velocity: Array
    status: FollowStatus
    reason: str
    pose: Array
    progress: float = 0.0

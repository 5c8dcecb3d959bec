"""Predicts where a push takes an object that a camera does not see meanwhile.

While the arm hides an object, the position of the finger's tip is known all the same, and a model
predicts where its push takes the object. Where the object looks the same at several angles, the
prediction tells these apart, see docs/theory/perception.md, section 3. The model need not be exact:
a prediction's standard deviation is a part of the way that the object is predicted to go.

`predict_pose` predicts one object, `predict_scene_poses` several that push each other.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.tracking.symmetries import ExpectedPose

PLACE_FRACTION = 0.3
"""Standard deviation of the place that a model predicts, as a part of the way."""

TURN_FRACTION = 0.4
"""Standard deviation of the angle that a model predicts, as a part of the turn."""

LEAST_DEVIATIONS = (0.005, 0.1)
"""Least standard deviations of place, m, and angle, rad, of what a model predicts."""

LEAST_STEP = 1e-6
"""A tip that moved by less than this between two pictures pushes nothing, m."""


@dataclass(frozen=True, eq=False)
class PushModel:
    """What a push does to an object, as far as it is known.

    Attributes:
        obj: the object, in the body frame that is tracked.
        top: height of the object, m; a tip above it pushes nothing.
        radius: radius of the finger's tip, m; of a pusher of another shape, how far it reaches from
            its frame's origin.
        shape: of a pusher that is no disc, whose x axis points where it moves; None of a disc.
    """

    obj: GridObject
    top: float
    radius: float
    shape: PusherShape | None = None


class Tip(NamedTuple):
    """A place of the finger's tip.

    Attributes:
        t: when it was there, s.
        place: (3,) p_WP of its center, m; NaN where it pushes nothing and yet may move the object,
            as in a grasp.
    """

    t: float
    place: Array


@dataclass(frozen=True, eq=False)
class PosePrediction:
    """Predicted pose of an object that was not seen since some pushes.

    Attributes:
        last_seen: (3,) the pose at which it was last seen, W, m and rad.
        pose: (3,) the pose to which the pushes since then take it, W, m and rad.
        known: whether all that may have moved it since then is known to the model.
        pushed: whether a push has moved it in the model.
    """

    last_seen: Array
    pose: Array
    known: bool = True
    pushed: bool = False

    def expect(self) -> ExpectedPose | None:
        """Says where the object is expected; None where the model says nothing of it."""
        if not (self.known and self.pushed):
            return None
        way = float(np.linalg.norm(self.pose[:2] - self.last_seen[:2]))
        turn = abs(float(wrap_angle(self.pose[2] - self.last_seen[2])))
        return make_expectation(self.pose, way, turn)


def make_expectation(pose: Array, way: float, turn: float) -> ExpectedPose:
    """Turns the pose that a model predicts for an object into an expectation.

    Args:
        pose: (3,) the predicted pose, W, m and rad.
        way: how far it moves in the model, m.
        turn: how far it turns in the model, rad.

    Returns:
        The expectation. Its standard deviations grow with the way and the turn.
    """
    return ExpectedPose(
        pose=pose,
        place_deviation=max(LEAST_DEVIATIONS[0], PLACE_FRACTION * way),
        turn_deviation=max(LEAST_DEVIATIONS[1], TURN_FRACTION * turn),
    )


def predict_pose(
    before: PosePrediction,
    model: PushModel,
    read_params: Callable[[], CellParameters],
    last: Tip,
    now: Tip,
) -> PosePrediction:
    """Predicts where an object is after the tip went straight from one place to another.

    Args:
        before: the prediction for the moment at which the tip was at `last`.
        model: the object and the tip.
        read_params: gives masses and frictions of the object's cells; it is called only where the
            tip may have pushed.
        last: the tip in the picture before.
        now: the tip now.

    Returns:
        The prediction for now. It is not `known` where the tip's place is not known, or where the
        model cannot follow the push.
    """
    if not _is_known(last, now):
        return replace(before, known=False)
    if not _may_push(last, now, model.top):
        return before
    try:
        push = _make_push(last, now, model.radius, model.shape)
        motion = simulate(
            Bodies(model.obj, read_params()), push, before.pose, regime="quasi_static"
        )
    except GridPushError:
        return replace(before, known=False)
    if motion.status == MotionStatus.NO_CONTACT:
        return before
    if motion.status != MotionStatus.OK:
        return replace(before, known=False)
    return replace(before, pose=motion.final_pose, pushed=True)


@dataclass(frozen=True, eq=False)
class ScenePushModel:
    """What a push does to several objects, which push each other, as far as it is known.

    Attributes:
        bodies: the objects, in the body frames that are tracked, with what is supposed of their
            masses and frictions.
        top: height of the highest object, m; a tip above it pushes nothing.
        radius: radius of the finger's tip, m.
    """

    bodies: Bodies
    top: float
    radius: float


@dataclass(frozen=True, eq=False)
class ScenePrediction:
    """Predicted poses of several objects, each since it was last seen.

    Attributes:
        last_seen: (N, 3) the poses at which the objects were last seen, W, m and rad.
        poses: (N, 3) the poses to which the pushes since then take them, W, m and rad.
        known: (N,) whether all that may have moved an object since then is known to the model.
    """

    last_seen: Array
    poses: Array
    known: NDArray[np.bool_]

    def expect(self) -> tuple[ExpectedPose | None, ...]:
        """Says where each object is expected; None where the model says nothing of it."""
        # The further a push took an object in the model, the less sure it is where it lies.
        moved = self.poses - self.last_seen
        ways = np.linalg.norm(moved[:, :2], axis=1).tolist()
        turns = np.abs(wrap_angle(moved[:, 2])).tolist()
        return tuple(
            make_expectation(pose, way, turn) if known and way + turn > LEAST_STEP else None
            for pose, way, turn, known in zip(self.poses, ways, turns, self.known, strict=True)
        )

    def see(self, poses: Array) -> "ScenePrediction":
        """Returns the prediction after a picture: it begins anew for the objects that were seen.

        Args:
            poses: (N, 3) where they were seen, W, m and rad; NaN for one that was not.
        """
        # An object that was not seen keeps its prediction.
        seen: NDArray[np.bool_] = np.asarray(np.isfinite(poses).all(axis=1))
        return ScenePrediction(
            last_seen=np.where(seen[:, None], poses, self.last_seen),
            poses=np.where(seen[:, None], poses, self.poses),
            known=self.known | seen,
        )


def predict_scene_poses(
    before: ScenePrediction, model: ScenePushModel, last: Tip, now: Tip
) -> ScenePrediction:
    """Predicts where several objects are after the tip went straight from one place to another.

    Args:
        before: the prediction for the moment at which the tip was at `last`.
        model: the objects and the tip.
        last: the tip in the picture before.
        now: the tip now.

    Returns:
        The prediction for now. No object is `known`, until it is seen, where the tip's place is not
        known, or where the model cannot follow the push.
    """
    # A tip that nobody knows of, as in a grasp, may have moved any of them.
    unknown = replace(before, known=np.zeros_like(before.known))
    if not _is_known(last, now):
        return unknown
    if not _may_push(last, now, model.top):
        return before
    try:
        # Objects that touch may overlap a little, as they were seen.
        push = _make_push(last, now, model.radius)
        motion = simulate_together(model.bodies, push, before.poses)
    except GridPushError:
        return unknown
    # What the tip did not touch lies where it lay.
    if motion.status == MotionStatus.NO_CONTACT:
        return before
    # So may the tip and an object; the first steps push them apart.
    if motion.status not in (MotionStatus.OK, MotionStatus.STARTED_OVERLAPPING):
        return unknown
    return replace(before, poses=motion.poses[-1])


def _is_known(last: Tip, now: Tip) -> bool:
    """Says whether it is known how the tip went from one place to another."""
    return bool(np.isfinite([last.place, now.place]).all()) and now.t > last.t


def _may_push(last: Tip, now: Tip, top: float) -> bool:
    """Says whether a tip may push objects of a height, m: not one above them, nor one at rest."""
    places = np.array([last.place, now.place])
    return bool(places[:, 2].min() <= top and np.ptp(places[:, :2], axis=0).max() >= LEAST_STEP)


def _make_push(last: Tip, now: Tip, radius: float, shape: PusherShape | None = None) -> Push:
    """Makes the straight push of a tip of a radius, m, or of a shape, from one place to another."""
    places = np.array([last.place[:2], now.place[:2]])
    if shape is None:
        return Push.along([last.t, now.t], places, radius)
    x, y = places[1] - places[0]
    return Push.along([last.t, now.t], places, shape=shape, yaw=np.arctan2(y, x))

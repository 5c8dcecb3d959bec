"""`ObjectsPoseEstimator`: tracks several objects in a camera's pictures, a port for each.

It is `SceneTracker` between ports. One object is tracked by `ObjectPoseEstimator`, which predicts
it by what is learned meanwhile, and tells its tracker while the finger is too far off to touch it.
Several objects have neither: made one, the two would be a branch at every step.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context

from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.perception.tracking.multi_object_tracking import SceneTracker, SceneTrackerState
from gridpush_drake.perception.tracking.pose_prediction import (
    ScenePrediction,
    ScenePushModel,
    Tip,
    predict_scene_poses,
)
from gridpush_drake.perception.tracking.symmetries import ExpectedPose
from gridpush_drake.systems.sensing.planar_pose_sensor import DEFAULT_PERIOD
from gridpush_drake.systems.sensing.pose_estimator import PoseEstimator, Poses


class ObjectsPoseEstimator(PoseEstimator[SceneTrackerState, ScenePrediction]):
    """Tracks several objects, which may touch, through the pictures of a color and depth camera.

    .. pydrake_system::

        name: ObjectsPoseEstimator
        input_ports:
        - color_image
        - depth_image
        - label_image
        - pusher_state
        output_ports:
        - object_pose_0
        - covariance_0
        - seen_0
        - ...
        - message

    * color_image: abstract `ImageRgba8U`.
    * depth_image: abstract `ImageDepth32F`, m, of the same pixels. It need not be connected.
    * label_image: abstract `ImageLabel16I`, rendered as the camera sees the scene; it tells which
      pixels show the robot, or something else that hides the objects. It need not be connected.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity v_WP, m/s;
      NaN while something else than a push moves the objects. Only with a `model`; it need not be
      connected.
    * object_pose_0, and so on for each object in the tracker's order: vector of 3, X_WB,
      (x, y, theta), m and rad; theta does not jump by whole turns. NaN if it was not seen.
    * covariance_0, and so on: vector of 9, covariance of the pose, row-major, m², m rad and rad²;
      NaN if the object was not seen.
    * seen_0, and so on: vector of 1, 1 if the object was seen in the picture that the pose is of,
      else 0.
    * message: abstract `str`, why the objects were not found yet; empty once they were.

    A picture is taken every `period`; its poses are on the ports `latency` later. While the lens is
    covered, which numeric parameter 0 says, nothing is seen. While an object is not seen, the model
    says where pushes take it, also through other objects; there it is looked for. Abstract state:
    one `EstimatorState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        tracker: SceneTracker,
        width: int,
        height: int,
        *,
        period: float = DEFAULT_PERIOD,
        latency: float = 0.0,
        guesses: Sequence[ArrayLike | None] | None = None,
        occluded_by: Iterable[int] = (),
        model: ScenePushModel | None = None,
    ) -> None:
        """Declares the system.

        Args:
            tracker: tracks the objects; it knows the camera.
            width: width of the images, pixels.
            height: height of the images, pixels.
            period: time between two pictures, s.
            latency: time from a picture until its poses are on the ports, s.
            guesses: for each object (3,) X_WB in the first picture, roughly, m and rad, or None to
                search for it; None to search for all of them.
            occluded_by: labels, in `label_image`, of whatever may hide the objects.
            model: what pushes do to the objects; None where nobody knows.
        """
        super().__init__(
            [f"_{i}" for i in range(len(tracker))],
            width,
            height,
            period=period,
            latency=latency,
            occluded_by=occluded_by,
            has_model=model is not None,
        )
        self._tracker = tracker
        self._guesses = guesses
        self._model = model

    def _start(self, frame: Frame, hidden: NDArray[np.bool_] | None) -> SceneTrackerState:
        return self._tracker.start(frame, self._guesses, hidden)

    def _track(
        self,
        tracker: SceneTrackerState,
        frame: Frame,
        hidden: NDArray[np.bool_] | None,
        prediction: ScenePrediction | None,
        tip: Tip | None,
    ) -> tuple[SceneTrackerState, Poses]:
        expected = _expect_occluded(tracker, prediction)
        return self._tracker.track(tracker, frame, hidden, expected)

    def _predict(
        self, context: Context, prediction: ScenePrediction, last: Tip, now: Tip
    ) -> ScenePrediction:
        assert self._model is not None
        return predict_scene_poses(prediction, self._model, last, now)

    def _correct(self, prediction: ScenePrediction | None, poses: Poses) -> ScenePrediction | None:
        seen = np.array([each.pose for each in poses])
        if prediction is not None:
            return prediction.see(seen)
        # The first prediction begins with a picture in which all objects are seen.
        if not np.isfinite(seen).all():
            return None
        known = np.ones(len(seen), dtype=bool)
        return ScenePrediction(last_seen=seen, poses=seen, known=known)


def _expect_occluded(
    tracker: SceneTrackerState, prediction: ScenePrediction | None
) -> tuple[ExpectedPose | None, ...] | None:
    """Says where the objects are expected that were hidden in the last picture; None if none was.

    While an object is in view, its last pose says more than any prediction.
    """
    if prediction is None or not any(each.hidden for each in tracker.objects):
        return None
    return tuple(
        expected if each.hidden else None
        for expected, each in zip(prediction.expect(), tracker.objects, strict=True)
    )

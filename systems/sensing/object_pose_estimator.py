"""`ObjectPoseEstimator`: tracks an object in a camera's pictures; `PoseTracker` between ports."""

from collections.abc import Iterable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context

from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.perception.tracking.pose_prediction import (
    PosePrediction,
    PushModel,
    Tip,
    predict_pose,
)
from gridpush_drake.perception.tracking.tracking import PoseTracker, TrackerState
from gridpush_drake.systems.sensing.object_watch import ObjectWatch
from gridpush_drake.systems.sensing.planar_pose_sensor import DEFAULT_PERIOD
from gridpush_drake.systems.sensing.pose_estimator import PoseEstimator, Poses


class ObjectPoseEstimator(PoseEstimator[TrackerState, PosePrediction]):
    """Tracks an object through the pictures of a color and depth camera.

    .. pydrake_system::

        name: ObjectPoseEstimator
        input_ports:
        - color_image
        - depth_image
        - label_image
        - pusher_state
        - mass
        - friction
        - contact_friction
        output_ports:
        - object_pose
        - covariance
        - seen
        - message

    * color_image: abstract `ImageRgba8U`.
    * depth_image: abstract `ImageDepth32F`, m, of the same pixels. It need not be connected.
    * label_image: abstract `ImageLabel16I`, rendered as the camera sees the scene; it tells which
      pixels show the robot, or something else that hides the object. It need not be connected.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity v_WP, m/s;
      NaN while something else than a push moves the object. Only with a `model`; it need not be
      connected.
    * mass, friction: vectors of n, the estimated mass of each cell, kg, and its friction
      coefficient against the support. Only with a `model`; if they are not connected, all cells
      count as alike.
    * contact_friction: vector of 1, the estimated friction coefficient of the tip against the
      object. Only with a `model`.
    * object_pose: vector of 3, X_WB, (x, y, theta), m and rad; theta does not jump by whole turns.
      NaN if the object was not seen.
    * covariance: vector of 9, covariance of the pose, row-major, m², m rad and rad²; NaN if the
      object was not seen.
    * seen: vector of 1, 1 if the object was seen in the picture that the pose is of, else 0.
    * message: abstract `str`, why the object was not found yet; empty once it was.

    A picture is taken every `period`; its pose is on the ports `latency` later. While the lens is
    covered, which numeric parameter 0 says, nothing is seen. While the object is not seen, the
    model says where pushes take it; by that, poses at which it looks the same are told apart when
    it is seen again. Abstract state: one `EstimatorState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        tracker: PoseTracker,
        width: int,
        height: int,
        *,
        period: float = DEFAULT_PERIOD,
        latency: float = 0.0,
        guess: ArrayLike | None = None,
        occluded_by: Iterable[int] = (),
        model: PushModel | None = None,
    ) -> None:
        """Declares the system.

        Args:
            tracker: tracks the object; it knows the camera.
            width: width of the images, pixels.
            height: height of the images, pixels.
            period: time between two pictures, s.
            latency: time from a picture until its pose is on the ports, s.
            guess: (3,) X_WB in the first picture, roughly, m and rad; None to search for it.
            occluded_by: labels, in `label_image`, of whatever may hide the object.
            model: what pushes do to the object; None where nobody knows.
        """
        super().__init__(
            ("",),
            width,
            height,
            period=period,
            latency=latency,
            occluded_by=occluded_by,
            has_model=model is not None,
        )
        self._tracker = tracker
        self._guess = None if guess is None else np.array(guess, dtype=np.float64)
        self._model = model
        self._watch: ObjectWatch | None = None
        if model is not None:
            self._watch = ObjectWatch(
                outline=tracker.outline, height=model.top, tip_radius=model.radius
            )
            self._mass = self.DeclareVectorInputPort("mass", model.obj.n)
            self._friction = self.DeclareVectorInputPort("friction", model.obj.n)
            self._contact_friction = self.DeclareVectorInputPort("contact_friction", 1)

    def _start(self, frame: Frame, hidden: NDArray[np.bool_] | None) -> TrackerState:
        return self._tracker.start(frame, self._guess, hidden)

    def _track(
        self,
        tracker: TrackerState,
        frame: Frame,
        hidden: NDArray[np.bool_] | None,
        prediction: PosePrediction | None,
        tip: Tip | None,
    ) -> tuple[TrackerState, Poses]:
        # While the object is in view, its last pose says more than any prediction.
        expected = None
        if prediction is not None and tracker.hidden:
            expected = prediction.expect()
        untouched = self._is_untouched(tracker, tip)
        tracker, pose = self._tracker.track(tracker, frame, hidden, expected, untouched)
        return tracker, (pose,)

    def _is_untouched(self, tracker: TrackerState, tip: Tip | None) -> bool:
        """Says whether the finger is surely too far from the object to touch it."""
        if self._watch is None or tip is None or not np.isfinite(tip.place).all():
            return False
        return not self._watch.is_near(tracker.last_published_pose, tip.place)

    def _predict(
        self, context: Context, prediction: PosePrediction, last: Tip, now: Tip
    ) -> PosePrediction:
        assert self._model is not None
        return predict_pose(prediction, self._model, partial(self._read_model, context), last, now)

    def _correct(self, prediction: PosePrediction | None, poses: Poses) -> PosePrediction | None:
        pose = poses[0]
        return PosePrediction(last_seen=pose.pose, pose=pose.pose) if pose.seen else prediction

    def _read_model(self, context: Context) -> CellParameters:
        """Reads what is estimated of the object; an even object where nothing is connected."""
        assert self._model is not None
        obj = self._model.obj
        ports = (self._mass, self._friction, self._contact_friction)
        if not all(port.HasValue(context) for port in ports):
            return CellParameters.uniform(obj)
        mass, friction, contact_friction = (np.array(port.Eval(context)) for port in ports)
        return CellParameters(mass, friction, float(contact_friction[0]))

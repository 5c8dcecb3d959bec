"""`PoseEstimator`: base of the systems that track one object, or several, in a camera's pictures.

It says when a picture is taken, in which order the steps of an estimate follow each other, and when
a pose comes to the ports. How objects are tracked, and how a model predicts them while they are
hidden, is a matter of the derived classes: `ObjectPoseEstimator` and `ObjectsPoseEstimator`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, State

from gridpush_drake.errors import PerceptionError
from gridpush_drake.frozen import Unchanging
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.perception.tracking.pose_prediction import Tip
from gridpush_drake.perception.tracking.tracking import NOT_SEEN, TrackedPose
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.sensing.pusher_gate import PUSHER_STATE_SIZE
from gridpush_drake.systems.sensing.rgbd_inputs import RgbdInputs

TrackerStateType = TypeVar("TrackerStateType")
"""The state of a tracker."""

PredictionType = TypeVar("PredictionType")
"""A model's prediction of where the objects are."""

Poses = tuple[TrackedPose, ...]
"""The poses that were found in one picture, one for each object."""

Reports = tuple[tuple[float, Poses], ...]
"""The poses found in some pictures, the latest last, each with the time from which on it is on the
ports, s."""


@dataclass(frozen=True, eq=False)
class EstimatorState(Unchanging, Generic[TrackerStateType, PredictionType]):
    """All that an estimator remembers; never changed, only replaced.

    Attributes:
        tracker: state of the tracker after the last picture; None before the first picture in which
            all objects were found.
        reports: the poses that are on the ports, and those that will be.
        message: why the objects were not found yet; empty once they were.
        tip: the finger's tip in the last picture; None where it is not known.
        prediction: the poses to which pushes have taken the objects since they were last seen; None
            before they were seen, and without a model.
    """

    tracker: TrackerStateType | None = None
    reports: Reports = ()
    message: str = ""
    tip: Tip | None = None
    prediction: PredictionType | None = None


class PoseEstimator(
    AbstractStateSystem[EstimatorState[TrackerStateType, PredictionType]],
    Generic[TrackerStateType, PredictionType],
):
    """Tracks objects through the pictures of a color and depth camera.

    .. pydrake_system::

        name: PoseEstimator
        input_ports:
        - color_image
        - depth_image
        - label_image
        - pusher_state
        output_ports:
        - object_pose
        - covariance
        - seen
        - ...
        - message

    * color_image: abstract `ImageRgba8U`.
    * depth_image: abstract `ImageDepth32F`, m, of the same pixels. It need not be connected.
    * label_image: abstract `ImageLabel16I`; it tells which pixels show what hides the objects. It
      need not be connected.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity v_WP, m/s;
      NaN while something else than a push moves the objects. Only where there is a model; it need
      not be connected.
    * object_pose, for each object, with an ending of its own: vector of 3, X_WB, (x, y, theta), m
      and rad; theta does not jump by whole turns. NaN if the object was not seen.
    * covariance, for each object: vector of 9, covariance of the pose, row-major, m², m rad and
      rad²; NaN if the object was not seen.
    * seen, for each object: vector of 1, 1 if the object was seen in the picture that the pose is
      of, else 0.
    * message: abstract `str`, why the objects were not found yet; empty once they were.

    A picture is taken every `period`; its poses are on the ports `latency` later. While the lens is
    covered, which numeric parameter 0 says, nothing is seen. Abstract state: one `EstimatorState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        endings: Sequence[str],
        width: int,
        height: int,
        *,
        period: float,
        latency: float,
        occluded_by: Iterable[int],
        has_model: bool,
    ) -> None:
        """Declares the ports and the state.

        Args:
            endings: for each object, with what the names of its output ports end.
            width: width of the images, pixels.
            height: height of the images, pixels.
            period: time between two pictures, s.
            latency: time from a picture until its poses are on the ports, s.
            occluded_by: labels, in `label_image`, of whatever may hide the objects.
            has_model: whether `_predict` knows what pushes do to the objects.
        """
        super().__init__(EstimatorState(), period)
        self._count = len(endings)
        self._latency = latency
        self._has_model = has_model
        self._covered = self.DeclareNumericParameter(BasicVector([0.0]))
        self._inputs = RgbdInputs(self, width, height, occluded_by)
        if has_model:
            self._pusher = self.DeclareVectorInputPort("pusher_state", PUSHER_STATE_SIZE)
        for i, ending in enumerate(endings):
            self._declare(f"object_pose{ending}", 3, i, lambda found: found.pose)
            self._declare(f"covariance{ending}", 9, i, lambda found: np.ravel(found.covariance))
            self._declare(f"seen{ending}", 1, i, lambda found: [float(found.seen)])
        self._declare_value("message", lambda now: now.message)
        self.DeclareInitializationUnrestrictedUpdateEvent(self._look_first)

    def SetCovered(self, root_context: Context, covered: bool) -> None:
        """Covers the lens in a Diagram's Context, or uncovers it, from the next picture on."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(self._covered).SetFromVector([float(covered)])

    def _start(self, frame: Frame, hidden: NDArray[np.bool_] | None) -> TrackerStateType:
        """Returns the tracker's state before its first picture.

        Raises:
            PerceptionError: an object is not in view.
        """
        raise NotImplementedError

    def _track(
        self,
        tracker: TrackerStateType,
        frame: Frame,
        hidden: NDArray[np.bool_] | None,
        prediction: PredictionType | None,
        tip: Tip | None,
    ) -> tuple[TrackerStateType, Poses]:
        """Finds the objects in a picture.

        Args:
            tracker: the tracker's state after the picture before.
            frame: the picture.
            hidden: (height, width) the pixels that show what may hide the objects; None if unknown.
            prediction: where a model predicts the objects; None without one.
            tip: the finger's tip in the picture; None where it is not known.

        Returns:
            The tracker's state after the picture, and the poses.

        Raises:
            PerceptionError: the picture does not suit the tracker.
        """
        raise NotImplementedError

    def _predict(
        self, context: Context, prediction: PredictionType, last: Tip, now: Tip
    ) -> PredictionType:
        """Predicts the objects after the tip went straight from one place to another.

        It is only called where there is a model.
        """
        raise NotImplementedError

    def _correct(self, prediction: PredictionType | None, poses: Poses) -> PredictionType | None:
        """Returns the prediction after a picture: it begins anew where an object was seen.

        It is only called where there is a model.
        """
        raise NotImplementedError

    def _declare(self, name: str, size: int, i: int, calc: Callable[[TrackedPose], Any]) -> None:
        """Declares an output port of object i."""
        depends = {self._remembered, self.time_ticket()}
        self.DeclareVectorOutputPort(name, size, weakly(self._calc_found, i, calc), depends)

    def _calc_found(
        self, context: Context, output: BasicVector, i: int, calc: Callable[[TrackedPose], Any]
    ) -> None:
        """Puts what was found of object i on a port."""
        poses = find_report(self._get_state(context).reports, context.get_time())
        output.SetFromVector(calc(poses[i] if poses else NOT_SEEN))

    def _look_first(self, context: Context, state: State) -> None:
        """Looks in advance at what the first picture will show, so that poses are known at once."""
        if self._get_state(context).tracker is None:
            self._update(context, state)

    def _go_on(
        self, context: Context, now: EstimatorState[TrackerStateType, PredictionType]
    ) -> EstimatorState[TrackerStateType, PredictionType]:
        """Takes a picture."""
        time = context.get_time()
        after = now
        poses: Poses = (NOT_SEEN,) * self._count
        if not context.get_numeric_parameter(self._covered).value()[0]:
            # The objects are predicted, looked for about the prediction, and predicted anew from
            # where they were seen.
            frame = self._inputs.take_frame(context)
            after = self._follow_tip(context, now)
            after, poses = self._look(after, frame, self._inputs.find_occluded(context))
            if self._has_model:
                after = replace(after, prediction=self._correct(after.prediction, poses))
        reports = add_report(after.reports, time, time + self._latency, poses)
        return replace(after, reports=reports)

    def _follow_tip(
        self, context: Context, now: EstimatorState[TrackerStateType, PredictionType]
    ) -> EstimatorState[TrackerStateType, PredictionType]:
        """Predicts where the push since the last picture took the objects.

        Returns:
            The state with the tip's present place and with that prediction.
        """
        if not self._has_model or not self._pusher.HasValue(context):
            return now
        tip = Tip(context.get_time(), np.array(self._pusher.Eval(context)[:3]))
        prediction = now.prediction
        if prediction is not None and now.tip is not None:
            prediction = self._predict(context, prediction, now.tip, tip)
        return replace(now, tip=tip, prediction=prediction)

    def _look(
        self,
        state: EstimatorState[TrackerStateType, PredictionType],
        frame: Frame,
        hidden: NDArray[np.bool_] | None,
    ) -> tuple[EstimatorState[TrackerStateType, PredictionType], Poses]:
        """Finds the objects in a picture; returns the state afterwards, and the poses."""
        try:
            tracker = state.tracker or self._start(frame, hidden)
            tracker, poses = self._track(tracker, frame, hidden, state.prediction, state.tip)
        except PerceptionError as error:
            return replace(state, message=str(error)), (NOT_SEEN,) * self._count
        return replace(state, tracker=tracker, message=""), poses


def add_report(reports: Reports, time: float, ready: float, poses: Poses) -> Reports:
    """Adds the poses found in a picture to those that are on the ports, or will be.

    Args:
        reports: those of the pictures before.
        time: time of the picture, s.
        ready: time from which on its poses are on the ports, s.
        poses: the poses found in it.

    Returns:
        What is on the ports now and what is to come. The first picture is taken twice, once in
        advance; then the new poses replace the old ones.
    """
    present = max((at for at, _ in reports if at <= time), default=-np.inf)
    kept = tuple(report for report in reports if report[0] >= present and report[0] < ready)
    return (*kept, (ready, poses))


def find_report(reports: Reports, time: float) -> Poses:
    """Finds the poses that are on the ports at a time, s; empty before the first ones."""
    return next((poses for ready, poses in reversed(reports) if ready <= time), ())

"""`ObjectsPoseEstimator`: tracks several objects in a camera's pictures, a port for each.

It is `SceneTracker` between ports. One object is tracked by `ObjectPoseEstimator`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context, State

from gridpush_drake.errors import PerceptionError
from gridpush_drake.frozen import Unchanging
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.perception.foresight import (
    SceneForesight,
    ScenePushModel,
    Tip,
    foresee_scene,
)
from gridpush_drake.perception.frames import Frame
from gridpush_drake.perception.look_alikes import Expectation
from gridpush_drake.perception.scene_tracking import SceneState, SceneTracker
from gridpush_drake.perception.tracking import NOT_SEEN, TrackedPose
from gridpush_drake.systems.object_controller import AbstractStateSystem
from gridpush_drake.systems.object_pose_estimator import RgbdInputs, add_told, find_told
from gridpush_drake.systems.planar_pose_sensor import DEFAULT_PERIOD
from gridpush_drake.systems.pusher_gate import PUSHER_STATE_SIZE

Poses = tuple[TrackedPose, ...]
"""What one picture tells of each object; empty before the first one."""


@dataclass(frozen=True, eq=False)
class ObjectsEstimatorState(Unchanging):
    """All that the estimator remembers; never changed, only replaced.

    Attributes:
        tracker: state of the tracker after the last picture; None before the first picture in which
            all objects were found.
        told: poses, the latest last, each with the time from which on it is on the ports, s.
        message: why the objects were not found yet; empty once they were.
        tip: the finger's tip in the last picture; None where it is not known.
        foresight: where pushes have taken the objects since they were last seen; None before that.
    """

    tracker: SceneState | None = None
    told: tuple[tuple[float, Poses], ...] = ()
    message: str = ""
    tip: Tip | None = None
    foresight: SceneForesight | None = None


class ObjectsPoseEstimator(AbstractStateSystem[ObjectsEstimatorState]):
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
    one `ObjectsEstimatorState`.
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
        hidden_by: Iterable[int] = (),
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
            hidden_by: labels, in `label_image`, of whatever may hide the objects.
            model: what pushes do to the objects; None where nobody knows.
        """
        super().__init__(ObjectsEstimatorState(), period)
        self._tracker = tracker
        self._latency = latency
        self._guesses = guesses
        self._covered = self.DeclareNumericParameter(BasicVector([0.0]))
        self._inputs = RgbdInputs(self, width, height, hidden_by)
        self._model = model
        if model is not None:
            self._pusher = self.DeclareVectorInputPort("pusher_state", PUSHER_STATE_SIZE)
        for i in range(len(tracker)):
            self._declare(f"object_pose_{i}", 3, i, lambda told: told.pose)
            self._declare(f"covariance_{i}", 9, i, lambda told: np.ravel(told.covariance))
            self._declare(f"seen_{i}", 1, i, lambda told: [float(told.seen)])
        self._declare_value("message", lambda now: now.message)
        self.DeclareInitializationUnrestrictedUpdateEvent(self._look_first)

    def SetCovered(self, root_context: Context, covered: bool) -> None:
        """Covers the lens in a Diagram's Context, or uncovers it, from the next picture on."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(self._covered).SetFromVector([float(covered)])

    def _declare(self, name: str, size: int, i: int, calc: Callable[[TrackedPose], Any]) -> None:
        """Declares an output port of object i."""
        depends = {self._remembered, self.time_ticket()}
        calc_port = weakly(self._calc_told, i, calc)
        self.DeclareVectorOutputPort(name, size, calc_port, depends)

    def _calc_told(
        self, context: Context, output: BasicVector, i: int, calc: Callable[[TrackedPose], Any]
    ) -> None:
        """Says what is on a port of object i now."""
        poses = find_told(self._get_state(context).told, context.get_time(), ())
        output.SetFromVector(calc(poses[i] if poses else NOT_SEEN))

    def _look_first(self, context: Context, state: State) -> None:
        """Looks in advance at what the first picture will show, so that poses are known at once."""
        if self._get_state(context).tracker is None:
            self._update(context, state)

    def _go_on(self, context: Context, now: ObjectsEstimatorState) -> ObjectsEstimatorState:
        """Takes a picture."""
        time = context.get_time()
        after = now
        poses: Poses = (NOT_SEEN,) * len(self._tracker)
        if not context.get_numeric_parameter(self._covered).value()[0]:
            frame = self._inputs.take_frame(context)
            foreseen = self._foresee(context, now)
            after, poses = self._track(foreseen, frame, self._inputs.find_hidden(context))
            after = self._look_back(after, poses)
        return replace(after, told=add_told(after.told, time, time + self._latency, poses))

    def _foresee(self, context: Context, now: ObjectsEstimatorState) -> ObjectsEstimatorState:
        """Foretells where the objects are that were not seen in the last picture.

        Returns:
            The state with the tip's present place, and with where a push took the objects since.
        """
        model = self._model
        if model is None or not self._pusher.HasValue(context):
            return now
        tip = Tip(context.get_time(), np.array(self._pusher.Eval(context)[:3]))
        foresight = now.foresight
        if foresight is not None and now.tip is not None:
            foresight = foresee_scene(foresight, model, now.tip, tip)
        return replace(now, tip=tip, foresight=foresight)

    def _look_back(self, state: ObjectsEstimatorState, poses: Poses) -> ObjectsEstimatorState:
        """Begins to foretell anew from the poses that were seen."""
        if self._model is None:
            return state
        seen = np.array([each.pose for each in poses])
        before = state.foresight
        if before is not None:
            return replace(state, foresight=before.see(seen))
        # The first time, all of them are seen.
        if not np.isfinite(seen).all():
            return state
        known = np.ones(len(seen), dtype=bool)
        return replace(state, foresight=SceneForesight(told=seen, poses=seen, known=known))

    def _track(
        self, state: ObjectsEstimatorState, frame: Frame, hidden: NDArray[np.bool_] | None
    ) -> tuple[ObjectsEstimatorState, Poses]:
        """Finds the objects in a picture; returns the state afterwards, and the poses."""
        try:
            tracker = state.tracker or self._tracker.start(frame, self._guesses, hidden)
            tracker, poses = self._tracker.track(
                tracker, frame, hidden, self._expect(tracker, state.foresight)
            )
        except PerceptionError as error:
            return replace(state, message=str(error)), (NOT_SEEN,) * len(self._tracker)
        return replace(state, tracker=tracker, message=""), poses

    def _expect(
        self, tracker: SceneState, foresight: SceneForesight | None
    ) -> tuple[Expectation | None, ...] | None:
        """Says where the objects are expected that were hidden in the last picture."""
        if foresight is None or not any(each.hidden for each in tracker.objects):
            return None
        return tuple(
            expected if each.hidden else None
            for expected, each in zip(foresight.expect(), tracker.objects, strict=True)
        )

"""`ObjectPoseEstimator`: tracks an object in a camera's pictures; `PoseTracker` between ports."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from gridpush_drake.errors import PerceptionError
from gridpush_drake.frozen import Unchanging
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.foresight import Foresight, PushModel, Tip, foresee
from gridpush_drake.perception.frames import Frame
from gridpush_drake.perception.tracking import NOT_SEEN, PoseTracker, TrackedPose, TrackerState
from gridpush_drake.systems.object_controller import AbstractStateSystem
from gridpush_drake.systems.planar_pose_sensor import DEFAULT_PERIOD
from gridpush_drake.systems.pusher_gate import PUSHER_STATE_SIZE

MAX_LABEL = 2**15
"""All labels in an `ImageLabel16I` are less than this."""


@dataclass(frozen=True, eq=False)
class EstimatorState(Unchanging):
    """All that the estimator remembers; never changed, only replaced.

    Attributes:
        tracker: state of the tracker after the last picture; None before the first picture in which
            the object was found.
        told: poses, the latest last, each with the time from which on it is on the ports, s.
        message: why the object was not found yet; empty once it was.
        tip: the finger's tip in the last picture; None where it is not known.
        foresight: where pushes have taken the object since it was last seen; None before that.
    """

    tracker: TrackerState | None = None
    told: tuple[tuple[float, TrackedPose], ...] = ((-np.inf, NOT_SEEN),)
    message: str = ""
    tip: Tip | None = None
    foresight: Foresight | None = None


class RgbdInputs:
    """The input ports of a system that looks at the pictures of a color and depth camera."""

    def __init__(
        self, system: LeafSystem, width: int, height: int, hidden_by: Iterable[int]
    ) -> None:
        """Declares the ports `color_image`, `depth_image` and `label_image`.

        Only the first must be connected.

        Args:
            system: the system that gets the ports.
            width: width of the images, pixels.
            height: height of the images, pixels.
            hidden_by: labels, in `label_image`, of whatever may hide the object.
        """
        self._hidden = np.zeros(MAX_LABEL, dtype=bool)
        self._hidden[list(hidden_by)] = True
        self._color = system.DeclareAbstractInputPort(
            "color_image", Value(ImageRgba8U(width, height))
        )
        self._depth = system.DeclareAbstractInputPort(
            "depth_image", Value(ImageDepth32F(width, height))
        )
        self._labels = system.DeclareAbstractInputPort(
            "label_image", Value(ImageLabel16I(width, height))
        )

    def take_frame(self, context: Context) -> Frame:
        """Copies what is on the ports into a frame; without depth if that is not connected."""
        color: NDArray[np.uint8] = self._color.Eval(context).data[..., :3]
        depth: NDArray[np.float32] | None = None
        if self._depth.HasValue(context):
            depth = np.array(self._depth.Eval(context).data[..., 0])
        return Frame(np.array(color, order="C"), depth, context.get_time())

    def find_hidden(self, context: Context) -> NDArray[np.bool_] | None:
        """Finds the pixels (height, width) that show what may hide the object; None if unknown."""
        if not self._hidden.any() or not self._labels.HasValue(context):
            return None
        return self._hidden[self._labels.Eval(context).data[..., 0]]


class ObjectPoseEstimator(AbstractStateSystem[EstimatorState]):
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
        hidden_by: Iterable[int] = (),
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
            hidden_by: labels, in `label_image`, of whatever may hide the object.
            model: what pushes do to the object; None where nobody knows.
        """
        super().__init__(EstimatorState(), period)
        self._tracker = tracker
        self._latency = latency
        self._guess = None if guess is None else np.array(guess, dtype=np.float64)
        self._covered = self.DeclareNumericParameter(BasicVector([0.0]))
        self._inputs = RgbdInputs(self, width, height, hidden_by)
        self._model = model
        if model is not None:
            self._pusher = self.DeclareVectorInputPort("pusher_state", PUSHER_STATE_SIZE)
            self._mass = self.DeclareVectorInputPort("mass", model.obj.n)
            self._friction = self.DeclareVectorInputPort("friction", model.obj.n)
            self._contact_friction = self.DeclareVectorInputPort("contact_friction", 1)
        self._declare_outputs()
        self.DeclareInitializationUnrestrictedUpdateEvent(self._look_first)

    def SetCovered(self, root_context: Context, covered: bool) -> None:
        """Covers the lens in a Diagram's Context, or uncovers it, from the next picture on."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(self._covered).SetFromVector([float(covered)])

    def _declare_outputs(self) -> None:
        def declare(name: str, size: int, calc: Callable[[TrackedPose], Any]) -> None:
            self.DeclareVectorOutputPort(name, size, weakly(self._calc_told, calc), depends)

        depends = {self._remembered, self.time_ticket()}
        declare("object_pose", 3, lambda told: told.pose)
        declare("covariance", 9, lambda told: np.ravel(told.covariance))
        declare("seen", 1, lambda told: [float(told.seen)])
        self._declare_value("message", lambda now: now.message)

    def _calc_told(
        self, context: Context, output: BasicVector, calc: Callable[[TrackedPose], Any]
    ) -> None:
        output.SetFromVector(
            calc(find_told(self._get_state(context).told, context.get_time(), NOT_SEEN))
        )

    def _look_first(self, context: Context, state: State) -> None:
        """Looks in advance at what the first picture will show, so that a pose is known at once."""
        if self._get_state(context).tracker is None:
            self._update(context, state)

    def _go_on(self, context: Context, now: EstimatorState) -> EstimatorState:
        """Takes a picture."""
        time = context.get_time()
        after = now
        pose = NOT_SEEN
        if not context.get_numeric_parameter(self._covered).value()[0]:
            frame = self._inputs.take_frame(context)
            foreseen = self._foresee(context, now)
            after, pose = self._track(foreseen, frame, self._inputs.find_hidden(context))
            after = self._look_back(after, pose)
        return replace(after, told=add_told(after.told, time, time + self._latency, pose))

    def _foresee(self, context: Context, now: EstimatorState) -> EstimatorState:
        """Foretells where the object is that was not seen in the last picture.

        Returns:
            The state with the tip's present place, and with where a push took the object since.
        """
        model = self._model
        if model is None or not self._pusher.HasValue(context):
            return now
        tip = Tip(context.get_time(), np.array(self._pusher.Eval(context)[:3]))
        foresight = now.foresight
        if foresight is not None and now.tip is not None:
            foresight = foresee(foresight, model, partial(self._read_model, context), now.tip, tip)
        return replace(now, tip=tip, foresight=foresight)

    def _read_model(self, context: Context) -> CellParameters:
        """Reads what is estimated of the object; an even object where nothing is connected."""
        assert self._model is not None
        obj = self._model.obj
        ports = (self._mass, self._friction, self._contact_friction)
        if not all(port.HasValue(context) for port in ports):
            return CellParameters.uniform(obj)
        mass, friction, contact_friction = (np.array(port.Eval(context)) for port in ports)
        return CellParameters(mass, friction, float(contact_friction[0]))

    def _look_back(self, state: EstimatorState, pose: TrackedPose) -> EstimatorState:
        """Begins to foretell anew from a pose that was seen."""
        if self._model is None or not pose.seen:
            return state
        return replace(state, foresight=Foresight(told=pose.pose, pose=pose.pose))

    def _track(
        self, state: EstimatorState, frame: Frame, hidden: NDArray[np.bool_] | None
    ) -> tuple[EstimatorState, TrackedPose]:
        """Finds the object in a picture; returns the state afterwards, and the pose."""
        try:
            tracker = state.tracker or self._tracker.start(frame, self._guess, hidden)
            expected = None
            if state.foresight is not None and tracker.hidden:
                expected = state.foresight.expect()
            tracker, pose = self._tracker.track(tracker, frame, hidden, expected)
        except PerceptionError as error:
            return replace(state, message=str(error)), NOT_SEEN
        return replace(state, tracker=tracker, message=""), pose


Told = TypeVar("Told")
"""What a picture tells: the pose of one object, or of several."""


def add_told(
    told: tuple[tuple[float, Told], ...], time: float, ready: float, new: Told
) -> tuple[tuple[float, Told], ...]:
    """Adds what a picture told to what is on the ports, or will be.

    Args:
        told: what was told before, each with the time from which on it is on the ports, s.
        time: time of the picture, s.
        ready: time from which on its pose is on the ports, s.
        new: what it tells.

    Returns:
        What is on the ports now and what is to come. The first picture is taken twice, once in
        advance; then the new one replaces the old one.
    """
    present = max((at for at, _ in told if at <= time), default=-np.inf)
    kept = tuple(item for item in told if item[0] >= present and item[0] < ready)
    return (*kept, (ready, new))


def find_told(told: tuple[tuple[float, Told], ...], time: float, otherwise: Told) -> Told:
    """Finds what is on the ports at a time, s, of what was told; `otherwise` before the first."""
    return next((new for ready, new in reversed(told) if ready <= time), otherwise)

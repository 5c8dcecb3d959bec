"""`LiftScale`: weighs what the gripper lifts, by what the arm feels before and after.

Before the gripper has closed, the arm notes what it tells of an empty gripper. While it holds the
object up, it feels the weight and the torque of the weight about the grasp point. Both make a
`LiftTest`, which is added to the weighings so far.
"""

from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.pushes.weighings import FORCE_STD, TORQUE_STD, LiftTest, MassTestLog
from gridpush_drake.systems.base.messages import (
    GRASP_COMMAND_SIZE,
    GraspCommand,
    GraspPhase,
    GraspStatus,
)
from gridpush_drake.systems.base.object_controller import AbstractStateSystem

AVERAGED_POSE_COUNT = 8
"""Number of poses of the object before the grasp whose mean counts."""

BEFORE_PHASES = (GraspPhase.IDLE, GraspPhase.APPROACHING, GraspPhase.ENTERING)
"""Phases in which the object still lies where it lay."""

FORCE_FLOOR = 0.05
"""Standard deviation of a lift's weight that averaging does not take away, N."""

TORQUE_FLOOR = 0.01
"""Standard deviation of a lift's torque that averaging does not take away, N m: the place between
the pads is known to a millimeter or two."""


@dataclass(frozen=True)
class LiftOptions:
    """When a lifted object is weighed.

    Attributes:
        settle: how long the object is held before it is weighed, s.
        time: how long it is weighed, s.
        min_weight: a weight below this is not believed, N.
    """

    settle: float = 0.5
    time: float = 1.5
    min_weight: float = 0.3

    @classmethod
    def of_hold(cls, hold: float) -> "LiftOptions":
        """Makes the options with which a lift is over before an object was held so long, s."""
        return cls(settle=min(0.5, hold / 4), time=min(1.5, hold / 2))


@dataclass(frozen=True, eq=False)
class LiftScaleState(Unchanging):
    """All that the scale remembers; never changed, only replaced.

    Attributes:
        poses: the latest poses (x, y, theta) of the object before the grasp, m and rad.
        tare: mean wrench (6,) of the empty gripper and the number of samples in it.
        load: mean wrench (6,) of the gripper with the object, likewise.
        held_since: since when the object is held up, s; None while it is not.
        weighed: number of the grasp whose lift was written down last.
        lifts: the lifts so far.
    """

    poses: tuple[tuple[float, ...], ...] = ()
    tare: tuple[Array, int] = field(default_factory=lambda: (np.zeros(6), 0))
    load: tuple[Array, int] = field(default_factory=lambda: (np.zeros(6), 0))
    held_since: float | None = None
    weighed: int = 0
    lifts: tuple[LiftTest, ...] = ()


class LiftScale(AbstractStateSystem[LiftScaleState]):
    """Adds what lifts tell to the weighings so far.

    .. pydrake_system::

        name: LiftScale
        input_ports:
        - weighing_log
        - grasp_status
        - grasp_command
        - grasp_wrench
        - object_pose
        output_ports:
        - weighing_log

    * weighing_log (input): abstract `MassTestLog`, the presses so far.
    * grasp_status: abstract `GraspStatus` of the executor of grasps.
    * grasp_command: vector of 6, see `GraspCommand`. It need not be connected.
    * grasp_wrench: vector of 6, torque about the grasp point, N m, above force, N, on the gripper
      in W; a sample that is not finite is passed over.
    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad; NaN where it is not seen.
    * weighing_log (output): abstract `MassTestLog`, presses and lifts so far.

    Abstract state: one `LiftScaleState`.
    """

    __slots__ = NO_SLOTS

    def __init__(self, options: LiftOptions | None = None, *, period: float = 0.005) -> None:
        """Declares the system.

        Args:
            options: when an object is weighed.
            period: time between two samples, s.
        """
        super().__init__(LiftScaleState(), period)
        self._options = options or LiftOptions()
        self._log = self.DeclareAbstractInputPort("weighing_log", AbstractValue.Make(MassTestLog()))
        self._status = self.DeclareAbstractInputPort(
            "grasp_status", AbstractValue.Make(GraspStatus())
        )
        self._command = self.DeclareVectorInputPort("grasp_command", GRASP_COMMAND_SIZE)
        self._wrench = self.DeclareVectorInputPort("grasp_wrench", 6)
        self._pose = self.DeclareVectorInputPort("object_pose", 3)
        self.DeclareAbstractOutputPort(
            "weighing_log",
            lambda: AbstractValue.Make(MassTestLog()),
            weakly(self._calc_log),
            {self._remembered, self._log.ticket()},
        )

    def _go_on(self, context: Context, now: LiftScaleState) -> LiftScaleState:
        """Notes poses before a grasp, then the empty gripper, then the load."""
        status: GraspStatus = self._status.Eval(context)
        phase = status.phase
        # Only before the gripper closes does the object lie where it is seen on the table.
        if phase in BEFORE_PHASES:
            now = self._note_pose(context, now)
        if phase == GraspPhase.APPROACHING and now.tare[1]:
            # Another grasp has begun.
            now = replace(now, tare=LiftScaleState().tare)
        wrench = np.array(self._wrench.Eval(context))
        if not np.isfinite(wrench).all():
            return now
        # On its way in the gripper is empty and slow. Held up, the object weighs on it alone.
        if phase == GraspPhase.ENTERING:
            return replace(now, tare=_average(now.tare, wrench))
        if phase == GraspPhase.HOLDING and now.weighed != status.command_id:
            return self._weigh(context, now, wrench, status.command_id)
        if now.held_since is not None:
            return replace(now, held_since=None, load=LiftScaleState().load)
        return now

    def _note_pose(self, context: Context, now: LiftScaleState) -> LiftScaleState:
        """Remembers where the object is seen before it is gripped."""
        pose = tuple(self._pose.Eval(context).tolist())
        if not np.isfinite(pose).all() or now.poses[-1:] == (pose,):
            return now
        return replace(now, poses=(*now.poses, pose)[-AVERAGED_POSE_COUNT:])

    def _weigh(
        self, context: Context, now: LiftScaleState, wrench: Array, command_id: int
    ) -> LiftScaleState:
        """Averages the load of an object that is held up, and writes the lift down in the end."""
        time = context.get_time()
        if now.held_since is None:
            return replace(now, held_since=time, load=LiftScaleState().load)
        held = time - now.held_since
        if held < self._options.settle:
            return now
        now = replace(now, load=_average(now.load, wrench))
        if held < self._options.settle + self._options.time:
            return now
        # The lift is written down once for each grasp.
        command = GraspCommand.from_vector(self._command.Eval(context))
        lift = self._make_lift(now, command.p_WG[:2])
        lifts = now.lifts if lift is None else (*now.lifts, lift)
        return replace(now, lifts=lifts, weighed=command_id)

    def _make_lift(self, now: LiftScaleState, place: Array) -> LiftTest | None:
        """Makes the lift of what was averaged; None where nothing can be said.

        Args:
            now: the state.
            place: (2,) the middle between the pads when they closed, W, m.
        """
        if not now.poses or not now.tare[1]:
            return None
        # What was told of the empty gripper is no weight. The object pulls the gripper down.
        load = now.load[0] - now.tare[0]
        weight = -float(load[5])
        if not weight >= self._options.min_weight:
            return None
        samples = 1 / now.load[1] + 1 / now.tare[1]
        return LiftTest(
            pose=np.mean(now.poses, axis=0),
            place=place,
            weight=weight,
            torque=load[:2],
            weight_std=sqrt(FORCE_STD**2 * samples + FORCE_FLOOR**2),
            torque_std=sqrt(TORQUE_STD**2 * samples + TORQUE_FLOOR**2),
        )

    def _calc_log(self, context: Context, output: AbstractValue) -> None:
        log: MassTestLog = self._log.Eval(context)
        lifts = self._get_state(context).lifts
        output.set_value(replace(log, lifts=(*log.lifts, *lifts)) if lifts else log)


def _average(mean: tuple[Array, int], value: Array) -> tuple[Array, int]:
    """Adds a value to a mean of so many values."""
    before, count = mean
    return before + (value - before) / (count + 1), count + 1

"""`PressExecutor`: an arm presses on what hangs over the table's edge, and notes what it felt.

The tip goes over the object and down to just above it. Then `planning.weighing.press` takes over:
the tip goes down slowly until the object begins to tilt, and up again. Back where it rests, it
waits until the object was seen again without the arm before it: a press by which the object was
shifted or turned has slid, and says nothing of the weight. What is not done here is to choose where
to press (`planning.weighing.plan`) or to say what a press means
(`identification.absolute.estimate`).
"""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import shapely
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array, transform_shape, wrap_angle
from gridpush_drake.multibody.tool_motion import (
    ToolPose,
    TrajectorySegment,
    calc_tool_pose,
    make_transform,
)
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.closed_loop import Pose
from gridpush_drake.planning.weighing.press import (
    PressOptions,
    PressOutcome,
    PressPhase,
    PressSample,
    PressState,
    advance_press,
    break_off,
    has_slid,
)
from gridpush_drake.pushes.weighings import MassTestLog, TiltTest
from gridpush_drake.systems.base.messages import (
    PRESS_COMMAND_SIZE,
    GraspStatus,
    PressCommand,
    PressStatus,
    PressStep,
    PushStatus,
)
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.execution.push_executor import (
    NOT_FINITE,
    SPEED_SCALES,
    PushTrajectoryOptions,
    Reach,
)
from gridpush_drake.units import MM_PER_M

MAX_MOVE = 0.01
"""If a pressed object is seen farther than this from where it lay, m, the press is broken off. An
arm that gives way takes the object along a little."""

MAX_TURN = 0.1
"""If a pressed object is seen turned by more than this from how it lay, rad, the press is broken
off."""

MAX_MOVE_BEFORE = 0.003
"""If the object is seen farther than this from where it lay before the tip touches it, m, it is not
pressed: it is not where the press was planned, or it is seen wrongly."""

MAX_TURN_BEFORE = 0.025
"""If the object is seen turned by more than this from how it lay before the tip touches it, rad, it
is not pressed."""

MAX_SLIP = 0.0015
"""Distance between where an object lay before a press and where it lies afterwards, m, beyond which
it slid."""

MAX_SLIP_TURN = 0.006
"""Angle by which an object may be turned by a press, rad; beyond it, it slid. By presses that told
the weight it was turned by up to 0.003 rad."""

OBSERVATION_DELAY = 0.3
"""Time after which the pictures that are told show the tip at rest, s."""

OBSERVATION_TIME = 1.0
"""Time from when the tip is back from a press until it is judged where the object lies, s."""

NOTE_TIME = 0.3
"""Time for which the tip rests after a press before the executor is idle, s: more than it takes
whoever learns to see the weighing."""

ARM_PRESS = PressOptions(approach_speed=0.02, max_force=24.0)
"""How an arm presses: as `PressOptions`, but slower just above the object, so that the joints'
accelerations stay small."""

WHAT_CAME = {
    PressOutcome.TOO_HEAVY: "the object lay still up to the greatest force",
    PressOutcome.NO_CONTACT: "the tip met nothing where the object's top should be",
    PressOutcome.NO_FORCE: "force or place of the tip was not finite",
    PressOutcome.MOVED: "the object was seen to move away",
    PressOutcome.SLID: "the tip slid on the object, or the object under it",
    PressOutcome.BROKEN_OFF: "it was taken back",
}
"""What came of a press that gave no weighing, in half a sentence."""


@dataclass(frozen=True, eq=False)
class PressExecutorState(Unchanging):
    """All that the executor remembers; never changed, only replaced.

    Attributes:
        segments: the current motion through the air and those still to come.
        segment_start: when the current one began, s.
        command: the last command that was taken up.
        yaw: yaw of the tool, which stays as it is, rad.
        press: how the press stands; None before the tip is above the object.
        observations: poses X_WB of the object since the tip is back from the press, m and rad; no
            two that follow each other are of one picture.
        status: the status on the port.
        weighings: what came of the presses so far.
    """

    segments: tuple[TrajectorySegment, ...] = ()
    segment_start: float = 0.0
    command: PressCommand = field(default_factory=PressCommand)
    yaw: float = 0.0
    press: PressState | None = None
    observations: tuple[Pose, ...] = ()
    status: PressStatus = field(default_factory=PressStatus)
    weighings: MassTestLog = field(default_factory=MassTestLog)


class PressExecutor(AbstractStateSystem[PressExecutorState]):
    """Presses on a part of an object that hangs over the table's edge, with an arm's fingertip.

    While nothing is pressed, the pose that the other executors desire is passed on.

    A command is taken up when all executors are idle and its id differs from the last one's. It is
    refused, with the reason in the status, if its numbers are not finite, if the place is not on
    the object and beyond the edge, or if the arm cannot follow. A command that is taken back, by
    another one with id 0, and an object that is seen to move away end a press at once.

    .. pydrake_system::

        name: PressExecutor
        input_ports:
        - other_tip_pose
        - push_status
        - grasp_status
        - press_command
        - object_pose
        - pusher_state
        - force
        output_ports:
        - tip_pose
        - status
        - weighing_log

    * other_tip_pose: abstract `RigidTransform`, X_WP that the other executors desire, m; at rest
      while these are idle.
    * push_status: abstract `PushStatus` of the executor of pushes.
    * grasp_status: abstract `GraspStatus` of the executor of grasps; it need not be connected.
    * press_command: vector of 11, see `PressCommand`. It need not be connected.
    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad; NaN where it is not seen.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity v_WP, m/s.
    * force: vector of 3, force on the tip in W, N, with whatever offset it has.
    * tip_pose: abstract `RigidTransform`, desired X_WP, m.
    * status: abstract `PressStatus`, how the executor stands.
    * weighing_log: abstract `MassTestLog`, what came of all presses so far.

    Abstract state: one `PressExecutorState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        obj: GridObject,
        reach: Reach | None = None,
        style: PushTrajectoryOptions | None = None,
        options: PressOptions | None = None,
    ) -> None:
        """Makes an executor.

        Args:
            obj: the object.
            reach: says why the arm cannot follow a path; None if it always can.
            style: heights and speeds of the tip's way through the air, and its radius.
            options: how presses are made.
        """
        self.style = style or PushTrajectoryOptions()
        self.options = options or ARM_PRESS
        super().__init__(PressExecutorState(), self.style.period)
        self._outline = obj.outline
        self._reach = reach
        self._other_pose = self.DeclareAbstractInputPort(
            "other_tip_pose", AbstractValue.Make(RigidTransform())
        )
        self._push_status = self.DeclareAbstractInputPort(
            "push_status", AbstractValue.Make(PushStatus())
        )
        self._grasp_status = self.DeclareAbstractInputPort(
            "grasp_status", AbstractValue.Make(GraspStatus())
        )
        self._command = self.DeclareVectorInputPort("press_command", PRESS_COMMAND_SIZE)
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._tip = self.DeclareVectorInputPort("pusher_state", 6)
        self._force = self.DeclareVectorInputPort("force", 3)
        self.DeclareAbstractOutputPort(
            "tip_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            weakly(self._calc_tip_pose),
            {self.time_ticket(), self._remembered, self._other_pose.ticket()},
        )
        self._declare_value("status", lambda now: now.status)
        self._declare_value("weighing_log", lambda now: now.weighings)

    def _calc_tip_pose(self, context: Context, output: AbstractValue) -> None:
        now = self._get_state(context)
        # Through the air the trajectory leads the tip, in a press what `advance_press` commands.
        # While nothing is pressed, the other executors do.
        if now.segments:
            place = now.segments[0].position(context.get_time() - now.segment_start)
        elif now.status.step == PressStep.PRESSING and now.press is not None:
            assert now.press.command is not None
            place = now.press.command
        else:
            output.set_value(self._other_pose.Eval(context))
            return
        output.set_value(make_transform([*place, now.yaw]))

    def _go_on(self, context: Context, now: PressExecutorState) -> PressExecutorState:
        """Goes on with a press, or takes up or refuses a command."""
        if now.status.step == PressStep.IDLE:
            return self._take_up(context, now)
        if now.status.step == PressStep.PRESSING:
            return self._press(context, now)
        if now.status.step == PressStep.RETURNING and not now.segments:
            return self._look(context, now)
        return self._travel(context, now)

    def _take_up(self, context: Context, now: PressExecutorState) -> PressExecutorState:
        """Takes up or refuses a new command."""
        if not self._command.HasValue(context) or not self._push_status.Eval(context).ready:
            return now
        if self._grasp_status.HasValue(context) and not self._grasp_status.Eval(context).ready:
            return now
        command = PressCommand.from_vector(self._command.Eval(context))
        if command.command_id in (0, now.status.command_id):
            return now
        # The way begins and ends where the other executors have the tip at rest.
        rest = self._read_rest(context)
        if rest is None:
            return now
        segments, reason = self.plan(command, rest)
        if reason:
            refused = PressStatus(
                command_id=command.command_id, outcome=PressOutcome.REFUSED, reason=reason
            )
            return replace(now, status=refused)
        return replace(
            now,
            segments=segments,
            segment_start=context.get_time(),
            command=command,
            yaw=rest[3],
            press=None,
            status=PressStatus(PressStep.APPROACHING, command.command_id),
        )

    def plan(
        self, command: PressCommand, rest: ToolPose
    ) -> tuple[tuple[TrajectorySegment, ...], str]:
        """Plans the tip's way to just above the place, as fast as the arm can follow.

        Args:
            command: the press.
            rest: pose of the tool, which is at rest.

        Returns:
            The segments, and ""; or no segments, and why the command is refused.
        """
        reason = self._find_fault(command)
        if reason:
            return (), reason
        # The arm is asked about the way to the hovering place and, slowly, down to where the press
        # ends at the latest. A stretched arm may be able to follow at a lower speed.
        target = command.make_target(self.style.tip_radius)
        above = target.hover + np.array([0.0, 0.0, self.options.clearance])
        lowest = target.hover - np.array([0.0, 0.0, self.options.max_depth])
        stopped: str | None = ""
        for scale in SPEED_SCALES:
            segments = self._make_way(np.array(rest[:3]), above, PressStep.APPROACHING, scale)
            if self._reach is None:
                return segments, ""
            path = np.array([rest[:3], *(segment.end for segment in segments), lowest])
            speeds = [*(segment.top_speed for segment in segments), self.options.approach_speed]
            stopped = self._reach(path, np.array(speeds))
            if stopped is None:
                return segments, ""
        return (), stopped or ""

    def _find_fault(self, command: PressCommand) -> str:
        """Says what is wrong with a command; empty if nothing is."""
        if not np.isfinite(command.to_vector()).all():
            return NOT_FINITE
        target = command.make_target(self.style.tip_radius)
        where = f"({command.x:.3f}, {command.y:.3f}) m"
        if not target.calc_lever_arm(np.array(target.place)) > 0:
            return f"the tip would press inside the table's edge, at {where}"
        outline = transform_shape(command.object_pose, self._outline)
        if not outline.contains(shapely.Point(target.place)):
            return f"the tip would press beside the object, at {where}"
        highest = self.style.travel_height - self.style.tip_radius
        if not 0 < target.top < highest:
            return (
                f"the object's top is {target.top:.3f} m high; expected more than 0 and less than "
                f"{highest:.3f} m, above which the tip travels"
            )
        return ""

    def _make_way(
        self, start: Array, end: Array, step: PressStep, scale: float = 1.0
    ) -> tuple[TrajectorySegment, ...]:
        """Makes a way of the tip through the air: up, over and down.

        Args:
            start: (3,) p_WP, m.
            end: (3,) p_WP, m.
            step: what the way is part of.
            scale: factor of the speeds.
        """
        style = self.style
        high = max(style.travel_height, float(start[2]), float(end[2]))
        x0, y0, z0 = start.tolist()
        x1, y1, z1 = end.tolist()
        places = [(x0, y0, z0), (x0, y0, high), (x1, y1, high), (x1, y1, z1)]
        speeds = [style.vertical_speed, style.travel_speed, style.vertical_speed]
        return tuple(
            TrajectorySegment(step, first, last, scale * speed, style.travel_acceleration)
            for (first, last), speed in zip(pairwise(places), speeds, strict=True)
            if first != last
        )

    def _travel(self, context: Context, now: PressExecutorState) -> PressExecutorState:
        """Goes on through the air, to the object or back."""
        time = context.get_time()
        done, *left = now.segments
        if time - now.segment_start < done.duration:
            return now
        if left:
            return replace(now, segments=tuple(left), segment_start=time)
        if now.status.step == PressStep.RETURNING:
            return replace(now, segments=(), segment_start=time)
        # The tip is above the place: what it is commanded goes on from there.
        press = PressState(command=np.array(done.end), since=time, last=time)
        status = replace(now.status, step=PressStep.PRESSING)
        return replace(now, segments=(), press=press, status=status)

    def _press(self, context: Context, now: PressExecutorState) -> PressExecutorState:
        """Carries the press on by what is measured now."""
        assert now.press is not None
        sample = PressSample(
            time=context.get_time(),
            tip=np.array(self._tip.Eval(context)[:3]),
            force=np.array(self._force.Eval(context)),
        )
        # Two things end a press early that its force does not tell.
        target = now.command.make_target(self.style.tip_radius)
        press = now.press
        if self._command.Eval(context)[0] == 0:
            press = break_off(press, sample, PressOutcome.BROKEN_OFF)
        if self._has_moved(now, self._object_pose.Eval(context)):
            press = break_off(press, sample, PressOutcome.MOVED)
        # The tip is up again when the press is done; it then returns.
        press = advance_press(target, self.options, press, sample)
        rest = self._read_rest(context)
        if press.phase != PressPhase.DONE or rest is None:
            return replace(now, press=press)
        return self._return(context.get_time(), now, press, np.array(rest[:3]))

    def _read_rest(self, context: Context) -> ToolPose | None:
        """Reads where the other executors want the tool at rest; None while that is not finite."""
        rest = calc_tool_pose(self._other_pose.Eval(context))
        return rest if np.isfinite(rest).all() else None

    def _has_moved(self, now: PressExecutorState, pose: Array) -> bool:
        """Says whether an object that is seen at a pose (3,) is no longer where it lay."""
        assert now.press is not None
        if now.press.touched is None:
            return _is_off(now.command, pose, MAX_MOVE_BEFORE, MAX_TURN_BEFORE)
        return _is_off(now.command, pose, MAX_MOVE, MAX_TURN)

    def _return(
        self, time: float, now: PressExecutorState, press: PressState, rest: Array
    ) -> PressExecutorState:
        """Begins the way back to where the tip rests (3,), m."""
        assert press.command is not None
        return replace(
            now,
            segments=self._make_way(press.command, rest, PressStep.RETURNING),
            segment_start=time,
            press=press,
            observations=(),
            status=replace(now.status, step=PressStep.RETURNING),
        )

    def _look(self, context: Context, now: PressExecutorState) -> PressExecutorState:
        """Looks at the object after a press, and writes down what came of it.

        The executor is idle only `NOTE_TIME` later, so that whoever waits for it knows the
        weighing.
        """
        since = context.get_time() - now.segment_start
        if now.press is None:
            if since < NOTE_TIME:
                return now
            return replace(now, status=replace(now.status, step=PressStep.IDLE))
        if now.press.outcome != PressOutcome.TILTED:
            return self._finish(context.get_time(), now, ())
        pose = self._object_pose.Eval(context)
        observations = now.observations
        if since >= OBSERVATION_DELAY and np.isfinite(pose).all():
            x, y, theta = pose.tolist()
            if (x, y, theta) not in observations[-1:]:
                observations = (*observations, (x, y, theta))
        if since < OBSERVATION_TIME:
            return replace(now, observations=observations)
        return self._finish(context.get_time(), now, observations)

    def _finish(
        self, time: float, now: PressExecutorState, observations: tuple[Pose, ...]
    ) -> PressExecutorState:
        """Writes down what came of a press, after which the object was seen at some poses."""
        press = now.press
        assert press is not None and press.outcome is not None
        outcome = press.outcome
        weighing = None
        reason = ""
        if observations:
            reason = describe_slip(now.command, np.mean(observations, axis=0))
        if reason:
            outcome = PressOutcome.SLID
        else:
            target = now.command.make_target(self.style.tip_radius)
            weighing = press.make_weighing(target, self.options, now.command.object_pose)
            reason = describe_press(press, weighing)
        weighings = now.weighings
        if weighing is not None:
            weighings = replace(weighings, presses=(*weighings.presses, weighing))
        status = replace(
            now.status,
            outcome=outcome,
            reason=reason,
            weighed=weighing is not None,
        )
        return replace(
            now,
            segment_start=time,
            press=None,
            observations=(),
            status=status,
            weighings=weighings,
        )


def _is_off(command: PressCommand, pose: Array, max_move: float, max_turn: float) -> bool:
    """Says whether an object is seen at a pose (3,) too far from where it was to be pressed.

    Args:
        command: the press.
        pose: (3,) X_WB, m and rad; NaN where the object is not seen, which says nothing.
        max_move: greatest distance, m.
        max_turn: greatest angle, rad.
    """
    if not np.isfinite(pose).all():
        return False
    off = pose - command.object_pose
    far = np.linalg.norm(off[:2]) > max_move
    return bool(far or abs(wrap_angle(off[2])) > max_turn)


def describe_slip(command: PressCommand, pose: Array) -> str:
    """Says in half a sentence that an object slid by a press; "" where it did not.

    Args:
        command: the press, with the object's pose before it.
        pose: (3,) X_WB of the object after it, m and rad.
    """
    if not has_slid(np.array(command.object_pose), pose, MAX_SLIP, MAX_SLIP_TURN):
        return ""
    off = pose - command.object_pose
    turn = np.degrees(abs(wrap_angle(off[2])))
    return (
        f"the object slid by {MM_PER_M * np.linalg.norm(off[:2]):.1f} mm and turned by "
        f"{turn:.1f}°, so "
        "that its tilt says nothing of its weight"
    )


def describe_press(press: PressState, weighing: TiltTest | None) -> str:
    """Says in half a sentence what came of a press."""
    if weighing is not None:
        rocked = ""
        if weighing.rock_force is not None:
            rocked = f"it rocks at {weighing.rock_force:.1f} N, and "
        return (
            f"{rocked}it tilts at {weighing.force:.1f} N, {MM_PER_M * weighing.arm:.0f} mm beyond "
            "the "
            f"edge, and came back from {np.degrees(press.tilt):.1f}°"
        )
    assert press.outcome is not None
    return WHAT_CAME.get(press.outcome, "it tilted, but hardly any force was felt")

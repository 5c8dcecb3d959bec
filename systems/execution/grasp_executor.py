"""`GraspExecutor`: desired poses of the tool, and openings of the gripper, from grasp commands.

How the tool and the gripper move is in `systems.execution.grasp_trajectory`. Here the trajectory is
gone through, the gripper is watched, and a grasp that fails is given up.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context

from gridpush_drake.frozen import Unchanging
from gridpush_drake.multibody.tool_motion import (
    ToolPose,
    ToolTrajectorySegment,
    calc_tool_pose,
    make_transform,
)
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.systems.base.messages import (
    GRASP_COMMAND_SIZE,
    GraspCommand,
    GraspOutcome,
    GraspPhase,
    GraspStatus,
    PushStatus,
)
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.execution.grasp_trajectory import (
    GraspTrajectoryOptions,
    TurningReach,
    find_speed_scale,
    make_homing_trajectory,
    make_retreat_trajectory,
    plan_grasp,
)
from gridpush_drake.systems.execution.push_executor import NOT_FINITE, UNREADABLE_ID
from gridpush_drake.units import MM_PER_M

Validator = Callable[[GraspCommand], str | None]
"""A function that says why a command must not be carried out; None if it may."""

GRIPPER_STATE_SIZE = 4
"""Length of a gripper's state: positions of the left and right finger, m, and velocities, m/s."""

GRASPING_PHASES = (GraspPhase.CLOSING, GraspPhase.LIFTING, GraspPhase.HOLDING)
"""Phases in which something is in the gripper, or should be."""

SAME_PLACE = 1e-6
"""Two poses that differ by less than this, m and rad, need no motion from one to the other."""


@dataclass(frozen=True)
class GraspState(Unchanging):
    """All that the executor remembers.

    Attributes:
        segments: the current segment and those still to come; none while nothing is grasped.
        segment_start: time at which the current segment began, s.
        command: the last command that was taken up.
        speed_scale: factor of the traveling speeds at which the arm can follow it.
        closed: opening after the gripper had closed on the object, m.
        status: the status on the port, but for `fault`.
        fault: what on the input ports is not finite at present, and keeps the executor from going
            on; empty if nothing is.
    """

    segments: tuple[ToolTrajectorySegment, ...] = ()
    segment_start: float = 0.0
    command: GraspCommand = field(default_factory=GraspCommand)
    speed_scale: float = 1.0
    closed: float = 0.0
    status: GraspStatus = field(default_factory=GraspStatus)
    fault: str = ""

    @property
    def shown_status(self) -> GraspStatus:
        """The status on the port."""
        if not self.fault:
            return self.status
        outcome = GraspOutcome.REFUSED if self.fault == UNREADABLE_ID else self.status.outcome
        return replace(self.status, outcome=outcome, reason=self.fault)


class GraspExecutor(AbstractStateSystem[GraspState]):
    """Grasps from the side what overhangs the table's edge, lifts it and holds it.

    While nothing is grasped, the pose that the executor of pushes desires is passed on.

    A command is taken up when both executors are idle and the command's id differs from the last
    one's. It is refused, with the reason in the status, if its numbers are not usable, or if the
    arm cannot follow. While an input that it needs is not finite, it waits where it is, and the
    status says why. After a grasp that failed the tool goes back to the pose of the executor of
    pushes. The pose is continuous, and so are its first two derivatives.

    .. pydrake_system::

        name: GraspExecutor
        input_ports:
        - push_tip_pose
        - push_status
        - grasp_command
        - gripper_state
        output_ports:
        - tip_pose
        - gripper_position
        - gripper_force_limit
        - status

    * push_tip_pose: abstract `RigidTransform`, X_WP that the executor of pushes desires, m; it is
      at rest while that is idle.
    * push_status: abstract `PushStatus` of the executor of pushes.
    * grasp_command: vector of 6, command_id, x, y, z (m), approach (rad) and lift (m), see
      `GraspCommand`. It need not be connected.
    * gripper_state: vector of 4, positions of the left and right finger, m, and their velocities,
      m/s.
    * tip_pose: abstract `RigidTransform`, desired X_WP, m.
    * gripper_position: vector of 1, the opening that is asked for, m.
    * gripper_force_limit: vector of 1, the greatest force of a finger, N.
    * status: abstract `GraspStatus`, how the executor stands.

    Abstract state: one `GraspState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        reach: TurningReach | None = None,
        style: GraspTrajectoryOptions | None = None,
        validator: Validator | None = None,
    ):
        """Makes an executor.

        Args:
            reach: says what stops the arm on a path; None if nothing ever does.
            style: measures, heights, speeds and times.
            validator: says what else speaks against a command; None for nothing.
        """
        self.style = style or GraspTrajectoryOptions()
        super().__init__(GraspState(), self.style.period)
        self._reach = reach
        self._validator = validator
        self._push_pose = self.DeclareAbstractInputPort(
            "push_tip_pose", AbstractValue.Make(RigidTransform())
        )
        self._push_status = self.DeclareAbstractInputPort(
            "push_status", AbstractValue.Make(PushStatus())
        )
        self._command = self.DeclareVectorInputPort("grasp_command", GRASP_COMMAND_SIZE)
        self._gripper = self.DeclareVectorInputPort("gripper_state", GRIPPER_STATE_SIZE)
        remembered = self._remembered
        self.DeclareAbstractOutputPort(
            "tip_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            weakly(self._calc_tip_pose),
            {self.time_ticket(), remembered, self._push_pose.ticket()},
        )
        self.DeclareVectorOutputPort(
            "gripper_position", 1, weakly(self._calc_position), {self.time_ticket(), remembered}
        )
        self.DeclareVectorOutputPort(
            "gripper_force_limit", 1, weakly(self._calc_force_limit), {self.nothing_ticket()}
        )
        self._declare_value("status", lambda now: now.shown_status)

    def _calc_tip_pose(self, context: Context, output: AbstractValue) -> None:
        state = self._get_state(context)
        if state.segments:
            pose = state.segments[0].position(context.get_time() - state.segment_start)
            output.set_value(make_transform(pose))
        else:
            output.set_value(self._push_pose.Eval(context))

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        state = self._get_state(context)
        opening = self.style.opening
        if state.segments:
            opening = state.segments[0].calc_opening(context.get_time() - state.segment_start)
        output.SetAtIndex(0, opening)

    def _calc_force_limit(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self.style.force)

    def _go_on(self, context: Context, now: GraspState) -> GraspState:
        """Goes on with a grasp, or takes up or refuses a command."""
        time = context.get_time()
        fault = self._find_bad_input(context, now)
        if fault != now.fault:
            now = replace(now, fault=fault)
        if fault:
            return now
        if now.segments:
            return self._follow(context, now, time)
        return self._take_up(context, now, time)

    def _find_bad_input(self, context: Context, now: GraspState) -> str:
        """Names an input that is needed at present and is not finite; empty if there is none."""
        busy = bool(now.segments)
        if not busy:
            command_id = self._command.Eval(context)[0] if self._command.HasValue(context) else 0
            if not np.isfinite(command_id):
                return UNREADABLE_ID
            if command_id in (0, now.status.command_id):
                return ""
        if not np.isfinite(self._push_pose.Eval(context).translation()).all():
            return "the push executor's pose is not finite"
        if (
            busy
            and now.segments[0].phase in GRASPING_PHASES
            and not np.isfinite(self._gripper.Eval(context)).all()
        ):
            return "the gripper's state is not finite"
        return ""

    def _take_up(self, context: Context, now: GraspState, time: float) -> GraspState:
        """Takes up or refuses a new command."""
        if not self._command.HasValue(context) or not self._push_status.Eval(context).ready:
            return now
        vector = self._command.Eval(context)
        if vector[0] in (0, now.status.command_id):
            return now
        command = GraspCommand.from_vector(vector)
        rest = calc_tool_pose(self._push_pose.Eval(context))
        segments, reason = self.plan(command, rest)
        if reason:
            refused = GraspStatus(
                command_id=command.command_id, outcome=GraspOutcome.REFUSED, reason=reason
            )
            return replace(now, status=refused)
        return GraspState(
            segments=segments,
            segment_start=time,
            command=command,
            speed_scale=find_speed_scale(segments, self.style),
            closed=0.0,
            status=GraspStatus(GraspPhase(segments[0].phase), command.command_id),
        )

    def plan(
        self, command: GraspCommand, rest: ToolPose
    ) -> tuple[tuple[ToolTrajectorySegment, ...], str]:
        """Plans a grasp.

        Args:
            command: the grasp.
            rest: pose of the tool, which is at rest.

        Returns:
            The segments, and ""; or no segments, and why the command is refused.
        """
        reason = self._find_fault(command)
        if not reason and self._validator is not None:
            reason = self._validator(command)
        if reason:
            return (), reason
        return plan_grasp(command, rest, self.style, self._reach)

    def _find_fault(self, command: GraspCommand) -> str | None:
        """Says what is wrong with the numbers of a command; None if nothing is."""
        if not np.isfinite(command.to_vector()).all():
            return NOT_FINITE
        if not 0.0 < command.lift <= self.style.max_lift:
            return (
                f"lift {command.lift:.3g} m; "
                f"expected more than 0, at most {self.style.max_lift:.3g}"
            )
        return None

    def _follow(self, context: Context, now: GraspState, time: float) -> GraspState:
        """Goes on with the segments, and looks at the gripper while it grasps.

        A grasp that fails is given up as soon as the tool rests.
        """
        segment = now.segments[0]
        left = now.segments[1:]
        over = time - now.segment_start >= segment.duration
        grasping = segment.phase in GRASPING_PHASES
        if grasping and not now.status.outcome:
            closed = over and bool(left) and left[0].phase == GraspPhase.LIFTING
            now = self._look(context, now, closed)
        failed = now.status.outcome in (GraspOutcome.MISSED, GraspOutcome.SLIPPED)
        at_rest = over or not segment.top_speed
        if grasping and failed and at_rest:
            return self._turn_back(context, now, time)
        if not over or now.status.outcome == GraspOutcome.HELD:
            return now
        if left:
            return replace(
                now,
                segments=left,
                segment_start=time,
                status=replace(now.status, phase=GraspPhase(left[0].phase)),
            )
        if segment.phase == GraspPhase.HOLDING:
            return replace(now, status=replace(now.status, outcome=GraspOutcome.HELD))
        return self._come_home(context, now, time)

    def _look(self, context: Context, now: GraspState, closed: bool) -> GraspState:
        """Notes whether the gripper has closed on something, and whether that is being lost.

        Args:
            context: the system's Context.
            now: the state.
            closed: whether the gripper has just closed, and is about to be lifted.
        """
        opening = self._calc_opening(context)
        if closed and opening < self.style.min_width:
            reason = f"the gripper closed to {MM_PER_M * opening:.1f} mm: nothing is in it"
            return self._fail(now, GraspOutcome.MISSED, reason)
        if closed:
            return replace(now, closed=opening)
        least = max(now.closed - self.style.max_slip, self.style.min_width)
        if now.status.phase == GraspPhase.CLOSING or opening > least:
            return now
        reason = f"the opening fell from {MM_PER_M * now.closed:.1f} to {MM_PER_M * opening:.1f} mm"
        return self._fail(now, GraspOutcome.SLIPPED, reason)

    def _fail(self, now: GraspState, outcome: GraspOutcome, reason: str) -> GraspState:
        """Returns the state of a grasp that has failed; the tool still has to come back."""
        return replace(now, status=replace(now.status, outcome=outcome, reason=reason))

    def _turn_back(self, context: Context, now: GraspState, time: float) -> GraspState:
        """Begins the way back from a grasp that has failed."""
        x, y, z, yaw = now.segments[0].end
        rest = calc_tool_pose(self._push_pose.Eval(context))
        opening = self._calc_opening(context)
        opening = max(opening, 0.0) if np.isfinite(opening) else self.style.opening
        segments = make_retreat_trajectory(
            (x, y, z, yaw), opening, rest, now.command.approach, self.style, now.speed_scale
        )
        return replace(
            now,
            segments=segments,
            segment_start=time,
            status=replace(now.status, phase=GraspPhase(segments[0].phase)),
        )

    def _come_home(self, context: Context, now: GraspState, time: float) -> GraspState:
        """Hands back to the executor of pushes, once the tool is where that one wants it."""
        if not self._push_status.Eval(context).ready:
            return now
        rest = calc_tool_pose(self._push_pose.Eval(context))
        at = now.segments[0].end
        if np.allclose(rest, at, rtol=0.0, atol=SAME_PLACE):
            status = replace(now.status, phase=GraspPhase.IDLE)
            return replace(now, segments=(), segment_start=time, status=status)
        segments = make_homing_trajectory(at, rest, self.style, now.speed_scale)
        return replace(now, segments=segments, segment_start=time)

    def _calc_opening(self, context: Context) -> float:
        """Calculates the gripper's opening, m, from the positions of its fingers."""
        left, right, *_ = self._gripper.Eval(context)
        return float(right - left)

"""`GraspExecutor`: from a grasp command to the tool's desired pose and the gripper's opening."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context

from gridpush_drake.systems import grasp_status
from gridpush_drake.systems.grasp_command import GRASP_COMMAND_SIZE, GraspCommand
from gridpush_drake.systems.grasp_status import HELD, MISSED, REFUSED, SLIPPED, GraspOutcome, GraspStatus
from gridpush_drake.systems.grasp_way import (
    GraspingStyle,
    calc_yaws,
    make_grasp_legs,
    make_homing_legs,
    make_retreat_legs,
)
from gridpush_drake.systems.push_executor import HURRIES, NOT_FINITE, UNREADABLE
from gridpush_drake.systems.push_status import PushStatus
from gridpush_drake.systems.replaced_state import ReplacedStateSystem
from gridpush_drake.systems.tool_motion import ToolLeg, ToolPose, calc_tool_pose, make_transform
from gridpush_drake.systems.weak_calc import NO_SLOTS, weakly

Array = NDArray[np.float64]
TurningReach = Callable[[Array, Array, Array], str | None]
"""Of the tip's way (k, 3), m in W, speeds (k - 1,) on its pieces, m/s, and yaws (k,), rad: None, or what stops it."""

Objection = Callable[[GraspCommand], str | None]
"""Of a command: None, or why it must not be carried out."""

GRIPPER_STATE_SIZE = 4
"""Positions of left and right finger, m, and their velocities, m/s."""

GRASPING = (grasp_status.CLOSING, grasp_status.LIFTING, grasp_status.HOLDING)
"""Phases with something in the gripper, or so it should be."""

SAME_PLACE = 1e-6
"""m and rad, of two poses that need no way between them."""


@dataclass(frozen=True)
class GraspState:
    """All that the executor remembers.

    Attributes:
        legs: the current one and those still to come; none while it passes the push executor's pose through.
        leg_start: when the current one began, s.
        command: the last one taken up.
        hurry: share of the travelling speeds at which the arm can follow it.
        closed: opening when the gripper had closed on the object, m.
        status: as on the port, but for what is not finite at present.
        fault: what on the ports is not finite, and keeps the executor from going on; empty for nothing.
    """

    legs: tuple[ToolLeg, ...] = ()
    leg_start: float = 0.0
    command: GraspCommand = field(default_factory=GraspCommand)
    hurry: float = 1.0
    closed: float = 0.0
    status: GraspStatus = field(default_factory=GraspStatus)
    fault: str = ""

    @property
    def shown_status(self) -> GraspStatus:
        """As on the port."""
        if not self.fault:
            return self.status
        outcome = REFUSED if self.fault == UNREADABLE else self.status.outcome
        return replace(self.status, outcome=outcome, reason=self.fault)


class GraspExecutor(ReplacedStateSystem[GraspState]):
    """Grasps what overhangs the table's rim, from the side, lifts it and holds it; else passes the finger's pose on.

    A command is taken up when the push executor is idle, this one too, and the command's number is not the last one's.
    It is refused, with its reason in the status, where its numbers are not usable and where the arm cannot follow.
    While what it needs to see is not finite it waits where it is, and the status says why.
    After a grasp that failed the tool goes back to the push executor's pose. The pose is continuous, and so are its
    first two derivatives.

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

    Ports:
        push_tip_pose: abstract `RigidTransform`, X_WP that the push executor desires; at rest while that is idle.
        push_status: abstract `PushStatus`.
        grasp_command: vector of 6, see `GraspCommand`: number, x, y, z (m), approach (rad), lift (m). Need not be
            connected where nothing is grasped.
        gripper_state: vector of 4, the fingers' positions, left and right, m, and velocities, m/s.
        tip_pose: abstract `RigidTransform`, X_WP desired.
        gripper_position: vector of 1, the opening asked for, m.
        gripper_force_limit: vector of 1, N.
        status: abstract `GraspStatus`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        reach: TurningReach | None = None,
        style: GraspingStyle | None = None,
        objection: Objection | None = None,
    ):
        """Makes an executor.

        Args:
            reach: whether the arm can follow a way; None trusts it.
            style: measures, heights, speeds and times.
            objection: what else speaks against a command; None for nothing.
        """
        self.style = style or GraspingStyle()
        super().__init__(GraspState(), self.style.period)
        self._reach, self._objection = reach, objection
        self._push_pose = self.DeclareAbstractInputPort("push_tip_pose", AbstractValue.Make(RigidTransform()))
        self._push_status = self.DeclareAbstractInputPort("push_status", AbstractValue.Make(PushStatus()))
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
        self.DeclareVectorOutputPort("gripper_force_limit", 1, weakly(self._calc_force_limit), {self.nothing_ticket()})
        self.DeclareAbstractOutputPort(
            "status", lambda: AbstractValue.Make(GraspStatus()), weakly(self._calc_status), {remembered}
        )

    def _calc_tip_pose(self, context: Context, output: AbstractValue) -> None:
        state = self._get_state(context)
        if state.legs:
            output.set_value(make_transform(state.legs[0].calc_pose(context.get_time() - state.leg_start)))
        else:
            output.set_value(self._push_pose.Eval(context))

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        state, opening = self._get_state(context), self.style.opening
        if state.legs:
            opening = state.legs[0].calc_opening(context.get_time() - state.leg_start)
        output.SetAtIndex(0, opening)

    def _calc_force_limit(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self.style.force)

    def _calc_status(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._get_state(context).shown_status)

    def _go_on(self, context: Context, now: GraspState) -> GraspState:
        """Goes on with a grasp, or takes up or refuses a command."""
        time, fault = context.get_time(), self._find_bad_input(context, now)
        if fault != now.fault:
            now = replace(now, fault=fault)
        if fault:
            return now
        return self._follow(context, now, time) if now.legs else self._take_up(context, now, time)

    def _find_bad_input(self, context: Context, now: GraspState) -> str:
        """What is needed at present and not finite; empty for nothing."""
        busy = bool(now.legs)
        if not busy:
            number = self._command.Eval(context)[0] if self._command.HasValue(context) else 0
            if not np.isfinite(number):
                return UNREADABLE
            if number in (0, now.status.number):
                return ""
        if not np.isfinite(self._push_pose.Eval(context).translation()).all():
            return "the push executor's pose is not finite"
        if busy and now.legs[0].phase in GRASPING and not np.isfinite(self._gripper.Eval(context)).all():
            return "the gripper's state is not finite"
        return ""

    def _take_up(self, context: Context, now: GraspState, time: float) -> GraspState:
        if not self._command.HasValue(context) or not self._push_status.Eval(context).ready:
            return now
        vector = self._command.Eval(context)
        if vector[0] in (0, now.status.number):
            return now
        command = GraspCommand.from_vector(vector)
        rest = calc_tool_pose(self._push_pose.Eval(context))
        legs, reason = self.plan(command, rest)
        if reason:
            return replace(now, status=GraspStatus(number=command.number, outcome=REFUSED, reason=reason))
        status = GraspStatus(legs[0].phase, command.number)
        return GraspState(legs, time, command, _find_hurry(legs, self.style), 0.0, status)

    def plan(self, command: GraspCommand, rest: ToolPose) -> tuple[tuple[ToolLeg, ...], str]:
        """Plans a grasp from a pose of the tool; returns its legs, or none and why it is refused."""
        reason = self._find_fault(command) or (self._objection and self._objection(command))
        if reason:
            return (), reason
        return plan_grasp(command, rest, self.style, self._reach)

    def _find_fault(self, command: GraspCommand) -> str | None:
        if not np.isfinite(command.to_vector()).all():
            return NOT_FINITE
        if not 0.0 < command.lift <= self.style.largest_lift:
            return f"lift {command.lift:.3g} m; expected more than 0, at most {self.style.largest_lift:.3g}"
        return None

    def _follow(self, context: Context, now: GraspState, time: float) -> GraspState:
        """Looks at the gripper; the next leg when one is done. What fails is given up as soon as the tool rests."""
        leg, left = now.legs[0], now.legs[1:]
        over = time - now.leg_start >= leg.duration
        if leg.phase in GRASPING and not now.status.outcome:
            now = self._look(context, now, closed=over and bool(left) and left[0].phase == grasp_status.LIFTING)
        if leg.phase in GRASPING and now.status.outcome in (MISSED, SLIPPED) and (over or not leg.top_speed):
            return self._turn_back(context, now, time)
        if not over or now.status.outcome == HELD:
            return now
        if left:
            return replace(now, legs=left, leg_start=time, status=replace(now.status, phase=left[0].phase))
        if leg.phase == grasp_status.HOLDING:
            return replace(now, status=replace(now.status, outcome=HELD))
        return self._come_home(context, now, time)

    def _look(self, context: Context, now: GraspState, closed: bool) -> GraspState:
        """Notes whether the gripper has closed on something, and whether that is being lost."""
        opening = self._calc_opening(context)
        if closed and opening < self.style.least_width:
            return self._fail(now, MISSED, f"the gripper closed to {1e3 * opening:.1f} mm: nothing is in it")
        if closed:
            return replace(now, closed=opening)
        least = max(now.closed - self.style.most_slip, self.style.least_width)
        if now.status.phase == grasp_status.CLOSING or opening > least:
            return now
        return self._fail(now, SLIPPED, f"the opening fell from {1e3 * now.closed:.1f} to {1e3 * opening:.1f} mm")

    def _fail(self, now: GraspState, outcome: GraspOutcome, reason: str) -> GraspState:
        return replace(now, status=replace(now.status, outcome=outcome, reason=reason))

    def _turn_back(self, context: Context, now: GraspState, time: float) -> GraspState:
        x, y, z, yaw = now.legs[0].end
        rest = calc_tool_pose(self._push_pose.Eval(context))
        opening = self._calc_opening(context)
        opening = max(opening, 0.0) if np.isfinite(opening) else self.style.opening
        legs = make_retreat_legs((x, y, z, yaw), opening, rest, now.command.approach, self.style, now.hurry)
        return replace(now, legs=legs, leg_start=time, status=replace(now.status, phase=legs[0].phase))

    def _come_home(self, context: Context, now: GraspState, time: float) -> GraspState:
        """Hands back to the push executor, where the tool is where that one has it."""
        rest, at = calc_tool_pose(self._push_pose.Eval(context)), now.legs[0].end
        if not self._push_status.Eval(context).ready:
            return now
        if not np.allclose(rest, at, rtol=0.0, atol=SAME_PLACE):
            return replace(now, legs=make_homing_legs(at, rest, self.style, now.hurry), leg_start=time)
        return replace(now, legs=(), leg_start=time, status=replace(now.status, phase=grasp_status.IDLE))

    def _calc_opening(self, context: Context) -> float:
        left, right, *_ = self._gripper.Eval(context)
        return float(right - left)


def plan_grasp(
    command: GraspCommand, rest: ToolPose, style: GraspingStyle, reach: TurningReach | None
) -> tuple[tuple[ToolLeg, ...], str]:
    """Plans the way of a grasp, as fast as the arm can follow.

    Args:
        command: the grasp.
        rest: where the tool is.
        style: measures, heights, speeds and times.
        reach: whether the arm can follow a way; None trusts it.

    Returns:
        The legs, and ""; or no legs, and why the arm cannot follow.
    """
    reasons: list[str] = []
    for yaw in calc_yaws(command.approach):
        for hurry in HURRIES:
            legs = make_grasp_legs(command, rest, style, yaw, hurry)
            found = reach and reach(*_describe(legs))
            if not found:
                return legs, ""
            reasons.append(found)
    return (), reasons[len(HURRIES) - 1]  # of the lesser turn, as slow as can be


def _describe(legs: tuple[ToolLeg, ...]) -> tuple[Array, Array, Array]:
    """Way, speeds and yaws of the legs that move."""
    moving = [leg for leg in legs if leg.top_speed > 0.0]
    corners = np.array([moving[0].start] + [leg.end for leg in moving])
    return corners[:, :3], np.array([leg.top_speed for leg in moving]), corners[:, 3]


def _find_hurry(legs: tuple[ToolLeg, ...], style: GraspingStyle) -> float:
    """Share of the travelling speeds at which legs were planned."""
    return min(leg.speed for leg in legs if leg.phase == grasp_status.APPROACHING) / style.vertical_speed

"""`GraspExecutor`: from a grasp command to the tool's desired pose and the gripper's opening.

The tool takes the object from beyond the table's edge, and goes back: up from the pushing finger's
rest, over to above the standoff while the tool turns, down beyond the edge, in, close, up.

The gripper's grasp frame G is fixed to the tip's frame P. The fingers point along P's x axis, which
is W's -x at yaw 0:

    yaw = approach - pi,   p_WP = p_WG - R_WP(yaw) p_PG
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import pi
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array, make_direction
from gridpush_drake.multibody.tool_motion import (
    ToolPose,
    ToolTrajectorySegment,
    calc_tool_pose,
    calc_tool_rotation,
    make_transform,
)
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.planning.pregrasp.gripper import Gripper
from gridpush_drake.systems.messages import (
    GRASP_COMMAND_SIZE,
    GraspCommand,
    GraspOutcome,
    GraspPhase,
    GraspStatus,
    PushStatus,
)
from gridpush_drake.systems.object_controller import AbstractStateSystem
from gridpush_drake.systems.push_executor import NOT_FINITE, SPEED_SCALES, UNREADABLE

CONTROLLER_STIFFNESS = 200.0
"""Of Drake's SchunkWsgPositionController between the opening that is asked for and the one there
is, N/m."""


@dataclass(frozen=True)
class GraspTrajectoryOptions:
    """How grasps are carried out.

    Attributes:
        p_PG: (3,) from the tip's center to the grasp point, in the tip's frame P, m.
        travel_height: of the tip's center while it passes over the object, m.
        standoff: from where the gripper comes down to where it closes, m.
        travel_speed: m/s.
        vertical_speed: of coming down and going up beyond the edge, m/s.
        entering_speed: of going in and out, m/s.
        lifting_speed: m/s.
        travel_acceleration: m/s².
        careful_acceleration: of going in and lifting, m/s².
        force: of the gripper, N.
        opening: of the gripper but when it grasps, m.
        closing_speed: change of the opening asked for until the pads would meet, m/s.
        squeeze_time: over which the whole force is asked for afterwards, s.
        settle_time: with the whole force before the opening is looked at, s.
        opening_time: of letting go, s.
        hold_time: how long the object is held up before it counts as held, s.
        min_width: of what is between the pads where something is, m.
        max_slip: the least that the opening falls by where the object is being lost, m.
        max_lift: that is not refused, m.
        period: of the state's update, s.
    """

    p_PG: tuple[float, float, float] = (0.169383, 0.0, -0.235)
    travel_height: float = 0.12
    standoff: float = Gripper.standoff
    travel_speed: float = 0.3
    vertical_speed: float = 0.15
    entering_speed: float = 0.05
    lifting_speed: float = 0.05
    travel_acceleration: float = 1.0
    careful_acceleration: float = 0.1
    force: float = Gripper.max_force
    opening: float = Gripper.opening
    closing_speed: float = Gripper.closing_speed
    squeeze_time: float = 0.5
    settle_time: float = 0.3
    opening_time: float = 0.6
    hold_time: float = 3.0
    min_width: float = 0.004
    max_slip: float = 0.006
    max_lift: float = 0.2
    period: float = 0.005

    @classmethod
    def of_gripper(cls, gripper: Gripper, force: float, **others: Any) -> "GraspTrajectoryOptions":
        """How a gripper grasps that is asked to press with a force, N.

        Args:
            gripper: says opening, closing speed, standoff and the greatest force.
            force: asked for, N; no more than the gripper's greatest is used.
            **others: fields that the gripper does not say.
        """
        return cls(
            standoff=gripper.standoff,
            force=gripper.limit_force(force),
            opening=gripper.opening,
            closing_speed=gripper.closing_speed,
            **others,
        )

    @property
    def squeeze(self) -> float:
        """Opening at which the gripper's controller, whose spring pulls towards it, asks for the whole force, m."""
        return -self.force / CONTROLLER_STIFFNESS


def calc_yaws(approach: float) -> tuple[float, float]:
    """The tool's yaws whose fingers point along `approach` (rad) and that a wrist may have, the smaller first, rad."""
    near = (approach - pi + pi) % (2 * pi) - pi
    return near, near - np.copysign(2 * pi, near)


def calc_tip(style: GraspTrajectoryOptions, p_WG: Array, yaw: float) -> Array:
    """p_WP (3,) of the tip's center where the grasp point is p_WG (3,), m."""
    return np.asarray(p_WG - calc_tool_rotation(yaw).matrix() @ np.array(style.p_PG))


def make_grasp_trajectory(
    command: GraspCommand,
    rest: ToolPose,
    style: GraspTrajectoryOptions,
    yaw: float,
    speed_scale: float = 1.0,
) -> tuple[ToolTrajectorySegment, ...]:
    """Makes the trajectory of a grasp: up, over, down, in, close, lift, hold.

    Args:
        command: the grasp.
        rest: where the tool is.
        style: heights, speeds and times.
        yaw: of the tool in the grasp, rad.
        speed_scale: share of the speeds at which the tool travels.

    Returns:
        The segments.
    """
    x, y, z, turn = rest
    high = style.travel_height
    x1, y1, low = calc_tip(style, command.p_WG, yaw).tolist()
    x0, y0 = (np.array([x1, y1]) - style.standoff * command.heading).tolist()
    above, outside, inside = (x0, y0, high, yaw), (x0, y0, low, yaw), (x1, y1, low, yaw)
    lifted = (x1, y1, low + command.lift, yaw)
    opened, squeezed = (style.opening, style.opening), (style.squeeze, style.squeeze)
    fast, careful = style.travel_acceleration, style.careful_acceleration
    vertical = speed_scale * style.vertical_speed
    approaching, closing = GraspPhase.APPROACHING, GraspPhase.CLOSING
    segments = (
        [
            ToolTrajectorySegment(
                approaching, rest, (x, y, high, turn), vertical, fast, opening=opened
            )
        ]
        if z != high
        else []
    )
    segments += [
        ToolTrajectorySegment(
            approaching,
            (x, y, high, turn),
            above,
            speed_scale * style.travel_speed,
            fast,
            opening=opened,
        ),
        ToolTrajectorySegment(approaching, above, outside, vertical, fast, opening=opened),
        ToolTrajectorySegment(
            GraspPhase.ENTERING, outside, inside, style.entering_speed, careful, opening=opened
        ),
        ToolTrajectorySegment(
            closing,
            inside,
            inside,
            wait=style.opening / style.closing_speed,
            opening=(style.opening, 0.0),
        ),
        ToolTrajectorySegment(
            closing, inside, inside, wait=style.squeeze_time, opening=(0.0, style.squeeze)
        ),
        ToolTrajectorySegment(closing, inside, inside, wait=style.settle_time, opening=squeezed),
        ToolTrajectorySegment(
            GraspPhase.LIFTING, inside, lifted, style.lifting_speed, careful, opening=squeezed
        ),
        ToolTrajectorySegment(
            GraspPhase.HOLDING, lifted, lifted, wait=style.hold_time, opening=squeezed
        ),
    ]
    return tuple(segments)


def make_retreat_trajectory(
    pose: ToolPose,
    opening: float,
    rest: ToolPose,
    approach: float,
    style: GraspTrajectoryOptions,
    speed_scale: float = 1.0,
) -> tuple[ToolTrajectorySegment, ...]:
    """Makes the trajectory back from a grasp that failed: open, straight out, up, over, and down to the rest.

    Args:
        pose: where the tool is.
        opening: of the gripper, m.
        rest: where the tool is to go.
        approach: heading in which the fingers point, rad.
        style: heights, speeds and times.
        speed_scale: share of the speeds at which the tool travels.

    Returns:
        The segments.
    """
    x1, y1, z, yaw = pose
    x0, y0 = (np.array([x1, y1]) - style.standoff * make_direction(approach)).tolist()
    outside = (x0, y0, z, yaw)
    opened, phase = (style.opening, style.opening), GraspPhase.RETREATING
    return (
        ToolTrajectorySegment(
            GraspPhase.OPENING,
            pose,
            pose,
            wait=style.opening_time,
            opening=(opening, style.opening),
        ),
        ToolTrajectorySegment(
            phase, pose, outside, style.entering_speed, style.careful_acceleration, opening=opened
        ),
        *make_homing_trajectory(outside, rest, style, speed_scale),
    )


def make_homing_trajectory(
    pose: ToolPose, rest: ToolPose, style: GraspTrajectoryOptions, speed_scale: float = 1.0
) -> tuple[ToolTrajectorySegment, ...]:
    """Makes the trajectory from a free place to the rest: up, over, down; as `make_retreat_trajectory`."""
    x0, y0, z, yaw = pose
    x, y, _, turn = rest
    high = max(style.travel_height, z)
    phase, vertical, opened = (
        GraspPhase.RETREATING,
        speed_scale * style.vertical_speed,
        (style.opening, style.opening),
    )
    acceleration = style.travel_acceleration
    corners = [(pose, (x0, y0, high, yaw), vertical)]
    corners.append(((x0, y0, high, yaw), (x, y, high, turn), speed_scale * style.travel_speed))
    corners.append(((x, y, high, turn), rest, vertical))
    return tuple(
        ToolTrajectorySegment(phase, start, end, speed, acceleration, opening=opened)
        for start, end, speed in corners
        if start != end
    )


TurningReach = Callable[[Array, Array, Array], str | None]
"""Of the tip's path (k, 3), m in W, speeds (k - 1,) on its pieces, m/s, and yaws (k,), rad: None,
or what stops it."""

Validator = Callable[[GraspCommand], str | None]
"""Of a command: None, or why it must not be carried out."""

GRIPPER_STATE_SIZE = 4
"""Positions of left and right finger, m, and their velocities, m/s."""

GRASPING = (GraspPhase.CLOSING, GraspPhase.LIFTING, GraspPhase.HOLDING)
"""Phases with something in the gripper, or so it should be."""

SAME_PLACE = 1e-6
"""m and rad, of two poses that need no motion between them."""


@dataclass(frozen=True)
class GraspState(Unchanging):
    """All that the executor remembers.

    Attributes:
        segments: the current one and those still to come; none while it passes the push executor's
            pose through.
        segment_start: when the current one began, s.
        command: the last one taken up.
        speed_scale: share of the traveling speeds at which the arm can follow it.
        closed: opening when the gripper had closed on the object, m.
        status: as on the port, but for what is not finite at present.
        fault: what on the ports is not finite, and keeps the executor from going on; empty for
            nothing.
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
        """As on the port."""
        if not self.fault:
            return self.status
        outcome = GraspOutcome.REFUSED if self.fault == UNREADABLE else self.status.outcome
        return replace(self.status, outcome=outcome, reason=self.fault)


class GraspExecutor(AbstractStateSystem[GraspState]):
    """Grasps what overhangs the table's edge, from the side, lifts it and holds it; else passes the finger's pose on.

    A command is taken up when the push executor is idle, this one too, and the command's id is not
    the last one's. It is refused, with its reason in the status, where its numbers are not usable
    and where the arm cannot follow. While what it needs to see is not finite it waits where it is,
    and the status says why. After a grasp that failed the tool goes back to the push executor's
    pose. The pose is continuous, and so are its first two derivatives.

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

    * push_tip_pose: abstract `RigidTransform`, X_WP that the push executor desires, m; at rest
      while that is idle.
    * push_status: abstract `PushStatus` of the push executor.
    * grasp_command: vector of 6, see `GraspCommand`: command_id, x, y, z (m), approach (rad), lift
      (m). Need not be connected where nothing is grasped.
    * gripper_state: vector of 4, the fingers' positions, left and right, m, and velocities, m/s.
    * tip_pose: abstract `RigidTransform`, X_WP desired, m.
    * gripper_position: vector of 1, the opening asked for, m.
    * gripper_force_limit: vector of 1, the largest force of a finger, N.
    * status: abstract `GraspStatus`.

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
            reach: whether the arm can follow a path; None trusts it.
            style: measures, heights, speeds and times.
            validator: what else speaks against a command; None for nothing.
        """
        self.style = style or GraspTrajectoryOptions()
        super().__init__(GraspState(), self.style.period)
        self._reach, self._validator = reach, validator
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
            output.set_value(
                make_transform(state.segments[0].position(context.get_time() - state.segment_start))
            )
        else:
            output.set_value(self._push_pose.Eval(context))

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        state, opening = self._get_state(context), self.style.opening
        if state.segments:
            opening = state.segments[0].calc_opening(context.get_time() - state.segment_start)
        output.SetAtIndex(0, opening)

    def _calc_force_limit(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self.style.force)

    def _go_on(self, context: Context, now: GraspState) -> GraspState:
        """Goes on with a grasp, or takes up or refuses a command."""
        time, fault = context.get_time(), self._find_bad_input(context, now)
        if fault != now.fault:
            now = replace(now, fault=fault)
        if fault:
            return now
        return (
            self._follow(context, now, time) if now.segments else self._take_up(context, now, time)
        )

    def _find_bad_input(self, context: Context, now: GraspState) -> str:
        """What is needed at present and not finite; empty for nothing."""
        busy = bool(now.segments)
        if not busy:
            command_id = self._command.Eval(context)[0] if self._command.HasValue(context) else 0
            if not np.isfinite(command_id):
                return UNREADABLE
            if command_id in (0, now.status.command_id):
                return ""
        if not np.isfinite(self._push_pose.Eval(context).translation()).all():
            return "the push executor's pose is not finite"
        if (
            busy
            and now.segments[0].phase in GRASPING
            and not np.isfinite(self._gripper.Eval(context)).all()
        ):
            return "the gripper's state is not finite"
        return ""

    def _take_up(self, context: Context, now: GraspState, time: float) -> GraspState:
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
        status = GraspStatus(GraspPhase(segments[0].phase), command.command_id)
        return GraspState(
            segments, time, command, _find_speed_scale(segments, self.style), 0.0, status
        )

    def plan(
        self, command: GraspCommand, rest: ToolPose
    ) -> tuple[tuple[ToolTrajectorySegment, ...], str]:
        """Plans a grasp from a pose of the tool; returns its segments, or none and why it is refused."""
        reason = self._find_fault(command) or (self._validator and self._validator(command))
        if reason:
            return (), reason
        return plan_grasp(command, rest, self.style, self._reach)

    def _find_fault(self, command: GraspCommand) -> str | None:
        if not np.isfinite(command.to_vector()).all():
            return NOT_FINITE
        if not 0.0 < command.lift <= self.style.max_lift:
            return f"lift {command.lift:.3g} m; expected more than 0, at most {self.style.max_lift:.3g}"
        return None

    def _follow(self, context: Context, now: GraspState, time: float) -> GraspState:
        """Looks at the gripper; the next segment when one is done. What fails is given up as soon as the tool rests."""
        segment, left = now.segments[0], now.segments[1:]
        over = time - now.segment_start >= segment.duration
        if segment.phase in GRASPING and not now.status.outcome:
            now = self._look(
                context, now, closed=over and bool(left) and left[0].phase == GraspPhase.LIFTING
            )
        if (
            segment.phase in GRASPING
            and now.status.outcome in (GraspOutcome.MISSED, GraspOutcome.SLIPPED)
            and (over or not segment.top_speed)
        ):
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
        """Notes whether the gripper has closed on something, and whether that is being lost."""
        opening = self._calc_opening(context)
        if closed and opening < self.style.min_width:
            return self._fail(
                now,
                GraspOutcome.MISSED,
                f"the gripper closed to {1e3 * opening:.1f} mm: nothing is in it",
            )
        if closed:
            return replace(now, closed=opening)
        least = max(now.closed - self.style.max_slip, self.style.min_width)
        if now.status.phase == GraspPhase.CLOSING or opening > least:
            return now
        return self._fail(
            now,
            GraspOutcome.SLIPPED,
            f"the opening fell from {1e3 * now.closed:.1f} to {1e3 * opening:.1f} mm",
        )

    def _fail(self, now: GraspState, outcome: GraspOutcome, reason: str) -> GraspState:
        return replace(now, status=replace(now.status, outcome=outcome, reason=reason))

    def _turn_back(self, context: Context, now: GraspState, time: float) -> GraspState:
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
        """Hands back to the push executor, where the tool is where that one has it."""
        rest, at = calc_tool_pose(self._push_pose.Eval(context)), now.segments[0].end
        if not self._push_status.Eval(context).ready:
            return now
        if not np.allclose(rest, at, rtol=0.0, atol=SAME_PLACE):
            return replace(
                now,
                segments=make_homing_trajectory(at, rest, self.style, now.speed_scale),
                segment_start=time,
            )
        return replace(
            now, segments=(), segment_start=time, status=replace(now.status, phase=GraspPhase.IDLE)
        )

    def _calc_opening(self, context: Context) -> float:
        left, right, *_ = self._gripper.Eval(context)
        return float(right - left)


def plan_grasp(
    command: GraspCommand, rest: ToolPose, style: GraspTrajectoryOptions, reach: TurningReach | None
) -> tuple[tuple[ToolTrajectorySegment, ...], str]:
    """Plans the trajectory of a grasp, as fast as the arm can follow.

    Args:
        command: the grasp.
        rest: where the tool is.
        style: measures, heights, speeds and times.
        reach: whether the arm can follow a path; None trusts it.

    Returns:
        The segments, and ""; or no segments, and why the arm cannot follow.
    """
    reasons: list[str] = []
    for yaw in calc_yaws(command.approach):
        for speed_scale in SPEED_SCALES:
            segments = make_grasp_trajectory(command, rest, style, yaw, speed_scale)
            found = reach and reach(*_describe(segments))
            if not found:
                return segments, ""
            reasons.append(found)
    return (), reasons[len(SPEED_SCALES) - 1]  # of the lesser turn, as slow as can be


def _describe(segments: tuple[ToolTrajectorySegment, ...]) -> tuple[Array, Array, Array]:
    """Path, speeds and yaws of the segments that move."""
    moving = [segment for segment in segments if segment.top_speed > 0.0]
    corners = np.array([moving[0].start] + [segment.end for segment in moving])
    return corners[:, :3], np.array([segment.top_speed for segment in moving]), corners[:, 3]


def _find_speed_scale(
    segments: tuple[ToolTrajectorySegment, ...], style: GraspTrajectoryOptions
) -> float:
    """Share of the traveling speeds at which segments were planned."""
    return (
        min(segment.speed for segment in segments if segment.phase == GraspPhase.APPROACHING)
        / style.vertical_speed
    )

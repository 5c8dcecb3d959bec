"""Trajectories of a grasp from beyond the table's edge, and back if it fails.

The tool goes up from where the pushing finger rests, over to above the standoff while it turns,
down beyond the edge, and in; the gripper closes, and the tool goes up. `GraspExecutor` carries the
trajectories out.

The gripper's grasp frame G is fixed to the tip's frame P. The fingers point along P's x axis, which
is W's -x at yaw 0:

    yaw = approach - pi,   p_WP = p_WG - R_WP(yaw) p_PG
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

from gridpush_drake.geometry.se2 import Array, make_direction
from gridpush_drake.multibody.tool_motion import (
    ToolPose,
    ToolTrajectorySegment,
    calc_tool_rotation,
)
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.systems.base.messages import GraspCommand, GraspPhase
from gridpush_drake.systems.execution.push_executor import SPEED_SCALES

CONTROLLER_STIFFNESS = 200.0
"""Stiffness of Drake's `SchunkWsgPositionController` between the opening that is asked for and the
present one, N/m."""

TurningReach = Callable[[Array, Array, Array], str | None]
"""A function that says what stops the arm on a path of the tip, (k, 3) in W, m, at speeds (k - 1,)
on its pieces, m/s, with yaws (k,) of the tool, rad; None if nothing does."""


@dataclass(frozen=True)
class GraspTrajectoryOptions:
    """How grasps are carried out.

    Attributes:
        p_PG: (3,) from the tip's center to the grasp point, in the tip's frame P, m.
        travel_height: height of the tip's center while it passes over the object, m.
        standoff: distance between the place where the gripper comes down and the one where it
            closes, m.
        travel_speed: speed of the tip while it passes over the object, m/s.
        vertical_speed: speed of coming down and going up beyond the edge, m/s.
        entering_speed: speed of going in and out, m/s.
        lifting_speed: speed of lifting, m/s.
        travel_acceleration: greatest acceleration while nothing is near the gripper, m/s².
        careful_acceleration: greatest acceleration of going in and lifting, m/s².
        force: force with which the gripper presses, N.
        opening: opening of the gripper while it does not grasp, m.
        closing_speed: rate at which the opening that is asked for falls until the pads would meet,
            m/s.
        squeeze_time: time in which the whole force is then asked for, s.
        settle_time: time with the whole force before the opening is looked at, s.
        opening_time: time of letting go, s.
        hold_time: time after which an object that is held up counts as held, s.
        min_width: if the pads are nearer than this, nothing is between them, m.
        max_slip: if the opening falls by more than this, the object is being lost, m.
        max_lift: a command to lift higher is refused, m.
        period: time between two updates of the state, s.
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
        """Makes the options of a gripper that is asked to press with a force.

        Args:
            gripper: the gripper; it says opening, closing speed, standoff and the greatest force.
            force: force that is asked for, N; no more than the gripper's greatest is used.
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
        """Opening, m, at which the gripper's controller presses with the whole force.

        The controller is a spring that pulls toward the opening asked for. That is negative here:
        the pads meet, or something is between them, before the opening is reached.
        """
        return -self.force / CONTROLLER_STIFFNESS


def calc_yaws(approach: float) -> tuple[float, float]:
    """Calculates the yaws of the tool at which its fingers point along `approach`, all in rad.

    There are two that a wrist may have. The one with the lesser turn comes first.
    """
    near = (approach - pi + pi) % (2 * pi) - pi
    return near, near - np.copysign(2 * pi, near)


def calc_tip(style: GraspTrajectoryOptions, p_WG: Array, yaw: float) -> Array:
    """Calculates p_WP (3,) of the tip's center with the grasp point at p_WG (3,), m."""
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
        rest: pose of the tool, which is at rest.
        style: heights, speeds and times.
        yaw: yaw of the tool in the grasp, rad.
        speed_scale: factor of the speeds at which the tool travels.

    Returns:
        The segments.
    """
    # The places: above the rest, above the standoff, beyond the edge, at the object, and lifted.
    x, y, z, turn = rest
    high = style.travel_height
    x1, y1, low = calc_tip(style, command.p_WG, yaw).tolist()
    x0, y0 = (np.array([x1, y1]) - style.standoff * command.heading).tolist()
    above_rest = (x, y, high, turn)
    above = (x0, y0, high, yaw)
    outside = (x0, y0, low, yaw)
    inside = (x1, y1, low, yaw)
    lifted = (x1, y1, low + command.lift, yaw)

    # The way in, with the gripper open.
    opened = (style.opening, style.opening)
    vertical_speed = speed_scale * style.vertical_speed
    segments = []
    if z != high:
        segments.append(
            ToolTrajectorySegment(
                GraspPhase.APPROACHING,
                rest,
                above_rest,
                vertical_speed,
                style.travel_acceleration,
                opening=opened,
            )
        )
    segments += [
        ToolTrajectorySegment(
            GraspPhase.APPROACHING,
            above_rest,
            above,
            speed_scale * style.travel_speed,
            style.travel_acceleration,
            opening=opened,
        ),
        ToolTrajectorySegment(
            GraspPhase.APPROACHING,
            above,
            outside,
            vertical_speed,
            style.travel_acceleration,
            opening=opened,
        ),
        ToolTrajectorySegment(
            GraspPhase.ENTERING,
            outside,
            inside,
            style.entering_speed,
            style.careful_acceleration,
            opening=opened,
        ),
    ]
    return (*segments, *_make_closing_segments(inside, lifted, style))


def _make_closing_segments(
    inside: ToolPose, lifted: ToolPose, style: GraspTrajectoryOptions
) -> tuple[ToolTrajectorySegment, ...]:
    """Makes the segments that close the gripper, lift and hold."""
    squeezed = (style.squeeze, style.squeeze)
    return (
        ToolTrajectorySegment(
            GraspPhase.CLOSING,
            inside,
            inside,
            wait=style.opening / style.closing_speed,
            opening=(style.opening, 0.0),
        ),
        ToolTrajectorySegment(
            GraspPhase.CLOSING,
            inside,
            inside,
            wait=style.squeeze_time,
            opening=(0.0, style.squeeze),
        ),
        ToolTrajectorySegment(
            GraspPhase.CLOSING, inside, inside, wait=style.settle_time, opening=squeezed
        ),
        ToolTrajectorySegment(
            GraspPhase.LIFTING,
            inside,
            lifted,
            style.lifting_speed,
            style.careful_acceleration,
            opening=squeezed,
        ),
        ToolTrajectorySegment(
            GraspPhase.HOLDING, lifted, lifted, wait=style.hold_time, opening=squeezed
        ),
    )


def make_retreat_trajectory(
    pose: ToolPose,
    opening: float,
    rest: ToolPose,
    approach: float,
    style: GraspTrajectoryOptions,
    speed_scale: float = 1.0,
) -> tuple[ToolTrajectorySegment, ...]:
    """Makes the trajectory back from a grasp that failed: open, straight out, and to the rest.

    Args:
        pose: pose of the tool.
        opening: opening of the gripper, m.
        rest: pose to which the tool is to go.
        approach: direction in which the fingers point, rad.
        style: heights, speeds and times.
        speed_scale: factor of the speeds at which the tool travels.

    Returns:
        The segments.
    """
    x1, y1, z, yaw = pose
    x0, y0 = (np.array([x1, y1]) - style.standoff * make_direction(approach)).tolist()
    outside = (x0, y0, z, yaw)
    let_go = ToolTrajectorySegment(
        GraspPhase.OPENING,
        pose,
        pose,
        wait=style.opening_time,
        opening=(opening, style.opening),
    )
    go_out = ToolTrajectorySegment(
        GraspPhase.RETREATING,
        pose,
        outside,
        style.entering_speed,
        style.careful_acceleration,
        opening=(style.opening, style.opening),
    )
    return (let_go, go_out, *make_homing_trajectory(outside, rest, style, speed_scale))


def make_homing_trajectory(
    pose: ToolPose, rest: ToolPose, style: GraspTrajectoryOptions, speed_scale: float = 1.0
) -> tuple[ToolTrajectorySegment, ...]:
    """Makes the trajectory from a place with nothing around to the rest: up, over, down.

    The arguments are those of `make_retreat_trajectory`.
    """
    x0, y0, z, yaw = pose
    x, y, _, turn = rest
    high = max(style.travel_height, z)
    above = (x0, y0, high, yaw)
    above_rest = (x, y, high, turn)
    vertical_speed = speed_scale * style.vertical_speed
    pieces = (
        (pose, above, vertical_speed),
        (above, above_rest, speed_scale * style.travel_speed),
        (above_rest, rest, vertical_speed),
    )
    return tuple(
        ToolTrajectorySegment(
            GraspPhase.RETREATING,
            start,
            end,
            speed,
            style.travel_acceleration,
            opening=(style.opening, style.opening),
        )
        for start, end, speed in pieces
        if start != end
    )


def plan_grasp(
    command: GraspCommand, rest: ToolPose, style: GraspTrajectoryOptions, reach: TurningReach | None
) -> tuple[tuple[ToolTrajectorySegment, ...], str]:
    """Plans the trajectory of a grasp, as fast as the arm can follow.

    Args:
        command: the grasp.
        rest: pose of the tool, which is at rest.
        style: measures, heights, speeds and times.
        reach: says what stops the arm on a path; None if nothing ever does.

    Returns:
        The segments, and ""; or no segments, and why the arm cannot follow.
    """
    reasons: list[str] = []
    for yaw in calc_yaws(command.approach):
        for speed_scale in SPEED_SCALES:
            segments = make_grasp_trajectory(command, rest, style, yaw, speed_scale)
            reason = None if reach is None else reach(*_list_corners(segments))
            if not reason:
                return segments, ""
            reasons.append(reason)
    # The reason that is told is that of the lesser turn, at the lowest speed.
    return (), reasons[len(SPEED_SCALES) - 1]


def _list_corners(segments: tuple[ToolTrajectorySegment, ...]) -> tuple[Array, Array, Array]:
    """Lists path (k, 3), speeds (k - 1,) and yaws (k,) of the segments that move the tool."""
    moving = [segment for segment in segments if segment.top_speed > 0.0]
    corners = np.array([moving[0].start] + [segment.end for segment in moving])
    speeds = np.array([segment.top_speed for segment in moving])
    return corners[:, :3], speeds, corners[:, 3]


def find_speed_scale(
    segments: tuple[ToolTrajectorySegment, ...], style: GraspTrajectoryOptions
) -> float:
    """Finds the factor of the traveling speeds with which the segments of a grasp were planned."""
    approaching = (segment for segment in segments if segment.phase == GraspPhase.APPROACHING)
    return min(segment.speed for segment in approaching) / style.vertical_speed

"""The way of the tool in a grasp from beyond the table's rim, and back.

Up from the pushing finger's rest, over to above the standoff while the tool turns, down beyond the rim, in, close, up.

The gripper's grasp frame G is fixed to the tip's frame P. The fingers point along P's x axis, which is W's -x at yaw 0:

    yaw = approach - pi,   p_WP = p_WG - R_WP(yaw) p_PG
"""

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.systems import grasp_status
from gridpush_drake.systems.grasp_command import GraspCommand
from gridpush_drake.systems.tool_motion import ToolLeg, ToolPose, calc_tool_rotation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GraspingStyle:
    """How grasps are carried out.

    Attributes:
        p_PG: (3,) from the tip's centre to the grasp point, in the tip's frame P, m.
        travel_height: of the tip's centre while it passes over the object, m.
        standoff: from where the gripper comes down to where it closes, m.
        travel_speed: m/s.
        vertical_speed: of coming down and going up beyond the rim, m/s.
        entering_speed: of going in and out, m/s.
        lifting_speed: m/s.
        travel_acceleration: m/s².
        careful_acceleration: of going in and lifting, m/s².
        force: of the gripper, N.
        opening: of the gripper but when it grasps, m.
        closing_speed: change of the opening asked for until the pads would meet, m/s.
        squeeze: opening asked for afterwards, m; negative, for the controller's spring to ask for the whole force.
        squeeze_time: over which, s.
        settle_time: with the whole force before the opening is looked at, s.
        opening_time: of letting go, s.
        hold_time: how long the object is held up before it counts as held, s.
        least_width: of what is between the pads where something is, m.
        most_slip: the least that the opening falls by where the object is being lost, m.
        largest_lift: that is not refused, m.
        period: of the state's update, s.
    """

    p_PG: tuple[float, float, float] = (0.169383, 0.0, -0.235)
    travel_height: float = 0.12
    standoff: float = 0.1
    travel_speed: float = 0.3
    vertical_speed: float = 0.15
    entering_speed: float = 0.05
    lifting_speed: float = 0.05
    travel_acceleration: float = 1.0
    careful_acceleration: float = 0.1
    force: float = 80.0
    opening: float = 0.1
    closing_speed: float = 0.15
    squeeze: float = -0.4
    squeeze_time: float = 0.5
    settle_time: float = 0.3
    opening_time: float = 0.6
    hold_time: float = 3.0
    least_width: float = 0.004
    most_slip: float = 0.006
    largest_lift: float = 0.2
    period: float = 0.005


def calc_yaws(approach: float) -> tuple[float, float]:
    """The tool's yaws whose fingers point along `approach` (rad) and that a wrist may have, the smaller first, rad."""
    near = (approach - pi + pi) % (2 * pi) - pi
    return near, near - np.copysign(2 * pi, near)


def calc_tip(style: GraspingStyle, p_WG: Array, yaw: float) -> Array:
    """p_WP (3,) of the tip's centre where the grasp point is p_WG (3,), m."""
    return np.asarray(p_WG - calc_tool_rotation(yaw).matrix() @ np.array(style.p_PG))


def make_grasp_legs(
    command: GraspCommand, rest: ToolPose, style: GraspingStyle, yaw: float, hurry: float = 1.0
) -> tuple[ToolLeg, ...]:
    """Makes the way of a grasp: up, over, down, in, close, lift, hold.

    Args:
        command: the grasp.
        rest: where the tool is.
        style: heights, speeds and times.
        yaw: of the tool in the grasp, rad.
        hurry: share of the speeds at which the tool travels.

    Returns:
        The legs.
    """
    x, y, z, turn = rest
    high = style.travel_height
    x1, y1, low = calc_tip(style, command.p_WG, yaw).tolist()
    x0, y0 = (np.array([x1, y1]) - style.standoff * command.heading).tolist()
    above, outside, inside = (x0, y0, high, yaw), (x0, y0, low, yaw), (x1, y1, low, yaw)
    lifted = (x1, y1, low + command.lift, yaw)
    opened, squeezed = (style.opening, style.opening), (style.squeeze, style.squeeze)
    fast, careful = style.travel_acceleration, style.careful_acceleration
    vertical = hurry * style.vertical_speed
    approaching, closing = grasp_status.APPROACHING, grasp_status.CLOSING
    legs = [ToolLeg(approaching, rest, (x, y, high, turn), vertical, fast, opening=opened)] if z != high else []
    legs += [
        ToolLeg(approaching, (x, y, high, turn), above, hurry * style.travel_speed, fast, opening=opened),
        ToolLeg(approaching, above, outside, vertical, fast, opening=opened),
        ToolLeg(grasp_status.ENTERING, outside, inside, style.entering_speed, careful, opening=opened),
        ToolLeg(closing, inside, inside, wait=style.opening / style.closing_speed, opening=(style.opening, 0.0)),
        ToolLeg(closing, inside, inside, wait=style.squeeze_time, opening=(0.0, style.squeeze)),
        ToolLeg(closing, inside, inside, wait=style.settle_time, opening=squeezed),
        ToolLeg(grasp_status.LIFTING, inside, lifted, style.lifting_speed, careful, opening=squeezed),
        ToolLeg(grasp_status.HOLDING, lifted, lifted, wait=style.hold_time, opening=squeezed),
    ]
    return tuple(legs)


def make_retreat_legs(
    pose: ToolPose, opening: float, rest: ToolPose, approach: float, style: GraspingStyle, hurry: float = 1.0
) -> tuple[ToolLeg, ...]:
    """Makes the way back from a grasp that failed: open, straight out, up, over, and down to the rest.

    Args:
        pose: where the tool is.
        opening: of the gripper, m.
        rest: where the tool is to go.
        approach: heading in which the fingers point, rad.
        style: heights, speeds and times.
        hurry: share of the speeds at which the tool travels.

    Returns:
        The legs.
    """
    x1, y1, z, yaw = pose
    x0, y0 = (np.array([x1, y1]) - style.standoff * np.array([np.cos(approach), np.sin(approach)])).tolist()
    outside = (x0, y0, z, yaw)
    opened, phase = (style.opening, style.opening), grasp_status.RETREATING
    return (
        ToolLeg(grasp_status.OPENING, pose, pose, wait=style.opening_time, opening=(opening, style.opening)),
        ToolLeg(phase, pose, outside, style.entering_speed, style.careful_acceleration, opening=opened),
        *make_homing_legs(outside, rest, style, hurry),
    )


def make_homing_legs(pose: ToolPose, rest: ToolPose, style: GraspingStyle, hurry: float = 1.0) -> tuple[ToolLeg, ...]:
    """Makes the way from a free place to the rest: up, over, down; as `make_retreat_legs`."""
    x0, y0, z, yaw = pose
    x, y, _, turn = rest
    high = max(style.travel_height, z)
    phase, vertical, opened = grasp_status.RETREATING, hurry * style.vertical_speed, (style.opening, style.opening)
    acceleration = style.travel_acceleration
    corners = [(pose, (x0, y0, high, yaw), vertical)]
    corners.append(((x0, y0, high, yaw), (x, y, high, turn), hurry * style.travel_speed))
    corners.append(((x, y, high, turn), rest, vertical))
    return tuple(
        ToolLeg(phase, start, end, speed, acceleration, opening=opened) for start, end, speed in corners if start != end
    )

"""The way of the finger's tip in a push: over the object, down beside it, along, a pause, and up again."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.systems import push_status
from gridpush_drake.systems.push_command import PushCommand
from gridpush_drake.systems.push_motion import Leg


@dataclass(frozen=True)
class PushingStyle:
    """How pushes are carried out.

    Attributes:
        travel_height: of the tip's centre while it passes over the object, m.
        push_height: of the tip's centre while it pushes, m.
        travel_speed: m/s.
        vertical_speed: of descending and retracting, m/s.
        travel_acceleration: of all but the push, m/s².
        push_acceleration: m/s².
        largest_push_speed: that is not refused, m/s.
        settle_time: to dwell after the push, s.
        tip_radius: m.
        clearance: the least gap between tip and object where a push starts, m.
        period: of the state's update, s.
    """

    travel_height: float = 0.12
    push_height: float = 0.012
    travel_speed: float = 0.3
    vertical_speed: float = 0.15
    travel_acceleration: float = 1.0
    push_acceleration: float = 0.5
    largest_push_speed: float = 0.2
    settle_time: float = 0.3
    tip_radius: float = 0.008
    clearance: float = 0.0
    period: float = 0.005


def make_legs(command: PushCommand, rest: ArrayLike, style: PushingStyle, hurry: float = 1.0) -> tuple[Leg, ...]:
    """Makes the way of a push from and back to rest: up if need be, over, down, along, pause, up.

    Args:
        command: the push.
        rest: (3,) p_WP where the tip is, m.
        style: heights, speeds and times.
        hurry: share of the speeds before and after the push.

    Returns:
        The legs; the last one ends above the push's end.
    """
    x, y, z = np.asarray(rest, float).tolist()
    (x0, y0), (x1, y1) = command.start.tolist(), command.end.tolist()
    high, low = style.travel_height, style.push_height
    travel = (hurry * style.travel_speed, style.travel_acceleration)
    vertical = (hurry * style.vertical_speed, style.travel_acceleration)
    legs = [Leg(push_status.APPROACHING, (x, y, z), (x, y, high), *vertical)] if z < high else []
    z = max(z, high)
    legs += [
        Leg(push_status.APPROACHING, (x, y, z), (x0, y0, high), *travel),
        Leg(push_status.DESCENDING, (x0, y0, high), (x0, y0, low), *vertical),
        Leg(push_status.PUSHING, (x0, y0, low), (x1, y1, low), command.speed, style.push_acceleration),
        Leg(push_status.SETTLING, (x1, y1, low), (x1, y1, low), wait=style.settle_time),
        Leg(push_status.RETRACTING, (x1, y1, low), (x1, y1, high), *vertical),
    ]
    return tuple(legs)


def break_off(legs: tuple[Leg, ...], t: float) -> tuple[Leg, ...]:
    """What is left of a push that is to stop as soon as it can; then, as ever, a pause, and up.

    Args:
        legs: still to come; the first one is under way.
        t: since that one began, s.

    Returns:
        The legs; as they were where the push itself is over.
    """
    phases = [leg.phase for leg in legs]
    if push_status.PUSHING not in phases:
        return legs
    i = phases.index(push_status.PUSHING)
    push = legs[i].stop_from(t if i == 0 else 0.0)
    if push.end == legs[i].end:
        return legs
    x, y, _ = push.end
    after = [replace(leg, start=(x, y, leg.start[2]), end=(x, y, leg.end[2])) for leg in legs[i + 1 :]]
    return (*legs[:i], push, *after)

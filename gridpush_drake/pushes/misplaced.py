"""Whether the pusher is where a log says, beside the object's outline: units, and the body frame.

Where a slow push ends, its disc touches the outline, and where a push begins, the disc is outside.
Where many pushes of a log say otherwise, its lengths or angles are in other units, or its poses are
of another body frame than the outline's. What else can be wrong with a log is found in
`plausibility`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import LineString, Point

from gridpush_drake.dynamics import GRAVITY
from gridpush_drake.geometry.se2 import transform_back
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.units import M_PER_MM, MM_PER_M

MAX_TIP_GAP = 0.005
"""Distance off the outline from which on a pusher is not where the log says, m, beside
`GAP_FRACTION`."""

GAP_FRACTION = 0.05
"""Fraction of the object's diameter that is added to `MAX_TIP_GAP`."""

MANY_FRACTION = 0.5
"""Fraction of a log's pushes that makes the log doubtful where so many are out of place."""

FEW_FRACTION = 0.2
"""Fraction of a log's pushes that may be out of place in units that explain the log."""

MIN_PUSH = 1e-3
"""Shortest length of a push, at the median of a log, by which its lengths may be in millimeters,
m."""


IN_DEGREES = "object_theta: in degrees? expected rad"
"""What a message says of angles that are probably in degrees."""


FRAME_PUSHES = 5
"""Pushes that move the object, at least, from which it is told whether the pusher was at its
outline."""

FRAME_TOLERANCE = 0.004
"""How far off the outline the pushers are at the ends of pushes, on average, before the body frame
is doubted, m."""

FRAME_CAP = 0.25
"""Distance from the outline beyond which a push counts as no further off, diameters of the
object."""

FRAME_GAIN = 0.3
"""Fraction of that distance that must be left where the outline is shifted, for the shift to be
named as the likely cause."""

MOVED_FRACTION = 0.1
"""Fraction of the pusher's path by which its object must move, at the mean of the cells, for the
push to count as one that moves it."""

SHIFT_COST = 0.05
"""How much nearer to the outline a shift must bring the pushers, by its length."""

FRAME_STEPS = ((0.03, 8), (0.01, 3), (0.003, 3))
"""Steps of the search for the shift, diameters of the object, and how many of them either way: one
search about what the one before found."""

SLIDING_SPEED = 0.2
"""Speed of the pusher, in square roots of g times the object's diameter, from which on the object
may slide on when the pusher has stopped; such pushes do not tell where the outline is."""


@dataclass(frozen=True)
class _Units:
    """Units that a log's numbers may be in.

    Attributes:
        tip: unit of tip_x and tip_y, m.
        place: unit of object_x and object_y, m.
        angle: unit of object_theta, rad.
        says: what a message says of a log in these units.
    """

    tip: float
    place: float
    angle: float
    says: str


AS_SAID = _Units(tip=1.0, place=1.0, angle=1.0, says="")
"""The units that a log should be in."""

DEGREE_UNITS = _Units(tip=1.0, place=1.0, angle=np.pi / 180, says=IN_DEGREES)
"""Angles in degrees."""

TIP_MM = _Units(
    tip=M_PER_MM,
    place=1.0,
    angle=1.0,
    says="tip_x, tip_y: in millimeters? expected m, as object_x, object_y are",
)
"""Only the tip in millimeters."""

PLACE_MM = _Units(
    tip=1.0,
    place=M_PER_MM,
    angle=1.0,
    says="object_x, object_y: in millimeters? expected m, as tip_x, tip_y are",
)
"""Only the object in millimeters."""

ALL_MM = _Units(
    tip=M_PER_MM,
    place=M_PER_MM,
    angle=1.0,
    says="tip_x, tip_y, object_x, object_y: in millimeters? expected m",
)
"""All lengths in millimeters."""


def explain_no_contact(obj: GridObject, log: PushLog) -> str:
    """Says of a log in which nothing touches which push comes nearest, and what may be wrong."""
    gaps, depths = np.array([_calc_gap(obj, seen, AS_SAID) for seen in log]).T
    nearest = int(np.argmin(gaps))
    seen = log[nearest]
    gap = float(gaps[nearest])
    depth = float(depths[nearest])
    if gap > 0:
        how = f"passes its outline at {gap:.3g} m"
    elif depth > 0:
        how = f"begins with the pusher {depth:.3g} m inside its outline"
    else:
        how = "only grazes its outline"
    return (
        f"{log.source or 'push log'}: no push touches {obj.name} from outside; the nearest, "
        f"{seen.name!r}, {how}; expected tip_x, tip_y and object_x, object_y, object_theta (m, "
        "rad) in one frame, and of this object"
    )


def find_units(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Finds lengths or angles in other units, by pushers that are where they cannot be."""
    wrong = _are_misplaced(obj, log, AS_SAID)
    reading = _choose_reading(obj, log, float(wrong.mean())) if wrong.any() else None
    if reading is None:
        return
    for i in np.flatnonzero(wrong):
        gap, depth = _calc_gap(obj, log[int(i)], AS_SAID)
        place = f"{gap:.3g} m off" if gap >= depth else f"{depth:.3g} m inside"
        yield (
            f"push {log[int(i)].name!r}, column {reading.says}; as it stands, the pusher is "
            f"{place} the outline of {obj.name}"
        )


def _choose_reading(obj: GridObject, log: PushLog, wrong: float) -> _Units | None:
    """Chooses units in which the pushers are in place.

    Args:
        obj: the object.
        log: the pushes.
        wrong: fraction of the pushers that are out of place in the log's own units.

    Returns:
        The units; None where there are none.
    """
    poses = np.array([seen.pose for seen in log])
    turned = (np.abs(poses[:, 2]) > 2 * np.pi).mean() >= MANY_FRACTION
    if turned and _are_misplaced(obj, log, DEGREE_UNITS).mean() <= wrong * FEW_FRACTION:
        return DEGREE_UNITS
    if wrong < MANY_FRACTION:
        return None
    away = (
        np.abs(poses[:, :2]).max() > MAX_TIP_GAP
    )  # where every push begins at 0, the object's places fit any unit
    length = np.median([seen.push.length for seen in log])
    readings = [
        units
        for units in ((TIP_MM, PLACE_MM, ALL_MM) if away else (ALL_MM,))
        if units.tip * length > MIN_PUSH
    ]
    return next(
        (units for units in readings if _are_misplaced(obj, log, units).mean() <= FEW_FRACTION),
        None,
    )


def find_other_body_frames(obj: GridObject, log: PushLog) -> Iterator[str]:
    """An outline that is not where the pushers are when slow pushes end: a body frame that is off.

    Where a slow push ends, its disc touches the outline. So the disc's center, in body axes, is its
    radius away from it; a body frame that is off by d shows there as an outline shifted by d.
    """
    ends = [
        (seen.push.radius, transform_back(seen.final_pose, seen.push.xy[-1:])[0])
        for seen in log
        if seen.push.shape is None and _ends_in_contact(obj, seen)
    ]
    if len(ends) < FRAME_PUSHES:
        return
    diameter = calc_diameter(obj)
    radii = np.array([radius for radius, _ in ends])
    tips = np.array([tip for _, tip in ends])

    def calc_off(shift: NDArray[np.float64]) -> float:
        """Mean distance of the discs from the outline, shifted by `shift`; far ones count less."""
        points = shapely.points(tips - shift)
        distance = shapely.distance(obj.outline.boundary, points)
        signed = np.where(shapely.contains(obj.outline, points), -distance, distance)
        return float(np.minimum(np.abs(signed - radii), FRAME_CAP * diameter).mean())

    off = calc_off(np.zeros(2))
    if off <= FRAME_TOLERANCE:
        return
    shift, left = _search_shift(calc_off, diameter)
    seen = (
        f"where {len(ends)} pushes end, the pusher is {off * MM_PER_M:.3g} mm off the outline on "
        "average"
    )
    if left <= FRAME_GAIN * off * (1 - len(shift) / len(ends)):  # two numbers are fitted
        x, y = shift * MM_PER_M
        yield (
            f"object_x, object_y: of another body frame than the outline of {obj.name}, which then "
            f"lies at ({x:.0f}, {y:.0f}) mm in it? {seen}, there {left * MM_PER_M:.2g} mm; "
            "identify --fit-frame learns where it lies, --body-at says it"
        )
    # where tips slip off, they end far off and yet were at the outline when the pushes began
    elif _are_misplaced(obj, log, AS_SAID).mean() >= FEW_FRACTION:
        yield (
            f"object_x, object_y, object_theta: in the frame of tip_x, tip_y, of {obj.name}, and "
            f"pusher.radius right? {seen}"
        )


def _ends_in_contact(obj: GridObject, seen: ObservedPush) -> bool:
    """Whether a push moves the object, slowly enough for the pusher to touch it at the end."""
    if not len(seen.poses_observed) or seen.t_observed[-1] < seen.push.duration:
        return False
    speed = seen.push.length / seen.push.duration
    if speed > SLIDING_SPEED * np.sqrt(GRAVITY * calc_diameter(obj)):
        return False
    cells = obj.cells_at([seen.pose, seen.final_pose])
    moved = float(np.linalg.norm(cells[1] - cells[0], axis=1).mean())
    return moved > MOVED_FRACTION * seen.push.length


def _search_shift(
    calc_off: Callable[[NDArray[np.float64]], float], diameter: float
) -> tuple[NDArray[np.float64], float]:
    """The shift (2,), m, of the outline at which the pushers are nearest to it, and how near, m."""
    best = np.zeros(2)
    left = np.inf
    for fraction, count in FRAME_STEPS:
        steps = fraction * diameter * np.arange(-count, count + 1)
        tried = best + np.array([[x, y] for x in steps for y in steps])
        off = [calc_off(shift) for shift in tried]
        # of shifts that explain the pushes alike the least is the most likely
        k = int(np.argmin(off + SHIFT_COST * np.linalg.norm(tried, axis=1)))
        best = tried[k]
        left = off[k]
    return best, left


def calc_diameter(obj: GridObject) -> float:
    """Diagonal of the bounding box of an object's outline, m."""
    left, low, right, high = obj.outline.bounds
    return float(np.hypot(right - left, high - low))


def _are_misplaced(obj: GridObject, log: PushLog, units: _Units) -> NDArray[np.bool_]:
    """Which pushes begin inside the object or pass it by."""
    slack = MAX_TIP_GAP + GAP_FRACTION * calc_diameter(obj)
    # of a pusher that is no disc, the place alone does not tell
    return np.array(
        [seen.push.shape is None and max(_calc_gap(obj, seen, units)) > slack for seen in log],
        dtype=bool,
    )


def _calc_gap(obj: GridObject, seen: ObservedPush, units: _Units) -> tuple[float, float]:
    """Measures how far a pusher's path stays off the outline, and how deep inside it begins, m.

    Each is negative where it does not.
    """
    pose = seen.pose * (units.place, units.place, units.angle)
    path = transform_back(pose, seen.push.xy * units.tip)
    start = Point(path[0])
    radius = seen.push.radius
    inside = bool(shapely.contains(obj.outline, start))
    depth = radius + float(obj.outline.boundary.distance(start)) * (1.0 if inside else -1.0)
    return float(obj.outline.distance(LineString(path))) - radius, depth

"""Whether a push log can be true of an object: units, frames, and poses that no push can lead to.

What cannot be true is refused, what hardly can is warned of. Bounds are those of a rigid body that
slides on dry friction, taken generously. A pusher that travels s moves the centroid by no more than
about s and turns the body by no more than s / (2 rho), rho the radius of gyration; a body that is
let go at speed v slides on for v^2 / (2 mu g).
"""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import LineString, Point

from gridpush_drake.dynamics import GRAVITY
from gridpush_drake.errors import GridPushError, PushLogError, PushLogWarning
from gridpush_drake.geometry.se2 import transform, transform_back
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog

TRAVEL_FACTOR = 2.0
"""Times the pusher's path that the centroid, or a point at the radius of gyration as the body
turns, may move."""

SPEED_FACTOR = 2.0
"""Times the pusher's mean speed at which it may let go of the object."""

NOISE_SHARE = 0.25
"""Share of the object's diameter by which a pose may be off besides."""

MAX_SPEED = 30.0
"""Largest mean speed of a pusher, m/s."""

MAX_DIAMETER = 10.0
"""Largest diameter of an object, m."""

MAX_TABLE = 100.0
"""Largest side of a table that is not doubted, m."""

MAX_FIRST_ANGLE = 4 * np.pi
"""Largest angle of an object at a push's beginning that is not doubted, rad."""

GAP = 0.005
"""Distance off the outline from which on a pusher is not where the log says, m, beside
`GAP_SHARE`."""

GAP_SHARE = 0.05
"""Share of the object's diameter that is added to `GAP`."""

MANY = 0.5
"""Share of a log's pushes that makes the log doubtful where so many are out of place."""

FEW = 0.2
"""Share of a log's pushes that may be out of place in units that explain the log."""

MIN_PUSH = 1e-3
"""Shortest length of a push, at the median of a log, by which its lengths may be in millimeters,
m."""

MM = 1e-3
"""Meters in a millimeter."""

MM_PER_M = 1e3
"""Millimeters in a meter."""

IN_DEGREES = "object_theta: in degrees? expected rad"

SLOW_SPEED = 2e-4
"""Speed of a pusher below which times are probably not in seconds, m/s, at the median of a log. The
slowest published pushes are ten times as fast."""

LONG_PUSH = 200.0
"""Duration of a push from which on times are probably not in seconds, s, at the median of a log."""

USUAL_SPEED = 1e-3
"""Speed of a pusher that a unit of the times must at least lead to, to be named as the likely one,
m/s."""

TIME_UNITS = (("milliseconds", 1e-3), ("microseconds", 1e-6), ("nanoseconds", 1e-9))
"""Units that times are often in by mistake, s."""

MAX_MASS = 500.0
"""Mass of an object that is not doubted, kg."""

MAX_AREAL_DENSITY = 2000.0
"""Mass by area of an object whose height is not known, where it is not doubted, kg/m²: a quarter of
a meter of steel."""

MAX_DENSITY = 23000.0
"""Mass by area and height that is not doubted, kg/m³; nothing on earth is denser."""

FORCE_FACTOR = 20.0
"""Times the greatest friction of an object of known mass, from which on its forces are doubted."""

MAX_FORCE = 1e4
"""Force on an object of unknown mass that is not doubted, N."""

PULLING_SHARE = 0.5
"""Share of the pushes with forces that may do negative work before the forces are doubted."""

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
"""Share of that distance that must be left where the outline is shifted, for the shift to be named
as the likely cause."""

MOVED_SHARE = 0.1
"""Share of the pusher's path by which its object must move, at the mean of the cells, for the push
to count as one that moves it."""

SHIFT_COST = 0.05
"""How much nearer to the outline a shift must bring the pushers, by its length."""

FRAME_STEPS = ((0.03, 8), (0.01, 3), (0.003, 3))
"""Steps of the search for the shift, diameters of the object, and how many of them either way: one
search about what the one before found."""

SLIDING_SPEED = 0.2
"""Speed of the pusher, in square roots of g times the object's diameter, from which on the object
may slide on when the pusher has stopped; such pushes do not tell where the outline is."""


class Finding(NamedTuple):
    """One thing that cannot be true, or hardly."""

    message: str  # push, column, what is wrong and the likely cause, in one line
    certain: bool  # whether it cannot be true; otherwise it may be
    about_first: bool
    """Whether what a prediction begins with is in doubt (the units, the pusher's path, the first
    pose) rather than what was seen later, which only learning needs."""


@dataclass(frozen=True)
class _Units:
    """A reading of a log's numbers: what they are multiplied by."""

    tip: float
    place: float
    angle: float
    says: str


AS_SAID = _Units(1.0, 1.0, 1.0, "")
DEGREES = _Units(1.0, 1.0, np.pi / 180, IN_DEGREES)
TIP_MM = _Units(MM, 1.0, 1.0, "tip_x, tip_y: in millimeters? expected m, as object_x, object_y are")
PLACE_MM = _Units(
    1.0, MM, 1.0, "object_x, object_y: in millimeters? expected m, as tip_x, tip_y are"
)
ALL_MM = _Units(MM, MM, 1.0, "tip_x, tip_y, object_x, object_y: in millimeters? expected m")


def check_plausible(obj: GridObject, log: PushLog, *, learning: bool) -> None:
    """Refuses a log that cannot be true of an object, and warns of one that hardly can.

    Args:
        learning: whether later poses are learned from, so that an impossible one spoils the result;
            where pushes are only to be predicted, it is warned of.

    Raises:
        PushLogError: lengths or angles are in other units, a pusher is faster than any, or, where
            it is to be learned from, a pose that the push cannot have led to. The message names
            push, column and likely cause.

    Warns:
        PushLogWarning: what may be true, but hardly is.
    """
    for finding in find_implausible(obj, log):
        message = f"{log.source}: {finding.message}" if log.source else finding.message
        if finding.certain and (finding.about_first or learning):
            raise PushLogError(message)
        warnings.warn(message, PushLogWarning, stacklevel=3)


def find_implausible(obj: GridObject, log: PushLog) -> list[Finding]:
    """Finds what cannot be true of a log, or hardly, at most one finding of a kind."""
    found: list[Finding] = []
    for find, certain, about_first in KINDS:
        messages = list(find(obj, log))
        if not messages:
            continue
        more = len(messages) - 1
        also = f" (and {more} more push{'es' if more > 1 else ''})" if more else ""
        found.append(Finding(messages[0] + also, certain, about_first))
        if certain:
            break
    return found


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


def check_size(obj: GridObject, kind: type[GridPushError]) -> None:
    """Raises an error of a kind where an object is larger than any that is pushed about."""
    for message in _find_large_objects(obj, PushLog(())):
        raise kind(message)


def explain_unused_forces(obj: GridObject, log: PushLog, inertial: bool) -> str | None:
    """Says why the forces of a log cannot be learned from; None where they can, or there are none.

    Args:
        obj: the object.
        log: the pushes.
        inertial: whether the pushes are simulated with inertia, as fast ones are.
    """
    if all(seen.force is None for seen in log):
        return None
    for find in (_find_large_forces, _find_pulling_forces):
        for message in find(obj, log):
            return f"{message}; the forces are not used"
    if inertial:
        return (
            "columns force_x, force_y: the forces are not used, as the pushes are fast: in part "
            "they accelerate the object, and only those of slow pushes show its friction"
        )
    return None


def _find_units(obj: GridObject, log: PushLog) -> Iterator[str]:
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
        wrong: share of the pushers that are out of place in the log's own units.

    Returns:
        The units; None where there are none.
    """
    poses = np.array([seen.pose for seen in log])
    turned = (np.abs(poses[:, 2]) > 2 * np.pi).mean() >= MANY
    if turned and _are_misplaced(obj, log, DEGREES).mean() <= wrong * FEW:
        return DEGREES
    if wrong < MANY:
        return None
    away = (
        np.abs(poses[:, :2]).max() > GAP
    )  # where every push begins at 0, the object's places fit any unit
    length = np.median([seen.push.length for seen in log])
    readings = [
        units
        for units in ((TIP_MM, PLACE_MM, ALL_MM) if away else (ALL_MM,))
        if units.tip * length > MIN_PUSH
    ]
    return next(
        (units for units in readings if _are_misplaced(obj, log, units).mean() <= FEW), None
    )


def _find_fast_pushers(obj: GridObject, log: PushLog) -> Iterator[str]:
    for seen in log:
        speed = seen.push.length / seen.push.duration
        if speed > MAX_SPEED:
            yield (
                f"push {seen.name!r}, column t: the pusher moves {seen.push.length:.3g} m in "
                f"{seen.push.duration:.3g} "
                f"s; expected at most {MAX_SPEED:g} m/s: are times in s, and tip_x, tip_y in m?"
            )


def _find_slow_pushers(obj: GridObject, log: PushLog) -> Iterator[str]:
    durations = np.array([seen.push.duration for seen in log])
    lengths = np.array([seen.push.length for seen in log])
    if not len(log):
        return
    duration = float(np.median(durations))
    length = float(np.median(lengths))
    speed = float(np.median(lengths / durations))
    if speed >= SLOW_SPEED and duration <= LONG_PUSH:
        return
    likely = next(
        (name for name, unit in TIME_UNITS if speed / unit >= USUAL_SPEED), "another unit"
    )
    yield (
        f"column t: in {likely}? expected s; as they stand, pushes of {length:.3g} m take "
        f"{duration:.3g} s (medians)"
    )


def _find_heavy_objects(obj: GridObject, log: PushLog) -> Iterator[str]:
    mass = obj.prior.total_mass
    area = float(obj.outline.area)
    if mass is None:
        return
    limit = MAX_AREAL_DENSITY if obj.height is None else MAX_DENSITY * obj.height
    if mass > min(MAX_MASS, limit * area):
        height = "" if obj.height is None else f" and {obj.height:.3g} m high"
        yield (
            f"{obj.name}: total_mass is {mass:.4g} kg, of an object of {area:.3g} m²{height}: in "
            "grams? expected kg"
        )


def _find_large_forces(obj: GridObject, log: PushLog) -> Iterator[str]:
    mass = obj.prior.total_mass
    limit = MAX_FORCE
    if mass is not None:
        limit = min(MAX_FORCE, FORCE_FACTOR * obj.prior.friction_max * mass * GRAVITY)
    for seen in log:
        if seen.force is None:
            continue
        size = float(np.median(np.linalg.norm(seen.force, axis=1)))
        if size > limit:
            held = "" if mass is None else f" for an object of {mass:.3g} kg"
            yield (
                f"push {seen.name!r}, columns force_x, force_y: are {size:.3g} N at the median; "
                f"expected at most {limit:.3g} N{held}: in N, and not a sensor's counts?"
            )


def _find_pulling_forces(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Forces against the pusher's motion: those on the pusher, or of another frame."""
    work = {seen.name: _calc_work(seen) for seen in log if seen.force is not None}
    pulling = [name for name, value in work.items() if value < 0]
    if len(pulling) > PULLING_SHARE * len(work):
        for name in pulling:
            yield (
                f"push {name!r}, columns force_x, force_y: pull the object against the pusher's "
                "motion; expected "
                "the force on the object, in the frame of tip_x, tip_y: is it that on the pusher?"
            )


def _calc_work(seen: ObservedPush) -> float:
    """Work of a push's measured force along the pusher's path, J."""
    assert seen.force_t is not None and seen.force is not None
    ends = np.append(seen.force_t[1:], seen.push.duration)
    path = seen.push.tip_at(ends) - seen.push.tip_at(seen.force_t)
    return float((seen.force * path).sum())


def _find_other_body_frames(obj: GridObject, log: PushLog) -> Iterator[str]:
    """An outline that is not where the pushers are when slow pushes end: a body frame that is off.

    Where a slow push ends, its disc touches the outline. So the disc's center, in body axes, is its
    radius away from it; a body frame that is off by d shows there as an outline shifted by d.
    """
    ends = [
        (seen.push.radius, transform_back(seen.final_pose, seen.push.xy[-1:])[0])
        for seen in log
        if _ends_in_contact(obj, seen)
    ]
    if len(ends) < FRAME_PUSHES:
        return
    diameter = _calc_diameter(obj)
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
            f"lies at ({x:.0f}, {y:.0f}) mm in it? {seen}, there {left * MM_PER_M:.2g} mm"
        )
    # where tips slip off, they end far off and yet were at the outline when the pushes began
    elif _are_misplaced(obj, log, AS_SAID).mean() >= FEW:
        yield (
            f"object_x, object_y, object_theta: in the frame of tip_x, tip_y, of {obj.name}, and "
            f"pusher.radius right? {seen}"
        )


def _ends_in_contact(obj: GridObject, seen: ObservedPush) -> bool:
    """Whether a push moves the object, slowly enough for the pusher to touch it at the end."""
    if not len(seen.poses_observed) or seen.t_observed[-1] < seen.push.duration:
        return False
    speed = seen.push.length / seen.push.duration
    if speed > SLIDING_SPEED * np.sqrt(GRAVITY * _calc_diameter(obj)):
        return False
    cells = obj.cells_at([seen.pose, seen.final_pose])
    moved = float(np.linalg.norm(cells[1] - cells[0], axis=1).mean())
    return moved > MOVED_SHARE * seen.push.length


def _search_shift(
    calc_off: Callable[[NDArray[np.float64]], float], diameter: float
) -> tuple[NDArray[np.float64], float]:
    """The shift (2,), m, of the outline at which the pushers are nearest to it, and how near, m."""
    best = np.zeros(2)
    left = np.inf
    for share, count in FRAME_STEPS:
        steps = share * diameter * np.arange(-count, count + 1)
        tried = best + np.array([[x, y] for x in steps for y in steps])
        off = [calc_off(shift) for shift in tried]
        # of shifts that explain the pushes alike the least is the most likely
        k = int(np.argmin(off + SHIFT_COST * np.linalg.norm(tried, axis=1)))
        best = tried[k]
        left = off[k]
    return best, left


def _find_begun_off_table(obj: GridObject, log: PushLog) -> Iterator[str]:
    for seen, rows in _find_off_table(obj, log):
        if 0 in rows:
            yield _describe_off_table(obj, seen, 0)


def _find_gone_off_table(obj: GridObject, log: PushLog) -> Iterator[str]:
    for seen, rows in _find_off_table(obj, log):
        yield _describe_off_table(obj, seen, int(rows[0])) + ": did it fall, or a lost track?"


def _find_off_table(
    obj: GridObject, log: PushLog
) -> Iterator[tuple[ObservedPush, NDArray[np.intp]]]:
    """Finds the pushes with poses at which no cell's center is on the log's table.

    Yields:
        A push, and which of its poses these are, the first one being 0.
    """
    if log.table is None:
        return
    table = shapely.Polygon(log.table)
    shapely.prepare(table)
    middle = obj.p_BC[np.argmin((obj.p_BC**2).sum(axis=1))]
    for seen in log:
        poses = np.vstack([seen.pose, seen.poses_observed])
        x, y = transform(poses, middle[None])[:, 0].T
        doubtful = np.flatnonzero(~shapely.contains_xy(table, x, y))
        cells = obj.cells_at(poses[doubtful])
        rows = doubtful[~shapely.contains_xy(table, cells[..., 0], cells[..., 1]).any(axis=1)]
        if len(rows):
            yield seen, rows


def _describe_off_table(obj: GridObject, seen: ObservedPush, row: int) -> str:
    t, pose = (seen.t_observed[row - 1], seen.poses_observed[row - 1]) if row else (0.0, seen.pose)
    at = ", ".join(f"{value:.3g}" for value in pose)
    return (
        f"push {seen.name!r}, column table: at t = {t:.3g} s the object, at ({at}), has no cell of "
        f"{obj.name} with its center on the table; expected an object on it, and both in one frame"
    )


def _find_jumps(obj: GridObject, log: PushLog) -> Iterator[str]:
    for seen in log:
        centroids = np.vstack(
            [obj.cells_at(seen.pose).mean(axis=0), obj.cells_at(seen.poses_observed).mean(axis=1)]
        )
        moved = centroids - centroids[0]
        far = np.linalg.norm(moved, axis=1)
        k = int(np.argmax(far))
        allowed = _calc_reach(obj, seen)
        if far[k] <= allowed:
            continue
        column = ("object_x", "object_y")[int(np.argmax(np.abs(moved[k])))]
        cause = "in millimeters, or a lost track?" if far[k] * MM < allowed else "a lost track?"
        yield (
            f"push {seen.name!r}, column {column}: the object moves {far[k]:.3g} m by t = "
            f"{seen.t_observed[k - 1]:.3g} "
            f"s, in a push of {seen.push.length:.3g} m; expected less than {allowed:.3g} m: {cause}"
        )


def _find_turns(obj: GridObject, log: PushLog) -> Iterator[str]:
    for seen in log:
        turned = np.abs(seen.poses_observed[:, 2] - seen.pose[2])
        allowed = _calc_reach(obj, seen) / obj.radius_of_gyration
        if not len(turned) or turned.max() <= allowed:
            continue
        k = int(np.argmax(turned))
        yield (
            f"push {seen.name!r}, column object_theta: the object turns {turned[k]:.3g} rad by t = "
            f"{seen.t_observed[k]:.3g} s, in a push of {seen.push.length:.3g} m; expected less "
            f"than {allowed:.3g} rad: in degrees, or a lost track?"
        )


def _find_large_objects(obj: GridObject, log: PushLog) -> Iterator[str]:
    if _calc_diameter(obj) > MAX_DIAMETER:
        yield (
            f"{obj.name}: its outline spans {_calc_diameter(obj):.3g} m; in millimeters? expected "
            f"m, at most {MAX_DIAMETER:g}"
        )


def _find_large_angles(obj: GridObject, log: PushLog) -> Iterator[str]:
    for seen in log:
        if abs(seen.pose[2]) > MAX_FIRST_ANGLE:
            yield (
                f"push {seen.name!r}, column {IN_DEGREES}; the object lies at {seen.pose[2]:.4g}"
            )


def _find_large_tables(obj: GridObject, log: PushLog) -> Iterator[str]:
    if log.table is not None and (size := float(np.ptp(log.table, axis=0).max())) > MAX_TABLE:
        yield (
            f"column table: in millimeters? expected m, at most {MAX_TABLE:g} a side; "
            f"the table spans {size:.3g}"
        )


KINDS = (
    (_find_units, True, True),
    (_find_fast_pushers, True, True),
    (_find_begun_off_table, True, True),
    (_find_turns, True, False),
    (_find_jumps, True, False),
    (_find_gone_off_table, True, False),
    (_find_large_objects, True, False),
    (_find_large_angles, False, True),
    (_find_large_tables, False, True),
    (_find_slow_pushers, False, True),
    (_find_heavy_objects, False, True),
    (_find_other_body_frames, False, True),
)
"""What finds what is wrong, whether it is certain, and whether it is about what a prediction begins
with."""


def _calc_reach(obj: GridObject, seen: ObservedPush) -> float:
    """Farthest that a push can move the object's centroid, m."""
    speed = SPEED_FACTOR * seen.push.length / seen.push.duration
    slide = speed**2 / (2 * obj.prior.friction_min * GRAVITY)
    return TRAVEL_FACTOR * seen.push.length + slide + NOISE_SHARE * _calc_diameter(obj)


def _calc_diameter(obj: GridObject) -> float:
    left, low, right, high = obj.outline.bounds
    return float(np.hypot(right - left, high - low))


def _are_misplaced(obj: GridObject, log: PushLog, units: _Units) -> NDArray[np.bool_]:
    """Which pushes begin inside the object or pass it by."""
    slack = GAP + GAP_SHARE * _calc_diameter(obj)
    return np.array([max(_calc_gap(obj, seen, units)) > slack for seen in log], dtype=bool)


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

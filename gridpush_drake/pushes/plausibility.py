"""Whether a push log can be true of an object: units, frames, and poses that no push can lead to.

Bounds are those of a rigid body that slides on dry friction, taken generously. A pusher that
travels s moves the centroid by no more than about s and turns the body by no more than s / (2 rho),
rho the radius of gyration; a body that is let go at speed v slides on for v^2 / (2 mu g).
"""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import LineString, Point

from gridpush_drake.dynamics import GRAVITY
from gridpush_drake.errors import PushLogError, PushLogWarning
from gridpush_drake.geometry.se2 import transform, transform_back
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

TRAVEL_FACTOR = 2.0
"""Times the pusher's path that the centroid, or a point at the radius of gyration as the body
turns, may move."""

SPEED_FACTOR = 2.0  # times the pusher's mean speed at which it may let go of the object
NOISE_SHARE = 0.25  # of the object's diameter, by which a pose may be off besides
MAX_SPEED = 30.0  # of a pusher, mean, m/s
MAX_DIAMETER = 10.0  # of an object, m
MAX_TABLE = 100.0  # of a table's side, where it is not doubted, m
MAX_FIRST_ANGLE = 4 * np.pi  # of an object at a push's beginning, where it is not doubted, rad

GAP, GAP_SHARE = 0.005, 0.05
"""A pusher this far off the outline, m plus this share of the object's diameter, is not where the
log says."""

MANY, FEW = 0.5, 0.2
"""Shares of a log's pushes: so many out of place make it doubtful, so few leave a reading of its
units standing."""

MIN_PUSH = 1e-3
"""Of a push's length, m, at the median of a log: shorter ones are no sign that its lengths are in
millimeters."""

MM = 1e-3  # meters in a millimeter

IN_DEGREES = "object_theta: in degrees? expected rad"


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
    gaps = [_calc_gap(obj, seen, AS_SAID)[0] for seen in log]
    nearest = int(np.argmin(gaps))
    return (
        f"{log.source or 'push log'}: no push touches {obj.name}; the nearest, {log[nearest].name!r}, passes its "
        f"outline at {max(gaps[nearest], 0.0):.3g} m; expected tip_x, tip_y and object_x, object_y, object_theta (m, "
        "rad) in one frame, and of this object"
    )


def _find_units(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Lengths or angles in other units: the pusher is where it cannot be, and in those units it is not."""
    wrong = _are_misplaced(obj, log, AS_SAID)
    reading = _choose_reading(obj, log, float(wrong.mean())) if wrong.any() else None
    if reading is None:
        return
    for i in np.flatnonzero(wrong):
        gap, depth = _calc_gap(obj, log[int(i)], AS_SAID)
        place = f"{gap:.3g} m off" if gap >= depth else f"{depth:.3g} m inside"
        yield (
            f"push {log[int(i)].name!r}, column {reading.says}; as it stands, the pusher is {place} the outline of "
            f"{obj.name}"
        )


def _choose_reading(obj: GridObject, log: PushLog, wrong: float) -> _Units | None:
    """The units in which the pushers are in place, where a share `wrong` of them is not; None where there are none."""
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
                f"push {seen.name!r}, column t: the pusher moves {seen.push.length:.3g} m in {seen.push.duration:.3g} "
                f"s; expected at most {MAX_SPEED:g} m/s: are times in s, and tip_x, tip_y in m?"
            )


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
    """The pushes with poses at which no cell's center is on the log's table, and which poses, the first being 0."""
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
        f"push {seen.name!r}, column table: at t = {t:.3g} s the object, at ({at}), has no cell of {obj.name} with its "
        "center on the table; expected an object on it, and both in one frame"
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
            f"push {seen.name!r}, column {column}: the object moves {far[k]:.3g} m by t = {seen.t_observed[k - 1]:.3g} "
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
            f"{seen.t_observed[k]:.3g} s, in a push of {seen.push.length:.3g} m; expected less than {allowed:.3g} rad: "
            "in degrees, or a lost track?"
        )


def _find_large_objects(obj: GridObject, log: PushLog) -> Iterator[str]:
    if _calc_diameter(obj) > MAX_DIAMETER:
        yield (
            f"{obj.name}: its outline spans {_calc_diameter(obj):.3g} m; in millimeters? expected m, at most "
            f"{MAX_DIAMETER:g}"
        )


def _find_large_angles(obj: GridObject, log: PushLog) -> Iterator[str]:
    for seen in log:
        if abs(seen.pose[2]) > MAX_FIRST_ANGLE:
            yield (
                f"push {seen.name!r}, column {IN_DEGREES}; the object lies at {seen.pose[2]:.4g}"
            )


def _find_large_tables(obj: GridObject, log: PushLog) -> Iterator[str]:
    if log.table is not None and (size := float(np.ptp(log.table, axis=0).max())) > MAX_TABLE:
        yield f"column table: in millimeters? expected m, at most {MAX_TABLE:g} a side; the table spans {size:.3g}"


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
    """How far the pusher's path stays off the outline, and how deep inside it begins, m, negative where it does not."""
    pose = seen.pose * (units.place, units.place, units.angle)
    path = transform_back(pose, seen.push.xy * units.tip)
    start, radius = Point(path[0]), seen.push.radius
    inside = bool(shapely.contains(obj.outline, start))
    depth = radius + float(obj.outline.boundary.distance(start)) * (1.0 if inside else -1.0)
    return float(obj.outline.distance(LineString(path))) - radius, depth

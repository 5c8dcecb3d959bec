"""Whether logs of pushes and of weighings can be true of an object: units, frames, sizes, motions.

What cannot be true is refused, what hardly can is warned of. Bounds are those of a rigid body that
slides on dry friction, taken generously. A pusher that travels s moves the centroid by no more than
about s and turns the body by no more than s / (2 rho), rho the radius of gyration; a body that is
let go at speed v slides on for v^2 / (2 mu g). An object that a press F tilts at a distance a
beyond the edge weighs at least F a / (g b), b the distance of its innermost point from the edge.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Point

from gridpush_drake.dynamics import GRAVITY
from gridpush_drake.errors import GridPushError, PushLogError, PushLogWarning
from gridpush_drake.geometry.se2 import Array, transform, transform_back, turn_right
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.misplaced import (
    IN_DEGREES,
    calc_diameter,
    find_other_body_frames,
    find_units,
)
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_csv import LIFT_FORCE
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import LiftTest, MassTestLog, TiltTest
from gridpush_drake.units import M_PER_MM

TRAVEL_FACTOR = 2.0
"""Times the pusher's path that the centroid, or a point at the radius of gyration as the body
turns, may move."""

SPEED_FACTOR = 2.0
"""Times the pusher's mean speed at which it may let go of the object."""

NOISE_FRACTION = 0.25
"""Fraction of the object's diameter by which a pose may be off besides."""

MAX_SPEED = 30.0
"""Largest mean speed of a pusher, m/s."""

MAX_DIAMETER = 10.0
"""Largest diameter of an object, m."""

MAX_TABLE = 100.0
"""Largest side of a table that is not doubted, m."""

MAX_FIRST_ANGLE = 4 * np.pi
"""Largest angle of an object at a push's beginning that is not doubted, rad."""


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

PULLING_FRACTION = 0.5
"""Fraction of the pushes with forces that may do negative work before the forces are doubted."""

MIN_FORCE_STD = 1e-4
"""Standard deviation of a force below which no robot measures it, N: the weight of 10 mg."""

MIN_TORQUE_STD = 1e-6
"""Standard deviation of a torque below which no robot measures it, N m."""

TORQUE_SIGMAS = 4.0
"""Standard deviations by which the torque of a lift may be wrong."""


class Finding(NamedTuple):
    """One thing that cannot be true of a log, or hardly.

    Attributes:
        message: push or weighing, column, what is wrong and the likely cause, in one line.
        certain: whether it cannot be true; otherwise it may be.
        about_first: whether what a prediction begins with is in doubt (the units, the pusher's
            path, the first pose) rather than what was seen later, which only learning needs.
    """

    message: str
    certain: bool
    about_first: bool


def check_plausible(
    obj: GridObject,
    log: PushLog,
    *,
    learning: bool,
    frame_known: bool = True,
    alone: bool = True,
) -> None:
    """Refuses a log that cannot be true of an object, and warns of one that hardly can.

    Args:
        obj: the object.
        log: the pushes.
        learning: whether later poses are learned from, so that an impossible one spoils the result;
            where pushes are only to be predicted, it is warned of.
        frame_known: whether the outline's frame is said to be that of the logged poses; where it is
            not, an outline that is off is no news.
        alone: whether nothing else was pushed; beside others, a pusher need not come near it.

    Raises:
        PushLogError: lengths or angles are in other units, a pusher is faster than any, or, where
            it is to be learned from, a pose that the push cannot have led to. The message names
            push, column and likely cause.

    Warns:
        PushLogWarning: what may be true, but hardly is.
    """
    for finding in find_implausible(obj, log, frame_known=frame_known, alone=alone):
        _report(finding, log.source, refuse=finding.about_first or learning)


def check_plausible_mass_tests(obj: GridObject, log: MassTestLog) -> None:
    """Refuses weighings that cannot be true of an object, and warns of those that hardly can.

    Raises:
        PushLogError: places, forces or torques are in other units or another frame, or a standard
            deviation is smaller than any sensor's. The message names weighing, column and likely
            cause.

    Warns:
        PushLogWarning: what may be true, but hardly is.
    """
    for finding in find_implausible_mass_tests(obj, log):
        _report(finding, log.source, refuse=True)


def find_implausible(
    obj: GridObject, log: PushLog, *, frame_known: bool = True, alone: bool = True
) -> list[Finding]:
    """Finds what cannot be true of a log, or hardly, at most one finding of a kind.

    Args:
        obj: the object.
        log: the pushes.
        frame_known: as for `check_plausible`.
        alone: as for `check_plausible`.
    """
    left_out = set() if frame_known else {find_other_body_frames}
    if not alone:
        left_out = {find_units, find_other_body_frames}
    finders = [
        (partial(find, obj, log), certain, first)
        for find, certain, first in PLAUSIBILITY_CHECKS
        if find not in left_out
    ]
    return _collect(finders, ("push", "pushes"))


def find_implausible_mass_tests(obj: GridObject, log: MassTestLog) -> list[Finding]:
    """Finds what cannot be true of weighings, or hardly, at most one finding of a kind."""
    finders = [(partial(find, obj, log), certain, True) for find, certain in WEIGHING_KINDS]
    return _collect(finders, ("weighing", "weighings"))


def _collect(
    finders: Sequence[tuple[Callable[[], Iterator[str]], bool, bool]], nouns: tuple[str, str]
) -> list[Finding]:
    """Lets each finder look, and stops after the first finding that is certain.

    Args:
        finders: what looks, and `Finding.certain` and `Finding.about_first` of what it finds.
        nouns: what a finding is about, in the singular and in the plural.
    """
    found: list[Finding] = []
    for find, certain, about_first in finders:
        messages = list(find())
        if not messages:
            continue
        more = len(messages) - 1
        also = f" (and {more} more {nouns[more > 1]})" if more else ""
        found.append(Finding(messages[0] + also, certain, about_first))
        if certain:
            break
    return found


def _report(finding: Finding, source: str, *, refuse: bool) -> None:
    """Raises an error of a finding that is certain, if it is to be refused; warns otherwise."""
    message = name_source(source, finding.message)
    if finding.certain and refuse:
        raise PushLogError(message)
    warnings.warn(message, PushLogWarning, stacklevel=4)


def name_source(source: str, message: str) -> str:
    """Puts before a message where the log came from that it is about, if that is known."""
    return f"{source}: {message}" if source else message


def check_size(obj: GridObject, kind: type[GridPushError]) -> None:
    """Raises an error of a kind where an object is larger than any that is pushed about."""
    for message in _find_large_objects(obj, PushLog(())):
        raise kind(message)


def explain_unused_forces(
    objects: Sequence[GridObject], log: PushLog, inertial: bool
) -> str | None:
    """Says why the forces of a log cannot be learned from; None where they can, or there are none.

    Args:
        objects: the objects that are pushed.
        log: the pushes.
        inertial: whether the pushes are simulated with inertia, as fast ones are.
    """
    if all(seen.force is None for seen in log):
        return None
    for messages in (
        _find_large_forces(objects, log),
        _find_pulling_forces(log),
        _find_lifting_forces(log),
    ):
        for message in messages:
            return f"{message}; the forces are not used"
    if inertial:
        return (
            "columns force_x, force_y: the forces are not used, as the pushes are fast: in part "
            "they accelerate the object, and only those of slow pushes show its friction"
        )
    return None


def _find_fast_pushers(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Finds pushers that are faster than any: times or lengths in another unit."""
    for seen in log:
        speed = seen.push.length / seen.push.duration
        if speed > MAX_SPEED:
            yield (
                f"push {seen.name!r}, column t: the pusher moves {seen.push.length:.3g} m in "
                f"{seen.push.duration:.3g} "
                f"s; expected at most {MAX_SPEED:g} m/s: are times in s, and tip_x, tip_y in m?"
            )


def _find_slow_pushers(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Finds pushers so slow, at the median, that times are hardly in seconds."""
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
    """Finds a mass that is too large for an object of this size: grams, perhaps."""
    mass = obj.prior.total_mass
    if mass is not None and mass > _calc_max_mass(obj):
        yield (
            f"{obj.name}: total_mass is {mass:.4g} kg, of an object of {_describe_size(obj)}: in "
            "grams? expected kg"
        )


def _calc_max_mass(obj: GridObject) -> float:
    """Largest mass of an object of this size that is not doubted, kg."""
    limit = MAX_AREAL_DENSITY if obj.height is None else MAX_DENSITY * obj.height
    return min(MAX_MASS, limit * float(obj.outline.area))


def _describe_size(obj: GridObject) -> str:
    """Says how large an object is: "0.0072 m² and 0.03 m high"."""
    height = "" if obj.height is None else f" and {obj.height:.3g} m high"
    return f"{float(obj.outline.area):.3g} m²{height}"


def _find_large_forces(objects: Sequence[GridObject], log: PushLog) -> Iterator[str]:
    """Finds forces beyond what the objects' friction resists: a sensor's counts, perhaps."""
    masses = [obj.prior.total_mass for obj in objects]
    known = [mass for mass in masses if mass is not None]
    limit = MAX_FORCE
    mass = sum(known) if len(known) == len(masses) else None
    if mass is not None:
        friction = max(obj.prior.friction_max for obj in objects)
        limit = min(MAX_FORCE, FORCE_FACTOR * friction * mass * GRAVITY)
    for seen in log:
        if seen.force is None:
            continue
        size = float(np.median(np.linalg.norm(seen.force, axis=1)))
        if size > limit:
            held = "" if mass is None else f" for {mass:.3g} kg in all"
            yield (
                f"push {seen.name!r}, columns force_x, force_y: are {size:.3g} N at the median; "
                f"expected at most {limit:.3g} N{held}: in N, and not a sensor's counts?"
            )


def _find_pulling_forces(log: PushLog) -> Iterator[str]:
    """Forces against the pusher's motion: those on the pusher, or of another frame."""
    work = {seen.name: _calc_work(seen) for seen in log if seen.force is not None}
    pulling = [name for name, value in work.items() if value < 0]
    if len(pulling) > PULLING_FRACTION * len(work):
        for name in pulling:
            yield (
                f"push {name!r}, columns force_x, force_y: pull the object against the pusher's "
                "motion; expected "
                "the force on the object, in the frame of tip_x, tip_y: is it that on the pusher?"
            )


def _find_lifting_forces(log: PushLog) -> Iterator[str]:
    """Finds upward forces beyond what friction at the finger can carry: a sensor's offset."""
    felt = [
        (seen.force, seen.lift_force)
        for seen in log
        if seen.force is not None and seen.lift_force is not None
    ]
    if not felt:
        return
    up = float(np.median(np.concatenate([np.abs(lift) for _, lift in felt])))
    along = float(np.median(np.concatenate([np.linalg.norm(force, axis=1) for force, _ in felt])))
    if up > along:
        yield (
            f"column {LIFT_FORCE}: is {up:.3g} N at the median, up or down, and force_x, force_y "
            f"only {along:.3g} N; expected less, for friction at the pusher cannot carry as much: "
            "was the sensor's offset taken off?"
        )


def _calc_work(seen: ObservedPush) -> float:
    """Work of a push's measured force along the pusher's path, J."""
    assert seen.force_t is not None and seen.force is not None
    # Each force is taken to last until the next one is measured.
    ends = np.append(seen.force_t[1:], seen.push.duration)
    path = seen.push.tip_at(ends) - seen.push.tip_at(seen.force_t)
    return float((seen.force * path).sum())


def _find_begun_off_table(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Finds pushes at whose beginning the object is not on the log's table."""
    for seen, rows in _find_off_table(obj, log):
        if 0 in rows:
            yield _describe_off_table(obj, seen, 0)


def _find_gone_off_table(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Finds pushes during which the object leaves the log's table."""
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
    """Says where a push has the object off the table; `row` 0 is its first pose."""
    t, pose = (seen.t_observed[row - 1], seen.poses_observed[row - 1]) if row else (0.0, seen.pose)
    at = ", ".join(f"{value:.3g}" for value in pose)
    return (
        f"push {seen.name!r}, column table: at t = {t:.3g} s the object, at ({at}), has no cell of "
        f"{obj.name} with its center on the table; expected an object on it, and both in one frame"
    )


def _find_jumps(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Finds objects that move farther than their push can take them."""
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
        # The column that moves most is named; what fits once it is divided by 1,000 is probably mm.
        column = f"{log.names[0]}_{'xy'[int(np.argmax(np.abs(moved[k])))]}"
        cause = (
            "in millimeters, or a lost track?" if far[k] * M_PER_MM < allowed else "a lost track?"
        )
        yield (
            f"push {seen.name!r}, column {column}: the object moves {far[k]:.3g} m by t = "
            f"{seen.t_observed[k - 1]:.3g} "
            f"s, in a push of {seen.push.length:.3g} m; expected less than {allowed:.3g} m: {cause}"
        )


def _find_turns(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Finds objects that turn farther than their push can turn them."""
    for seen in log:
        # A point at the radius of gyration goes no farther than the centroid may.
        turned = np.abs(seen.poses_observed[:, 2] - seen.pose[2])
        allowed = _calc_reach(obj, seen) / obj.radius_of_gyration
        if not len(turned) or turned.max() <= allowed:
            continue
        k = int(np.argmax(turned))
        yield (
            f"push {seen.name!r}, column {log.names[0]}_theta: the object turns {turned[k]:.3g} "
            f"rad by t = {seen.t_observed[k]:.3g} s, in a push of {seen.push.length:.3g} m; "
            f"expected less than {allowed:.3g} rad: in degrees, or a lost track?"
        )


def _find_large_objects(obj: GridObject, log: PushLog | MassTestLog) -> Iterator[str]:
    """Finds an outline that is larger than any object that is pushed about."""
    if calc_diameter(obj) > MAX_DIAMETER:
        yield (
            f"{obj.name}: its outline spans {calc_diameter(obj):.3g} m; in millimeters? expected "
            f"m, at most {MAX_DIAMETER:g}"
        )


def _find_large_angles(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Finds pushes whose first angle is many turns: degrees, perhaps."""
    for seen in log:
        if abs(seen.pose[2]) > MAX_FIRST_ANGLE:
            yield (
                f"push {seen.name!r}, column {log.names[0]}_theta: in degrees? expected rad; the "
                f"object lies at {seen.pose[2]:.4g}"
            )


def _find_large_tables(obj: GridObject, log: PushLog) -> Iterator[str]:
    """Finds a table that is larger than any: millimeters, perhaps."""
    if log.table is not None and (size := float(np.ptp(log.table, axis=0).max())) > MAX_TABLE:
        yield (
            f"column table: in millimeters? expected m, at most {MAX_TABLE:g} a side; "
            f"the table spans {size:.3g}"
        )


def _name_mass_tests(log: MassTestLog) -> Iterator[tuple[str, TiltTest | LiftTest]]:
    """Names each weighing by its kind and its number among those of its kind, from 1."""
    for i, press in enumerate(log.presses, start=1):
        yield f"press {i}", press
    for i, lift in enumerate(log.lifts, start=1):
        yield f"lift {i}", lift


def _find_misplaced_mass_tests(obj: GridObject, log: MassTestLog) -> Iterator[str]:
    """Finds weighings whose tip or pads were not at the object."""
    for name, weighing in _name_mass_tests(log):
        off = _calc_off_outline(obj, weighing.pose, weighing.place)
        if off <= NOISE_FRACTION * calc_diameter(obj):
            continue
        yield (
            f"{name}, columns place_x, place_y: are {off:.3g} m off the outline of {obj.name} at "
            "object_x, object_y, object_theta; expected a place on it: are both in one frame and "
            "in m, and object_theta in rad?"
        )


def _calc_off_outline(obj: GridObject, pose: Array, place: Array) -> float:
    """Distance of a place (2,) in W from the convex hull of an object at a pose (3,), m."""
    return float(obj.outline.convex_hull.distance(Point(transform_back(pose, place))))


def _find_presses_of_fallen(obj: GridObject, log: MassTestLog) -> Iterator[str]:
    """Finds presses of an object no part of which lies inside the table's edge."""
    for i, press in enumerate(log.presses, start=1):
        if _calc_reach_inside(obj, press) <= 0:
            yield (
                f"press {i}, columns edge_x, edge_y, edge_angle: {obj.name} lies wholly beyond the "
                "edge; expected a part of it inside: is edge_angle, in rad, the direction in which "
                "the table ends?"
            )


def _calc_reach_inside(obj: GridObject, press: TiltTest) -> float:
    """Distance of the object's innermost point from the edge, m; negative beyond the edge."""
    corners = transform(press.pose, shapely.get_coordinates(obj.outline.convex_hull))
    return float(((press.edge_point - corners) @ press.normal).max())


def _find_heavy_mass_tests(obj: GridObject, log: MassTestLog) -> Iterator[str]:
    """Finds forces that only an object heavier than any of its size takes to tilt or to lift."""
    limit = _calc_max_mass(obj)
    for name, weighing in _name_mass_tests(log):
        if isinstance(weighing, TiltTest):
            # F a = m g b, and b is at most the reach of the object inside the edge.
            force = weighing.force
            mass = force * weighing.arm / (_calc_reach_inside(obj, weighing) * GRAVITY)
        else:
            force = weighing.weight
            mass = force / GRAVITY
        if mass > limit:
            yield (
                f"{name}, column force: {force:.4g} N is that of {mass:.4g} kg or more, of an "
                f"object of {_describe_size(obj)}; expected at most {limit:.4g} kg: in N, and not "
                "a sensor's counts?"
            )


def _find_long_levers(obj: GridObject, log: MassTestLog) -> Iterator[str]:
    """Finds torques of lifts by which the center of mass is off the object."""
    for i, lift in enumerate(log.lifts, start=1):
        if lift.torque is None:
            continue
        # The torque is W (-l_y, l_x). Turned to the right, it is W l.
        at = lift.place + turn_right(lift.torque) / lift.weight
        off = _calc_off_outline(obj, lift.pose, at)
        error = TORQUE_SIGMAS * lift.torque_std / lift.weight
        if off > NOISE_FRACTION * calc_diameter(obj) + error:
            yield (
                f"lift {i}, columns torque_x, torque_y: put the center of mass {off:.3g} m off the "
                f"outline of {obj.name}: in N m, about the middle between the pads, and without "
                "the sensor's offset?"
            )


def _find_small_stds(obj: GridObject, log: MassTestLog) -> Iterator[str]:
    """Finds standard deviations that are smaller than those of any sensor."""
    for name, weighing in _name_mass_tests(log):
        if isinstance(weighing, TiltTest):
            stds = [("force_std", weighing.force_std, MIN_FORCE_STD, "N")]
        else:
            stds = [("force_std", weighing.weight_std, MIN_FORCE_STD, "N")]
            if weighing.torque is not None:
                stds.append(("torque_std", weighing.torque_std, MIN_TORQUE_STD, "N m"))
        for column, std, least, unit in stds:
            if std < least:
                yield (
                    f"{name}, column {column}: is {std:.3g} {unit}, and no robot feels so exactly; "
                    f"expected at least {least:g} {unit}"
                )


def _find_large_test_angles(obj: GridObject, log: MassTestLog) -> Iterator[str]:
    """Finds weighings with angles of many turns: degrees, perhaps."""
    for name, weighing in _name_mass_tests(log):
        if abs(weighing.pose[2]) > MAX_FIRST_ANGLE:
            yield f"{name}, column {IN_DEGREES}; the object lies at {weighing.pose[2]:.4g}"
        if isinstance(weighing, TiltTest) and abs(weighing.edge_angle) > MAX_FIRST_ANGLE:
            yield (
                f"{name}, column edge_angle: in degrees? expected rad; it is "
                f"{weighing.edge_angle:.4g}"
            )


WEIGHING_KINDS = (
    (_find_large_objects, True),
    (_find_misplaced_mass_tests, True),
    (_find_presses_of_fallen, True),
    (_find_heavy_mass_tests, True),
    (_find_long_levers, True),
    (_find_small_stds, True),
    (_find_large_test_angles, False),
)
"""What finds what is wrong with weighings, and whether it is certain."""

PLAUSIBILITY_CHECKS = (
    (find_units, True, True),
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
    (find_other_body_frames, False, True),
)
"""What finds what is wrong, whether it is certain, and whether it is about what a prediction begins
with."""


def _calc_reach(obj: GridObject, seen: ObservedPush) -> float:
    """Farthest that a push can move the object's centroid, m."""
    speed = SPEED_FACTOR * seen.push.length / seen.push.duration
    slide = speed**2 / (2 * obj.prior.friction_min * GRAVITY)
    return TRAVEL_FACTOR * seen.push.length + slide + NOISE_FRACTION * calc_diameter(obj)

"""A continuous stream of the tip's and the object's poses: its CSV form, and the pushes in it.

A stream is one CSV file, a row a sample, SI units and radians, world frame. Its columns: t; tip_x,
tip_y (the center of the pusher's disc); optionally tip_z, its height above the table, 0 where it is
not there, and tip_vx, tip_vy, tip_vz, its velocity, found from its places where it is not there;
object_x, object_y, object_theta. The tip's cells, or the object's, are empty where it was not seen.
"""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from gridpush_drake.errors import PushLogError
from gridpush_drake.files import write_whole
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import (
    POSE,
    ObservedPush,
    PushLog,
    fail,
    read_number,
    read_table,
)
from gridpush_drake.pushes.segmentation import (
    UNUSABLE,
    RecordOptions,
    Sample,
    SegmenterOptions,
    SegmenterState,
    advance,
    calc_rest_pose,
    find_begin,
    make_observed_push,
    name_push,
)

TIP = ("tip_x", "tip_y", "tip_z")
VELOCITY = ("tip_vx", "tip_vy", "tip_vz")
REQUIRED = ("t", "tip_x", "tip_y", *POSE)
COLUMNS = ("t", *TIP, *VELOCITY, *POSE)

WHAT = "a stream of poses (CSV)"

VELOCITY_WINDOW = 0.1  # over which a velocity is found from places by a straight line, s


@dataclass(frozen=True, eq=False)
class Recording:
    """The pushes of a stream."""

    log: PushLog  # the pushes
    begins: tuple[float, ...] = ()  # when in the stream each began, s
    unusable: tuple[
        str, ...
    ] = ()  # why motions that may have been pushes could not be written down
    unfinished: bool = False  # whether the stream ended within a push, which is left out


def record_pushes(
    samples: Iterable[Sample],
    obj: GridObject,
    radius: float,
    segmenter: SegmenterOptions | None = None,
    record: RecordOptions | None = None,
    source: str = "",
) -> Recording:
    """Cuts a stream into pushes as `GridIdentifier` does while it goes on, and names them as it does.

    Args:
        samples: of the stream, later and later.
        radius: of the tip, m.
        segmenter: when a push begins and ends.
        record: how it is written down.
        source: where the stream came from.
    """
    segmenter, record = segmenter or SegmenterOptions(), record or RecordOptions()
    state, pushes, begins, unusable = (
        SegmenterState(),
        list[ObservedPush](),
        list[float](),
        list[str](),
    )
    for sample in samples:
        state, episode = advance(state, sample, segmenter)
        if episode is None:
            continue
        try:
            observed = make_observed_push(episode, obj, radius, name_push(len(pushes)), record)
        except UNUSABLE as error:
            unusable.append(
                f"the motion at {episode.path[0].t:g} s could not be written down: {error}"
            )
            continue
        if observed is not None:
            pushes.append(observed)
            begins.append(find_begin(episode, record))
        elif calc_rest_pose(episode.before, record) is None:
            unusable.append(
                f"before the motion at {episode.path[0].t:g} s the object was not seen at rest"
            )
    return Recording(
        PushLog(tuple(pushes), source), tuple(begins), tuple(unusable), bool(state.path)
    )


def calc_velocities(t: Array, places: Array, window: float = VELOCITY_WINDOW) -> Array:
    """Finds velocities (K, d), m/s, by straight lines through the places within half a window (s) of each.

    NaN where fewer than two places are known within it; rows of `places` (K, d), m, that are not
    finite are not known.
    """
    known = np.asarray(np.isfinite(places).all(axis=1))
    weight = known.astype(float)
    p = np.where(known[:, None], places, 0.0)
    origin = p[known].mean(axis=0) if known.any() else 0.0
    p = (p - origin) * weight[:, None]
    half = window / 2
    first, last = np.searchsorted(t, t - half, "left"), np.searchsorted(t, t + half, "right")
    first, last = (
        np.minimum(first, np.maximum(np.arange(len(t)) - 1, 0)),
        np.maximum(last, np.arange(len(t)) + 1),
    )

    def total(values: Array) -> Array:
        sums = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
        return sums[last] - sums[first]

    time = t - (t[0] + t[-1]) / 2
    n, st, stt = total(weight), total(weight * time), total(weight * time**2)
    sp, stp = total(p), total(p * time[:, None])
    n = np.maximum(n, 1.0)
    spread = stt - st**2 / n
    enough: NDArray[np.bool_] = np.greater(
        spread, np.finfo(float).eps * np.maximum(stt, 1.0) * len(t)
    )
    velocity: Array = (stp - st[:, None] * sp / n[:, None]) / np.where(enough, spread, 1.0)[:, None]
    velocity[~known | ~enough] = np.nan
    return velocity


def make_samples(t: Array, tip: Array, velocity: Array, poses: Array) -> list[Sample]:
    """Puts samples together: times (K,), p_WP and v_WP of the tip (K, 3), q_W (K, 3), NaN where it was not seen."""
    rows = zip(t.tolist(), poses.tolist(), tip.tolist(), velocity.tolist(), strict=True)
    return [Sample(time, tuple(pose), tuple(place), tuple(v)) for time, pose, place, v in rows]


DELAY_RANGE = 0.3  # greatest delay that is looked for, s
DELAY_ROUNDS = 3  # of writing the pushes down with the delay found so far
DELAY_OBSERVATIONS = 100  # most poses a push that the delay is found from
MIN_OBSERVATIONS = 5  # of a push whose delay can be estimated
LAST_SHARE = 0.2  # of a push's path, at its end, on which the object moves with the tip

END_VARIANCE = 9.0
"""Of a parabola's value at the end of its N points, in variances of one of them by N; that of the
rest is small."""

MAD_TO_STD = 1.4826  # standard deviation by median absolute deviation, of normal errors


@dataclass(frozen=True)
class Delay:
    """How late the object's poses are against the tip's places."""

    value: float  # s, positive where the poses are late
    std: float  # of it, s
    pushes: int  # from which it was found


def estimate_delay(
    samples: Sequence[Sample],
    obj: GridObject,
    radius: float,
    segmenter: SegmenterOptions | None = None,
    record: RecordOptions | None = None,
) -> Delay | None:
    """Estimates how late the object's poses are in a stream, from its standing still when the tip stops.

    Over the last part of a push the pose is q(t) = q_end + b d + c d^2, d = s(t - delay) - s_end, s
    the tip's path: the delay, b and c that fit it best. Of all pushes the median counts: in some
    the tip slides off before it stops. As the poses at rest are chosen by the delay, the pushes are
    written down once more with what was found.

    The arguments are those of `record_pushes`; delays are beyond `record.pose_delay`. None where
    poses are too few.
    """
    record = replace(record or RecordOptions(), observations=DELAY_OBSERVATIONS)
    start, found, errors = record.pose_delay, list[float](), list[float]()
    for _ in range(DELAY_ROUNDS):
        log = record_pushes(samples, obj, radius, segmenter, record).log
        fits = [
            fit for seen in log if (fit := _fit_delay(seen, obj.radius_of_gyration)) is not None
        ]
        if not fits:
            return None
        found, errors = (
            [value + record.pose_delay - start for value, _ in fits],
            [std for _, std in fits],
        )
        record = replace(record, pose_delay=start + float(np.median(found)))
    median = float(np.median(found))
    spread = max(
        MAD_TO_STD * float(np.median(np.abs(np.array(found) - median))), float(np.median(errors))
    )
    return Delay(median, spread * math.sqrt(math.pi / 2 / len(found)), len(found))


def _fit_delay(seen: ObservedPush, rho: float) -> tuple[float, float] | None:
    """A push's delay and its standard deviation, s; None where there is too little to see."""
    end = float(seen.push.distance_at(seen.push.duration))
    late = seen.push.distance_at(seen.t_observed) > (1 - LAST_SHARE) * end
    late[-1:] = False
    count = int(late.sum())
    if count < MIN_OBSERVATIONS:
        return None
    moved = (seen.poses_observed[late] - seen.final_pose) * (1.0, 1.0, rho)

    def fit(delay: float) -> tuple[float, Array]:
        d = seen.push.distance_at(seen.t_observed[late] - delay) - end
        basis = np.column_stack([d, d**2]) / end
        factors = np.asarray(np.linalg.lstsq(basis, moved, rcond=None)[0], dtype=np.float64)
        return float(np.linalg.norm(moved - basis @ factors)), factors

    best = minimize_scalar(
        lambda delay: fit(delay)[0], bounds=(-DELAY_RANGE, DELAY_RANGE), method="bounded"
    ).x
    misfit, factors = fit(best)
    duration = seen.t_observed[late][-1] - seen.t_observed[late][0]
    speed = float(np.linalg.norm(factors[0])) * LAST_SHARE / duration
    if abs(best) > (1 - 1 / MIN_OBSERVATIONS) * DELAY_RANGE or not speed > 0:
        return None
    return float(best), misfit / math.sqrt(moved.size) * math.sqrt(END_VARIANCE / count) / speed


def write_stream_csv(samples: Sequence[Sample], path: Path | str, force: bool = False) -> None:
    """Writes a stream so that `read_stream_csv` gives its numbers back bit for bit.

    Raises OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    for sample in samples:
        row = [repr(float(sample.t))]
        for numbers in ((*sample.tip, *sample.velocity), sample.pose):
            row += [
                repr(float(number)) if all(map(math.isfinite, numbers)) else ""
                for number in numbers
            ]
        writer.writerow(row)
    write_whole(path, buffer.getvalue(), force)


def read_stream_csv(path: Path | str) -> list[Sample]:
    """Reads a stream.

    Raises PushLogError: the file cannot be read or breaks the form; the message names file, line,
    column and form.
    """
    path = Path(path)
    t, groups = list[float](), list[list[list[float]]]()
    measured = False
    for line, row in read_table(path, WHAT, REQUIRED, _check_header):
        t.append(_read_time(path, line, row["t"], t))
        groups.append([_read_group(path, line, row, group) for group in (TIP, VELOCITY, POSE)])
        measured = VELOCITY[0] in row
    if not t:
        raise PushLogError(f"{path}: is empty; expected rows below the header {','.join(REQUIRED)}")
    times, (tip, velocity, poses) = np.array(t), np.array(groups).transpose(1, 0, 2)
    return make_samples(times, tip, velocity if measured else calc_velocities(times, tip), poses)


def _check_header(path: Path, line: int, header: list[str]) -> None:
    form = f"expected {','.join(REQUIRED)} and, if known, {TIP[2]} and {', '.join(VELOCITY)}"
    for name in header:
        if name not in COLUMNS or header.count(name) > 1:
            fail(path, line, name, f"is {'there twice' if name in COLUMNS else 'unknown'}; {form}")
    there = [name for name in VELOCITY if name in header]
    for name in (*REQUIRED, *(VELOCITY if there else ())):
        if name not in header:
            fail(path, line, name, f"is missing; {form}")


def _read_time(path: Path, line: int, cell: str, before: list[float]) -> float:
    time = _read_number(path, line, "t", cell)
    if before and time <= before[-1]:
        fail(path, line, "t", f"is {time!r} after {before[-1]!r}; expected times (s) that increase")
    return time


def _read_group(
    path: Path, line: int, row: dict[str, str], columns: tuple[str, ...]
) -> list[float]:
    """The numbers of columns that are empty together; 0 for a column that the file does not have."""
    there = [name for name in columns if name in row]
    if not any(row[name].strip() for name in there):
        return [math.nan] * len(columns) if there else [0.0] * len(columns)
    return [_read_number(path, line, name, row[name]) if name in row else 0.0 for name in columns]


def _read_number(path: Path, line: int, column: str, cell: str) -> float:
    group = next((columns for columns in (TIP, VELOCITY, POSE) if column in columns), None)
    form = "a finite number" + (f", or {', '.join(group)} empty" if group else " (s)")
    return read_number(path, line, column, cell, form)

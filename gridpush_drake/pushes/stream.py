"""A continuous stream of the tip's and the object's poses: its CSV form, and the pushes in it.

A stream is one CSV file, a row a sample, SI units and radians, world frame. Its columns: t; tip_x,
tip_y (the center of the pusher's disc); optionally tip_z, its height above the table, 0 where it is
not there, and tip_vx, tip_vy, tip_vz, its velocity, found from its places where it is not there;
object_x, object_y, object_theta; optionally tip_yaw, the angle of the frame of a pusher that is no
disc, 0 where it is not there. The tip's cells, or the object's, are empty where it was not seen.
Where it is known how much later the object's poses are than their times say, such as the age of a
camera's pictures, that stands in the column object_delay, s, in the first row and nowhere else.
"""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import PushLogError
from gridpush_drake.files import write_whole
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.csv_table import (
    fail,
    is_empty,
    read_number,
    read_table,
    refuse_misspelled,
    warn_of_further,
)
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_csv import POSE_COLUMNS
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import (
    UNUSABLE_ERRORS,
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

STREAM_TIP_COLUMNS = ("tip_x", "tip_y", "tip_z")
VELOCITY_COLUMNS = ("tip_vx", "tip_vy", "tip_vz")
REQUIRED_STREAM_COLUMNS = ("t", "tip_x", "tip_y", *POSE_COLUMNS)
YAW_COLUMN = "tip_yaw"
DELAY_COLUMN = "object_delay"
STREAM_COLUMNS = (
    "t",
    *STREAM_TIP_COLUMNS,
    *VELOCITY_COLUMNS,
    *POSE_COLUMNS,
    YAW_COLUMN,
    DELAY_COLUMN,
)

EXPECTED_STREAM = "a stream of poses (CSV)"

MAX_GIVEN_DELAY = 10.0
"""Largest delay of the object's poses that is believed, s. A larger one is in another unit."""

VELOCITY_WINDOW = 0.1
"""Length of time over which a straight line through the tip's places tells its velocity, s."""


@dataclass(frozen=True, eq=False)
class Recording:
    """The pushes of a stream.

    Attributes:
        log: the pushes.
        begins: when in the stream each of them began, s.
        unusable: a sentence for each motion that may have been a push but could not be written
            down.
        unfinished: whether the stream ended within a push, which is left out.
    """

    log: PushLog
    begins: tuple[float, ...] = ()
    unusable: tuple[str, ...] = ()
    unfinished: bool = False


def record_pushes(
    samples: Iterable[Sample],
    obj: GridObject,
    pusher: float | PusherShape,
    segmenter: SegmenterOptions | None = None,
    record: RecordOptions | None = None,
    source: str = "",
) -> Recording:
    """Cuts a stream into pushes, and names them.

    `GridIdentifier` does the same while a stream goes on.

    Args:
        samples: the stream's samples, in the order of their times.
        obj: the object that is pushed.
        pusher: radius of the tip, m, or the shape of a pusher that is no disc.
        segmenter: when a push begins and ends.
        record: how a push is written down.
        source: where the stream came from, for messages.

    Returns:
        The pushes, and what could not be made one.
    """
    segmenter = segmenter or SegmenterOptions()
    record = record or RecordOptions()
    state = SegmenterState()
    pushes: list[ObservedPush] = []
    begins: list[float] = []
    unusable: list[str] = []
    for sample in samples:
        state, episode = advance(state, sample, segmenter)
        if episode is None:
            continue
        # One push that was badly seen must not cost the others.
        try:
            observed = make_observed_push(episode, obj, pusher, name_push(len(pushes)), record)
        except UNUSABLE_ERRORS as error:
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
        log=PushLog(tuple(pushes), source),
        begins=tuple(begins),
        unusable=tuple(unusable),
        unfinished=bool(state.path),
    )


def calc_velocities(t: Array, places: Array, window: float = VELOCITY_WINDOW) -> Array:
    """Finds velocities by fitting straight lines to the places around each time.

    With weights w_i of 1 where a place p_i is known and 0 where not, least squares gives

        v = (sum w t p - sum w t sum w p / n) / (sum w t² - (sum w t)² / n),    n = sum w

    Args:
        t: (K,) times, increasing, s.
        places: (K, d) places, m; a row that is not finite is not known.
        window: length of time that a line is fitted to, s.

    Returns:
        (K, d) velocities, m/s; NaN where the place is not known, or fewer than two are within the
        window.
    """
    known = np.asarray(np.isfinite(places).all(axis=1))
    weight = known.astype(float)
    p = np.where(known[:, None], places, 0.0)
    # Places about their mean, and times about the middle: the sums below then lose fewest digits.
    origin = p[known].mean(axis=0) if known.any() else 0.0
    p = (p - origin) * weight[:, None]
    time = t - (t[0] + t[-1]) / 2

    # The rows within each window, and at least the row itself and the one before it.
    index = np.arange(len(t))
    half = window / 2
    first = np.minimum(np.searchsorted(t, t - half, "left"), np.maximum(index - 1, 0))
    end = np.maximum(np.searchsorted(t, t + half, "right"), index + 1)

    def total(values: Array) -> Array:
        """Sums rows over each window, as a difference of sums from the beginning."""
        nothing = np.zeros((1, *values.shape[1:]))
        sums = np.concatenate([nothing, np.cumsum(values, axis=0)])
        return sums[end] - sums[first]

    n = total(weight)
    sum_t = total(weight * time)
    sum_tt = total(weight * time**2)
    sum_p = total(p)
    sum_tp = total(p * time[:, None])
    n = np.maximum(n, 1.0)
    spread = sum_tt - sum_t**2 / n
    # A spread of round-off alone is that of a single time.
    least_spread = np.finfo(float).eps * np.maximum(sum_tt, 1.0) * len(t)
    enough: NDArray[np.bool_] = np.greater(spread, least_spread)
    covariance = sum_tp - sum_t[:, None] * sum_p / n[:, None]
    velocity: Array = covariance / np.where(enough, spread, 1.0)[:, None]
    velocity[~known | ~enough] = np.nan
    return velocity


def make_samples(t: Array, tip: Array, velocity: Array, poses: Array) -> list[Sample]:
    """Puts samples together.

    Args:
        t: (K,) times, s.
        tip: (K, 3) p_WP, places of the tip's center, m.
        velocity: (K, 3) v_WP, m/s.
        poses: (K, 3) q_WB of the object, m and rad; NaN where it was not seen.

    Returns:
        K samples.
    """
    rows = zip(t.tolist(), poses.tolist(), tip.tolist(), velocity.tolist(), strict=True)
    return [Sample(time, tuple(pose), tuple(place), tuple(v)) for time, pose, place, v in rows]


def turn_samples(samples: Sequence[Sample], t: Array, yaws: Array, mounted: float) -> list[Sample]:
    """Adds the angle of a pusher that is no disc to samples.

    Args:
        samples: the samples.
        t: (K,) times at which what carries the pusher was seen, or was not, by the same clock, s.
        yaws: (K,) its angles about the vertical then, rad; NaN where it was not seen, through which
            it is taken to turn evenly.
        mounted: how far the pusher's x axis is turned from that, rad.
    """
    seen = np.isfinite(yaws)
    if not seen.any():
        return list(samples)
    turned = np.interp([each.t for each in samples], t[seen], np.unwrap(yaws[seen])) + mounted
    return [each._replace(yaw=yaw) for each, yaw in zip(samples, turned.tolist(), strict=True)]


@dataclass(frozen=True, eq=False)
class Stream:
    """What a stream's file holds.

    Attributes:
        samples: the samples, in the order of their times.
        pose_delay: how much later the object's poses are than their times say, s; None where the
            file does not say.
    """

    samples: list[Sample]
    pose_delay: float | None = None


def write_stream_csv(
    samples: Sequence[Sample],
    path: Path | str,
    force: bool = False,
    pose_delay: float | None = None,
) -> None:
    """Writes a stream so that `read_stream_csv` gives its numbers back bit for bit.

    Args:
        samples: the samples, in the order of their times.
        path: the file to be written.
        force: whether an existing file may be replaced.
        pose_delay: how much later the object's poses are than their times say, s; None where it is
            not known.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    delays = [] if pose_delay is None else [repr(float(pose_delay))]
    turned = any(sample.yaw for sample in samples)
    left_out = {*(() if turned else (YAW_COLUMN,)), *(() if delays else (DELAY_COLUMN,))}
    writer.writerow([name for name in STREAM_COLUMNS if name not in left_out])
    for sample in samples:
        row = [repr(float(sample.t))]
        # Cells of what was not seen are empty, all of the tip's or all of the object's.
        for numbers in ((*sample.tip, *sample.velocity), sample.pose):
            was_seen = all(map(math.isfinite, numbers))
            row += [repr(float(number)) if was_seen else "" for number in numbers]
        yaw = [repr(float(sample.yaw))] if turned else []
        writer.writerow([*row, *yaw, *delays])
        delays = [""] * len(delays)
    write_whole(path, buffer.getvalue(), force)


def read_stream_csv(path: Path | str) -> Stream:
    """Reads a stream's file; its form stands at the head of this module.

    Raises:
        PushLogError: the file cannot be read or breaks the form; the message names file, line,
            column and form.

    Warns:
        PushLogWarning: the file has further columns, which are passed over.
    """
    path = Path(path)
    t: list[float] = []
    groups: list[list[list[float]]] = []
    yaws: list[float] = []
    measured = False
    pose_delay: float | None = None
    for line, row in read_table(path, EXPECTED_STREAM, REQUIRED_STREAM_COLUMNS, _check_header):
        t.append(_read_time(path, line, row["t"], t, is_log="push" in row))
        groups.append(
            [
                _read_group(path, line, row, group)
                for group in (STREAM_TIP_COLUMNS, VELOCITY_COLUMNS, POSE_COLUMNS)
            ]
        )
        yaws.append(_read_yaw(path, line, row.get(YAW_COLUMN, "")))
        measured = VELOCITY_COLUMNS[0] in row
        if not is_empty(row.get(DELAY_COLUMN, "")):
            pose_delay = _read_delay(path, line, row[DELAY_COLUMN], pose_delay)
    if not t:
        raise PushLogError(
            f"{path}: is empty; expected rows below the header {','.join(REQUIRED_STREAM_COLUMNS)}"
        )
    times = np.array(t)
    tip, velocity, poses = np.array(groups).transpose(1, 0, 2)
    if not measured:
        velocity = calc_velocities(times, tip)
    samples = make_samples(times, tip, velocity, poses)
    turned = zip(samples, yaws, strict=True)
    return Stream([sample._replace(yaw=yaw) for sample, yaw in turned], pose_delay)


def _read_yaw(path: Path, line: int, cell: str) -> float:
    """Reads the angle of a pusher's frame, rad; 0 of an empty cell."""
    return 0.0 if is_empty(cell) else read_number(path, line, YAW_COLUMN, cell, "an angle (rad)")


def _read_delay(path: Path, line: int, cell: str, before: float | None) -> float:
    """Reads the delay in a row's cell, s, which must be the one of the rows before it."""
    form = f"how late the object's poses are (s), at most {MAX_GIVEN_DELAY:g}"
    delay = read_number(path, line, DELAY_COLUMN, cell, form)
    if abs(delay) > MAX_GIVEN_DELAY:
        fail(path, line, DELAY_COLUMN, f"is {delay:g}; expected {form}: in milliseconds?")
    if before is not None and delay != before:
        fail(
            path, line, DELAY_COLUMN, f"is {delay!r} after {before!r}; expected one delay in a file"
        )
    return delay


def _check_header(path: Path, line: int, header: list[str]) -> None:
    """Refuses a header without a column that is needed, or with one twice or misspelled."""
    known = (
        f"{STREAM_TIP_COLUMNS[2]}, {YAW_COLUMN}, {DELAY_COLUMN} and {', '.join(VELOCITY_COLUMNS)}"
    )
    form = f"expected {','.join(REQUIRED_STREAM_COLUMNS)} and, if known, {known}"
    for name in header:
        if header.count(name) > 1:
            fail(path, line, name, f"is there twice; {form}")
    refuse_misspelled(path, line, header, STREAM_COLUMNS, form)
    there = [name for name in VELOCITY_COLUMNS if name in header]
    for name in (*REQUIRED_STREAM_COLUMNS, *(VELOCITY_COLUMNS if there else ())):
        if name not in header:
            fail(path, line, name, f"is missing; {form}")
    warn_of_further(path, header, STREAM_COLUMNS)


def _read_time(path: Path, line: int, cell: str, before: list[float], is_log: bool) -> float:
    """Reads a row's time, s, which must be later than those of the rows before it.

    In a push log (`is_log`: the file has a column `push`) time begins anew with each push.
    """
    time = _read_number(path, line, "t", cell)
    if before and time <= before[-1]:
        hint = "; is it a push log, which has a column push?" if is_log else ""
        expected = f"expected times (s) that increase, as {EXPECTED_STREAM} has them{hint}"
        fail(path, line, "t", f"is {time!r} after {before[-1]!r}; {expected}")
    return time


def _read_group(
    path: Path, line: int, row: dict[str, str], columns: tuple[str, ...]
) -> list[float]:
    """Reads the cells of columns that are empty together.

    Returns:
        A number for each column: NaN where the cells are empty, 0 where the file has no such
        column.
    """
    there = [name for name in columns if name in row]
    if all(is_empty(row[name]) for name in there):
        return [math.nan] * len(columns) if there else [0.0] * len(columns)
    return [_read_number(path, line, name, row[name]) if name in row else 0.0 for name in columns]


def _read_number(path: Path, line: int, column: str, cell: str) -> float:
    """Reads a cell's number; a message says which columns may be empty together."""
    group = next(
        (
            columns
            for columns in (STREAM_TIP_COLUMNS, VELOCITY_COLUMNS, POSE_COLUMNS)
            if column in columns
        ),
        None,
    )
    form = "a finite number" + (f", or {', '.join(group)} empty" if group else " (s)")
    return read_number(path, line, column, cell, form)

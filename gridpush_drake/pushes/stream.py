"""A continuous stream of the tip's and the object's poses: its CSV form, and the pushes in it.

A stream is one CSV file, a row a sample, SI units and radians, world frame. Its columns: t; tip_x,
tip_y (the center of the pusher's disc); optionally tip_z, its height above the table, 0 where it is
not there, and tip_vx, tip_vy, tip_vz, its velocity, found from its places where it is not there;
object_x, object_y, object_theta. The tip's cells, or the object's, are empty where it was not seen.
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

from gridpush_drake.errors import PushLogError
from gridpush_drake.files import write_whole
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import (
    POSE,
    ObservedPush,
    PushLog,
    fail,
    is_empty,
    read_number,
    read_table,
    refuse_misspelled,
    warn_of_further,
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
DELAY = "object_delay"
COLUMNS = ("t", *TIP, *VELOCITY, *POSE, DELAY)

WHAT = "a stream of poses (CSV)"

MAX_TOLD_DELAY = 10.0
"""Greatest delay of the object's poses that is believed, s; a larger one is in another unit."""

VELOCITY_WINDOW = 0.1
"""Over which a velocity is found from places by a straight line, s."""


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


@dataclass(frozen=True, eq=False)
class Stream:
    """What a stream's file holds.

    Attributes:
        samples: later and later.
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
        samples: later and later.
        path: the file to be written.
        force: whether an existing file may be replaced.
        pose_delay: how much later the object's poses are than their times say, s; None where it is
            not known.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    told = [] if pose_delay is None else [repr(float(pose_delay))]
    writer.writerow(COLUMNS if told else COLUMNS[:-1])
    for sample in samples:
        row = [repr(float(sample.t))]
        for numbers in ((*sample.tip, *sample.velocity), sample.pose):
            row += [
                repr(float(number)) if all(map(math.isfinite, numbers)) else ""
                for number in numbers
            ]
        writer.writerow([*row, *told])
        told = [""] * len(told)
    write_whole(path, buffer.getvalue(), force)


def read_stream_csv(path: Path | str) -> Stream:
    """Reads a stream.

    Raises:
        PushLogError: the file cannot be read or breaks the form; the message names file, line,
            column and form.

    Warns:
        PushLogWarning: the file has further columns, which are passed over.
    """
    path = Path(path)
    t, groups = list[float](), list[list[list[float]]]()
    measured = False
    pose_delay: float | None = None
    for line, row in read_table(path, WHAT, REQUIRED, _check_header):
        t.append(_read_time(path, line, row["t"], t))
        groups.append([_read_group(path, line, row, group) for group in (TIP, VELOCITY, POSE)])
        measured = VELOCITY[0] in row
        if not is_empty(row.get(DELAY, "")):
            pose_delay = _read_delay(path, line, row[DELAY], pose_delay)
    if not t:
        raise PushLogError(f"{path}: is empty; expected rows below the header {','.join(REQUIRED)}")
    times, (tip, velocity, poses) = np.array(t), np.array(groups).transpose(1, 0, 2)
    if not measured:
        velocity = calc_velocities(times, tip)
    return Stream(make_samples(times, tip, velocity, poses), pose_delay)


def _read_delay(path: Path, line: int, cell: str, before: float | None) -> float:
    """The delay in a row's cell, which must be the one of the rows before it, s."""
    form = f"how late the object's poses are (s), at most {MAX_TOLD_DELAY:g}"
    delay = read_number(path, line, DELAY, cell, form)
    if abs(delay) > MAX_TOLD_DELAY:
        fail(path, line, DELAY, f"is {delay:g}; expected {form}: in milliseconds?")
    if before is not None and delay != before:
        fail(path, line, DELAY, f"is {delay!r} after {before!r}; expected one delay in a file")
    return delay


def _check_header(path: Path, line: int, header: list[str]) -> None:
    known = f"{TIP[2]}, {DELAY} and {', '.join(VELOCITY)}"
    form = f"expected {','.join(REQUIRED)} and, if known, {known}"
    for name in header:
        if header.count(name) > 1:
            fail(path, line, name, f"is there twice; {form}")
    refuse_misspelled(path, line, header, COLUMNS, form)
    there = [name for name in VELOCITY if name in header]
    for name in (*REQUIRED, *(VELOCITY if there else ())):
        if name not in header:
            fail(path, line, name, f"is missing; {form}")
    warn_of_further(path, header, COLUMNS)


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
    if all(is_empty(row[name]) for name in there):
        return [math.nan] * len(columns) if there else [0.0] * len(columns)
    return [_read_number(path, line, name, row[name]) if name in row else 0.0 for name in columns]


def _read_number(path: Path, line: int, column: str, cell: str) -> float:
    group = next((columns for columns in (TIP, VELOCITY, POSE) if column in columns), None)
    form = "a finite number" + (f", or {', '.join(group)} empty" if group else " (s)")
    return read_number(path, line, column, cell, form)

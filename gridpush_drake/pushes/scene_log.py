"""Pushes of several objects that were seen together: `SceneLog`, and its file.

A scene log is one tidy CSV file, a row a sample, as that of one object is (`push_log`), with three
columns for each object: NAME_x, NAME_y and NAME_theta. A push log of one object is so a scene log
of one, which is called "object".
"""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushLogError
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.pushes.csv_table import fail, is_empty, read_table
from gridpush_drake.pushes.push_csv import TIP
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS

AXES = ("x", "y", "theta")
"""Endings of the three columns of an object's pose."""

REQUIRED = ("push", "t", *TIP)
"""Columns that every file has, besides those of the objects."""

WHAT = "a scene log (CSV)"
"""The expected form of a file, for messages."""

FORM = f"expected {','.join(REQUIRED)} and NAME_x, NAME_y, NAME_theta for each object"
"""The expected columns, for messages."""


@dataclass(frozen=True, eq=False)
class ObservedScenePush(Frozen):
    """One push and what was seen of N objects while it lasted.

    Attributes:
        name: what to call it.
        push: the disc's motion.
        poses: (N, 3) q_W = (x, y, theta) of the objects at the push's beginning, m and rad.
        t_observed: (K,) times of the later observations, s, strictly increasing, in (0,
            push.duration].
        poses_observed: (K, N, 3) q_W at those times.

    Raises:
        PushLogError: a shape, a time or a value is not as said above.
    """

    name: str
    push: Push
    poses: Array
    t_observed: Array
    poses_observed: Array

    def __post_init__(self) -> None:
        poses = np.array(self.poses, dtype=np.float64)
        times = np.array(self.t_observed, dtype=np.float64)
        later = np.array(self.poses_observed, dtype=np.float64)
        n = len(poses)
        if poses.shape != (n, 3) or times.ndim != 1 or later.shape != (len(times), n, 3):
            raise PushLogError(
                f"push {self.name!r}: poses of shape {poses.shape}, t_observed {times.shape}, "
                f"poses_observed {later.shape}; expected (N, 3), (K,) and (K, N, 3)"
            )
        if not all(np.isfinite(values).all() for values in (poses, times, later)):
            raise PushLogError(f"push {self.name!r}: poses and times must be finite numbers")
        inside = len(times) > 0 and times[0] > 0 and times[-1] <= self.push.duration
        if not inside or (np.diff(times) <= 0).any():
            raise PushLogError(
                f"push {self.name!r}: t_observed must increase strictly, from more than 0 to at "
                f"most {self.push.duration} s"
            )
        for name, values in (("poses", poses), ("t_observed", times), ("poses_observed", later)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)


@dataclass(frozen=True, eq=False)
class SceneLog(Frozen):
    """Several pushes of the same objects.

    Attributes:
        pushes: the pushes.
        names: the objects' names, in the order of their poses.

    Raises:
        PushLogError: a push has another number of objects.
    """

    pushes: tuple[ObservedScenePush, ...]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "pushes", tuple(self.pushes))
        object.__setattr__(self, "names", tuple(self.names))
        for seen in self.pushes:
            if len(seen.poses) != len(self.names):
                raise PushLogError(
                    f"push {seen.name!r}: {len(seen.poses)} objects; expected "
                    f"{len(self.names)}: {', '.join(self.names)}"
                )

    def __len__(self) -> int:
        return len(self.pushes)

    def __iter__(self) -> Iterator[ObservedScenePush]:
        return iter(self.pushes)

    def __getitem__(self, index: int) -> ObservedScenePush:
        return self.pushes[index]

    @classmethod
    def read_csv(cls, path: Path | str, radius: float = DEFAULT_PUSHER_RADIUS) -> "SceneLog":
        """Reads a scene log, or a push log of one object.

        Args:
            path: the file.
            radius: of the pusher, m.

        Raises:
            PushLogError: the file cannot be read or breaks the form; the message names the file,
                the line, the column and the expected form.
        """
        path = Path(path)
        names: list[str] = []
        rows = []
        for line, cells in read_table(path, WHAT, REQUIRED, _check_header):
            names = names or _find_names(list(cells))
            rows.append((line, cells))
        pushes = []
        for _, group in groupby(rows, lambda row: row[1]["push"].strip()):
            pushes.append(_read_push(path, list(group), names, radius))
        if not pushes:
            raise PushLogError(f"{path}: holds no push; {FORM}")
        return cls(tuple(pushes), tuple(names))

    def write_csv(self, path: Path | str, force: bool = False) -> None:
        """Writes the log so that `read_csv` gives its numbers back bit for bit.

        Raises:
            OutputError: the file exists and `force` is not set, or it cannot be written.
        """
        path = Path(path)
        check_writable(path, force)
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        columns = [f"{name}_{axis}" for name in self.names for axis in AXES]
        writer.writerow([*REQUIRED, *columns])
        for seen in self.pushes:
            poses = dict(zip(seen.t_observed.tolist(), seen.poses_observed, strict=True))
            poses[0.0] = seen.poses
            times = sorted({*seen.push.t.tolist(), *poses})
            for t, tip in zip(times, seen.push.tip_at(times).tolist(), strict=True):
                values = [repr(value) for value in poses[t].ravel().tolist()] if t in poses else []
                values += [""] * (len(columns) - len(values))
                writer.writerow([seen.name, repr(t), *map(repr, tip), *values])
        write_whole(path, buffer.getvalue(), force)


def _check_header(path: Path, line: int, header: list[str]) -> None:
    """Refuses a header without a column that is needed."""
    for name in REQUIRED:
        if name not in header:
            fail(path, line, name, f"is missing; {FORM}")
    names = _find_names(header)
    if not names:
        fail(path, line, "NAME_x", f"is missing; {FORM}")
    for name in names:
        for axis in AXES:
            if f"{name}_{axis}" not in header:
                fail(path, line, f"{name}_{axis}", f"is missing; {FORM}")


def _find_names(header: list[str]) -> list[str]:
    """Finds the objects that a header has the heading of, in its order."""
    ending = f"_{AXES[-1]}"
    return [column.removesuffix(ending) for column in header if column.endswith(ending)]


def _read_push(
    path: Path, rows: list[tuple[int, dict[str, str]]], names: list[str], radius: float
) -> ObservedScenePush:
    """Reads the rows of one push."""
    times = []
    tips = []
    seen_times = []
    poses = []
    columns = [f"{name}_{axis}" for name in names for axis in AXES]
    for line, cells in rows:
        times.append(_read_number(path, line, cells, "t"))
        tips.append([_read_number(path, line, cells, column) for column in TIP])
        if any(not is_empty(cells[column]) for column in columns):
            values = [_read_number(path, line, cells, column) for column in columns]
            poses.append(np.reshape(values, (len(names), 3)))
            seen_times.append(times[-1])
    line, first = rows[0]
    if not seen_times or seen_times[0] != times[0]:
        fail(path, line, columns[0], "is empty; expected all poses on a push's first row")
    name = first["push"].strip()
    try:
        push = Push.along(times, tips, radius)
        begin = times[0]
        return ObservedScenePush(
            name=name,
            push=push,
            poses=poses[0],
            t_observed=np.array(seen_times[1:]) - begin,
            poses_observed=np.array(poses[1:]).reshape(-1, len(names), 3),
        )
    except PushLogError as error:
        raise PushLogError(f"{path}, line {line}: {error}") from error


def _read_number(path: Path, line: int, cells: dict[str, str], column: str) -> float:
    """Reads a finite number of a column."""
    text = cells[column]
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        fail(path, line, column, f"is {text!r}; expected a finite number")
    return value

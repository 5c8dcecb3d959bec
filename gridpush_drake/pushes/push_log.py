"""Observed pushes: the tip's path, the object's poses and, where it was measured, the force.

Positions are in the world frame W, in m; angles in rad; times in s from the push's own beginning;
forces, N, are the pusher's on the object.

A push log is one tidy CSV file: a row a sample. Its columns: push (any text, rows of one push
together), t, tip_x, tip_y (the disc's center), object_x, object_y, object_theta (on a push's first
row, and wherever else it was observed; empty elsewhere) and, where they are known, force_x, force_y
on the object, overhang: 1 while a part of the object hung over the table's edge, 0 or empty
otherwise (one such row marks the push), and table: its top in W as well-known text, POLYGON ((x y,
x y, ...)), once in the file. Times are counted from each push's first row. A cell that holds nan
counts as empty, and further columns are passed over with a warning.
"""

import csv
import difflib
import io
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import groupby, islice, pairwise
from pathlib import Path
from typing import NamedTuple, NoReturn, overload

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.polygon import orient

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import MAX_NUMBER, PushLogError, PushLogWarning
from gridpush_drake.files import check_writable, read_text, write_whole
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.notebook import MM, count, describe_move, make_page, make_table

DEFAULT_PUSHER_RADIUS = 0.008
"""Radius of a pusher where neither the caller nor the object's file gives one, m: that of the
shipped finger, `models/fingers/rod`. Learning and planning take the same one."""

TIP = ("tip_x", "tip_y")
"""Columns of the tip's center."""

POSE = ("object_x", "object_y", "object_theta")
"""Columns of the object's pose."""

FORCE = ("force_x", "force_y")
"""Columns of the force on the object."""

REQUIRED = ("push", "t", *TIP, *POSE)
"""Columns that every file has."""

OVERHANG = "overhang"
"""Column that says whether a part of the object hung over the table's edge."""

TABLE = "table"
"""Column of the table's top."""

COLUMNS = (*REQUIRED, *FORCE, OVERHANG, TABLE)
"""All columns that are read."""

FLAGS = {"0": False, "1": True, "0.0": False, "1.0": True}
"""Texts that say no or yes in a column; pandas writes numbers of such a column with points."""

NO_NUMBER = "nan"
"""Text of an empty cell where pandas or NumPy wrote the file."""

WHAT = "a push log (CSV)"
"""The expected form of a file, for messages."""

UNITS = {"t": "s", "object_theta": "rad", "force_x": "N", "force_y": "N"}
"""Unit of each column; m where not listed."""

SUGGESTION_CUTOFF = 0.5
"""Similarity (0 to 1) from which a known column is suggested for an unknown one."""

TYPO_CUTOFF = 0.88
"""Similarity (0 to 1) to a column that is not there, from which a further column is taken for a
misspelled one and refused, lest what it holds is lost."""

MAX_ROWS = 50_000
"""Most rows of one push: 50 s of a robot that writes a thousand a second."""

MAX_POSES = 300
"""Most poses of one push that are kept after the first; of more, this many evenly spread ones. The
work of learning grows with their square, and neighbors tell nearly the same."""

MAX_SHOWN = 60
"""Characters of a refused value that a message repeats."""

MAX_NAMED = 5
"""Further columns that a warning names."""

MIN_TIME_STEP = 1e-9
"""S between two rows of a push."""


@dataclass(frozen=True, eq=False)
class ObservedPush(Frozen):
    """One push and what was seen of the object while it lasted.

    Attributes:
        name: what to call it; any text without blanks at its ends.
        push: the disc's motion.
        pose: (3,) q_W = (x, y, theta) of the object at the push's beginning, m and rad.
        t_observed: (K,) times of the later observations, s, strictly increasing, in (0,
            push.duration]; K is 0 only where a push is to be predicted.
        poses_observed: (K, 3) q_W at those times, theta continuous (see `nearest_turn`).
        force_t: (F,) times of the force samples, s, strictly increasing, in [0, push.duration];
            None where the force was not measured.
        force: (F, 2) force on the object in W, N; None where it was not measured.
        overhang: whether a part of the object hung over the table's edge.

    Raises:
        PushLogError: a shape, a time or a value is not as said above.
    """

    name: str
    push: Push
    pose: Array
    t_observed: Array
    poses_observed: Array
    force_t: Array | None = None
    force: Array | None = None
    overhang: bool = False

    def __post_init__(self) -> None:
        if not self.name or self.name != self.name.strip():
            raise PushLogError(
                f"push {self.name!r}: its name must not be empty nor have blanks at its ends"
            )
        t_observed = self._array("t_observed", self.t_observed, (-1,))
        self._array("pose", self.pose, (3,))
        self._array("poses_observed", self.poses_observed, (len(t_observed), 3))
        self._check_times("t_observed", t_observed)
        if len(t_observed) and t_observed[0] <= 0:
            raise PushLogError(
                f"push {self.name!r}: t_observed[0] is {t_observed[0]} s; expected times > 0"
            )
        if (self.force_t is None) != (self.force is None):
            raise PushLogError(
                f"push {self.name!r}: force_t and force come together, or not at all"
            )
        if self.force_t is not None and self.force is not None:
            force_t = self._array("force_t", self.force_t, (-1,))
            self._array("force", self.force, (len(force_t), 2))
            self._check_times("force_t", force_t)

    def __repr__(self) -> str:
        """Name, push and what became of the object, in a line."""
        path = f"{self.push.length * MM:.0f} mm in {self.push.duration:.3g} s"
        seen_any = len(self.t_observed) > 0
        seen = count(len(self.t_observed), "pose")
        went = f", the object {describe_move(self.pose, self.final_pose)}" if seen_any else ""
        over = ", over the table's edge" if self.overhang else ""
        return f"ObservedPush {self.name!r}: {path}, {seen}{went}{over}"

    def _array(self, name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
        """Makes a field a read-only array of a shape, in which -1 stands for any number."""
        array = np.array(value, dtype=np.float64)
        if array.size == 0 and 0 in shape:
            array = array.reshape(shape)
        if array.ndim != len(shape) or any(
            n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)
        ):
            raise PushLogError(
                f"push {self.name!r}: {name} has shape {array.shape}; expected {shape}"
            )
        if not np.isfinite(array).all():
            raise PushLogError(f"push {self.name!r}: {name} must hold finite numbers")
        array.setflags(write=False)
        object.__setattr__(self, name, array)
        return array

    def _check_times(self, name: str, t: Array) -> None:
        """Refuses times, s, that do not increase or are not within the push."""
        if np.any(np.diff(t) <= 0):
            raise PushLogError(f"push {self.name!r}: {name} must be strictly increasing")
        if len(t) and (t[0] < 0 or t[-1] > self.push.duration):
            raise PushLogError(
                f"push {self.name!r}: {name} runs from {t[0]} to {t[-1]} s; expected times within "
                f"the push, 0 to {self.push.duration} s"
            )

    @property
    def final_pose(self) -> Array:
        """Pose q_W (3,) at the last observation, m and rad.

        Raises:
            PushLogError: the object was not observed after the push's beginning.
        """
        if not len(self.poses_observed):
            raise PushLogError(
                f"push {self.name!r}: the object was not observed after the push's beginning"
            )
        return self.poses_observed[-1]


@dataclass(frozen=True, eq=False)
class PushLog(Frozen):
    """Several pushes of one object. `log[3]` is a push; `log[1:4]` and `log[[0, 2]]` are logs.

    Attributes:
        pushes: the pushes.
        source: where they came from, such as a file's name.
        radius_given: whether the pusher's radius was given with the pushes; where it was not, they
            carry DEFAULT_PUSHER_RADIUS, and whoever knows the object's file replaces it
            (`with_radius`).
        table: (K, 2) corners in W of the table's top, counterclockwise, m; None where its edge is
            far or unknown.
    """

    pushes: tuple[ObservedPush, ...]
    source: str = ""
    radius_given: bool = True
    table: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pushes", tuple(self.pushes))
        if self.table is not None:
            corners = np.array(self.table, dtype=np.float64)
            if (
                corners.ndim != 2
                or corners.shape[1] != 2
                or len(corners) < 3
                or not np.isfinite(corners).all()
            ):
                raise PushLogError(
                    f"table: corners of shape {corners.shape}; expected (K, 2) finite numbers, K "
                    ">= 3 (m)"
                )
            corners.setflags(write=False)
            object.__setattr__(self, "table", corners)

    @classmethod
    def read_csv(
        cls, path: Path | str, radius: float | None = None, *, require_final: bool = True
    ) -> "PushLog":
        """Reads a push log; `docs/howto/own_pushes.md` has the columns.

        Args:
            radius: of the pusher, m; DEFAULT_PUSHER_RADIUS where None, and `radius_given` says so.
            require_final: whether every push must have an observation after its first row.

        Raises:
            PushLogError: the file cannot be read or breaks the form; the message names the file,
                the line, the column and the expected form.
            PushError: the radius is not positive.

        Warns:
            PushLogWarning: the file has further columns, which are passed over, or so many poses of
                a push that only some of them are kept.
        """
        return _read_push_csv(Path(path), radius, require_final)

    def write_csv(self, path: Path | str, force: bool = False) -> None:
        """Writes the log so that `read_csv` gives its numbers back bit for bit.

        Raises:
            PushLogError: two pushes have the same name, or there is no push.
            OutputError: the file exists and `force` is not set, or it cannot be written.
        """
        _write_push_csv(self, Path(path), force)

    def __repr__(self) -> str:
        """How many pushes and poses there are, how long and from where, in a line."""
        poses = count(sum(len(seen.t_observed) for seen in self), "pose")
        way = sum(seen.push.length for seen in self)
        source = f", from {self.source}" if self.source else ""
        return f"PushLog of {count(len(self), 'push')}: {poses}, {way:.3g} m of pushing{source}"

    def _repr_html_(self) -> str:
        """A row a push."""
        heads = ("push", "path, mm", "duration, s", "poses seen", "the object", "forces")
        rows = [
            (
                seen.name,
                f"{seen.push.length * MM:.0f}",
                f"{seen.push.duration:.3g}",
                len(seen.t_observed),
                describe_move(seen.pose, seen.final_pose) if len(seen.t_observed) else "not seen",
                "none" if seen.force_t is None else len(seen.force_t),
            )
            for seen in self
        ]
        return make_page(repr(self), make_table(heads, rows))

    def __len__(self) -> int:
        return len(self.pushes)

    def __iter__(self) -> Iterator[ObservedPush]:
        return iter(self.pushes)

    @overload
    def __getitem__(self, index: int) -> ObservedPush: ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[np.integer]) -> "PushLog": ...

    def __getitem__(
        self, index: int | slice | Sequence[int] | NDArray[np.integer]
    ) -> "ObservedPush | PushLog":
        if isinstance(index, slice):
            return replace(self, pushes=self.pushes[index])
        if isinstance(index, (int, np.integer)):
            return self.pushes[index]
        return self.subset(index)

    def subset(self, indices: Sequence[int] | NDArray[np.integer]) -> "PushLog":
        """Takes some of the pushes.

        Args:
            indices: their places, or a mask of booleans.

        Returns:
            A log of them, in the order of the indices.

        Raises:
            IndexError: an index is beyond the last push.
        """
        chosen = np.arange(len(self))[list(indices)]
        return replace(self, pushes=tuple(self.pushes[i] for i in chosen))

    @property
    def supported(self) -> "PushLog":
        """The pushes that a model can explain: all, where the table is known, else `on_table`."""
        return self if self.table is not None else self.on_table

    @property
    def on_table(self) -> "PushLog":
        """The pushes during which the whole object was on the table, for models that know no edge.

        The log has no table.

        Raises:
            PushLogError: there are pushes, but none of them is such a one.
        """
        kept = self.subset([i for i, seen in enumerate(self) if not seen.overhang])
        if len(self) and not len(kept):
            raise PushLogError(
                f"{self.source or 'push log'}: overhang is 1 in every push; expected the column "
                "table, or at least one push with the whole object on the table"
            )
        return replace(kept, table=None)

    @property
    def overhanging(self) -> "PushLog":
        """Takes the pushes that no model can explain: over the edge of an unknown table."""
        return self.subset(
            [i for i, seen in enumerate(self) if seen.overhang and self.table is None]
        )

    def with_radius(self, radius: float) -> "PushLog":
        """Gives all pushes a disc of another radius, m.

        Raises:
            PushError: the radius is not positive.
        """
        pushes = tuple(
            replace(seen, push=replace(seen.push, radius=radius)) for seen in self.pushes
        )
        return replace(self, pushes=pushes, radius_given=True)


def nearest_turn(theta: float, reference: float) -> float:
    """Adds whole turns to an angle so that it is within pi of another one.

    Args:
        theta: the angle, rad.
        reference: the other one, rad.

    Returns:
        The angle, rad; the very same number where it is near already.
    """
    turns = round((reference - theta) / math.tau)
    return theta + turns * math.tau if turns else theta


class _Row(NamedTuple):
    """A row of a file.

    Attributes:
        line: its number in the file.
        push: the push's name.
        t: time, s.
        tip: x and y of the tip's center, m.
        pose: x, y and theta of the object, m and rad; None where it was not seen.
        force: x and y of the force on the object, N; None where it is not known.
        overhang: whether the row says that the object hung over the table's edge.
        table: (K, 2) corners of the table's top, m; None where the row does not say.
    """

    line: int
    push: str
    t: float
    tip: list[float]
    pose: list[float] | None
    force: list[float] | None
    overhang: bool
    table: Array | None


def _read_push_csv(path: Path, radius: float | None, require_final: bool) -> PushLog:
    """Reads a file; see `PushLog.read_csv`."""
    seen: dict[str, int] = {}  # the line on which each push begins
    pushes = []
    table: Array | None = None
    read = (
        _parse_row(path, line, cells)
        for line, cells in read_table(path, WHAT, REQUIRED, _check_header)
    )
    dense: list[tuple[str, int]] = []  # pushes with too many poses, and how many
    for _, group in groupby(read, lambda row: row.push):
        # One row more than allowed shows that there are too many; no more are read.
        rows = list(islice(group, MAX_ROWS + 1))
        first = rows[0]
        if len(rows) > MAX_ROWS:
            fail(
                path, rows[-1].line, "push",
                f"push {first.push!r} has more than {MAX_ROWS} rows; expected one push: a stream "
                "of many is cut into pushes by `gridpush record`",
            )  # fmt: skip
        if first.push in seen:
            fail(
                path, first.line, "push",
                f"push {first.push!r} began on line {seen[first.push]} already; expected its rows "
                "together",
            )  # fmt: skip
        seen[first.push] = first.line
        for row in rows:
            if table is not None and row.table is not None and not np.array_equal(row.table, table):
                fail(
                    path, row.line, TABLE, "is another one than before; expected one table in a log"
                )
            table = table if row.table is None else row.table
        rows, poses = _thin_poses(rows)
        if poses > MAX_POSES:
            dense.append((first.push, poses))
        pushes.append(
            _observed_push(
                path, rows, DEFAULT_PUSHER_RADIUS if radius is None else radius, require_final
            )
        )
    if dense:
        name, poses = dense[0]
        more = f" (and {len(dense) - 1} more)" if len(dense) > 1 else ""
        warnings.warn(
            f"{path}: push {name!r}{more} has {poses} poses after its first row; {MAX_POSES} of "
            "them, evenly spread, are kept",
            PushLogWarning,
            stacklevel=3,
        )
    if not pushes:
        raise PushLogError(
            f"{path}: holds no push; expected rows below the header {','.join(REQUIRED)}"
        )
    return PushLog(tuple(pushes), str(path), radius_given=radius is not None, table=table)


def _thin_poses(rows: list[_Row]) -> tuple[list[_Row], int]:
    """Leaves out poses of a push that has many.

    Args:
        rows: the push's rows.

    Returns:
        The rows, with at most MAX_POSES poses after the first row's, and how many there were.
    """
    later = [i for i, row in enumerate(rows) if i and row.pose is not None]
    if len(later) <= MAX_POSES:
        return rows, len(later)
    evenly = np.linspace(0, len(later) - 1, MAX_POSES).round().astype(int)
    kept = {0, *(later[k] for k in evenly)}
    thinned = [row if i in kept else row._replace(pose=None) for i, row in enumerate(rows)]
    return thinned, len(later)


def _write_push_csv(log: PushLog, path: Path, force: bool) -> None:
    """Writes a file; see `PushLog.write_csv`."""
    check_writable(path, force)
    names = [seen.name for seen in log]
    if not names:
        raise PushLogError(f"{path}: the log to be written holds no push")
    for i, name in enumerate(names):
        if name in names[:i]:
            raise PushLogError(
                f"{path}: two pushes of the log are named {name!r}; expected one name a push"
            )
    with_force = any(seen.force is not None for seen in log)
    with_overhang = any(seen.overhang for seen in log)

    # Columns of which nothing is known are left out.
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    more = [
        name for name, there in ((OVERHANG, with_overhang), (TABLE, log.table is not None)) if there
    ]
    writer.writerow([*REQUIRED, *(FORCE if with_force else ()), *more])
    # The table stands in the first row, and nowhere else.
    text = [] if log.table is None else [_describe_table(log.table)]
    for seen in log:
        flag = [str(int(seen.overhang))] if with_overhang else []
        for cells in _cells(seen, with_force):
            writer.writerow([*cells, *flag, *text])
            text = [""] * len(text)
    write_whole(path, buffer.getvalue(), force)


def _describe_table(corners: Array) -> str:
    """Writes corners (K, 2), m, as well-known text, exact to the last bit."""
    closed = [*corners.tolist(), corners[0].tolist()]
    points = ", ".join(f"{x!r} {y!r}" for x, y in closed)
    return f"POLYGON (({points}))"


def _cells(seen: ObservedPush, with_force: bool) -> Iterator[list[str]]:
    """Makes the cells of each row of a push: a row for each time at which anything is known."""
    poses = dict(zip(seen.t_observed.tolist(), seen.poses_observed.tolist(), strict=True))
    poses[0.0] = seen.pose.tolist()
    forces: dict[float, list[float]] = {}
    if seen.force_t is not None and seen.force is not None:
        forces = dict(zip(seen.force_t.tolist(), seen.force.tolist(), strict=True))
    times = sorted({*seen.push.t.tolist(), *poses, *forces})
    for t, tip in zip(times, seen.push.tip_at(times).tolist(), strict=True):
        row = [seen.name, repr(t), *map(repr, tip), *map(repr, poses.get(t, []))]
        row += [""] * (len(REQUIRED) - len(row))
        if with_force:
            row += [repr(f) for f in forces[t]] if t in forces else [""] * len(FORCE)
        yield row


def read_table(
    path: Path,
    what: str,
    required: Sequence[str],
    check_header: Callable[[Path, int, list[str]], None],
) -> Iterator[tuple[int, dict[str, str]]]:
    """Reads a CSV file row by row.

    Args:
        path: the file.
        what: it should hold, for messages.
        required: the columns that it must have, for messages.
        check_header: is called with path, line and header before the first row.

    Yields:
        Each row's line in the file, and its cells by column.

    Raises:
        PushLogError: the file cannot be read, is empty or no CSV, or a row is longer or shorter
            than the header.
    """
    text = read_text(path, what, PushLogError)
    if "\0" in text:
        raise PushLogError(f"{path}: is not UTF-8 text (it holds a NUL); expected {what}")
    reader = csv.reader(io.StringIO(text, newline=""))
    header: list[str] = []
    try:
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if not header:
                header = [cell.strip() for cell in cells]
                check_header(path, reader.line_num, header)
            elif len(cells) != len(header):
                number = f"has {len(cells)} fields; the header has {len(header)}"
                raise PushLogError(f"{path}, line {reader.line_num}: {number}")
            else:
                yield reader.line_num, dict(zip(header, cells, strict=True))
    except csv.Error as error:
        raise PushLogError(f"{path}, line {reader.line_num}: is not CSV: {error}") from error
    if not header:
        raise PushLogError(f"{path}: is empty; expected the header {','.join(required)}")


def _check_header(path: Path, line: int, header: list[str]) -> None:
    """Refuses a header without a column that is needed, or with one twice or misspelled."""
    known = f"{','.join(FORCE)}, {OVERHANG} and {TABLE}"
    form = f"expected comma-separated {','.join(REQUIRED)} and, if known, {known}"
    twice = next((name for name in header if header.count(name) > 1), None)
    if twice is not None:
        fail(path, line, twice, f"is there twice; {form}")
    unknown = [name for name in header if name not in COLUMNS]
    objects = [name.removesuffix("_theta") for name in header if name.endswith("_theta")]
    if len(objects) > 1 and "object" not in objects:
        fail(
            path,
            line,
            "object_x",
            f"is missing: the columns are those of several objects, {', '.join(objects)}; expected "
            "a log of one. Several are learned together by gridpush identify --with",
        )
    for name in (name for name in REQUIRED if name not in header):
        close = [other for other in unknown if other.lower() == name]
        close = close or difflib.get_close_matches(name, unknown, 1, SUGGESTION_CUTOFF)
        hint = f"; rename {close[0]!r} to {name!r}?" if close else ""
        fail(path, line, name, f"is missing{hint}; {form}")
    missing = [name for name in FORCE if name not in header]
    refuse_misspelled(path, line, header, COLUMNS, form)
    if len(missing) == 1:
        fail(path, line, missing[0], f"is missing; the columns {' and '.join(FORCE)} come together")
    warn_of_further(path, header, COLUMNS)


def refuse_misspelled(
    path: Path, line: int, header: list[str], columns: Sequence[str], form: str
) -> None:
    """Refuses a further column that is all but called as one that is not there.

    Args:
        path: the file, for the message.
        line: of its header.
        header: the columns that it has.
        columns: those that it may have.
        form: what is expected, for the message.

    Raises:
        PushLogError: there is such a column.
    """
    absent = [name for name in columns if name not in header]
    for name in header:
        if name not in columns:
            close = difflib.get_close_matches(name.lower(), absent, 1, TYPO_CUTOFF)
            if close:
                fail(path, line, name, f"is unknown; did you mean {close[0]!r}? {form}")


def warn_of_further(path: Path, header: list[str], columns: Sequence[str]) -> None:
    """Says which further columns of a file are passed over, with a PushLogWarning."""
    further = [name for name in header if name not in columns]
    if further:
        shown = ", ".join(name[:MAX_SHOWN] or "(without a name)" for name in further[:MAX_NAMED])
        more = f" and {len(further) - MAX_NAMED} more" if len(further) > MAX_NAMED else ""
        noun = "columns" if len(further) > 1 else "column"
        warnings.warn(
            f"{path}: passed over the {noun} {shown}{more}; known are {','.join(columns)}",
            PushLogWarning,
            stacklevel=2,
        )


def is_empty(cell: str) -> bool:
    """Whether a cell holds nothing: blanks, or nan as pandas and NumPy write it."""
    text = cell.strip()
    return not text or text.lower() == NO_NUMBER


def _parse_row(path: Path, line: int, cells: dict[str, str]) -> _Row:
    """Reads a row's cells; a PushLogError names the column of one that cannot be read."""
    name = cells["push"].strip()
    if not name:
        fail(path, line, "push", "is empty; expected the push's name, on each of its rows")
    pose = _read_group(path, line, cells, POSE)
    force = _read_group(path, line, cells, FORCE)
    tip = [_read_number(path, line, column, cells[column]) for column in TIP]
    flag = cells.get(OVERHANG, "").strip()
    hangs_over = False if is_empty(flag) else FLAGS.get(flag)
    if hangs_over is None:
        fail(path, line, OVERHANG, f"is {flag[:MAX_SHOWN]!r}; expected 0 or 1, or empty")
    table = _table(path, line, cells.get(TABLE, "").strip())
    return _Row(
        line=line,
        push=name,
        t=_read_number(path, line, "t", cells["t"]),
        tip=tip,
        pose=pose,
        force=force,
        overhang=hangs_over,
        table=table,
    )


def _read_group(
    path: Path, line: int, cells: dict[str, str], columns: tuple[str, ...]
) -> list[float] | None:
    """Reads the numbers of columns that are empty together; None where they are."""
    if all(is_empty(cells.get(column, "")) for column in columns):
        return None
    return [_read_number(path, line, column, cells[column]) for column in columns]


def _table(path: Path, line: int, cell: str) -> Array | None:
    """Reads the corners (K, 2) of a table's top, counterclockwise, m; None of an empty cell."""
    if is_empty(cell):
        return None
    try:
        with np.errstate(invalid="ignore"):
            polygon = shapely.from_wkt(cell)
            usable = polygon.is_valid and 0 < polygon.area < np.inf
    except shapely.GEOSException:
        polygon = None
        usable = False
    if not isinstance(polygon, shapely.Polygon) or polygon.interiors or not usable:
        form = (
            "expected POLYGON ((x y, x y, ..., x y)) in m "
            "that ends where it begins and does not cross itself, no hole"
        )
        fail(path, line, TABLE, f"is {cell[:MAX_SHOWN]!r}; {form}")
    return np.asarray(orient(polygon).exterior.coords)[:-1, :2]


def _read_number(path: Path, line: int, column: str, cell: str) -> float:
    """Reads a cell's number; a message tells its unit, and which columns may be empty together."""
    value = parse_number(cell)
    if value is None:
        group = next((columns for columns in (POSE, FORCE) if column in columns), None)
        form = f"a finite number ({UNITS.get(column, 'm')})" + (
            f", or {', '.join(group)} empty" if group else ""
        )
        value = read_number(path, line, column, cell, form)
    return value


def parse_number(cell: str) -> float | None:
    """Reads a cell's number; None where it is not one that was measured."""
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if abs(value) <= MAX_NUMBER and "_" not in cell else None


def read_number(path: Path, line: int, column: str, cell: str, form: str) -> float:
    """Reads a cell's number.

    Args:
        path: the file, for the message.
        line: the row's line, for the message.
        column: the column, for the message.
        cell: the cell's text.
        form: what is expected, for the message.

    Returns:
        The number.

    Raises:
        PushLogError: it is not a number that was measured.
    """
    value = parse_number(cell)
    if value is None:
        large = False
        with suppress(ValueError):
            large = MAX_NUMBER < abs(float(cell)) < math.inf
        limit = f", at most {MAX_NUMBER:g}" if large else ""
        fail(path, line, column, f"is {cell.strip()[:MAX_SHOWN]!r}; expected {form}{limit}")
    return value


def _observed_push(
    path: Path, rows: list[_Row], radius: float, require_final: bool
) -> ObservedPush:
    """Makes a push of its rows; a PushLogError names the line and the column of a wrong one."""
    first = rows[0]
    if first.pose is None:
        fail(
            path,
            first.line,
            POSE[0],
            f"is empty; expected a pose on push {first.push!r}'s first row",
        )
    if len(rows) == 1:
        fail(path, first.line, "push", f"push {first.push!r} has one row; expected at least two")
    for before, row in pairwise(rows):
        if row.t - before.t < MIN_TIME_STEP:
            fail(
                path,
                row.line,
                "t",
                f"is {row.t!r} after {before.t!r}; expected times (s) that increase",
            )
    seen = [row for row in rows[1:] if row.pose is not None]
    if require_final and not seen:
        fail(
            path, rows[-1].line, POSE[0],
            f"is empty; expected the object's pose on a later row of push {first.push!r} too",
        )  # fmt: skip
    # Angles go on from pose to pose, though a tracker may jump by whole turns.
    poses = [list(row.pose or ()) for row in [first, *seen]]
    for pose_before, pose in pairwise(poses):
        pose[2] = nearest_turn(pose[2], pose_before[2])
    felt = [row for row in rows if row.force is not None]
    return ObservedPush(
        name=first.push,
        push=Push.along([row.t for row in rows], [row.tip for row in rows], radius),
        pose=np.array(poses[0]),
        t_observed=np.array([row.t - first.t for row in seen]),
        poses_observed=np.array(poses[1:]).reshape(-1, len(POSE)),
        force_t=np.array([row.t - first.t for row in felt]) if felt else None,
        force=np.array([row.force for row in felt]) if felt else None,
        overhang=any(row.overhang for row in rows),
    )


def fail(path: Path, line: int, column: str, what: str) -> NoReturn:
    """Raises a PushLogError that names file, line and column."""
    raise PushLogError(f"{path}, line {line}, column {column[:MAX_SHOWN]}: {what}")

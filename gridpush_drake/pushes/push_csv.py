"""The file of a push log: its columns, how it is read, and how it is written.

A push log is one tidy CSV file: a row a sample. Its columns: push (any text, rows of one push
together), t, tip_x, tip_y (the disc's center), object_x, object_y, object_theta (on a push's first
row, and wherever else it was observed; empty elsewhere) and, where they are known, force_x, force_y
on the object, force_z on it, upwards, where those two are, overhang: 1 while a part of the object
hung over the table's edge, 0 or empty otherwise (one such row marks the push), and table: its top
in W as well-known text, POLYGON ((x y, x y, ...)), once in the file. A push by another shape than a
disc has tip_yaw, the angle of the pusher's frame, on every row, and pusher on its first: all places
within a radius of MULTIPOINT ((x y), ...), the centers of discs, or of POLYGON ((x y, ...)) or
LINESTRING (x y, x y), in the pusher's frame, such as MULTIPOINT ((0 -0.02), (0 0.02)) RADIUS 0.003;
tip_x, tip_y are then the origin of that frame. Times are counted from each
push's first row. A cell that holds nan counts as empty, and further columns are passed over with a
warning.

A log of several objects, or of one with a name, has three columns for each instead of object_x,
object_y and object_theta: NAME_x, NAME_y and NAME_theta, filled or empty together.

Users read and write by `PushLog.read_csv` and `PushLog.write_csv`.
"""

import csv
import difflib
import io
import warnings
from collections.abc import Iterator, Sequence
from itertools import groupby, islice, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry.polygon import orient

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape, choose_pusher_radius
from gridpush_drake.errors import PushError, PushLogError, PushLogWarning
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.csv_table import (
    MAX_SHOWN,
    SUGGESTION_CUTOFF,
    fail,
    is_empty,
    parse_number,
    read_number,
    read_table,
    refuse_misspelled,
    warn_of_further,
)
from gridpush_drake.pushes.observed_push import ObservedPush, nearest_turn

PUSHES_FILE = "pushes.csv"
"""Name of a push log in a folder with its object's file, as runs and imports write it."""

TIP_COLUMNS = ("tip_x", "tip_y")
"""Columns of the tip's center."""

OBJECT = "object"
"""What the columns of the pose of an object without a name begin with."""

AXES = ("x", "y", "theta")
"""What the three columns of a pose end with."""


def list_pose_columns(names: Sequence[str]) -> tuple[str, ...]:
    """Lists the columns of the poses of objects, by their names."""
    return tuple(f"{name}_{axis}" for name in names for axis in AXES)


POSE_COLUMNS = list_pose_columns([OBJECT])
"""Columns of the pose of an object without a name."""

FORCE_COLUMNS = ("force_x", "force_y")
"""Columns of the force on the object."""

LIFT_FORCE = "force_z"
"""Column of its upward part. A push has it in all rows that have the others, or in none."""

PATH = ("push", "t", *TIP_COLUMNS)
"""Columns that every file has, besides those of poses."""

REQUIRED_COLUMNS = (*PATH, *POSE_COLUMNS)
"""Columns that the file of an object without a name has."""

OVERHANG_COLUMN = "overhang"
"""Column that says whether a part of the object hung over the table's edge."""

TABLE_COLUMN = "table"
"""Column of the table's top."""

YAW_COLUMN = "tip_yaw"
"""Column of the angle of the pusher's frame."""

PUSHER_COLUMN = "pusher"
"""Column of the pusher's shape."""

SHAPE_FORM = "MULTIPOINT ((x y), ...), POLYGON ((x y, ...)) or LINESTRING (x y, x y), then RADIUS r"
"""Expected form of a pusher's shape, for messages."""

SHAPE_RADIUS = "RADIUS"
"""Word before the radius in it."""

PUSHER_HELP = (
    "plate:WxTxR (width, thickness, radius of the corners; also a closed gripper), "
    "discs:R@x,y;x,y (radius, then the centers; such as two fingertips), or as in the column "
    f"{PUSHER_COLUMN} of a push log, all in m. Its x axis points where it pushes."
)
"""The forms of a pusher's shape that a user types, for help texts."""

KNOWN = (*FORCE_COLUMNS, LIFT_FORCE, OVERHANG_COLUMN, TABLE_COLUMN, YAW_COLUMN, PUSHER_COLUMN)
"""Columns of what may be known besides."""

PUSH_COLUMNS = (*REQUIRED_COLUMNS, *KNOWN)
"""All columns that are read of an object without a name."""

FLAG_TEXTS = {"0": False, "1": True, "0.0": False, "1.0": True}
"""Texts that say no or yes in a column; pandas writes numbers of such a column with points."""

EXPECTED_LOG = "a push log (CSV)"
"""The expected form of a file, for messages."""

COLUMN_UNITS = {"t": "s", "force_x": "N", "force_y": "N", LIFT_FORCE: "N", YAW_COLUMN: "rad"}
"""Unit of each column; m where not listed, but rad of angles."""

MAX_ROWS = 50_000
"""Most rows of one push: 50 s of a robot that writes a thousand a second."""

MAX_POSES = 300
"""Most poses of one push that are kept after the first; of more, this many evenly spread ones. The
work of learning grows with their square, and neighbors tell nearly the same."""

MIN_TIME_STEP = 1e-9
"""S between two rows of a push."""


class _Row(NamedTuple):
    """A row of a file.

    Attributes:
        line: its number in the file.
        push: the push's name.
        t: time, s.
        tip: x and y of the tip's center, m.
        pose: x, y and theta of each object, m and rad; None where they were not seen.
        force: x and y of the force on the object, N; None where it is not known.
        lift_force: its upward part, N; None where it is not known.
        overhang: whether the row says that the object hung over the table's edge.
        table: (K, 2) corners of the table's top, m; None where the row does not say.
        yaw: angle of the pusher's frame, rad; None of a disc.
        shape: the pusher's; None of a disc, and on rows after a push's first.
    """

    line: int
    push: str
    t: float
    tip: list[float]
    pose: list[float] | None
    force: list[float] | None
    lift_force: float | None
    overhang: bool
    table: Array | None
    yaw: float | None
    shape: PusherShape | None


def read_pushes(
    path: Path, radius: float, require_final: bool
) -> tuple[tuple[ObservedPush, ...], Array | None, tuple[str, ...]]:
    """Reads a push log's file.

    Args:
        path: the file.
        radius: of the pusher, m.
        require_final: whether every push must have an observation after its first row.

    Returns:
        The pushes; the corners (K, 2) of the table's top, counterclockwise, m, None where the file
        does not tell them; and the objects' names.

    Raises:
        PushLogError: the file cannot be read or breaks the form; the message names the file, the
            line, the column and the expected form.
        PushError: the radius is not positive.

    Warns:
        PushLogWarning: see `PushLog.read_csv`.
    """
    begun: dict[str, int] = {}  # the line on which each push begins
    pushes = []
    table: Array | None = None
    dense: list[tuple[str, int]] = []  # pushes with too many poses, and how many
    names: list[str] = []

    def check_header(path: Path, line: int, header: list[str]) -> None:
        names.extend(_find_names(header))
        _check_header(path, line, header, names)

    read = (
        _parse_row(path, line, cells, list_pose_columns(names))
        for line, cells in read_table(path, EXPECTED_LOG, REQUIRED_COLUMNS, check_header)
    )
    for _, group in groupby(read, lambda row: row.push):
        # One row more than allowed shows that there are too many; no more are read.
        rows = list(islice(group, MAX_ROWS + 1))
        _check_rows(path, rows, begun)
        begun[rows[0].push] = rows[0].line
        table = _find_table(path, rows, table)
        rows, poses = _thin_poses(rows)
        if poses > MAX_POSES:
            dense.append((rows[0].push, poses))
        pushes.append(_make_push(path, rows, radius, require_final, names))
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
            f"{path}: holds no push; expected rows below the header {','.join(REQUIRED_COLUMNS)}"
        )
    return tuple(pushes), table, tuple(names)


def _check_rows(path: Path, rows: list[_Row], begun: dict[str, int]) -> None:
    """Refuses a push with too many rows, and one whose rows do not stand together.

    Args:
        path: the file, for the message.
        rows: rows that follow each other and name the same push.
        begun: the line on which each push before began.

    Raises:
        PushLogError: it is such a push.
    """
    first = rows[0]
    if len(rows) > MAX_ROWS:
        fail(
            path,
            rows[-1].line,
            "push",
            f"push {first.push!r} has more than {MAX_ROWS} rows; expected one push: a stream of "
            "many is cut into pushes by `gridpush record`",
        )
    if first.push in begun:
        fail(
            path,
            first.line,
            "push",
            f"push {first.push!r} began on line {begun[first.push]} already; expected its rows "
            "together",
        )


def _find_table(path: Path, rows: list[_Row], table: Array | None) -> Array | None:
    """Finds the table's top in a push's rows.

    Args:
        path: the file, for the message.
        rows: the push's rows.
        table: (K, 2) the corners that rows before gave, m, or None.

    Returns:
        The corners (K, 2), m; None where no row has given them yet.

    Raises:
        PushLogError: rows give different tables.
    """
    for row in rows:
        if row.table is None:
            continue
        if table is not None and not np.array_equal(row.table, table):
            fail(
                path,
                row.line,
                TABLE_COLUMN,
                "is another one than before; expected one table in a log",
            )
        table = row.table
    return table


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


def _find_names(header: list[str]) -> list[str]:
    """Finds the objects of which a header has columns; "object" where there are none of others."""
    ending = f"_{AXES[-1]}"
    names = [column.removesuffix(ending) for column in header if column.endswith(ending)]
    whole = [name for name in names if set(list_pose_columns([name])) <= set(header)]
    return names if len(names) > 1 or whole else [OBJECT]


def _check_header(path: Path, line: int, header: list[str], names: list[str]) -> None:
    """Refuses a header without a column that is needed, or with one twice or misspelled."""
    required = (*PATH, *list_pose_columns(names))
    further = f"{','.join(FORCE_COLUMNS)}, {LIFT_FORCE}, {OVERHANG_COLUMN} and {TABLE_COLUMN}"
    form = f"expected comma-separated {','.join(required)} and, if known, {further}"
    twice = next((name for name in header if header.count(name) > 1), None)
    if twice is not None:
        fail(path, line, twice, f"is there twice; {form}")
    unknown = [name for name in header if name not in (*required, *KNOWN)]
    for name in (name for name in required if name not in header):
        close = [other for other in unknown if other.lower() == name]
        close = close or difflib.get_close_matches(name, unknown, 1, SUGGESTION_CUTOFF)
        hint = f"; rename {close[0]!r} to {name!r}?" if close else ""
        fail(path, line, name, f"is missing{hint}; {form}")
    missing = [name for name in FORCE_COLUMNS if name not in header]
    # The upward force alone tells nothing.
    used = (*required, *(name for name in KNOWN if not (missing and name == LIFT_FORCE)))
    refuse_misspelled(path, line, header, used, form)
    if len(missing) == 1:
        fail(
            path,
            line,
            missing[0],
            f"is missing; the columns {' and '.join(FORCE_COLUMNS)} come together",
        )
    warn_of_further(path, header, used)


def _parse_row(path: Path, line: int, cells: dict[str, str], pose_columns: tuple[str, ...]) -> _Row:
    """Reads a row's cells; a PushLogError names the column of one that cannot be read."""
    name = cells["push"].strip()
    if not name:
        fail(path, line, "push", "is empty; expected the push's name, on each of its rows")
    pose = _read_group(path, line, cells, pose_columns)
    force = _read_group(path, line, cells, FORCE_COLUMNS)
    upward = _read_group(path, line, cells, (LIFT_FORCE,)) if FORCE_COLUMNS[0] in cells else None
    if upward is not None and force is None:
        fail(
            path,
            line,
            LIFT_FORCE,
            f"is {upward[0]:g}, but {' and '.join(FORCE_COLUMNS)} are empty; expected all or none",
        )
    tip = [_read_number(path, line, column, cells[column]) for column in TIP_COLUMNS]
    flag = cells.get(OVERHANG_COLUMN, "").strip()
    hangs_over = False if is_empty(flag) else FLAG_TEXTS.get(flag)
    if hangs_over is None:
        fail(path, line, OVERHANG_COLUMN, f"is {flag[:MAX_SHOWN]!r}; expected 0 or 1, or empty")
    table = _read_table_top(path, line, cells.get(TABLE_COLUMN, "").strip())
    yaw = _read_group(path, line, cells, (YAW_COLUMN,))
    return _Row(
        line=line,
        push=name,
        t=_read_number(path, line, "t", cells["t"]),
        tip=tip,
        pose=pose,
        force=force,
        lift_force=None if upward is None else upward[0],
        overhang=hangs_over,
        table=table,
        yaw=None if yaw is None else yaw[0],
        shape=read_shape(path, line, cells.get(PUSHER_COLUMN, "").strip()),
    )


def _read_group(
    path: Path, line: int, cells: dict[str, str], columns: tuple[str, ...]
) -> list[float] | None:
    """Reads the numbers of columns that are empty together; None where they are."""
    if all(is_empty(cells.get(column, "")) for column in columns):
        return None
    return [_read_number(path, line, column, cells[column], columns) for column in columns]


def _read_table_top(path: Path, line: int, cell: str) -> Array | None:
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
        fail(path, line, TABLE_COLUMN, f"is {cell[:MAX_SHOWN]!r}; {form}")
    return np.asarray(orient(polygon).exterior.coords)[:-1, :2]


def read_shape(path: Path, line: int, cell: str) -> PusherShape | None:
    """Reads a pusher's shape; None of an empty cell."""
    if is_empty(cell):
        return None
    try:
        return _parse_core(cell)
    except ValueError:
        fail(path, line, PUSHER_COLUMN, f"is {cell[:MAX_SHOWN]!r}; expected {SHAPE_FORM} (m)")
    except PushError as error:
        fail(path, line, PUSHER_COLUMN, str(error))


def choose_pusher(option: str, text: str | None, obj: GridObject) -> float | PusherShape:
    """Chooses what pushed an object: the shape that a user types, or a disc of a radius, m.

    Args:
        option: the option's name, for the error's message.
        text: the shape; None of a disc, of the radius in the object's file or the usual one.
        obj: the object.

    Raises:
        PushLogError: the text is of no form that is known, or makes no shape.
    """
    return choose_pusher_radius(obj) if text is None else parse_pusher(option, text)


def parse_pusher(option: str, text: str) -> PusherShape:
    """Reads a pusher's shape as a user types it.

    Args:
        option: the option's name, for the error's message.
        text: `plate:0.06x0.02x0.003` (width, thickness, radius of the corners),
            `discs:0.004@0,-0.02;0,0.02` (radius, then the centers), or the form of a push log, m.

    Raises:
        PushLogError: the text is of no such form, or makes no shape.
    """
    kind, _, rest = text.partition(":")
    try:
        if kind == "plate":
            width, thickness, radius = map(float, rest.split("x"))
            return PusherShape.plate(width, thickness, radius)
        if kind == "discs":
            size, _, places = rest.partition("@")
            centers = [[float(each) for each in place.split(",")] for place in places.split(";")]
            return PusherShape.discs(centers, float(size))
        return _parse_core(text)
    except ValueError:
        raise PushLogError(
            f"{option}: is {text[:MAX_SHOWN]!r}; expected plate:WxTxR, discs:R@x,y;x,y or "
            f"{SHAPE_FORM} (m)"
        ) from None
    except PushError as error:
        raise PushLogError(f"{option}: {error}") from error


def _parse_core(text: str) -> PusherShape:
    """Reads a pusher's shape as a push log has it; raises ValueError where it has another form."""
    core, found, radius = text.partition(SHAPE_RADIUS)
    size = parse_number(radius.strip())
    try:
        geometry = shapely.from_wkt(core.strip())
    except shapely.GEOSException:
        geometry = None
    known = (shapely.MultiPoint, shapely.Point, shapely.LineString, shapely.Polygon)
    if not found or size is None or not isinstance(geometry, known) or geometry.is_empty:
        raise ValueError
    # a ring ends where it begins
    places = shapely.get_coordinates(geometry)
    if isinstance(geometry, shapely.Polygon):
        places = places[:-1]
    joined = not isinstance(geometry, (shapely.MultiPoint, shapely.Point))
    return PusherShape(places, size, joined)


def _make_path(path: Path, rows: list[_Row], radius: float) -> Push:
    """Makes the motion of the pusher of a push's rows: of a disc of a radius, or of a shape."""
    first = rows[0]
    # a shape on the first row, and its angle on all
    t = [row.t for row in rows]
    tip = [row.tip for row in rows]
    for row in rows:
        if (row.yaw is None) != (first.shape is None):
            turned = "is empty; expected an angle (rad)"
            still = f"is given, but no {PUSHER_COLUMN} on the first row; expected both or none"
            problem = turned if row.yaw is None else still
            fail(path, row.line, YAW_COLUMN, f"of push {first.push!r} {problem}")
        if row.shape is not None and row is not first:
            fail(path, row.line, PUSHER_COLUMN, f"is not on the first row of push {first.push!r}")
    if first.shape is None:
        return Push.along(t, tip, radius)
    yaw = np.unwrap([row.yaw or 0.0 for row in rows])
    return Push.along(t, tip, shape=first.shape, yaw=yaw)


def _read_number(
    path: Path, line: int, column: str, cell: str, together: tuple[str, ...] = ()
) -> float:
    """Reads a cell's number; a message tells its unit, and which columns may be empty together."""
    value = parse_number(cell)
    if value is None:
        unit = COLUMN_UNITS.get(column, "rad" if column.endswith(f"_{AXES[-1]}") else "m")
        form = f"a finite number ({unit})"
        if together:
            form += f", or {', '.join(together)} empty"
        value = read_number(path, line, column, cell, form)
    return value


def _make_push(
    path: Path, rows: list[_Row], radius: float, require_final: bool, names: Sequence[str]
) -> ObservedPush:
    """Makes a push of its rows; a PushLogError names the line and the column of a wrong one."""
    first = rows[0]
    columns = list_pose_columns(names)
    if first.pose is None:
        fail(
            path,
            first.line,
            columns[0],
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
            path,
            rows[-1].line,
            columns[0],
            f"is empty; expected the object's pose on a later row of push {first.push!r} too",
        )
    # Angles go on from pose to pose, though a tracker may jump by whole turns.
    poses = [list(row.pose or ()) for row in [first, *seen]]
    for pose_before, pose in pairwise(poses):
        for turn in range(2, len(columns), 3):
            pose[turn] = nearest_turn(pose[turn], pose_before[turn])
    felt = [row for row in rows if row.force is not None]
    upward = [row for row in felt if row.lift_force is not None]
    if upward and len(upward) < len(felt):
        lacking = next(row for row in felt if row.lift_force is None)
        fail(
            path,
            lacking.line,
            LIFT_FORCE,
            f"is empty; expected a number (N) in all rows of push {first.push!r} that have "
            f"{' and '.join(FORCE_COLUMNS)}, or in none",
        )
    shape = (3,) if len(names) == 1 else (len(names), 3)
    return ObservedPush(
        name=first.push,
        push=_make_path(path, rows, radius),
        pose=np.reshape(poses[0], shape),
        t_observed=np.array([row.t - first.t for row in seen]),
        poses_observed=np.array(poses[1:]).reshape(-1, *shape),
        force_t=np.array([row.t - first.t for row in felt]) if felt else None,
        force=np.array([row.force for row in felt]) if felt else None,
        overhang=any(row.overhang for row in rows),
        lift_force=np.array([row.lift_force for row in upward]) if upward else None,
    )


def write_pushes(
    path: Path,
    pushes: Sequence[ObservedPush],
    table: Array | None,
    names: Sequence[str],
    force: bool,
) -> None:
    """Writes a push log's file so that `read_pushes` gives its numbers back bit for bit.

    Args:
        path: the file.
        pushes: the pushes; at least one, each with a name of its own.
        table: (K, 2) corners in W of the table's top, m; None where they are not known.
        names: what the objects are called.
        force: whether a file that exists is replaced.

    Raises:
        PushLogError: two pushes have the same name, or there is no push.
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    check_writable(path, force)
    given = [seen.name for seen in pushes]
    if not given:
        raise PushLogError(f"{path}: the log to be written holds no push")
    for i, name in enumerate(given):
        if name in given[:i]:
            raise PushLogError(
                f"{path}: two pushes of the log are named {name!r}; expected one name a push"
            )
    forces: tuple[str, ...] = ()
    if any(seen.force is not None for seen in pushes):
        forces = FORCE_COLUMNS
    if any(seen.lift_force is not None for seen in pushes):
        forces = (*FORCE_COLUMNS, LIFT_FORCE)
    with_overhang = any(seen.overhang for seen in pushes)
    shaped = any(seen.push.shape is not None for seen in pushes)

    # Columns of which nothing is known are left out.
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    more = [
        name
        for name, there in (
            (OVERHANG_COLUMN, with_overhang),
            (TABLE_COLUMN, table is not None),
            (YAW_COLUMN, shaped),
            (PUSHER_COLUMN, shaped),
        )
        if there
    ]
    writer.writerow([*PATH, *list_pose_columns(names), *forces, *more])
    # The table stands in the first row, and nowhere else.
    text = [] if table is None else [_describe_table(table)]
    for seen in pushes:
        flag = [str(int(seen.overhang))] if with_overhang else []
        shape = [describe_shape(seen.push.shape)] if shaped else []
        for t, cells in _make_rows(seen, len(forces)):
            yaw = [] if not shaped else [""]
            if seen.push.shape is not None:
                yaw = [repr(float(seen.push.yaw_at(t)))]
            writer.writerow([*cells, *flag, *text, *yaw, *shape])
            text = [""] * len(text)
            shape = [""] * len(shape)
    write_whole(path, buffer.getvalue(), force)


def _describe_table(corners: Array) -> str:
    """Writes corners (K, 2), m, as well-known text, exact to the last bit."""
    closed = [*corners.tolist(), corners[0].tolist()]
    points = ", ".join(f"{x!r} {y!r}" for x, y in closed)
    return f"POLYGON (({points}))"


def describe_shape(shape: PusherShape | None) -> str:
    """Writes a pusher's shape as `read_shape` reads it, exact to the last bit; "" of a disc."""
    if shape is None:
        return ""
    places = [f"{x!r} {y!r}" for x, y in shape.core.tolist()]
    if not shape.joined:
        core = f"MULTIPOINT ({', '.join(f'({place})' for place in places)})"
    elif len(places) > 2:
        core = f"POLYGON (({', '.join([*places, places[0]])}))"
    else:
        core = f"LINESTRING ({', '.join(places)})"
    return f"{core} {SHAPE_RADIUS} {shape.radius!r}"


def describe_pusher(push: Push) -> dict[str, str | float]:
    """Describes what pushes, and how it is turned, where it is no disc: `pusher`, `yaw` (rad)."""
    if push.shape is None:
        return {}
    return {"pusher": describe_shape(push.shape), "yaw": float(push.yaw_at([0.0])[0])}


def _make_rows(seen: ObservedPush, columns: int) -> Iterator[tuple[float, list[str]]]:
    """Makes the rows of a push, time and cells: one for each time at which anything is known.

    Args:
        seen: the push.
        columns: number of the file's columns of forces: 0, 2, or 3 with the upward force.
    """
    rows = seen.poses_observed.reshape(len(seen.t_observed), seen.pose.size)
    poses = dict(zip(seen.t_observed.tolist(), rows.tolist(), strict=True))
    poses[0.0] = seen.pose.ravel().tolist()
    required = len(PATH) + seen.pose.size
    forces: dict[float, list[float]] = {}
    if seen.force_t is not None and seen.force is not None:
        felt = seen.force
        if seen.lift_force is not None:
            felt = np.column_stack([felt, seen.lift_force])
        forces = dict(zip(seen.force_t.tolist(), felt.tolist(), strict=True))
    times = sorted({*seen.push.t.tolist(), *poses, *forces})
    for t, tip in zip(times, seen.push.tip_at(times).tolist(), strict=True):
        row = [seen.name, repr(t), *map(repr, tip), *map(repr, poses.get(t, []))]
        row += [""] * (required - len(row))
        row += map(repr, forces.get(t, []))
        yield t, row + [""] * (required + columns - len(row))

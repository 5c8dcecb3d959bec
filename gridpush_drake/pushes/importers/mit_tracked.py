"""Importer of the MIT push data set as its authors publish it: whole tracks, a file a push.

(Yu, Bauza, Fazeli, Rodriguez, "More than a million ways to be pushed", IROS 2016.) A file is HDF5
or JSON and holds three tables, each row with a time by the clock of its own sensor:

    tip_pose     t (s), x, y (m), yaw (rad)          of the pusher's tip
    object_pose  t (s), x, y (m), yaw (rad)          of the object
    ft_wrench    t (s), fx, fy (N), torque (N m)     at the tip; may be missing

The file's name says what was done, `motion_surface=S_shape=H_a=A_v=V_i=I_s=S_t=T`: the surface, the
object's shape, the tip's acceleration and speed, and where and from what side it pushes. Of these
only the shape is read; everything else is in the tables.

Two things in these files need care. Their clocks differ: how late the object's poses are is found
from all pushes of a folder together, and said. And the object's last pose often comes 0.1 s before
the tip's end. What was not seen does not count: such a push is known up to its last pose only, and
no rest pose is made up for it.
"""

import json
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.errors import MAX_NUMBER, PushLogError, PushLogWarning
from gridpush_drake.extras import import_extra
from gridpush_drake.files import read_bytes, read_text
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers.mit import OBJECT_OPTION, TIP_RADIUS, make_mit_object
from gridpush_drake.pushes.importers.two_clocks import (
    Tracks,
    add_force,
    make_episode,
    warn_of_delay,
)
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.pose_delay import choose_episodes_delay
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import (
    UNUSABLE_ERRORS,
    RecordOptions,
    TipMotion,
    find_begin,
    make_observed_push,
)
from gridpush_drake.units import BYTES_PER_MEGABYTE

TIP_TABLE = "tip_pose"
"""Name of the table of the tip's poses."""

OBJECT_TABLE = "object_pose"
"""Name of the table of the object's poses."""

WRENCH_TABLE = "ft_wrench"
"""Name of the table of the forces."""

TABLE_COLUMNS = {
    TIP_TABLE: "t (s), x, y (m), yaw (rad)",
    OBJECT_TABLE: "t (s), x, y (m), yaw (rad)",
    WRENCH_TABLE: "t (s), fx, fy (N), torque (N m)",
}
"""What the four columns of each table are."""

FILE_SUFFIXES = (".h5", ".hdf5", ".json")
"""How the names of such files end."""

EXPECTED_MIT = "pushes of the MIT push data set (HDF5 or JSON)"

MAX_SIZE = 16 * BYTES_PER_MEGABYTE
"""Largest file, bytes; those of the data set have less than one megabyte."""

MAX_ROWS = 50_000
"""Most rows of one table: 200 s at 250 Hz."""

MAX_FILES = 10_000
"""Most files of a folder that are read."""

MIN_ROWS = 2
"""Fewest rows of a track that can be followed."""


@dataclass(frozen=True)
class MitTrackedImporter:
    """Convert tracked pushes of the MIT push data set (HDF5 or JSON, a file or a folder of them).

    Without `shape` and `obj` the object is the one that the file's name says, `shape=NAME`.
    """

    file: ClassVar[str] = "FILE.h5|FILE.json|DIR"
    source: ClassVar[str] = "a file of the MIT push data set with tracks, or a folder of such files"

    shape: str | None = field(
        default=None,
        metadata={
            "help": "The name of the shape that was pushed, such as rect1. If it is not given, the "
            "names of the files tell."
        },
    )
    obj: GridObject | None = field(
        default=None,
        metadata=OBJECT_OPTION,
    )
    object_delay: float | None = field(
        default=None,
        metadata={
            "help": "How much later the times of the object's poses are than those of the tip's, "
            "s. If it is not given, it is found from the pushes."
        },
    )

    def read(self, path: Path | str) -> tuple[PushLog, GridObject]:
        """Reads the pushes of a file, or of all such files of a folder, and the object.

        Raises:
            PushLogError: a file cannot be read, lacks a table or holds something else in it; the
                files are of different shapes, the shape is not known; or no push touches the
                object.
            MissingExtraError: a file is HDF5, and h5py is not installed.

        Warns:
            PushLogWarning: files hold no push; the object's times are late, and that was taken out;
                or the forces are those on the tip, and were turned round.
        """
        path = Path(path)
        paths = _list_files(path)
        obj = self.obj or make_mit_object(path, self.shape or _read_shape(path, paths))

        episodes: list[tuple[Path, TipMotion, dict[str, Array]]] = []
        options = RecordOptions()
        for one in paths:
            tables = _read_tables(one)
            tracks = Tracks(
                tip_t=tables[TIP_TABLE][:, 0],
                tip=tables[TIP_TABLE][:, 1:3],
                object_t=tables[OBJECT_TABLE][:, 0],
                poses=tables[OBJECT_TABLE][:, 1:],
            )
            episode = make_episode(tracks, options)
            if episode is not None:
                episodes.append((one, episode, tables))

        delay = choose_episodes_delay(
            [episode for _, episode, _ in episodes],
            obj,
            options,
            given=self.object_delay,
            given_by="--object-delay",
        )
        warn_of_delay(path, delay)
        options = replace(options, pose_delay=delay.value)
        pushes = [
            seen
            for one, episode, tables in episodes
            if (seen := _write_down(one, episode, tables, obj, options)) is not None
        ]
        if not pushes:
            raise PushLogError(
                f"{path}: no push touches {obj.name}; expected {EXPECTED_MIT} of this object"
            )
        if len(pushes) < len(paths):
            warn(
                f"{path}: {len(paths) - len(pushes)} of {len(paths)} files hold no push of the "
                "object, and are left out",
                PushLogWarning,
                stacklevel=2,
            )
        return PushLog(tuple(_orient_forces(path, pushes)), str(path)), obj


def _list_files(path: Path) -> list[Path]:
    """The file itself, or the folder's files of a known ending by their names.

    Raises:
        PushLogError: the folder holds no such file or too many.
    """
    if not path.is_dir():
        return [path]
    paths = sorted(one for one in path.iterdir() if one.suffix.lower() in FILE_SUFFIXES)
    if not 1 <= len(paths) <= MAX_FILES:
        raise PushLogError(
            f"{path}: holds {len(paths)} files that end in {', '.join(FILE_SUFFIXES)}; "
            f"expected 1 to {MAX_FILES} of {EXPECTED_MIT}"
        )
    return paths


def _read_shape(path: Path, paths: list[Path]) -> str:
    """The one shape that the files' names say.

    Raises:
        PushLogError: a name says no shape, or two say different ones.
    """
    shapes = set()
    for one in paths:
        said = [word.partition("=")[2] for word in one.stem.split("_") if word.startswith("shape=")]
        if len(said) != 1:
            raise PushLogError(
                f"{one}: its name does not say the shape; expected shape=NAME in it, or --shape "
                "or --object"
            )
        shapes.add(said[0])
    if len(shapes) > 1:
        raise PushLogError(
            f"{path}: holds pushes of {' and '.join(sorted(shapes))}; expected one shape, or "
            "--object"
        )
    return shapes.pop()


def _read_tables(path: Path) -> dict[str, Array]:
    """Reads the tables (K, 4) of a file, times increasing; ft_wrench only where it is there."""
    raw = _read_json(path) if path.suffix.lower() == ".json" else _read_hdf5(path)
    tables = {}
    for name, form in TABLE_COLUMNS.items():
        if name not in raw:
            if name == WRENCH_TABLE:
                continue
            there = ", ".join(sorted(raw)) or "nothing"
            raise PushLogError(f"{path}: has no {name}; it holds {there}")
        tables[name] = _check_table(path, name, form, raw[name])
    return tables


def _read_json(path: Path) -> dict[str, Any]:
    text = read_text(path, EXPECTED_MIT, PushLogError, MAX_SIZE)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PushLogError(
            f"{path}: cannot be read as JSON: {error}; expected {EXPECTED_MIT}"
        ) from error
    if not isinstance(content, dict):
        raise PushLogError(
            f"{path}: is no JSON object; expected one with {', '.join(TABLE_COLUMNS)}"
        )
    return content


def _read_hdf5(path: Path) -> dict[str, Any]:
    """The tables of an HDF5 file; a table that says it is larger than any push is not unpacked."""
    content = read_bytes(path, EXPECTED_MIT, PushLogError, MAX_SIZE)
    h5py = import_extra("h5py", "hdf5")
    found: dict[str, Any] = {}
    try:
        with h5py.File(BytesIO(content), "r") as file:
            for name in file:
                if name not in TABLE_COLUMNS:
                    found[name] = None
                    continue
                shape = getattr(file[name], "shape", None)
                if shape is None or len(shape) != 2 or shape[0] > MAX_ROWS or shape[1] != 4:
                    raise PushLogError(
                        f"{path}: {name} has the shape {shape}; expected (K, 4), K at most "
                        f"{MAX_ROWS}, of {TABLE_COLUMNS[name]}"
                    )
                found[name] = file[name][:]
    except PushLogError:
        raise
    except Exception as error:  # a damaged file makes h5py raise almost anything
        raise PushLogError(
            f"{path}: cannot be read as HDF5: {error}; expected {EXPECTED_MIT}"
        ) from error
    return found


def _check_table(path: Path, name: str, form: str, value: ArrayLike) -> Array:
    """A table's numbers, the rows with the same time as the one before left out."""
    try:
        table = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        table = np.empty(0)
    if table.ndim != 2 or table.shape[1] != 4 or not MIN_ROWS <= len(table) <= MAX_ROWS:
        raise PushLogError(
            f"{path}: {name} has the shape {table.shape}; expected {MIN_ROWS} to {MAX_ROWS} rows "
            f"of {form}"
        )
    if not (np.abs(table) <= MAX_NUMBER).all():
        raise PushLogError(f"{path}: {name} must hold finite numbers, rows of {form}")
    steps = np.diff(table[:, 0])
    if (steps < 0).any():
        row = int(np.argmax(steps < 0)) + 2
        raise PushLogError(
            f"{path}: {name}, row {row}: its time is before the one above; expected times (s) "
            "that increase"
        )
    return table[np.append(True, steps > 0)]


def _write_down(
    path: Path,
    episode: TipMotion,
    tables: dict[str, Array],
    obj: GridObject,
    options: RecordOptions,
) -> ObservedPush | None:
    """A file's push; None where the tip does not touch the object or the object was not seen."""
    try:
        seen = make_observed_push(episode, obj, TIP_RADIUS, path.stem.strip(), options)
    except UNUSABLE_ERRORS as error:
        raise PushLogError(f"{path}: the push could not be written down: {error}") from error
    if seen is None or WRENCH_TABLE not in tables:
        return seen
    wrench = tables[WRENCH_TABLE]
    return add_force(seen, find_begin(episode, options), wrench[:, 0], wrench[:, 1:3])


def _orient_forces(path: Path, pushes: list[ObservedPush]) -> list[ObservedPush]:
    """The pushes with the forces on the object: those on the tip, against its motion, turned round.

    Which of the two a file holds is judged by all its pushes together: a tip pushes and never
    pulls, so that the forces' work on the object is positive.
    """
    work = sum(
        float(seen.force.sum(axis=0) @ seen.push.velocity)
        for seen in pushes
        if seen.force is not None
    )
    if work >= 0:
        return pushes
    warn(
        f"{path}: {WRENCH_TABLE} holds the forces on the tip; they were turned round into those "
        "on the "
        "object",
        PushLogWarning,
        stacklevel=3,
    )
    return [seen if seen.force is None else replace(seen, force=-seen.force) for seen in pushes]

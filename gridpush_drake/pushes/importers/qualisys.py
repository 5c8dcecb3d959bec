"""Importer of motion capture tables of Qualisys Track Manager: rigid bodies, `NAME_6D.tsv`.

The text is separated by tabs. It may begin with a header, lines of a word and its values
(`NO_OF_BODIES`, `FREQUENCY`, `BODY_NAMES` and so on), and goes on with a row a frame: its number,
its time (s), and for each rigid body 16 numbers and an empty column,

    X Y Z (mm)  Roll Pitch Yaw (degrees)  Residual (mm)  Rot[0] ... Rot[8]

Rot is the body's rotation matrix R_WB, column after column: Rot[0], Rot[1], Rot[2] is the body's x
axis in the world frame. It is what is read; the three angles say the same in a convention that can
be chosen in the program. A body that the cameras lost in a frame has zeros and a residual of -1, or
blanks.

One body is the object and another one carries the tip, at a fixed place in that body's frame. Both
have the clock of the cameras, so that there is no delay between them.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import MAX_NUMBER, PushLogError
from gridpush_drake.files import read_text
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers import (
    describe_pusher_option,
    describe_yaw_option,
    require_object,
)
from gridpush_drake.pushes.push_csv import choose_pusher
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import RecordOptions, SegmenterOptions
from gridpush_drake.pushes.stream import calc_velocities, make_samples, record_pushes, turn_samples
from gridpush_drake.units import M_PER_MM

EXPECTED_QUALISYS = "a table of rigid bodies of Qualisys Track Manager (NAME_6D.tsv)"


FRAME_COLUMNS = 2
"""Columns before the first body: the frame's number and its time."""

BODY_COLUMNS = 16
"""Numbers of a body; an empty column follows."""

RESIDUAL_INDEX = 6
"""Which of a body's numbers is the residual; a negative one means that the body was not seen."""

ROTATION_INDICES = slice(7, 16)
"""Which of a body's numbers are Rot[0] to Rot[8]."""

ROTATION_TOLERANCE = 0.01
"""How far R^T R may be from the identity, in each of its elements."""

NAMES_WORD = "BODY_NAMES"
"""Word of the header's line that names the bodies."""

MAX_FRAMES = 500_000
"""Most frames: 83 minutes at 100 Hz."""


class BodyTrack(NamedTuple):
    """Where a rigid body was in each frame.

    Attributes:
        p: (K, 3) p_WB, m; NaN where it was not seen.
        R: (K, 3, 3) R_WB; NaN where it was not seen.
    """

    p: Array
    R: Array


@dataclass(frozen=True)
class QualisysImporter:
    """Convert the pushes in a motion capture table of Qualisys Track Manager (NAME_6D.tsv)."""

    file: ClassVar[str] = "NAME_6D.tsv"
    source: ClassVar[str] = "a table of rigid bodies that Qualisys Track Manager exported"
    example: ClassVar[str] = "--object plate.yaml --object-body plate --tip-body finger"

    obj: GridObject | None = field(
        default=None,
        metadata={
            "help": "The object that was pushed: an object file whose frame is that of the "
            "object's rigid body, or a shipped object's name. It has to be given.",
            "name": "--object",
        },
    )
    object_body: str = field(
        default="",
        metadata={
            "help": "The rigid body of the object: its name in the header of the table, or its "
            "number there, from 1. It has to be given."
        },
    )
    tip_body: str = field(
        default="",
        metadata={
            "help": "The rigid body that carries the pusher's tip: its name or its number, from "
            "1. It has to be given."
        },
    )
    tip_at: str = field(
        default="0,0,0",
        metadata={
            "help": "Where the center of the tip is in the frame of the rigid body that carries "
            "it: x,y,z, m."
        },
    )
    table_height: float = field(
        default=0.0,
        metadata={"help": "Height of the table's top in the world frame of the cameras, m."},
    )
    pusher: str | None = field(
        default=None, metadata=describe_pusher_option("the tip's rigid body")
    )
    pusher_yaw: float = field(default=0.0, metadata=describe_yaw_option("the tip's rigid body"))

    def read(self, path: Path | str) -> tuple[PushLog, GridObject]:
        """Reads a table, and cuts it into the pushes of the object.

        The world frame is that of the cameras, whose z axis must point up.

        Raises:
            PushLogError: the file cannot be read or is not of its form, a body is not there, an
                option is missing, or no push touches the object.
        """
        path = Path(path)
        t, bodies = read_bodies(path)
        obj = require_object(path, self.obj)
        pushed = _choose(path, bodies, "--object-body", self.object_body)
        carrier = _choose(path, bodies, "--tip-body", self.tip_body)
        tip = carrier.p + carrier.R @ _read_place(self.tip_at)
        tip[:, 2] -= self.table_height

        poses = np.column_stack([pushed.p[:, :2], _calc_yaws(pushed.R)])

        pusher = choose_pusher("--pusher", self.pusher, obj)
        samples = make_samples(t, tip, calc_velocities(t, tip), poses)
        if self.pusher is not None:
            if not abs(self.pusher_yaw) <= MAX_NUMBER:
                raise PushLogError(
                    f"--pusher-yaw: is {self.pusher_yaw!r}; expected a finite number (rad)"
                )
            samples = turn_samples(samples, t, _calc_yaws(carrier.R), self.pusher_yaw)
        recording = record_pushes(
            samples, obj, pusher, SegmenterOptions(), RecordOptions(), str(path)
        )
        if not len(recording.log):
            lowest = float(np.nanmin(tip[:, 2])) if np.isfinite(tip[:, 2]).any() else math.nan
            below = SegmenterOptions().engaged_below
            why = recording.unusable[0] if recording.unusable else (
                f"the tip comes down to {lowest:.3f} m above the table, and counts as pushing "
                f"below {below:g} m; are --tip-at and --table-height right?"
            )  # fmt: skip
            raise PushLogError(f"{path}: holds no push of {obj.name}: {why}")
        return recording.log, obj


def _calc_yaws(R: Array) -> Array:
    """Calculates the directions of x axes seen from above, (K,) rad, of rotations (K, 3, 3)."""
    return np.asarray(np.arctan2(R[:, 1, 0], R[:, 0, 0]))


def read_bodies(path: Path) -> tuple[Array, dict[str, BodyTrack]]:
    """Reads where each rigid body was.

    Args:
        path: the file.

    Returns:
        Times (K,), s, increasing, and each body's track by its name; bodies that have no name are
        called by their numbers, the first "1".

    Raises:
        PushLogError: the file cannot be read, has no frames, or a row is not of the form; the
            message names the file, the line and the form.
    """
    lines = read_text(path, EXPECTED_QUALISYS, PushLogError).splitlines()
    header: dict[str, list[str]] = {}
    first = len(lines)
    for i, line in enumerate(lines):
        cells = line.split("\t")
        if _is_number(cells[0]):
            first = i
            break
        header.setdefault(cells[0].strip(), [cell.strip() for cell in cells[1:] if cell.strip()])
    rows = [(i + 1, line) for i, line in enumerate(lines) if i >= first and line.strip()]
    if not rows:
        raise PushLogError(f"{path}: holds no frame; expected {EXPECTED_QUALISYS}")
    if len(rows) > MAX_FRAMES:
        raise PushLogError(f"{path}: holds {len(rows)} frames; expected at most {MAX_FRAMES}")

    count = _count_bodies(path, *rows[0])
    table = np.array([_read_row(path, number, line, count) for number, line in rows])
    t = table[:, 1]
    if (np.diff(t) <= 0).any():
        number = rows[int(np.argmax(np.diff(t) <= 0)) + 1][0]
        raise PushLogError(
            f"{path}, line {number}: its time is not after the one above; expected times (s) that "
            "increase"
        )
    names = header.get(NAMES_WORD, [])
    if len(names) != count:
        names = [str(i + 1) for i in range(count)]
    tracks = {}
    for i, name in enumerate(names):
        begin = FRAME_COLUMNS + i * BODY_COLUMNS
        tracks[name] = _make_track(
            path, name, table[:, begin : begin + BODY_COLUMNS], [number for number, _ in rows]
        )
    return t, tracks


def _count_bodies(path: Path, number: int, line: str) -> int:
    """Counts the bodies of a row: 16 numbers and an empty column each, the last may lack."""
    cells = line.split("\t")
    count, rest = divmod(len(cells) - FRAME_COLUMNS + 1, BODY_COLUMNS + 1)
    if rest not in (0, 1) or count < 1:
        raise PushLogError(
            f"{path}, line {number}: has {len(cells)} columns; expected a frame's number, its "
            f"time, and {BODY_COLUMNS} numbers and an empty column for each rigid body"
        )
    return count


def _read_row(path: Path, number: int, line: str, count: int) -> NDArray[np.float64]:
    """A row's numbers without the empty columns; NaN for a body whose cells are blank."""
    cells = line.split("\t")
    if _count_bodies(path, number, line) != count:
        raise PushLogError(
            f"{path}, line {number}: has {len(cells)} columns; expected those of {count} rigid "
            "bodies, as in the rows above"
        )
    row = np.empty(FRAME_COLUMNS + count * BODY_COLUMNS)
    row[:FRAME_COLUMNS] = [_read_cell(path, number, cell) for cell in cells[:FRAME_COLUMNS]]
    for i in range(count):
        begin = FRAME_COLUMNS + i * (BODY_COLUMNS + 1)
        own = cells[begin : begin + BODY_COLUMNS]
        into = slice(FRAME_COLUMNS + i * BODY_COLUMNS, FRAME_COLUMNS + (i + 1) * BODY_COLUMNS)
        blank = not any(cell.strip() for cell in own)
        row[into] = math.nan if blank else [_read_cell(path, number, cell) for cell in own]
    return row


def _read_cell(path: Path, number: int, cell: str) -> float:
    if not _is_number(cell) or not abs(float(cell)) <= MAX_NUMBER:
        raise PushLogError(f"{path}, line {number}: is {cell[:60]!r}; expected a finite number")
    return float(cell)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _make_track(path: Path, name: str, own: Array, lines: list[int]) -> BodyTrack:
    """A body's track from its columns (K, 16).

    Raises:
        PushLogError: Rot is no rotation matrix in a frame in which the body was seen.
    """
    p = own[:, :3] * M_PER_MM
    R = (
        own[:, ROTATION_INDICES].reshape(-1, 3, 3).transpose(0, 2, 1)
    )  # column after column in the file
    lost = ~(own[:, RESIDUAL_INDEX] >= 0) | ~own[:, ROTATION_INDICES].any(axis=1)
    off = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max(axis=(1, 2))
    wrong = ~lost & ((off > ROTATION_TOLERANCE) | (np.linalg.det(np.nan_to_num(R)) < 0))
    if wrong.any():
        raise PushLogError(
            f"{path}, line {lines[int(np.argmax(wrong))]}: Rot[0] to Rot[8] of {name} are no "
            "rotation matrix"
        )
    return BodyTrack(
        p=np.where(lost[:, None], np.nan, p), R=np.where(lost[:, None, None], np.nan, R)
    )


def _choose(path: Path, bodies: dict[str, BodyTrack], option: str, said: str) -> BodyTrack:
    """A body by its name or its number."""
    names = list(bodies)
    if said in bodies:
        return bodies[said]
    if said.isdecimal() and 1 <= int(said) <= len(names):
        return bodies[names[int(said) - 1]]
    problem = f"is {said!r}" if said else "is missing"
    raise PushLogError(f"{path}: {option} {problem}; expected one of {', '.join(names)}")


def _read_place(text: str) -> Array:
    """The tip's place (3,) in its body's frame, m.

    Raises:
        PushLogError: it is not three finite numbers with commas between them.
    """
    words = text.split(",")
    if len(words) != 3 or not all(_is_number(word) for word in words):
        raise PushLogError(f"--tip-at: is {text!r}; expected x,y,z (m)")
    place = np.array([float(word) for word in words])
    if not (np.abs(place) <= MAX_NUMBER).all():
        raise PushLogError(f"--tip-at: is {text!r}; expected finite numbers x,y,z (m)")
    return place

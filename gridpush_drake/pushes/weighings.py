"""Weighings of an object: presses at the table's edge, lifts, and the CSV file that holds them.

    edge press   A part of the object hangs over the edge. The fingertip presses down on it, and the
                 force is noted at which the object begins to tilt.
    lift         The gripper holds the object level in the air. Its weight is noted and, where it is
                 known, the torque of the weight about the pads.

Positions are in the world frame W, in m; angles in rad; forces in N; torques in N m. What they
tell of mass and center of mass is worked out in `identification.absolute.estimate`.
"""

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, pi, sin
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.errors import PushLogError, require_positive
from gridpush_drake.files import write_whole
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.notebook import count
from gridpush_drake.pushes.csv_table import (
    fail,
    is_empty,
    read_number,
    read_table,
    refuse_misspelled,
    warn_of_further,
)
from gridpush_drake.pushes.push_csv import POSE_COLUMNS
from gridpush_drake.units import MM_PER_M

FORCE_STD = 0.2
"""Default standard deviation of a force at the fingertip or the gripper, N: that of an arm that
tells the external torques of its joints."""

TORQUE_STD = 0.02
"""Default standard deviation of a torque about the pads, N m: `FORCE_STD` on an arm of 0.1 m."""

POSITION_STD = 0.001
"""Standard deviation of an object's seen position, per axis, m."""

ANGLE_STD = 0.3 * pi / 180
"""Standard deviation of an object's seen heading, rad."""

EDGE_STD = 0.0005
"""Standard deviation of where the table's edge is along its normal, m, as seen from both fingertip
and object."""

PRESS_ROW = "press"
LIFT_ROW = "lift"

KIND_COLUMN = "kind"
"""Column that says what a row is: `PRESS_ROW` or `LIFT_ROW`."""

PLACE_COLUMNS = ("place_x", "place_y")
"""Columns of where the tip presses, or of the middle between the pads."""

FORCE_COLUMN = "force"
"""Column of the force at which the object begins to tilt, or of its weight."""

EDGE_COLUMNS = ("edge_x", "edge_y", "edge_angle")
"""Columns of a press: a point of the edge, and the direction in which the table ends there."""

TORQUE_COLUMNS = ("torque_x", "torque_y")
"""Columns of a lift: torque of the weight about the middle between the pads; may be empty."""

STD_COLUMNS = ("force_std", "torque_std")
"""Columns of standard deviations; where they are empty, the defaults hold."""

ROCKING_COLUMNS = ("center_shift", "free_way", "rock_force")
"""Columns of a press: how far its tilt had moved the center of mass, how far the tip went on
freely, and a smaller force at which the object gave way before; may be empty."""

REQUIRED_TEST_COLUMNS = (KIND_COLUMN, *POSE_COLUMNS, *PLACE_COLUMNS, FORCE_COLUMN, *EDGE_COLUMNS)
"""Columns that every file has."""

TEST_COLUMNS = (*REQUIRED_TEST_COLUMNS, *TORQUE_COLUMNS, *STD_COLUMNS, *ROCKING_COLUMNS)
"""All columns that are read."""

TEST_COLUMN_UNITS = {
    "object_theta": "rad",
    "edge_angle": "rad",
    FORCE_COLUMN: "N",
    "force_std": "N",
    "torque_x": "N m",
    "torque_y": "N m",
    "torque_std": "N m",
    "rock_force": "N",
}
"""Unit of each column; m where not listed."""

EXPECTED_TESTS = "weighings (CSV)"
"""The expected form of a file, for messages."""


@dataclass(frozen=True, eq=False)
class TiltTest(Frozen):
    """One press on a part that hangs over the table's edge, up to where the object begins to tilt.

    Attributes:
        pose: (3,) X_WB of the object while it was pressed, m and rad. Presses and lifts with the
            very same pose share its error.
        place: (2,) where the tip pressed, W, m; beyond the edge.
        force: N, downwards, at which the object begins to tilt.
        edge_point: (2,) a point of the edge, W, m.
        edge_angle: direction of the edge's outward normal, rad.
        force_std: standard deviation of the force, N.
        center_shift: how far the tilt had moved the center of mass outwards as the force was
            measured, m; 0 at the first sign of tilt.
        free_way: how far the tip went on downwards without a rise of the force, m; None where that
            is not known. An object that tilts about the edge gives way as far as it is pressed; one
            that rocks on its feet is stiff again when its underside meets the edge.
        rock_force: smaller force at which the object gave way before and was stiff again, N, as on
            its feet; None where it did not.

    Raises:
        PushLogError: a value is not as said above.
    """

    pose: Array
    place: Array
    force: float
    edge_point: Array
    edge_angle: float
    force_std: float = FORCE_STD
    center_shift: float = 0.0
    free_way: float | None = None
    rock_force: float | None = None

    def __post_init__(self) -> None:
        _freeze(self, "press", pose=3, place=2, edge_point=2)
        for name in ROCKING_COLUMNS:
            value = getattr(self, name)
            if value is not None and not 0 <= value < np.inf:
                unit = TEST_COLUMN_UNITS.get(name, "m")
                raise PushLogError(
                    f"press: {name} is {value!r}; expected a number, 0 or more ({unit})"
                )
        require_positive(PushLogError, "press: ", "N", force=self.force, force_std=self.force_std)
        if not np.isfinite(self.edge_angle):
            raise PushLogError(
                f"press: edge_angle is {self.edge_angle!r}; expected a finite number (rad)"
            )
        if not self.arm > 0:
            raise PushLogError(
                f"press: the tip is {-self.arm * MM_PER_M:.1f} mm inside the table's edge; "
                "expected a "
                "place beyond it"
            )

    @property
    def normal(self) -> Array:
        """(2,) the edge's outward unit normal, W."""
        return np.array([cos(self.edge_angle), sin(self.edge_angle)])

    @property
    def arm(self) -> float:
        """How far beyond the edge the tip presses, m."""
        return float(self.normal @ (self.place - self.edge_point))

    def __repr__(self) -> str:
        """Force and distance from the edge, in a line."""
        return (
            f"TiltTest: {self.force:.2f} ± {self.force_std:.2f} N, "
            f"{self.arm * MM_PER_M:.0f} mm beyond the edge"
        )


@dataclass(frozen=True, eq=False)
class LiftTest(Frozen):
    """One look at the forces while the gripper holds the object level in the air.

    Attributes:
        pose: (3,) X_WB of the object as it was gripped, m and rad.
        place: (2,) the middle between the pads, in the same frame, m.
        weight: N.
        torque: (2,) torque of the weight about the middle between the pads, along x and y of W,
            N m: (-W l_y, W l_x) where the center of mass is l beyond the pads. None where it is
            not known.
        weight_std: standard deviation of the weight, N.
        torque_std: standard deviation of the torque per axis, N m.

    Raises:
        PushLogError: a value is not as said above.
    """

    pose: Array
    place: Array
    weight: float
    torque: Array | None = None
    weight_std: float = FORCE_STD
    torque_std: float = TORQUE_STD

    def __post_init__(self) -> None:
        _freeze(self, "lift", pose=3, place=2)
        if self.torque is not None:
            _freeze(self, "lift", torque=2)
        require_positive(
            PushLogError, "lift: ", "N", weight=self.weight, weight_std=self.weight_std
        )
        require_positive(PushLogError, "lift: ", "N m", torque_std=self.torque_std)

    def __repr__(self) -> str:
        """The weight, in a line."""
        about = "" if self.torque is None else ", with its torque about the pads"
        return f"LiftTest: {self.weight:.2f} ± {self.weight_std:.2f} N{about}"


@dataclass(frozen=True, eq=False)
class MassTestLog:
    """All weighings of one object.

    Attributes:
        presses: presses at the table's edge.
        lifts: lifts.
        source: where they came from, such as a file's name.
    """

    presses: tuple[TiltTest, ...] = ()
    lifts: tuple[LiftTest, ...] = ()
    source: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "presses", tuple(self.presses))
        object.__setattr__(self, "lifts", tuple(self.lifts))

    def __len__(self) -> int:
        return len(self.presses) + len(self.lifts)

    def __repr__(self) -> str:
        """How many there are, in a line."""
        kinds = f"{count(len(self.presses), 'edge press')}, {count(len(self.lifts), 'lift')}"
        source = f", from {self.source}" if self.source else ""
        return f"MassTestLog: {kinds}{source}"

    @classmethod
    def read_csv(cls, path: Path | str) -> "MassTestLog":
        """Reads a file; `docs/reference/files.md` has its columns.

        Raises:
            PushLogError: the file cannot be read or breaks the form; the message names the file,
                the line, the column and the expected form.

        Warns:
            PushLogWarning: the file has further columns, which are passed over.
        """
        path = Path(path)
        presses = []
        lifts = []
        for line, cells in read_table(path, EXPECTED_TESTS, REQUIRED_TEST_COLUMNS, _check_header):
            try:
                made = _parse_row(path, line, cells)
            except PushLogError as error:
                # A record knows neither its file nor its line; what reads its cells does.
                if str(error).startswith(str(path)):
                    raise
                raise PushLogError(f"{path}, line {line}: {error}") from error
            if isinstance(made, TiltTest):
                presses.append(made)
            else:
                lifts.append(made)
        if not presses and not lifts:
            raise PushLogError(f"{path}: holds no weighing; expected at least one row")
        return cls(tuple(presses), tuple(lifts), str(path))

    def write_csv(self, path: Path | str, force: bool = False) -> None:
        """Writes the weighings so that `read_csv` gives their numbers back bit for bit.

        Raises:
            OutputError: the file exists and `force` is not set, or it cannot be written.
        """
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(TEST_COLUMNS)
        for press in self.presses:
            edge = [*press.edge_point, press.edge_angle]
            where = [*press.pose, *press.place, press.force, *edge]
            # A press has no torque.
            values = (getattr(press, name) for name in ROCKING_COLUMNS)
            rocking = ["" if one is None else repr(float(one)) for one in values]
            writer.writerow(
                [PRESS_ROW, *_write(where), "", "", *_write([press.force_std]), "", *rocking]
            )
        for lift in self.lifts:
            where = [*lift.pose, *lift.place, lift.weight]
            torque = ["", ""] if lift.torque is None else _write(lift.torque)
            # A lift has no edge, and not always a torque.
            stds = _write([lift.weight_std, lift.torque_std])
            writer.writerow([LIFT_ROW, *_write(where), "", "", "", *torque, *stds, "", "", ""])
        write_whole(path, text.getvalue(), force)


def _freeze(record: TiltTest | LiftTest, what: str, **sizes: int) -> None:
    """Makes fields of a record read-only vectors of finite numbers."""
    for name, size in sizes.items():
        vector = check_vector(PushLogError, f"{what}: {name}", getattr(record, name), size)
        vector.setflags(write=False)
        object.__setattr__(record, name, vector)


def _check_header(path: Path, line: int, header: list[str]) -> None:
    """Refuses a header without a column that is needed, or with one twice or misspelled."""
    known = ",".join((*TORQUE_COLUMNS, *STD_COLUMNS, *ROCKING_COLUMNS))
    form = f"expected comma-separated {','.join(REQUIRED_TEST_COLUMNS)} and, if known, {known}"
    refuse_misspelled(path, line, header, TEST_COLUMNS, form)
    for name in REQUIRED_TEST_COLUMNS:
        if name not in header:
            fail(path, line, name, f"is missing; {form}")
    for name in TEST_COLUMNS:
        if header.count(name) > 1:
            fail(path, line, name, f"is there twice; {form}")
    warn_of_further(path, header, TEST_COLUMNS)


def _parse_row(path: Path, line: int, cells: dict[str, str]) -> TiltTest | LiftTest:
    """Makes a weighing of a row's cells."""

    def read(columns: Iterable[str]) -> list[float]:
        """Reads the numbers of some columns, none of which may be empty."""
        numbers = []
        for name in columns:
            form = f"a finite number ({TEST_COLUMN_UNITS.get(name, 'm')})"
            numbers.append(read_number(path, line, name, cells.get(name, ""), form))
        return numbers

    def read_std(name: str, default: float) -> float:
        """Reads a standard deviation; the default where the cell is empty."""
        return default if is_empty(cells.get(name, "")) else read([name])[0]

    # What both kinds have.
    kind = cells[KIND_COLUMN].strip()
    pose = np.array(read(POSE_COLUMNS))
    place = np.array(read(PLACE_COLUMNS))
    (force,) = read([FORCE_COLUMN])
    force_std = read_std("force_std", FORCE_STD)
    if kind == PRESS_ROW:
        x, y, angle = read(EDGE_COLUMNS)
        center_shift, free_way, rock_force = (
            None if is_empty(cells.get(name, "")) else read([name])[0] for name in ROCKING_COLUMNS
        )
        return TiltTest(
            pose=pose,
            place=place,
            force=force,
            edge_point=np.array([x, y]),
            edge_angle=angle,
            force_std=force_std,
            center_shift=center_shift or 0.0,
            free_way=free_way,
            rock_force=rock_force,
        )
    if kind == LIFT_ROW:
        felt = not all(is_empty(cells.get(name, "")) for name in TORQUE_COLUMNS)
        return LiftTest(
            pose=pose,
            place=place,
            weight=force,
            torque=np.array(read(TORQUE_COLUMNS)) if felt else None,
            weight_std=force_std,
            torque_std=read_std("torque_std", TORQUE_STD),
        )
    fail(path, line, KIND_COLUMN, f"is {kind!r}; expected {PRESS_ROW!r} or {LIFT_ROW!r}")


def _write(values: ArrayLike) -> list[str]:
    """Writes numbers so that they are read back exactly."""
    return [repr(float(value)) for value in np.asarray(values, dtype=np.float64)]

"""Importer of the CMU pushes (Zhou, Paolini, Bagnell, Mason, ICRA 2016).

They are from GitHub's robinzhoucmu/MLab_EXP.

A right-angled triangular block is pushed with a point; its pose is known before and after. As a
file's pushes are chained (where one ends, the next begins), each is given in its own initial object
frame: an imported push's world frame is the object's body frame at that push's beginning, so that
the initial pose is zero.

The text format: one record a line, blanks between numbers: the number of pushes; then for each push
the object's pose before and its pose after (x y z, quaternion w x y z), the number of force rows
and the rows (t fx fy), the number of tool rows and the rows (t x y z qw qx qy qz). Lengths are in
mm, times in s (absolute), forces in N and in the sensor's frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import MAX_NUMBER, PushError, PushLogError
from gridpush_drake.files import read_text
from gridpush_drake.geometry.se2 import Array, compose, invert, rotate, transform_back
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import PhysicalPrior
from gridpush_drake.pushes.csv_table import MAX_SHOWN
from gridpush_drake.pushes.observed_push import ObservedPush, nearest_turn
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.units import M_PER_MM

POSE_FORM = "x y z (mm) qw qx qy qz"
FORCE_FORM = "t (s) fx fy (N)"
TOOL_FORM = "t (s) x y z (mm) qw qx qy qz"

POSE_SIZE = 7
"""How many numbers a line with a pose has."""

FORCE_SIZE = 3
"""How many numbers a line with a force has."""

TOOL_SIZE = 8
"""How many numbers a line with the tool's pose has."""

QUATERNION_TOLERANCE = 1e-3
"""Largest difference of a quaternion's norm from 1."""

MAX_DIGITS = 9
"""Largest number of digits of a count."""


PushType = TypeVar("PushType")
"""A push as a file of some kind has it."""


class CmuPush(NamedTuple):
    """One push as logged.

    Attributes:
        before: (7,) the object's pose before the push, robot base frame, mm and quaternion w x y z.
        after: (7,) the object's pose after it.
        force: (F, 3) rows t fx fy, sensor frame, s and N.
        tool: (T, 8) rows t x y z qw qx qy qz, robot base frame, s, mm and quaternion.
    """

    before: Array
    after: Array
    force: Array
    tool: Array


def read_cmu(path: Path) -> list[CmuPush]:
    """Reads every push of a file, in its order.

    Raises:
        PushLogError: the file cannot be read, is cut short, goes on after its last push, or a line
            is not what it should be; the message names the file, the line and the expected form.
    """
    return FileLines(path, "a file of the CMU pushes").take_pushes(_read_push)


def _read_push(lines: "FileLines", i: int) -> CmuPush:
    """Takes the lines of push number i, from 0."""
    before = lines.table(1, POSE_SIZE, f"push {i + 1}: the object's pose before, {POSE_FORM}")[0]
    after = lines.table(1, POSE_SIZE, f"push {i + 1}: its pose after, {POSE_FORM}")[0]
    force_rows = lines.count(f"push {i + 1}: the number of force rows")
    force = lines.table(force_rows, FORCE_SIZE, f"push {i + 1}: a force row, {FORCE_FORM}")
    tool_rows = lines.count(f"push {i + 1}: the number of tool rows")
    tool = lines.table(tool_rows, TOOL_SIZE, f"push {i + 1}: a tool row, {TOOL_FORM}")
    return CmuPush(before=before, after=after, force=force, tool=tool)


class FileLines:
    """The lines of a text file with something on them, taken from the top."""

    def __init__(self, path: Path, form: str) -> None:
        """Reads a file; `form` says what it should be, for messages."""
        self._path = path
        text = read_text(path, form, PushLogError)
        lines = enumerate(text.splitlines(), start=1)
        self._lines = [(number, words) for number, line in lines if (words := line.split())]
        self._next = 0

    def count(self, what: str) -> int:
        """Takes a line with one whole number, at least 1."""
        number, words = self._take(what)
        counted = len(words) == 1 and words[0].isdecimal() and len(words[0]) <= MAX_DIGITS
        if not counted or int(words[0]) < 1:
            self._fail(number, words, f"{what}, a whole number of at least 1")
        return int(words[0])

    def words(self, number: int, what: str) -> list[str]:
        """Takes a line with so many words."""
        line, words = self._take(what)
        if len(words) != number:
            self._fail(line, words, what)
        return words

    def table(self, rows: int, size: int, what: str, quaternion: bool = True) -> Array:
        """Takes lines of finite numbers.

        Args:
            rows: how many lines.
            size: how many numbers a line.
            what: what is expected, for messages.
            quaternion: whether a line of at least 7 numbers ends in a unit quaternion.

        Returns:
            (rows, size) the numbers.
        """
        # No more room is made than there are lines: the count may be wrong.
        table = np.empty((min(rows, len(self._lines) - self._next), size))
        for row in range(rows):
            number, words = self._take(what)
            try:
                values = [float(word) for word in words]
            except ValueError:
                values = []
            if len(values) != size or not (np.abs(values) <= MAX_NUMBER).all():
                self._fail(number, words, what)
            table[row] = values
            turns = quaternion and size >= POSE_SIZE
            norm = float(np.linalg.norm(table[row, -4:])) if turns else 1.0
            if abs(norm - 1) > QUATERNION_TOLERANCE:
                self._fail(number, words, f"{what} with a quaternion of length 1")
        return table

    def take_pushes(self, take: Callable[["FileLines", int], PushType]) -> list[PushType]:
        """Takes the whole file: the number of pushes, and each of them by its number from 0."""
        pushes = [take(self, i) for i in range(self.count("the number of pushes"))]
        if self._next < len(self._lines):
            self._fail(*self._lines[self._next], "the file's end after its last push")
        return pushes

    def _take(self, what: str) -> tuple[int, list[str]]:
        """Takes the next line: its number and its words."""
        if self._next == len(self._lines):
            last = self._lines[-1][0] if self._lines else 0
            raise PushLogError(
                f"{self._path}, line {last + 1}: the file ends here; expected {what}"
            )
        self._next += 1
        return self._lines[self._next - 1]

    def _fail(self, number: int, words: list[str], what: str) -> None:
        """Raises a PushLogError that shows a line and says what was expected."""
        shown = " ".join(words)
        raise PushLogError(
            f"{self._path}, line {number}: is {shown[:MAX_SHOWN]!r}; expected {what}"
        )


BLOCK_CENTROID = (0.050, 0.050)
"""The block's centroid, from the logged origin (the right-angle corner) in body axes, m."""

BLOCK_OUTLINE = ((-0.05, -0.05), (0.10, -0.05), (-0.05, 0.10))
"""Corners of the block, about its centroid, m."""

TIP_OFFSET = (-0.0012, -0.00085)
"""Place of the tip's center from the logged tool point, tool's axes, m; found from contact geometry
over all logs."""

TIP_EXTENSION = 0.00065
"""Length that the tool travels along its straight path after its logging stops, m."""

TIP_RADIUS = 0.0005
"""Radius of the tip, m."""

STANDSTILL_DISTANCE = 0.00005
"""Distance from where the tool starts (or ends) within which it stands still, m. It is half a step
of the log."""

STRAIGHT_TOLERANCE = 0.0002
"""Distance from a straight line within which the tool's path is one, m. It is logged in steps of
0.1 mm."""

SENSOR_AXES = ((2**-0.5, 2**-0.5), (2**-0.5, -(2**-0.5)))
"""Matrix R_tool that turns forces from the force sensor's axes into the tool's."""

BLOCK_MASS = 1.518
"""Mass of the block, kg."""

CONTACT_FRICTION = 0.5
"""Prior of the tip's friction coefficient on the block's side."""

CONTACT_FRICTION_STD = 0.15
"""Standard deviation of that prior."""

BLOCK_CELLS = 55
"""Largest number of cells of the block's grid."""

UNIFORM_PLATE_STD = 0.002
"""Standard deviation with which the center of mass of a uniform plate is at its centroid, m."""


def triangle_block(uniform_plate: bool = False) -> GridObject:
    """Makes the pushed block; B is at its centroid, x and y along its legs.

    As a uniform plate its center of mass is held to be known at the centroid.
    """
    prior = PhysicalPrior(
        total_mass=BLOCK_MASS,
        center_of_mass=(0.0, 0.0) if uniform_plate else None,
        center_of_mass_std=UNIFORM_PLATE_STD,
        contact_friction=CONTACT_FRICTION,
        contact_friction_std=CONTACT_FRICTION_STD,
        pusher_radius=TIP_RADIUS,
    )
    return GridObject.from_outline(
        BLOCK_OUTLINE, max_cells=BLOCK_CELLS, name="triangle_block", prior=prior
    )


@dataclass(frozen=True)
class TriangleBlockImporter:
    """What importers of logs of CMU's triangular block have in common.

    In the logs each push begins where the one before it ended. Shuffled, no two neighbors are known
    to be chained.
    """

    shuffle: bool = field(
        default=True,
        metadata={
            "help": "Put the pushes in random order. In the log each push begins where the one "
            "before it ended."
        },
    )
    uniform_plate: bool = field(
        default=False,
        metadata={
            "help": "Write into the object file that the block's center of mass is at its "
            "centroid.",
            "name": "--uniform-plate",
        },
    )
    seed: int = field(default=0, metadata={"help": "Seed of the random order."})

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise PushLogError(f"seed is {self.seed}; expected 0 or more")

    def collect(
        self, path: Path, names: Sequence[str], observe: Callable[[int, str], ObservedPush]
    ) -> tuple[PushLog, GridObject]:
        """Makes a log of the pushes of a file, in the order that is asked for, and the block.

        Args:
            path: of the file, for messages.
            names: of the pushes in the file, for messages.
            observe: makes the log's entry of one of them, with its name in the log; may raise
                PushError.

        Raises:
            PushLogError: a push could not be made.
        """
        count = len(names)
        rng = np.random.default_rng(self.seed)
        order = rng.permutation(count) if self.shuffle else np.arange(count)
        digits = len(str(count))
        pushes = []
        for place, i in enumerate(order.tolist(), start=1):
            try:
                pushes.append(observe(i, f"push_{place:0{digits}}"))
            except PushError as error:
                raise PushLogError(f"{path}: push {names[i]}: {error}") from error
        return PushLog(tuple(pushes), str(path)), triangle_block(self.uniform_plate)


@dataclass(frozen=True)
class CmuImporter(TriangleBlockImporter):
    """Convert a log of CMU's triangular block (Zhou, Paolini, Bagnell, Mason, ICRA 2016).

    To calibrate is to correct the logged tool point to the tip's center (TIP_OFFSET), to take the
    log's steps out of its straight path, and to let it travel on for TIP_EXTENSION. Shuffled, no
    two neighbors are known to be chained.
    """

    file: ClassVar[str] = "LOG.txt"
    source: ClassVar[str] = "a log in the GitHub repository robinzhoucmu/MLab_EXP"

    calibrate: bool = field(
        default=True,
        metadata={
            "help": "Correct the places in the log, which are those of a point on the tool, to the "
            "center of the pusher's tip."
        },
    )

    def read(self, path: Path | str) -> tuple[PushLog, GridObject]:
        """Reads a file of CMU pushes.

        Returns:
            The pushes, named by their place in the log, each observed at its end only; and the
            block.

        Raises:
            PushLogError: the file cannot be read or is not of the format, or a push's tool does not
                move.
        """
        path = Path(path)
        logged = read_cmu(path)
        names = [str(i + 1) for i in range(len(logged))]
        return self.collect(path, names, lambda i, name: _observe(logged[i], name, self.calibrate))


def _observe(logged: CmuPush, name: str, calibrate: bool) -> ObservedPush:
    """Makes the log's entry of a push.

    Raises:
        PushError: the tool does not move.
    """
    q_before = _centroid_pose(logged.before)
    q_after = _centroid_pose(logged.after)
    tool = _without_standstill(_in_time_order(logged.tool))
    if tool is None:
        raise PushError("the tool does not move; expected a path, at times that increase")
    yaw = _calc_yaw(tool[:, 4:])
    t = tool[:, 0] - tool[0, 0]
    p = tool[:, 1:3] * M_PER_MM
    force = _force_on_object(logged.force, tool[:, 0], yaw)
    force_t = t
    if calibrate:
        t, p = _travel_on(t, _straightened(p + rotate(yaw, TIP_OFFSET)))
    # Everything is told in the object's frame at the push's beginning.
    push = Push.along(t, transform_back(q_before, p), TIP_RADIUS)
    end = compose(invert(q_before), q_after)
    end[2] = nearest_turn(float(end[2]), 0.0)
    return ObservedPush(
        name=name,
        push=push,
        pose=np.zeros(3),
        t_observed=np.array([push.duration]),
        poses_observed=end[None],
        force_t=force_t,
        force=rotate(-q_before[2], force),
    )


def _centroid_pose(pose: Array) -> Array:
    """Calculates the pose (3,) of B at the centroid, m and rad.

    Args:
        pose: (7,) logged pose of the block's corner, mm and quaternion w x y z.
    """
    yaw = float(_calc_yaw(pose[3:]))
    return compose([*pose[:2] * M_PER_MM, yaw], [*BLOCK_CENTROID, 0.0])


def _force_on_object(rows: Array, times: Array, yaw: Array) -> Array:
    """Calculates the force on the object, -R(yaw) R_tool (f - f_first).

    The sensor measures the force on the tool, and the first reading shows its offset.

    Args:
        rows: (F, 3) logged rows t fx fy, sensor frame, s and N.
        times: (K,) times at which the force is wanted, s.
        yaw: (K,) the tool's angle then, rad.

    Returns:
        (K, 2) the force, robot's frame, N.
    """
    rows = _in_time_order(rows)
    f = np.column_stack(
        [np.interp(times, rows[:, 0], rows[:, axis] - rows[0, axis]) for axis in (1, 2)]
    )
    return -rotate(yaw, f @ np.array(SENSOR_AXES).T)


def _straightened(p: Array) -> Array:
    """Projects a path on its best line, along which it never goes back.

    Args:
        p: (K, 2) the path, m.

    Returns:
        (K, 2) the projected path, m; the path itself where it is not straight.
    """
    center = p.mean(axis=0)
    along, across = np.linalg.svd(p - center, full_matrices=False)[2]
    if np.abs((p - center) @ across).max() > STRAIGHT_TOLERANCE:
        return p
    if (p[-1] - p[0]) @ along < 0:
        along = -along
    farthest_so_far = np.maximum.accumulate((p - center) @ along)
    return center + farthest_so_far[:, None] * along


def _travel_on(t: Array, p: Array) -> tuple[Array, Array]:
    """Adds a sample `TIP_EXTENSION` further on the line from the first to the last sample.

    Args:
        t: (K,) times, s.
        p: (K, 2) places, m.

    Returns:
        Times and places with the sample, which is reached at the mean speed.
    """
    travel = p[-1] - p[0]
    length = np.linalg.norm(travel)
    fraction = TIP_EXTENSION / length
    return np.append(t, t[-1] + fraction * t[-1]), np.vstack([p, p[-1] + fraction * travel])


def _in_time_order(rows: Array) -> Array:
    """Keeps the rows whose time (first column) is later than that of all before them."""
    t = rows[:, 0]
    return rows[np.append(True, t[1:] > np.maximum.accumulate(t)[:-1])]


def _without_standstill(tool: Array) -> Array | None:
    """Cuts off the rows in which the tool stands where it starts or where it ends.

    One such row is left at each end.

    Args:
        tool: (T, 8) the tool's rows.

    Returns:
        (K, 8) rows; None where the tool ends where it starts, or never leaves.
    """
    p = tool[:, 1:3] * M_PER_MM
    left = np.flatnonzero(np.linalg.norm(p - p[0], axis=1) > STANDSTILL_DISTANCE)
    not_yet = np.flatnonzero(np.linalg.norm(p - p[-1], axis=1) > STANDSTILL_DISTANCE)
    if np.linalg.norm(p[-1] - p[0]) <= STANDSTILL_DISTANCE or not len(left) or not len(not_yet):
        return None
    return tool[left[0] - 1 : not_yet[-1] + 2]


def _calc_yaw(q: Array) -> Array:
    """Calculates the angles (...,) about z, rad, of quaternions (..., 4), w x y z."""
    return np.asarray(Rotation.from_quat(q, scalar_first=True).as_euler("ZYX")[..., 0])

"""The text format of the CMU pushes (Zhou, Paolini, Bagnell, Mason, ICRA 2016), as numbers and no more.

One record a line, blanks between numbers: the number of pushes; then for each push the object's pose before
and its pose after (x y z, quaternion w x y z), the number of force rows and the rows (t fx fy), the number
of tool rows and the rows (t x y z qw qx qy qz). Lengths are in mm, times in s (absolute), forces in N and in
the sensor's frame.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import PushLogError
from gridpush_drake.files import read_text

POSE_FORM = "x y z (mm) qw qx qy qz"
FORCE_FORM = "t (s) fx fy (N)"
TOOL_FORM = "t (s) x y z (mm) qw qx qy qz"

POSE_SIZE, FORCE_SIZE, TOOL_SIZE = 7, 3, 8
"""Numbers on a line of each kind."""

QUATERNION_TOLERANCE = 1e-3
"""Largest difference of a quaternion's norm from 1."""


MAX_DIGITS = 9
"""Of a count."""

MAX_NUMBER = 1e12
"""Magnitude of a number, beyond which it is none that was logged."""

SHOWN = 60
"""Most characters of a bad line that a message repeats."""


class CmuPush(NamedTuple):
    """One push as logged.

    Attributes:
        before: (7,) the object's pose before, mm and quaternion w x y z, robot base frame.
        after: (7,) the same after.
        force: (F, 3) rows t fx fy, s and N, sensor frame.
        tool: (T, 8) rows t x y z qw qx qy qz, s, mm and quaternion, robot base frame.
    """

    before: NDArray[np.float64]
    after: NDArray[np.float64]
    force: NDArray[np.float64]
    tool: NDArray[np.float64]


def read_cmu(path: Path) -> list[CmuPush]:
    """Reads every push of a file.

    Args:
        path: the text file.

    Returns:
        The pushes, in the file's order.

    Raises:
        PushLogError: the file cannot be read, is cut short, goes on after its last push, or a line is not
            what it should be; the message names the file, the line and the expected form.
    """
    lines = _Lines(path)
    pushes = [_read_push(lines, i) for i in range(lines.count("the number of pushes"))]
    lines.expect_end()
    return pushes


def _read_push(lines: "_Lines", i: int) -> CmuPush:
    before = lines.table(1, POSE_SIZE, f"push {i + 1}: the object's pose before, {POSE_FORM}")[0]
    after = lines.table(1, POSE_SIZE, f"push {i + 1}: its pose after, {POSE_FORM}")[0]
    force_rows = lines.count(f"push {i + 1}: the number of force rows")
    force = lines.table(force_rows, FORCE_SIZE, f"push {i + 1}: a force row, {FORCE_FORM}")
    tool_rows = lines.count(f"push {i + 1}: the number of tool rows")
    tool = lines.table(tool_rows, TOOL_SIZE, f"push {i + 1}: a tool row, {TOOL_FORM}")
    return CmuPush(before, after, force, tool)


class _Lines:
    """The file's lines with something on them, taken from the top."""

    def __init__(self, path: Path) -> None:
        self._path = path
        text = read_text(path, "a file of the CMU pushes", PushLogError)
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

    def table(self, rows: int, size: int, what: str) -> NDArray[np.float64]:
        """Takes `rows` lines of `size` finite numbers; a size of at least 7 ends in a unit quaternion."""
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
            norm = float(np.linalg.norm(table[row, -4:])) if size >= POSE_SIZE else 1.0
            if abs(norm - 1) > QUATERNION_TOLERANCE:
                self._fail(number, words, f"{what} with a quaternion of length 1")
        return table

    def expect_end(self) -> None:
        """Refuses lines that are left."""
        if self._next < len(self._lines):
            self._fail(*self._lines[self._next], "the file's end after its last push")

    def _take(self, what: str) -> tuple[int, list[str]]:
        if self._next == len(self._lines):
            last = self._lines[-1][0] if self._lines else 0
            raise PushLogError(f"{self._path}, line {last + 1}: the file ends here; expected {what}")
        self._next += 1
        return self._lines[self._next - 1]

    def _fail(self, number: int, words: list[str], what: str) -> None:
        shown = " ".join(words)
        raise PushLogError(f"{self._path}, line {number}: is {shown[:SHOWN]!r}; expected {what}")

"""Importer of the CMU two-point pushes: one block, pushed by two tips at once (2015).

The tool turns about a center, or moves straight ahead, with both tips on one side of the block of
`cmu`. Its pose is known before and after each push. As pushes are chained, each is given in its own
initial object frame, as there.

The text format, in m, rad, s and N: the number of pushes; then for each push a line of its name,
`rotation` or `translation`, whether the block went with the tool (0 or 1) and whether the push can
be used (0 or 1); the block's pose before, its pose after (x y theta of the centroid); the command
(push point x y, normal x y, center x y, angle, gap, fraction that was logged); the number of tool
rows and the rows (t x y theta); and the number of force rows and the rows (t fx fy). The tool's
frame is midway between the tips' fronts, its x axis along the normal at the beginning.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import PushLogError
from gridpush_drake.geometry.se2 import Array, compose, invert, rotate, transform_back
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers.cmu import TIP_RADIUS, FileLines, TriangleBlockImporter
from gridpush_drake.pushes.observed_push import ObservedPush, nearest_turn
from gridpush_drake.pushes.push_log import PushLog

HEAD_FORM = "name, rotation or translation, stable (0 or 1), usable (0 or 1)"
POSE_FORM = "x y theta (m, rad)"
COMMAND_FORM = "point x y, normal x y, center x y, angle, gap, fraction (m, rad)"
TOOL_FORM = "t x y theta (s, m, rad)"
FORCE_FORM = "t fx fy (s, N)"

MOTIONS = ("rotation", "translation")
"""The kinds of motion that the first line of a push can name."""

HEAD_SIZE = 4
"""How many words the first line of a push has."""

COMMAND_SIZE = 9
"""How many numbers a command has."""

TOOL_SIZE = 4
"""How many numbers a row of the tool has."""

FORCE_SIZE = 3
"""How many numbers a row of the force has."""

TIP_CENTERS = ((-0.00098, -0.0258), (-0.00051, 0.0243))
"""Centers of the two tips in the tool's frame, m; found from where they touch the block at the
end of pushes."""

TWO_TIPS = PusherShape.discs(TIP_CENTERS, TIP_RADIUS)
"""The pusher of these pushes."""


class TwoPointPush(NamedTuple):
    """One push as logged, robot base frame.

    Attributes:
        name: month, day, hour and minute of its log, and its number there.
        stable: whether the block went with the tool.
        usable: whether nothing else moved the block.
        before, after: (3,) the block's poses, m and rad.
        command: (9,) what the tool was told.
        tool: (K, 4) rows t x y theta, s, m and rad; as commanded, to the end of the motion.
        force: (F, 3) rows t fx fy, s and N, on the block.
    """

    name: str
    stable: bool
    usable: bool
    before: Array
    after: Array
    command: Array
    tool: Array
    force: Array


def read_two_point(path: Path) -> list[TwoPointPush]:
    """Reads every push of a file that can be used, in its order.

    Raises:
        PushLogError: the file cannot be read, is cut short, goes on after its last push, a line is
            not what it should be, or no push can be used; the message names the file, and the line
            with its expected form.
    """
    lines = FileLines(path, "a file of the CMU two-point pushes")
    pushes = [push for push in lines.take_pushes(_read_push) if push.usable]
    if not pushes:
        raise PushLogError(f"{path}: no push can be used; expected a 1 at the end of a head")
    return pushes


def _read_push(lines: FileLines, i: int) -> TwoPointPush:
    """Takes the lines of push number i, from 0."""
    push = f"push {i + 1}"
    name, _, stable, usable = lines.words(HEAD_SIZE, f"{push}: {HEAD_FORM}")
    before = lines.table(1, 3, f"{push}: the block's pose before, {POSE_FORM}")[0]
    after = lines.table(1, 3, f"{push}: its pose after, {POSE_FORM}")[0]
    command = lines.table(1, COMMAND_SIZE, f"{push}: the command, {COMMAND_FORM}", False)[0]
    tool_rows = lines.count(f"{push}: the number of tool rows")
    tool = lines.table(tool_rows, TOOL_SIZE, f"{push}: a tool row, {TOOL_FORM}")
    force_rows = lines.count(f"{push}: the number of force rows")
    force = lines.table(force_rows, FORCE_SIZE, f"{push}: a force row, {FORCE_FORM}")
    return TwoPointPush(
        name=name,
        stable=stable == "1",
        usable=usable == "1",
        before=before,
        after=after,
        command=command,
        tool=tool,
        force=force,
    )


@dataclass(frozen=True)
class TwoPointImporter(TriangleBlockImporter):
    """Convert a log of CMU's triangular block, pushed by two tips at once (Zhou and others, 2015).

    Pushes that the log calls unusable are left out. Shuffled, no two neighbors are known to be
    chained.
    """

    file: ClassVar[str] = "LOG.txt"
    source: ClassVar[str] = "two-point pushes of the repository robinzhoucmu/MLab_EXP, as one text"

    def read(self, path: Path | str) -> tuple[PushLog, GridObject]:
        """Reads a file of two-point pushes.

        Returns:
            The pushes, named by their place in the log, each observed at its end only; and the
            block.

        Raises:
            PushLogError: the file cannot be read or is not of the format, or no push can be used.
        """
        path = Path(path)
        logged = read_two_point(path)
        names = [push.name for push in logged]
        return self.collect(path, names, lambda i, name: observe_two_point(logged[i], name))


def observe_two_point(logged: TwoPointPush, name: str) -> ObservedPush:
    """Makes the log's entry of a push, in the block's frame at its beginning.

    Raises:
        PushError: the tool's times do not increase.
    """
    t = logged.tool[:, 0] - logged.tool[0, 0]
    push = Push.along(
        t,
        transform_back(logged.before, logged.tool[:, 1:3]),
        shape=TWO_TIPS,
        yaw=logged.tool[:, 3] - logged.before[2],
    )
    # everything is told in the block's frame at the push's beginning
    end = compose(invert(logged.before), logged.after)
    end[2] = nearest_turn(float(end[2]), 0.0)
    # forces before the tool moves tell nothing
    force_t = logged.force[:, 0] - logged.tool[0, 0]
    kept = (force_t >= 0) & (force_t <= push.duration)
    return ObservedPush(
        name=name,
        push=push,
        pose=np.zeros(3),
        t_observed=np.array([push.duration]),
        poses_observed=end[None],
        force_t=force_t[kept],
        force=rotate(-logged.before[2], logged.force[kept, 1:]),
    )

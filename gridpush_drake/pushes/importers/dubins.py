"""Importer of runs in which two fingers push an object along planned curves (Zhou, 2017).

A run is one to three pushes, seen by a camera: between them the fingers are lifted, and nothing is
logged. Every push becomes one of the log, in the world frame of the file.

The file is CSV with the columns task, repeat, t (s), object_x, object_y, object_theta, robot_x,
robot_y, robot_theta (m and rad) and action. Object cells are empty where the camera did not see it.
The robot's frame is midway between the fingers, and its x axis points where they push. The camera
is late: what it tells at t is where the object was a little before. Its frame may be off the
robot's, by some millimeters and a degree, which shows by where the fingers lie on the outline.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import PushLogError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.csv_table import fail, is_empty, read_number, read_table
from gridpush_drake.pushes.importers import OBJECT_OPTION, require_object
from gridpush_drake.pushes.importers.camera_frame import find_camera_frame, place_in_robot_frame
from gridpush_drake.pushes.observed_push import ObservedPush, nearest_turn
from gridpush_drake.pushes.push_log import PushLog

OBJECT_COLUMNS = ("object_x", "object_y", "object_theta")
ROBOT_COLUMNS = ("robot_x", "robot_y", "robot_theta")
COLUMNS = ("task", "repeat", "t", *OBJECT_COLUMNS, *ROBOT_COLUMNS, "action")
"""Columns that a file has."""

FILE_FORM = "runs of two fingers (CSV)"
"""The expected form of a file, for messages."""

LIFTED_TIME = 1.0
"""Time between two rows, s, from which on the fingers were lifted in between."""

STILL_DISTANCE = 0.0001
"""Distance from where the fingers start (or end) within which they stand still, m: the log's
step."""


class _Observation(NamedTuple):
    """A row of a file: which push it is of, time, s, and poses (3,), m and rad; None if unseen."""

    push: tuple[str, str, str]
    t: float
    seen: list[float] | None
    robot: list[float]


class FingerPush(NamedTuple):
    """One push of a run, world frame of the file.

    Attributes:
        task, repeat: which run it is of.
        number: its number in the run, from 1.
        push: the fingers' path.
        before, after: (3,) mean poses of the object at rest, m and rad; None where it was not seen.
        during: when it was seen in between, s from the push's beginning, and its poses (3,).
    """

    task: str
    repeat: str
    number: int
    push: Push
    before: Array | None
    during: list[tuple[float, Array]]
    after: Array | None

    def observe(self) -> ObservedPush | None:
        """Makes the log's entry of a push; None where its beginning or its end was not seen."""
        if self.before is None or self.after is None:
            return None
        return ObservedPush(
            name=f"{self.task}_{self.repeat}_{self.number}",
            push=self.push,
            pose=self.before,
            t_observed=np.array([*(when for when, _ in self.during), self.push.duration]),
            poses_observed=np.array([*(pose for _, pose in self.during), self.after]),
        )


@dataclass(frozen=True)
class DubinsImporter:
    """Convert runs in which two fingers push an object along Dubins curves (Zhou, 2017).

    Poses that the camera repeats to the last digit are taken once, for the later ones may be old.
    """

    file: ClassVar[str] = "RUNS.csv"
    source: ClassVar[str] = "runs of a two-fingered pusher as one table, a row an observation"
    example: ClassVar[str] = "--object block.yaml"

    obj: GridObject | None = field(default=None, metadata=OBJECT_OPTION)
    finger_radius: float = field(
        default=0.0025, metadata={"help": "Radius of each of the two fingers, m."}
    )
    finger_distance: float = field(
        default=0.018, metadata={"help": "Distance of the fingers' centers, m."}
    )
    object_delay: float = field(
        default=0.14, metadata={"help": "How late the object's poses are, s."}
    )

    calibrate: bool = field(
        default=True,
        metadata={
            "help": "Find where the camera's frame is in the robot's, from where the fingers lie "
            "on the outline while they push."
        },
    )

    def __post_init__(self) -> None:
        for name in ("finger_radius", "finger_distance"):
            if not 0 < getattr(self, name) < np.inf:
                raise PushLogError(
                    f"--{name.replace('_', '-')}: is {getattr(self, name)!r}; expected a positive "
                    "number (m)"
                )
        if not 0 <= self.object_delay < LIFTED_TIME:
            raise PushLogError(
                f"--object-delay: is {self.object_delay!r}; expected 0 or more, less than "
                f"{LIFTED_TIME:g} (s)"
            )

    def read(self, path: Path | str) -> tuple[PushLog, GridObject]:
        """Reads the pushes of all runs of a file.

        Returns:
            The pushes, named by task, repeat and their number in the run; and the object.

        Raises:
            PushLogError: the file cannot be read or is not of its form, the object is missing, or
                no push is seen at its beginning and its end.
        """
        path = Path(path)
        obj = require_object(path, self.obj)
        pushes = [push.observe() for push in self.list_pushes(path)]
        seen = [push for push in pushes if push is not None]
        if not seen:
            raise PushLogError(
                f"{path}: no push is seen at its beginning and its end; expected {FILE_FORM}"
            )
        if self.calibrate:
            X_RC = find_camera_frame(obj, seen)
            seen = [place_in_robot_frame(push, X_RC) for push in seen]
        return PushLog(tuple(seen), str(path)), obj

    def list_pushes(self, path: Path) -> list[FingerPush]:
        """Lists the pushes of all runs of a file in their order, those that are not seen, too.

        Raises:
            PushLogError: the file cannot be read or is not of its form.
        """
        half = self.finger_distance / 2
        shape = PusherShape.discs([(0.0, -half), (0.0, half)], self.finger_radius)
        pushes = []
        numbers: dict[tuple[str, str], int] = {}
        for rows in _cut_pushes(_read_rows(path)):
            task, repeat, _ = rows[0].push
            number = numbers.get((task, repeat), 0) + 1
            push = _make_push(rows, number, shape, self.object_delay)
            if push is not None:
                numbers[task, repeat] = number
                pushes.append(push)
        return pushes


def _read_rows(path: Path) -> list[_Observation]:
    """Reads the rows of a file; a PushLogError names line and column of a wrong one."""

    def check_header(path: Path, line: int, header: list[str]) -> None:
        for name in COLUMNS:
            if name not in header:
                fail(path, line, name, f"is missing; expected the columns {','.join(COLUMNS)}")

    rows = []
    for line, cells in read_table(path, FILE_FORM, COLUMNS, check_header):
        read = {
            name: read_number(path, line, name, cells[name], "a finite number (s, m, rad)")
            for name in ("t", *OBJECT_COLUMNS, *ROBOT_COLUMNS)
            if not (name in OBJECT_COLUMNS and all(is_empty(cells[c]) for c in OBJECT_COLUMNS))
        }
        rows.append(
            _Observation(
                push=(cells["task"].strip(), cells["repeat"].strip(), cells["action"].strip()),
                t=read["t"],
                seen=[read[name] for name in OBJECT_COLUMNS] if "object_x" in read else None,
                robot=[read[name] for name in ROBOT_COLUMNS],
            )
        )
    return rows


def _cut_pushes(rows: list[_Observation]) -> list[list[_Observation]]:
    """Cuts rows into pushes: of one run and action, without a lift, at times that increase."""
    pushes: list[list[_Observation]] = []
    for before, row in pairwise([None, *rows]):
        assert row is not None
        # another run or action, or a lift in between, begins another push
        if before is None or row.push != before.push or row.t - before.t > LIFTED_TIME:
            pushes.append([])
        if not pushes[-1] or row.t > pushes[-1][-1].t:
            pushes[-1].append(row)
    return pushes


def _make_push(
    rows: list[_Observation], number: int, shape: PusherShape, delay: float
) -> FingerPush | None:
    """Makes a push of its rows; None where the fingers stand still."""
    robot = np.array([row.robot for row in rows])
    t = np.array([row.t for row in rows])
    moving = _find_motion(robot)
    if moving is None:
        return None
    begin, end = t[moving.start], t[moving.stop - 1]
    # What the camera saw, at the time when it was so; repeated poses may be old ones.
    seen: list[tuple[float, Array]] = []
    for row in rows:
        if row.seen is None or (seen and row.seen[:2] == seen[-1][1][:2].tolist()):
            continue
        pose = np.array(row.seen)
        if seen:
            pose[2] = nearest_turn(float(pose[2]), float(seen[-1][1][2]))
        seen.append((row.t - delay, pose))
    # the poses at rest before and after the motion, and those in between
    first = [pose for when, pose in seen if when <= begin]
    after = [pose for when, pose in seen if when >= end]
    task, repeat, _ = rows[0].push
    return FingerPush(
        task=task,
        repeat=repeat,
        number=number,
        push=Push.along(t[moving], robot[moving, :2], shape=shape, yaw=np.unwrap(robot[moving, 2])),
        before=np.mean(first, axis=0) if first else None,
        during=[(when - begin, pose) for when, pose in seen if begin < when < end],
        after=np.mean(after, axis=0) if after else None,
    )


def _find_motion(robot: Array) -> slice | None:
    """Finds the rows from the last before the fingers move to the first in which they stand again.

    Args:
        robot: (K, 3) poses, m and rad.
    """
    # where they have left their first place, and where they have not yet reached the last
    left = np.flatnonzero(np.linalg.norm(robot[:, :2] - robot[0, :2], axis=1) > STILL_DISTANCE)
    not_yet = np.flatnonzero(np.linalg.norm(robot[:, :2] - robot[-1, :2], axis=1) > STILL_DISTANCE)
    if not len(left) or not len(not_yet):
        return None
    return slice(max(int(left[0]) - 1, 0), min(int(not_yet[-1]) + 2, len(robot)))

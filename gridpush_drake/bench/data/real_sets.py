"""Sets of real pushes with what a judge must know of them, and how a set is divided.

A division keeps on one side what would give answers away: equal actions of two-point pushes, which
were made again on other days, and all runs from one start to the goal. Pushes of other kinds are
divided by chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, groupby
from math import radians
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist
from shapely import Polygon

from gridpush_drake.bench.data.real_logs import (
    CMU_LOG,
    CMU_RHO,
    DUBINS_LOG,
    IMPORTED_LOG,
    OUTLINE_ENDING,
    SIMULATED_LOG,
    TWO_POINT_LOG,
    simulate_log,
)
from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array, compose, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import OBJECT_FILE
from gridpush_drake.pushes.csv_table import fail, read_number, read_table
from gridpush_drake.pushes.importers import find_importer
from gridpush_drake.pushes.importers.camera_frame import find_camera_frame, place_in_robot_frame
from gridpush_drake.pushes.importers.cmu import triangle_block
from gridpush_drake.pushes.importers.dubins import DubinsImporter
from gridpush_drake.pushes.importers.two_point import observe_two_point, read_two_point
from gridpush_drake.pushes.push_log import PushLog

ACTION_TOLERANCE = np.array([0.001, 0.001, 0.1, 0.1, 0.001, 0.001, 0.01, 0.001])
"""Largest differences of equal two-point actions: point x y (m), normal x y, center x y (m), angle
(rad) and gap (m). Robots repeat them to 0.1 mm."""

PUSH_COUNTS = (5, 25)
"""Numbers of pushes to learn from."""

RUN_COUNTS = (3,)
"""Numbers of runs to learn from."""

MAX_CELLS = 60
"""Largest number of cells of an object of which a set has the outline alone."""

OUTLINE_TOLERANCE = 0.0001
"""How far an outline that is read may be from the file's, m: corners that tell no more are left
out."""

MAX_SLIP = {TWO_POINT_LOG: (0.003, radians(5.0)), DUBINS_LOG: (0.0015, radians(1.5))}
"""How far an object may slip from its pusher, m and rad, in a push that is called stable, by the
kind of the set. Most who judged the two-point pushes by eye drew the line there."""

START_GAP = {TWO_POINT_LOG: 0.002, DUBINS_LOG: 0.01}
"""How far a tip may be from the outline where a push begins, m, by the kind of the set."""

REPEATED = {CMU_LOG: 0.0014}
"""What a push differs by when it is made again, m, where the set itself does not show it."""


class LiftedRun(NamedTuple):
    """Pushes that follow one another, between which the pusher is lifted.

    Attributes:
        group: number of its group, as of its pushes.
        pose: (3,) where the object is first seen at rest, m and rad.
        pushes: the pushes from there on.
        end: (3,) where it is seen at rest at last.
        seen: numbers of those pushes in the set's log, which has the ones that were seen.
    """

    group: int
    pose: Array
    pushes: tuple[Push, ...]
    end: Array
    seen: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class RealSet:
    """Pushes of an object, and what a judge knows of them.

    Attributes:
        kind: kind of the set, of `real_logs`.
        log: the pushes.
        obj: the object.
        groups: of each push the number of its group, which is never divided.
        runs: the runs; none where each push is by itself.
        stayed: of each push whether the object went with the pusher, as those who made it say; None
            where nobody says.
    """

    kind: str
    log: PushLog
    obj: GridObject
    groups: tuple[int, ...]
    runs: tuple[LiftedRun, ...] = ()
    stayed: tuple[bool, ...] | None = None

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of pushes, or of runs, to learn from."""
        return RUN_COUNTS if self.runs else PUSH_COUNTS

    def calc_repeatability(self) -> float | None:
        """Calculates what a push differs by when it is made again, m; None where none was.

        It is the mean over all pairs of equal two-point pushes, or of last poses of runs to one
        goal.
        """
        if self.kind in REPEATED:
            return REPEATED[self.kind]
        if self.stayed is None and not self.runs:
            return None
        ends = [(run.group, run.end) for run in self.runs] or [
            (group, seen.final_pose) for group, seen in zip(self.groups, self.log, strict=True)
        ]
        found = [
            calc_error(one, other)
            for (of, one), (beside, other) in combinations(ends, 2)
            if of == beside
        ]
        return float(np.mean(found)) if found else None


@dataclass(frozen=True)
class Division:
    """Numbers of the pushes of a set on both sides.

    Attributes:
        test: held-out pushes.
        test_runs: numbers of the held-out runs.
        training: pushes to learn from, by their number or that of their runs.
    """

    test: tuple[int, ...]
    test_runs: tuple[int, ...]
    training: dict[int, tuple[int, ...]]


def calc_error(one: Array, other: Array) -> float:
    """Calculates |dxy| + rho |dtheta| of two poses (3,), m."""
    dx, dy, turn = one - other
    return float(np.hypot(dx, dy) + CMU_RHO * abs(wrap_angle(turn)))


def divide(known: RealSet, test: int, seed: int, number: int) -> Division:
    """Divides a set.

    Args:
        known: the set.
        test: number of held-out pushes; of runs, those of one group are held out.
        seed: seed of everything random.
        number: number of the division.

    Returns:
        The division.
    """
    rng = np.random.default_rng([seed, number])
    if known.runs:
        goals = list(dict.fromkeys(run.group for run in known.runs))
        goal = goals[number % len(goals)]
        held_out = tuple(i for i, run in enumerate(known.runs) if run.group == goal)
        others = [run for run in known.runs if run.group != goal]
        order = rng.permutation(len(others))
        training = {
            count: tuple(i for at in order[:count] for i in others[at].seen)
            for count in known.counts
        }
        test_pushes = tuple(i for run in held_out for i in known.runs[run].seen)
        return Division(test_pushes, held_out, training)
    order = rng.permutation(len(known.log))
    chosen = tuple(int(i) for i in order[:test])
    groups = {known.groups[i] for i in chosen}
    rest = [int(i) for i in order[test:] if known.groups[i] not in groups]
    return Division(chosen, (), {count: tuple(rest[:count]) for count in known.counts})


def place_runs(known: RealSet, training: Sequence[int]) -> RealSet:
    """Moves poses that a camera saw to the robot's frame, as pushes that are learned from show it.

    Args:
        known: a set; one without runs stays as it is.
        training: numbers of the pushes from which may be learned.
    """
    if not known.runs:
        return known
    X_RC = find_camera_frame(known.obj, known.log.subset(training))
    runs = [
        run._replace(pose=compose(X_RC, run.pose), end=compose(X_RC, run.end)) for run in known.runs
    ]
    placed = [place_in_robot_frame(seen, X_RC) for seen in known.log]
    return replace(known, log=PushLog(tuple(placed), known.log.source), runs=tuple(runs))


@lru_cache(maxsize=1)
def read_set(path: Path, kind: str) -> RealSet:
    """Reads a set of real pushes. The center of mass of a CMU plate is told: it is even.

    Raises:
        PushLogError: it cannot be read.
    """
    if kind == TWO_POINT_LOG:
        return _read_two_point(path)
    if kind == DUBINS_LOG:
        return _read_runs(path)
    if kind == IMPORTED_LOG:
        obj = GridObject.from_yaml(path.with_name(OBJECT_FILE))
        log = PushLog.read_csv(path, obj.prior.pusher_radius)
    else:
        log, obj = find_importer(kind)().read(path)
    if kind == CMU_LOG:
        obj = replace(obj, prior=replace(obj.prior, center_of_mass=(0.0, 0.0)))
    return RealSet(kind, log, obj, tuple(range(len(log))))


def simulate_set(path: Path, seed: int, number: int) -> RealSet:
    """Simulates pushes of the object of a file, which stand in for real ones."""
    log, obj = simulate_log(path, seed, number)
    return RealSet(SIMULATED_LOG, log, obj, tuple(range(len(log))))


def _read_two_point(path: Path) -> RealSet:
    """Reads two-point pushes; equal actions are a group."""
    logged = read_two_point(path)
    pushes = [observe_two_point(push, f"push_{i}") for i, push in enumerate(logged, start=1)]
    actions = np.array([push.command[: len(ACTION_TOLERANCE)] for push in logged])
    actions /= ACTION_TOLERANCE
    _, groups = connected_components(cdist(actions, actions, "chebyshev") <= 1.0)
    return RealSet(
        kind=TWO_POINT_LOG,
        log=PushLog(tuple(pushes), str(path)),
        obj=triangle_block(uniform_plate=True),
        groups=tuple(int(group) for group in groups),
        stayed=tuple(push.stable for push in logged),
    )


def _read_runs(path: Path) -> RealSet:
    """Reads runs of two fingers, and the outline beside; runs to one goal are a group."""
    beside = path.with_name(path.stem + OUTLINE_ENDING)
    outline = [
        [read_number(beside, line, name, cells[name], "a finite number (m)") for name in "xy"]
        for line, cells in read_table(beside, "an outline (columns x,y; m)", "xy", _check_outline)
    ]
    polygon = Polygon(outline).simplify(OUTLINE_TOLERANCE)
    obj = GridObject.from_outline(polygon, max_cells=MAX_CELLS, name=path.stem)
    importer = DubinsImporter(obj, calibrate=False)
    log, _ = importer.read(path)
    logged = importer.list_pushes(path)
    tasks = list(dict.fromkeys(push.task for push in logged))
    numbers = {seen.name: i for i, seen in enumerate(log)}
    runs = []
    for (task, _), of_run in groupby(logged, key=lambda push: (push.task, push.repeat)):
        pushes = list(of_run)
        pose, end = pushes[0].before, pushes[-1].after
        if pose is not None and end is not None:
            seen = [made.name for push in pushes if (made := push.observe()) is not None]
            run = LiftedRun(
                group=tasks.index(task),
                pose=pose,
                pushes=tuple(push.push for push in pushes),
                end=end,
                seen=tuple(numbers[name] for name in seen),
            )
            runs.append(run)
    group_of = {i: run.group for run in runs for i in run.seen}
    return RealSet(
        kind=DUBINS_LOG,
        log=log,
        obj=obj,
        groups=tuple(group_of.get(i, -1) for i in range(len(log))),
        runs=tuple(runs),
    )


def _check_outline(path: Path, line: int, header: Sequence[str]) -> None:
    """Raises PushLogError where a table has no columns x and y."""
    for name in "xy":
        if name not in header:
            fail(path, line, name, "is missing; expected the columns x,y")

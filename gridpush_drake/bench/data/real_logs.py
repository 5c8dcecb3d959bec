"""Logs for `gridpush bench real` and `reality`: those of real robots below a folder, or simulated.

Real logs are public data of other people. Simulated ones stand in where there are none: masses and
frictions are hidden, drawn by part, every push begins at a random place of the outline, and the
object is seen with noise at the push's beginning and end.
"""

import csv
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.io import whosmat

from gridpush_drake.bench.data.protocol import MASS_RANGE, add_pose_noise, check_folder, hide_parts
from gridpush_drake.bench.worlds.plant import draw_push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import OBJECT_FILE
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.importers.cmu import POSE_SIZE
from gridpush_drake.pushes.importers.dubins import COLUMNS
from gridpush_drake.pushes.importers.two_point import HEAD_SIZE, MOTIONS
from gridpush_drake.pushes.push_csv import REQUIRED_COLUMNS
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

SIMULATED_PUSH_COUNT = 50
"""Number of pushes of a simulated log, as many as the CMU's have."""

FRICTION_RANGE = (0.2, 0.5)
"""Least and greatest friction of a part against the support."""

CMU_RHO = 0.05 * 2**0.5
"""Length by which the CMU's metric multiplies an angle, m."""

CMU_LOG = "cmu"
"""Kind of a log of the CMU's."""

MIT_LOG = "mit"
"""Kind of a log of the MIT's."""

TWO_POINT_LOG = "two-point"
"""Kind of a log of the CMU's pushes by two tips."""

DUBINS_LOG = "dubins"
"""Kind of a log of runs in which two fingers push along planned curves."""

IMPORTED_LOG = "imported"
"""Kind of a push log in this package's own form, with its object's file beside."""

OUTLINE_ENDING = "_outline.csv"
"""Ending of the name of the file beside such a log that has the outline of what is pushed: columns
x and y, m, counterclockwise in the frame of the logged poses, as far as that is known."""

SIMULATED_LOG = "simulated"
"""Kind of a log that is simulated."""


@lru_cache(maxsize=1)
def simulate_log(path: Path, seed: int, number: int) -> tuple[PushLog, GridObject]:
    """Simulates a log of pushes of an object, quasi-static.

    Args:
        path: the object's file.
        seed: seed of everything random.
        number: number of the log; each has hidden parameters, pushes and noise of its own.

    Returns:
        The pushes, and the object as whoever learns sees it: one part of unknown mass.

    Raises:
        ObjectError: the file cannot be read.
        PushError: hardly any push moves the object.
    """
    obj = GridObject.from_yaml(path)
    rng = np.random.default_rng([seed, number])
    truth_seed, first = (int(value) for value in rng.integers(2**31, size=2))
    truth = CellParameters.random(obj, truth_seed, MASS_RANGE, FRICTION_RANGE)
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    world = SimulatedWorld(Model(obj, truth), (0.0, 0.0, 0.0))
    pushes = []
    for i in range(SIMULATED_PUSH_COUNT):
        push, pose = draw_push(Model(obj, truth), first + i, radius)
        world.put(pose)
        last = world.execute(push).final_pose
        before = add_pose_noise(pose, rng)
        after = add_pose_noise(last, rng)
        pushes.append(
            ObservedPush(f"push_{i + 1:02d}", push, before, np.array([push.duration]), after[None])
        )
    plain = replace(obj, prior=replace(obj.prior, total_mass=None))
    log = PushLog(tuple(pushes), source=f"{obj.name}, simulated, number {number}")
    return log, hide_parts(plain)


CMU_SOURCE = "GitHub robinzhoucmu/MLab_EXP"
"""Where the CMU's pushes are."""

MIT_SOURCE = "GitHub robinzhoucmu/PlanarManipulationToolBox"
"""Where the MIT's pushes are."""

RECORDS_VARIABLE = "record_all"
"""Name of the variable of a MATLAB file that holds pushes."""


def find_push_logs(
    data: Path, min_pushes: int, kinds: Collection[str] = (CMU_LOG, MIT_LOG)
) -> list[tuple[str, Path]]:
    """Finds real robots' push logs below a folder.

    Args:
        data: the folder.
        min_pushes: text files with fewer pushes are passed over.
        kinds: kinds of logs that are wanted.

    Returns:
        Kind and file of each log, kind by kind.

    Raises:
        GridPushError: there is no such folder, or no push log in it.
    """
    expected = (
        f"push logs as of {CMU_SOURCE} (text files of {min_pushes} or more pushes) or of "
        f"{MIT_SOURCE} (.mat)"
    )
    if DUBINS_LOG in kinds:
        expected += f", or runs of two fingers (NAME.csv, with NAME{OUTLINE_ENDING} beside)"
    if IMPORTED_LOG in kinds:
        expected += f", or folders that `gridpush import` wrote ({OBJECT_FILE} beside)"
    check_folder(data, expected)
    texts = [(_count_pushes(path), path) for path in sorted(data.rglob("*.txt"))]
    logs = [
        (kind, path)
        for kind in (CMU_LOG, TWO_POINT_LOG)
        for (of, count), path in texts
        if of == kind and count >= min_pushes
    ]
    logs += [(MIT_LOG, path) for path in sorted(data.rglob("*.mat")) if _has_records(path)]
    logs += [(DUBINS_LOG, path) for path in sorted(data.rglob("*.csv")) if _has_runs(path)]
    if IMPORTED_LOG in kinds:
        logs += [
            (IMPORTED_LOG, path)
            for beside in sorted(data.rglob(OBJECT_FILE))
            for path in sorted(beside.parent.glob("*.csv"))
            if _count_imported(path) >= min_pushes
        ]
    logs = [(kind, path) for kind, path in logs if kind in kinds]
    if not logs:
        raise GridPushError(f"{data}: holds no push log; expected {expected}")
    return logs


def _count_pushes(path: Path) -> tuple[str, int]:
    """Reads of which of the CMU's forms a text is, and how many pushes it says that it has."""
    try:
        with path.open() as file:
            count, first, second = (file.readline().split() for _ in range(3))
        if len(count) == 1 and len(first) == len(second) == POSE_SIZE:
            return CMU_LOG, int(count[0])
        if len(count) == 1 and len(first) == HEAD_SIZE and first[1] in MOTIONS:
            return TWO_POINT_LOG, int(count[0])
    except (OSError, ValueError):
        pass
    return "", 0


def _has_runs(path: Path) -> bool:
    """Says whether a table holds runs of two fingers."""
    try:
        with path.open(newline="") as file:
            return set(COLUMNS) <= set(next(csv.reader(file), []))
    except (OSError, ValueError, csv.Error):
        return False


def _count_imported(path: Path) -> int:
    """Counts the pushes of a table in this package's own form; 0 where it is another table."""
    try:
        with path.open(newline="") as file:
            rows = csv.DictReader(file)
            if not set(REQUIRED_COLUMNS) <= set(rows.fieldnames or ()):
                return 0
            return len({row[REQUIRED_COLUMNS[0]] for row in rows})
    except (OSError, ValueError, csv.Error):
        return 0


def _has_records(path: Path) -> bool:
    """Says whether a file is one of MATLAB's that holds pushes."""
    try:
        return any(name == RECORDS_VARIABLE for name, _, _ in whosmat(path))
    except (OSError, ValueError, TypeError, NotImplementedError):
        return False


def name_logs(logs: Sequence[tuple[str, Path]]) -> list[tuple[str, str, Path]]:
    """Names each log by its file, with as many of its folders as tell it from the others.

    An imported one is named by its folder.
    """
    names = {path: path.parent.name if kind == IMPORTED_LOG else path.stem for kind, path in logs}
    for depth in range(1, max(len(path.parts) for path in names)):
        twice = [path for path, name in names.items() if list(names.values()).count(name) > 1]
        names |= {path: "/".join((*path.parts[-1 - depth : -1], path.stem)) for path in twice}
    return [(names[path], kind, path) for kind, path in logs]

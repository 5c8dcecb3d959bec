"""Importer of runs in which a controller pushed without a break: JSON of Hogan and Rodriguez.

The file is one JSON object. Its lists have an entry for each period of the controller, mostly 1 ms:

    timeJSON              times, s
    q_sliderJSON          three lists: x, y (m) and theta (rad) of the object
    q_pusher_sensedJSON   two lists: x and y of the center of the tip, m

Other keys are passed over. Entries may be null, and one list may be longer than another, as the run
was ended while they were written: what is behind the end of the shortest one is not used. The
object's pose is repeated until a new one comes, mostly every 4 ms, and counts where it is new.

Such a run has no pushes in it that begin and end. So it is cut into *windows* of one length, which
follow one another, and each window is a push. A window says nothing of the object, and is left out,
if the tip does not push in it, or if the object moves while the tip is away from it: then somebody
has helped with his hand.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar
from warnings import warn

import numpy as np
import shapely
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import choose_pusher_radius
from gridpush_drake.errors import MAX_NUMBER, PushLogError, PushLogWarning
from gridpush_drake.files import read_text
from gridpush_drake.geometry.se2 import Array, transform_back
from gridpush_drake.notebook import count
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers import OBJECT_OPTION, require_object
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import name_push

EXPECTED_RUN = (
    "a run as JSON with the keys timeJSON (K numbers), q_sliderJSON (3 lists of K numbers) and "
    "q_pusher_sensedJSON (2 lists of K numbers)"
)

LIST_COUNTS = {"q_sliderJSON": 3, "q_pusher_sensedJSON": 2}
"""Number of lists that each key holds."""

MAX_RUN_SIZE = 512 * 2**20
"""Largest file that is read, bytes: 30 minutes at 1 kHz."""

REST_PERIOD = 0.02
"""Time after which a pose counts as seen anew although it is the same as before, s: an object at
rest may give the same numbers again and again."""

MAX_GAP = 0.1
"""Longest time within a window in which the object or the tip is not seen, s."""

TOUCH_GAP = 0.003
"""Gap between tip and object up to which they may touch, m: the errors of both places added up."""

MIN_WAY = 0.001
"""Least way of the tip in a window that tells something of the object, m."""

HELPED_WAY = 0.002
"""If the object moves by more than this in a window while the tip is away from it, it was helped,
m; root mean square over its cells."""

MAX_POSES = 250
"""Most poses of a window that are kept, evenly."""


@dataclass(frozen=True, eq=False)
class ClosedLoopRun:
    """A run at the times at which the object was seen anew.

    Attributes:
        t: (K,) times, s, increasing.
        poses: (K, 3) q_W of the object, m and rad, theta without jumps.
        tip: (K, 2) p_WP of the tip's center, m.
    """

    t: Array
    poses: Array
    tip: Array


@dataclass(frozen=True)
class ClosedLoopImporter:
    """Convert a run in which a controller pushed without a break (RUN.json)."""

    file: ClassVar[str] = "RUN.json"
    source: ClassVar[str] = "JSON with q_sliderJSON, q_pusher_sensedJSON and timeJSON"
    example: ClassVar[str] = "--object block.yaml"

    obj: GridObject | None = field(default=None, metadata=OBJECT_OPTION)
    window: float = field(
        default=1.0,
        metadata={"help": "Length of the windows into which the run is cut, s."},
    )

    def read(self, path: Path | str) -> tuple[PushLog, GridObject]:
        """Reads a run, and cuts it into windows, each of which is a push.

        Raises:
            PushLogError: the file cannot be read or is not of its form, an option is missing or
                out of range, or the tip pushes the object in no window.

        Warns:
            PushLogWarning: the object moved in some windows while the tip was away from it.
        """
        path = Path(path)
        obj = require_object(path, self.obj)
        if not 0 < self.window < MAX_NUMBER:
            raise PushLogError(f"--window: is {self.window!r}; expected a positive number (s)")
        run = read_run(path)
        radius = choose_pusher_radius(obj)
        touching = _find_contact(obj, run, radius) <= TOUCH_GAP

        pushes: list[ObservedPush] = []
        helped = 0
        for part in _cut(run, self.window):
            way = np.linalg.norm(np.diff(run.tip[part], axis=0), axis=1).sum()
            if not touching[part].any() or way < MIN_WAY:
                continue
            if np.diff(run.t[part]).max() > MAX_GAP:
                continue
            if _measure_free_way(obj, run.poses[part], touching[part]) > HELPED_WAY:
                helped += 1
                continue
            pushes.append(_make_push(run, part, radius, name_push(len(pushes))))
        if not pushes:
            raise PushLogError(
                f"{path}: the tip pushes {obj.name} in no window of {self.window:g} s; are "
                "the object's frame and the radius of the tip those of the run?"
            )
        if helped:
            windows = count(helped, "window")
            warn(
                f"{path}: {windows} left out, in which the object moves though the tip is away "
                "from it, as if a hand had helped",
                PushLogWarning,
                stacklevel=2,
            )
        return PushLog(tuple(pushes), str(path)), obj


def read_run(path: Path) -> ClosedLoopRun:
    """Reads a run at the times at which the object was seen anew.

    Raises:
        PushLogError: the file cannot be read or is not of its form; the message names the file and
            the key.
    """
    text = read_text(path, EXPECTED_RUN, PushLogError, MAX_RUN_SIZE)
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PushLogError(f"{path}: is no JSON ({error}); expected {EXPECTED_RUN}") from error
    if not isinstance(data, dict):
        raise PushLogError(f"{path}: is no JSON object; expected {EXPECTED_RUN}")
    lists = {"timeJSON": [_read_numbers(path, "timeJSON", data.get("timeJSON"))]}
    for key, expected in LIST_COUNTS.items():
        value = data.get(key)
        if not isinstance(value, list) or len(value) != expected:
            raise PushLogError(f"{path}: {key}: expected {expected} lists of numbers")
        lists[key] = [_read_numbers(path, key, one) for one in value]

    # What is behind the end of the shortest list is not used, nor rows with a null.
    length = min(len(one) for each in lists.values() for one in each)
    t = lists["timeJSON"][0][:length]
    poses = np.column_stack([one[:length] for one in lists["q_sliderJSON"]])
    tip = np.column_stack([one[:length] for one in lists["q_pusher_sensedJSON"]])
    known = np.isfinite(np.column_stack([t, poses, tip])).all(axis=1)
    if known.sum() < 2:
        raise PushLogError(f"{path}: has {known.sum()} whole rows; expected two or more")

    # Two threads wrote the lists: a time that is not after all others before it is none.
    rows = np.flatnonzero(known)
    rows = rows[np.append(True, t[rows[1:]] > np.maximum.accumulate(t[rows])[:-1])]
    rows = rows[_find_new(t[rows], poses[rows])]
    poses = poses[rows]
    poses[:, 2] = np.unwrap(poses[:, 2])
    return ClosedLoopRun(t[rows], poses, tip[rows])


def _read_numbers(path: Path, key: str, value: Any) -> Array:
    """Reads a list of numbers, (K,); NaN where one is null."""
    if not isinstance(value, list):
        raise PushLogError(f"{path}: {key}: expected a list of numbers")
    for i, one in enumerate(value):
        is_number = isinstance(one, int | float) and not isinstance(one, bool)
        if one is not None and not (is_number and abs(one) <= MAX_NUMBER):
            raise PushLogError(
                f"{path}: {key}: entry {i + 1} is {str(one)[:60]!r}; expected a finite number, or "
                "null where it is not known"
            )
    return np.array([np.nan if one is None else one for one in value], dtype=np.float64)


def _find_new(t: Array, poses: Array) -> NDArray[np.bool_]:
    """Finds the rows (K,) in which the pose is new, or at rest since long enough."""
    new = np.zeros(len(t), dtype=bool)
    new[0] = True
    changed = np.append(True, (np.diff(poses, axis=0) != 0).any(axis=1))
    last = t[0]
    for i in range(1, len(t)):
        if changed[i] or t[i] - last >= REST_PERIOD:
            new[i] = True
            last = t[i]
    return new


def _find_contact(obj: GridObject, run: ClosedLoopRun, radius: float) -> Array:
    """Calculates the gap between tip and object, (K,), m; negative where they overlap."""
    p_BP = transform_back(run.poses, run.tip[:, None])[:, 0]
    gap: Array = shapely.distance(obj.outline, shapely.points(p_BP)) - radius
    return gap


def _cut(run: ClosedLoopRun, window: float) -> list[slice]:
    """Cuts a run into windows of one length, s, each with the first pose of the next one."""
    edges = np.arange(run.t[0], run.t[-1] - window / 2, window)
    first = np.searchsorted(run.t, edges)
    last = np.searchsorted(run.t, edges + window, side="right") - 1
    return [slice(a, b + 1) for a, b in zip(first, last, strict=True) if b - a >= 2]


def _measure_free_way(obj: GridObject, poses: Array, touching: NDArray[np.bool_]) -> float:
    """Measures how far the object has moved while the tip was away from it.

    Args:
        obj: the object.
        poses: (K, 3) its poses, m and rad.
        touching: (K,) whether the tip may touch it.

    Returns:
        The longest of these motions, m, root mean square over its cells.
    """
    cells = obj.cells_at(poses)
    longest = 0.0
    away = np.flatnonzero(~touching)
    # each stretch of neighboring rows by itself
    for stretch in np.split(away, np.flatnonzero(np.diff(away) > 1) + 1):
        if len(stretch) > 1:
            moved = cells[stretch[-1]] - cells[stretch[0]]
            longest = max(longest, float(np.sqrt(np.square(moved).sum(axis=-1).mean())))
    return longest


def _make_push(run: ClosedLoopRun, part: slice, radius: float, name: str) -> ObservedPush:
    """Makes a push of a window."""
    t = run.t[part] - run.t[part.start]
    rows = np.unique(np.linspace(0, len(t) - 1, min(len(t), MAX_POSES + 1)).round().astype(int))
    poses = run.poses[part][rows]
    push = Push.along(t[rows], run.tip[part][rows], radius)
    return ObservedPush(
        name=name, push=push, pose=poses[0], t_observed=push.t[1:], poses_observed=poses[1:]
    )

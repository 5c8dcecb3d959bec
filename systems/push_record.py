"""From what was seen during a push to the entry of a push log.

The first pose is the mean of the looks at the object at rest before it, the last one that of the looks after it;
between them a few single looks are kept, evenly spread along the tip's way. The tip's path is as measured, without the
samples that straight lines between the others replace to within `path_tolerance`.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray
from shapely import LineString

from gridpush_drake.dynamics.push import Push
from gridpush_drake.grid.object import GridObject
from gridpush_drake.pushes.log import ObservedPush, nearest_turn
from gridpush_drake.systems.push_segmenter import Episode, Sample

Array = NDArray[np.float64]

SAME_TIME = 1e-6
"""s; times that differ by less are one."""

LATEST = 5
"""Looks at the end whose median tells where the object rests."""


@dataclass(frozen=True)
class RecordOptions:
    """How a push is written down.

    Attributes:
        observations: most poses a push, the last one included.
        least_distance: of the tip; less is no push, m.
        reach: a tip that never came closer to the object than its radius and this did not push it, m.
        path_tolerance: by which the thinned path may differ from the measured one, m.
        still: the tip has not yet, or no longer, moved within this of its first, or last, place, m.
        coast: how long the object may slide on after the tip's stop, s.
        rest_tolerance: looks further than this from where the object rests are not of that rest, m.
        rest_angle_tolerance: likewise, rad.
        pose_delay: how old a pose is when it is read, s.
    """

    observations: int = 10
    least_distance: float = 0.005
    reach: float = 0.005
    path_tolerance: float = 5e-5
    still: float = 5e-5
    coast: float = 0.1
    rest_tolerance: float = 0.003
    rest_angle_tolerance: float = 0.03
    pose_delay: float = 0.0


def make_observed_push(
    episode: Episode, obj: GridObject, radius: float, name: str, options: RecordOptions
) -> ObservedPush | None:
    """Makes the log's entry.

    Args:
        episode: what was seen.
        obj: the object.
        radius: of the tip, m.
        name: what to call the push.
        options: see `RecordOptions`.

    Returns:
        The push; None where the tip hardly moved or never came near the object, or where the object was not seen both
        before and after.
    """
    pose = calc_rest_pose(episode.before, options)
    t, xy = _trim(episode.path, options.still)
    if pose is None or len(t) < 2:
        return None
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    if way[-1] < options.least_distance or _calc_distance(obj, pose, xy) > radius + options.reach:
        return None
    end, t, xy = _add_coast(episode, t, xy, options.coast)
    way = np.append(way, np.full(len(t) - len(way), way[-1]))
    settled = [look for look in episode.after if look.t - options.pose_delay >= t[-1]]
    last = calc_rest_pose(settled, options)
    seen = _choose_looks(episode.path, t, way, end, options, up_to_end=last is None)
    if last is not None:
        seen = [(time, look) for time, look in seen if time < t[-1]] + [(float(t[-1]), last)]
    if not seen:
        return None
    times = np.array([time for time, _ in seen])
    t, xy = thin_path(t, xy, times, options.path_tolerance)
    return ObservedPush(name, Push.along(t - t[0], xy, radius), pose, times - t[0], _continue_turns(pose, seen))


def calc_rest_pose(looks: tuple[Sample, ...] | list[Sample], options: RecordOptions) -> Array | None:
    """Mean of the latest looks at one pose; None where the object was not seen.

    Starting from the last look, all within the tolerance of the last few's median count, up to the first two in a row
    that do not: before them the object lay elsewhere. A single one is a bad look.
    """
    poses = np.array([look.pose for look in looks if np.isfinite(look.pose).all()])
    if not len(poses):
        return None
    theta = poses[-1, 2]
    poses[:, 2] = theta + (poses[:, 2] - theta + pi) % (2 * pi) - pi
    off = poses - np.median(poses[-LATEST:], axis=0)
    good = np.hypot(off[:, 0], off[:, 1]) <= options.rest_tolerance
    good &= np.abs(off[:, 2]) <= options.rest_angle_tolerance
    elsewhere = np.flatnonzero(~(good[:-1] | good[1:]))
    if len(elsewhere):
        good[: elsewhere[-1] + 1] = False
    return poses[good].mean(axis=0) if good.any() else np.median(poses[-LATEST:], axis=0)


def thin_path(t: Array, xy: Array, keep: Array, tolerance: float) -> tuple[Array, Array]:
    """Leaves out samples that linear interpolation in time replaces (Ramer, Douglas and Peucker's way).

    Args:
        t: (K,) times, s, increasing.
        xy: (K, 2) places, m.
        keep: times that the path is cut at in any case, within it, s.
        tolerance: m.

    Returns:
        The times (L,) and places (L, 2) that are left.
    """
    times = np.union1d(t, keep)
    places = np.column_stack([np.interp(times, t, xy[:, axis]) for axis in (0, 1)])
    wanted = np.isin(times, keep)
    wanted[[0, -1]] = True
    pending = list(pairwise(np.flatnonzero(wanted).tolist()))
    while pending:
        first, last = pending.pop()
        if last - first < 2:
            continue
        share = (times[first + 1 : last] - times[first]) / (times[last] - times[first])
        straight = places[first] + share[:, None] * (places[last] - places[first])
        error = np.linalg.norm(places[first + 1 : last] - straight, axis=1)
        if error.max() > tolerance:
            middle = first + 1 + int(np.argmax(error))
            wanted[middle] = True
            pending += [(first, middle), (middle, last)]
    return times[wanted], places[wanted]


def _trim(path: tuple[Sample, ...], still: float) -> tuple[Array, Array]:
    """Times and places of the tip from its last moment at rest to its first."""
    t, xy = np.array([look.t for look in path]), np.array([look.tip[:2] for look in path])
    moved = np.flatnonzero(np.linalg.norm(xy - xy[0], axis=1) > still)
    moving = np.flatnonzero(np.linalg.norm(xy - xy[-1], axis=1) > still)
    if not len(moved) or not len(moving):
        return t[:1], xy[:1]
    part = slice(max(moved[0] - 1, 0), moving[-1] + 2)
    return t[part], xy[part]


def _add_coast(episode: Episode, t: Array, xy: Array, coast: float) -> tuple[float, Array, Array]:
    """Lets the tip stand for as long as the object may slide on, while it was seen to; and when it stopped, s."""
    end = float(t[-1])
    stood = min(coast, episode.path[-1].t - end)
    return (end, np.append(t, end + stood), np.vstack([xy, xy[-1:]])) if stood > 0 else (end, t, xy)


def _choose_looks(
    path: tuple[Sample, ...], t: Array, way: Array, end: float, options: RecordOptions, up_to_end: bool
) -> list[tuple[float, Array]]:
    """Times and poses of the looks nearest to even shares of the tip's way."""
    looks = [
        (_snap(look.t - options.pose_delay, t), np.array(look.pose)) for look in path if np.isfinite(look.pose).all()
    ]
    looks = [(time, pose) for time, pose in looks if t[0] < time <= end]
    if not looks:
        return []
    passed = np.interp([time for time, _ in looks], t, way)
    wanted = way[-1] * np.arange(1, options.observations + up_to_end) / options.observations
    return [looks[i] for i in sorted({int(np.argmin(np.abs(passed - share))) for share in wanted})]


def _snap(time: float, t: Array) -> float:
    """The nearest of the times t where round-off alone keeps `time` from it."""
    nearest = float(t[np.argmin(np.abs(t - time))])
    return nearest if abs(nearest - time) < SAME_TIME else time


def _calc_distance(obj: GridObject, pose: Array, xy: Array) -> float:
    """Least distance of the tip's centre from the object where it lies at the beginning, m."""
    c, s = cos(pose[2]), sin(pose[2])
    return float(obj.outline.distance(LineString((xy - pose[:2]) @ np.array([[c, -s], [s, c]]))))


def _continue_turns(pose: Array, seen: list[tuple[float, Array]]) -> Array:
    """The poses (K, 3), theta without jumps from the first pose on."""
    poses, before = [], float(pose[2])
    for _, look in seen:
        before = nearest_turn(float(look[2]), before)
        poses.append([look[0], look[1], before])
    return np.array(poses)

"""One push from two tracks: the tip's places and the object's poses, each with times of its own.

The tracks are not resampled. Where the object was seen, the tip's place is interpolated; where only
the tip was seen, the object counts as not seen. So nothing is said of the object at a time at which
nobody looked, above all not after its last pose: a push whose end nobody saw is compared with the
model up to the last pose only.
"""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.pushes.segmentation import Episode, RecordOptions, Sample

MAX_BRIDGED = 6.0
"""The tip's place is interpolated between two of its rows that are at most this many of its median
periods apart."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """What was logged of one push.

    Attributes:
        tip_t: (K,) times of the tip's places, s, increasing.
        tip: (K, 2) p_WP of the tip's center, m.
        object_t: (N,) times of the object's poses by the object's own clock, s, increasing.
        poses: (N, 3) q_W of the object, m and rad.
    """

    tip_t: Array
    tip: Array
    object_t: Array
    poses: Array


def make_episode(tracks: Tracks, record: RecordOptions) -> Episode | None:
    """Puts two tracks together as one motion of the tip, with the object's poses as they are timed.

    How late the object's poses are is not taken out here, but where the episode is written down
    (`RecordOptions.pose_delay`).

    Args:
        tracks: what was logged.
        record: how the push will be written down; `still` says from when on the tip moves.

    Returns:
        The motion: what was seen before the tip moved, while it moved, and after it stopped; None
        where the tip did not move.
    """
    t = tracks.tip_t
    tip = tracks.tip
    moved = np.flatnonzero(np.linalg.norm(tip - tip[0], axis=1) > record.still)
    moving = np.flatnonzero(np.linalg.norm(tip - tip[-1], axis=1) > record.still)
    if not len(moved) or not len(moving):
        return None
    # the last row before the tip has moved, and the first one from which it moves no more
    begin = t[max(moved[0] - 1, 0)]
    end = t[min(moving[-1] + 1, len(t) - 1)]

    samples = _merge(tracks)
    before = tuple(one for one in samples if one.t < begin)
    path = tuple(one for one in samples if begin <= one.t <= end)
    after = tuple(one for one in samples if one.t > end)
    if not any(np.isfinite(one.pose).all() for one in before):
        # The log begins with the push: then the object rests where it was first seen.
        first = next((one for one in path if np.isfinite(one.pose).all()), None)
        before = () if first is None else (first,)
    return Episode(before=before, path=path, after=after)


def _merge(tracks: Tracks) -> list[Sample]:
    """Makes a sample at each time of both tracks; the pose is that of the object where seen."""
    t = np.union1d(tracks.tip_t, tracks.object_t)
    inside = (tracks.tip_t[0] <= t) & (t <= tracks.tip_t[-1])
    steps = np.diff(tracks.tip_t)
    after = np.clip(np.searchsorted(tracks.tip_t, t), 1, len(steps))
    bridged = (steps[after - 1] <= MAX_BRIDGED * np.median(steps)) | np.isin(t, tracks.tip_t)
    # Before the log of the tip and after it, the tip is where it was first and last seen.
    tip = np.column_stack([np.interp(t, tracks.tip_t, tracks.tip[:, axis]) for axis in (0, 1)])
    poses = np.full((len(t), 3), np.nan)
    poses[np.isin(t, tracks.object_t)] = tracks.poses
    poses[inside & ~bridged] = np.nan
    still = (0.0, 0.0, 0.0)
    return [
        Sample(t=time, pose=tuple(pose), tip=(x, y, 0.0), velocity=still)
        for time, pose, (x, y) in zip(t.tolist(), poses.tolist(), tip.tolist(), strict=True)
    ]

"""What importers of tracks share, whose tip, object and force have times of their own.

`make_episode` makes one push of the tip's places and the object's poses.

The tracks are not resampled. Where the object was seen, the tip's place is interpolated; where only
the tip was seen, the object counts as not seen. So nothing is said of the object at a time at which
nobody looked, above all not after its last pose: a push whose end nobody saw is compared with the
model up to the last pose only.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from warnings import warn

import numpy as np

from gridpush_drake.errors import PushLogWarning
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.pose_delay import ChosenDelay
from gridpush_drake.pushes.segmentation import RecordOptions, Sample, TipMotion, find_motion
from gridpush_drake.units import MS_PER_S

MAX_GAP = 6
"""Median periods of a track across which nothing is interpolated: a longer gap is left empty."""


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


def make_episode(tracks: Tracks, record: RecordOptions) -> TipMotion | None:
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
    motion = find_motion(tip, record.still)
    if motion is None:
        return None
    begin, end = t[motion][[0, -1]]

    samples = _merge(tracks)
    before = tuple(one for one in samples if one.t < begin)
    path = tuple(one for one in samples if begin <= one.t <= end)
    after = tuple(one for one in samples if one.t > end)
    if not any(np.isfinite(one.pose).all() for one in before):
        # The log begins with the push: then the object rests where it was first seen.
        first = next((one for one in path if np.isfinite(one.pose).all()), None)
        before = () if first is None else (first,)
    return TipMotion(before=before, path=path, after=after)


def _merge(tracks: Tracks) -> list[Sample]:
    """Makes a sample at each time of both tracks; the pose is that of the object where seen."""
    t = np.union1d(tracks.tip_t, tracks.object_t)
    inside = (tracks.tip_t[0] <= t) & (t <= tracks.tip_t[-1])
    steps = np.diff(tracks.tip_t)
    after = np.clip(np.searchsorted(tracks.tip_t, t), 1, len(steps))
    bridged = (steps[after - 1] <= MAX_GAP * np.median(steps)) | np.isin(t, tracks.tip_t)
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


def add_force(seen: ObservedPush, begin: float, t: Array, force: Array) -> ObservedPush:
    """Adds to a push the forces that were measured while it lasted.

    Args:
        seen: the push.
        begin: when it began, s.
        t: (F,) times of the forces by the same clock, s.
        force: (F, 2) force on the object in W, N.

    Returns:
        The push with its forces; itself where none was measured meanwhile.
    """
    since = t - begin
    during = (since >= 0) & (since <= seen.push.duration)
    return replace(seen, force_t=since[during], force=force[during]) if during.any() else seen


def warn_of_delay(path: Path, chosen: ChosenDelay, offset: float = 0.0) -> None:
    """Warns of a delay that was found and taken out, or of one that contradicts what was told.

    It is called by an importer's `read`, to whose caller the warning goes.

    Args:
        path: the file.
        chosen: the delay of the object's poses.
        offset: what `--object-delay` would say more than `chosen` for the same poses, s.
    """
    found = chosen.found
    if found is None:
        return
    applied = not chosen.given_by and chosen.value == found.value
    if not (applied or chosen.is_contradicted):
        return
    total = found.value + offset
    size = f"{total * MS_PER_S:.0f} ± {found.std * MS_PER_S:.0f} ms late, by {found.pushes} pushes"
    what = (
        f"this was taken out; --object-delay {total:.4g} says so"
        if applied
        else "--object-delay says otherwise, and is believed"
    )
    warn(f"{path}: the object's poses are {size}; {what}", PushLogWarning, stacklevel=3)

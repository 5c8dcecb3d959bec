"""A stream of observations cut into pushes: where each begins and ends, and its entry in a push log.

A push is going on while the tip is down (below `engaged_below`) and moves over the table; it is
over when the tip has stopped and then lifts, moves on, or simply stands. The object moves only when
pushed, so that what is observed between two pushes is one pose, many times.

    waiting  --- down and moving --------------------------------> moving
    moving   --- slow, or lifted --------------------------------> settling
    settling --- moving again before `pause` is over, not lifted > moving, the same push
    settling --- moving again later, or after it was lifted -----> moving, the next push
    settling --- `settle`, or `settle_lifted`, is over ----------> waiting

Of a push's entry, the first pose is the mean of the observations of the object at rest before it,
the last one that of those after it; between them a few single observations are kept, evenly spread
along the tip's path. That path is as measured, without the samples that straight lines between the
others replace to within `path_tolerance`.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, inf, isfinite
from typing import NamedTuple

import numpy as np
from shapely import LineString

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import GridPushError, PushLogError
from gridpush_drake.geometry.se2 import Array, transform_back, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import ObservedPush, nearest_turn

Numbers = tuple[float, float, float]

MAX_SAMPLES = 50_000
"""Most samples of one motion of the tip: 50 s of a robot that says a thousand times a second where
its tip is."""


class Sample(NamedTuple):
    """What was seen at one time, W."""

    t: float  # s
    pose: Numbers  # q = (x, y, theta) of the object, m and rad; not finite where it was not seen
    tip: Numbers  # p_WP of the tip's center, m
    velocity: Numbers  # v_WP, m/s


@dataclass(frozen=True)
class SegmenterOptions:
    """When a push begins and ends.

    Attributes:
        engaged_below: height of the tip's center below which it can touch the object, m.
        moving_above: horizontal speed from which on the tip moves, m/s.
        pause: a shorter stop does not end a push, s.
        settle_lifted: after lifting, a push is not over sooner than this after its stop, s: its
            last pose is to be observed several times.
        settle: so long after the stop a push is over though the tip stays down, s.
        lift: the tip is lifted when it rises by this from its lowest place in the push, m.
        rest_window: longest time for which poses at rest are kept, s.
    """

    engaged_below: float = 0.05
    moving_above: float = 0.005
    pause: float = 0.2
    settle_lifted: float = 0.6
    settle: float = 1.0
    lift: float = 0.003
    rest_window: float = 3.0


@dataclass(frozen=True)
class Episode:
    """A motion of the tip that may be a push.

    Attributes:
        before: observations of the object before it, at rest.
        path: while the tip was down, the first with the tip about to move.
        after: from the stop on.
    """

    before: tuple[Sample, ...]
    path: tuple[Sample, ...]
    after: tuple[Sample, ...]


@dataclass(frozen=True)
class SegmenterState:
    """What the segmenter remembers."""

    rest: tuple[Sample, ...] = ()  # observations of the object since it last came to rest
    path: tuple[
        Sample, ...
    ] = ()  # the present push while the tip is down; empty where there is none
    lowest: float = inf  # height of the tip at its lowest on that path, m
    after: tuple[Sample, ...] = ()  # from its stop on, lifted or not; empty while it moves
    lifted: bool = False  # whether it has ended by lifting


def advance(
    state: SegmenterState, sample: Sample, options: SegmenterOptions
) -> tuple[SegmenterState, Episode | None]:
    """Takes in one sample, later than all before: the state after it, and the episode that it ends, if any.

    It is passed over where the tip is not known.
    """
    if not all(map(isfinite, (*sample.tip, *sample.velocity))):
        return state, None
    moving = sample.tip[2] < options.engaged_below and _slides(sample.velocity, options)
    if not state.path:
        oldest = bisect_left(state.rest, sample.t - options.rest_window, key=lambda seen: seen.t)
        kept = state.rest[oldest:]
        return (_begin(state.rest, sample) if moving else SegmenterState((*kept, sample))), None
    lift_height = min(options.engaged_below, state.lowest + options.lift)
    lifted = state.lifted or sample.tip[2] > lift_height
    stopped_for = sample.t - state.after[0].t if state.after else 0.0
    if moving and (state.lifted or (not lifted and stopped_for >= options.pause)):
        return _begin(state.after, sample), Episode(state.rest, state.path, state.after)
    if moving and not lifted:
        return replace(_go_on(state, sample), after=()), None
    state = replace(
        state if lifted else _go_on(state, sample), lifted=lifted, after=(*state.after, sample)
    )
    if stopped_for >= (options.settle_lifted if lifted else options.settle):
        return SegmenterState(rest=state.after), Episode(state.rest, state.path, state.after)
    return state, None


def _slides(velocity: Numbers, options: SegmenterOptions) -> bool:
    """Whether the tip moves over the table rather than up or down."""
    speed = hypot(*velocity[:2])
    return speed > options.moving_above and speed > abs(velocity[2])


def _begin(rest: tuple[Sample, ...], sample: Sample) -> SegmenterState:
    """Starts a push; the sample before, with the tip still at rest, is where its path begins."""
    path = (*rest[-1:], sample)
    return SegmenterState(rest, path, min(seen.tip[2] for seen in path))


def _go_on(state: SegmenterState, sample: Sample) -> SegmenterState:
    """Lengthens the present push by a sample.

    Raises:
        PushLogError: it has MAX_SAMPLES already.
    """
    if len(state.path) >= MAX_SAMPLES:
        raise PushLogError(
            f"the motion of the tip that begins at t = {state.path[0].t:g} s has more than "
            f"{MAX_SAMPLES} samples; expected pushes, with the tip at rest or lifted in between"
        )
    return replace(state, path=(*state.path, sample), lowest=min(state.lowest, sample.tip[2]))


def find_episodes(samples: Iterable[Sample], options: SegmenterOptions) -> Iterator[Episode]:
    """Finds the motions of the tip in a stream that may be pushes, one after another.

    A motion that the stream's end cuts short is not among them.
    """
    state = SegmenterState()
    for sample in samples:
        state, episode = advance(state, sample, options)
        if episode is not None:
            yield episode


SAME_TIME = 1e-6
"""S; times that differ by less are one."""

UNUSABLE = (GridPushError, np.linalg.LinAlgError, ArithmeticError, ValueError)
"""What a push that was badly seen may lead to when it is written down or learned from."""

LATEST = 5
"""Observations at the end whose median tells where the object rests."""


@dataclass(frozen=True)
class RecordOptions:
    """How a push is written down."""

    observations: int = 10  # most poses a push, the last one included
    min_distance: float = 0.005  # of the tip; less is no push, m
    reach: float = 0.005  # a tip that never came closer to the object than its radius and this did not push it, m
    path_tolerance: float = 5e-5  # by which the thinned path may differ from the measured one, m
    still: float = (
        5e-5  # the tip has not yet, or no longer, moved within this of its first, or last, place, m
    )
    coast: float = 0.1  # how long the object may slide on after the tip's stop, s
    rest_tolerance: float = (
        0.003  # observations further than this from where the object rests are not of that rest, m
    )
    rest_angle_tolerance: float = 0.03  # likewise, rad
    pose_delay: float = 0.0  # how old a pose is when it is read, s


def name_push(count: int) -> str:
    """What the push after `count` others of a stream is called."""
    return f"push_{count + 1}"


def make_observed_push(
    episode: Episode, obj: GridObject, radius: float, name: str, options: RecordOptions
) -> ObservedPush | None:
    """Makes the log's entry for a tip of `radius`, m.

    None where the tip hardly moved or never came near the object, or where that was not seen both
    before and after.
    """
    pose = calc_rest_pose(episode.before, options)
    t, xy = trim_path(episode.path, options.still)
    if pose is None or len(t) < 2:
        return None
    traveled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    distance = obj.outline.distance(LineString(transform_back(pose, xy)))
    if traveled[-1] < options.min_distance or distance > radius + options.reach:
        return None
    end, t, xy = _add_coast(episode, t, xy, options.coast)
    traveled = np.append(traveled, np.full(len(t) - len(traveled), traveled[-1]))
    settled = [sample for sample in episode.after if sample.t - options.pose_delay >= t[-1]]
    last = calc_rest_pose(settled, options)
    seen = _choose_observations(episode.path, t, traveled, end, options, up_to_end=last is None)
    if last is not None:
        seen = [(time, q) for time, q in seen if time < t[-1]] + [(float(t[-1]), last)]
    if not seen:
        return None
    times = np.array([time for time, _ in seen])
    t, xy = thin_path(t, xy, times, options.path_tolerance)
    return ObservedPush(
        name, Push.along(t - t[0], xy, radius), pose, times - t[0], _continue_turns(pose, seen)
    )


def find_begin(episode: Episode, options: RecordOptions) -> float:
    """When the push that an episode is written down as begins, s: its time 0."""
    return float(trim_path(episode.path, options.still)[0][0])


def calc_rest_pose(
    observations: tuple[Sample, ...] | list[Sample], options: RecordOptions
) -> Array | None:
    """Mean of the latest observations of one pose; None where the object was not seen.

    Starting from the last one, all within the tolerance of the last few's median count, up to the
    first two in a row that do not: before them the object lay elsewhere. A single one is an
    outlier.
    """
    poses = np.array([seen.pose for seen in observations if np.isfinite(seen.pose).all()])
    if not len(poses):
        return None
    theta = poses[-1, 2]
    poses[:, 2] = theta + wrap_angle(poses[:, 2] - theta)
    off = poses - np.median(poses[-LATEST:], axis=0)
    good = np.hypot(off[:, 0], off[:, 1]) <= options.rest_tolerance
    good &= np.abs(off[:, 2]) <= options.rest_angle_tolerance
    elsewhere = np.flatnonzero(~(good[:-1] | good[1:]))
    if len(elsewhere):
        good[: elsewhere[-1] + 1] = False
    return poses[good].mean(axis=0) if good.any() else np.median(poses[-LATEST:], axis=0)


def thin_path(t: Array, xy: Array, keep: Array, tolerance: float) -> tuple[Array, Array]:
    """Leaves out samples that linear interpolation in time replaces (the algorithm of Ramer, Douglas and Peucker).

    Args:
        t: (K,) times, s, increasing; and the places `xy` (K, 2), m.
        keep: times that the path is cut at in any case, within it, s.
        tolerance: m.
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


def trim_path(path: tuple[Sample, ...], still: float) -> tuple[Array, Array]:
    """Times and places of the tip from its last moment at rest to its first."""
    t, xy = np.array([sample.t for sample in path]), np.array([sample.tip[:2] for sample in path])
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


def _choose_observations(
    path: tuple[Sample, ...],
    t: Array,
    traveled: Array,
    end: float,
    options: RecordOptions,
    up_to_end: bool,
) -> list[tuple[float, Array]]:
    """Times and poses of the observations nearest to even shares of the tip's path, `traveled` (K,) m by t (K,) s."""
    seen = [
        (_snap(sample.t - options.pose_delay, t), np.array(sample.pose))
        for sample in path
        if np.isfinite(sample.pose).all()
    ]
    seen = [(time, pose) for time, pose in seen if t[0] < time <= end]
    if not seen:
        return []
    traveled_then = np.interp([time for time, _ in seen], t, traveled)
    wanted = traveled[-1] * np.arange(1, options.observations + up_to_end) / options.observations
    return [
        seen[i] for i in sorted({int(np.argmin(np.abs(traveled_then - share))) for share in wanted})
    ]


def _snap(time: float, t: Array) -> float:
    """The nearest of the times t where round-off alone keeps `time` from it."""
    nearest = float(t[np.argmin(np.abs(t - time))])
    return nearest if abs(nearest - time) < SAME_TIME else time


def _continue_turns(pose: Array, seen: list[tuple[float, Array]]) -> Array:
    """The poses (K, 3), theta without jumps from the first pose on."""
    poses, before = [], float(pose[2])
    for _, q in seen:
        before = nearest_turn(float(q[2]), before)
        poses.append([q[0], q[1], before])
    return np.array(poses)

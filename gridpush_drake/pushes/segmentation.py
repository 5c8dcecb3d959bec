"""A stream of observations cut into pushes: where each begins and ends, and its push log entry.

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
from math import hypot, inf, isfinite, nan
from typing import NamedTuple

import numpy as np
from shapely import LineString

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import GridPushError, PushLogError
from gridpush_drake.geometry.se2 import Array, transform_back, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.observed_push import ObservedPush, nearest_turn
from gridpush_drake.pushes.push_csv import MIN_TIME_STEP

Numbers = tuple[float, float, float]

FREE_HEIGHT = 0.01
"""A tip that is higher by this than in a push touches nothing, m."""

MAX_FORCES = 20
"""Largest number of forces that are written down of a push; more samples are averaged."""

NOT_FELT = (nan, nan, nan)
"""Force of a sample in which none was measured."""

MAX_SAMPLES = 50_000
"""Largest number of samples of one motion of the tip: 50 s of a robot that says a thousand times a
second where its tip is."""


class Sample(NamedTuple):
    """What was seen at one time, in the world frame W.

    Attributes:
        t: time, s.
        pose: q = (x, y, theta) of the object, m and rad; not finite where it was not seen.
        tip: p_WP of the tip's center, m.
        velocity: v_WP of the tip, m/s.
        force: on the tip, N, with whatever offset it has; not finite where none was measured.
        yaw: angle of the pusher's frame, rad; 0 of a disc.
    """

    t: float
    pose: Numbers
    tip: Numbers
    velocity: Numbers
    force: Numbers = NOT_FELT
    yaw: float = 0.0


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
class TipMotion:
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
    """What the segmenter remembers from sample to sample.

    Attributes:
        rest: observations of the object since it last came to rest.
        path: samples of the present push while the tip is down; empty where there is none.
        lowest: height of the tip at its lowest on that path, m.
        after: samples from the tip's stop on, lifted or not; empty while it moves.
        lifted: whether the push has ended by lifting.
    """

    rest: tuple[Sample, ...] = ()
    path: tuple[Sample, ...] = ()
    lowest: float = inf
    after: tuple[Sample, ...] = ()
    lifted: bool = False


def advance(
    state: SegmenterState, sample: Sample, options: SegmenterOptions
) -> tuple[SegmenterState, TipMotion | None]:
    """Takes in one sample, which is later than all before.

    Args:
        state: what is remembered.
        sample: the sample; it is passed over where the tip is not known.
        options: when a push begins and ends.

    Returns:
        What is remembered after it, and the episode that it ends; None where it ends none.

    Raises:
        PushLogError: one motion of the tip has too many samples.
    """
    if not all(map(isfinite, (*sample.tip, *sample.velocity))):
        return state, None
    moving = sample.tip[2] < options.engaged_below and _slides(sample.velocity, options)

    # Waiting: the object is seen at rest, until the tip moves.
    if not state.path:
        if moving:
            return _begin(state.rest, sample), None
        oldest = bisect_left(state.rest, sample.t - options.rest_window, key=lambda seen: seen.t)
        return SegmenterState(rest=(*state.rest[oldest:], sample)), None

    # Moving on: as a new push after a lift or a long stop, else as the same one.
    lift_height = min(options.engaged_below, state.lowest + options.lift)
    lifted = state.lifted or sample.tip[2] > lift_height
    stopped_for = sample.t - state.after[0].t if state.after else 0.0
    if moving and (state.lifted or (not lifted and stopped_for >= options.pause)):
        return _begin(state.after, sample), TipMotion(state.rest, state.path, state.after)
    if moving and not lifted:
        return replace(_go_on(state, sample), after=()), None

    # Settling: the push is over once the object was seen at rest for long enough.
    state = state if lifted else _go_on(state, sample)
    state = replace(state, lifted=lifted, after=(*state.after, sample))
    if stopped_for >= (options.settle_lifted if lifted else options.settle):
        return SegmenterState(rest=state.after), TipMotion(state.rest, state.path, state.after)
    return state, None


def _slides(velocity: Numbers, options: SegmenterOptions) -> bool:
    """Whether the tip moves over the table rather than up or down."""
    speed = hypot(*velocity[:2])
    return speed > options.moving_above and speed > abs(velocity[2])


def _begin(rest: tuple[Sample, ...], sample: Sample) -> SegmenterState:
    """Starts a push; the sample before, with the tip still at rest, is where its path begins."""
    path = (*rest[-1:], sample)
    return SegmenterState(rest=rest, path=path, lowest=min(seen.tip[2] for seen in path))


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


def find_episodes(samples: Iterable[Sample], options: SegmenterOptions) -> Iterator[TipMotion]:
    """Finds the motions of the tip in a stream that may be pushes, one after another.

    A motion that the stream's end cuts short is not among them.
    """
    state = SegmenterState()
    for sample in samples:
        state, episode = advance(state, sample, options)
        if episode is not None:
            yield episode


SAME_TIME = 1e-6
"""Difference below which two times are one, s."""

UNUSABLE_ERRORS = (GridPushError, np.linalg.LinAlgError, ArithmeticError, ValueError)
"""Errors to which a push that was badly seen may lead when it is written down or learned from."""

LATEST_OBSERVATIONS = 5
"""Number of observations at the end whose median tells where the object rests."""


@dataclass(frozen=True)
class RecordOptions:
    """How a push is written down.

    Attributes:
        observations: largest number of poses of a push, the last one included.
        min_distance: shortest path of the tip that is a push, m.
        reach: a tip that never came closer to the object's outline than its radius and this did not
            push it, m.
        path_tolerance: largest difference of the thinned path from the measured one, m.
        still: the tip has not begun to move while it is within this of its first place, and moves
            no more once it is within this of its last one, m.
        coast: longest time that the object may slide on after the tip's stop, s.
        rest_tolerance: observations further than this from where the object rests are not of that
            rest, m.
        rest_angle_tolerance: observations turned by more than this from how the object rests are
            not of that rest, rad.
        pose_delay: how old a pose is when it is read, s.
    """

    observations: int = 10
    min_distance: float = 0.005
    reach: float = 0.005
    path_tolerance: float = 5e-5
    still: float = 5e-5
    coast: float = 0.1
    rest_tolerance: float = 0.003
    rest_angle_tolerance: float = 0.03
    pose_delay: float = 0.0


def name_push(count: int) -> str:
    """Names the push that comes after `count` others of a stream."""
    return f"push_{count + 1}"


def make_observed_push(
    episode: TipMotion,
    obj: GridObject,
    pusher: float | PusherShape,
    name: str,
    options: RecordOptions,
) -> ObservedPush | None:
    """Makes a push log's entry.

    Args:
        episode: a motion of the tip that may be a push.
        obj: the object.
        pusher: radius of the tip, m, or the shape of a pusher that is no disc.
        name: name of the push.
        options: how a push is written down.

    Returns:
        The entry; None where the tip hardly moved or never came near the object, or where the
        object was not seen both before and after.
    """
    # Only a tip that moved, and came near the object, has pushed it.
    pose = calc_rest_pose(episode.before, options)
    t, xy = trim_path(episode.path, options.still)
    if pose is None or len(t) < 2:
        return None
    shape = pusher if isinstance(pusher, PusherShape) else None
    reach = pusher.reach if isinstance(pusher, PusherShape) else pusher
    traveled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    distance = obj.outline.distance(LineString(transform_back(pose, xy)))
    if traveled[-1] < options.min_distance or distance > reach + options.reach:
        return None

    # The tip stands at the end for as long as the object may slide on.
    end = float(t[-1])
    t, xy = _add_coast(episode, t, xy, options.coast)
    traveled = np.append(traveled, np.full(len(t) - len(traveled), traveled[-1]))

    # The last pose is that of the object at rest, where it was seen so.
    settled = [sample for sample in episode.after if sample.t - options.pose_delay >= t[-1]]
    last = calc_rest_pose(settled, options)
    seen = _choose_observations(episode.path, t, traveled, end, options, up_to_end=last is None)
    if last is not None:
        seen = [(time, q) for time, q in seen if time < t[-1]] + [(float(t[-1]), last)]
    if not seen:
        return None
    times = np.array([time for time, _ in seen])
    felt_at, force = _read_force(episode, float(t[0]), end)
    if felt_at is not None:
        felt_at = _take_known_times(felt_at, np.union1d(t, times))
    # The path keeps its places at all these times, so that a file of the push is read as it was.
    kept = times if felt_at is None else np.union1d(times, felt_at)
    t, xy = thin_path(t, xy, kept, options.path_tolerance)
    return ObservedPush(
        name=name,
        push=Push.along(
            t - t[0],
            xy,
            radius=None if shape is not None else reach,
            shape=shape,
            yaw=None if shape is None else _read_yaw(episode.path, t),
        ),
        pose=pose,
        t_observed=times - t[0],
        poses_observed=_continue_turns(pose, seen),
        force_t=None if felt_at is None else felt_at - t[0],
        force=None if force is None else force[:, :2],
        lift_force=None if force is None else force[:, 2],
    )


def _read_yaw(path: tuple[Sample, ...], t: Array) -> Array:
    """Reads the yaw of the pusher's frame at times t (K,), s, without jumps, rad."""
    yaw = np.unwrap([sample.yaw for sample in path])
    return np.interp(t, [sample.t for sample in path], yaw)


def _take_known_times(times: Array, known: Array) -> Array:
    """Replaces times by known ones from which only rounding sets them apart.

    The mean of a group's times may differ by its last digit from the time of the group's middle
    sample. A push log could not tell the two apart.
    """
    after = np.clip(np.searchsorted(known, times), 1, len(known) - 1)
    before = after - 1
    nearest = np.where(times - known[before] < known[after] - times, known[before], known[after])
    return np.where(np.abs(nearest - times) < MIN_TIME_STEP, nearest, times)


def _read_force(episode: TipMotion, begin: float, end: float) -> tuple[Array | None, Array | None]:
    """Reads the force on the object while the tip moved, without the offset of what measures it.

    The offset is the mean of what was felt before the push with the tip lifted, so that it touched
    nothing.

    Args:
        episode: the motion of the tip.
        begin: when the tip began to move, s.
        end: when it stopped, s.

    Returns:
        Times (F,) in the stream, s, and forces (F, 3) in W, N; None for both where the force
        was not measured in the push, or the tip was not seen lifted before.
    """
    high = episode.path[0].tip[2] + FREE_HEIGHT
    free = np.array(
        [
            seen.force
            for seen in episode.before
            if seen.tip[2] > high and np.isfinite(seen.force).all()
        ]
    )
    felt = [
        seen for seen in episode.path if begin <= seen.t <= end and np.isfinite(seen.force).all()
    ]
    if not len(free) or not felt:
        return None, None
    # The object feels the opposite of what the tip does.
    force = free.mean(axis=0) - np.array([seen.force for seen in felt])
    t = np.array([seen.t for seen in felt])
    # Neighboring samples are averaged.
    groups = np.array_split(np.arange(len(felt)), min(len(felt), MAX_FORCES))
    means = np.array([force[group].mean(axis=0) for group in groups])
    return np.array([t[group].mean() for group in groups]), means


def find_begin(episode: TipMotion, options: RecordOptions) -> float:
    """Finds the time in the stream at which an episode's push begins, s."""
    return float(trim_path(episode.path, options.still)[0][0])


def calc_rest_pose(
    observations: tuple[Sample, ...] | list[Sample], options: RecordOptions
) -> Array | None:
    """Calculates where the object rests: the mean of the latest observations of one pose.

    Starting from the last one, all within the tolerance of the last few's median count, up to the
    first two in a row that do not: before them the object lay elsewhere. A single one is an
    outlier.

    Returns:
        (3,) the pose, m and rad; None where the object was not seen.
    """
    poses = np.array([seen.pose for seen in observations if np.isfinite(seen.pose).all()])
    if not len(poses):
        return None
    # Angles may differ by whole turns.
    theta = poses[-1, 2]
    poses[:, 2] = theta + wrap_angle(poses[:, 2] - theta)
    off = poses - np.median(poses[-LATEST_OBSERVATIONS:], axis=0)
    good = np.hypot(off[:, 0], off[:, 1]) <= options.rest_tolerance
    good &= np.abs(off[:, 2]) <= options.rest_angle_tolerance
    elsewhere = np.flatnonzero(~(good[:-1] | good[1:]))
    if len(elsewhere):
        good[: elsewhere[-1] + 1] = False
    return (
        poses[good].mean(axis=0) if good.any() else np.median(poses[-LATEST_OBSERVATIONS:], axis=0)
    )


def thin_path(t: Array, xy: Array, keep: Array, tolerance: float) -> tuple[Array, Array]:
    """Leaves out samples that linear interpolation in time replaces.

    It is the algorithm of Ramer, Douglas and Peucker, with places of equal times compared.

    Args:
        t: (K,) times, increasing, s.
        xy: (K, 2) places, m.
        keep: times within the path at which it is cut in any case, s.
        tolerance: largest distance of a place that is left out from the path that remains, m.

    Returns:
        The times (L,), s, and places (L, 2), m, that are left.
    """
    times = np.union1d(t, keep)
    places = np.column_stack([np.interp(times, t, xy[:, axis]) for axis in (0, 1)])
    wanted = np.isin(times, keep)
    wanted[[0, -1]] = True
    pending = list(pairwise(np.flatnonzero(wanted).tolist()))
    # Each piece is replaced by a straight line, or cut where it is farthest from that.
    while pending:
        first, last = pending.pop()
        if last - first < 2:
            continue
        fraction = (times[first + 1 : last] - times[first]) / (times[last] - times[first])
        straight = places[first] + fraction[:, None] * (places[last] - places[first])
        error = np.linalg.norm(places[first + 1 : last] - straight, axis=1)
        if error.max() > tolerance:
            middle = first + 1 + int(np.argmax(error))
            wanted[middle] = True
            pending += [(first, middle), (middle, last)]
    return times[wanted], places[wanted]


def trim_path(path: tuple[Sample, ...], still: float) -> tuple[Array, Array]:
    """Cuts off a path's ends, at which the tip stands.

    Args:
        path: samples of the tip.
        still: distance within which the tip stands, m.

    Returns:
        Times (K,), s, and places (K, 2), m, from the tip's last moment at its first place to its
        first moment at its last place; one of each where it never moved.
    """
    t = np.array([sample.t for sample in path])
    xy = np.array([sample.tip[:2] for sample in path])
    part = find_motion(xy, still)
    return (t[:1], xy[:1]) if part is None else (t[part], xy[part])


def find_motion(xy: Array, still: float) -> slice | None:
    """Finds the part of a path in which the tip moves.

    Args:
        xy: (K, 2) places of the tip, m.
        still: distance within which the tip stands, m.

    Returns:
        The rows from the tip's last moment at its first place to its first moment at its last
        place; None where it never moved.
    """
    moved = np.flatnonzero(np.linalg.norm(xy - xy[0], axis=1) > still)
    moving = np.flatnonzero(np.linalg.norm(xy - xy[-1], axis=1) > still)
    if not len(moved) or not len(moving):
        return None
    return slice(max(int(moved[0]) - 1, 0), int(moving[-1]) + 2)


def _add_coast(episode: TipMotion, t: Array, xy: Array, coast: float) -> tuple[Array, Array]:
    """Lets the tip stand at its path's end for as long as the object may slide on.

    Args:
        episode: the motion that the path was cut from.
        t: (K,) times of the path, s.
        xy: (K, 2) places of the tip, m.
        coast: longest time that the object may slide on, s.

    Returns:
        Times and places with one more sample; without it where the tip was not seen to stand.
    """
    end = float(t[-1])
    stood = min(coast, episode.path[-1].t - end)
    if stood <= 0:
        return t, xy
    return np.append(t, end + stood), np.vstack([xy, xy[-1:]])


def _choose_observations(
    path: tuple[Sample, ...],
    t: Array,
    traveled: Array,
    end: float,
    options: RecordOptions,
    up_to_end: bool,
) -> list[tuple[float, Array]]:
    """Chooses the observations nearest to even fractions of the tip's path.

    Args:
        path: the samples of a push.
        t: (K,) times of the tip's path, s.
        traveled: (K,) length of the path by then, m.
        end: the time at which the tip stops, s.
        options: how a push is written down.
        up_to_end: whether the path's end is one of the shares; where the object was seen at rest
            after it, it is not.

    Returns:
        Times, s, and poses (3,), m and rad.
    """
    seen: list[tuple[float, Array]] = []
    for sample in path:
        if np.isfinite(sample.pose).all():
            time = _snap(sample.t - options.pose_delay, t)
            if t[0] < time <= end:
                seen.append((time, np.array(sample.pose)))
    if not seen:
        return []
    traveled_then = np.interp([time for time, _ in seen], t, traveled)
    wanted = traveled[-1] * np.arange(1, options.observations + up_to_end) / options.observations
    # One observation may be the nearest to several shares.
    nearest = {int(np.argmin(np.abs(traveled_then - fraction))) for fraction in wanted}
    return [seen[i] for i in sorted(nearest)]


def _snap(time: float, t: Array) -> float:
    """Takes the nearest of the times t (K,), s, where round-off alone keeps a time from it."""
    nearest = float(t[np.argmin(np.abs(t - time))])
    return nearest if abs(nearest - time) < SAME_TIME else time


def _continue_turns(pose: Array, seen: list[tuple[float, Array]]) -> Array:
    """Collects the poses (K, 3), m and rad, theta without jumps from the first pose (3,) on."""
    poses = []
    before = float(pose[2])
    for _, q in seen:
        before = nearest_turn(float(q[2]), before)
        poses.append([q[0], q[1], before])
    return np.array(poses)

"""Where a push begins and ends, seen from the pusher's state alone.

A push is going on while the tip is down (below `engaged_below`) and moves over the table; it is over when the tip has
stopped and then lifts, moves on, or simply stands. The object moves only when pushed, so that the poses seen between
two pushes are many looks at one pose.

    waiting --- down and moving ---> moving --- slow, or lifted ---> settling --- lifted, `settle` over ---> waiting
                                       ^  (shorter stops than `pause`) |  moving again: the next push
                                       +-------------------------------+
"""

from dataclasses import dataclass, replace
from math import hypot, isfinite
from typing import NamedTuple

Numbers = tuple[float, float, float]


class Sample(NamedTuple):
    """What was seen at one time, W.

    Attributes:
        t: s.
        pose: q = (x, y, theta) of the object, m and rad; not finite where it was not seen.
        tip: p_WP of the tip's centre, m.
        velocity: v_WP, m/s.
    """

    t: float
    pose: Numbers
    tip: Numbers
    velocity: Numbers


@dataclass(frozen=True)
class SegmenterOptions:
    """When a push begins and ends.

    Attributes:
        engaged_below: height of the tip's centre below which it can touch the object, m.
        moving_above: horizontal speed from which on the tip moves, m/s.
        pause: a shorter stop does not end a push, s.
        look: after lifting, a push is not over sooner than this after its stop, s: its last pose wants to be seen
            several times.
        settle: so long after the stop a push is over though the tip stays down, s.
        lift: the tip is lifted when it rises by this from its lowest place in the push, m.
        rest_window: longest time for which poses at rest are kept, s.
    """

    engaged_below: float = 0.05
    moving_above: float = 0.005
    pause: float = 0.2
    look: float = 0.6
    settle: float = 1.0
    lift: float = 0.003
    rest_window: float = 3.0


@dataclass(frozen=True)
class Episode:
    """A motion of the tip that may be a push.

    Attributes:
        before: looks at the object before it, at rest.
        path: while the tip was down, the first with the tip about to move.
        after: from the stop on.
    """

    before: tuple[Sample, ...]
    path: tuple[Sample, ...]
    after: tuple[Sample, ...]


@dataclass(frozen=True)
class SegmenterState:
    """What the segmenter remembers.

    Attributes:
        rest: looks at the object since it last came to rest.
        path: the present push while the tip is down; empty where there is none.
        after: from its stop on, lifted or not; empty while it moves.
        lifted: whether it has ended by lifting.
    """

    rest: tuple[Sample, ...] = ()
    path: tuple[Sample, ...] = ()
    after: tuple[Sample, ...] = ()
    lifted: bool = False


def advance(state: SegmenterState, sample: Sample, options: SegmenterOptions) -> tuple[SegmenterState, Episode | None]:
    """Takes in one sample.

    Args:
        state: before it.
        sample: later than all before; it is passed over where the tip is not known.
        options: see `SegmenterOptions`.

    Returns:
        The state after it, and the episode that it ends, if any.
    """
    if not all(map(isfinite, (*sample.tip, *sample.velocity))):
        return state, None
    moving = sample.tip[2] < options.engaged_below and _slides(sample.velocity, options)
    if not state.path:
        return (_begin(state.rest, sample) if moving else _rest(state, sample, options)), None
    lifted = state.lifted or sample.tip[2] > _find_lift_height(state.path, options)
    stopped_for = sample.t - state.after[0].t if state.after else 0.0
    if moving and (state.lifted or (not lifted and stopped_for >= options.pause)):
        return _begin(state.after, sample), Episode(state.rest, state.path, state.after)
    if moving and not lifted:
        return replace(state, path=(*state.path, sample), after=()), None
    state = replace(
        state, lifted=lifted, after=(*state.after, sample), path=state.path if lifted else (*state.path, sample)
    )
    if stopped_for >= (options.look if lifted else options.settle):
        return SegmenterState(rest=state.after), Episode(state.rest, state.path, state.after)
    return state, None


def _slides(velocity: Numbers, options: SegmenterOptions) -> bool:
    """Whether the tip moves over the table rather than up or down."""
    speed = hypot(*velocity[:2])
    return speed > options.moving_above and speed > abs(velocity[2])


def _begin(rest: tuple[Sample, ...], sample: Sample) -> SegmenterState:
    """Starts a push; the sample before, with the tip still at rest, is where its path begins."""
    return SegmenterState(rest, (*rest[-1:], sample))


def _rest(state: SegmenterState, sample: Sample, options: SegmenterOptions) -> SegmenterState:
    kept = tuple(seen for seen in state.rest if seen.t >= sample.t - options.rest_window)
    return SegmenterState((*kept, sample))


def _find_lift_height(path: tuple[Sample, ...], options: SegmenterOptions) -> float:
    return min(options.engaged_below, min(sample.tip[2] for sample in path) + options.lift)

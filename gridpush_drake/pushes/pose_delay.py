"""How late the object's poses are against the tip's places, found from the pushes of a stream.

A tracker's clock is seldom the robot's, and a picture takes time. While the tip pushes, the
object's pose is a smooth function of the tip's path, and it stands still from when the tip does
(`docs/theory/identification.md`, section 9). What is found is the whole delay of the stream's
poses, whatever somebody said of it before: whoever is told the number found finds it again.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.segmentation import (
    RecordOptions,
    Sample,
    SegmenterOptions,
    TipMotion,
    find_episodes,
    trim_path,
)
from gridpush_drake.units import MS_PER_S

MAX_DELAY = 0.3
"""Largest delay that is looked for, s."""

DELAY_STEP = 0.002
"""Distance between the delays that are tried before the best one is refined, s."""

LAST_FRACTION = 0.2
"""Fraction of a push's path, at its end, on which the object's pose is taken for a parabola of the
path."""

REST_TIME = 0.5
"""Length of time after the tip's stop, and the delay, whose poses at rest are used, s."""

MIN_MOVING = 6
"""Fewest poses on the last fraction of a path from which a push's delay is found."""

MAX_LAST_FRACTION = 0.6
"""Largest fraction of a path that is taken, where poses are so rare that `MIN_MOVING` of them need
more than the last share."""

MIN_MOTION = 0.002
"""Least motion of the object on the last fraction of the path by which its stop can be seen, m."""

MAX_ROUNDS = 8
"""Most rounds of choosing poses by the delay found so far."""

CONVERGED_CHANGE = 1e-4
"""Change of the delay from one round to the next below which it is found, s."""

MIN_TELLING = 0.005
"""Delay, and difference from a delay that was told, below which nothing is said of it, s."""

DELAY_SIGMAS = 2.0
"""Number of standard deviations from which on a delay is told apart from none, or from the one that
was told."""


MAD_TO_STD = 1.4826
"""Ratio of the standard deviation of normal numbers to their median absolute deviation."""

MEDIAN_VARIANCE = math.pi / 2
"""Ratio of the variance of a median of normal numbers to that of their mean."""

FIT_PARAMETERS = 10
"""Number of parameters of one push's fit: q_end, b and c of three coordinates, and the delay."""


@dataclass(frozen=True)
class Delay:
    """How late the object's poses are against the tip's places.

    Attributes:
        value: the whole delay, s, positive where the poses are late.
        std: its standard deviation, s.
        pushes: how many pushes it was found from.
    """

    value: float
    std: float
    pushes: int

    def differs_from(self, given: float) -> bool:
        """Whether it contradicts a delay that was told, s."""
        return abs(self.value - given) > max(MIN_TELLING, DELAY_SIGMAS * self.std)


@dataclass(frozen=True)
class ChosenDelay:
    """The delay with which a stream's pushes are written down, and where it is from.

    Attributes:
        value: the delay, s.
        found: what the pushes say; None where they do not tell.
        given_by: who said it: "--pose-delay", for instance; empty where nobody did, and `value` is
            what was found, or 0 where that is not told apart from none.
    """

    value: float
    found: Delay | None
    given_by: str = ""

    @property
    def is_contradicted(self) -> bool:
        """Whether the pushes say another delay than was told."""
        return (
            bool(self.given_by) and self.found is not None and self.found.differs_from(self.value)
        )

    def describe(self) -> str:
        """Says in a sentence what the delay is, how well it is known and what was done about it."""
        applied = f"{self.value * MS_PER_S:.0f} ms"
        if self.found is None:
            why = "the pushes do not tell it"
            return (
                f"The object's poses are taken to be {applied} late, as {self.given_by} says; "
                f"{why}."
                if self.given_by
                else f"The object's poses are taken to be on time; {why}."
            )
        found = (
            f"{self.found.value * MS_PER_S:.0f} ± {self.found.std * MS_PER_S:.0f} ms late, "
            f"by {self.found.pushes} pushes"
        )
        if self.given_by:
            relation = "but they are" if self.is_contradicted else "and they are"
            return (
                f"The object's poses are taken to be {applied} late, as {self.given_by} says, "
                f"{relation} {found}."
            )
        if self.value == self.found.value:
            return f"The object's poses are {found}; that was taken out of their times."
        return f"The object's poses are {found}, which is not told apart from being on time."


def choose_delay(
    samples: Sequence[Sample],
    obj: GridObject,
    segmenter: SegmenterOptions | None = None,
    record: RecordOptions | None = None,
    given: float | None = None,
    given_by: str = "",
    otherwise: float = 0.0,
) -> ChosenDelay:
    """Chooses the delay with which a stream is written down: what was told, or else what is found.

    Args:
        samples: the stream's samples, in the order of their times.
        obj: the object.
        segmenter: when a push begins and ends.
        record: how a push is written down.
        given: the delay as somebody says it, s; None where nobody does.
        given_by: who says it; an option's or a column's name.
        otherwise: the delay that is taken where nobody says one, and the pushes do not tell it
            apart from this one, s.

    Returns:
        The delay, and where it is from.
    """
    episodes = list(find_episodes(samples, segmenter or SegmenterOptions()))
    return choose_episodes_delay(episodes, obj, record, given, given_by, otherwise)


def choose_episodes_delay(
    episodes: Sequence[TipMotion],
    obj: GridObject,
    record: RecordOptions | None = None,
    given: float | None = None,
    given_by: str = "",
    otherwise: float = 0.0,
) -> ChosenDelay:
    """Chooses the delay as `choose_delay` does, for motions that are already cut out of a stream.

    Args:
        episodes: the motions of the tip.
        obj: the object.
        record: how a push is written down.
        given: the delay as somebody says it, s; None where nobody does.
        given_by: who does.
        otherwise: the delay that is taken where nobody says one, and the pushes do not tell it
            apart from this one, s.
    """
    found = estimate_episodes_delay(episodes, obj, record)
    if given is not None:
        return ChosenDelay(given, found, given_by)
    if found is not None and found.differs_from(otherwise):
        return ChosenDelay(found.value, found)
    return ChosenDelay(otherwise, found)


@dataclass(frozen=True, eq=False)
class _LastPart:
    """A push's end: times and places of the tip, and the poses from there on until the next push.

    Attributes:
        t: (K,) times of the tip's path, s.
        traveled: (K,) length of the path by then, m.
        t_seen: (N,) times of the poses as the stream has them, s.
        seen: (N, 3) poses, the angle times the radius of gyration, m.
    """

    t: Array
    traveled: Array
    t_seen: Array
    seen: Array


def estimate_delay(
    samples: Iterable[Sample],
    obj: GridObject,
    segmenter: SegmenterOptions | None = None,
    record: RecordOptions | None = None,
) -> Delay | None:
    """Estimates how late the object's poses are in a stream.

    The object stands still from when the tip does. Over the last part of a push its pose is

        q(t) = q_end + b d + c d²,     d = s(t - delay) - s_end

    with s the length of the tip's path. The delay, q_end, b and c are those that fit it best. Of
    all pushes the median counts, for in some of them the tip slides off before it stops. As the
    poses are chosen by the delay, this is repeated until the delay does not change any more.

    Args:
        samples: the stream's samples, in the order of their times.
        obj: the object.
        segmenter: when a push begins and ends.
        record: how a push is written down; its `pose_delay` has no influence.

    Returns:
        The delay; None where no push tells it.
    """
    return estimate_episodes_delay(
        find_episodes(samples, segmenter or SegmenterOptions()), obj, record
    )


def estimate_episodes_delay(
    episodes: Iterable[TipMotion], obj: GridObject, record: RecordOptions | None = None
) -> Delay | None:
    """Estimates the delay as `estimate_delay` does, for motions that are already cut out."""
    record = record or RecordOptions()
    ends = [
        end
        for episode in episodes
        if (end := _cut_end(episode, obj.radius_of_gyration, record)) is not None
    ]
    delay = 0.0
    for _ in range(MAX_ROUNDS):
        fits = [fit for end in ends if (fit := _fit_delay(end, delay)) is not None]
        if not fits:
            return None
        found = np.array([value for value, _ in fits])
        before = delay
        delay = float(np.median(found))
        if abs(delay - before) < CONVERGED_CHANGE:
            break
    # Pushes may differ by less than each of them is uncertain, where they are few.
    spread = MAD_TO_STD * float(np.median(np.abs(found - delay)))
    spread = max(spread, float(np.median([std for _, std in fits])))
    return Delay(delay, spread * math.sqrt(MEDIAN_VARIANCE / len(found)), len(found))


def _cut_end(episode: TipMotion, rho: float, record: RecordOptions) -> _LastPart | None:
    """Takes a push's tip path, and the poses seen from its beginning on.

    Args:
        episode: the push.
        rho: the object's radius of gyration, m, by which angles become lengths.
        record: how a push is written down.

    Returns:
        Path and poses; None where the tip hardly moved, or the object was never seen.
    """
    t, xy = trim_path(episode.path, record.still)
    if len(t) < 2:
        return None
    traveled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    if traveled[-1] < record.min_distance:
        return None
    # A sample may be on the path and after it; each time counts once.
    samples: dict[float, Sequence[float]] = {}
    for sample in (*episode.path, *episode.after):
        if np.isfinite(sample.pose).all():
            samples[sample.t] = sample.pose
    if not samples:
        return None
    t_seen = np.array(sorted(samples))
    seen = np.array([samples[time] for time in t_seen.tolist()])
    seen[:, 2] = rho * np.unwrap(seen[:, 2])
    return _LastPart(t=t, traveled=traveled, t_seen=t_seen, seen=seen)


def _fit_delay(end: _LastPart, around: float) -> tuple[float, float] | None:
    """Finds the delay that explains best how a push ends.

    Args:
        end: the push's end.
        around: the delay by which the poses are chosen, s.

    Returns:
        The delay and its standard deviation, s; None where there is too little to see.
    """
    # The part begins at the last fraction of the path, or earlier where poses are rare.
    stop = float(end.t[-1])
    way = end.traveled[-1]
    usual = float(np.interp((1 - LAST_FRACTION) * way, end.traveled, end.t))
    earliest = float(np.interp((1 - MAX_LAST_FRACTION) * way, end.traveled, end.t))
    before = end.t_seen[end.t_seen < stop + around] - around
    needed = float(before[-MIN_MOVING:].min(initial=usual))
    begin = max(earliest, min(usual, needed))
    chosen = (end.t_seen >= begin + around) & (end.t_seen <= stop + around + REST_TIME)
    moving = int((chosen & (end.t_seen < stop + around)).sum())
    resting = int(chosen.sum()) - moving
    if moving < MIN_MOVING or resting < 2:
        return None

    # An object that hardly moves does not show when it stops.
    t = end.t_seen[chosen]
    seen = end.seen[chosen]
    at_rest = np.median(seen[moving:], axis=0)
    if np.linalg.norm(at_rest - seen[:2].mean(axis=0)) < MIN_MOTION:
        return None

    def calc_misfit(delay: float) -> float:
        """Sum of squared residuals of the best parabola in d, m²."""
        d = np.interp(t - delay, end.t, end.traveled) / way - 1
        basis = np.column_stack([np.ones_like(d), d, d**2])
        factors = np.asarray(np.linalg.lstsq(basis, seen, rcond=None)[0], dtype=np.float64)
        return float(((seen - basis @ factors) ** 2).sum())

    reach = min(MAX_DELAY, stop - begin + REST_TIME / 2)
    tried = around + np.arange(-reach, reach + DELAY_STEP, DELAY_STEP)
    misfits = np.array([calc_misfit(float(delay)) for delay in tried])
    k = int(np.argmin(misfits))
    if k in (0, len(tried) - 1):
        return None
    # The delay is where the parabola through the three lowest misfits is lowest, and its variance
    # is by that parabola's curvature.
    low, middle, high = misfits[k - 1 : k + 2]
    curvature = low - 2 * middle + high
    if not curvature > 0:
        return None
    value = float(tried[k] + DELAY_STEP * (low - high) / (2 * curvature))
    variance = middle / max(seen.size - FIT_PARAMETERS, 1)
    return value, DELAY_STEP * math.sqrt(2 * variance / curvature)

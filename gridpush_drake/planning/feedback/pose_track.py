"""Where the object is now, by poses that come late, seldom or not at all, and by its model.

A pose tells where the object was when it was seen. From then on the model carries it along the
finger's path, which is known up to now. So a new pose is compared with what the model says of its
own time, and only the difference is filtered: with the variances P of the estimate and R of a pose,

    q = q_model + K (q_seen - q_model),    K = P / (P + R),    P <- (1 - K) P

P grows with the way d by which the model moved the object, of which it is wrong by a fraction,
alike from pose to pose, and a little with time: sqrt(P) <- sqrt(P) + doubt d. A pose that differs
by more than a few standard deviations is an outlier. It is believed only if the next pose agrees
with it: then the object was disturbed, and is where these two poses say.

Two numbers say whether the model is of this object at all: what was corrected lately, against how
far the object was moved lately; and the response, which is how much of the motion that the finger
should have caused was seen. With the model's motions m and the seen ones o between poses,

    response = sum(m.o) / sum(m.m),

in which older poses fade with the way that the model moved the object since. It is about 1 if the
object follows the finger, and about 0 if it does not, whatever the reason.
"""

from collections import deque
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    THETA,
    TIP_X,
    X,
    follow_tip,
)
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.planning.pushed_object import SearchModel

MEMORY_TIME = 2.0
"""Time for which the finger's path is remembered, s."""

RESPONSE_MEMORY = 2.0
"""Way of the object by the model, in radii of gyration, over which the response is averaged. There
is no response before the model moved the object as far."""

MAX_COORDINATE = 1e3
"""Largest coordinate of a place or a pose, m or rad. A larger one is no measurement, and is treated
as one that is not finite."""


def is_plausible(numbers: ArrayLike) -> bool:
    """Says whether coordinates are finite, and at most MAX_COORDINATE in size."""
    # Written so that NaN is not plausible.
    return bool((np.abs(np.asarray(numbers, dtype=np.float64)) <= MAX_COORDINATE).all())


@dataclass(frozen=True)
class TrackOptions:
    """How poses are filtered.

    Attributes:
        position_std: standard deviation of a seen position, per axis, m.
        angle_std: standard deviation of a seen angle, rad.
        inflation: fraction of the way moved by which the model may be off.
        drift: standard deviation of what moves the object otherwise, m in a second.
        outlier: difference of a pose from the model's, in standard deviations, beyond which the
            pose is not believed unless the next one agrees with it.
        memory: time within which corrections are summed up, s; older ones fade.
        most: greatest correction that counts at once, in radii of gyration, so that one disturbance
            does not tell of another object.
    """

    position_std: float = 0.0005
    angle_std: float = 0.005
    inflation: float = 0.15
    drift: float = 0.0003
    outlier: float = 6.0
    memory: float = 1.0
    most: float = 0.3

    def __post_init__(self) -> None:
        require_positive(PlanningError, "track: ", "m", position_std=self.position_std)
        require_positive(PlanningError, "track: ", "rad", angle_std=self.angle_std)
        require_positive(PlanningError, "track: ", inflation=self.inflation, outlier=self.outlier)
        require_positive(PlanningError, "track: ", "s", memory=self.memory)


@dataclass(frozen=True, eq=False)
class FilteredState:
    """Where the object was at a time, and how sure that is.

    Attributes:
        time: time of the pose that it comes from, s.
        state: (STATE_SIZE,) state of object and finger.
        variance: (3,) variances of the pose, m² and rad².
    """

    time: float
    state: Array
    variance: Array

    @property
    def pose(self) -> Array:
        """(3,) the pose, m and rad."""
        return self.state[X : THETA + 1]


class PoseTrack:
    """Follows one object.

    Attributes:
        options: how poses are filtered.
        came_at: time of the last pose that came, believed or not, s; -inf before the first.
        corrected: (3,) by how much poses corrected the model lately, m, the turn counted by the
            radius of gyration.
        disturbances: number of times that the object was found elsewhere.
        moved: how far the model moved the object lately, m, a turn counted likewise.
    """

    def __init__(self, arm: float, options: TrackOptions | None = None) -> None:
        """Begins with nothing seen.

        Args:
            arm: the object's radius of gyration, m.
            options: how poses are filtered.
        """
        self.options = options or TrackOptions()
        self.came_at = -np.inf
        self.corrected = np.zeros(3)
        self.moved = 0.0
        self.disturbances = 0
        self._arm = arm
        self._believed = FilteredState(-np.inf, np.zeros(STATE_SIZE), np.zeros(3))
        # an outlier that the next pose may agree with
        self._pending: FilteredState | None = None
        # sums of the response, and the way over which they were made
        self._expected = 0.0
        self._followed = 0.0
        self._way = 0.0
        self._times: deque[float] = deque()
        self._tips: deque[Array] = deque()

    def copy(self) -> "PoseTrack":
        """Makes a copy that goes on by itself; beliefs are never changed, but replaced."""
        other = copy(self)
        other._times = self._times.copy()
        other._tips = self._tips.copy()
        return other

    @property
    def seen_at(self) -> float:
        """Time of the last pose that was believed, s; -inf before the first."""
        return self._believed.time

    @property
    def response(self) -> float:
        """Fraction of the motion that the finger should have caused that was seen, lately.

        It is NaN before the model moved the object by RESPONSE_MEMORY.
        """
        if self._way < RESPONSE_MEMORY * self._arm:
            return np.nan
        return self._followed / self._expected

    def forget_response(self) -> None:
        """Begins the response anew, as for another model."""
        self._expected = 0.0
        self._followed = 0.0
        self._way = 0.0

    def add_tip(self, time: float, tip: Array) -> None:
        """Takes in where the finger's center is, (2,) m, at a time, s; times increase.

        Of a finger that is no disc it is (3,), with its angle, rad.
        """
        if self._times and time <= self._times[-1]:
            return
        self._times.append(float(time))
        self._tips.append(np.array(tip, dtype=np.float64))
        while len(self._times) > 2 and self._times[1] < time - MEMORY_TIME:
            self._times.popleft()
            self._tips.popleft()

    def add_pose(self, model: SearchModel, time: float, pose: ArrayLike) -> bool:
        """Takes in a pose (3,), m and rad, that was seen at a time, s.

        Returns:
            Whether it was believed. It is not if it is older than the last one, later than the
            finger's last place, or older than all that is remembered; or if neither the model nor
            the pose before explains it.
        """
        seen = np.asarray(pose, dtype=np.float64)
        if not self._times or not self.came_at < time <= self._times[-1]:
            return False
        self.came_at = time
        if not np.isfinite(self.seen_at) or time < self._times[0]:
            self._believed = self._begin(time, seen)
            self._pending = None
            return True
        # What was believed before, carried on by the model, explains most poses.
        before = self._believed
        expected = self._carry(model, before, time)
        off = _subtract(seen, expected.pose)
        motion = self._unit * _subtract(expected.pose, before.pose)
        if self._agrees(off, expected):
            self._believed = self._correct(expected, off)
            self._pending = None
            correction = self._unit * _subtract(self._believed.pose, expected.pose)
            self._sum_up(correction, motion, time - before.time)
            self._note_response(motion, motion + correction)
            return True
        # An outlier is believed where the pose before says the same: the object was disturbed.
        # Nothing that was known of its motion holds any more.
        if self._pending is not None:
            other = self._carry(model, self._pending, time)
            from_other = _subtract(seen, other.pose)
            if self._agrees(from_other, other):
                self._believed = self._correct(other, from_other)
                self._pending = None
                self.disturbances += 1
                self._sum_up(self._unit * off, motion, time - before.time)
                return True
        self._pending = self._begin(time, seen)
        return False

    def _carry(self, model: SearchModel, belief: FilteredState, time: float) -> FilteredState:
        """Carries a belief on to a later time by the model, less sure than before."""
        state = belief.state.copy()
        self._follow(model, state, belief.time, time)
        moved = _measure(self._unit * _subtract(state[X : THETA + 1], belief.pose))
        options = self.options
        std = np.sqrt(belief.variance) + options.inflation * moved / self._unit
        drift = options.drift**2 * (time - belief.time) / self._unit**2
        return FilteredState(time, state, std**2 + drift)

    def _agrees(self, off: Array, belief: FilteredState) -> bool:
        """Whether a pose that is off by (3,) from a belief, m and rad, is no outlier."""
        most = self.options.outlier**2 * (belief.variance + self._noise)
        return bool((off**2 <= most).all())

    def _correct(self, belief: FilteredState, off: Array) -> FilteredState:
        """Corrects a belief by a pose of its time that is off by (3,), m and rad."""
        gain = belief.variance / (belief.variance + self._noise)
        state = belief.state.copy()
        state[X : THETA + 1] += gain * off
        return FilteredState(belief.time, state, (1.0 - gain) * belief.variance)

    def _sum_up(self, correction: Array, motion: Array, lasted: float) -> None:
        """Adds a correction (3,) and the model's motion (3,), both m, to what happened lately."""
        fading = np.exp(-lasted / self.options.memory)
        most = self.options.most * self._arm
        fraction = min(1.0, most / max(float(np.linalg.norm(correction)), most))
        self.corrected = fading * self.corrected + fraction * correction
        self.moved = fading * self.moved + _measure(motion)

    def _note_response(self, motion: Array, seen: Array) -> None:
        """Notes the model's motion (3,), m, and the one that was seen (3,), m."""
        moved = _measure(motion)
        fading = np.exp(-moved / (RESPONSE_MEMORY * self._arm))
        self._expected = fading * self._expected + float(motion @ motion)
        self._followed = fading * self._followed + float(motion @ seen)
        self._way += moved

    @property
    def _unit(self) -> Array:
        """(3,) factors by which the coordinates of a pose become lengths."""
        return np.array([1.0, 1.0, self._arm])

    @property
    def _noise(self) -> Array:
        """(3,) variances of a seen pose."""
        position = self.options.position_std**2
        return np.array([position, position, self.options.angle_std**2])

    @property
    def seen_pose(self) -> Array:
        """(3,) the filtered pose of the time `seen_at`, m and rad."""
        return self._believed.pose.copy()

    def find_tips(self, begin: float, end: float) -> Array:
        """The finger's path (K, D) after one time and up to another, s; its last place is then."""
        between = [tip for t, tip in zip(self._times, self._tips, strict=True) if begin < t < end]
        return np.array([*between, self._find_tip(end)])

    def predict(self, model: SearchModel) -> Array:
        """The state (STATE_SIZE,) now, which is when the finger's last place was told."""
        state = self._believed.state.copy()
        self._follow(model, state, self.seen_at, self._times[-1])
        return state

    def _begin(self, time: float, pose: Array) -> FilteredState:
        """Takes a pose (3,) as it is, of an object at rest."""
        state = np.zeros(STATE_SIZE)
        state[X : THETA + 1] = pose
        tip = self._find_tip(time)
        state[TIP_X : TIP_X + len(tip)] = tip
        return FilteredState(time, state, self._noise)

    def _follow(self, model: SearchModel, state: Array, begin: float, end: float) -> None:
        """Carries a state along the finger's path between two times."""
        follow_tip(model, state, self.find_tips(begin, end))

    def _find_tip(self, time: float) -> Array:
        """The finger's place (D,) at a time, m and rad."""
        path = np.array(self._tips)
        times = np.array(self._times)
        return np.array([np.interp(time, times, column) for column in path.T])


def _subtract(pose: Array, other: Array) -> Array:
    """Difference of two poses (3,), m and rad, with the smaller of the two turns."""
    off = pose - other
    off[2] = wrap_angle(off[2])
    return np.asarray(off)


def _measure(off: Array) -> float:
    """Size of a difference of poses (3,) that is in lengths, m."""
    return float(np.hypot(np.hypot(off[0], off[1]), off[2]))

"""Where the object is now, by poses that come late, seldom or not at all, and by its model.

A pose tells where the object was when it was seen. From then on the model carries it along the
finger's path, which is known up to now. So a new pose is compared with what the model says of its
own time, and only the difference is filtered: with the variances P of the estimate and R of a pose,

    q = q_model + K (q_seen - q_model),    K = P / (P + R),    P <- (1 - K) P

P grows with the way d by which the model moved the object, of which it is wrong by a share, alike
from pose to pose, and a little with time: sqrt(P) <- sqrt(P) + doubt d. A pose that differs by more
than a few standard deviations tells of a shove: it is taken as it is.

What was corrected lately, against how far the object was moved lately, says whether the model is of
this object at all.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.kernels.finger_push import (
    MEMORY,
    STATE,
    THETA,
    TIP_X,
    TIP_Y,
    VX,
    PushedModel,
    W,
    X,
    follow_tip,
)
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, wrap_angle

REMEMBERED = 2.0
"""Time for which the finger's path is remembered, s."""


@dataclass(frozen=True)
class TrackOptions:
    """How poses are filtered.

    Attributes:
        position_std: standard deviation of a seen position, per axis, m.
        angle_std: standard deviation of a seen angle, rad.
        doubt: share of the way moved by which the model may be off.
        drift: standard deviation of what moves the object otherwise, m in a second.
        shove: difference of a pose from the model's that is taken for a shove, in standard
            deviations.
        memory: time within which corrections are summed up, s; older ones fade.
        most: greatest correction that counts at once, in radii of gyration, so that one shove does
            not tell of another object.
    """

    position_std: float = 0.0005
    angle_std: float = 0.005
    doubt: float = 0.15
    drift: float = 0.0003
    shove: float = 6.0
    memory: float = 1.0
    most: float = 0.3

    def __post_init__(self) -> None:
        require_positive(PlanningError, "track: ", "m", position_std=self.position_std)
        require_positive(PlanningError, "track: ", "rad", angle_std=self.angle_std)
        require_positive(PlanningError, "track: ", doubt=self.doubt, shove=self.shove)
        require_positive(PlanningError, "track: ", "s", memory=self.memory)


class PoseTrack:
    """Follows one object.

    Attributes:
        options: how poses are filtered.
        seen_at: time of the last pose that was taken in, s; -inf before the first.
        corrected: (3,) by how much poses corrected the model lately, m, the turn counted by the
            radius of gyration.
        shoves: number of poses that were taken for shoves.
        moved: how far the model moved the object lately, m, a turn counted likewise.
    """

    def __init__(self, arm: float, options: TrackOptions | None = None) -> None:
        """Begins with nothing seen.

        Args:
            arm: the object's radius of gyration, m.
            options: how poses are filtered.
        """
        self.options = options or TrackOptions()
        self.seen_at = -np.inf
        self.corrected = np.zeros(3)
        self.moved = 0.0
        self.shoves = 0
        self._arm = arm
        self._state = np.zeros(STATE)
        self._variance = np.zeros(3)
        self._times: deque[float] = deque()
        self._tips: deque[Array] = deque()

    def copy(self) -> "PoseTrack":
        """Makes a copy that goes on by itself."""
        other = PoseTrack(self._arm, self.options)
        other.seen_at = self.seen_at
        other.corrected = self.corrected.copy()
        other.moved = self.moved
        other.shoves = self.shoves
        other._state = self._state.copy()
        other._variance = self._variance.copy()
        other._times = self._times.copy()
        other._tips = self._tips.copy()
        return other

    def add_tip(self, time: float, tip: Array) -> None:
        """Takes in where the finger's center is, (2,) m, at a time, s; times increase."""
        if self._times and time <= self._times[-1]:
            return
        self._times.append(float(time))
        self._tips.append(np.array(tip, dtype=np.float64))
        while len(self._times) > 2 and self._times[1] < time - REMEMBERED:
            self._times.popleft()
            self._tips.popleft()

    def add_pose(self, model: PushedModel, time: float, pose: ArrayLike) -> bool:
        """Takes in a pose (3,), m and rad, that was seen at a time, s.

        Returns:
            Whether it was: it is not if it is older than the last one, later than the finger's last
            place, or older than all that is remembered.
        """
        seen = np.asarray(pose, dtype=np.float64)
        if not self._times or not self.seen_at < time <= self._times[-1]:
            return False
        if not np.isfinite(self.seen_at) or time < self._times[0]:
            self._begin(time, seen)
            return True
        # The model's pose at the time of this one, and how sure it is.
        before = self._state[X : THETA + 1].copy()
        lasted = time - self.seen_at
        self._follow(model, self._state, self.seen_at, time)
        moved = self._measure(self._state[X : THETA + 1] - before)
        options = self.options
        unit = np.array([1.0, 1.0, self._arm])
        std = np.sqrt(self._variance) + options.doubt * moved / unit
        self._variance = std**2 + options.drift**2 * lasted / unit**2
        # How far this one is off, and how much of that is believed.
        off = seen - self._state[X : THETA + 1]
        off[2] = wrap_angle(off[2])
        total = self._variance + self._noise
        self.seen_at = time
        if (off**2 > options.shove**2 * total).any():
            # nothing that was known of the motion holds any more
            self.shoves += 1
            correction = off
            self._variance = self._noise.copy()
            self._state[VX : W + 1] = 0.0
            self._state[MEMORY:] = 0.0
        else:
            gain = self._variance / total
            correction = gain * off
            self._variance *= 1.0 - gain
        self._state[X : THETA + 1] += correction
        self._sum_up(correction * unit, moved, lasted)
        return True

    def _sum_up(self, correction: Array, moved: float, lasted: float) -> None:
        """Adds a correction (3,), m, and a way, m, to what happened lately."""
        fading = np.exp(-lasted / self.options.memory)
        most = self.options.most * self._arm
        share = min(1.0, most / max(float(np.linalg.norm(correction)), most))
        self.corrected = fading * self.corrected + share * correction
        self.moved = fading * self.moved + moved

    @property
    def _noise(self) -> Array:
        """(3,) variances of a seen pose."""
        position = self.options.position_std**2
        return np.array([position, position, self.options.angle_std**2])

    @property
    def seen_pose(self) -> Array:
        """(3,) the filtered pose of the time `seen_at`, m and rad."""
        return self._state[X : THETA + 1].copy()

    def find_tips(self, begin: float, end: float) -> Array:
        """The finger's path (K, 2) after one time and up to another, s; its last place is then."""
        between = [tip for t, tip in zip(self._times, self._tips, strict=True) if begin < t < end]
        return np.array([*between, self._find_tip(end)])

    def predict(self, model: PushedModel) -> Array:
        """The state (STATE,) now, which is when the finger's last place was told."""
        state = self._state.copy()
        self._follow(model, state, self.seen_at, self._times[-1])
        return state

    def _begin(self, time: float, pose: Array) -> None:
        """Takes a pose (3,) as it is, of an object at rest."""
        self._state[:] = 0.0
        self._state[X : THETA + 1] = pose
        self._state[TIP_X : TIP_Y + 1] = self._find_tip(time)
        self._variance = self._noise
        self.seen_at = time

    def _follow(self, model: PushedModel, state: Array, begin: float, end: float) -> float:
        """Carries a state along the finger's path between two times; returns the way, m."""
        tips = self.find_tips(begin, end)
        way = np.diff(np.vstack([state[TIP_X : TIP_Y + 1], tips]), axis=0)
        follow_tip(model, state, tips)
        return float(np.linalg.norm(way, axis=1).sum())

    def _find_tip(self, time: float) -> Array:
        """The finger's center (2,) at a time, m."""
        path = np.array(self._tips)
        times = np.array(self._times)
        return np.array([np.interp(time, times, path[:, i]) for i in range(2)])

    def _measure(self, off: Array) -> float:
        """Size of a difference of poses (3,), m."""
        return float(np.hypot(np.hypot(off[0], off[1]), self._arm * wrap_angle(off[2])))

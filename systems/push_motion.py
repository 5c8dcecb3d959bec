"""Straight motions from rest to rest, as functions of time.

A motion of length d with top speed v and acceleration bound a ramps up during T, goes on at v during C, and ramps down
during T:

    ramp:      ds/dt = v (3 u^2 - 2 u^3),   s = v T (u^3 - u^4 / 2),   u = t / T
    T = 3 v / (2 a),   C = d / v - T

The ramp's acceleration 6 v u (1 - u) / T begins and ends at zero, so that position, velocity and acceleration are all
continuous, and is greatest in the middle, where it is a. A ramp covers v T / 2; where d is too short for two of them,
C = 0 and the top speed falls to sqrt(2 a d / 3).
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.systems.push_status import PushPhase

Array = NDArray[np.float64]
Point = tuple[float, float, float]

RAMP_PEAK = 1.5
"""Greatest slope of 3 u^2 - 2 u^3: a ramp's greatest acceleration over its mean one."""

ROUND_OFF = 1e-9
"""Share of a leg by which it is not worth cutting it short."""


@dataclass(frozen=True)
class Leg:
    """One straight motion of the tip, or a wait.

    Attributes:
        phase: what it is part of, see `push_status`.
        start: p_WP of the tip's centre at the beginning, m.
        end: likewise at the end.
        speed: greatest, m/s.
        acceleration: greatest, m/s².
        wait: to stay at the end, s.
    """

    phase: PushPhase
    start: Point
    end: Point
    speed: float = 1.0
    acceleration: float = 1.0
    wait: float = 0.0

    @property
    def length(self) -> float:
        """M."""
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    @property
    def top_speed(self) -> float:
        """Reached on the way: `speed`, or less where the leg is too short for it, m/s."""
        return min(self.speed, sqrt(self.acceleration * self.length / RAMP_PEAK))

    @property
    def ramp(self) -> float:
        """Time from rest to top speed, s."""
        return RAMP_PEAK * self.top_speed / self.acceleration

    @property
    def moving_time(self) -> float:
        """s, without the wait."""
        return self.length / self.top_speed + self.ramp if self.length > 0.0 else 0.0

    @property
    def duration(self) -> float:
        """s, with the wait."""
        return self.moving_time + self.wait

    def position(self, t: float) -> Array:
        """(3,) p_WP at time t after the beginning, m; rests before and after."""
        share = self._travelled(t) / self.length if self.length > 0.0 else 1.0
        return np.array(self.start) + share * np.subtract(self.end, self.start)

    def velocity(self, t: float) -> Array:
        """(3,) v_WP at time t after the beginning, m/s."""
        if self.length == 0.0:
            return np.zeros(3)
        return self._speed(t) / self.length * np.subtract(self.end, self.start)

    def stop_from(self, t: float) -> "Leg":
        """The same motion up to time t, and from there the soonest stop; itself where it ends as soon anyway.

        A motion that has begun is cut short to what it has travelled and one ramp more, or to two ramps: up to t it is
        then the same, and all is as continuous as before. One that has not begun becomes none.
        """
        if t <= 0.0 or self.length == 0.0:
            return replace(self, end=self.start)
        braking = self.top_speed * self.ramp / 2.0
        share = (max(self._travelled(t), braking) + braking) / self.length
        if share >= 1.0 - ROUND_OFF:
            return self
        x, y, z = (np.array(self.start) + share * np.subtract(self.end, self.start)).tolist()
        return replace(self, end=(x, y, z))

    def _travelled(self, t: float) -> float:
        """The way s made in time t, m."""
        if t <= 0.0:
            return 0.0
        if t >= self.moving_time:
            return self.length
        if t > self.moving_time / 2.0:
            return self.length - self._travelled(self.moving_time - t)
        u = min(t / self.ramp, 1.0)
        return self.top_speed * (self.ramp * (u**3 - u**4 / 2.0) + max(t - self.ramp, 0.0))

    def _speed(self, t: float) -> float:
        """ds/dt, m/s."""
        u = min(max(min(t, self.moving_time - t), 0.0) / self.ramp, 1.0)
        return self.top_speed * (3.0 * u**2 - 2.0 * u**3)

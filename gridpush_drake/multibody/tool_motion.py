"""Straight motions from rest to rest, as functions of time.

A motion of length d with top speed v and acceleration bound a ramps up during T, goes on at v during C, and ramps down
during T:

    ramp:      ds/dt = v (3 u^2 - 2 u^3),   s = v T (u^3 - u^4 / 2),   u = t / T
    T = 3 v / (2 a),   C = d / v - T

The ramp's acceleration 6 v u (1 - u) / T begins and ends at zero, so that position, velocity and acceleration are all
continuous, and is greatest in the middle, where it is a. A ramp covers v T / 2; where d is too short for two of them,
C = 0 and the top speed falls to sqrt(2 a d / 3).

Straight motions of the tool that also turn it about the vertical, from rest to rest, as functions of time.

A motion moves the tip by d and turns the tool by the angle b. Its way is

    s = sqrt(d^2 + (r b)^2)

with the turning radius r; along it goes the profile of `TrajectorySegment`, and tip and angle have the same share of
their way made at any time. So position, angle, and their first two derivatives are continuous.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from math import hypot, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

Array = NDArray[np.float64]

R_WP_DOWN = RollPitchYaw(0.0, np.pi, 0.0).ToRotationMatrix()
"""Of a tool that points down. Not (pi, 0, 0), from which the arm's elbow hangs."""
Point = tuple[float, float, float]

RAMP_PEAK = 1.5
"""Greatest slope of 3 u^2 - 2 u^3: a ramp's greatest acceleration over its mean one."""

ROUND_OFF = 1e-9
"""Share of a leg by which it is not worth cutting it short."""


@dataclass(frozen=True)
class TrajectorySegment:
    """One straight motion of the tip, or a wait.

    Attributes:
        phase: what it is part of of a motion
        start: p_WP of the tip's center at the beginning, m.
        end: likewise at the end.
        speed: greatest, m/s.
        acceleration: greatest, m/s².
        wait: to stay at the end, s.
    """

    phase: StrEnum
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
        share = self._traveled(t) / self.length if self.length > 0.0 else 1.0
        return np.array(self.start) + share * np.subtract(self.end, self.start)

    def velocity(self, t: float) -> Array:
        """(3,) v_WP at time t after the beginning, m/s."""
        if self.length == 0.0:
            return np.zeros(3)
        return self._speed(t) / self.length * np.subtract(self.end, self.start)

    def stop_from(self, t: float) -> "TrajectorySegment":
        """The same motion up to time t, and from there the soonest stop; itself where it ends as soon anyway.

        A motion that has begun is cut short to what it has traveled and one ramp more, or to two ramps: up to t it is
        then the same, and all is as continuous as before. One that has not begun becomes none.
        """
        if t <= 0.0 or self.length == 0.0:
            return replace(self, end=self.start)
        braking = self.top_speed * self.ramp / 2.0
        share = (max(self._traveled(t), braking) + braking) / self.length
        if share >= 1.0 - ROUND_OFF:
            return self
        x, y, z = (np.array(self.start) + share * np.subtract(self.end, self.start)).tolist()
        return replace(self, end=(x, y, z))

    def _traveled(self, t: float) -> float:
        """The way s made in time t, m."""
        if t <= 0.0:
            return 0.0
        if t >= self.moving_time:
            return self.length
        if t > self.moving_time / 2.0:
            return self.length - self._traveled(self.moving_time - t)
        u = min(t / self.ramp, 1.0)
        return self.top_speed * (self.ramp * (u**3 - u**4 / 2.0) + max(t - self.ramp, 0.0))

    def _speed(self, t: float) -> float:
        """ds/dt, m/s."""
        u = min(max(min(t, self.moving_time - t), 0.0) / self.ramp, 1.0)
        return self.top_speed * (3.0 * u**2 - 2.0 * u**3)


ToolPose = tuple[float, float, float, float]
"""p_WP of the tip's center, m, and the tool's yaw, rad: 0 is `R_WP_DOWN`."""

TURNING_RADIUS = 0.3
"""m of way that a turn by a radian counts."""


def calc_tool_rotation(yaw: float) -> RotationMatrix:
    """R_WP of a tool that points down and is turned by `yaw` (rad) about W's z axis."""
    return RotationMatrix.MakeZRotation(yaw) @ R_WP_DOWN if yaw else R_WP_DOWN


def calc_tool_pose(X_WP: RigidTransform) -> ToolPose:
    """Reads tip and yaw, in (-pi, pi], from the pose of a tool that points down."""
    x, y, z = X_WP.translation().tolist()
    R = X_WP.rotation().matrix() @ R_WP_DOWN.matrix().T
    return x, y, z, float(np.arctan2(R[1, 0], R[0, 0]))


def make_transform(pose: ArrayLike) -> RigidTransform:
    """X_WP of a tool's pose (4,): x, y, z, m, and yaw, rad."""
    *p_WP, yaw = np.asarray(pose, float).tolist()
    return RigidTransform(calc_tool_rotation(yaw), p_WP)


@dataclass(frozen=True)
class ToolTrajectorySegment:
    """One straight motion of the tool, or a wait, with the gripper's opening.

    Attributes:
        phase: what it is part of of a motion
        start: of tip and yaw.
        end: likewise.
        speed: greatest, m/s of the way.
        acceleration: greatest, m/s².
        wait: to stay at the end, s.
        opening: that the gripper is asked for at the beginning and at the end of the leg, m; linear in between.
    """

    phase: StrEnum
    start: ToolPose
    end: ToolPose
    speed: float = 1.0
    acceleration: float = 1.0
    wait: float = 0.0
    opening: tuple[float, float] = (0.1, 0.1)

    @cached_property
    def profile(self) -> TrajectorySegment:
        """The way made in time, along the x axis; of no phase of a push."""
        *p_start, from_yaw = self.start
        *p_end, to_yaw = self.end
        way = hypot(float(np.linalg.norm(np.subtract(p_end, p_start))), TURNING_RADIUS * (to_yaw - from_yaw))
        return TrajectorySegment(self.phase, (0.0, 0.0, 0.0), (way, 0.0, 0.0), self.speed, self.acceleration, self.wait)

    @property
    def duration(self) -> float:
        """s, with the wait."""
        return self.profile.duration

    @property
    def top_speed(self) -> float:
        """Reached on the way, m/s; 0 for a wait."""
        return self.profile.top_speed

    def calc_pose(self, t: float) -> Array:
        """(4,) tip, m, and yaw, rad, at time t after the beginning; rests before and after."""
        length = self.profile.length
        share = float(self.profile.position(t)[0]) / length if length > 0.0 else 1.0
        return np.array(self.start) + share * np.subtract(self.end, self.start)

    def calc_opening(self, t: float) -> float:
        """That the gripper is asked for at time t after the beginning, m."""
        begin, end = self.opening
        share = min(max(t / self.duration, 0.0), 1.0) if self.duration > 0.0 else 1.0
        return begin + share * (end - begin)

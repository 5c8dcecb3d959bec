"""Straight motions of the tool from rest to rest, as trajectories of Drake's, and the tool's poses.

A motion moves the tip by d and may turn the tool about the vertical by the angle b. The length of
its path is

    l = sqrt(d^2 + (r b)^2)

with the turning radius r. With top speed v and acceleration bound a, the length s made by time t
grows during T, goes on at v during C, and slows down during T:

    ramp:      ds/dt = v (3 u^2 - 2 u^3),   s = v T (u^3 - u^4 / 2),   u = t / T
    T = 3 v / (2 a),   C = l / v - T

The ramp's acceleration 6 v u (1 - u) / T begins and ends at zero, so that position, velocity and
acceleration are all continuous, and is greatest in the middle, where it is a. A ramp covers v T /
2; where l is too short for two of them, C = 0 and the top speed falls to sqrt(2 a l / 3).

The yaw is a number and no rotation: a wrist that has to turn by more than half a turn does so,
while a `PiecewisePose` would go the shorter way.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PathParameterizedTrajectory, PiecewisePolynomial

from gridpush_drake.geometry.se2 import Array

R_WP_DOWN = RollPitchYaw(0.0, np.pi, 0.0).ToRotationMatrix()
"""Rotation of a tool that points down. It is not (pi, 0, 0), from which the arm's elbow hangs."""

Point = tuple[float, float, float]
"""Place p_WP of the tip's center, m."""

ToolPose = tuple[float, float, float, float]
"""Place p_WP of the tip's center, m, and the tool's yaw, rad: 0 is `R_WP_DOWN`."""

TipRule = Callable[[Array, float], str | None]
"""Says in a sentence why the tip may not be at p_WP (3,), m, with the tool's yaw, rad; or None."""

TURNING_RADIUS = 0.3
"""Length of path for which a turn by a radian counts, m."""

RAMP_PEAK = 1.5
"""Largest slope of 3 u^2 - 2 u^3: a ramp's largest acceleration over its mean one."""

ROUND_OFF = 1e-9
"""Fraction of a segment by which it is not worth cutting it short, and of a ramp by which it is not
worth cruising."""


@dataclass(frozen=True)
class TrajectorySegment:
    """One straight motion of the tool, or a wait.

    Attributes:
        phase: what it is part of.
        start: `Point` or `ToolPose` at the beginning.
        end: `Point` or `ToolPose` at the end.
        speed: largest speed along the path, m/s.
        acceleration: largest acceleration along the path, m/s².
        wait: how long the tool stays at the end, s.
    """

    phase: StrEnum
    start: tuple[float, ...]
    end: tuple[float, ...]
    speed: float = 1.0
    acceleration: float = 1.0
    wait: float = 0.0

    @cached_property
    def length(self) -> float:
        """Length l of the path, m."""
        change = np.subtract(self.end, self.start)
        change[3:] *= TURNING_RADIUS
        return float(np.linalg.norm(change))

    @property
    def top_speed(self) -> float:
        """Speed v that is reached, m/s: `speed`, less on a path too short for it, 0 in a wait."""
        return min(self.speed, sqrt(self.acceleration * self.length / RAMP_PEAK))

    @property
    def ramp(self) -> float:
        """Time T from rest to top speed, s."""
        return RAMP_PEAK * self.top_speed / self.acceleration

    @property
    def moving_time(self) -> float:
        """Time that the motion takes without the wait, s."""
        return self.length / self.top_speed + self.ramp if self.length > 0.0 else 0.0

    @property
    def duration(self) -> float:
        """Time that the motion takes with the wait, s."""
        return self.moving_time + self.wait

    @cached_property
    def time_scaling(self) -> PiecewisePolynomial:
        """Length s, m, made by time t, s, of a segment that moves."""
        v = self.top_speed
        T = self.ramp
        cruise = self.moving_time - 2.0 * T
        up = Polynomial(np.array([0.0, 0.0, 0.0, v / T**2, -v / (2.0 * T**3)]))
        level = Polynomial(np.array([v * T / 2.0, v]))
        down = Polynomial(
            np.array([self.length - v * T / 2.0, v, 0.0, -v / T**2, v / (2.0 * T**3)])
        )
        if cruise < ROUND_OFF * T:
            return PiecewisePolynomial([up, down], [0.0, T, self.moving_time])
        return PiecewisePolynomial([up, level, down], [0.0, T, T + cruise, self.moving_time])

    @cached_property
    def trajectory(self) -> PathParameterizedTrajectory:
        """Place and yaw, as in `start`, over the time since the beginning, s, without the wait.

        Only a segment that moves has one.
        """
        path = PiecewisePolynomial.FirstOrderHold(
            [0.0, self.length], np.column_stack([self.start, self.end])
        )
        return PathParameterizedTrajectory(path, self.time_scaling)

    def position(self, t: float) -> Array:
        """Place and yaw at time t, s, after the beginning; at rest before and after."""
        if self.length == 0.0:
            return np.array(self.start)
        return np.asarray(self.trajectory.value(t))[:, 0]

    def velocity(self, t: float) -> Array:
        """Velocity of `position`, m/s and rad/s, at time t, s, after the beginning."""
        if self.length == 0.0:
            return np.zeros(len(self.start))
        return np.asarray(self.trajectory.EvalDerivative(t, 1))[:, 0]

    def stop_from(self, t: float) -> "TrajectorySegment":
        """Ends the motion by the soonest stop after time t, s.

        A motion that has begun is cut short to what it has traveled and one ramp more, or to two
        ramps: up to t it is then the same, and all is as continuous as before. One that has not
        begun becomes none.

        Returns:
            The motion, up to t the same; itself where it ends as soon anyway.
        """
        if t <= 0.0 or self.length == 0.0:
            return replace(self, end=self.start)
        # A ramp covers v T / 2.
        braking = self.top_speed * self.ramp / 2.0
        made = max(float(self.time_scaling.value(t)[0, 0]), braking)
        fraction = (made + braking) / self.length
        if fraction >= 1.0 - ROUND_OFF:
            return self
        end = np.array(self.start) + fraction * np.subtract(self.end, self.start)
        return replace(self, end=tuple(end.tolist()))


@dataclass(frozen=True)
class ToolTrajectorySegment(TrajectorySegment):
    """One straight motion of the tool, or a wait, with the gripper's opening.

    Attributes:
        start: tip and yaw at the beginning.
        end: tip and yaw at the end.
        opening: the openings that the gripper is asked for at the beginning and at the end, m;
            linear in between.
    """

    start: ToolPose
    end: ToolPose
    opening: tuple[float, float] = (0.1, 0.1)

    def calc_opening(self, t: float) -> float:
        """Calculates the opening, m, that is asked for at time t, s, after the beginning."""
        if self.duration <= 0.0:
            return self.opening[1]
        return float(np.interp(t, [0.0, self.duration], self.opening))


def calc_tool_rotation(yaw: float) -> RotationMatrix:
    """Makes R_WP of a tool that points down and is turned by a yaw, rad, about W's z axis."""
    return RotationMatrix.MakeZRotation(yaw) @ R_WP_DOWN if yaw else R_WP_DOWN


def calc_tool_pose(X_WP: RigidTransform) -> ToolPose:
    """Reads tip and yaw, in (-pi, pi], from the pose of a tool that points down."""
    x, y, z = X_WP.translation().tolist()
    R = X_WP.rotation().matrix() @ R_WP_DOWN.matrix().T
    return x, y, z, float(np.arctan2(R[1, 0], R[0, 0]))


def make_transform(pose: ArrayLike) -> RigidTransform:
    """Makes X_WP of a tool's pose (4,): x, y, z, m, and yaw, rad; of (3,) the yaw is 0."""
    x, y, z, *yaw = np.asarray(pose, float).tolist()
    return RigidTransform(calc_tool_rotation(*yaw or (0.0,)), [x, y, z])

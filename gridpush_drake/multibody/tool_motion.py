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
"""Of a tool that points down. Not (pi, 0, 0), from which the arm's elbow hangs."""

Point = tuple[float, float, float]
"""p_WP of the tip's center, m."""

ToolPose = tuple[float, float, float, float]
"""p_WP of the tip's center, m, and the tool's yaw, rad: 0 is `R_WP_DOWN`."""

TURNING_RADIUS = 0.3
"""M of path that a turn by a radian counts."""

RAMP_PEAK = 1.5
"""Greatest slope of 3 u^2 - 2 u^3: a ramp's greatest acceleration over its mean one."""

ROUND_OFF = 1e-9
"""Share of a segment by which it is not worth cutting it short, and of a ramp by which it is not
worth cruising."""


@dataclass(frozen=True)
class TrajectorySegment:
    """One straight motion of the tool, or a wait."""

    phase: StrEnum  # what it is part of
    start: tuple[float, ...]  # `Point` or `ToolPose` at the beginning
    end: tuple[float, ...]  # likewise at the end
    speed: float = 1.0  # greatest, m/s along the path
    acceleration: float = 1.0  # greatest, m/s²
    wait: float = 0.0  # to stay at the end, s

    @cached_property
    def length(self) -> float:
        """Of the path, m."""
        change = np.subtract(self.end, self.start)
        change[3:] *= TURNING_RADIUS
        return float(np.linalg.norm(change))

    @property
    def top_speed(self) -> float:
        """Reached on the path: `speed`, or less where the segment is too short for it; 0 for a wait; m/s."""
        return min(self.speed, sqrt(self.acceleration * self.length / RAMP_PEAK))

    @property
    def ramp(self) -> float:
        """Time from rest to top speed, s."""
        return RAMP_PEAK * self.top_speed / self.acceleration

    @property
    def moving_time(self) -> float:
        """Without the wait, s."""
        return self.length / self.top_speed + self.ramp if self.length > 0.0 else 0.0

    @property
    def duration(self) -> float:
        """With the wait, s."""
        return self.moving_time + self.wait

    @cached_property
    def time_scaling(self) -> PiecewisePolynomial:
        """The length s, m, made by time t, s; of a segment that moves."""
        v, T, cruise = self.top_speed, self.ramp, self.moving_time - 2.0 * self.ramp
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
        """(3,) or (4,) as `start`, over the time since the beginning, s, without the wait; of a segment that moves."""
        path = PiecewisePolynomial.FirstOrderHold(
            [0.0, self.length], np.column_stack([self.start, self.end])
        )
        return PathParameterizedTrajectory(path, self.time_scaling)

    def position(self, t: float) -> Array:
        """As `start`, at time t after the beginning; rests before and after."""
        if self.length == 0.0:
            return np.array(self.start)
        return np.asarray(self.trajectory.value(t))[:, 0]

    def velocity(self, t: float) -> Array:
        """Of `position`, m/s and rad/s."""
        if self.length == 0.0:
            return np.zeros(len(self.start))
        return np.asarray(self.trajectory.EvalDerivative(t, 1))[:, 0]

    def stop_from(self, t: float) -> "TrajectorySegment":
        """The same motion up to time t, and from there the soonest stop; itself where it ends as soon anyway.

        A motion that has begun is cut short to what it has traveled and one ramp more, or to two
        ramps: up to t it is then the same, and all is as continuous as before. One that has not
        begun becomes none.
        """
        if t <= 0.0 or self.length == 0.0:
            return replace(self, end=self.start)
        braking = self.top_speed * self.ramp / 2.0
        share = (max(float(self.time_scaling.value(t)[0, 0]), braking) + braking) / self.length
        if share >= 1.0 - ROUND_OFF:
            return self
        return replace(
            self,
            end=tuple((np.array(self.start) + share * np.subtract(self.end, self.start)).tolist()),
        )


@dataclass(frozen=True)
class ToolTrajectorySegment(TrajectorySegment):
    """One straight motion of the tool, or a wait, with the gripper's opening.

    Attributes:
        start: of tip and yaw.
        end: likewise.
        opening: that the gripper is asked for at the beginning and at the end, m; linear in
            between.
    """

    start: ToolPose
    end: ToolPose
    opening: tuple[float, float] = (0.1, 0.1)

    def calc_opening(self, t: float) -> float:
        """That the gripper is asked for at time t after the beginning, m."""
        return (
            float(np.interp(t, [0.0, self.duration], self.opening))
            if self.duration > 0.0
            else self.opening[1]
        )


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

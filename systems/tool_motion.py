"""Straight motions of the tool that also turn it about the vertical, from rest to rest, as functions of time.

A motion moves the tip by d and turns the tool by the angle b. Its way is

    s = sqrt(d^2 + (r b)^2)

with the turning radius r; along it goes the profile of `push_motion.Leg`, and tip and angle have the same share of
their way made at any time. So position, angle, and their first two derivatives are continuous.
"""

from dataclasses import dataclass
from functools import cached_property
from math import hypot

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RotationMatrix

from gridpush_drake.systems.grasp_status import GraspPhase
from gridpush_drake.systems.push_executor import R_WP_DOWN
from gridpush_drake.systems.push_motion import Leg
from gridpush_drake.systems.push_status import PushPhase

Array = NDArray[np.float64]
ToolPose = tuple[float, float, float, float]
"""p_WP of the tip's centre, m, and the tool's yaw, rad: 0 is `R_WP_DOWN`."""

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
class ToolLeg:
    """One straight motion of the tool, or a wait, with the gripper's opening.

    Attributes:
        phase: what it is part of, see `grasp_status`.
        start: of tip and yaw.
        end: likewise.
        speed: greatest, m/s of the way.
        acceleration: greatest, m/s².
        wait: to stay at the end, s.
        opening: that the gripper is asked for at the beginning and at the end of the leg, m; linear in between.
    """

    phase: GraspPhase
    start: ToolPose
    end: ToolPose
    speed: float = 1.0
    acceleration: float = 1.0
    wait: float = 0.0
    opening: tuple[float, float] = (0.1, 0.1)

    @cached_property
    def profile(self) -> Leg:
        """The way made in time, along the x axis; of no phase of a push."""
        *p_start, from_yaw = self.start
        *p_end, to_yaw = self.end
        way = hypot(float(np.linalg.norm(np.subtract(p_end, p_start))), TURNING_RADIUS * (to_yaw - from_yaw))
        return Leg(PushPhase.IDLE, (0.0, 0.0, 0.0), (way, 0.0, 0.0), self.speed, self.acceleration, self.wait)

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

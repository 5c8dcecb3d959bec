"""The regions in which the finger's tip may be: while it pushes, and while it is steered."""

from typing import Protocol

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.station.robot.arm import ArmReach
from gridpush_drake.station.robot.robot import Robot
from gridpush_drake.station.scene.contents import CalcTipReach
from gridpush_drake.station.scene.posts import leave_out
from gridpush_drake.station.schema.scenario import PushScenario

STEER_INSET = 0.03
"""Distance that a steered finger keeps from the limits of workspace and reach, m. There the joints
of a stretched arm would turn too fast for it."""

STEER_TURNING_SPEED = 1.0
"""Greatest speed at which a gripper turns while it is steered, rad/s."""

MOST_STEER_YAW = 1.8
"""Greatest angle to which a gripper is turned while it is steered, either way, rad. It looks the
same after half a turn, so that it faces any direction, and has something left to turn with."""

CRACK_HALF_WIDTH = 1e-4
"""Half the width of cracks in a region that do not count, m."""

REGION_SLACK = 0.003
"""Distance by which a steered finger may leave its region before it is held back, m. It is less
than the distance that plans keep from obstacles."""

RING_SEGMENTS = 32
"""Number of the sides by which a polygon replaces a quarter of a circle."""


class Surroundings(Protocol):
    """What has to be known of a robot's surroundings; a `Setting` and a `Station` know it."""

    @property
    def scenario(self) -> PushScenario:
        """The scenario, with workspace and finger."""
        ...

    @property
    def plant(self) -> MultibodyPlant:
        """The scene's plant, finalised."""
        ...

    @property
    def robot(self) -> Robot:
        """The robot."""
        ...

    @property
    def obstacles(self) -> tuple[Polygon, ...]:
        """What the tip must not touch, polygons in W, m."""
        ...


class ReachableSurroundings(Surroundings, Protocol):
    """A robot's surroundings and its arm's reach; a `Station` knows both."""

    @property
    def reach(self) -> ArmReach:
        """Says whether the arm can follow a path."""
        ...


def MakeFingerRegion(
    station: ReachableSurroundings, inset: float = 0.0, *, around_others: bool = True
) -> BaseGeometry:
    """Makes the region in which the tip's center may be while it pushes.

    Args:
        station: the station.
        inset: distance by which the region is made smaller on all sides, m.
        around_others: whether places where the tip would touch another object are left out.

    Returns:
        A polygon or several in W, m, see `make_finger_region`.
    """
    if not around_others:
        return _make_reach_region(station, station.reach, inset)
    return make_finger_region(station, station.reach, inset)


def make_finger_region(setting: Surroundings, reach: ArmReach, inset: float = 0.0) -> BaseGeometry:
    """Makes the region in which the tip's center may be while it pushes.

    Args:
        setting: robot and scene.
        reach: says whether the arm can follow a path.
        inset: distance by which the region is made smaller on all sides, m.

    Returns:
        A polygon or several in W, m: the part of the workspace that the arm reaches, without the
        places where the tip would touch an obstacle; it may be empty.
    """
    region = _make_reach_region(setting, reach, inset)
    return leave_out(region, setting.obstacles, setting.robot.clear_radius + inset)


def make_steer_region(setting: Surroundings, reach: ArmReach, speed: float) -> BaseGeometry:
    """Makes the region in which the tip's center may be while the finger is steered, W, m.

    It is that of `make_finger_region`, but for what is near the limits of workspace and reach, and
    for where the arm is too stretched to move its finger as fast as it may be steered.

    Args:
        setting: robot and scene.
        reach: says whether the arm can follow a path.
        speed: greatest speed of the finger, m/s.
    """
    region = _make_reach_region(setting, reach, STEER_INSET, speed)
    return leave_out(region, setting.obstacles, setting.robot.clear_radius)


def _make_reach_region(
    setting: Surroundings, reach: ArmReach, inset: float, speed: float | None = None
) -> BaseGeometry:
    """Makes the part of the workspace that the arm reaches, W, m, made smaller by an inset, m.

    With a speed, m/s, it is the part in which the arm can move the tip as fast as that.
    """
    workspace = setting.scenario.workspace
    height = setting.scenario.finger.push_height
    box = shapely.box(workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1])
    if setting.robot.arm.reach is None or speed is not None:
        # A region that is found in squares has hairline cracks between them.
        turns = setting.robot.shape is not None and speed is not None
        yaws = (0.0, -MOST_STEER_YAW, MOST_STEER_YAW) if turns else (0.0,)
        found = shapely.intersection_all(
            [reach.find_region(box.bounds, height, speed=speed, yaw=yaw) for yaw in yaws]
        )
        box = found.buffer(CRACK_HALF_WIDTH, join_style="mitre").buffer(-CRACK_HALF_WIDTH)
    if setting.robot.arm.reach is None:
        return box.buffer(-inset)
    axis, least, greatest = CalcTipReach(setting.plant, setting.robot, height)
    return MakeRing(axis, least + inset, greatest - inset) & box.buffer(-inset)


def MakeRing(axis: NDArray[np.float64], least: float, greatest: float) -> shapely.Polygon:
    """Makes a ring about a point (2,) in W, between the least and the greatest radius, all in m."""
    center = shapely.Point(axis)
    return center.buffer(greatest, RING_SEGMENTS) - center.buffer(least, RING_SEGMENTS)

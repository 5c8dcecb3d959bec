"""`StationSetting`: what a station knows of its robot and table, simulated or real.

`make_surface` makes the table's top as planners know it, and `find_obstacles` what stands on it.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from pydrake.multibody.plant import MultibodyPlant
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.station.robot.robot import Robot
from gridpush_drake.station.scene.camera import FoundObject
from gridpush_drake.station.scene.contents import CalcBasePose
from gridpush_drake.station.scene.other_objects import OtherObject, list_others, place_others
from gridpush_drake.station.scene.posts import place_posts
from gridpush_drake.station.scene.resolve import ResolvedScenario
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.execution.push_executor import PushTrajectoryOptions

EDGE_DETAIL = 5e-4
"""Distance by which the table's edge may be simplified, m. A round table becomes a polygon of few
corners."""


def make_surface(table_top: BaseGeometry) -> SupportSurface:
    """Makes the surface that planners know from the table's top, a polygon in W, m.

    Raises:
        ScenarioError: the table's top is in several pieces.
    """
    if not isinstance(table_top, Polygon):
        raise ScenarioError("directives: the table's top is in several pieces; expected one")
    return SupportSurface(shapely.simplify(table_top, EDGE_DETAIL))


def make_style(scenario: PushScenario, robot: Robot) -> PushTrajectoryOptions:
    """Makes the options of the finger's path in a push from scenario and robot."""
    finger = scenario.finger
    return PushTrajectoryOptions(
        travel_height=finger.travel_height,
        push_height=finger.push_height,
        tip_radius=robot.finger.tip_radius,
        shape=robot.shape,
    )


@dataclass(frozen=True, eq=False)
class StationSetting:
    """What a station knows of its robot and of the table before it, whether simulated or real.

    Attributes:
        scenario: the scenario that it was made from. With a color and depth camera, pose and
            height of the object are those that the camera saw.
        obj: the object, as the robot knows it.
        found: the object as it was found in the photograph; None if the robot is told the object.
        others: the other objects on the table.
        plant: the scene's plant, finalised. With a real robot it is never simulated, and serves
            only for measures.
        control_plant: the robot alone, as `MakeControlPlant` makes it.
        robot: measures of the robot, and the names of its models.
        table_top: the part of the table where things may lie, a polygon in W, m.
        home: p_WP of the tip at the beginning, m.
        q_start: (n,) the arm's joint positions with the tip at `home`, rad. The inverse kinematics
            is drawn to them.
    """

    scenario: PushScenario
    obj: GridObject
    found: FoundObject | None
    others: tuple[OtherObject, ...]
    plant: MultibodyPlant
    control_plant: MultibodyPlant
    robot: Robot
    table_top: BaseGeometry
    home: tuple[float, float, float]
    q_start: Array

    @property
    def obstacles(self) -> tuple[Polygon, ...]:
        """What pushes are planned around, polygons in W, m: posts, and other objects."""
        return (*place_posts(self.scenario.posts), *place_others(self.others))


def find_obstacles(resolved: ResolvedScenario) -> tuple[Polygon, ...]:
    """Finds what pushes are planned around before there is a station; see `Setting.obstacles`."""
    others = list_others(resolved.scenario, resolved.others)
    return (*place_posts(resolved.scenario.posts), *place_others(others))


def MakeSetting(
    resolved: ResolvedScenario,
    scenario: PushScenario,
    plant: MultibodyPlant,
    found: FoundObject | None = None,
    others: tuple[OtherObject, ...] = (),
) -> StationSetting:
    """Makes a setting of a resolved scenario; see `StationSetting` for what its parts mean.

    Args:
        resolved: the resolved scenario.
        scenario: its scenario, or a copy with the object's pose and height as the camera saw them.
        plant: the scene's plant, finalised.
        found: the object as it was found in the photograph; None if the robot is told the object.
        others: the other objects in the plant.
    """
    obj = resolved.obj if found is None else found.obj
    return StationSetting(
        scenario=scenario,
        obj=obj.forget() if scenario.unknown_inertia else obj,
        found=found,
        others=others,
        plant=plant,
        control_plant=resolved.control_plant,
        robot=resolved.robot,
        table_top=resolved.table_top,
        home=resolved.home,
        q_start=resolved.q_start,
    )


def find_lookouts(setting: StationSetting) -> Array:
    """Chooses places for the tip, (3, 3), p_WP, m, from which the arm hides little from a camera.

    The arm may stand between the camera and the object. If the object is not seen, the executor
    moves the tip to these places in turn. They are the tip's home and, at the same height, the two
    corners of the workspace that are nearest to the robot's base, where the arm is folded. What the
    arm hides at one of the places can be seen when it is at another.
    """
    workspace = setting.scenario.workspace
    z = setting.home[2]
    p_WR = CalcBasePose(setting.plant, setting.robot).translation()
    corners = np.array([(x, y, z) for x in workspace.x for y in workspace.y])
    nearest = np.argsort(np.linalg.norm(corners[:, :2] - p_WR[:2], axis=1), kind="stable")[:2]
    return np.vstack([setting.home, corners[nearest]])

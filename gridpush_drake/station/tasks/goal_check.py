"""Checks of places that a scenario sends its object to, before the robot begins.

What can be known of a goal without knowing the object's masses is refused at the door: an object
that would hang over the table's edge there, touch an obstacle, or lie where the finger does not
come to it. Whether there is a way to the goal is known only on the way.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.push_constraints import PushConstraints, make_body
from gridpush_drake.station.scene.resolve import ResolvedScenario
from gridpush_drake.station.scene.setting import find_obstacles, make_surface

EXPECTED_POSE = "expected [x, y, theta] (m, rad)"
"""What a pose of a scenario should be, for messages."""


def check_place(name: str, obj: GridObject, pose: Array, constraints: PushConstraints) -> None:
    """Checks that an object may lie somewhere.

    Args:
        name: of the scenario's field that tells the pose.
        obj: the object.
        pose: (3,) X_WB, m and rad.
        constraints: the table and its obstacles.

    Raises:
        ScenarioError: the object would hang over the table's edge there, or be too near to it, or
            to an obstacle.
    """
    on_table, blocked = constraints.allow_pose(obj, pose)
    # The whole outline must be over the table: with masses unknown, nothing less is safe.
    if not on_table:
        raise ScenarioError(
            f"{_describe(name, pose)}: there the object is nearer than "
            f"{constraints.edge_margin:g} m to the table's edge, or beyond it; {EXPECTED_POSE} "
            "farther "
            "in"
        )
    # Nor may it touch what else stands there, which is known before the robot begins.
    if blocked:
        raise ScenarioError(
            f"{_describe(name, pose)}: there the object is nearer than "
            f"{constraints.obstacle_margin:g} m to an obstacle; {EXPECTED_POSE} clear of all of "
            "them"
        )


def list_misplaced(
    places: Mapping[str, Array], resolved: ResolvedScenario, margins: PushConstraints
) -> list[str]:
    """Lists at which poses the object would hang over the table's edge, or touch an obstacle.

    Args:
        places: (3,) X_WB, m and rad, by the names of the scenario's fields.
        resolved: the scenario.
        margins: rules of which the margins from the table's edge and from obstacles hold here.

    Returns:
        A message for each; none with a camera, for that measures the outline, which is not known
        yet.
    """
    if resolved.scenario.camera.kind != "ideal":
        return []
    constraints = replace(
        margins, surface=make_surface(resolved.table_top), obstacles=find_obstacles(resolved)
    )
    faults = []
    for name, pose in places.items():
        try:
            check_place(name, resolved.obj, pose, constraints)
        except ScenarioError as error:
            faults.append(str(error))
    return faults


def check_reach(
    name: str, obj: GridObject, pose: Array, region: BaseGeometry, radius: float
) -> None:
    """Checks that the finger comes to an object.

    Args:
        name: of the scenario's field that tells the pose.
        obj: the object.
        pose: (3,) X_WB, m and rad.
        region: where the finger's center may be, W.
        radius: of the finger, m.

    Raises:
        ScenarioError: it does not.
    """
    # For the last push the finger has to touch the object beside its goal.
    if region.distance(transform_shape(pose, make_body(obj))) > radius:
        raise ScenarioError(
            f"{_describe(name, pose)}: there the finger does not come to the object; "
            f"{EXPECTED_POSE} "
            "within the robot's reach"
        )


def _describe(name: str, pose: Array) -> str:
    """Says what a field is."""
    x, y, theta = np.asarray(pose).tolist()
    return f"{name} is [{x:g}, {y:g}, {theta:g}]"

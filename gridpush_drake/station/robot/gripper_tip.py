"""`MeasureGripperTip`: what of a gripper touches an object that it pushes.

The gripper points down. Of its collision geometry that counts which is no higher above the table
than the object. Of a closed gripper the pusher is the convex hull of it, seen from above. Two
fingers that are apart have a hull each, along whose rim stand discs so close together that a corner
of an object comes in between them by less than a millimeter. So the model of the gripper says how
wide it is, and no file has to say it again.
"""

from collections.abc import Sequence

import numpy as np
import shapely
import shapely.affinity
from pydrake.geometry import Box, SceneGraphInspector, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from gridpush_drake.dynamics.pusher import SYMMETRY_TOLERANCE, PusherShape
from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.station.robot.robot import GripperTip, Robot

CORNER_RADIUS = 5e-4
"""Radius by which the corners of the hull are rounded, m, as those of objects are."""

HULL_DETAIL = 1e-5
"""Distance by which the hull may be simplified, m."""

HALF_TURN = 180.0
"""Degrees of half a turn."""

DISCS_ACROSS = 6.0
"""How many times as wide as the radius of its discs a finger is at least."""


def MeasureGripperTip(
    plant: MultibodyPlant,
    inspector: SceneGraphInspector,
    robot: Robot,
    push_height: float,
    top: float,
    highest: float,
) -> GripperTip:
    """Measures the ends of the gripper with which a robot pushes.

    Args:
        plant: a finalised plant with the robot's scene.
        inspector: of its scene graph.
        robot: a robot whose gripper pushes.
        push_height: height of the tip's frame above the table, m.
        top: height of the highest object, m.
        highest: height of the highest object or post, m.

    Returns:
        Its shape, and how far it reaches down and to the side.

    Raises:
        ScenarioError: a collision geometry is neither a box nor a sphere, none is as low as the
            object, the fingers do not look the same after half a turn, or two fingertips that
            should push are not apart.
    """
    model = robot.finger_model
    gripper = plant.GetModelInstanceByName(model)
    context = plant.CreateDefaultContext()  # in which the fingers are as far apart as they should
    tip = plant.GetFrameByName(robot.finger.tip_frame, gripper)
    touching: list[BaseGeometry] = []
    depth = 0.0
    reach = 0.0
    for index in plant.GetBodyIndices(gripper):
        body = plant.get_body(index)
        X_PB = body.body_frame().CalcPose(context, tip)
        for geometry in plant.GetCollisionGeometriesForBody(body):
            shape = inspector.GetShape(geometry)
            if not isinstance(shape, Box | Sphere):
                raise ScenarioError(
                    f"directives: collision {inspector.GetName(geometry)} of {model} is a "
                    f"{type(shape).__name__}; expected boxes and spheres of a gripper that pushes"
                )
            corners, margin = _list_corners(shape, X_PB @ inspector.GetPoseInFrame(geometry))
            # z points down, from where the object's top is to where the table is
            low = corners[:, 2].max() + margin
            high = corners[:, 2].min() - margin
            depth = max(depth, float(low))
            if low > push_height - highest:
                aside = np.linalg.norm(corners[:, :2], axis=1).max() + margin
                reach = max(reach, float(aside))
            if high < push_height and low > push_height - top:
                # seen from above, x of the pusher's frame is against the tool's
                seen = corners[:, :2] * (-1.0, 1.0)
                touching.append(shapely.MultiPoint(seen).convex_hull.buffer(margin))
    if not touching:
        raise ScenarioError(
            f"pusher is a gripper, but no collision geometry of {model} is as low as the object's "
            f"top, {top:g} m; expected a lower finger.push_height"
        )
    make_shape = _make_hull if robot.opening == 0.0 else _make_fingertips
    return GripperTip(make_shape(touching, model), depth, reach)


def _list_corners(shape: Box | Sphere, X_PG: RigidTransform) -> tuple[Array, float]:
    """Lists corners (k, 3) of a box, or a sphere's center, in P, and what is about them, m."""
    if isinstance(shape, Sphere):
        return X_PG.translation()[None], float(shape.radius())
    half = np.array([shape.width(), shape.depth(), shape.height()]) / 2
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1)
    return np.asarray(X_PG @ (half[:, None] * signs)).T, 0.0


def _make_hull(touching: Sequence[BaseGeometry], model: str) -> PusherShape:
    """Makes the hull of what touches, in the pusher's frame, which is the same after half a turn.

    Raises:
        ScenarioError: it is not.
    """
    hull = shapely.union_all(list(touching)).convex_hull
    turned = _turn(hull)
    _check_symmetry(hull, turned, model)
    outline = orient((hull | turned).convex_hull.simplify(HULL_DETAIL))
    return PusherShape.polygon(shapely.get_coordinates(outline)[:-1], CORNER_RADIUS)


def _make_fingertips(touching: Sequence[BaseGeometry], model: str) -> PusherShape:
    """Makes discs along the rims of two fingers, in the pusher's frame, as `_make_hull` does.

    Raises:
        ScenarioError: they touch each other, or do not look the same after half a turn.
    """
    pieces = shapely.get_parts(shapely.union_all(list(touching)))
    right, left = (
        shapely.union_all([each for each in pieces if side * each.centroid.y > 0.0]).convex_hull
        for side in (-1.0, 1.0)
    )
    if not right.distance(left) > 0.0:
        raise ScenarioError(
            f"pusher is fingertips, but the fingers of {model} are not apart as low as the object; "
            "expected a larger finger.opening"
        )
    _check_symmetry(left, _turn(right), model)
    # Discs inside one finger that touch its rim, each at most a radius from the next.
    x_min, y_min, x_max, y_max = left.bounds
    radius = min(x_max - x_min, y_max - y_min) / DISCS_ACROSS
    rim = left.buffer(-radius, join_style="mitre").exterior
    corners = shapely.get_coordinates(rim)[:-1]
    more = shapely.get_coordinates(shapely.segmentize(rim, radius))[:-1]
    centers = np.unique(np.round(np.concatenate([corners, more]), 7), axis=0)
    return PusherShape.discs(np.concatenate([centers, -centers]), radius)


def _turn(area: BaseGeometry) -> BaseGeometry:
    """Turns an area by half a turn about the origin of the pusher's frame."""
    return shapely.affinity.rotate(area, HALF_TURN, origin=(0.0, 0.0))


def _check_symmetry(area: BaseGeometry, turned: BaseGeometry, model: str) -> None:
    """Raises ScenarioError where an area is not what it is after half a turn."""
    if area.symmetric_difference(turned).area > SYMMETRY_TOLERANCE * area.area:
        raise ScenarioError(
            f"pusher is a gripper, but the fingers of {model} look different after half a turn; "
            "expected tip_frame of its gripper.yaml in their middle"
        )

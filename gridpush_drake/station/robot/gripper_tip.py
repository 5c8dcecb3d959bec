"""`MeasureGripperTip`: what of a closed gripper touches an object that it pushes.

The gripper points down. Of its collision geometry that counts which is no higher above the table
than the object; the pusher is the convex hull of it, seen from above. So the model of the gripper
says how wide it is, and no file has to say it again.
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

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.station.robot.robot import GripperTip, Robot

CORNER_RADIUS = 5e-4
"""Radius by which the corners of the hull are rounded, m, as those of objects are."""

HULL_DETAIL = 1e-5
"""Distance by which the hull may be simplified, m."""

HALF_TURN = 180.0
"""Degrees of half a turn."""

SYMMETRY_TOLERANCE = 0.01
"""Fraction of its area by which the hull may change in half a turn."""


def MeasureGripperTip(
    plant: MultibodyPlant,
    inspector: SceneGraphInspector,
    robot: Robot,
    push_height: float,
    top: float,
) -> GripperTip:
    """Measures the ends of the closed gripper with which a robot pushes.

    Args:
        plant: a finalised plant with the robot's scene.
        inspector: of its scene graph.
        robot: a robot whose gripper pushes.
        push_height: height of the tip's frame above the table, m.
        top: height of the highest object, m.

    Returns:
        Its shape, and how far the fingers reach below the tip's frame.

    Raises:
        ScenarioError: a collision geometry is neither a box nor a sphere, none is as low as the
            object, or the fingers do not look the same after half a turn.
    """
    model = robot.finger_model
    gripper = plant.GetModelInstanceByName(model)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, gripper, np.zeros(plant.num_positions(gripper)))  # closed
    tip = plant.GetFrameByName(robot.finger.tip_frame, gripper)
    touching: list[BaseGeometry] = []
    depth = 0.0
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
            if high < push_height and low > push_height - top:
                # seen from above, x of the pusher's frame is against the tool's
                seen = corners[:, :2] * (-1.0, 1.0)
                touching.append(shapely.MultiPoint(seen).convex_hull.buffer(margin))
    if not touching:
        raise ScenarioError(
            f"pusher is gripper, but no collision geometry of {model} is as low as the object's "
            f"top, {top:g} m; expected a lower finger.push_height"
        )
    return GripperTip(_make_shape(touching, model), depth)


def _list_corners(shape: Box | Sphere, X_PG: RigidTransform) -> tuple[Array, float]:
    """Lists corners (k, 3) of a box, or a sphere's center, in P, and what is about them, m."""
    if isinstance(shape, Sphere):
        return X_PG.translation()[None], float(shape.radius())
    half = np.array([shape.width(), shape.depth(), shape.height()]) / 2
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1)
    return np.asarray(X_PG @ (half[:, None] * signs)).T, 0.0


def _make_shape(touching: Sequence[BaseGeometry], model: str) -> PusherShape:
    """Makes the hull of what touches, in the pusher's frame, which is the same after half a turn.

    Raises:
        ScenarioError: it is not.
    """
    hull = shapely.union_all(list(touching)).convex_hull
    turned = shapely.affinity.rotate(hull, HALF_TURN, origin=(0.0, 0.0))
    if hull.symmetric_difference(turned).area > SYMMETRY_TOLERANCE * hull.area:
        raise ScenarioError(
            f"pusher is gripper, but the closed fingers of {model} look different after half a "
            "turn; expected tip_frame of its gripper.yaml in their middle"
        )
    outline = orient((hull | turned).convex_hull.simplify(HULL_DETAIL))
    return PusherShape.polygon(shapely.get_coordinates(outline)[:-1], CORNER_RADIUS)

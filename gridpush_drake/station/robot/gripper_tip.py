"""`MeasureGripperTip`: what of a closed gripper touches an object that it pushes.

The gripper points down. Of its collision geometry that counts which is no higher above the table
than the object; the pusher is the convex hull of it, seen from above. So the model of the gripper
says how wide it is, and no file has to say it again.
"""

import numpy as np
import shapely
from pydrake.geometry import Box, SceneGraphInspector, Sphere
from pydrake.multibody.plant import MultibodyPlant
from shapely import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import ScenarioError
from gridpush_drake.station.robot.robot import GripperTip, Robot

CORNER_RADIUS = 5e-4
"""Radius by which the corners of the hull are rounded, m, as those of objects are."""

HULL_DETAIL = 1e-5
"""Distance by which the hull may be simplified, m."""

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
    positions = np.zeros(plant.num_positions(gripper))
    plant.SetPositions(context, gripper, positions)
    tip = plant.GetFrameByName(robot.finger.tip_frame, gripper)
    touching: list[BaseGeometry] = []
    depth = 0.0
    for index in plant.GetBodyIndices(gripper):
        body = plant.get_body(index)
        X_PB = body.body_frame().CalcPose(context, tip)
        for geometry in plant.GetCollisionGeometriesForBody(body):
            X_PG = X_PB @ inspector.GetPoseInFrame(geometry)
            shape = inspector.GetShape(geometry)
            if not isinstance(shape, Box | Sphere):
                raise ScenarioError(
                    f"directives: collision {inspector.GetName(geometry)} of {model} is a "
                    f"{type(shape).__name__}; expected boxes and spheres of a gripper that pushes"
                )
            # z points down, from where the object's top is to where the table is
            if isinstance(shape, Sphere):
                corners = X_PG.translation()[None]
                margin = shape.radius()
            else:
                half = np.array([shape.width(), shape.depth(), shape.height()]) / 2
                signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
                corners = np.asarray(X_PG @ (signs * half).T).T
                margin = 0.0
            low = corners[:, 2].max() + margin
            high = corners[:, 2].min() - margin
            depth = max(depth, float(low))
            if high < push_height and low > push_height - top:
                # seen from above, x of the pusher's frame is against the tool's
                seen = corners[:, :2] * (-1.0, 1.0)
                touching.append(shapely.MultiPoint(seen).convex_hull.buffer(margin))
    hull = shapely.union_all(touching).convex_hull
    turned = shapely.affinity.rotate(hull, 180.0, origin=(0.0, 0.0))
    if not isinstance(hull, Polygon):
        raise ScenarioError(
            f"pusher is gripper, but no collision geometry of {model} is as low as the object's "
            f"top, {top:g} m; expected a lower finger.push_height"
        )
    if hull.symmetric_difference(turned).area > SYMMETRY_TOLERANCE * hull.area:
        raise ScenarioError(
            f"pusher is gripper, but the closed fingers of {model} look different after half a "
            "turn; expected tip_frame of its gripper.yaml in their middle"
        )
    outline = orient((hull | turned).convex_hull.simplify(HULL_DETAIL))
    corners = shapely.get_coordinates(outline)[:-1]
    return GripperTip(PusherShape.polygon(corners, CORNER_RADIUS), depth)

"""Where on the table's top things may lie, read from the table's model, which alone says how large it is."""

from math import isclose

import numpy as np
import shapely
from pydrake.geometry import Box, Cylinder, GeometryId, SceneGraphInspector
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError

TABLE = "table"
"""Name of the table's model instance."""

TOP_TOLERANCE = 1e-6
"""m, about the plane z = 0; and of the table's normal, as a sine."""

QUADRANT_SEGMENTS = 256
"""Of the polygon within a round table's rim, a quarter turn; it lies within 2 um of a rim of 0.5 m."""

SEAM = 1e-9
"""m: outlines are rounded to it, so that pieces of a table that meet leave no gap."""


def FindTableTops(
    plant: MultibodyPlant, inspector: SceneGraphInspector, instance: str = TABLE
) -> dict[GeometryId, BaseGeometry]:
    """Finds the collision geometries whose top is the table's.

    Args:
        plant: finalised, the table fixed to its world.
        inspector: of the scene graph that the plant is registered with.
        instance: name of the table's model instance.

    Returns:
        The outline in W, m, of each box and upright cylinder of the table that ends at z = 0.

    Raises:
        ScenarioError: there is no such model, or none of its geometries ends there.
    """
    if not plant.HasModelInstanceNamed(instance):
        raise ScenarioError(f"directives: there is no model {instance}; expected one whose top lies at z = 0")
    context = plant.CreateDefaultContext()
    tops: dict[GeometryId, BaseGeometry] = {}
    for index in plant.GetBodyIndices(plant.GetModelInstanceByName(instance)):
        body = plant.get_body(index)
        X_WB = plant.EvalBodyPoseInWorld(context, body)
        for geometry in plant.GetCollisionGeometriesForBody(body):
            X_WG = X_WB @ inspector.GetPoseInFrame(geometry)
            outline = _outline_of(inspector.GetShape(geometry), X_WG)
            if outline is not None:
                tops[geometry] = outline
    if not tops:
        raise ScenarioError(f"directives: {instance} has no level box or cylinder that ends at z = 0; expected one")
    return tops


def FindTableOutline(plant: MultibodyPlant, inspector: SceneGraphInspector, instance: str = TABLE) -> BaseGeometry:
    """Finds where on the table's top things may lie: the union of `FindTableTops`, a polygon in W, m."""
    return shapely.union_all(list(FindTableTops(plant, inspector, instance).values()), grid_size=SEAM)


def _outline_of(shape: Box | Cylinder | object, X_WG: RigidTransform) -> BaseGeometry | None:
    """In W; None where the shape does not end level at z = 0."""
    R, p = X_WG.rotation().matrix(), X_WG.translation()
    if np.hypot(R[0, 2], R[1, 2]) > TOP_TOLERANCE or not isinstance(shape, Box | Cylinder):
        return None
    half = (shape.height() if isinstance(shape, Box) else shape.length()) / 2
    if not isclose(p[2] + half, 0.0, abs_tol=TOP_TOLERANCE):
        return None
    if isinstance(shape, Cylinder):
        return shapely.Point(p[:2]).buffer(shape.radius(), quad_segs=QUADRANT_SEGMENTS)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (shape.width() / 2, shape.depth() / 2)
    return shapely.Polygon(corners @ R[:2, :2].T + p[:2])

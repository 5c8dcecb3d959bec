"""Contact properties, with Drake's combination laws undone.

Two surfaces a and b touch with friction 2 mu_a mu_b/(mu_a + mu_b) and stiffness k_a k_b/(k_a +
k_b). Against a *stiff partner* of friction mu_b = 1 and stiffness k_b >> k_a, the contact has
friction mu and stiffness k_a where

    mu_a = mu mu_b / (2 mu_b - mu) = mu / (2 - mu)

So whatever touches a grid object (the table under its spheres, the pusher's tip at its side) is
made a stiff partner, and the object alone carries the parameters of the contact.

`FindTableOutline`: where on the table's top things may lie, read from the table's model, which
alone says how large it is.
"""

from collections.abc import Iterable
from math import isclose

import numpy as np
import shapely
from pydrake.geometry import (
    Box,
    Cylinder,
    GeometryId,
    ProximityProperties,
    RoleAssign,
    SceneGraph,
    SceneGraphInspector,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ParameterError, ScenarioError

PARTNER_FRICTION = 1.0
"""Coefficient of a stiff partner."""

PARTNER_STIFFNESS = 1e12
"""Stiffness of a stiff partner, N/m. Next to it every sphere's stiffness is its contact's, to
1e-6."""


def calc_own_friction(friction: float, name: str = "friction") -> float:
    """Calculates the coefficient that gives a contact with a stiff partner the wanted friction.

    Args:
        friction: the contact's friction mu, at least 0 and less than 2.
        name: what the friction is called in a message.

    Returns:
        mu / (2 - mu).

    Raises:
        ParameterError: no coefficient gives that much friction.
    """
    limit = 2 * PARTNER_FRICTION
    if not 0 <= friction < limit:
        raise ParameterError(
            f"{name} is {friction:g}; expected at least 0 and less than {limit:g} in a Drake plant"
        )
    return friction * PARTNER_FRICTION / (limit - friction)


def MakeContactProperties(
    friction: float, stiffness: float, dissipation: float = 0.0
) -> ProximityProperties:
    """Makes the properties of a surface.

    Args:
        friction: coefficient of static and of dynamic friction.
        stiffness: stiffness of a point contact, N/m.
        dissipation: dissipation by Hunt and Crossley, s/m.
    """
    properties = ProximityProperties()
    properties.AddProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
    properties.AddProperty("material", "point_contact_stiffness", float(stiffness))
    properties.AddProperty("material", "hunt_crossley_dissipation", float(dissipation))
    return properties


def MakePartnerProperties() -> ProximityProperties:
    """Makes the properties of a stiff partner."""
    return MakeContactProperties(PARTNER_FRICTION, PARTNER_STIFFNESS)


def SetPartner(
    plant: MultibodyPlant, scene_graph: SceneGraph, geometries: Iterable[GeometryId]
) -> None:
    """Makes stiff partners of collision geometries: those of the table, and of the tip.

    It is to be called before a Context is made.
    """
    source = plant.get_source_id()
    for geometry in geometries:
        # What else is known of the surface is kept, such as its hydroelastic properties.
        properties = ProximityProperties(
            scene_graph.model_inspector().GetProximityProperties(geometry)
        )
        wanted = MakePartnerProperties()
        for name in wanted.GetPropertiesInGroup("material"):
            properties.UpdateProperty("material", name, wanted.GetProperty("material", name))
        scene_graph.AssignRole(source, geometry, properties, RoleAssign.kReplace)


TABLE_INSTANCE = "table"
"""Name of the table's model instance."""

TOP_TOLERANCE = 1e-6
"""Largest distance of a table's top from the plane z = 0, m, and largest sine of its tilt."""

QUADRANT_SEGMENTS = 256
"""Number of corners, in a quarter turn, of the polygon within a round table's edge. It lies within
2 um of an edge of 0.5 m radius."""

SEAM_GRID = 1e-9
"""Grid to which outlines are rounded, m, so that pieces of a table that meet leave no gap."""


def FindTableTops(
    plant: MultibodyPlant, inspector: SceneGraphInspector
) -> dict[GeometryId, BaseGeometry]:
    """Finds the collision geometries of a finalised plant whose top is the table's.

    Returns:
        The outline in W, m, of each box and upright cylinder of the table that ends at z = 0.

    Raises:
        ScenarioError: there is no such model, or none of its geometries ends there.
    """
    if not plant.HasModelInstanceNamed(TABLE_INSTANCE):
        raise ScenarioError(
            f"directives: there is no model {TABLE_INSTANCE}; expected one whose top lies at z = 0"
        )
    context = plant.CreateDefaultContext()
    tops: dict[GeometryId, BaseGeometry] = {}
    for index in plant.GetBodyIndices(plant.GetModelInstanceByName(TABLE_INSTANCE)):
        body = plant.get_body(index)
        X_WB = plant.EvalBodyPoseInWorld(context, body)
        for geometry in plant.GetCollisionGeometriesForBody(body):
            X_WG = X_WB @ inspector.GetPoseInFrame(geometry)
            outline = _outline_of(inspector.GetShape(geometry), X_WG)
            if outline is not None:
                tops[geometry] = outline
    if not tops:
        raise ScenarioError(
            f"directives: {TABLE_INSTANCE} has no level box or cylinder that ends at z = 0; "
            "expected one"
        )
    return tops


def FindTableOutline(plant: MultibodyPlant, inspector: SceneGraphInspector) -> BaseGeometry:
    """Finds where on the table's top things may lie: the union of `FindTableTops`, in W, m."""
    return shapely.union_all(list(FindTableTops(plant, inspector).values()), grid_size=SEAM_GRID)


def _outline_of(shape: Box | Cylinder | object, X_WG: RigidTransform) -> BaseGeometry | None:
    """Finds a shape's outline in W, m; None where the shape does not end level at z = 0."""
    R = X_WG.rotation().matrix()
    p = X_WG.translation()
    if np.hypot(R[0, 2], R[1, 2]) > TOP_TOLERANCE or not isinstance(shape, Box | Cylinder):
        return None
    half = (shape.height() if isinstance(shape, Box) else shape.length()) / 2
    if not isclose(p[2] + half, 0.0, abs_tol=TOP_TOLERANCE):
        return None
    if isinstance(shape, Cylinder):
        return shapely.Point(p[:2]).buffer(shape.radius(), quad_segs=QUADRANT_SEGMENTS)
    half_sides = (shape.width() / 2, shape.depth() / 2)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half_sides
    return shapely.Polygon(corners @ R[:2, :2].T + p[:2])

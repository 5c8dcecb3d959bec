"""A table's edge that bears: small spheres along it, about which an object tilts.

A grid object stands on spheres below its cells, the outermost of which is up to a cell inside the
table's edge; it would tilt about that. So the edge itself bears, too: on it lie small spheres, just
below the table's top, that touch the object's underside as soon as it tilts by a thousandth of a
degree. An object that lies flat does not touch them.
"""

import numpy as np
import shapely
from numpy.typing import ArrayLike
from pydrake.geometry import GeometryId, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from shapely import LineString, Polygon

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.contact_material import MakePartnerProperties

RIM_RADIUS = 2e-4
"""Radius of the spheres on the edge, m."""

RIM_SPACING = 4e-3
"""Distance of neighboring spheres on the edge, m."""

RIM_GAP = 1e-5
"""Depth of the spheres' tops below the table's top, m."""


def AddTableRim(plant: MultibodyPlant, outline: Polygon) -> tuple[GeometryId, ...]:
    """Adds spheres along the outline of a table's top, z = 0 in W, before the objects.

    Args:
        plant: the plant, before Finalize.
        outline: the table's top, in W, m.

    Returns:
        The spheres' geometries, which belong to the world.
    """
    length = outline.exterior.length
    count = round(length / RIM_SPACING)
    along = np.arange(count) * length / count
    return AddRimSpheres(plant, place_along(outline.exterior, along))


def AddRimSpheres(plant: MultibodyPlant, places: ArrayLike) -> tuple[GeometryId, ...]:
    """Adds spheres of an edge to the world.

    Args:
        plant: the plant, before Finalize.
        places: (K, 2) where they are, W, m.
    """
    return tuple(
        plant.RegisterCollisionGeometry(
            plant.world_body(),
            RigidTransform([x, y, -RIM_RADIUS - RIM_GAP]),
            Sphere(RIM_RADIUS),
            f"rim_{i}",
            MakePartnerProperties(),
        )
        for i, (x, y) in enumerate(np.asarray(places, float).tolist())
    )


def place_along(line: LineString, along: Array) -> Array:
    """Places points on a line; (K, 2), m, at lengths (K,) along it, m."""
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(line, along)))

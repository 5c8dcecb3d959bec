"""Outlines as objects touch each other: with round corners; and whether they overlap."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from gridpush_drake.dynamics.bodies import describe_object
from gridpush_drake.dynamics.kernel_call import calc_reach
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.polygons import OutlineEdges
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.objects.grid_object import GridObject

CORNER_RADIUS = 0.0005
"""Radius of the round corners with which objects touch each other, m. The normal of a contact turns
evenly round a corner; at a sharp one it would jump."""

MIN_CORNER_RADIUS = 1e-5
"""Least such radius of an object with parts so thin that the usual one would break them, m."""

STRAIGHT = 1e-9
"""Sine of the turn up to which a vertex of a core counts as straight, and touches nothing."""

OVERLAP_TOLERANCE = 1e-8
"""Area of two outlines' overlap that is taken for touching, m²: 10 cm by 0.1 µm."""


class Core(NamedTuple):
    """An outline moved inwards by the radius of the corners.

    Attributes:
        edges: its edges, body frame.
        convex: (E,) whether the vertex where an edge begins is convex.
        radius: the radius, m.
    """

    edges: OutlineEdges
    convex: NDArray[np.bool_]
    radius: float


def check_overlap(objects: Sequence[GridObject], poses: Array) -> None:
    """Raises SimulationError, which names both, where two objects overlap at poses (N, 3)."""
    # Outlines that merely touch have an overlap without area.
    outlines = [
        transform_shape(pose, obj.outline) for obj, pose in zip(objects, poses, strict=True)
    ]
    for i, j in combinations(range(len(objects)), 2):
        if not outlines[i].intersects(outlines[j]):
            continue
        area = outlines[i].intersection(outlines[j]).area
        if area > OVERLAP_TOLERANCE:
            raise SimulationError(
                f"{describe_object(objects, i)} and {describe_object(objects, j)} overlap "
                f"by {area * 1e4:.3g} cm²; expected objects beside each other"
            )


def get_core(obj: GridObject) -> Core:
    """Moves an object's outline inwards by the radius of its corners, once for each object.

    An object with parts thinner than twice that radius has sharper corners.

    Raises:
        SimulationError: even `MIN_CORNER_RADIUS` breaks the outline.
    """
    cached: Core | None = obj.__dict__.get("_scene_core")
    if cached is None:
        cached = _make_core(obj)
        obj.__dict__["_scene_core"] = cached
    return cached


def _make_core(obj: GridObject) -> Core:
    # As round as usual, or less where that would break a thin part off.
    radius = CORNER_RADIUS
    while radius >= MIN_CORNER_RADIUS:
        inner = obj.outline.buffer(-radius, join_style="mitre", mitre_limit=MITRE_LIMIT)
        whole = isinstance(inner, Polygon) and not inner.is_empty
        if whole and len(inner.interiors) == len(obj.outline.interiors):
            edges = OutlineEdges.from_polygon(shapely.remove_repeated_points(inner))
            return Core(edges=edges, convex=_find_convex(edges), radius=radius)
        radius /= 2
    raise SimulationError(
        f"{obj.name}: its outline is thinner than {2 * MIN_CORNER_RADIUS * 1000:g} mm somewhere; "
        "expected one that can touch another object"
    )


MITRE_LIMIT = 10.0
"""Farthest that a vertex of the core may be from the outline's, in radii."""


def _find_convex(edges: OutlineEdges) -> NDArray[np.bool_]:
    """Tells which vertices, where the edges begin, are convex."""
    # the turn from the edge before: to the left where the vertex is convex
    along = edges.end - edges.start
    before = along[edges.previous]
    turn = before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0]
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(along, axis=1)
    return np.asarray(turn > STRAIGHT * lengths)


def calc_outline_reach(obj: GridObject) -> float:
    """The farthest point of the outline from B's origin, m; no less than the farthest cell's."""
    farthest = np.linalg.norm(obj.edges.start, axis=1).max()
    return max(float(farthest), calc_reach(obj))

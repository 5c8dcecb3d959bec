"""Convex polygons: hulls, half-planes, and how far points stay inside."""

import numpy as np
import shapely

from gridpush_drake.geometry.se2 import Array

SLACK = 1e-12
"""m, so that half-planes that leave one point leave a polygon, for round-off's sake."""

FAR = 8.0
"""Size of a half-plane's rectangle, in greatest offsets."""


def hull_of(points: Array) -> Array:
    """(V, 2) corners of the convex hull of points, counterclockwise; empty where they are in a line, or none."""
    hull = shapely.MultiPoint(points).convex_hull
    if not isinstance(hull, shapely.Polygon) or hull.is_empty:
        return np.empty((0, 2))
    return np.asarray(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1]


def bound_by_half_planes(directions: Array, offsets: Array) -> Array:
    """Corners of the convex polygon {c: d.c <= h(d)}.

    Bounds of single directions that hold for most draws only are no support function: some lie outside what the
    others leave, and count nothing.

    Args:
        directions: (D, 2) unit vectors, all round.
        offsets: (D,) h, m; together they leave something, be it a point.

    Returns:
        (V, 2) corners, m, counterclockwise, each bound taken SLACK further out.
    """
    reach = FAR * (float(np.abs(offsets).max()) + SLACK)
    on_edge = (offsets + SLACK)[:, None] * directions
    along, inward = reach * np.column_stack([-directions[:, 1], directions[:, 0]]), -reach * directions
    half_planes = np.stack([on_edge + along, on_edge + along + inward, on_edge - along + inward, on_edge - along], 1)
    return hull_of(shapely.get_coordinates(shapely.intersection_all(shapely.polygons(half_planes))))


def calc_margin_inside(inner: Array, hull: Array) -> float:
    """How far a set of points stays inside a convex polygon, m: negative where a point is outside, -inf without one.

    Args:
        inner: (V, 2) the points, m.
        hull: (k, 2) corners, counterclockwise, m; may be empty.
    """
    return float(_calc_gaps(inner, hull)[0].min()) if len(hull) >= 3 else -np.inf


def find_weakest_direction(inner: Array, hull: Array) -> Array:
    """(2,) outward unit normal of the hull's edge that the points `inner` (V, 2) come nearest to, or pass farthest.

    Where there is no hull, any direction is as weak as another: x.
    """
    if len(hull) < 3:
        return np.array([1.0, 0.0])
    gaps, normals = _calc_gaps(inner, hull)
    return normals[int(np.argmin(gaps))]


def _calc_gaps(inner: Array, hull: Array) -> tuple[Array, Array]:
    """Least distance (k,) of points inside each edge of a convex polygon, m, and the edges' outward normals (k, 2)."""
    along = np.roll(hull, -1, axis=0) - hull
    normals = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    return (normals * hull).sum(axis=1) - (inner @ normals.T).max(axis=0), normals

"""Polygons: convex hulls and half-planes, how far points stay inside, and the outline as directed edges."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon
from shapely.geometry.polygon import orient

from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array

SLACK = 1e-12  # m, so that half-planes that leave one point leave a polygon, for round-off's sake
FAR = 8.0  # size of a half-plane's rectangle, in greatest offsets


def hull_of(points: Array) -> Array:
    """(V, 2) corners of the convex hull of points, counterclockwise; empty where they are in a line, or none."""
    hull = shapely.MultiPoint(points).convex_hull
    if not isinstance(hull, shapely.Polygon) or hull.is_empty:
        return np.empty((0, 2))
    return np.asarray(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1]


def bound_by_half_planes(directions: Array, offsets: Array) -> Array:
    """Corners (V, 2) of the convex polygon {c: d.c <= h(d)}, m, counterclockwise, each bound taken SLACK further out.

    Bounds of single directions that hold for most draws only are no support function: some lie
    outside what the others leave, and count nothing. `directions` (D, 2) are unit vectors, all
    round; `offsets` (D,) are h, m, and leave something, be it a point.
    """
    reach = FAR * (float(np.abs(offsets).max()) + SLACK)
    on_edge = (offsets + SLACK)[:, None] * directions
    along, inward = (
        reach * np.column_stack([-directions[:, 1], directions[:, 0]]),
        -reach * directions,
    )
    half_planes = np.stack(
        [on_edge + along, on_edge + along + inward, on_edge - along + inward, on_edge - along], 1
    )
    return hull_of(shapely.get_coordinates(shapely.intersection_all(shapely.polygons(half_planes))))


def calc_margin_inside(inner: Array, hull: Array) -> float:
    """How far points (V, 2) stay inside a convex polygon (k, 2), counterclockwise, m: negative where one is outside.

    -inf without a polygon.
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
    normals = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(
        along, axis=1, keepdims=True
    )
    return (normals * hull).sum(axis=1) - (inner @ normals.T).max(axis=0), normals


@dataclass(frozen=True, eq=False)
class OutlineEdges(Frozen):
    """The outline's E directed edges, body frame, with the object on their left.

    Attributes:
        start: (E, 2) first vertex of each edge, m.
        end: (E, 2) last vertex, m.
        previous: (E,) index of the edge that ends where this one starts.
        arc_length: (E,) distance along its ring from the ring's first vertex to the edge's start,
            m.
        exterior_count: the first so many edges are the exterior ring; those of holes follow.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    previous: NDArray[np.int64]
    arc_length: NDArray[np.float64]
    exterior_count: int

    @classmethod
    def from_polygon(cls, outline: Polygon) -> "OutlineEdges":
        """Takes a polygon apart: exterior counterclockwise, holes clockwise."""
        oriented = orient(outline)
        starts: list[NDArray[Any]] = []
        ends: list[NDArray[Any]] = []
        previous: list[NDArray[Any]] = []
        arc_length: list[NDArray[Any]] = []
        first = 0
        for ring in (oriented.exterior, *oriented.interiors):
            vertices = np.asarray(ring.coords, dtype=np.float64)[:, :2]
            vertices = vertices[np.r_[True, np.any(np.diff(vertices, axis=0) != 0, axis=1)]]
            count = len(vertices) - 1
            starts.append(vertices[:-1])
            ends.append(vertices[1:])
            previous.append(first + np.roll(np.arange(count), 1))
            lengths = np.linalg.norm(np.diff(vertices, axis=0), axis=1)
            arc_length.append(np.cumsum(lengths) - lengths)
            first += count
        return cls(_join(starts), _join(ends), _join(previous), _join(arc_length), len(starts[0]))

    @property
    def perimeter(self) -> float:
        """Length of the exterior ring, m."""
        last = self.exterior_count - 1
        return float(self.arc_length[last] + np.linalg.norm(self.end[last] - self.start[last]))

    def at(
        self, arc_length: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The place at an arc length, m, on the exterior ring, counterclockwise from its first vertex.

        The point (2,) in m, the unit tangent (2,) and the outward unit normal (2,), body frame.
        """
        s = arc_length % self.perimeter
        edge = int(np.searchsorted(self.arc_length[: self.exterior_count], s, side="right")) - 1
        tangent = self.end[edge] - self.start[edge]
        tangent = tangent / np.linalg.norm(tangent)
        point = self.start[edge] + (s - self.arc_length[edge]) * tangent
        return point, tangent, np.array([tangent[1], -tangent[0]])


def _join(parts: list[NDArray[Any]]) -> NDArray[Any]:
    array = np.ascontiguousarray(np.concatenate(parts))
    array.setflags(write=False)
    return array

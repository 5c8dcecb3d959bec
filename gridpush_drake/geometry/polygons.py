"""Polygons: convex hulls, intersections of half-planes, margins, and an outline's directed edges.

Contact with an outline is calculated from its edges in `dynamics.kernels.contact.contact`; convex
polygons serve planning, where a body is safe as long as its center stays inside one.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon
from shapely.geometry.polygon import orient

from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array, IntArray, turn_left, turn_right

HALF_PLANE_SLACK = 1e-12
"""Distance by which every half-plane is widened, m. Half-planes that have just one point in common
so leave a small polygon, and not nothing for round-off's sake."""

HALF_PLANE_SIZE = 8.0
"""Size of the rectangle that stands for a half-plane, in the largest of the offsets."""

MIN_CORNERS = 3
"""Number of corners from which on points are a polygon."""


def hull_of(points: Array) -> Array:
    """Calculates the convex hull of points (n, 2), m.

    Returns:
        (V, 2) its corners, counterclockwise, m; (0, 2) where the points are in a line, or none.
    """
    hull = shapely.MultiPoint(points).convex_hull
    if not isinstance(hull, shapely.Polygon) or hull.is_empty:
        return np.empty((0, 2))
    return np.asarray(orient(hull).exterior.coords)[:-1]


def bound_by_half_planes(directions: Array, offsets: Array) -> Array:
    """Intersects half-planes {c: d . c <= h}, each widened by `HALF_PLANE_SLACK`.

    Each bound may be the tightest one for its own direction, or may lie outside of what the other
    bounds leave; then it counts nothing.

    Args:
        directions: (D, 2) unit vectors d, all round.
        offsets: (D,) h, m; together they leave something, be it a point.

    Returns:
        (V, 2) corners of the convex polygon that is left, counterclockwise, m.
    """
    # A half-plane is a rectangle here, so large that its other three sides do not matter:
    # one side lies on the bound, and it reaches inwards.
    reach = HALF_PLANE_SIZE * (float(np.abs(offsets).max()) + HALF_PLANE_SLACK)
    on_edge = (offsets + HALF_PLANE_SLACK)[:, None] * directions
    along = reach * turn_left(directions)
    inward = -reach * directions
    left = on_edge + along
    right = on_edge - along
    inner_left = left + inward
    inner_right = right + inward
    corners = np.stack([left, inner_left, inner_right, right], axis=1)
    common = shapely.intersection_all(shapely.polygons(corners))
    return hull_of(shapely.get_coordinates(common))


def calc_margin_inside(inner: Array, hull: Array) -> float:
    """Calculates how far points stay inside a convex polygon.

    Args:
        inner: (V, 2) the points, m.
        hull: (k, 2) corners of the polygon, counterclockwise, m.

    Returns:
        The least distance of a point to an edge, m: negative where a point is outside, -inf where
        the corners make no polygon.
    """
    if len(hull) < MIN_CORNERS:
        return -np.inf
    return float(_calc_gaps(inner, hull).gaps.min())


def find_weakest_direction(inner: Array, hull: Array) -> Array:
    """Finds the side of a convex polygon that points come nearest to, or pass farthest.

    Args:
        inner: (V, 2) the points, m.
        hull: (k, 2) corners of the polygon, counterclockwise, m.

    Returns:
        (2,) outward unit normal of that side. Where the corners make no polygon any direction is
        as weak as another, and it is the x axis.
    """
    if len(hull) < MIN_CORNERS:
        return np.array([1.0, 0.0])
    found = _calc_gaps(inner, hull)
    return found.normals[int(np.argmin(found.gaps))]


class _Gaps(NamedTuple):
    """How far points stay inside each edge of a convex polygon.

    Attributes:
        gaps: (k,) least distance of a point to the edge's line, m, negative beyond it.
        normals: (k, 2) the edges' outward unit normals.
    """

    gaps: Array
    normals: Array


def _calc_gaps(inner: Array, hull: Array) -> _Gaps:
    """Measures points (V, 2) against each edge of a convex polygon (k, 2), counterclockwise, m."""
    along = np.roll(hull, -1, axis=0) - hull
    lengths = np.linalg.norm(along, axis=1, keepdims=True)
    normals = turn_right(along) / lengths
    # gap = n . corner - max n . point
    edges_at = (normals * hull).sum(axis=1)
    points_at = inner @ normals.T
    farthest = points_at.max(axis=0)
    return _Gaps(gaps=edges_at - farthest, normals=normals)


@dataclass(frozen=True, eq=False)
class OutlineEdges(Frozen):
    """The outline's E directed edges, body frame, with the object on their left.

    Attributes:
        start: (E, 2) first vertex of each edge, m.
        end: (E, 2) last vertex, m.
        previous: (E,) index of the edge that ends where this one starts.
        arc_length: (E,) distance along its ring from the ring's first vertex to the edge's start,
            m.
        exterior_count: number of edges of the exterior ring, which come first; those of holes
            follow.
    """

    start: Array
    end: Array
    previous: IntArray
    arc_length: Array
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
            # A vertex that is given twice in a row would be an edge without a direction.
            moves = np.diff(vertices, axis=0)
            is_new = np.any(moves != 0, axis=1)
            vertices = vertices[np.r_[True, is_new]]
            count = len(vertices) - 1
            starts.append(vertices[:-1])
            ends.append(vertices[1:])
            # Each edge follows the one before it, the ring's first edge its last.
            previous.append(first + np.roll(np.arange(count), 1))
            along = np.diff(vertices, axis=0)
            lengths = np.linalg.norm(along, axis=1)
            arc_length.append(np.cumsum(lengths) - lengths)
            first += count
        return cls(
            start=_join(starts),
            end=_join(ends),
            previous=_join(previous),
            arc_length=_join(arc_length),
            exterior_count=len(starts[0]),
        )

    @cached_property
    def perimeter(self) -> float:
        """Length of the exterior ring, m."""
        last = self.exterior_count - 1
        last_length = np.linalg.norm(self.end[last] - self.start[last])
        return float(self.arc_length[last] + last_length)

    def at(self, arc_length: float) -> tuple[Array, Array, Array]:
        """Finds a place on the exterior ring.

        Args:
            arc_length: distance along the ring, counterclockwise from its first vertex, m; beyond
                the perimeter it goes on round.

        Returns:
            The point (2,), m, the unit tangent (2,) and the outward unit normal (2,), body frame;
            the last two are read-only.
        """
        s = arc_length % self.perimeter
        # The edge is the last one that starts no later than s.
        starts = self.arc_length[: self.exterior_count]
        edge = int(np.searchsorted(starts, s, side="right")) - 1
        past_start = s - starts[edge]
        tangent = self.tangents[edge]
        return self.start[edge] + past_start * tangent, tangent, self.normals[edge]

    @cached_property
    def tangents(self) -> Array:
        """(E, 2) unit tangents of the edges."""
        along = self.end - self.start
        return _join([along / np.linalg.norm(along, axis=1)[:, None]])

    @cached_property
    def normals(self) -> Array:
        """(E, 2) outward unit normals of the edges."""
        return _join([turn_right(self.tangents)])


def _join(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Joins the arrays of all rings to one that nobody can write to."""
    array = np.ascontiguousarray(np.concatenate(parts))
    array.setflags(write=False)
    return array

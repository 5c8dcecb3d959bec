"""Triangle meshes of what is drawn flat on a table: cells, an outline's prism, discs, rings and arrows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPolygon, Polygon, constrained_delaunay_triangles
from shapely.geometry.polygon import orient

from gridpush_drake.grid.object import GridObject

Array = NDArray[np.float64]

CELL_SHARE = 0.94
"""Side of a drawn cell, in cells; the rest is the gap that lets cells be told apart."""

CIRCLE_SIDES = 48
"""Straight pieces of a drawn circle."""

CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))
"""Of a square, counterclockwise."""


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles in space.

    Attributes:
        vertices: (k, 3) m.
        faces: (m, 3) indices into the vertices.
    """

    vertices: Array
    faces: NDArray[np.int32]

    def __add__(self, other: "TriangleMesh") -> "TriangleMesh":
        """Both together."""
        faces = np.concatenate([self.faces, other.faces + len(self.vertices)]).astype(np.int32)
        return TriangleMesh(np.concatenate([self.vertices, other.vertices]), faces)


def make_cell_prisms(obj: GridObject, height: float, share: float = CELL_SHARE) -> TriangleMesh:
    """Makes a prism a cell, standing on the plane z = 0 of the body frame, open below.

    Args:
        obj: the object.
        height: of the prisms, m.
        share: side of a prism, in cells.

    Returns:
        The mesh; its 8 n vertices come by corner, then by cell (the first n are all cells' first upper corners).
    """
    n, half = obj.n, share * obj.cell_size / 2
    rings = [np.column_stack([obj.p_BC + half * np.array(corner), np.zeros(n)]) for corner in CORNERS]
    upper = [ring + np.array([0.0, 0.0, height]) for ring in rings]
    quads = [(0, 1, 2, 3)] + [(i + 4, (i + 1) % 4 + 4, (i + 1) % 4, i) for i in range(4)]
    cell = np.arange(n)
    faces = [
        np.column_stack([cell + n * corner for corner in triangle]) for quad in quads for triangle in _halves(quad)
    ]
    return TriangleMesh(np.concatenate(upper + rings), np.concatenate(faces).astype(np.int32))


def make_outline_prism(obj: GridObject, height: float) -> TriangleMesh:
    """Makes the walls and the lid of an object's outline; body frame, from z = 0 to `height`, m."""
    mesh = _make_plate(obj.outline, height)
    outline = orient(obj.outline)
    for ring in (outline.exterior, *outline.interiors):
        mesh += _make_wall(np.array(ring.coords)[:, :2], height)
    return mesh


def make_outline_edge(obj: GridObject, height: float, width: float) -> TriangleMesh:
    """Makes a flat band about an object's outline, half inside and half outside; body frame, at z = `height`, m.

    Args:
        obj: the object.
        height: m.
        width: of the band, m.

    Returns:
        The mesh.
    """
    band = obj.outline.buffer(width / 2).difference(obj.outline.buffer(-width / 2))
    return _make_plate(band, height)


def make_disc(covariance: ArrayLike, centre: ArrayLike, height: float) -> TriangleMesh:
    """Makes a flat ellipse, the points p with (p - c)' S^-1 (p - c) <= 1.

    Args:
        covariance: (2, 2) S, m².
        centre: (2,) c, m.
        height: z, m.

    Returns:
        The mesh.
    """
    rim = _calc_ellipse(covariance, centre)
    vertices = np.column_stack([np.vstack([rim, np.asarray(centre)]), np.full(len(rim) + 1, height)])
    i = np.arange(len(rim))
    faces = np.column_stack([i, (i + 1) % len(rim), np.full(len(rim), len(rim))])
    return TriangleMesh(vertices, faces.astype(np.int32))


def make_ring(covariance: ArrayLike, centre: ArrayLike, height: float, width: float) -> TriangleMesh:
    """Makes the rim of the ellipse of `make_disc`, as a flat band that reaches `width`, m, outwards."""
    inner = _calc_ellipse(covariance, centre)
    outer = _calc_ellipse(_widen(np.asarray(covariance, dtype=np.float64), width), centre)
    n, i = len(inner), np.arange(len(inner))
    j = (i + 1) % n
    faces = np.concatenate([np.column_stack([i, i + n, j + n]), np.column_stack([i, j + n, j])])
    rim = np.vstack([inner, outer])
    return TriangleMesh(np.column_stack([rim, np.full(len(rim), height)]), faces.astype(np.int32))


def make_arrow(start: ArrayLike, end: ArrayLike, height: float, width: float) -> TriangleMesh:
    """Makes a flat arrow.

    Args:
        start: (2,) of its tail, m.
        end: (2,) of its point, m.
        height: z, m.
        width: of its shaft, m; the head is three times as wide and long, at most the whole arrow.

    Returns:
        The mesh.
    """
    tail, point = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(point - tail))
    along = (point - tail) / length
    across = np.array([-along[1], along[0]])
    neck, half = length - min(3 * width, length), width / 2
    outline = [(0, -half), (neck, -half), (neck, half), (0, half), (neck, -3 * half), (length, 0), (neck, 3 * half)]
    flat = np.array([tail + s * along + t * across for s, t in outline])
    vertices = np.column_stack([flat, np.full(len(flat), height)])
    return TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]], dtype=np.int32))


def _make_plate(area: Polygon | MultiPolygon, height: float) -> TriangleMesh:
    triangles = constrained_delaunay_triangles(area).geoms
    corners = np.concatenate([np.array(triangle.exterior.coords)[:3, :2] for triangle in triangles])
    faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    return TriangleMesh(np.column_stack([corners, np.full(len(corners), height)]), faces)


def _make_wall(ring: Array, height: float) -> TriangleMesh:
    """Between a closed ring (k, 2), first and last the same, at z = 0 and at z = height."""
    n = len(ring) - 1
    low = np.column_stack([ring[:-1], np.zeros(n)])
    i = np.arange(n)
    j = (i + 1) % n
    faces = np.concatenate([np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n])])
    return TriangleMesh(np.vstack([low, low + np.array([0.0, 0.0, height])]), faces.astype(np.int32))


def _halves(quad: tuple[int, ...]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    a, b, c, d = quad
    return (a, b, c), (a, c, d)


def _calc_ellipse(covariance: ArrayLike, centre: ArrayLike) -> Array:
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    angle = 2 * np.pi * np.arange(CIRCLE_SIDES) / CIRCLE_SIDES
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(centre, dtype=np.float64) + circle @ vectors.T


def _widen(covariance: Array, width: float) -> Array:
    """The ellipse whose half axes are longer by `width`."""
    values, vectors = np.linalg.eigh(covariance)
    axes = np.sqrt(np.maximum(values, 0.0)) + width
    return (vectors * axes**2) @ vectors.T

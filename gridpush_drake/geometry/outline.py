"""The outline as arrays of directed edges, and places on it by arc length."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon
from shapely.geometry.polygon import orient


@dataclass(frozen=True, eq=False)
class OutlineEdges:
    """The outline's E directed edges, body frame, with the object on their left.

    Attributes:
        start: (E, 2) first vertex of each edge, m.
        end: (E, 2) last vertex, m.
        previous: (E,) index of the edge that ends where this one starts.
        arc_length: (E,) distance along its ring from the ring's first vertex to the edge's start, m.
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

    def at(self, arc_length: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Finds the place at an arc length on the exterior ring (counterclockwise, taken modulo the perimeter).

        Args:
            arc_length: m, from the exterior's first vertex.

        Returns:
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

"""Where on an object's outline a disc can touch it.

A disc of radius r that touches the outline has its center at distance r from the object, and
nowhere nearer: it is on the boundary of the object grown by r. So of each edge, set off by r, only
those pieces are reachable that lie on that boundary. What lies within the grown object is in a
concavity narrower than the disc, or too near a reflex vertex.

A place is told by its arc length and its edge, for the edge says what the normal is there. A vertex
is the end of two edges; that the disc can also touch it from the directions in between is left out.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject

TOUCHING_DEPTH = 1e-6
"""A disc that is this much inside the object still counts as touching it, m."""

ARC_SEGMENTS = 64
"""Number of chords of a quarter circle in the outline of the grown object."""

MIN_PIECE = 1e-5
"""A reachable piece must be longer than this, m, unless its edge is not."""

END_ROOM = 1e-7
"""Reachable pieces end this fraction of the perimeter short of a vertex, where the normal is still
the edge's own."""


@dataclass(frozen=True, eq=False)
class ReachableOutline:
    """The reachable pieces of an outline's exterior, none across a vertex, in order of arc length.

    Attributes:
        low: (P,) arc length where each begins, m.
        high: (P,) where it ends, m.
        tangent: (P, 2) unit tangent of its edge, counterclockwise, body frame.
        origin: (P, 2) outline point at arc length zero, were the edge that long, body frame, m.
        perimeter: of the exterior, m.
    """

    low: Array
    high: Array
    tangent: Array
    origin: Array
    perimeter: float

    @property
    def length(self) -> float:
        """Length of all pieces together, m."""
        return float((self.high - self.low).sum())

    @property
    def _ends(self) -> Array:
        """(P,) length of the pieces up to the end of each, m."""
        return np.cumsum(self.high - self.low)

    @property
    def normal(self) -> Array:
        """(P, 2) outward unit normals, body frame."""
        return np.column_stack([self.tangent[:, 1], -self.tangent[:, 0]])

    def find_nearest(self, arc_length: ArrayLike) -> tuple[Array, NDArray[np.int64]]:
        """Finds the nearest reachable places.

        Args:
            arc_length: (...,) m; the outline begins again after its perimeter.

        Returns:
            The nearest reachable arc lengths (...,), m, and the pieces (...,) that they are on.
        """
        s = np.mod(np.asarray(arc_length, dtype=np.float64), self.perimeter)[..., None]
        turns = np.array([-1.0, 0.0, 1.0]) * self.perimeter
        # How far each arc length, or a turn less or more, is from every piece: (..., P, 3).
        shifted = s[..., None] + turns
        clipped = np.clip(shifted, self.low[:, None], self.high[:, None])
        distance = np.abs(clipped - shifted)
        # The nearest piece, and the turn by which it is nearest.
        piece = distance.min(axis=-1).argmin(axis=-1)
        turn = np.take_along_axis(distance.argmin(axis=-1), piece[..., None], axis=-1)[..., 0]
        return np.clip(s[..., 0] + turns[turn], self.low[piece], self.high[piece]), piece

    def spread(self, spacing: float) -> tuple[Array, NDArray[np.int64]]:
        """Spreads places evenly over all pieces, which are taken together.

        Args:
            spacing: greatest distance between neighboring places, m.

        Returns:
            Arc lengths, m, and the pieces that they are on.
        """
        count = max(1, int(np.ceil(self._ends[-1] / spacing)))
        return self.locate((np.arange(count) + 0.5) / count)

    def locate(self, fraction: ArrayLike) -> tuple[Array, NDArray[np.int64]]:
        """Finds places by the fraction of all pieces' length that is before them.

        Args:
            fraction: (...,) 0 to below 1.

        Returns:
            Arc lengths (...,), m, and the pieces (...,) that they are on.
        """
        ends = self._ends
        traveled = ends[-1] * np.asarray(fraction, dtype=np.float64)
        piece = np.searchsorted(ends, traveled, side="right")
        return self.high[piece] - (ends[piece] - traveled), piece

    def calc_fraction(self, arc_length: float, piece: int) -> float:
        """Calculates the fraction of all pieces' length before a place; the inverse of `locate`.

        Args:
            arc_length: of the place, m.
            piece: that it is on.
        """
        ends = self._ends
        return float((ends[piece] - (self.high[piece] - arc_length)) / ends[-1])

    def point(self, arc_length: Array, piece: NDArray[np.int64]) -> Array:
        """Calculates points of the outline.

        Args:
            arc_length: (...,) m.
            piece: (...,) indices of the pieces that they are on.

        Returns:
            (..., 2) body frame, m.
        """
        return self.origin[piece] + arc_length[..., None] * self.tangent[piece]


@lru_cache(maxsize=64)
def find_reachable_outline(
    obj: GridObject, radius: float, clearance: float = 0.0
) -> ReachableOutline:
    """Finds where a disc can begin to push an object.

    Args:
        obj: the object.
        radius: of the disc, m.
        clearance: gap between disc and object at the beginning, m, which must be free, too.

    Raises:
        PlanningError: the radius is not positive, the clearance negative, or there is no reachable
            place.
    """
    require_positive(PlanningError, unit="m", radius=radius)
    if not (np.isfinite(clearance) and clearance >= 0):
        raise PlanningError(f"clearance is {clearance!r}; expected a number >= 0 (m)")
    edges = obj.edges
    count = edges.exterior_count
    start = edges.start[:count]
    end = edges.end[:count]
    first = edges.arc_length[:count]
    lengths = np.linalg.norm(end - start, axis=1)
    tangent = (end - start) / lengths[:, None]
    normal = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    # Every edge set off by the disc, and the object grown by the disc.
    reach = radius + clearance
    offset = shapely.linestrings(np.stack([start + reach * normal, end + reach * normal], axis=1))
    grown = shapely.buffer(
        shapely.Polygon(obj.outline.exterior), reach - TOUCHING_DEPTH, quad_segs=ARC_SEGMENTS
    )
    # What of each edge is not within the grown object: rows of edge, and arc lengths at both ends.
    room = END_ROOM * edges.perimeter
    rows = []
    for i, free in enumerate(shapely.difference(offset, grown)):
        for piece in getattr(free, "geoms", [free]):
            along = (np.array(piece.coords) - offset[i].coords[0]) @ tangent[i]
            if not len(along) or np.ptp(along) <= min(MIN_PIECE, lengths[i] / 2):
                continue
            low = first[i] + max(along.min(), room)
            high = first[i] + min(along.max(), lengths[i] - room)
            if high > low:
                rows.append((i, low, high))
    if not rows:
        raise PlanningError(
            f"{obj.name}: no place on the outline that a disc of radius {radius} m can touch"
        )
    edge, begins, ends = (np.array(column) for column in zip(*rows, strict=True))
    return ReachableOutline(
        low=begins,
        high=ends,
        tangent=tangent[edge],
        origin=start[edge] - first[edge, None] * tangent[edge],
        perimeter=edges.perimeter,
    )

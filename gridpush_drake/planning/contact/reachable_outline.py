"""Where on an object's outline a disc can touch it.

A disc of radius r that touches the outline has its center at distance r from the object, nowhere
nearer: on the boundary of the object grown by r. Of an edge's offset by r, only the pieces on that
boundary are reachable: what lies within the grown object is in a concavity narrower than the disc,
or too near a reflex vertex. In the piecewise-linear outline an edge belongs to the normal that it
has, so that a vertex is the end of two edges; the arcs about convex vertices are left to the ends
of the edges beside them.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject

TOUCHING = 1e-6  # m; a disc this much inside the object still counts as touching
ARC_SEGMENTS = 64  # chords of a quarter circle, of the grown object
MIN_PIECE = 1e-5  # m; a reachable piece must be longer, unless its edge is not

END_ROOM = 1e-7
"""Reachable pieces end this share of the perimeter short of a vertex, where the normal is still the
edge's own."""


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
        """Of all pieces, m."""
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
        """The nearest reachable arc lengths (..., m) and the pieces (...,) they are on, round the perimeter."""
        s = np.mod(np.asarray(arc_length, dtype=np.float64), self.perimeter)[..., None]
        turns = np.array([-1.0, 0.0, 1.0]) * self.perimeter
        shifted = s[..., None] + turns
        clipped = np.clip(shifted, self.low[:, None], self.high[:, None])
        gap = np.abs(clipped - shifted).min(axis=-1)
        piece = gap.argmin(axis=-1)
        best = np.take_along_axis(
            np.abs(clipped - shifted).argmin(axis=-1), piece[..., None], axis=-1
        )[..., 0]
        return np.clip(s[..., 0] + turns[best], self.low[piece], self.high[piece]), piece

    def spread(self, spacing: float) -> tuple[Array, NDArray[np.int64]]:
        """Arc lengths `spacing` or less apart, m, and their pieces; evenly, short pieces taken together."""
        count = max(1, int(np.ceil(self._ends[-1] / spacing)))
        return self.locate((np.arange(count) + 0.5) / count)

    def locate(self, share: ArrayLike) -> tuple[Array, NDArray[np.int64]]:
        """Arc lengths (..., m) at shares (...,) of the pieces' length, 0 to below 1, and the pieces (...,) there."""
        ends = self._ends
        traveled = ends[-1] * np.asarray(share, dtype=np.float64)
        piece = np.searchsorted(ends, traveled, side="right")
        return self.high[piece] - (ends[piece] - traveled), piece

    def calc_share(self, arc_length: float, piece: int) -> float:
        """The share of the pieces' length at which an arc length (m) of a piece lies: the inverse of `locate`."""
        ends = self._ends
        return float((ends[piece] - (self.high[piece] - arc_length)) / ends[-1])

    def point(self, arc_length: Array, piece: NDArray[np.int64]) -> Array:
        """(..., 2) outline points, body frame, m."""
        return self.origin[piece] + arc_length[..., None] * self.tangent[piece]


@lru_cache(maxsize=64)
def find_reachable_outline(
    obj: GridObject, radius: float, clearance: float = 0.0
) -> ReachableOutline:
    """Finds where a disc of `radius` (m), with a gap of `clearance` (m) that must be free too, can begin to push.

    Raises:
        PlanningError: the radius is not positive, the clearance negative, or there is no reachable
            place.
    """
    require_positive(PlanningError, unit="m", radius=radius)
    if not (np.isfinite(clearance) and clearance >= 0):
        raise PlanningError(f"clearance is {clearance!r}; expected a number >= 0 (m)")
    edges, reach = obj.edges, radius + clearance
    count = edges.exterior_count
    start, end, first = edges.start[:count], edges.end[:count], edges.arc_length[:count]
    lengths = np.linalg.norm(end - start, axis=1)
    tangent = (end - start) / lengths[:, None]
    normal = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    room = END_ROOM * edges.perimeter
    offset = shapely.linestrings(np.stack([start + reach * normal, end + reach * normal], axis=1))
    grown = shapely.buffer(
        shapely.Polygon(obj.outline.exterior), reach - TOUCHING, quad_segs=ARC_SEGMENTS
    )
    rows = []
    for i, free in enumerate(shapely.difference(offset, grown)):
        for piece in getattr(free, "geoms", [free]):
            along = (np.array(piece.coords) - offset[i].coords[0]) @ tangent[i]
            if len(along) and np.ptp(along) > min(MIN_PIECE, lengths[i] / 2):
                rows.append(
                    (
                        i,
                        first[i] + max(along.min(), room),
                        first[i] + min(along.max(), lengths[i] - room),
                    )
                )
    rows = [row for row in rows if row[2] > row[1]]
    if not rows:
        raise PlanningError(
            f"{obj.name}: no place on the outline that a disc of radius {radius} m can touch"
        )
    edge, low, high = (np.array(column) for column in zip(*rows, strict=True))
    origin = start[edge] - first[edge, None] * tangent[edge]
    return ReachableOutline(low, high, tangent[edge], origin, edges.perimeter)

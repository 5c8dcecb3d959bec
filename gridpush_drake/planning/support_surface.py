"""The support surface: the table's top as a polygon in the plane z = 0, world frame W.

A round table is the regular polygon inscribed in its circle, so that nothing counts as supported
beyond its edge. Signed distances are positive inside:

    d(p) = +- min over edges |p - edge|

`SupportSurface` is the table. `find_supported` says which cells of an object are on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linprog
from shapely import Polygon
from shapely.geometry.polygon import orient

from gridpush_drake.errors import MAX_NUMBER, PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, check_vector, make_direction, rotate
from gridpush_drake.notebook import count
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import ObservedPush

ROUND_SIDES = 120
"""Number of sides of the polygon that stands for a round table. Its edge is then off by at most
R (1 - cos(pi/120)) = R/2900."""

FIT_ANGLES = 48
"""Number of directions in which a body is tried on a table, over a full turn."""

STRAIGHT_CORNER = 1e-9
"""A corner that turns inwards makes a table concave if the cross product of its two edges is larger
than this, m²."""

ROUND_OFF = 1e-9
"""An edge of the table is looked at if the object comes as near to it as this, m, for round-off."""


@dataclass(frozen=True, eq=False)
class SupportSurface:
    """A table's top.

    Attributes:
        polygon: its edge, world frame, m; counterclockwise, without holes.

    Raises:
        PlanningError: the polygon crosses itself, is empty or has holes, or a corner is too far
            away for numbers.
    """

    polygon: Polygon

    def __repr__(self) -> str:
        """Corners and size, in a line."""
        left, low, right, high = self.polygon.bounds
        corners = count(len(self.polygon.exterior.coords) - 1, "corner")
        return f"SupportSurface with {corners}: {right - left:.3g} x {high - low:.3g} m"

    def __post_init__(self) -> None:
        polygon = self.polygon
        is_simple = isinstance(polygon, Polygon) and not polygon.is_empty and polygon.is_valid
        if not is_simple or polygon.area <= 0:
            raise PlanningError(
                "table: expected a simple polygon with an area, that does not cross itself"
            )
        if polygon.interiors:
            raise PlanningError("table: has holes; expected a polygon without")
        farthest = max(map(abs, polygon.bounds))
        if farthest > MAX_NUMBER:
            raise PlanningError(
                f"table: a corner is at {farthest:g} m; expected at most {MAX_NUMBER:g} m"
            )
        object.__setattr__(self, "polygon", orient(polygon))

    @classmethod
    def rectangle(cls, center: ArrayLike, size: ArrayLike) -> "SupportSurface":
        """Makes a rectangle along the world's axes.

        Args:
            center: (2,) m.
            size: (2,) sides along x and y, m.

        Raises:
            PlanningError: a number is not finite, or a side is not positive.
        """
        x, y = check_vector(PlanningError, "table: center", center, 2, "m")
        width, height = check_vector(PlanningError, "table: size", size, 2, "m")
        if width <= 0 or height <= 0:
            raise PlanningError(
                f"table: size is ({width:g}, {height:g}); expected positive sides (m)"
            )
        return cls(shapely.box(x - width / 2, y - height / 2, x + width / 2, y + height / 2))

    @classmethod
    def round(cls, center: ArrayLike, radius: float) -> "SupportSurface":
        """Makes a round table, as an inscribed polygon of `ROUND_SIDES` sides.

        Args:
            center: (2,) m.
            radius: m.

        Raises:
            PlanningError: a number is not finite, or the radius is not positive.
        """
        p = check_vector(PlanningError, "table: center", center, 2, "m")
        require_positive(PlanningError, "table: ", "m", radius=radius)
        angle = 2 * np.pi * np.arange(ROUND_SIDES) / ROUND_SIDES
        return cls(Polygon(p + radius * make_direction(angle)))

    @classmethod
    def from_polygon(cls, points: ArrayLike | Sequence[Sequence[float]]) -> "SupportSurface":
        """Makes a table of any shape.

        Args:
            points: (k, 2) its corners, clockwise or counterclockwise, m.

        Raises:
            PlanningError: they make no simple polygon.
        """
        corners = np.array(points, dtype=np.float64)
        is_list = corners.ndim == 2 and corners.shape[1] == 2 and len(corners) >= 3
        if not is_list or not np.isfinite(corners).all():
            raise PlanningError(
                f"table: points of shape {corners.shape}; "
                "expected (k, 2) finite numbers, k >= 3 (m)"
            )
        return cls(Polygon(corners))

    @cached_property
    def corners(self) -> Array:
        """(k, 2) corners of the polygon, counterclockwise, the first not repeated, m."""
        return np.asarray(self.polygon.exterior.coords, dtype=np.float64)[:-1, :2]

    @cached_property
    def edge_lengths(self) -> Array:
        """(k,) length of the edge from each corner to the next, m."""
        return np.linalg.norm(np.roll(self.corners, -1, axis=0) - self.corners, axis=1)

    @cached_property
    def edge_normals(self) -> Array:
        """(k, 2) outward unit normals of the edges."""
        tangent = (np.roll(self.corners, -1, axis=0) - self.corners) / self.edge_lengths[:, None]
        return np.column_stack([tangent[:, 1], -tangent[:, 0]])

    @cached_property
    def edge_offsets(self) -> Array:
        """(k,) offset of each edge along its outward normal n: n.p for any of its points p, m."""
        return np.asarray((self.edge_normals * self.corners).sum(axis=1))

    @cached_property
    def is_convex(self) -> bool:
        """Whether no corner turns inwards."""
        along = np.roll(self.corners, -1, axis=0) - self.corners
        after = np.roll(along, -1, axis=0)
        return bool(
            (along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0] > -STRAIGHT_CORNER).all()
        )

    @property
    def perimeter(self) -> float:
        """Length of the edge, m."""
        return float(self.edge_lengths.sum())

    def edge_at(self, arc_length: float) -> tuple[Array, Array]:
        """Finds a point of the edge.

        Args:
            arc_length: from the first corner, counterclockwise, m.

        Returns:
            The point (2,), m, and the outward unit normal (2,) there.
        """
        s = arc_length % self.perimeter
        begins = np.cumsum(self.edge_lengths) - self.edge_lengths
        edge = int(np.searchsorted(begins, s, side="right")) - 1
        normal = self.edge_normals[edge]
        tangent = np.array([-normal[1], normal[0]])
        return self.corners[edge] + (s - begins[edge]) * tangent, normal

    def contains(self, points: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether points are on the table.

        Args:
            points: (..., 2) m.
            margin: how far inside the edge they must be, m. If it is negative, they may be so far
                beyond the edge; at the corners of a convex table that is measured from the lines of
                the edges.

        Returns:
            (...,) bool.
        """
        p = np.asarray(points, dtype=np.float64)
        if self.is_convex:
            return np.asarray((self.edge_offsets - p @ self.edge_normals.T).min(axis=-1) >= margin)
        if margin:
            return np.asarray(self.signed_distances(p) >= margin)
        return np.asarray(shapely.contains_xy(self.polygon, p[..., 0], p[..., 1]))

    def signed_distances(self, points: ArrayLike) -> Array:
        """Distances (...,) of points (..., 2) to the edge, m: negative beyond it."""
        p = np.asarray(points, dtype=np.float64)
        flat = p.reshape(-1, 2)
        along = np.roll(self.corners, -1, axis=0) - self.corners
        fraction = ((flat[:, None] - self.corners) * along).sum(axis=2) / self.edge_lengths**2
        feet = self.corners + np.clip(fraction, 0.0, 1.0)[..., None] * along
        distance = np.sqrt(((feet - flat[:, None]) ** 2).sum(axis=2).min(axis=1)).reshape(
            p.shape[:-1]
        )
        return np.where(self.contains(p), distance, -distance)

    def cell_distances(self, obj: GridObject, pose: ArrayLike) -> Array:
        """Calculates how far inside the edge each cell's square is, at the point nearest to it.

        On a concave table it is a lower bound: the center's distance less half the diagonal.

        Args:
            obj: the object.
            pose: (..., 3) X_WB, m and rad.

        Returns:
            (..., n) m.
        """
        q = np.asarray(pose, dtype=np.float64)
        centers = obj.cells_at(q)
        half = obj.cell_size / 2
        if not self.is_convex:
            return self.signed_distances(centers) - half * np.sqrt(2)
        # How far a square reaches along a normal: half its side times the normal's 1-norm in B.
        across = np.abs(rotate(-q[..., 2, None], self.edge_normals)).sum(axis=-1)
        gaps = self.edge_offsets - centers @ self.edge_normals.T - half * across[..., None, :]
        return np.asarray(gaps.min(axis=-1))

    def contains_cells(
        self, obj: GridObject, pose: ArrayLike, margin: float = 0.0
    ) -> bool | NDArray[np.bool_]:
        """Whether every cell's square is on the table.

        Args:
            obj: the object.
            pose: (..., 3) X_WB, m and rad.
            margin: how far inside the edge they must be, m.

        Returns:
            (...,) bool.
        """
        inside = self.cell_distances(obj, pose).min(axis=-1) >= margin
        return bool(inside) if np.ndim(inside) == 0 else np.asarray(inside)

    def fits(self, body: ArrayLike) -> bool:
        """Whether a convex body can lie on the table, turned in some direction.

        For each of `FIT_ANGLES` directions the half-planes of the edges are moved in by how far the
        body reaches across them. It can lie there if they have a point in common. For a concave
        table its convex hull is tried.

        Args:
            body: (V, 2) corners of the body, body frame, m.
        """
        table = self if self.is_convex else SupportSurface(self.polygon.convex_hull)
        offsets = table.edge_offsets
        for angle in 2 * np.pi * np.arange(FIT_ANGLES) / FIT_ANGLES:
            reach = (rotate(angle, body) @ table.edge_normals.T).max(axis=0)
            if _have_common_point(table.edge_normals, offsets - reach):
                return True
        return False


def _have_common_point(normals: Array, offsets: Array) -> bool:
    """Whether half-planes n.p <= offset have a point p in common.

    They do if the greatest t for which some p fulfills n.p + t <= offset is not negative.

    Args:
        normals: (k, 2) unit normals n.
        offsets: (k,) m.
    """
    A = np.column_stack([normals, np.ones(len(normals))])
    best = linprog([0.0, 0.0, -1.0], A_ub=A, b_ub=offsets, bounds=3 * [(None, None)])
    return bool(best.status == 0 and -best.fun >= 0)


def find_supported(
    obj: GridObject, poses: ArrayLike, surface: SupportSurface, inset: float = 0.0
) -> NDArray[np.bool_]:
    """Finds which cells' centers are on the table.

    It says the same as `SupportSurface.contains`, but is quicker: of a convex table only those
    edges are looked at that the object reaches at any of the poses.

    Args:
        obj: the object.
        poses: (..., 3) X_WB, m and rad.
        surface: the table.
        inset: how far inside the edge a center must be, m.

    Returns:
        (..., n) bool.
    """
    q = np.asarray(poses, dtype=np.float64)
    if not surface.is_convex:
        return surface.contains(obj.cells_at(q), inset)
    normals = surface.edge_normals
    offsets = surface.edge_offsets
    reach = float(np.linalg.norm(obj.p_BC, axis=1).max()) + inset + ROUND_OFF
    gaps = (offsets - q[..., :2] @ normals.T).reshape(-1, len(normals))
    near = gaps.min(axis=0) < reach
    if not near.any():
        return np.ones((*q.shape[:-1], obj.n), dtype=bool)
    return np.asarray((offsets[near] - obj.cells_at(q) @ normals[near].T).min(axis=-1) >= inset)


def stayed_supported(obj: GridObject, seen: ObservedPush, surface: SupportSurface) -> bool:
    """Whether every cell's center was on the table in every pose that was seen of a push."""
    return bool(find_supported(obj, np.vstack([seen.pose, seen.poses_observed]), surface).all())

"""`Pusher`: what pushes objects, and how: its shape, its speed, and the room it needs.

`PusherShape` is a rigid shape that moves in the plane, with a frame T of its own: one disc, several
discs (two fingertips), or a convex polygon with round corners (a plate, a closed gripper).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely
import shapely.affinity
from numpy.typing import ArrayLike
from shapely import MultiPoint, MultiPolygon, Polygon
from shapely.geometry.polygon import orient

from gridpush_drake.errors import (
    MAX_NUMBER,
    ObjectError,
    PlanningError,
    PushError,
    require_positive,
)
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.objects.grid_object import GridObject

DEFAULT_PUSHER_RADIUS = 0.008
"""Radius of a pusher where neither the caller nor the object's file gives one, m: that of the
shipped finger, `models/fingers/rod`. Learning and planning take the same one."""


CONVEXITY_TOLERANCE = 1e-9
"""Fraction of its hull's area by which a polygon may be smaller and still count as convex."""

SYMMETRY_TOLERANCE = 0.01
"""Fraction of its area by which a shape may change in half a turn and still count as the same."""

MITRE_LIMIT = 100.0
"""Farthest that a corner of a polygon's core may be from the polygon's, in radii."""


@dataclass(frozen=True, eq=False)
class PusherShape(Frozen):
    """All points within a radius of a convex polygon, or of one place or more; frame T.

    `disc`, `discs`, `polygon` and `plate` make the usual ones. By convention T's x axis points
    where the pusher pushes, and its y axis to the left.

    Attributes:
        core: (K, 2) corners of the polygon, counterclockwise, or the discs' centers, m.
        radius: m, positive: of the discs, or of the round corners.
        joined: whether `core` is a polygon, whose faces touch, too. One of two corners is a
            rounded line.

    Raises:
        PushError: the polygon is not convex, or a number is out of range.
    """

    core: Array
    radius: float
    joined: bool = field(default=False)

    def __post_init__(self) -> None:
        core = np.array(self.core, dtype=np.float64)
        require_positive(PushError, "pusher: ", radius=self.radius)
        least = 2 if self.joined else 1
        if core.ndim != 2 or core.shape[1] != 2 or len(core) < least:
            raise PushError(f"pusher: core of shape {core.shape}; expected (K, 2), K >= {least}")
        if not (np.abs(core) <= MAX_NUMBER).all():
            raise PushError(f"pusher: core: expected finite numbers, at most {MAX_NUMBER:g} (m)")
        if self.joined:
            _check_polygon(core)
        core.setflags(write=False)
        object.__setattr__(self, "core", core)
        object.__setattr__(self, "radius", float(self.radius))

    @classmethod
    def disc(cls, radius: float) -> "PusherShape":
        """Makes a disc about T's origin; radius in m."""
        return cls(np.zeros((1, 2)), radius)

    @classmethod
    def discs(cls, centers: ArrayLike, radius: float) -> "PusherShape":
        """Makes discs, such as two fingertips, at places (K, 2), m, of one radius, m."""
        return cls(np.array(centers, dtype=np.float64), radius)

    @classmethod
    def polygon(cls, corners: ArrayLike, radius: float) -> "PusherShape":
        """Makes a convex polygon (K, 2), m, whose corners are rounded by a radius, m.

        Raises:
            PushError: it is not convex, or thinner than twice the radius.
        """
        outline = np.array(corners, dtype=np.float64)
        if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
            raise PushError(
                f"pusher: corners of shape {outline.shape}; expected (K, 2), K >= 3 (m)"
            )
        _check_polygon(outline)
        require_positive(PushError, "pusher: ", radius=radius)
        # the core: all sides moved inwards
        inner = Polygon(outline).buffer(-radius, join_style="mitre", mitre_limit=MITRE_LIMIT)
        if not isinstance(inner, Polygon) or inner.is_empty:
            raise PushError(
                f"pusher: the polygon is thinner than {2 * radius:g} m; expected a smaller radius"
            )
        core = shapely.get_coordinates(orient(shapely.remove_repeated_points(inner)).exterior)
        return cls(core[:-1], radius, True)

    @classmethod
    def plate(cls, width: float, thickness: float, radius: float) -> "PusherShape":
        """Makes a plate, or a closed parallel gripper, whose front is on T's y axis.

        Args:
            width: along y, m.
            thickness: along x, backwards from the front, m.
            radius: of the round corners, m; less than half of the other two.
        """
        require_positive(PushError, "pusher: ", width=width, thickness=thickness)
        half = width / 2
        corners = [(-thickness, -half), (0.0, -half), (0.0, half), (-thickness, half)]
        return cls.polygon(corners, radius)

    @cached_property
    def reach(self) -> float:
        """The farthest point from T's origin, m."""
        return float(np.linalg.norm(self.core, axis=1).max()) + self.radius

    @cached_property
    def period(self) -> float:
        """Angle about T's origin after which it looks the same, rad: half or all of a turn."""
        area = self.area
        turned = shapely.affinity.rotate(area, 180.0, (0.0, 0.0))
        changed = area.symmetric_difference(turned).area
        return np.pi if changed < SYMMETRY_TOLERANCE * area.area else 2.0 * np.pi

    @cached_property
    def area(self) -> Polygon | MultiPolygon:
        """All that it covers, m, frame T; its round corners are regular polygons."""
        points = MultiPoint(self.core)
        covered = (points.convex_hull if self.joined else points).buffer(self.radius)
        assert isinstance(covered, Polygon | MultiPolygon)
        return covered

    def at(self, pose: ArrayLike) -> Polygon | MultiPolygon:
        """Returns what it covers with its frame at X_WT (3,), m and rad; world frame, m."""
        return transform_shape(pose, self.area)


def _check_polygon(corners: Array) -> None:
    """Raises PushError where corners (K, 2) are no convex polygon, counterclockwise."""
    if len(corners) == 2:
        if (corners[0] == corners[1]).all():
            raise PushError("pusher: both corners are the same; expected two places")
        return
    # a convex polygon fills its hull
    polygon = Polygon(corners)
    hull = polygon.convex_hull.area
    convex = polygon.is_valid and polygon.area >= (1 - CONVEXITY_TOLERANCE) * hull > 0
    if not (convex and polygon.exterior.is_ccw):
        raise PushError("pusher: expected the corners of a convex polygon, counterclockwise (m)")


@dataclass(frozen=True)
class Pusher:
    """A rigid shape that pushes objects; a disc unless it says otherwise.

    Attributes:
        radius: of the disc, m; None for that of the objects' files, or else of the shipped finger.
        speed: at which it pushes, m/s.
        clearance: gap between pusher and object where a push begins, m.
        shape: of a pusher that is no disc about its own origin; None of a disc.

    Raises:
        PlanningError: a number is out of range.
    """

    radius: float | None = None
    speed: float = 0.03
    clearance: float = 0.002
    shape: PusherShape | None = None

    def __post_init__(self) -> None:
        if self.shape is not None and self.radius is not None:
            raise PlanningError("radius and shape are given; expected one of them")
        if self.radius is not None:
            require_positive(PlanningError, unit="m", radius=self.radius)
        require_positive(PlanningError, unit="m/s", speed=self.speed)
        if not 0 <= self.clearance < float("inf"):
            raise PlanningError(f"clearance is {self.clearance!r}; expected a number >= 0 (m)")

    def choose_radius(self, objects: GridObject | Sequence[GridObject]) -> float:
        """Chooses the radius, m, with which it pushes an object or objects.

        That of a shape is the radius of its round corners.
        """
        if self.shape is not None:
            return self.shape.radius
        return choose_pusher_radius(objects, self.radius)

    def choose_reach(self, objects: GridObject | Sequence[GridObject]) -> float:
        """Chooses how far it reaches from its center at most, m: the radius of a disc."""
        return self.choose_radius(objects) if self.shape is None else self.shape.reach


DEFAULT_PUSHER = Pusher()
"""The shipped finger, or that of the objects' files, at its usual speed."""


def find_pusher_radius(objects: Sequence[GridObject]) -> float | None:
    """Finds the pusher's radius in objects' files, m; None where none has it.

    Raises:
        ObjectError: they name different ones.
    """
    known = [obj.prior.pusher_radius for obj in objects]
    radii = {radius for radius in known if radius is not None}
    if len(radii) > 1:
        listed = ", ".join(f"{radius:g} m" for radius in sorted(radii))
        raise ObjectError(
            f"the objects' files name pushers of different radii, {listed}; expected one pusher"
        )
    return radii.pop() if radii else None


def choose_pusher_radius(
    objects: GridObject | Sequence[GridObject], radius: float | None = None
) -> float:
    """Chooses a pusher's radius, m: as given, else the objects' files', else the shipped finger's.

    Args:
        objects: the object, or the objects, that are pushed.
        radius: as given, m; None where it is not.

    Raises:
        ObjectError: the objects' files name different ones.
    """
    if radius is not None:
        return radius
    known = find_pusher_radius([objects] if isinstance(objects, GridObject) else objects)
    return DEFAULT_PUSHER_RADIUS if known is None else known

"""Paths that an object is pushed along: poses, and a speed.

A path is given by poses of the body frame, between which it is interpolated. What goes along it is
the centroid of the object's cells. Its length s is counted by the way of the centroid, or by rho
|dtheta|, rho the radius of gyration, where the object turns faster than it goes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.errors import MAX_NUMBER, PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, make_direction, rotate, transform
from gridpush_drake.objects.grid_object import GridObject

POINT_SPACING = 0.002
"""Length between the points by which an object's way along a path is kept, m."""

LOOK_BACK = 0.01
"""How far back along the path an object may be found again, m."""

LOOK_AHEAD = 0.06
"""How far ahead along the path an object may be found, m."""


@dataclass(frozen=True, eq=False)
class PosePath:
    """Poses that an object should go through, in order, and how fast.

    Attributes:
        poses: (K, 3) X_WB, m and rad; two or more. The object turns the way that the angles say: by
            a whole turn where they differ by 2 pi.
        speed: of the object's centroid, m/s.

    Raises:
        PlanningError: there are fewer than two poses, they do not differ, a number is not finite,
            or the speed is not positive.
    """

    poses: Array
    speed: float

    def __post_init__(self) -> None:
        poses = np.array(self.poses, dtype=np.float64)
        if poses.ndim != 2 or poses.shape[1:] != (3,) or len(poses) < 2:
            raise PlanningError(
                f"path: poses of shape {poses.shape}; expected (K, 3), K at least 2 (m and rad)"
            )
        if not (np.isfinite(poses).all() and (np.abs(poses) <= MAX_NUMBER).all()):
            raise PlanningError("path: a pose is not finite, or too far away; expected m and rad")
        if not np.diff(poses, axis=0).any():
            raise PlanningError("path: all poses are the same; expected some that differ")
        require_positive(PlanningError, "path: ", "m/s", speed=self.speed)
        poses.setflags(write=False)
        object.__setattr__(self, "poses", poses)
        object.__setattr__(self, "speed", float(self.speed))

    @classmethod
    def through(
        cls, obj: GridObject, points: ArrayLike, speed: float, turn: float = 0.0
    ) -> "PosePath":
        """Makes a path on which the object's centroid goes through points, and turns with it.

        Args:
            obj: the object.
            points: (K, 2) of the centroid, W, m; no two in a row are the same.
            speed: m/s.
            turn: angle of the body's x axis from the direction of the path, rad.

        Raises:
            PlanningError: as of the class.
        """
        places = np.array(points, dtype=np.float64)
        if places.ndim != 2 or places.shape[1:] != (2,) or len(places) < 2:
            raise PlanningError(
                f"path: points of shape {places.shape}; expected (K, 2), K at least 2 (m)"
            )
        if not np.isfinite(places).all() or not np.diff(places, axis=0).any(axis=1).all():
            raise PlanningError("path: points must be finite, and no two in a row the same (m)")
        way = np.gradient(places, axis=0)
        theta = np.unwrap(np.arctan2(way[:, 1], way[:, 0])) + turn
        origin = places - rotate(theta, obj.p_BC.mean(axis=0))
        return cls(np.column_stack([origin, theta]), speed)

    @property
    def goal(self) -> Array:
        """(3,) the last pose, m and rad."""
        return np.asarray(self.poses[-1])


class PathProgress:
    """A path as it is for one object: how far along it the object is, and where it should be next.

    Attributes:
        path: the path.
        length: length of the path, m. Between two poses it is the way of the centroid, or that of a
            point at the radius of gyration as the object turns, whichever is longer.
    """

    def __init__(self, obj: GridObject, path: PosePath) -> None:
        """Measures the path."""
        self.path = path
        self._middle = middle = obj.p_BC.mean(axis=0)
        self._arm = obj.radius_of_gyration
        # the path at even lengths, so that a place on it is found by its index
        corners, arc = self._measure(path.poses, middle)
        self.length = float(arc[-1])
        count = max(2, int(np.ceil(self.length / POINT_SPACING)) + 1)
        self._arc = np.linspace(0.0, self.length, count)
        self._table = np.column_stack([np.interp(self._arc, arc, row) for row in corners.T])
        # Where the object turns on the spot, its heading stands for the direction of the path.
        steps = np.gradient(self._table[:, :2], axis=0)
        size = np.linalg.norm(steps, axis=1, keepdims=True)
        heading = self._table[:, 2]
        self._along = np.where(size > 0, steps / np.maximum(size, 1e-12), make_direction(heading))

    def _measure(self, poses: Array, middle: Array) -> tuple[Array, Array]:
        """Measures poses (K, 3), of which those that repeat the one before are left out.

        Returns:
            Centroids and headings there, and the lengths (K,) of the path up to there, m.
        """
        center = transform(poses, middle[None])[:, 0]
        rows = np.column_stack([center, poses[:, 2]])
        way = np.linalg.norm(np.diff(center, axis=0), axis=1)
        turn = self._arm * np.abs(np.diff(poses[:, 2]))
        arc = np.append(0.0, np.cumsum(np.maximum(way, turn)))
        kept = np.append(True, np.diff(arc) > 0)
        return rows[kept], arc[kept]

    def at(self, s: ArrayLike) -> Array:
        """Centroid, m, and heading, rad, (..., 3) at lengths (...,) of the path, m.

        Before its beginning and beyond its end, they are those of the beginning and of the end.
        """
        place = np.asarray(s, dtype=np.float64)
        return np.stack([np.interp(place, self._arc, column) for column in self._table.T], axis=-1)

    def along(self, s: ArrayLike) -> Array:
        """Unit vectors (..., 2) along the way of the centroid at lengths (...,)."""
        place = np.asarray(s, dtype=np.float64)
        found = np.stack([np.interp(place, self._arc, row) for row in self._along.T], axis=-1)
        size = np.linalg.norm(found, axis=-1, keepdims=True)
        return np.asarray(found / np.maximum(size, 1e-12))

    def project(self, center: Array, heading: float, last: float) -> float:
        """Finds how far along the path an object has come, m.

        Args:
            center: (2,) its centroid, W, m.
            heading: rad.
            last: how far it had come before, m. Only places of the path near there are considered.
        """
        low = np.searchsorted(self._arc, last - LOOK_BACK)
        high = max(np.searchsorted(self._arc, last + LOOK_AHEAD, side="right"), low + 1)
        near = self._table[low:high]
        # Where the path crosses itself, the heading tells on which part of it the object is.
        turn = np.mod(heading - near[:, 2] + np.pi, 2 * np.pi) - np.pi
        off = ((near[:, :2] - center) ** 2).sum(axis=1) + (self._arm * turn) ** 2
        return float(self._arc[low + int(off.argmin())])

    def rest(self, begin: float) -> PosePath:
        """The part of the path that is left from a length on, m; a last step of it at least."""
        begin = min(begin, float(self._arc[-2]))
        rows = np.vstack([self.at(begin), self._table[self._arc > begin]])
        origin = rows[:, :2] - rotate(rows[:, 2], self._middle)
        return PosePath(np.column_stack([origin, rows[:, 2]]), self.path.speed)

    def measure_distance(self, centers: Array) -> Array:
        """Distances (K,) of centroids (K, 2) from the nearest place of the whole path, m."""
        a = self._table[:-1, :2]
        d = np.diff(self._table[:, :2], axis=0)
        size2 = np.maximum((d**2).sum(axis=1), 1e-18)
        off = centers[:, None] - a
        fraction = np.clip((off * d).sum(axis=-1) / size2, 0.0, 1.0)
        return np.asarray(np.linalg.norm(off - fraction[..., None] * d, axis=-1).min(axis=1))

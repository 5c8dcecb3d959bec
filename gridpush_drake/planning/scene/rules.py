"""What a push of several objects may not do: `SceneRules`, and `SceneRoom`, which judges by them.

No push brings an object near the table's edge or against a post, or begins where the finger does
not fit. Contact with other objects is not forbidden: where all of them end is weighed in `search`.
A pusher that is no disc begins where the area that it covers is free.
The theory is in `docs/theory/planning.md`, section 6.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.polygons import hull_of
from gridpush_drake.geometry.se2 import Array, transform, transform_shape
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.push_constraints import PushRule, make_body
from gridpush_drake.planning.support_surface import SupportSurface

START_CLEARANCE = 1e-4
"""Distance of the pusher from every outline, beyond its clearance, where a push begins, m."""

CONSTRAINT_SLACK = 1e-6
"""By how much a rule may be broken, m, for round-off."""

MAX_EDGE_APPROACH = 0.01
"""By how much nearer to the table's edge a push may bring an object that is near it already, m. It
could hardly be turned otherwise."""

LEAST_MARGIN = 0.012
"""Distance from the table's edge below which no push brings an object nearer to it, m."""

POST_MARGIN = 0.01
"""Least distance of every object from an obstacle that is fixed on the table, m."""

POST_LEEWAY = 0.006
"""By how much nearer to such an obstacle an object may come by a further model, m."""


@dataclass(frozen=True, eq=False)
class SceneRules:
    """What a push of a scene may not do.

    Attributes:
        surface: the table; None for one without end.
        edge_margin: how far inside the table's edge every object must stay, m. One that is nearer
            already may come nearer still by `MAX_EDGE_APPROACH`, but not nearer than
            `LEAST_MARGIN`. While all of an object is over the table, it stays whatever its masses
            are.
        leeway: by how much nearer to the edge an object may come by a further model, m.
        finger_overhang: how far beyond the edge the finger's center may be, m.
        finger_region: where the finger's center may be, or the origin of another pusher's shape, W;
            None for anywhere.
        posts: what is fixed on the table, polygons in W, m: every object stays `POST_MARGIN` away
            from it, or no nearer than it is. The finger keeps clear of it by `finger_region`.
        push_rule: asked last, of a push that is about to be chosen: whether a robot can carry it
            out; None allows all.
    """

    surface: SupportSurface | None = None
    edge_margin: float = 0.03
    leeway: float = 0.01
    finger_overhang: float = 0.03
    finger_region: BaseGeometry | None = None
    posts: tuple[Polygon, ...] = ()
    push_rule: PushRule | None = None

    def allows_push(self, push: Push) -> bool:
        """Whether a robot can carry a push out."""
        return self.push_rule is None or self.push_rule(push)


UNCONSTRAINED = SceneRules()
"""The rules of a table without end and a finger that comes everywhere."""


@dataclass(frozen=True, eq=False)
class RoomLimits:
    """What the objects must keep in a push.

    Attributes:
        edge: (N,) least distances inside the table's edge, m.
        posts: (N,) least distances from what is fixed on the table, m.
    """

    edge: Array
    posts: Array


class SceneRoom:
    """Says where objects and finger may be by the rules.

    Attributes:
        objects: the N objects.
        rules: what no push may do.
    """

    def __init__(self, objects: Sequence[GridObject], rules: SceneRules = UNCONSTRAINED) -> None:
        """Makes the shapes that poses are judged with."""
        self.objects = objects
        self.rules = rules
        self._corners = [np.array(make_body(obj).exterior.coords)[:-1] for obj in objects]
        self._hulls = [hull_of(corners) for corners in self._corners]
        self._posts = shapely.union_all(list(rules.posts)) if rules.posts else None

    def calc_edge_distances(self, poses: Array) -> Array:
        """Calculates how far inside the table's edge each object is, (K, N) m; inf without a table.

        Args:
            poses: (K, N, 3), m and rad.
        """
        surface = self.rules.surface
        if surface is None:
            return np.full(poses.shape[:2], np.inf)
        distances = []
        for b, hull in enumerate(self._hulls):
            corners = transform(poses[:, b], hull)
            if surface.is_convex:
                inside = surface.edge_offsets - corners @ surface.edge_normals.T
                distances.append(inside.min(axis=(1, 2)))
            else:
                distances.append(surface.signed_distances(corners).min(axis=1))
        return np.stack(distances, axis=1)

    def calc_post_distances(self, poses: Array) -> Array:
        """Calculates how far each object is from what is fixed on the table, (K, N) m; inf without.

        Args:
            poses: (K, N, 3), m and rad.
        """
        distances = np.full(poses.shape[:2], np.inf)
        if self._posts is not None:
            for b, corners in enumerate(self._corners):
                placed = shapely.polygons(transform(poses[:, b], corners))
                distances[:, b] = shapely.distance(placed, self._posts)
        return distances

    def fits_pusher(self, poses: Array, pushes: Sequence[Push]) -> NDArray[np.bool_]:
        """Says which of K pushes can begin where they do, where the pusher comes down, (K,).

        Args:
            poses: (N, 3) where the objects lie, m and rad.
            pushes: the pushes, by one pusher.
        """
        if not pushes:
            return np.ones(0, dtype=bool)
        starts = np.array([push.start for push in pushes])
        # A disc covers all within its radius of its center; another shape, its area.
        covered, room = shapely.points(starts), pushes[0].radius + START_CLEARANCE
        if pushes[0].shape is not None:
            covered, room = np.array([push.find_area(0.0) for push in pushes]), START_CLEARANCE
        fits = self.allows_finger(starts)
        for pose, obj in zip(poses, self.objects, strict=True):
            fits &= shapely.distance(transform_shape(pose, obj.outline), covered) > room
        return fits

    def allows_finger(self, tips: Array) -> NDArray[np.bool_]:
        """Says where the finger's center, or the origin of a shape, may be, of places (K, 2)."""
        allowed = np.ones(len(tips), dtype=bool)
        if self.rules.finger_region is not None:
            allowed &= shapely.contains_xy(self.rules.finger_region, tips[:, 0], tips[:, 1])
        if self.rules.surface is not None:
            allowed &= self.rules.surface.contains(tips, -self.rules.finger_overhang)
        return allowed

    def make_limits(self, poses: Array, further: bool = False) -> RoomLimits:
        """Makes what the objects must keep in a push from poses (N, 3).

        Args:
            poses: where they lie, m and rad.
            further: whether the push is simulated by a further model, by which they may come a
                little nearer.
        """
        # The table's edge: whoever is near it already may come a little nearer.
        inside = self.calc_edge_distances(poses[None])[0]
        near = np.maximum(inside - MAX_EDGE_APPROACH, np.minimum(inside, LEAST_MARGIN))
        edge = np.minimum(near, self.rules.edge_margin) - CONSTRAINT_SLACK
        # Posts: whoever is near one already may come no nearer.
        posts = np.minimum(self.calc_post_distances(poses[None])[0], POST_MARGIN) - CONSTRAINT_SLACK
        if further:
            edge -= self.rules.leeway
            posts -= POST_LEEWAY
        return RoomLimits(edge=edge, posts=posts)

    def keeps_room(self, poses: Array, limits: RoomLimits) -> NDArray[np.bool_]:
        """Says which states (K, N, 3) keep the objects off the table's edge and the posts, (K,)."""
        kept = (self.calc_edge_distances(poses) >= limits.edge).all(axis=1)
        if self._posts is not None:
            kept &= (self.calc_post_distances(poses) >= limits.posts).all(axis=1)
        return np.asarray(kept)


def place_outlines(objects: Sequence[GridObject], poses: Array) -> NDArray[np.object_]:
    """Places the outlines of N objects at poses (N, 3), in W: (N,) polygons."""
    placed = [transform_shape(pose, obj.outline) for obj, pose in zip(objects, poses, strict=True)]
    return np.array(placed, dtype=object)

"""What a push must keep clear of: the table's edge, obstacles, and whatever else a caller knows.

A push is cut short where going on would break a rule. If a rule is broken already where the push
begins, for the object hangs over the edge or lies at an obstacle, it must not get worse.

`PushConstraints` are the rules. `PushChecker` applies them to pushes of one object from one pose,
with the shapes that this takes made once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.support_surface import SupportSurface

PoseRule = Callable[[Array], NDArray[np.bool_]]
"""Takes poses (K, 3) along a push, in order, and returns whether each is allowed, (K,)."""

PushRule = Callable[[Push], bool]
"""Takes a push and returns whether it can be carried out."""

CHECK_EVERY = 0.003
"""Length of the pusher's path between poses that are checked, m."""

CONSTRAINT_SLACK = 1e-6
"""By how much a rule may be broken, m, for round-off."""

CIRCLE_ROOM = 1.01
"""The circle about a body is this many times as large as it need be: what is grown or shrunk by a
circle is a polygon, which may be off by an eighth of a percent of the radius."""


@dataclass(frozen=True, eq=False)
class PushConstraints:
    """The rules of pushes.

    Attributes:
        surface: the table; None for one without end.
        obstacles: polygons in W that neither object nor finger may touch.
        edge_margin: least distance of every cell from the table's edge, inwards, m; negative lets
            cells hang over.
        obstacle_margin: least distance of object and finger from an obstacle, m.
        finger_inset: least distance of the finger's center from the table's edge, inwards, m;
            negative lets it hang beyond, as a finger that ends above the table may.
        pose_rule: says of further poses of the object whether they are allowed; None allows all.
        finger_region: where the finger's center may be, W; None for anywhere.
        push_rule: asked last, of a push that is about to be chosen: whether a robot can carry it
            out; None allows all.

    Raises:
        PlanningError: a number is not finite, the obstacles' margin is negative, or the finger's
            region is empty.
    """

    surface: SupportSurface | None = None
    obstacles: tuple[Polygon, ...] = ()
    edge_margin: float = 0.0
    obstacle_margin: float = 0.005
    finger_inset: float = 0.0
    pose_rule: PoseRule | None = None
    finger_region: BaseGeometry | None = None
    push_rule: PushRule | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        for name in ("edge_margin", "obstacle_margin", "finger_inset"):
            if not np.isfinite(getattr(self, name)):
                raise PlanningError(
                    f"{name} is {getattr(self, name)!r}; expected a finite number (m)"
                )
        if self.obstacle_margin < 0:
            raise PlanningError(
                f"obstacle_margin is {self.obstacle_margin!r}; expected a number >= 0 (m)"
            )
        if self.finger_region is not None and self.finger_region.is_empty:
            raise PlanningError(
                "finger_region is empty; expected some place where the finger may be"
            )
        for obstacle in self.obstacles:
            if not isinstance(obstacle, Polygon) or obstacle.is_empty or not obstacle.is_valid:
                raise PlanningError(
                    "obstacles: expected simple polygons that do not cross themselves"
                )

    @property
    def is_free(self) -> bool:
        """Whether no pose of object or finger is forbidden."""
        return not self.obstacles and all(
            rule is None for rule in (self.surface, self.pose_rule, self.finger_region)
        )

    def allows_push(self, push: Push) -> bool:
        """Whether `push_rule` lets a push be chosen."""
        return self.push_rule is None or self.push_rule(push)

    def start_at(self, obj: GridObject, pose: ArrayLike, radius: float) -> "PushChecker":
        """Makes what checks pushes of an object at `pose` (3,), X_WB, by a disc of `radius`, m."""
        return PushChecker(self, obj, np.asarray(pose, dtype=np.float64), radius)

    def allow_pose(self, obj: GridObject, pose: ArrayLike) -> tuple[bool, bool]:
        """Says whether an object may lie at a pose.

        Args:
            obj: the object.
            pose: (3,) X_WB, m and rad.

        Returns:
            Whether all of it is far enough inside the table's edge, and whether it is too near to
            an obstacle.
        """
        q = np.asarray(pose, dtype=np.float64)
        outline = np.array(make_body(obj).exterior.coords)[:-1]
        body = shapely.polygons(transform(q[None], outline))[0]
        on_table = True
        if self.surface is not None:
            table = self.surface.polygon.buffer(-self.edge_margin + CONSTRAINT_SLACK)
            on_table = bool(shapely.covers(table, body))
        blocked = False
        if self.obstacles:
            distance = float(shapely.distance(shapely.union_all(list(self.obstacles)), body))
            blocked = distance < self.obstacle_margin - CONSTRAINT_SLACK
        return on_table, blocked


class PushChecker:
    """The rules for one object at one pose and one disc.

    Attributes:
        constraints: the rules.
        body: union of outline and cells, body frame.
    """

    def __init__(
        self, constraints: PushConstraints, obj: GridObject, pose: Array, radius: float
    ) -> None:
        """Makes the shapes that pushes are checked with.

        Args:
            constraints: the rules.
            obj: the object.
            pose: (3,) where pushes begin, X_WB, m and rad.
            radius: of the finger, a disc, m.
        """
        self.constraints = constraints
        self.body = make_body(obj)
        self._vertices = np.array(self.body.exterior.coords)[:-1]
        # Where a circle about the body is allowed, the body need not be looked at. (The circle is
        # a little larger than the body, for the polygons that buffers make of circles.)
        circle = shapely.minimum_bounding_circle(self.body)
        self._middle = np.array(circle.centroid.coords[0])
        reach = float(np.linalg.norm(self._vertices - self._middle, axis=1).max())
        self._reach = CIRCLE_ROOM * reach
        self._room_on_table: BaseGeometry | None = None
        self._room_about_obstacles: BaseGeometry | None = None
        # On a convex table it is enough that the corners of the body's convex hull are.
        self._points_on_table = self._vertices
        self._table: BaseGeometry | None = None
        self._finger_table: BaseGeometry | None = None
        self._finger_region = constraints.finger_region
        self._blocked: BaseGeometry | None = None
        self._finger_blocked: BaseGeometry | None = None
        if constraints.surface is not None:
            self._prepare_table(constraints.surface, pose)
        if self._finger_region is not None:
            shapely.prepare(self._finger_region)
        if constraints.obstacles:
            self._prepare_obstacles(pose, radius)

    def _prepare_table(self, surface: SupportSurface, pose: Array) -> None:
        """Makes the tables that body and finger must be on; the body begins at `pose` (3,)."""
        table = surface.polygon.buffer(-self.constraints.edge_margin)
        if surface.is_convex:
            self._points_on_table = np.array(self.body.convex_hull.exterior.coords)[:-1]
        # If the body is beyond the margin already, the table is made larger by as much.
        points = shapely.points(transform(pose[None], self._points_on_table)[0])
        over = 0.0 if table.is_empty else float(shapely.distance(points, table).max())
        self._table = (
            table.buffer(over + CONSTRAINT_SLACK) if over > 0 else table.buffer(CONSTRAINT_SLACK)
        )
        self._finger_table = surface.polygon.buffer(-self.constraints.finger_inset)
        self._room_on_table = self._table.buffer(-self._reach)
        shapely.prepare(self._room_on_table)
        shapely.prepare(self._table)
        shapely.prepare(self._finger_table)

    def _prepare_obstacles(self, pose: Array, radius: float) -> None:
        """Makes what body and finger must not touch; the body begins at `pose` (3,)."""
        margin = self.constraints.obstacle_margin
        union = shapely.union_all(list(self.constraints.obstacles))
        # If the body is nearer than the margin already, the margin is made smaller by as much.
        room = float(shapely.distance(union, self.place(pose[None])[0]))
        self._blocked = union.buffer(max(min(margin, room) - CONSTRAINT_SLACK, -CONSTRAINT_SLACK))
        self._finger_blocked = union.buffer(margin + radius)
        self._room_about_obstacles = self._blocked.buffer(self._reach)
        shapely.prepare(self._room_about_obstacles)
        shapely.prepare(self._blocked)
        shapely.prepare(self._finger_blocked)

    def place(self, poses: Array) -> NDArray[np.object_]:
        """Makes polygons (K,) of the body, without its holes, at poses (K, 3), in W."""
        return np.asarray(shapely.polygons(transform(poses, self._vertices)))

    def allows_finger(self, p_WP: Array) -> NDArray[np.bool_]:
        """Whether the disc's center may be at p_WP (..., 2), m."""
        x = p_WP[..., 0]
        y = p_WP[..., 1]
        allowed = np.ones(p_WP.shape[:-1], dtype=bool)
        if self._finger_table is not None:
            allowed &= shapely.contains_xy(self._finger_table, x, y)
        if self._finger_region is not None:
            allowed &= shapely.contains_xy(self._finger_region, x, y)
        if self._finger_blocked is not None:
            allowed &= ~shapely.contains_xy(self._finger_blocked, x, y)
        return allowed

    def overlaps_obstacle(self, pose: Array) -> bool:
        """Whether the body at a pose (3,) overlaps an obstacle."""
        return any(
            obstacle.intersects(self.place(pose[None])[0])
            for obstacle in self.constraints.obstacles
        )

    @property
    def has_obstacles(self) -> bool:
        """Whether there are obstacles."""
        return self._blocked is not None

    @property
    def table_is_convex(self) -> bool:
        """Whether the table is convex, or there is none."""
        return self._table is None or self._points_on_table is not self._vertices

    def bounds(self, points: Array, room: float) -> tuple[Array, Array]:
        """Calculates the bounds of where an object may be.

        Args:
            points: (K, 2) that must be within them where there is no table, m.
            room: about points and obstacles where there is no table, m.

        Returns:
            (2,) least and (2,) greatest x and y, m: those of the table, if there is one.
        """
        if self.constraints.surface is not None:
            box = np.array(self.constraints.surface.polygon.bounds)
            return box[:2], box[2:]
        corners = [
            points,
            *(np.array(obstacle.bounds).reshape(2, 2) for obstacle in self.constraints.obstacles),
        ]
        points = np.concatenate(corners)
        return points.min(axis=0) - room, points.max(axis=0) + room

    def allows_poses(self, poses: Array) -> NDArray[np.bool_]:
        """Whether the object may be at poses (K, 3), in order along a push."""
        allowed = self.allows_geometry(poses)
        if self.constraints.pose_rule is not None:
            allowed &= self.constraints.pose_rule(poses)
        return allowed

    def allows_geometry(self, poses: Array) -> NDArray[np.bool_]:
        """Whether edge and obstacles let the object be at poses (K, 3)."""
        allowed = self.clears_obstacles(poses)
        if self._table is not None:
            middles = transform(poses, self._middle[None])[:, 0]
            near = np.flatnonzero(~shapely.contains_xy(self._room_on_table, middles))
            points = transform(poses[near], self._points_on_table)
            on_table = shapely.contains_xy(self._table, points[..., 0], points[..., 1]).all(axis=1)
            if not self.table_is_convex:
                on_table &= shapely.covers(self._table, self.place(poses[near]))
            allowed[near] &= on_table
        return allowed

    def clears_obstacles(self, poses: Array) -> NDArray[np.bool_]:
        """Whether the object at poses (K, 3) is far enough from every obstacle."""
        clear = np.ones(len(poses), dtype=bool)
        if self._blocked is not None:
            middles = transform(poses, self._middle[None])[:, 0]
            near = np.flatnonzero(shapely.contains_xy(self._room_about_obstacles, middles))
            clear[near] = ~shapely.intersects(self._blocked, self.place(poses[near]))
        return clear

    def count_allowed(self, tip: Array, poses: Array) -> int:
        """Counts how many steps of a push are allowed, from the first on.

        Args:
            tip: (T+1, 2) places of the disc's center, m.
            poses: (T+1, 3) poses of the object, X_WB, m and rad.
        """
        return int(self.count_allowed_by_models(tip, poses[None])[0])

    def count_allowed_by_models(self, tip: Array, poses: Array) -> NDArray[np.int64]:
        """Counts how many steps of a push are allowed, from the first on, by each of M models.

        Args:
            tip: (T+1, 2) places of the disc's center, m.
            poses: (M, T+1, 3) poses of the object by each model, X_WB, m and rad.

        Returns:
            (M,).
        """
        if self.constraints.is_free:
            return np.full(len(poses), len(tip))
        # Only steps about CHECK_EVERY apart are checked, and the last one.
        step = max(float(np.linalg.norm(np.diff(tip, axis=0), axis=1).mean()), CONSTRAINT_SLACK)
        stride = max(1, int(CHECK_EVERY / step))
        rows = np.unique(np.append(np.arange(0, len(tip), stride), len(tip) - 1))
        checked = poses[:, rows]
        allowed = self.allows_poses(checked.reshape(-1, 3)).reshape(checked.shape[:2])
        allowed &= self.allows_finger(tip[rows])
        first = np.argmin(allowed, axis=1)
        cut = np.where(first > 0, rows[first - 1] + 1, 0)
        return np.where(allowed.all(axis=1), len(tip), cut)


def make_body(obj: GridObject) -> Polygon:
    """Makes the body that must keep clear: the union of an object's outline and its cells' squares.

    It is the largest piece of that, in the body frame. The polygon is kept with the object, so that
    it is made only once.
    """
    cached = obj.__dict__.get("_swept_body")
    if cached is None:
        half = obj.cell_size / 2
        x, y = obj.p_BC.T
        squares = shapely.box(x - half, y - half, x + half, y + half)
        union = shapely.union_all([obj.outline, *squares])
        pieces = getattr(union, "geoms", [union])
        cached = Polygon(max(pieces, key=lambda piece: piece.area).exterior)
        obj.__dict__["_swept_body"] = cached
    return cached

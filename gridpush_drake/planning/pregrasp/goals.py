"""Where to slide an object so that the gripper can take it at the table's edge (the goals of the paper's Algorithm 3).

A goal pose lets the footprint of a graspable part hang beyond the edge while the center of mass, at
its worst, stays inside what holds the object. Seen from the object, a edge is a line w.p = b with w
the direction that points off the table: beyond it hangs what is farther along w. For every
direction w the part that sticks out most, whose footprint's least w.p is greatest, asks for the
least overhang; it is tried along the whole edge.

Goals are ranked by how far the object has to be slid (mean distance of its cells), with a charge
for a thin margin.

`ArmLimits`: what a robot's arm can do, as far as pre-grasp decisions need to know it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.polygons import calc_margin_inside, find_weakest_direction, hull_of
from gridpush_drake.geometry.se2 import Array, make_direction, rotate, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.pregrasp.grasp_parts import GraspPart
from gridpush_drake.planning.pregrasp.stability import SUPPORT_INSET, calc_support_polygon
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.push_constraints import PushRule, make_body
from gridpush_drake.planning.support_surface import SupportSurface


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """What the arm can do; None everywhere stands for an arm that can do anything.

    Attributes:
        finger_region: where the finger's center may be, W.
        edge_region: where on the table's edge the gripper may take something, W.
        can_push: whether the arm can carry out a push.
        can_grasp: whether the gripper can take the object where a goal has it, given the masses
            that it may have.
    """

    finger_region: BaseGeometry | None = None
    edge_region: BaseGeometry | None = None
    can_push: PushRule | None = None
    can_grasp: Callable[["PreGraspGoal", PlausibleMassSet], bool] | None = None


ANY_ARM = ArmLimits()  # an arm that can do anything


GOAL_ROOM = 0.03
"""Least distance of an object at a goal from anything else on the table, m; a little more than
pushes towards the goal must keep."""

TOUCH = 1e-9  # m, for round-off
SHALLOWER = (0.5, 0.25)  # of the overhang, where with more of it nothing is safe
DEEPER = (
    3.0,
    5.0,
)  # of it, where with less the gripper gets hold of nothing: its pads may need what lies farther in
GOALS_FOR_AN_ARM = 6  # goals looked for that the arm can grasp at; to ask the arm takes time
PARTS_FOR_AN_ARM = 12  # parts that hang over which the arm is asked about


@dataclass(frozen=True)
class GoalOptions:
    """How goals are sought.

    Attributes:
        margin: least stability margin of a safe goal, m.
        overhang: how far beyond the edge a goal puts the footprint, m; more than is needed, for
            pushes end only nearly where they should.
        min_overhang: how far beyond the edge the footprint must be for the gripper to take the
            part, m.
        directions: of the object that are pointed off the table, over a full turn.
        places: along the edge.
        tried: most poses whose margin is calculated.
        comfort: margin from which on more of it is worth nothing, m.
        charge: how much farther to slide a meter of missing comfort is worth, m/m.
        inset: m inside the edge that a cell's center must be to hold.
    """

    margin: float = 0.003
    overhang: float = 0.006
    min_overhang: float = 0.001
    directions: int = 48
    places: int = 40
    tried: int = 60
    comfort: float = 0.02
    charge: float = 5.0
    inset: float = SUPPORT_INSET

    def __post_init__(self) -> None:
        for name in ("margin", "overhang", "min_overhang", "comfort", "charge", "inset"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected a number >= 0")
        for name in ("directions", "places", "tried"):
            if getattr(self, name) < 4:
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected at least 4")


@dataclass(frozen=True, eq=False)
class PreGraspGoal:
    """A pose at the edge with a part hanging over.

    Attributes:
        pose: (3,) X_WB, m and rad, theta within half a turn of where the object is.
        part: that hangs over.
        overhang: how far its footprint is beyond the edge, m.
        margin: how far the worst center of mass stays inside the support, m; negative where it may
            tip.
        travel: mean distance of the cells from where they are, m.
        weakest: (2,) unit vector, body frame, along which the margin is least.
    """

    pose: Array
    part: GraspPart
    overhang: float
    margin: float
    travel: float
    weakest: Array

    @property
    def p_WG(self) -> Array:
        """(2,) middle of the part in W, m."""
        return transform(self.pose, self.part.p_BG[None])[0]

    @property
    def closing_W(self) -> Array:
        """(2,) unit vector along which the jaws close, in W."""
        return rotate(self.pose[2], self.part.closing)


def calc_overhangs(parts: Sequence[GraspPart], pose: ArrayLike, surface: SupportSurface) -> Array:
    """How far the parts' footprints are beyond the edge, (P,) m; negative where some of one is over the table.

    On a convex table it is measured from the line of one edge, and so a little too small beyond a
    corner.
    """
    q = np.asarray(pose, dtype=np.float64)
    corners = transform(q, np.array([part.footprint for part in parts]).reshape(-1, 4, 2))
    if surface.is_convex:
        return np.asarray(
            (corners @ surface.edge_normals.T - surface.edge_offsets).min(axis=1).max(axis=1)
        )
    prints = shapely.polygons(corners)
    clear = shapely.distance(prints, surface.polygon)
    inside = surface.signed_distances(corners).max(axis=1)
    return np.where(clear > 0, clear, -np.maximum(inside, TOUCH))


def find_grasp_at(
    masses: PlausibleMassSet,
    parts: Sequence[GraspPart],
    pose: ArrayLike,
    surface: SupportSurface,
    options: GoalOptions | None = None,
    limits: ArmLimits = ANY_ARM,
) -> PreGraspGoal | None:
    """The part that can be taken where the object lies now, the nearest to the middle of its possible centers of mass.

    Returns:
        The present pose as a goal, whatever its margin; None where no part that the arm can take
        hangs over far enough.
    """
    options = options or GoalOptions()
    q = np.asarray(pose, dtype=np.float64)
    overhangs = calc_overhangs(parts, q, surface) if parts else np.empty(0)
    free = np.flatnonzero(overhangs >= options.min_overhang)
    if not len(free):
        return None
    middle = masses.middle
    nearest = sorted(free.tolist(), key=lambda i: float(np.linalg.norm(parts[i].p_BG - middle)))
    margin, weakest = _judge(masses, q, surface, options.inset)
    goals = [
        PreGraspGoal(q.copy(), parts[i], float(overhangs[i]), margin, 0.0, weakest) for i in nearest
    ]
    if limits.can_grasp is None:
        return goals[0]
    return next((goal for goal in goals[:PARTS_FOR_AN_ARM] if limits.can_grasp(goal, masses)), None)


def find_pregrasp_goals(
    masses: PlausibleMassSet,
    parts: Sequence[GraspPart],
    pose: ArrayLike,
    surface: SupportSurface,
    options: GoalOptions | None = None,
    limits: ArmLimits = ANY_ARM,
    obstacles: Sequence[Polygon] = (),
) -> list[PreGraspGoal]:
    """Seeks goal poses for an object at `pose` (3,), X_WB, m and rad.

    Args:
        obstacles: what else lies on the table, polygons in W, m; no goal is nearer than
            GOAL_ROOM to it.

    Returns:
        Safe ones, whose margin is at least `options.margin`, by rank; where there are none, the one
        with the greatest margin alone.

    Raises:
        PlanningError: there is no graspable part, or the table is smaller than the object.
    """
    options = options or GoalOptions()
    q = np.asarray(pose, dtype=np.float64)
    check_room(masses.obj, parts, surface)
    goals: list[PreGraspGoal] = []
    for share in (1.0, *SHALLOWER, *DEEPER):
        if goals and share > 1.0:
            break
        wanted = replace(options, overhang=share * options.overhang)
        found: list[PreGraspGoal] = []
        for candidate, part in _propose(masses, parts, q, surface, wanted, limits, obstacles):
            reached = float(calc_overhangs([part], candidate, surface)[0])
            if reached >= options.min_overhang:
                margin, weakest = _judge(masses, candidate, surface, options.inset)
                travel = float(calc_goal_error(masses.obj, q, candidate))
                found.append(PreGraspGoal(candidate, part, reached, margin, travel, weakest))
        safe = [goal for goal in found if goal.margin >= options.margin]
        if safe:
            rank = sorted(
                safe,
                key=lambda at: at.travel + options.charge * max(options.comfort - at.margin, 0.0),
            )
            if kept := _keep(rank, masses, limits):
                return kept
        else:
            goals = _keep(sorted(found, key=lambda at: -at.margin), masses, limits)[:1] or goals
    return goals


def _keep(
    goals: list[PreGraspGoal], masses: PlausibleMassSet, limits: ArmLimits
) -> list[PreGraspGoal]:
    """The goals, in their order, that the arm can grasp at: the first few."""
    if limits.can_grasp is None:
        return goals
    can_grasp = limits.can_grasp
    return list(islice((goal for goal in goals if can_grasp(goal, masses)), GOALS_FOR_AN_ARM))


def check_room(obj: GridObject, parts: Sequence[GraspPart], surface: SupportSurface) -> None:
    """Raises PlanningError where the object has no graspable part, or the table is smaller than the object."""
    if not parts:
        raise PlanningError(
            f"{obj.name}: no graspable part: nowhere narrower than the gripper opens, with room for it"
        )
    if not surface.fits(hull_of(obj.outline.exterior.coords[:-1])):
        raise PlanningError(
            f"table: smaller than {obj.name}, which fits on it in no direction; expected a larger table"
        )


def _propose(
    masses: PlausibleMassSet,
    parts: Sequence[GraspPart],
    pose: Array,
    surface: SupportSurface,
    options: GoalOptions,
    limits: ArmLimits,
    obstacles: Sequence[Polygon],
) -> list[tuple[Array, GraspPart]]:
    """Poses (3,) that are promising by what a straight edge would say, and the part that hangs over in each."""
    obj = masses.obj
    feet = np.array([part.footprint for part in parts])
    angles = 2 * np.pi * np.arange(options.directions) / options.directions
    places = surface.perimeter * (np.arange(options.places) + 0.5) / options.places
    edge = [surface.edge_at(s) for s in places]
    if limits.edge_region is not None:
        edge = [
            (point, normal)
            for point, normal in edge
            if shapely.contains_xy(limits.edge_region, *point)
        ]
    found: list[tuple[float, float, Array, GraspPart]] = []
    for angle in angles:
        w = make_direction(angle)
        reach = (feet @ w).min(axis=1)
        best = int(np.argmax(reach))
        b = float(reach[best]) - options.overhang
        margin = calc_margin_inside(
            masses.center_of_mass_polygon, hull_of(obj.p_BC[obj.p_BC @ w <= b - options.inset])
        )
        p_BR = parts[best].p_BG + (b - parts[best].p_BG @ w) * w
        for point, normal in edge:
            theta = float(np.arctan2(normal[1], normal[0])) - angle
            theta += 2 * np.pi * np.round((pose[2] - theta) / (2 * np.pi))
            goal = np.append(point - rotate(theta, p_BR), theta)
            cost = float(calc_goal_error(obj, pose, goal)) + options.charge * max(
                options.comfort - margin, 0.0
            )
            found.append((margin, cost, goal, parts[best]))
    if obstacles and found:
        # A goal must leave room to everything else on the table.
        poses = np.array([goal for _, _, goal, _ in found])
        bodies = shapely.polygons(transform(poses, np.array(make_body(obj).exterior.coords)[:-1]))
        free = shapely.distance(shapely.union_all(list(obstacles)), bodies) >= GOAL_ROOM
        found = [each for each, is_free in zip(found, free.tolist(), strict=True) if is_free]
    promising = sorted((f for f in found if f[0] >= options.margin), key=lambda f: f[1])
    if not promising:
        promising = sorted(
            found, key=lambda f: (-round(f[0], 4) if np.isfinite(f[0]) else np.inf, f[1])
        )
    return [(goal, part) for _, _, goal, part in promising[: options.tried]]


def _judge(
    masses: PlausibleMassSet, pose: Array, surface: SupportSurface, inset: float
) -> tuple[float, Array]:
    centers, hull = (
        masses.center_of_mass_polygon,
        calc_support_polygon(masses.obj, pose, surface, inset),
    )
    return calc_margin_inside(centers, hull), find_weakest_direction(centers, hull)

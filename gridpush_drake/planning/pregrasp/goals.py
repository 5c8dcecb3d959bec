"""Where to slide an object to grasp it at the table's edge: the goals of the paper's Algorithm 3.

A goal pose lets the footprint of a graspable part hang beyond the edge while the center of mass, at
its worst, stays inside what holds the object.

Seen from the object, an edge of the table is a line w.p = b, where w is the unit vector that points
off the table; what is farther along w hangs over. For every direction w the part that sticks out
most needs the least overhang: the one whose footprint's least w.p is greatest. With b a little less
than that, the part hangs over, and the margin on a straight edge follows without a table: how far
the center of mass stays inside the hull of the cells with w.p <= b. Then each such pose of object
and edge is tried at many places along the table's edge.

Goals are ranked by how far the object has to be slid (mean distance of its cells), with a charge
for a thin margin.

`ArmLimits` is what a robot's arm can do, as far as pre-grasp decisions need to know it.
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
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import GraspPart
from gridpush_drake.planning.pregrasp.stability import SUPPORT_INSET, calc_support_polygon
from gridpush_drake.planning.push_constraints import PushRule, make_body
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.press import PressTarget


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """What the arm can do. A field that is None sets no limit.

    Attributes:
        finger_region: where the finger's center may be, W.
        edge_region: where on the table's edge the gripper may take something, W.
        can_push: whether the arm can carry out a push.
        can_grasp: whether the gripper can take the object where a goal has it, given the masses
            that it may have.
        can_press: whether the finger can press there, with the object at a pose (3,).
    """

    finger_region: BaseGeometry | None = None
    edge_region: BaseGeometry | None = None
    can_push: PushRule | None = None
    can_grasp: Callable[["PreGraspGoal", PlausibleMassSet], bool] | None = None
    can_press: Callable[[PressTarget, Array], bool] | None = None


ANY_ARM = ArmLimits()
"""Limits of an arm that can do anything."""

GOAL_ROOM = 0.03
"""Least distance of an object at a goal from anything else on the table, m; a little more than
pushes towards the goal must keep."""

MIN_TOUCH_DEPTH = 1e-9
"""Least depth by which a footprint that touches the table counts as over it, m."""

SMALLER_OVERHANGS = (0.5, 0.25)
"""If nothing is safe with the overhang wanted, these fractions of it are tried."""

LARGER_OVERHANGS = (3.0, 5.0)
"""If no smaller overhang gives a goal either, these multiples of it are tried: the gripper's pads
may need something that lies farther in."""

MAX_GOALS_ASKED = 6
"""Number of goals after which no more are looked for that the arm can grasp at. It takes time to
ask the arm."""

MAX_PARTS_ASKED = 12
"""Number of overhanging parts that the arm is asked about at most."""

MARGIN_DIGITS = 4
"""Where no margin is safe, margins that agree in so many decimals, of m, count as the same."""


@dataclass(frozen=True)
class GoalOptions:
    """How goals are sought.

    Attributes:
        margin: least stability margin of a safe goal, m.
        overhang: how far beyond the edge a goal puts the footprint, m; more than is needed, for
            pushes end only nearly where they should.
        min_overhang: how far beyond the edge the footprint must be for the gripper to take the
            part, m.
        directions: number of directions of the object that are pointed off the table, over a full
            turn.
        places: number of places along the table's edge.
        tried: number of poses whose margin is calculated, at most.
        comfort: a margin larger than this is worth nothing more, m.
        charge: how much farther to slide a meter of missing comfort is worth, m/m.
        inset: m inside the edge that a cell's center must be to hold.

    Raises:
        PlanningError: a value is out of range.
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

    def calc_charge(self, margin: float) -> float:
        """Calculates the charge for a thin margin, m, in meters that the object has to be slid."""
        return self.charge * max(self.comfort - margin, 0.0)


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


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A pose that may be a goal, judged as if the table's edge were straight.

    Attributes:
        pose: (3,) X_WB, m and rad.
        part: that hangs over.
        margin: stability margin on a straight edge, m.
        cost: mean distance of the cells from where they are, and the charge for the margin, m.
    """

    pose: Array
    part: GraspPart
    margin: float
    cost: float


def calc_overhangs(parts: Sequence[GraspPart], pose: ArrayLike, surface: SupportSurface) -> Array:
    """Calculates how far the parts' footprints are beyond the edge.

    On a convex table it is measured from the line of one edge, and so a little too small beyond a
    corner.

    Args:
        parts: the P parts.
        pose: (3,) of the object, X_WB, m and rad.
        surface: the table.

    Returns:
        (P,) m; negative where some of a footprint is over the table.
    """
    q = np.asarray(pose, dtype=np.float64)
    corners = transform(q, np.array([part.footprint for part in parts]).reshape(-1, 4, 2))
    if surface.is_convex:
        # A footprint hangs over an edge as far as its innermost corner does; the edge counts at
        # which that is farthest.
        beyond = corners @ surface.edge_normals.T - surface.edge_offsets
        return np.asarray(beyond.min(axis=1).max(axis=1))
    footprints = shapely.polygons(corners)
    clear = shapely.distance(footprints, surface.polygon)
    inside = surface.signed_distances(corners).max(axis=1)
    return np.where(clear > 0, clear, -np.maximum(inside, MIN_TOUCH_DEPTH))


def find_grasp_at(
    masses: PlausibleMassSet,
    parts: Sequence[GraspPart],
    pose: ArrayLike,
    surface: SupportSurface,
    options: GoalOptions | None = None,
    limits: ArmLimits = ANY_ARM,
) -> PreGraspGoal | None:
    """Finds the part that can be taken where the object lies now.

    Args:
        masses: that the object may have; of several parts the one nearest to the middle of its
            possible centers of mass is taken.
        parts: the parts to choose from.
        pose: (3,) of the object, X_WB, m and rad.
        surface: the table.
        options: how far a footprint must hang over.
        limits: of the arm.

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
        PreGraspGoal(
            pose=q.copy(),
            part=parts[i],
            overhang=float(overhangs[i]),
            margin=margin,
            travel=0.0,
            weakest=weakest,
        )
        for i in nearest
    ]
    if limits.can_grasp is None:
        return goals[0]
    return next((goal for goal in goals[:MAX_PARTS_ASKED] if limits.can_grasp(goal, masses)), None)


def find_pregrasp_goals(
    masses: PlausibleMassSet,
    parts: Sequence[GraspPart],
    pose: ArrayLike,
    surface: SupportSurface,
    options: GoalOptions | None = None,
    limits: ArmLimits = ANY_ARM,
    obstacles: Sequence[Polygon] = (),
) -> list[PreGraspGoal]:
    """Seeks goal poses for an object.

    Args:
        masses: that the object may have.
        parts: one of which is to hang over.
        pose: (3,) where the object lies, X_WB, m and rad.
        surface: the table.
        options: how goals are sought, and what counts as safe.
        limits: of the arm.
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
    unsafe: list[PreGraspGoal] = []
    for fraction in (1.0, *SMALLER_OVERHANGS, *LARGER_OVERHANGS):
        # A larger overhang makes margins thinner: it is for where there is no goal at all.
        if unsafe and fraction > 1.0:
            break
        wanted = replace(options, overhang=fraction * options.overhang)
        candidates = _propose(masses, parts, q, surface, wanted, limits, obstacles)
        found = _judge_candidates(candidates, masses, q, surface, options)
        safe = [goal for goal in found if goal.margin >= options.margin]
        if safe:
            safe.sort(key=lambda goal: goal.travel + options.calc_charge(goal.margin))
            kept = _keep_graspable(safe, masses, limits)
            if kept:
                return kept
        else:
            found.sort(key=lambda goal: -goal.margin)
            unsafe = _keep_graspable(found, masses, limits)[:1] or unsafe
    return unsafe


def _judge_candidates(
    candidates: Sequence[_Candidate],
    masses: PlausibleMassSet,
    pose: Array,
    surface: SupportSurface,
    options: GoalOptions,
) -> list[PreGraspGoal]:
    """Makes goals of those candidates whose part hangs over far enough on the real table.

    Args:
        candidates: judged as if the edge were straight.
        masses: that the object may have.
        pose: (3,) where the object lies, X_WB, m and rad.
        surface: the table.
        options: how far a part must hang over.
    """
    found = []
    for candidate in candidates:
        overhang = float(calc_overhangs([candidate.part], candidate.pose, surface)[0])
        if overhang < options.min_overhang:
            continue
        margin, weakest = _judge(masses, candidate.pose, surface, options.inset)
        goal = PreGraspGoal(
            pose=candidate.pose,
            part=candidate.part,
            overhang=overhang,
            margin=margin,
            travel=float(calc_goal_error(masses.obj, pose, candidate.pose)),
            weakest=weakest,
        )
        found.append(goal)
    return found


def _keep_graspable(
    goals: list[PreGraspGoal], masses: PlausibleMassSet, limits: ArmLimits
) -> list[PreGraspGoal]:
    """The first few goals that the arm can grasp at; all where it has no limits."""
    if limits.can_grasp is None:
        return goals
    can_grasp = limits.can_grasp
    return list(islice((goal for goal in goals if can_grasp(goal, masses)), MAX_GOALS_ASKED))


def check_room(obj: GridObject, parts: Sequence[GraspPart], surface: SupportSurface) -> None:
    """Checks that an object has graspable parts, and fits on the table.

    Raises:
        PlanningError: it has no graspable part, or the table is smaller than the object.
    """
    if not parts:
        raise PlanningError(
            f"{obj.name}: no graspable part: nowhere narrower than the gripper opens, with room "
            "for it"
        )
    if not surface.fits(hull_of(obj.outline.exterior.coords[:-1])):
        raise PlanningError(
            f"table: smaller than {obj.name}, which fits on it in no direction; expected a larger "
            "table"
        )


def _propose(
    masses: PlausibleMassSet,
    parts: Sequence[GraspPart],
    pose: Array,
    surface: SupportSurface,
    options: GoalOptions,
    limits: ArmLimits,
    obstacles: Sequence[Polygon],
) -> list[_Candidate]:
    """Proposes poses that are promising by what a straight edge would say, the best first.

    Arguments as of `find_pregrasp_goals`.
    """
    found = _list_candidates(masses, parts, pose, surface, options, limits)
    if obstacles and found:
        found = _keep_clear(found, masses.obj, obstacles)
    promising = [each for each in found if each.margin >= options.margin]
    promising.sort(key=lambda each: each.cost)
    if not promising:
        # Nothing is safe: the thickest margins first, and those of nothing held (-inf) last.
        promising = sorted(
            found,
            key=lambda each: (
                -round(each.margin, MARGIN_DIGITS) if np.isfinite(each.margin) else np.inf,
                each.cost,
            ),
        )
    return promising[: options.tried]


def _list_candidates(
    masses: PlausibleMassSet,
    parts: Sequence[GraspPart],
    pose: Array,
    surface: SupportSurface,
    options: GoalOptions,
    limits: ArmLimits,
) -> list[_Candidate]:
    """Lists poses with each direction of the object off the table, at each place of its edge."""
    obj = masses.obj
    footprints = np.array([part.footprint for part in parts])
    angles = 2 * np.pi * np.arange(options.directions) / options.directions
    edge_places = _list_edge_places(surface, options.places, limits)
    found: list[_Candidate] = []
    for angle in angles:
        # The part that sticks out most along w, and the line w.p = b at which it hangs over.
        w = make_direction(angle)
        reach = (footprints @ w).min(axis=1)
        best = int(np.argmax(reach))
        part = parts[best]
        b = float(reach[best]) - options.overhang
        # The margin, if the table's edge were that line.
        holding = obj.p_BC[obj.p_BC @ w <= b - options.inset]
        margin = calc_margin_inside(masses.center_of_mass_polygon, hull_of(holding))
        charge = options.calc_charge(margin)
        # The point R of that line beside the part comes to each place of the edge, with w along
        # the edge's outward normal. Of the headings theta, full turns apart, the nearest is taken.
        p_BR = part.p_BG + (b - part.p_BG @ w) * w
        for p_WR, normal in edge_places:
            theta = float(np.arctan2(normal[1], normal[0])) - angle
            theta += 2 * np.pi * np.round((pose[2] - theta) / (2 * np.pi))
            goal = np.append(p_WR - rotate(theta, p_BR), theta)
            cost = float(calc_goal_error(obj, pose, goal)) + charge
            found.append(_Candidate(pose=goal, part=part, margin=margin, cost=cost))
    return found


def _list_edge_places(
    surface: SupportSurface, count: int, limits: ArmLimits
) -> list[tuple[Array, Array]]:
    """Lists evenly spaced points of the table's edge that the gripper reaches, and the normals.

    Args:
        surface: the table.
        count: number of places along the whole edge.
        limits: of the arm.

    Returns:
        Points (2,), m, and outward unit normals (2,), in W.
    """
    arc_lengths = surface.perimeter * (np.arange(count) + 0.5) / count
    places = [surface.edge_at(s) for s in arc_lengths]
    region = limits.edge_region
    if region is None:
        return places
    return [(point, normal) for point, normal in places if shapely.contains_xy(region, *point)]


def _keep_clear(
    candidates: list[_Candidate], obj: GridObject, obstacles: Sequence[Polygon]
) -> list[_Candidate]:
    """The candidates that leave GOAL_ROOM to everything else on the table."""
    poses = np.array([each.pose for each in candidates])
    bodies = shapely.polygons(transform(poses, np.array(make_body(obj).exterior.coords)[:-1]))
    free = shapely.distance(shapely.union_all(list(obstacles)), bodies) >= GOAL_ROOM
    return [each for each, is_free in zip(candidates, free.tolist(), strict=True) if is_free]


def _judge(
    masses: PlausibleMassSet, pose: Array, surface: SupportSurface, inset: float
) -> tuple[float, Array]:
    """Calculates the stability margin at a pose (3,), m.

    Returns:
        The margin, and the unit vector (2,), body frame, along which it is least.
    """
    centers = masses.center_of_mass_polygon
    hull = calc_support_polygon(masses.obj, pose, surface, inset)
    return calc_margin_inside(centers, hull), find_weakest_direction(centers, hull)

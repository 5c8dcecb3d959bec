"""The next push of a slide to the table's edge: towards one of several goals, safe all the way.

Contact-point optimization proposes pushes towards each goal, forbidden to pass poses whose
stability margin is too thin. The proposals are then tried on several samples of the model, with the
loads that an overhanging object has (`dynamics.kernels.support_loads`), and cut short before the
first pose in which any draw's margin is too thin. Taken is the proposal that, so cut, ends nearest
to its goal on the average of the draws.

`PushMonitor`: watches a push under way that the object stays as safe as it was planned to, and
clear of other things on the table.

A push is planned so that the worst-case stability margin m(q) stays at m0 or above, where m0 is
what was asked for, or less where the margin was thinner at the beginning. A look errs by up to e,
so that nothing is known to be amiss until

    m_e(q) < m0 - e,

where m_e also counts as held those cells that only just seem to be beyond the edge, by e or less.
Then something else happened than was planned: the object slipped, or somebody moved it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.simulation import calc_loads, simulate
from gridpush_drake.geometry.polygons import calc_margin_inside, hull_of
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import optimize_contact
from gridpush_drake.planning.contact.trial import ContactOptions, PlannedPush, calc_goal_error
from gridpush_drake.planning.pregrasp.goals import ANY_ARM, ArmLimits, PreGraspGoal
from gridpush_drake.planning.pregrasp.stability import (
    SUPPORT_INSET,
    calc_stability_margin,
    calc_stability_margins,
)
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.push_constraints import (
    CHECK_EVERY,
    PoseRule,
    PushConstraints,
    make_body,
)
from gridpush_drake.planning.support_surface import SupportSurface

OBSTACLE_MARGIN = 0.025
"""Least distance of object and finger from other things on the table that pushes are planned with,
m: a push never ends quite where it is predicted to."""

BREAK_OFF_DISTANCE = 0.015
"""Distance between the object and another thing below which a push under way is broken off, m. Two
pictures may pass before the finger stops, in which it moves by less."""

FREE_OVERHANG = 1.0
"""m that cells may hang over the edge as far as the push search is concerned; stability is the
limit."""


@dataclass(frozen=True, eq=False)
class EdgeMotion:
    """What became of an object pushed near the edge."""

    poses: Array  # (K, 3) along the push, the first before it, m and rad
    traveled: Array  # (K,) m of the pusher's path at each
    fell: bool  # whether the object fell off the table; the poses end where it did

    @property
    def final_pose(self) -> Array:
        """(3,) the last pose."""
        return self.poses[-1]


def simulate_near_edge(
    obj: GridObject,
    params: CellParameters,
    push: Push,
    pose: ArrayLike,
    surface: SupportSurface,
    physics: Physics = QUASI_STATIC,
) -> EdgeMotion:
    """Simulates a slow push of an object that may hang over the edge, up to where it falls.

    Args:
        obj: the object.
        params: what it weighs and rubs.
        push: the push.
        pose: (3,) where it lies, X_WB, m and rad.
        surface: the table.
        physics: of the simulation, quasi-static.

    Returns:
        The motion.
    """
    q = np.asarray(pose, dtype=np.float64)
    gravity = physics.gravity
    if calc_loads(obj, params, q, surface.corners, gravity) is None:
        return EdgeMotion(q[None].copy(), np.zeros(1), True)
    times = make_path_times(push, physics.regime)
    traveled = push.distance_at(times)
    motion = simulate(obj, params, push, q, times=times, physics=physics, table=surface.corners)
    fell = bool(motion.tips.any())
    if not fell and calc_loads(obj, params, motion.final_pose, surface.corners, gravity) is None:
        return EdgeMotion(motion.poses, traveled, True)
    count = int(np.argmax(motion.tips)) + 1 if fell else len(times)
    return EdgeMotion(motion.poses[:count], traveled[:count], fell)


@dataclass(frozen=True)
class SlideOptions:
    """How pushes of a slide are chosen.

    Attributes:
        margin: least stability margin on the way, m.
        inset: m inside the edge that a cell's center must be to hold.
        goals: so many of the best goals are pushed towards.
        proposals: tried on the draws, over all goals.
        min_gain: by which a push must bring the object nearer to its goal, mean of the cells, m.
        finger_overhang: how far beyond the edge the finger's center may be, m.
        contact: what pushes may be chosen from.
    """

    margin: float = 0.002
    inset: float = SUPPORT_INSET
    goals: int = 3
    proposals: int = 10
    min_gain: float = 0.0005
    finger_overhang: float = 0.03
    contact: ContactOptions = field(
        default_factory=lambda: ContactOptions(distance_range=(0.004, 0.15), starts=6, budget=24)
    )


@dataclass(frozen=True, eq=False)
class Slide:
    """A push towards a goal."""

    planned: PlannedPush  # the push, and where it is expected to end
    goal: PreGraspGoal  # that it goes to
    margin: float  # least stability margin of any draw on the way, m
    spread: float  # root mean square distance of the draws' ends from their mean, of the cells, m


def make_stability_rule(
    masses: PlausibleMassSet,
    pose: ArrayLike,
    surface: SupportSurface,
    margin: float,
    inset: float = SUPPORT_INSET,
) -> PoseRule:
    """A rule for a push's poses: the stability margin must not fall below `margin`, m.

    Where it is thinner at `pose` (3,) already, or with the object wholly on the table, it must not
    get thinner still.
    """
    wanted = calc_kept_margin(masses, pose, surface, margin, inset) - THINNER

    def rule(poses: Array) -> NDArray[np.bool_]:
        return np.asarray(calc_stability_margins(masses, poses, surface, inset) >= wanted)

    return rule


def calc_kept_margin(
    masses: PlausibleMassSet,
    pose: ArrayLike,
    surface: SupportSurface,
    margin: float,
    inset: float = SUPPORT_INSET,
) -> float:
    """The stability margin that a push keeps, m.

    It is `margin`, or less where it is thinner at `pose` (3,) already, or with the object wholly on
    the table.
    """
    whole = calc_margin_inside(masses.center_of_mass_polygon, hull_of(masses.obj.p_BC))
    return min(margin, float(whole), calc_stability_margin(masses, pose, surface, inset))


THINNER = 1e-4  # m that a margin may become thinner where it is thin already, for round-off


def plan_slide(
    masses: PlausibleMassSet,
    params: CellParameters,
    draws: Sequence[CellParameters],
    pose: ArrayLike,
    goals: Sequence[PreGraspGoal],
    surface: SupportSurface,
    options: SlideOptions | None = None,
    limits: ArmLimits = ANY_ARM,
    obstacles: tuple[Polygon, ...] = (),
    physics: Physics = QUASI_STATIC,
) -> Slide | None:
    """Chooses the next push; None where none is safe, within the arm's reach, and brings the object nearer to a goal.

    Args:
        draws: further models to try the pushes on; the model itself is always tried.
        pose: (3,) where the object lies, X_WB, m and rad.
        goals: best first.
        obstacles: what else lies on the table, polygons in W, m, which the object keeps clear of
            whichever of the models is true.
        physics: of the simulations, quasi-static; it takes the place of the one in
            `options.contact`.
    """
    options = options or SlideOptions()
    options = replace(options, contact=replace(options.contact, physics=physics))
    q = np.asarray(pose, dtype=np.float64)
    rule = make_stability_rule(masses, q, surface, options.margin, options.inset)
    constraints = PushConstraints(
        surface,
        obstacles,
        edge_margin=-FREE_OVERHANG,
        obstacle_margin=OBSTACLE_MARGIN,
        finger_inset=-options.finger_overhang,
        pose_rule=rule,
        finger_region=limits.finger_region,
        push_rule=limits.can_push,
    )
    checker = constraints.start_at(masses.obj, q, options.contact.radius)

    def allows(poses: Array) -> NDArray[np.bool_]:
        return rule(poses) & checker.clears_obstacles(poses)

    proposals: list[tuple[PlannedPush, PreGraspGoal]] = []
    for goal in goals[: options.goals]:
        plan = optimize_contact(
            masses.obj, params, q, goal.pose, constraints=constraints, options=options.contact
        )
        proposals += [
            (push, goal)
            for push in plan.candidates
            if push.cost < plan.start_cost - options.min_gain
        ]
    proposals.sort(key=lambda each: each[0].cost)
    best: Slide | None = None
    for planned, goal in proposals[: options.proposals]:
        if best is not None and planned.cost >= best.planned.cost:
            break  # cut short and with doubt, it would hardly end nearer than the model has it end
        slide = _try(planned, goal, masses, (params, *draws), q, surface, allows, options)
        if slide is None or (best is not None and slide.planned.cost >= best.planned.cost):
            continue
        if constraints.allows_push(slide.planned.push):
            best = slide
    return best


def _try(
    planned: PlannedPush,
    goal: PreGraspGoal,
    masses: PlausibleMassSet,
    models: Sequence[CellParameters],
    pose: Array,
    surface: SupportSurface,
    rule: PoseRule,
    options: SlideOptions,
) -> Slide | None:
    """The push cut so short that it is safe with every model; None where nothing useful is left of it."""
    obj = masses.obj
    checks = np.unique(np.append(np.arange(0.0, planned.distance, CHECK_EVERY), planned.distance))
    paths = []
    for model in models:
        motion = simulate_near_edge(
            obj, model, planned.push, pose, surface, options.contact.physics
        )
        path = np.column_stack(
            [np.interp(checks, motion.traveled, motion.poses[:, i]) for i in range(3)]
        )
        allowed = rule(path) & (~np.bool_(motion.fell) | (checks < motion.traveled[-1]))
        checks = checks[: int(np.argmin(allowed))] if not allowed.all() else checks
        paths.append(path)
        if not (checks >= options.contact.distance_range[0]).any():
            return None
    useful = checks >= options.contact.distance_range[0]
    ends = np.array([path[: len(checks)] for path in paths])
    costs = np.where(useful, calc_goal_error(obj, ends, goal.pose).mean(axis=0), np.inf)
    best = int(np.argmin(costs))
    start_cost = float(calc_goal_error(obj, pose, goal.pose))
    if costs[best] > start_cost - options.min_gain:
        return None
    distance = float(checks[best])
    push = Push.on_outline(
        obj, planned.arc_length, planned.angle, distance, radius=planned.push.radius,
        speed=planned.push.length / planned.push.duration, pose=pose, clearance=options.contact.clearance,
    )  # fmt: skip
    cells = obj.cells_at(ends[:, best])
    spread = float(np.sqrt(((cells - cells.mean(axis=0)) ** 2).sum(axis=2).mean()))
    margin = float(
        calc_stability_margins(
            masses, ends[:, : best + 1].reshape(-1, 3), surface, options.inset
        ).min()
    )
    cut = replace(
        planned, distance=distance, push=push, pose=ends[0, best], cost=float(costs[best])
    )
    return Slide(cut, goal, margin, spread)


MM = 1e3  # millimeters in a meter


@dataclass(frozen=True, eq=False)
class PushMonitor:
    """What one push was planned with.

    Attributes:
        masses: the masses held possible.
        surface: the table.
        margin: m0, m.
        inset: m inside the edge that a cell's center must be to hold.
        error: e, of a look, m.
        obstacles: other things on the table, as one shape in W; None for none.
        room: least distance from them that the object keeps, m.
    """

    masses: PlausibleMassSet
    surface: SupportSurface
    margin: float
    inset: float
    error: float
    obstacles: BaseGeometry | None = None
    room: float = 0.0

    @classmethod
    def of_push(
        cls,
        masses: PlausibleMassSet,
        surface: SupportSurface,
        pose: Array,
        options: SlideOptions,
        error: float,
        obstacles: Sequence[Polygon] = (),
    ) -> "PushMonitor":
        """The monitor of a push from `pose` (3,), planned with `options`.

        Args:
            error: of a look, m.
            obstacles: what else lies on the table, polygons in W, m. Where the object begins nearer
                to one than pushes are broken off at, it must not come nearer still.
        """
        margin = calc_kept_margin(masses, pose, surface, options.margin, options.inset)
        others = shapely.union_all(list(obstacles)) if obstacles else None
        room = 0.0
        if others is not None:
            begin = transform_shape(pose, make_body(masses.obj)).distance(others)
            room = min(BREAK_OFF_DISTANCE, begin - error)
        return cls(masses, surface, margin, options.inset, error, others, room)

    def find_fault(self, pose: Array) -> str | None:
        """Why the push should not go on with the object seen at `pose` (3,), in half a sentence; None where it may."""
        if self.obstacles is not None:
            left = transform_shape(pose, make_body(self.masses.obj)).distance(self.obstacles)
            if left < self.room:
                return f"the object is {left * MM:.0f} mm from another one"
        margin = calc_stability_margin(self.masses, pose, self.surface, self.inset - self.error)
        if margin >= self.margin - self.error:
            return None
        return f"the object might fall, its stability margin is {margin * MM:.0f} mm at the worst"

"""The next push of a slide to the table's edge: towards one of several goals, safe all the way.

`plan_slide` chooses it. Contact-point optimization proposes pushes towards each goal, forbidden to
pass poses whose stability margin is too thin. Each proposal is then simulated with a few samples of
the model, with the loads that an overhanging object has (`dynamics.kernels.support_loads`), and
cut short before the first pose in which the margin is too thin by any of them. If what is left of
it looks better than the best one known, it is weighed with all samples: cut before the first pose
in which the margin is too thin by more than a small share of them, or in which the object falls by
any. The proposal is taken that, so cut, ends nearest to its goal on the average of the samples.

`PushMonitor` watches a push under way: whether the object stays as safe as was planned, and clear
of other things on the table.

A push is planned so that the worst-case stability margin m(q) stays at m0 or above, where m0 is
what was asked for, or less where the margin was thinner at the beginning. An observed pose is wrong
by up to e, so that nothing is known to be amiss until

    m_e(q) < m0 - e,

where m_e also counts as held those cells that only just seem to be beyond the edge, by e or less.
If that happens, something else happened than was planned: the object slipped, or somebody moved it.
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
from gridpush_drake.notebook import MM
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import optimize_contact
from gridpush_drake.planning.contact.trial import ContactOptions, PlannedPush, calc_goal_error
from gridpush_drake.planning.model_rollouts import count_agreed, count_exceptions, count_kept
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
"""How far cells may hang over the edge as far as the push search is concerned, m. What limits the
overhang is the stability margin."""

ROUND_OFF_MARGIN = 1e-4
"""By how much a margin that is thin already may become thinner, m, for round-off."""


@dataclass(frozen=True, eq=False)
class EdgeMotion:
    """What became of an object pushed near the edge.

    Attributes:
        poses: (K, 3) X_WB along the push, the first before it, m and rad; the last one is where the
            object fell, if it did.
        traveled: (K,) length of the pusher's path up to each pose, m.
        fell: whether the object fell off the table.
    """

    poses: Array
    traveled: Array
    fell: bool

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
        params: its masses and frictions.
        push: the push.
        pose: (3,) where it lies, X_WB, m and rad.
        surface: the table.
        physics: of the simulation, quasi-static.

    Returns:
        The motion.
    """
    q = np.asarray(pose, dtype=np.float64)
    gravity = physics.gravity
    # Without loads that bear it, the object falls where it lies.
    if calc_loads(obj, params, q, surface.corners, gravity) is None:
        return EdgeMotion(poses=q[None].copy(), traveled=np.zeros(1), fell=True)
    times = make_path_times(push, physics.regime)
    traveled = push.distance_at(times)
    motion = simulate(obj, params, push, q, times=times, physics=physics, table=surface.corners)
    fell = bool(motion.tips.any())
    # The simulation says of every step whether the object tips in it, but not of the last pose.
    if not fell and calc_loads(obj, params, motion.final_pose, surface.corners, gravity) is None:
        return EdgeMotion(poses=motion.poses, traveled=traveled, fell=True)
    count = int(np.argmax(motion.tips)) + 1 if fell else len(times)
    return EdgeMotion(poses=motion.poses[:count], traveled=traveled[:count], fell=fell)


@dataclass(frozen=True)
class SlideOptions:
    """How pushes of a slide are chosen.

    Attributes:
        margin: least stability margin on the way, m.
        inset: how far inside the edge a cell's center must be to hold, m.
        goals: number of goals, the best ones, that pushes are sought towards.
        proposals: number of proposed pushes that are tried on the samples, over all goals.
        few: number of samples with which a proposal is tried before it is weighed with all.
        confidence: share of the samples that must keep the margin; all of them where they are few.
        min_gain: by how much a push must bring the object nearer to its goal to be worth making,
            mean of the cells, m.
        finger_overhang: how far beyond the edge the finger's center may be, m.
        contact: what pushes may be chosen from.
    """

    margin: float = 0.002
    inset: float = SUPPORT_INSET
    goals: int = 3
    proposals: int = 10
    few: int = 4
    confidence: float = 0.95
    min_gain: float = 0.0005
    finger_overhang: float = 0.03
    contact: ContactOptions = field(
        default_factory=lambda: ContactOptions(distance_range=(0.004, 0.15), starts=6, budget=24)
    )


@dataclass(frozen=True, eq=False)
class Slide:
    """A push towards a goal.

    Attributes:
        planned: the push, and where it is expected to end.
        goal: the goal that it goes to.
        margin: least stability margin on the way, by the share of the samples that must keep it, m.
        spread: root mean square distance of the cells at the samples' ends from their mean, m.
    """

    planned: PlannedPush
    goal: PreGraspGoal
    margin: float
    spread: float


def make_stability_rule(
    masses: PlausibleMassSet,
    pose: ArrayLike,
    surface: SupportSurface,
    margin: float,
    inset: float = SUPPORT_INSET,
) -> PoseRule:
    """Makes a rule for the poses of a push: the stability margin must not become too thin.

    Arguments as of `calc_kept_margin`, which says what is too thin.
    """
    kept = calc_kept_margin(masses, pose, surface, margin, inset) - ROUND_OFF_MARGIN

    def rule(poses: Array) -> NDArray[np.bool_]:
        return np.asarray(calc_stability_margins(masses, poses, surface, inset) >= kept)

    return rule


def calc_kept_margin(
    masses: PlausibleMassSet,
    pose: ArrayLike,
    surface: SupportSurface,
    margin: float,
    inset: float = SUPPORT_INSET,
) -> float:
    """Calculates the stability margin that a push keeps.

    Args:
        masses: that the object may have.
        pose: (3,) where the push begins, X_WB, m and rad.
        surface: the table.
        margin: asked for, m.
        inset: how far inside the edge a cell's center must be to hold, m.

    Returns:
        `margin`, or less where it is thinner at `pose` already, or would be with the object wholly
        on the table, m.
    """
    whole = calc_margin_inside(masses.center_of_mass_polygon, hull_of(masses.obj.p_BC))
    return min(margin, float(whole), calc_stability_margin(masses, pose, surface, inset))


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
    """Chooses the next push of a slide.

    Args:
        masses: that the object may have; stability is judged by the worst of them.
        params: the model, by which pushes are searched for.
        draws: further models that the pushes are weighed with.
        pose: (3,) where the object lies, X_WB, m and rad.
        goals: best first.
        surface: the table.
        options: how pushes are chosen.
        limits: of the arm.
        obstacles: what else lies on the table, polygons in W, m, which the object keeps clear of
            whichever of the models is true.
        physics: of the simulations, quasi-static; it takes the place of the one in
            `options.contact`.

    Returns:
        The push; None where none is safe, within the arm's reach, and brings the object nearer to a
        goal.
    """
    options = options or SlideOptions()
    options = replace(options, contact=replace(options.contact, physics=physics))
    q = np.asarray(pose, dtype=np.float64)
    # What a push must keep to: by the model in the search, and by every sample afterwards.
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

    # Proposals towards every goal, those first that the model has end nearest to their goal.
    proposals: list[tuple[PlannedPush, PreGraspGoal]] = []
    for goal in goals[: options.goals]:
        plan = optimize_contact(
            masses.obj, params, q, goal.pose, constraints=constraints, options=options.contact
        )
        enough = plan.start_cost - options.min_gain
        proposals += [(push, goal) for push in plan.candidates if push.cost < enough]
    proposals.sort(key=lambda proposal: proposal[0].cost)
    # The best proposal, once cut short.
    best: Slide | None = None
    for planned, goal in proposals[: options.proposals]:
        # By the samples, and cut short, a push would hardly end nearer than by the model alone.
        if best is not None and planned.cost >= best.planned.cost:
            break
        # First with a few samples; what they leave of it then with all.
        slide: Slide | None = None
        for models in ((params, *draws[: options.few]), (params, *draws)):
            slide = _cut_short(
                planned=planned if slide is None else slide.planned,
                goal=goal,
                masses=masses,
                models=models,
                pose=q,
                surface=surface,
                rule=allows,
                options=options,
            )
            if slide is None or (best is not None and slide.planned.cost >= best.planned.cost):
                slide = None
                break
        if slide is not None and constraints.allows_push(slide.planned.push):
            best = slide
    return best


def _cut_short(
    planned: PlannedPush,
    goal: PreGraspGoal,
    masses: PlausibleMassSet,
    models: Sequence[CellParameters],
    pose: Array,
    surface: SupportSurface,
    rule: PoseRule,
    options: SlideOptions,
) -> Slide | None:
    """Cuts a push to what is safe by the models, and of that to what ends nearest.

    Args:
        planned: the push.
        goal: that it goes to.
        masses: that the object may have.
        models: M models that the push is simulated with, the estimate first.
        pose: (3,) where the object lies.
        surface: the table.
        rule: which poses are allowed, whichever model is true.
        options: what is worth pushing for.

    Returns:
        The part; None where nothing useful is left of the push.
    """
    obj = masses.obj
    shortest = options.contact.distance_range[0]
    # Distances, every few millimeters, at which the push may be cut.
    cuts = np.unique(np.append(np.arange(0.0, planned.distance, CHECK_EVERY), planned.distance))
    paths = np.empty((len(models), len(cuts), 3))
    for m, model in enumerate(models):
        motion = simulate_near_edge(
            obj, model, planned.push, pose, surface, options.contact.physics
        )
        for i in range(3):
            paths[m, :, i] = np.interp(cuts, motion.traveled, motion.poses[:, i])
        # By no model may the object fall.
        if motion.fell:
            cuts = cuts[cuts < motion.traveled[-1]]
            paths = paths[:, : len(cuts)]
        if not (cuts >= shortest).any():
            return None
    # The estimate, and nearly all of the other models, keep the rule up to the cut.
    held = rule(paths.reshape(-1, 3)).reshape(paths.shape[:2])
    cuts = cuts[: count_agreed(count_kept(held), options.confidence)]
    if not (cuts >= shortest).any():
        return None
    # Of the cuts that are left, the one that ends nearest to the goal on the models' average.
    ends = paths[:, : len(cuts)]
    mean_costs = calc_goal_error(obj, ends, goal.pose).mean(axis=0)
    costs = np.where(cuts >= shortest, mean_costs, np.inf)
    best = int(np.argmin(costs))
    start_cost = float(calc_goal_error(obj, pose, goal.pose))
    if costs[best] > start_cost - options.min_gain:
        return None
    distance = float(cuts[best])
    push = Push.on_outline(
        obj,
        planned.arc_length,
        planned.angle,
        distance,
        radius=planned.push.radius,
        speed=planned.push.length / planned.push.duration,
        pose=pose,
        clearance=options.contact.clearance,
    )
    cells = obj.cells_at(ends[:, best])
    spread = float(np.sqrt(((cells - cells.mean(axis=0)) ** 2).sum(axis=2).mean()))
    on_the_way = ends[:, : best + 1].reshape(-1, 3)
    margins = calc_stability_margins(masses, on_the_way, surface, options.inset)
    by_models = np.sort(margins.reshape(len(models), -1).min(axis=1))
    exceptions = count_exceptions(len(models) - 1, options.confidence)
    cut = replace(
        planned, distance=distance, push=push, pose=ends[0, best], cost=float(costs[best])
    )
    return Slide(planned=cut, goal=goal, margin=float(by_models[exceptions]), spread=spread)


@dataclass(frozen=True, eq=False)
class PushMonitor:
    """Watches one push, by what it was planned with.

    Attributes:
        masses: that the object may have.
        surface: the table.
        margin: m0, the stability margin that the push was planned to keep, m.
        inset: how far inside the edge a cell's center must be to hold, m.
        error: e, by how much an observed pose may be wrong, m.
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
        """Makes the monitor of a push that was planned with `options`.

        Args:
            masses: that the object may have.
            surface: the table.
            pose: (3,) where the push begins, X_WB, m and rad.
            options: that the push was planned with.
            error: by how much an observed pose may be wrong, m.
            obstacles: what else lies on the table, polygons in W, m. Where the object begins nearer
                to one than pushes are broken off at, it must not come nearer still.
        """
        others = None
        room = 0.0
        if obstacles:
            others = shapely.union_all(list(obstacles))
            at_start = transform_shape(pose, make_body(masses.obj)).distance(others)
            room = min(BREAK_OFF_DISTANCE, at_start - error)
        return cls(
            masses=masses,
            surface=surface,
            margin=calc_kept_margin(masses, pose, surface, options.margin, options.inset),
            inset=options.inset,
            error=error,
            obstacles=others,
            room=room,
        )

    def find_fault(self, pose: Array) -> str | None:
        """Says why the push should not go on.

        Args:
            pose: (3,) where the object is seen, X_WB, m and rad.

        Returns:
            The reason in half a sentence; None where the push may go on.
        """
        if self.obstacles is not None:
            gap = transform_shape(pose, make_body(self.masses.obj)).distance(self.obstacles)
            if gap < self.room:
                return f"the object is {gap * MM:.0f} mm from another one"
        margin = calc_stability_margin(self.masses, pose, self.surface, self.inset - self.error)
        if margin >= self.margin - self.error:
            return None
        return f"the object might fall, its stability margin is {margin * MM:.0f} mm at the worst"

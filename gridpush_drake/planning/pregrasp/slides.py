"""The next push of a slide to the table's edge: towards one of several goals, safe all the way.

`plan_slide` chooses it. Contact-point optimization proposes pushes towards each goal, forbidden to
pass poses whose stability margin is too thin. What a proposal does is then followed by samples of
the model, with the loads that an overhanging object has (`edge_motion`), and the push is cut before
the first pose in which the margin is too thin by more than a small fraction of the samples, or in
which the object falls by any. The proposal is taken that, so cut, ends nearest to its goal on the
average of the samples.

That takes long with all samples, so it is done for as few proposals as possible. A few samples sift
them: what these leave of a push, and how near it comes to its goal by them, decides when its turn
comes, the most promising one first. The others are asked block by block, only as far as the push
goes by those asked before, and no more once too many of them leave nothing of it. The search ends
where the next proposal promises no more than the best one keeps.

How a push under way is watched is in `push_monitor`. The theory is in `docs/theory/planning.md`,
section 4.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon

from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.dynamics.push import DEFAULT_TIP_STEP, Push
from gridpush_drake.geometry.polygons import calc_margin_inside, hull_of
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import optimize_contact
from gridpush_drake.planning.contact.trial import ContactOptions, PlannedPush, calc_goal_error
from gridpush_drake.planning.edge_motion import COMPARED_TIP_STEP, follow_near_edge
from gridpush_drake.planning.model_rollouts import count_agreed, count_exceptions, count_kept
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.goals import ANY_ARM, ArmLimits, PreGraspGoal
from gridpush_drake.planning.pregrasp.stability import (
    SUPPORT_INSET,
    calc_stability_margin,
    calc_stability_margins,
)
from gridpush_drake.planning.push_constraints import (
    CHECK_EVERY,
    PoseRule,
    PushChecker,
    PushConstraints,
)
from gridpush_drake.planning.support_surface import SupportSurface

OBSTACLE_MARGIN = 0.025
"""Least distance of object and finger from other things on the table that pushes are planned with,
m: a push never ends quite where it is predicted to."""

FREE_OVERHANG = 1.0
"""How far cells may hang over the edge as far as the push search is concerned, m. What limits the
overhang is the stability margin."""

ROUND_OFF_MARGIN = 1e-4
"""By how much a margin that is thin already may become thinner, m, for round-off."""

BLOCK_SIZE = 24
"""Number of samples that are followed before it is looked how much of a push they leave."""


@dataclass(frozen=True)
class SlideOptions:
    """How pushes of a slide are chosen.

    Attributes:
        margin: least stability margin on the way, m.
        inset: how far inside the edge a cell's center must be to hold, m.
        goals: number of goals, the best ones, that pushes are sought towards.
        proposals: number of proposed pushes that are tried on the samples, over all goals.
        few: number of samples with which proposals are sifted before any is weighed with all.
        confidence: fraction of the samples that must keep the margin; all of them where they are
            few.
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
        margin: least stability margin on the way, by the fraction of the samples that must keep it,
            m.
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
    return min(
        calc_whole_margin(masses, margin), calc_stability_margin(masses, pose, surface, inset)
    )


def calc_whole_margin(masses: PlausibleMassSet, margin: float) -> float:
    """Returns `margin`, or less where it is thinner with the object wholly on the table, m."""
    whole = calc_margin_inside(masses.center_of_mass_polygon, hull_of(masses.obj.p_BC))
    return min(margin, float(whole))


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
    # What a push must keep to: by the model in the search, and by nearly all samples afterwards.
    kept = calc_kept_margin(masses, q, surface, options.margin, options.inset)
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
    # Proposals towards every goal, those first that the model has end nearest to their goal.
    proposals: list[tuple[PlannedPush, PreGraspGoal]] = []
    for goal in goals[: options.goals]:
        plan = optimize_contact(
            Model(masses.obj, params),
            q,
            goal.pose,
            constraints=constraints,
            options=options.contact,
        )
        enough = plan.start_cost - options.min_gain
        proposals += [(push, goal) for push in plan.candidates if push.cost < enough]
    proposals.sort(key=lambda proposal: proposal[0].cost)
    weighing = _SlideWeighing(
        masses=masses,
        models=(params, *draws),
        pose=q,
        surface=surface,
        kept_margin=kept - ROUND_OFF_MARGIN,
        checker=constraints.start_at(
            masses.obj, q, options.contact.pusher.choose_reach(masses.obj)
        ),
        options=options,
    )
    return _choose_best(proposals[: options.proposals], weighing, constraints)


def _choose_best(
    proposals: Sequence[tuple[PlannedPush, PreGraspGoal]],
    weighing: "_SlideWeighing",
    constraints: PushConstraints,
) -> Slide | None:
    """Chooses the proposal that ends nearest to its goal by all samples.

    Args:
        proposals: pushes, and the goals that they go to.
        weighing: says what the samples leave of a push.
        constraints: say whether the arm can make a push.

    Returns:
        What is left of it; None where of none anything useful is.
    """
    # A queue of (how near to its goal a push is expected to end, its number, what few samples left
    # of it), the nearest first. By more samples, and cut short, a push would hardly end nearer.
    queue: list[tuple[float, int, _Sifted | None]] = [
        (planned.cost, i, None) for i, (planned, _) in enumerate(proposals)
    ]
    heapq.heapify(queue)
    best: Slide | None = None
    while queue:
        cost, i, sifted = heapq.heappop(queue)
        if best is not None and cost >= best.planned.cost:
            break
        if sifted is None:
            sifted = weighing.sift(*proposals[i])
            if sifted is not None:
                heapq.heappush(queue, (sifted.cost, i, sifted))
            continue
        slide = weighing.weigh(sifted)
        if slide is None or (best is not None and slide.planned.cost >= best.planned.cost):
            continue
        if constraints.allows_push(slide.planned.push):
            best = slide
    return best


@dataclass(frozen=True, eq=False)
class _Followed:
    """What a push does by some models, at C places where it may be cut.

    Attributes:
        poses: (M, C, 3) X_WB, m and rad.
        margins: (M, C) stability margins there, m.
        upright: (M,) number of places, from the first on, at which the object has not fallen.
        kept: (M,) number of places, from the first on, at which the rules are kept.
    """

    poses: Array
    margins: Array
    upright: IntArray
    kept: IntArray

    def add(self, other: "_Followed") -> "_Followed":
        """Adds further models; all are looked at where these are."""
        C = other.poses.shape[1]
        return _Followed(
            poses=np.concatenate([self.poses[:, :C], other.poses]),
            margins=np.concatenate([self.margins[:, :C], other.margins]),
            upright=np.minimum(np.concatenate([self.upright, other.upright]), C),
            kept=np.minimum(np.concatenate([self.kept, other.kept]), C),
        )


@dataclass(frozen=True, eq=False)
class _Sifted:
    """A proposal as a few samples see it.

    Attributes:
        planned: the push.
        goal: that it goes to.
        cuts: (C,) lengths at which it may be cut, up to the best one by these samples, m.
        followed: what it does by the estimate and these samples.
        cost: how far from the goal the cells are there on their average, m.
    """

    planned: PlannedPush
    goal: PreGraspGoal
    cuts: Array
    followed: _Followed
    cost: float


@dataclass(frozen=True, eq=False)
class _SlideWeighing:
    """Says what models leave of a push.

    Attributes:
        masses: that the object may have.
        models: the estimate, then the samples.
        pose: (3,) where the object lies, X_WB, m and rad.
        surface: the table.
        kept_margin: least stability margin, m.
        checker: of the obstacles.
        options: what is worth pushing for, and what must hold.
    """

    masses: PlausibleMassSet
    models: Sequence[CellParameters]
    pose: Array
    surface: SupportSurface
    kept_margin: float
    checker: PushChecker
    options: SlideOptions

    def sift(self, planned: PlannedPush, goal: PreGraspGoal) -> _Sifted | None:
        """Cuts a push to what is safe by a few samples, and of that to what ends nearest.

        Args:
            planned: the push.
            goal: that it goes to.

        Returns:
            What is left; None where nothing useful is.
        """
        # Distances, every few millimeters, at which the push may be cut.
        cuts = np.unique(np.append(np.arange(0.0, planned.distance, CHECK_EVERY), planned.distance))
        # The estimate in steps as short as ever, for it says where the object is expected.
        estimate = self._follow(self.models[:1], planned, cuts, DEFAULT_TIP_STEP)
        few = self.models[1 : 1 + self.options.few]
        followed = estimate.add(self._follow(few, planned, cuts, COMPARED_TIP_STEP))
        best = self._find_best_cut(followed, goal, cuts, len(few))
        if best is None:
            return None
        end, cost = best
        return _Sifted(planned, goal, cuts=cuts[:end], followed=followed, cost=cost)

    def weigh(self, sifted: _Sifted) -> Slide | None:
        """Cuts to what is safe by all samples, and of that to what ends nearest.

        Args:
            sifted: what a few samples left of a push.

        Returns:
            What is left; None where nothing useful is.
        """
        cuts = sifted.cuts
        draws = len(self.models) - 1
        followed = sifted.followed
        rest = self.models[len(followed.poses) :]
        for begin in range(0, len(rest), BLOCK_SIZE):
            block = rest[begin : begin + BLOCK_SIZE]
            followed = followed.add(self._follow(block, sifted.planned, cuts, COMPARED_TIP_STEP))
            cuts = cuts[: self._count_safe(followed, draws)]
            if not self._are_long_enough(cuts).any():
                return None
        best = self._find_best_cut(followed, sifted.goal, cuts, draws)
        return (
            None if best is None else self._make_slide(sifted, followed, cuts[: best[0]], best[1])
        )

    def _follow(
        self,
        models: Sequence[CellParameters],
        planned: PlannedPush,
        cuts: Array,
        tip_step: float,
    ) -> _Followed:
        """Follows a push up to its last cut by some models; there may be none."""
        motions = follow_near_edge(
            obj=self.masses.obj,
            models=models,
            push=self._make_push(planned, float(cuts[-1])),
            pose=self.pose,
            surface=self.surface,
            places=cuts,
            physics=self.options.contact.physics or QUASI_STATIC,
            tip_step=tip_step,
        )
        flat = motions.poses.reshape(-1, 3)
        margins = calc_stability_margins(self.masses, flat, self.surface, self.options.inset)
        held = (margins >= self.kept_margin) & self.checker.clears_obstacles(flat)
        shape = motions.poses.shape[:2]
        return _Followed(
            poses=motions.poses,
            margins=margins.reshape(shape),
            upright=motions.counts,
            kept=count_kept(held.reshape(shape)),
        )

    def _make_push(self, planned: PlannedPush, distance: float) -> Push:
        """Makes the first part of a push, of a distance, m."""
        return Push.on_outline(
            self.masses.obj,
            planned.arc_length,
            planned.angle,
            distance,
            radius=planned.push.radius,
            shape=planned.push.shape,
            speed=planned.push.length / planned.push.duration,
            pose=self.pose,
            clearance=self.options.contact.pusher.clearance,
        )

    def _are_long_enough(self, cuts: Array) -> NDArray[np.bool_]:
        """Whether a push cut there is long enough to be made."""
        return np.asarray(cuts >= self.options.contact.distance_range[0])

    def _count_safe(self, followed: _Followed, draws: int) -> int:
        """Counts the cuts that are safe by the models followed so far.

        By no model may the object fall; the estimate, and nearly all of the others, keep the rules.

        Args:
            followed: what the push does by the estimate and some samples.
            draws: number of samples that there will be; those not followed yet allow all.
        """
        kept = np.full(1 + draws, followed.poses.shape[1])
        kept[: len(followed.kept)] = followed.kept
        return min(int(followed.upright.min()), count_agreed(kept, self.options.confidence))

    def _find_best_cut(
        self, followed: _Followed, goal: PreGraspGoal, cuts: Array, draws: int
    ) -> tuple[int, float] | None:
        """Finds the safe cut that ends nearest to the goal on the models' average.

        Args:
            followed: what the push does by the models.
            goal: that it goes to.
            cuts: (C,) where it may be cut, m.
            draws: number of samples among the models.

        Returns:
            Number of cuts up to that one, and how far from the goal the cells are there, m; None
            where none is worth a push.
        """
        obj = self.masses.obj
        cuts = cuts[: self._count_safe(followed, draws)]
        useful = self._are_long_enough(cuts)
        if not useful.any():
            return None
        mean_costs = calc_goal_error(obj, followed.poses[:, : len(cuts)], goal.pose).mean(axis=0)
        costs = np.where(useful, mean_costs, np.inf)
        best = int(np.argmin(costs))
        start_cost = float(calc_goal_error(obj, self.pose, goal.pose))
        if costs[best] > start_cost - self.options.min_gain:
            return None
        return best + 1, float(costs[best])

    def _make_slide(self, sifted: _Sifted, followed: _Followed, cuts: Array, cost: float) -> Slide:
        """Makes the push that goes up to the last of some cuts, (C,), m."""
        count = len(cuts)
        ends = followed.poses[:, count - 1]
        cells = self.masses.obj.cells_at(ends)
        spread = float(np.sqrt(((cells - cells.mean(axis=0)) ** 2).sum(axis=2).mean()))
        by_models = np.sort(followed.margins[:, :count].min(axis=1))
        exceptions = count_exceptions(len(self.models) - 1, self.options.confidence)
        distance = float(cuts[-1])
        planned = replace(
            sifted.planned,
            distance=distance,
            push=self._make_push(sifted.planned, distance),
            pose=ends[0].copy(),
            cost=cost,
        )
        return Slide(
            planned=planned, goal=sifted.goal, margin=float(by_models[exceptions]), spread=spread
        )

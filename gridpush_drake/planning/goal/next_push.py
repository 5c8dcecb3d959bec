"""The next push of a sequence: it looks one or two pushes ahead, and allows for a wrong model.

Horizon 1 aims for the goal itself (or, where something is in between, for places along the path).
Horizon 2 asks of several first pushes how near a second push from their predicted end would come.
The first pushes are the best few of horizon 1, and pushes towards waypoints, such as the object
turned first where it lies. The decision is, in this order,

    one push, if that is good enough, or only one is looked ahead;
    the first of two, if they come nearer;
    where neither gains anything, the best of all places with all directions.

A push is made only as far as it keeps the rules, with some leeway, by the model and by nearly all
samples: other models that may be the true one. By each of them its own center of friction must also
stay over the table. Samples are 100 draws from the posterior, and of the best few pushes that one
is made that leaves least to go on their average. Before anything was learned the samples are
objects that are heavier towards one side (`belief.tilt_loads`). Several tilts are tried, for the
most uneven object is not always the worst: a push may turn one object to the one side and another
to the other. The theory is in `docs/theory/planning.md`, section 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
import shapely

from gridpush_drake.dynamics.push import make_path_times
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import (
    Array,
    IntArray,
    rotate,
    transform,
    wrap_angle,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import PRIOR_SIDES, PRIOR_TILTS, tilt_loads
from gridpush_drake.planning.contact.optimization import (
    ContactMethod,
    ContactPlan,
    optimize_contact,
)
from gridpush_drake.planning.contact.trial import ContactOptions, PlannedPush
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.model_rollouts import (
    WEIGHED_DRAWS,
    count_agreed,
    count_kept,
    follow_pushes,
)
from gridpush_drake.planning.push_constraints import CIRCLE_ROOM, PushConstraints

DEFAULT_TOLERANCE = 0.02
"""Mean cell error at which a goal counts as reached, m: the paper's."""

DEFAULT_MAX_PUSHES = 25
"""Number of pushes after which a goal is given up."""

BEAM_WIDTH = 3
"""Number of first pushes towards the goal, the best ones, for which a second is searched for."""

SECOND_STARTS = 5
"""Number of starts of the search for a second push."""

SECOND_BUDGET = 16
"""Greatest number of simulations of the search for a second push."""

MIN_GAIN = 0.001
"""By how much a push must shorten what is left to go to be worth making, m."""

ROUND_OFF = 1e-9
"""By how much a center of friction may be nearer to the table's edge than allowed, m, for
round-off."""


@dataclass(frozen=True)
class RobustnessOptions:
    """How many other models may be the true one, and what must hold by them.

    Attributes:
        samples: number of samples from the posterior that a push is tried with.
        confidence: fraction of the samples that must allow a push; all of them where they are few.
        weighed: number of pushes, the best ones by the model, of which samples from the posterior
            choose.
        tilts: a above: how uneven an object may be of which nothing is known.
        sides: number of directions u for each tilt.
        leeway: by how much more cells may hang over by a sample than by the model, m.
        center_margin: how far inside the table's edge the center of friction must stay, m.
        seed: of the samples.
    """

    samples: int = WEIGHED_DRAWS
    confidence: float = 0.95
    weighed: int = 3
    tilts: tuple[float, ...] = PRIOR_TILTS
    sides: int = PRIOR_SIDES
    leeway: float = 0.03
    center_margin: float = 0.03
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.confidence <= 1:
            raise PlanningError(
                f"confidence is {self.confidence!r}; expected more than 0, and at most 1"
            )
        for name, least in (("samples", 0), ("sides", 0), ("weighed", 1)):
            if getattr(self, name) < least:
                raise PlanningError(
                    f"{name} is {getattr(self, name)!r}; expected a whole number, {least} or more"
                )


def draw_model_samples(
    model: Model,
    identification: Identification | None,
    options: RobustnessOptions,
) -> list[CellParameters]:
    """Makes other models that may be the true one.

    Args:
        model: one object, with its parameters.
        identification: that the model comes from; None where nothing was learned.
        options: how many models to make.
    """
    if identification is not None:
        return identification.draws(options.samples, options.seed)
    return tilt_loads(model, options.tilts, options.sides)


@dataclass(frozen=True, eq=False)
class SafePush:
    """The part of a push that is safe by the models.

    Attributes:
        planned: the part, or the whole push.
        ends: (M, 3) where it leaves the object by each model, X_WB, m and rad.
    """

    planned: PlannedPush
    ends: Array


@dataclass(eq=False)
class Robustness:
    """Cuts pushes to the part that is safe by the models; counts the simulations that this takes.

    Attributes:
        obj: the object.
        models: the model first, then the samples.
        constraints: the rules.
        contact: how pushes are made and simulated.
        options: what must hold.
        learned: whether the samples are draws from a posterior, so that their average tells what a
            push is worth.
        simulations: number of simulations so far.
    """

    obj: GridObject
    models: Sequence[CellParameters]
    constraints: PushConstraints
    contact: ContactOptions
    options: RobustnessOptions
    learned: bool = False
    simulations: int = 0

    def cut(self, pose: Array, planned: PlannedPush) -> SafePush | None:
        """Cuts a push to the part that is safe by the model and nearly all samples.

        Args:
            pose: (3,) where the object lies, X_WB, m and rad.
            planned: the push.

        Returns:
            The part; None if it is too short to be a push.
        """
        bounded = self.constraints.surface is not None or bool(self.constraints.obstacles)
        if not bounded and not self.learned:
            return SafePush(planned=planned, ends=planned.pose[None])
        physics = self.contact.resolve(Model(self.obj, self.models[0])).physics
        (poses,) = follow_pushes(self.obj, self.models, [planned.push], pose, physics)
        self.simulations += len(self.models)
        # The number of steps that the model and nearly all samples allow.
        times = make_path_times(planned.push, physics.regime)
        usable = len(times)
        if bounded:
            usable = self._count_usable(pose, planned.push.tip_at(times), poses)
        distance = self.contact.pusher.speed * times[usable - 1] if usable else 0.0
        if distance < self.contact.distance_range[0]:
            return None
        ends = poses[:, usable - 1]
        if usable == len(times):
            return SafePush(planned=planned, ends=ends)
        push = planned.push.shorten(float(times[usable - 1]))
        part = replace(planned, distance=float(distance), push=push, pose=ends[0].copy())
        return SafePush(planned=part, ends=ends)

    def _count_usable(self, pose: Array, tip: Array, poses: Array) -> int:
        """Counts the steps of a push that the model and nearly all samples allow.

        Args:
            pose: (3,) where the object lies.
            tip: (T+1, 2) places of the finger's center, m.
            poses: (M, T+1, 3) poses of the object by each model.
        """
        rules = replace(
            self.constraints,
            edge_margin=self.constraints.edge_margin - self.options.leeway,
            pose_rule=None,
        )
        reach = self.contact.pusher.choose_reach(self.obj)
        checker = rules.start_at(self.obj, pose, reach)
        counts = np.minimum(
            checker.count_allowed_by_models(tip, poses), self._count_supported(poses)
        )
        return count_agreed(counts, self.options.confidence)

    def _count_supported(self, poses: Array) -> IntArray:
        """Counts the poses (M, K, 3), from the first on, with the center of friction on the table.

        By each model it must be `center_margin` inside the edge. If it is nearer to the edge
        already in the first pose, it must not come nearer still.

        Returns:
            (M,).
        """
        surface = self.constraints.surface
        if surface is None:
            return np.full(len(poses), poses.shape[1])
        centers = np.array([params.relative_friction() @ self.obj.p_BC for params in self.models])
        places = poses[..., :2] + rotate(poses[..., 2], centers[:, None])
        margin = self.options.center_margin
        least = np.minimum(margin, surface.signed_distances(places[:, 0])) - ROUND_OFF
        # Distances are calculated only of places that are not well inside the edge.
        well_inside = surface.polygon.buffer(-CIRCLE_ROOM * margin)
        shapely.prepare(well_inside)
        held = np.asarray(shapely.contains_xy(well_inside, places[..., 0], places[..., 1]))
        m, k = np.nonzero(~held)
        held[m, k] = surface.signed_distances(places[m, k]) >= least[m]
        return count_kept(held)


@dataclass(frozen=True, eq=False)
class GoalRules:
    """How an object is pushed to a goal.

    Attributes:
        constraints: table, obstacles and further rules.
        contact: what pushes may be chosen from.
        horizon: pushes to look ahead, 1 or 2; one by default, for the second says little of a model
            not yet learned. 2 is resorted to in any case where one push gains nothing.
        robustness: how far pushes must be safe though the model may be wrong; None trusts the
            model.
        tolerance: mean cell error at which the goal counts as reached, m.
        max_pushes: number of pushes after which the goal is given up.

    Raises:
        PlanningError: a number is out of range.
    """

    constraints: PushConstraints = field(default_factory=PushConstraints)
    contact: ContactOptions = field(default_factory=ContactOptions)
    horizon: int = 1
    robustness: RobustnessOptions | None = field(default_factory=RobustnessOptions)
    tolerance: float = DEFAULT_TOLERANCE
    max_pushes: int = DEFAULT_MAX_PUSHES

    def __post_init__(self) -> None:
        require_positive(PlanningError, unit="m", tolerance=self.tolerance)
        if self.max_pushes < 0:
            raise PlanningError(f"max_pushes is {self.max_pushes!r}; expected 0 or more")
        if self.horizon not in (1, 2):
            raise PlanningError(f"horizon is {self.horizon!r}; expected 1 or 2")


@dataclass(frozen=True, eq=False)
class NextPush:
    """The decision on the next push.

    Attributes:
        push: the push; None where none gains enough.
        cost: what is left to go after it, m (mean cell error, round obstacles).
        final_cost: what is expected to be left at the end of the horizon, m.
        horizon: 1 or 2, that of the search which the push comes from.
        simulations: number of simulations that the decision took.
    """

    push: PlannedPush | None
    cost: float
    final_cost: float
    horizon: int
    simulations: int


def choose_push(
    model: Model,
    pose: Array,
    cost_to_go: CostToGo,
    rules: GoalRules,
    robustness: Robustness | None = None,
) -> NextPush:
    """Decides on the next push of an object.

    Args:
        model: one object, with its parameters.
        pose: (3,) where it lies, X_WB, m and rad.
        cost_to_go: to the goal.
        rules: how it is pushed.
        robustness: cuts pushes short; None makes them as planned.
    """
    search = _PushSearch(
        model=model,
        pose=pose,
        cost_to_go=cost_to_go,
        rules=rules,
        robustness=robustness,
    )
    first = search.find_first("gradient")
    good_enough = bool(first) and first[0].cost <= rules.tolerance
    if good_enough or rules.horizon < 2:
        chosen = search.decide(first, [])
        if chosen.push is not None:
            return chosen
    chosen = search.decide(first, search.find_second(first))
    if chosen.push is not None:
        return chosen
    return search.decide(search.find_first("exhaustive"), [])


@dataclass(frozen=True, eq=False)
class _Option:
    """A push that may be made next.

    Attributes:
        push: the push.
        cost: what is left to go after it, m.
        final_cost: what is left after the best second push, m; the same as `cost` where none was
            searched for.
        expected: what is left to go on the average of the draws, m; None where none were asked.
    """

    push: PlannedPush
    cost: float
    final_cost: float
    expected: float | None = None

    def rank(self) -> tuple[float, float]:
        """What options are compared by: the average of the draws, then the model."""
        return self.cost if self.expected is None else self.expected, self.cost


@dataclass(eq=False)
class _PushSearch:
    """The searches of one decision, with the number of simulations that they took.

    Attributes:
        model: the object with its parameters.
        pose: (3,) where it lies.
        cost_to_go: to the goal.
        rules: how it is pushed.
        robustness: cuts pushes short; None for not.
        simulations: number of simulations so far.
    """

    model: Model
    pose: Array
    cost_to_go: CostToGo
    rules: GoalRules
    robustness: Robustness | None
    simulations: int = 0

    def __post_init__(self) -> None:
        self.cost_now = self.cost_to_go.calc_cost(self.pose)
        self.subgoals = self.cost_to_go.find_subgoals(self.pose)

    def find_first(self, method: ContactMethod) -> list[_Option]:
        """Finds pushes towards the goal, or towards what leads to it, best first."""
        found = []
        for subgoal in self.subgoals:
            plan = self._search(self.pose, subgoal, self.rules.contact, method)
            found += self._take(plan.candidates, BEAM_WIDTH if self.rules.horizon > 1 else 1)
        return sorted(found, key=_Option.rank)

    def find_second(self, first: list[_Option]) -> list[_Option]:
        """Finds what is left to go after a second push.

        First pushes are the best of `first`, and others towards waypoints.
        """
        beam = first[:BEAM_WIDTH]
        waypoints = []
        if self.subgoals:
            waypoints = make_waypoints(self.model.obj, self.pose, self.subgoals[0])
        for waypoint in waypoints:
            plan = self._search(self.pose, waypoint, self.rules.contact)
            beam += self._take(plan.candidates, 1)
        later = replace(self.rules.contact, starts=SECOND_STARTS, budget=SECOND_BUDGET)
        found = []
        for option in beam:
            final_cost = option.cost
            for subgoal in self.cost_to_go.find_subgoals(option.push.pose)[:1]:
                plan = self._search(option.push.pose, subgoal, later)
                if plan.push is not None:
                    final_cost = min(final_cost, self.cost_to_go.calc_cost(plan.push.pose))
            found.append(replace(option, final_cost=final_cost))
        return found

    def _make_option(self, push: PlannedPush) -> _Option:
        """Calculates what a push leaves to go."""
        cost = self.cost_to_go.calc_cost(push.pose)
        return _Option(push=push, cost=cost, final_cost=cost)

    def _take(self, candidates: Sequence[PlannedPush], count: int) -> list[_Option]:
        """Takes the best few candidates that are allowed, as far as they are safe, best first."""
        if self.robustness is None:
            allowed = (push for push in candidates if self.rules.constraints.allows_push(push.push))
            return [self._make_option(push) for push in islice(allowed, count)]
        robustness = self.robustness
        before = robustness.simulations
        options = [self._make_option(push) for push in candidates]
        options.sort(key=lambda option: option.cost)
        wanted = max(count, robustness.options.weighed) if robustness.learned else count
        taken: list[_Option] = []
        for option in options:
            # Cut short, a push leaves more to go: once enough are better, the others need no cut.
            if len(taken) >= wanted and option.cost >= taken[wanted - 1].cost:
                break
            safe = robustness.cut(self.pose, option.push)
            if safe is not None and self.rules.constraints.allows_push(safe.planned.push):
                expected = None
                if robustness.learned:
                    expected = self._calc_expected_cost(safe.ends)
                taken.append(replace(self._make_option(safe.planned), expected=expected))
                taken.sort(key=lambda option: option.cost)
        self.simulations += robustness.simulations - before
        taken = taken[:wanted]
        # Of the best by the model, those that leave least to go on the average of the draws.
        if robustness.learned:
            taken.sort(key=_Option.rank)
        return taken[:count]

    def _calc_expected_cost(self, ends: Array) -> float:
        """What is left to go on the average of poses (M, 3), m.

        A pose from which no path is known counts as one at which nothing was gained.
        """
        costs = self.cost_to_go.estimate_costs(ends)
        return float(np.where(np.isfinite(costs), costs, self.cost_now).mean())

    def decide(self, first: list[_Option], second: list[_Option]) -> NextPush:
        """Decides for the better of the horizons, where it gains enough.

        Args:
            first: pushes of horizon 1, best first.
            second: pushes of horizon 2, in any order.
        """
        worth = self.cost_now - MIN_GAIN
        chosen = NextPush(
            push=None,
            cost=self.cost_now,
            final_cost=self.cost_now,
            horizon=1,
            simulations=self.simulations,
        )
        if first and first[0].cost < worth:
            best = first[0]
            chosen = replace(chosen, push=best.push, cost=best.cost, final_cost=best.cost)
        if second:
            best = min(second, key=lambda option: (option.final_cost, option.cost))
            if best.final_cost < min(worth, chosen.final_cost):
                chosen = replace(
                    chosen,
                    push=best.push,
                    cost=best.cost,
                    final_cost=best.final_cost,
                    horizon=2,
                )
        return chosen

    def _search(
        self, pose: Array, goal: Array, options: ContactOptions, method: ContactMethod = "gradient"
    ) -> ContactPlan:
        """Searches for pushes from a pose (3,) to a goal (3,), and counts the simulations."""
        plan = optimize_contact(
            self.model,
            pose,
            goal,
            method=method,
            constraints=self.rules.constraints,
            options=options,
        )
        self.simulations += plan.simulations
        return plan


def make_waypoints(obj: GridObject, pose: Array, goal: Array) -> list[Array]:
    """Makes poses (3,) to which the first of two pushes may bring the object.

    They are the object where it lies, turned as at the goal, or half as far.
    """
    centroid = obj.p_BC.mean(axis=0)
    here = transform(pose, centroid[None])[0]
    thetas = pose[2] + np.array([1.0, 0.5]) * wrap_angle(goal[2] - pose[2])
    return [np.append(here - rotate(theta, centroid), theta) for theta in thetas]

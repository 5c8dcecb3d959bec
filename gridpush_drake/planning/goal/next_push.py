"""The next push of a sequence: searches over one and two pushes, compared, and cut short where the model may be wrong.

Horizon 1 aims for the goal itself (or, where something is in between, for places along the path).
Horizon 2 asks, of the best few of these pushes and of pushes towards waypoints, such as the object
turned first where it lies, how near a second push from their predicted end would come. One push
that is good enough is taken; else the first of two that are; else the first of the two that come
nearest. Where nothing gains, every place is tried with every direction.

A push is made only as far as it keeps the rules, with some leeway, not just by the model but by
every sample: other models that may be the true one. By each of them its own center of friction must
also stay over the table. Samples are drawn from the posterior; before anything was learned they are
objects heavier towards one side,

    k_i ~ exp(a u · (p_i - c) / r),   u all around,   r the farthest cell's distance from the cells'
    centroid c,

little (a small) and much: where a push turns an object to either side, the worst is often in
between.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, make_direction, rotate, transform, wrap_angle
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import (
    ContactMethod,
    ContactPlan,
    optimize_contact,
)
from gridpush_drake.planning.contact.trial import ContactOptions, PlannedPush
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.push_constraints import PushConstraints


@dataclass(frozen=True)
class RobustnessOptions:
    """How many other models may be the true one, and what must hold by all of them.

    Attributes:
        samples: from the posterior that a push is tried with.
        tilts: a above: how uneven an object may be of which nothing is known.
        sides: directions u of each.
        leeway: m by which cells may hang over further by a sample than by the model.
        center_margin: m by which the center of friction must stay over the table.
        seed: of the draws.
    """

    samples: int = 6
    tilts: tuple[float, ...] = (1.0, 2.0)
    sides: int = 4
    leeway: float = 0.03
    center_margin: float = 0.03
    seed: int = 0


def draw_model_samples(
    obj: GridObject,
    params: CellParameters,
    identification: Identification | None,
    options: RobustnessOptions,
) -> list[CellParameters]:
    """Other models that may be the true one; `identification` is None where nothing was learned."""
    if identification is not None:
        return identification.samples(options.samples, options.seed)
    arm = obj.p_BC - obj.p_BC.mean(axis=0)
    farthest = max(float(np.linalg.norm(arm, axis=1).max()), obj.cell_size)
    # along the object's longest axis first, where unevenness matters most
    axis = np.linalg.eigh(arm.T @ arm)[1][:, -1]
    turns = np.arctan2(axis[1], axis[0]) + 2 * np.pi * np.arange(options.sides) / options.sides
    slopes = make_direction(turns) @ arm.T / farthest
    return [
        replace(params, mass=params.mass * np.exp(tilt * slope))
        for tilt in options.tilts
        for slope in slopes
    ]


@dataclass(eq=False)
class Robustness:
    """Cuts pushes short; counts the simulations it takes.

    Attributes:
        obj: the object.
        models: the model first, then the samples.
        constraints: the rules.
        contact: what pushes are made like.
        options: what must hold.
        simulations: run so far.
    """

    obj: GridObject
    models: Sequence[CellParameters]
    constraints: PushConstraints
    contact: ContactOptions
    options: RobustnessOptions
    simulations: int = 0

    def cut(self, pose: Array, planned: PlannedPush) -> PlannedPush | None:
        """The part of a push from `pose` that is safe by all models; None where that is nothing."""
        if self.constraints.surface is None and not self.constraints.obstacles:
            return planned
        physics = self.contact.resolve_physics(self.obj, self.models[0])
        times = make_path_times(planned.push, physics.regime)
        rules = replace(
            self.constraints,
            edge_margin=self.constraints.edge_margin - self.options.leeway,
            pose_rule=None,
        )
        checker = rules.start_at(self.obj, pose, self.contact.radius)
        usable, nominal = len(times), None
        for params in self.models:
            motion = simulate(self.obj, params, planned.push, pose, times=times, physics=physics)
            self.simulations += 1
            nominal = motion.poses if nominal is None else nominal
            usable = min(
                usable,
                checker.count_allowed(motion.tip, motion.poses),
                self._count_supported(params, motion.poses),
            )
        distance = self.contact.speed * times[usable - 1] if usable else 0.0
        if nominal is None or distance < self.contact.distance_range[0]:
            return None
        if usable == len(times):
            return planned
        whole = planned.push
        push = Push(
            whole.start,
            whole.velocity,
            float(times[usable - 1]),
            whole.radius,
            start_tangent=whole.start_tangent,
        )
        return replace(
            planned, distance=float(distance), push=push, pose=nominal[usable - 1].copy()
        )

    def _count_supported(self, params: CellParameters, poses: Array) -> int:
        """How many of the poses, from the first on, keep the model's center of friction over the table."""
        surface = self.constraints.surface
        if surface is None:
            return len(poses)
        center = (params.relative_friction() @ self.obj.p_BC)[None]
        room = surface.signed_distances(transform(poses, center)[:, 0])
        held = room >= min(self.options.center_margin, float(room[0])) - 1e-9
        return len(poses) if held.all() else int(np.argmin(held))


DEFAULT_TOLERANCE = 0.02  # mean cell error at which a goal counts as reached, m: the paper's

DEFAULT_MAX_PUSHES = 25

BEAM = 3  # first pushes towards the goal that a second is searched for
SECOND_STARTS, SECOND_BUDGET = 5, 16  # starts of the second push's search, and its most simulations
MIN_GAIN = 0.001  # m by which a push must shorten what is left to go to be worth making


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
        max_pushes: most pushes.

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
    """A decision."""

    push: PlannedPush | None  # the push; None where none gains enough
    cost: float  # what is left to go after it, m (mean cell error, round obstacles)
    final_cost: float  # what is expected to be left at the end of the horizon, m
    horizon: int  # 1 or 2, that of the search the push comes from
    simulations: int  # that the decision took


def choose_push(
    obj: GridObject,
    params: CellParameters,
    pose: Array,
    cost_to_go: CostToGo,
    rules: GoalRules,
    robustness: Robustness | None = None,
) -> NextPush:
    """Decides on the next push of an object at `pose` (3,), m and rad.

    One that comes as near as the tolerance is good enough. `robustness` cuts pushes short; None
    makes them as planned.
    """
    search = _PushSearch(obj, params, pose, cost_to_go, rules, robustness)
    first = search.find_first("gradient")
    if (first and first[0][0] <= rules.tolerance) or rules.horizon < 2:
        chosen = search.decide(first, [])
        if chosen.push is not None:
            return chosen
    chosen = search.decide(first, search.find_second(first))
    if chosen.push is not None:
        return chosen
    return search.decide(search.find_first("exhaustive"), [])


@dataclass(eq=False)
class _PushSearch:
    """The searches of one decision, counted."""

    obj: GridObject
    params: CellParameters
    pose: Array
    cost_to_go: CostToGo
    rules: GoalRules
    robustness: Robustness | None
    simulations: int = 0

    def __post_init__(self) -> None:
        self.now = self.cost_to_go.calc_cost(self.pose)
        self.subgoals = self.cost_to_go.find_subgoals(self.pose)

    def find_first(self, method: ContactMethod) -> list[tuple[float, PlannedPush]]:
        """Pushes towards the goal or what leads to it, each after the cost that it leaves, least first."""
        found = []
        for subgoal in self.subgoals:
            plan = self._search(self.pose, subgoal, self.rules.contact, method)
            found += self._take(plan.candidates, BEAM if self.rules.horizon > 1 else 1)
        return sorted(found, key=lambda pair: pair[0])

    def find_second(
        self, first: list[tuple[float, PlannedPush]]
    ) -> list[tuple[float, float, PlannedPush]]:
        """First pushes, each after the costs that a second push leaves, and that it leaves itself."""
        beam = first[:BEAM]
        for waypoint in (
            make_waypoints(self.obj, self.pose, self.subgoals[0]) if self.subgoals else []
        ):
            plan = self._search(self.pose, waypoint, self.rules.contact)
            beam += self._take(plan.candidates, 1)
        later = replace(self.rules.contact, starts=SECOND_STARTS, budget=SECOND_BUDGET)
        found = []
        for cost, push in beam:
            final = cost
            for subgoal in self.cost_to_go.find_subgoals(push.pose)[:1]:
                plan = self._search(push.pose, subgoal, later)
                if plan.push is not None:
                    final = min(final, self.cost_to_go.calc_cost(plan.push.pose))
            found.append((final, cost, push))
        return found

    def _take(
        self, candidates: Sequence[PlannedPush], count: int
    ) -> list[tuple[float, PlannedPush]]:
        """The best few candidates that are allowed, as far as they are safe, each after the cost that it leaves."""
        if self.robustness is None:
            allowed = (push for push in candidates if self.rules.constraints.allows_push(push.push))
            return [(self.cost_to_go.calc_cost(push.pose), push) for push in islice(allowed, count)]
        before = self.robustness.simulations
        taken: list[tuple[float, PlannedPush]] = []
        for cost, push in sorted(
            ((self.cost_to_go.calc_cost(push.pose), push) for push in candidates),
            key=lambda pair: pair[0],
        ):
            # cut short, a push leaves more to go
            if len(taken) >= count and cost >= taken[count - 1][0]:
                break
            safe = self.robustness.cut(self.pose, push)
            if safe is not None and self.rules.constraints.allows_push(safe.push):
                taken = sorted(
                    [*taken, (self.cost_to_go.calc_cost(safe.pose), safe)], key=lambda pair: pair[0]
                )
        self.simulations += self.robustness.simulations - before
        return taken[:count]

    def decide(
        self, first: list[tuple[float, PlannedPush]], second: list[tuple[float, float, PlannedPush]]
    ) -> NextPush:
        """The better of the horizons, where it gains enough."""
        worth = self.now - MIN_GAIN
        chosen = NextPush(None, self.now, self.now, 1, self.simulations)
        if first and first[0][0] < worth:
            chosen = NextPush(first[0][1], first[0][0], first[0][0], 1, self.simulations)
        if second:
            final, cost, push = min(second, key=lambda entry: entry[:2])
            if final < min(worth, chosen.final_cost):
                chosen = NextPush(push, cost, final, 2, self.simulations)
        return chosen

    def _search(
        self, pose: Array, goal: Array, options: ContactOptions, method: ContactMethod = "gradient"
    ) -> ContactPlan:
        plan = optimize_contact(
            self.obj,
            self.params,
            pose,
            goal,
            method=method,
            constraints=self.rules.constraints,
            options=options,
        )
        self.simulations += plan.simulations
        return plan


def make_waypoints(obj: GridObject, pose: Array, goal: Array) -> list[Array]:
    """Poses in between that one push may have to make for first: turned as the goal, or half so, where it lies."""
    centroid = obj.p_BC.mean(axis=0)
    here = transform(pose, centroid[None])[0]
    thetas = pose[2] + np.array([1.0, 0.5]) * wrap_angle(goal[2] - pose[2])
    return [np.append(here - rotate(theta, centroid), theta) for theta in thetas]

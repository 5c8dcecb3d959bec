"""The next push of a sequence: searches over one and two pushes, compared.

Horizon 1 aims for the goal itself (or, where something is in between, for places along the way). Horizon 2 asks, of the
best few of these pushes and of pushes towards waypoints, such as the object turned first where it lies, how near a
second push from their predicted end would come. One push that is good enough is taken; else the first of two that are;
else the first of the two that come nearest. Where nothing gains, every place is tried with every direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import (
    ContactMethod,
    ContactOptions,
    ContactPlan,
    optimize_contact,
    with_search,
)
from gridpush_drake.planning.contact.trial import PlannedPush
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.goal.robustness import Robustness
from gridpush_drake.planning.push_constraints import PushConstraints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HorizonOptions:
    """How far ahead to look.

    Attributes:
        horizon: 1 or 2 pushes; 2 is resorted to in any case where one push gains nothing.
        beam: first pushes towards the goal that a second is searched for.
        second_starts: starts of the second push's search.
        second_budget: its most simulations.
        min_gain: m by which a push must shorten the way to be worth making.
    """

    horizon: int = 2
    beam: int = 3
    second_starts: int = 5
    second_budget: int = 16
    min_gain: float = 0.001


@dataclass(frozen=True, eq=False)
class NextPush:
    """A decision.

    Attributes:
        push: the push; None where none shortens the way.
        way: what is left to go after it, m (mean cell error, round obstacles).
        final_way: what is expected to be left at the end of the horizon, m.
        horizon: 1 or 2, that of the search the push comes from.
        simulations: that the decision took.
    """

    push: PlannedPush | None
    way: float
    final_way: float
    horizon: int
    simulations: int


def choose_push(
    obj: GridObject,
    params: CellParameters,
    pose: Array,
    way: CostToGo,
    good_enough: float,
    constraints: PushConstraints,
    options: ContactOptions,
    horizons: HorizonOptions,
    caution: Robustness | None = None,
) -> NextPush:
    """Chooses the next push.

    Args:
        obj: the object.
        params: its model.
        pose: (3,) q_W where it lies.
        way: to the goal.
        good_enough: mean cell error at which the goal counts as reached, m.
        constraints: the rules.
        options: what pushes may be chosen from.
        horizons: how far ahead to look.
        caution: cuts first pushes to what is safe though the model may be wrong; None trusts the model.

    Returns:
        The decision.
    """
    search = _PushSearch(obj, params, pose, way, constraints, options, horizons, caution)
    first = search.find_first("gradient")
    if (first and first[0][0] <= good_enough) or horizons.horizon < 2:
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
    way: CostToGo
    constraints: PushConstraints
    options: ContactOptions
    horizons: HorizonOptions
    caution: Robustness | None
    simulations: int = 0

    def __post_init__(self) -> None:
        self.now = self.way.calc_cost(self.pose)
        self.subgoals = self.way.find_subgoals(self.pose)

    def find_first(self, method: ContactMethod) -> list[tuple[float, PlannedPush]]:
        """Pushes towards the goal or what leads to it, each after the way that it leaves, shortest first."""
        found = []
        for subgoal in self.subgoals:
            plan = self._search(self.pose, subgoal, self.options, method)
            found += self._take(plan.candidates, self.horizons.beam if self.horizons.horizon > 1 else 1)
        return sorted(found, key=lambda pair: pair[0])

    def find_second(self, first: list[tuple[float, PlannedPush]]) -> list[tuple[float, float, PlannedPush]]:
        """First pushes, each after the ways that a second push leaves, and that it leaves itself."""
        beam = first[: self.horizons.beam]
        for waypoint in make_waypoints(self.obj, self.pose, self.subgoals[0]) if self.subgoals else []:
            plan = self._search(self.pose, waypoint, self.options)
            beam += self._take(plan.candidates, 1)
        later = with_search(self.options, starts=self.horizons.second_starts, budget=self.horizons.second_budget)
        found = []
        for cost, push in beam:
            final = cost
            for subgoal in self.way.find_subgoals(push.pose)[:1]:
                plan = self._search(push.pose, subgoal, later)
                if plan.push is not None:
                    final = min(final, self.way.calc_cost(plan.push.pose))
            found.append((final, cost, push))
        return found

    def _take(self, candidates: Sequence[PlannedPush], count: int) -> list[tuple[float, PlannedPush]]:
        """The best few candidates that are allowed, as far as they are safe, each after the way that it leaves."""
        if self.caution is None:
            allowed = (push for push in candidates if self.constraints.allows_push(push.push))
            return [(self.way.calc_cost(push.pose), push) for push in islice(allowed, count)]
        before = self.caution.simulations
        taken: list[tuple[float, PlannedPush]] = []
        for way, push in sorted(
            ((self.way.calc_cost(push.pose), push) for push in candidates), key=lambda pair: pair[0]
        ):
            # cut short, a push leaves more of the way
            if len(taken) >= count and way >= taken[count - 1][0]:
                break
            safe = self.caution.cut(self.pose, push)
            if safe is not None and self.constraints.allows_push(safe.push):
                taken = sorted([*taken, (self.way.calc_cost(safe.pose), safe)], key=lambda pair: pair[0])
        self.simulations += self.caution.simulations - before
        return taken[:count]

    def decide(
        self, first: list[tuple[float, PlannedPush]], second: list[tuple[float, float, PlannedPush]]
    ) -> NextPush:
        """The better of the horizons, where it gains enough."""
        worth = self.now - self.horizons.min_gain
        chosen = NextPush(None, self.now, self.now, 1, self.simulations)
        if first and first[0][0] < worth:
            chosen = NextPush(first[0][1], first[0][0], first[0][0], 1, self.simulations)
        if second:
            final, cost, push = min(second, key=lambda entry: entry[:2])
            if final < min(worth, chosen.final_way):
                chosen = NextPush(push, cost, final, 2, self.simulations)
        return chosen

    def _search(
        self, pose: Array, goal: Array, options: ContactOptions, method: ContactMethod = "gradient"
    ) -> ContactPlan:
        plan = optimize_contact(
            self.obj, self.params, pose, goal, method=method, constraints=self.constraints, options=options
        )
        self.simulations += plan.simulations
        return plan


def make_waypoints(obj: GridObject, pose: Array, goal: Array) -> list[Array]:
    """Poses on the way that one push may have to make for first: turned as the goal, or half so, where it lies."""
    turn = (goal[2] - pose[2] + np.pi) % (2 * np.pi) - np.pi
    centroid = obj.p_BC.mean(axis=0)
    here = obj.cells_at(pose).mean(axis=0)
    waypoints = []
    for share in (1.0, 0.5):
        theta = pose[2] + share * turn
        c, s = np.cos(theta), np.sin(theta)
        x, y = centroid
        waypoints.append(np.array([here[0] - c * x + s * y, here[1] - s * x - c * y, theta]))
    return waypoints

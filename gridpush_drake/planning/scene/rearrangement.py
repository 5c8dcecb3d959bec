"""`RearrangePlanner`: several objects are pushed to goal poses, in an order that it chooses.

With the distance

    d = sqrt(|p - p_goal|² + rho² (theta - theta_goal)²)

of an object's cells' centroid and heading from the goal (rho is its radius of gyration), what is
left for it is estimated at

    V = b [not reached] + a d + c sqrt(d)       seconds

and the next push is the one after which the sum over all objects is least (`search`). An object at
its goal that is pushed off costs again, so that contact with others is weighed, and not forbidden.

A sum of distances does not see what is in between. So not every object goes at once:

    goes     its goal is free of others
    waits    another object lies in its goal; it weighs little until that has gone
    aside    where all wait for each other, one of them is moved to a free place nearby first; and
             where nothing got better for several pushes, what lies on the way is

The theory is in `docs/theory/planning.md`, section 6.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.affinity import translate

from gridpush_drake.dynamics.bodies import describe_object
from gridpush_drake.dynamics.scene.cores import OVERLAP_TOLERANCE
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import (
    Array,
    make_direction,
    transform,
    transform_shape,
    wrap_angle,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.scene.loop import (
    SceneAction,
    SceneDecision,
    SceneStep,
    describe_no_room,
)
from gridpush_drake.planning.scene.rules import (
    POST_MARGIN,
    UNCONSTRAINED,
    SceneRules,
    place_outlines,
)
from gridpush_drake.planning.scene.search import SceneSearch, SceneSearchOptions
from gridpush_drake.units import MM_PER_M

GOAL_GAP = 0.002
"""An object that is nearer than this to another one's goal lies in it, m."""

BUFFER_CLEARANCE = 0.03
"""Distance from everything else at which an object that is put aside should lie, m."""

BUFFER_STEP = 0.03
"""Distance between rings on which a place aside is looked for, m."""

BUFFER_RINGS = 16
"""Number of these rings."""

BUFFER_PLACES = 16
"""Number of places on each of them."""

BUFFER_TOLERANCE = 0.015
"""Distance at which an object counts as put aside, m."""

MAX_STALL_PUSHES = 4
"""Pushes after the best state so far from which on what lies on the way is moved aside, for as many
pushes."""


@dataclass(frozen=True)
class RearrangeOptions:
    """When a goal is reached, and what is left is worth.

    Attributes:
        position_tolerance: distance of the cells' centroid from where it should be within which a
            goal is reached, m.
        angle_tolerance: turn from the goal within which it is reached, rad.
        goal_fraction: fraction of the tolerances within which a push is planned to end.
        base: what an object that is not at its goal costs in any case, s.
        per_length: what a meter to go costs, s/m.
        per_root: what the square root of a meter to go costs, s.
        blocked: how much an object that waits weighs, against 1.
        longest: how much farther than the farthest object has to go a push may be, as a factor.
        search: how pushes are searched for.

    Raises:
        PlanningError: a number is not positive.
    """

    position_tolerance: float = 0.02
    angle_tolerance: float = 0.2
    goal_fraction: float = 0.7
    base: float = 5.0
    per_length: float = 100.0
    per_root: float = 20.0
    blocked: float = 0.1
    longest: float = 1.5
    search: SceneSearchOptions = field(default_factory=SceneSearchOptions)

    def __post_init__(self) -> None:
        require_positive(
            PlanningError,
            position_tolerance=self.position_tolerance,
            angle_tolerance=self.angle_tolerance,
            goal_fraction=self.goal_fraction,
            base=self.base,
            per_length=self.per_length,
            per_root=self.per_root,
            longest=self.longest,
        )


FINE_OPTIONS = RearrangeOptions(position_tolerance=0.005, angle_tolerance=float(np.radians(3.0)))
"""Goals within 5 mm and 3 degrees."""


@dataclass(frozen=True, eq=False)
class Targets:
    """Where each object should go now.

    Attributes:
        poses: (N, 3) target poses; NaN where an object may lie anywhere.
        weights: (N,) how much what is left for each object weighs.
        is_buffered: (N,) whether it is put aside: its heading does not matter, and it goes first.
    """

    poses: Array
    weights: Array
    is_buffered: NDArray[np.bool_]


class RearrangePlanner:
    """Pushes objects to goal poses.

    Attributes:
        objects: the N objects.
        goals: (N, 3) goal poses, m and rad; NaN for an object that may lie anywhere.
        options: when a goal is reached.
        rules: what no push may do.
    """

    def __init__(
        self,
        objects: Sequence[GridObject],
        goals: ArrayLike,
        options: RearrangeOptions | None = None,
        rules: SceneRules = UNCONSTRAINED,
        *,
        seed: int = 0,
    ) -> None:
        """Checks the goals.

        Args:
            objects: the objects.
            goals: (N, 3) goal poses, m and rad; NaN for an object that may lie anywhere.
            options: when a goal is reached, and how pushes are searched for.
            rules: what no push may do.
            seed: seed of the pushes that are drawn.

        Raises:
            PlanningError: the goals are not N poses, two of them overlap, or one is not on the
                table.
        """
        self.objects = tuple(objects)
        self.goals = np.array(goals, dtype=np.float64)
        self.options = options or RearrangeOptions()
        self.rules = rules
        self._seed = seed
        self._centroids = [obj.p_BC.mean(axis=0) for obj in self.objects]
        self._arms = [float(obj.radius_of_gyration) for obj in self.objects]
        if self.goals.shape != (len(self.objects), 3):
            raise PlanningError(
                f"goals of shape {self.goals.shape}; expected ({len(self.objects)}, 3), one for "
                "each object"
            )
        self._has_goal: NDArray[np.bool_] = np.asarray(np.isfinite(self.goals).all(axis=1))
        if not (self._has_goal | np.isnan(self.goals).all(axis=1)).all():
            raise PlanningError("goals: expected three finite numbers each, or NaN for no goal")
        check_goals(self.objects, self.goals, rules)

    def calc_errors(self, poses: Array) -> tuple[Array, Array]:
        """Calculates how far the objects are from their goals.

        Args:
            poses: (..., N, 3) where they lie, m and rad.

        Returns:
            Distances (..., N) of the cells' centroids, m, and turns (..., N), rad; 0 without a
            goal.
        """
        distance, turn = self._calc_differences(poses, self.goals)
        return np.where(self._has_goal, distance, 0.0), np.where(self._has_goal, turn, 0.0)

    def find_reached(self, poses: Array) -> NDArray[np.bool_]:
        """Says which objects are at their goals, (N,); those without one are."""
        distance, turn = self.calc_errors(poses)
        options = self.options
        near = (distance < options.position_tolerance) & (turn < options.angle_tolerance)
        return np.asarray(near)

    def decide(self, poses: Array, belief: Belief, steps: Sequence[SceneStep]) -> SceneDecision:
        """Decides what to do next; see `ScenePlanner`."""
        reached = self.find_reached(poses)
        if reached.all():
            return SceneDecision(SceneAction.DONE, "every object lies at its goal")
        # The search, towards what each object should do now.
        targets = self.choose_targets(poses, steps)
        bodies = self._list_moving(poses, targets)
        search = SceneSearch(belief, self.rules, self.options.search)
        rng = np.random.default_rng((self._seed, len(steps)))
        longest = self.options.longest * self._calc_farthest(poses, targets, bodies)
        found = search.find_push(
            poses,
            lambda some: self.calc_cost(some, targets),
            bodies,
            rng,
            detours=[lambda some: self.calc_cost(some, targets, TURN_FIRST)],
            longest=longest + REACH_ON,
        )
        if found is None:
            # around those that should move the finger fits nowhere: any push is better than none
            found = search.find_push(
                poses, lambda some: self.calc_cost(some, targets), range(len(poses)), rng
            )
        if found is None:
            reason = describe_no_room(self.objects, bodies, search.options.pusher)
            return SceneDecision(SceneAction.FAIL, reason)
        left = len(poses) - int(reached.sum())
        name = describe_object(self.objects, found.body)
        active = "aside" if targets.is_buffered[found.body] else "towards its goal"
        return SceneDecision(
            SceneAction.PUSH,
            f"{name} {active}, {left} of {len(poses)} not at their goals yet",
            push=found.push,
            body=found.body,
            expected=found.poses,
        )

    def calc_cost(self, poses: Array, targets: Targets, along: float = 1.0) -> Array:
        """Calculates V, what is left to go.

        Args:
            poses: (K, N, 3) states.
            targets: where each object should go.
            along: weight of distances against turns, 1 for what is really left.

        Returns:
            (K,) s.
        """
        options = self.options
        distance, turn = self._calc_differences(poses, targets.poses)
        turn = np.where(targets.is_buffered, 0.0, turn)
        d = np.hypot(along * distance, np.array(self._arms) * turn)
        # where it should end, with a little to spare
        position = np.where(
            targets.is_buffered,
            BUFFER_TOLERANCE,
            options.goal_fraction * options.position_tolerance,
        )
        missed = (distance > position) | (turn > options.goal_fraction * options.angle_tolerance)
        left = options.base * missed + options.per_length * d + options.per_root * np.sqrt(d)
        wanted = np.isfinite(targets.poses[:, 0])
        return np.asarray((np.where(wanted, left, 0.0) * targets.weights).sum(axis=-1))

    def choose_targets(self, poses: Array, steps: Sequence[SceneStep]) -> Targets:
        """Chooses where each object should go now: to its goal, aside, or nowhere yet."""
        n = len(poses)
        weights = np.ones(n)
        is_buffered = np.zeros(n, dtype=bool)
        to = self.goals.copy()
        outlines = place_outlines(self.objects, poses)
        blocked = self._find_blocked(poses, outlines)
        active = ~self.find_reached(poses) & ~blocked
        weights[blocked] = self.options.blocked

        # Who lies in the way of others, and has nowhere to go itself?
        in_the_way: list[int] = []
        if blocked.any() and not active.any():
            in_the_way = self._pick_from_circle(blocked, outlines)
        elif self._is_stuck(poses, steps):
            in_the_way = self._find_on_the_way(poses, active, outlines)
        for body in in_the_way:
            place = self._find_buffer_place(body, poses, outlines)
            if place is not None:
                to[body] = place
                is_buffered[body] = True
                weights[body] = 1.0
        return Targets(to, weights, is_buffered)

    def _calc_differences(self, poses: Array, to: Array) -> tuple[Array, Array]:
        """Distances and turns (..., N) of poses (..., N, 3) from others (N, 3), m and rad."""
        distances = []
        for b, p_BC in enumerate(self._centroids):
            now = transform(poses[..., b, :], p_BC[None])[..., 0, :]
            wanted = transform(to[b], p_BC[None])[0]
            distances.append(np.linalg.norm(now - wanted, axis=-1))
        turn = np.abs(wrap_angle(poses[..., 2] - to[:, 2]))
        return np.stack(distances, axis=-1), np.asarray(turn)

    def _find_blocked(self, poses: Array, outlines: NDArray[np.object_]) -> NDArray[np.bool_]:
        """Finds the objects in whose goals others lie that are not at their own goals."""
        reached = self.find_reached(poses)
        blocked = np.zeros(len(poses), dtype=bool)
        for i in np.flatnonzero(~reached):
            blocked[i] = any(
                not (reached[j] and self._has_goal[j]) for j in self._find_in_goal(int(i), outlines)
            )
        return blocked

    def _find_in_goal(self, body: int, outlines: NDArray[np.object_]) -> list[int]:
        """Lists the objects that lie in another one's goal."""
        goal = transform_shape(self.goals[body], self.objects[body].outline)
        near: NDArray[np.bool_] = np.asarray(shapely.distance(outlines, goal) < GOAL_GAP)
        near[body] = False
        return [int(j) for j in np.flatnonzero(near)]

    def _pick_from_circle(
        self, blocked: NDArray[np.bool_], outlines: NDArray[np.object_]
    ) -> list[int]:
        """Picks which object goes aside, where all that have a goal wait for each other."""
        blockers = [self._find_in_goal(int(i), outlines) for i in np.flatnonzero(blocked)]
        # One without a goal of its own, or else the one that most others wait for.
        named = [j for each in blockers for j in each]
        free = [j for j in named if not self._has_goal[j]]
        if free:
            return sorted(set(free))
        return [max(sorted(set(named)), key=named.count)]

    def _is_stuck(self, poses: Array, steps: Sequence[SceneStep]) -> bool:
        """Says whether nothing got better for `MAX_STALL_PUSHES` pushes; for as many after that."""
        if not steps:
            return False
        # what was left in each state that was seen, as if every object went to its goal
        every = Targets(self.goals, np.ones(len(poses)), np.zeros(len(poses), dtype=bool))
        states = np.array([*(step.poses for step in steps), poses])
        since = len(states) - 1 - int(np.argmin(self.calc_cost(states, every)))
        return since >= MAX_STALL_PUSHES and (since // MAX_STALL_PUSHES) % 2 == 1

    def _find_on_the_way(
        self, poses: Array, active: NDArray[np.bool_], outlines: NDArray[np.object_]
    ) -> list[int]:
        """Finds what lies between an object and its goal: that of the object with least to go."""
        distance, _ = self.calc_errors(poses)
        for i in sorted(np.flatnonzero(active).tolist(), key=lambda body: float(distance[body])):
            goal = transform_shape(self.goals[i], self.objects[i].outline)
            way = shapely.union(outlines[i], goal).convex_hull
            others: NDArray[np.bool_] = np.asarray(shapely.distance(outlines, way) < GOAL_GAP)
            others[i] = False
            if others.any():
                return [int(j) for j in np.flatnonzero(others)]
        return []

    def _find_buffer_place(
        self, body: int, poses: Array, outlines: NDArray[np.object_]
    ) -> Array | None:
        """Finds the nearest place where an object is in nobody's way: a pose (3,), or None."""
        # What is taken: the other objects, and the ways from them to their goals.
        others = [outlines[j] for j in range(len(poses)) if j != body]
        for j in np.flatnonzero(self._has_goal):
            if j != body:
                goal = transform_shape(self.goals[j], self.objects[j].outline)
                others.append(shapely.union(outlines[j], goal).convex_hull)
        taken = shapely.union_all([*others, *self.rules.posts])
        shapely.prepare(taken)
        table = self.rules.surface
        room = None if table is None else table.polygon.buffer(-self.rules.edge_margin)
        # Rings around where it lies, from the inside out.
        for ring in range(1, BUFFER_RINGS + 1):
            angles = 2 * np.pi * np.arange(BUFFER_PLACES) / BUFFER_PLACES
            for dx, dy in (ring * BUFFER_STEP * make_direction(angles)).tolist():
                there = translate(outlines[body], dx, dy)
                if shapely.distance(there, taken) < BUFFER_CLEARANCE:
                    continue
                if room is None or shapely.covers(room, there):
                    return np.asarray(poses[body] + [dx, dy, 0.0])
        return None

    def _list_moving(self, poses: Array, targets: Targets) -> list[int]:
        """Lists the objects that pushes begin at: those put aside, or else those that go."""
        # What is put aside goes first, for the others wait for it.
        distance, _ = self._calc_differences(poses, targets.poses)
        is_buffered = targets.is_buffered & (distance > BUFFER_TOLERANCE)
        if is_buffered.any():
            return [int(b) for b in np.flatnonzero(is_buffered)]
        active = ~self.find_reached(poses) & (targets.weights == 1.0) & ~targets.is_buffered
        if not active.any():
            active = ~self.find_reached(poses)
        return [int(b) for b in np.flatnonzero(active)]

    def _calc_farthest(self, poses: Array, targets: Targets, bodies: Sequence[int]) -> float:
        """Calculates the farthest that one of some objects has to go, m."""
        distance, turn = self._calc_differences(poses, targets.poses)
        d = np.hypot(distance, np.array(self._arms) * turn)
        return float(np.nanmax(d[list(bodies)], initial=0.0))


TURN_FIRST = 0.3
"""Weight of distances in the cost by which detours are chosen, which turn an object first."""

REACH_ON = 0.02
"""Length by which a push may be longer than the object has to go, m: it slides off, or turns."""


def check_goals(
    objects: Sequence[GridObject],
    goals: Array,
    rules: SceneRules = UNCONSTRAINED,
    fields: Sequence[str] | None = None,
) -> None:
    """Checks that goals are beside each other and beside posts, and on the table.

    Args:
        objects: the N objects.
        goals: (N, 3) X_WB of each object at its goal, m and rad; NaN where it has none.
        rules: table and posts.
        fields: names of the N fields in which a user gave the goals, for messages; None if they
            are from no file.

    Raises:
        PlanningError: names both objects, or the object and the table or the post.
    """

    def name_goal(i: int) -> str:
        """Names an object's goal by its object, and by its field if it has one."""
        name = describe_object(objects, i)
        return f"that of {name}" if fields is None else f"{fields[i]} of {name}"

    begin = "goals: " if fields is None else ""
    given = np.flatnonzero(np.isfinite(goals).all(axis=1)).tolist()
    placed = {i: transform_shape(goals[i], objects[i].outline) for i in given}
    for i, j in combinations(given, 2):
        area = float(placed[i].intersection(placed[j]).area)
        if area > OVERLAP_TOLERANCE:
            raise PlanningError(
                f"{begin}{name_goal(i)} and {name_goal(j)} overlap by {area * 1e4:.3g} cm²; "
                "expected goals beside each other"
            )
    for i in given:
        for number, post in enumerate(rules.posts):
            if placed[i].distance(post) < POST_MARGIN:
                raise PlanningError(
                    f"{begin}{name_goal(i)} is nearer to posts[{number}] than "
                    f"{POST_MARGIN * MM_PER_M:g} mm; expected a pose beside it"
                )
    if rules.surface is None:
        return
    room = rules.surface.polygon.buffer(-rules.edge_margin)
    for i in given:
        if not room.covers(placed[i]):
            raise PlanningError(
                f"{begin}{name_goal(i)} is nearer to the table's edge than "
                f"{rules.edge_margin * MM_PER_M:g} mm; expected a pose well on the table"
            )

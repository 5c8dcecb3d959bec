"""`FetchPlanner`: brings the wanted object out of clutter to the table's edge, to be grasped there.

    clear    push away what is too near to the wanted object, or to its way to the edge
    poke     poke the wanted object, to learn where its mass may be
    slide    push it to the edge, so that it cannot fall on the way, by any masses it may have
    grasp    a graspable part hangs over far enough, and by any of these masses the object stays put

`planning.pregrasp` decides on the last three, and keeps clear of all other objects. Only the wanted
object comes near the table's edge, and only as far as is safe by all masses that it may have. The
other objects are cleared away to places wholly on the table, where they lie safely whatever their
masses are. The theory is in `docs/theory/planning.md`, section 6.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.bodies import describe_object
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, transform, transform_shape
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.pregrasp.decision import PreGraspDecision, PreGraspOptions
from gridpush_drake.planning.pregrasp.goals import ANY_ARM, ArmLimits, find_pregrasp_goals
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.slides import OBSTACLE_MARGIN
from gridpush_drake.planning.scene.loop import (
    SceneAction,
    SceneDecision,
    SceneLearning,
    SceneStep,
    describe_no_room,
)
from gridpush_drake.planning.scene.rules import SceneRules, place_outlines
from gridpush_drake.planning.scene.search import SceneSearch, SceneSearchOptions
from gridpush_drake.planning.support_surface import SupportSurface, stayed_supported
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

POKE_KIND = "poke"
SLIDE_KIND = "slide"
CLEARING_KIND = "clear"
"""Kinds of pushes, as a decision's `kind` names them."""

ROWS_APART = 4
"""Number of steps of a simulated push from one state in which the room is measured to the next."""

EDGE_ZONE = 0.12
"""Other objects that lie nearer than this to the table's edge may be in the way later, m."""

SHORE_FRACTION = 0.3
"""Cost of a meter by which another object is nearer to the edge than `EDGE_ZONE`, as a fraction of
the cost of a meter of lacking room."""

BLOCKED_COST = 10.0
"""Cost of a way to the edge that a post blocks, as an additional length of way, m: the object has
to be slid around the post."""

MIN_LACKING_CLEARANCE = 1e-3
"""Nothing is cleared away if no more room than this is lacking, m."""


@dataclass(frozen=True)
class FetchOptions:
    """How the wanted object is fetched.

    Attributes:
        room: least distance of everything else from the wanted object and from its way to the edge,
            m. Finger and object keep `slides.OBSTACLE_MARGIN` from it; the finger is behind the
            object while it slides it.
        spare: additional room that clearing aims at, m, so that a push need not be made twice.
        per_length: cost of a meter of lacking room, s/m.
        base: cost of an object that is in the way at all, s.
        max_clearing: number of pushes after which clearing away is given up.
        pregrasp: how the object is poked and slid, and what counts as safe.
        search: how pushes that clear the way are searched for.

    Raises:
        PlanningError: a number is not positive.
    """

    room: float = 0.055
    spare: float = 0.01
    per_length: float = 100.0
    base: float = 5.0
    max_clearing: int = 30
    pregrasp: PreGraspOptions = field(default_factory=PreGraspOptions)
    search: SceneSearchOptions = field(
        default_factory=lambda: SceneSearchOptions(candidates=32, firsts=3, seconds=8)
    )

    def __post_init__(self) -> None:
        require_positive(
            PlanningError,
            room=self.room,
            spare=self.spare,
            per_length=self.per_length,
            base=self.base,
            max_clearing=self.max_clearing,
        )


class FetchPlanner:
    """Brings the wanted one of several objects to the table's edge.

    Attributes:
        objects: the N objects.
        wanted: number of the wanted one.
        surface: the table.
        options: how it is fetched.
        rules: what pushes that clear the way may not do. Its posts are in the way of the wanted
            object, too.
    """

    def __init__(
        self,
        objects: Sequence[GridObject],
        wanted: int,
        surface: SupportSurface,
        options: FetchOptions | None = None,
        limits: ArmLimits = ANY_ARM,
        rules: SceneRules | None = None,
        *,
        seed: int = 0,
    ) -> None:
        """Finds the graspable parts of the wanted object.

        Args:
            objects: the objects.
            wanted: number of the wanted one, from 0.
            surface: the table.
            options: how it is fetched.
            limits: of the arm.
            rules: what pushes that clear the way may not do; those of the table and the arm where
                None.
            seed: seed of the pushes that are drawn.

        Raises:
            PlanningError: there is no such object, it has no graspable part, or the table is
                smaller than it.
        """
        self.objects = tuple(objects)
        if not 0 <= wanted < len(self.objects):
            raise PlanningError(
                f"wanted is {wanted!r}; expected the number of one of {len(self.objects)} objects, "
                "from 0"
            )
        self.wanted = wanted
        self.surface = surface
        self.options = options or FetchOptions()
        self.rules = rules or SceneRules(
            surface, finger_region=limits.finger_region, push_rule=limits.can_push
        )
        self._limits = limits
        self._seed = seed
        obj = self.objects[wanted]
        self._planner = PreGraspPlanner(obj, surface, self.options.pregrasp, limits=limits)

    def decide(self, poses: Array, belief: Belief, steps: Sequence[SceneStep]) -> SceneDecision:
        """Decides what to do next; see `ScenePlanner`."""
        model = belief.alone.get(self.wanted)
        outlines = place_outlines(self.objects, poses)
        way = self._choose_way(poses, model, outlines)
        lacking = self._calc_lacking(poses[None], way, self.options.room)[0]
        if lacking.max(initial=0.0) <= MIN_LACKING_CLEARANCE:
            # The way is free: what is left is one object's business.
            decision = self._decide_alone(poses, model, outlines, steps)
            if decision.action != "fail":
                return self._translate(decision, poses)
            # It may need yet more room, where something is nearer than twice as far.
            wider = self._calc_lacking(poses[None], way, 2 * self.options.room)[0]
            if wider.max(initial=0.0) <= MIN_LACKING_CLEARANCE:
                return SceneDecision(SceneAction.FAIL, decision.reason, body=self.wanted)
            return self._clear(poses, belief, steps, way, 2 * self.options.room)
        clearing = self._clear(poses, belief, steps, way, self.options.room)
        if clearing.action is SceneAction.PUSH:
            return clearing
        # Nothing can be cleared away. There may be another way round, though a narrower one.
        decision = self._decide_alone(poses, model, outlines, steps)
        return clearing if decision.action == "fail" else self._translate(decision, poses)

    def _choose_way(
        self, poses: Array, model: Belief | None, outlines: NDArray[np.object_]
    ) -> BaseGeometry:
        """Chooses the way to the edge on which least is to be cleared away.

        Until a goal is safe by what is known, the way is no longer than the object itself: it needs
        room to be poked.
        """
        here = outlines[self.wanted]
        if model is None:
            return here
        goals = find_pregrasp_goals(
            masses=model.masses,
            parts=self._planner.parts,
            pose=poses[self.wanted],
            surface=self.surface,
            options=self.options.pregrasp.goal,
            limits=self._limits,
            obstacles=self.rules.posts,
        )
        safe = [goal for goal in goals if goal.margin >= self.options.pregrasp.goal.margin]
        if not safe:
            return here
        ways = []
        for goal in safe:
            there = transform_shape(goal.pose, self.objects[self.wanted].outline)
            way = shapely.union(here, there).convex_hull
            lacking = self._calc_lacking(poses[None], way, self.options.room)[0]
            cost = goal.travel + float(lacking.sum())
            # What is fixed on a way cannot be cleared from it.
            blocked = any(way.distance(post) < OBSTACLE_MARGIN for post in self.rules.posts)
            cost += BLOCKED_COST if blocked else 0.0
            ways.append((cost, way))
        return min(ways, key=lambda each: each[0])[1]

    def _calc_lacking(self, poses: Array, way: BaseGeometry, room: float) -> Array:
        """Calculates by how much each object is too near to a way, (K, N) m; 0 for the wanted one.

        Args:
            poses: (K, N, 3) where the objects lie, m and rad.
            way: what should be free, in W.
            room: how far everything else should be from it, m.
        """
        lacking = np.zeros(poses.shape[:2])
        shapely.prepare(way)
        for b, obj in enumerate(self.objects):
            if b != self.wanted:
                corners = np.array(obj.outline.exterior.coords)[:-1]
                bodies = shapely.polygons(transform(poses[:, b], corners))
                lacking[:, b] = np.maximum(room - shapely.distance(way, bodies), 0.0)
        return lacking

    def _clear(
        self,
        poses: Array,
        belief: Belief,
        steps: Sequence[SceneStep],
        way: BaseGeometry,
        room: float,
    ) -> SceneDecision:
        """Decides on a push that makes room around a way."""
        made = sum(step.decision.kind == CLEARING_KIND for step in steps)
        lacking = self._calc_lacking(poses[None], way, room)[0]
        bodies = [int(b) for b in np.flatnonzero(lacking > MIN_LACKING_CLEARANCE)]
        names = ", ".join(describe_object(self.objects, b) for b in bodies)
        wanted = describe_object(self.objects, self.wanted)
        if made >= self.options.max_clearing:
            reason = f"{names} still in the way of {wanted} after {made} pushes"
            return SceneDecision(SceneAction.FAIL, reason, body=self.wanted)
        start = poses[self.wanted]
        obj = self.objects[self.wanted]
        search = SceneSearch(belief, self.rules, self.options.search)

        def cost(some: Array) -> Array:
            # of a few states along a push; in between it changes evenly
            rows = np.unique(np.append(np.arange(0, len(some), ROWS_APART), len(some) - 1))
            missing = self._calc_lacking(some[rows], way, room + self.options.spare)
            left = self.options.per_length * missing.sum(axis=1)
            left += self.options.base * (missing > self.options.spare).sum(axis=1)
            # near the edge everything is in the way sooner or later
            outward = np.maximum(EDGE_ZONE - search.room.calc_edge_distances(some[rows]), 0.0)
            left += SHORE_FRACTION * self.options.per_length * outward.sum(axis=1)
            # the wanted object should stay where it is
            moved = np.linalg.norm(some[rows, self.wanted, :2] - start[:2], axis=1)
            turned = np.abs(some[rows, self.wanted, 2] - start[2])
            left += self.options.per_length * np.hypot(moved, obj.radius_of_gyration * turned)
            return np.interp(np.arange(len(some)), rows, left)

        rng = np.random.default_rng((self._seed, len(steps)))
        found = search.find_push(poses, cost, bodies, rng)
        if found is None:
            found = search.find_push(poses, cost, range(len(poses)), rng)
        if found is None:
            return SceneDecision(
                SceneAction.FAIL,
                describe_no_room(self.objects, bodies, self.options.search.pusher),
            )
        return SceneDecision(
            SceneAction.PUSH,
            f"{names} out of the way of {wanted}",
            push=found.push,
            body=found.body,
            expected=found.poses,
            kind=CLEARING_KIND,
        )

    def _decide_alone(
        self,
        poses: Array,
        model: Belief | None,
        outlines: NDArray[np.object_],
        steps: Sequence[SceneStep],
    ) -> PreGraspDecision:
        """Decides as if the other objects were fixed obstacles."""
        others = [outlines[b] for b in range(len(poses)) if b != self.wanted]
        others += self.rules.posts
        pokes = sum(step.decision.kind == POKE_KIND for step in steps if not step.refused)
        slides = sum(step.decision.kind == SLIDE_KIND for step in steps if not step.refused)
        planner = PreGraspPlanner(
            self.objects[self.wanted],
            self.surface,
            self.options.pregrasp,
            parts=self._planner.parts,
            limits=self._limits,
            obstacles=[shapely.Polygon(each.exterior) for each in others],
        )
        return planner.decide(poses[self.wanted], model, pokes, slides)

    def _translate(self, decision: PreGraspDecision, poses: Array) -> SceneDecision:
        """Makes a scene's decision of one of the wanted object's."""
        if decision.action == "grasp":
            return SceneDecision(
                SceneAction.GRASP, decision.reason, body=self.wanted, goal=decision.goal
            )
        expected = None
        if decision.expected_pose is not None:
            expected = poses.copy()
            expected[self.wanted] = decision.expected_pose
        return SceneDecision(
            SceneAction.PUSH,
            decision.reason,
            push=decision.push,
            body=self.wanted,
            expected=expected,
            kind=decision.action,
            goal=decision.goal,
        )


@dataclass(frozen=True)
class FetchLearning:
    """Learns the wanted object alone, from pushes in which nothing else moved.

    These are the pushes that the wanted object's stability is judged by: nothing in them depends on
    how the others rub.

    Attributes:
        wanted: number of the wanted object.
        surface: the table; what hung over its edge in a push is not learned from that push.
        friction_range: least and greatest friction coefficient of any cell of the wanted object;
            the object's own bounds where None.
        scene: learns all objects together, for the pushes that clear the way; None for not at all.
        still: farthest that another object may be seen to move in such a push, m.
        min_move: least distance that the wanted one must move in it, m.
        obj: the wanted object with the height at which it is pushed; that of the scene, of which
            none is known, where None.
    """

    wanted: int
    surface: SupportSurface
    friction_range: tuple[float, float] | None = None
    scene: SceneLearning | None = None
    still: float = 0.004
    min_move: float = 0.002
    obj: GridObject | None = None

    def learn(
        self,
        belief: Belief,
        pushes: Sequence[ObservedPush],
        seed: int,
        *,
        last: bool = False,
        anew: bool = False,
    ) -> Belief | None:
        """Learns anew, where the last push tells something; see `SceneLearner`.

        The wanted object is learned after each push that tells of it, so that nothing of it is left
        to learn at last.
        """
        obj = self.obj or belief.objects[self.wanted]
        found = None
        if self.scene is not None:
            # the model of a scene knows no edge, over which the wanted object is slid at last
            lying = [each for each in pushes if self._lies(each, obj)]
            found = self.scene.learn(belief, lying, seed, last=last, anew=anew)
        if last or not pushes or not self._tells(pushes[-1], obj):
            return found
        clean = [seen.single_out(self.wanted) for seen in pushes if self._tells(seen, obj)]
        log = PushLog(tuple(clean))
        alone = identify(Model(obj), log, seed=seed)
        learned = Belief.of_identification(alone, friction_range=self.friction_range, log=log)
        return replace(found or belief, alone={**belief.alone, self.wanted: learned})

    def _tells(self, seen: ObservedPush, obj: GridObject) -> bool:
        """Says whether only the wanted object moved in a push, and lay wholly on the table."""
        change = seen.final_pose - seen.pose
        moved = np.linalg.norm(change[:, :2], axis=1)
        turned = obj.radius_of_gyration * np.abs(change[:, 2])
        others = np.delete(moved + turned, self.wanted)
        if others.max(initial=0.0) > self.still or moved[self.wanted] < self.min_move:
            return False
        return self._lies(seen, obj)

    def _lies(self, seen: ObservedPush, obj: GridObject) -> bool:
        """Says whether the wanted object lay wholly on the table throughout a push."""
        return stayed_supported(obj, seen.single_out(self.wanted), self.surface)

"""What to do next to grasp an object at the table's edge: the paper's Algorithm 3, made safe.

    explore   poke until the set of possible masses leaves a goal that is safe
    slide     push towards the goals, stable at the worst all the way; learn from every push that
              stayed on the table
    grasp     a graspable part hangs over far enough, and the object stays put at the worst

Each decision depends on what is seen and known now and on how many pushes were made, on nothing
else: if an object slipped, or was moved by somebody, the next decision simply takes it from where
it lies. What cannot be done safely is not done, and the decision says why.

`PreGraspPlanner.decide` makes one decision. `pregrasp_plan` makes the same decisions on predicted
poses, and so plans a whole slide as one model predicts it. How a robot carries decisions out is in
`pregrasp_loop`; the theory is in `docs/theory/planning.md`, section 4.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import Polygon
from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.simulation import calc_loads
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.exploration.designed_pokes import (
    DesignedPokes,
    Functional,
    calc_center_std,
    make_center_functional,
    make_farthest_functional,
)
from gridpush_drake.planning.exploration.strategy import PokeProposal
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.decision import (
    PokeForecast,
    PreGraspDecision,
    PreGraspOptions,
)
from gridpush_drake.planning.pregrasp.goals import (
    ANY_ARM,
    ArmLimits,
    PreGraspGoal,
    check_room,
    find_grasp_at,
    find_pregrasp_goals,
)
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import (
    FlatPart,
    GraspPart,
    find_flat_parts,
    find_grasp_parts,
    find_held_parts,
    stack_flat_parts,
)
from gridpush_drake.planning.pregrasp.grasp.gripper import PadLimit
from gridpush_drake.planning.pregrasp.poke_forecast import forecast_std
from gridpush_drake.planning.pregrasp.slides import (
    OBSTACLE_MARGIN,
    ROUND_OFF_MARGIN,
    calc_whole_margin,
    make_stability_rule,
    plan_slide,
)
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.plausibility import check_size
from gridpush_drake.units import MM_PER_M

ACCEPTED_FRACTION = 2 / 3
"""Fraction of the margin asked of a goal that is enough once the object is on its way, and where it
ends up. Pushes end only nearly where they should, and each of them changes a little what is known,
so that with the whole margin a plan would often be given up halfway."""

REACHABLE_SIGMAS = 4.0
"""Further pokes may add at most this many standard deviations, of how far the center can be across
the edge, to a margin. What would need more is given up."""

RETREAT_DEPTH = 0.02
"""How much farther inside the edge than pokes keep it an object is brought back to, m, so that it
can be poked there."""

RETREAT_MODELS = 20
"""Least number of models by which the object stays where it lies. With fewer of them, what was
learned says too little of how it would move, and it is not pushed."""

RETREAT_STEPS = 50
"""Greatest number of steps in which a place on the table is found for an object."""


class PreGraspPlanner:
    """Decides what to do next with one object on one table.

    Attributes:
        obj: the object.
        surface: the table.
        options: how far to go, and how carefully.
        pads: what the gripper's pads can hold of the object; None where that is not asked.
        parts: the narrow parts, which are taken where they can be.
        flat_parts: places at the rim that the gripper reaches, for where no narrow part will do.
        limits: of the arm.
        obstacles: what else lies on the table, polygons in W, m; the object keeps clear of it.
    """

    def __init__(
        self,
        obj: GridObject,
        surface: SupportSurface,
        options: PreGraspOptions | None = None,
        parts: Sequence[GraspPart] | None = None,
        limits: ArmLimits = ANY_ARM,
        obstacles: Sequence[Polygon] = (),
    ) -> None:
        """Finds the graspable parts; `parts` are the narrow ones, where they are known already.

        Raises:
            PlanningError: there is no graspable part, the table is smaller than the object, or the
                object is larger than any that is pushed about.
        """
        check_size(obj, PlanningError)
        self.obj = obj
        self.surface = surface
        self.limits = limits
        self.obstacles = tuple(obstacles)
        self.options = options or PreGraspOptions()
        gripper = self.options.gripper
        force = self.options.pad_force
        self.parts = tuple(find_grasp_parts(obj, gripper) if parts is None else parts)
        self.pads: PadLimit | None = None
        self.flat_parts: tuple[FlatPart, ...] = ()
        if force is not None:
            self.pads = gripper.limit_pads(obj, force)
            self.flat_parts = tuple(find_flat_parts(obj, gripper))
        check_room(obj, [*self.parts, *self.flat_parts], surface)

    @threadpool_limits.wrap(limits=1, user_api="blas")
    def decide(
        self, pose: ArrayLike, model: Belief | None, pokes: int = 0, slides: int = 0
    ) -> PreGraspDecision:
        """Decides what to do next.

        Args:
            pose: (3,) where the object is seen, X_WB, m and rad.
            model: what is known of it; None before any push.
            pokes: number of pokes made so far.
            slides: number of slides made so far.
        """
        q = np.asarray(pose, dtype=np.float64)
        decision = self._decide(q, model, pokes, slides)
        if decision.action != "poke":
            return decision
        return self._say_forecast(q, self._prior if model is None else model, decision)

    @cached_property
    def _prior(self) -> Belief:
        """What is believed before any push."""
        return Belief.of_prior(self.obj)

    def _decide(self, q: Array, model: Belief | None, pokes: int, slides: int) -> PreGraspDecision:
        """Decides; what a poke is expected to bring is known to first order only."""
        if model is None:
            return self._poke(q, self._prior, None, pokes, "nothing is known of the object yet")
        # Narrow parts go first. The rim is for what can be taken by none of them.
        near = self._find_parts_near(model, self._calc_max_arm(model))
        decision = self._decide_with(near, q, model, pokes, slides)
        if decision.action != "fail" or not self.flat_parts:
            return decision
        flat = self._decide_by_rim(q, model, pokes, slides)
        if flat.action != "fail" or not self.parts:
            return flat
        return replace(flat, reason=f"{decision.reason}; and by the rim, {flat.reason}")

    def is_safe(self, pose: ArrayLike, masses: PlausibleMassSet) -> bool:
        """Says whether an object stays put, whichever of some masses it has, with the whole margin.

        Args:
            pose: (3,) where it lies, X_WB, m and rad.
            masses: that it may have.
        """
        options = self.options.slide
        margin = calc_stability_margin(masses, pose, self.surface, options.inset)
        return margin >= calc_whole_margin(masses, options.margin) - ROUND_OFF_MARGIN

    def retreat(self, pose: ArrayLike, model: Belief) -> PreGraspDecision | None:
        """Decides on a push that brings an object from over the edge back onto the table.

        That the object lies still is known, whatever else is in doubt: models by which it would
        fall where it lies do not count, and by none of the others may it fall on the way. No
        stability margin is asked for, as the worst masses are among those that do not count.

        Args:
            pose: (3,) where it lies, X_WB, m and rad.
            model: what may be true of it.

        Returns:
            The push; None where none is safe by all these models.
        """
        q = np.asarray(pose, dtype=np.float64)
        home = self._find_home(q)
        inset = self.options.slide.inset
        goal = PreGraspGoal(
            pose=home,
            part=(*self.parts, *self.flat_parts)[0],
            overhang=0.0,
            margin=calc_stability_margin(model.masses, home, self.surface, inset),
            travel=float(calc_goal_error(self.obj, q, home)),
            weakest=np.array([1.0, 0.0]),
        )
        corners = self.surface.corners
        stays = [
            bodies
            for bodies in (model.bodies, *model.samples)
            if calc_loads(bodies, q, corners) is not None
        ]
        if len(stays) < RETREAT_MODELS:
            return None
        staying = replace(model, bodies=stays[0])
        planner = self._ask_margin(-np.inf)
        return planner._slide(q, staying, [goal], "lying wholly on the table", stays[1:])

    def _ask_margin(self, margin: float) -> "PreGraspPlanner":
        """Makes a planner whose slides keep another stability margin, m."""
        other = copy(self)
        slide = replace(self.options.slide, margin=margin)
        other.options = replace(self.options, slide=slide)
        return other

    def _find_home(self, pose: Array) -> Array:
        """Finds where an object at a pose (3,) would lie wholly on the table, without a turn."""
        room = self.surface.polygon.buffer(-(self.options.poke_margin + RETREAT_DEPTH))
        home = pose.copy()
        corners = np.array(self.obj.outline.convex_hull.exterior.coords)[:-1]
        for _ in range(RETREAT_STEPS):
            # The corner that is farthest off is brought to the nearest place; others may follow.
            points = shapely.points(transform(home, corners))
            far = points[int(np.argmax(shapely.distance(points, room)))]
            if room.is_empty or room.covers(far):
                break
            begin, end = shapely.get_coordinates(shapely.shortest_line(far, room))
            home[:2] += end - begin
        return home

    def go_gently(self, length: float) -> "PreGraspPlanner":
        """Makes a planner whose slides are no longer than a length, m."""
        gentle = copy(self)
        slide = self.options.slide
        shortest, longest = slide.contact.distance_range
        contact = replace(slide.contact, distance_range=(shortest, min(longest, length)))
        gentle.options = replace(self.options, slide=replace(slide, contact=contact))
        return gentle

    def suppose_heavier(self) -> "PreGraspPlanner":
        """Makes a planner for an object that withstood a press; itself if it never presses."""
        return self

    def avoid(self, places: Sequence[tuple[float, float]]) -> "PreGraspPlanner":
        """Makes a planner that does not press where the object slid; itself if it never presses."""
        return self

    def stop_weighing(self, why: str) -> "PreGraspPlanner":
        """Makes a planner that presses no more, and says why; itself if it never presses."""
        return self

    def _decide_by_rim(self, q: Array, model: Belief, pokes: int, slides: int) -> PreGraspDecision:
        """Decides what to do next to take a flat part.

        Only those parts count by which the pads hold the object wherever its center of mass is.
        """
        assert self.pads is not None  # or there would be no flat parts
        pads = self.pads.weigh(model.masses)
        centers = model.masses.center_of_mass_polygon
        held = find_held_parts(self.flat_parts, pads, centers)
        if held:
            return self._decide_with(held, q, model, pokes, slides)
        why = pads.describe_best(*stack_flat_parts(self.flat_parts), centers)
        # If the pads would hold it with its center of mass where it is estimated, a poke may help.
        middle = model.masses.middle[None]
        if model.posterior is not None and find_held_parts(self.flat_parts, pads, middle):
            return self._poke(q, model, None, pokes, why)
        return PreGraspDecision("fail", why)

    def _decide_with(
        self, parts: Sequence[GraspPart], q: Array, model: Belief, pokes: int, slides: int
    ) -> PreGraspDecision:
        """Decides what to do next to take one of some parts, all of them narrow or all flat."""
        options = self.options
        # Grasp, where a part hangs over already.
        here = find_grasp_at(model.masses, parts, q, self.surface, options.goal, self.limits)
        if here is not None and here.margin >= ACCEPTED_FRACTION * options.goal.margin:
            reason = (
                "a part hangs over, and the object stays put with "
                f"{here.margin * MM_PER_M:.0f} mm to spare"
            )
            return PreGraspDecision("grasp", reason, here)
        # Poke, while too little is known. Where no poke can be made, what is known has to do: goals
        # and slides are judged at the worst.
        if model.posterior is not None and pokes < options.min_pokes:
            poke = self._poke(q, model, None, pokes, "too little is known of the object yet")
            if poke.push is not None:
                return poke
        goals = self._find_goals(q, model, parts)
        if not goals:
            return self._poke_or_give_up(q, model, parts, pokes)
        best = goals[0]
        asked = options.goal.margin * (ACCEPTED_FRACTION if slides else 1.0)
        if best.margin < asked:
            why = (
                f"the safest goal has a stability margin of {best.margin * MM_PER_M:.0f} mm at the "
                f"worst; {asked * MM_PER_M:.0f} mm are asked for"
            )
            return self._poke(q, model, best, pokes, why)
        if slides >= options.max_slides:
            return PreGraspDecision("fail", f"not at the edge after {slides} slides", best)
        sliding = self._slide(q, model, goals, "a goal")
        if sliding is None:
            why = "no push towards a goal is safe all the way"
            return self._poke(q, model, best, pokes, why)
        return sliding

    def _slide(
        self,
        pose: Array,
        model: Belief,
        goals: Sequence[PreGraspGoal],
        aim: str,
        draws: Sequence[Bodies] | None = None,
    ) -> PreGraspDecision | None:
        """Decides on a push towards one of some goals; None if none is safe all the way.

        Args:
            pose: (3,) where the object lies, X_WB, m and rad.
            model: what is known of the object.
            goals: the goals, the best one first.
            aim: what the goals are, in words.
            draws: models that it must be safe by, beside the estimate; None for the model's own.
        """
        slide = plan_slide(
            masses=model.masses,
            params=model.params,
            draws=[each.params for each in (model.samples if draws is None else draws)],
            pose=pose,
            goals=goals,
            surface=self.surface,
            options=self.options.slide,
            limits=self.limits,
            obstacles=self.obstacles,
            physics=model.physics,
        )
        if slide is None:
            return None
        reason = f"{slide.planned.cost * MM_PER_M:.0f} mm from {aim} after this push"
        if np.isfinite(self.options.slide.margin):
            reason += f"; stability margin {slide.margin * MM_PER_M:.0f} mm or more on the way"
        return PreGraspDecision(
            "slide",
            reason,
            goal=slide.goal,
            push=slide.planned.push,
            expected_pose=slide.planned.pose,
        )

    def _describe_room(self) -> str:
        """Where pokes must keep the object, in words."""
        clear = ", clear of what else lies there" if self.obstacles else ""
        return f"on the table{clear}"

    def _calc_max_arm(self, model: Belief) -> float:
        """How far a narrow part may be from the center of mass, m: less for a heavy object."""
        if self.pads is None:
            return self.options.max_arm
        return min(self.options.max_arm, self.pads.weigh(model.masses).max_arm)

    def _find_parts_near(self, model: Belief, arm: float) -> tuple[GraspPart, ...]:
        """The narrow parts no farther than `arm`, m, from where the center of mass is estimated."""
        middle = model.masses.middle
        return tuple(part for part in self.parts if np.linalg.norm(part.p_BG - middle) <= arm)

    def _find_goals(
        self, pose: Array, model: Belief, parts: Sequence[GraspPart]
    ) -> list[PreGraspGoal]:
        """The goals with one of the parts beyond the edge; none without parts."""
        if not parts:
            return []
        return find_pregrasp_goals(
            masses=model.masses,
            parts=parts,
            pose=pose,
            surface=self.surface,
            options=self.options.goal,
            limits=self.limits,
            obstacles=self.obstacles,
        )

    def _poke_or_give_up(
        self, pose: Array, model: Belief, parts: Sequence[GraspPart], pokes: int
    ) -> PreGraspDecision:
        """Decides what to do where none of `parts` allows a goal.

        It pokes if the center of mass may turn out to be near other narrow parts that allow one.
        """
        if any(isinstance(part, FlatPart) for part in parts):
            why = (
                "no pose lets a part that the pads hold hang over the edge where the arm can "
                "take it"
            )
            return PreGraspDecision("fail", why)
        arm = self._calc_max_arm(model)
        near = f" within {arm * MM_PER_M:.0f} mm of the center of mass" if np.isfinite(arm) else ""
        why = f"no pose lets a graspable part{near} hang over the edge where the arm can take it"
        reachable = self._find_parts_near(model, arm + REACHABLE_SIGMAS * calc_center_std(model))
        if len(reachable) == len(parts) or not self._find_goals(pose, model, reachable):
            return PreGraspDecision("fail", why)
        return self._poke(pose, model, None, pokes, why)

    def propose_poke(
        self, model: Belief, pose: ArrayLike, direction: ArrayLike | None = None
    ) -> PokeProposal:
        """Proposes the poke that is expected to tell most of the center of mass.

        The object stays inside the table's edge, or at least as far in and as stable as it is.

        Args:
            model: of the object; its `posterior` must not be None.
            pose: (3,) where the object lies, X_WB, m and rad.
            direction: (2,) unit vector in the body frame along which it matters how far the center
                can be; where None, the center matters.

        Raises:
            PlanningError: the model leaves nothing to learn.
        """
        slide = self.options.slide
        rule = make_stability_rule(model.masses, pose, self.surface, slide.margin, slide.inset)
        rules = PushConstraints(
            self.surface,
            self.obstacles,
            edge_margin=self.options.poke_margin,
            obstacle_margin=OBSTACLE_MARGIN,
            pose_rule=rule,
            finger_region=self.limits.finger_region,
            push_rule=self.limits.can_push,
        )
        return DesignedPokes(self.options.poke, _choose_functional(direction)).propose(
            model, pose, rules
        )

    def _poke(
        self, pose: Array, model: Belief, best: PreGraspGoal | None, pokes: int, why: str
    ) -> PreGraspDecision:
        """Chooses the poke that tells most about the center of mass, or gives up.

        Args:
            pose: (3,) where the object lies.
            model: what is known of it.
            best: the best goal, across whose edge the center of mass matters; None if it matters in
                every direction.
            pokes: number of pokes made so far.
            why: a poke is needed, in half a sentence.
        """
        if model.posterior is None:
            return PreGraspDecision("fail", f"{why}, and pokes would not tell more", best)
        if pokes >= self.options.max_pokes:
            return PreGraspDecision("fail", f"{why}, after {pokes} pokes", best)
        choice = self.propose_poke(model, pose, None if best is None else best.weakest)
        if choice.push is None:
            reason = f"{why}, and no poke keeps the object {self._describe_room()}"
            return PreGraspDecision("fail", reason, best)
        # The margin cannot grow by more than what is not known yet.
        asked = self.options.goal.margin
        if best is not None and best.margin + REACHABLE_SIGMAS * choice.std < asked:
            reason = (
                f"{why}; pokes cannot tell mass from friction, only closer friction bounds would "
                "help"
            )
            return PreGraspDecision("fail", reason, best)
        forecast = PokeForecast(best is not None, choice.std, choice.expected_std)
        return PreGraspDecision("poke", why, goal=best, push=choice.push, forecast=forecast)

    def _say_forecast(
        self, pose: Array, model: Belief, decision: PreGraspDecision
    ) -> PreGraspDecision:
        """Says what a poke that is made is expected to bring, which takes long to forecast."""
        assert decision.push is not None and decision.forecast is not None
        functional = _choose_functional(None if decision.goal is None else decision.goal.weakest)
        expected = forecast_std(model, decision.push, pose, functional)
        forecast = decision.forecast
        if expected is not None:
            forecast = replace(forecast, expected_std=expected)
        reason = f"{decision.reason}; {forecast.describe()}"
        return replace(decision, reason=reason, forecast=forecast)


def _choose_functional(direction: ArrayLike | None) -> Functional:
    """Chooses what a poke is to tell: how far the center can be in a direction, or the center."""
    if direction is None:
        return make_center_functional
    return partial(make_farthest_functional, direction=direction)

"""The pre-grasp planner that weighs an object of which nothing is told before it relies on a goal.

Where friction may be anything, pokes cannot tell how far the center of mass is from the edge: a
light, rough part and a heavy, smooth one look the same. `PreGraspPlanner` then finds goals that are
hardly safe, and goes from one to the other, or gives up. This one first slides the object to where
a part hangs over the edge that can be pressed safely, by all that is known, and weighs it there:

    pokes      as many as that planner makes first
    weigh      until mass and center are roughly known; of all presses that are safe, the one that
               tells soonest, with the slides to it
    slide      to a goal, as that planner does, or weigh on where the goal has little margin
    stop       weighing where many slides led to few presses, or presses in a row weighed nothing;
               the reason says so
    grasp      as that planner does

How presses are planned is in `planning.weighing`; the theory is in `docs/theory/planning.md`,
section 8.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import product
from math import ceil

import numpy as np
import shapely
from shapely import LineString

from gridpush_drake.geometry.se2 import Array, transform_shape, wrap_angle
from gridpush_drake.identification.absolute.estimate import LOG_MASS, AbsoluteEstimate
from gridpush_drake.notebook import count
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.decision import PreGraspDecision
from gridpush_drake.planning.pregrasp.goals import PreGraspGoal
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.slides import calc_kept_margin
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.plan import (
    Edge,
    PlannedPress,
    PressRules,
    list_placements,
    plan_press,
)
from gridpush_drake.planning.weighing.press import PressTarget
from gridpush_drake.planning.weighing.sequence import (
    MASS_INCREASE,
    SequenceOptions,
    calc_headings,
    calc_normalized_uncertainty,
    calc_remaining_uncertainty,
    with_no_tip_force,
)
from gridpush_drake.units import MM_PER_M

DEFAULT_TOP = 0.03
"""Height of an object whose file does not tell it, m."""

CORNER_ROOM = 0.15
"""Least distance of an object's middle from a corner of the table, along the edge, where it is
weighed, m."""

SUFFICIENT_UNCERTAINTY = 3.0
"""What `calc_normalized_uncertainty` says if mass and both coordinates of the center are known just
well enough. Then nothing more is weighed."""

ROUGH_UNCERTAINTY = 36.0
"""What `calc_normalized_uncertainty` says if mass and center are known to about 5 % and 5 mm."""

PRESS_TIME = 6.0
"""Time that a press takes, s."""

SLIDE_TIME = 6.0
"""Time that a slide takes, s."""

SLIDE_LENGTH = 0.1
"""How far a slide moves an object, m."""

SLIDE_TURN = 0.8
"""How far a slide turns an object, rad."""

LEAST_GAIN = 0.003
"""By how much a slide must bring an object nearer to where it can be pressed, m, if it can be
pressed where it lies, too."""

LIKE_HEADING = 0.2
"""Difference of two headings from which on they count as different, rad."""

LEAST_RATE = 0.5
"""Fraction of the best press's rate that another press must have for a slide to go there
instead."""

SOME_EDGE = Edge(point=(0.0, 0.0), angle=0.0)
"""An edge for which rests are worked out, before they are moved to the table's own edges."""

SLIDE_TRUST = {0.004: 1.0, 0.002: 0.7, 0.001: 0.5}
"""How far from its goal a slide may end, m, so that a press is still possible; and the factor on
the rate of a press that allows so much, as slides end only nearly where they should."""

UNSTABLE_TRUST = 0.5
"""Factor on the rate of a press at a place where the object might not be stable at the worst: a
slide is cut short of it."""

LYING_STILL_TRUST = 0.7
"""Factor on the rate of a press that tilts the object with its center of mass where it is expected,
and not wherever it may be."""

SHORT_ARM = 0.012
"""Least distance of a press from the edge, m, where the center of mass may be almost anywhere."""

SMALL_GAIN = 0.03
"""Fraction of what is open that a press must be expected to take away at least, where no press
takes away `TiltTestOptions.min_gain` and mass or center are not even roughly known."""

REGION_ROOM = 0.12
"""How far within the ends of what the finger gets to of an edge the middle of an object is laid, m:
it is pressed beside its middle, and the finger has to get round it to turn it."""

MAX_PLACEMENTS = 6
"""Number of places to be weighed at that a slide may go to."""


@dataclass(frozen=True)
class TiltTestOptions:
    """When and how the planner weighs.

    Attributes:
        sequence: what presses keep to, and what is enough.
        min_gain: fraction of what is open of mass and center that a press must be expected to take
            away.
        trusted_margin: stability margin of a goal, m, to which the object is slid without being
            weighed further.
        max_presses: greatest number of presses that tilted the object.
        first_slides: number of slides after which an object that was not pressed yet is slid no
            further to be weighed.
        slides_per_press: number of slides that each press adds to these, also one that the object
            withstood.
        edge_room: how far inside the ends of its edge an object crosses that edge where it is
            weighed, m; and how far it keeps from all other edges.
        top: height of the object's top, m; None for what its file says.
    """

    sequence: SequenceOptions = field(default_factory=SequenceOptions)
    min_gain: float = 0.2
    trusted_margin: float = 0.006
    max_presses: int = 8
    first_slides: int = 8
    slides_per_press: int = 4
    edge_room: float = 0.005
    top: float | None = None


class TiltTestPlanner(PreGraspPlanner):
    """Decides as `PreGraspPlanner`, but weighs before it relies on a goal, pokes on or gives up.

    Attributes:
        weighing: when and how it weighs.
        mass_factor: factor on the mass that is believed, for a planner that supposes another one,
            as after a press that the object withstood.
        no_tilt_count: number of presses in a row at which the object did not tilt.
        is_narrow: whether it presses on parts that are narrower than the finger, too.
        is_short: whether it presses up to SHORT_ARM near to the edge.
        avoided: places on the object at which it slid when it was pressed, body frame, m.
        stopped: why it weighs no more, in half a sentence; empty while it weighs.
    """

    weighing: TiltTestOptions = TiltTestOptions()
    mass_factor: float = 1.0
    no_tilt_count: int = 0
    is_narrow: bool = False
    is_short: bool = False
    avoided: tuple[tuple[float, float], ...] = ()
    stopped: str = ""

    def _decide(self, q: Array, model: Belief | None, pokes: int, slides: int) -> PreGraspDecision:
        """Decides as a `PreGraspPlanner`, or to weigh."""
        if self.stopped:
            decision = super()._decide(q, model, pokes, slides)
            return replace(decision, reason=f"{decision.reason}; {self.stopped}")
        if model is None or model.absolute is None or not self.may_weigh(model, pokes, slides):
            return super()._decide(q, model, pokes, slides)
        known = (
            calc_normalized_uncertainty(model.absolute.covariance, self.weighing.sequence)
            <= ROUGH_UNCERTAINTY
        )
        may_slide = slides < self.calc_slide_limit(model.absolute.presses)
        if not known:
            weighing = self._decide_to_weigh(q, model, may_slide)
            if weighing is not None:
                return weighing
        decision = super()._decide(q, model, pokes, slides)
        if not may_slide:
            presses = model.absolute.presses + self.no_tilt_count
            decision = _say_why_weighed_no_further(decision, presses, slides)
        safe = decision.action == "slide" and decision.margin >= self.weighing.trusted_margin
        if not known or safe or decision.action == "grasp":
            return decision
        weighing = self._decide_to_weigh(q, model, may_slide)
        if weighing is None:
            return decision
        why = decision.reason
        if decision.action == "slide":
            why = (
                f"the goal has a stability margin of {decision.margin * MM_PER_M:.0f} mm at the "
                "worst"
            )
        return replace(weighing, reason=f"{why}; {weighing.reason}")

    def may_weigh(self, model: Belief, pokes: int, slides: int) -> bool:
        """Says whether it is time to weigh, and mass or center are not known well enough yet."""
        assert model.absolute is not None
        # The first pokes tell how friction is spread. After that a press tells more than a poke.
        if pokes < self.options.min_pokes or slides >= self.options.max_slides:
            return False
        if model.presses >= self.weighing.max_presses:
            return False
        return (
            calc_normalized_uncertainty(model.absolute.covariance, self.weighing.sequence)
            > SUFFICIENT_UNCERTAINTY
        )

    def calc_slide_limit(self, presses: int) -> int:
        """Calculates after how many slides an object is slid no further to be weighed.

        Args:
            presses: number of presses that tilted it so far.
        """
        presses += self.no_tilt_count
        return self.weighing.first_slides + self.weighing.slides_per_press * presses

    def _decide_to_weigh(
        self, pose: Array, model: Belief, may_slide: bool = True
    ) -> PreGraspDecision | None:
        """Decides on a press, or on a push to where one can be made; None where neither helps.

        Args:
            pose: (3,) where the object lies, X_WB, m and rad.
            model: what is known of it.
            may_slide: whether it may be pushed to where a press can be made.
        """
        for choice in self.plan_presses(pose, model, may_slide):
            planner = choice.planner
            if choice.here is not None:
                planner = planner._ask_gain(LEAST_GAIN)
            slide = planner._slide_to_weigh(pose, model, [one.goal for one in choice.placements])
            if slide is not None:
                return slide
            if choice.here is not None:
                target = choice.here.target
                return PreGraspDecision("weigh", "it is weighed where it lies", press=target)
        return None

    def plan_presses(
        self, pose: Array, model: Belief, may_slide: bool = True
    ) -> Iterator["PressChoice"]:
        """Plans presses where the object lies, and placements at an edge that tell sooner.

        Args:
            pose: (3,) where the object lies, X_WB, m and rad.
            model: what is known of it.
            may_slide: whether the object may be laid elsewhere.

        Yields:
            What there is, by one set of rules after another: each supposes more, or allows more,
            than those before it, and is for where those lead to nothing.
        """
        belief = model.absolute
        assert belief is not None
        # If there is no other press, one is made that tilts the object if it is lighter than it is
        # expected. The whole finger is to press on the object. Where no such press is left, a part
        # that is too narrow for it is pressed.
        lighter = self._suppose_lighter(belief)
        tried = [self, lighter, self._allow_narrow(), lighter._allow_narrow()]
        # Where that leads to nothing, several presses that each tell little are better than none.
        asked = self.weighing.min_gain
        known = (
            calc_normalized_uncertainty(belief.covariance, self.weighing.sequence)
            <= ROUGH_UNCERTAINTY
        )
        accepted = asked if known else min(asked, SMALL_GAIN)
        little: list[PressChoice] = []
        for planner in tried:
            planner = planner._accept_gain(accepted)
            here, placements = planner._gather_presses(pose, model, belief, may_slide)
            much = planner._choose_presses(belief, here, placements, asked)
            if much is not None:
                yield much
            some = planner._choose_presses(belief, here, placements, accepted)
            if some is not None:
                little.append(some)
        yield from little

    def _gather_presses(
        self, pose: Array, model: Belief, belief: AbsoluteEstimate, may_slide: bool
    ) -> tuple[PlannedPress | None, list["PressPlacement"]]:
        """Gathers what there is by one set of rules, whether it is sure to come about or not.

        A heavy object may lie still with its center of mass farthest from the edge. And as long as
        that may be almost anywhere, so little may hang over that a press near the edge is the only
        one. These are compared with all others by how soon they are expected to tell: an object
        that is slid to wherever there is no doubt is pushed about.

        Args:
            pose: (3,) where the object lies, X_WB, m and rad.
            model: what is known of it.
            belief: what is held of its mass and center of mass.
            may_slide: whether the object may be laid elsewhere.

        Returns:
            A press where it lies, the surest kind first; and placements, those that tell soonest
            first.
        """
        arms = (self, self._allow_short())
        here = next(
            (
                press
                for planner, is_robust in product(arms, (True, False))
                if (press := planner._find_press(pose, model, belief, is_robust)) is not None
            ),
            None,
        )
        kinds = sorted(
            (kind for planner in arms for kind in planner._list_kinds(belief)),
            key=lambda kind: -kind.trust,
        )
        placements = self._list_placements(pose, model, belief, kinds) if may_slide else []
        return here, placements

    def _list_kinds(self, belief: AbsoluteEstimate) -> list["PressKind"]:
        """Lists the kinds of presses for which the object may be laid somewhere."""
        rules = self._make_rules(belief)
        return [
            PressKind(
                replace(rules, pose_error=rules.pose_error + room, min_arm=rules.min_arm + room),
                is_robust,
                trust if is_robust else trust * LYING_STILL_TRUST,
            )
            for is_robust in (True, False)
            for room, trust in SLIDE_TRUST.items()
        ]

    def _choose_presses(
        self,
        belief: AbsoluteEstimate,
        here: PlannedPress | None,
        placements: Sequence["PressPlacement"],
        gain: float,
    ) -> "PressChoice | None":
        """Chooses presses that take away at least a fraction of what is open; None without any.

        A placement is chosen only if a press there tells sooner than one where the object lies.
        """
        rate = 0.0
        if here is not None:
            expected = self._calc_gain(belief, here)
            rate = _calc_rate(expected, 0)
            here = here if expected >= gain else None
        telling = [one for one in placements if one.gain >= gain]
        sooner = telling and (here is None or rate < telling[0].rate)
        placements = self._choose_placements(telling) if sooner else []
        if here is None and not placements:
            return None
        return PressChoice(self, here, tuple(placements))

    def _slide_to_weigh(
        self, pose: Array, model: Belief, goals: Sequence[PreGraspGoal]
    ) -> PreGraspDecision | None:
        """Decides on a push towards one of some goals where the object can be weighed."""
        return self._slide(pose, model, goals, "where it can be weighed") if goals else None

    def suppose_heavier(self) -> "TiltTestPlanner":
        """Makes a planner that presses where less force would do.

        It is for an object that did not tilt with the greatest force, so that it is heavier, or its
        center of mass farther inside, than was supposed.
        """
        other = self._suppose(MASS_INCREASE)
        other.no_tilt_count += 1
        return other

    def avoid(self, places: Sequence[tuple[float, float]]) -> "TiltTestPlanner":
        """Makes a planner that does not press again where the object slid.

        Args:
            places: on the object, body frame, m.
        """
        other = copy(self)
        other.avoided = (*self.avoided, *places)
        return other

    def stop_weighing(self, why: str) -> "TiltTestPlanner":
        """Makes a planner that decides by what was weighed so far, and presses no more.

        Args:
            why: in half a sentence.
        """
        other = copy(self)
        other.stopped = why
        return other

    @property
    def _top(self) -> float:
        """Height of the object's top, m."""
        return self.weighing.top or self.obj.height or DEFAULT_TOP

    def _suppose_lighter(self, belief: AbsoluteEstimate) -> "TiltTestPlanner":
        """Makes a planner that supposes a mass one standard deviation less than is believed."""
        std = float(np.sqrt(belief.covariance[LOG_MASS, LOG_MASS]))
        return self._suppose(float(np.exp(-std)))

    def _allow_narrow(self) -> "TiltTestPlanner":
        """Makes a planner that presses on parts that are narrower than the finger, too."""
        other = copy(self)
        other.is_narrow = True
        return other

    def _allow_short(self) -> "TiltTestPlanner":
        """Makes a planner that presses nearer to the edge, too."""
        other = copy(self)
        other.is_short = True
        return other

    def _accept_gain(self, gain: float) -> "TiltTestPlanner":
        """Makes a planner whose presses take away at least a fraction of what is open."""
        other = copy(self)
        other.weighing = replace(self.weighing, min_gain=gain)
        return other

    def _suppose(self, factor: float) -> "TiltTestPlanner":
        """Makes a planner that supposes a mass which is another one by a factor."""
        other = copy(self)
        other.mass_factor = self.mass_factor * factor
        return other

    def _make_rules(self, belief: AbsoluteEstimate) -> PressRules:
        """Makes the rules of a press, which suppose the mass that is known by now."""
        rules = self.weighing.sequence.rules
        known = belief.presses or belief.pushes
        mass = belief.total_mass if known else rules.mass
        return replace(
            rules,
            mass=mass * self.mass_factor,
            is_narrow=self.is_narrow,
            avoided=self.avoided,
            min_arm=min(rules.min_arm, SHORT_ARM) if self.is_short else rules.min_arm,
        )

    def _calc_gain(self, belief: AbsoluteEstimate, planned: PlannedPress) -> float:
        """Calculates the fraction of what is open that a press is expected to take away."""
        options = self.weighing.sequence
        now = calc_normalized_uncertainty(belief.covariance, options)
        return (
            1 - calc_remaining_uncertainty(belief, planned, self._make_rules(belief), options) / now
        )

    def _find_press(
        self, pose: Array, model: Belief, belief: AbsoluteEstimate, is_robust: bool
    ) -> PlannedPress | None:
        """Finds a press where the object lies now (3,); None where none is safe and tells much.

        What `is_robust` means, `plan_press` says.
        """
        centers = model.masses.center_of_mass_polygon
        rules = self._make_rules(belief)
        for edge in list_edges(self.surface):
            if not self._hangs_over_only(edge, pose):
                continue
            planned = plan_press(self.obj, centers, pose, edge.line, self._top, rules, is_robust)
            if planned is None or self._calc_gain(belief, planned) < self.weighing.min_gain:
                continue
            if self._can_press(planned.target, pose):
                return with_no_tip_force(planned, belief, rules)
        return None

    def _can_press(self, target: PressTarget, pose: Array) -> bool:
        """Says whether the arm can press there, with the object at a pose (3,)."""
        return self.limits.can_press is None or self.limits.can_press(target, pose)

    def _hangs_over_only(self, edge: "TableEdge", pose: Array) -> bool:
        """Says whether an object at a pose (3,) hangs over one edge, and over no other.

        Near a corner of the table it would tilt about the corner instead of the edge.
        """
        room = self.weighing.edge_room
        outline = shapely.get_coordinates(transform_shape(pose, self.obj.outline))
        for other in list_edges(self.surface):
            if other != edge and other.line.calc_beyond(outline).max() > -room:
                return False
        along = edge.line.calc_along(outline)
        return bool(along.min() >= room and along.max() <= edge.length - room)

    def _list_placements(
        self,
        pose: Array,
        model: Belief,
        belief: AbsoluteEstimate,
        kinds: Sequence["PressKind"],
    ) -> list["PressPlacement"]:
        """Lists poses at the edge at which a press tells much, those first that tell it soonest.

        Args:
            pose: (3,) where the object lies, X_WB, m and rad.
            model: what is known of it.
            belief: what is held of its mass and center of mass.
            kinds: of presses; with each heading the first one counts that is possible.
        """
        masses = model.masses
        slide = self.options.slide
        kept = calc_kept_margin(masses, pose, self.surface, slide.margin, slide.inset)
        # The edges differ only in where they are: what is told by a press is the same at each.
        headings = calc_headings(self.obj, SOME_EDGE).tolist()
        telling = [
            one
            for heading in headings
            for one in self._list_telling(heading, masses, belief, kinds)
        ]
        found: list[PressPlacement] = []
        for edge in list_edges(self.surface):
            # The object may also go over the edge as it lies.
            upright = float(wrap_angle(pose[2] - edge.line.angle))
            unturned = self._list_telling(upright, masses, belief, kinds)
            along = self._choose_along(edge, pose)
            for planned, gain, trust in (*unturned, *telling):
                if gain < self.weighing.min_gain:
                    continue
                moved = planned.move_to(edge.line, along)
                if not self._hangs_over_only(edge, moved.pose):
                    continue
                # Of the headings that are full turns apart, the nearest one is meant.
                moved.pose[2] = pose[2] + wrap_angle(moved.pose[2] - pose[2])
                goal = self._make_goal(pose, moved, masses)
                sure = trust if goal.margin >= kept else trust * UNSTABLE_TRUST
                rate = sure * _calc_rate(gain, _count_slides(pose, moved.pose))
                found.append(PressPlacement(moved, goal, gain, rate))
        found.sort(key=lambda one: -one.rate)
        return found

    def _choose_along(self, edge: "TableEdge", pose: Array) -> float:
        """Chooses where along an edge an object is laid, from the edge's corner, m.

        It is as near as may be to where it is, but not at a corner, and where the finger gets: an
        object that is slid along may have left the workspace.
        """
        low, high = CORNER_ROOM, edge.length - CORNER_ROOM
        if self.limits.finger_region is not None:
            begin = np.array(edge.line.point)
            side = LineString([begin, begin + edge.length * edge.line.tangent])
            reached = shapely.get_coordinates(side.intersection(self.limits.finger_region))
            if len(reached):
                along = edge.line.calc_along(reached)
                low = max(low, float(along.min()) + REGION_ROOM)
                high = min(high, float(along.max()) - REGION_ROOM)
        return float(np.clip(edge.line.calc_along(pose[:2]), low, max(low, high)))

    def _list_telling(
        self,
        heading: float,
        masses: PlausibleMassSet,
        belief: AbsoluteEstimate,
        kinds: Sequence["PressKind"],
    ) -> list[tuple[PlannedPress, float, float]]:
        """Lists how far the object may hang over `SOME_EDGE` with a heading, rad; see above.

        Returns:
            The press of each overhang, its gain and how far it is trusted, all of one kind.
        """
        for kind in kinds:
            planned = list_placements(
                self.obj,
                masses.center_of_mass_polygon,
                heading,
                SOME_EDGE,
                self._top,
                kind.rules,
                is_robust=kind.is_robust,
            )
            if planned:
                return [(one, self._calc_gain(belief, one), kind.trust) for one in planned]
        return []

    def _choose_placements(self, placements: Sequence["PressPlacement"]) -> list["PressPlacement"]:
        """Chooses the first rests at which the arm can press, of different headings.

        Each of them tells about as soon as the first one. One push may be safe where another is
        not, and rests that are turned alike need about the same push.
        """
        chosen: list[PressPlacement] = []
        for one in placements:
            if len(chosen) == MAX_PLACEMENTS or (chosen and one.rate < LEAST_RATE * chosen[0].rate):
                break
            heading = one.goal.pose[2]
            if any(abs(heading - other.goal.pose[2]) < LIKE_HEADING for other in chosen):
                continue
            # The arm is asked last, for that takes longest.
            if self._can_press(one.planned.target, one.goal.pose):
                chosen.append(one)
        return chosen

    def _ask_gain(self, gain: float) -> "TiltTestPlanner":
        """Makes a planner whose slides must bring the object nearer by a distance, m."""
        asking = copy(self)
        asking.options = replace(self.options, slide=replace(self.options.slide, min_gain=gain))
        return asking

    def _make_goal(
        self, pose: Array, planned: PlannedPress, masses: PlausibleMassSet
    ) -> PreGraspGoal:
        """Makes a goal of a slide of where an object is to be pressed."""
        target = planned.target
        inset = self.options.slide.inset
        return PreGraspGoal(
            pose=planned.pose,
            part=(*self.parts, *self.flat_parts)[0],
            overhang=target.calc_lever_arm(np.array(target.place)),
            margin=calc_stability_margin(masses, planned.pose, self.surface, inset),
            travel=float(calc_goal_error(self.obj, pose, planned.pose)),
            weakest=np.array([1.0, 0.0]),
        )


def _say_why_weighed_no_further(
    decision: PreGraspDecision, presses: int, slides: int
) -> PreGraspDecision:
    """The decision with a reason that says why the object is slid no further to be weighed."""
    made = count(presses, "press") if presses else "no press"
    why = f"{count(slides, 'slide')} led to {made}, so that it is slid no further to be weighed"
    return replace(decision, reason=f"{decision.reason}; {why}")


def _count_slides(pose: Array, goal: Array) -> int:
    """Estimates how many slides bring an object from a pose (3,) to another."""
    distance = float(np.linalg.norm(goal[:2] - pose[:2]))
    return ceil(distance / SLIDE_LENGTH + abs(float(goal[2] - pose[2])) / SLIDE_TURN)


def _calc_rate(gain: float, slides: int) -> float:
    """Calculates how fast a press tells, 1/s: the logarithm of what it leaves open, by time.

    Args:
        gain: fraction of what is open that the press is expected to take away.
        slides: number of slides to it.
    """
    return float(-np.log1p(-gain) / (PRESS_TIME + slides * SLIDE_TIME))


@dataclass(frozen=True)
class PressKind:
    """A kind of presses for which an object may be laid somewhere.

    Attributes:
        rules: what they keep to, with room for a slide that ends only nearly where it should.
        is_robust: see `plan_press`.
        trust: factor on the rates, by how far they are trusted to come about.
    """

    rules: PressRules
    is_robust: bool
    trust: float


@dataclass(frozen=True, eq=False)
class PressPlacement:
    """Where an object may be laid to be pressed.

    Attributes:
        planned: the press.
        goal: that a slide goes to.
        gain: fraction of what is open that the press is expected to take away.
        rate: how fast the press tells, with the slides to it, times how far the slides are trusted
            to lead to it, 1/s.
    """

    planned: PlannedPress
    goal: PreGraspGoal
    gain: float
    rate: float


@dataclass(frozen=True, eq=False)
class PressChoice:
    """Presses of which the planner may choose one.

    Attributes:
        planner: by whose rules they are planned.
        here: the press where the object lies; None where none is safe and tells enough.
        placements: where the object may be laid to be pressed sooner than here, with the slides to
            it; the best first.
    """

    planner: TiltTestPlanner
    here: PlannedPress | None
    placements: tuple[PressPlacement, ...]


@dataclass(frozen=True)
class TableEdge:
    """One side of a table.

    Attributes:
        line: the line that it is on, from its first corner.
        length: m.
    """

    line: Edge
    length: float


def list_edges(surface: SupportSurface) -> list[TableEdge]:
    """Lists the sides of a table; each runs from its line's point along its tangent."""
    return [
        TableEdge(
            line=Edge(
                point=(float(corner[0]), float(corner[1])),
                angle=float(np.arctan2(normal[1], normal[0])),
            ),
            length=float(length),
        )
        for corner, normal, length in zip(
            surface.corners, surface.edge_normals, surface.edge_lengths, strict=True
        )
    ]

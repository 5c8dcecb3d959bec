"""The pre-grasp planner that weighs where the others give up, or go on poking.

Where friction may be anything, pokes cannot tell how far the center of mass is from the edge: a
light, rough part and a heavy, smooth one look the same. `PreGraspPlanner` gives up then. This one
slides the object to where a part hangs over the edge that can be pressed safely, by all that is
known, weighs it there, and goes on with what that told.

How presses are planned is in `planning.weighing`; the theory is in `docs/theory/planning.md`,
section 8.
"""

from copy import copy
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
import shapely
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from gridpush_drake.geometry.se2 import Array, transform_shape, wrap_angle
from gridpush_drake.identification.absolute import AbsoluteEstimate
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.pregrasp.decision import PreGraspDecision
from gridpush_drake.planning.pregrasp.goals import PreGraspGoal
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.slides import calc_kept_margin
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet, UncertainModel
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.plan import (
    Edge,
    PlannedPress,
    PressRules,
    list_rests,
    plan_press,
)
from gridpush_drake.planning.weighing.press import PressTarget
from gridpush_drake.planning.weighing.sequence import (
    HEAVIER,
    SequenceOptions,
    calc_headings,
    calc_left_open,
    calc_open,
    with_sure_force,
)

MM = 1e3
"""Millimeters in a meter."""

DEFAULT_TOP = 0.03
"""Height of an object whose file does not tell it, m."""

CORNER_ROOM = 0.15
"""Least distance of an object's middle from a corner of the table, along the edge, where it is
weighed, m."""

ENOUGH = 3.0
"""What `calc_open` says if mass and both coordinates of the center are known just well enough. Then
nothing more is weighed."""

MAX_RESTS = 6
"""Number of places to be weighed at that a slide may go to."""


@dataclass(frozen=True)
class WeighingOptions:
    """When and how the planner weighs.

    Attributes:
        sequence: what presses keep to, and what is enough.
        min_gain: share of what is open of mass and center that a press must be expected to take
            away.
        max_presses: greatest number of presses that tilted the object.
        edge_room: how far inside the ends of its edge an object crosses that edge where it is
            weighed, m; and how far it keeps from all other edges.
        top: height of the object's top, m; None for what its file says.
    """

    sequence: SequenceOptions = field(default_factory=SequenceOptions)
    min_gain: float = 0.2
    max_presses: int = 8
    edge_room: float = 0.005
    top: float | None = None


class WeighingPlanner(PreGraspPlanner):
    """Decides as `PreGraspPlanner`, and weighs instead of giving up or poking on.

    Attributes:
        weighing: when and how it weighs.
        withstood: number of presses that the object withstood, for each of which it is supposed to
            be heavier.
    """

    weighing: WeighingOptions = WeighingOptions()
    withstood: int = 0

    # The matrices are small: threads of BLAS would only cost time, and change the order of sums.
    @threadpool_limits.wrap(limits=1, user_api="blas")
    def decide(
        self, pose: ArrayLike, model: UncertainModel | None, pokes: int = 0, slides: int = 0
    ) -> PreGraspDecision:
        """Decides what to do next; see `PreGraspPlanner.decide`."""
        decision = super().decide(pose, model, pokes, slides)
        if decision.action not in ("fail", "poke") or model is None or model.belief is None:
            return decision
        # The first pokes tell how friction is spread. After that a press tells more than a poke.
        if decision.action == "poke" and pokes < self.options.min_pokes:
            return decision
        if model.belief.presses >= self.weighing.max_presses or slides >= self.options.max_slides:
            return decision
        if calc_open(model.belief.covariance, self.weighing.sequence) <= ENOUGH:
            return decision
        q = np.asarray(pose, dtype=np.float64)
        # A heavy object may lie still wherever its center of mass is farthest from the edge. If
        # there is no other press, one is made that tilts it with the center where it is expected.
        for surely in (True, False):
            here = self._find_press(q, model, model.belief, surely)
            if here is not None:
                reason = f"{decision.reason}; it is weighed where it lies"
                return PreGraspDecision("weigh", reason, press=here.target)
            slide = self._slide_to_weigh(q, model, model.belief, surely)
            if slide is not None:
                return slide
        return decision

    def suppose_heavier(self) -> "WeighingPlanner":
        """Makes a planner that presses where less force would do.

        It is for an object that did not tilt with the greatest force, so that it is heavier, or its
        center of mass farther inside, than was supposed.
        """
        heavier = copy(self)
        heavier.withstood = self.withstood + 1
        return heavier

    @property
    def _top(self) -> float:
        """Height of the object's top, m."""
        return self.weighing.top or self.obj.height or DEFAULT_TOP

    def _make_rules(self, belief: AbsoluteEstimate) -> PressRules:
        """Makes the rules of a press, which suppose the mass that is known by now."""
        rules = self.weighing.sequence.rules
        known = belief.presses or belief.pushes
        mass = belief.total_mass if known else rules.mass
        return replace(rules, mass=mass * HEAVIER**self.withstood)

    def _calc_gain(self, belief: AbsoluteEstimate, planned: PlannedPress) -> float:
        """Calculates the share of what is open that a press is expected to take away."""
        options = self.weighing.sequence
        now = calc_open(belief.covariance, options)
        return 1 - calc_left_open(belief, planned, self._make_rules(belief), options) / now

    def _find_press(
        self, pose: Array, model: UncertainModel, belief: AbsoluteEstimate, surely: bool
    ) -> PlannedPress | None:
        """Finds a press where the object lies now (3,); None where none is safe and tells much.

        What `surely` means, `plan_press` says.
        """
        centers = model.masses.center_of_mass_polygon
        rules = self._make_rules(belief)
        for edge in list_edges(self.surface):
            if not self._hangs_over_only(edge, pose):
                continue
            planned = plan_press(self.obj, centers, pose, edge.line, self._top, rules, surely)
            if planned is None or self._calc_gain(belief, planned) < self.weighing.min_gain:
                continue
            if self._can_press(planned.target, pose):
                return with_sure_force(planned, belief, rules)
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

    def _slide_to_weigh(
        self, pose: Array, model: UncertainModel, belief: AbsoluteEstimate, surely: bool
    ) -> PreGraspDecision | None:
        """Decides on a push towards where the object can be weighed; None where there is none."""
        goals = self._list_goals(pose, model, belief, surely)
        if not goals:
            return None
        return self._slide(pose, model, goals, "where it can be weighed")

    def _list_goals(
        self, pose: Array, model: UncertainModel, belief: AbsoluteEstimate, surely: bool = True
    ) -> list[PreGraspGoal]:
        """Lists poses at the edge at which a press tells much.

        Those at which the object is stable at the worst go first, the nearest ones before others. A
        slide is cut short of all others, so that the object would be pushed about before them.
        """
        masses = model.masses
        slide = self.options.slide
        kept = calc_kept_margin(masses, pose, self.surface, slide.margin, slide.inset)
        rules = self._make_rules(belief)
        middle = pose[:2]
        found: list[tuple[PreGraspGoal, PressTarget]] = []
        for edge in list_edges(self.surface):
            along = float(edge.line.calc_along(middle))
            along = float(np.clip(along, CORNER_ROOM, max(edge.length - CORNER_ROOM, CORNER_ROOM)))
            for heading in calc_headings(self.obj, edge.line).tolist():
                # Of the headings that are full turns apart, the nearest one is meant.
                theta = float(pose[2] + wrap_angle(heading - pose[2]))
                rests = list_rests(
                    self.obj,
                    masses.center_of_mass_polygon,
                    theta,
                    edge.line,
                    self._top,
                    rules,
                    along=along,
                    surely=surely,
                )
                for planned in rests:
                    if self._calc_gain(belief, planned) < self.weighing.min_gain:
                        continue
                    if self._hangs_over_only(edge, planned.pose):
                        found.append((self._make_goal(pose, planned, masses), planned.target))
        # The arm is asked last, for that takes longest.
        found.sort(key=lambda one: (one[0].margin < kept, one[0].travel))
        reached = (goal for goal, target in found if self._can_press(target, goal.pose))
        return list(islice(reached, MAX_RESTS))

    def _make_goal(
        self, pose: Array, planned: PlannedPress, masses: PlausibleMassSet
    ) -> PreGraspGoal:
        """Makes a goal of a slide of where an object is to be pressed."""
        target = planned.target
        inset = self.options.slide.inset
        return PreGraspGoal(
            pose=planned.pose,
            part=(*self.parts, *self.flat_parts)[0],
            overhang=target.calc_arm(np.array(target.place)),
            margin=calc_stability_margin(masses, planned.pose, self.surface, inset),
            travel=float(calc_goal_error(self.obj, pose, planned.pose)),
            weakest=np.array([1.0, 0.0]),
        )


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

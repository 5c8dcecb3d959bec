"""The pre-grasp planner that weighs where the others give up.

Where friction may be anything, pokes cannot tell how far the center of mass is from the edge: a
light, rough part and a heavy, smooth one look the same. `PreGraspPlanner` gives up then. This one
slides the object to where a part hangs over the edge that can be pressed safely, by all that is
known, weighs it there, and goes on with what that told.

How presses are planned is in `planning.weighing`; the theory is in `docs/theory/planning.md`,
section 8.
"""

from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.identification.absolute import AbsoluteEstimate
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.pregrasp.goals import PreGraspGoal
from gridpush_drake.planning.pregrasp.planner import PreGraspDecision, PreGraspPlanner
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.plan import (
    Edge,
    PlannedPress,
    PressRules,
    list_rests,
    plan_press,
)
from gridpush_drake.planning.weighing.sequence import (
    HEAVIER,
    SequenceOptions,
    calc_headings,
    calc_left_open,
    calc_open,
)

MM = 1e3
"""Millimeters in a meter."""

DEFAULT_TOP = 0.03
"""Height of an object whose file does not tell it, m."""

CORNER_ROOM = 0.15
"""Least distance of an object's middle from a corner of the table, along the edge, where it is
weighed, m."""

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
    """

    sequence: SequenceOptions = field(default_factory=SequenceOptions)
    min_gain: float = 0.2
    max_presses: int = 8


class WeighingPlanner(PreGraspPlanner):
    """Decides as `PreGraspPlanner`, and weighs instead of giving up.

    Attributes:
        weighing: when and how it weighs.
    """

    weighing: WeighingOptions = WeighingOptions()

    # The matrices are small: threads of BLAS would only cost time, and change the order of sums.
    @threadpool_limits.wrap(limits=1, user_api="blas")
    def decide(
        self, pose: ArrayLike, model: UncertainModel | None, pokes: int = 0, slides: int = 0
    ) -> PreGraspDecision:
        """Decides what to do next; see `PreGraspPlanner.decide`."""
        decision = super().decide(pose, model, pokes, slides)
        if decision.action != "fail" or model is None or model.belief is None:
            return decision
        if model.belief.presses >= self.weighing.max_presses or slides >= self.options.max_slides:
            return decision
        q = np.asarray(pose, dtype=np.float64)
        belief = model.belief
        centers = model.masses.center_of_mass_polygon
        here = self._find_press(q, centers, belief)
        if here is not None:
            reason = f"{decision.reason}; it is weighed where it lies"
            return PreGraspDecision("weigh", reason, press=here.target)
        return self._slide_to_weigh(q, model, belief) or decision

    def suppose_heavier(self) -> "WeighingPlanner":
        """Makes a planner that presses where less force would do.

        It is for an object that did not tilt with the greatest force, so that it is heavier, or its
        center of mass farther inside, than was supposed.
        """
        heavier = copy(self)
        sequence = self.weighing.sequence
        rules = replace(sequence.rules, mass=HEAVIER * sequence.rules.mass)
        heavier.weighing = replace(self.weighing, sequence=replace(sequence, rules=rules))
        return heavier

    @property
    def _top(self) -> float:
        """Height of the object's top, m."""
        return self.obj.height or DEFAULT_TOP

    def _make_rules(self, belief: AbsoluteEstimate) -> PressRules:
        """Makes the rules of a press, which suppose the mass that is known by now."""
        rules = self.weighing.sequence.rules
        return replace(rules, mass=max(belief.total_mass, rules.mass)) if belief.presses else rules

    def _calc_gain(self, belief: AbsoluteEstimate, planned: PlannedPress) -> float:
        """Calculates the share of what is open that a press is expected to take away."""
        options = self.weighing.sequence
        now = calc_open(belief.covariance, options)
        return 1 - calc_left_open(belief, planned, self._make_rules(belief), options) / now

    def _find_press(
        self, pose: Array, centers: Array, belief: AbsoluteEstimate
    ) -> PlannedPress | None:
        """Finds a press where the object lies now (3,); None where none is safe and tells much."""
        rules = self._make_rules(belief)
        for edge in list_edges(self.surface):
            planned = plan_press(self.obj, centers, pose, edge.line, self._top, rules)
            if planned is not None and self._calc_gain(belief, planned) >= self.weighing.min_gain:
                return planned
        return None

    def _slide_to_weigh(
        self, pose: Array, model: UncertainModel, belief: AbsoluteEstimate
    ) -> PreGraspDecision | None:
        """Decides on a push towards where the object can be weighed; None where there is none."""
        goals = self._list_goals(pose, model, belief)
        if not goals:
            return None
        return self._slide(pose, model, goals, "where it can be weighed")

    def _list_goals(
        self, pose: Array, model: UncertainModel, belief: AbsoluteEstimate
    ) -> list[PreGraspGoal]:
        """Lists poses at the edge at which a press tells much, the nearest first."""
        centers = model.masses.center_of_mass_polygon
        rules = self._make_rules(belief)
        middle = pose[:2]
        found: list[PreGraspGoal] = []
        for edge in list_edges(self.surface):
            along = float(edge.line.calc_along(middle))
            along = float(np.clip(along, CORNER_ROOM, max(edge.length - CORNER_ROOM, CORNER_ROOM)))
            for heading in calc_headings(self.obj, edge.line).tolist():
                # Of the headings that are full turns apart, the nearest one is meant.
                theta = float(pose[2] + wrap_angle(heading - pose[2]))
                rests = list_rests(
                    self.obj, centers, theta, edge.line, self._top, rules, along=along
                )
                for planned in rests:
                    if self._calc_gain(belief, planned) >= self.weighing.min_gain:
                        found.append(self._make_goal(pose, planned))
        found.sort(key=lambda goal: goal.travel)
        return found[:MAX_RESTS]

    def _make_goal(self, pose: Array, planned: PlannedPress) -> PreGraspGoal:
        """Makes a goal of a slide of where an object is to be pressed."""
        target = planned.target
        return PreGraspGoal(
            pose=planned.pose,
            part=(*self.parts, *self.flat_parts)[0],
            overhang=target.calc_arm(np.array(target.place)),
            margin=planned.inside,
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

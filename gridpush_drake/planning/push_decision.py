"""One decision of pushing to a goal: whether to go on, and with which push.

Whoever pushes (`push_to_goal` in a simulated world, a controller in a station) looks, asks here, and does as told.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.contact_point import ContactOptions
from gridpush_drake.planning.next_push import HorizonOptions, NextPush, choose_push
from gridpush_drake.planning.planned_push import calc_goal_error
from gridpush_drake.planning.push_caution import Caution, CautionOptions, draw_doubts
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.push_plan import (
    DEFAULT_MAX_PUSHES,
    DEFAULT_TOLERANCE,
    STUCK,
    check_ends,
    check_tolerance,
    judge,
)
from gridpush_drake.planning.way_to_goal import WayToGoal

Array = NDArray[np.float64]

DEFAULT_CAUTION = CautionOptions()
"""How much is doubted, where nothing else is said."""


@dataclass(frozen=True, eq=False)
class GoalRules:
    """How an object is pushed to a goal.

    Attributes:
        constraints: table, obstacles and further rules.
        contact: what pushes may be chosen from.
        horizons: how far ahead to look; one push by default, for the second says little of a model not yet learned.
        caution: how far pushes must be safe though the model may be wrong; None trusts the model.
        tolerance: mean cell error at which the goal counts as reached, m.
        max_pushes: most pushes.

    Raises:
        PlanningError: the tolerance is not positive, or the pushes are fewer than none.
    """

    constraints: PushConstraints = field(default_factory=PushConstraints)
    contact: ContactOptions = field(default_factory=ContactOptions)
    horizons: HorizonOptions = field(default_factory=lambda: HorizonOptions(horizon=1))
    caution: CautionOptions | None = DEFAULT_CAUTION
    tolerance: float = DEFAULT_TOLERANCE
    max_pushes: int = DEFAULT_MAX_PUSHES

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance, self.max_pushes)


@dataclass(frozen=True, eq=False)
class PushDecision:
    """What to do.

    Attributes:
        status: why to end, see `push_plan.REASONS`; None where a push should be made.
        error: mean cell error to the goal now, m.
        chosen: the next push; None where there should be none, or none was looked for.
        way: to the goal, to be given to the next decision; None where the question did not come up.
    """

    status: str | None
    error: float
    chosen: NextPush | None = None
    way: WayToGoal | None = None


def decide_push(
    obj: GridObject,
    pose: Array,
    goal: Array,
    made: int,
    params: CellParameters,
    identification: Identification | None,
    rules: GoalRules,
    way: WayToGoal | None = None,
) -> PushDecision:
    """Decides on the next push.

    Args:
        obj: the object.
        pose: (3,) q_W where it lies, m and rad.
        goal: (3,) where it should.
        made: pushes so far.
        params: the model.
        identification: that the model comes from; None where nothing was learned.
        rules: how to push.
        way: of the decision before, to the same goal by the same rules; None where there was none.

    Returns:
        The decision.

    Raises:
        PlanningError: the finger fits nowhere on the outline.
    """
    error = float(calc_goal_error(obj, pose, goal))
    bad = check_ends(obj, pose, goal, rules.constraints, rules.contact.radius)
    if bad is not None:
        return PushDecision(bad, error)
    # what was looked for from where the object lay before may not say how to go on from where somebody put it
    if way is None or way.direct or not np.isfinite(way.calc_cost(pose)):
        way = WayToGoal(obj, pose, goal, rules.constraints.start_at(obj, pose, rules.contact.radius))
    status = judge(obj, pose, way, made, rules.tolerance, rules.max_pushes)
    if status is not None:
        return PushDecision(status, error, way=way)
    caution = None
    if rules.caution is not None:
        doubts = draw_doubts(obj, params, identification, rules.caution)
        caution = Caution(obj, [params, *doubts], rules.constraints, rules.contact, rules.caution)
    chosen = choose_push(
        obj, params, pose, way, rules.tolerance, rules.constraints, rules.contact, rules.horizons, caution
    )
    return PushDecision(STUCK if chosen.push is None else None, error, chosen, way)


def forbid(rules: GoalRules, refused: tuple[Array, ...], apart: float, turned: float) -> GoalRules:
    """The rules without pushes like some that were refused.

    Args:
        rules: the rules.
        refused: of each such push (4,): where it began, W, m, and its unit direction.
        apart: m between the beginnings of pushes that are not alike.
        turned: rad between their directions.

    Returns:
        The rules, with a push rule that asks this first.
    """
    if not refused:
        return rules
    before = rules.constraints

    def allow(push: Push) -> bool:
        towards = push.velocity / np.linalg.norm(push.velocity)
        alike = any(
            np.linalg.norm(push.start - one[:2]) < apart and towards @ one[2:] > np.cos(turned) for one in refused
        )
        return not alike and before.allows_push(push)

    return replace(rules, constraints=replace(before, push_rule=allow))

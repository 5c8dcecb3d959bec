"""One decision on the way to a goal: to push, and how, or to end.

`push_to_goal_loop` decides so whenever the object lies still.
"""

from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.goal.next_push import (
    GoalRules,
    NextPush,
    Robustness,
    choose_push,
    draw_model_samples,
)
from gridpush_drake.planning.goal.push_plan import PushPlanStatus, check_ends, find_stop_reason

ALIKE_DISTANCE = 0.01
"""A push that begins nearer than this to one that was refused, m, in a direction that differs by
less than `ALIKE_TURN`, is not tried."""

ALIKE_TURN = 0.2
"""Difference of direction below which two pushes may be alike, rad; see `ALIKE_DISTANCE`."""


@dataclass(frozen=True, eq=False)
class PushDecision:
    """What to do next.

    Attributes:
        status: why to end, see `push_plan.REASONS`; None where a push should be made.
        error: mean cell error to the goal now, m.
        chosen: the next push; None where there should be none, or none was searched for.
        cost_to_go: to be given to the next decision; None where it was not needed.
    """

    status: PushPlanStatus | None
    error: float
    chosen: NextPush | None = None
    cost_to_go: CostToGo | None = None


def decide_push(
    model: Model,
    pose: Array,
    goal: Array,
    made: int,
    identification: Identification | None,
    rules: GoalRules,
    cost_to_go: CostToGo | None = None,
) -> PushDecision:
    """Decides on the next push of an object.

    Args:
        model: one object, with its parameters.
        pose: (3,) where it lies, X_WB, m and rad.
        goal: (3,) where it should get to, X_WB, m and rad.
        made: number of pushes made so far.
        identification: that the model comes from; None where nothing was learned.
        rules: how it is pushed.
        cost_to_go: of the decision before, to the same goal by the same rules; None where there was
            none.

    Raises:
        PlanningError: the finger fits nowhere on the outline.
    """
    obj = model.obj
    error = float(calc_goal_error(obj, pose, goal))
    radius = rules.contact.pusher.choose_reach(obj)
    status = check_ends(obj, pose, goal, rules.constraints, radius)
    if status is not None:
        return PushDecision(status, error)
    # A lattice that was made for where the object lay before may not say how to go on from where
    # somebody put it.
    if cost_to_go is None or cost_to_go.direct or not np.isfinite(cost_to_go.calc_cost(pose)):
        checker = rules.constraints.start_at(obj, pose, radius)
        cost_to_go = CostToGo(obj, pose, goal, checker)
    status = find_stop_reason(obj, pose, cost_to_go, made, rules)
    if status is not None:
        return PushDecision(status, error, cost_to_go=cost_to_go)
    robustness = None
    if rules.robustness is not None:
        samples = draw_model_samples(model, identification, rules.robustness)
        robustness = Robustness(
            obj=obj,
            models=[model.params, *samples],
            constraints=rules.constraints,
            contact=rules.contact,
            options=rules.robustness,
            learned=identification is not None,
        )
    chosen = choose_push(model, pose, cost_to_go, rules, robustness)
    status = PushPlanStatus.STUCK if chosen.push is None else None
    return PushDecision(status, error, chosen, cost_to_go)


def forbid(rules: GoalRules, refused: tuple[Push, ...]) -> GoalRules:
    """Makes rules that also forbid whatever is like one of the pushes that were refused."""
    if not refused:
        return rules
    before = rules.constraints

    def allow(push: Push) -> bool:
        direction = _calc_direction(push)
        alike = any(
            np.linalg.norm(push.start - one.start) < ALIKE_DISTANCE
            and direction @ _calc_direction(one) > np.cos(ALIKE_TURN)
            for one in refused
        )
        return not alike and before.allows_push(push)

    return replace(rules, constraints=replace(before, push_rule=allow))


def _calc_direction(push: Push) -> Array:
    """The unit vector (2,) of a push's motion, W."""
    return np.asarray(push.velocity / np.linalg.norm(push.velocity))

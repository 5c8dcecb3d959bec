"""Pushing an object to a goal pose in a simulated world, learning on the way: `push_to_goal`.

It steps `PushToGoalLoop` (`push_to_goal_loop`), which controllers step on a robot. A whole sequence
by the model alone is planned by `push_plan`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import nan

from numpy.typing import ArrayLike

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.closed_loop import FAILED_MODE, LOST_MODE, LoopOptions
from gridpush_drake.planning.contact.trial import PlannedPush, calc_goal_error
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_to_goal_loop import (
    ContactPointMode,
    PushToGoalLoop,
    PushToGoalState,
)
from gridpush_drake.planning.loop_run import Learner, run_loop
from gridpush_drake.planning.world import PushWorld
from gridpush_drake.pushes.push_log import ObservedPush, PushLog


@dataclass(frozen=True, eq=False)
class PushRound:
    """One round: what was planned, what happened, and whether it was learned from.

    Attributes:
        planned: the push with its predicted end.
        seen: what happened.
        prediction_error: mean cell distance between predicted and seen end, m; NaN where the end
            was not seen.
        learned: whether the model was learned anew after it.
    """

    planned: PlannedPush
    seen: ObservedPush
    prediction_error: float
    learned: bool


@dataclass(frozen=True, eq=False)
class PushRun:
    """The result of pushing an object to a goal.

    Attributes:
        goal: (3,) the goal pose, X_WB, m and rad.
        steps: the rounds, in order.
        status: "reached", "lost", or why it ended: see `push_plan.REASONS`; "error" where no push
            could be planned.
        reason: the status in a sentence.
        error: mean cell error where the object was last seen at rest, m; NaN where it never was.
        params: the last model.
        identification: identification from which `params` came; None where nothing was learned.
        simulations: number of pushes simulated by the planner.
        planning_seconds: wall-clock time of planning, s.
        learning_seconds: wall-clock time of learning, s.
    """

    goal: Array
    steps: tuple[PushRound, ...]
    status: str
    reason: str
    error: float
    params: CellParameters
    identification: Identification | None
    simulations: int
    planning_seconds: float
    learning_seconds: float

    @property
    def log(self) -> PushLog:
        """The pushes that were made."""
        return PushLog(tuple(step.seen for step in self.steps), source="pushing to a goal")


ONE_OBSERVATION = LoopOptions(observations=1, timeout=0.15)
"""Options for a world in which nothing moves between two pushes: one observation is enough for a
decision."""


def push_to_goal(
    world: PushWorld,
    model: Model,
    goal: ArrayLike,
    rules: GoalRules | None = None,
    *,
    learner: Learner | None = Learner(),  # noqa: B008
    options: LoopOptions = ONE_OBSERVATION,
    progress: Callable[[PushRound], None] | None = None,
) -> PushRun:
    """Pushes an object to a goal in a world, seeing it after every push, and learning on the way.

    An object that was moved by somebody else between pushes is pushed from where it then lies.

    Args:
        world: where the object lies, and pushes are carried out.
        model: one object, with its parameters.
        goal: (3,) the goal pose, X_WB, m and rad.
        rules: how it is pushed.
        learner: learns after every push that does not reach the goal; None never.
        options: how the loop observes, and when it gives up.
        progress: called after every push.

    Raises:
        PlanningError: an argument is out of range.
    """
    obj = model.obj
    aim = check_vector(PlanningError, "goal", goal, 3)
    steps: list[PushRound] = []
    loop = PushToGoalLoop(model, rules, options)

    def learn(
        obj: GridObject, log: PushLog, before: Identification | None
    ) -> Identification | None:
        seen = log[-1]
        reached = False
        if len(seen.t_observed):
            reached = bool(calc_goal_error(obj, seen.final_pose, aim) <= loop.rules.tolerance)
        return before if learner is None or reached else learner(obj, log, before)

    def note(state: PushToGoalState, seen: ObservedPush, learned: bool) -> None:
        assert state.planned is not None
        error = nan
        if len(seen.t_observed):
            error = float(calc_goal_error(obj, seen.final_pose, state.planned.pose))
        steps.append(PushRound(state.planned, seen, error, learned))
        if progress is not None:
            progress(steps[-1])

    def is_over(state: PushToGoalState) -> bool:
        return state.status.mode in (ContactPointMode.REACHED, FAILED_MODE, LOST_MODE)

    run = run_loop(loop, world, is_over, obj=obj, learn=learn, goal=aim, progress=note)
    status = run.state.status
    found = run.identification
    return PushRun(
        goal=aim,
        steps=tuple(steps),
        status=status.cause or status.mode.value,
        reason=status.reason,
        error=status.error,
        params=(found or loop.model).params,
        identification=found,
        simulations=run.state.simulations,
        planning_seconds=run.planning_seconds,
        learning_seconds=run.learning_seconds,
    )

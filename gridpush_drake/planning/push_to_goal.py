"""Pushing to a goal pose in a world that is not the model: look, choose a push, make it, learn from it, look again."""

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.errors import PlanningError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.contact_point import ContactOptions, check_pose
from gridpush_drake.planning.next_push import HorizonOptions, NextPush
from gridpush_drake.planning.planned_push import PlannedPush, calc_goal_error
from gridpush_drake.planning.push_caution import CautionOptions
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.push_decision import DEFAULT_CAUTION, GoalRules, decide_push
from gridpush_drake.planning.push_learner import Learner, LearningOptions
from gridpush_drake.planning.push_plan import DEFAULT_MAX_PUSHES, DEFAULT_TOLERANCE, REASONS
from gridpush_drake.planning.push_world import PushWorld
from gridpush_drake.planning.way_to_goal import WayToGoal
from gridpush_drake.pushes.log import ObservedPush, PushLog

Array = NDArray[np.float64]
Progress = Callable[["PushStep"], None]

DEFAULT_LEARNING = LearningOptions()
"""When to learn, where nothing else is said."""

LOST = "lost"
LOST_REASON = "The object is not seen any more: it has fallen, or something hides it."


@dataclass(frozen=True, eq=False)
class PushStep:
    """One round: what was planned, what happened, and what it was learned with.

    Attributes:
        planned: the push with its predicted end.
        seen: what happened.
        way: what was expected to be left to go after it, m.
        prediction_error: mean cell distance between predicted and seen end, m.
        goal_error: mean cell error to the goal at the seen end, m.
        horizon: of the search that the push came from.
        learned: whether the model was learned anew after it.
    """

    planned: PlannedPush
    seen: ObservedPush
    way: float
    prediction_error: float
    goal_error: float
    horizon: int
    learned: bool


@dataclass(frozen=True, eq=False)
class PushRun:
    """What came of pushing to a goal.

    Attributes:
        goal: (3,).
        steps: the rounds, in order.
        status: "reached", "lost", or why it ended: see `push_plan.REASONS`.
        reason: the same in a sentence.
        error: mean cell error at the last seen pose, m; NaN where none was seen.
        params: the last model.
        identification: it came from; None where nothing was learned.
        simulations: pushes simulated by the planner.
        planning_seconds: wall-clock time.
        learning_seconds: wall-clock time.
    """

    goal: Array
    steps: tuple[PushStep, ...]
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


def push_to_goal(
    world: PushWorld,
    obj: GridObject,
    goal: ArrayLike,
    *,
    params: CellParameters | None = None,
    learning: LearningOptions | None = DEFAULT_LEARNING,
    constraints: PushConstraints | None = None,
    options: ContactOptions | None = None,
    horizons: HorizonOptions | None = None,
    caution: CautionOptions | None = DEFAULT_CAUTION,
    tolerance: float = DEFAULT_TOLERANCE,
    max_pushes: int = DEFAULT_MAX_PUSHES,
    patience: int = 3,
    progress: Progress | None = None,
) -> PushRun:
    """Pushes an object to a goal pose, looking after every push, and learning on the way.

    Args:
        world: that carries out pushes.
        obj: the object.
        goal: (3,) where it should lie, m and rad.
        params: the model to begin with; uniform by the object's prior where None.
        learning: when to learn; None never.
        constraints: table, obstacles and further rules; none by default.
        options: what pushes may be chosen from.
        horizons: how far ahead to look; one push where None, for the second says little of a model not yet learned.
        caution: how far pushes must be safe though the model may be wrong; None trusts the model.
        tolerance: mean cell error at which the goal counts as reached, m.
        max_pushes: most pushes.
        patience: how often in a row to look for an object that is not seen before it counts as lost.
        progress: called after every push.

    Returns:
        What came of it. An object that was moved by somebody else between pushes is pushed from where it then lies.

    Raises:
        PlanningError: an argument is out of range.
    """
    if patience < 1:
        raise PlanningError(f"patience is {patience!r}; expected at least 1")
    rules = GoalRules(
        constraints or PushConstraints(), options or ContactOptions(), horizons or HorizonOptions(horizon=1), caution,
        tolerance, max_pushes,
    )  # fmt: skip
    learner = Learner(obj, params or CellParameters.uniform(obj), learning)
    drive = _Drive(world, obj, check_pose("goal", goal), learner, rules, patience)
    status: str | None = None
    while status is None:
        made = len(drive.steps)
        status = drive.go_on()
        if progress is not None and len(drive.steps) > made:
            progress(drive.steps[-1])
    return drive.finish(status)


@dataclass(eq=False)
class _Drive:
    """Pushing to a goal, round by round; see `push_to_goal` for what it is made of."""

    world: PushWorld
    obj: GridObject
    goal: Array
    learner: Learner
    rules: GoalRules
    patience: int
    steps: list[PushStep] = field(default_factory=list)
    simulations: int = 0
    seconds: float = 0.0
    error: float = float("nan")
    way: WayToGoal | None = None

    def go_on(self) -> str | None:
        """Looks, and where the goal is not reached makes one more push; why it ended, or None where it goes on."""
        q = _look(self.world, self.patience)
        if q is None:
            return LOST
        begin = perf_counter()
        decision = decide_push(
            self.obj, q, self.goal, len(self.steps), self.learner.params, self.learner.identification, self.rules,
            self.way,
        )  # fmt: skip
        self.seconds += perf_counter() - begin
        self.error, self.way = decision.error, decision.way
        if decision.chosen is not None:
            self.simulations += decision.chosen.simulations
        if decision.chosen is not None and decision.chosen.push is not None:
            self._make(decision.chosen, decision.chosen.push)
        return decision.status

    def _make(self, decision: NextPush, planned: PlannedPush) -> None:
        """Makes a push, and learns from it unless the goal is reached."""
        seen = self.world.execute(planned.push)
        off = after = float("nan")
        if len(seen.t_observed):
            off = float(calc_goal_error(self.obj, seen.final_pose, planned.pose))
            after = float(calc_goal_error(self.obj, seen.final_pose, self.goal))
        learned = not after <= self.rules.tolerance and self.learner.take(seen, off)
        self.steps.append(PushStep(planned, seen, decision.way, off, after, decision.horizon, learned))

    def finish(self, status: str) -> PushRun:
        """What came of it."""
        reason = LOST_REASON if status == LOST else REASONS[status]
        return PushRun(
            self.goal, tuple(self.steps), status, reason, self.error, self.learner.params, self.learner.identification,
            self.simulations, self.seconds, self.learner.seconds,
        )  # fmt: skip


def _look(world: PushWorld, patience: int) -> Array | None:
    for _ in range(patience):
        q = world.pose
        if q is not None:
            return check_pose("pose", q)
    return None

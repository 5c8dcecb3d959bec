"""A sequence of pushes to a goal pose, by the model alone."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Point

from gridpush_drake.errors import PlanningError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.planning.contact_point import ContactOptions, check_pose
from gridpush_drake.planning.next_push import HorizonOptions, choose_push
from gridpush_drake.planning.planned_push import PlannedPush, calc_goal_error
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.way_to_goal import WayToGoal

Array = NDArray[np.float64]

REACHED = "reached"
GOAL_OFF_TABLE, START_OFF_TABLE = "goal_off_table", "start_off_table"
GOAL_BLOCKED, START_BLOCKED = "goal_blocked", "start_blocked"
GOAL_OUT_OF_REACH = "goal_out_of_reach"
NO_WAY, STUCK, TOO_MANY_PUSHES = "no_way", "stuck", "too_many_pushes"

REASONS = {
    REACHED: "The object is at the goal, within the tolerance.",
    GOAL_OFF_TABLE: "At the goal pose the object hangs over the table's edge further than it may.",
    START_OFF_TABLE: "Where the object lies, its centre is not over the table.",
    GOAL_BLOCKED: "At the goal pose the object touches an obstacle, or is nearer to one than it may be.",
    GOAL_OUT_OF_REACH: "At the goal pose the finger does not come to the object.",
    START_BLOCKED: "Where the object lies, it overlaps an obstacle.",
    NO_WAY: "There is no way to the goal for the object between the obstacles and the table's edges.",
    STUCK: "No push that the finger can make brings the object nearer to the goal.",
    TOO_MANY_PUSHES: "The goal was not reached within the pushes that were allowed.",
}
"""What each status means, in a sentence."""

DEFAULT_TOLERANCE = 0.02
"""Mean cell error at which a goal counts as reached, m: the paper's."""

DEFAULT_MAX_PUSHES = 25


@dataclass(frozen=True, eq=False)
class PushPlan:
    """A sequence of pushes, each from where the one before is predicted to end.

    Attributes:
        start: (3,) q_W at the beginning.
        goal: (3,).
        pushes: in order; as far as they get, where the goal is not reached.
        status: "reached", or why not: see REASONS.
        reason: the same in a sentence.
        error: predicted mean cell error at the end, m.
        errors: (pushes,) the same after each push; a push that goes round something may make it greater.
        simulations: simulated pushes.
        seconds: wall-clock time.
    """

    start: Array
    goal: Array
    pushes: tuple[PlannedPush, ...]
    status: str
    reason: str
    error: float
    errors: Array
    simulations: int
    seconds: float

    @property
    def reached(self) -> bool:
        """Whether the plan ends at the goal."""
        return self.status == REACHED

    @property
    def poses(self) -> Array:
        """(pushes + 1, 3) the start and the predicted pose after each push."""
        return np.array([self.start, *(push.pose for push in self.pushes)])


def plan_pushes(
    obj: GridObject,
    params: CellParameters,
    pose: ArrayLike,
    goal: ArrayLike,
    *,
    constraints: PushConstraints | None = None,
    options: ContactOptions | None = None,
    horizons: HorizonOptions | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    max_pushes: int = DEFAULT_MAX_PUSHES,
) -> PushPlan:
    """Plans pushes that bring an object to a goal pose, trusting the model.

    Args:
        obj: the object.
        params: its model.
        pose: (3,) q_W where it lies, m and rad.
        goal: (3,) where it should.
        constraints: table, obstacles and further rules; none by default.
        options: what pushes may be chosen from.
        horizons: how far ahead to look.
        tolerance: mean cell error at which the goal counts as reached, m.
        max_pushes: most pushes.

    Returns:
        The plan; its `status` says whether it gets there, and if not why.

    Raises:
        PlanningError: an argument is out of range.
    """
    begin = perf_counter()
    constraints, options = constraints or PushConstraints(), options or ContactOptions()
    horizons = horizons or HorizonOptions()
    q, aim = check_pose("pose", pose), check_pose("goal", goal)
    check_tolerance(tolerance, max_pushes)
    pushes: list[PlannedPush] = []
    simulations, start = 0, q
    status = check_ends(obj, q, aim, constraints, options.radius)
    way = WayToGoal(obj, q, aim, constraints.start_at(obj, q, options.radius)) if status is None else None
    while status is None and way is not None:
        status = judge(obj, q, way, len(pushes), tolerance, max_pushes)
        if status is not None:
            break
        decision = choose_push(obj, params, q, way, tolerance, constraints, options, horizons)
        simulations += decision.simulations
        if decision.push is None:
            status = STUCK
            break
        pushes.append(decision.push)
        q = decision.push.pose
    assert status is not None
    errors = calc_goal_error(obj, np.array([start, *(push.pose for push in pushes)]), aim)
    return PushPlan(
        start, aim, tuple(pushes), status, REASONS[status], float(errors[-1]), errors[1:], simulations,
        perf_counter() - begin,
    )  # fmt: skip


def judge(obj: GridObject, pose: Array, way: WayToGoal, made: int, tolerance: float, max_pushes: int) -> str | None:
    """Why a sequence should end at `pose` after `made` pushes; None where it should go on."""
    if float(calc_goal_error(obj, pose, way.goal)) <= tolerance:
        return REACHED
    if made >= max_pushes:
        return TOO_MANY_PUSHES
    return None if np.isfinite(way.calc_cost(pose)) else NO_WAY


def check_ends(obj: GridObject, start: Array, goal: Array, constraints: PushConstraints, radius: float) -> str | None:
    """Why the object cannot lie at the goal, or does not lie properly at the start, by the rules; None where it can."""
    checker = constraints.start_at(obj, start, radius)
    if constraints.surface is not None:
        centre = Point(obj.cells_at(start).mean(axis=0))
        if not constraints.surface.polygon.covers(centre):
            return START_OFF_TABLE
    if checker.overlaps_obstacle(start):
        return START_BLOCKED
    table, blocked = constraints.allow_pose(obj, goal)
    if not table:
        return GOAL_OFF_TABLE
    if blocked:
        return GOAL_BLOCKED
    region = constraints.finger_region
    if region is not None and region.distance(checker.place(goal[None])[0]) > radius:
        return GOAL_OUT_OF_REACH
    return None


def check_tolerance(tolerance: float, max_pushes: int) -> None:
    """Raises PlanningError where the tolerance is not positive, or the pushes are fewer than none."""
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise PlanningError(f"tolerance is {tolerance!r}; expected a positive number (m)")
    if max_pushes < 0:
        raise PlanningError(f"max_pushes is {max_pushes!r}; expected 0 or more")

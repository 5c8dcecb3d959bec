"""A sequence of pushes to a goal pose, by the model alone.

A push plan as a YAML file, and as the document that it holds.
"""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from shapely import Point

from gridpush_drake.errors import PlanningError
from gridpush_drake.files import write_whole
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.notebook import (
    MM,
    count,
    describe_pose,
    draw_paths,
    make_page,
    make_table,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import PlannedPush, calc_goal_error
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.goal.next_push import GoalRules, choose_push
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import find_supported
from gridpush_drake.yaml_file import dump_yaml


class PushPlanStatus(StrEnum):
    """How a sequence of pushes ends; see REASONS."""

    REACHED = "reached"
    GOAL_OFF_TABLE = "goal_off_table"
    START_OFF_TABLE = "start_off_table"
    GOAL_BLOCKED = "goal_blocked"
    START_BLOCKED = "start_blocked"
    GOAL_OUT_OF_REACH = "goal_out_of_reach"
    NO_PATH = "no_path"
    STUCK = "stuck"
    TOO_MANY_PUSHES = "too_many_pushes"


REASONS = {
    PushPlanStatus.REACHED: "The object is at the goal, within the tolerance.",
    PushPlanStatus.GOAL_OFF_TABLE: "At the goal pose the object hangs over the table's edge further than it may.",
    PushPlanStatus.START_OFF_TABLE: "Where the object lies, its center is not over the table.",
    PushPlanStatus.GOAL_BLOCKED: "At the goal pose the object touches an obstacle, or is nearer to one than it may be.",
    PushPlanStatus.GOAL_OUT_OF_REACH: "At the goal pose the finger does not come to the object.",
    PushPlanStatus.START_BLOCKED: "Where the object lies, it overlaps an obstacle.",
    PushPlanStatus.NO_PATH: "There is no path to the goal for the object between the obstacles and the table's edges.",
    PushPlanStatus.STUCK: "No push that the finger can make brings the object nearer to the goal.",
    PushPlanStatus.TOO_MANY_PUSHES: "The goal was not reached within the pushes that were allowed.",
}
"""What each status means, in a sentence."""

LOOK_AHEAD = GoalRules(horizon=2)  # rules of a plan that trusts its model


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
    status: PushPlanStatus
    reason: str
    error: float
    errors: Array
    simulations: int
    seconds: float

    def __repr__(self) -> str:
        """Status, pushes and what is left, in two lines."""
        pushes = (
            f"{count(len(self.pushes), 'push')}, {self.error * MM:.1f} mm from the goal at the end"
        )
        return f"PushPlan, {self.status}: {pushes}\n{self.reason}"

    def _repr_html_(self) -> str:
        """A row a push, and the path that the object is predicted to take."""
        rows = [
            (number, f"{each.distance * MM:.0f}", describe_pose(each.pose), f"{error * MM:.1f}")
            for number, (each, error) in enumerate(
                zip(self.pushes, self.errors, strict=True), start=1
            )
        ]
        heads = ("push", "path, mm", "the object afterwards", "left to go, mm")
        path = draw_paths([(self.poses[:, :2], "teal", "object's body frame, push by push")])
        return make_page(repr(self), path, make_table(heads, rows))

    @property
    def reached(self) -> bool:
        """Whether the plan ends at the goal."""
        return self.status == PushPlanStatus.REACHED

    @property
    def poses(self) -> Array:
        """(pushes + 1, 3) the start and the predicted pose after each push."""
        return np.array([self.start, *(push.pose for push in self.pushes)])


def plan_pushes(
    obj: GridObject,
    params: CellParameters,
    pose: ArrayLike,
    goal: ArrayLike,
    rules: GoalRules = LOOK_AHEAD,
) -> PushPlan:
    """Plans pushes that bring an object from `pose` (3,) to `goal` (3,), m and rad, trusting the model.

    Returns:
        The plan; its `status` says whether it gets there, and if not why. The rules' robustness is not asked for.

    Raises:
        PlanningError: an argument is out of range.
    """
    begin = perf_counter()
    q, aim = (
        check_vector(PlanningError, "pose", pose, 3),
        check_vector(PlanningError, "goal", goal, 3),
    )
    pushes: list[PlannedPush] = []
    simulations, start = 0, q
    status = check_ends(obj, q, aim, rules.constraints, rules.contact.radius)
    cost_to_go = (
        CostToGo(obj, q, aim, rules.constraints.start_at(obj, q, rules.contact.radius))
        if not status
        else None
    )
    while status is None and cost_to_go is not None:
        status = find_stop_reason(obj, q, cost_to_go, len(pushes), rules)
        if status is not None:
            break
        decision = choose_push(obj, params, q, cost_to_go, rules)
        simulations += decision.simulations
        if decision.push is None:
            status = PushPlanStatus.STUCK
            break
        pushes.append(decision.push)
        q = decision.push.pose
    assert status is not None
    errors = calc_goal_error(obj, np.array([start, *(push.pose for push in pushes)]), aim)
    return PushPlan(
        start, aim, tuple(pushes), status, REASONS[status], float(errors[-1]), errors[1:], simulations,
        perf_counter() - begin,
    )  # fmt: skip


def find_stop_reason(
    obj: GridObject, pose: Array, cost_to_go: CostToGo, made: int, rules: GoalRules
) -> PushPlanStatus | None:
    """Why a sequence should end at `pose` after `made` pushes; None where it should go on."""
    if float(calc_goal_error(obj, pose, cost_to_go.goal)) <= rules.tolerance:
        return PushPlanStatus.REACHED
    if made >= rules.max_pushes:
        return PushPlanStatus.TOO_MANY_PUSHES
    return None if np.isfinite(cost_to_go.calc_cost(pose)) else PushPlanStatus.NO_PATH


def check_ends(
    obj: GridObject, start: Array, goal: Array, constraints: PushConstraints, radius: float
) -> PushPlanStatus | None:
    """Why the object cannot lie at the goal, or does not lie properly at the start, by the rules; None where it can."""
    checker = constraints.start_at(obj, start, radius)
    if constraints.surface is not None:
        center = Point(obj.cells_at(start).mean(axis=0))
        if not constraints.surface.polygon.covers(center):
            return PushPlanStatus.START_OFF_TABLE
    if checker.overlaps_obstacle(start):
        return PushPlanStatus.START_BLOCKED
    table, blocked = constraints.allow_pose(obj, goal)
    if not table or (
        constraints.surface and not find_supported(obj, goal, constraints.surface).any()
    ):
        return PushPlanStatus.GOAL_OFF_TABLE
    if blocked:
        return PushPlanStatus.GOAL_BLOCKED
    region = constraints.finger_region
    if region is not None and region.distance(checker.place(goal[None])[0]) > radius:
        return PushPlanStatus.GOAL_OUT_OF_REACH
    return None


FORMAT_VERSION = 1

HEADER = """\
# Pushes that bring an object to a goal pose, planned by gridpush.
# SI units, radians, world frame; `start` is the place of the pusher's center, `pose` the object's predicted pose after
# the push (x, y, theta), `error` the mean distance of the object's cells from where they are at the goal.
"""

LINE_WIDTH = 120


def describe_plan(plan: PushPlan, name: str, radius: float) -> dict[str, Any]:
    """A plan as plain lists and numbers; `radius` is the pusher's, m."""
    return {
        "gridpush_plan": FORMAT_VERSION,
        "object": name,
        "status": plan.status.value,
        "reason": plan.reason,
        "start": plan.start.tolist(),
        "goal": plan.goal.tolist(),
        "error": plan.error,
        "simulations": plan.simulations,
        "pusher_radius": radius,
        "pushes": [
            {
                "start": planned.push.start.tolist(),
                "velocity": planned.push.velocity.tolist(),
                "duration": planned.push.duration,
                "arc_length": planned.arc_length,
                "angle": planned.angle,
                "distance": planned.distance,
                "pose": planned.pose.tolist(),
                "error": float(error),
            }
            for planned, error in zip(plan.pushes, plan.errors, strict=True)
        ],
    }


def write_plan(
    path: Path | str, plan: PushPlan, name: str, radius: float, force: bool = False
) -> None:
    """Writes a plan. Raises OutputError where the file exists and `force` is not set, or it cannot be written."""
    document = describe_plan(plan, name, radius)
    text = dump_yaml(document, default_flow_style=None, width=LINE_WIDTH)
    write_whole(path, HEADER + text, force)

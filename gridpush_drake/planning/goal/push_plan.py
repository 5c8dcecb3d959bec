"""A sequence of pushes to a goal pose, by the model alone; and its YAML file.

`plan_pushes` makes the sequence: each push begins where the one before is predicted to end. For
pushes that are made, seen and learned from one by one, see `push_to_goal`.
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
from gridpush_drake.identification.model import Model
from gridpush_drake.notebook import count, describe_pose, draw_paths, make_page, make_table
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import PlannedPush, calc_goal_error
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.goal.next_push import GoalRules, choose_push
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import find_supported
from gridpush_drake.pushes.push_csv import describe_pusher
from gridpush_drake.units import MM_PER_M
from gridpush_drake.yaml_file import dump_yaml


class PushPlanStatus(StrEnum):
    """How a sequence of pushes ends; `STATUS_SENTENCES` says what each status means."""

    REACHED = "reached"
    GOAL_OFF_TABLE = "goal_off_table"
    START_OFF_TABLE = "start_off_table"
    GOAL_BLOCKED = "goal_blocked"
    START_BLOCKED = "start_blocked"
    GOAL_OUT_OF_REACH = "goal_out_of_reach"
    NO_PATH = "no_path"
    STUCK = "stuck"
    TOO_MANY_PUSHES = "too_many_pushes"


STATUS_SENTENCES = {
    PushPlanStatus.REACHED: "The object is at the goal, within the tolerance.",
    PushPlanStatus.GOAL_OFF_TABLE: (
        "At the goal pose the object hangs over the table's edge further than it may."
    ),
    PushPlanStatus.START_OFF_TABLE: "Where the object lies, its center is not over the table.",
    PushPlanStatus.GOAL_BLOCKED: (
        "At the goal pose the object touches an obstacle, or is nearer to one than it may be."
    ),
    PushPlanStatus.GOAL_OUT_OF_REACH: "At the goal pose the finger does not come to the object.",
    PushPlanStatus.START_BLOCKED: "Where the object lies, it overlaps an obstacle.",
    PushPlanStatus.NO_PATH: (
        "There is no path to the goal for the object between the obstacles and the table's edges."
    ),
    PushPlanStatus.STUCK: "No push that the finger can make brings the object nearer to the goal.",
    PushPlanStatus.TOO_MANY_PUSHES: "The goal was not reached within the pushes that were allowed.",
}
"""What each status means, in a sentence."""

LOOK_AHEAD = GoalRules(horizon=2)
"""Rules of a plan that trusts its model: it looks two pushes ahead."""


@dataclass(frozen=True, eq=False)
class PushPlan:
    """A sequence of pushes, each from where the one before is predicted to end.

    Attributes:
        start: (3,) pose at the beginning, X_WB, m and rad.
        goal: (3,) pose to get to, X_WB, m and rad.
        pushes: in order; as far as they get, where the goal is not reached.
        status: "reached", or why not: see `STATUS_SENTENCES`.
        reason: the status in a sentence.
        error: predicted mean cell error at the end, m.
        errors: (pushes,) predicted mean cell error after each push, m. It may grow in a push that
            goes round something.
        simulations: number of simulated pushes.
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
        pushes = count(len(self.pushes), "push")
        left = f"{self.error * MM_PER_M:.1f} mm from the goal at the end"
        return f"PushPlan, {self.status}: {pushes}, {left}\n{self.reason}"

    def _repr_html_(self) -> str:
        """A table with a row for each push, and a drawing of the predicted path."""
        rows = [
            (
                number,
                f"{each.distance * MM_PER_M:.0f}",
                describe_pose(each.pose),
                f"{error * MM_PER_M:.1f}",
            )
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
        """(pushes + 1, 3) the start and the predicted pose after each push, X_WB, m and rad."""
        return np.array([self.start, *(push.pose for push in self.pushes)])


def plan_pushes(
    model: Model,
    pose: ArrayLike,
    goal: ArrayLike,
    rules: GoalRules = LOOK_AHEAD,
) -> PushPlan:
    """Plans pushes that bring an object to a goal, trusting the model.

    Args:
        model: one object, with its parameters.
        pose: (3,) where it lies, X_WB, m and rad.
        goal: (3,) where it should get to, X_WB, m and rad.
        rules: how it is pushed; their robustness is not used.

    Returns:
        The plan; its `status` says whether it gets there, and if not why.

    Raises:
        PlanningError: an argument is out of range.
    """
    obj = model.obj
    begin = perf_counter()
    start = check_vector(PlanningError, "pose", pose, 3)
    aim = check_vector(PlanningError, "goal", goal, 3)
    pushes: list[PlannedPush] = []
    simulations = 0
    radius = rules.contact.pusher.choose_reach(obj)
    status = check_ends(obj, start, aim, rules.constraints, radius)
    if status is None:
        checker = rules.constraints.start_at(obj, start, radius)
        cost_to_go = CostToGo(obj, start, aim, checker)
        q = start
        while True:
            status = find_stop_reason(obj, q, cost_to_go, len(pushes), rules)
            if status is not None:
                break
            decision = choose_push(model, q, cost_to_go, rules)
            simulations += decision.simulations
            if decision.push is None:
                status = PushPlanStatus.STUCK
                break
            pushes.append(decision.push)
            q = decision.push.pose
    errors = calc_goal_error(obj, np.array([start, *(push.pose for push in pushes)]), aim)
    return PushPlan(
        start=start,
        goal=aim,
        pushes=tuple(pushes),
        status=status,
        reason=STATUS_SENTENCES[status],
        error=float(errors[-1]),
        errors=errors[1:],
        simulations=simulations,
        seconds=perf_counter() - begin,
    )


def find_stop_reason(
    obj: GridObject, pose: Array, cost_to_go: CostToGo, made: int, rules: GoalRules
) -> PushPlanStatus | None:
    """Finds why a sequence should end at `pose` (3,) after `made` pushes; None to go on."""
    if float(calc_goal_error(obj, pose, cost_to_go.goal)) <= rules.tolerance:
        return PushPlanStatus.REACHED
    if made >= rules.max_pushes:
        return PushPlanStatus.TOO_MANY_PUSHES
    if not np.isfinite(cost_to_go.calc_cost(pose)):
        return PushPlanStatus.NO_PATH
    return None


def check_ends(
    obj: GridObject, start: Array, goal: Array, constraints: PushConstraints, radius: float
) -> PushPlanStatus | None:
    """Checks that the object may lie at both ends of its way.

    Args:
        obj: the object.
        start: (3,) where it lies, X_WB, m and rad.
        goal: (3,) where it should get to, X_WB, m and rad.
        constraints: the rules.
        radius: of the finger, m.

    Returns:
        Why the object cannot lie at the goal, or does not lie properly at the start; None where it
        can and does.
    """
    checker = constraints.start_at(obj, start, radius)
    if constraints.surface is not None:
        center = Point(obj.cells_at(start).mean(axis=0))
        if not constraints.surface.polygon.covers(center):
            return PushPlanStatus.START_OFF_TABLE
    if checker.overlaps_obstacle(start):
        return PushPlanStatus.START_BLOCKED
    on_table, blocked = constraints.allow_pose(obj, goal)
    if not on_table:
        return PushPlanStatus.GOAL_OFF_TABLE
    # Where cells may hang over, some of them must still be on the table.
    if constraints.surface and not find_supported(obj, goal, constraints.surface).any():
        return PushPlanStatus.GOAL_OFF_TABLE
    if blocked:
        return PushPlanStatus.GOAL_BLOCKED
    region = constraints.finger_region
    if region is not None and region.distance(checker.place(goal[None])[0]) > radius:
        return PushPlanStatus.GOAL_OUT_OF_REACH
    return None


FORMAT_VERSION = 1
"""Version of the format of plan files."""

PLAN_HEADER = """\
# Pushes that bring an object to a goal pose, planned by gridpush.
# SI units, radians, world frame; `start` is the place of the pusher's center, `pose` the object's
# predicted pose after the push (x, y, theta), `error` the mean distance of the object's cells from
# where they are at the goal.
"""

"""Comment at the beginning of a plan file."""

LINE_WIDTH = 120
"""Greatest width of a line of a plan file, in characters."""


def describe_plan(plan: PushPlan, name: str, radius: float) -> dict[str, Any]:
    """Makes the document of a plan: plain dictionaries, lists and numbers.

    Args:
        plan: the plan.
        name: of the object.
        radius: of the pusher, m; of its corners, where it is no disc.
    """
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
                **describe_pusher(planned.push),
            }
            for planned, error in zip(plan.pushes, plan.errors, strict=True)
        ],
    }


def write_plan(
    path: Path | str, plan: PushPlan, name: str, radius: float, force: bool = False
) -> None:
    """Writes a plan as YAML.

    Args:
        path: of the file.
        plan: the plan.
        name: of the object.
        radius: of the pusher, m.
        force: whether a file that exists is written over.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    document = describe_plan(plan, name, radius)
    text = dump_yaml(document, default_flow_style=None, width=LINE_WIDTH)
    write_whole(path, PLAN_HEADER + text, force)

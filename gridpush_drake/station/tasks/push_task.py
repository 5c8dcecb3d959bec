"""The task `push`: an unknown object is pushed to a goal.

It is learned from the very pushes that bring it there.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from gridpush_drake.display.overlay import Mark, to_css
from gridpush_drake.display.shapes import AddGhost, MakePlanarTransform
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_error
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.page import ReportSummary
from gridpush_drake.report.plan_figures import draw_push_run
from gridpush_drake.station.control.robot_control import Learning
from gridpush_drake.station.scene.finger_region import MakeFingerRegion
from gridpush_drake.station.scene.resolve import ResolvedScenario
from gridpush_drake.station.scene.setting import make_surface
from gridpush_drake.station.simulated.station import Station
from gridpush_drake.station.tasks.goal_check import check_place, check_reach, list_misplaced
from gridpush_drake.station.tasks.task import (
    ControlledRecord,
    Judgment,
    StationTask,
    Status,
    TaskStatus,
    Waiting,
)
from gridpush_drake.station.tasks.task_kind import FIRST_TITLE, GoalKind
from gridpush_drake.systems.base.messages import ContactPointMode, ContactPointStatus
from gridpush_drake.systems.control.contact_point_controller import ContactPointController
from gridpush_drake.units import MM_PER_M


@dataclass(repr=False)
class PlacedRecord(ControlledRecord[Status]):
    """What came of a run at whose end the object should lie somewhere.

    Attributes:
        goal: (3,) X_WB of the object at the goal, m and rad.
        pose: (3,) true X_WB of the object at the end, m and rad; NaN if it had fallen. With a real
            robot it is the pose that was last seen.
        error: mean distance of the cells from where they should be, with the object at `pose`, m.
    """

    goal: Array
    pose: Array = field(default_factory=lambda: np.full(3, np.nan), kw_only=True)
    error: float = field(default=float("nan"), kw_only=True)


@dataclass(repr=False)
class PushTaskRecord(PlacedRecord[ContactPointStatus]):
    """What came of a run. It is filled while the task runs.

    Attributes:
        tolerance: mean distance of the object's cells from where they should be at which the goal
            counts as reached, m.
    """

    tolerance: float

    @property
    def pushes(self) -> int:
        """Number of pushes that were made."""
        return self.last.pushes

    @property
    def rest_poses(self) -> list[Array]:
        """Poses X_WB (3,) at rest, as seen, before the first push in the log and after each."""
        return [*(seen.pose for seen in self.log[:1]), *(seen.final_pose for seen in self.log)]

    @property
    def expected_errors(self) -> list[float]:
        """Errors that were expected after each push that began, m; see `error`."""
        return [step.status.expected_error for step in self.steps if step.push is not None]


EDGE_MARGIN = 0.03
"""Least distance that pushes leave between the object and the table's edge, m."""

MAX_PUSH = 0.25
"""Greatest length of a push, m."""

MIN_PUSH = 0.003
"""Least length of a push after the finger has come to the object, m."""

GOAL_COLOR = Rgba(0.16, 0.55, 0.35)
"""Color of the object's outline at the goal."""

GOAL_PATH = "goal"
"""Path in Meshcat of the object's outline at the goal."""


PUSH_TITLES = {
    ContactPointMode.WAITING: FIRST_TITLE,
    ContactPointMode.PUSHING: "Push {}, toward the goal",
    ContactPointMode.POKING: "Push {}, a poke to learn the object anew",
    ContactPointMode.REACHED: "At the goal",
    ContactPointMode.FAILED: "Given up",
    ContactPointMode.LOST: "The object is out of sight",
}
"""Titles beside the recording for the push controller's modes; {} is the push's number."""


class PushTask(StationTask[PushTaskRecord]):
    """The station with a controller that pushes the object to a goal.

    Attributes:
        surface: the table, as planners know it.
    """

    lost_after = 5.0
    timeout = 15.0
    learning = Learning()
    takes_gripper = True

    def AddController(self, builder: DiagramBuilder) -> ContactPointController:
        """Adds the controller that pushes to the scenario's goal.

        Raises:
            ScenarioError: no push can bring the object to its goal.
        """
        station = self.station
        scenario = station.scenario
        self.surface = make_surface(station.table_top)
        rules = make_rules(station, self.surface)
        # A goal that no push can reach is refused before the robot begins.
        field = scenario.names.name_field(0, "goal")
        check_goal(station.obj, np.array(scenario.goal.pose), rules, field)
        goal = builder.AddNamedSystem("goal", ConstantVectorSource(np.array(scenario.goal.pose)))
        controller: ContactPointController = builder.AddNamedSystem(
            "controller",
            ContactPointController(
                Model(station.obj), rules, answer_delay=scenario.simulation.answer_delay
            ),
        )
        builder.Connect(goal.get_output_port(), controller.GetInputPort("goal_pose"))
        return controller

    def draw_goals(self, meshcat: Meshcat) -> None:
        """Draws the object's translucent outline at the goal."""
        station = self.station
        AddGoal(meshcat, station.obj, station.scenario.goal.pose, station.object_in_plant.height)

    @classmethod
    def list_faults(cls, resolved: ResolvedScenario) -> list[str]:
        """Lists why the object may not lie at its goal; see `StationTask.list_faults`."""
        scenario = resolved.scenario
        goal = {scenario.names.name_field(0, "goal"): np.array(scenario.goal.pose)}
        return list_misplaced(goal, resolved, PushConstraints(edge_margin=EDGE_MARGIN))

    def make_record(self) -> PushTaskRecord:
        """Makes the empty record of a run."""
        goal = self.station.scenario.goal
        return PushTaskRecord(
            obj=self.station.obj,
            truth=self.station.truth,
            surface=self.surface,
            last=ContactPointStatus(),
            goal=np.array(goal.pose),
            tolerance=goal.tolerance,
        )

    def note(self, record: PushTaskRecord, time: float) -> bool:
        """Writes down where the object is, and what the controller does."""
        note_pose(self, record)
        return self.note_step(record, time) or not self.read("executor.status").ready

    def judge(self, record: PushTaskRecord, waiting: Waiting) -> Judgment:
        """Decides whether the object is at the goal or lost, or the task can get no further."""
        status = record.last
        if self.simulated and np.isnan(record.pose).any():
            push = status.pushes + (
                status.mode in (ContactPointMode.PUSHING, ContactPointMode.POKING)
            )
            return TaskStatus.LOST, f"The object left the table during push {push}."
        if waiting.unseen > self.lost_after and self.read("executor.status").ready:
            return TaskStatus.LOST, f"The object has not been seen for {self.lost_after:g} s."
        if status.mode in (ContactPointMode.REACHED, ContactPointMode.FAILED):
            return TaskStatus(status.mode), status.reason
        return self.judge_idle(waiting, status.reason)


def note_pose(task: StationTask[Any], record: PlacedRecord[Any]) -> None:
    """Writes into a record where the object is now, and how far that is from the goal."""
    pose = np.array(task.read(task.judged_pose))
    # The true pose is NaN once the object has fallen. A camera's is NaN whenever it does not see
    # the object, which says nothing about where that lies.
    if task.simulated or np.isfinite(pose).all():
        record.pose = pose
    record.error = float(calc_goal_error(record.obj, record.pose, record.goal))


def make_rules(station: Station, surface: SupportSurface) -> GoalRules:
    """Makes the rules by which the controller pushes from a station and its scenario."""
    scenario = station.scenario
    clearance = scenario.pokes.clearance
    constraints = PushConstraints(
        surface=surface,
        obstacles=station.obstacles,
        edge_margin=EDGE_MARGIN,
        finger_region=MakeFingerRegion(station),
        push_rule=station.CanPush,
    )
    contact = ContactOptions(
        replace(station.robot.pusher, speed=scenario.pokes.speed, clearance=clearance),
        distance_range=(clearance + MIN_PUSH, MAX_PUSH),
    )
    return GoalRules(
        constraints, contact, tolerance=scenario.goal.tolerance, max_pushes=scenario.goal.max_pushes
    )


def check_goal(obj: GridObject, goal: Array, rules: GoalRules, field: str = "goal.pose") -> None:
    """Checks what can be known of a goal before the robot begins.

    Args:
        obj: the object.
        goal: (3,) X_WB, m and rad.
        rules: by which it is pushed.
        field: name of the scenario's field with the goal, for messages.

    Raises:
        ScenarioError: at the goal the object would hang over the table's edge or be near to it,
            touch an obstacle, or lie where the finger does not come to it.
    """
    check_place(field, obj, goal, rules.constraints)
    # Without a region the finger comes everywhere.
    if rules.constraints.finger_region is not None:
        region = rules.constraints.finger_region
        check_reach(field, obj, goal, region, rules.contact.pusher.choose_reach(obj))


def AddGoal(meshcat: Meshcat, obj: GridObject, pose: Array | list[float], height: float) -> None:
    """Draws an object's translucent outline where the object should go.

    Args:
        meshcat: Meshcat in which it is drawn.
        obj: the object.
        pose: (3,) X_WB of the object at the goal, m and rad.
        height: height of the object, m.
    """
    meshcat.Delete(GOAL_PATH)
    AddGhost(meshcat, GOAL_PATH, obj, height, GOAL_COLOR)
    meshcat.SetTransform(GOAL_PATH, MakePlanarTransform(pose))


class PushKind(GoalKind):
    """A robot pushes an object it knows nothing about to a goal, and learns it on the way."""

    help = "push it to a goal pose, and learn on the way"
    sentence = "Push the {} to its goal."
    station = PushTask
    done = TaskStatus.REACHED
    marks = (Mark(to_css(GOAL_COLOR), "where the object should lie"),)

    def name_phase(self, status: Any) -> str:
        """Returns a title with the push's number."""
        return PUSH_TITLES[status.mode].format(status.pushes + 1)

    def summarize(self, record: PushTaskRecord) -> dict[str, Any]:
        """Adds to the summary how far from the goal the object ended."""
        return super().summarize(record) | {
            "pushes": record.pushes,
            "goal": [float(value) for value in record.goal],
            "error": record.error,
        }

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells how far from the goal the object ended."""
        name = speak_name(summary["object"])
        left = f"{summary['error'] * MM_PER_M:.1f} mm"
        return [
            f"The {name} after {summary['pushes']} pushes: {summary['message']}",
            f"  mean distance of its cells from where they should be: {left}",
        ]

    def make_summary(self, record: PushTaskRecord) -> ReportSummary:
        """Shows where the object lay after every push."""
        steps = []
        for number, (seen, pose) in enumerate(
            zip(record.log, record.rest_poses[1:], strict=False), start=1
        ):
            x, y = seen.push.start.tolist()
            left = float(calc_goal_error(record.obj, pose, record.goal)) * MM_PER_M
            where = f"({x:.3f}, {y:.3f}) m, {seen.push.length * MM_PER_M:.0f} mm far"
            steps.append((str(number), where, f"{left:.0f} mm"))
        return ReportSummary(
            headline=record.message,
            facts=(
                ("pushes", str(record.pushes)),
                ("left to go", f"{record.error * MM_PER_M:.1f} mm"),
                ("simulated", f"{record.duration:.0f} s"),
            ),
            figure=draw_push_run(
                record.obj,
                record.rest_poses,
                [seen.push for seen in record.log],
                record.goal,
                record.surface,
                expected=record.expected_errors,
                tolerance=record.tolerance,
            ),
            caption="The object at rest after every push, the pushes as arrows, the goal dotted; "
            "and how far off it was.",
            heads=("push", "from", "left to go"),
            steps=steps,
        )

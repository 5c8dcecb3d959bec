"""What came of pushing an object to a goal in the station.

Pushing an unknown object to a goal pose: the station learns it from the very pushes that bring it there.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from gridpush_drake.multibody.meshcat_shapes import AddGhost, MakePlanarTransform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_error
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.station.finger_region import MakeFingerRegion
from gridpush_drake.station.push_station import Learning, MakePushStation, PushStation
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.task import (
    GO_ON,
    AimStationCamera,
    BuildTask,
    Judgment,
    Progress,
    Sight,
    TaskRecord,
    TaskStatus,
    make_surface,
)
from gridpush_drake.systems.contact_point_controller import ContactPointController
from gridpush_drake.systems.messages import ContactPointMode, ContactPointStatus, PushCommand

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PushTaskStep:
    """A change of what the controller says.

    Attributes:
        time: s.
        status: of the controller.
        pose: (3,) where the object was seen, X_WB, m and rad; NaN where it was not.
        push: the command, where a push began.
    """

    time: float
    status: ContactPointStatus
    pose: Array
    push: PushCommand | None = None


@dataclass
class PushTaskRecord(TaskRecord):
    """What came of a run: "reached", "failed", "lost", "stuck" or "interrupted"; filled while it runs.

    Attributes:
        surface: the table.
        goal: (3,) where it should lie, X_WB, m and rad.
        tolerance: mean cell error at which the goal counts as reached, m.
        steps: what the controller said, in order.
        pose: (3,) where the object truly lay at the end, X_WB, m and rad; NaN where it had fallen.
        error: mean cell error to the goal there, m.
    """

    surface: SupportSurface
    goal: Array
    tolerance: float
    steps: list[PushTaskStep] = field(default_factory=list)
    pose: Array = field(default_factory=lambda: np.full(3, np.nan))
    error: float = float("nan")

    @property
    def last(self) -> ContactPointStatus:
        """The controller's last status."""
        return self.steps[-1].status if self.steps else ContactPointStatus()

    @property
    def statuses(self) -> list[ContactPointStatus]:
        """All that the controller said, in order."""
        return [step.status for step in self.steps]

    @property
    def pushes(self) -> int:
        """How many were made."""
        return self.last.pushes

    @property
    def rest_poses(self) -> list[Array]:
        """(3,) where the object was seen at rest, before the first push in the log and after each."""
        return [*(seen.pose for seen in self.log[:1]), *(seen.final_pose for seen in self.log)]

    @property
    def expected_errors(self) -> list[float]:
        """Mean cell error to the goal that was expected after each push that began, m."""
        return [step.status.expected_error for step in self.steps if step.push is not None]


REACHED, FAILED, LOST, STUCK = TaskStatus.REACHED, TaskStatus.FAILED, TaskStatus.LOST, TaskStatus.STUCK

MEMORY = 8
"""Pushes: the latest ones are learned from; the cost of learning grows with them."""

EDGE_MARGIN = 0.03
"""Between the object and the table's edge, m."""

MAX_PUSH = 0.25
"""m."""

MIN_PUSH = 0.003
"""Of what is left of a push when the finger has come to the object, m."""

LOST_AFTER = 5.0
"""Simulated without the object being seen, after which it is not waited for any longer, s."""

TIMEOUT = 15.0
"""Simulated without anything new, after which the task is stuck, s."""

GOAL_COLOR = Rgba(0.16, 0.55, 0.35)
"""Of the outline at the goal."""


class PushTask:
    """The station with a controller that pushes the object to a goal; to be run once or many times.

    Attributes:
        station: the station.
        controller: the system.
        task: runs its Diagram.
        surface: the table.
    """

    def __init__(self, scenario: PushScenario, meshcat: Meshcat | None = None) -> None:
        """Makes the Diagram.

        Args:
            scenario: what stands where, and where the object should go.
            meshcat: to show it in; None for none.

        Raises:
            ScenarioError: the scenario makes no sense.
            StationError: see `MakePushStation`.
        """
        self._scenario = scenario
        builder = DiagramBuilder()
        self.station: PushStation = builder.AddSystem(
            MakePushStation(scenario, meshcat, show_object=False, learning=Learning(max_pushes=None, memory=MEMORY))
        )
        station = self.station
        self.surface = make_surface(station)
        goal = builder.AddNamedSystem("goal", ConstantVectorSource(np.array(scenario.goal.pose)))
        self.controller = builder.AddNamedSystem("controller", ContactPointController(station.obj, self.make_rules()))
        builder.Connect(goal.get_output_port(), self.controller.GetInputPort("goal_pose"))
        self.task = BuildTask(builder, station, self.controller, "push_task", meshcat)
        if meshcat is not None:
            AddGoal(meshcat, station.obj, scenario.goal.pose, station.object_in_plant.height)

    def make_rules(self) -> GoalRules:
        """How the controller pushes, by the scenario."""
        scenario, station = self._scenario, self.station
        clearance = scenario.pokes.clearance
        constraints = PushConstraints(
            self.surface,
            edge_margin=EDGE_MARGIN,
            finger_region=MakeFingerRegion(station),
            push_rule=lambda push: station.FindObstacle(PushCommand.from_push(1, push)) is None,
        )
        contact = ContactOptions(
            scenario.finger.tip_radius, clearance, scenario.pokes.speed, (clearance + MIN_PUSH, MAX_PUSH)
        )
        return GoalRules(constraints, contact, tolerance=scenario.goal.tolerance, max_pushes=scenario.goal.max_pushes)

    def AimCamera(self, meshcat: Meshcat) -> None:
        """Points Meshcat's camera at the arm and the table."""
        AimStationCamera(meshcat, self.station)

    def run(
        self, seed: int | None = None, progress: Progress | None = None, realtime_rate: float = 0.0
    ) -> PushTaskRecord:
        """Runs the task from its beginning.

        Args:
            seed: of everything random, instead of the scenario's.
            progress, realtime_rate: see `TaskRun.run`.

        Returns:
            What came of it. Ctrl-C ends it early, with what there is by then.
        """
        goal = self._scenario.goal
        record = PushTaskRecord(self.station.obj, self.station.truth, self.surface, np.array(goal.pose), goal.tolerance)
        end = self.task.run(_Watch(self, record).judge, seed, progress, realtime_rate)
        record.note_end(self.task, end)
        return record


@dataclass(eq=False)
class _Watch:
    """Follows a run: writes down what is new, and decides when it is over."""

    run: PushTask
    record: PushTaskRecord
    last_new: float = 0.0
    sight: Sight = field(default_factory=lambda: Sight(LOST_AFTER))

    def judge(self, time: float) -> Judgment:
        """Status and message."""
        self._note(time)
        status = self.record.last
        if np.isnan(self.record.pose).any():
            return (
                LOST,
                f"The object left the table during push {status.pushes + (status.mode == ContactPointMode.PUSHING)}.",
            )
        lost = self.sight.is_lost(time, self.run.task.read("object.pose"))
        if lost and self.run.task.read("executor.status").ready:
            return LOST, f"The object has not been seen for {LOST_AFTER:g} s."
        if status.mode in (ContactPointMode.REACHED, ContactPointMode.FAILED):
            return TaskStatus(status.mode), status.reason
        if time - self.last_new > TIMEOUT:
            return STUCK, f"Nothing happened for {TIMEOUT:g} s: {status.reason}"
        return GO_ON

    def _note(self, time: float) -> None:
        record, read = self.record, self.run.task.read
        record.note_learned(self.run.task)
        record.pose = np.array(read("object.pose_true"))
        record.error = float(calc_goal_error(record.obj, record.pose, record.goal))
        status: ContactPointStatus = read("status", self.run.controller)
        if not read("executor.status").ready:
            self.last_new = time
        if status is record.last:
            return
        self.last_new = time
        push = PushCommand.from_vector(read("push_command", self.run.controller))
        step = PushTaskStep(
            time, status, np.array(read("object.pose")), push if status.mode == ContactPointMode.PUSHING else None
        )
        record.steps.append(step)


def AddGoal(meshcat: Meshcat, obj: GridObject, pose: Array | list[float], height: float, path: str = "goal") -> None:
    """Draws an object's translucent outline where it should go.

    Args:
        meshcat: where to draw.
        obj: the object.
        pose: (3,) X_WB, m and rad.
        height: of the object, m.
        path: below which it is drawn.
    """
    meshcat.Delete(path)
    AddGhost(meshcat, path, obj, height, GOAL_COLOR)
    meshcat.SetTransform(path, MakePlanarTransform(pose))

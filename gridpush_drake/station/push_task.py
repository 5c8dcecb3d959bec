"""Pushing an unknown object to a goal pose: the station learns it from the very pushes that bring it there."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from gridpush_drake.grid.object import GridObject
from gridpush_drake.planning.contact_point import ContactOptions
from gridpush_drake.planning.planned_push import calc_goal_error
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.push_decision import GoalRules
from gridpush_drake.scene.scenario import PushScenario
from gridpush_drake.station.finger_region import MakeFingerRegion
from gridpush_drake.station.learning import Learning
from gridpush_drake.station.push_station import MakePushStation, PushStation
from gridpush_drake.station.push_task_record import PushTaskRecord, PushTaskStep
from gridpush_drake.station.table_surface import make_surface
from gridpush_drake.station.task_run import GO_ON, Judgement, Progress, Sight, TaskStatus
from gridpush_drake.station.task_wiring import AimStationCamera, BuildTask
from gridpush_drake.systems import contact_point_status as modes
from gridpush_drake.systems.contact_point_controller import ContactPointController
from gridpush_drake.systems.contact_point_status import ContactPointStatus
from gridpush_drake.systems.meshcat_drawing import AddGhost, MakePlanarTransform
from gridpush_drake.systems.push_command import PushCommand

Array = NDArray[np.float64]

REACHED, FAILED, LOST, STUCK = TaskStatus.REACHED, TaskStatus.FAILED, TaskStatus.LOST, TaskStatus.STUCK

MEMORY = 8
"""Pushes: the latest ones are learned from; the cost of learning grows with them."""

EDGE_MARGIN = 0.03
"""Between the object and the table's edge, m."""

LONGEST_PUSH = 0.25
"""m."""

SHORTEST_PUSH = 0.003
"""Of what is left of a push when the finger has come to the object, m."""

LOST_AFTER = 5.0
"""Simulated without the object being seen, after which it is not waited for any longer, s."""

PATIENCE = 15.0
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
            MakePushStation(scenario, meshcat, show_object=False, learning=Learning(most_pushes=None, memory=MEMORY))
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
            scenario.finger.tip_radius, clearance, scenario.pokes.speed, (clearance + SHORTEST_PUSH, LONGEST_PUSH)
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

    def judge(self, time: float) -> Judgement:
        """Status and message."""
        self._note(time)
        status = self.record.last
        if np.isnan(self.record.pose).any():
            return LOST, f"The object left the table during push {status.pushes + (status.mode == modes.PUSHING)}."
        lost = self.sight.is_lost(time, self.run.task.read("object.pose"))
        if lost and self.run.task.read("executor.status").ready:
            return LOST, f"The object has not been seen for {LOST_AFTER:g} s."
        if status.mode in (modes.REACHED, modes.FAILED):
            return TaskStatus(status.mode), status.reason
        if time - self.last_new > PATIENCE:
            return STUCK, f"Nothing happened for {PATIENCE:g} s: {status.reason}"
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
        step = PushTaskStep(time, status, np.array(read("object.pose")), push if status.mode == modes.PUSHING else None)
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

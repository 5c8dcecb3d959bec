"""Pushing an unknown object to a goal: it is learned from the very pushes that bring it there."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from gridpush_drake.display.shapes import AddGhost, MakePlanarTransform
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_error
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.station.control.robot_control import Learning
from gridpush_drake.station.scene.finger_region import MakeFingerRegion
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scene.setting import find_obstacles, make_surface
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.simulated.station import Station, StationMaker
from gridpush_drake.station.tasks.goal_check import check_place, check_reach
from gridpush_drake.station.tasks.task import (
    GO_ON,
    ControlledRecord,
    Judgment,
    StationTask,
    TaskStatus,
    Waiting,
)
from gridpush_drake.systems.base.messages import ContactPointMode, ContactPointStatus, PushCommand
from gridpush_drake.systems.control.contact_point_controller import ContactPointController


@dataclass(repr=False)
class PushTaskRecord(ControlledRecord[ContactPointStatus]):
    """What came of a run. It is filled while the task runs.

    Attributes:
        goal: (3,) X_WB of the object at the goal, m and rad.
        tolerance: mean distance of the object's cells from where they should be at which the goal
            counts as reached, m.
        pose: (3,) true X_WB of the object at the end, m and rad; NaN if it had fallen. With a real
            robot it is the pose that was last seen.
        error: mean distance of the cells from where they should be, with the object at `pose`, m.
    """

    goal: Array
    tolerance: float
    pose: Array = field(default_factory=lambda: np.full(3, np.nan))
    error: float = float("nan")

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


class PushTask(StationTask[PushTaskRecord]):
    """The station with a controller that pushes the object to a goal.

    Attributes:
        surface: the table, as planners know it.
    """

    lost_after = 5.0
    timeout = 15.0

    def __init__(
        self,
        scenario: PushScenario | ResolvedScenario,
        meshcat: Meshcat | None = None,
        make_station: StationMaker = MakePushStation,
    ) -> None:
        """Makes the Diagram.

        Args:
            scenario: the scenario, resolved or not; its `goal` says where the object should go.
            meshcat: Meshcat in which the station is shown; None for none.
            make_station: makes the station; a simulated one by default.

        Raises:
            ScenarioError: the scenario makes no sense, or the object cannot be brought to its goal.
            StationError: nothing can be rendered on this computer; or see `MakeHardwareStation`.
        """
        resolved = resolve(scenario)
        self.check(resolved)
        scenario = resolved.scenario
        builder = DiagramBuilder()
        station = builder.AddSystem(
            make_station(resolved, meshcat, show_object=False, learning=Learning())
        )
        self.surface = make_surface(station.table_top)
        rules = make_rules(station, self.surface)
        # A goal that no push can reach is refused before the robot begins.
        field = scenario.names.name_field(0, "goal")
        check_goal(station.obj, np.array(scenario.goal.pose), rules, field)
        goal = builder.AddNamedSystem("goal", ConstantVectorSource(np.array(scenario.goal.pose)))
        self.controller = builder.AddNamedSystem(
            "controller",
            ContactPointController(
                Model(station.obj), rules, answer_delay=scenario.simulation.answer_delay
            ),
        )
        builder.Connect(goal.get_output_port(), self.controller.GetInputPort("goal_pose"))
        super().__init__(builder, station, self.controller, meshcat)
        if meshcat is not None:
            AddGoal(meshcat, station.obj, scenario.goal.pose, station.object_in_plant.height)

    @classmethod
    def list_faults(cls, resolved: ResolvedScenario) -> list[str]:
        """Lists why the object may not lie at its goal; see `StationTask.list_faults`.

        A camera measures the object's outline, which is not known yet.
        """
        scenario = resolved.scenario
        if scenario.camera.kind != "ideal":
            return []
        constraints = PushConstraints(
            surface=make_surface(resolved.table_top),
            obstacles=find_obstacles(resolved),
            edge_margin=EDGE_MARGIN,
        )
        field = scenario.names.name_field(0, "goal")
        try:
            check_place(field, resolved.obj, np.array(scenario.goal.pose), constraints)
        except ScenarioError as error:
            return [str(error)]
        return []

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
        pose = np.array(self.read(self.judged_pose))
        # The true pose is NaN once the object has fallen. A camera's is NaN whenever it does not
        # see the object, which says nothing about where that lies.
        if self.simulated or np.isfinite(pose).all():
            record.pose = pose
        record.error = float(calc_goal_error(record.obj, record.pose, record.goal))
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
        if waiting.idle > self.timeout:
            return TaskStatus.STUCK, f"Nothing happened for {self.timeout:g} s: {status.reason}"
        return GO_ON


def make_rules(station: Station, surface: SupportSurface) -> GoalRules:
    """Makes the rules by which the controller pushes from a station and its scenario."""
    scenario = station.scenario
    clearance = scenario.pokes.clearance
    constraints = PushConstraints(
        surface=surface,
        obstacles=station.obstacles,
        edge_margin=EDGE_MARGIN,
        finger_region=MakeFingerRegion(station),
        push_rule=lambda push: station.FindObstacle(PushCommand.from_push(1, push)) is None,
    )
    contact = ContactOptions(
        Pusher(station.robot.finger.tip_radius, scenario.pokes.speed, clearance),
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
        check_reach(field, obj, goal, region, rules.contact.pusher.choose_radius(obj))


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

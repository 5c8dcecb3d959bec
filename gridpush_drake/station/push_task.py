"""Pushing an unknown object to a goal pose: the station learns it from the very pushes that bring it there.

`PushTaskRecord` says what came of it.
"""

from dataclasses import dataclass, field

import numpy as np
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from gridpush_drake.display.shapes import AddGhost, MakePlanarTransform
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_error
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.station.others import place_others
from gridpush_drake.station.push_station import MakePushStation
from gridpush_drake.station.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.station import (
    Learning,
    MakeFingerRegion,
    Station,
    StationMaker,
    make_surface,
)
from gridpush_drake.station.task import (
    GO_ON,
    ControlledRecord,
    Judgment,
    StationTask,
    TaskStatus,
    Waiting,
)
from gridpush_drake.systems.contact_point_controller import ContactPointController
from gridpush_drake.systems.messages import ContactPointMode, ContactPointStatus, PushCommand


@dataclass(repr=False)
class PushTaskRecord(ControlledRecord[ContactPointStatus]):
    """What came of a run: "reached", "failed", "lost", "stuck" or "interrupted"; filled while it runs.

    Attributes:
        goal: (3,) where it should lie, X_WB, m and rad.
        tolerance: mean cell error at which the goal counts as reached, m.
        pose: (3,) where the object truly lay at the end, X_WB, m and rad; NaN where it had fallen.
            A real one: as seen.
        error: mean cell error to the goal there, m.
    """

    goal: Array
    tolerance: float
    pose: Array = field(default_factory=lambda: np.full(3, np.nan))
    error: float = float("nan")

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


REACHED, FAILED, LOST, STUCK = (
    TaskStatus.REACHED,
    TaskStatus.FAILED,
    TaskStatus.LOST,
    TaskStatus.STUCK,
)

EDGE_MARGIN = 0.03
"""Between the object and the table's edge, m."""

MAX_PUSH = 0.25
"""m."""

MIN_PUSH = 0.003
"""Of what is left of a push when the finger has come to the object, m."""

GOAL_COLOR = Rgba(0.16, 0.55, 0.35)
"""Of the outline at the goal."""

GOAL_PATH = "goal"
"""Of that in Meshcat."""


class PushTask(StationTask[PushTaskRecord]):
    """The station with a controller that pushes the object to a goal.

    Attributes:
        surface: the table.
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
            scenario: resolved or not, what stands where, and where the object should go.
            meshcat: to show it in; None for none.
            make_station: of a scenario; a simulated one by default.

        Raises:
            ScenarioError: the scenario makes no sense.
            StationError: see `MakePushStation`.
        """
        resolved = resolve(scenario)
        scenario = resolved.scenario
        builder = DiagramBuilder()
        station = builder.AddSystem(
            make_station(resolved, meshcat, show_object=False, learning=Learning())
        )
        self.surface = make_surface(station.table_top)
        goal = builder.AddNamedSystem("goal", ConstantVectorSource(np.array(scenario.goal.pose)))
        self.controller = builder.AddNamedSystem(
            "controller",
            ContactPointController(
                station.obj,
                make_rules(station, self.surface),
                answer_delay=scenario.simulation.answer_delay,
            ),
        )
        builder.Connect(goal.get_output_port(), self.controller.GetInputPort("goal_pose"))
        super().__init__(builder, station, self.controller, meshcat)
        if meshcat is not None:
            AddGoal(meshcat, station.obj, scenario.goal.pose, station.object_in_plant.height)

    def make_record(self) -> PushTaskRecord:
        """An empty record."""
        station, goal = self.station, self.station.scenario.goal
        begin = ContactPointStatus()
        return PushTaskRecord(
            station.obj, station.truth, self.surface, begin, np.array(goal.pose), goal.tolerance
        )

    def note(self, record: PushTaskRecord, time: float) -> bool:
        """Writes down where the object is and what the controller says."""
        pose = np.array(self.read(self.judged_pose))
        if self.simulated or np.isfinite(pose).all():
            record.pose = pose
        record.error = float(calc_goal_error(record.obj, record.pose, record.goal))
        return self.note_step(record, time) or not self.read("executor.status").ready

    def judge(self, record: PushTaskRecord, waiting: Waiting) -> Judgment:
        """Status and message."""
        status = record.last
        if self.simulated and np.isnan(record.pose).any():
            push = status.pushes + (status.mode == ContactPointMode.PUSHING)
            return LOST, f"The object left the table during push {push}."
        if waiting.unseen > self.lost_after and self.read("executor.status").ready:
            return LOST, f"The object has not been seen for {self.lost_after:g} s."
        if status.mode in (ContactPointMode.REACHED, ContactPointMode.FAILED):
            return TaskStatus(status.mode), status.reason
        if waiting.idle > self.timeout:
            return STUCK, f"Nothing happened for {self.timeout:g} s: {status.reason}"
        return GO_ON


def make_rules(station: Station, surface: SupportSurface) -> GoalRules:
    """How the controller pushes, by a station's scenario."""
    scenario = station.scenario
    clearance = scenario.pokes.clearance
    constraints = PushConstraints(
        surface,
        place_others(station.others),
        edge_margin=EDGE_MARGIN,
        finger_region=MakeFingerRegion(station),
        push_rule=lambda push: station.FindObstacle(PushCommand.from_push(1, push)) is None,
    )
    contact = ContactOptions(
        station.robot.finger.tip_radius,
        clearance,
        scenario.pokes.speed,
        (clearance + MIN_PUSH, MAX_PUSH),
    )
    return GoalRules(
        constraints, contact, tolerance=scenario.goal.tolerance, max_pushes=scenario.goal.max_pushes
    )


def AddGoal(meshcat: Meshcat, obj: GridObject, pose: Array | list[float], height: float) -> None:
    """Draws an object's translucent outline where it should go.

    Args:
        meshcat: where to draw.
        obj: the object.
        pose: (3,) X_WB, m and rad.
        height: of the object, m.
    """
    meshcat.Delete(GOAL_PATH)
    AddGhost(meshcat, GOAL_PATH, obj, height, GOAL_COLOR)
    meshcat.SetTransform(GOAL_PATH, MakePlanarTransform(pose))

"""The whole story: poke an unknown object, learn it, slide it to the table's edge, grasp what hangs over, lift it.

`GraspFinder` says how, and where on the table's edge, the station's gripper can take the object;
`PreGraspRecord` what came of exploring, sliding and grasping.
"""

from dataclasses import dataclass, replace
from math import atan2

import numpy as np
import shapely
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.pregrasp.exploration import PokeOptions
from gridpush_drake.planning.pregrasp.goals import ArmLimits, GoalOptions, PreGraspGoal
from gridpush_drake.planning.pregrasp.grasp_parts import FlatPart, PadLimit, find_held_grasps
from gridpush_drake.planning.pregrasp.planner import (
    ACCEPTED_SHARE,
    PreGraspOptions,
    PreGraspPlanner,
)
from gridpush_drake.planning.pregrasp.side_grasp import SideGrasp, check_thickness, choose_varied
from gridpush_drake.planning.pregrasp.slides import SlideOptions
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface, stayed_supported
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
from gridpush_drake.systems.messages import GraspCommand, PreGraspMode, PreGraspStatus, PushCommand
from gridpush_drake.systems.pregrasp_controller import PreGraspController

EDGE_STEP = 0.03
"""m along the edge, between places that the gripper is tried at."""

EDGE_SPARE = 0.002
"""m between the gripper's tips and the edge, beyond their least clearance, where places of the edge
are tried."""

GRASPS_TRIED = 16
"""Of those found at a pose, all different, that the arm is asked about."""


@dataclass(frozen=True, eq=False)
class GraspFinder:
    """Finds grasps that the arm can carry out.

    Attributes:
        station: the station; it has a gripper.
        obj: the object.
        surface: the table.
        pads: the gripper's measures, and what its pads can hold.
    """

    station: Station
    obj: GridObject
    surface: SupportSurface
    pads: PadLimit

    def find_grasp(
        self, pose: Array, aim: Array, masses: PlausibleMassSet, at_worst: bool
    ) -> SideGrasp | None:
        """How the gripper takes the object at `pose` (3,), as near `aim` (2,), body frame, as it can.

        Its pads hold the object, `at_worst` whichever of the masses it has, otherwise as they are
        estimated.
        """
        height = self.station.scenario.object_height
        found = find_held_grasps(
            self.obj, pose, self.surface, self.pads, aim, height, masses, at_worst
        )
        for grasp in choose_varied(found, GRASPS_TRIED):
            if self._is_reached(grasp.p_WG, grasp.approach):
                return grasp
        return None

    def can_grasp(self, goal: PreGraspGoal, masses: PlausibleMassSet) -> bool:
        """Whether the object can be taken at a goal, and held: by its rim whichever of some masses it has."""
        return (
            self.find_grasp(goal.pose, goal.part.p_BG, masses, isinstance(goal.part, FlatPart))
            is not None
        )

    def find_edge(self) -> BaseGeometry:
        """Where on the edge the gripper can take something, coming straight in. Raises StationError for nowhere."""
        out = self.pads.gripper.jaw_reach + self.pads.gripper.table_clearance + EDGE_SPARE
        places = []
        for s in np.arange(0.0, self.surface.perimeter, EDGE_STEP):
            point, normal = self.surface.edge_at(float(s))
            if self._is_reached(point + out * normal, atan2(-normal[1], -normal[0])):
                places.append(shapely.Point(point).buffer(EDGE_STEP))
        if not places:
            raise StationError(
                "the gripper reaches no place of the table's edge; expected a table beside the robot"
            )
        return shapely.union_all(places)

    def _is_reached(self, p_WG: Array, approach: float) -> bool:
        """Whether the arm can grasp at a point (2,), m, with the fingers pointing along `approach`, rad."""
        scenario, (x, y) = self.station.scenario, p_WG.tolist()
        command = GraspCommand(
            1, x, y, scenario.object_height / 2, approach, scenario.pregrasp.lift
        )
        return self.station.FindGraspObstacle(command) is None


@dataclass(repr=False)
class PreGraspRecord(ControlledRecord[PreGraspStatus]):
    """What came of a run: "held", "not_lifted", "dropped", "failed", "lost", "stuck" or "interrupted".

    Attributes:
        raised: how far the object's lowest point was above the table at the end, m; NaN where
            nobody knows.
    """

    raised: float = float("nan")


HELD, DROPPED, FAILED = TaskStatus.HELD, TaskStatus.DROPPED, TaskStatus.FAILED
LOST, STUCK, NOT_LIFTED = TaskStatus.LOST, TaskStatus.STUCK, TaskStatus.NOT_LIFTED

CLEARANCE = 0.006
"""Between finger and object where a push begins, m: it comes down beside an object seen to about a
millimeter."""

LIFTED_SHARE = 0.7
"""Of the lift, that the object's lowest point must truly have been raised by to count as held."""


class PreGraspTask(StationTask[PreGraspRecord]):
    """The station with a controller that explores, slides, grasps and lifts.

    Attributes:
        obj: the object.
        surface: the table.
        planner: what the controller decides with.
    """

    lost_after = 10.0
    timeout = 60.0

    def __init__(
        self,
        scenario: PushScenario | ResolvedScenario,
        meshcat: Meshcat | None = None,
        make_station: StationMaker = MakePushStation,
    ) -> None:
        """Makes the Diagram.

        Args:
            scenario: resolved or not, what stands where, and how it is done; its scene has a gripper.
            meshcat: to show it in; None for none.
            make_station: of a scenario; a simulated one by default.

        Raises:
            ScenarioError: the scenario makes no sense, or its scene has no gripper.
            StationError: see `MakePushStation`.
            PlanningError: the object is too thick for the gripper, its pads fit nowhere on it, or
                the table is smaller than it.
        """
        resolved = resolve(scenario)
        scenario = resolved.scenario
        builder = DiagramBuilder()
        self.station: Station = builder.AddSystem(
            make_station(resolved, meshcat, show_object=False, learning=Learning())
        )
        station = self.station
        if station.robot.gripper is None:
            raise ScenarioError(
                "directives: there is no model gripper; expected a scene that can grasp"
            )
        self.surface = make_surface(station.table_top)
        self.obj = station.obj
        measures = station.robot.gripper
        gripper, force = measures.make_side_gripper(), measures.limit_force(scenario.pregrasp.force)
        check_thickness(self.obj, scenario.object_height, gripper)
        pads = PadLimit.of_object(self.obj, gripper, force)
        self._finder = GraspFinder(station, self.obj, self.surface, pads)
        self.planner = PreGraspPlanner(
            self.obj,
            self.surface,
            make_options(station, pads),
            limits=self._make_limits(),
            obstacles=place_others(station.others),
        )
        self.controller = builder.AddNamedSystem("controller", self._make_controller())
        super().__init__(builder, station, self.controller, meshcat)

    def make_record(self) -> PreGraspRecord:
        """An empty record."""
        return PreGraspRecord(self.obj, self.station.truth, self.surface, PreGraspStatus())

    def note(self, record: PreGraspRecord, time: float) -> bool:
        """Writes down how high the object is and what the controller does."""
        if self.simulated:
            record.raised = self.calc_raised()
        return self.note_step(record, time)

    def judge(self, record: PreGraspRecord, waiting: Waiting) -> Judgment:
        """Status and message."""
        status = record.last
        if self.simulated and np.isnan(self.read(self.judged_pose)).any():
            return DROPPED, f"The object fell: {status.reason}"
        if status.mode == PreGraspMode.HOLDING:
            if not self.simulated:
                return HELD, "The gripper lifted the object and holds it."
            if record.raised >= LIFTED_SHARE * self.station.scenario.pregrasp.lift:
                return (
                    HELD,
                    f"The object was lifted and held, {1e3 * record.raised:.0f} mm above the table.",
                )
            return (
                NOT_LIFTED,
                f"The gripper closed and went up, but the object did not: {1e3 * record.raised:.0f} mm.",
            )
        if status.mode == PreGraspMode.FAILED:
            return FAILED, status.reason
        at_rest = self.read("executor.status").ready and self.read("grasp.status").ready
        if waiting.unseen > self.lost_after and at_rest:
            return LOST, f"The object has not been seen for {self.lost_after:g} s."
        if waiting.idle > self.timeout:
            return STUCK, f"Nothing happened for {self.timeout:g} s: {status.reason}"
        return GO_ON

    def finish(self, record: PreGraspRecord) -> None:
        """Says of each push whether a part hung over the edge; what was seen counts until the object is grasped."""
        grasped = next(
            (step.time for step in record.steps if step.status.mode == PreGraspMode.GRASPING),
            np.inf,
        )
        record.sight = record.sight and record.sight.until(grasped)
        pushes = tuple(
            replace(seen, overhang=not stayed_supported(self.obj, seen, self.surface))
            for seen in record.log
        )
        record.log = replace(record.log, pushes=pushes)

    def calc_raised(self) -> float:
        """How far the lowest corner of the object is above the table now, m."""
        X_WB = self.read("body_poses")[int(self.station.object_in_plant.body.index())]
        outline = np.asarray(self.obj.outline.exterior.coords)[:, :2]
        flat = np.column_stack([outline, np.zeros(len(outline))])
        return float((X_WB.rotation().matrix() @ flat.T)[2].min() + X_WB.translation()[2])

    def _make_limits(self) -> ArmLimits:
        station = self.station
        return ArmLimits(
            finger_region=MakeFingerRegion(station),
            edge_region=self._finder.find_edge(),
            can_push=lambda push: station.FindObstacle(PushCommand.from_push(1, push)) is None,
            can_grasp=self._finder.can_grasp,
        )

    def _make_controller(self) -> PreGraspController:
        pregrasp = self.station.scenario.pregrasp
        return PreGraspController(
            self.planner,
            self._finder.find_grasp,
            grasp_height=self.station.scenario.object_height / 2,
            lift=pregrasp.lift,
            seed=self.station.scenario.seed,
            answer_delay=self.station.scenario.simulation.answer_delay,
        )


def make_options(station: Station, pads: PadLimit) -> PreGraspOptions:
    """The planner's options, by a station's scenario and robot and what its gripper's pads can hold."""
    scenario = station.scenario
    pregrasp, radius, speed = (
        scenario.pregrasp,
        station.robot.finger.tip_radius,
        scenario.pokes.speed,
    )
    slide = SlideOptions()
    contact: ContactOptions = replace(
        slide.contact, radius=radius, speed=speed, clearance=CLEARANCE
    )
    return PreGraspOptions(
        goal=GoalOptions(margin=pregrasp.margin),
        slide=replace(slide, margin=ACCEPTED_SHARE * pregrasp.margin, contact=contact),
        poke=PokeOptions(radius=radius, speed=speed, clearance=CLEARANCE),
        min_pokes=pregrasp.min_pokes,
        max_pokes=pregrasp.max_pokes,
        max_slides=pregrasp.max_slides,
        max_arm=pregrasp.max_arm,
        pads=pads,
    )

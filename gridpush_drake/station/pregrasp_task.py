"""`GraspFinder`: how, and where on the table's edge, the station's gripper can take an object.

What came of exploring, sliding and grasping in the station.

The whole story: poke an unknown object, learn it, slide it to the table's edge, grasp what hangs over, lift it.
"""

from dataclasses import dataclass, field, replace
from math import atan2

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.pregrasp.exploration import PokeOptions
from gridpush_drake.planning.pregrasp.goals import ArmLimits, GoalOptions, PreGraspGoal
from gridpush_drake.planning.pregrasp.planner import ACCEPTED_SHARE, PreGraspOptions, PreGraspPlanner
from gridpush_drake.planning.pregrasp.side_grasp import SideGrasp, SideGripper, choose_varied, find_side_grasps
from gridpush_drake.planning.pregrasp.slides import SlideOptions
from gridpush_drake.planning.support_surface import SupportSurface, find_supported
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
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
from gridpush_drake.systems.messages import GraspCommand, PreGraspMode, PreGraspStatus, PushCommand
from gridpush_drake.systems.pregrasp_controller import PreGraspController

Array = NDArray[np.float64]

EDGE_STEP = 0.03
"""m along the edge, between places that the gripper is tried at."""

EDGE_SPARE = 0.002
"""m between the gripper's tips and the edge, beyond their least clearance, where places of the edge are tried."""

GRASPS_TRIED = 16
"""Of those found at a pose, all different, that the arm is asked about."""


@dataclass(frozen=True, eq=False)
class GraspFinder:
    """Finds grasps that the arm can carry out.

    Attributes:
        station: the station; it has a gripper.
        obj: the object.
        surface: the table.
        gripper: its measures.
    """

    station: PushStation
    obj: GridObject
    surface: SupportSurface
    gripper: SideGripper = field(default_factory=SideGripper)

    def find_grasp(self, pose: Array, center_of_mass: Array) -> SideGrasp | None:
        """How the gripper takes the object at `pose` (3,), as near its center of mass (2,), body frame, as it can."""
        found = find_side_grasps(
            self.obj,
            pose,
            self.surface,
            self.gripper,
            center_of_mass,
            height=self.station.scenario.object_height,
        )
        for grasp in choose_varied(found, GRASPS_TRIED):
            if self._is_reached(grasp.p_WG, grasp.approach):
                return grasp
        return None

    def can_grasp(self, goal: PreGraspGoal) -> bool:
        """Whether the object can be taken at a goal."""
        return self.find_grasp(goal.pose, goal.part.p_BG) is not None

    def find_edge(self) -> BaseGeometry:
        """Where on the edge the gripper can take something, coming straight in. Raises StationError for nowhere."""
        out = self.gripper.jaw_reach + self.gripper.table_clearance + EDGE_SPARE
        places = []
        for s in np.arange(0.0, self.surface.perimeter, EDGE_STEP):
            point, normal = self.surface.edge_at(float(s))
            if self._is_reached(point + out * normal, atan2(-normal[1], -normal[0])):
                places.append(shapely.Point(point).buffer(EDGE_STEP))
        if not places:
            raise StationError("the gripper reaches no place of the table's edge; expected a table beside the robot")
        return shapely.union_all(places)

    def _is_reached(self, p_WG: Array, approach: float) -> bool:
        """Whether the arm can grasp at a point (2,), m, with the fingers pointing along `approach`, rad."""
        scenario, (x, y) = self.station.scenario, p_WG.tolist()
        command = GraspCommand(1, x, y, scenario.object_height / 2, approach, scenario.pregrasp.lift)
        return self.station.FindGraspObstacle(command) is None


@dataclass(frozen=True, eq=False)
class PreGraspStep:
    """Something that the controller did.

    Attributes:
        time: when it began, s.
        status: of the controller.
        pose: (3,) where the object was seen, X_WB, m and rad; NaN where it was not.
        push: the command, where it was a push.
        grasp: the command, where it was a grasp.
        pushes_learned_from: by then.
    """

    time: float
    status: PreGraspStatus
    pose: Array
    push: PushCommand | None = None
    grasp: GraspCommand | None = None
    pushes_learned_from: int = 0


@dataclass
class PreGraspRecord(TaskRecord):
    """What came of a run: "held", "dropped", "failed", "lost", "stuck" or "interrupted"; filled while it runs.

    Attributes:
        surface: the table.
        steps: what the controller did.
        raised: how far the object's lowest point was above the table at the end, m.
    """

    surface: SupportSurface
    steps: list[PreGraspStep] = field(default_factory=list)
    raised: float = float("nan")

    @property
    def last(self) -> PreGraspStatus:
        """The controller's last status."""
        return self.steps[-1].status if self.steps else PreGraspStatus()


HELD, DROPPED, FAILED = TaskStatus.HELD, TaskStatus.DROPPED, TaskStatus.FAILED
LOST, STUCK = TaskStatus.LOST, TaskStatus.STUCK

MEMORY = 14
"""Pushes: the latest ones are learned from; the cost of learning grows with them, what they tell hardly does."""

CLEARANCE = 0.006
"""Between finger and object where a push begins, m: it comes down beside an object seen to about a millimeter."""

LIFTED_SHARE = 0.7
"""Of the lift, that the object's lowest point must truly have been raised by to count as held."""

TIMEOUT = 60.0
"""Simulated without anything new, after which the task is stuck, s."""

LOST_AFTER = 10.0
"""Simulated without the object being seen, after which it is not waited for any longer, s."""


class PreGraspTask:
    """The station with a controller that explores, slides, grasps and lifts; to be run once or many times.

    Attributes:
        station: the station.
        planner: what the controller decides with.
        controller: the system.
        task: runs its Diagram.
    """

    def __init__(self, scenario: PushScenario, meshcat: Meshcat | None = None) -> None:
        """Makes the Diagram.

        Args:
            scenario: what stands where, and how it is done; its scene has a gripper.
            meshcat: to show it in; None for none.

        Raises:
            ScenarioError: the scenario makes no sense, or its scene has no gripper.
            StationError: see `MakePushStation`.
            PlanningError: the object has no graspable part, or the table is smaller than it.
        """
        self._scenario = scenario
        builder = DiagramBuilder()
        learning = Learning(max_pushes=None, memory=MEMORY, admit=self._admit)
        self.station: PushStation = builder.AddSystem(
            MakePushStation(scenario, meshcat, show_object=False, learning=learning)
        )
        station = self.station
        if station.gripper is None:
            raise ScenarioError("directives: there is no model gripper; expected a scene that can grasp")
        self.surface = make_surface(station)
        self.obj = station.obj
        self._finder = GraspFinder(station, self.obj, self.surface)
        self.planner = PreGraspPlanner(self.obj, self.surface, make_options(scenario), limits=self._make_limits())
        self.controller = builder.AddNamedSystem("controller", self._make_controller())
        self.task = BuildTask(builder, station, self.controller, "pre_grasp_task", meshcat)

    def AimCamera(self, meshcat: Meshcat) -> None:
        """Points Meshcat's camera at the arm and the table."""
        AimStationCamera(meshcat, self.station)

    def run(
        self, seed: int | None = None, progress: Progress | None = None, realtime_rate: float = 0.0
    ) -> PreGraspRecord:
        """Runs the task from its beginning.

        Args:
            seed: of everything random, instead of the scenario's.
            progress, realtime_rate: see `TaskRun.run`.

        Returns:
            What came of it. Ctrl-C ends it early, with what there is by then.
        """
        record = PreGraspRecord(self.obj, self.station.truth, self.surface)
        watch = _Watch(self, record)
        end = self.task.run(watch.judge, seed, progress, realtime_rate)
        watch.note(end.duration)
        record.note_end(self.task, end)
        record.log = self._mark_overhang(record.log)
        return record

    def calc_raised(self) -> float:
        """How far the lowest corner of the object is above the table now, m."""
        X_WB = self.task.read("body_poses")[int(self.station.object_in_plant.body.index())]
        outline = np.asarray(self.obj.outline.exterior.coords)[:, :2]
        flat = np.column_stack([outline, np.zeros(len(outline))])
        return float((X_WB.rotation().matrix() @ flat.T)[2].min() + X_WB.translation()[2])

    def _admit(self, seen: ObservedPush) -> bool:
        """Whether the object was wholly on the table, as far as it was seen: the model knows no edge."""
        poses = np.vstack([seen.pose[None], seen.poses_observed])
        return bool(find_supported(self.obj, poses, self.surface).all())

    def _mark_overhang(self, log: PushLog) -> PushLog:
        """The log, saying of each push whether a part of the object hung over the table's edge."""
        return replace(log, pushes=tuple(replace(seen, overhang=not self._admit(seen)) for seen in log))

    def _make_limits(self) -> ArmLimits:
        station = self.station
        return ArmLimits(
            finger_region=MakeFingerRegion(station),
            edge_region=self._finder.find_edge(),
            can_push=lambda push: station.FindObstacle(PushCommand.from_push(1, push)) is None,
            can_grasp=self._finder.can_grasp,
        )

    def _make_controller(self) -> PreGraspController:
        pregrasp = self._scenario.pregrasp
        return PreGraspController(
            self.planner,
            self._finder.find_grasp,
            grasp_height=self._scenario.object_height / 2,
            lift=pregrasp.lift,
            seed=self._scenario.seed,
        )


@dataclass(eq=False)
class _Watch:
    """Follows a run: writes down what is done, and decides when it is over."""

    run: PreGraspTask
    record: PreGraspRecord
    last_new: float = 0.0
    sight: Sight = field(default_factory=lambda: Sight(LOST_AFTER))

    def judge(self, time: float) -> Judgment:
        """Status and message."""
        self.note(time)
        status, run = self.record.last, self.run
        lost = self.sight.is_lost(time, run.task.read("object.pose"))
        if np.isnan(run.task.read("object.pose_true")).any():
            return DROPPED, f"The object fell: {status.reason}"
        if status.mode == PreGraspMode.HOLDING:
            wanted = LIFTED_SHARE * run._scenario.pregrasp.lift
            if self.record.raised >= wanted:
                return HELD, f"The object was lifted and held, {1e3 * self.record.raised:.0f} mm above the table."
            return DROPPED, f"The gripper holds something, but the object is not up: {1e3 * self.record.raised:.0f} mm."
        if status.mode == PreGraspMode.FAILED:
            return FAILED, status.reason
        if lost and self.at_rest:
            return LOST, f"The object has not been seen for {LOST_AFTER:g} s."
        if time - self.last_new > TIMEOUT:
            return STUCK, f"Nothing happened for {TIMEOUT:g} s: {status.reason}"
        return GO_ON

    @property
    def at_rest(self) -> bool:
        """Whether the robot does nothing, its finger up."""
        read = self.run.task.read
        return bool(read("executor.status").ready and read("grasp.status").ready)

    def note(self, time: float) -> None:
        """Writes down what is new."""
        record, read = self.record, self.run.task.read
        record.note_learned(self.run.task)
        record.raised = self.run.calc_raised()
        status = read("status", self.run.controller)
        if status is record.last:
            return
        self.last_new = time
        push = PushCommand.from_vector(read("push_command", self.run.controller))
        grasp = GraspCommand.from_vector(read("grasp_command", self.run.controller))
        pushing = status.mode in (PreGraspMode.EXPLORING, PreGraspMode.SLIDING)
        record.steps.append(
            PreGraspStep(
                time,
                status,
                np.array(read("object.pose")),
                push if pushing else None,
                grasp if status.mode == PreGraspMode.GRASPING else None,
                len(record.estimates[-1].push_names) if record.estimates else 0,
            )
        )


def make_options(scenario: PushScenario) -> PreGraspOptions:
    """The planner's options, by a scenario."""
    pregrasp, radius, speed = scenario.pregrasp, scenario.finger.tip_radius, scenario.pokes.speed
    slide = SlideOptions()
    contact: ContactOptions = replace(slide.contact, radius=radius, speed=speed, clearance=CLEARANCE)
    return PreGraspOptions(
        goal=GoalOptions(margin=pregrasp.margin),
        slide=replace(slide, margin=ACCEPTED_SHARE * pregrasp.margin, contact=contact),
        poke=PokeOptions(radius=radius, speed=speed, clearance=CLEARANCE),
        min_pokes=pregrasp.min_pokes,
        max_pokes=pregrasp.max_pokes,
        max_slides=pregrasp.max_slides,
        max_arm=pregrasp.max_arm,
    )

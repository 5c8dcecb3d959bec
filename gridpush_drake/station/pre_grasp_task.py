"""The whole story: poke an unknown object, learn it, slide it to the table's edge, grasp what hangs over, lift it."""

from dataclasses import dataclass, field, replace
from math import atan2

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.arm_limits import ArmLimits
from gridpush_drake.planning.contact_point import ContactOptions
from gridpush_drake.planning.exploration import PokeOptions
from gridpush_drake.planning.pregrasp import ACCEPTED_SHARE, PreGraspOptions, PreGraspPlanner
from gridpush_drake.planning.pregrasp_goal import GoalOptions, PreGraspGoal
from gridpush_drake.planning.side_grasp import SideGrasp, SideGripper, find_side_grasps
from gridpush_drake.planning.slide_push import SlideOptions
from gridpush_drake.planning.surface import SupportSurface
from gridpush_drake.pushes.log import ObservedPush, PushLog
from gridpush_drake.scene.meshcat_server import AimCamera
from gridpush_drake.scene.scenario import PushScenario
from gridpush_drake.station.conduct import Conduct
from gridpush_drake.station.experiment import AddEstimateVisualizer
from gridpush_drake.station.finger_region import MakeFingerRegion
from gridpush_drake.station.push_station import Learning, MakePushStation, PushStation
from gridpush_drake.station.task_run import Progress, TaskRun
from gridpush_drake.systems import pre_grasp_status
from gridpush_drake.systems.grasp_command import GraspCommand
from gridpush_drake.systems.pre_grasp_controller import PreGraspController
from gridpush_drake.systems.pre_grasp_status import PreGraspStatus
from gridpush_drake.systems.push_command import PushCommand

Array = NDArray[np.float64]

HELD, DROPPED, FAILED, LOST, STUCK = "held", "dropped", "failed", "lost", "stuck"

MEMORY = 14
"""Pushes: the latest ones are learned from; the cost of learning grows with them, what they tell hardly does."""

CLEARANCE = 0.006
"""Between finger and object where a push begins, m: it comes down beside an object seen to about a millimetre."""

RIM_DETAIL = 5e-4
"""m by which the rim may be simplified, inwards: of a round table to a polygon of few corners."""

RIM_STEP = 0.03
"""m along the rim, between places that the gripper is tried at."""

RIM_SPARE = 0.002
"""m between the gripper's tips and the rim, beyond their least clearance, where places of the rim are tried."""

GRASP_STEP = 0.002
"""m between grasp points tried: a narrow handle has room for the pads along its middle only."""

GRASPS_TRIED = 12
"""Of those found at a pose, that the arm is asked about."""

LIFTED_SHARE = 0.7
"""Of the lift, that the object's lowest point must truly have been raised by to count as held."""

PATIENCE = 60.0
"""Simulated without anything new, after which the task is stuck, s."""

CAMERA_BACK, CAMERA_LEFT, CAMERA_UP = 0.08, 0.12, 0.08
"""m from where the object begins to what Meshcat's camera looks at."""

CAMERA_DISTANCE, CAMERA_AZIMUTH, CAMERA_ELEVATION = 0.95, 0.25, 0.45
"""Of Meshcat's camera, m, rad and rad: beyond the rim that things are slid to."""

LOST_AFTER = 10.0
"""Simulated without the object being seen, after which it is not waited for any longer, s."""


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
class PreGraspRecord:
    """What came of a run; filled while it runs.

    Attributes:
        obj: the object, with what is known of its friction.
        truth: what it really weighs and how it rubs.
        surface: the table.
        log: all pushes, in order.
        estimates: the identification after each push learned from.
        steps: what the controller did.
        status: "held", "dropped", "failed", "lost", "stuck" or "interrupted"; empty while it runs.
        message: the status in a sentence.
        raised: how far the object's lowest point was above the table at the end, m.
        conduct: how the robot behaved.
        duration: simulated, s.
    """

    obj: GridObject
    truth: CellParameters
    surface: SupportSurface
    log: PushLog = field(default_factory=lambda: PushLog(()))
    estimates: list[Identification] = field(default_factory=list)
    steps: list[PreGraspStep] = field(default_factory=list)
    status: str = ""
    message: str = ""
    raised: float = float("nan")
    conduct: Conduct = field(default_factory=Conduct)
    duration: float = 0.0

    @property
    def last(self) -> PreGraspStatus:
        """The controller's last status."""
        return self.steps[-1].status if self.steps else PreGraspStatus()


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
        learning = Learning(most_pushes=None, memory=MEMORY, admit=self._admit)
        self.station: PushStation = builder.AddSystem(
            MakePushStation(scenario, meshcat, show_object=False, learning=learning)
        )
        station = self.station
        if station.gripper is None:
            raise ScenarioError("directives: there is no model gripper; expected a scene that can grasp")
        self.surface = SupportSurface(_simplify(station.table_top))
        low, high = scenario.pregrasp.friction
        prior = replace(station.obj.prior, friction=float(np.sqrt(low * high)), friction_min=low, friction_max=high)
        self.obj = replace(station.obj, prior=prior)
        self.planner = PreGraspPlanner(self.obj, self.surface, make_options(scenario), limits=self._make_limits())
        self.controller = builder.AddNamedSystem("controller", self._make_controller())
        for port, source in (
            ("object_pose", "object.pose"),
            ("identification", "estimate.identification"),
            ("push_log", "estimate.push_log"),
            ("push_status", "executor.status"),
            ("grasp_status", "grasp.status"),
        ):
            builder.Connect(station.GetOutputPort(source), self.controller.GetInputPort(port))
        for port in ("push_command", "grasp_command"):
            builder.Connect(self.controller.GetOutputPort(port), station.GetInputPort(port))
        if meshcat is not None:
            AddEstimateVisualizer(builder, station, self.controller, meshcat)
        diagram = builder.Build()
        diagram.set_name("pre_grasp_task")
        self.task = TaskRun(station, diagram)

    def AimCamera(self, meshcat: Meshcat) -> None:
        """Points Meshcat's camera at where the object begins and where it may be grasped."""
        x, y, _ = self._scenario.object_pose
        target = (x - CAMERA_BACK, y + CAMERA_LEFT, CAMERA_UP)
        AimCamera(meshcat, target, CAMERA_DISTANCE, CAMERA_AZIMUTH, CAMERA_ELEVATION)

    def run(
        self, seed: int | None = None, progress: Progress | None = None, realtime_rate: float = 0.0
    ) -> PreGraspRecord:
        """Runs the task from its beginning.

        Args:
            seed: of everything random, instead of the scenario's.
            progress: see `Progress`.
            realtime_rate: at most so many simulated seconds a second; 0 for as fast as possible.

        Returns:
            What came of it. Ctrl-C ends it early, with what there is by then.
        """
        record = PreGraspRecord(self.obj, self.station.truth, self.surface)
        watch = _Watch(self, record)
        end = self.task.run(watch.judge, seed, progress, realtime_rate)
        watch.note(end.duration)
        record.truth = self.station.truth
        record.status, record.message = end.status, end.message
        record.conduct, record.duration = end.conduct, end.duration
        return record

    def find_grasp(self, pose: Array, centre_of_mass: Array) -> SideGrasp | None:
        """How the gripper takes the object at `pose` (3,), as near its centre of mass (2,), body frame, as it can."""
        found = find_side_grasps(
            self.obj,
            pose,
            self.surface,
            self._gripper,
            centre_of_mass,
            height=self._scenario.object_height,
            step=GRASP_STEP,
        )
        for grasp in found[:GRASPS_TRIED]:
            if self.station.FindGraspObstacle(self._make_command(grasp)) is None:
                return grasp
        return None

    def calc_raised(self) -> float:
        """How far the lowest corner of the object is above the table now, m."""
        X_WB = self.task.read("body_poses")[int(self.station.object_in_plant.body.index())]
        outline = np.asarray(self.obj.outline.exterior.coords)[:, :2]
        flat = np.column_stack([outline, np.zeros(len(outline))])
        return float((X_WB.rotation().matrix() @ flat.T)[2].min() + X_WB.translation()[2])

    @property
    def _gripper(self) -> SideGripper:
        return SideGripper()

    def _make_command(self, grasp: SideGrasp) -> GraspCommand:
        x, y = grasp.p_WG.tolist()
        return GraspCommand(1, x, y, self._scenario.object_height / 2, grasp.approach, self._scenario.pregrasp.lift)

    def _admit(self, seen: ObservedPush) -> bool:
        """Whether the object was wholly on the table, as far as it was seen: the model knows no edge."""
        poses = np.vstack([seen.pose[None], seen.poses_observed])
        return bool(self.surface.contains(self.obj.cells_at(poses)).all())

    def _make_limits(self) -> ArmLimits:
        station = self.station
        return ArmLimits(
            finger_region=MakeFingerRegion(station),
            rim_region=self._find_rim(),
            can_push=lambda push: station.FindObstacle(PushCommand.from_push(1, push)) is None,
            can_grasp=self._can_grasp,
        )

    def _can_grasp(self, goal: PreGraspGoal) -> bool:
        return self.find_grasp(goal.pose, goal.part.p_BG) is not None

    def _find_rim(self) -> BaseGeometry:
        """Where on the rim the gripper can take something, come in straight across."""
        out = self._gripper.jaw_reach + self._gripper.table_clearance + RIM_SPARE
        places = []
        for s in np.arange(0.0, self.surface.perimeter, RIM_STEP):
            point, normal = self.surface.rim_at(float(s))
            x, y = (point + out * normal).tolist()
            command = GraspCommand(
                1, x, y, self._scenario.object_height / 2, atan2(-normal[1], -normal[0]), self._scenario.pregrasp.lift
            )
            if self.station.FindGraspObstacle(command) is None:
                places.append(shapely.Point(point).buffer(RIM_STEP))
        if not places:
            raise StationError("the gripper reaches no place of the table's rim; expected a table beside the robot")
        return shapely.union_all(places)

    def _make_controller(self) -> PreGraspController:
        pregrasp = self._scenario.pregrasp
        return PreGraspController(
            self.planner,
            self.find_grasp,
            (pregrasp.friction[0], pregrasp.friction[1]),
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
    last_seen: float = 0.0

    def judge(self, time: float) -> tuple[str, str]:
        """Status and message; empty while it goes on."""
        self.note(time)
        status, run = self.record.last, self.run
        if np.isnan(run.task.read("object.pose_true")).any():
            return DROPPED, f"The object fell: {status.reason}"
        if status.mode == pre_grasp_status.HOLDING:
            wanted = LIFTED_SHARE * run._scenario.pregrasp.lift
            if self.record.raised >= wanted:
                return HELD, f"The object was lifted and held, {1e3 * self.record.raised:.0f} mm above the table."
            return DROPPED, f"The gripper holds something, but the object is not up: {1e3 * self.record.raised:.0f} mm."
        if status.mode == pre_grasp_status.FAILED:
            return FAILED, status.reason
        if time - self.last_seen > LOST_AFTER:
            return LOST, f"The object has not been seen for {LOST_AFTER:g} s."
        if time - self.last_new > PATIENCE:
            return STUCK, f"Nothing happened for {PATIENCE:g} s: {status.reason}"
        return "", ""

    def note(self, time: float) -> None:
        """Writes down what is new."""
        record, read = self.record, self.run.task.read
        record.log = read("estimate.push_log")
        found = read("estimate.identification")
        if found is not None and (not record.estimates or found is not record.estimates[-1]):
            record.estimates.append(found)
        pose = np.array(read("object.pose"))
        if np.isfinite(pose).all():
            self.last_seen = time
        record.raised = self.run.calc_raised()
        status = read("status", self.run.controller)
        if status is record.last:
            return
        self.last_new = time
        push = PushCommand.from_vector(read("push_command", self.run.controller))
        grasp = GraspCommand.from_vector(read("grasp_command", self.run.controller))
        pushing = status.mode in (pre_grasp_status.EXPLORING, pre_grasp_status.SLIDING)
        record.steps.append(
            PreGraspStep(
                time,
                status,
                pose,
                push if pushing else None,
                grasp if status.mode == pre_grasp_status.GRASPING else None,
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
        least_pokes=pregrasp.least_pokes,
        most_pokes=pregrasp.most_pokes,
        most_slides=pregrasp.most_slides,
        most_arm=pregrasp.most_arm,
    )


def _simplify(top: BaseGeometry) -> shapely.Polygon:
    if not isinstance(top, shapely.Polygon):
        raise ScenarioError("directives: the table's top is in several pieces; expected one")
    return shapely.simplify(top, RIM_DETAIL)

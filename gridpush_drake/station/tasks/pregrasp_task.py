"""The pre-grasp task: poke and learn an object, slide it to the table's edge, grasp and lift it.

`SlideTask` does the same up to the grasp, which it leaves to somebody else. So it needs no gripper
that points at the table's edge, and a gripper that pushes slides the object, too.

If nothing is told of the object, it is weighed on the way, where else the task would have to give
up: the finger presses on what hangs over the edge (`planning.weighing`).

`GraspFinder` finds how the station's gripper can take the object, and where on the table's edge.
"""

from dataclasses import dataclass, replace
from math import atan2
from typing import Any, ClassVar

import numpy as np
import shapely
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.errors import PlanningError, StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.exploration.designed_pokes import PokeOptions
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.goals import ArmLimits, GoalOptions, PreGraspGoal
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import FlatPart, find_held_grasps
from gridpush_drake.planning.pregrasp.grasp.gripper import PadLimit
from gridpush_drake.planning.pregrasp.grasp.side_grasp import SideGrasp, choose_varied
from gridpush_drake.planning.pregrasp.planner import ACCEPTED_FRACTION, PreGraspPlanner
from gridpush_drake.planning.pregrasp.slides import SlideOptions
from gridpush_drake.planning.pregrasp.weighing_planner import TiltTestOptions, TiltTestPlanner
from gridpush_drake.planning.support_surface import SupportSurface, stayed_supported
from gridpush_drake.planning.weighing.plan import PressRules
from gridpush_drake.planning.weighing.sequence import SequenceOptions
from gridpush_drake.station.control.robot_control import PRESS_FRACTION, Learning
from gridpush_drake.station.robot.measures import GripperMeasures
from gridpush_drake.station.robot.robot import Robot
from gridpush_drake.station.scene.finger_region import MakeFingerRegion
from gridpush_drake.station.scene.resolve import ResolvedScenario
from gridpush_drake.station.scene.setting import make_surface
from gridpush_drake.station.simulated.station import Station
from gridpush_drake.station.tasks.task import (
    ControlledRecord,
    Judgment,
    StationTask,
    TaskStatus,
    Waiting,
)
from gridpush_drake.systems.base.messages import (
    GraspCommand,
    PreGraspMode,
    PreGraspStatus,
)
from gridpush_drake.systems.control.pregrasp_controller import PreGraspController
from gridpush_drake.units import MM_PER_M

EDGE_STEP = 0.03
"""Distance along the table's edge between the places at which the gripper is tried, m."""

EDGE_SPARE = 0.002
"""Distance between gripper and edge beyond the least clearance when places of the edge are tried,
m."""

GRASPS_TRIED = 16
"""Greatest number of grasps at a pose, all different, that the arm is led to."""


@dataclass(frozen=True, eq=False)
class GraspFinder:
    """Finds grasps that the arm can carry out.

    Attributes:
        station: a station with a gripper.
        obj: the object.
        surface: the table, as planners know it.
        pads: what the pads of the gripper can hold.
        grasps: whether the station's own arm is to grasp.
    """

    station: Station
    obj: GridObject
    surface: SupportSurface
    pads: PadLimit
    grasps: bool = True

    def find_grasp(
        self, pose: Array, aim: Array, masses: PlausibleMassSet, at_worst: bool
    ) -> SideGrasp | None:
        """Finds a grasp that holds the object and that the arm can carry out.

        Args:
            pose: (3,) X_WB of the object, m and rad.
            aim: (2,) p_BA of a point to which the grasp should be as near as it can, m.
            masses: the masses that the object may have.
            at_worst: whether the pads must hold the object for each of the masses, not only for
                the estimated one.

        Returns:
            The grasp; None if there is none.
        """
        height = self.station.scenario.object_height
        found = find_held_grasps(
            self.obj,
            pose,
            self.surface,
            self.pads,
            aim=aim,
            height=height,
            masses=masses,
            at_worst=at_worst,
        )
        for grasp in choose_varied(found, GRASPS_TRIED):
            if self._is_reached(grasp.p_WG, grasp.approach):
                return grasp
        return None

    def can_grasp(self, goal: PreGraspGoal, masses: PlausibleMassSet) -> bool:
        """Returns whether the gripper can take the object at a goal, and hold it.

        A flat part is taken by its rim and must be held for each of the masses.
        """
        at_worst = isinstance(goal.part, FlatPart)
        return self.find_grasp(goal.pose, goal.part.p_BG, masses, at_worst) is not None

    def find_edge(self) -> BaseGeometry:
        """Finds where on the table's edge the gripper can take something, coming straight in.

        Returns:
            Discs about places of the edge, in W, m.

        Raises:
            StationError: there is no such place.
        """
        out = self.pads.gripper.jaw_reach + self.pads.gripper.table_clearance + EDGE_SPARE
        places = []
        for s in np.arange(0.0, self.surface.perimeter, EDGE_STEP):
            point, normal = self.surface.edge_at(float(s))
            if self._is_reached(point + out * normal, atan2(-normal[1], -normal[0])):
                places.append(shapely.Point(point).buffer(EDGE_STEP))
        if not places:
            raise StationError(
                "the gripper reaches no place of the table's edge; "
                "expected a table beside the robot"
            )
        return shapely.union_all(places)

    def _is_reached(self, p_WG: Array, approach: float) -> bool:
        """Returns whether the arm can grasp at p_WG (2,), m, coming in along `approach`, rad.

        It can everywhere where somebody else grasps.
        """
        if not self.grasps:
            return True
        scenario = self.station.scenario
        x, y = p_WG.tolist()
        command = GraspCommand(
            command_id=1,
            x=x,
            y=y,
            z=scenario.object_height / 2,
            approach=approach,
            lift=scenario.pregrasp.lift,
        )
        return self.station.FindGraspObstacle(command) is None


@dataclass(repr=False)
class PreGraspRecord(ControlledRecord[PreGraspStatus]):
    """What came of a run. It is filled while the task runs.

    Attributes:
        raised: height of the object's lowest point above the table at the end, m; NaN if nobody
            knows it.
    """

    raised: float = float("nan")


APPROACH_CLEARANCE = 0.006
"""Distance between finger and object where a push begins, m. The finger comes down beside an object
that is seen to about a millimeter."""

FELT_SPEED = 0.03
"""Greatest speed of a push if the object is weighed, m/s. The forces of faster pushes accelerate
small objects, too, and do not show their friction alone."""

LIFTED_FRACTION = 0.7
"""An object counts as held if its lowest point was raised by more than this fraction of the
lift."""


class PreGraspTask(StationTask[PreGraspRecord]):
    """The station with a controller that explores, slides, grasps and lifts.

    Attributes:
        grasps: whether it grasps and lifts; else it is done where the object could be grasped.
        obj: the object, as the robot knows it.
        surface: the table, as planners know it.
        planner: decides for the controller what to do next.
    """

    lost_after = 10.0
    timeout = 60.0
    learning = Learning()
    grasps: ClassVar[bool] = True

    def AddController(self, builder: DiagramBuilder) -> PreGraspController:
        """Adds the controller, and makes the planner that decides for it.

        Raises:
            StationError: the gripper reaches no place of the table's edge.
            PlanningError: the object is too thick for the gripper, the gripper's pads fit nowhere
                on it, or the table is smaller than it.
        """
        station = self.station
        scenario = station.scenario
        self.surface = make_surface(station.table_top)
        self.obj = station.obj
        self._finder, options = make_finder(station, self.surface, self.grasps)
        kind = TiltTestPlanner if scenario.unknown_inertia else PreGraspPlanner
        self.planner = kind(
            self.obj,
            self.surface,
            options,
            limits=self._make_limits(),
            obstacles=station.obstacles,
        )
        if isinstance(self.planner, TiltTestPlanner):
            self.planner.weighing = make_tilt_test_options(station)
        controller: PreGraspController = builder.AddNamedSystem(
            "controller", self._make_controller()
        )
        return controller

    @classmethod
    def list_faults(cls, resolved: ResolvedScenario) -> list[str]:
        """Lists why the object cannot be grasped; see `StationTask.list_faults`."""
        return list_gripper_faults(resolved, cls.grasps)

    def make_record(self) -> PreGraspRecord:
        """Makes the empty record of a run."""
        return PreGraspRecord(
            obj=self.obj,
            truth=self.station.truth,
            surface=self.surface,
            last=PreGraspStatus(),
        )

    def note(self, record: PreGraspRecord, time: float) -> bool:
        """Writes down how high the object is, and what the controller does."""
        if self.simulated:
            record.raised = calc_raised(self)
        return self.note_step(record, time)

    def judge(self, record: PreGraspRecord, waiting: Waiting) -> Judgment:
        """Decides whether the object is where it should be or lost, or there is no way on."""
        status = record.last
        if self.simulated and np.isnan(self.read(self.judged_pose)).any():
            return TaskStatus.DROPPED, f"The object fell: {status.reason}"
        if status.mode == PreGraspMode.READY:
            return TaskStatus.REACHED, status.reason
        if status.mode == PreGraspMode.HOLDING:
            return judge_lift(self, record.raised, "The object")
        if status.mode == PreGraspMode.FAILED:
            return TaskStatus.FAILED, status.reason
        at_rest = not self.is_at_work() and (not self.grasps or self.read("grasp.status").ready)
        if waiting.unseen > self.lost_after and at_rest:
            return TaskStatus.LOST, f"The object has not been seen for {self.lost_after:g} s."
        return self.judge_idle(waiting, status.reason)

    def finish(self, record: PreGraspRecord) -> None:
        """Marks the pushes in which a part hung over the edge, and cuts what was seen in the grasp.

        If anything was weighed, the last estimate is learned from all pushes and weighings.

        While the gripper holds the object it does not lie on the table, and what the camera says of
        its pose there means nothing.
        """
        grasp_times = [
            step.time for step in record.steps if step.status.mode == PreGraspMode.GRASPING
        ]
        if record.camera_view is not None:
            record.camera_view = record.camera_view.until(grasp_times[0] if grasp_times else np.inf)
        pushes = tuple(
            replace(seen, overhang=not stayed_supported(self.obj, seen, self.surface))
            for seen in record.log
        )
        record.log = replace(record.log, pushes=pushes)
        if len(record.weighings):
            learned = self.station.LearnAll(self.simulator.get_context())
            known = any(learned is one for one in record.estimates[-1:])
            if learned is not None and learned.push_names and not known:
                record.estimates.append(learned)

    def could_hold(self) -> bool:
        """Says whether a robot that knew masses and frictions would see a way to hold the object.

        It would if the planner, given them, slides the object towards a goal from where it lies at
        first.

        Raises:
            StationError: nobody knows the hidden masses, for nothing is simulated.
        """
        truth = self.station.truth
        if truth is None:
            raise StationError("nothing is simulated; expected a station whose truth is known")
        prior = replace(self.obj.prior, total_mass=float(truth.mass.sum()))
        obj = replace(self.obj, prior=prior)
        pads = self._finder.pads
        finder = replace(self._finder, obj=obj, pads=pads.gripper.limit_pads(obj, pads.force))
        knowing = PreGraspPlanner(
            obj,
            self.surface,
            self.planner.options,
            self.planner.parts,
            limits=replace(self.planner.limits, can_grasp=finder.can_grasp),
            obstacles=self.planner.obstacles,
        )
        belief = Belief.of_parameters(Bodies(obj, truth))
        decision = knowing.decide(self.station.scenario.object_pose, belief)
        return decision.action in ("slide", "grasp")

    def _make_limits(self) -> ArmLimits:
        """Makes the limits of what the planner may ask of the arm."""
        station = self.station
        finger_region = MakeFingerRegion(station)
        return ArmLimits(
            finger_region=finger_region,
            edge_region=self._find_edge(finger_region),
            # No methods of the task: the controller would hold the task, whose Simulator holds the
            # controller where Python's garbage collector cannot see it.
            can_push=station.CanPush,
            can_grasp=self._finder.can_grasp,
            can_press=station.CanPress if station.scenario.unknown_inertia else None,
        )

    def _find_edge(self, finger_region: BaseGeometry) -> BaseGeometry:
        """Finds where on the table's edge the object may be taken, in W, m."""
        return self._finder.find_edge()

    def _make_controller(self) -> PreGraspController:
        """Makes the controller, which grasps at half the object's height."""
        scenario = self.station.scenario
        return PreGraspController(
            self.planner,
            self._finder.find_grasp if self.grasps else None,
            grasp_height=scenario.object_height / 2,
            lift=scenario.pregrasp.lift,
            seed=scenario.seed,
            answer_delay=scenario.simulation.answer_delay,
            weighs=scenario.unknown_inertia,
        )


class SlideTask(PreGraspTask):
    """The station with a controller that explores and slides, and leaves the grasp to others."""

    takes_gripper = True
    grasps = False

    def _find_edge(self, finger_region: BaseGeometry) -> BaseGeometry:
        """Finds the table's edge as far as the pusher gets to it, in W, m.

        Raises:
            StationError: it gets to no place of the edge.
        """
        near = finger_region.buffer(EDGE_STEP)
        if not near.intersects(self.surface.polygon.exterior):
            raise StationError(
                "workspace: the pusher gets to no place of the table's edge; expected to be within "
                f"{EDGE_STEP:g} m of it somewhere"
            )
        return near


def make_tilt_test_options(station: Station) -> TiltTestOptions:
    """Makes the options by which a station's object is weighed."""
    scenario = station.scenario
    rules = PressRules(
        tip_radius=station.robot.finger.tip_radius,
        max_force=PRESS_FRACTION * scenario.safety.force,
    )
    return TiltTestOptions(
        sequence=SequenceOptions(rules=rules),
        max_presses=scenario.weighing.max_presses,
        top=scenario.object_height,
    )


def _find_gripper(robot: Robot, grasps: bool) -> GripperMeasures | None:
    """Finds the measures of the gripper by which an object can be grasped.

    One that pushes points down, and cannot grasp at the table's edge itself.
    """
    return robot.gripper if grasps or robot.gripper else robot.pushing_gripper


def calc_raised(task: StationTask[Any]) -> float:
    """Calculates the height of the pushed object's lowest corner above the table now, m."""
    station = task.station
    X_WB = task.read("body_poses")[int(station.object_in_plant.body.index())]
    outline = np.asarray(station.obj.outline.exterior.coords)[:, :2]
    # The corners of the object's bottom: B's origin is at the height of the bottom.
    p_BK = np.column_stack([outline, np.zeros(len(outline))])
    return float((X_WB.rotation().matrix() @ p_BK.T)[2].min() + X_WB.translation()[2])


def judge_lift(task: StationTask[Any], raised: float, what: str, more: str = "") -> Judgment:
    """Judges whether the gripper that has closed and gone up truly holds the object.

    Args:
        task: the task.
        raised: height of the object's lowest point above the table, m.
        what: what to call the object at the beginning of a sentence.
        more: what else is true if it is held.
    """
    if not task.simulated:
        return TaskStatus.HELD, "The gripper lifted the object and holds it."
    height = f"{MM_PER_M * max(0.0, raised):.0f} mm"
    if raised >= LIFTED_FRACTION * task.station.scenario.pregrasp.lift:
        return TaskStatus.HELD, f"{what} was lifted and held, {height} above the table{more}."
    return TaskStatus.NOT_LIFTED, (
        f"The gripper closed and went up, but the object did not: {height}."
    )


def make_finder(
    station: Station, surface: SupportSurface, grasps: bool = True
) -> tuple[GraspFinder, PreGraspOptions]:
    """Makes what finds grasps of a station's object, and the planner's options.

    Args:
        station: the station.
        surface: the table.
        grasps: whether the station's own arm is to grasp.

    Raises:
        PlanningError: the object is too thick for the gripper, or its pads fit nowhere on it.
    """
    scenario = station.scenario
    measures = _find_gripper(station.robot, grasps)
    assert measures is not None
    gripper = measures.make_gripper()
    force = gripper.limit_force(scenario.pregrasp.force)
    gripper.check_thickness(station.obj, scenario.object_height)
    pads = gripper.limit_pads(station.obj, force)
    finder = GraspFinder(station, station.obj, surface, pads, grasps)
    # how the object is poked and slid
    pregrasp = scenario.pregrasp
    speed = scenario.pokes.speed
    if scenario.unknown_inertia:
        speed = min(speed, FELT_SPEED)
    slide = SlideOptions()
    pusher = replace(station.robot.pusher, speed=speed, clearance=APPROACH_CLEARANCE)
    contact: ContactOptions = replace(slide.contact, pusher=pusher)
    options = PreGraspOptions(
        gripper=gripper,
        pad_force=force,
        goal=GoalOptions(margin=pregrasp.margin),
        slide=replace(slide, margin=ACCEPTED_FRACTION * pregrasp.margin, contact=contact),
        poke=PokeOptions(pusher),
        min_pokes=pregrasp.min_pokes,
        max_pokes=pregrasp.max_pokes,
        max_slides=pregrasp.max_slides,
        max_arm=pregrasp.max_arm,
    )
    return finder, options


def list_gripper_faults(resolved: ResolvedScenario, grasps: bool = True) -> list[str]:
    """Lists why the robot cannot grasp a scenario's object, as far as its height tells.

    A camera measures the object's height: it is not known here how high it will find it.

    Args:
        resolved: the scenario.
        grasps: whether the robot itself is to grasp; else its gripper says what can be grasped.
    """
    scenario = resolved.scenario
    gripper = _find_gripper(resolved.robot, grasps)
    if gripper is None:
        return ["directives: there is no model gripper; expected a scene that can grasp"]
    if scenario.camera.kind != "ideal":
        return []
    try:
        gripper.make_gripper().check_thickness(resolved.obj, scenario.object_height)
    except PlanningError as error:
        return [f"{scenario.names.name_field(0, 'height')}: {error}"]
    return []

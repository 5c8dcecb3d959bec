"""Tasks with several objects in the station: separate them, rearrange them, or fetch one.

The scenario's `object` is object 0, and its `others` are the objects after it, in their order. All
are seen by ideal cameras, or followed by one color and depth camera (`station.scene.scene_camera`).
"""

from dataclasses import dataclass, field, replace
from os import cpu_count

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder

from gridpush_drake.display.shapes import AddGhost, MakePlanarTransform
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.images.camera_view import SceneCameraView
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.closed_loop import LoopOptions
from gridpush_drake.planning.pregrasp.goals import ArmLimits
from gridpush_drake.planning.pregrasp.grasp.side_grasp import SideGrasp
from gridpush_drake.planning.pregrasp.pregrasp_loop import choose_grasp
from gridpush_drake.planning.scene.fetching import FetchLearning, FetchOptions, FetchPlanner
from gridpush_drake.planning.scene.joint_loop import (
    FindSceneGrasp,
    JointLoop,
    SceneMode,
    SceneStatus,
)
from gridpush_drake.planning.scene.loop import (
    SceneDecision,
    SceneLearner,
    SceneLearning,
    ScenePlanner,
)
from gridpush_drake.planning.scene.rearrangement import (
    RearrangeOptions,
    RearrangePlanner,
    check_goals,
)
from gridpush_drake.planning.scene.rules import SceneRules
from gridpush_drake.planning.scene.search import SceneSearchOptions
from gridpush_drake.planning.scene.separation import (
    SeparatePlanner,
    SeparationOptions,
    calc_clearances,
)
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.station.control.robot_control import Learning
from gridpush_drake.station.scene.finger_region import MakeFingerRegion
from gridpush_drake.station.scene.other_objects import draw_other_truth, list_parts
from gridpush_drake.station.scene.posts import leave_out, place_posts
from gridpush_drake.station.scene.resolve import ResolvedScenario
from gridpush_drake.station.scene.scene_camera import AddPosesTogether
from gridpush_drake.station.scene.setting import make_surface
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.push_station import PushStation
from gridpush_drake.station.tasks.pregrasp_task import (
    APPROACH_CLEARANCE,
    calc_raised,
    judge_lift,
    list_gripper_faults,
    make_finder,
)
from gridpush_drake.station.tasks.push_task import EDGE_MARGIN, GOAL_COLOR, MAX_PUSH
from gridpush_drake.station.tasks.task import (
    ControlledRecord,
    Judgment,
    StationTask,
    TaskStatus,
    Waiting,
)
from gridpush_drake.systems.control.scene_controller import SceneController

GOALS_PATH = "goals"
"""Path in Meshcat of the objects' outlines at their goals."""

PREDICTION_NOISE = (2e-3, 2e-3, 1e-2)
"""Standard deviations of what poses in the station are off from their predictions, m, m and rad."""

DETECTION_OPTIONS = LoopOptions(timeout=3.0)
"""How objects are observed: one may be out of sight for a while behind the arm, which then moves
away."""

MESSAGE_PORT = "camera.message"
"""Name of a port that only a station has whose camera follows several objects."""

PLANNING_DRAWS = 3
"""Number of further models that pushes are tried on."""


@dataclass(repr=False)
class SceneTaskRecord(ControlledRecord[SceneStatus]):
    """What came of a run. It is filled while the task runs.

    Attributes:
        objects: the N objects, object 0 being `obj`.
        names: what to call them.
        goals: (N, 3) goal poses, m and rad; NaN where there are none.
        poses: (N, 3) true X_WB of the objects at the end, m and rad, NaN for one that fell; as they
            were seen last where the robot is real.
        begin: (N, 3) the same before anything was done.
        scene_log: what was seen of each push.
        scene_view: what a color and depth camera saw; None with ideal cameras.
        other_truths: true masses and frictions of the objects after the first; empty if nobody
            knows them.
        belief: what the robot believed of the objects at the end; None before it began.
        raised: height of the lowest point of object 0 above the table at the end, m; NaN if nobody
            knows it.
    """

    objects: tuple[GridObject, ...]
    names: tuple[str, ...]
    goals: Array
    poses: Array
    begin: Array
    scene_log: tuple[ObservedPush, ...] = field(default=(), kw_only=True)
    scene_view: SceneCameraView | None = field(default=None, kw_only=True)
    other_truths: tuple[CellParameters, ...] = field(default=(), kw_only=True)
    belief: Belief | None = field(default=None, kw_only=True)
    raised: float = field(default=float("nan"), kw_only=True)

    def list_objects(self) -> tuple[GridObject, ...]:
        """Lists the N objects."""
        return self.objects

    @property
    def learned(self) -> tuple[Identification, ...]:
        """(N,) what was learned of each object; empty where no push told anything of any."""
        found = () if self.belief is None else self.belief.identifications
        return found if any(each.push_names for each in found) else ()

    @property
    def truths(self) -> tuple[CellParameters, ...]:
        """(N,) true masses and frictions of the objects; empty if nobody knows them."""
        return () if self.truth is None else (self.truth, *self.other_truths)

    @property
    def pushes(self) -> int:
        """Number of pushes that were made."""
        return self.last.pushes

    def list_kinds(self) -> list[str]:
        """Lists what each push that was asked for was for, in a word; empty words in most tasks."""
        return [step.status.kind for step in self.steps if step.push is not None]

    @property
    def clearances(self) -> NDArray[np.float64]:
        """(N,) distance of each object from the nearest other one at the end, m."""
        return np.asarray(calc_clearances(self.objects, self.poses))


class SceneTask(StationTask[SceneTaskRecord]):
    """The station with a controller for a task with several objects.

    A kind of task overrides `make_planner`, and whatever else is different.

    Attributes:
        surface: the table, as planners know it.
        objects: the N objects, as the robot knows them.
        planner: decides for the controller.
    """

    lost_after = 10.0
    timeout = 120.0
    pushes_others = True
    # The station learns nothing by itself.
    learning = Learning(max_pushes=0)
    has_goals = False

    def AddController(self, builder: DiagramBuilder) -> SceneController:
        """Adds the controller, and makes the planner that decides for it.

        Raises:
            PlanningError: goals overlap, or the wanted object cannot be grasped.
        """
        station = self.station
        scenario = station.scenario
        # what the robot knows of the table and the objects
        self.surface = make_surface(station.table_top)
        self.objects = (station.obj, *(other.obj for other in station.others))
        self.names = name_objects(self.objects)
        others = [other.pose for other in station.others]
        self._begin = np.array([scenario.object_pose, *others])
        self.goals = make_goals(scenario) if self.has_goals else np.full_like(self._begin, np.nan)
        self._other_truths: tuple[CellParameters, ...] = ()
        # what decides, between the ports of a system
        self.planner = self.make_planner()
        loop = JointLoop(
            planner=self.planner,
            belief=Belief.of_even_objects(
                self.objects, sample_count=PLANNING_DRAWS, seed=scenario.seed
            ),
            learning=self.make_learning(),
            max_pushes=scenario.goal.max_pushes * len(self.objects),
            find_grasp=self.make_find_grasp(),
            options=DETECTION_OPTIONS,
            seed=scenario.seed,
        )
        controller: SceneController = builder.AddNamedSystem(
            "controller",
            SceneController(
                loop,
                grasp_height=scenario.object_height / 2,
                lift=scenario.pregrasp.lift,
                answer_delay=scenario.simulation.answer_delay,
            ),
        )
        # where all objects are
        ports = [station.GetOutputPort(f"{name}.pose") for name in self.object_names]
        together = AddPosesTogether(builder, ports, "object_poses")
        builder.Connect(together, controller.GetInputPort("object_poses"))
        return controller

    @classmethod
    def list_faults(cls, resolved: ResolvedScenario) -> list[str]:
        """Lists what is missing for several objects; see `StationTask.list_faults`."""
        scenario = resolved.scenario
        faults = []
        if not scenario.others:
            faults.append(
                f"{scenario.names.name_rest()}: empty; expected other objects on the table: "
                "this task is for several. "
                "The shipped scenarios separate, rearrange and fetch have them"
            )
        if scenario.base != "free":
            faults.append(f"base is {scenario.base}; expected free, as the other objects are")
        if cls.has_goals:
            faults += _list_wrong_goals(resolved)
        return faults

    def make_planner(self) -> ScenePlanner:
        """Makes what decides for the controller."""
        raise NotImplementedError

    def make_learning(self) -> SceneLearner:
        """Makes what learns the objects; here all together."""
        return SceneLearning(noise=PREDICTION_NOISE)

    def make_find_grasp(self) -> FindSceneGrasp | None:
        """Makes what finds grasps; None where none is made."""
        return None

    def make_rules(self) -> SceneRules:
        """Makes the rules of pushes: the table's edge, posts, and what the arm reaches."""
        station = self.station
        posts = place_posts(station.scenario.posts)
        reached = MakeFingerRegion(station, around_others=False)
        return SceneRules(
            surface=self.surface,
            edge_margin=EDGE_MARGIN,
            finger_region=leave_out(reached, posts, station.robot.clear_radius),
            posts=posts,
            push_rule=station.CanPush,
        )

    def make_search(self) -> SceneSearchOptions:
        """Makes the options of the search for pushes from the robot's pusher and the scenario."""
        return SceneSearchOptions(
            lengths=(0.005, MAX_PUSH),
            pusher=replace(
                self.station.robot.pusher,
                speed=self.station.scenario.pokes.speed,
                clearance=APPROACH_CLEARANCE,
            ),
            workers=cpu_count() or 1,
        )

    def prepare(self, context: Context, seed: int) -> None:
        """Notes what the other objects truly are in this run, for its record."""
        scenario = self.station.scenario
        self._other_truths = tuple(
            draw_other_truth(scenario, part, number, seed)
            for number, part in enumerate(list_parts(self.station.others))
        )

    def make_record(self) -> SceneTaskRecord:
        """Makes the empty record of a run."""
        poses = self._read_poses()
        return SceneTaskRecord(
            obj=self.station.obj,
            truth=self.station.truth,
            surface=self.surface,
            last=SceneStatus(),
            objects=self.objects,
            names=self.names,
            goals=self.goals,
            poses=poses,
            other_truths=self._other_truths,
            begin=self._begin,
        )

    def list_objects(self) -> tuple[GridObject, ...]:
        """Lists the N objects, as the robot knows them."""
        return self.objects

    def read_estimates(self) -> tuple[Identification, ...]:
        """Returns what is known now of each object (N,); see `StationTask.read_estimates`."""
        context = self.controller.GetMyContextFromRoot(self.simulator.get_context())
        return self.controller.GetState(context).belief.identifications

    def note(self, record: SceneTaskRecord, time: float) -> bool:
        """Writes down where the objects are, and what the controller does."""
        record.poses = self._read_poses()
        new = self.note_step(record, time)
        if new:
            context = self.controller.GetMyContextFromRoot(self.simulator.get_context())
            state = self.controller.GetState(context)
            record.scene_log = state.log
            record.belief = state.belief
        return new or not self.read("executor.status").ready

    def judge(self, record: SceneTaskRecord, waiting: Waiting) -> Judgment:
        """Decides whether the task is done, an object is lost, or it can get no further."""
        status = record.last
        if self.simulated and np.isnan(record.poses).any():
            fallen = np.flatnonzero(np.isnan(record.poses).any(axis=1)).tolist()
            names = ", ".join(self.names[b] for b in fallen)
            return TaskStatus.DROPPED, f"{names} fell during push {status.pushes + 1}."
        if status.mode is SceneMode.DONE:
            return TaskStatus.REACHED, status.reason
        if status.mode is SceneMode.HOLDING:
            return self._judge_held(record)
        if status.mode is SceneMode.FAILED:
            return TaskStatus.FAILED, status.reason
        if status.mode is SceneMode.LOST:
            return TaskStatus.LOST, f"{status.reason} {self._read_message()}".strip()
        return self.judge_idle(waiting, status.reason)

    def _read_message(self) -> str:
        """Returns what a camera says that has not found all objects; empty if it has."""
        if not self.station.HasOutputPort(MESSAGE_PORT):
            return ""
        message = self.read(MESSAGE_PORT)
        return f"The camera: {message}." if message else ""

    def finish(self, record: SceneTaskRecord) -> None:
        """Adds what the camera saw; while the gripper holds an object its pose means nothing."""
        if not isinstance(self.station, PushStation):
            return
        view = self.station.FindSceneView(self.simulator.get_context())
        grasps = [step.time for step in record.steps if step.status.mode is SceneMode.GRASPING]
        if view is not None:
            record.scene_view = view.until(grasps[0] if grasps else np.inf)

    def _judge_held(self, record: SceneTaskRecord) -> Judgment:
        """Judges whether the gripper truly holds the object; here there is none."""
        return TaskStatus.HELD, record.last.reason

    def _read_poses(self) -> Array:
        """Reads where all objects are, (N, 3) m and rad: truly, where that is known."""
        kind = "pose_true" if self.simulated else "pose"
        return np.array([self.read(f"{name}.{kind}") for name in self.object_names])

    def draw_goals(self, meshcat: Meshcat) -> None:
        """Draws the objects' translucent outlines at their goals."""
        meshcat.Delete(GOALS_PATH)
        heights = [self.station.object_in_plant.height]
        heights += [other.height for other in self.station.others]
        for b, (obj, pose, height) in enumerate(
            zip(self.objects, self.goals, heights, strict=True)
        ):
            if np.isfinite(pose).all():
                path = f"{GOALS_PATH}/{b}"
                AddGhost(meshcat, path, obj, height, GOAL_COLOR)
                meshcat.SetTransform(path, MakePlanarTransform(pose))


class SeparateTask(SceneTask):
    """The station with a controller that pushes objects apart."""

    takes_gripper = True

    def make_planner(self) -> SeparatePlanner:
        """Makes the planner; pushes begin where the robot's finger fits."""
        search = replace(self.make_search(), candidates=24, firsts=2, seconds=6, compared=3)
        return SeparatePlanner(
            self.objects,
            SeparationOptions(search=search),
            self.make_rules(),
            seed=self.station.scenario.seed,
        )


ANGLE_A_METER = 10.0
"""Turn from a goal within which an object has reached it, for each meter of the goal's tolerance,
rad/m: 0.2 rad for 2 cm, and about 3 degrees for 5 mm."""

MAX_ANGLE = 0.5
"""Greatest such turn, rad, however great the goal's tolerance is."""


class RearrangeTask(SceneTask):
    """The station with a controller that pushes objects to goals, and learns them on the way."""

    has_goals = True
    takes_gripper = True

    def make_planner(self) -> RearrangePlanner:
        """Makes the planner, towards the scenario's goals."""
        tolerance = self.station.scenario.goal.tolerance
        options = RearrangeOptions(
            position_tolerance=tolerance,
            angle_tolerance=min(ANGLE_A_METER * tolerance, MAX_ANGLE),
            search=self.make_search(),
        )
        return RearrangePlanner(
            self.objects,
            self.goals,
            options,
            self.make_rules(),
            seed=self.station.scenario.seed,
        )


class FetchTask(SceneTask):
    """The station with a controller that clears the way, and grasps the wanted object, object 0."""

    @classmethod
    def list_faults(cls, resolved: ResolvedScenario) -> list[str]:
        """Lists what is missing to fetch an object; see `StationTask.list_faults`."""
        return [*super().list_faults(resolved), *list_gripper_faults(resolved)]

    def make_planner(self) -> FetchPlanner:
        """Makes the planner, with what the gripper can take."""
        station = self.station
        scenario = station.scenario
        # what the gripper can take, and hold
        self._finder, pregrasp = make_finder(station, self.surface)
        # how the way is cleared, and the object is slid
        rules = self.make_rules()
        options = FetchOptions(
            pregrasp=pregrasp,
            search=replace(self.make_search(), candidates=32, firsts=3, seconds=8),
        )
        limits = ArmLimits(
            finger_region=rules.finger_region,
            edge_region=self._finder.find_edge(),
            can_push=rules.push_rule,
            can_grasp=self._finder.can_grasp,
        )
        return FetchPlanner(
            self.objects,
            wanted=0,
            surface=self.surface,
            options=options,
            limits=limits,
            rules=rules,
            seed=scenario.seed,
        )

    def make_learning(self) -> FetchLearning:
        """Learns the wanted object from pushes in which nothing else moved, and all together."""
        friction = self.station.scenario.object_friction
        return FetchLearning(
            0,
            self.surface,
            friction_range=None if friction is None else (friction[0], friction[1]),
            obj=self.station.obj,
            scene=SceneLearning(noise=PREDICTION_NOISE),
        )

    def make_find_grasp(self) -> FindSceneGrasp:
        """Makes what finds a grasp that holds the wanted object where it lies."""
        # Not the task: the controller would hold it, and neither would ever be freed.
        finder = self._finder
        wanted = self.objects[0]

        def find(poses: Array, decision: SceneDecision, belief: Belief) -> SideGrasp | None:
            model = belief.alone.get(0) or Belief.of_prior(wanted)
            return choose_grasp(finder.find_grasp, poses[0], model.masses, decision.goal)

        return find

    def note(self, record: SceneTaskRecord, time: float) -> bool:
        """Writes down how high the wanted object is, too."""
        if self.simulated:
            record.raised = calc_raised(self)
        new = super().note(record, time)
        return new or not self.read("grasp.status").ready

    def _judge_held(self, record: SceneTaskRecord) -> Judgment:
        """Judges whether the gripper that has closed and gone up truly holds the object."""
        return judge_lift(self, record.raised, f"The {self.names[0]}", "; nothing fell")


def name_objects(objects: tuple[GridObject, ...]) -> tuple[str, ...]:
    """Names objects in words; those of one name by their numbers, too."""
    names = [speak_name(obj.name) for obj in objects]
    return tuple(name if names.count(name) == 1 else f"{name} {b}" for b, name in enumerate(names))


def make_goals(scenario: PushScenario) -> Array:
    """Collects the goals of a scenario's objects, (N, 3) m and rad; NaN where there is none."""
    nowhere = [np.nan] * 3
    others = [nowhere if other.goal is None else other.goal for other in scenario.others]
    return np.array([scenario.goal.pose, *others])


def _list_wrong_goals(resolved: ResolvedScenario) -> list[str]:
    """Lists what is wrong with the goals of a scenario's objects."""
    scenario = resolved.scenario
    names = scenario.names
    field = names.name_field(0, "goal")
    if names.has_no_goal:
        return [
            f"{field}: missing; expected [x, y, theta] (m, rad) for the object that is wanted, or "
            "else for the first one; those after it may lie anywhere"
        ]
    objects = (resolved.obj, *resolved.others)
    rules = SceneRules(
        surface=make_surface(resolved.table_top),
        edge_margin=EDGE_MARGIN,
        posts=place_posts(scenario.posts),
    )
    fields = [names.name_field(number, "goal") for number in range(len(objects))]
    try:
        check_goals(objects, make_goals(scenario), rules, fields)
    except PlanningError as error:
        return [str(error)]
    return []

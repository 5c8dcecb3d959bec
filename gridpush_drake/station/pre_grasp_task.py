"""The whole story: poke an unknown object, learn it, slide it to the table's edge, grasp what hangs over, lift it."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.errors import ScenarioError
from gridpush_drake.planning.arm_limits import ArmLimits
from gridpush_drake.planning.contact_point import ContactOptions
from gridpush_drake.planning.exploration import PokeOptions
from gridpush_drake.planning.held_cells import find_held
from gridpush_drake.planning.pregrasp import ACCEPTED_SHARE, PreGraspOptions, PreGraspPlanner
from gridpush_drake.planning.pregrasp_goal import GoalOptions
from gridpush_drake.planning.slide_push import SlideOptions
from gridpush_drake.pushes.log import ObservedPush, PushLog
from gridpush_drake.scene.scenario import PushScenario
from gridpush_drake.station.finger_region import MakeFingerRegion
from gridpush_drake.station.grasp_finder import GraspFinder
from gridpush_drake.station.learning import Learning
from gridpush_drake.station.pre_grasp_record import PreGraspRecord, PreGraspStep
from gridpush_drake.station.push_station import MakePushStation, PushStation
from gridpush_drake.station.table_surface import make_surface
from gridpush_drake.station.task_run import GO_ON, Judgement, Progress, Sight, TaskStatus
from gridpush_drake.station.task_wiring import AimStationCamera, BuildTask
from gridpush_drake.systems import pre_grasp_status
from gridpush_drake.systems.grasp_command import GraspCommand
from gridpush_drake.systems.pre_grasp_controller import PreGraspController
from gridpush_drake.systems.push_command import PushCommand

Array = NDArray[np.float64]

HELD, DROPPED, FAILED = TaskStatus.HELD, TaskStatus.DROPPED, TaskStatus.FAILED
LOST, STUCK = TaskStatus.LOST, TaskStatus.STUCK

MEMORY = 14
"""Pushes: the latest ones are learned from; the cost of learning grows with them, what they tell hardly does."""

CLEARANCE = 0.006
"""Between finger and object where a push begins, m: it comes down beside an object seen to about a millimetre."""

LIFTED_SHARE = 0.7
"""Of the lift, that the object's lowest point must truly have been raised by to count as held."""

PATIENCE = 60.0
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
        learning = Learning(most_pushes=None, memory=MEMORY, admit=self._admit)
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
        return bool(find_held(self.obj, poses, self.surface).all())

    def _mark_overhang(self, log: PushLog) -> PushLog:
        """The log, saying of each push whether a part of the object hung over the table's edge."""
        return replace(log, pushes=tuple(replace(seen, overhang=not self._admit(seen)) for seen in log))

    def _make_limits(self) -> ArmLimits:
        station = self.station
        return ArmLimits(
            finger_region=MakeFingerRegion(station),
            rim_region=self._finder.find_rim(),
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

    def judge(self, time: float) -> Judgement:
        """Status and message."""
        self.note(time)
        status, run = self.record.last, self.run
        lost = self.sight.is_lost(time, run.task.read("object.pose"))
        if np.isnan(run.task.read("object.pose_true")).any():
            return DROPPED, f"The object fell: {status.reason}"
        if status.mode == pre_grasp_status.HOLDING:
            wanted = LIFTED_SHARE * run._scenario.pregrasp.lift
            if self.record.raised >= wanted:
                return HELD, f"The object was lifted and held, {1e3 * self.record.raised:.0f} mm above the table."
            return DROPPED, f"The gripper holds something, but the object is not up: {1e3 * self.record.raised:.0f} mm."
        if status.mode == pre_grasp_status.FAILED:
            return FAILED, status.reason
        if lost and self.at_rest:
            return LOST, f"The object has not been seen for {LOST_AFTER:g} s."
        if time - self.last_new > PATIENCE:
            return STUCK, f"Nothing happened for {PATIENCE:g} s: {status.reason}"
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
        pushing = status.mode in (pre_grasp_status.EXPLORING, pre_grasp_status.SLIDING)
        record.steps.append(
            PreGraspStep(
                time,
                status,
                np.array(read("object.pose")),
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

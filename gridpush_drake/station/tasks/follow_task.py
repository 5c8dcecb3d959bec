"""The task `follow`: an unknown object is poked, learned, and then pushed along a path."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import shapely
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from shapely import Polygon

from gridpush_drake.display.overlay import Mark, to_css
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, transform_shape, wrap_angle
from gridpush_drake.notebook import count as count_noun
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.planning.feedback.follow_calculations import FollowRules
from gridpush_drake.planning.feedback.follow_options import FollowOptions
from gridpush_drake.planning.feedback.pose_path import PathProgress, PosePath
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.report.follow_figure import draw_follow_run, find_centers
from gridpush_drake.report.page import ReportSummary
from gridpush_drake.station.scene.camera import calc_pose_age
from gridpush_drake.station.scene.finger_region import (
    MOST_STEER_YAW,
    STEER_TURNING_SPEED,
    make_steer_region,
)
from gridpush_drake.station.scene.resolve import ResolvedScenario
from gridpush_drake.station.scene.setting import make_surface
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.station import Station
from gridpush_drake.station.tasks.follow_config import FollowConfig
from gridpush_drake.station.tasks.goal_check import check_place, list_misplaced
from gridpush_drake.station.tasks.identify_task import make_policy
from gridpush_drake.station.tasks.push_task import EDGE_MARGIN, AddGoal, PlacedRecord, note_pose
from gridpush_drake.station.tasks.task import (
    GO_ON,
    Judgment,
    StationTask,
    TaskStatus,
    Waiting,
)
from gridpush_drake.station.tasks.task_kind import TaskKind
from gridpush_drake.systems.base.messages import PushStatus
from gridpush_drake.systems.control.follow_controller import (
    BLIND_STATUSES,
    SAMPLE_PERIOD,
    FollowController,
    FollowControlStatus,
    FollowMode,
)
from gridpush_drake.systems.control.poke_policy import PokePolicy
from gridpush_drake.units import MM_PER_M

OBSTACLE_MARGIN = 0.01
"""Least distance that object and finger are meant to keep from an obstacle, m."""

PLANNED_PATH = "follow/planned"
GONE_PATH = "follow/gone"
"""Paths in Meshcat of the lines along which the object's centroid should go, and went."""

PLANNED_COLOR = Rgba(0.16, 0.55, 0.35)
GONE_COLOR = Rgba(0.75, 0.35, 0.15)
"""Colors of these lines."""

LINE_WIDTH = 4.0
"""Width of these lines, pixels."""

LINE_HEIGHT = 0.002
"""Height of these lines above the object's top, m."""


FOLLOW_TITLES = {
    FollowMode.POKING: "Poking the object, to learn it",
    FollowMode.PLANNING: "Planning a path",
    FollowMode.GOING: "The finger goes to the object",
    FollowMode.FOLLOWING: "Pushing along the path",
    FollowMode.REACHED: "At the end of the path",
    FollowMode.FAILED: "Given up",
}
"""Titles beside the recording for the modes of the controller that follows a path."""


@dataclass(repr=False)
class FollowRecord(PlacedRecord[FollowControlStatus]):
    """What came of a run. It is filled while the task runs.

    Attributes:
        obstacles: outlines of what stands in the way, W, m.
        paths: the paths that were followed, in order.
        times: times, s, for `poses` and `tips`.
        poses: (3,) poses of the object while the finger was steered, as `pose`.
        tips: (2,) places of the finger's tip then, W, m.
    """

    obstacles: tuple[Polygon, ...]
    paths: list[PosePath] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    tips: list[Array] = field(default_factory=list)

    @property
    def pokes(self) -> int:
        """Number of pokes that were learned from."""
        return len(self.estimates[-1].push_names) if self.estimates else 0

    @property
    def steering_time(self) -> float:
        """Time for which the finger was steered, s."""
        return self.times[-1] - self.times[0] if self.times else 0.0

    @property
    def way(self) -> Array:
        """(K, 2) places of the cells' centroid while the finger was steered, W, m."""
        return find_centers(self.obj, np.array(self.poses).reshape(-1, 3))

    @property
    def distance(self) -> float:
        """Distance of the cells' centroid from the path's end, m."""
        here, end = find_centers(self.obj, np.stack([self.pose, self.goal]))
        return float(np.linalg.norm(here - end))

    @property
    def turn(self) -> float:
        """Angle from that of the path's end, rad."""
        return abs(float(wrap_angle(self.pose[2] - self.goal[2])))

    def calc_distances(self) -> Array:
        """Calculates the distances (K,) of the centroid from the path that was followed last, m."""
        if not self.paths or not self.poses:
            return np.empty(0)
        return PathProgress(self.obj, self.paths[-1]).measure_distance(self.way)

    def calc_rms(self) -> float:
        """Calculates the root mean square distance of the centroid from its path, m."""
        distances = self.calc_distances()
        return float(np.sqrt((distances**2).mean())) if len(distances) else float("nan")

    def calc_clearance(self) -> float:
        """Calculates the least distance of the object from an obstacle while it was pushed, m."""
        if not self.obstacles or not self.poses:
            return float("inf")
        obstacles = shapely.union_all(list(self.obstacles))
        return min(
            float(obstacles.distance(transform_shape(pose, self.obj.outline)))
            for pose in self.poses
        )


class FollowTask(StationTask[FollowRecord]):
    """The station with a policy that pokes, and a controller that pushes along a path.

    Attributes:
        surface: the table, as planners know it.
        rules: how the object is pushed along.
    """

    takes_gripper = True
    lost_after = 5.0
    timeout = 15.0

    path_field: ClassVar[str] = "follow.path"
    """The scenario's field that gives the path, for messages."""

    @classmethod
    def choose_steer_speed(cls, scenario: PushScenario) -> float:
        """Chooses the greatest speed at which the finger is steered, m/s."""
        return scenario.section(FollowConfig).steer_speed

    def AddController(self, builder: DiagramBuilder) -> Diagram:
        """Adds what pokes and then follows the path, as one controller.

        Raises:
            ScenarioError: the path or the goal cannot be followed.
            PlanningError: the path makes no sense.
        """
        station = self.station
        self.surface = make_surface(station.table_top)
        path = self.make_path(station.obj, station.scenario)
        self.rules = make_follow_rules(station, path)
        for name, pose in self.list_places(station.obj, station.scenario).items():
            check_place(name, station.obj, pose, self.rules.constraints)
        self._policy = make_policy(station)
        self._follower = FollowController(
            station.obj, self.rules, answer_delay=station.scenario.simulation.answer_delay
        )
        controller: Diagram = builder.AddNamedSystem(
            "controller", _join_controllers(self._policy, self._follower)
        )
        return controller

    def draw_goals(self, meshcat: Meshcat) -> None:
        """Draws the object's translucent outline at the path's end."""
        station = self.station
        AddGoal(meshcat, station.obj, self.rules.end, station.object_in_plant.height)

    @classmethod
    def list_faults(cls, resolved: ResolvedScenario) -> list[str]:
        """Lists why the path or the goal cannot be followed; see `StationTask.list_faults`."""
        scenario = resolved.scenario
        follow = scenario.section(FollowConfig)
        faults = []
        if follow.speed > follow.finger_speed:
            faults.append(
                f"follow.speed is {follow.speed:g} m/s; expected at most follow.finger_speed, "
                f"{follow.finger_speed:g} m/s"
            )
        try:
            places = cls.list_places(resolved.obj, scenario)
        except PlanningError as error:
            return [*faults, str(error).replace("path", cls.path_field, 1)]
        margins = PushConstraints(edge_margin=EDGE_MARGIN, obstacle_margin=OBSTACLE_MARGIN)
        return faults + list_misplaced(places, resolved, margins)

    @classmethod
    def make_path(cls, obj: GridObject, scenario: PushScenario) -> PosePath | None:
        """Makes the path that a scenario gives; None if one to the goal is to be planned.

        Raises:
            PlanningError: the path makes no sense; the message begins with "path".
        """
        follow = scenario.section(FollowConfig)
        return None if follow.path is None else PosePath(np.array(follow.path), follow.speed)

    @classmethod
    def list_places(cls, obj: GridObject, scenario: PushScenario) -> dict[str, Array]:
        """Lists where an object should come, (3,) X_WB, m and rad: its path, or else its goal.

        Returns:
            The poses by what a message calls them.

        Raises:
            PlanningError: see `make_path`.
        """
        path = cls.make_path(obj, scenario)
        if path is None:
            return {scenario.names.name_field(0, "goal"): np.array(scenario.goal.pose)}
        return {f"{cls.path_field}[{at}]": pose for at, pose in enumerate(path.poses)}

    def prepare(self, context: Context, seed: int) -> None:
        """Sets the seed from which the policy draws its pokes."""
        self._policy.SetSeed(context, seed)
        if self.meshcat is not None:
            for path in (PLANNED_PATH, GONE_PATH):
                self.meshcat.Delete(path)

    def make_record(self) -> FollowRecord:
        """Makes the empty record of a run."""
        return FollowRecord(
            obj=self.station.obj,
            truth=self.station.truth,
            surface=self.surface,
            last=FollowControlStatus(),
            obstacles=tuple(self.rules.constraints.obstacles),
            goal=self.rules.end,
        )

    def note(self, record: FollowRecord, time: float) -> bool:
        """Writes down where object and finger are, and what the controller does."""
        note_pose(self, record)
        is_new = self.note_step(record, time)
        prepared = self.read("prepared", self.controller)
        if prepared.path is not None and all(path is not prepared.path for path in record.paths):
            record.paths.append(prepared.path)
            self._draw(PLANNED_PATH, find_centers(record.obj, prepared.path.poses), PLANNED_COLOR)
        if record.last.mode == FollowMode.FOLLOWING and np.isfinite(record.pose).all():
            record.times.append(time)
            record.poses.append(record.pose)
            record.tips.append(np.array(self.read("pusher.state")[:2]))
            self._draw(GONE_PATH, record.way, GONE_COLOR)
        # While it waits to see object or finger, nothing is new; else the follower says if
        # nothing gets on.
        rests = record.last.cause in BLIND_STATUSES
        return is_new or (self.is_at_work() and not rests)

    def judge(self, record: FollowRecord, waiting: Waiting) -> Judgment:
        """Decides whether the object is at the path's end or lost, or the task gets no further."""
        status = record.last
        if self.simulated and np.isnan(record.pose).any():
            return TaskStatus.LOST, "The object left the table."
        if waiting.unseen > self.lost_after:
            return TaskStatus.LOST, f"The object has not been seen for {self.lost_after:g} s."
        if status.mode in (FollowMode.REACHED, FollowMode.FAILED):
            # the finger goes up first
            if self.is_at_work():
                return GO_ON
            return TaskStatus(status.mode), status.reason
        return self.judge_idle(waiting, status.reason)

    def _draw(self, path: str, places: Array, color: Rgba) -> None:
        """Draws a line through places (K, 2), W, m, in Meshcat."""
        if self.meshcat is None or len(places) < 2:
            return
        height = np.full(len(places), self.station.object_in_plant.height + LINE_HEIGHT)
        self.meshcat.SetLine(path, np.vstack([places.T, height]), LINE_WIDTH, color)


def make_follow_rules(station: Station, path: PosePath | None) -> FollowRules:
    """Makes the rules by which the controller pushes from a station and its scenario.

    Args:
        station: the station.
        path: the path; None to plan one to the scenario's goal.
    """
    scenario = station.scenario
    follow = scenario.section(FollowConfig)
    return FollowRules(
        goal=np.array(scenario.goal.pose),
        finger=FeedbackFinger(
            radius=station.robot.pusher.choose_radius(station.obj),
            speed=follow.finger_speed,
            walking_speed=follow.walking_speed,
            shape=station.robot.shape,
            turning_speed=STEER_TURNING_SPEED,
            most_yaw=MOST_STEER_YAW,
        ),
        speed=follow.speed,
        path=path,
        constraints=PushConstraints(
            surface=make_surface(station.table_top),
            obstacles=station.obstacles,
            edge_margin=EDGE_MARGIN,
            obstacle_margin=OBSTACLE_MARGIN,
            finger_region=make_steer_region(station, station.reach, follow.steer_speed),
        ),
        options=FollowOptions(
            position_tolerance=follow.position_tolerance, angle_tolerance=follow.angle_tolerance
        ),
        pokes=scenario.pokes.count,
        plans=follow.plans,
        pose_delay=calc_shown_age(scenario),
        seed=scenario.seed,
    )


def calc_shown_age(scenario: PushScenario) -> float:
    """Calculates how old a pose is on average when the controller finds it on its port, s.

    A picture's pose is there as soon as its delay is over, and is found at the next look.
    """
    camera = scenario.camera
    return calc_pose_age(camera) - 1 / camera.rate + SAMPLE_PERIOD / 2


def _join_controllers(policy: PokePolicy, follower: FollowController) -> Diagram:
    """Joins what pokes and what follows to one controller, with the ports of both."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("policy", policy)
    builder.AddNamedSystem("follower", follower)
    inputs = [follower.get_input_port(i) for i in range(follower.num_input_ports())]
    for port in inputs:
        builder.ExportInput(port, port.get_name())
    builder.ConnectInput("object_pose", policy.GetInputPort("object_pose"))
    builder.ConnectInput("push_status", policy.GetInputPort("status"))
    builder.ConnectInput("push_log", policy.GetInputPort("push_log"))
    builder.ExportOutput(policy.GetOutputPort("push_command"), "push_command")
    for name in ("steer_command", "status", "progress", "prepared"):
        builder.ExportOutput(follower.GetOutputPort(name), name)
    diagram: Diagram = builder.Build()
    return diagram


class FollowKind(TaskKind):
    """A robot pokes an object, learns it, and pushes it along a path with feedback."""

    help = (
        "poke and learn it, and push it along a path between obstacles, with a finger that is "
        "steered ten times a second"
    )
    sentence = "Push the {} along a path between the posts."
    station = FollowTask
    done = TaskStatus.REACHED
    scenario = "slalom"
    hides = True
    marks = (
        Mark(to_css(PLANNED_COLOR), "where the object should go, and lie at the end"),
        Mark(to_css(GONE_COLOR), "where it went"),
    )

    def count_steps(self, scenario: PushScenario) -> int:
        """Counts the pokes, and the path."""
        return scenario.pokes.count + 1

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """Names the poke, or what the controller does afterwards."""
        now: FollowControlStatus = task.read("status", task.controller)
        if now.mode == FollowMode.POKING:
            return f"poke {status.executed + (not status.ready)}, {status.phase}", status.executed
        return FOLLOW_TITLES[now.mode], status.executed

    def name_phase(self, status: Any) -> str:
        """Returns a title for what the controller does."""
        return FOLLOW_TITLES[status.mode]

    def summarize(self, record: FollowRecord) -> dict[str, Any]:
        """Adds to the summary how the object kept to its path, and where it ended."""
        return super().summarize(record) | {
            "cause": record.last.cause,
            "pokes": record.pokes,
            "plans": record.last.plans,
            "goal": record.goal.tolist(),
            "distance": record.distance,
            "turn": record.turn,
            "path_rms": record.calc_rms(),
            "steering_seconds": record.steering_time,
            "clearance": record.calc_clearance() if record.obstacles else None,
        }

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells whether the object came to the path's end, and how near it kept to the path."""
        name = speak_name(summary["object"])
        pokes = count_noun(summary["pokes"], "poke")
        lines = [f"The {name} after {pokes}: {summary['message']}"]
        if np.isfinite(summary["path_rms"]):
            lines.append(
                f"  in {summary['steering_seconds']:.1f} s, {summary['path_rms'] * MM_PER_M:.1f} "
                "mm from "
                f"its path (root mean square); {summary['distance'] * MM_PER_M:.1f} mm and "
                f"{np.degrees(summary['turn']):.1f}° from the end"
            )
        force = summary["limit_report"]["force"]
        lines.append(f"  greatest force on the finger: {force:.1f} N")
        if summary["limit_report"]["touched"]:
            pairs = (" and ".join(pair) for pair in summary["limit_report"]["touched"])
            lines.append(f"  these touched, but should not: {'; '.join(pairs)}")
        return lines

    def make_summary(self, record: FollowRecord) -> ReportSummary:
        """Shows the path, the object's way and what stood in it."""
        path = record.paths[-1] if record.paths else None
        away = (
            f"{record.calc_clearance() * MM_PER_M:.0f} mm" if record.obstacles else "nothing there"
        )
        return ReportSummary(
            headline=record.message,
            facts=(
                ("pokes", str(record.pokes)),
                ("on its way", f"{record.steering_time:.1f} s"),
                ("from the path, RMS", f"{record.calc_rms() * MM_PER_M:.1f} mm"),
                ("nearest to an obstacle", away),
                ("greatest force", f"{record.limit_report.force:.1f} N"),
            ),
            figure=draw_follow_run(
                record.obj,
                planned=np.empty((0, 3)) if path is None else path.poses,
                poses=record.poses,
                tips=record.tips,
                times=record.times,
                distances=record.calc_distances(),
                goal=record.goal,
                surface=record.surface,
                obstacles=record.obstacles,
            ),
            caption="Left: the path of the object's middle as it was planned, its way, and the "
            "finger's; the object dotted where it should end. Right: how far the middle was from "
            "its path.",
            heads=("time", "what", "why"),
            steps=[
                (f"{step.time:.1f}\N{NO-BREAK SPACE}s", step.status.mode, step.status.reason)
                for step in record.steps
            ],
        )

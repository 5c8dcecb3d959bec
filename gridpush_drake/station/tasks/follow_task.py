"""Pushing an unknown object along a path: it is poked, learned, and then pushed with feedback."""

from dataclasses import dataclass, field

import numpy as np
import shapely
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from shapely import Polygon

from gridpush_drake.errors import PlanningError, ScenarioError
from gridpush_drake.geometry.se2 import Array, transform, transform_shape, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.feedback.follow_calculations import FollowRules
from gridpush_drake.planning.feedback.follow_options import FollowOptions
from gridpush_drake.planning.feedback.pose_path import PathProgress, PosePath
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.station.control.robot_control import Learning
from gridpush_drake.station.scene.camera import calc_pose_age
from gridpush_drake.station.scene.finger_region import make_steer_region
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scene.setting import find_obstacles, make_surface
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.simulated.station import Station, StationMaker
from gridpush_drake.station.tasks.goal_check import check_place
from gridpush_drake.station.tasks.identify_task import make_policy
from gridpush_drake.station.tasks.push_task import EDGE_MARGIN, AddGoal
from gridpush_drake.station.tasks.task import (
    GO_ON,
    ControlledRecord,
    Judgment,
    StationTask,
    TaskStatus,
    Waiting,
)
from gridpush_drake.systems.control.follow_controller import (
    BLIND_STATUSES,
    SAMPLE_PERIOD,
    FollowController,
    FollowControlStatus,
    FollowMode,
)
from gridpush_drake.systems.control.poke_policy import PokePolicy

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


@dataclass(repr=False)
class FollowRecord(ControlledRecord[FollowControlStatus]):
    """What came of a run. It is filled while the task runs.

    Attributes:
        obstacles: outlines of what stands in the way, W, m.
        goal: (3,) X_WB at the end of the path, m and rad.
        pose: (3,) true X_WB of the object at the end, m and rad; NaN if it had fallen. With a real
            robot it is the pose that was last seen.
        error: mean distance of the cells from where they should be, with the object at `pose`, m.
        paths: the paths that were followed, in order.
        times: times, s, for `poses` and `tips`.
        poses: (3,) poses of the object while the finger was steered, as `pose`.
        tips: (2,) places of the finger's tip then, W, m.
    """

    obstacles: tuple[Polygon, ...]
    goal: Array
    pose: Array = field(default_factory=lambda: np.full(3, np.nan))
    error: float = float("nan")
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
        poses = np.array(self.poses).reshape(-1, 3)
        return transform(poses, self.obj.p_BC.mean(axis=0)[None])[:, 0]

    @property
    def distance(self) -> float:
        """Distance of the cells' centroid from the path's end, m."""
        middle = self.obj.p_BC.mean(axis=0)[None]
        return float(np.linalg.norm(transform(self.pose, middle) - transform(self.goal, middle)))

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
            scenario: the scenario, resolved or not; its `follow` says how the object is pushed
                along, its `goal` where to, its `pokes.count` from how many pokes it is learned.
            meshcat: Meshcat in which the station is shown; None for none.
            make_station: makes the station; a simulated one by default.

        Raises:
            ScenarioError: the scenario makes no sense, or its path or goal cannot be followed.
            StationError: nothing can be rendered on this computer; or see `MakeHardwareStation`.
            PlanningError: the scenario's path makes no sense.
        """
        resolved = resolve(scenario)
        self.check(resolved)
        scenario = resolved.scenario
        builder = DiagramBuilder()
        station = builder.AddSystem(
            make_station(
                resolved,
                meshcat,
                show_object=False,
                learning=Learning(max_pushes=scenario.pokes.count),
                steered=True,
            )
        )
        self.surface = make_surface(station.table_top)
        self.rules = make_follow_rules(station)
        check_path(station.obj, scenario, self.rules.constraints)
        self._policy = make_policy(station)
        self._follower = FollowController(
            station.obj, self.rules, answer_delay=scenario.simulation.answer_delay
        )
        self.controller = builder.AddNamedSystem(
            "controller", _join_controllers(self._policy, self._follower)
        )
        super().__init__(builder, station, self.controller, meshcat)
        self._meshcat = meshcat
        if meshcat is not None:
            self._height = station.object_in_plant.height
            AddGoal(meshcat, station.obj, self.rules.end, self._height)

    @classmethod
    def list_faults(cls, resolved: ResolvedScenario) -> list[str]:
        """Lists why the path or the goal cannot be followed; see `StationTask.list_faults`."""
        scenario = resolved.scenario
        follow = scenario.follow
        faults = []
        if follow.speed > follow.finger_speed:
            faults.append(
                f"follow.speed is {follow.speed:g} m/s; expected at most follow.finger_speed, "
                f"{follow.finger_speed:g} m/s"
            )
        if follow.path is not None:
            try:
                PosePath(np.array(follow.path), follow.speed)
            except PlanningError as error:
                faults.append(f"follow.{error}")
        # A camera measures the object's outline, which is not known yet.
        if scenario.camera.kind == "ideal":
            faults += _list_misplaced(resolved)
        return faults

    def prepare(self, context: Context, seed: int) -> None:
        """Sets the seed from which the policy draws its pokes."""
        self._policy.SetSeed(context, seed)
        if self._meshcat is not None:
            for path in (PLANNED_PATH, GONE_PATH):
                self._meshcat.Delete(path)

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
        pose = np.array(self.read(self.judged_pose))
        # The true pose is NaN once the object has fallen. A camera's is NaN whenever it does not
        # see the object, which says nothing about where that lies.
        if self.simulated or np.isfinite(pose).all():
            record.pose = pose
        record.error = float(calc_goal_error(record.obj, record.pose, record.goal))
        is_new = self.note_step(record, time)
        prepared = self.read("prepared", self.controller)
        if prepared.path is not None and all(path is not prepared.path for path in record.paths):
            record.paths.append(prepared.path)
            self._draw(PLANNED_PATH, self._find_centers(prepared.path.poses), PLANNED_COLOR)
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
        if waiting.idle > self.timeout:
            return TaskStatus.STUCK, f"Nothing happened for {self.timeout:g} s: {status.reason}"
        return GO_ON

    def _find_centers(self, poses: Array) -> Array:
        """Places (K, 2) of the cells' centroid at poses (K, 3), W, m."""
        return transform(poses, self.station.obj.p_BC.mean(axis=0)[None])[:, 0]

    def _draw(self, path: str, places: Array, color: Rgba) -> None:
        """Draws a line through places (K, 2), W, m, in Meshcat."""
        if self._meshcat is None or len(places) < 2:
            return
        height = np.full(len(places), self._height + LINE_HEIGHT)
        self._meshcat.SetLine(path, np.vstack([places.T, height]), LINE_WIDTH, color)


def make_follow_rules(station: Station) -> FollowRules:
    """Makes the rules by which the controller pushes from a station and its scenario."""
    scenario = station.scenario
    follow = scenario.follow
    path = None
    if follow.path is not None:
        path = PosePath(np.array(follow.path), follow.speed)
    return FollowRules(
        goal=np.array(scenario.goal.pose),
        finger=FeedbackFinger(
            radius=station.robot.finger.tip_radius,
            speed=follow.finger_speed,
            walking_speed=follow.walking_speed,
        ),
        speed=follow.speed,
        path=path,
        constraints=PushConstraints(
            surface=make_surface(station.table_top),
            obstacles=station.obstacles,
            edge_margin=EDGE_MARGIN,
            obstacle_margin=OBSTACLE_MARGIN,
            finger_region=make_steer_region(station, station.reach),
        ),
        options=FollowOptions(
            position_tolerance=follow.position_tolerance, angle_tolerance=follow.angle_tolerance
        ),
        pokes=scenario.pokes.count,
        plans=follow.plans,
        pose_delay=calc_shown_age(scenario),
        seed=scenario.seed,
    )


def list_places(scenario: PushScenario) -> dict[str, list[float]]:
    """Lists where an object should come, X_WB, m and rad: its path, or else its goal.

    Returns:
        The poses by the names of their fields.
    """
    path = scenario.follow.path
    if path is not None:
        return {f"follow.path[{at}]": pose for at, pose in enumerate(path)}
    return {scenario.names.name_field(0, "goal"): scenario.goal.pose}


def check_path(obj: GridObject, scenario: PushScenario, constraints: PushConstraints) -> None:
    """Checks what can be known of a goal and a path before anything was learned.

    Raises:
        ScenarioError: at the goal, or on a path that is told, the object would touch an obstacle or
            hang over the table's edge.
    """
    for name, pose in list_places(scenario).items():
        check_place(name, obj, np.array(pose), constraints)


def _list_misplaced(resolved: ResolvedScenario) -> list[str]:
    """Lists which poses of the path or the goal are not on the table, or at an obstacle."""
    constraints = PushConstraints(
        surface=make_surface(resolved.table_top),
        obstacles=find_obstacles(resolved),
        edge_margin=EDGE_MARGIN,
        obstacle_margin=OBSTACLE_MARGIN,
    )
    faults = []
    for name, pose in list_places(resolved.scenario).items():
        try:
            check_place(name, resolved.obj, np.array(pose), constraints)
        except ScenarioError as error:
            faults.append(str(error))
    return faults


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

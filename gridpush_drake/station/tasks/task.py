"""`StationTask`: what all tasks in the station have in common.

A task is a Diagram of a station and a system that commands it. A run makes a fresh Context, puts
everything where it begins, and goes on in short steps. After each step the task writes down what is
new (`note`), and decides whether it is over (`judge`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System

from gridpush_drake.display.server import AimCamera
from gridpush_drake.errors import ScenarioError
from gridpush_drake.identification.result import Identification
from gridpush_drake.notebook import count, make_page
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.images.camera_view import CameraView
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import Sample
from gridpush_drake.pushes.weighings import MassTestLog
from gridpush_drake.station.control.robot_control import Learning
from gridpush_drake.station.scene.other_objects import list_parts
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scene.scene_camera import AddPosesTogether
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.limit_monitor import LimitMonitor, LimitReport
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.simulated.station import Station, StationMaker
from gridpush_drake.systems.base.messages import GraspCommand, PushCommand, PushStatus
from gridpush_drake.systems.learning.estimate_visualizer import EstimateVisualizer, ShownObject
from gridpush_drake.systems.safety.guard_status import GuardMode, GuardStatus


class TaskStatus(StrEnum):
    """How a task stands, or how it ended.

    A status is false, as a condition, while the task runs, and true once it has ended.
    """

    RUNNING = ""
    INTERRUPTED = "interrupted"
    """The user ended the run."""
    STOPPED = "stopped"
    """A real arm was stopped, by its guard or since something failed."""
    STUCK = "stuck"
    """Nothing new happened for too long."""
    FAILED = "failed"
    """The controller has given up."""
    FINISHED = "finished"
    """All pushes of an experiment were carried out."""
    OBJECT_LOST = "object_lost"
    """The object left the table in an experiment."""
    LOST = "lost"
    """The object left the table, or was out of sight for too long, in another task."""
    REACHED = "reached"
    """The object lies at the goal."""
    HELD = "held"
    """The gripper has lifted the object, and holds it."""
    DROPPED = "dropped"
    """The object fell."""
    NOT_LIFTED = "not_lifted"
    """The gripper closed and went up, but the object did not."""


OBSERVATION_PERIOD = 0.1
"""Simulated time from one observation of a task to the next, s."""

Judgment = tuple[TaskStatus, str]
"""A task's status, and a sentence about it."""

GO_ON: Judgment = (TaskStatus.RUNNING, "")
"""The judgment of a task that is not over."""

Progress = Callable[[PushStatus, int], None]
"""A function that is told, after each step, the executor's status and the number of pushes."""

INPUT_SOURCES = {
    "object_pose": "object.pose",
    "identification": "estimate.identification",
    "push_log": "estimate.push_log",
    "push_status": "executor.status",
    "status": "executor.status",
    "grasp_status": "grasp.status",
    "press_status": "press.status",
    "pusher_state": "pusher.state",
    "pusher_yaw": "pusher.yaw",
    "steer_status": "steer.status",
}
"""The station's output port for each input port that a controller may have, by the input's name."""

COMMAND_PORTS = ("push_command", "grasp_command", "press_command", "steer_command")
"""Names of the ports that command the station: a controller's outputs and the station's inputs."""

TRUE_POSE = "object.pose_true"
"""Name of a port that only a simulated station has."""

GUARD_STATUS = "guard.status"
"""Name of a port that only a real robot's station has."""

WEIGHING_LOG = "weighing.log"
PRESS_STATUS = "press.status"
"""Names of ports that only a station has that weighs."""

STEER_STATUS = "steer.status"
"""Name of a port that only a station has in which the finger can be steered."""

SHOWN_ESTIMATES = (
    "mass",
    "friction",
    "contact_friction",
    "center_of_mass",
    "center_of_mass_covariance",
)
"""The estimates that are drawn in Meshcat."""


CAMERA_FRACTION = 0.82
"""Distance of Meshcat's camera from the point that it looks at, in diagonals of a rectangle around
the table and the robot's base."""

CAMERA_HEIGHT = 0.17
"""Height above the table of the point that Meshcat's camera looks at, m: a third of the arm's."""

CAMERA_AZIMUTH = 0.75
CAMERA_ELEVATION = 0.5
"""Direction in which Meshcat's camera stands, rad: opposite the robot, to its left, beyond the edge
to which objects are slid."""


@dataclass
class TaskRecord:
    """What came of a run. It is filled while the task runs.

    Attributes:
        obj: the object, as the robot knows it.
        truth: its true masses and frictions; None if nobody knows them, as with a real object.
        log: all pushes, in order.
        stream: all that the identifier read, from which the pushes were cut.
        camera_view: what a color and depth camera saw; None with an ideal camera.
        estimates: the identification after each push that was learned from.
        status: how the run ended.
        message: the status in a sentence, and the pushes that were not as planned.
        weighings: what presses and lifts told; empty if nothing was weighed.
        limit_report: how near the robot came to its limits.
        duration: duration of the run, in simulated time, s.
    """

    obj: GridObject
    truth: CellParameters | None
    log: PushLog = field(default_factory=lambda: PushLog(()), kw_only=True)
    stream: list[Sample] = field(default_factory=list, kw_only=True)
    camera_view: CameraView | None = field(default=None, kw_only=True)
    estimates: list[Identification] = field(default_factory=list, kw_only=True)
    weighings: MassTestLog = field(default_factory=MassTestLog, kw_only=True)
    status: TaskStatus = field(default=TaskStatus.RUNNING, kw_only=True)
    message: str = field(default="", kw_only=True)
    limit_report: LimitReport = field(default_factory=LimitReport, kw_only=True)
    duration: float = field(default=0.0, kw_only=True)

    def list_objects(self) -> tuple[GridObject, ...]:
        """Lists the objects (N,) that the task was about; here the one."""
        return (self.obj,)

    def __repr__(self) -> str:
        """Says in a line or two what was done with which object, and how it ended."""
        name = type(self).__name__
        status = self.status or "running"
        pushes = f"{count(len(self.log), 'push')} in {self.duration:.0f} s simulated"
        return f"{name} of {self.obj.name!r}, {status}: {pushes}\n{self.message}".rstrip()

    def _repr_html_(self) -> str:
        """Shows the pushes, and the last estimate, in a notebook."""
        parts = [self.log._repr_html_()]
        parts += [estimate._repr_html_() for estimate in self.estimates[-1:]]
        return make_page(repr(self), *parts)


Status = TypeVar("Status")


@dataclass(frozen=True, eq=False)
class TaskStep(Generic[Status]):
    """A change of a controller's status.

    Attributes:
        time: time at which the change was noted, s.
        status: the new status.
        pose: (3,) X_WB of the object as it was seen then, m and rad; NaN if it was not seen.
        push: the command, if a push began with this step.
        grasp: the command, if a grasp began with this step.
    """

    time: float
    status: Status
    pose: NDArray[np.float64]
    push: PushCommand | None = None
    grasp: GraspCommand | None = None


@dataclass(repr=False)
class ControlledRecord(TaskRecord, Generic[Status]):
    """What came of a run that was led by a controller with a status.

    Attributes:
        surface: the table, as planners know it.
        last: the controller's last status.
        steps: the changes of its status, in order.
    """

    surface: SupportSurface
    last: Status
    steps: list[TaskStep[Status]] = field(default_factory=list, kw_only=True)


RecordType = TypeVar("RecordType", bound=TaskRecord)


@dataclass(frozen=True)
class Waiting:
    """How long nothing has been seen, and how long nothing has happened; a task's `judge` takes it.

    Attributes:
        unseen: time since the camera last saw the object, s.
        idle: time since `note` last found something new, s.
    """

    unseen: float
    idle: float


class Drive(Protocol):
    """Moves on the time of a station whose robot is real; `HardwareLink` is one.

    A simulated station needs none: its time is moved on by the Simulator.
    """

    def begin(self, diagram: Diagram, station: Station, context: Context) -> None:
        """Writes what is known of the robot into a fresh Context of the station's Diagram."""

    def advance(self, simulator: Simulator, time: float) -> None:
        """Goes on to a time, s, together with the robot."""

    def fail(self, error: BaseException) -> None:
        """Notes that the loop has failed, and why; `finish` comes next."""

    def finish(self, simulator: Simulator) -> None:
        """Brings the robot to rest and holds it there, whatever has failed; raises nothing."""

    def explain(self) -> str:
        """Says in sentences what went wrong beside what the guard says; empty for nothing."""


class StationTask(Generic[RecordType]):
    """A station with a system that commands it, to be run once or many times.

    A kind of task overrides `AddController`, `make_record`, `note`, `judge` and, if it needs to,
    `list_faults`, `choose_steer_speed`, `draw_goals`, `prepare` and `finish`.

    Attributes:
        station: the station.
        controller: the system that commands it.
        diagram: the Diagram of both.
        simulator: the diagram's Simulator.
        simulated: whether the robot is simulated. Then the task also knows what the robot cannot
            see.
        meshcat: Meshcat in which the station is shown; None for none.
        judged_pose: name of the station's port with the pose by which the object is judged: the
            true one if there is one.
    """

    lost_after: ClassVar[float]
    """If the object is not seen for this long, it is lost; simulated time, s."""

    timeout: ClassVar[float]
    """If nothing new happens for this long, the task is stuck; simulated time, s."""

    pushes_others: ClassVar[bool] = False
    """Whether the task is about the other objects on the table, too: it pushes and learns them."""

    takes_gripper: ClassVar[bool] = False
    """Whether the robot may push with its closed gripper in the task, in place of a finger."""

    learning: ClassVar[Learning | None] = None
    """From which pushes the station learns; None for the first `pokes.count` of the scenario."""

    def __init__(
        self,
        scenario: PushScenario | ResolvedScenario,
        meshcat: Meshcat | None = None,
        make_station: StationMaker = MakePushStation,
    ) -> None:
        """Makes the station and what commands it, connects them, and builds the Diagram.

        The controller's input ports that are named in `INPUT_SOURCES` and its output ports that are
        named in `COMMAND_PORTS` are connected with the station.

        Args:
            scenario: the scenario, resolved or not.
            meshcat: Meshcat in which the station and the estimate are shown; None for none.
            make_station: makes the station; a simulated one by default.

        Raises:
            ScenarioError: the scenario makes no sense, or the task cannot be done in it.
            PlanningError: an object, a goal or a path will not do.
            StationError: nothing can be rendered on this computer, or the robot does not come where
                the task needs it; or see `MakeHardwareStation`.
        """
        resolved = resolve(scenario)
        self.check(resolved)
        builder = DiagramBuilder()
        station = builder.AddSystem(
            make_station(
                resolved,
                meshcat,
                show_object=False,
                learning=self.learning,
                steer_speed=self.choose_steer_speed(resolved.scenario),
                several=self.pushes_others,
            )
        )
        self.station: Station = station
        controller = self.AddController(builder)
        ports = map(controller.get_input_port, range(controller.num_input_ports()))
        for port in [port for port in ports if port.get_name() in INPUT_SOURCES]:
            builder.Connect(station.GetOutputPort(INPUT_SOURCES[port.get_name()]), port)
        for command in COMMAND_PORTS:
            if controller.HasOutputPort(command):
                builder.Connect(controller.GetOutputPort(command), station.GetInputPort(command))
        self._visualizer: EstimateVisualizer | None = None
        if meshcat is not None:
            self._visualizer = AddEstimateVisualizer(
                builder, station, controller, meshcat, several=self.pushes_others
            )
        self.controller = controller
        self.diagram = builder.Build()
        self.diagram.set_name(type(self).__name__)
        self.simulator = Simulator(self.diagram)
        self.simulated: bool = station.HasOutputPort(TRUE_POSE)
        self.judged_pose = TRUE_POSE if self.simulated else "object.pose"
        # Times at which the object was last seen, and something was last new, s.
        self._last_seen = 0.0
        self._last_new = 0.0
        self.meshcat = meshcat
        if meshcat is not None:
            self.draw_goals(meshcat)

    @classmethod
    def list_faults(cls, resolved: ResolvedScenario) -> list[str]:
        """Lists why the task cannot be done in a scenario, as far as is known without a station.

        Returns:
            Messages, each of which names its field and what is expected; empty if there are none.
        """
        return []

    @classmethod
    def check(cls, resolved: ResolvedScenario, more: Sequence[str] = ()) -> None:
        """Checks that the task can be done in a scenario, before anything is made or opened.

        Args:
            resolved: the scenario.
            more: further faults, which are told with those of the task.

        Raises:
            ScenarioError: it cannot; the message has all faults.
        """
        faults = [*cls._list_pusher_faults(resolved), *cls.list_faults(resolved), *more]
        if faults:
            raise ScenarioError(". Also: ".join(faults))

    @classmethod
    def _list_pusher_faults(cls, resolved: ResolvedScenario) -> list[str]:
        """Lists why a gripper cannot push in the task, in place of a finger."""
        if resolved.robot.shape is None:
            return []
        pusher = resolved.scenario.pusher
        if not cls.takes_gripper:
            return [
                f"pusher is {pusher}, which is for the tasks identify, push, slide, follow, line, "
                "separate and rearrange, in which nothing is grasped or pressed; expected one of "
                "them, or pusher: finger, and a scene with a finger"
            ]
        if resolved.scenario.unknown_inertia:
            return [
                f"pusher is {pusher}, and unknown_inertia is true, which asks for presses with a "
                "finger; expected pusher: finger, or unknown_inertia: false"
            ]
        return []

    @classmethod
    def choose_steer_speed(cls, scenario: PushScenario) -> float | None:
        """Chooses the greatest speed of a finger that is steered, m/s; here it is not steered."""
        return None

    def AddController(self, builder: DiagramBuilder) -> System:
        """Adds the system that commands `station`, and whatever else the Diagram is to have."""
        raise NotImplementedError

    def draw_goals(self, meshcat: Meshcat) -> None:
        """Draws where objects should come; here nothing."""

    def make_record(self) -> RecordType:
        """Makes the empty record of a run."""
        raise NotImplementedError

    def note(self, record: RecordType, time: float) -> bool:
        """Writes into the record what is new at a time, s; returns whether anything is new."""
        raise NotImplementedError

    def judge(self, record: RecordType, waiting: Waiting) -> Judgment:
        """Decides whether the task is over, and how it ended."""
        raise NotImplementedError

    def judge_idle(self, waiting: Waiting, reason: str) -> Judgment:
        """Judges a task that goes on: it is stuck if nothing has happened for too long.

        Args:
            waiting: how long nothing has happened.
            reason: what the controller says last.
        """
        if waiting.idle > self.timeout:
            return TaskStatus.STUCK, f"Nothing happened for {self.timeout:g} s: {reason}"
        return GO_ON

    def prepare(self, context: Context, seed: int) -> None:
        """Sets in a fresh Context of the Diagram what a kind of task needs beside the station."""

    def finish(self, record: RecordType) -> None:
        """Completes the record of a run that has ended."""

    def run(
        self,
        seed: int | None = None,
        progress: Progress | None = None,
        realtime_rate: float = 0.0,
        drive: Drive | None = None,
    ) -> RecordType:
        """Runs the task from its beginning.

        Args:
            seed: seed of everything random, instead of the scenario's.
            progress: told after every step how far the run is.
            realtime_rate: greatest number of simulated seconds in a second; 0 for as fast as
                possible.
            drive: moves on the time of a station with a real robot; it has a rate of its own. None
                for a simulated one.

        Returns:
            The record of the run. Ctrl-C ends the run early, and the record has what there is by
            then. With a `drive` any failure in the loop ends it early, too: the robot is brought to
            rest first, and the record's message says what failed. Without a `drive` the failure is
            raised.
        """
        simulator = self.simulator
        self.begin(seed, drive)
        context = simulator.get_mutable_context()
        monitor = LimitMonitor(self.station, pushes_others=self.pushes_others)
        record = self.make_record()
        record.truth = self.station.GetTruth(context)
        record.limit_report = monitor.limit_report
        self._last_seen = 0.0
        self._last_new = 0.0
        simulator.set_target_realtime_rate(realtime_rate)
        simulator.set_monitor(monitor)
        if drive is None:
            self._go_on(record, Simulator.AdvanceTo, progress)
        else:
            self._go_on_with(drive, record, progress)
        self._complete(record, drive)
        return record

    def _go_on_with(self, drive: Drive, record: RecordType, progress: Progress | None) -> None:
        """Runs the task with a real robot, which is brought to rest at the end in any case."""
        try:
            self._go_on(record, drive.advance, progress)
        except (Exception, SystemExit) as error:  # the robot must come to rest whatever it is
            drive.fail(error)
            record.status = TaskStatus.STOPPED
        drive.finish(self.simulator)
        guard = self._read_guard()
        if guard is not None and guard.failed and record.status != TaskStatus.INTERRUPTED:
            record.status = TaskStatus.STOPPED
            record.message = describe_stop(guard)

    def _go_on(
        self,
        record: RecordType,
        advance: Callable[[Simulator, float], None],
        progress: Progress | None,
    ) -> None:
        """Goes on until the task is judged to be over, or Ctrl-C ends it."""
        simulator = self.simulator
        try:
            simulator.Initialize()
            while not record.status:
                advance(simulator, simulator.get_context().get_time() + OBSERVATION_PERIOD)
                self._observe(record)
                if progress is not None:
                    progress(self.read("executor.status"), len(record.log))
        except KeyboardInterrupt:
            self._observe(record)
            if not record.status:
                record.status = TaskStatus.INTERRUPTED
                record.message = f"Interrupted after {len(record.log)} pushes."

    def _complete(self, record: RecordType, drive: Drive | None) -> None:
        """Writes into the record what is known only at the end of a run.

        Without a `drive` a failure is raised. With one the run may have ended by a failure, after
        which some of this can no longer be read: each part is then written if it can be.
        """
        context = self.simulator.get_context()
        remarks: list[str] = []

        def read_stream() -> None:
            record.stream = self.station.FindStream(context)

        def read_camera_view() -> None:
            record.camera_view = self.station.FindCameraView(context)

        def name_untouched() -> None:
            untouched = self.read("estimate.identification").unused_pushes
            if untouched:
                remarks.append(f"Nothing was touched in {', '.join(untouched)}.")

        def show_last() -> None:
            # What was learned at the very end may be newer than the last picture.
            if self._visualizer is not None:
                self._visualizer.ForcedPublish(self._visualizer.GetMyContextFromRoot(context))

        finish = partial(self.finish, record)
        for part in (show_last, read_stream, read_camera_view, finish, name_untouched):
            try:
                part()
            except (Exception, SystemExit) as error:
                if drive is None:
                    raise
                drive.fail(error)
                record.status = TaskStatus.STOPPED
        explained = "" if drive is None else drive.explain()
        strayed = record.limit_report.explain_strayed()
        record.message = " ".join(filter(None, [record.message, explained, strayed, *remarks]))

    def begin(self, seed: int | None = None, drive: Drive | None = None) -> None:
        """Gives the simulator a fresh Context, with everything where a run begins.

        Args:
            seed: seed of everything random, instead of the scenario's.
            drive: see `run`.
        """
        self.simulator.reset_context(self.diagram.CreateDefaultContext())
        context = self.simulator.get_mutable_context()
        seed = self.station.scenario.seed if seed is None else seed
        if drive is not None:
            drive.begin(self.diagram, self.station, context)
        self.station.SetStart(context, seed)
        self.prepare(context, seed)

    def preview(self, drive: Drive, within: float) -> PushCommand | None:
        """Finds the first push that the task would make, while nothing moves.

        Args:
            drive: see `run`.
            within: longest time to wait for a push, s.

        Returns:
            The push; None if there was none within this time.
        """
        self.begin(drive=drive)
        self.simulator.Initialize()
        time = 0.0
        while time < within:
            time += OBSERVATION_PERIOD
            drive.advance(self.simulator, time)
            command = PushCommand.from_vector(self.read("push_command", self.controller))
            if command.command_id:
                return command
        return None

    def read(self, port: str, system: System | None = None) -> Any:
        """Returns the present value of an output port.

        Args:
            port: name of the port.
            system: the system of the Diagram that has it; the station by default.
        """
        system = system or self.station
        return system.GetOutputPort(port).Eval(
            system.GetMyContextFromRoot(self.simulator.get_context())
        )

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names (N,) of the objects that the task is about, as the station's ports have them."""
        others = self.station.others if self.pushes_others else ()
        return ("object", *(other.name for other in others))

    def list_objects(self) -> tuple[GridObject, ...]:
        """Lists the objects (N,) that the task is about, as the robot knows them; here the one."""
        return (self.station.obj,)

    def read_estimates(self) -> tuple[Identification, ...]:
        """Returns what is known now of each object (N,) that the task is about.

        Of an object of which nothing was learned it is the prior, without `push_names`.
        """
        return (self.read("estimate.identification"),)

    def note_step(self, record: ControlledRecord[Any], time: float) -> bool:
        """Adds a step to the record if the controller's status has changed; returns whether it has.

        Args:
            record: the record of the run.
            time: time now, s.
        """
        status = self.read("status", self.controller)
        if status is record.last:
            return False
        push = PushCommand.from_vector(self.read("push_command", self.controller))
        grasp = GraspCommand()
        if self.controller.HasOutputPort("grasp_command"):
            grasp = GraspCommand.from_vector(self.read("grasp_command", self.controller))
        # A command stays on its port until the next one. Number 0 is no command.
        known_pushes = {0, *(step.push.command_id for step in record.steps if step.push)}
        known_grasps = {0, *(step.grasp.command_id for step in record.steps if step.grasp)}
        record.last = status
        record.steps.append(
            TaskStep(
                time=time,
                status=status,
                pose=np.array(self.read("object.pose")),
                push=None if push.command_id in known_pushes else push,
                grasp=None if grasp.command_id in known_grasps else grasp,
            )
        )
        return True

    def AimCamera(self, meshcat: Meshcat) -> None:
        """Points Meshcat's camera so that the whole arm and the whole table stay in sight."""
        station = self.station
        # It looks at a point halfway between the middle of the scene and the object.
        x0, y0, x1, y1 = station.table_top.union(shapely.Point(0.0, 0.0)).bounds
        x, y = (np.array([x0 + x1, y0 + y1]) / 2 + station.scenario.object_pose[:2]) / 2
        distance = CAMERA_FRACTION * float(np.hypot(x1 - x0, y1 - y0))
        AimCamera(meshcat, (x, y, CAMERA_HEIGHT), distance, CAMERA_AZIMUTH, CAMERA_ELEVATION)

    def _observe(self, record: RecordType) -> None:
        """Writes into the record what there is by now, and judges whether the task is over."""
        time = self.simulator.get_context().get_time()
        record.duration = time
        record.log = self.read("estimate.push_log")
        estimate = self.read("estimate.identification")
        if self.station.HasOutputPort(WEIGHING_LOG):
            record.weighings = self.read(WEIGHING_LOG)
        if estimate.push_names and (not record.estimates or estimate is not record.estimates[-1]):
            record.estimates.append(estimate)

        # While the arm works it may hide the object from a color and depth camera: that does not
        # count as not being seen.
        may_be_occluded = self.station.found is not None and self.is_at_work()
        if may_be_occluded or np.isfinite(self.read("object.pose")).all():
            self._last_seen = time
        if self.note(record, time):
            self._last_new = time
        waiting = Waiting(unseen=time - self._last_seen, idle=time - self._last_new)
        record.status, record.message = self.judge(record, waiting)

        # Whatever the judgment, a task in which the arm was stopped ends once the arm is at rest.
        guard = self._read_guard()
        if guard is None or not guard.stopped:
            return
        record.status, record.message = GO_ON
        if guard.ended:
            record.status = TaskStatus.INTERRUPTED if guard.by_user else TaskStatus.STOPPED
            record.message = describe_stop(guard)

    def is_at_work(self) -> bool:
        """Says whether the arm pushes, presses at the table's edge, or is steered."""
        ports = ["executor.status", PRESS_STATUS, STEER_STATUS]
        return not all(self.read(port).ready for port in ports if self.station.HasOutputPort(port))

    def _read_guard(self) -> GuardStatus | None:
        """Returns the status of a real arm's guard; None if the robot is simulated."""
        if not self.station.HasOutputPort(GUARD_STATUS):
            return None
        status: GuardStatus = self.read(GUARD_STATUS)
        return status


def describe_stop(guard: GuardStatus) -> str:
    """Says in a sentence when and why an arm was stopped, and whether it was seen at rest."""
    held = "is held" if guard.mode == GuardMode.HOLDING else "was not seen at rest"
    return f"The arm was stopped at {guard.since:.2f} s and {held}: {guard.reason}."


def AddEstimateVisualizer(
    builder: DiagramBuilder,
    station: Station,
    controller: System,
    meshcat: Meshcat,
    *,
    several: bool = False,
) -> EstimateVisualizer:
    """Adds a system that shows what is known of the objects, and the controller's push, in Meshcat.

    What is known is on the controller's ports where it learns by itself, else on the station's.

    Args:
        builder: the builder that has station and controller.
        station: a simulated station.
        controller: the system that commands it.
        meshcat: Meshcat in which the estimates are shown.
        several: whether the station's other objects are shown, too.
    """
    parts = [station.object_in_plant, *list_parts(station.others if several else ())]
    shown = [ShownObject(part.obj, part.height, int(part.body.index())) for part in parts]
    # The robot's object may have other cells than the true one.
    shown[0] = replace(shown[0], obj=station.obj)
    visualizer = builder.AddNamedSystem(
        "estimate_visualizer",
        EstimateVisualizer(shown, meshcat, pusher_shape=station.robot.shape),
    )
    builder.Connect(station.GetOutputPort("body_poses"), visualizer.GetInputPort("body_poses"))
    names = ("object", *(other.name for other in station.others[: len(parts) - 1]))
    poses = [station.GetOutputPort(f"{name}.pose_true") for name in names]
    together = AddPosesTogether(builder, poses, "true_object_poses")
    builder.Connect(together, visualizer.GetInputPort("object_pose"))
    for name in SHOWN_ESTIMATES:
        source = controller if controller.HasOutputPort(name) else station
        port = source.GetOutputPort(name if source is controller else f"estimate.{name}")
        builder.Connect(port, visualizer.GetInputPort(name))
    builder.Connect(
        station.GetOutputPort("executor.status"), visualizer.GetInputPort("push_status")
    )
    for name in ("push_command", "predicted_poses"):
        if controller.HasOutputPort(name):
            builder.Connect(controller.GetOutputPort(name), visualizer.GetInputPort(name))
    return visualizer

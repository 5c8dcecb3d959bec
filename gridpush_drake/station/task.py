"""`StationTask`: what all tasks in the station share.

A task is a Diagram of a station and a system that commands it. A run makes a fresh Context, puts
everything where it begins, and goes on in short steps: after each the task writes down what is new,
and its judge says whether it is over.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System

from gridpush_drake.display.server import AimCamera
from gridpush_drake.identification.result import Identification
from gridpush_drake.notebook import count, make_page
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.sight import Sight
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import Sample
from gridpush_drake.station.limit_monitor import LimitMonitor, LimitReport
from gridpush_drake.station.station import Station
from gridpush_drake.systems.arm_guard import GuardMode, GuardStatus
from gridpush_drake.systems.estimate_visualizer import EstimateVisualizer
from gridpush_drake.systems.messages import GraspCommand, PushCommand, PushStatus


class TaskStatus(StrEnum):
    """How a task in the station stands, or ended; RUNNING is false."""

    RUNNING = ""
    INTERRUPTED = "interrupted"
    STUCK = "stuck"
    LOST = "lost"
    FAILED = "failed"
    FINISHED = "finished"
    OBJECT_LOST = "object_lost"
    REACHED = "reached"
    HELD = "held"
    DROPPED = "dropped"
    NOT_LIFTED = "not_lifted"
    STOPPED = "stopped"


ADVANCE = 0.1
"""Simulated between two observations of how far a task is, s."""

Judgment = tuple[TaskStatus, str]
"""A task's status, and a sentence about it."""

GO_ON: Judgment = (TaskStatus.RUNNING, "")

Progress = Callable[[PushStatus, int], None]
"""Told now and then the executor's status and how many pushes are in the log."""

SOURCES = {
    "object_pose": "object.pose",
    "identification": "estimate.identification",
    "push_log": "estimate.push_log",
    "push_status": "executor.status",
    "status": "executor.status",
    "grasp_status": "grasp.status",
}
"""Of what is wanted at an input port, by its name: the station's output port."""

COMMANDS = ("push_command", "grasp_command")
"""Ports that command the station, named alike on both sides."""

TRUE_POSE, GUARD_STATUS = "object.pose_true", "guard.status"
"""Ports that a station has only where it is simulated, and only where it is not."""

SHOWN = ("mass", "friction", "contact_friction", "center_of_mass", "center_of_mass_covariance")
"""Estimates that are drawn."""


CAMERA_SHARE = 0.82
"""Distance of Meshcat's camera from what it looks at, in diagonals of the table and the robot's
base."""

CAMERA_HEIGHT = 0.17
"""Of what it looks at above the table, m: a third of the arm."""

CAMERA_AZIMUTH, CAMERA_ELEVATION = 0.75, 0.5
"""Where it stands, rad: opposite the robot, to its left, beyond the edge that things are slid
to."""


@dataclass
class TaskRecord:
    """What came of a run; filled while it runs.

    Attributes:
        obj: the object.
        truth: what it really weighs and how it rubs; None where nobody knows, of a real one.
        log: all pushes, in order.
        stream: all that the identifier saw, of which the pushes were cut.
        sight: what a color and depth camera saw; None where the camera is ideal.
        estimates: the identification after each push learned from.
        status: how it ended.
        message: the status in a sentence, and the pushes that were not as planned.
        limit_report: how the robot behaved.
        duration: simulated, s.
    """

    obj: GridObject
    truth: CellParameters | None
    log: PushLog = field(default_factory=lambda: PushLog(()), kw_only=True)
    stream: list[Sample] = field(default_factory=list, kw_only=True)
    sight: Sight | None = field(default=None, kw_only=True)
    estimates: list[Identification] = field(default_factory=list, kw_only=True)
    status: TaskStatus = field(default=TaskStatus.RUNNING, kw_only=True)
    message: str = field(default="", kw_only=True)
    limit_report: LimitReport = field(default_factory=LimitReport, kw_only=True)
    duration: float = field(default=0.0, kw_only=True)

    def __repr__(self) -> str:
        """What was done with which object, and how it ended, in a line or two."""
        pushes = f"{count(len(self.log), 'push')} in {self.duration:.0f} s simulated"
        status = self.status or "running"
        return f"{type(self).__name__} of {self.obj.name!r}, {status}: {pushes}\n{self.message}".rstrip()

    def _repr_html_(self) -> str:
        """The pushes, and the last estimate."""
        parts = [self.log._repr_html_()]
        parts += [estimate._repr_html_() for estimate in self.estimates[-1:]]
        return make_page(repr(self), *parts)


Status = TypeVar("Status")


@dataclass(frozen=True, eq=False)
class TaskStep(Generic[Status]):
    """A change of what a controller says.

    Attributes:
        time: s.
        status: of the controller.
        pose: (3,) where the object was seen, X_WB, m and rad; NaN where it was not.
        push: the command, where a push began.
        grasp: the command, where a grasp began.
    """

    time: float
    status: Status
    pose: NDArray[np.float64]
    push: PushCommand | None = None
    grasp: GraspCommand | None = None


@dataclass(repr=False)
class ControlledRecord(TaskRecord, Generic[Status]):
    """What came of a run that a controller with a status led.

    Attributes:
        surface: the table.
        last: the controller's last status.
        steps: what it said, in order.
    """

    surface: SupportSurface
    last: Status
    steps: list[TaskStep[Status]] = field(default_factory=list, kw_only=True)


R = TypeVar("R", bound=TaskRecord)


@dataclass(frozen=True)
class Waiting:
    """For how long nothing has been seen or has happened, for judges.

    Attributes:
        unseen: since the camera last saw the object, s.
        idle: since `note` last found something new, s.
    """

    unseen: float
    idle: float


class Drive(Protocol):
    """What moves the time of a station that is no simulation on; see `HardwareLink`."""

    def begin(self, diagram: Diagram, station: Station, context: Context) -> None:
        """Writes what is known of the robot into a fresh Context of the Diagram that the station is in."""

    def advance(self, simulator: Simulator, time: float) -> None:
        """Goes on to a time, s."""

    def fail(self, error: BaseException) -> None:
        """Notes that the loop has failed, and why; `finish` comes next."""

    def finish(self, simulator: Simulator) -> None:
        """Brings the robot to rest and holds it there, whatever has failed; raises nothing."""

    def explain(self) -> str:
        """What went wrong beside what the guard says, in sentences; empty for nothing."""


class StationTask(Generic[R]):
    """A station with what commands it; to be run once or many times.

    A kind of task overrides `make_record`, `note`, `judge` and, where it needs to, `prepare` and
    `finish`.

    Attributes:
        station: the station.
        controller: what commands it.
        diagram: of both.
        simulator: of the diagram.
        simulated: whether the robot is, so that more is known than what it sees.
        judged_pose: the port with the object's pose by which its place is judged.
    """

    lost_after: ClassVar[float]
    """Simulated without the object being seen, after which it is lost, s."""

    timeout: ClassVar[float]
    """Simulated without anything new, after which the task is stuck, s."""

    def __init__(
        self, builder: DiagramBuilder, station: Station, controller: System, meshcat: Meshcat | None
    ) -> None:
        """Connects a station with what commands it, and builds the Diagram.

        Args:
            builder: both are in it, and whatever else the Diagram has.
            station: the station.
            controller: its input ports named in `SOURCES` and its output ports named in `COMMANDS`
                are connected.
            meshcat: to show the estimate in; None for none.
        """
        ports = map(controller.get_input_port, range(controller.num_input_ports()))
        for port in [port for port in ports if port.get_name() in SOURCES]:
            builder.Connect(station.GetOutputPort(SOURCES[port.get_name()]), port)
        for command in COMMANDS:
            if controller.HasOutputPort(command):
                builder.Connect(controller.GetOutputPort(command), station.GetInputPort(command))
        if meshcat is not None:
            AddEstimateVisualizer(builder, station, controller, meshcat)
        self.station, self.diagram, self._controller = station, builder.Build(), controller
        self.simulated: bool = station.HasOutputPort(TRUE_POSE)
        self.judged_pose = TRUE_POSE if self.simulated else "object.pose"
        self.diagram.set_name(type(self).__name__)
        self.simulator = Simulator(self.diagram)
        self._last_seen = self._last_new = 0.0

    def make_record(self) -> R:
        """An empty record."""
        raise NotImplementedError

    def note(self, record: R, time: float) -> bool:
        """Writes down what is new at a time, s; returns whether anything is."""
        raise NotImplementedError

    def judge(self, record: R, waiting: Waiting) -> Judgment:
        """Says whether the task is over, and how it ended."""
        raise NotImplementedError

    def prepare(self, context: Context, seed: int) -> None:
        """Sets what else is to be set in the fresh Context of the Diagram."""

    def finish(self, record: R) -> None:
        """Completes the record of a run that has ended."""

    def run(
        self,
        seed: int | None = None,
        progress: Progress | None = None,
        realtime_rate: float = 0.0,
        drive: Drive | None = None,
    ) -> R:
        """Runs the task from its beginning.

        Args:
            seed: of everything random, instead of the scenario's.
            progress: told after every step.
            realtime_rate: at most so many simulated seconds a second; 0 for as fast as possible.
            drive: of a station that is no simulation; it has a rate of its own.

        Returns:
            What came of it. Ctrl-C ends it early, with what there is by then. So does, with a
            `drive`, whatever fails in the loop: the robot is brought to rest first, and the record's
            message says what failed. Without a `drive` a failure is raised.
        """
        simulator, station = self.simulator, self.station
        self.begin(seed, drive)
        context = simulator.get_mutable_context()
        monitor, record = LimitMonitor(station), self.make_record()
        record.truth, record.limit_report = station.GetTruth(context), monitor.limit_report
        self._last_seen = self._last_new = 0.0
        simulator.set_target_realtime_rate(realtime_rate)
        simulator.set_monitor(monitor)
        if drive is None:
            self._go_on(record, Simulator.AdvanceTo, progress)
        else:
            try:
                self._go_on(record, drive.advance, progress)
            except (Exception, SystemExit) as error:  # the robot must come to rest whatever it is
                drive.fail(error)
                record.status = TaskStatus.STOPPED
            drive.finish(simulator)
            guard = self._read_guard()
            if guard is not None and guard.failed and record.status != TaskStatus.INTERRUPTED:
                record.status, record.message = TaskStatus.STOPPED, describe_stop(guard)
        self._complete(record, drive)
        return record

    def _go_on(
        self, record: R, advance: Callable[[Simulator, float], None], progress: Progress | None
    ) -> None:
        """Goes on until the judge says that the task is over, or Ctrl-C does."""
        simulator = self.simulator
        try:
            simulator.Initialize()
            while not record.status:
                advance(simulator, simulator.get_context().get_time() + ADVANCE)
                self._observe(record)
                if progress is not None:
                    progress(self.read("executor.status"), len(record.log))
        except KeyboardInterrupt:
            self._observe(record)
            if not record.status:
                message = f"Interrupted after {len(record.log)} pushes."
                record.status, record.message = TaskStatus.INTERRUPTED, message

    def _complete(self, record: R, drive: Drive | None) -> None:
        """Writes into the record what is known only at its end; with a `drive`, as much as can still be read."""
        context = self.simulator.get_context()
        remarks: list[str] = []

        def read_stream() -> None:
            record.stream = self.station.FindStream(context)

        def read_sight() -> None:
            record.sight = self.station.FindSight(context)

        def name_untouched() -> None:
            untouched = self.read("estimate.identification").unused_pushes
            if untouched:
                remarks.append(f"Nothing was touched in {', '.join(untouched)}.")

        for part in (read_stream, read_sight, lambda: self.finish(record), name_untouched):
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
        """Gives the simulator a fresh Context in which all is where it begins; see `run`."""
        self.simulator.reset_context(self.diagram.CreateDefaultContext())
        context = self.simulator.get_mutable_context()
        seed = self.station.scenario.seed if seed is None else seed
        if drive is not None:
            drive.begin(self.diagram, self.station, context)
        self.station.SetStart(context, seed)
        self.prepare(context, seed)

    def preview(self, drive: Drive, within: float) -> PushCommand | None:
        """The first push that the task would make, while nothing moves; None where there is none within a time, s."""
        self.begin(drive=drive)
        self.simulator.Initialize()
        time = 0.0
        while time < within:
            time += ADVANCE
            drive.advance(self.simulator, time)
            command = PushCommand.from_vector(self.read("push_command", self._controller))
            if command.command_id:
                return command
        return None

    def read(self, port: str, system: System | None = None) -> Any:
        """What an output port shows at present: of the station, or of another `system` of the Diagram."""
        system = system or self.station
        return system.GetOutputPort(port).Eval(
            system.GetMyContextFromRoot(self.simulator.get_context())
        )

    def note_step(self, record: ControlledRecord[Any], time: float) -> bool:
        """Writes down what the controller says, where that is new; returns whether it is."""
        status = self.read("status", self._controller)
        if status is record.last:
            return False
        push = PushCommand.from_vector(self.read("push_command", self._controller))
        grasp = GraspCommand()
        if self._controller.HasOutputPort("grasp_command"):
            grasp = GraspCommand.from_vector(self.read("grasp_command", self._controller))
        begun = {0, *(step.push.command_id for step in record.steps if step.push)}
        grasped = {0, *(step.grasp.command_id for step in record.steps if step.grasp)}
        record.last = status
        record.steps.append(
            TaskStep(
                time,
                status,
                np.array(self.read("object.pose")),
                None if push.command_id in begun else push,
                None if grasp.command_id in grasped else grasp,
            )
        )
        return True

    def AimCamera(self, meshcat: Meshcat) -> None:
        """Points Meshcat's camera so that the whole arm and the whole table are in sight, whatever the robot does."""
        station = self.station
        x0, y0, x1, y1 = station.table_top.union(shapely.Point(0.0, 0.0)).bounds
        x, y = (np.array([x0 + x1, y0 + y1]) / 2 + station.scenario.object_pose[:2]) / 2
        distance = CAMERA_SHARE * float(np.hypot(x1 - x0, y1 - y0))
        AimCamera(meshcat, (x, y, CAMERA_HEIGHT), distance, CAMERA_AZIMUTH, CAMERA_ELEVATION)

    def _observe(self, record: R) -> None:
        """Writes down what there is by now, and lets the judge speak."""
        time = record.duration = self.simulator.get_context().get_time()
        record.log = self.read("estimate.push_log")
        found = self.read("estimate.identification")
        if found.push_names and (not record.estimates or found is not record.estimates[-1]):
            record.estimates.append(found)
        hidden = (
            self.station.found is not None and not self.read("executor.status").ready
        )  # by the arm at work
        if hidden or np.isfinite(self.read("object.pose")).all():
            self._last_seen = time
        if self.note(record, time):
            self._last_new = time
        record.status, record.message = self.judge(
            record, Waiting(time - self._last_seen, time - self._last_new)
        )
        guard = self._read_guard()
        if guard is None or not guard.stopped:
            return
        # whatever the judge says, a task in which the arm was stopped ends once that is at rest
        record.status, record.message = GO_ON
        if guard.ended:
            record.status = TaskStatus.INTERRUPTED if guard.by_user else TaskStatus.STOPPED
            record.message = describe_stop(guard)

    def _read_guard(self) -> GuardStatus | None:
        """What the guard of a real arm says; None where there is none."""
        if not self.station.HasOutputPort(GUARD_STATUS):
            return None
        status: GuardStatus = self.read(GUARD_STATUS)
        return status


def describe_stop(guard: GuardStatus) -> str:
    """Says in a sentence that an arm was stopped, why, and whether it is known to be at rest."""
    held = "is held" if guard.mode == GuardMode.HOLDING else "was not seen at rest"
    return f"The arm was stopped at {guard.since:.2f} s and {held}: {guard.reason}."


def AddEstimateVisualizer(
    builder: DiagramBuilder, station: Station, controller: System, meshcat: Meshcat
) -> EstimateVisualizer:
    """Shows the station's estimate and what the controller commands, in Meshcat."""
    part = station.object_in_plant
    visualizer = builder.AddNamedSystem(
        "estimate_visualizer",
        EstimateVisualizer(station.obj, meshcat, height=part.height, body=int(part.body.index())),
    )
    builder.Connect(station.GetOutputPort("body_poses"), visualizer.GetInputPort("body_poses"))
    builder.Connect(
        station.GetOutputPort("object.pose_true"), visualizer.GetInputPort("object_pose")
    )
    for port in SHOWN:
        builder.Connect(station.GetOutputPort(f"estimate.{port}"), visualizer.GetInputPort(port))
    builder.Connect(
        controller.GetOutputPort("push_command"), visualizer.GetInputPort("push_command")
    )
    return visualizer

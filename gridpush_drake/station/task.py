"""`TaskRun`: what the runs of all tasks in the station share.

A task is a Diagram of a station and the systems that command it, and a judge that says when it is over. A run makes a
fresh Context, puts everything where it begins, and goes on in short steps until the judge is satisfied or somebody
presses Ctrl-C.

`TaskRecord`: what the records of all tasks in the station tell.

A Diagram of a station and the system that commands it, ready to run.

The station's table as planning knows it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
import shapely
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System

from gridpush_drake.errors import ScenarioError
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.meshcat_server import AimCamera
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.limit_monitor import LimitMonitor, LimitReport
from gridpush_drake.station.push_station import PushStation
from gridpush_drake.systems.estimate_visualizer import EstimateVisualizer
from gridpush_drake.systems.messages import PushStatus


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


INTERRUPTED = TaskStatus.INTERRUPTED

ADVANCE = 0.1
"""Simulated between two looks at how far a task is, s."""

LOST_AFTER = 0.5
"""Simulated without the object being seen, after which it has left the table, where a task says nothing else, s."""

Judgment = tuple[TaskStatus, str]
"""A task's status, and a sentence about it."""

GO_ON: Judgment = (TaskStatus.RUNNING, "")

Judge = Callable[[float], Judgment]
"""Called with the time, s, after every step."""

Progress = Callable[[PushStatus, int], None]
"""Told now and then the executor's status and how many pushes are in the log."""


@dataclass
class TaskEnd:
    """How a run ended; filled while it runs.

    Attributes:
        status: as the judge says, or INTERRUPTED.
        message: the status in a sentence.
        limit_report: how the robot behaved.
        duration: simulated, s.
    """

    status: TaskStatus = TaskStatus.RUNNING
    message: str = ""
    limit_report: LimitReport = field(default_factory=LimitReport)
    duration: float = 0.0


class TaskRun:
    """Runs a task's Diagram, once or many times.

    Attributes:
        station: the station.
        diagram: that it is part of, with the systems that command it.
        simulator: of the diagram.
    """

    def __init__(self, station: PushStation, diagram: Diagram) -> None:
        """Makes the simulator."""
        self.station, self.diagram = station, diagram
        self.simulator = Simulator(diagram)

    def run(
        self,
        judge: Judge,
        seed: int | None = None,
        progress: Progress | None = None,
        realtime_rate: float = 0.0,
        prepare: Callable[[Context], None] | None = None,
    ) -> TaskEnd:
        """Runs the task from its beginning.

        Args:
            judge: says when it is over.
            seed: of everything random in the station, instead of the scenario's.
            progress: told after every step.
            realtime_rate: at most so many simulated seconds a second; 0 for as fast as possible.
            prepare: what else is to be set in the fresh Context of the Diagram.

        Returns:
            How it ended. Ctrl-C ends it early, after one more word of the judge's, which counts where he has one.
        """
        simulator, station = self.simulator, self.station
        simulator.reset_context(self.diagram.CreateDefaultContext())
        context = simulator.get_mutable_context()
        station.SetStart(context, station.scenario.seed if seed is None else seed)
        if prepare is not None:
            prepare(context)
        monitor = LimitMonitor(station)
        end = TaskEnd(limit_report=monitor.limit_report)
        simulator.set_target_realtime_rate(realtime_rate)
        simulator.set_monitor(monitor)
        try:
            simulator.Initialize()
            while not end.status:
                simulator.AdvanceTo(context.get_time() + ADVANCE)
                end.duration = context.get_time()
                end.status, end.message = judge(end.duration)
                if progress is not None:
                    progress(self.read("executor.status"), len(self.read("estimate.push_log")))
        except KeyboardInterrupt:
            end.duration = context.get_time()
            end.status, end.message = judge(end.duration)
            if not end.status:
                pushes = len(self.read("estimate.push_log"))
                end.status, end.message = INTERRUPTED, f"Interrupted after {pushes} pushes."
        return end

    def read(self, port: str, system: System | None = None) -> Any:
        """What an output port shows at present: of the station, or of another `system` of the Diagram."""
        system = system or self.station
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self.simulator.get_context()))


@dataclass
class Sight:
    """Whether the object is still there, for judges.

    Attributes:
        lost_after: simulated without the object being seen, after which it is lost, s.
        last_seen: s.
    """

    lost_after: float = LOST_AFTER
    last_seen: float = 0.0

    def is_lost(self, time: float, pose: np.ndarray) -> bool:
        """Whether it has not been seen for `lost_after`; `pose` (3,) is NaN where it is not seen."""
        if np.isfinite(pose).all():
            self.last_seen = time
        return time - self.last_seen > self.lost_after


@dataclass
class TaskRecord:
    """What came of a run; filled while it runs.

    Attributes:
        obj: the object.
        truth: what it really weighs and how it rubs.
        log: all pushes, in order.
        estimates: the identification after each push learned from.
        status: how it ended.
        message: the status in a sentence.
        limit_report: how the robot behaved.
        duration: simulated, s.
    """

    obj: GridObject
    truth: CellParameters
    log: PushLog = field(default_factory=lambda: PushLog(()), kw_only=True)
    estimates: list[Identification] = field(default_factory=list, kw_only=True)
    status: TaskStatus = field(default=TaskStatus.RUNNING, kw_only=True)
    message: str = field(default="", kw_only=True)
    limit_report: LimitReport = field(default_factory=LimitReport, kw_only=True)
    duration: float = field(default=0.0, kw_only=True)

    def note_learned(self, task: TaskRun) -> None:
        """Writes down the pushes made, and what was learned from them."""
        self.log = task.read("estimate.push_log")
        found = task.read("estimate.identification")
        if found.push_names and (not self.estimates or found is not self.estimates[-1]):
            self.estimates.append(found)

    def note_end(self, task: TaskRun, end: TaskEnd) -> None:
        """Writes down how the task's last run ended."""
        self.truth = task.station.GetTruth(task.simulator.get_context())
        self.status, self.message, self.limit_report, self.duration = (
            end.status,
            end.message,
            end.limit_report,
            end.duration,
        )


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

SHOWN = ("mass", "friction", "contact_friction", "center_of_mass", "center_of_mass_covariance")
"""Estimates that are drawn."""


CAMERA_SHARE = 0.82
"""Distance of Meshcat's camera from what it looks at, in diagonals of the table and the robot's base."""

CAMERA_HEIGHT = 0.17
"""Of what it looks at above the table, m: a third of the arm."""

CAMERA_AZIMUTH, CAMERA_ELEVATION = 0.75, 0.5
"""Where it stands, rad: opposite the robot, to its left, beyond the edge that things are slid to."""


def AimStationCamera(meshcat: Meshcat, station: PushStation) -> None:
    """Points Meshcat's camera so that the whole arm and the whole table are in sight, whatever the robot does."""
    x0, y0, x1, y1 = station.table_top.union(shapely.Point(0.0, 0.0)).bounds
    x, y = (np.array([x0 + x1, y0 + y1]) / 2 + station.scenario.object_pose[:2]) / 2
    distance = CAMERA_SHARE * float(np.hypot(x1 - x0, y1 - y0))
    AimCamera(meshcat, (x, y, CAMERA_HEIGHT), distance, CAMERA_AZIMUTH, CAMERA_ELEVATION)


def BuildTask(
    builder: DiagramBuilder, station: PushStation, controller: System, name: str, meshcat: Meshcat | None = None
) -> TaskRun:
    """Connects a station with what commands it, and builds the Diagram.

    Args:
        builder: both are in it, and whatever else the Diagram has.
        station: the station.
        controller: its input ports named in `SOURCES` and its output ports named in `COMMANDS` are connected.
        name: of the Diagram.
        meshcat: to show the estimate in; None for none.

    Returns:
        Runs the Diagram.
    """
    ports = map(controller.get_input_port, range(controller.num_input_ports()))
    for port in [port for port in ports if port.get_name() in SOURCES]:
        builder.Connect(station.GetOutputPort(SOURCES[port.get_name()]), port)
    for command in COMMANDS:
        if controller.HasOutputPort(command):
            builder.Connect(controller.GetOutputPort(command), station.GetInputPort(command))
    if meshcat is not None:
        AddEstimateVisualizer(builder, station, controller, meshcat)
    diagram = builder.Build()
    diagram.set_name(name)
    return TaskRun(station, diagram)


def AddEstimateVisualizer(
    builder: DiagramBuilder, station: PushStation, controller: System, meshcat: Meshcat
) -> EstimateVisualizer:
    """Shows the station's estimate and what the controller commands, in Meshcat."""
    part = station.object_in_plant
    visualizer = builder.AddNamedSystem(
        "estimate_visualizer",
        EstimateVisualizer(station.obj, meshcat, height=part.height, body=int(part.body.index())),
    )
    builder.Connect(station.GetOutputPort("body_poses"), visualizer.GetInputPort("body_poses"))
    builder.Connect(station.GetOutputPort("object.pose_true"), visualizer.GetInputPort("object_pose"))
    for port in SHOWN:
        builder.Connect(station.GetOutputPort(f"estimate.{port}"), visualizer.GetInputPort(port))
    builder.Connect(controller.GetOutputPort("push_command"), visualizer.GetInputPort("push_command"))
    return visualizer


EDGE_DETAIL = 5e-4
"""m by which the edge may be simplified: of a round table to a polygon of few corners."""


def make_surface(station: PushStation) -> SupportSurface:
    """The table's top. Raises ScenarioError where it is in several pieces."""
    top = station.table_top
    if not isinstance(top, shapely.Polygon):
        raise ScenarioError("directives: the table's top is in several pieces; expected one")
    return SupportSurface(shapely.simplify(top, EDGE_DETAIL))

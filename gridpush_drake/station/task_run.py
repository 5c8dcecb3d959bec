"""`TaskRun`: what the runs of all tasks in the station share.

A task is a Diagram of a station and the systems that command it, and a judge that says when it is over. A run makes a
fresh Context, puts everything where it begins, and goes on in short steps until the judge is satisfied or somebody
presses Ctrl-C.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, System

from gridpush_drake.station.conduct import Conduct, ConductMonitor
from gridpush_drake.station.push_station import PushStation
from gridpush_drake.systems.push_status import PushStatus


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

Judgement = tuple[TaskStatus, str]
"""A task's status, and a sentence about it."""

GO_ON: Judgement = (TaskStatus.RUNNING, "")

Judge = Callable[[float], Judgement]
"""Called with the time, s, after every step."""

Progress = Callable[[PushStatus, int], None]
"""Told now and then the executor's status and how many pushes are in the log."""


@dataclass
class TaskEnd:
    """How a run ended; filled while it runs.

    Attributes:
        status: as the judge says, or INTERRUPTED.
        message: the status in a sentence.
        conduct: how the robot behaved.
        duration: simulated, s.
    """

    status: TaskStatus = TaskStatus.RUNNING
    message: str = ""
    conduct: Conduct = field(default_factory=Conduct)
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
        monitor = ConductMonitor(station)
        end = TaskEnd(conduct=monitor.conduct)
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

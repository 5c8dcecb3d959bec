"""`TaskRecord`: what the records of all tasks in the station tell."""

from dataclasses import dataclass, field

from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.result import Identification
from gridpush_drake.pushes.log import PushLog
from gridpush_drake.station.conduct import Conduct
from gridpush_drake.station.task_run import TaskEnd, TaskRun, TaskStatus


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
        conduct: how the robot behaved.
        duration: simulated, s.
    """

    obj: GridObject
    truth: CellParameters
    log: PushLog = field(default_factory=lambda: PushLog(()), kw_only=True)
    estimates: list[Identification] = field(default_factory=list, kw_only=True)
    status: TaskStatus = field(default=TaskStatus.RUNNING, kw_only=True)
    message: str = field(default="", kw_only=True)
    conduct: Conduct = field(default_factory=Conduct, kw_only=True)
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
        self.status, self.message, self.conduct, self.duration = end.status, end.message, end.conduct, end.duration

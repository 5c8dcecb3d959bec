"""An experiment: the station pokes an object it knows nothing about, learns, and is tested on pushes it never saw."""

from dataclasses import dataclass, field

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder

from gridpush_drake.errors import StationError
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.others import leave_out
from gridpush_drake.station.push_station import MakePushStation
from gridpush_drake.station.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.station import MakeFingerRegion, Station, StationMaker
from gridpush_drake.station.task import (
    ADVANCE,
    GO_ON,
    Judgment,
    StationTask,
    TaskRecord,
    TaskStatus,
    Waiting,
)
from gridpush_drake.systems.messages import PushStatus
from gridpush_drake.systems.poke_policy import PokePolicy, PokeRegion, RandomPokeOptions

FINISHED, OBJECT_LOST, STUCK = TaskStatus.FINISHED, TaskStatus.OBJECT_LOST, TaskStatus.STUCK

EDGE_MARGIN = 0.03
"""Between the object and the table's edge or another object, where pokes are meant to leave it,
m."""

MIDDLE_MARGIN = 0.09
"""Between the object's centroid and the limits of where the finger can be, for the finger to get
around it, m."""

LOST_AFTER, HIDDEN_AFTER = 0.5, 5.0
"""Simulated without the object being seen, after which it has left the table, s; and where the arm
may hide it."""

LEARNING_TIME = 10.0
"""For the last push to be learned from, where that goes on beside the Diagram, s."""

REFUSALS = 20
"""In a row, after which the experiment is stuck."""


@dataclass(repr=False)
class IdentifyTaskRecord(TaskRecord):
    """What came of an experiment: "finished", "object_lost", "interrupted" or "stuck"; filled while it runs.

    Attributes:
        training: how many pushes, from the first, are to learn from.
        phases: (time, s, and status) wherever the executor began something new.
    """

    training: int = 0
    phases: list[tuple[float, PushStatus]] = field(default_factory=list)

    @property
    def training_log(self) -> PushLog:
        """The pushes learned from."""
        return self.log[: self.training]

    @property
    def held_out_log(self) -> PushLog:
        """The pushes that were only predicted."""
        return self.log[self.training :]


@dataclass
class PokeJudge:
    """Decides when an experiment is over.

    Attributes:
        pushes: to be carried out.
        lost_after: s without the object being seen, after which it has left the table.
        executed: when it last looked.
        refused: up to the last push that was carried out.
    """

    pushes: int
    lost_after: float = LOST_AFTER
    executed: int = 0
    refused: int = 0

    def judge(self, status: PushStatus, waiting: Waiting) -> Judgment:
        """Status and message."""
        if status.executed > self.executed:
            self.executed, self.refused = status.executed, status.refused
        if waiting.unseen > self.lost_after:
            return (
                OBJECT_LOST,
                f"The object left the table during push {status.executed + (not status.ready)}.",
            )
        if status.executed >= self.pushes:
            return FINISHED, f"All {self.pushes} pushes were carried out."
        if status.refused - self.refused >= REFUSALS:
            return (
                STUCK,
                f"The last {REFUSALS} pushes were refused; the last one because {status.reason}.",
            )
        if waiting.idle > IdentifyTask.timeout:
            return STUCK, (
                f"No push was found for {IdentifyTask.timeout:g} s: from where the object lies, the finger reaches no "
                "place from which it could push; is the object within the workspace?"
            )
        return GO_ON


class IdentifyTask(StationTask[IdentifyTaskRecord]):
    """The station with a policy that pokes."""

    lost_after = LOST_AFTER
    timeout = 10.0

    def __init__(
        self,
        scenario: PushScenario | ResolvedScenario,
        meshcat: Meshcat | None = None,
        make_station: StationMaker = MakePushStation,
    ) -> None:
        """Makes the Diagram.

        Args:
            scenario: resolved or not, what stands where, and how it is poked.
            meshcat: to show it in; None for none.
            make_station: of a scenario; a simulated one by default.

        Raises:
            ScenarioError, StationError: see `MakePushStation`.
        """
        resolved = resolve(scenario)
        scenario = resolved.scenario
        builder = DiagramBuilder()
        station = builder.AddSystem(make_station(resolved, meshcat, show_object=False))
        self.controller = builder.AddNamedSystem("policy", _make_policy(station))
        super().__init__(builder, station, self.controller, meshcat)

    def prepare(self, context: Context, seed: int) -> None:
        """Seeds the policy."""
        self.controller.SetSeed(context, seed)

    def make_record(self) -> IdentifyTaskRecord:
        """An empty record."""
        pokes = self.station.scenario.pokes
        lost_after = self.lost_after if self.station.found is None else HIDDEN_AFTER
        self._judge = PokeJudge(pokes.count + pokes.test_count, lost_after)
        self._logged, self._logged_at = 0, -float("inf")
        return IdentifyTaskRecord(self.station.obj, self.station.truth, training=pokes.count)

    def note(self, record: IdentifyTaskRecord, time: float) -> bool:
        """Writes down what the executor began; something is new while a push is under way."""
        status = self.read("executor.status")
        if not record.phases or record.phases[-1][1] != status:
            record.phases.append((time, status))
        if len(record.training_log) > self._logged:
            self._logged, self._logged_at = len(record.training_log), time
        return not status.ready

    def judge(self, record: IdentifyTaskRecord, waiting: Waiting) -> Judgment:
        """Status and message; an experiment is over once its pushes were learned from."""
        judgment = self._judge.judge(self.read("executor.status"), waiting)
        return (
            GO_ON
            if judgment[0] == FINISHED and not self._has_learned(record.duration)
            else judgment
        )

    def _has_learned(self, time: float) -> bool:
        """Whether the last push to learn from was learned from, or will not be."""
        if self.read("estimate.message") or time > self._logged_at + LEARNING_TIME:
            return True
        return bool(time - self.read("estimate.age")[0] >= self._logged_at - ADVANCE)

    def finish(self, record: IdentifyTaskRecord) -> None:
        """Raises StationError where not a single push could be carried out."""
        if not len(record.log) and record.status == STUCK:
            raise StationError(record.message)


def _make_policy(station: Station) -> PokePolicy:
    scenario, pokes = station.scenario, station.scenario.pokes
    keep_in = leave_out(station.table_top.buffer(-EDGE_MARGIN), station.others, EDGE_MARGIN)
    middle = MakeFingerRegion(station, MIDDLE_MARGIN)
    region = PokeRegion(MakeFingerRegion(station), keep_in, None if middle.is_empty else middle)
    style = RandomPokeOptions(
        distance=(pokes.distance[0], pokes.distance[1]),
        speed=pokes.speed,
        slant=pokes.slant,
        tip_radius=station.robot.finger.tip_radius,
        clearance=pokes.clearance,
    )
    return PokePolicy(
        station.obj,
        region,
        scenario.seed,
        pokes.count,
        style,
        reach=lambda command: station.FindObstacle(command) is None,
        test_pushes=pokes.test_count,
        test_distance=pokes.test_distance,
        answer_delay=scenario.simulation.answer_delay,
    )

"""An experiment: the station pokes an object that it knows nothing about, and learns it.

Then it is tested on further pushes, which are only predicted.
"""

from dataclasses import dataclass, field

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import StationError
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.exploration.random_pokes import (
    PokeRegion,
    RandomPokeOptions,
    RandomPokes,
)
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.scene.finger_region import MakeFingerRegion
from gridpush_drake.station.scene.posts import leave_out
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.simulated.station import Station, StationMaker
from gridpush_drake.station.tasks.task import (
    GO_ON,
    OBSERVATION_PERIOD,
    Judgment,
    StationTask,
    TaskRecord,
    TaskStatus,
    Waiting,
)
from gridpush_drake.systems.base.messages import PushStatus
from gridpush_drake.systems.control.poke_policy import PokePolicy, make_command

EDGE_MARGIN = 0.03
"""Distance from the table's edge, and from other objects, that pokes are meant to leave, m."""

MIDDLE_MARGIN = 0.09
"""Distance from the object's centroid to the limits of where the finger can be that lets the finger
get around the object, m. Pokes are chosen so that they keep it."""

LOST_AFTER = 0.5
"""If an ideal camera does not see the object for this long, it has left the table; simulated time,
s."""

HIDDEN_AFTER = 5.0
"""If a color and depth camera, from which the arm may hide the object, does not see it for this
long, it has left the table; simulated time, s."""

LEARNING_TIME = 10.0
"""Longest wait for the last push to be learned from, s. With a real arm learning goes on beside the
Diagram, in a thread of its own."""

MAX_REFUSALS = 20
"""If this many pushes in a row are refused, the experiment is stuck."""


@dataclass(repr=False)
class IdentifyTaskRecord(TaskRecord):
    """What came of an experiment. It is filled while the experiment runs.

    Attributes:
        training: number of pushes, from the first, that are to be learned from.
        phases: time, s, and the executor's status, whenever the executor began something new.
    """

    training: int = 0
    phases: list[tuple[float, PushStatus]] = field(default_factory=list)

    @property
    def training_log(self) -> PushLog:
        """The pushes that were learned from."""
        return self.log[: self.training]

    @property
    def held_out_log(self) -> PushLog:
        """The pushes that were only predicted."""
        return self.log[self.training :]


@dataclass
class PokeJudge:
    """Decides when an experiment is over.

    Attributes:
        pushes: number of pushes to be carried out.
        lost_after: if the object is not seen for this long, it has left the table, s.
        executed: number of pushes that had been carried out when it last judged.
        refused: number of pushes that had been refused when the last push was carried out.
    """

    pushes: int
    lost_after: float = LOST_AFTER
    executed: int = 0
    refused: int = 0

    def judge(self, status: PushStatus, waiting: Waiting) -> Judgment:
        """Judges by the executor's status and by how long nothing was seen or happened."""
        if status.executed > self.executed:
            self.executed = status.executed
            self.refused = status.refused
        if waiting.unseen > self.lost_after:
            push = status.executed + (not status.ready)
            return TaskStatus.OBJECT_LOST, f"The object left the table during push {push}."
        if status.executed >= self.pushes:
            return TaskStatus.FINISHED, f"All {self.pushes} pushes were carried out."
        if status.refused - self.refused >= MAX_REFUSALS:
            return TaskStatus.STUCK, (
                f"The last {MAX_REFUSALS} pushes were refused; the last one because "
                f"{status.reason}."
            )
        if waiting.idle > IdentifyTask.timeout:
            return TaskStatus.STUCK, (
                f"No push was found for {IdentifyTask.timeout:g} s: from where the object lies, "
                "the finger reaches no place from which it could push; is the object within the "
                "workspace?"
            )
        return GO_ON


class IdentifyTask(StationTask[IdentifyTaskRecord]):
    """An experiment: the station with a policy that pokes an object to learn it."""

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
            scenario: the scenario, resolved or not; its `pokes` say how the object is poked.
            meshcat: Meshcat in which the station is shown; None for none.
            make_station: makes the station; a simulated one by default.

        Raises:
            ScenarioError: the scenario makes no sense.
            StationError: nothing can be rendered on this computer; or see `MakeHardwareStation`.
        """
        resolved = resolve(scenario)
        scenario = resolved.scenario
        builder = DiagramBuilder()
        station = builder.AddSystem(make_station(resolved, meshcat, show_object=False))
        self.controller = builder.AddNamedSystem(
            "policy", make_policy(station, scenario.pokes.test_count)
        )
        super().__init__(builder, station, self.controller, meshcat)

    def prepare(self, context: Context, seed: int) -> None:
        """Sets the seed from which the policy draws its pokes."""
        self.controller.SetSeed(context, seed)

    def make_record(self) -> IdentifyTaskRecord:
        """Makes the empty record of a run."""
        pokes = self.station.scenario.pokes
        lost_after = self.lost_after if self.station.found is None else HIDDEN_AFTER
        self._judge = PokeJudge(pokes.count + pokes.test_count, lost_after)
        # Number of logged pushes to learn from, and when the last of them was logged, s.
        self._logged = 0
        self._logged_at = -float("inf")
        return IdentifyTaskRecord(self.station.obj, self.station.truth, training=pokes.count)

    def note(self, record: IdentifyTaskRecord, time: float) -> bool:
        """Writes down what the executor began; something is new while a push is under way."""
        status = self.read("executor.status")
        if not record.phases or record.phases[-1][1] != status:
            record.phases.append((time, status))
        if len(record.training_log) > self._logged:
            self._logged = len(record.training_log)
            self._logged_at = time
        return not status.ready

    def judge(self, record: IdentifyTaskRecord, waiting: Waiting) -> Judgment:
        """Decides whether the experiment is over: all pushes are made, and were learned from."""
        judgment = self._judge.judge(self.read("executor.status"), waiting)
        if judgment[0] == TaskStatus.FINISHED and not self._has_learned(record.duration):
            return GO_ON
        return judgment

    def _has_learned(self, time: float) -> bool:
        """Returns whether the last push to learn from was learned from, or never will be."""
        # A message says why learning failed.
        if self.read("estimate.message") or time > self._logged_at + LEARNING_TIME:
            return True
        # The present estimate was asked for, with all pushes logged by then, at `time - age`. The
        # last push was noted up to an `OBSERVATION_PERIOD` after it was logged.
        return bool(time - self.read("estimate.age")[0] >= self._logged_at - OBSERVATION_PERIOD)

    def finish(self, record: IdentifyTaskRecord) -> None:
        """Checks that at least one push was carried out.

        Raises:
            StationError: the experiment is stuck, and not a single push could be carried out.
        """
        if not len(record.log) and record.status == TaskStatus.STUCK:
            raise StationError(record.message)


def make_policy(station: Station, test_pushes: int = 0) -> PokePolicy:
    """Makes the policy that draws pokes as the station's scenario says.

    Args:
        station: the station.
        test_pushes: number of pokes after those to learn from.
    """
    scenario = station.scenario
    pokes = scenario.pokes
    keep_in = leave_out(station.table_top.buffer(-EDGE_MARGIN), station.obstacles, EDGE_MARGIN)
    # In a small workspace the finger gets around the object nowhere; then any place will do.
    middle = MakeFingerRegion(station, MIDDLE_MARGIN)
    strategy = RandomPokes(
        RandomPokeOptions(
            distance=(pokes.distance[0], pokes.distance[1]),
            speed=pokes.speed,
            slant=pokes.slant,
            tip_radius=station.robot.finger.tip_radius,
            clearance=pokes.clearance,
        ),
        PokeRegion(keep_in, None if middle.is_empty else middle),
        scenario.seed,
    )
    region = MakeFingerRegion(station)

    def can_push(poke: Push) -> bool:
        command = make_command(1, poke, pokes.speed)
        return not region.is_empty and station.FindObstacle(command) is None

    rules = PushConstraints(
        finger_region=None if region.is_empty else region,
        push_rule=can_push,
    )
    return PokePolicy(
        Model(station.obj),
        strategy,
        rules,
        pokes.count,
        test_pushes=test_pushes,
        test_distance=pokes.test_distance,
        answer_delay=scenario.simulation.answer_delay,
    )

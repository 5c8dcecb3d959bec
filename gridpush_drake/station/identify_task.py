"""An experiment: the station pokes an object it knows nothing about, learns, and is tested on pushes it never saw."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder

from gridpush_drake.errors import StationError
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.finger_region import MakeFingerRegion
from gridpush_drake.station.push_station import MakePushStation, PushStation
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.task import (
    GO_ON,
    INTERRUPTED,
    AimStationCamera,
    BuildTask,
    Judgment,
    Progress,
    Sight,
    TaskRecord,
    TaskStatus,
)
from gridpush_drake.systems.messages import PushStatus
from gridpush_drake.systems.poke_policy import PokePolicy, PokeRegion, RandomPokeOptions

FINISHED, OBJECT_LOST, STUCK = TaskStatus.FINISHED, TaskStatus.OBJECT_LOST, TaskStatus.STUCK

EDGE_MARGIN = 0.03
"""Between the object and the table's edge, where pokes are meant to leave it, m."""

MIDDLE_MARGIN = 0.09
"""Between the object's centroid and the limits of where the finger can be, for the finger to get around it, m."""

REFUSALS = 20
"""In a row, after which the experiment is stuck."""

TIMEOUT = 10.0
"""Simulated without a push being under way, after which it is stuck, s."""

__all__ = [
    "FINISHED",
    "INTERRUPTED",
    "OBJECT_LOST",
    "STUCK",
    "IdentifyTask",
    "IdentifyTaskRecord",
    "Progress",
]  # fmt: skip


@dataclass
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


class IdentifyTask:
    """The station with a policy that pokes, to be run once or many times.

    Attributes:
        station: the station.
        diagram: of station, policy and, with Meshcat, the estimate's picture.
        simulator: of the diagram.
    """

    def __init__(self, scenario: PushScenario, meshcat: Meshcat | None = None) -> None:
        """Makes the Diagram.

        Args:
            scenario: what stands where, and how it is poked.
            meshcat: to show it in; None for none.

        Raises:
            ScenarioError, StationError: see `MakePushStation`.
        """
        self._scenario = scenario
        builder = DiagramBuilder()
        self.station: PushStation = builder.AddSystem(MakePushStation(scenario, meshcat, show_object=False))
        self._policy = builder.AddNamedSystem("policy", _make_policy(self.station))
        self._task = BuildTask(builder, self.station, self._policy, "push_experiment", meshcat)
        self.diagram: Diagram = self._task.diagram
        self.simulator: Simulator = self._task.simulator

    def AimCamera(self, meshcat: Meshcat) -> None:
        """Points Meshcat's camera at the arm and the table."""
        AimStationCamera(meshcat, self.station)

    def run(
        self, seed: int | None = None, progress: Progress | None = None, realtime_rate: float = 0.0
    ) -> IdentifyTaskRecord:
        """Runs the experiment from its beginning.

        Args:
            seed: of everything random, instead of the scenario's.
            progress, realtime_rate: see `TaskRun.run`.

        Returns:
            What came of it. Ctrl-C ends it early, with what there is by then.

        Raises:
            StationError: not a single push could be carried out.
        """
        seed = self._scenario.seed if seed is None else seed
        pokes = self._scenario.pokes
        record = IdentifyTaskRecord(self.station.obj, self.station.truth, training=pokes.count)
        watch = _Watch(pokes.count + pokes.test_count)

        def judge(time: float) -> Judgment:
            status = self._note(record)
            if not record.phases or record.phases[-1][1] != status:
                record.phases.append((time, status))
            return watch.judge(time, status, self._task.read("object.pose"))

        end = self._task.run(judge, seed, progress, realtime_rate, lambda context: self._policy.SetSeed(context, seed))
        record.note_end(self._task, end)
        if not len(record.log) and record.status == STUCK:
            raise StationError(record.message)
        return record

    def _note(self, record: IdentifyTaskRecord) -> PushStatus:
        record.note_learned(self._task)
        status: PushStatus = self._task.read("executor.status")
        return status


@dataclass
class _Watch:
    """Decides when an experiment is over."""

    pushes: int
    sight: Sight = field(default_factory=Sight)
    last_busy: float = 0.0
    executed: int = 0
    refused: int = 0

    def judge(self, time: float, status: PushStatus, pose: NDArray[np.float64]) -> Judgment:
        """Status and message."""
        lost = self.sight.is_lost(time, pose)
        if not status.ready:
            self.last_busy = time
        if status.executed > self.executed:
            self.executed, self.refused = status.executed, status.refused
        if lost:
            return OBJECT_LOST, f"The object left the table during push {status.executed + (not status.ready)}."
        if status.executed >= self.pushes:
            return FINISHED, f"All {self.pushes} pushes were carried out."
        if status.refused - self.refused >= REFUSALS:
            return STUCK, f"The last {REFUSALS} pushes were refused; the last one because {status.reason}."
        if time - self.last_busy > TIMEOUT:
            return STUCK, (
                f"No push was found for {TIMEOUT:g} s: from where the object lies, the finger reaches no place from "
                "which it could push; is the object within the workspace?"
            )
        return GO_ON


def _make_policy(station: PushStation) -> PokePolicy:
    scenario, pokes = station.scenario, station.scenario.pokes
    keep_in = station.table_top.buffer(-EDGE_MARGIN)
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
    )

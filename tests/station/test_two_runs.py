"""What differs between two runs is in their Contexts; stations stand side by side, and are freed when dropped."""

import gc
import subprocess
import sys
from pathlib import Path
from weakref import ref

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.multibody.ground_truth import SetGridObjectPose, SetGridObjectVelocity
from gridpush_drake.station.scene.contents import MakeTruth
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.limit_monitor import LimitMonitor
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.tasks.identify_task import IdentifyTask
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.systems.base.messages import PushCommand

RUNS = ((1, (0.55, 0.05, 0.3), 0.6), (2, (0.6, -0.05, -0.5), 0.4))
"""Seed, where the object begins, and how fast it slides along x then, m/s: friction and masses tell
at once."""

STEPS, STEP = 6, 0.05
"""Of the simulation, s."""

GROWTH = 2.0
"""MB that a station leaves behind at most; one that is not freed leaves 6."""

BUILDS = """
import gc
from pathlib import Path
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.push_station import MakePushStation

def read_memory():
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024

used = []
for _ in range(13):
    MakePushStation(PushScenario(object="open_book")).CreateDefaultContext()
    gc.collect()
    used.append(read_memory())
print((used[-1] - used[2]) / 10)
"""


def make_scenario():
    return PushScenario(object="open_book")


@pytest.fixture(scope="module")
def station():
    return MakePushStation(make_scenario())


class Run:
    """One run of a station, in a Context of its own or in one shared with others."""

    def __init__(self, station, root, seed, pose, speed):
        self.station, self.root, self.seen = station, root, []
        station.SetStart(root, seed)
        plant_context = station.plant.GetMyMutableContextFromRoot(root)
        SetGridObjectPose(station.plant, plant_context, station.object_in_plant, pose)
        SetGridObjectVelocity(
            station.plant, plant_context, station.object_in_plant, (speed, 0.0, 1.0)
        )
        own = station.GetMyMutableContextFromRoot(root)
        command = PushCommand(1, pose[0] + 0.3, pose[1], np.pi, 0.1, 0.03)
        station.GetInputPort("push_command").FixValue(own, command.to_vector())

    def look(self):
        context = self.station.GetMyContextFromRoot(self.root)
        state = self.station.plant.GetPositionsAndVelocities(
            self.station.plant.GetMyContextFromRoot(self.root)
        )
        ports = ("object.pose", "pusher.state", "iiwa.torque_commanded")
        truth = self.station.GetTruth(self.root)
        shown = [self.station.GetOutputPort(port).Eval(context) for port in ports]
        self.seen.append(
            np.concatenate([state, *shown, truth.mass, truth.friction, [truth.contact_friction]])
        )


def simulate_alone(station, *start):
    simulator = Simulator(station, station.CreateDefaultContext())
    run = Run(station, simulator.get_mutable_context(), *start)
    for step in range(1, STEPS + 1):
        simulator.AdvanceTo(step * STEP)
        run.look()
    return np.array(run.seen)


@pytest.fixture(scope="module")
def alone(station):
    return [simulate_alone(station, *start) for start in RUNS]


def test_two_runs_of_one_station_do_not_meet(station, alone):
    simulators = [Simulator(station, station.CreateDefaultContext()) for _ in RUNS]
    runs = [
        Run(station, simulator.get_mutable_context(), *start)
        for simulator, start in zip(simulators, RUNS, strict=True)
    ]
    for step in range(1, STEPS + 1):
        for simulator, run in zip(simulators, runs, strict=True):
            simulator.AdvanceTo(step * STEP)
            run.look()
    for run, expected in zip(runs, alone, strict=True):
        np.testing.assert_array_equal(np.array(run.seen), expected)
    assert np.abs(alone[0][-1] - alone[1][-1]).max() > 0.01


def test_the_truth_is_read_back_from_the_context(station):
    contexts = [station.CreateDefaultContext() for _ in range(3)]
    for context, seed in zip(contexts, (None, 1, 2), strict=True):
        station.SetStart(context, seed)
    for context, seed in zip(
        [*contexts, contexts[1].Clone()], (station.scenario.seed, 1, 2, 1), strict=True
    ):
        expected = MakeTruth(station.obj, station.scenario.truth, seed)
        np.testing.assert_array_equal(station.GetTruth(context).mass, expected.mass)
        np.testing.assert_array_equal(station.GetTruth(context).friction, expected.friction)


def test_two_stations_stand_in_one_diagram(alone):
    builder = DiagramBuilder()
    stations = [
        builder.AddSystem(MakePushStation(make_scenario(), name=name)) for name in ("left", "right")
    ]
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    runs = [Run(station, root, *start) for station, start in zip(stations, RUNS, strict=True)]
    for step in range(1, STEPS + 1):
        simulator.AdvanceTo(step * STEP)
        for run in runs:
            run.look()
    for run, expected in zip(runs, alone, strict=True):
        np.testing.assert_array_equal(np.array(run.seen), expected)


def test_a_station_that_is_dropped_is_freed():
    others = [{"object": "pliers", "pose": [0.6, 0.25, 0.5]}]
    experiment = IdentifyTask(PushScenario(object="open_book", others=others))
    simulator, station = experiment.simulator, experiment.station
    station.SetStart(simulator.get_mutable_context())
    simulator.set_monitor(LimitMonitor(station))
    simulator.AdvanceTo(0.02)
    parts = [
        ref(part) for part in (experiment, simulator, station, station.plant, station.scene_graph)
    ]
    del experiment, simulator, station
    gc.collect()
    assert [part() for part in parts] == [None] * len(parts)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "weighs"),
    [*((name, False) for name in TASK_KINDS), ("pregrasp", True), ("slide", True)],
)
def test_a_task_that_is_dropped_is_freed(name, weighs):
    kind = TASK_KINDS[name]
    scenario = kind.make_scenario()
    scenario.unknown_inertia = weighs
    task = kind.make_task(resolve(scenario))
    parts = [
        ref(part)
        for part in (
            task,
            task.simulator,
            task.controller,
            task.station,
            task.station.plant,
            task.station.scene_graph,
        )
    ]
    del task
    gc.collect()
    assert [part() for part in parts] == [None] * len(parts)


@pytest.mark.slow
def test_a_station_leaves_little_memory_behind():
    if not Path("/proc/self/status").exists():
        pytest.skip("memory is read from /proc")
    done = subprocess.run(
        [sys.executable, "-c", BUILDS], capture_output=True, text=True, check=True
    )
    assert float(done.stdout) < GROWTH, done.stdout

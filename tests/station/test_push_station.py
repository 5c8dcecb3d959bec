import gc
from collections import Counter
from threading import Thread
from weakref import ref

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, System

from gridpush_drake.display.server import StartMeshcatServer
from gridpush_drake.errors import ScenarioError
from gridpush_drake.station.control.robot_control import ESTIMATE_OUTPUTS
from gridpush_drake.station.robot.arm_driver import DRIVER_OUTPUTS
from gridpush_drake.station.scene.contents import MakeTruth
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.limit_monitor import LimitMonitor
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.systems.base.messages import PushCommand
from tests.helpers.twin_bench import COARSE_HAMMER


def advance_until_idle(simulator, station, command, limit=15.0):
    context = simulator.get_mutable_context()
    station.GetInputPort("push_command").FixValue(context, command.to_vector())
    end = context.get_time() + limit
    while context.get_time() < end:
        simulator.AdvanceTo(context.get_time() + 0.1)
        status = station.GetOutputPort("executor.status").Eval(context)
        if status.ready and status.command_id == command.command_id:
            return status
    raise AssertionError(f"not done after {limit} s: {status}")


@pytest.fixture(scope="module")
def station():
    return MakePushStation(PushScenario(object=COARSE_HAMMER))


@pytest.fixture
def simulator(station):
    context = station.CreateDefaultContext()
    station.SetStart(context)
    station.GetInputPort("push_command").FixValue(context, PushCommand().to_vector())
    return Simulator(station, context)


def test_has_the_ports_it_names(station):
    outputs = {station.get_output_port(i).get_name() for i in range(station.num_output_ports())}
    assert {f"iiwa.{name}" for name in DRIVER_OUTPUTS} | {
        f"estimate.{name}" for name in ESTIMATE_OUTPUTS
    } <= outputs
    assert {
        "executor.status",
        "pusher.state",
        "object.pose",
        "object.pose_true",
        "contact_results",
    } <= outputs
    assert [station.get_input_port(i).get_name() for i in range(station.num_input_ports())] == [
        "push_command"
    ]


def test_a_push_moves_the_object_and_is_learned_from(station, simulator):
    context = simulator.get_mutable_context()
    monitor = LimitMonitor(station, period=0.005)
    simulator.set_monitor(monitor)
    simulator.Initialize()
    prior = station.GetOutputPort("estimate.mass").Eval(context).copy()
    np.testing.assert_allclose(prior, prior.mean())
    # across the hammer's handle, off its center
    status = advance_until_idle(
        simulator, station, PushCommand(1, 0.53, -0.04, np.pi / 2, 0.08, 0.05)
    )
    assert (status.executed, status.refused) == (1, 0)
    log = station.GetOutputPort("estimate.push_log").Eval(context)
    assert len(log) == 1
    (seen,) = log
    moved = np.linalg.norm(
        station.obj.cells_at(seen.final_pose) - station.obj.cells_at(seen.pose), axis=1
    )
    assert moved.mean() > 0.01
    true_pose = station.GetOutputPort("object.pose_true").Eval(context)
    assert np.linalg.norm(seen.final_pose[:2] - true_pose[:2]) < 5e-4
    assert np.ptp(station.GetOutputPort("estimate.mass").Eval(context)) > 0
    assert monitor.limit_report.ok, monitor.limit_report
    assert monitor.limit_report.tracking_error < 1e-3


def test_refuses_what_the_arm_cannot_reach(station, simulator):
    status = advance_until_idle(
        simulator, station, PushCommand(1, 0.95, 0.3, 0.0, 0.1, 0.03), limit=1.0
    )
    assert (status.executed, status.refused) == (0, 1)
    assert "reach" in status.reason
    assert "reach" in station.FindObstacle(PushCommand(1, 0.95, 0.3, 0.0, 0.1, 0.03))
    assert station.FindObstacle(PushCommand(1, 0.55, -0.1, np.pi / 2, 0.1, 0.03)) is None


def test_the_truth_goes_to_the_plant_alone(station):
    """Two truths: everything but the plant's own outputs is the same before the first push."""
    ports = [
        f"estimate.{name}"
        for name in ("mass", "friction", "mass_std", "contact_friction", "center_of_mass")
    ]
    seen = []
    for seed in (0, 1):
        context = station.CreateDefaultContext()
        station.SetStart(context, seed)
        body = station.object_in_plant.body
        inertia = body.CalcSpatialInertiaInBodyFrame(station.plant.GetMyContextFromRoot(context))
        truth = MakeTruth(station.obj, station.scenario.truth, seed)
        np.testing.assert_allclose(
            inertia.get_com()[:2], truth.center_of_mass(station.obj), atol=1e-12
        )
        seen.append([station.GetOutputPort(port).Eval(context).copy() for port in ports])
    for first, second in zip(*seen, strict=True):
        np.testing.assert_array_equal(first, second)
    station.SetStart(station.CreateDefaultContext(), 0)


def test_a_scenario_that_makes_no_sense_is_refused():
    scenario = PushScenario()
    scenario.object_pose = [3.0, 0.0, 0.0]
    with pytest.raises(ScenarioError, match="object_pose"):
        MakePushStation(scenario)


def count_drake_objects():
    """How many systems, builders and contexts of Drake there are, by their types' names.

    By types alone: isinstance also asks an object for its class, which a weak proxy refuses whose
    object is gone.
    """
    gc.collect()
    kinds = (System, DiagramBuilder, Context)
    return Counter(type(one).__name__ for one in gc.get_objects() if issubclass(type(one), kinds))


def test_stations_that_are_dropped_leave_nothing_of_drake():
    MakePushStation(PushScenario())  # what is made once, and kept
    before = count_drake_objects()
    for _ in range(2):
        station = MakePushStation(PushScenario())
        station.SetStart(station.CreateDefaultContext())
        del station
    assert count_drake_objects() - before == Counter()


def test_a_station_that_another_thread_collects_leaves_its_server_to_this_one():
    """Whoever holds only the station; Drake ends a process in which another thread destroys a server."""
    dropped = MakePushStation(PushScenario(), StartMeshcatServer(0))
    kept = ref(dropped)
    del dropped
    collector = Thread(target=gc.collect)
    collector.start()
    collector.join()
    assert kept() is None
    gc.collect()

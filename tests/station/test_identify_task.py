import gc
from pathlib import Path

import numpy as np
import pytest

from gridpush_drake.display.server import StartMeshcatServer
from gridpush_drake.dynamics.physics import QUASI_STATIC
from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.tasks.identify_task import IdentifyTask, PokeJudge
from gridpush_drake.station.tasks.task import TaskStatus, Waiting
from gridpush_drake.systems.base.messages import PushCommand, PushPhase, PushStatus


def make_scenario(count=1, test_count=0, **fields):
    scenario = PushScenario(**fields)
    scenario.pokes.count, scenario.pokes.test_count = count, test_count
    return scenario


@pytest.fixture(scope="module")
def short():
    """One push to learn from and one held out, by one Diagram, twice."""
    experiment = IdentifyTask(make_scenario(1, 1))
    told = []
    first = experiment.run(progress=lambda status, logged: told.append((status.phase, logged)))
    return first, experiment.run(), told


@pytest.mark.slow
def test_carries_out_its_pushes(short):
    record, _, told = short
    assert record.status == TaskStatus.FINISHED
    assert (len(record.training_log), len(record.held_out_log), len(record.estimates)) == (1, 1, 1)
    assert record.held_out_log[0].push.length == pytest.approx(0.1 + 0.008, abs=1e-3)
    assert record.limit_report.ok
    assert {PushPhase.PUSHING} < {phase for phase, _ in told}
    assert told[-1][1] == 2


@pytest.mark.slow
def test_a_second_run_of_the_same_diagram_is_the_same(short):
    first, second, _ = short
    for one, other in zip(first.log, second.log, strict=True):
        np.testing.assert_array_equal(one.push.xy, other.push.xy)
        np.testing.assert_array_equal(one.poses_observed, other.poses_observed)
    np.testing.assert_array_equal(first.estimates[-1].params.mass, second.estimates[-1].params.mass)


@pytest.mark.slow
def test_a_run_that_is_watched_takes_the_same_steps_as_one_that_is_not():
    contexts = []
    for meshcat in (None, StartMeshcatServer(0)):
        task = IdentifyTask(make_scenario(1), meshcat)
        task.begin(0)
        task.simulator.AdvanceTo(0.5)
        contexts.append(task.simulator.get_context())
    one, other = (context.get_continuous_state_vector().CopyToVector() for context in contexts)
    assert one.any(), "the filter of the arm's velocity has not begun to move"
    np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_the_log_says_the_same_offline(short, tmp_path):
    record, _, _ = short
    path = tmp_path / "pushes.csv"
    record.training_log.write_csv(path)
    read = PushLog.read_csv(path)
    assert not read.radius_given
    direct, offline = (
        identify(Model(record.obj), record.training_log),
        identify(Model(record.obj), read),
    )
    np.testing.assert_array_equal(direct.params.mass, offline.params.mass)
    np.testing.assert_array_equal(direct.params.mass, record.estimates[-1].params.mass)


@pytest.mark.slow
def test_ends_when_the_object_leaves_the_table():
    experiment = IdentifyTask(make_scenario(2, object="open_book", object_pose=[0.6, 0.0, 0.0]))
    station = experiment.station

    def disturb(status, logged):
        """Somebody throws it off the table during the second push."""
        if status.executed == 1 and status.phase == PushPhase.PUSHING:
            context = station.plant.GetMyMutableContextFromRoot(
                experiment.simulator.get_mutable_context()
            )
            station.plant.SetFloatingBaseBodyPoseInWorldFrame(
                context, station.object_in_plant.body, _beside_table()
            )

    record = experiment.run(progress=disturb)
    assert record.status == TaskStatus.OBJECT_LOST
    assert "left the table during push 2" in record.message
    assert len(record.estimates) == 1


def _beside_table():
    from pydrake.math import RigidTransform

    return RigidTransform([0.6, 1.5, -0.2])


@pytest.mark.slow
def test_an_arm_that_is_stuck_is_named():
    """Its joints are locked while it pushes; the executor goes on by the clock."""
    experiment = IdentifyTask(make_scenario(1, object="open_book"))
    station = experiment.station

    def jam(status, logged):
        if status.phase == PushPhase.PUSHING:
            plant = station.plant
            context = plant.GetMyMutableContextFromRoot(experiment.simulator.get_mutable_context())
            arm = plant.GetModelInstanceByName(station.robot.arm_model)
            plant.SetVelocities(context, arm, np.zeros(plant.num_velocities(arm)))
            for index in plant.GetJointIndices(arm):
                plant.get_joint(index).Lock(context)

    record = experiment.run(progress=jam)
    ((command, error),) = record.limit_report.strayed.items()
    assert command == 1 and error > 0.04
    assert record.message.endswith(f"{1e3 * error:.0f} mm in push 1: is the arm held or stuck?")


@pytest.mark.slow
def test_an_object_out_of_the_fingers_workspace_is_an_error():
    scenario = make_scenario()
    scenario.workspace.x, scenario.workspace.y = [0.585, 0.615], [-0.015, 0.015]
    with pytest.raises(StationError, match="workspace"):
        IdentifyTask(scenario).run()


def test_an_unknown_object_suggests_the_nearest():
    with pytest.raises(ScenarioError, match="claw_hammer"):
        IdentifyTask(make_scenario(object="claw_hamer"))


def test_gives_up_after_many_refusals():
    watch, waiting = PokeJudge(5), Waiting(0.0, 0.1)
    assert watch.judge(PushStatus(), waiting) == ("", "")
    status, message = watch.judge(
        PushStatus(command_id=20, refused=20, reason="the arm sulks"), waiting
    )
    assert status == TaskStatus.STUCK
    assert "the arm sulks" in message


@pytest.mark.slow
def test_commands_are_numbered_anew_in_each_run(short):
    assert PushCommand().command_id == 0
    first, second, _ = short
    assert (
        [seen.name for seen in first.log]
        == [seen.name for seen in second.log]
        == ["push_1", "push_2"]
    )


def _read_memory():
    """Resident, MB."""
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("memory is read from /proc")
    return (
        int(
            next(
                line for line in status.read_text().splitlines() if line.startswith("VmRSS")
            ).split()[1]
        )
        / 1024
    )


@pytest.mark.slow
def test_runs_of_one_diagram_leak_no_memory():
    """At most 50 MB in 50 demos of 8 pushes, seen on 8 pushes after the first 4."""
    scenario = make_scenario(4, object="open_book")
    scenario.pokes.speed = 0.1
    experiment = IdentifyTask(scenario)
    used = []
    for seed in range(3):
        assert len(experiment.run(seed).log) == 4
        gc.collect()
        used.append(_read_memory())
    assert used[-1] - used[0] < 50 / 400 * 8, used


@pytest.mark.slow
def test_learns_a_hammer():
    record = IdentifyTask(make_scenario(8, 6, seed=1)).run()
    obj = record.obj
    assert record.status == TaskStatus.FINISHED
    assert record.limit_report.ok, record.limit_report
    assert record.limit_report.tracking_error < 1e-3
    before, after = (
        calc_mean_cell_error(Model(obj, params, QUASI_STATIC), record.held_out_log)
        for params in (CellParameters.uniform(obj), record.estimates[-1].params)
    )
    assert after < before / 3
    assert after < 5e-3
    gap = record.estimates[-1].params.center_of_mass(obj) - record.truth.center_of_mass(obj)
    assert np.linalg.norm(gap) < 8e-3


@pytest.mark.slow
def test_does_not_end_before_the_last_push_is_learned_from():
    scenario = PushScenario(object="open_book", base="planar", object_pose=[0.55, 0.0, 0.0])
    scenario.pokes.count, scenario.pokes.test_count, scenario.pokes.speed = 1, 0, 0.08
    scenario.simulation.answer_delay = 2.0  # the finger has long gone up by then
    record = IdentifyTask(scenario).run()
    assert record.status == TaskStatus.FINISHED
    assert [found.push_names for found in record.estimates] == [
        tuple(seen.name for seen in record.log)
    ]

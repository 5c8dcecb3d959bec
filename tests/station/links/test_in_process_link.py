"""The whole loop of control and twin over an in-process link, whose records are also lost, late and spoiled."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable

from gridpush_drake.station.hardware import HardwareLink, MakeHardwareStation
from gridpush_drake.station.links import InProcessLink, TipLoad, Unusable
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.tasks.identify_task import IdentifyTask
from gridpush_drake.station.tasks.task import TaskStatus
from gridpush_drake.systems.robot_records import ArmCommand, ArmStatus, PoseObservation
from tests.helpers.link_bench import LinkBench
from tests.helpers.twin_bench import COARSE_BOOK

NEAR = 1e-3
"""rad, of a joint that is where it is held."""

NOT_NEWER = "ArmStatus was not newer than the one before"
NOT_FINITE = "ArmStatus: velocity is not finite"

MOVING = 0.8
"""s, of the twin's time: the arm is on its way then."""


def make_scenario():
    scenario = PushScenario(object=COARSE_BOOK, object_pose=[0.55, 0.0, 0.0], base="planar")
    scenario.pokes.count, scenario.pokes.test_count, scenario.pokes.speed = 1, 0, 0.06
    scenario.simulation.answer_delay = None
    return scenario


@pytest.fixture(scope="module")
def resolved():
    return resolve(make_scenario())


@pytest.fixture
def bench(resolved):
    return LinkBench(resolved, IdentifyTask)


@pytest.mark.slow
def test_a_task_is_done_over_a_link_of_ones_own(bench):
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.FINISHED, record.message
    assert len(record.log) == 1
    assert bench.link.report.left_out == {}
    assert bench.twin_link.left_out == {}


class Trouble:
    """Spoils the arm's statuses from a moment of the twin's time on, and keeps the ones before for later use."""

    def __init__(self, fault):
        self.fault, self.before, self.count = fault, None, 0

    def __call__(self, time, message):
        if not isinstance(message, ArmStatus):
            return [message]
        before, self.before = self.before, message
        if time < MOVING or before is None:
            return [message]
        self.count += 1
        return self.fault(self, before, message)


def reorder(trouble, before, message):
    """Every tenth comes once more, after the one that followed it."""
    return [message, before] if trouble.count % 10 == 0 else [message]


def spoil_some(trouble, before, message):
    """Every tenth is not finite."""
    bad = replace(message, velocity=np.full(7, np.nan))
    return [bad] if trouble.count % 10 == 0 else [message]


def lack_some(trouble, before, message):
    """Every tenth has a velocity too few, or is none at all."""
    if trouble.count % 10:
        return [message]
    return [replace(message, velocity=message.velocity[:-1]), Unusable("the cable was loose")]


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        pytest.param(reorder, NOT_NEWER, marks=pytest.mark.slow),
        pytest.param(spoil_some, NOT_FINITE, marks=pytest.mark.slow),
        pytest.param(lack_some, "the cable was loose", marks=pytest.mark.slow),
    ],
)
def test_records_that_will_not_do_are_counted_and_change_nothing(bench, fault, why):
    bench.links[0].spoil = Trouble(fault)
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.FINISHED, record.message
    assert bench.link.report.left_out[why] > 10
    if fault is lack_some:
        few = "ArmStatus: velocity is of another number of joints; expected 7"
        assert bench.link.report.left_out[few] > 10


def freeze(trouble, before, message):
    trouble.frozen = getattr(trouble, "frozen", message)
    return [replace(trouble.frozen, time=message.time)]


def lose(trouble, before, message):
    return []


def poison(trouble, before, message):
    return [replace(message, position=np.full(7, np.inf))]


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        pytest.param(freeze, "no joint's measured position has changed", marks=pytest.mark.slow),
        pytest.param(lose, "no status", marks=pytest.mark.slow),
        (poison, "messages were left out: ArmStatus: position is not finite"),
    ],
)
def test_a_robot_that_is_not_heard_of_any_more_is_stopped(bench, fault, says):
    bench.links[0].spoil = Trouble(fault)
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.STOPPED
    assert says in record.message
    for _ in range(100):
        bench.move()
    held = bench.rows[-1][1]
    away = [time for time, q in bench.rows if np.abs(q - held).max() > NEAR]
    assert max(away) - MOVING < 0.3
    # the arm was on its way
    begun = next(q for time, q in bench.rows if time >= MOVING - 0.1)
    assert np.abs(begun - held).max() > 5 * NEAR


@pytest.mark.slow
def test_the_twin_leaves_out_commands_that_are_none(bench):
    count = [0]

    def spoil(time, message):
        count[0] += 1
        if isinstance(message, ArmCommand) and count[0] % 10 == 3:
            return [replace(message, position=np.full(7, np.nan)), message]
        return [message]

    bench.links[1].spoil = spoil
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.FINISHED, record.message
    assert bench.twin_link.left_out["ArmCommand: position is not finite"] > 10


def test_what_comes_over_a_link_is_what_the_station_reads_without_a_message_in_between(resolved):
    """The very records: nothing is encoded or decoded but by a link over a network, at its edge."""
    here, world = InProcessLink.make_pair()
    link = HardwareLink(here, resolved.robot)
    status = ArmStatus(1.0, resolved.q_start, np.zeros(7), np.zeros(7))
    seen = PoseObservation(1.0, (0.55, 0.0, 0.0))
    world.send(status)
    world.send(seen)
    station = MakeHardwareStation(resolved)
    context = station.CreateDefaultContext()
    link.begin(station, station, context)
    assert station.GetInputPort("arm_status").Eval(context) is status
    assert station.GetInputPort("object.observation").Eval(context) is seen
    measured = station.GetOutputPort(f"{resolved.robot.arm_model}.position_measured")
    np.testing.assert_array_equal(measured.Eval(context), resolved.q_start)


@pytest.mark.parametrize("robot", ["iiwa14", "ur5e"])
def test_a_force_on_the_tip_is_found_again_from_the_wrench_on_the_flange(robot):
    scenario = PushScenario(directives=make_robot_directives(robot, grasping=False))
    found = resolve(scenario)
    load = TipLoad(found.control_plant, found.robot)
    plant = found.control_plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, found.q_start)
    tip = plant.GetFrameByName(found.robot.finger.tip_frame)
    world = plant.world_frame()
    J = plant.CalcJacobianTranslationalVelocity(
        context, JacobianWrtVariable.kV, tip, np.zeros(3), world, world
    )
    torque = J.T @ [3.0, -4.0, 12.0]
    force, moment = load.calc_wrench(found.q_start, torque)
    assert np.linalg.norm(force) == pytest.approx(13.0)
    np.testing.assert_allclose(load.calc_torque(found.q_start, force, moment), torque, atol=1e-9)

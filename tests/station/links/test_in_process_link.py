"""The whole loop of control and twin over an in-process link, whose records are also lost, late and spoiled."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from drake import lcmt_image_array, lcmt_planar_manipuland_status
from pydrake.multibody.tree import JacobianWrtVariable

from gridpush_drake.station.camera import make_camera
from gridpush_drake.station.identify_task import IdentifyTask
from gridpush_drake.station.links import (
    ArmCommand,
    ArmStatus,
    GripperStatus,
    InProcessLink,
    LinkBus,
    ObjectSight,
    Picture,
    TipLoad,
    Unusable,
)
from gridpush_drake.station.links.lcm.picture_messages import decode_frame
from gridpush_drake.station.links.lcm.robot_messages import name_object_channel
from gridpush_drake.station.resolve import resolve
from gridpush_drake.station.robot import make_robot_directives
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.task import TaskStatus
from tests.helpers.link_bench import LinkBench

NEAR = 1e-3
"""rad, of a joint that is where it is held."""

NOT_NEWER = "IIWA_STATUS was not newer than the one before"
NOT_FINITE = "IIWA_STATUS: joint_velocity_estimated is not finite"

MOVING = 0.8
"""s, of the twin's time: the arm is on its way then."""


def make_scenario():
    scenario = PushScenario(object="open_book", object_pose=[0.55, 0.0, 0.0], base="planar")
    scenario.pokes.count, scenario.pokes.test_count, scenario.pokes.speed = 1, 0, 0.06
    scenario.simulation.answer_delay = None
    return scenario


@pytest.fixture(scope="module")
def resolved():
    return resolve(make_scenario())


@pytest.fixture
def bench(resolved):
    return LinkBench(resolved, IdentifyTask)


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


def double(trouble, before, message):
    return [message, message]


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
        pytest.param(double, NOT_NEWER, marks=pytest.mark.slow),
        (reorder, NOT_NEWER),
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
        assert any("6 numbers; expected 7" in each for each in bench.link.report.left_out)


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
        (poison, "messages were left out: IIWA_STATUS: joint_position_measured is not finite"),
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
    assert bench.twin_link.left_out["IIWA_COMMAND: joint_position is not finite"] > 10


class Reading:
    """A bus that is read at one end of a link, and what it leaves out.

    Attributes:
        world: the other end of the link.
        bus: what is read.
        left_out: why, for each record that no message can be made of.
    """

    def __init__(self, robot):
        self.world, link = InProcessLink.make_pair()
        self.left_out = []
        self.bus = LinkBus(link, robot, leave_out=self.left_out.append)


@pytest.fixture
def reading(resolved):
    return Reading(resolved.robot)


def test_records_keep_all_they_say_on_their_way_through_messages(reading, resolved):
    """From a link to messages, and from these to another link."""
    link, end = InProcessLink.make_pair()
    out = LinkBus(link, resolved.robot, others=2)
    second = name_object_channel(2)
    for channel in ("IIWA_STATUS", "SCHUNK_WSG_STATUS", "PLANAR_MANIPULAND_STATUS", second):
        reading.bus.Subscribe(channel, partial(out.Publish, channel))
    position = np.linspace(-1.0, 1.0, 7)
    reading.world.send(ArmStatus(1.25, position, 2 * position, 3 * position, 4 * position))
    reading.world.send(GripperStatus(1.5, 0.03, -0.01, 12.0))
    reading.world.send(ObjectSight(1.75, [0.5, -0.25, 3.0]))
    reading.world.send(ObjectSight(1.8, [0.6, 0.25, -1.0], number=2))
    assert reading.bus.HandleSubscriptions(0) == 4
    assert reading.left_out == []
    status, gripper, sight, other = end.receive(0.0)
    assert status.time == 1.25
    np.testing.assert_array_equal(status.position, position)
    np.testing.assert_array_equal(status.velocity, 2 * position)
    np.testing.assert_array_equal(status.torque_external, 3 * position)
    np.testing.assert_array_equal(status.position_commanded, 4 * position)
    assert (gripper.time, gripper.force) == (1.5, 12.0)
    assert (gripper.opening, gripper.speed) == pytest.approx((0.03, -0.01))
    assert (sight.time, *sight.pose, sight.number) == (1.75, 0.5, -0.25, 3.0, 0)
    assert (other.time, *other.pose, other.number) == (1.8, 0.6, 0.25, -1.0, 2)


@pytest.mark.parametrize("time", [np.nan, -1.0, np.inf, 1e15])
def test_a_time_that_is_none_is_left_to_the_readers_checks(reading, time):
    taken = []
    reading.bus.Subscribe("PLANAR_MANIPULAND_STATUS", taken.append)
    reading.world.send(ObjectSight(time, [0.0, 0.0, 0.0]))
    assert reading.bus.HandleSubscriptions(0) == 1
    assert lcmt_planar_manipuland_status.decode(taken[0]).utime == -1
    assert reading.left_out == []


def test_what_is_no_record_of_numbers_is_left_out(reading):
    taken = []
    for channel in ("DRAKE_RGBD_CAMERA_IMAGES", "SCHUNK_WSG_STATUS"):
        reading.bus.Subscribe(channel, taken.append)
    reading.world.send(GripperStatus(0.0, "wide"))
    reading.world.send(Picture(0.0, None))
    reading.bus.HandleSubscriptions(0)
    assert taken == []
    assert len(reading.left_out) == 2
    assert all("no message can be made of" in why for why in reading.left_out)


def test_a_picture_is_the_same_after_its_way_through_a_message(reading, tmp_path):
    camera = make_camera(PushScenario().camera)
    rng = np.random.default_rng(1)
    color = rng.integers(0, 256, (camera.height, camera.width, 3), dtype=np.uint8)
    depth = rng.uniform(0.2, 2.0, (camera.height, camera.width)).astype(np.float32)
    taken = []
    reading.bus.Subscribe("DRAKE_RGBD_CAMERA_IMAGES", taken.append)
    reading.world.send(Picture(2.5, color, depth))
    reading.bus.HandleSubscriptions(0)
    frame = decode_frame(lcmt_image_array.decode(taken[0]), camera)
    assert frame.t == 2.5
    np.testing.assert_array_equal(frame.color, color)
    np.testing.assert_array_equal(frame.depth, depth)


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

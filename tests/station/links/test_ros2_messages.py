"""Messages of ROS 2 are read as they are written; neither needs ROS, but only its types' fields."""

import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.station.links.link import Unusable
from gridpush_drake.station.links.ros2.ros2_reader import MAX_WRENCH_AGE, Ros2Reader
from gridpush_drake.station.links.ros2.ros2_robot import MakeRosRobot
from gridpush_drake.station.links.ros2.ros2_topics import (
    ARM_POSITIONS,
    ARM_TRAJECTORY,
    GRIPPER_POSITIONS,
    GRIPPER_TRAJECTORY,
    JOINT_STATES,
    WRENCH,
)
from gridpush_drake.station.links.ros2.ros2_writer import Ros2Writer
from gridpush_drake.station.scene.camera import make_camera
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    PoseObservation,
)

NOW = 12.5
"""The reader's clock, s."""


def make_stamp():
    return SimpleNamespace(sec=0, nanosec=0)


def make_header():
    return SimpleNamespace(stamp=make_stamp(), frame_id="")


def make_vector():
    return SimpleNamespace(x=0.0, y=0.0, z=0.0)


def make_pose():
    return SimpleNamespace(
        position=make_vector(), orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    )


def make_types():
    """The types of messages, with the fields that ROS gives to a new message of each."""
    fields = {
        "Clock": lambda: {"clock": make_stamp()},
        "CameraInfo": lambda: {"header": make_header()},
        "Float64MultiArray": lambda: {"data": []},
        "Image": lambda: {"header": make_header(), "is_bigendian": 0},
        "JointState": lambda: {
            "header": make_header(),
            "name": [],
            "position": [],
            "velocity": [],
            "effort": [],
        },
        "JointTrajectory": lambda: {"header": make_header(), "joint_names": [], "points": []},
        "JointTrajectoryPoint": lambda: {
            "positions": [],
            "effort": [],
            "time_from_start": make_stamp(),
        },
        "PoseStamped": lambda: {"header": make_header(), "pose": make_pose()},
        "WrenchStamped": lambda: {
            "header": make_header(),
            "wrench": SimpleNamespace(force=make_vector(), torque=make_vector()),
        },
    }

    def make_type(new):
        return lambda **given: SimpleNamespace(**{**new(), **given})

    return SimpleNamespace(**{name: make_type(new) for name, new in fields.items()})


@pytest.fixture(scope="module")
def robot():
    """The names of the iiwa with its gripper, and a camera."""
    scenario = read_scenario("grasp")
    return MakeRosRobot(resolve(scenario), make_camera(scenario.camera))


def write(robot, send, record):
    """The messages, by their topics, that a method of the writer publishes for a record."""
    published = {}
    writer = Ros2Writer(make_types(), robot, published.__setitem__)
    getattr(writer, send)(record)
    return published


def make_reader(robot, load_known=True):
    return Ros2Reader(robot, load_known, lambda: NOW)


def make_status(robot):
    rng = np.random.default_rng(0)
    q, v, torque = rng.normal(size=(3, len(robot.joints)))
    return ArmStatus(time=3.25, position=q, velocity=v, torque_external=torque)


def test_an_arms_status_with_the_torques_of_its_joints(robot):
    status = make_status(robot)
    reader = make_reader(robot)
    reader.take_joints(write(robot, "send_arm_status", status)[JOINT_STATES])
    (read,) = reader.take_all()
    assert read.time == pytest.approx(status.time)
    np.testing.assert_allclose(read.position, status.position)
    np.testing.assert_allclose(read.velocity, status.velocity)
    np.testing.assert_allclose(read.torque_external, status.torque_external)
    assert reader.take_all() == []


def test_an_arms_load_comes_as_a_wrench_where_its_joints_have_none(robot):
    robot = replace(robot, load="wrench")
    status = make_status(robot)
    # of any torques, the part that a force on the tip explains: a wrench can tell no more
    wrench = robot.tip_load.calc_wrench(status.position, status.torque_external)
    torque = robot.tip_load.calc_torque(status.position, *wrench)
    status = replace(status, torque_external=torque)
    published = write(robot, "send_arm_status", status)
    assert published[JOINT_STATES].effort == []

    reader = make_reader(robot, load_known=False)
    reader.take_joints(published[JOINT_STATES])
    (before,) = reader.take_all()
    assert not reader.load_known
    np.testing.assert_array_equal(before.torque_external, 0.0)

    reader.take_wrench(published[WRENCH])
    reader.take_joints(published[JOINT_STATES])
    (read,) = reader.take_all()
    assert reader.load_known
    assert np.abs(torque).max() > 0.1
    np.testing.assert_allclose(read.torque_external, torque, atol=1e-9)

    # a wrench that is old says nothing of the load any more
    late = replace(status, time=status.time + 2 * MAX_WRENCH_AGE)
    reader.take_joints(write(robot, "send_arm_status", late)[JOINT_STATES])
    (refused,) = reader.take_all()
    assert isinstance(refused, Unusable)
    assert "s older than joint_states" in refused.why

    # nor does one that is stamped ahead, whose sensor may have died since
    ahead = replace(status, time=status.time + 3600.0)
    reader.take_wrench(write(robot, "send_arm_status", ahead)[WRENCH])
    reader.take_joints(published[JOINT_STATES])
    (refused,) = reader.take_all()
    assert isinstance(refused, Unusable)
    assert "s newer than joint_states" in refused.why


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda m: m.name.append(m.name[0]), "joint_states names a joint twice"),
        (lambda m: m.name.append("another"), "joint_states: position has not one number"),
        (lambda m: m.position.append(0.0), "joint_states: position has not one number"),
        (lambda m: m.velocity.pop(), "joint_states: velocity has not one number for each name"),
        (lambda m: m.effort.append(0.0), "joint_states: effort has not one number for each name"),
    ],
)
def test_joints_whose_numbers_are_not_clear_are_left_out(robot, spoil, why):
    reader = make_reader(robot)
    message = write(robot, "send_arm_status", make_status(robot))[JOINT_STATES]
    for field in ("name", "position", "velocity", "effort"):
        setattr(message, field, list(getattr(message, field)))
    if why.endswith("twice"):
        for field in ("position", "velocity", "effort"):
            setattr(message, field, [*getattr(message, field), 0.0])
    spoil(message)
    reader.take_joints(message)
    (refused,) = reader.take_all()
    assert isinstance(refused, Unusable)
    assert refused.why.startswith(why)


def test_names_in_ever_new_orders_take_no_memory(robot):
    reader = make_reader(robot)
    message = write(robot, "send_arm_status", make_status(robot))[JOINT_STATES]
    tracemalloc.start()
    for number in range(500):
        message.name = [*robot.joints, f"{number:0>2000}"]
        message.position = np.zeros(len(message.name))
        message.velocity = message.effort = np.zeros(len(message.name))
        reader.take_joints(message)
        assert isinstance(reader.take_all()[0], ArmStatus)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 200_000  # the names alone are 1 MB


def test_a_driver_without_velocities_is_read_by_differences(robot):
    first = make_status(robot)
    second = replace(first, time=first.time + 0.1, position=np.asarray(first.position) + 0.02)
    reader = make_reader(robot)
    for status in (first, second):
        message = write(robot, "send_arm_status", status)[JOINT_STATES]
        message.velocity = []
        reader.take_joints(message)
    before, after = reader.take_all()
    np.testing.assert_array_equal(before.velocity, 0.0)
    np.testing.assert_allclose(after.velocity, 0.2)


@pytest.mark.parametrize(
    ("send", "topic", "take"),
    [
        ("send_arm_trajectory", ARM_TRAJECTORY, "take_arm_trajectory"),
        ("send_arm_positions", ARM_POSITIONS, "take_arm_positions"),
    ],
)
def test_an_arms_command_in_both_forms(robot, send, topic, take):
    command = ArmCommand(time=1.0, position=np.linspace(-1, 1, len(robot.joints)))
    reader = make_reader(robot)
    getattr(reader, take)(write(robot, send, command)[topic])
    (read,) = reader.take_all()
    assert read.time == NOW
    np.testing.assert_allclose(read.position, command.position)


@pytest.mark.parametrize(
    ("send", "topic", "take", "force"),
    [
        ("send_gripper_trajectory", GRIPPER_TRAJECTORY, "take_gripper_trajectory", 30.0),
        ("send_gripper_positions", GRIPPER_POSITIONS, "take_gripper_positions", None),
    ],
)
def test_a_grippers_command_in_both_forms(robot, send, topic, take, force):
    command = GripperCommand(time=1.0, opening=0.04, force=30.0)
    reader = make_reader(robot)
    getattr(reader, take)(write(robot, send, command)[topic])
    (read,) = reader.take_all()
    assert read.opening == pytest.approx(0.04)
    # numbers without a force stand for the gripper's greatest one
    assert read.force == pytest.approx(robot.max_force if force is None else force)


def test_a_grippers_status_and_where_an_object_is(robot):
    reader = make_reader(robot)
    status = GripperStatus(time=2.0, opening=0.05, speed=-0.02, force=8.0)
    reader.take_joints(write(robot, "send_gripper_status", status)[JOINT_STATES])
    sight = PoseObservation(time=2.5, pose=np.array([0.4, -0.1, 2.0]), number=1)
    (message,) = write(robot, "send_pose", sight).values()
    reader.take_pose(message, number=1)
    read, seen = reader.take_all()
    assert (read.time, read.opening) == pytest.approx((2.0, 0.05))
    assert (read.speed, read.force) == pytest.approx((-0.02, 8.0))
    assert (seen.time, seen.number) == (2.5, 1)
    np.testing.assert_allclose(seen.pose, sight.pose)
    # an object that is not seen is not spoken of
    assert not write(robot, "send_pose", replace(sight, pose=np.full(3, np.nan)))


def test_a_picture_is_read_when_both_of_its_images_are_there(robot):
    camera = robot.camera
    rng = np.random.default_rng(1)
    color = rng.integers(0, 256, (camera.height, camera.width, 3), dtype=np.uint8)
    depth = rng.uniform(0.5, 1.0, color.shape[:2]).astype(np.float32)
    published = write(robot, "send_picture", Frame(color, depth, 4.0))
    info, color_image, depth_image = published.values()
    reader = make_reader(robot)
    reader.take_camera_info(info)
    reader.take_depth(depth_image)
    assert reader.take_all() == []
    reader.take_color(color_image)
    (read,) = reader.take_all()
    assert read.t == pytest.approx(4.0)
    np.testing.assert_array_equal(read.color, color)
    np.testing.assert_array_equal(read.depth, depth)

    # another camera than the scenario's is refused, once it says so
    info.k = 1.1 * np.asarray(info.k)
    reader.take_camera_info(info)
    reader.take_color(color_image)
    (refused,) = reader.take_all()
    assert isinstance(refused, Unusable)
    assert "fx" in refused.why


def test_joints_that_are_missing_are_told(robot):
    reader = make_reader(robot)
    command = ArmCommand(time=1.0, position=np.zeros(len(robot.joints)))
    message = write(robot, "send_arm_trajectory", command)[ARM_TRAJECTORY]
    message.joint_names = message.joint_names[:-1]
    reader.take_arm_trajectory(message)
    (refused,) = reader.take_all()
    assert refused.why.startswith(f"{ARM_TRAJECTORY} names not all joints; expected iiwa_joint_1")

"""ROS 2: what can be tested without it, and twin, controller and strangers over DDS where it is there."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gridpush_drake.errors import ImageError, StationError
from gridpush_drake.geometry.se2 import calc_yaw
from gridpush_drake.station.links.link import LinkRole
from gridpush_drake.station.links.ros2.ros2_link import Ros2Link
from gridpush_drake.station.links.ros2.ros2_pictures import (
    find_camera_fault,
    read_color,
    read_depth,
)
from gridpush_drake.station.links.ros2.ros2_reader import find_orientation_fault
from gridpush_drake.station.links.ros2.ros2_robot import GripperJoints, MakeRosRobot
from gridpush_drake.station.links.ros2.ros2_topics import import_ros, name_object_topic
from gridpush_drake.station.scene.camera import make_camera
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario
from tests.helpers import ros2_processes

OBSTACLE = ros2_processes.find_obstacle()

over_dds = pytest.mark.skipif(OBSTACLE is not None, reason=str(OBSTACLE))

STOPS_WITHIN = 0.25
"""s, by the twin's clock, from a fault to rest."""

SILENCE = 1.0
"""s, after which a robot that is not heard of is given up."""


def test_without_ros_it_is_said_what_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(StationError, match=r"--ros2: rclpy .*source /opt/ros/DISTRO/setup\.bash"):
        import_ros()


def test_names_are_the_models_and_the_gripper_opens_as_its_joints_do():
    resolved = resolve(read_scenario("grasp"))
    robot = MakeRosRobot(resolved)
    assert robot.joints == tuple(f"iiwa_joint_{k}" for k in range(1, 8))
    assert (robot.command, robot.load) == ("trajectory", "effort")
    assert robot.gripper.names == ("left_finger_sliding_joint", "right_finger_sliding_joint")
    assert robot.gripper.calc_position(0.06) == pytest.approx([-0.03, 0.03])
    assert robot.gripper.calc_fraction(np.array([-0.03, 0.03])) == pytest.approx(0.6)


def test_each_object_has_topics_of_its_own():
    assert MakeRosRobot(resolve(read_scenario("fetch"))).others == 1
    assert name_object_topic("object_pose", 0) == "object_pose"
    assert name_object_topic("object_pose", 2) == "other_1/object_pose"


def test_a_gripper_of_one_turning_joint_is_wide_open_at_another_end():
    robotiq = GripperJoints(("finger_joint",), np.array([0.8]), np.array([0.0]), 0.085)
    assert robotiq.calc_position(0.085) == pytest.approx([0.0])
    assert robotiq.calc_position(0.0) == pytest.approx([0.8])
    assert 0.085 * robotiq.calc_fraction(np.array([0.4])) == pytest.approx(0.0425)


def make_quaternion(roll, yaw):
    x, y, z, w = Rotation.from_euler("xz", [roll, yaw]).as_quat()
    return SimpleNamespace(x=x, y=y, z=z, w=w)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -3.0])
def test_an_object_that_lies_flat_has_a_turn(yaw):
    q = make_quaternion(0.0, yaw)
    assert find_orientation_fault(q) == ""
    assert calc_yaw(q.w, q.x, q.y, q.z) == pytest.approx(yaw)


def test_an_orientation_that_nobody_filled_is_not_taken_for_one():
    empty = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
    assert find_orientation_fault(empty) == "the orientation's quaternion has length 0; expected 1"
    unknown = SimpleNamespace(x=0.0, y=0.0, z=float("nan"), w=1.0)
    assert "has length nan" in find_orientation_fault(unknown)


def test_a_tilted_object_is_not_one_that_lies_on_the_table():
    assert find_orientation_fault(make_quaternion(np.radians(8), 0.4)) == ""
    assert "12 degrees from upright" in find_orientation_fault(make_quaternion(np.radians(12), 0.4))
    assert "180 degrees from upright" in find_orientation_fault(make_quaternion(np.pi, 0.4))


def make_image(pixels, encoding, pad=0, big=False):
    """A `sensor_msgs/Image` by its fields, each row with some bytes more than it needs."""
    height, width = pixels.shape[:2]
    kind = pixels.dtype.newbyteorder(">" if big else "<")
    rows = pixels.astype(kind).reshape(height, -1).view(np.uint8).reshape(height, -1)
    rows = np.hstack([rows, np.zeros((height, pad), np.uint8)])
    return SimpleNamespace(
        height=height,
        width=width,
        encoding=encoding,
        step=rows.shape[1],
        is_bigendian=int(big),
        data=rows.tobytes(),
    )


@pytest.mark.parametrize("pad", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "order"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 0])],
)
def test_colors_are_read_in_every_encoding(encoding, order, pad):
    color = np.random.default_rng(0).integers(0, 256, (4, 6, 3), dtype=np.uint8)
    np.testing.assert_array_equal(read_color(make_image(color[..., order], encoding, pad)), color)


@pytest.mark.parametrize("big", [False, True])
def test_depth_is_read_in_meters_and_what_is_none_is_0(big):
    meters = np.array([[0.5, 1.25], [np.nan, -1.0], [np.inf, 5e3]], np.float32)
    known = np.array([[0.5, 1.25], [0, 0], [0, 0]], np.float32)
    np.testing.assert_array_equal(read_depth(make_image(meters, "32FC1", 8, big)), known)
    millimeters = np.array([[500, 1250], [0, 65535]], np.uint16)
    read = read_depth(make_image(millimeters, "16UC1", 4, big))
    np.testing.assert_allclose(read, [[0.5, 1.25], [0.0, 65.535]], rtol=1e-6)


def test_images_that_will_not_do_are_refused():
    image = make_image(np.zeros((4, 6, 3), np.uint8), "rgb8")
    image.data = image.data[:-1]
    with pytest.raises(ImageError, match="71 bytes in rows of 18; expected 4 rows"):
        read_color(image)
    with pytest.raises(ImageError, match="encoding is yuv422; expected one of rgb8"):
        read_color(make_image(np.zeros((4, 6, 2), np.uint8), "yuv422"))
    with pytest.raises(ImageError, match="encoding is rgb8; expected one of 16UC1"):
        read_depth(make_image(np.zeros((4, 6, 3), np.uint8), "rgb8"))


def test_a_camera_that_is_another_than_the_scenarios_is_told():
    camera = make_camera(PushScenario().camera)

    def make_info(K=camera.K, d=(0.0,) * 5, width=camera.width):
        return SimpleNamespace(width=width, height=camera.height, k=K.ravel(), d=d)

    assert find_camera_fault(make_info(), camera) == ""
    assert find_camera_fault(make_info(1.005 * camera.K), None) == ""
    assert "pixels; expected" in find_camera_fault(make_info(width=10), camera)
    assert "image_rect" in find_camera_fault(make_info(d=(0.1, 0, 0, 0, 0)), camera)
    assert "fx is" in find_camera_fault(make_info(1.1 * camera.K), camera)


@over_dds
@pytest.mark.filterwarnings("ignore:module 'sre_\\w+' is deprecated")
def test_arguments_that_ros_does_not_understand_are_refused():
    robot = MakeRosRobot(resolve(PushScenario()))
    with pytest.raises(StationError, match="--ros-args -r nonsense"):
        Ros2Link(LinkRole.CONTROL, robot, ["-r", "nonsense"])
    with pytest.raises(StationError, match="command is 'torque'; expected trajectory"):
        Ros2Link(LinkRole.CONTROL, robot, ["-p", "command:=torque"])


def check_done(told):
    robot = told["robot"]
    assert robot["code"] == 0, robot["err"]
    assert robot["summary"]["status"] == "finished"
    assert robot["summary"]["pushes"] == 1
    assert told["twin_code"] == 0, told["twin_err"]


@over_dds
@pytest.mark.parametrize(
    ("robot", "command"),
    [
        ("ur5e", "trajectory"),
        pytest.param("ur5e", "position", marks=pytest.mark.slow),
        pytest.param("iiwa14", "trajectory", marks=pytest.mark.slow),
        pytest.param("iiwa14", "position", marks=pytest.mark.slow),
    ],
)
def test_a_task_is_done_over_dds_and_shown_to_who_looks_on(tmp_path, robot, command):
    told = ros2_processes.run_in_namespace("do_task", tmp_path, robot, command)
    check_done(told)
    assert (told["trajectories"] > 100) == (command == "trajectory")
    assert min(told["shown"].values()) >= 1
    assert told["levels"][0] == 0
    # the center lies in the book, and it is known how well
    assert np.linalg.norm(np.subtract(told["center"], told["last_pose"])) < 0.1
    assert all(1e-7 < variance < 0.01 for variance in told["variance"])
    # the wrench of a UR, or the torques of an iiwa, say how the object presses
    assert 1.0 < told["robot"]["summary"]["loop"]["force"] < 20.0


@over_dds
@pytest.mark.slow
def test_a_controller_that_dies_leaves_the_arm_at_rest_and_another_goes_on(tmp_path):
    told = ros2_processes.run_in_namespace("lose_controller", tmp_path)
    for fault in ("killed", "interrupted"):
        assert told[fault]["speed_before"] > 0.01
        assert told[fault]["stopped_within"] < STOPS_WITHIN
        assert told[fault]["held_for"] > 0.5
    assert told["interrupted"]["code"] == 130
    assert "asked to stop by SIGINT" in told["interrupted"]["log"]
    assert told["finished"]["code"] == 0, told["finished"]["err"]


@over_dds
@pytest.mark.slow
def test_a_twin_that_dies_stops_the_controller(tmp_path):
    told = ros2_processes.run_in_namespace("lose_twin", tmp_path)
    assert told["alone"]["code"] == 2
    assert "the robot sends no status on joint_states" in told["alone"]["err"]
    assert "in this ROS domain" in told["alone"]["err"]
    assert told["robot"]["code"] == 1
    assert told["robot"]["summary"]["status"] == "stopped"
    assert told["commands_for"] < SILENCE
    assert told["largest_step"] < 0.01


BEARABLE = {
    "doubled": "joint_states was not newer than the one before",
    "reordered": "joint_states was not newer than the one before",
    "late": "",
    "not_finite": "joint_states: velocity is not finite",
    "incomplete": "joint_states: position has not one number for each name",
    "future": "joint_states is from the future, by its sender's own clock",
}


@over_dds
@pytest.mark.parametrize(
    "fault",
    [
        "not_finite",
        *(
            pytest.param(fault, marks=pytest.mark.slow)
            for fault in BEARABLE
            if fault != "not_finite"
        ),
    ],
)
def test_statuses_that_will_not_do_are_counted_and_change_nothing(tmp_path, fault):
    told = ros2_processes.run_in_namespace("spoil_statuses", tmp_path, fault)
    check_done(told)
    left_out = told["robot"]["summary"]["loop"]["left_out"]
    if BEARABLE[fault]:
        assert left_out[BEARABLE[fault]] > 10, left_out


@over_dds
@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "says"),
    [("frozen", "no joint's measured position has changed"), ("lost", "no status")],
)
def test_a_robot_that_is_not_heard_of_is_stopped(tmp_path, fault, says):
    told = ros2_processes.run_in_namespace("spoil_statuses", tmp_path, fault)
    assert told["robot"]["code"] == 1
    assert told["robot"]["summary"]["status"] == "stopped"
    assert says in told["robot"]["summary"]["message"]
    assert told["speed_before"] > 0.01
    assert told["stopped_within"] < SILENCE + STOPS_WITHIN


@over_dds
def test_a_stranger_moves_the_twin_and_nonsense_does_not(tmp_path):
    told = ros2_processes.run_in_namespace("command_twin", tmp_path)
    assert told["moved"] == pytest.approx([0.1, 0, 0, 0, 0, 0, 0], abs=2e-3)
    assert told["after"] == pytest.approx([0.1, 0, 0, 0, 0, 0, 0], abs=2e-3)
    for why in ("is of another number of joints", "is not finite", "is beyond all measure"):
        assert f"1 left out: the arm's commands: position {why}" in told["twin_err"]


@over_dds
@pytest.mark.slow
def test_the_object_is_found_in_pictures_over_ros_2(tmp_path):
    told = ros2_processes.run_in_namespace("see_by_pictures", tmp_path)
    check_done(told)
    assert told["poses"] > 20
    assert told["tracker_code"] == 0

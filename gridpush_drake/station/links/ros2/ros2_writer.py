"""`Ros2Writer`: turns the records of a `Link` into messages of ROS 2, and publishes them."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.station.links.link import ARM_PERIOD
from gridpush_drake.station.links.ros2.ros2_pictures import CAMERA_INFO, COLOR, DEPTH
from gridpush_drake.station.links.ros2.ros2_robot import RosRobot
from gridpush_drake.station.links.ros2.ros2_topics import (
    ARM_POSITIONS,
    ARM_TRAJECTORY,
    CLOCK,
    GRIPPER_POSITIONS,
    GRIPPER_TRAJECTORY,
    JOINT_STATES,
    NANOSECONDS,
    OBJECT_POSE,
    WORLD,
    WRENCH,
    name_object_topic,
)
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    PoseObservation,
)


class Ros2Writer:
    """Publishes records; each method does one kind of them in one kind of message."""

    def __init__(
        self, ros: SimpleNamespace, robot: RosRobot, publish: Callable[[str, Any], None]
    ) -> None:
        """Takes what is needed to make messages.

        Args:
            ros: the types of messages, see `ros2_topics.import_ros`.
            robot: the robot's names.
            publish: publishes a message on a topic.
        """
        self._ros = ros
        self._robot = robot
        self._publish = publish

    def send_arm_trajectory(self, command: ArmCommand) -> None:
        """Publishes the arm's command as a `JointTrajectory` of one point."""
        self._publish(
            ARM_TRAJECTORY, self._make_trajectory(self._robot.joints, _list(command.position))
        )

    def send_arm_positions(self, command: ArmCommand) -> None:
        """Publishes the arm's command as a `Float64MultiArray`."""
        self._publish(ARM_POSITIONS, self._ros.Float64MultiArray(data=_list(command.position)))

    def send_gripper_trajectory(self, command: GripperCommand) -> None:
        """Publishes the gripper's command as a `JointTrajectory` of one point."""
        gripper = self._robot.gripper
        if gripper is None:
            return
        message = self._make_trajectory(gripper.names, gripper.calc_position(command.opening))
        message.points[0].effort = [float(command.force)] * len(gripper.names)
        self._publish(GRIPPER_TRAJECTORY, message)

    def send_gripper_positions(self, command: GripperCommand) -> None:
        """Publishes the gripper's command as a `Float64MultiArray`."""
        gripper = self._robot.gripper
        if gripper is not None:
            data = gripper.calc_position(command.opening)
            self._publish(GRIPPER_POSITIONS, self._ros.Float64MultiArray(data=data))

    def _make_trajectory(self, joints: Sequence[str], position: list[float]) -> Any:
        """Makes a trajectory of one point, to be reached a period from now (header time 0: now)."""
        message = self._ros.JointTrajectory()
        message.joint_names = list(joints)
        point = self._ros.JointTrajectoryPoint()
        point.positions = position
        point.time_from_start.nanosec = round(ARM_PERIOD * NANOSECONDS)
        message.points = [point]
        return message

    def send_arm_status(self, status: ArmStatus) -> None:
        """Publishes the arm's state as a `JointState`, its load, and the clock."""
        stamp = self._make_stamp(status.time)
        self._publish(CLOCK, self._ros.Clock(clock=stamp))
        if self._robot.load == "wrench":
            self._send_wrench(status, stamp)
        message = self._ros.JointState()
        message.header.stamp = stamp
        message.name = list(self._robot.joints)
        message.position = _list(status.position)
        message.velocity = _list(status.velocity)
        if self._robot.load == "effort":
            message.effort = _list(status.torque_external)
        self._publish(JOINT_STATES, message)

    def _send_wrench(self, status: ArmStatus, stamp: Any) -> None:
        message = self._ros.WrenchStamped()
        message.header.stamp = stamp
        message.header.frame_id = self._robot.flange_frame
        force, torque = self._robot.tip_load.calc_wrench(status.position, status.torque_external)
        for vector, numbers in ((message.wrench.force, force), (message.wrench.torque, torque)):
            vector.x, vector.y, vector.z = map(float, numbers)
        self._publish(WRENCH, message)

    def send_gripper_status(self, status: GripperStatus) -> None:
        """Publishes the gripper's state as a `JointState`."""
        gripper = self._robot.gripper
        if gripper is None:
            return
        message = self._ros.JointState()
        message.header.stamp = self._make_stamp(status.time)
        message.name = list(gripper.names)
        message.position = gripper.calc_position(status.opening)
        rate = status.speed / gripper.opening
        message.velocity = [float(v) for v in rate * (gripper.open - gripper.closed)]
        message.effort = [float(status.force)] * len(gripper.names)
        self._publish(JOINT_STATES, message)

    def send_pose(self, observation: PoseObservation) -> None:
        """Publishes where the object was seen; nothing where it was not."""
        if np.isfinite(np.asarray(observation.pose, float)).all():
            message = self._ros.PoseStamped()
            message.header.stamp = self._make_stamp(observation.time)
            message.header.frame_id = WORLD
            write_pose(message.pose, observation.pose)
            self._publish(name_object_topic(OBJECT_POSE, observation.number), message)

    def send_picture(self, picture: Frame) -> None:
        """Publishes a picture as `Image`s, with the camera's `CameraInfo`."""
        stamp = self._make_stamp(picture.t)
        pixels = {COLOR: ("rgb8", np.ascontiguousarray(picture.color))}
        if picture.depth is not None:
            pixels[DEPTH] = ("32FC1", np.ascontiguousarray(picture.depth, dtype="<f4"))
        if self._robot.camera is not None:
            self._publish(CAMERA_INFO, self._make_camera_info(self._robot.camera, stamp))
        for topic, (encoding, array) in pixels.items():
            message = self._ros.Image()
            message.header.stamp = stamp
            message.header.frame_id = "camera"
            message.height, message.width = array.shape[:2]
            message.encoding = encoding
            message.step = array.strides[0]
            message.data = array.tobytes()
            self._publish(topic, message)

    def _make_camera_info(self, camera: Camera, stamp: Any) -> Any:
        message = self._ros.CameraInfo()
        message.header.stamp = stamp
        message.header.frame_id = "camera"
        message.width, message.height = camera.width, camera.height
        message.k = camera.K.ravel()
        message.r = np.eye(3).ravel()
        message.p = np.column_stack([camera.K, np.zeros(3)]).ravel()
        message.distortion_model = "plumb_bob"
        message.d = [0.0] * 5
        return message

    def _make_stamp(self, time: float) -> Any:
        stamp = self._ros.JointState().header.stamp
        nanoseconds = max(round(NANOSECONDS * time), 0)
        stamp.sec, stamp.nanosec = divmod(nanoseconds, round(NANOSECONDS))
        return stamp


def write_pose(message: Any, pose: Sequence[float] | Array, height: float = 0.0) -> None:
    """Writes a pose in the plane (3,), m and rad, into a `geometry_msgs/Pose`."""
    x, y, yaw = (float(number) for number in pose)
    message.position.x, message.position.y, message.position.z = x, y, height
    message.orientation.z, message.orientation.w = float(np.sin(yaw / 2)), float(np.cos(yaw / 2))


def _list(numbers: Sequence[float] | NDArray[np.float64]) -> list[float]:
    return [float(number) for number in numbers]

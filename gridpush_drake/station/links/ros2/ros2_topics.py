"""The names, frames and types of messages that are spoken over ROS 2, and how they are imported."""

from importlib import import_module
from types import SimpleNamespace
from typing import Any

from gridpush_drake.errors import StationError

JOINT_STATES = "joint_states"
WRENCH = "wrench"
OBJECT_POSE = "object_pose"
OBJECT_COVARIANCE = "object_pose_with_covariance"
ARM_TRAJECTORY = "joint_trajectory_controller/joint_trajectory"
ARM_POSITIONS = "forward_position_controller/commands"
GRIPPER_TRAJECTORY = "gripper_controller/joint_trajectory"
GRIPPER_POSITIONS = "gripper_controller/commands"
CLOCK = "/clock"
"""Topics; all but the last are relative names. Those of a camera are in `ros2_pictures`."""

WORLD = "world"
"""Frame of the scenario's W in headers."""

NANOSECONDS = 1e9
"""Nanoseconds in a second."""

TYPES = {
    "Clock": "rosgraph_msgs",
    "CameraInfo": "sensor_msgs",
    "Float64MultiArray": "std_msgs",
    "Image": "sensor_msgs",
    "JointState": "sensor_msgs",
    "JointTrajectory": "trajectory_msgs",
    "JointTrajectoryPoint": "trajectory_msgs",
    "PoseStamped": "geometry_msgs",
    "PoseWithCovarianceStamped": "geometry_msgs",
    "WrenchStamped": "geometry_msgs",
}
"""Messages, by the ROS packages that define them."""


def name_object_topic(topic: str, number: int) -> str:
    """Names a topic of an object's pose, by the object's number; see `PoseObservation`.

    Args:
        topic: the topic of the scenario's `object`.
        number: 0 for it, and 1 and so on for the scenario's `others`.
    """
    return topic if number == 0 else f"other_{number - 1}/{topic}"


def import_ros() -> SimpleNamespace:
    """Imports rclpy and the messages; returns them by their names.

    Raises:
        StationError: ROS 2 is not in this shell, or is for another Python.
    """
    try:
        found: dict[str, Any] = {"rclpy": import_module("rclpy")}
        for module in ("context", "executors", "node", "qos", "signals"):
            found[module] = import_module(f"rclpy.{module}")
        for name, package in TYPES.items():
            found[name] = getattr(import_module(f"{package}.msg"), name)
    except ImportError as error:
        raise StationError(
            f"--ros2: {error.name or 'rclpy'} cannot be imported ({error}); expected ROS 2 in this "
            "shell (source /opt/ros/DISTRO/setup.bash) and gridpush installed for its Python"
        ) from error
    return SimpleNamespace(**found)

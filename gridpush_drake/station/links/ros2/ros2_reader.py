"""`Ros2Reader`: turns messages of ROS 2 into the records of a `Link`.

Messages come as Python objects with the fields of their types; nothing of ROS is imported here.
What cannot be used is turned into an `Unusable`, which says why.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RollPitchYaw

from gridpush_drake.errors import ImageError
from gridpush_drake.geometry.se2 import QUATERNION_TOLERANCE, Array, calc_yaw
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.station.links.link import LinkMessage, Unusable
from gridpush_drake.station.links.ros2.ros2_pictures import (
    COLOR,
    DEPTH,
    find_camera_fault,
    read_color,
    read_depth,
)
from gridpush_drake.station.links.ros2.ros2_robot import GripperJoints, RosRobot
from gridpush_drake.station.links.ros2.ros2_topics import (
    ARM_TRAJECTORY,
    GRIPPER_POSITIONS,
    GRIPPER_TRAJECTORY,
    JOINT_STATES,
    NANOSECONDS,
    OBJECT_COVARIANCE,
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

MAX_WRENCH_AGE = 0.1
"""If the last wrench was measured longer than this before the joints, or after them, s, the load is
not known any more. The status then cannot be used, and the arm is stopped if no better one comes.
A wrench stamped ahead would otherwise be believed until the joints come to its time, though its
sensor may have died."""

MAX_DEVIATION = 0.02
"""Largest standard deviation, m, with which a pose of the object can be used, by its covariance.
That of the turn counts with `TURN_FRACTION`."""

TURN_FRACTION = 0.1
"""m for each rad: a turn's standard deviation counts as so much of a shift's."""

COVARIANCE_PLACES = (0, 7, 35)
"""Where the variances of x, y and the turn about z are in a pose's covariance of 36 numbers."""

MAX_TILT = 10.0
"""Greatest angle between the object's z axis and the vertical, degrees. An object that lies on the
table is upright; beyond this, the pose is of something else, or in another frame."""

KEPT_IMAGES = 10
"""Number of color or depth images that wait at most for the other one of the same moment."""


class Ros2Reader:
    """Reads messages, and keeps the records until they are asked for.

    Attributes:
        load_known: whether anything has said the load on the arm from outside.
    """

    def __init__(self, robot: RosRobot, load_known: bool, get_time: Callable[[], float]) -> None:
        """Begins with no message.

        Args:
            robot: the robot's names.
            load_known: whether the load on the arm needs no `WrenchStamped` to be known.
            get_time: the node's clock, s.
        """
        self.load_known = load_known
        self._robot = robot
        self._get_time = get_time
        self._received: list[LinkMessage] = []
        self._wrench: tuple[float, Array, Array] | None = None
        self._last: tuple[float, Array] | None = None
        self._images: dict[str, dict[tuple[int, int], Any]] = {COLOR: {}, DEPTH: {}}
        self._camera_fault = ""

    def take_all(self) -> list[LinkMessage]:
        """Returns all records since the last call, in the order of their messages."""
        received = self._received
        self._received = []
        return received

    def take_joints(self, message: Any) -> None:
        """Takes a `JointState` of the arm, the gripper, or both; other joints say nothing here."""
        time = _read_time(message.header.stamp)
        gripper = self._robot.gripper
        order = _find_order(message.name, self._robot.joints)
        gripper_order = None if gripper is None else _find_order(message.name, gripper.names)
        if order is None and gripper_order is None:
            return
        fault = self._find_joints_fault(message)
        if fault:
            self._leave_out(f"{JOINT_STATES}{fault}", GripperStatus if order is None else ArmStatus)
            return
        if order is not None:
            self._take_arm(message, order, time)
        if gripper is not None and gripper_order is not None:
            self._take_gripper_joints(message, gripper, gripper_order, time)

    def _find_joints_fault(self, message: Any) -> str:
        """Says why it is not clear which number of a `JointState` is which joint's; "" if it is."""
        names = list(message.name)
        wanted = self._robot.joints
        if self._robot.gripper is not None:
            wanted += self._robot.gripper.names
        if any(names.count(name) > 1 for name in wanted):
            return " names a joint twice"
        if len(message.position) != len(names):
            return ": position has not one number for each name"
        for field in ("velocity", "effort"):
            if len(getattr(message, field)) not in (0, len(names)):
                return f": {field} has not one number for each name"
        return ""

    def _take_gripper_joints(
        self, message: Any, gripper: GripperJoints, order: NDArray[np.intp], time: float
    ) -> None:
        position = _pick(message.position, order)
        assert position is not None
        velocity, effort = _pick(message.velocity, order), _pick(message.effort, order)
        fraction = gripper.calc_fraction(position)
        speed = 0.0
        if velocity is not None:
            speed = gripper.opening * gripper.calc_fraction(gripper.closed + velocity)
        force = 0.0 if effort is None else float(np.abs(effort).mean())
        self._received.append(GripperStatus(time, gripper.opening * fraction, speed, force))

    def _take_arm(self, message: Any, order: NDArray[np.intp], time: float) -> None:
        position = _pick(message.position, order)
        assert position is not None
        velocity = _pick(message.velocity, order)
        if velocity is None:
            velocity = self._calc_velocity(time, position)
        self._last = (time, position)
        torque = self._calc_torque(message, order, time, position)
        if torque is None:
            return
        self._received.append(ArmStatus(time, position, velocity, torque))

    def _calc_velocity(self, time: float, position: Array) -> Array:
        """From the status before, where a driver says no velocities, rad/s."""
        if self._last is None or not time > self._last[0]:
            return np.zeros_like(position)
        return (position - self._last[1]) / (time - self._last[0])

    def _calc_torque(
        self, message: Any, order: NDArray[np.intp], time: float, position: Array
    ) -> Array | None:
        """Returns the torques on the joints from outside, N m; None, and counted, if unknown."""
        if self._robot.load == "effort":
            effort = _pick(message.effort, order)
            if effort is None:
                self._leave_out(
                    f"{JOINT_STATES}: effort has not one number for each name", ArmStatus
                )
            return effort
        if self._wrench is None or not np.isfinite(position).all():
            return np.zeros(len(position))
        came, force, torque = self._wrench
        if abs(time - came) > MAX_WRENCH_AGE:
            which = "older" if came < time else "newer"
            self._leave_out(
                f"{WRENCH} is more than {MAX_WRENCH_AGE:g} s {which} than {JOINT_STATES}",
                ArmStatus,
            )
            return None
        return self._robot.tip_load.calc_torque(position, force, torque)

    def take_wrench(self, message: Any) -> None:
        """Takes a `WrenchStamped`, the load on the flange; the joints' torques follow from it."""
        frame = message.header.frame_id
        if frame not in ("", self._robot.flange_frame):
            self._leave_out(f"{WRENCH} is in frame {frame}; expected {self._robot.flange_frame}")
            return
        self.load_known = True
        force, torque = message.wrench.force, message.wrench.torque
        self._wrench = (
            _read_time(message.header.stamp),
            np.array([force.x, force.y, force.z]),
            np.array([torque.x, torque.y, torque.z]),
        )

    def take_pose(self, message: Any, number: int = 0) -> None:
        """Takes a `PoseStamped` of an object, by the object's number; see `PoseObservation`."""
        self._take_stamped(OBJECT_POSE, message.header, message.pose, number)

    def take_covariance(self, message: Any, number: int = 0) -> None:
        """Takes a `PoseWithCovarianceStamped` of an object; one that is too unsure is left out."""
        variances = [message.pose.covariance[place] for place in COVARIANCE_PLACES]
        deviation = np.sqrt(np.abs(variances)) * [1.0, 1.0, TURN_FRACTION]
        if not (deviation <= MAX_DEVIATION).all():  # true for NaN
            self._leave_out(
                f"{name_object_topic(OBJECT_COVARIANCE, number)}: the standard deviation is more "
                f"than {MAX_DEVIATION:g} m, or {MAX_DEVIATION / TURN_FRACTION:g} rad",
                PoseObservation,
                number,
            )
            return
        self._take_stamped(OBJECT_COVARIANCE, message.header, message.pose.pose, number)

    def _take_stamped(self, name: str, header: Any, pose: Any, number: int) -> None:
        topic = name_object_topic(name, number)
        known = ("", WORLD, self._robot.base_frame)
        if header.frame_id not in known:
            self._leave_out(
                f"{topic} is in frame {header.frame_id}; expected {WORLD} or "
                f"{self._robot.base_frame}",
                PoseObservation,
                number,
            )
            return
        fault = find_orientation_fault(pose.orientation)
        if fault:
            self._leave_out(f"{topic}: {fault}", PoseObservation, number)
            return
        q = pose.orientation
        yaw = float(calc_yaw(q.w, q.x, q.y, q.z))
        x, y = pose.position.x, pose.position.y
        if header.frame_id == self._robot.base_frame:
            X_WR = self._robot.X_WR
            x, y, _ = X_WR.translation() + X_WR.rotation() @ [x, y, pose.position.z]
            yaw += RollPitchYaw(X_WR.rotation()).yaw_angle()
        seen = np.array([x, y, yaw])
        if not np.isfinite(seen).all():
            self._leave_out(f"{topic} is not finite", PoseObservation, number)
            return
        self._received.append(PoseObservation(_read_time(header.stamp), seen, number))

    def take_arm_trajectory(self, message: Any) -> None:
        """Takes a `JointTrajectory` of one point as a command for the arm."""
        point = self._find_point(ARM_TRAJECTORY, message, self._robot.joints)
        if point is not None:
            self._received.append(ArmCommand(self._get_time(), point[0]))

    def take_arm_positions(self, message: Any) -> None:
        """Takes a `Float64MultiArray` as a command for the arm."""
        position = np.array(message.data, dtype=np.float64)
        self._received.append(ArmCommand(self._get_time(), position))

    def take_gripper_trajectory(self, message: Any) -> None:
        """Takes a `JointTrajectory` of one point as a command for the gripper."""
        assert self._robot.gripper is not None
        point = self._find_point(GRIPPER_TRAJECTORY, message, self._robot.gripper.names)
        if point is not None:
            force = self._robot.max_force if point[1] is None else float(point[1].mean())
            self._take_gripper(point[0], force)

    def take_gripper_positions(self, message: Any) -> None:
        """Takes a `Float64MultiArray` as a command for the gripper."""
        assert self._robot.gripper is not None
        position = np.array(message.data, dtype=np.float64)
        if len(position) != len(self._robot.gripper.names):
            expected = len(self._robot.gripper.names)
            self._leave_out(f"{GRIPPER_POSITIONS} has {len(position)} numbers; expected {expected}")
            return
        self._take_gripper(position, self._robot.max_force)

    def _take_gripper(self, position: Array, force: float) -> None:
        gripper = self._robot.gripper
        assert gripper is not None
        opening = gripper.opening * gripper.calc_fraction(position)
        self._received.append(GripperCommand(self._get_time(), opening, force))

    def _find_point(
        self, topic: str, message: Any, joints: tuple[str, ...]
    ) -> tuple[Array, Array | None] | None:
        """Reads positions and any efforts of a trajectory's only point; None if it will not do."""
        names = list(message.joint_names)
        order = _find_order(names, joints)
        if order is None:
            self._leave_out(f"{topic} names not all joints; expected {', '.join(joints)}")
            return None
        if len(message.points) != 1:
            self._leave_out(f"{topic} has {len(message.points)} points; expected one at a time")
            return None
        if any(names.count(name) > 1 for name in joints):
            self._leave_out(f"{topic} names a joint twice")
            return None
        point = message.points[0]
        position = _pick(point.positions, order)
        if position is None or len(point.positions) != len(names):
            self._leave_out(f"{topic}: positions has not one number for each joint")
            return None
        return position, _pick(point.effort, order)

    def take_color(self, message: Any) -> None:
        """Takes a color `Image`."""
        self._take_image(COLOR, message)

    def take_depth(self, message: Any) -> None:
        """Takes a depth `Image`."""
        self._take_image(DEPTH, message)

    def _take_image(self, topic: str, message: Any) -> None:
        """Keeps an image until the other one of the same moment is there."""
        if self._camera_fault:
            self._leave_out(self._camera_fault)
            return
        stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        kept, other = self._images[topic], self._images[DEPTH if topic == COLOR else COLOR]
        kept[stamp] = message
        while len(kept) > KEPT_IMAGES:
            del kept[next(iter(kept))]
        if stamp not in other:
            return
        color = self._images[COLOR].pop(stamp)
        depth = self._images[DEPTH].pop(stamp)
        try:
            picture = Frame(read_color(color), read_depth(depth), _read_time(color.header.stamp))
        except ImageError as error:
            self._leave_out(str(error))
            return
        self._received.append(picture)

    def take_camera_info(self, message: Any) -> None:
        """Takes a `CameraInfo`, which says whether the camera is the scenario's."""
        self._camera_fault = find_camera_fault(message, self._robot.camera)

    def _leave_out(self, why: str, kind: type | None = None, number: int = 0) -> None:
        self._received.append(Unusable(why, kind, number))


def find_orientation_fault(q: Any) -> str:
    """Says why a `geometry_msgs/Quaternion` is not that of an object which lies flat.

    A message that nobody filled has x = y = z = w = 0, and would be read as "not turned".
    """
    length = np.sqrt(q.x**2 + q.y**2 + q.z**2 + q.w**2)
    if not abs(length - 1.0) <= QUATERNION_TOLERANCE:  # true for NaN
        return f"the orientation's quaternion has length {length:.3g}; expected 1"
    z_up = 1 - 2 * (q.x**2 + q.y**2)
    tilt = float(np.degrees(np.arccos(np.clip(z_up, -1.0, 1.0))))
    if tilt > MAX_TILT:
        return (
            f"the object's z axis is {tilt:.0f} degrees from upright; expected at most {MAX_TILT:g}"
        )
    return ""


def _read_time(stamp: Any) -> float:
    return float(stamp.sec) + float(stamp.nanosec) / NANOSECONDS


def _find_order(names: Sequence[str], wanted: Sequence[str]) -> NDArray[np.intp] | None:
    """Where the wanted joints are among a message's; None where not all are there."""
    names = list(names)
    there = all(name in names for name in wanted)
    return np.array([names.index(name) for name in wanted]) if there else None


def _pick(numbers: Sequence[float], order: NDArray[np.intp]) -> Array | None:
    """The numbers of the joints that are wanted; None where there are not as many as names."""
    values = np.asarray(numbers, dtype=np.float64)
    return values[order] if len(values) > int(order.max()) else None

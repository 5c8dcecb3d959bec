"""`Ros2Link`: a `Link` over ROS 2, by the `rclpy` of the user's own ROS 2 installation.

Topics are relative names, so that namespaces and remapping work as ROS users expect
(`--ros-args -r joint_states:=/left/joint_states -r __ns:=/cell`), and so does `use_sim_time`:

    joint_states                               sensor_msgs/JointState: arm, gripper, or both
    wrench                                     geometry_msgs/WrenchStamped, on the flange
    object_pose                                geometry_msgs/PoseStamped
    object_pose_with_covariance                geometry_msgs/PoseWithCovarianceStamped
    other_0/object_pose, ...                   the same of the scenario's other objects
    camera/color/image_raw, camera/depth/image_raw      sensor_msgs/Image
    camera/color/camera_info                   sensor_msgs/CameraInfo
    joint_trajectory_controller/joint_trajectory        trajectory_msgs/JointTrajectory
    forward_position_controller/commands       std_msgs/Float64MultiArray
    gripper_controller/joint_trajectory        trajectory_msgs/JointTrajectory
    gripper_controller/commands                std_msgs/Float64MultiArray

Statuses are received by best effort, which takes both kinds of publishers, and images reliably
where their publisher offers it. Commands are sent reliably, as ros2_control's controllers want
them. Nothing of ROS is imported before a link is made.
"""

from collections.abc import Callable, Sequence
from enum import StrEnum
from functools import partial
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RollPitchYaw

from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import QUATERNION_TOLERANCE, Array, calc_yaw
from gridpush_drake.perception.camera import Camera
from gridpush_drake.station.lcm.robot_messages import ARM_PERIOD
from gridpush_drake.station.links.link import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    LinkMessage,
    ObjectSight,
    Picture,
    Unusable,
)
from gridpush_drake.station.links.ros2_pictures import (
    CAMERA_INFO,
    COLOR,
    DEPTH,
    find_camera_fault,
    read_color,
    read_depth,
)
from gridpush_drake.station.links.ros2_robot import RosRobot

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

MAX_WRENCH_AGE = 0.1
"""If the last wrench was measured longer than this before the joints, s, the load is not known any
more. The status then cannot be used, and the arm is stopped if no better one comes."""

MAX_DEVIATION = 0.02
"""Largest standard deviation, m, with which a pose of the object can be used, by its covariance.
That of the turn counts with `TURN_SHARE`."""

TURN_SHARE = 0.1
"""m for each rad: a turn's standard deviation counts as so much of a shift's."""

COVARIANCE_PLACES = (0, 7, 35)
"""Where the variances of x, y and the turn about z are in a pose's covariance of 36 numbers."""

MAX_TILT = 10.0
"""Greatest angle between the object's z axis and the vertical, degrees. An object that lies on the
table is upright; beyond this, the pose is of something else, or in another frame."""

KEPT_IMAGES = 10
"""Number of color or depth images that wait at most for the other one of the same moment."""

QUEUE = 10
"""Number of messages of a topic that wait at most to be read."""

DRAINED = 100
"""Number of messages that are taken at most between two looks at the clock."""

BEST_EFFORT = "BEST_EFFORT"
RELIABLE = "RELIABLE"
BEST_AVAILABLE = "BEST_AVAILABLE"
"""How a topic is received. Best effort takes every publisher. Images are larger than the buffers of
a computer, and most would be lost so: they are received reliably wherever their publisher offers
it."""

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
    """Names a topic of an object's pose, by the object's number; see `ObjectSight`.

    Args:
        topic: the topic of the scenario's `object`.
        number: 0 for it, and 1 and so on for the scenario's `others`.
    """
    return topic if number == 0 else f"other_{number - 1}/{topic}"


class Ros2Role(StrEnum):
    """Who speaks over a link; its name is the node's, too."""

    CONTROL = "gridpush_robot"
    ROBOT = "gridpush_twin"
    TRACKER = "gridpush_tracker"
    CAMERA = "gridpush_camera"


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


def open_ros2(role: Ros2Role, robot: RosRobot, arguments: Sequence[str] = ()) -> "Ros2Link":
    """Opens a link over ROS 2.

    Args:
        role: who speaks.
        robot: its names.
        arguments: of ROS, as they stand after `--ros-args` on a command line.

    Raises:
        StationError: ROS 2 is not there, or an argument will not do.
    """
    return Ros2Link(role, robot, arguments)


class Ros2Link:
    """A node of ROS 2 as a `Link`.

    Attributes:
        node: the node, for what else is published.
        load_known: whether anything has said the load on the arm from outside.
    """

    def __init__(self, role: Ros2Role, robot: RosRobot, arguments: Sequence[str] = ()) -> None:
        """Makes the node with the topics of a role; see `open_ros2`."""
        self._ros = import_ros()
        self._robot = robot
        self._received: list[LinkMessage] = []
        self._taken = 0  # how many messages have come, of whatever kind
        self._context = self._ros.context.Context()
        given = ["gridpush", *(["--ros-args", *arguments] if arguments else [])]
        try:
            # Ctrl-C and other signals stay the command's own
            self._ros.rclpy.init(
                args=given,
                context=self._context,
                signal_handler_options=self._ros.signals.SignalHandlerOptions.NO,
            )
            self.node = self._ros.node.Node(role.value, context=self._context)
        except Exception as error:  # rclpy raises several kinds of its own
            text = " ".join(str(error).split())
            raise StationError(
                f"--ros-args {' '.join(arguments)}: {text}; expected arguments of ROS 2, such as "
                "-r joint_states:=/ur/joint_states"
            ) from error
        self._executor = self._ros.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}
        self.load_known = role != Ros2Role.CONTROL or robot.load == "effort"
        self._wrench: tuple[float, Array, Array] | None = None
        self._last: tuple[float, Array] | None = None
        self._orders: dict[tuple[str, ...], NDArray[np.intp] | None] = {}
        self._images: dict[str, dict[tuple[int, int], Any]] = {COLOR: {}, DEPTH: {}}
        self._camera_fault = ""
        self._senders: dict[type, Callable[[Any], None]] = {}
        self._open(role)

    def close(self) -> None:
        """Leaves ROS 2."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def receive(self, timeout: float) -> Sequence[LinkMessage]:
        """All that has come; waits up to `timeout`, s, where nothing has."""
        self._executor.spin_once(timeout_sec=timeout)
        # Until nothing is left to take. Not every message makes a record: an image waits for the
        # other one of its moment.
        for _ in range(DRAINED):
            count = self._taken
            self._executor.spin_once(timeout_sec=0.0)
            if self._taken == count:
                break
        received, self._received = self._received, []
        return received

    def send(self, message: LinkMessage) -> None:
        """Publishes a record; one that the role does not speak of is left alone."""
        send = self._senders.get(type(message))
        if send is not None:
            send(message)

    def get_time(self) -> float:
        """The node's clock, s: the simulation's with `use_sim_time`."""
        return float(self.node.get_clock().now().nanoseconds) / NANOSECONDS

    def publish(self, topic: str, message: Any, *, latched: bool = False) -> None:
        """Publishes a message; `latched` ones are also had by who comes later."""
        if topic not in self._publishers:
            qos = self._ros.qos
            durability = qos.DurabilityPolicy.TRANSIENT_LOCAL if latched else None
            profile = qos.QoSProfile(
                depth=1 if latched else QUEUE,
                reliability=qos.ReliabilityPolicy.RELIABLE,
                durability=durability or qos.DurabilityPolicy.VOLATILE,
            )
            self._publishers[topic] = self.node.create_publisher(type(message), topic, profile)
        self._publishers[topic].publish(message)

    def _open(self, role: Ros2Role) -> None:
        """Subscribes to what a role reads, and says how what it sends is published."""
        command = self._read_command_kind()
        if role in (Ros2Role.CONTROL, Ros2Role.TRACKER):
            self._subscribe("JointState", JOINT_STATES, self._take_joints)
        if role == Ros2Role.CONTROL:
            if self._robot.load == "wrench":
                self._subscribe("WrenchStamped", WRENCH, self._take_wrench)
            for number in range(self._robot.others + 1):
                self._subscribe_to_object(number)
            if command == "trajectory":
                self._senders[ArmCommand] = self._send_arm_trajectory
                self._senders[GripperCommand] = self._send_gripper_trajectory
            else:
                self._senders[ArmCommand] = self._send_arm_positions
                self._senders[GripperCommand] = self._send_gripper_positions
        elif role == Ros2Role.ROBOT:
            self._subscribe("JointTrajectory", ARM_TRAJECTORY, self._take_arm_trajectory, RELIABLE)
            self._subscribe("Float64MultiArray", ARM_POSITIONS, self._take_arm_positions, RELIABLE)
            if self._robot.gripper is not None:
                self._subscribe(
                    "JointTrajectory", GRIPPER_TRAJECTORY, self._take_gripper_trajectory, RELIABLE
                )
                self._subscribe(
                    "Float64MultiArray", GRIPPER_POSITIONS, self._take_gripper_positions, RELIABLE
                )
            self._senders[ArmStatus] = self._send_arm_status
            self._senders[GripperStatus] = self._send_gripper_status
            self._senders[ObjectSight] = self._send_pose
        elif role == Ros2Role.TRACKER:
            self._subscribe("Image", COLOR, self._take_color, BEST_AVAILABLE)
            self._subscribe("Image", DEPTH, self._take_depth, BEST_AVAILABLE)
            self._subscribe("CameraInfo", CAMERA_INFO, self._take_camera_info)
            self._senders[ObjectSight] = self._send_pose
        else:
            self._senders[Picture] = self._send_picture

    def _read_command_kind(self) -> str:
        """The node's parameter `command`, by default as robot.yaml has it."""
        kind = self.node.declare_parameter("command", self._robot.command).value
        if kind not in ("trajectory", "position"):
            raise StationError(
                f"ROS parameter command is {kind!r}; expected trajectory (for "
                "joint_trajectory_controller) or position (for forward_position_controller)"
            )
        return str(kind)

    def _subscribe_to_object(self, number: int) -> None:
        """Subscribes to the topics of an object's pose, by the object's number."""
        self._subscribe(
            "PoseStamped",
            name_object_topic(OBJECT_POSE, number),
            partial(self._take_pose, number=number),
        )
        self._subscribe(
            "PoseWithCovarianceStamped",
            name_object_topic(OBJECT_COVARIANCE, number),
            partial(self._take_covariance, number=number),
        )

    def _subscribe(
        self,
        kind: str,
        topic: str,
        take: Callable[[Any], None],
        reliability: str = BEST_EFFORT,
    ) -> None:
        def count_and_take(message: Any) -> None:
            self._taken += 1
            take(message)

        qos = self._ros.qos
        policy = qos.ReliabilityPolicy[reliability]
        profile = qos.QoSProfile(depth=QUEUE, reliability=policy)
        self.node.create_subscription(getattr(self._ros, kind), topic, count_and_take, profile)

    def _leave_out(self, why: str) -> None:
        self._received.append(Unusable(why))

    # What comes in

    def _take_joints(self, message: Any) -> None:
        """Takes a `JointState` of the arm, the gripper, or both; other joints say nothing here."""
        time = _read_time(message.header.stamp)
        order = self._find_order(tuple(message.name), self._robot.joints)
        if order is not None:
            self._take_arm(message, order, time)
        gripper = self._robot.gripper
        if gripper is None:
            return
        order = self._find_order(tuple(message.name), gripper.names)
        if order is None:
            return
        position = _pick(message.position, order)
        if position is None:
            self._leave_out(f"{JOINT_STATES}: position has not one number for each name")
            return
        velocity, effort = _pick(message.velocity, order), _pick(message.effort, order)
        share = gripper.calc_share(position)
        speed = 0.0
        if velocity is not None:
            speed = gripper.opening * gripper.calc_share(gripper.closed + velocity)
        force = 0.0 if effort is None else float(np.abs(effort).mean())
        self._received.append(GripperStatus(time, gripper.opening * share, speed, force))

    def _take_arm(self, message: Any, order: NDArray[np.intp], time: float) -> None:
        position = _pick(message.position, order)
        if position is None:
            self._leave_out(f"{JOINT_STATES}: position has not one number for each name")
            return
        velocity = _pick(message.velocity, order)
        if velocity is None:
            velocity = self._calc_velocity(time, position)
        self._last = (time, position)
        torque = self._calc_torque(message, order, time, position)
        if torque is None:
            return
        self._received.append(ArmStatus(time, position, velocity, torque))

    def _find_order(
        self, names: tuple[str, ...], wanted: tuple[str, ...]
    ) -> NDArray[np.intp] | None:
        """Where the wanted joints are among a message's; None where not all are there."""
        key = (*names, "", *wanted)
        if key not in self._orders:
            there = all(name in names for name in wanted)
            self._orders[key] = np.array([names.index(n) for n in wanted]) if there else None
        return self._orders[key]

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
                self._leave_out(f"{JOINT_STATES}: effort has not one number for each name")
            return effort
        if self._wrench is None or not np.isfinite(position).all():
            return np.zeros(len(position))
        came, force, torque = self._wrench
        if time - came > MAX_WRENCH_AGE:
            self._leave_out(f"{WRENCH} is more than {MAX_WRENCH_AGE:g} s older than {JOINT_STATES}")
            return None
        return self._robot.tip_load.calc_torque(position, force, torque)

    def _take_wrench(self, message: Any) -> None:
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

    def _take_pose(self, message: Any, number: int = 0) -> None:
        self._take_stamped(OBJECT_POSE, message.header, message.pose, number)

    def _take_covariance(self, message: Any, number: int = 0) -> None:
        variances = [message.pose.covariance[place] for place in COVARIANCE_PLACES]
        deviation = np.sqrt(np.abs(variances)) * [1.0, 1.0, TURN_SHARE]
        if not (deviation <= MAX_DEVIATION).all():  # true for NaN
            self._leave_out(
                f"{name_object_topic(OBJECT_COVARIANCE, number)}: the standard deviation is more "
                f"than {MAX_DEVIATION:g} m, or {MAX_DEVIATION / TURN_SHARE:g} rad"
            )
            return
        self._take_stamped(OBJECT_COVARIANCE, message.header, message.pose.pose, number)

    def _take_stamped(self, name: str, header: Any, pose: Any, number: int) -> None:
        topic = name_object_topic(name, number)
        known = ("", WORLD, self._robot.base_frame)
        if header.frame_id not in known:
            self._leave_out(
                f"{topic} is in frame {header.frame_id}; expected {WORLD} or "
                f"{self._robot.base_frame}"
            )
            return
        fault = find_orientation_fault(pose.orientation)
        if fault:
            self._leave_out(f"{topic}: {fault}")
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
            self._leave_out(f"{topic} is not finite")
            return
        self._received.append(ObjectSight(_read_time(header.stamp), seen, number))

    def _take_arm_trajectory(self, message: Any) -> None:
        point = self._find_point(ARM_TRAJECTORY, message, self._robot.joints)
        if point is not None:
            self._received.append(ArmCommand(self.get_time(), point[0]))

    def _take_arm_positions(self, message: Any) -> None:
        position = np.array(message.data, dtype=np.float64)
        self._received.append(ArmCommand(self.get_time(), position))

    def _take_gripper_trajectory(self, message: Any) -> None:
        assert self._robot.gripper is not None
        point = self._find_point(GRIPPER_TRAJECTORY, message, self._robot.gripper.names)
        if point is not None:
            force = self._robot.max_force if point[1] is None else float(point[1].mean())
            self._take_gripper(point[0], force)

    def _take_gripper_positions(self, message: Any) -> None:
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
        opening = gripper.opening * gripper.calc_share(position)
        self._received.append(GripperCommand(self.get_time(), opening, force))

    def _find_point(
        self, topic: str, message: Any, joints: tuple[str, ...]
    ) -> tuple[Array, Array | None] | None:
        """Reads positions and any efforts of a trajectory's only point; None if it will not do."""
        order = self._find_order(tuple(message.joint_names), joints)
        if order is None:
            self._leave_out(f"{topic} names not all joints; expected {', '.join(joints)}")
            return None
        if len(message.points) != 1:
            self._leave_out(f"{topic} has {len(message.points)} points; expected one at a time")
            return None
        position = _pick(message.points[0].positions, order)
        if position is None:
            self._leave_out(f"{topic}: positions has not one number for each joint")
            return None
        return position, _pick(message.points[0].effort, order)

    def _take_color(self, message: Any) -> None:
        self._take_image(COLOR, message)

    def _take_depth(self, message: Any) -> None:
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
            picture = Picture(_read_time(color.header.stamp), read_color(color), read_depth(depth))
        except StationError as error:
            self._leave_out(str(error))
            return
        self._received.append(picture)

    def _take_camera_info(self, message: Any) -> None:
        self._camera_fault = find_camera_fault(message, self._robot.camera)

    # What goes out

    def _send_arm_trajectory(self, command: ArmCommand) -> None:
        self.publish(
            ARM_TRAJECTORY, self._make_trajectory(self._robot.joints, _list(command.position))
        )

    def _send_arm_positions(self, command: ArmCommand) -> None:
        self.publish(ARM_POSITIONS, self._ros.Float64MultiArray(data=_list(command.position)))

    def _send_gripper_trajectory(self, command: GripperCommand) -> None:
        gripper = self._robot.gripper
        if gripper is None:
            return
        message = self._make_trajectory(gripper.names, gripper.calc_position(command.opening))
        message.points[0].effort = [float(command.force)] * len(gripper.names)
        self.publish(GRIPPER_TRAJECTORY, message)

    def _send_gripper_positions(self, command: GripperCommand) -> None:
        gripper = self._robot.gripper
        if gripper is not None:
            data = gripper.calc_position(command.opening)
            self.publish(GRIPPER_POSITIONS, self._ros.Float64MultiArray(data=data))

    def _make_trajectory(self, joints: Sequence[str], position: list[float]) -> Any:
        """Makes a trajectory of one point, to be reached a period from now (header time 0: now)."""
        message = self._ros.JointTrajectory()
        message.joint_names = list(joints)
        point = self._ros.JointTrajectoryPoint()
        point.positions = position
        point.time_from_start.nanosec = round(ARM_PERIOD * NANOSECONDS)
        message.points = [point]
        return message

    def _send_arm_status(self, status: ArmStatus) -> None:
        stamp = self._make_stamp(status.time)
        self.publish(CLOCK, self._ros.Clock(clock=stamp))
        if self._robot.load == "wrench":
            self._send_wrench(status, stamp)
        message = self._ros.JointState()
        message.header.stamp = stamp
        message.name = list(self._robot.joints)
        message.position = _list(status.position)
        message.velocity = _list(status.velocity)
        if self._robot.load == "effort":
            message.effort = _list(status.torque_external)
        self.publish(JOINT_STATES, message)

    def _send_wrench(self, status: ArmStatus, stamp: Any) -> None:
        message = self._ros.WrenchStamped()
        message.header.stamp = stamp
        message.header.frame_id = self._robot.flange_frame
        force, torque = self._robot.tip_load.calc_wrench(status.position, status.torque_external)
        for vector, numbers in ((message.wrench.force, force), (message.wrench.torque, torque)):
            vector.x, vector.y, vector.z = map(float, numbers)
        self.publish(WRENCH, message)

    def _send_gripper_status(self, status: GripperStatus) -> None:
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
        self.publish(JOINT_STATES, message)

    def _send_pose(self, sight: ObjectSight) -> None:
        """Publishes where the object was seen; nothing where it was not."""
        if np.isfinite(np.asarray(sight.pose, float)).all():
            message = self._ros.PoseStamped()
            message.header.stamp = self._make_stamp(sight.time)
            message.header.frame_id = WORLD
            write_pose(message.pose, sight.pose)
            self.publish(name_object_topic(OBJECT_POSE, sight.number), message)

    def _send_picture(self, picture: Picture) -> None:
        stamp = self._make_stamp(picture.time)
        pixels = {COLOR: ("rgb8", np.ascontiguousarray(picture.color))}
        if picture.depth is not None:
            pixels[DEPTH] = ("32FC1", np.ascontiguousarray(picture.depth, dtype="<f4"))
        if self._robot.camera is not None:
            self.publish(CAMERA_INFO, self._make_camera_info(self._robot.camera, stamp))
        for topic, (encoding, array) in pixels.items():
            message = self._ros.Image()
            message.header.stamp = stamp
            message.header.frame_id = "camera"
            message.height, message.width = array.shape[:2]
            message.encoding = encoding
            message.step = array.strides[0]
            message.data = array.tobytes()
            self.publish(topic, message)

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


def write_pose(message: Any, pose: Sequence[float] | Array, height: float = 0.0) -> None:
    """Writes a pose in the plane (3,), m and rad, into a `geometry_msgs/Pose`."""
    x, y, yaw = (float(number) for number in pose)
    message.position.x, message.position.y, message.position.z = x, y, height
    message.orientation.z, message.orientation.w = float(np.sin(yaw / 2)), float(np.cos(yaw / 2))


def _read_time(stamp: Any) -> float:
    return float(stamp.sec) + float(stamp.nanosec) / NANOSECONDS


def _pick(numbers: Sequence[float], order: NDArray[np.intp]) -> Array | None:
    """The numbers of the joints that are wanted; None where there are not as many as names."""
    values = np.asarray(numbers, dtype=np.float64)
    return values[order] if len(values) > int(order.max()) else None


def _list(numbers: Sequence[float] | NDArray[np.float64]) -> list[float]:
    return [float(number) for number in numbers]

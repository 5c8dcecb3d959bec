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
them. Nothing of ROS is imported before a link is made. The names of topics stand in `ros2_topics`;
messages are read by `ros2_reader` and written by `ros2_writer`, and this file has the node itself.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from gridpush_drake.errors import StationError
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.station.links.link import Link, LinkMessage, LinkRole, Record
from gridpush_drake.station.links.ros2.ros2_pictures import CAMERA_INFO, COLOR, DEPTH
from gridpush_drake.station.links.ros2.ros2_reader import Ros2Reader
from gridpush_drake.station.links.ros2.ros2_robot import RosRobot
from gridpush_drake.station.links.ros2.ros2_topics import (
    ARM_POSITIONS,
    ARM_TRAJECTORY,
    GRIPPER_POSITIONS,
    GRIPPER_TRAJECTORY,
    JOINT_STATES,
    NANOSECONDS,
    OBJECT_COVARIANCE,
    OBJECT_POSE,
    WRENCH,
    import_ros,
    name_object_topic,
)
from gridpush_drake.station.links.ros2.ros2_writer import Ros2Writer
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    PoseObservation,
)

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


NAMES = {
    ArmStatus: JOINT_STATES,
    ArmCommand: "the arm's commands",
    GripperStatus: f"{JOINT_STATES} of the gripper",
    GripperCommand: "the gripper's commands",
    Frame: COLOR,
}
"""What records are called in messages to the user, by their types."""


class Ros2Link(Link):
    """A node of ROS 2 as a `Link`.

    Attributes:
        place: see `Link`.
        node: the node, for what else is published.
    """

    place = "in this ROS domain"

    def __init__(self, role: LinkRole, robot: RosRobot, arguments: Sequence[str] = ()) -> None:
        """Makes the node with the topics of a role.

        Args:
            role: who speaks.
            robot: its names.
            arguments: of ROS, as they stand after `--ros-args` on a command line.

        Raises:
            StationError: ROS 2 is not there, or an argument will not do.
        """
        self._ros = import_ros()
        self._robot = robot
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
        load_known = role != LinkRole.CONTROL or robot.load == "effort"
        self._reader = Ros2Reader(robot, load_known, self.get_time)
        self._writer = Ros2Writer(self._ros, robot, self.publish)
        self._senders: dict[type, Callable[[Any], None]] = {}
        self._open(role)

    @property
    def load_known(self) -> bool:
        """Whether anything has said the load on the arm from outside."""
        return self._reader.load_known

    @property
    def where(self) -> str:
        """The network, in words."""
        return f"ROS 2 as node {self.node.get_fully_qualified_name()}"

    def get_name(self, kind: type, number: int = 0) -> str:
        """Returns the topic of a type of records, or what else says it; see `Link`."""
        if kind is PoseObservation:
            return name_object_topic(OBJECT_POSE, number)
        return NAMES[kind]

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
        return self._reader.take_all()

    def send(self, record: Record) -> None:
        """Publishes a record; one that the role does not speak of is left alone."""
        send = self._senders.get(type(record))
        if send is not None:
            send(record)

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

    def _open(self, role: LinkRole) -> None:
        """Subscribes to what a role reads, and says how what it sends is published."""
        command = self._read_command_kind()
        if role in (LinkRole.CONTROL, LinkRole.TRACKER):
            self._subscribe("JointState", JOINT_STATES, self._reader.take_joints)
        if role == LinkRole.CONTROL:
            if self._robot.load == "wrench":
                self._subscribe("WrenchStamped", WRENCH, self._reader.take_wrench)
            for number in range(self._robot.others + 1):
                self._subscribe_to_object(number)
            if command == "trajectory":
                self._senders[ArmCommand] = self._writer.send_arm_trajectory
                self._senders[GripperCommand] = self._writer.send_gripper_trajectory
            else:
                self._senders[ArmCommand] = self._writer.send_arm_positions
                self._senders[GripperCommand] = self._writer.send_gripper_positions
        elif role == LinkRole.ROBOT:
            self._subscribe(
                "JointTrajectory", ARM_TRAJECTORY, self._reader.take_arm_trajectory, RELIABLE
            )
            self._subscribe(
                "Float64MultiArray", ARM_POSITIONS, self._reader.take_arm_positions, RELIABLE
            )
            if self._robot.gripper is not None:
                self._subscribe(
                    "JointTrajectory",
                    GRIPPER_TRAJECTORY,
                    self._reader.take_gripper_trajectory,
                    RELIABLE,
                )
                self._subscribe(
                    "Float64MultiArray",
                    GRIPPER_POSITIONS,
                    self._reader.take_gripper_positions,
                    RELIABLE,
                )
            self._senders[ArmStatus] = self._writer.send_arm_status
            self._senders[GripperStatus] = self._writer.send_gripper_status
            self._senders[PoseObservation] = self._writer.send_pose
        elif role == LinkRole.TRACKER:
            self._subscribe("Image", COLOR, self._reader.take_color, BEST_AVAILABLE)
            self._subscribe("Image", DEPTH, self._reader.take_depth, BEST_AVAILABLE)
            self._subscribe("CameraInfo", CAMERA_INFO, self._reader.take_camera_info)
            self._senders[PoseObservation] = self._writer.send_pose
        else:
            self._senders[Frame] = self._writer.send_picture

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
            partial(self._reader.take_pose, number=number),
        )
        self._subscribe(
            "PoseWithCovarianceStamped",
            name_object_topic(OBJECT_COVARIANCE, number),
            partial(self._reader.take_covariance, number=number),
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

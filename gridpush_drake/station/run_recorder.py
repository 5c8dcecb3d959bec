"""`RunRecorder`: writes a run as an MCAP file with standard ROS 2 messages, for Foxglove, too.

While a task runs, `note` reads what changes; `write` adds what the identifier saw in between, and
writes one file. It needs the package `rosbags`, and no ROS:

    /object_pose, /tip_pose      geometry_msgs/PoseStamped, as the learner read them
    /joint_states                sensor_msgs/JointState of the arm
    /wrench                      geometry_msgs/WrenchStamped on the arm's flange
    /center_of_mass              geometry_msgs/PoseWithCovarianceStamped, with each estimate
    /push                        nav_msgs/Path, with each push that begins
    /phase                       std_msgs/String, whenever the robot does something else
    /camera/color/compressed     sensor_msgs/CompressedImage (JPEG), with a color and depth camera

Poses are in the frame `world`, times are those of the run, from 0. `gridpush import bag` reads the
same pushes from it again.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from gridpush_drake.extras import import_extra
from gridpush_drake.files import write_whole
from gridpush_drake.geometry.se2 import Array, make_rotation
from gridpush_drake.identification.result import Identification, calc_center_of_mass
from gridpush_drake.station.arm import MakeControlPlant
from gridpush_drake.station.lcm.picture_messages import JPEG_QUALITY
from gridpush_drake.station.links.ros2 import WORLD, list_joints
from gridpush_drake.station.links.tip_load import TipLoad
from gridpush_drake.station.robot import GetRobotInPlant
from gridpush_drake.station.task import StationTask
from gridpush_drake.systems.messages import PushCommand

NANOSECONDS = 10**9
"""Nanoseconds in a second."""

VERSION = 9
"""Version of the bag's format."""

CAMERA = "rgbd_noise"
"""Name of the system whose pictures are recorded."""

PICTURE_TOPIC = "/camera/color/compressed"

TOPICS = {
    "/object_pose": "geometry_msgs/msg/PoseStamped",
    "/tip_pose": "geometry_msgs/msg/PoseStamped",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/wrench": "geometry_msgs/msg/WrenchStamped",
    "/center_of_mass": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/push": "nav_msgs/msg/Path",
    "/phase": "std_msgs/msg/String",
    PICTURE_TOPIC: "sensor_msgs/msg/CompressedImage",
}
"""Types of the messages, by topic."""

POSE_COVARIANCE = 36
"""Numbers of a pose's covariance."""


def import_rosbags() -> tuple[ModuleType, Any]:
    """Imports what writes bags; returns `rosbags.rosbag2` and a store of ROS 2's message types.

    Raises:
        MissingExtraError: `rosbags` is not installed.
    """
    import_extra("rosbags", "bags")
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    return rosbag2, get_typestore(Stores.ROS2_JAZZY)


class RunRecorder:
    """Collects the messages of a run."""

    def __init__(self) -> None:
        """Is ready for a run.

        Raises:
            MissingExtraError: `rosbags` is not installed.
        """
        self._rosbag2, self._store = import_rosbags()
        self._messages: list[tuple[float, str, Any]] = []
        self._task: StationTask[Any] | None = None
        self._joints: list[str] = []
        self._load: TipLoad | None = None
        self._phase = ""
        self._push = 0
        self._estimate: Identification | None = None
        self._picture_time = -1.0

    def note(self, task: StationTask[Any]) -> None:
        """Reads what the robot, the learner and the camera of a running task show now."""
        if task is not self._task:
            self._begin(task)
        time = float(task.simulator.get_context().get_time())
        self._note_arm(task, time)
        self._note_doing(task, time)
        self._note_estimate(task, time)
        self._note_picture(task, time)

    def write(self, path: Path, record: Any, force: bool = False) -> None:
        """Writes the file, whole.

        Args:
            path: of the MCAP file.
            record: what the run came to; its stream has the poses.
            force: whether a file that exists is replaced.

        Raises:
            OutputError: it cannot be written, or exists.
        """
        for sample in record.stream:
            tip = np.asarray(sample.tip, float)
            if np.isfinite(tip).all():
                self._add(sample.t, "/tip_pose", self._make_pose(sample.t, tip, 0.0))
            x, y, theta = (float(number) for number in sample.pose)
            if np.isfinite([x, y, theta]).all():
                place = np.array([x, y, 0.0])
                self._add(sample.t, "/object_pose", self._make_pose(sample.t, place, theta))
        # `rosbags` writes a folder of its own; what is wanted is the one file in it.
        with TemporaryDirectory() as scratch:
            folder = Path(scratch) / "run"
            self._write_bag(folder)
            (file,) = folder.glob("*.mcap")
            write_whole(path, file.read_bytes(), force)

    def _write_bag(self, folder: Path) -> None:
        plugin = self._rosbag2.StoragePlugin.MCAP
        with self._rosbag2.Writer(folder, version=VERSION, storage_plugin=plugin) as writer:
            used = {topic for _, topic, _ in self._messages}
            connections = {
                topic: writer.add_connection(topic, kind, typestore=self._store)
                for topic, kind in TOPICS.items()
                if topic in used
            }
            for time, topic, message in sorted(self._messages, key=lambda row: row[0]):
                data = self._store.serialize_cdr(message, TOPICS[topic])
                writer.write(connections[topic], round(time * NANOSECONDS), bytes(data))

    def _begin(self, task: StationTask[Any]) -> None:
        """Looks at the robot of a task that is noted for the first time."""
        self._task = task
        station = task.station
        arm = GetRobotInPlant(station.plant, station.robot).arm
        self._joints = list_joints(station.plant, arm)
        self._load = TipLoad(MakeControlPlant(station.robot), station.robot)

    def _note_arm(self, task: StationTask[Any], time: float) -> None:
        robot = task.station.robot
        names = ("position_measured", "velocity_estimated", "torque_external")
        q, v, torque = (np.array(task.read(f"{robot.arm_model}.{name}")) for name in names)
        header = self._make_header(time)
        no_efforts = np.zeros(0)
        state = self._make("sensor_msgs/msg/JointState", header, self._joints, q, v, no_efforts)
        self._add(time, "/joint_states", state)
        assert self._load is not None
        force, moment = self._load.calc_wrench(q, torque)
        wrench = self._make(
            "geometry_msgs/msg/Wrench", self._make_vector(force), self._make_vector(moment)
        )
        header = self._make_header(time, robot.arm.flange_frame)
        self._add(time, "/wrench", self._make("geometry_msgs/msg/WrenchStamped", header, wrench))

    def _note_doing(self, task: StationTask[Any], time: float) -> None:
        """What the robot does, and the push that it has begun."""
        phase = str(task.read("executor.status").phase)
        if phase != self._phase:
            self._phase = phase
            self._add(time, "/phase", self._make("std_msgs/msg/String", phase))
        command = PushCommand.from_vector(task.read("push_command", task.controller))
        if command.command_id in (0, self._push):
            return
        self._push = command.command_id
        ends = [
            self._make_pose(time, np.append(point, 0.0), command.direction)
            for point in (command.start, command.end)
        ]
        self._add(time, "/push", self._make("nav_msgs/msg/Path", self._make_header(time), ends))

    def _note_estimate(self, task: StationTask[Any], time: float) -> None:
        """The center of mass in W and its covariance, which turns with the object."""
        found: Identification = task.read("estimate.identification")
        pose = np.array(task.read("object.pose"))
        if found is self._estimate or not found.push_names or not np.isfinite(pose).all():
            return
        self._estimate = found
        center, spread = calc_center_of_mass(found)
        R = make_rotation(pose[2])
        covariance = np.zeros((6, 6))
        covariance[:2, :2] = R @ spread @ R.T
        at = self._make_pose(time, np.append(pose[:2] + R @ center, 0.0), float(pose[2]))
        uncertain = self._make(
            "geometry_msgs/msg/PoseWithCovariance", at.pose, covariance.reshape(POSE_COVARIANCE)
        )
        message = self._make("geometry_msgs/msg/PoseWithCovarianceStamped", at.header, uncertain)
        self._add(time, "/center_of_mass", message)

    def _note_picture(self, task: StationTask[Any], time: float) -> None:
        """The newest picture of a simulated camera, once."""
        station = task.station
        rate = station.scenario.camera.rate
        if not station.HasSubsystemNamed(CAMERA) or time - self._picture_time < 1.0 / rate:
            return
        self._picture_time = time
        camera = station.GetSubsystemByName(CAMERA)
        color = task.read("color_image", camera).data[..., :3]
        bgr = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2BGR)
        _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        header = self._make_header(time, "camera")
        message = self._make("sensor_msgs/msg/CompressedImage", header, "jpeg", jpeg.ravel())
        self._add(time, PICTURE_TOPIC, message)

    def _add(self, time: float, topic: str, message: Any) -> None:
        self._messages.append((time, topic, message))

    def _make(self, kind: str, *fields: Any) -> Any:
        return self._store.types[kind](*fields)

    def _make_header(self, time: float, frame: str = WORLD) -> Any:
        seconds, nanoseconds = divmod(round(time * NANOSECONDS), NANOSECONDS)
        stamp = self._make("builtin_interfaces/msg/Time", seconds, nanoseconds)
        return self._make("std_msgs/msg/Header", stamp, frame)

    def _make_vector(self, numbers: Array) -> Any:
        return self._make("geometry_msgs/msg/Vector3", *(float(number) for number in numbers))

    def _make_pose(self, time: float, place: Array, yaw: float) -> Any:
        """A `PoseStamped` in the frame `world`, at a place (3,), upright but for its yaw."""
        turn = (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        pose = self._make(
            "geometry_msgs/msg/Pose",
            self._make("geometry_msgs/msg/Point", *(float(number) for number in place)),
            self._make("geometry_msgs/msg/Quaternion", *turn),
        )
        return self._make("geometry_msgs/msg/PoseStamped", self._make_header(time), pose)

"""`RunRecorder`: writes a run as an MCAP file with standard ROS 2 messages, for Foxglove, too.

While a task runs, `note` reads what changes; `write` adds what the identifier saw in between, and
writes one file. It needs the package `rosbags`, and no ROS:

    /object_pose, /tip_pose      geometry_msgs/PoseStamped, as the learner read them
    /tip_command                 geometry_msgs/PoseStamped: where the tip should be
    /joint_states                sensor_msgs/JointState of the arm
    /joint_commands              sensor_msgs/JointState: the positions that the joints should take
    /gripper_states              sensor_msgs/JointState of the fingers, with a gripper
    /gripper_command             std_msgs/Float64: the opening that is asked for, m, with a gripper
    /wrench                      geometry_msgs/WrenchStamped on the arm's flange
    /tf                          tf2_msgs/TFMessage: the frame `object`, as the learner read it
    /center_of_mass              geometry_msgs/PoseWithCovarianceStamped, with each estimate
    /cells                       visualization_msgs/MarkerArray: the cells, colored by the masses
                                 of each estimate, in the frame `object`
    /pusher                      std_msgs/String: the shape of a pusher that is no disc
    /push                        nav_msgs/Path, with each push that begins
    /other_0/object_pose, ...    in a task with several objects, the poses of those after the first,
    /other_0/center_of_mass, ... and their centers of mass; /tf and /cells have all objects
    /phase                       std_msgs/String, whenever the robot does something else
    /camera/color/compressed     sensor_msgs/CompressedImage (JPEG), with a color and depth camera

Other poses are in the frame `world`, times are those of the run, from 0. `gridpush import bag`
reads the same pushes from it again.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.extras import import_extra
from gridpush_drake.files import write_whole
from gridpush_drake.geometry.se2 import Array, make_rotation
from gridpush_drake.identification.result import Identification, calc_center_of_mass
from gridpush_drake.pushes.push_csv import describe_shape
from gridpush_drake.station.links.lcm.picture_messages import JPEG_QUALITY
from gridpush_drake.station.links.ros2.ros2_robot import list_joints
from gridpush_drake.station.links.ros2.ros2_topics import WORLD
from gridpush_drake.station.links.tip_load import TipLoad
from gridpush_drake.station.recording.run_recording import (
    GRIPPER_COMMAND_TOPIC,
    GRIPPER_TOPIC,
    OBJECT_FRAME,
    PICTURE_TOPIC,
    PUSHER_TOPIC,
    SEEN_SIZE,
    find_type,
    name_topic,
)
from gridpush_drake.station.robot.arm import MakeControlPlant
from gridpush_drake.station.robot.robot import GetRobotInPlant
from gridpush_drake.station.tasks.task import StationTask
from gridpush_drake.systems.base.messages import PushCommand
from gridpush_drake.units import NS_PER_S

BAG_VERSION = 9
"""Version of the bag's format."""

CAMERA_SYSTEM = "rgbd_noise"
"""Name of the system whose pictures are recorded."""

CELL_HEIGHT = 0.005
"""Height of the cells that are shown, m."""

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
        self._fingers: list[str] = []
        self._load: TipLoad | None = None
        self._phase = ""
        self._push = 0
        self._estimates: dict[str, Identification] = {}
        self._picture_time = -1.0

    def note(self, task: StationTask[Any]) -> None:
        """Reads what the robot, the learner and the camera of a running task show now."""
        if task is not self._task:
            self._begin(task)
        time = float(task.simulator.get_context().get_time())
        self._note_arm(task, time)
        self._note_commands(task, time)
        self._note_gripper(task, time)
        self._note_doing(task, time)
        self._note_other_poses(task, time)
        self._note_estimates(task, time)
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
                self._add(sample.t, "/tip_pose", self._make_pose(sample.t, tip, sample.yaw))
            x, y, theta = (float(number) for number in sample.pose)
            self._add_pose(sample.t, OBJECT_FRAME, x, y, theta)
        # `rosbags` writes a folder of its own; what is wanted is the one file in it.
        with TemporaryDirectory() as scratch:
            folder = Path(scratch) / "run"
            self._write_bag(folder)
            (file,) = folder.glob("*.mcap")
            write_whole(path, file.read_bytes(), force)

    def _write_bag(self, folder: Path) -> None:
        plugin = self._rosbag2.StoragePlugin.MCAP
        with self._rosbag2.Writer(folder, version=BAG_VERSION, storage_plugin=plugin) as writer:
            used = {topic for _, topic, _ in self._messages}
            connections = {
                topic: writer.add_connection(topic, find_type(topic), typestore=self._store)
                for topic in sorted(used)
            }
            for time, topic, message in sorted(self._messages, key=lambda row: row[0]):
                data = self._store.serialize_cdr(message, find_type(topic))
                writer.write(connections[topic], round(time * NS_PER_S), bytes(data))

    def _add_pose(self, time: float, name: str, x: float, y: float, theta: float) -> None:
        """Adds where an object was seen, m and rad; nothing if it was not seen."""
        if np.isfinite([x, y, theta]).all():
            place = np.array([x, y, 0.0])
            pose = self._make_pose(time, place, theta)
            self._add(time, name_topic(name, "/object_pose"), pose)
            self._add(time, "/tf", self._make_frame(time, name, place, theta))

    def _begin(self, task: StationTask[Any]) -> None:
        """Looks at the robot of a task that is noted for the first time."""
        self._task = task
        station = task.station
        models = GetRobotInPlant(station.plant, station.robot)
        self._joints = list_joints(station.plant, models.arm)
        self._fingers = []
        if models.gripper is not None:
            self._fingers = list_joints(station.plant, models.gripper)
        self._load = TipLoad(MakeControlPlant(station.robot), station.robot)
        shape = describe_shape(station.robot.shape)
        if shape:
            self._add(0.0, PUSHER_TOPIC, self._make("std_msgs/msg/String", shape))

    def _note_arm(self, task: StationTask[Any], time: float) -> None:
        robot = task.station.robot
        names = ("position_measured", "velocity_estimated", "torque_external")
        q, v, torque = (np.array(task.read(f"{robot.arm_model}.{name}")) for name in names)
        self._add(time, "/joint_states", self._make_joint_state(time, self._joints, q, v))
        assert self._load is not None
        force, moment = self._load.calc_wrench(q, torque)
        wrench = self._make(
            "geometry_msgs/msg/Wrench", self._make_vector(force), self._make_vector(moment)
        )
        header = self._make_header(time, robot.arm.flange_frame)
        self._add(time, "/wrench", self._make("geometry_msgs/msg/WrenchStamped", header, wrench))

    def _note_commands(self, task: StationTask[Any], time: float) -> None:
        """Where the tip should be, and which positions the arm's joints should take."""
        X_WP = task.read("executor.tip_pose")
        w, x, y, z = X_WP.rotation().ToQuaternion().wxyz()
        pose = self._make_turned_pose(time, X_WP.translation(), np.array([x, y, z, w]))
        self._add(time, "/tip_command", pose)
        # A real arm is told what its guard lets pass, a simulated one what its driver is told.
        station = task.station
        arm_port = f"{station.robot.arm_model}.position_commanded"
        port = "guard.position" if station.HasOutputPort("guard.position") else arm_port
        q = np.array(task.read(port))
        self._add(time, "/joint_commands", self._make_joint_state(time, self._joints, q))

    def _note_gripper(self, task: StationTask[Any], time: float) -> None:
        """Where the gripper's fingers are, and how far it should open."""
        if not self._fingers:
            return
        positions, velocities = np.split(np.array(task.read("gripper.state")), 2)
        state = self._make_joint_state(time, self._fingers, positions, velocities)
        self._add(time, GRIPPER_TOPIC, state)
        opening = float(task.read("grasp.gripper_position")[0])
        self._add(time, GRIPPER_COMMAND_TOPIC, self._make("std_msgs/msg/Float64", opening))

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

    def _note_other_poses(self, task: StationTask[Any], time: float) -> None:
        """Where the objects after the first are seen; the first one's poses are in the stream."""
        for name in task.object_names[1:]:
            x, y, theta = (float(number) for number in task.read(f"{name}.pose"))
            self._add_pose(time, name, x, y, theta)

    def _note_estimates(self, task: StationTask[Any], time: float) -> None:
        """What is newly known of each object: its center of mass, and its cells."""
        markers = []
        for number, (name, found) in enumerate(
            zip(task.object_names, task.read_estimates(), strict=True)
        ):
            pose = np.array(task.read(f"{name}.pose"))
            known = found is self._estimates.get(name) or not found.push_names
            if known or not np.isfinite(pose).all():
                continue
            self._estimates[name] = found
            self._add(
                time,
                name_topic(name, "/center_of_mass"),
                self._make_center(time, found, pose),
            )
            markers.append(self._make_cells(time, found, name, number))
        if markers:
            array = self._make("visualization_msgs/msg/MarkerArray", markers)
            self._add(time, "/cells", array)

    def _make_center(self, time: float, found: Identification, pose: Array) -> Any:
        """The center of mass in W and its covariance, which turns with the object at a pose."""
        center, spread = calc_center_of_mass(found)
        R = make_rotation(pose[2])
        covariance = np.zeros((6, 6))
        covariance[:2, :2] = R @ spread @ R.T
        at = self._make_pose(time, np.append(pose[:2] + R @ center, 0.0), float(pose[2]))
        uncertain = self._make(
            "geometry_msgs/msg/PoseWithCovariance", at.pose, covariance.reshape(POSE_COVARIANCE)
        )
        return self._make("geometry_msgs/msg/PoseWithCovarianceStamped", at.header, uncertain)

    def _note_picture(self, task: StationTask[Any], time: float) -> None:
        """The newest picture of a simulated camera, once."""
        station = task.station
        rate = station.scenario.camera.rate
        if not station.HasSubsystemNamed(CAMERA_SYSTEM) or time - self._picture_time < 1.0 / rate:
            return
        self._picture_time = time
        camera = station.GetSubsystemByName(CAMERA_SYSTEM)
        color = task.read("color_image", camera).data[..., :3]
        bgr = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2BGR)
        _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        header = self._make_header(time, "camera")
        message = self._make("sensor_msgs/msg/CompressedImage", header, "jpeg", jpeg.ravel())
        self._add(time, PICTURE_TOPIC, message)

    def _make_cells(self, time: float, found: Identification, name: str, number: int) -> Any:
        """The cells as one marker, a list of cubes in the frame of the object of a name."""
        obj = found.obj
        side = SEEN_SIZE * obj.cell_size
        points = [self._make_point(np.append(p_BC, CELL_HEIGHT / 2)) for p_BC in obj.p_BC]
        colors = [
            self._make("std_msgs/msg/ColorRGBA", *(float(fraction) for fraction in color), 1.0)
            for color in CellColors().calc_colors(found.params.mass, found.params.friction)
        ]
        marker_type = self._store.types["visualization_msgs/msg/Marker"]
        return marker_type(
            header=self._make_header(time, name),
            ns="cells",
            id=number,
            type=marker_type.CUBE_LIST,
            action=marker_type.ADD,
            pose=self._make_pose(time, np.zeros(3), 0.0).pose,
            scale=self._make_vector(np.array([side, side, CELL_HEIGHT])),
            color=self._make("std_msgs/msg/ColorRGBA", 0.0, 0.0, 0.0, 1.0),
            # 0 s: until the next estimate takes its place
            lifetime=self._make("builtin_interfaces/msg/Duration", 0, 0),
            frame_locked=True,
            points=points,
            colors=colors,
            texture_resource="",
            texture=self._make_no_picture(time),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=self._make("visualization_msgs/msg/MeshFile", "", np.zeros(0, np.uint8)),
            mesh_use_embedded_materials=False,
        )

    def _make_no_picture(self, time: float) -> Any:
        header = self._make_header(time)
        nothing = np.zeros(0, np.uint8)
        return self._make("sensor_msgs/msg/CompressedImage", header, "", nothing)

    def _add(self, time: float, topic: str, message: Any) -> None:
        self._messages.append((time, topic, message))

    def _make(self, kind: str, *fields: Any) -> Any:
        return self._store.types[kind](*fields)

    def _make_header(self, time: float, frame: str = WORLD) -> Any:
        seconds, nanoseconds = divmod(round(time * NS_PER_S), NS_PER_S)
        stamp = self._make("builtin_interfaces/msg/Time", seconds, nanoseconds)
        return self._make("std_msgs/msg/Header", stamp, frame)

    def _make_joint_state(
        self, time: float, names: list[str], positions: Array, velocities: Array | None = None
    ) -> Any:
        """A `JointState` without efforts; without velocities, too, where they are not given."""
        no_numbers = np.zeros(0)
        speeds = no_numbers if velocities is None else velocities
        header = self._make_header(time)
        kind = "sensor_msgs/msg/JointState"
        return self._make(kind, header, names, positions, speeds, no_numbers)

    def _make_vector(self, numbers: Array) -> Any:
        return self._make("geometry_msgs/msg/Vector3", *(float(number) for number in numbers))

    def _make_point(self, place: Array) -> Any:
        return self._make("geometry_msgs/msg/Point", *(float(number) for number in place))

    def _make_frame(self, time: float, name: str, place: Array, yaw: float) -> Any:
        """A `TFMessage` that says where the frame of the object of a name is in `world`."""
        turn = (float(number) for number in make_quaternion(yaw))
        transform = self._make(
            "geometry_msgs/msg/Transform",
            self._make_vector(place),
            self._make("geometry_msgs/msg/Quaternion", *turn),
        )
        kind = "geometry_msgs/msg/TransformStamped"
        stamped = self._make(kind, self._make_header(time), name, transform)
        return self._make("tf2_msgs/msg/TFMessage", [stamped])

    def _make_pose(self, time: float, place: Array, yaw: float) -> Any:
        """A `PoseStamped` in the frame `world`, at a place (3,), upright but for its yaw."""
        return self._make_turned_pose(time, place, make_quaternion(yaw))

    def _make_turned_pose(self, time: float, place: Array, turn: Array) -> Any:
        """A `PoseStamped` in the frame `world`, at a place (3,), with a quaternion (x, y, z, w)."""
        pose = self._make(
            "geometry_msgs/msg/Pose",
            self._make_point(place),
            self._make("geometry_msgs/msg/Quaternion", *(float(number) for number in turn)),
        )
        return self._make("geometry_msgs/msg/PoseStamped", self._make_header(time), pose)


def make_quaternion(yaw: float) -> Array:
    """Returns the quaternion (x, y, z, w) of a rotation by a yaw, rad, about the vertical."""
    return np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])

"""`RunRecording`: what `RunRecorder` wrote, read again; and the topics that both know.

Only files with the topics of a `RunRecorder` are read here. Poses of any bag are read by the
importer `pushes.importers.bag`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import import_extra
from gridpush_drake.files import is_file
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.units import NS_PER_S

PICTURE_TOPIC = "/camera/color/compressed"
"""Topic of the pictures, which only a run with a simulated color and depth camera has."""

GRIPPER_TOPIC = "/gripper_states"
GRIPPER_COMMAND_TOPIC = "/gripper_command"
"""Topics that only a run of a robot with a gripper has."""

PUSHER_TOPIC = "/pusher"
"""Topic of the shape of a pusher that is no disc, as a push log has it; the frame is the tip's."""

TOPIC_TYPES = {
    "/object_pose": "geometry_msgs/msg/PoseStamped",
    "/tip_pose": "geometry_msgs/msg/PoseStamped",
    "/tip_command": "geometry_msgs/msg/PoseStamped",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/joint_commands": "sensor_msgs/msg/JointState",
    GRIPPER_TOPIC: "sensor_msgs/msg/JointState",
    GRIPPER_COMMAND_TOPIC: "std_msgs/msg/Float64",
    "/wrench": "geometry_msgs/msg/WrenchStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/center_of_mass": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/cells": "visualization_msgs/msg/MarkerArray",
    PUSHER_TOPIC: "std_msgs/msg/String",
    "/push": "nav_msgs/msg/Path",
    "/phase": "std_msgs/msg/String",
    PICTURE_TOPIC: "sensor_msgs/msg/CompressedImage",
}
"""Types of the messages, by topic.

In a task with several objects, the topics of an object after the first stand below its name, such
as /other_0/object_pose; see `name_topic`."""

OBJECT_FRAME = "object"
"""Name of the first object, and of its frame."""

OTHER_PREFIX = "other_"
"""Beginning of the names of other objects, as the station's ports have them; a number follows."""

SEEN_SIZE = 0.95
"""Side of a cell that is shown, as a fraction of its true side: so that cells can be told apart."""

RECORDING_SUFFIX = ".mcap"
"""Ending of a recording's name."""

MAX_SHOWN = 200
"""Largest number of characters of another package's message that are shown."""


class RecordingError(GridPushError):
    """A file is no recording of a run, or lacks what is wanted of one."""


@dataclass(frozen=True, eq=False)
class RunRecording:
    """A recorded run.

    Attributes:
        path: the file.
        topics: by topic the messages, each with its time, s, in the order of times.
    """

    path: Path
    topics: dict[str, list[tuple[float, Any]]]

    @property
    def end(self) -> float:
        """Time of the last message, s."""
        return max(messages[-1][0] for messages in self.topics.values())

    def get(self, topic: str) -> list[tuple[float, Any]]:
        """Returns the messages of a topic, each with its time, s; none if it is not there."""
        return self.topics.get(topic, [])

    def require(self, topic: str) -> list[tuple[float, Any]]:
        """Returns the messages of a topic, each with its time, s.

        Raises:
            RecordingError: it has none.
        """
        if topic not in self.topics:
            raise RecordingError(
                f"{self.path}: holds no {topic}; expected a recording that gridpush wrote with "
                "--record"
            )
        return self.topics[topic]


def name_topic(name: str, topic: str) -> str:
    """Names the topic of an object: for the first one as in `TOPIC_TYPES`, else below its name."""
    return topic if name == OBJECT_FRAME else f"/{name}{topic}"


def split_topic(topic: str) -> tuple[str, str]:
    """Splits a topic into its object's name, and the topic as in `TOPIC_TYPES`."""
    name, slash, rest = topic[1:].partition("/")
    if name.startswith(OTHER_PREFIX) and name[len(OTHER_PREFIX) :].isdigit() and slash:
        return name, f"/{rest}"
    return OBJECT_FRAME, topic


def find_type(topic: str) -> str | None:
    """Returns the type of a topic's messages; None for a topic that no recording has."""
    return TOPIC_TYPES.get(split_topic(topic)[1])


def read_run(path: Path) -> RunRecording:
    """Reads a recording that `RunRecorder` wrote.

    Raises:
        MissingExtraError: `rosbags` is not installed.
        RecordingError: there is no such file, it cannot be read, or it is of something else.
    """
    if not is_file(path):
        raise RecordingError(f"{path}: there is no such file; expected a recording (.mcap)")
    import_extra("rosbags", "bags")
    from rosbags.highlevel import AnyReader

    topics: dict[str, list[tuple[float, Any]]] = {}
    try:
        with AnyReader([path]) as reader:
            ours = [each for each in reader.connections if find_type(each.topic) == each.msgtype]
            for connection, time, data in reader.messages(connections=ours):
                message = reader.deserialize(data, connection.msgtype)
                topics.setdefault(connection.topic, []).append((time / NS_PER_S, message))
    except Exception as error:  # a damaged file makes rosbags raise almost anything
        said = str(error)[:MAX_SHOWN] or type(error).__name__
        raise RecordingError(
            f"{path}: cannot be read: {said}; expected a recording (.mcap) that gridpush wrote "
            "with --record"
        ) from error
    if not topics:
        raise RecordingError(
            f"{path}: holds none of the topics of a run; expected a recording that gridpush wrote "
            "with --record"
        )
    return RunRecording(path, topics)


def read_planar_pose(message: Any) -> Array:
    """Returns the planar pose (x, y, yaw), m and rad, of a `geometry_msgs/Pose`."""
    turn = message.orientation
    yaw = 2.0 * float(np.arctan2(turn.z, turn.w))
    return np.array([message.position.x, message.position.y, yaw])


def read_point(message: Any) -> Array:
    """Returns the place (3,), m, of a `geometry_msgs/Point` or `Vector3`."""
    return np.array([message.x, message.y, message.z])

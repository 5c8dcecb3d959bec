"""Bags of ROS 1 and 2, written as a robot and a tracker would: each with a clock of its own that is not quite even."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from gridpush_drake.pushes.segmentation import Sample

EPOCH = 1_700_000_000
"""s."""


@dataclass(frozen=True)
class Topic:
    """A topic to be written.

    Attributes:
        name: of it.
        kind: of its messages, without the package.
        t: (K,) times in the headers, s.
        values: (K, 6) x, y, z, roll, pitch, yaw, m and rad; or (K, 3) a force, N.
        frame, child: of the messages.
    """

    name: str
    kind: str
    t: np.ndarray
    values: np.ndarray
    frame: str = "table"
    child: str = ""


PACKAGES = {"Odometry": "nav_msgs", "TFMessage": "tf2_msgs"}


def write_bag(folder: Path, form: str, topics: Sequence[Topic]) -> Path:
    """Writes a bag: "bag", "db3" or "mcap"; returns what is to be read."""
    ros1 = form == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:  # which does not count tf2_msgs among its common interfaces
        store.register(
            get_types_from_msg(
                "geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"
            )
        )
    path = folder / "pushes.bag" if ros1 else folder / f"pushes_{form}"
    plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    rows = []
    with Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin) as writer:
        for topic in topics:
            kind = f"{PACKAGES.get(topic.kind, 'geometry_msgs')}/msg/{topic.kind}"
            connection = writer.add_connection(topic.name, kind, typestore=store)
            for t, values in zip(topic.t, topic.values, strict=True):
                message = make_message(store.types, topic, float(t), values, ros1)
                rows.append((float(t), connection, serialize(message, kind)))
        for t, connection, data in sorted(rows, key=lambda row: row[0]):
            writer.write(connection, round((EPOCH + t) * 1e9), bytes(data))
    return path if ros1 or form == "db3" else next(path.glob("*.mcap"))


def make_message(types: dict, topic: Topic, t: float, values: np.ndarray, ros1: bool):
    def make(name: str, *fields):
        return types[name.replace("/", "/msg/")](*fields)

    stamp = make("builtin_interfaces/Time", EPOCH + int(t), int((t % 1) * 1e9))
    header = make("std_msgs/Header", *((0,) if ros1 else ()), stamp, topic.frame)
    vector = make("geometry_msgs/Vector3", *map(float, values[:3]))
    if topic.kind == "WrenchStamped":
        still = make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
        return make(
            "geometry_msgs/WrenchStamped", header, make("geometry_msgs/Wrench", vector, still)
        )
    turn = Rotation.from_euler("xyz", values[3:]).as_quat()
    quaternion = make("geometry_msgs/Quaternion", *map(float, turn))
    pose = make(
        "geometry_msgs/Pose", make("geometry_msgs/Point", *map(float, values[:3])), quaternion
    )
    if topic.kind == "PoseStamped":
        return make("geometry_msgs/PoseStamped", header, pose)
    if topic.kind == "Odometry":
        zero = make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
        twist = make(
            "geometry_msgs/TwistWithCovariance",
            make("geometry_msgs/Twist", zero, zero),
            np.zeros(36),
        )
        covered = make("geometry_msgs/PoseWithCovariance", pose, np.zeros(36))
        return make("nav_msgs/Odometry", header, topic.child, covered, twist)
    transform = make("geometry_msgs/Transform", vector, quaternion)
    stamped = make("geometry_msgs/TransformStamped", header, topic.child, transform)
    if topic.kind == "TransformStamped":
        return stamped
    other = make("geometry_msgs/TransformStamped", header, "something_else", transform)
    return make("tf2_msgs/TFMessage", [other, stamped])


def sample_topic(
    samples: Sequence[Sample], read: Callable[[Sample], Sequence[float]], rate: float, jitter: float, drop: float,
    seed: int, delay: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """What a sensor says of a stream: at uneven times, stamped not quite right and late, with frames dropped."""
    rng = np.random.default_rng(seed)
    t = np.array([sample.t for sample in samples])
    values = np.array([read(sample) for sample in samples])
    times = np.arange(t[0] + 1 / rate, t[-1] - 1 / rate, 1 / rate)
    times += rng.uniform(-0.3, 0.3, len(times)) / rate
    times = times[rng.random(len(times)) > drop]
    seen = np.column_stack([np.interp(times, t, column) for column in values.T])
    stamps = times + np.clip(rng.normal(0, jitter, len(times)), -0.2 / rate, 0.2 / rate)
    return stamps + delay, seen

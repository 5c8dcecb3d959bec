"""Importer of ROS bags: ROS 1, and ROS 2 as sqlite3 or MCAP, with the package `rosbags`.

Poses of the object and of the tip, on topics of their own or in `tf`, are brought to one clock:
positions by lines, orientations along great circles, and nothing across gaps. What comes of it is a
stream, and the pushes are cut from it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple
from warnings import warn

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from gridpush_drake.errors import MAX_NUMBER, PushLogError, PushLogWarning
from gridpush_drake.files import exists
from gridpush_drake.geometry.se2 import QUATERNION_TOLERANCE, Array, calc_yaw
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers import describe_pusher_option, describe_yaw_option
from gridpush_drake.pushes.importers.two_clocks import MAX_GAP, add_force, warn_of_delay
from gridpush_drake.pushes.pose_delay import choose_delay
from gridpush_drake.pushes.push_csv import choose_pusher
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import RecordOptions, Sample, SegmenterOptions
from gridpush_drake.pushes.stream import calc_velocities, make_samples, record_pushes, turn_samples
from gridpush_drake.units import S_PER_NS

BAGS_EXTRA = "pip install '.[bags]'"


FORCE_SIZE = 3
"""How many numbers a force has, and a position."""

MAX_SHOWN = 200
"""Largest number of characters of another package's message that are shown."""

MIN_MESSAGES = 2
"""Fewest messages of a topic that can be interpolated."""

MAX_RATE = 1000.0
"""Largest rate of the samples that are made of a bag, Hz."""

MAX_SAMPLES = 500_000
"""Largest number of samples that are made of a bag: 4 h at 30 Hz."""

MAX_SHIFT = 1e9
"""Largest delay that may be told, s."""

METADATA_FILE = "metadata.yaml"
"""File in the folder of a ROS 2 bag that says what the bag holds."""

TRANSFORMS_TYPE = "TFMessage"
"""Type of messages that hold the transforms of many frames."""

POSE_READERS = {
    "PoseStamped": lambda message: (message.pose.position, message.pose.orientation),
    "PoseWithCovarianceStamped": lambda message: (
        message.pose.pose.position,
        message.pose.pose.orientation,
    ),
    "Odometry": lambda message: (message.pose.pose.position, message.pose.pose.orientation),
    "TransformStamped": lambda message: (message.transform.translation, message.transform.rotation),
}
"""Functions that take position and orientation out of a message, by the last part of its type."""

WRENCH_TYPE = "WrenchStamped"
"""Type of messages that hold a force."""


class Track(NamedTuple):
    """What a topic tells.

    Attributes:
        what: the topic, and the frame in it.
        frame: the frame in which it is told; empty where the messages do not say.
        t: (K,) times from the bag's beginning, increasing, s.
        values: (K, 7) position, m, and quaternion (x, y, z, w); or (K, 3) a force, N.
    """

    what: str
    frame: str
    t: Array
    values: Array


@dataclass(frozen=True)
class BagImporter:
    """Convert the pushes in a ROS 1 bag or a ROS 2 bag (sqlite3 or MCAP).

    A topic is named as in the bag; of a tf topic also the child frame, after a colon: /tf:object.
    Times are those in the messages' headers.
    """

    file: ClassVar[str] = "BAG"
    source: ClassVar[str] = "a ROS 1 bag (.bag), or a ROS 2 bag (.db3, .mcap, or its folder)"
    example: ClassVar[str] = "--object object.yaml --object-topic /object --tip-topic /tip"

    obj: GridObject | None = field(
        default=None,
        metadata={
            "help": "The object that was pushed: an object file or a shipped object's name. It has "
            "to be given.",
            "name": "--object",
        },
    )
    object_topic: str = field(
        default="",
        metadata={
            "help": "Topic of the object's pose: PoseStamped, TransformStamped, Odometry, or tf "
            "with the object's frame after a colon, such as /tf:object. It has to be given."
        },
    )
    tip_topic: str = field(
        default="",
        metadata={
            "help": "Topic of the pose of the pusher's tip, of the same kinds. It has to be given."
        },
    )
    force_topic: str = field(
        default="",
        metadata={
            "help": "Topic of the force on the object (WrenchStamped, N), in the frame of the "
            "poses; without it the log holds no forces."
        },
    )
    object_delay: float | None = field(
        default=None,
        metadata={
            "help": "How much later the time stamps of the object's poses are than the moment at "
            "which the object was there, s. If it is not given, it is found from the pushes."
        },
    )
    tip_delay: float = field(
        default=0.0,
        metadata={
            "help": "How much later the time stamps of the tip's poses are than the moment at "
            "which the tip was there, s."
        },
    )
    rate: float = field(
        default=30.0, metadata={"help": "How many poses a second are taken from the bag, Hz."}
    )
    table_height: float = field(
        default=0.0, metadata={"help": "Height of the table's top in the bag's frame, m."}
    )
    engaged_below: float = field(
        default=SegmenterOptions.engaged_below,
        metadata={
            "help": "Height of the tip's center above the table, below which the tip can touch the "
            "object, m."
        },
    )
    pusher: str | None = field(default=None, metadata=describe_pusher_option("the tip's pose"))
    pusher_yaw: float = field(default=0.0, metadata=describe_yaw_option("the tip's pose"))
    negate_force: bool = field(
        default=False,
        metadata={
            "help": "Reverse the force's sign, for a sensor that tells the force on the pusher "
            "instead of that on the object."
        },
    )

    force_in_tip: bool = field(
        default=False,
        metadata={
            "help": "The force is told in the axes of the tip's pose, as by a sensor on the wrist "
            "(such as /netft_data beside /tip_pose), and turns with it."
        },
    )
    sensor_yaw: float = field(
        default=0.0,
        metadata={
            "help": "With --force-in-tip: how far the sensor's axes are turned about the tip's z "
            "axis, rad."
        },
    )

    def read(self, path: Path | str) -> tuple[PushLog, GridObject]:
        """Reads a bag: a file, or a ROS 2 bag's folder.

        Raises:
            PushLogError: `rosbags` is not installed; the bag cannot be read; a topic is not there,
                holds other messages or too few; frames differ; the clocks do not overlap; or there
                is no push in it.
        """
        path = Path(path)
        if self.obj is None:
            raise PushLogError(
                f"{path}: --object is missing; expected the file or name of the object that was "
                "pushed"
            )
        self._check_numbers()
        tracks = self._read_tracks(path)
        tip = tracks["--tip-topic"]
        thing = tracks["--object-topic"]
        force = tracks.get("--force-topic")
        for other in (tip, None if self.force_in_tip else force):
            if other is not None and thing.frame and other.frame and other.frame != thing.frame:
                raise PushLogError(
                    f"{path}: {other.what} is in frame {other.frame!r}, {thing.what} in "
                    f"{thing.frame!r}; expected the same frame"
                )
        late = (self.object_delay or 0.0) - self.tip_delay
        samples, rest = make_stream(path, thing, tip, self.rate, self.table_height, late)
        pusher = choose_pusher("--pusher", self.pusher, self.obj)
        if self.pusher is not None:
            x, y, z, w = tip.values[:, FORCE_SIZE:].T
            samples = turn_samples(samples, tip.t, calc_yaw(w, x, y, z), self.pusher_yaw)
        segmenter = SegmenterOptions(engaged_below=self.engaged_below)
        # The tip's stamps are late, too: the stream's delay is that of the object against the tip.
        given = None if self.object_delay is None else rest
        chosen = choose_delay(
            samples,
            self.obj,
            segmenter,
            given=given,
            given_by="--object-delay less --tip-delay",
            otherwise=rest,
        )
        record = RecordOptions(pose_delay=chosen.value)
        found = record_pushes(samples, self.obj, pusher, segmenter, record, source=str(path))
        if not len(found.log):
            raise PushLogError(
                f"{path}: holds no push of {self.obj.name}; expected a tip that comes below "
                f"{self.engaged_below:g} m and moves the object (--engaged-below, --table-height)"
            )
        for text in found.unusable:
            warn(f"{path}: {text}", PushLogWarning, stacklevel=2)
        warn_of_delay(path, chosen, offset=late - rest + self.tip_delay)
        if force is None:
            return found.log, self.obj
        if self.force_in_tip:
            force = turn_force(force, tip, self.sensor_yaw)
        values = -force.values if self.negate_force else force.values
        felt = (
            add_force(*each, force.t, values[:, :2])
            for each in zip(found.log, found.begins, strict=True)
        )
        return replace(found.log, pushes=tuple(felt)), self.obj

    def _check_numbers(self) -> None:
        """Raises PushLogError where an option's number is none that can be."""
        limits = {
            "object_delay": MAX_SHIFT,
            "tip_delay": MAX_SHIFT,
            "rate": MAX_RATE,
            "table_height": MAX_NUMBER,
            "engaged_below": MAX_NUMBER,
            "pusher_yaw": MAX_NUMBER,
            "sensor_yaw": MAX_NUMBER,
        }
        for name, limit in limits.items():
            value = getattr(self, name)
            if value is None:
                continue
            if not abs(value) <= limit or (name == "rate" and value <= 0):
                kind = "a positive number (Hz)" if name == "rate" else "a finite number"
                raise PushLogError(
                    f"--{name.replace('_', '-')}: is {value!r}; expected {kind}, at most {limit:g}"
                )

    def _read_tracks(self, path: Path) -> dict[str, Track]:
        wanted = {
            "--object-topic": self.object_topic,
            "--tip-topic": self.tip_topic,
            "--force-topic": self.force_topic,
        }
        with _Bag(path) as bag:
            return {
                option: _make_track(path, bag.read(option, name), name)
                for option, name in wanted.items()
                if name or option != "--force-topic"
            }


def make_stream(
    path: Path, thing: Track, tip: Track, rate: float, table_height: float, late: float = 0.0
) -> tuple[list[Sample], float]:
    """Brings two tracks to the tip's clock at a rate, from where both begin to where one ends.

    The object's track is taken to be late by whole periods only. So its poses are always
    interpolated at the same of its own times, and what is found from them does not depend on what
    was told.

    Args:
        path: of the bag, for messages.
        thing: the object's track.
        tip: the tip's.
        rate: of the samples, Hz.
        table_height: height of the table's top in the tracks' frame, m.
        late: how much later the object's stamps are than the tip's, s.

    Returns:
        The samples, and by how much the object's poses in them are still late, s: less than half a
        period, if `late` is right.

    Raises:
        PushLogError: the tracks do not overlap, or there would be more than MAX_SAMPLES.
    """
    shift = round(late * rate)
    thing = thing._replace(t=thing.t - shift / rate)
    first = max(thing.t[0], tip.t[0])
    last = min(thing.t[-1], tip.t[-1])
    if last <= first:
        spans = " and ".join(
            f"{track.what} {track.t[0]:.3f} to {track.t[-1]:.3f} s" for track in (thing, tip)
        )
        raise PushLogError(
            f"{path}: the clocks do not overlap: {spans}; expected both to run at the same time"
        )
    if (last - first) * rate > MAX_SAMPLES:
        raise PushLogError(
            f"{path}: {last - first:.0f} s at --rate {rate:g} make more than {MAX_SAMPLES} "
            "samples; expected a lower rate (Hz), or a part of the bag"
        )
    t = np.arange(math.ceil(first * rate), math.floor(last * rate) + 1) / rate
    if not len(t):
        raise PushLogError(f"{path}: is shorter than one period of --rate {rate:g} (Hz)")
    poses, tips = (interpolate(track, t) for track in (thing, tip))
    places = tips[:, :3] - (0.0, 0.0, table_height)
    yaw = np.full(len(t), np.nan)
    seen = np.isfinite(poses).all(axis=1)
    x, y, z, w = poses[seen, 3:].T
    yaw[seen] = np.unwrap(calc_yaw(w, x, y, z))
    samples = make_samples(
        t, places, calc_velocities(t, places), np.column_stack([poses[:, :2], yaw])
    )
    return samples, late - shift / rate


def interpolate(track: Track, t: Array) -> Array:
    """The poses (L, 7) of a track at times t (L,), s; NaN across a gap."""
    values = np.column_stack([np.interp(t, track.t, track.values[:, axis]) for axis in range(3)])
    turns = Slerp(track.t, Rotation.from_quat(track.values[:, 3:]))(
        np.clip(t, track.t[0], track.t[-1])
    ).as_quat()
    steps = np.diff(track.t)
    after = np.clip(np.searchsorted(track.t, t), 1, len(steps))
    gap = (steps[after - 1] > MAX_GAP * np.median(steps)) & (np.abs(track.t[after] - t) > 0)
    return np.where(gap[:, None], np.nan, np.hstack([values, turns]))


def turn_force(force: Track, tip: Track, sensor_yaw: float) -> Track:
    """Turns forces from the axes of a sensor on the tip to the frame of the tip's poses.

    Args:
        force: what the sensor tells.
        tip: the tip's poses, by the same clock.
        sensor_yaw: how far the sensor's axes are turned about the tip's z axis, rad.

    Returns:
        The forces at those times at which the tip was seen.
    """
    turns = interpolate(tip, force.t)[:, FORCE_SIZE:]
    seen = np.isfinite(turns).all(axis=1)
    turned = Rotation.from_quat(turns[seen]) * Rotation.from_rotvec([0.0, 0.0, sensor_yaw])
    return force._replace(frame=tip.frame, t=force.t[seen], values=turned.apply(force.values[seen]))


def _make_track(path: Path, messages: "list[_Message]", name: str) -> Track:
    """Makes a track of a topic's messages, in order of time; refuses what is none."""
    if len(messages) < MIN_MESSAGES:
        raise PushLogError(
            f"{path}: {name} has {len(messages)} messages; expected at least {MIN_MESSAGES}"
        )
    frames = sorted({message.frame for message in messages})
    if len(frames) > 1:
        raise PushLogError(
            f"{path}: {name} is told in several frames: {', '.join(frames)}; expected one"
        )
    t, first = np.unique([message.t for message in messages], return_index=True)
    values = np.array([messages[i].values for i in first])
    if not (np.abs(values) <= MAX_NUMBER).all():
        raise PushLogError(
            f"{path}: {name} holds a number that is not finite, or larger than {MAX_NUMBER:g}; "
            "expected m, N and a unit quaternion"
        )
    if len(t) < MIN_MESSAGES:
        raise PushLogError(
            f"{path}: {name} has the same time in all its headers; expected times that increase"
        )
    if values.shape[1] > FORCE_SIZE:
        norms = np.linalg.norm(values[:, FORCE_SIZE:], axis=1)
        wrong = np.flatnonzero(np.abs(norms - 1) > QUATERNION_TOLERANCE)
        if len(wrong):
            raise PushLogError(
                f"{path}: {name} holds an orientation of length {norms[wrong[0]]:.3g} at "
                f"t = {t[wrong[0]]:.3f} s; expected a unit quaternion"
            )
    return Track(name, frames[0], t, values)


class _Message(NamedTuple):
    """What is used of one message.

    Attributes:
        t: time of its header, or of the bag where that has none, s from the bag's beginning.
        frame: the frame that its header names.
        values: position, m, and quaternion (x, y, z, w); of a wrench the force, N.
    """

    t: float
    frame: str
    values: list[float]


class _Bag:
    """An open bag."""

    def __init__(self, path: Path) -> None:
        self._path = path
        if not exists(path):
            raise PushLogError(
                f"{path}: cannot be read: there is no such file or folder; expected a ROS bag"
            )
        if not (path.is_file() or path.is_dir()):
            raise PushLogError(
                f"{path}: cannot be read: is a pipe or a device, not a file; expected a ROS bag"
            )
        if path.is_dir() and not (path / METADATA_FILE).exists():
            raise PushLogError(
                f"{path}: is a folder without {METADATA_FILE}; expected the folder of a ROS 2 "
                "bag, or a "
                "file .bag, .mcap or .db3"
            )

    def __enter__(self) -> "_Bag":
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise PushLogError(
                f"{self._path}: bags are read with the package rosbags; get it with {BAGS_EXTRA}"
            ) from error
        try:
            # old ROS 2 bags do not say what their messages look like
            self._reader = AnyReader(
                [self._path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)
            )
            self._reader.open()
        except Exception as error:  # a damaged bag makes rosbags raise almost anything
            raise self._unreadable(error) from error
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def read(self, option: str, name: str) -> list[_Message]:
        """Reads all messages of a topic.

        Args:
            option: the option that names it, for messages.
            name: the topic; after a colon the frame, of a topic that holds many.

        Raises:
            PushLogError: the topic is not there, or is of another kind.
        """
        topic, _, child = name.partition(":")
        kinds = {
            connection.topic: connection.msgtype.rpartition("/")[2]
            for connection in self._reader.connections
        }
        if topic not in kinds:
            there = (
                ", ".join(f"{known} ({kind})" for known, kind in sorted(kinds.items())) or "nothing"
            )
            problem = f"there is no topic {topic!r}" if topic else f"{option} is missing"
            raise PushLogError(f"{self._path}: {problem}; the bag holds {there}")
        kind = kinds[topic]
        allowed = (WRENCH_TYPE,) if option == "--force-topic" else (*POSE_READERS, TRANSFORMS_TYPE)
        if kind not in allowed:
            raise PushLogError(
                f"{self._path}: {topic} holds {kind}; expected one of {', '.join(allowed)}"
            )
        if kind == TRANSFORMS_TYPE and not child:
            raise PushLogError(
                f"{self._path}: {topic} holds many frames; expected one after a colon, "
                f"{topic}:FRAME"
            )
        try:
            found = [
                made
                for t, message in self._messages(topic)
                for made in self._convert(kind, t, message, child)
            ]
        except Exception as error:
            raise self._unreadable(error) from error
        if kind == TRANSFORMS_TYPE and not found:
            raise PushLogError(
                f"{self._path}: {topic} has no frame {child!r}; it has {self._list_frames(topic)}"
            )
        return found

    def _messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yields time, ns, and content of each message of a topic."""
        connections = [
            connection for connection in self._reader.connections if connection.topic == topic
        ]
        for connection, t, data in self._reader.messages(connections=connections):
            yield t, self._reader.deserialize(data, connection.msgtype)

    def _convert(self, kind: str, t: int, message: Any, child: str) -> Iterator[_Message]:
        """Takes what is used out of one message.

        Args:
            kind: kind of the message, one of POSE_READERS, TF or WRENCH_TYPE.
            t: time at which the bag has it, ns.
            message: the message, as rosbags reads it.
            child: the frame whose transforms are meant, in a message of many.

        Yields:
            One entry for each pose or wrench in it.
        """
        if kind == TRANSFORMS_TYPE:
            chosen = [
                each
                for each in message.transforms
                if each.child_frame_id.strip("/") == child.strip("/")
            ]
            kind = "TransformStamped"
            messages = chosen
        else:
            messages = [message]
        for each in messages:
            if kind == WRENCH_TYPE:
                force = each.wrench.force
                values = [force.x, force.y, force.z]
            else:
                p, q = POSE_READERS[kind](each)
                values = [p.x, p.y, p.z, q.x, q.y, q.z, q.w]
            stamp = each.header.stamp
            stamped = stamp.sec * round(1 / S_PER_NS) + stamp.nanosec
            seconds = ((stamped or t) - self._reader.start_time) * S_PER_NS
            yield _Message(seconds, each.header.frame_id.strip("/"), values)

    def _list_frames(self, topic: str) -> str:
        """Names the frames of a topic of transforms, for a message."""
        return ", ".join(
            sorted(
                {
                    each.child_frame_id
                    for _, message in self._messages(topic)
                    for each in message.transforms
                }
            )
        )

    def _unreadable(self, error: Exception) -> PushLogError:
        """Makes the error that says why the bag cannot be read."""
        why = " ".join(str(error).split()) or type(error).__name__
        return PushLogError(f"{self._path}: cannot be read as a ROS bag: {why[:MAX_SHOWN]}")

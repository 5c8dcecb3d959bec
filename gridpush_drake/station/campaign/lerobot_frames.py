"""The frames of a recorded episode: what was observed and commanded at evenly spaced times.

`station.campaign.lerobot_dataset` writes them as a LeRobot dataset. Names and meanings:

    observation.state               joints' positions, rad; the tip's center p_WP, m; the force on
                                    the flange, N; with a gripper its fingers' positions, m
    observation.environment_state   the object's pose X_WB as it was seen, (x, y, theta), m and rad
    observation.images.camera       a picture, with a simulated color and depth camera
    action                          positions that the joints are told to take, rad; with a gripper
                                    the opening that it is told, m

A frame has of each the newest value at its time, never a later one.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.station.recording.run_recording import (
    GRIPPER_COMMAND_TOPIC,
    GRIPPER_TOPIC,
    PICTURE_TOPIC,
    RecordingError,
    RunRecording,
    read_planar_pose,
    read_point,
)
from gridpush_drake.station.tasks.task import OBSERVATION_PERIOD

FRAMES_PER_SECOND = round(1 / OBSERVATION_PERIOD)
"""Frames a second: as many as a recording has observations of the joints."""

SAME_TIME = 1e-6
"""Times that differ by less than this are the same, s."""

STATE_FEATURE = "observation.state"
ENVIRONMENT_FEATURE = "observation.environment_state"
PICTURES_FEATURE = "observation.images.camera"
ACTION_FEATURE = "action"
"""Names of the features, as LeRobot has them."""

TIP_NAMES = ("tip_x", "tip_y", "tip_z")
FORCE_NAMES = ("flange_force_x", "flange_force_y", "flange_force_z")
OBJECT_NAMES = ("object_x", "object_y", "object_theta")
OPENING_NAME = "gripper_opening"
"""Names of what has no name in the recording."""


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames of an episode, `FRAMES_PER_SECOND` of them in a second.

    Attributes:
        names: by feature, what its numbers are.
        values: by feature, its numbers (n, number of names).
        pictures: n pictures, as bytes of JPEG files; None without a camera.
    """

    names: dict[str, tuple[str, ...]]
    values: dict[str, Array]
    pictures: list[bytes] | None

    def __len__(self) -> int:
        """Returns the number of frames."""
        return len(self.values[STATE_FEATURE])


@dataclass(frozen=True, eq=False)
class _Signal:
    """Something that is known from time to time.

    Attributes:
        names: what its numbers are.
        times: (k,) increasing, s.
        values: (k, number of names).
    """

    names: tuple[str, ...]
    times: Array
    values: Array

    def sample(self, times: Array) -> Array:
        """Returns the newest values at some times (n,), s; where there is none yet, the first."""
        return self.values[find_newest(self.times, times)]


def find_newest(known: Array, times: Array) -> np.ndarray:
    """Returns which of the known times (k,) is the newest at each of some times (n,); else 0."""
    newest = np.searchsorted(known, times + SAME_TIME, side="right") - 1
    return np.maximum(newest, 0)


def make_frames(run: RunRecording) -> Frames:
    """Makes the frames of a recorded episode.

    The first is at the first observation of the joints, or when the object was first seen, if that
    is later: before, nothing can be said of it.

    Args:
        run: the recording.

    Raises:
        RecordingError: the recording lacks something, or is too short for a frame.
    """
    joints = _read_joints(run, "/joint_states")
    tip = _read_places(run)
    seen = _read_object(run)
    state = [joints, tip, _read_force(run)]
    commands = [_read_joints(run, "/joint_commands")]
    if run.get(GRIPPER_TOPIC):
        state.append(_read_joints(run, GRIPPER_TOPIC))
        commands.append(_read_opening(run))

    begin = max(signal.times[0] for signal in (*state, *commands, seen))
    end = joints.times[-1]
    count = int(np.floor((end - begin + SAME_TIME) * FRAMES_PER_SECOND)) + 1
    if count < 1:
        raise RecordingError(
            f"{run.path}: the object was not seen before the run ended; expected one frame at least"
        )
    times = begin + np.arange(count) / FRAMES_PER_SECOND
    parts = {STATE_FEATURE: state, ENVIRONMENT_FEATURE: [seen], ACTION_FEATURE: commands}
    names = {}
    values = {}
    for feature, signals in parts.items():
        names[feature] = tuple(name for signal in signals for name in signal.names)
        values[feature] = np.hstack([signal.sample(times) for signal in signals])
    return Frames(
        names=names,
        values=values,
        pictures=_read_pictures(run, times),
    )


def _make_signal(names: tuple[str, ...], rows: list[tuple[float, Any]]) -> _Signal:
    """Makes a signal of times, s, with their numbers."""
    times = [time for time, _ in rows]
    values = [numbers for _, numbers in rows]
    return _Signal(
        names=names,
        times=np.array(times),
        values=np.array(values, dtype=np.float64),
    )


def _read_joints(run: RunRecording, topic: str) -> _Signal:
    """The positions of joints, rad or m."""
    messages = run.require(topic)
    first = messages[0][1]
    rows = [(time, message.position) for time, message in messages]
    return _make_signal(tuple(first.name), rows)


def _read_places(run: RunRecording) -> _Signal:
    """The tip's center, m."""
    rows = [(time, read_point(message.pose.position)) for time, message in run.require("/tip_pose")]
    return _make_signal(TIP_NAMES, rows)


def _read_object(run: RunRecording) -> _Signal:
    """The object's pose as it was seen, m and rad."""
    rows = [(time, read_planar_pose(message.pose)) for time, message in run.require("/object_pose")]
    signal = _make_signal(OBJECT_NAMES, rows)
    # An angle that jumps by a turn would be a motion to whoever learns from it
    signal.values[:, 2] = np.unwrap(signal.values[:, 2])
    return signal


def _read_force(run: RunRecording) -> _Signal:
    """The force on the arm's flange, N."""
    rows = [(time, read_point(message.wrench.force)) for time, message in run.require("/wrench")]
    return _make_signal(FORCE_NAMES, rows)


def _read_opening(run: RunRecording) -> _Signal:
    """The opening that the gripper is told, m."""
    rows = [(time, [message.data]) for time, message in run.require(GRIPPER_COMMAND_TOPIC)]
    return _make_signal((OPENING_NAME,), rows)


def _read_pictures(run: RunRecording, times: Array) -> list[bytes] | None:
    """The newest picture at each of some times (n,), s; None without any."""
    messages = run.get(PICTURE_TOPIC)
    if not messages:
        return None
    known = np.array([time for time, _ in messages])
    pictures = [message.data.tobytes() for _, message in messages]
    return [pictures[i] for i in find_newest(known, times)]

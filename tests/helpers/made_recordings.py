"""Recordings of runs that were never run: everything in them is a known function of time."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gridpush_drake.pushes.segmentation import Sample
from gridpush_drake.station.recording.run_recorder import RunRecorder
from gridpush_drake.station.recording.run_recording import (
    GRIPPER_COMMAND_TOPIC,
    GRIPPER_TOPIC,
    PICTURE_TOPIC,
)

JOINTS = ["joint_1", "joint_2"]

SEEN_FROM = 0.25
"""Time at which the object is seen first, s."""


def find_joints(time: float) -> np.ndarray:
    """Positions (2,) of the joints, rad."""
    return np.array([np.sin(time), time])


def find_command(time: float) -> np.ndarray:
    """Positions (2,) that the joints are told to take, rad."""
    return find_joints(time) + 0.01


def find_pose(time: float) -> tuple[float, float, float]:
    """The object's pose; it turns through half a turn, where angles jump."""
    return (0.5 + 0.01 * time, -0.1, 3.0 + 0.2 * time)


def paint(time: float, size: tuple[int, int]) -> bytes:
    """A picture, all in one color, which is redder with time; height and width in pixels."""
    picture = np.zeros((*size, 3), np.uint8)
    picture[..., 2] = round(10 * time)
    picture[..., 0] = 200
    return cv2.imencode(".jpg", picture)[1].tobytes()


class MadeRecorder(RunRecorder):
    """Writes messages of what is made up, in the way in which those of a run are written."""

    def make_up(self, end: float, size: tuple[int, int] | None, gripper: bool) -> None:
        """Makes the messages of a run up to a time, s; with pictures of a size, and a gripper."""
        for step in range(round(10 * end) + 1):
            time = step / 10
            velocity = np.zeros(2)
            state = self._make_joint_state(time, JOINTS, find_joints(time), velocity)
            self._add(time, "/joint_states", state)
            command = self._make_joint_state(time, JOINTS, find_command(time))
            self._add(time, "/joint_commands", command)
            nothing = self._make_vector(np.zeros(3))
            felt = self._make_vector(np.array([time, 0.0, -1.0]))
            wrench = self._make("geometry_msgs/msg/Wrench", felt, nothing)
            header = self._make_header(time)
            stamped = self._make("geometry_msgs/msg/WrenchStamped", header, wrench)
            self._add(time, "/wrench", stamped)
            if gripper:
                fingers = np.array([-time, time])
                state = self._make_joint_state(time, ["left", "right"], fingers, velocity)
                self._add(time, GRIPPER_TOPIC, state)
                opening = self._make("std_msgs/msg/Float64", 2 * time)
                self._add(time, GRIPPER_COMMAND_TOPIC, opening)
            if size is not None and step % 2 == 0:
                self._add_picture(time, size)

    def _add_picture(self, time: float, size: tuple[int, int]) -> None:
        jpeg = np.frombuffer(paint(time, size), np.uint8)
        header = self._make_header(time, "camera")
        message = self._make("sensor_msgs/msg/CompressedImage", header, "jpeg", jpeg)
        self._add(time, PICTURE_TOPIC, message)


class MadeRecord:
    """The stream of a run that was never run."""

    def __init__(self, end: float) -> None:
        self.stream: list[Any] = []
        for step in range(round(20 * end) + 1):
            time = step / 20
            pose = find_pose(time) if time >= SEEN_FROM - 1e-9 else (np.nan, np.nan, np.nan)
            tip = (0.4, 0.1 * time, 0.02)
            self.stream.append(Sample(t=time, tip=tip, velocity=(0.0, 0.1, 0.0), pose=pose))


def write_made_run(
    path: Path, end: float, size: tuple[int, int] | None = None, gripper: bool = False
) -> None:
    """Writes a recording.

    Args:
        path: the MCAP file.
        end: time of its end, s.
        size: height and width of its pictures, pixels; None for no pictures.
        gripper: whether the robot has a gripper.
    """
    recorder = MadeRecorder()
    recorder.make_up(end, size, gripper)
    recorder.write(path, MadeRecord(end), force=True)

"""Shows a recorded run in the Rerun viewer; `rerun_view` shows one while it goes on."""

from pathlib import Path
from typing import Any

import numpy as np

from gridpush_drake.display.rerun_scene import RerunScene
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS, PusherShape
from gridpush_drake.geometry.se2 import Array, make_rotation
from gridpush_drake.pushes.push_csv import read_shape
from gridpush_drake.station.recording.run_recording import (
    PICTURE_TOPIC,
    PUSHER_TOPIC,
    SEEN_SIZE,
    RunRecording,
    read_planar_pose,
    read_point,
    split_topic,
)

POSE_TOPIC = "/object_pose"
"""Topic of a recording that has the object's poses."""

POSE_SIZE = 6
"""Rows of a pose's covariance in ROS 2."""


def show_run(scene: RerunScene, run: RunRecording) -> None:
    """Shows a recorded run: everything that is in the file, at the times when it was so.

    Args:
        scene: where it is shown.
        run: the recording.

    Raises:
        RecordingError: the recording has no poses of the object.
    """
    run.require(POSE_TOPIC)
    shown = _Shown(scene)
    moments = []
    for topic, messages in run.topics.items():
        moments += [(time, topic, message) for time, message in messages]

    # Of what was so at the same time, the poses come first: the rest may be relative to them
    moments.sort(key=lambda moment: (moment[0], split_topic(moment[1])[1] != POSE_TOPIC))
    for time, topic, message in moments:
        scene.set_time(time)
        shown.show(topic, message)


class _Shown:
    """Shows one message after the other."""

    def __init__(self, scene: RerunScene) -> None:
        self._scene = scene
        self._poses: dict[str, Array] = {}
        self._pushes = 0
        self._shape: PusherShape | None = None

    def show(self, topic: str, message: Any) -> None:
        """Shows a message of a topic."""
        scene = self._scene
        name, topic = split_topic(topic)
        if topic == POSE_TOPIC:
            self._poses[name] = read_planar_pose(message.pose)
            scene.show_object(self._poses[name], f"world/{name}")
        elif topic == PUSHER_TOPIC:
            self._shape = read_shape(Path(topic), 1, message.data)
        elif topic == "/tip_pose":
            yaw = float(read_planar_pose(message.pose)[2])
            tip = read_point(message.pose.position)
            scene.show_tip(tip, DEFAULT_PUSHER_RADIUS, shape=self._shape, yaw=yaw)
        elif topic == "/push":
            self._pushes += 1
            first, last = message.poses
            scene.show_push(
                start=read_point(first.pose.position)[:2],
                end=read_point(last.pose.position)[:2],
            )
        elif topic == "/center_of_mass":
            self._show_center(name, message.pose)
        elif topic == "/cells":
            self._show_cells(message)
        elif topic == "/phase":
            scene.say(message.data)
        elif topic == PICTURE_TOPIC:
            scene.show_picture(message.data.tobytes())
        elif topic == "/wrench":
            force = read_point(message.wrench.force)
            size = float(np.linalg.norm(force))
            scene.plot("felt/force_n", size)
        elif topic == "/joint_states":
            for name, position in zip(message.name, message.position, strict=True):
                scene.plot(f"joints/{name}", float(position))

    def _show_center(self, name: str, message: Any) -> None:
        """The center of mass of an object, which the message has in W, in the body frame."""
        if name not in self._poses:
            return
        x, y, yaw = self._poses[name]
        R_WB = make_rotation(yaw)
        p_WBcm = read_point(message.pose.position)[:2]
        full = np.asarray(message.covariance).reshape(POSE_SIZE, POSE_SIZE)
        covariance = full[:2, :2]
        self._scene.show_center(
            center=R_WB.T @ (p_WBcm - [x, y]),
            covariance=R_WB.T @ covariance @ R_WB,
            entity=f"world/{name}",
        )
        self._scene.plot("known/pushes", float(self._pushes))

    def _show_cells(self, message: Any) -> None:
        for marker in message.markers:
            points = [read_point(point)[:2] for point in marker.points]
            colors = [(color.r, color.g, color.b) for color in marker.colors]
            self._scene.show_cells(
                p_BC=np.array(points),
                side=marker.scale.x / SEEN_SIZE,
                colors=np.array(colors),
                entity=f"world/{marker.header.frame_id}",
            )

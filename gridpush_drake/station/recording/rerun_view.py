"""`RerunView`: shows a run in the Rerun viewer while it goes on, or writes a file for it.

It needs the package `rerun-sdk`. What there is to see is in `display.rerun_scene`. A recording is
shown by `station.recording.rerun_replay`.
"""

from typing import Any

import cv2
import numpy as np

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.display.rerun_scene import RerunScene
from gridpush_drake.identification.result import Identification
from gridpush_drake.station.links.lcm.picture_messages import JPEG_QUALITY
from gridpush_drake.station.recording.run_recorder import CAMERA_SYSTEM
from gridpush_drake.station.tasks.task import StationTask
from gridpush_drake.systems.base.messages import PushCommand


class RerunView:
    """Shows what changes in a run."""

    def __init__(self, target: str, force: bool = False) -> None:
        """Starts the viewer, or a file; arguments and errors are those of `RerunScene`."""
        self._scene = RerunScene(target, force)
        self._estimates: dict[str, Identification] = {}
        self._push = 0
        self._picture_time = -1.0

    def note(self, task: StationTask[Any]) -> None:
        """Shows what a running task knows and does now."""
        time = float(task.simulator.get_context().get_time())
        self._scene.set_time(time)
        self._show_places(task)
        self._show_push(task)
        self._show_estimates(task)
        self._show_picture(task, time)

    def finish(self) -> None:
        """Ends the run; a file is whole from then on."""
        self._scene.finish()

    def _show_places(self, task: StationTask[Any]) -> None:
        tip = np.array(task.read("pusher.state"))[:3]
        robot = task.station.robot
        yaw = float(task.read("pusher.yaw")[0])
        self._scene.show_tip(tip, robot.finger.tip_radius, robot.shape, yaw)
        self._scene.say(str(task.read("executor.status").phase))
        for name in task.object_names:
            pose = np.array(task.read(f"{name}.pose"))
            if np.isfinite(pose).all():
                self._scene.show_object(pose, f"world/{name}")

    def _show_push(self, task: StationTask[Any]) -> None:
        command = PushCommand.from_vector(task.read("push_command", task.controller))
        if command.command_id in (0, self._push):
            return
        self._push = command.command_id
        self._scene.show_push(command.start, command.end)

    def _show_estimates(self, task: StationTask[Any]) -> None:
        for name, found in zip(task.object_names, task.read_estimates(), strict=True):
            if found is self._estimates.get(name) or not found.push_names:
                continue
            self._estimates[name] = found
            colors = CellColors().calc_colors(found.params.mass, found.params.friction)
            self._scene.show_estimate(found, colors, f"world/{name}")

    def _show_picture(self, task: StationTask[Any], time: float) -> None:
        station = task.station
        rate = station.scenario.camera.rate
        if not station.HasSubsystemNamed(CAMERA_SYSTEM) or time - self._picture_time < 1.0 / rate:
            return
        self._picture_time = time
        color = task.read("color_image", station.GetSubsystemByName(CAMERA_SYSTEM)).data[..., :3]
        bgr = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2BGR)
        _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        self._scene.show_picture(jpeg.tobytes())

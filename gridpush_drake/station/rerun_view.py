"""`RerunView`: shows a run in the Rerun viewer, while it goes on or from a file.

It needs the package `rerun-sdk`. Below `world` there are the object's cells, colored by the masses
that are held for the likeliest, the ellipse in which the center of mass is, the finger's tip, the
push that is under way, and pictures; below `known` curves of how well the object is known.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.errors import OutputError
from gridpush_drake.extras import import_extra
from gridpush_drake.files import check_writable
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification, calc_center_of_mass
from gridpush_drake.station.lcm.picture_messages import JPEG_QUALITY
from gridpush_drake.station.run_recorder import CAMERA
from gridpush_drake.station.task import StationTask
from gridpush_drake.systems.messages import PushCommand

LIVE = "live"
"""In the place of a file: the viewer is started, and shows the run while it goes on."""

APPLICATION = "gridpush"

TIMELINE = "time"
"""Name of the run's time in the viewer, s."""

UNFINISHED = ".unfinished.rrd"
"""Ending of the file while the run goes on; it is renamed when it is whole."""

MILLIMETERS = 1e3
"""Millimeters in a meter."""

ELLIPSE_POINTS = 48
"""Corners of the polygon that stands for an ellipse."""

DEVIATIONS = 2.0
"""Standard deviations out to which the ellipse reaches."""

CELL_HEIGHT = 0.004
"""Height of the cells that are shown, m."""

LINE_RADIUS = 0.001
"""Half the width of lines, m."""

RED, BLACK, BLUE = (220, 40, 40), (20, 20, 20), (40, 90, 200)


class RerunView:
    """Says what changes in a run to Rerun."""

    def __init__(self, target: str, force: bool = False) -> None:
        """Starts the viewer, or a file.

        Args:
            target: "live", or the name of an `.rrd` file.
            force: whether a file that exists is replaced.

        Raises:
            MissingExtraError: `rerun-sdk` is not installed.
            OutputError: the file cannot be written, or exists.
        """
        self._rr = import_extra("rerun", "rerun")
        self._path = None if target == LIVE else check_writable(Path(target), force)
        self._scratch: Path | None = None
        self._stream = self._rr.RecordingStream(APPLICATION)
        if self._path is None:
            self._stream.spawn()
        else:
            self._scratch = self._path.with_name(self._path.name + UNFINISHED)
            self._stream.save(self._scratch)
        self._estimate: Identification | None = None
        self._push = 0
        self._picture_time = -1.0
        self._log("world", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def note(self, task: StationTask[Any]) -> None:
        """Shows what a running task knows and does now."""
        time = float(task.simulator.get_context().get_time())
        self._stream.set_time(TIMELINE, duration=time)
        self._show_places(task)
        self._show_push(task)
        self._show_estimate(task)
        self._show_picture(task, time)

    def finish(self) -> None:
        """Ends the recording; the file is whole from then on."""
        self._stream.flush()
        self._stream.disconnect()
        if self._path is not None and self._scratch is not None:
            try:
                self._scratch.replace(self._path)
            except OSError as error:
                raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error

    def _log(self, entity: str, value: Any, *, static: bool = False) -> None:
        self._stream.log(entity, value, static=static)

    def _show_places(self, task: StationTask[Any]) -> None:
        tip = np.array(task.read("pusher.state"))[:3]
        radius = task.station.robot.finger.tip_radius
        self._log("world/tip", self._rr.Points3D([tip], radii=[radius], colors=[BLUE]))
        self._log("doing", self._rr.TextLog(str(task.read("executor.status").phase)))
        pose = np.array(task.read("object.pose"))
        if np.isfinite(pose).all():
            turn = self._rr.RotationAxisAngle((0.0, 0.0, 1.0), radians=float(pose[2]))
            place = self._rr.Transform3D(translation=(*pose[:2], 0.0), rotation=turn)
            self._log("world/object", place)

    def _show_push(self, task: StationTask[Any]) -> None:
        command = PushCommand.from_vector(task.read("push_command", task.controller))
        if command.command_id in (0, self._push):
            return
        self._push = command.command_id
        start = np.append(command.start, 0.0)
        way = np.append(command.end, 0.0) - start
        self._log("world/push", self._rr.Arrows3D(origins=[start], vectors=[way], colors=[RED]))

    def _show_estimate(self, task: StationTask[Any]) -> None:
        found: Identification = task.read("estimate.identification")
        if found is self._estimate or not found.push_names:
            return
        self._estimate = found
        obj = found.obj
        centers = np.column_stack([obj.p_BC, np.full(obj.n, CELL_HEIGHT / 2)])
        sizes = np.tile([obj.grid.cell_size, obj.grid.cell_size, CELL_HEIGHT], (obj.n, 1))
        colors = CellColors().calc_colors(found.params.mass, found.params.friction)
        cells = self._rr.Boxes3D(centers=centers, sizes=sizes, colors=colors, fill_mode="solid")
        self._log("world/object/cells", cells)

        # In the body frame, so that the ellipse moves with the object.
        center, covariance = calc_center_of_mass(found)
        ring = calc_ellipse(center, covariance)
        strip = np.column_stack([ring, np.full(len(ring), 2 * CELL_HEIGHT)])
        ellipse = self._rr.LineStrips3D([strip], colors=[BLACK], radii=[LINE_RADIUS])
        self._log("world/object/center_of_mass", ellipse)
        deviations = MILLIMETERS * np.sqrt(np.diag(covariance))
        for axis, deviation in zip("xy", deviations, strict=True):
            name = f"known/center_of_mass_{axis}_mm"
            self._log(name, self._rr.Scalars(float(deviation)))
        self._log("known/pushes", self._rr.Scalars(float(len(found.push_names))))

    def _show_picture(self, task: StationTask[Any], time: float) -> None:
        station = task.station
        rate = station.scenario.camera.rate
        if not station.HasSubsystemNamed(CAMERA) or time - self._picture_time < 1.0 / rate:
            return
        self._picture_time = time
        color = task.read("color_image", station.GetSubsystemByName(CAMERA)).data[..., :3]
        bgr = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2BGR)
        _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        picture = self._rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")
        self._log("camera", picture)


def calc_ellipse(center: Array, covariance: Array) -> Array:
    """The closed polygon (k, 2) about a center (2,) out to `DEVIATIONS` of a covariance (2, 2)."""
    values, vectors = np.linalg.eigh(covariance)
    angles = np.linspace(0.0, 2 * np.pi, ELLIPSE_POINTS + 1)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    return center + DEVIATIONS * (circle * np.sqrt(np.maximum(values, 0.0))) @ vectors.T

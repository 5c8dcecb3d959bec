"""`RerunScene`: an object, a finger and what is known of them, as the Rerun viewer shows them.

It needs the package `rerun-sdk`. What is shown when is decided elsewhere:
`station.recording.rerun_view` shows a run while it goes on, `cli.view.view_rerun` a model, a log or
a recording. The entities are

    world/object                      where the object is
    world/object/cells                its cells, in colors
    world/object/center_of_mass       the ellipse in which its center of mass is
    world/other_0/...                 the same of another object
    world/predicted                   its outline, where a model predicts it
    world/tip, world/push             the finger's tip, and the push that is under way
    camera                            pictures
    known/..., felt/..., joints/...   curves over time
    doing                             what is being done, in words
"""

from pathlib import Path
from typing import Any

import numpy as np
import shapely

from gridpush_drake.display.shapes import ELLIPSE_SIGMAS, make_ellipse
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import OutputError
from gridpush_drake.extras import import_extra
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification, calc_center_of_mass
from gridpush_drake.units import MM_PER_M

LIVE_VIEWER = "live"
"""In the place of a file: the viewer is started, and shows everything at once."""

RECORDING_SUFFIX = ".rrd"
"""Ending of the name of a file for the viewer."""

APPLICATION_NAME = "gridpush"
"""Name under which the viewer keeps what it shows."""

TIMELINE_NAME = "time"
"""Name of the time in the viewer, s."""


CELL_HEIGHT = 0.004
"""Height of the cells that are shown, m."""

LINE_RADIUS = 0.001
"""Half the width of lines, m."""

PUSH_COLOR = (220, 40, 40)
CENTER_COLOR = (20, 20, 20)
TIP_COLOR = (40, 90, 200)
PREDICTED_COLOR = (240, 140, 20)
"""Colors of the push, the ellipse, the finger's tip and what is predicted; sRGB."""


class RerunScene:
    """Tells the Rerun viewer, or a file for it, what there is."""

    def __init__(self, target: str, force: bool = False) -> None:
        """Starts the viewer, or a file.

        Args:
            target: "live", or the name of an `.rrd` file. If a viewer is open already, "live" shows
                everything there.
            force: whether a file that exists is replaced.

        Raises:
            MissingExtraError: `rerun-sdk` is not installed.
            OutputError: the file has a name of another form, cannot be written, or exists.
        """
        self._path: Path | None = None
        if target != LIVE_VIEWER:
            # The viewer tells what is in a file by the ending of its name
            if Path(target).suffix != RECORDING_SUFFIX:
                raise OutputError(
                    f"--rerun: is {target!r}; expected {LIVE_VIEWER}, or a name that ends with "
                    f"{RECORDING_SUFFIX}"
                )
            self._path = check_writable(Path(target), force)
        self._rr = import_extra("rerun", "rerun")
        self._stream = self._rr.RecordingStream(APPLICATION_NAME)
        self._force = force
        # Rerun's own writer waits for ever if the disk is full, so that a file is made in memory
        self._memory = None
        if self._path is None:
            self._stream.spawn()
        else:
            self._memory = self._stream.memory_recording()
        self._log("world", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def set_time(self, time: float) -> None:
        """Says when all that is shown from now on is so, s."""
        self._stream.set_time(TIMELINE_NAME, duration=time)

    def show_tip(
        self, p_WP: Array, radius: float, shape: PusherShape | None = None, yaw: float = 0.0
    ) -> None:
        """Shows what pushes at p_WP (3,), m: a ball of a radius, m, or the edge of a shape.

        Args:
            p_WP: (3,) center of the ball, or origin of the shape's frame, m.
            radius: of the ball, m.
            shape: of a pusher that is no disc.
            yaw: angle of the shape's frame, rad.
        """
        if shape is not None:
            edges = [
                lift(np.array(part.exterior.coords), float(p_WP[2]))
                for part in shapely.get_parts(shape.at([*p_WP[:2], yaw]))
            ]
            self._log("world/tip", self._rr.LineStrips3D(edges, colors=[TIP_COLOR]))
            return
        tip = self._rr.Points3D(
            positions=[p_WP],
            radii=[radius],
            colors=[TIP_COLOR],
        )
        self._log("world/tip", tip)

    def show_object(self, pose: Array, entity: str = "world/object") -> None:
        """Shows where the object is: X_WB (3,), m and rad; an entity below it moves with it."""
        x, y, theta = (float(number) for number in pose)
        turn = self._rr.RotationAxisAngle(
            axis=(0.0, 0.0, 1.0),
            radians=theta,
        )
        transform = self._rr.Transform3D(
            translation=(x, y, 0.0),
            rotation=turn,
        )
        self._log(entity, transform)

    def show_cells(
        self, p_BC: Array, side: float, colors: Array, entity: str = "world/object"
    ) -> None:
        """Shows the cells of the object of an entity.

        Args:
            p_BC: (n, 2) their middles in the body frame, m.
            side: side of a cell, m.
            colors: (n, 3) their colors, sRGB from 0 to 1.
            entity: the object.
        """
        # Boxes that stand on the table
        size = (side, side, CELL_HEIGHT)
        cells = self._rr.Boxes3D(
            centers=lift(p_BC, CELL_HEIGHT / 2),
            sizes=[size] * len(p_BC),
            colors=colors,
            fill_mode="solid",
        )
        self._log(f"{entity}/cells", cells)

    def show_outline(self, corners: Array, entity: str = "world/predicted") -> None:
        """Shows an outline (k, 2) in the body frame, m; `show_object` moves it."""
        # The line closes where it began
        ring = np.vstack([corners, corners[:1]])
        self._draw_line(f"{entity}/outline", lift(ring, CELL_HEIGHT), PREDICTED_COLOR)

    def show_center(self, center: Array, covariance: Array, entity: str = "world/object") -> None:
        """Shows where the center of mass is held to be, and how well it is known.

        Args:
            center: (2,) in the body frame, m. The ellipse moves with the object.
            covariance: (2, 2) in the body frame, m².
            entity: the object; curves over time are drawn for the first one.
        """
        # Above the cells, which would hide it
        ellipse = make_ellipse(ELLIPSE_SIGMAS**2 * covariance, center)
        ring = np.array(ellipse.exterior.coords)
        self._draw_line(f"{entity}/center_of_mass", lift(ring, 2 * CELL_HEIGHT), CENTER_COLOR)
        if entity != "world/object":
            return
        x_std, y_std = np.sqrt(np.diag(covariance))
        self.plot("known/center_of_mass_x_mm", MM_PER_M * float(x_std))
        self.plot("known/center_of_mass_y_mm", MM_PER_M * float(y_std))

    def show_estimate(
        self, found: Identification, colors: Array, entity: str = "world/object"
    ) -> None:
        """Shows the cells of an estimate, its center of mass, and of how many pushes it is.

        Args:
            found: the estimate.
            colors: (n, 3) of its cells, sRGB from 0 to 1.
            entity: the object.
        """
        self.show_cells(found.obj.p_BC, found.obj.cell_size, colors, entity)
        self.show_center(*calc_center_of_mass(found), entity)
        self.plot("known/pushes", float(len(found.push_names)))

    def show_push(self, start: Array, end: Array) -> None:
        """Shows a push as an arrow from `start` (2,) to `end` (2,), m."""
        origin = np.append(start, 0.0)
        way = np.append(end, 0.0) - origin
        arrow = self._rr.Arrows3D(
            origins=[origin],
            vectors=[way],
            colors=[PUSH_COLOR],
        )
        self._log("world/push", arrow)

    def show_picture(self, jpeg: bytes) -> None:
        """Shows a picture, as the bytes of a JPEG file."""
        picture = self._rr.EncodedImage(
            contents=jpeg,
            media_type="image/jpeg",
        )
        self._log("camera", picture)

    def plot(self, name: str, value: float) -> None:
        """Adds a value to a curve."""
        self._log(name, self._rr.Scalars(value))

    def say(self, text: str) -> None:
        """Adds a line to what is being done."""
        self._log("doing", self._rr.TextLog(text))

    def finish(self) -> None:
        """Ends it: a file is whole from then on, and a viewer stays open.

        Raises:
            OutputError: the file cannot be written.
        """
        self._stream.flush()
        content = None if self._memory is None else self._memory.drain_as_bytes()
        self._stream.disconnect()
        if self._path is not None and content is not None:
            write_whole(self._path, content, self._force)

    def drop(self) -> None:
        """Ends it without a file, where what was to be shown cannot be."""
        self._stream.disconnect()

    def _draw_line(self, entity: str, points: Array, color: tuple[int, int, int]) -> None:
        """Draws a line through points (k, 3), m."""
        lines = self._rr.LineStrips3D(
            [points],
            colors=[color],
            radii=[LINE_RADIUS],
        )
        self._log(entity, lines)

    def _log(self, entity: str, value: Any, *, static: bool = False) -> None:
        self._stream.log(entity, value, static=static)


def lift(points: Array, height: float) -> Array:
    """Returns points (k, 2) as points (k, 3) at a height, m."""
    heights = np.full(len(points), height)
    return np.column_stack([points, heights])

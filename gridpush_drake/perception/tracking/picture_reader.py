"""Tells table and object apart in the pictures of a camera that does not move.

The first picture tells what the table looks like. In each later one only the part in which an
object may be is looked at, see `PictureReader.look`. Moving an outline onto the edges found there
is done in `registration`, and choosing among poses in `tracking`. The theory is in
docs/theory/perception.md, section 1.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.detection.foreground import (
    Foreground,
    dilate,
    find_foreground,
    find_high,
    refine_boundary,
    remove_thin,
    score_pixels,
    to_lab,
)
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Color, Frame, Mask
from gridpush_drake.perception.images.table_plane import TablePlane
from gridpush_drake.perception.images.table_view import cover_pixels, find_off_table, look_at_table
from gridpush_drake.perception.tracking.registration import View

OCCLUDER_CLEARANCE = 0.015
"""A pixel that is this much higher than the object's top shows something else, such as the arm,
m."""

FLOOR_DEPTH = 0.05
"""A pixel that is this much lower than the table's top shows the floor and never the object,
whatever its color, m."""

FLOOR_MARGIN = 5
"""Beyond the table's edge, a pixel counts as floor if it is more than half of this from every pixel
where the depth camera sees something above the floor, pixels."""

COVER_MARGIN = 9
"""Width of the brush that widens what covers the object, pixels; half of it is added on each side,
because the cover's own edge is uncertain too."""

PAINT_SEED = 0
"""Seed of the table's colors that are painted over what covers it in the first frame."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """What the table looks like.

    Attributes:
        table: (height, width, 3) color of the table in each pixel, CIE L*a*b*.
        deviation: (3,) standard deviations of the table's color, CIE L*a*b*.
        plane: (3,) n/d, the normal of the table's plane in C over its distance, 1/m; None without
            depth.
        height_deviation: standard deviation of the heights measured on the table, m; 0 without
            depth.
    """

    table: NDArray[np.float32]
    deviation: Array
    plane: Array | None
    height_deviation: float


class UndistortedPicture(NamedTuple):
    """A frame without distortion.

    Attributes:
        color: (height, width, 3) uint8.
        depth: (height, width), m; None without a depth camera.
        covered: (height, width) bool, pixels that are known to show something else.
        t: time of the frame, s.
        explained: (height, width) bool, pixels that show another object whose pose is known; None
            where there is none.
    """

    color: Color
    depth: NDArray[np.float32] | None
    covered: Mask
    t: float
    explained: Mask | None = None


class PictureReader:
    """Tells table and objects apart in the pictures of one camera; it holds no state."""

    def __init__(self, camera: Camera, table_top: BaseGeometry | None = None) -> None:
        """Takes the camera.

        Args:
            camera: with X_WC; the table's top is at z = 0.
            table_top: polygon, W, m, beyond which the floor is seen; None where that is not known.
        """
        self.camera = camera
        self._ideal = camera.undistorted

        # The pixels beside the table, in the picture without distortion and as it was taken: the
        # first frame is painted over before its distortion is taken out.
        self._off_table: Mask | None = None
        self._off_table_raw: Mask | None = None
        if table_top is not None:
            self._off_table = find_off_table(self._ideal, table_top)
            self._off_table_raw = find_off_table(camera, table_top)

    def read(self, frame: Frame, unseen: Mask | None = None) -> UndistortedPicture:
        """Takes the distortion out of a frame.

        Args:
            frame: the frame.
            unseen: (height, width) bool, pixels of the frame which something covers, such as the
                arm; None where nothing is known to.

        Returns:
            The picture.

        Raises:
            ImageError: an image has another size than the camera.
        """
        self.camera.check_size(frame.color, "the color image")
        color = self.camera.undistort(frame.color)
        depth = None
        if frame.depth is not None:
            self.camera.check_size(frame.depth, "the depth image")
            depth = self.camera.undistort(frame.depth)
        covered = np.zeros((self.camera.height, self.camera.width), dtype=bool)
        if unseen is not None:
            self.camera.check_size(unseen, "the mask of what is covered")
            # No uint8, which would be interpolated between pixels.
            covered = self.camera.undistort(unseen.astype(np.uint16)) > 0
        return UndistortedPicture(color=color, depth=depth, covered=covered, t=frame.t)

    def learn(self, frame: Frame, unseen: Mask | None = None) -> tuple[Appearance, Mask]:
        """Learns what the table looks like.

        Args:
            frame: a frame that shows the table, whatever lies on it.
            unseen: see `read`.

        Returns:
            What the table looks like, and (height, width) bool, everything that is no table.

        Raises:
            ImageError: an image has another size than the camera.
            NoTableError: no table is in view.
        """
        # The table is fitted to a picture in which nothing else than table and objects is left: the
        # arm and the floor would draw the polynomial of its color and its plane away.
        table = self._paint_table(frame, unseen)
        painted, _, plane, _ = look_at_table(table.color, table.depth, self.camera)
        found = find_foreground(painted, plane)
        # The table's color in each pixel is what was seen less what differs from it.
        appearance = Appearance(
            table=to_lab(painted) - found.difference,
            deviation=found.deviation,
            plane=None if plane is None else -plane.normal / plane.offset,
            height_deviation=0.0 if plane is None else plane.deviation,
        )
        return appearance, found.mask

    def look(
        self,
        appearance: Appearance,
        picture: UndistortedPicture,
        window: tuple[slice, slice],
        height: float,
    ) -> View:
        """Tells an object from the table in a part of the picture.

        Args:
            appearance: what the table looks like.
            picture: the picture.
            window: rows and columns of the part.
            height: height of the object, m; what is higher by OCCLUDER_CLEARANCE covers it.

        Returns:
            What is object there.
        """
        difference = to_lab(picture.color[window]) - appearance.table[window]
        hidden = picture.covered[window]
        floor = np.zeros(difference.shape[:2], dtype=bool)
        plane = None
        high = None
        if picture.depth is not None and appearance.plane is not None:
            # Heights above the plane n/d that was fitted in the first frame (section 1).
            heights = self._calc_heights(picture.depth, appearance.plane, window)
            offset = float(1 / np.linalg.norm(appearance.plane))
            plane = TablePlane(
                normal=-appearance.plane * offset,
                offset=offset,
                heights=heights,
                deviation=appearance.height_deviation,
            )
            high = find_high(plane)

            # What stands above the object's top covers it, whether or not anybody said so.
            hidden = hidden | (heights > height + OCCLUDER_CLEARANCE)

            # The floor has another color than the table and would be taken for object. Beside the
            # table, depth that is missing is floor, too, but for a rim as wide as depth is blurred.
            floor = heights < -FLOOR_DEPTH
            if self._off_table is not None:
                above_floor = dilate(heights > -FLOOR_DEPTH, FLOOR_MARGIN)
                floor |= self._off_table[window] & ~above_floor

        if hidden.any():
            hidden = dilate(hidden, COVER_MARGIN)

        # What other objects explain says nothing of this one; their edges are known, unlike those
        # of a cover.
        if picture.explained is not None:
            hidden = hidden | picture.explained[window]

        # The score of each pixel and the boundary drawn by color, both of section 1.
        found: Foreground = score_pixels(difference, appearance.deviation, plane, high)
        rough = remove_thin(found.mask & ~hidden & ~floor)
        mask, coverage = refine_boundary(rough, found, hidden)
        rows, columns = window
        corner = np.array([columns.start, rows.start], dtype=np.float64)
        return View(coverage=coverage, mask=mask, covered=hidden, corner=corner)

    def _paint_table(self, frame: Frame, unseen: Mask | None) -> Frame:
        """Paints the table's colors over what covers it and over the floor."""
        hidden = np.zeros(frame.color.shape[:2], dtype=bool)
        if unseen is not None:
            hidden = unseen
        if self._off_table_raw is not None:
            hidden = hidden | self._off_table_raw
        color, depth = cover_pixels(frame.color, frame.depth, hidden, PAINT_SEED)
        return frame._replace(color=color, depth=depth)

    def _calc_heights(
        self, depth: NDArray[np.float32], plane: Array, window: tuple[slice, slice]
    ) -> NDArray[np.float32]:
        """Calculates how high above the table the pixels of a window are, m; NaN without depth.

        Args:
            depth: (height, width) of the whole picture, m.
            plane: (3,) n/d of the table.
            window: rows and columns.

        Returns:
            (h, w), m.
        """
        # The inverse depth n/d . r of the plane is linear in the pixel, as r is.
        across, down, level = np.linalg.solve(self._ideal.K.T, plane)
        rows, columns = window
        x = np.arange(columns.start, columns.stop)
        y = np.arange(rows.start, rows.stop)
        in_row = (across * x).astype(np.float32)
        in_column = (down * y + level).astype(np.float32)
        inverse_depth = in_column[:, None] + in_row

        # 1 - z (n/d).r is 0 on the plane, and 1/|n/d| the camera's distance.
        z = depth[window]
        heights = np.float32(1 / np.linalg.norm(plane)) * (1 - z * inverse_depth)
        heights[~(z > 0)] = np.nan
        return heights

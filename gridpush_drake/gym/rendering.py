"""`TablePicture`: pictures of episodes, from straight above."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gridpush_drake.geometry.se2 import Array

VIEW_HALF_SIDE = 1.0
"""Half the side of the picture of a large table, m."""

FLOOR_WIDTH = 0.1
"""Width of the floor that is seen around a small table, m."""

SUPERSAMPLING = 3
"""Number of pixels that are drawn for each pixel of the picture, along each side."""

LINE_WIDTH = 0.004
"""Width of lines, m."""

FLOOR_COLOR = (70, 72, 76)
"""Color of what is below the table, RGB from 0 to 255."""

TABLE_COLOR = (222, 205, 176)
"""Color of the table, RGB from 0 to 255."""

OBJECT_COLOR = (96, 120, 160)
"""Color of the object where its masses are not shown, RGB from 0 to 255."""

GOAL_COLOR = (40, 140, 60)
"""Color of the goal, RGB from 0 to 255."""

PUSH_COLOR = (200, 40, 40)
"""Color of the last push, RGB from 0 to 255."""

LIGHT_COLOR = np.array([196, 214, 240])
"""Color of the lightest cell (3,), RGB from 0 to 255."""

HEAVY_COLOR = np.array([120, 20, 60])
"""Color of the heaviest cell (3,), RGB from 0 to 255."""


class TablePicture:
    """A picture of a part of the table, seen from straight above; x to the right and y up."""

    def __init__(
        self, size: int, middle: Array, half: float, color: tuple[int, int, int] = FLOOR_COLOR
    ) -> None:
        """Makes an empty picture.

        Args:
            size: side of the picture, pixels.
            middle: (2,) place in the middle of it, W, m.
            half: half of the side that is seen, m.
            color: of what is not drawn over, RGB from 0 to 255.
        """
        self._middle = middle
        self._half = half
        self._scale = SUPERSAMPLING * size / (2 * half)
        self._image = Image.new("RGB", (SUPERSAMPLING * size,) * 2, color)
        self._brush = ImageDraw.Draw(self._image)

    def fill(self, points: Array, color: tuple[int, int, int]) -> None:
        """Draws the inside of a polygon with corners (K, 2), W, m."""
        self._brush.polygon(self._place(points), fill=color)

    def fill_disc(self, center: Array, radius: float, color: tuple[int, int, int]) -> None:
        """Draws a disc about a place (2,), W, m."""
        x, y = self._place(center[None])[0]
        reach = radius * self._scale
        self._brush.ellipse((x - reach, y - reach, x + reach, y + reach), fill=color)

    def draw_line(
        self, points: Array, color: tuple[int, int, int], width: float = LINE_WIDTH, times: int = 1
    ) -> None:
        """Draws a line through places (K, 2), W, m.

        Args:
            points: the places.
            color: RGB from 0 to 255.
            width: of the line, m; it is a whole number of fine pixels.
            times: how many times that the line is as wide.
        """
        pixels = times * max(1, round(width * self._scale))
        self._brush.line(self._place(points), fill=color, width=pixels)

    def finish(self) -> NDArray[np.uint8]:
        """The picture (size, size, 3), RGB."""
        return np.asarray(self._image.reduce(SUPERSAMPLING))

    def _place(self, points: Array) -> list[tuple[float, float]]:
        """Finds the pixels of places (K, 2), W, m."""
        pixels = ((np.asarray(points) - self._middle) * (1, -1) + self._half) * self._scale
        return [(float(x), float(y)) for x, y in pixels]


def color_cells(mass: Array, show_hidden: bool) -> list[tuple[int, int, int]]:
    """Chooses the colors of cells: one for all, or by their masses (n,), kg, which are hidden."""
    if not show_hidden:
        return [OBJECT_COLOR] * len(mass)
    log_mass = np.log(mass)
    fraction = (log_mass - log_mass.min()) / max(np.ptp(log_mass), np.finfo(float).tiny)
    colors = LIGHT_COLOR + fraction[:, None] * (HEAVY_COLOR - LIGHT_COLOR)
    return [(int(r), int(g), int(b)) for r, g, b in colors]

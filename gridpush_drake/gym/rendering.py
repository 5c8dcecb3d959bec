"""Pictures of an episode, from straight above."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.gym.episode import EpisodeState, PushGame

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


def draw_scene(
    game: PushGame, episode: EpisodeState, size: int, show_hidden: bool
) -> NDArray[np.uint8]:
    """Draws the table, the object, its goal and the finger's last path.

    Args:
        game: the game.
        episode: the episode that is drawn.
        size: side of the picture, pixels.
        show_hidden: whether cells are colored by their hidden masses.

    Returns:
        (size, size, 3) RGB; x to the right and y up.
    """
    corners = game.surface.corners
    obj = episode.shape.obj
    half = min(np.abs(corners).max() + FLOOR_WIDTH, VIEW_HALF_SIDE)
    # A table larger than the view is seen about the object.
    middle = np.zeros(2) if half < VIEW_HALF_SIDE else episode.true_pose[:2]
    scale = SUPERSAMPLING * size / (2 * half)
    image = Image.new("RGB", (SUPERSAMPLING * size,) * 2, FLOOR_COLOR)
    brush = ImageDraw.Draw(image)

    def place(points: Array) -> list[tuple[float, float]]:
        pixels = ((points - middle) * (1, -1) + half) * scale
        return [(float(x), float(y)) for x, y in pixels]

    brush.polygon(place(corners), fill=TABLE_COLOR)
    square = obj.cell_size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for p_BC, color in zip(obj.p_BC, _color_cells(episode, show_hidden), strict=True):
        brush.polygon(place(transform(episode.true_pose, p_BC + square)), fill=color)
    if episode.goal is not None:
        outline = np.array(obj.outline.exterior.coords)
        brush.line(
            place(transform(episode.goal, outline)),
            fill=GOAL_COLOR,
            width=max(1, round(LINE_WIDTH * scale)),
        )
    if episode.pushes:
        push = episode.pushes[-1].push
        brush.line(place(push.xy), fill=PUSH_COLOR, width=max(1, round(LINE_WIDTH * scale)))
        radius = push.radius * scale
        x, y = place(push.xy[-1:])[0]
        brush.ellipse((x - radius, y - radius, x + radius, y + radius), fill=PUSH_COLOR)
    return np.asarray(image.reduce(SUPERSAMPLING))


def _color_cells(episode: EpisodeState, show_hidden: bool) -> list[tuple[int, int, int]]:
    """Chooses the color of each cell."""
    mass = np.log(episode.hidden.mass)
    if not show_hidden:
        return [OBJECT_COLOR] * len(mass)
    fraction = (mass - mass.min()) / max(np.ptp(mass), np.finfo(float).tiny)
    colors = LIGHT_COLOR + fraction[:, None] * (HEAVY_COLOR - LIGHT_COLOR)
    return [(int(r), int(g), int(b)) for r, g, b in colors]

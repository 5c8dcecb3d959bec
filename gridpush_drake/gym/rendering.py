"""Pictures of an episode, from straight above."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.gym.episode import Episode, PushGame

VIEW, ROOM = 1.0, 0.1
"""m: how much of a large table is seen at least, and beyond the edge of a small one."""

SMOOTHING, LINE = 3, 0.004
"""Pixels drawn for each pixel of the picture, along each side, and width of lines, m."""

FLOOR, WOOD, PLAIN, GOAL, TIP = (
    (70, 72, 76),
    (222, 205, 176),
    (96, 120, 160),
    (40, 140, 60),
    (200, 40, 40),
)
"""Colors of what is below the table, the table, the object, its goal, and the last push; RGB."""

LIGHT, HEAVY = np.array([196, 214, 240]), np.array([120, 20, 60])
"""Of the lightest and the heaviest cell."""


def draw_scene(game: PushGame, episode: Episode, size: int, show_hidden: bool) -> NDArray[np.uint8]:
    """Draws the table, the object, its goal and the finger's last path; with the cells' hidden masses where asked.

    Returns:
        (size, size, 3) RGB; x to the right and y up.
    """
    corners, obj = game.surface.corners, episode.shape.obj
    half = min(np.abs(corners).max() + ROOM, VIEW)
    # a table larger than the view is seen about the object
    middle = np.zeros(2) if half < VIEW else episode.true_pose[:2]
    scale = SMOOTHING * size / (2 * half)
    image = Image.new("RGB", (SMOOTHING * size,) * 2, FLOOR)
    brush = ImageDraw.Draw(image)

    def place(points: Array) -> list[tuple[float, float]]:
        pixels = ((points - middle) * (1, -1) + half) * scale
        return [(float(x), float(y)) for x, y in pixels]

    brush.polygon(place(corners), fill=WOOD)
    square = obj.cell_size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for p_BC, color in zip(obj.p_BC, _color_cells(episode, show_hidden), strict=True):
        brush.polygon(place(transform(episode.true_pose, p_BC + square)), fill=color)
    if episode.goal is not None:
        outline = np.array(obj.outline.exterior.coords)
        brush.line(
            place(transform(episode.goal, outline)), fill=GOAL, width=max(1, round(LINE * scale))
        )
    if episode.pushes:
        push = episode.pushes[-1].push
        brush.line(place(push.xy), fill=TIP, width=max(1, round(LINE * scale)))
        (x, y), radius = place(push.xy[-1:])[0], push.radius * scale
        brush.ellipse((x - radius, y - radius, x + radius, y + radius), fill=TIP)
    return np.asarray(image.reduce(SMOOTHING))


def _color_cells(episode: Episode, show_hidden: bool) -> list[tuple[int, int, int]]:
    mass = np.log(episode.hidden.mass)
    if not show_hidden:
        return [PLAIN] * len(mass)
    share = (mass - mass.min()) / max(np.ptp(mass), np.finfo(float).tiny)
    return [tuple(map(int, LIGHT + part * (HEAVY - LIGHT))) for part in share]  # type: ignore[misc]

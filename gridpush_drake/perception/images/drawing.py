"""Outlines and masks drawn into photographs, for people to look at."""

import cv2
import numpy as np
from numpy.typing import ArrayLike
from shapely import Polygon

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Color, Mask

GREEN = (0, 255, 0)
"""Color of an object's outline, of its top and of its body frame's y axis in pictures."""

RED = (255, 0, 0)
"""Color of what was refused, and of the body frame's x axis in pictures."""

BLUE = (0, 80, 255)
"""Color of an object's bottom in pictures."""

LINE_WIDTH = 1
"""Width of the lines drawn in pictures, pixels."""

FRACTION_BITS = 4
"""Bits after the binary point in the coordinates that OpenCV's drawing takes."""

WHITE = (255, 255, 255)
"""Color of numbers."""

BLACK = (0, 0, 0)
"""Color of what is about numbers."""

NUMBER_FONT = cv2.FONT_HERSHEY_SIMPLEX
"""Font of numbers."""

FONT_SCALE = 0.8
"""Size of numbers; with 1 a digit is 22 pixels high."""

NUMBER_WIDTH = 2
"""Width of the strokes of numbers, pixels."""

NUMBER_HALO_WIDTH = 5
"""Width of the strokes of what is about them, pixels."""

AXIS_LENGTH = 0.03
"""Length of the body frame's axes in pictures, m."""


def draw_outline(
    color: Color, camera: Camera, outline: Polygon, height: float, X_WB: ArrayLike
) -> Color:
    """Draws an outline and its body frame into a photograph.

    Args:
        color: (height, width, 3) uint8, undistorted.
        camera: camera that took it, with X_WC.
        outline: outline on the table, W, m.
        height: height of the object, m; 0 draws its bottom alone.
        X_WB: (3,) pose (x, y, theta) of the body frame, W, m and rad.

    Returns:
        A new picture.
    """
    picture = color.copy()
    ideal = camera.undistorted

    def draw(points: Array, closed: bool, tint: tuple[int, int, int]) -> None:
        places = np.round(ideal.project(points) * 2**FRACTION_BITS).astype(np.int32)
        cv2.polylines(picture, [places], closed, tint, LINE_WIDTH, cv2.LINE_AA, FRACTION_BITS)

    # The bottom, and the top where that is another.
    levels = [(0.0, BLUE)]
    if height > 0:
        levels.append((height, GREEN))
    for z, tint in levels:
        for ring in (outline.exterior, *outline.interiors):
            xy = np.array(ring.coords)
            points = np.column_stack([xy, np.full(len(xy), z)])
            draw(points, True, tint)

    # The body frame's axes lie on the top, where they hide no part of the outline.
    x, y, theta = np.asarray(X_WB, dtype=np.float64)
    for angle, tint in ((theta, RED), (theta + np.pi / 2, GREEN)):
        tip = [x + AXIS_LENGTH * np.cos(angle), y + AXIS_LENGTH * np.sin(angle), height]
        draw(np.array([[x, y, height], tip]), False, tint)
    return picture


def draw_contours(color: Color, mask: Mask, tint: tuple[int, int, int] = RED) -> Color:
    """Draws the contours of a mask into a photograph; returns a new one."""
    picture = color.copy()
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, contours, -1, tint, LINE_WIDTH)
    return picture


def draw_number(color: Color, number: int, at: ArrayLike) -> Color:
    """Draws a number into a photograph.

    Args:
        color: (height, width, 3) uint8.
        number: the number.
        at: (2,) its middle, pixels.

    Returns:
        A new picture.
    """
    picture = color.copy()
    text = str(number)
    (width, height), _ = cv2.getTextSize(text, NUMBER_FONT, FONT_SCALE, NUMBER_HALO_WIDTH)
    x, y = np.round(np.asarray(at) + [-width / 2, height / 2]).astype(int)
    # White with black about it can be read on any color.
    for tint, thickness in ((BLACK, NUMBER_HALO_WIDTH), (WHITE, NUMBER_WIDTH)):
        cv2.putText(
            picture,
            text,
            org=(int(x), int(y)),
            fontFace=NUMBER_FONT,
            fontScale=FONT_SCALE,
            color=tint,
            thickness=thickness,
            lineType=cv2.LINE_AA,
        )
    return picture

"""Outlines of the eleven objects of the MIT push data set (Yu, Bauza, Fazeli, Rodriguez, IROS 2016).

Each is in the tracked body frame, m. The dimensions are those measured by the data set's authors, as
published in GitHub mcubelab/push-est-public (catkin_ws/src/pnpush_config/src/config/shape_db.py; butter from
catkin_ws/src/isam_pose/include/shape_db_butter_shape.h) and again in peterkty/pnpush. rect1, rect3 and hex
agree with where the pusher touches in the data; the areas of all agree with the plates' published masses
within 2.5 %.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

TRIANGLE_CORNER = (0.045, 0.045)
"""Where the triangles' right angle is: the frame is that of the 90 mm square the markers were put on, m."""

ELLIPSE_VERTICES = 120
"""Vertices of an ellipse's polygon; it then lies within 0.03 mm."""

HEXAGON_RADIUS = 0.0605
"""From the hexagon's centre to its vertices, the first on the x axis, m."""

BUTTER_HALF_MM = (
    (-27.46, 0.00), (-27.94, -3.73), (-29.67, -8.71), (-32.20, -13.67), (-35.23, -18.62),
    (-38.46, -23.55), (-41.61, -28.46), (-44.38, -33.34), (-46.47, -38.18), (-47.59, -42.99),
    (-47.49, -47.75), (-46.18, -52.42), (-43.79, -56.91), (-40.42, -61.16), (-36.21, -65.09),
    (-31.27, -68.64), (-25.72, -71.72), (-19.70, -74.27), (-13.31, -76.21), (-6.67, -77.46),
    (0.92, -78.02), (6.83, -77.66), (13.47, -76.59), (19.86, -74.81), (25.88, -72.41),
    (31.43, -69.45), (36.37, -66.02), (40.58, -62.17), (43.95, -57.99), (46.34, -53.56),
    (47.65, -48.93), (47.75, -44.19), (46.63, -39.39), (44.54, -34.55), (41.77, -29.68),
    (38.62, -24.78), (35.39, -19.85), (32.36, -14.91), (29.83, -9.95), (28.10, -4.98),
)  # fmt: skip
"""Half of the butterfly's outline; the other half is this one turned by pi about the origin, mm."""

MM = 1e-3
"""Metres in a millimetre."""


def _rectangle(along_x: float, along_y: float) -> NDArray[np.float64]:
    return np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (along_x / 2, along_y / 2)


def _triangle(along_x: float, along_y: float) -> NDArray[np.float64]:
    return TRIANGLE_CORNER - np.array([[0, 0], [along_x, 0], [0, along_y]])


def _ellipse(along_x: float, along_y: float) -> NDArray[np.float64]:
    angle = np.linspace(0, 2 * np.pi, ELLIPSE_VERTICES, endpoint=False)
    return np.column_stack([np.cos(angle) * along_x / 2, np.sin(angle) * along_y / 2])


def _hexagon() -> NDArray[np.float64]:
    angle = np.arange(6) * np.pi / 3
    return HEXAGON_RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])


def _butter() -> NDArray[np.float64]:
    half = np.array(BUTTER_HALF_MM) * MM
    return np.vstack([half, -half])


MIT_SHAPES: dict[str, Callable[[], NDArray[np.float64]]] = {
    "rect1": lambda: _rectangle(0.0900, 0.0900),
    "rect2": lambda: _rectangle(0.08991, 0.11258),
    "rect3": lambda: _rectangle(0.13501, 0.08994),
    "tri1": lambda: _triangle(0.12590, 0.12587),
    "tri2": lambda: _triangle(0.15100, 0.12587),
    "tri3": lambda: _triangle(0.17650, 0.12561),
    "ellip1": lambda: _ellipse(0.10500, 0.10500),
    "ellip2": lambda: _ellipse(0.10500, 0.13089),
    "ellip3": lambda: _ellipse(0.10500, 0.15700),
    "hex": _hexagon,
    "butter": _butter,
}
"""(k, 2) vertices by the data set's name of the shape, m."""

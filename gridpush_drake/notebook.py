"""What `repr` and a notebook show of records: plain sentences, small tables and drawings.

Drawings are SVG text, made without any plotting library, so that an object is shown at once. They
are no figures for a report: those are `gridpush_drake.report`'s.
"""

from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon

from gridpush_drake.units import DEG_PER_RAD, MM_PER_M

Array = NDArray[np.float64]
"""An array of floating-point numbers. Docstrings give its shape and its units."""


DRAWING_WIDTH = 360
"""Width of a drawing, pixels."""

DRAWING_MARGIN = 0.04
"""Room around a drawing, as a fraction of its longer side."""

VALUE_COLORS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))
"""Colors from the smallest to the largest value, red, green and blue from 0 to 255. Between them it
is interpolated. Their lightness grows evenly, so that they can be told apart in gray, too."""

MIN_ROOM = 1e-6
"""Size of a drawing of a single point, m."""

NO_VALUE = (222, 225, 230)
"""Color of a cell without a value."""


def describe_range(values: ArrayLike, unit: str = "") -> str:
    """Says which numbers there are, with their unit: "0.2 to 0.4", or "0.2" of equal ones."""
    numbers = np.asarray(values, dtype=np.float64)
    least = f"{numbers.min():.3g}"
    greatest = f"{numbers.max():.3g}"
    text = least if least == greatest else f"{least} to {greatest}"
    return f"{text} {unit}".rstrip()


def describe_pose(pose: ArrayLike) -> str:
    """Says where something lies: "(0.600, -0.100) m, 28.6°", for a pose (3,) in m and rad."""
    x, y, theta = np.asarray(pose, dtype=np.float64).tolist()
    return f"({x:.3f}, {y:.3f}) m, {theta * DEG_PER_RAD:.1f}°"


def describe_move(begin: ArrayLike, end: ArrayLike) -> str:
    """Says how far something went between poses (3,): "moved 12.3 mm and turned 4.5°"."""
    dx, dy, turn = (np.asarray(end, dtype=np.float64) - np.asarray(begin)).tolist()
    return f"moved {np.hypot(dx, dy) * MM_PER_M:.1f} mm and turned {turn * DEG_PER_RAD:.1f}°"


def count(number: int, noun: str) -> str:
    """Says how many there are: "1 push", "2 pushes", "3 presses", "4 cells"."""
    plural = f"{noun}es" if noun.endswith(("sh", "ss")) else f"{noun}s"
    return f"{number} {noun if number == 1 else plural}"


def make_page(text: str, *parts: str) -> str:
    """Makes the HTML of a record: what `repr` says of it, then drawings and tables."""
    return f"<div><p>{escape(text).replace(chr(10), '<br>')}</p>{''.join(parts)}</div>"


def make_table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Makes a table, as HTML, of a row of heads and rows of values; all are escaped."""
    head = "".join(f"<th>{escape(each)}</th>" for each in heads)
    body = ""
    for row in rows:
        cells = "".join(f"<td>{escape(str(value))}</td>" for value in row)
        body += f"<tr>{cells}</tr>"
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def draw_cells(
    outline: Polygon,
    p_BC: Array,
    cell_size: float,
    values: Array | None = None,
    legend: str = "",
) -> str:
    """Draws an object's outline and its cells, as SVG.

    Args:
        outline: contour with holes, body frame, m.
        p_BC: (n, 2) cell centers, body frame, m.
        cell_size: side of a cell, m.
        values: (n,) by which the cells are colored; all alike where None.
        legend: what the colors stand for, with the unit; the least and the greatest value follow.

    Returns:
        The drawing, x to the right and y up.
    """
    half = cell_size / 2
    points = np.vstack([np.asarray(outline.exterior.coords)[:, :2], p_BC - half, p_BC + half])
    scale, low, high = _fit(points)

    def place(points: Array) -> Array:
        """Brings points (k, 2), m, into the drawing, pixels, where y points down."""
        return np.column_stack([points[:, 0] - low[0], high[1] - points[:, 1]]) * scale

    side = cell_size * scale
    colors = [NO_VALUE] * len(p_BC) if values is None else choose_colors(values)
    corners = place(p_BC + [-half, half]).tolist()
    cells = "".join(
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{side:.1f}" height="{side:.1f}" '
        f'fill="rgb({red},{green},{blue})"/>'
        for (x, y), (red, green, blue) in zip(corners, colors, strict=True)
    )
    paths = []
    for ring in (outline.exterior, *outline.interiors):
        vertices = place(np.asarray(ring.coords)[:, :2])
        paths.append("M" + " L".join(f"{x:.1f},{y:.1f}" for x, y in vertices))
    rings = " ".join(paths)
    edge = f'<path d="{rings}" fill="none" stroke="#202428" stroke-width="1.5"/>'
    text = ""
    if values is not None:
        dark = f"{values.min():.3g}"
        light = f"{values.max():.3g}"
        text = f"<p>{escape(legend)}: dark {dark}, light {light}</p>"
    return _wrap(cells + edge, (high - low) * scale) + text


def draw_paths(paths: Sequence[tuple[Array, str, str]]) -> str:
    """Draws paths in the plane, as SVG.

    Args:
        paths: of each its points (K, 2), m, its color, and what it is, for the legend. Points that
            are not finite are left out.

    Returns:
        The drawing, x to the right and y up; empty where there is no point.
    """
    kept = [(points[np.isfinite(points).all(axis=1)], color, name) for points, color, name in paths]
    kept = [each for each in kept if len(each[0])]
    if not kept:
        return ""
    scale, low, high = _fit(np.vstack([points for points, _, _ in kept]))
    lines = ""
    for points, color, _ in kept:
        placed = np.column_stack([points[:, 0] - low[0], high[1] - points[:, 1]]) * scale
        joined = " ".join(f"{x:.1f},{y:.1f}" for x, y in placed)
        x, y = placed[-1]
        lines += f'<polyline points="{joined}" fill="none" stroke="{color}" stroke-width="2"/>'
        lines += f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{color}"/>'
    legend = "; ".join(f"{color}: {name}" for _, color, name in kept)
    return _wrap(lines, (high - low) * scale) + f"<p>{escape(legend)}</p>"


def choose_colors(values: Array) -> list[tuple[int, int, int]]:
    """Chooses colors for values (n,): red, green, blue from 0 to 255, darkest for the smallest."""
    least = float(values.min())
    spread = float(values.max()) - least
    fraction = (values - least) / spread if spread > 0 else np.full(len(values), 0.5)
    places = np.linspace(0.0, 1.0, len(VALUE_COLORS))
    channels = [np.interp(fraction, places, channel) for channel in zip(*VALUE_COLORS, strict=True)]
    rounded = np.rint(np.column_stack(channels)).astype(int).tolist()
    return [(red, green, blue) for red, green, blue in rounded]


def _fit(
    points: Array,
) -> tuple[float, Array, Array]:
    """Finds the scale, pixels a meter, and the lower and the upper corner (2,) of a drawing, m."""
    lowest = points.min(axis=0)
    highest = points.max(axis=0)
    room = DRAWING_MARGIN * max(float((highest - lowest).max()), MIN_ROOM)
    low = lowest - room
    high = highest + room
    return DRAWING_WIDTH / float((high - low).max()), low, high


def _wrap(content: str, size: Array) -> str:
    """Makes an SVG of its content and its size (2,), pixels."""
    width, height = size.tolist()
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.1f} {height:.1f}">{content}</svg>'
    )

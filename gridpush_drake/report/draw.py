"""Parts of all figures: cells and outlines, pushes, tables, panels, legends, scale bars, files.

Only matplotlib's objects are used (`make_grid` gives a Figure on an Agg canvas), never pyplot, so
that nothing global changes and drawing works in any thread and without a display.
"""

from collections.abc import Sequence
from io import BytesIO
from math import floor, log10
from typing import Any

import numpy as np
import shapely
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, PathPatch, Polygon
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike
from shapely.geometry.polygon import orient

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import ObjectError
from gridpush_drake.geometry.se2 import Array, rotate, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.units import M_PER_CM, MM_PER_M

INK_COLOR = "#2b2f36"
"""Color of outlines and text."""

PALE_COLOR = "#dfe5ec"
"""Color of cells without a value."""

FAINT_COLOR = "#a9b0b8"
"""Color of where things began, and of whatever stays in the background."""

TABLE_COLOR = "#f3efe6"
"""Color of a table's top."""

PART_COLORS = ("#7fa7c9", "#e3b778", "#8fbf9f", "#c99bb8", "#b3a6d9", "#a9a9a3")
"""Colors of an object's parts, in order of their labels, over again after the last."""

CELL_MAP = "viridis"
"""Color map of values where none is asked for."""

CELL_LINE = 0.4
"""Width of the lines between cells, points."""

OUTLINE_LINE = 1.4
"""Width of outlines, points."""

ARROW_LINE = 1.6
"""Width of arrows, points."""

TIP_LINE = 1.2
"""Width of the path of a finger, points."""

FONT_SIZE = 9
"""Size of text, points."""

OBJECT_MARGIN = 0.04
"""Room about an object that is drawn with axes, in its larger side."""

FRAME_FRACTION = 0.03
"""Room about an object that is drawn without axes, in its larger side."""

AXIS_FRACTION = 0.15
"""Length of the axes of a body frame, in the object's larger side."""

AXIS_NAME_GAP = 2
"""Gap between a frame's origin and its name, and between two names, points."""

SCALE_DROP = 0.05
"""Distance of the scale bar below an object, in the object's larger side."""

BAR_FRACTION = 0.04
"""Width of a color bar, in widths of the axes."""

BAR_GAP = 0.03
"""Distance of a color bar from the axes, in their width."""

MAX_TICKS = 5
"""Largest number of ticks on one axis or color bar."""

LEARNED_COLOR = "#2468a8"
"""Color of what the learned model says."""

PRIOR_COLOR = "#c9822b"
"""Color of what was held before learning."""

PAGE_WIDTH = 8.0
"""Width of a figure that is as wide as the page, inches."""

HALF_WIDTH = 4.6
"""Width of a figure about half as wide as the page, inches."""

BAR_ROOM = 0.55
"""Room beside a panel for its color bar, inches."""

TITLE_ROOM = 0.5
"""Room above a panel for its title, inches."""


SCALE_BAR_DIGITS = (5, 2, 1)
"""Digits with which a scale bar's length begins, the larger ones preferred."""

SCALE_FRACTION = 0.4
"""Longest scale bar, in the object's larger side."""

SVG_PADDING = 0.05
"""Room about what is drawn in an SVG file, inches."""

LEGEND_PAD = 4.5
"""Between the axes and a legend below them, in its font's size: room for ticks and a label."""


class ShownFigure(Figure):
    """A figure that a notebook shows as a picture, whether or not pyplot was ever imported.

    A notebook shows what has `_repr_png_`. Of matplotlib's own figures it shows a line of text
    unless pyplot was told before how to draw.
    """

    def _repr_png_(self) -> bytes:
        return to_png(self)


def to_png(figure: Figure) -> bytes:
    """Renders a figure as the bytes of a PNG file."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def draw_cells(
    ax: Axes,
    obj: GridObject,
    values: ArrayLike | None = None,
    *,
    cmap: str = CELL_MAP,
    label: str | None = None,
    limits: tuple[float, float] | None = None,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    alpha: float = 1.0,
) -> PolyCollection:
    """Draws the cells, colored by value, and the outline over them.

    Args:
        ax: where to draw, world frame, m; its aspect is made equal.
        obj: the object.
        values: (n,) one number per cell; None draws them all pale.
        cmap: name of a color map.
        label: adds a color bar with this title ("friction", "mass, g"); None adds none.
        limits: (low, high) ends of the color map; the values' own where None.
        pose: (x, y, theta) X_WB, m and rad.
        alpha: opacity, 0 to 1.

    Returns:
        The cells.

    Raises:
        ObjectError: `values` is not one number per cell.
    """
    cells = PolyCollection(
        _squares(obj, pose), edgecolors="white", linewidths=CELL_LINE, alpha=alpha
    )
    if values is None:
        cells.set_facecolor(PALE_COLOR)
    else:
        numbers = np.asarray(values, dtype=np.float64)
        if numbers.shape != (obj.n,):
            raise ObjectError(
                f"{obj.name}: values of shape {numbers.shape}; expected ({obj.n},), one for each "
                "cell"
            )
        cells.set_array(numbers)
        cells.set_cmap(colormaps[cmap])
        cells.set_clim(*(limits or (float(np.nanmin(numbers)), float(np.nanmax(numbers)))))
    ax.add_collection(cells)
    draw_outline(ax, obj, pose=pose, alpha=alpha)
    _frame(ax)
    if label is not None and values is not None:
        add_color_bar(ax, cells, label)
    return cells


def draw_parts(ax: Axes, obj: GridObject) -> PolyCollection:
    """Draws the cells in the colors of their parts, with a legend that counts them.

    Args:
        ax: where to draw, body frame, m.
        obj: the object.

    Returns:
        The cells.
    """
    labels, index, counts = np.unique(obj.labels, return_inverse=True, return_counts=True)
    colors = [PART_COLORS[i % len(PART_COLORS)] for i in range(len(labels))]
    cells = PolyCollection(
        _squares(obj, np.zeros(3)),
        facecolors=[colors[i] for i in index],
        edgecolors="white",
        linewidths=CELL_LINE,
    )
    ax.add_collection(cells)
    draw_outline(ax, obj)
    _frame(ax)
    handles = [
        Patch(facecolor=color, label=f"part {part}: {count} cell{'' if count == 1 else 's'}")
        for part, count, color in zip(labels, counts, colors, strict=True)
    ]
    ax.legend(
        handles=handles, fontsize=FONT_SIZE, frameon=False, loc="upper left", bbox_to_anchor=(1, 1)
    )
    return cells


def draw_outline(
    ax: Axes,
    obj: GridObject,
    *,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    color: str = INK_COLOR,
    linestyle: str = "solid",
    alpha: float = 1.0,
) -> PathPatch:
    """Draws the outline with its holes.

    Args:
        ax: where to draw, world frame, m.
        obj: the object.
        pose: (x, y, theta) X_WB, m and rad.
        color: color of the line.
        linestyle: style of the line, as matplotlib names it.
        alpha: opacity, 0 to 1.

    Returns:
        The outline.
    """
    outline = orient(obj.outline)
    rings = [
        transform(pose, np.array(ring.coords)[:, :2])
        for ring in (outline.exterior, *outline.interiors)
    ]
    path = Path.make_compound_path(*(Path(ring, closed=True) for ring in rings))
    patch = PathPatch(
        path,
        facecolor="none",
        edgecolor=color,
        linewidth=OUTLINE_LINE,
        linestyle=linestyle,
        alpha=alpha,
        joinstyle="round",
    )
    ax.add_patch(patch)
    return patch


def add_color_bar(ax: Axes, mappable: ScalarMappable, label: str) -> Colorbar:
    """Adds a slim color bar beside some axes, with a title."""
    figure = ax.get_figure(root=True)
    assert figure is not None, "the axes are on a figure"
    bar = figure.colorbar(mappable, ax=ax, fraction=BAR_FRACTION, pad=BAR_GAP)
    bar.set_label(label, fontsize=FONT_SIZE, color=INK_COLOR)
    bar.ax.tick_params(labelsize=FONT_SIZE - 1, colors=INK_COLOR)
    bar.ax.yaxis.set_major_locator(MaxNLocator(MAX_TICKS))
    bar.outline.set_visible(False)
    return bar


def _squares(obj: GridObject, pose: ArrayLike) -> list[Array]:
    """Calculates the corners (4, 2) of each cell in the world frame, m."""
    half = obj.cell_size / 2
    corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    # the cells are turned with the outline, where that was moved in the body frame
    if obj.outline_pose is not None:
        corners = rotate(obj.outline_pose.pose[2], corners)
    p_BQ = (obj.p_BC[:, None] + corners).reshape(-1, 2)
    return list(transform(pose, p_BQ).reshape(-1, 4, 2))


def _frame(ax: Axes) -> None:
    """Gives axes of a map equal scales, room, labels and few ticks."""
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(OBJECT_MARGIN)
    ax.autoscale_view()
    for spine in ("top", "right"):
        ax.spines[spine].set_visible(False)
    for axis, name in ((ax.xaxis, "x, m"), (ax.yaxis, "y, m")):
        axis.set_major_locator(MaxNLocator(MAX_TICKS))
        axis.label.set(text=name, fontsize=FONT_SIZE, color=INK_COLOR)
    ax.tick_params(labelsize=FONT_SIZE - 1, colors=INK_COLOR)


def draw_table(ax: Axes, corners: ArrayLike) -> None:
    """Draws a table's top by its corners (k, 2), m."""
    ax.add_patch(
        Polygon(
            np.asarray(corners),
            facecolor=TABLE_COLOR,
            edgecolor=FAINT_COLOR,
            linewidth=1.0,
            zorder=0,
        )
    )


def draw_arrow(ax: Axes, start: ArrayLike, end: ArrayLike, color: str) -> None:
    """Draws an arrow from `start` (2,) to `end` (2,), m."""
    style = {
        "arrowstyle": "-|>",
        "color": color,
        "linewidth": ARROW_LINE,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    ax.annotate("", tuple(np.asarray(end)), tuple(np.asarray(start)), arrowprops=style, zorder=5)


def draw_body_frame(ax: Axes, obj: GridObject) -> None:
    """Draws the axes x and y of an object's body frame, with its name, in a picture in that frame.

    Where the outline was moved in the body frame, the frame in which it was given is drawn, too.
    """
    x0, y0, x1, y1 = obj.outline.bounds
    length = AXIS_FRACTION * max(x1 - x0, y1 - y0)
    frames = [("body frame", np.zeros(3), INK_COLOR)]
    if obj.outline_pose is not None:
        frames.append(("outline's frame", np.array(obj.outline_pose.pose), PRIOR_COLOR))
    for i, (name, pose, color) in enumerate(frames):
        origin, x, y = transform(pose, length * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
        draw_arrow(ax, origin, x, color)
        draw_arrow(ax, origin, y, color)
        # names one below the other: the frames are near each other
        ax.annotate(
            name,
            tuple(origin),
            (AXIS_NAME_GAP, -(1 + i) * (FONT_SIZE + AXIS_NAME_GAP)),
            textcoords="offset points",
            fontsize=FONT_SIZE - 1,
            color=color,
            annotation_clip=False,
            zorder=5,
        )


def draw_numbered_push(ax: Axes, push: Push, number: int, color: str) -> None:
    """Draws an arrow along a push, the finger where it begins, and the push's number in it."""
    begin = push.xy[0]
    draw_arrow(ax, begin, push.xy[-1], color)
    draw_pusher(ax, push, 0.0, facecolor="white", edgecolor=color, zorder=6)
    ax.text(
        float(begin[0]),
        float(begin[1]),
        str(number),
        color=color,
        fontsize=FONT_SIZE - 2,
        ha="center",
        va="center_baseline",
        fontweight="bold",
        bbox={"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": color},
        zorder=7,
    )


def draw_tips(ax: Axes, push: Push, color: str) -> None:
    """Draws the path of the finger, open where it begins."""
    ax.plot(*push.xy.T, color=color, linewidth=TIP_LINE)
    for time, filling in ((0.0, "none"), (push.duration, color)):
        draw_pusher(ax, push, time, facecolor=filling, edgecolor=color)


def draw_pusher(ax: Axes, push: Push, time: float, **style: Any) -> None:
    """Draws a pusher's shape at a time of its push, s, with the style of a matplotlib patch."""
    if push.shape is None:
        x, y = push.tip_at([time])[0].tolist()
        ax.add_patch(Circle((x, y), push.radius, **style))
        return
    for part in shapely.get_parts(push.find_area(time)):
        ax.add_patch(Polygon(np.array(part.exterior.coords), **style))


def frame_points(ax: Axes, points: Sequence[ArrayLike], room: float) -> None:
    """Sets the axes' limits to all points (k, 2), m, with `room` about them, m."""
    together = np.concatenate([np.asarray(part) for part in points])
    low = together.min(axis=0) - room
    high = together.max(axis=0) + room
    ax.set_aspect("equal", adjustable="box", anchor="N")  # side by side, panels begin at one height
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])


def add_legend_below(ax: Axes, handles: Sequence[Line2D], columns: int) -> None:
    """Adds a legend below the axes and their labels."""
    ax.legend(
        handles=list(handles),
        fontsize=FONT_SIZE - 1,
        frameon=False,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        borderaxespad=LEGEND_PAD,
        ncols=columns,
    )


def make_panels(
    obj: GridObject, rows: int, columns: int, *, width: float = PAGE_WIDTH, max_height: float = 3.2
) -> tuple[Figure, np.ndarray]:
    """Makes a figure of panels that have the object's proportions.

    Args:
        obj: the object.
        rows: how many rows of panels.
        columns: how many columns.
        width: width of the figure, inches.
        max_height: largest height of a panel, inches.

    Returns:
        The figure, and its axes (rows, columns).
    """
    x0, y0, x1, y1 = obj.outline.bounds
    panel = max(width / columns - BAR_ROOM, 1.0)
    height = min(max(panel * (y1 - y0) / (x1 - x0), 0.8), max_height) + TITLE_ROOM
    return make_grid(rows, columns, width, height)


def make_grid(rows: int, columns: int, width: float, height: float) -> tuple[Figure, np.ndarray]:
    """Makes a figure of several axes.

    Args:
        rows: how many rows of axes.
        columns: how many columns.
        width: width of the figure, inches.
        height: height of a row, inches.

    Returns:
        The figure, and its axes (rows, columns).
    """
    figure = ShownFigure(figsize=(width, height * rows), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def make_chart(width: float, height: float) -> tuple[Figure, Axes]:
    """Makes a figure of one pair of axes, inches."""
    figure, axes = make_grid(1, 1, width, height)
    return figure, axes[0, 0]


def hide_axes(ax: Axes, title: str = "") -> None:
    """Leaves of the axes only the drawing and a title."""
    ax.set_axis_off()
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_title(title, fontsize=FONT_SIZE, color=INK_COLOR)


def frame_object(ax: Axes, obj: GridObject) -> None:
    """Sets the axes' limits to the object in its body frame, with room for a scale bar."""
    x0, y0, x1, y1 = obj.outline.bounds
    room = obj.cell_size / 2 + FRAME_FRACTION * max(x1 - x0, y1 - y0)
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(x0 - room, x1 + room)
    ax.set_ylim(y0 - room - SCALE_DROP * max(x1 - x0, y1 - y0), y1 + room)


def add_scale_bar(ax: Axes, obj: GridObject) -> None:
    """Adds a bar of a round length below the object, body frame."""
    x0, y0, x1, y1 = obj.outline.bounds
    length = calc_round_length(SCALE_FRACTION * max(x1 - x0, y1 - y0))
    below = y0 - obj.cell_size / 2 - SCALE_DROP * max(x1 - x0, y1 - y0)
    ax.plot([x0, x0 + length], [below, below], color=INK_COLOR, linewidth=2, solid_capstyle="butt")
    words = f" {length * 100:g} cm" if length >= M_PER_CM else f" {length * MM_PER_M:g} mm"
    ax.annotate(
        words,
        (x0 + length, below),
        va="center",
        fontsize=FONT_SIZE - 1,
        color=INK_COLOR,
        annotation_clip=False,
    )


def calc_round_length(longest: float) -> float:
    """Calculates the largest of 1, 2 or 5 times a power of ten that is at most `longest`."""
    power = 10.0 ** floor(log10(longest))
    return next(
        first * power for first in SCALE_BAR_DIGITS if first * power <= longest * (1 + 1e-9)
    )


def tidy(ax: Axes, x: str, y: str) -> None:
    """Names the axes of a chart and takes away what is not needed."""
    ax.set_xlabel(x, fontsize=FONT_SIZE, color=INK_COLOR)
    ax.set_ylabel(y, fontsize=FONT_SIZE, color=INK_COLOR)
    ax.tick_params(labelsize=FONT_SIZE - 1, colors=INK_COLOR)
    for spine in ("top", "right"):
        ax.spines[spine].set_visible(False)
    ax.grid(True, axis="both", color="#e8ebee", linewidth=0.6)
    ax.set_axisbelow(True)


def to_svg(figure: Figure) -> bytes:
    """Renders a figure as an SVG file, the same bytes every time."""
    buffer = BytesIO()
    with rc_context({"svg.hashsalt": "gridpush"}):
        figure.savefig(
            buffer,
            format="svg",
            metadata={"Date": None},
            bbox_inches="tight",
            pad_inches=SVG_PADDING,
        )
    return buffer.getvalue()

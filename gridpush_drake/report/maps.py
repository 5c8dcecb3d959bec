"""Maps over the cells: what was learned, how sure that is, and what the pushes could not tell.

Sizes, marks and colors that the report's figures share.
"""

from io import BytesIO
from math import floor, log10

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.report.draw import FONT, INK, add_color_bar, draw_cells

LEARNED = "#2468a8"
"""What the learned model says."""

BEFORE = "#c9822b"
"""What was held before learning."""

FAINT = "#a9b0b8"
"""Where things began, and whatever stays in the background."""

PAGE_WIDTH = 8.0
"""Of a figure as wide as the page, inches."""

HALF_WIDTH = 4.6
"""Of a figure half as wide, inches."""

BAR_ROOM = 0.55
"""Beside a panel, for its color bar, inches."""

TITLE_ROOM = 0.5
"""Above a panel, inches."""

CENTIMETER = 0.01
"""Lengths from here on are given in cm, shorter ones in mm; m."""

ROUND = (5, 2, 1)
"""What a round length begins with."""

SCALE_DROP = 0.05
"""How far below the object the scale bar is, in the object's larger side."""

FRAME_SHARE = 0.03
"""Room about the object, in its larger side."""

SCALE_SHARE = 0.4
"""A scale bar is at most this share of the object's width."""


def make_panels(
    obj: GridObject, rows: int, columns: int, *, width: float = PAGE_WIDTH, max_height: float = 3.2
) -> tuple[Figure, np.ndarray]:
    """Makes a grid of panels, each of the object's proportions.

    Args:
        obj: the object.
        rows: of panels.
        columns: of panels.
        width: of the whole, inches.
        max_height: of a panel, inches.

    Returns:
        The figure, on an Agg canvas, and its axes (rows, columns).
    """
    x0, y0, x1, y1 = obj.outline.bounds
    panel = max(width / columns - BAR_ROOM, 1.0)
    height = min(max(panel * (y1 - y0) / (x1 - x0), 0.8), max_height) + TITLE_ROOM
    return make_grid(rows, columns, width, height)


def make_grid(rows: int, columns: int, width: float, height: float) -> tuple[Figure, np.ndarray]:
    """Makes a figure of `rows` by `columns` axes, `width` inches in all and `height` inches a row."""
    figure = Figure(figsize=(width, height * rows), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def hide_axes(ax: Axes, title: str = "") -> None:
    """Leaves of the axes only the drawing and a title."""
    ax.set_axis_off()
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_title(title, fontsize=FONT, color=INK)


def frame_object(ax: Axes, obj: GridObject) -> None:
    """Sets the axes' limits to the object in its body frame, with room for its cells and a scale bar."""
    x0, y0, x1, y1 = obj.outline.bounds
    room = obj.cell_size / 2 + FRAME_SHARE * max(x1 - x0, y1 - y0)
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(x0 - room, x1 + room)
    ax.set_ylim(y0 - room - SCALE_DROP * max(x1 - x0, y1 - y0), y1 + room)


def add_scale_bar(ax: Axes, obj: GridObject) -> None:
    """Adds a bar of a round length below the object, body frame."""
    x0, y0, x1, y1 = obj.outline.bounds
    length = calc_round_length(SCALE_SHARE * max(x1 - x0, y1 - y0))
    below = y0 - obj.cell_size / 2 - SCALE_DROP * max(x1 - x0, y1 - y0)
    ax.plot([x0, x0 + length], [below, below], color=INK, linewidth=2, solid_capstyle="butt")
    ax.annotate(
        f" {_describe_length(length)}",
        (x0 + length, below),
        va="center",
        fontsize=FONT - 1,
        color=INK,
        annotation_clip=False,
    )


def calc_round_length(longest: float) -> float:
    """The greatest 1, 2 or 5 times a power of ten that is at most `longest`."""
    power = 10.0 ** floor(log10(longest))
    return next(first * power for first in ROUND if first * power <= longest * (1 + 1e-9))


def _describe_length(length: float) -> str:
    return f"{length * 100:g} cm" if length >= CENTIMETER else f"{length * 1000:g} mm"


def tidy(ax: Axes, x: str, y: str) -> None:
    """Names the axes of a chart and takes away what is not needed."""
    ax.set_xlabel(x, fontsize=FONT, color=INK)
    ax.set_ylabel(y, fontsize=FONT, color=INK)
    ax.tick_params(labelsize=FONT - 1, colors=INK)
    for spine in ("top", "right"):
        ax.spines[spine].set_visible(False)
    ax.grid(True, axis="both", color="#e8ebee", linewidth=0.6)
    ax.set_axisbelow(True)


def to_svg(figure: Figure) -> bytes:
    """Renders a figure as an SVG file, the same bytes every time."""
    from matplotlib import rc_context

    buffer = BytesIO()
    with rc_context({"svg.hashsalt": "gridpush"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


SPREAD_MAP = "BuPu"
"""Color map of standard deviations."""

SHARE_MAP = "YlGnBu"
"""Color map of what was learned, 0 to 1."""

GRAM = 1e3
"""Grams in a kilogram."""


def draw_learned_maps(result: Identification, truth: CellParameters | None = None) -> Figure:
    """Draws relative support friction and mass beside their standard deviations, and beside the truth if known.

    Relative friction is in units of the even share, so 1 everywhere where the object's friction is uniform.

    Args:
        result: the model.
        truth: what the object's cells really are.

    Returns:
        The figure: a row for friction and one for mass.
    """
    obj, known = result.obj, result.identifiability
    friction = known.relative_friction * obj.n
    rows = [
        (
            "relative friction", friction, known.relative_friction_std * obj.n,
            None if truth is None else truth.relative_friction() * obj.n, "× even share",
        ),
        (
            "mass", result.params.mass * GRAM, result.std.mass * GRAM,
            None if truth is None else truth.mass * (result.params.total_mass / truth.total_mass) * GRAM, "g a cell",
        ),
    ]  # fmt: skip
    figure, axes = make_panels(obj, len(rows), 2 if truth is None else 3)
    for ax_row, (name, estimate, spread, true, unit) in zip(axes, rows, strict=True):
        limits = _limits(estimate, true)
        columns = list(ax_row)
        if true is not None:
            _draw_map(columns.pop(0), obj, true, f"{name}: truth", unit, limits)
        _draw_map(columns[0], obj, estimate, f"{name}: learned", unit, limits)
        _draw_map(columns[1], obj, spread, "standard deviation", unit, _limits(spread, zero=True), SPREAD_MAP)
    add_scale_bar(axes[-1, 0], obj)
    return figure


def draw_unknown_maps(result: Identification) -> Figure:
    """Draws how much of each cell the pushes told, and the least and greatest mass it may have."""
    obj, known = result.obj, result.identifiability
    figure, axes = make_panels(obj, 1, 3)
    _draw_map(axes[0, 0], obj, known.learned_share * 100, "learned from the pushes", "%", (0, 100), SHARE_MAP)
    greatest = np.where(np.isfinite(known.mass_max), known.mass_max, np.nan) * GRAM
    limits = _limits(known.mass_min * GRAM, greatest)
    _draw_map(axes[0, 1], obj, known.mass_min * GRAM, "least possible mass", "g a cell", limits)
    _draw_map(axes[0, 2], obj, greatest, "greatest possible mass", "g a cell", limits)
    low, high = known.center_of_mass_box
    for ax in axes[0, 1:]:
        if np.isfinite(known.center_of_mass_box).all():
            ax.plot(*_rectangle(low, high), color="white", linewidth=3)
            ax.plot(*_rectangle(low, high), color=LEARNED, linewidth=1.5)
    add_scale_bar(axes[0, 0], obj)
    return figure


def _draw_map(
    ax: Axes,
    obj: GridObject,
    values: ArrayLike,
    title: str,
    unit: str,
    limits: tuple[float, float],
    cmap: str = "viridis",
) -> None:
    cells = draw_cells(ax, obj, values, limits=limits, cmap=cmap)
    hide_axes(ax, f"{title}, {unit}")
    frame_object(ax, obj)
    add_color_bar(ax, cells, "")


def _limits(
    values: NDArray[np.float64], others: NDArray[np.float64] | None = None, zero: bool = False
) -> tuple[float, float]:
    """Least and greatest of all, a little apart."""
    together = values if others is None else np.concatenate([values, others])
    low, high = (0.0 if zero else float(np.nanmin(together))), float(np.nanmax(together))
    apart = max(high - low, 0.02 * abs(high), np.finfo(float).tiny)
    return (low, low + apart) if zero else ((low + high - apart) / 2, (low + high + apart) / 2)


def _rectangle(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    return [low[0], high[0], high[0], low[0], low[0]], [low[1], low[1], high[1], high[1], low[1]]


def mark_point(ax: Axes, point: ArrayLike, label: str, color: str = INK, marker: str = "+") -> None:
    """Marks a point of the body frame, m, with an entry for the legend."""
    x, y = np.asarray(point, dtype=np.float64)
    ax.plot([x], [y], marker=marker, markersize=9, markeredgewidth=2, color=color, linestyle="none", label=label)

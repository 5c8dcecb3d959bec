"""Sizes, marks and colours that the report's figures share."""

from io import BytesIO
from math import floor, log10

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gridpush_drake.grid.object import GridObject
from gridpush_drake.report.draw import FONT, INK

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
"""Beside a panel, for its colour bar, inches."""

TITLE_ROOM = 0.5
"""Above a panel, inches."""

CENTIMETRE = 0.01
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
    obj: GridObject, rows: int, columns: int, *, width: float = PAGE_WIDTH, most_height: float = 3.2
) -> tuple[Figure, np.ndarray]:
    """Makes a grid of panels, each of the object's proportions.

    Args:
        obj: the object.
        rows: of panels.
        columns: of panels.
        width: of the whole, inches.
        most_height: of a panel, inches.

    Returns:
        The figure, on an Agg canvas, and its axes (rows, columns).
    """
    x0, y0, x1, y1 = obj.outline.bounds
    panel = max(width / columns - BAR_ROOM, 1.0)
    height = min(max(panel * (y1 - y0) / (x1 - x0), 0.8), most_height) + TITLE_ROOM
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
    return f"{length * 100:g} cm" if length >= CENTIMETRE else f"{length * 1000:g} mm"


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

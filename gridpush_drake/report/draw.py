"""Drawings of a grid object: its cells colored by value or part, and its outline.

Only matplotlib's objects are used (`make_figure` gives a Figure on an Agg canvas), never pyplot, so that nothing
global changes and drawing works in any thread and without a display.
"""

from io import BytesIO

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.polygon import orient

from gridpush_drake.errors import ObjectError
from gridpush_drake.objects.grid_object import GridObject

INK = "#2b2f36"
"""Outlines and text."""

PALE = "#dfe5ec"
"""Cells without a value."""

PART_COLORS = ("#7fa7c9", "#e3b778", "#8fbf9f", "#c99bb8", "#b3a6d9", "#a9a9a3")
"""Parts in order of their labels, over again after the last."""

CELL_MAP = "viridis"
"""Color map of values where none is asked for."""

CELL_LINE, OUTLINE_LINE = 0.4, 1.4
"""Line widths, points."""

FONT = 9
"""Size of text, points."""

MARGIN = 0.04
"""Room about the object, in its larger side."""

BAR_SHARE, BAR_GAP = 0.04, 0.03
"""Width of a color bar and its distance, in widths of the axes."""

MAX_TICKS = 5
"""On one axis or color bar."""


def make_figure(width: float = 6.0, height: float = 4.5, dpi: float = 150.0) -> tuple[Figure, Axes]:
    """Makes a figure with one axes.

    Args:
        width: inches.
        height: inches.
        dpi: pixels per inch.

    Returns:
        The figure, on an Agg canvas, and its axes.
    """
    figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


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
        limits: least and greatest value of the color map; the values' own where None.
        pose: (x, y, theta) X_WB, m and rad.
        alpha: opacity, 0 to 1.

    Returns:
        The cells.

    Raises:
        ObjectError: `values` is not one number per cell.
    """
    cells = PolyCollection(_squares(obj, pose), edgecolors="white", linewidths=CELL_LINE, alpha=alpha)
    if values is None:
        cells.set_facecolor(PALE)
    else:
        numbers = np.asarray(values, dtype=np.float64)
        if numbers.shape != (obj.n,):
            raise ObjectError(f"{obj.name}: values of shape {numbers.shape}; expected ({obj.n},), one for each cell")
        cells.set_array(numbers)
        cells.set_cmap(colormaps[cmap])
        cells.set_clim(*(limits or (float(np.nanmin(numbers)), float(np.nanmax(numbers)))))
    ax.add_collection(cells)
    draw_outline(ax, obj, pose=pose, alpha=alpha)
    _frame(ax)
    if label is not None and values is not None:
        add_color_bar(ax, cells, label)
    return cells


def draw_parts(ax: Axes, obj: GridObject, *, pose: ArrayLike = (0.0, 0.0, 0.0)) -> PolyCollection:
    """Draws the cells in the colors of their parts, with a legend that counts them.

    Args:
        ax: where to draw, world frame, m; its aspect is made equal.
        obj: the object.
        pose: (x, y, theta) X_WB, m and rad.

    Returns:
        The cells.
    """
    labels, index, counts = np.unique(obj.labels, return_inverse=True, return_counts=True)
    colors = [PART_COLORS[i % len(PART_COLORS)] for i in range(len(labels))]
    cells = PolyCollection(
        _squares(obj, pose), facecolors=[colors[i] for i in index], edgecolors="white", linewidths=CELL_LINE
    )
    ax.add_collection(cells)
    draw_outline(ax, obj, pose=pose)
    _frame(ax)
    handles = [
        Patch(facecolor=color, label=f"part {part}: {count} cell{'' if count == 1 else 's'}")
        for part, count, color in zip(labels, counts, colors, strict=True)
    ]
    ax.legend(handles=handles, fontsize=FONT, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
    return cells


def draw_outline(
    ax: Axes,
    obj: GridObject,
    *,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    color: str = INK,
    linestyle: str = "solid",
    alpha: float = 1.0,
) -> PathPatch:
    """Draws the outline with its holes.

    Args:
        ax: where to draw, world frame, m.
        obj: the object.
        pose: (x, y, theta) X_WB, m and rad.
        color: of the line.
        linestyle: as matplotlib names it.
        alpha: opacity, 0 to 1.

    Returns:
        The outline.
    """
    outline = orient(obj.outline)
    rings = [_place(np.array(ring.coords), pose) for ring in (outline.exterior, *outline.interiors)]
    path = Path.make_compound_path(*(Path(ring, closed=True) for ring in rings))
    patch = PathPatch(
        path, facecolor="none", edgecolor=color, linewidth=OUTLINE_LINE, linestyle=linestyle, alpha=alpha,
        joinstyle="round",
    )  # fmt: skip
    ax.add_patch(patch)
    return patch


def add_color_bar(ax: Axes, mappable: ScalarMappable, label: str) -> Colorbar:
    """Adds a slim color bar beside `ax`, titled `label`."""
    bar = ax.get_figure(root=True).colorbar(mappable, ax=ax, fraction=BAR_SHARE, pad=BAR_GAP)  # type: ignore[union-attr]
    bar.set_label(label, fontsize=FONT, color=INK)
    bar.ax.tick_params(labelsize=FONT - 1, colors=INK)
    bar.ax.yaxis.set_major_locator(MaxNLocator(MAX_TICKS))
    bar.outline.set_visible(False)
    return bar


def _squares(obj: GridObject, pose: ArrayLike) -> list[NDArray[np.float64]]:
    """The (4, 2) corners of each cell in the world frame, m."""
    half = obj.cell_size / 2
    corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return list(_place((obj.p_BC[:, None] + corners).reshape(-1, 2), pose).reshape(-1, 4, 2))


def _place(p_BP: NDArray[np.float64], pose: ArrayLike) -> NDArray[np.float64]:
    x, y, theta = np.asarray(pose, dtype=np.float64)
    c, s = np.cos(theta), np.sin(theta)
    return p_BP @ np.array([[c, s], [-s, c]]) + np.array([x, y])


def _frame(ax: Axes) -> None:
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(MARGIN)
    ax.autoscale_view()
    for spine in ("top", "right"):
        ax.spines[spine].set_visible(False)
    for axis, name in ((ax.xaxis, "x, m"), (ax.yaxis, "y, m")):
        axis.set_major_locator(MaxNLocator(MAX_TICKS))
        axis.label.set(text=name, fontsize=FONT, color=INK)
    ax.tick_params(labelsize=FONT - 1, colors=INK)

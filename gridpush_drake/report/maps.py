"""Maps over the cells: what was learned, how sure that is, and what the pushes could not tell."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.result import Identification
from gridpush_drake.report.draw import INK, add_color_bar, draw_cells
from gridpush_drake.report.layout import LEARNED, add_scale_bar, frame_object, hide_axes, make_panels

SPREAD_MAP = "BuPu"
"""Colour map of standard deviations."""

SHARE_MAP = "YlGnBu"
"""Colour map of what was learned, 0 to 1."""

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
    low, high = known.centre_of_mass_box
    for ax in axes[0, 1:]:
        if np.isfinite(known.centre_of_mass_box).all():
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

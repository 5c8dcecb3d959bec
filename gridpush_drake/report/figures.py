"""Figures of the object, the pushes and the search.

Pictures as PNG files: of an object, of a model, of a motion.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.identification.result import HistoryEntry, Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.draw import FONT, draw_cells, draw_outline, draw_parts, to_png
from gridpush_drake.report.maps import (
    BEFORE,
    FAINT,
    HALF_WIDTH,
    LEARNED,
    add_scale_bar,
    draw_learned_maps,
    frame_object,
    hide_axes,
    make_grid,
    make_panels,
    tidy,
)

MM = 1e3

LEGEND_COLUMNS = 3

GHOSTS = 5
"""Faint outlines along a drawn motion, its two ends apart."""


def draw_object_parts(obj: GridObject, width: float = HALF_WIDTH) -> Figure:
    """Draws the object with its parts."""
    figure, axes = make_panels(obj, 1, 1, width=width, max_height=width)
    draw_parts(axes[0, 0], obj)
    _put_legend_above(axes[0, 0])
    hide_axes(axes[0, 0])
    frame_object(axes[0, 0], obj)
    add_scale_bar(axes[0, 0], obj)
    return figure


def draw_pushes(result: Identification, log: PushLog, held_out: PushLog | None = None) -> Figure:
    """Draws the pushes in the object's frame as it lay when each began: arrows along the pusher's path."""
    obj = result.obj
    figure, axes = make_panels(obj, 1, 1, width=HALF_WIDTH, max_height=HALF_WIDTH)
    ax = axes[0, 0]
    draw_cells(ax, obj)
    for pushes, color, label in ((log, LEARNED, "learned from"), (held_out or (), BEFORE, "held out")):
        for i, seen in enumerate(pushes):
            unused = seen.name in result.unused_pushes
            path = _to_body(seen.pose, seen.push.xy)
            _draw_arrow(ax, path, FAINT if unused else color, None if i else label)
    ax.autoscale_view()
    hide_axes(ax)
    add_scale_bar(ax, obj)
    ax.legend(fontsize=FONT, frameon=False)
    _put_legend_above(ax)
    return figure


def draw_loss(history: Sequence[HistoryEntry], before: float | None = None) -> Figure:
    """Draws the loss along the search.

    Args:
        history: of the search.
        before: mean cell error with uniform parameters, m.

    Returns:
        The figure.
    """
    figure, axes = make_grid(1, 1, HALF_WIDTH, 0.55 * HALF_WIDTH)
    ax = axes[0, 0]
    simulations = [entry.simulations for entry in history]
    loss = [entry.loss * MM for entry in history]
    ax.step(simulations, loss, where="post", color=LEARNED, linewidth=1.6, label="best so far")
    ax.plot(simulations, loss, ".", color=LEARNED, markersize=4)
    if before is not None and np.isfinite(before):
        ax.axhline(before * MM, color=BEFORE, linewidth=1.2, linestyle="dashed", label="uniform friction")
    ax.set_ylim(bottom=0)
    tidy(ax, "simulated pushes", "mean cell error, mm")
    ax.legend(fontsize=FONT, frameon=False)
    return figure


def draw_learning(errors: Sequence[float], noise_floor: float | None = None) -> Figure:
    """Draws how the error of held-out predictions falls with the pushes learned from.

    Args:
        errors: mean cell error of the held-out pushes, m: before the first push, after it, after the second, ...
        noise_floor: error that the true parameters leave, m, where it is known.

    Returns:
        The figure.
    """
    figure, axes = make_grid(1, 1, 6.5, 2.9)
    ax = axes[0, 0]
    ax.plot(np.arange(len(errors)), np.array(errors) * MM, "o-", color=LEARNED, markersize=5, linewidth=1.6)
    ax.axhline(errors[0] * MM, color=BEFORE, linewidth=1.2, linestyle="dashed", label="even object")
    if noise_floor is not None:
        ax.axhline(noise_floor * MM, color=FAINT, linewidth=1.2, linestyle="dashed", label="true masses and frictions")
    ax.set_xticks(np.arange(len(errors)))
    ax.set_ylim(bottom=0)
    tidy(ax, "pushes learned from", "mean cell error, mm")
    ax.legend(fontsize=FONT, frameon=False)
    return figure


def draw_path(obj: GridObject, push: Push, poses: NDArray[np.float64], width: float = 6.0) -> Figure:
    """Draws a simulated motion: the object from its beginning to its end, and the pusher's path."""
    figure, axes = make_grid(1, 1, width, 0.75 * width)
    ax = axes[0, 0]
    for pose in poses[np.linspace(0, len(poses) - 1, GHOSTS + 2).astype(int)[1:-1]]:
        draw_outline(ax, obj, pose=pose, color=FAINT, alpha=0.5)
    draw_outline(ax, obj, pose=poses[0], color=FAINT, linestyle="dashed")
    draw_cells(ax, obj, pose=poses[-1])
    _draw_tip(ax, push)
    ax.autoscale_view()
    return figure


def _put_legend_above(ax: Axes) -> None:
    legend = ax.get_legend()
    if legend is not None:
        legend.set_loc("lower center")
        legend.set_bbox_to_anchor((0.5, 1.0), ax.transAxes)
        legend.set_ncols(LEGEND_COLUMNS)


def _draw_tip(ax: Axes, push: Push) -> None:
    ax.plot(*push.xy.T, color=LEARNED, linewidth=1)
    for center, filled in ((push.xy[0], False), (push.xy[-1], True)):
        ax.add_patch(Circle(tuple(center), push.radius, facecolor=LEARNED if filled else "none", edgecolor=LEARNED))


def _draw_arrow(ax: Axes, path: NDArray[np.float64], color: str, label: str | None) -> None:
    ax.plot(*path.T, color=color, linewidth=1.4, label=label)
    ahead = path[-1] - path[0]
    length = np.hypot(*ahead)
    if length > 0:
        ax.annotate(
            "", path[-1], path[-1] - 0.01 * ahead,
            arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
    ax.plot(*path[0], marker="o", markersize=3, color=color)


def _to_body(pose: ArrayLike, p_WP: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, theta = np.asarray(pose, dtype=np.float64)
    c, s = np.cos(theta), np.sin(theta)
    return (p_WP - (x, y)) @ np.array([[c, -s], [s, c]])


def draw_object(obj: GridObject) -> bytes:
    """The object with its parts, as PNG."""
    return to_png(draw_object_parts(obj))


def draw_model(result: Identification) -> bytes:
    """Relative friction and mass of a learned model beside their standard deviations, as PNG."""
    return to_png(draw_learned_maps(result))


def draw_motion(obj: GridObject, push: Push, poses: NDArray[np.float64]) -> bytes:
    """An object's motion (T+1, 3) under a push, as PNG."""
    return to_png(draw_path(obj, push, poses))

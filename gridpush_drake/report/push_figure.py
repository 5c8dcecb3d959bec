"""The figure of a pushing run: where the object lay, how it was pushed, and how the goal came nearer."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.draw import FONT, INK, draw_cells, draw_outline
from gridpush_drake.report.maps import BEFORE, FAINT, LEARNED, PAGE_WIDTH, make_grid, tidy
from gridpush_drake.report.plan_figure import TABLE

Array = NDArray[np.float64]

PANEL_HEIGHT = 4.4
"""Inches."""

ROOM = 0.04
"""About what is drawn, m."""

LEGEND_BELOW = -0.12
"""Of the axes' height."""

MM = 1e3


def draw_push_run(
    obj: GridObject,
    poses: Sequence[ArrayLike],
    pushes: Sequence[Push],
    goal: ArrayLike,
    surface: SupportSurface | None = None,
    *,
    expected: Sequence[float] = (),
    tolerance: float | None = None,
) -> Figure:
    """Draws a run: on the left the way to the goal, on the right how far the object was from it.

    Args:
        obj: the object.
        poses: (3,) where it was seen at rest, X_WB, m and rad: before the first push, and after each.
        pushes: as they were made; as many as poses, less one.
        goal: (3,) where it should lie.
        surface: the table; None for one without end.
        expected: of each push, the mean cell error to the goal that was expected after it, m; empty for unknown.
        tolerance: mean cell error at which the goal counts as reached, m; None is not drawn.

    Returns:
        The figure.
    """
    figure, axes = make_grid(1, 2, PAGE_WIDTH, PANEL_HEIGHT)
    rest, aim = np.array([np.asarray(pose, dtype=np.float64) for pose in poses]), np.asarray(goal, dtype=np.float64)
    _draw_way(axes[0, 0], obj, rest, pushes, aim, surface)
    _draw_errors(axes[0, 1], np.atleast_1d(calc_goal_error(obj, rest, aim)), expected, tolerance)
    return figure


def _draw_way(
    ax: Axes, obj: GridObject, poses: Array, pushes: Sequence[Push], goal: Array, surface: SupportSurface | None
) -> None:
    if surface is not None:
        ax.add_patch(Polygon(surface.corners, facecolor=TABLE, edgecolor=FAINT, zorder=0))
    for pose in poses[1:-1]:
        draw_outline(ax, obj, pose=pose, color=FAINT)
    draw_outline(ax, obj, pose=poses[0], color=INK, linestyle="dashed")
    if len(poses) > 1:
        draw_cells(ax, obj, pose=poses[-1], alpha=0.7)
    draw_outline(ax, obj, pose=goal, color=BEFORE, linestyle="dotted").set_zorder(4)
    for number, push in enumerate(pushes, start=1):
        _draw_push(ax, push, number)
    points = [obj.cells_at(pose) for pose in (*poses, goal)] + [push.xy for push in pushes]
    everything = np.concatenate(points)
    low, high = everything.min(axis=0) - ROOM, everything.max(axis=0) + ROOM
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    handles = [
        Line2D([], [], color=INK, linestyle="dashed", label="at first"),
        Line2D([], [], color=FAINT, label="on the way"),
        Line2D([], [], color=INK, label="at last"),
        Line2D([], [], color=BEFORE, linestyle="dotted", label="goal"),
        Line2D([], [], color=LEARNED, marker="o", markerfacecolor="white", label="pushes"),
    ]
    _add_legend(ax, handles, 3)
    ax.set_title("The way to the goal", fontsize=FONT, color=INK)


def _draw_push(ax: Axes, push: Push, number: int) -> None:
    """An arrow along the push, the finger where it began, and the push's number in it."""
    begin, end = push.xy[0], push.xy[-1]
    ax.annotate(
        "", end, begin,
        arrowprops={"arrowstyle": "-|>", "color": LEARNED, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}, zorder=5,
    )  # fmt: skip
    ax.add_patch(Circle((begin[0], begin[1]), push.radius, facecolor="white", edgecolor=LEARNED, zorder=6))
    ax.text(
        float(begin[0]), float(begin[1]), str(number), color=LEARNED, fontsize=FONT - 2, ha="center",
        va="center_baseline", fontweight="bold", zorder=7,
    )  # fmt: skip


def _draw_errors(ax: Axes, errors: Array, expected: Sequence[float], tolerance: float | None) -> None:
    ax.plot(np.arange(len(errors)), MM * errors, color=LEARNED, marker="o", zorder=3)
    handles = [Line2D([], [], color=LEARNED, marker="o", label="seen")]
    if len(expected):
        count = np.arange(1, len(expected) + 1)
        ax.plot(count, MM * np.asarray(expected), color=BEFORE, marker="D", markerfacecolor="white", linestyle="none",
                zorder=4)  # fmt: skip
        handles.append(
            Line2D([], [], color=BEFORE, marker="D", markerfacecolor="white", linestyle="none", label="expected")
        )
    if tolerance is not None:
        ax.axhline(MM * tolerance, color=FAINT, linestyle="dashed", linewidth=1.2, zorder=2)
        handles.append(Line2D([], [], color=FAINT, linestyle="dashed", label="near enough"))
    ax.set_ylim(bottom=0.0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    tidy(ax, "pushes made", "mean cell error to the goal, mm")
    _add_legend(ax, handles, 3)
    ax.set_title("How far it was from the goal", fontsize=FONT, color=INK)


def _add_legend(ax: Axes, handles: list[Line2D], columns: int) -> None:
    ax.legend(
        handles=handles, fontsize=FONT - 1, frameon=False, loc="upper center", bbox_to_anchor=(0.5, LEGEND_BELOW),
        ncols=columns,
    )  # fmt: skip

"""The figure of a push plan: table and obstacles, the object after every push, and the pushes."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from shapely import Polygon as Shape

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import PlannedPush
from gridpush_drake.planning.goal.push_plan import PushPlan
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.draw import FONT, INK, draw_cells, draw_outline
from gridpush_drake.report.maps import BEFORE, FAINT, LEARNED, make_grid

TABLE = "#f3efe6"
"""The table's top."""

OBSTACLE = "#c7bdb0"

WIDTH, MAX_HEIGHT = 6.5, 7.5
"""Of the figure, inches."""

LEGEND_ROOM = 0.7
"""Above the drawing, inches."""

ROOM = 0.05
"""About what is drawn, m."""


def draw_plan(
    obj: GridObject, plan: PushPlan, surface: SupportSurface | None = None, obstacles: Sequence[Shape] = ()
) -> Figure:
    """Draws a plan.

    Args:
        obj: the object.
        plan: its pushes; where there are none, start and goal alone are drawn.
        surface: the table; None for one without end.
        obstacles: what is in the way.

    Returns:
        The figure.
    """
    low, high = _calc_frame(obj, plan, surface, obstacles)
    height = min(WIDTH * (high[1] - low[1]) / (high[0] - low[0]), MAX_HEIGHT) + LEGEND_ROOM
    figure, axes = make_grid(1, 1, WIDTH, height)
    ax = axes[0, 0]
    if surface is not None:
        ax.add_patch(Polygon(surface.corners, facecolor=TABLE, edgecolor=FAINT, zorder=0))
    for obstacle in obstacles:
        ax.add_patch(Polygon(np.array(obstacle.exterior.coords), facecolor=OBSTACLE, edgecolor=INK, zorder=0.5))
    poses = plan.poses
    draw_outline(ax, obj, pose=poses[0], color=INK, linestyle="dashed")
    for pose in poses[1:-1]:
        draw_outline(ax, obj, pose=pose, color=FAINT)
    if len(poses) > 1:
        draw_cells(ax, obj, pose=poses[-1])
    draw_outline(ax, obj, pose=plan.goal, color=BEFORE, linestyle="dotted")
    for number, planned in enumerate(plan.pushes, start=1):
        _draw_push(ax, planned, number)
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    _add_legend(ax)
    count = len(plan.pushes)
    pushes = f"{count} push{'' if count == 1 else 'es'}"
    words = plan.status.replace("_", " ")
    ax.set_title(f"{obj.name}: {words}, {pushes}, {1e3 * plan.error:.1f} mm left", fontsize=FONT, color=INK)
    return figure


def _draw_push(ax: Axes, planned: PlannedPush, number: int) -> None:
    begin, end = planned.push.xy[0], planned.push.xy[-1]
    ax.annotate(
        "", end, begin,
        arrowprops={"arrowstyle": "-|>", "color": LEARNED, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}, zorder=5,
    )  # fmt: skip
    ax.add_patch(Circle((begin[0], begin[1]), planned.push.radius, facecolor="white", edgecolor=LEARNED, zorder=6))
    back = begin - (end - begin) / max(float(np.hypot(*(end - begin))), 1e-9) * 3 * planned.push.radius
    ax.text(
        float(back[0]), float(back[1]), str(number), color=LEARNED, fontsize=FONT, ha="center", va="center",
        fontweight="bold", zorder=7,
    )  # fmt: skip


def _add_legend(ax: Axes) -> None:
    handles = [
        Line2D([], [], color=INK, linestyle="dashed", label="start"),
        Line2D([], [], color=FAINT, label="on the way"),
        Line2D([], [], color=INK, label="predicted end"),
        Line2D([], [], color=BEFORE, linestyle="dotted", label="goal"),
        Line2D([], [], color=LEARNED, marker="o", markerfacecolor="white", label="pushes"),
    ]
    ax.legend(
        handles=handles, fontsize=FONT - 1, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.08),
        ncols=len(handles),
    )  # fmt: skip


def _calc_frame(
    obj: GridObject, plan: PushPlan, surface: SupportSurface | None, obstacles: Sequence[Shape]
) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest x and y of everything, m."""
    points = [obj.cells_at(pose) for pose in (*plan.poses, plan.goal)]
    points += [planned.push.xy for planned in plan.pushes]
    points += [np.array(obstacle.exterior.coords)[:, :2] for obstacle in obstacles]
    if surface is not None:
        points.append(surface.corners)
    everything = np.concatenate(points)
    return everything.min(axis=0) - ROOM, everything.max(axis=0) + ROOM

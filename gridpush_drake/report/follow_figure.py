"""Figure of a run in which an object was pushed along a path: where it should go, and went."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import ArrayLike
from shapely import Polygon as Shape

from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.draw import (
    FAINT_COLOR,
    INK_COLOR,
    LEARNED_COLOR,
    PAGE_WIDTH,
    PRIOR_COLOR,
    add_legend_below,
    draw_outline,
    draw_table,
    frame_points,
    make_grid,
    tidy,
)
from gridpush_drake.report.plan_figures import FIGURE_MARGIN, OBSTACLE_COLOR, PANEL_HEIGHT
from gridpush_drake.units import MM_PER_M

LINE_WIDTH = 1.2
"""Width of the lines of ways, points."""

PATH_LINE = 3.5
"""Width of the line of the path, points: it is seen on both sides of the object's way."""

OUTLINE_COUNT = 8
"""Number of outlines of the object on its way that are drawn, besides the first and the last."""


def draw_follow_run(
    obj: GridObject,
    *,
    planned: ArrayLike,
    poses: ArrayLike,
    tips: ArrayLike,
    times: ArrayLike,
    distances: ArrayLike,
    goal: ArrayLike,
    surface: SupportSurface | None = None,
    obstacles: Sequence[Shape] = (),
) -> Figure:
    """Draws a run: on the left the ways over the table, on the right how far off the path it was.

    Args:
        obj: the object.
        planned: (M, 3) poses of the path, X_WB, m and rad; M is 0 where there was none.
        poses: (K, 3) poses of the object while it was pushed.
        tips: (K, 2) places of the finger then, m.
        times: (K,) s.
        distances: (K,) of the cells' centroid from the path, m.
        goal: (3,) where the path ends.
        surface: the table; None for one without end.
        obstacles: what stood in the way, world frame, m.
    """
    figure, axes = make_grid(1, 2, PAGE_WIDTH, PANEL_HEIGHT)
    ax = axes[0, 0]
    path = np.asarray(planned, dtype=np.float64).reshape(-1, 3)
    gone = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    finger = np.asarray(tips, dtype=np.float64).reshape(-1, 2)
    aim = np.asarray(goal, dtype=np.float64)
    if surface is not None:
        draw_table(ax, surface.corners)
    for obstacle in obstacles:
        corners = np.array(obstacle.exterior.coords)[:, :2]
        ax.add_patch(Polygon(corners, facecolor=OBSTACLE_COLOR, edgecolor=INK_COLOR, zorder=0.5))
    # the object on its way, where it should end, and the ways of its centroid and of the finger
    if len(gone):
        rows = np.linspace(0, len(gone) - 1, OUTLINE_COUNT + 2).round().astype(int)
        for row in np.unique(rows):
            ends = row in (0, len(gone) - 1)
            draw_outline(ax, obj, pose=gone[row], color=LEARNED_COLOR, alpha=1.0 if ends else 0.3)
    draw_outline(ax, obj, pose=aim, linestyle="dotted")
    ways = (
        (find_centers(obj, path), PRIOR_COLOR, PATH_LINE, "path"),
        (find_centers(obj, gone), LEARNED_COLOR, LINE_WIDTH, "object"),
        (finger, FAINT_COLOR, LINE_WIDTH, "finger"),
    )
    handles = []
    for places, color, width, label in ways:
        ax.plot(places[:, 0], places[:, 1], color=color, linewidth=width)
        handles.append(Line2D([], [], color=color, linewidth=width, label=label))
    shapes = [np.array(obstacle.exterior.coords)[:, :2] for obstacle in obstacles]
    cells = obj.cells_at(np.vstack([gone[[0, -1]] if len(gone) else gone, aim])).reshape(-1, 2)
    frame_points(ax, [cells, finger, *shapes], FIGURE_MARGIN)
    add_legend_below(ax, handles, 3)

    # how far off the path it was
    ax = axes[0, 1]
    clock = np.asarray(times, dtype=np.float64)
    ax.plot(
        clock - clock[:1].sum(),
        np.asarray(distances) * MM_PER_M,
        color=LEARNED_COLOR,
        linewidth=LINE_WIDTH,
    )
    ax.set_ylim(bottom=0.0)
    tidy(ax, "time, s", "distance from the path, mm")
    return figure


def find_centers(obj: GridObject, poses: Array) -> Array:
    """Finds the places (K, 2) of the cells' centroid at poses (K, 3), m."""
    return transform(poses, obj.p_BC.mean(axis=0)[None])[:, 0]

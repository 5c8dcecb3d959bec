"""What a robot did with several objects, and learned of them: a figure, and a page of its own."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.draw import (
    FAINT_COLOR,
    FONT_SIZE,
    INK_COLOR,
    PAGE_WIDTH,
    PART_COLORS,
    add_legend_below,
    draw_cells,
    draw_numbered_push,
    draw_outline,
    draw_table,
    frame_points,
    make_grid,
    tidy,
)
from gridpush_drake.report.page import ReportSummary, embed, render
from gridpush_drake.units import MM_PER_M

PANEL_HEIGHT = 4.4
"""Height of the panels, inches."""

FIGURE_MARGIN = 0.05
"""Room about what is drawn, m."""

MEASURED_LINE_WIDTH = 2.0
"""Width of the lines of what was measured, points."""

MARKER_SIZE = 4.5
"""Size of their markers, points."""

POINTS_PER_INCH = 72.0
"""Points in an inch."""

LEGEND_COLUMNS = 3
"""Columns of a legend."""

SCENE_RUN_TEMPLATE = "scene_run.html.j2"
"""File with the page, to be filled in."""


def make_scene_report(
    name: str,
    summary: ReportSummary,
    recording: str | None = None,
    *,
    objects: Sequence[dict[str, Any]] = (),
    numbers: Sequence[tuple[str, str]] = (),
) -> str:
    """Makes the report of a task with several objects.

    Args:
        name: what was done with which objects.
        summary: what came of it.
        recording: the file with the recording of the run, as seen from the report; None without.
        objects: what was learned of each, as `scene_page.describe_models` describes it; empty for
            nothing.
        numbers: what was learned of the objects beside each other, see `list_scene_numbers`.

    Returns:
        An HTML page that needs nothing else.
    """
    return render(
        SCENE_RUN_TEMPLATE,
        name=name,
        summary=summary,
        figure=embed(summary.figure),
        recording=recording,
        objects=objects,
        numbers=numbers,
    )


def draw_scene_run(
    objects: Sequence[GridObject],
    names: Sequence[str],
    poses: Array,
    pushes: Sequence[Push],
    values: Array,
    measured: tuple[str, float | None],
    *,
    goals: Array | None = None,
    surface: SupportSurface | None = None,
) -> Figure:
    """Draws a run: on the left where the objects went, on the right what was measured.

    Args:
        objects: the N objects.
        names: what to call them.
        poses: (P+1, N, 3) where they were seen before each push and at last, m and rad.
        pushes: the P pushes.
        values: (P+1, N) what was measured of each, m.
        measured: what that is, in words, and where it should come to, m; None for nowhere.
        goals: (N, 3) goal poses, m and rad, NaN where there is none; None where there are none.
        surface: the table; None for one without end.

    Returns:
        The figure.
    """
    figure, axes = make_grid(1, 2, PAGE_WIDTH, PANEL_HEIGHT)
    colors = [PART_COLORS[b % len(PART_COLORS)] for b in range(len(objects))]
    handles = [
        Line2D([], [], color=color, linewidth=4, label=name)
        for color, name in zip(colors, names, strict=True)
    ]

    # Where they went.
    ax = axes[0, 0]
    if surface is not None:
        draw_table(ax, surface.corners)
    shown = [push.xy for push in pushes]
    for b, obj in enumerate(objects):
        for pose in poses[1:-1, b]:
            draw_outline(ax, obj, pose=pose, color=FAINT_COLOR, alpha=0.3)
        draw_outline(ax, obj, pose=poses[0, b], color=FAINT_COLOR, linestyle="dashed")
        draw_cells(ax, obj, pose=poses[-1, b]).set_facecolor(colors[b])
        shown.append(obj.cells_at(poses[[0, -1], b]).reshape(-1, 2))
        if goals is not None and np.isfinite(goals[b]).all():
            draw_outline(ax, obj, pose=goals[b], color=INK_COLOR, linestyle="dotted")
            shown.append(obj.cells_at(goals[b]))
    for number, push in enumerate(pushes, start=1):
        draw_numbered_push(ax, push, number, INK_COLOR)
    frame_points(ax, shown, FIGURE_MARGIN)
    ax.set_title("Dashed at first, filled at the end", fontsize=FONT_SIZE, color=INK_COLOR)
    add_legend_below(ax, handles, LEGEND_COLUMNS)

    # What was measured.
    ax = axes[0, 1]
    for b, color in enumerate(colors):
        # Two objects that lie nearest to each other have the same room. Their lines would lie on
        # each other, so that each is drawn beside the one before, a line's width higher.
        beside = (b - (len(colors) - 1) / 2) * MEASURED_LINE_WIDTH / POINTS_PER_INCH
        (line,) = ax.plot(
            np.arange(len(values)),
            MM_PER_M * values[:, b],
            color=color,
            linewidth=MEASURED_LINE_WIDTH,
            marker="o",
            markersize=MARKER_SIZE,
            zorder=3,
        )
        # set only now: the axes find their limits by lines whose places are plain data
        up = ScaledTranslation(0.0, beside, figure.dpi_scale_trans)
        line.set_transform(ax.transData + up)
    words, wanted = measured
    if wanted is not None:
        ax.axhline(
            MM_PER_M * wanted, color=FAINT_COLOR, linestyle="dashed", linewidth=1.2, zorder=2
        )
    ax.set_ylim(bottom=0.0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    tidy(ax, "pushes made", f"{words}, mm")
    ax.set_title(words.capitalize(), fontsize=FONT_SIZE, color=INK_COLOR)
    return figure

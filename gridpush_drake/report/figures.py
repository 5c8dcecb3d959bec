"""Figures of an object and its model: parts, pushes, the search, what was learned, predictions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array, transform_back
from gridpush_drake.identification.absolute.estimate import TiltingLine, TiltTestCheck
from gridpush_drake.identification.result import HistoryEntry, Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.report.draw import (
    CELL_MAP,
    FAINT_COLOR,
    FONT_SIZE,
    HALF_WIDTH,
    INK_COLOR,
    LEARNED_COLOR,
    PAGE_WIDTH,
    PART_COLORS,
    PRIOR_COLOR,
    add_color_bar,
    add_scale_bar,
    draw_arrow,
    draw_body_frame,
    draw_cells,
    draw_outline,
    draw_parts,
    draw_tips,
    frame_object,
    hide_axes,
    make_chart,
    make_grid,
    make_panels,
    tidy,
)
from gridpush_drake.units import GRAMS_PER_KG, MM_PER_M

LEGEND_COLUMNS = 3
"""Number of columns of a legend."""

MOTION_WIDTH = 6.0
"""Width of a motion's figure, inches."""

ARROW_HEAD = 0.01
"""Fraction of a path, at its end, along which the head of its arrow points."""

GHOST_COUNT = 5
"""Number of faint outlines along a drawn motion, besides its two ends."""

SPREAD_MAP = "BuPu"
"""Color map of standard deviations."""

FRACTION_MAP = "YlGnBu"
"""Color map of how much was learned, 0 to 1."""

MIN_OPACITY = 0.25
"""Opacity of a cell of which nothing was learned."""


MAX_OVERLAYS = 8
"""Largest number of pushes that are drawn one by one."""

OVERLAY_COLUMNS = 4
"""Number of them side by side."""

MAX_OVERLAY_HEIGHT = 3.2
"""Largest height of each of them, inches."""

MAX_DUMBBELLS = 32
"""Largest number of pushes that are compared line by line. More are a scatter of points."""

TILT_TEST_HEIGHT = 3.4
"""Height of the figure of presses at the table's edge, inches."""

TILT_TEST_ROOM = 1.15
"""Factor by which the forces' axis is longer than the greatest force, for its residual above it."""

LINE_HEIGHT = 0.22
"""Height of such a line, inches."""


def draw_object(obj: GridObject) -> Figure:
    """Draws the object with its parts."""
    figure, axes = make_panels(obj, 1, 1, width=HALF_WIDTH, max_height=HALF_WIDTH)
    ax = axes[0, 0]
    draw_parts(ax, obj)
    draw_body_frame(ax, obj)
    _put_legend_above(ax)
    hide_axes(ax)
    frame_object(ax, obj)
    add_scale_bar(ax, obj)
    return figure


def draw_pushes(result: Identification, log: PushLog, held_out: PushLog | None = None) -> Figure:
    """Draws the pushes as arrows, in the object's frame as it lay when each of them began."""
    obj = result.obj
    figure, axes = make_panels(obj, 1, 1, width=HALF_WIDTH, max_height=HALF_WIDTH)
    ax = axes[0, 0]
    draw_cells(ax, obj)
    draw_body_frame(ax, obj)
    names = {*result.unused_pushes, *(outlier.push for outlier in result.outliers if outlier.whole)}
    used = [seen for seen in log if seen.name not in names]
    left_out = [seen for seen in log if seen.name in names]
    kinds = (
        (used, LEARNED_COLOR, "learned from"),
        (left_out, FAINT_COLOR, "left out"),
        (held_out or (), PRIOR_COLOR, "held out"),
    )
    for pushes, color, label in kinds:
        for i, seen in enumerate(pushes):
            _draw_arrow(ax, transform_back(seen.pose, seen.push.xy), color, None if i else label)
    ax.autoscale_view()
    hide_axes(ax)
    add_scale_bar(ax, obj)
    ax.legend(fontsize=FONT_SIZE, frameon=False)
    _put_legend_above(ax)
    return figure


def draw_loss(history: Sequence[HistoryEntry], before: float | None = None) -> Figure:
    """Draws the loss along a search.

    Args:
        history: the search.
        before: mean cell error with uniform parameters, m; None where it is not known.
    """
    figure, ax = make_chart(HALF_WIDTH, 0.55 * HALF_WIDTH)
    simulations = [entry.simulations for entry in history]
    loss = [entry.loss * MM_PER_M for entry in history]
    ax.step(
        simulations, loss, where="post", color=LEARNED_COLOR, linewidth=1.6, label="best so far"
    )
    ax.plot(simulations, loss, ".", color=LEARNED_COLOR, markersize=4)
    if before is not None and np.isfinite(before):
        ax.axhline(
            before * MM_PER_M,
            color=PRIOR_COLOR,
            linewidth=1.2,
            linestyle="dashed",
            label="even object",
        )
    ax.set_ylim(bottom=0)
    tidy(ax, "simulated pushes", "mean cell error, mm")
    ax.legend(fontsize=FONT_SIZE, frameon=False)
    return figure


def draw_learning(errors: Sequence[float], noise_floor: float | None = None) -> Figure:
    """Draws how the error of held-out predictions falls with the pushes learned from.

    Args:
        errors: their mean cell errors before the first push and after each, m.
        noise_floor: the error that the true parameters leave, m; None where it is not known.
    """
    figure, ax = make_chart(6.5, 2.9)
    ax.plot(
        np.arange(len(errors)),
        np.array(errors) * MM_PER_M,
        "o-",
        color=LEARNED_COLOR,
        markersize=5,
        linewidth=1.6,
    )
    ax.axhline(
        errors[0] * MM_PER_M,
        color=PRIOR_COLOR,
        linewidth=1.2,
        linestyle="dashed",
        label="even object",
    )
    if noise_floor is not None:
        ax.axhline(
            noise_floor * MM_PER_M,
            color=FAINT_COLOR,
            linewidth=1.2,
            linestyle="dashed",
            label="true masses and frictions",
        )
    ax.set_xticks(np.arange(len(errors)))
    ax.set_ylim(bottom=0)
    tidy(ax, "pushes learned from", "mean cell error, mm")
    ax.legend(fontsize=FONT_SIZE, frameon=False)
    return figure


def draw_tilt_tests(obj: GridObject, tests: Sequence[TiltTestCheck]) -> Figure:
    """Draws where an object was pressed at the table's edge, and each force beside its expectation.

    Args:
        obj: the object.
        tests: how each press was judged.
    """
    figure, axes = make_grid(1, 2, PAGE_WIDTH, TILT_TEST_HEIGHT)
    left, right = axes[0]
    draw_outline(left, obj)
    numbers = np.arange(1, len(tests) + 1)
    for number, one in zip(numbers, tests, strict=True):
        color = LEARNED_COLOR if one.line == TiltingLine.EDGE else PRIOR_COLOR
        x, y = one.place
        left.plot(x, y, "o", color=color, markersize=4)
        left.annotate(str(number), (x, y), (4, 4), textcoords="offset points", fontsize=FONT_SIZE)
        # From what is expected to what was measured.
        right.plot([number, number], [one.expected, one.force], color=FAINT_COLOR, linewidth=1.6)
        right.plot(number, one.expected, "o", color=FAINT_COLOR, markersize=5)
        right.plot(number, one.force, "o", color=color, markersize=5)
        top = max(one.expected, one.force)
        right.annotate(
            f"{one.residual:+.1f}",
            (number, top),
            (0, 5),
            textcoords="offset points",
            fontsize=FONT_SIZE,
            ha="center",
        )
    for color, label in (
        (LEARNED_COLOR, "measured, about the edge"),
        (PRIOR_COLOR, "measured, does not count as that"),
        (FAINT_COLOR, "expected by all others"),
    ):
        right.plot([], [], "o", color=color, markersize=5, label=label)
    hide_axes(left)
    frame_object(left, obj)
    add_scale_bar(left, obj)
    right.set_xticks(numbers)
    right.set_xlim(0.5, len(tests) + 0.5)
    highest = max(max(one.force, one.expected) for one in tests)
    right.set_ylim(0, TILT_TEST_ROOM * highest)
    tidy(right, "press", "force, N; above it: residual")
    right.legend(
        fontsize=FONT_SIZE, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=1
    )
    return figure


def _put_legend_above(ax: Axes) -> None:
    """Moves the legend, where there is one, above the axes."""
    legend = ax.get_legend()
    if legend is not None:
        legend.set_loc("lower center")
        legend.set_bbox_to_anchor((0.5, 1.0), ax.transAxes)
        legend.set_ncols(LEGEND_COLUMNS)


def _draw_arrow(ax: Axes, path: Array, color: str, label: str | None) -> None:
    """Draws a path (k, 2), m, with a dot where it begins and an arrow's head where it ends."""
    ax.plot(*path.T, color=color, linewidth=1.4, label=label)
    ahead = path[-1] - path[0]
    length = np.hypot(*ahead)
    if length > 0:
        draw_arrow(ax, path[-1] - ARROW_HEAD * ahead, path[-1], color)
    ax.plot(*path[0], marker="o", markersize=3, color=color)


def draw_model(result: Identification, truth: CellParameters | None = None) -> Figure:
    """Draws the learned load and mass beside their standard deviations, and the truth if known.

    The load is a cell's fraction of the support's friction in units of the even fraction, so 1
    everywhere where it is even. What was learned is drawn full, what is the prior's faint; a row
    for the load and one for mass.
    """
    obj = result.obj
    known = result.identifiability
    true_load = None
    true_mass = None
    if truth is not None:
        true_load = truth.relative_friction() * obj.n
        # Of the learned total mass, so that only the distribution differs.
        true_mass = truth.mass * (result.params.total_mass / truth.total_mass) * GRAMS_PER_KG
    rows = [
        (
            "load",
            known.relative_friction * obj.n,
            known.relative_friction_std * obj.n,
            true_load,
            "× even fraction",
        ),
        (
            "mass at even friction",
            result.params.mass * GRAMS_PER_KG,
            result.std.mass * GRAMS_PER_KG,
            true_mass,
            "g a cell",
        ),
    ]
    shown = MIN_OPACITY + (1 - MIN_OPACITY) * known.learned_share
    figure, axes = make_panels(obj, len(rows), 2 if truth is None else 3)
    for ax_row, (name, estimate, spread, true, unit) in zip(axes, rows, strict=True):
        limits = _limits(estimate, true)
        columns = list(ax_row)
        if true is not None:
            _draw_map(columns.pop(0), obj, true, f"{name}: truth", unit, limits)
        _draw_map(columns[0], obj, estimate, f"{name}: learned", unit, limits, alpha=shown)
        _draw_map(
            columns[1],
            obj,
            spread,
            "standard deviation",
            unit,
            _limits(spread, zero=True),
            SPREAD_MAP,
        )
    add_scale_bar(axes[-1, 0], obj)
    return figure


def draw_unknown_maps(result: Identification) -> Figure:
    """Draws how much of each cell was learned, and the smallest and largest mass it may have."""
    obj = result.obj
    known = result.identifiability
    figure, axes = make_panels(obj, 1, 3)
    _draw_map(
        axes[0, 0],
        obj,
        known.learned_share * 100,
        "learned from the pushes",
        "%",
        (0, 100),
        FRACTION_MAP,
    )
    greatest = np.where(np.isfinite(known.mass_max), known.mass_max, np.nan) * GRAMS_PER_KG
    limits = _limits(known.mass_min * GRAMS_PER_KG, greatest)
    _draw_map(
        axes[0, 1], obj, known.mass_min * GRAMS_PER_KG, "smallest possible mass", "g a cell", limits
    )
    _draw_map(axes[0, 2], obj, greatest, "greatest possible mass", "g a cell", limits)
    low, high = known.center_of_mass_box
    for ax in axes[0, 1:] if np.isfinite(known.center_of_mass_box).all() else ():
        for color, width in (("white", 3.0), (LEARNED_COLOR, 1.5)):
            ax.add_patch(
                Rectangle(low, *(high - low), fill=False, edgecolor=color, linewidth=width)
            )
    add_scale_bar(axes[0, 0], obj)
    return figure


def _draw_map(
    ax: Axes,
    obj: GridObject,
    values: ArrayLike,
    title: str,
    unit: str,
    limits: tuple[float, float],
    cmap: str = CELL_MAP,
    alpha: Array | None = None,
) -> None:
    """Draws one value of each cell, with title and color bar; `alpha` is each cell's opacity.

    The unit has a line of its own: in one line, titles of three columns would touch.
    """
    cells = draw_cells(ax, obj, values, limits=limits, cmap=cmap)
    hide_axes(ax, f"{title}\n{unit}")
    frame_object(ax, obj)
    add_color_bar(ax, cells, "")
    if alpha is not None:
        cells.set_alpha(alpha)  # type: ignore[arg-type]  # one a cell will do


def _limits(values: Array, others: Array | None = None, zero: bool = False) -> tuple[float, float]:
    """Finds the ends of a color map: the smallest and the largest value, at least a little apart.

    Args:
        values: the values.
        others: further values, or None.
        zero: whether the map begins at zero.
    """
    together = values if others is None else np.concatenate([values, others])
    low = 0.0 if zero else float(np.nanmin(together))
    high = float(np.nanmax(together))
    apart = max(high - low, 0.02 * abs(high), np.finfo(float).tiny)
    if zero:
        return low, low + apart
    return (low + high - apart) / 2, (low + high + apart) / 2


@dataclass(frozen=True, eq=False)
class PushOutcome:
    """How one push came out.

    Attributes:
        seen: the push.
        before: (3,) final pose predicted with uniform parameters, m and rad.
        after: (3,) final pose as the learned model predicts it, m and rad.
        error_before: mean cell error of `before`, m.
        error_after: mean cell error of `after`, m.
        held_out: whether the model never saw it.
    """

    seen: ObservedPush
    before: Array
    after: Array
    error_before: float
    error_after: float
    held_out: bool


def draw_overlays(obj: GridObject, outcomes: Sequence[PushOutcome]) -> Figure:
    """Draws up to `MAX_OVERLAYS` pushes: where the object was, went, and was predicted to go."""
    chosen = outcomes[:MAX_OVERLAYS]
    columns = min(OVERLAY_COLUMNS, max(len(chosen), 1))
    rows = max(1, -(-len(chosen) // columns))
    figure, axes = make_grid(
        rows, columns, PAGE_WIDTH, min(PAGE_WIDTH / columns, MAX_OVERLAY_HEIGHT) + 0.2
    )
    for ax in axes.flat[len(chosen) :]:
        ax.set_axis_off()
    for ax, outcome in zip(axes.flat, chosen, strict=False):
        _draw_overlay(ax, obj, outcome)
    drawn = {
        "before the push": FAINT_COLOR,
        "observed": INK_COLOR,
        "even object": PRIOR_COLOR,
        "learned": LEARNED_COLOR,
    }
    handles = [
        Line2D(
            [],
            [],
            color=color,
            linestyle="dashed" if color == FAINT_COLOR else "solid",
            linewidth=1.6,
            label=label,
        )
        for label, color in drawn.items()
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=FONT_SIZE
    )
    return figure


def _draw_overlay(ax: Axes, obj: GridObject, outcome: PushOutcome) -> None:
    """Draws one push, with its errors in the title."""
    seen = outcome.seen
    draw_outline(ax, obj, pose=seen.pose, color=FAINT_COLOR, linestyle="dashed")
    draw_outline(ax, obj, pose=seen.final_pose, color=INK_COLOR)
    draw_outline(ax, obj, pose=outcome.before, color=PRIOR_COLOR, alpha=0.9)
    draw_outline(ax, obj, pose=outcome.after, color=LEARNED_COLOR, alpha=0.9)
    ax.plot(*seen.push.xy.T, color=FAINT_COLOR, linewidth=1)
    ax.plot(*seen.push.xy[-1], marker="o", markersize=4, color=FAINT_COLOR)
    ax.autoscale_view()
    kind = ", held out" if outcome.held_out else ""
    errors = f"{outcome.error_before * MM_PER_M:.1f} → {outcome.error_after * MM_PER_M:.1f} mm"
    hide_axes(ax, f"{seen.name}{kind}\n{errors}")


def draw_errors(outcomes: Sequence[PushOutcome]) -> Figure:
    """Draws every push's cell error of an even object and as learned."""
    return _draw_dumbbells(outcomes) if len(outcomes) <= MAX_DUMBBELLS else _draw_scatter(outcomes)


def _collect_errors(outcomes: Sequence[PushOutcome]) -> tuple[Array, Array]:
    """Collects the errors (P,) of an even object and as learned, mm."""
    before = MM_PER_M * np.array([outcome.error_before for outcome in outcomes])
    after = MM_PER_M * np.array([outcome.error_after for outcome in outcomes])
    return before, after


def _draw_dumbbells(outcomes: Sequence[PushOutcome]) -> Figure:
    """Draws a line for each push, from its error of an even object to that as learned."""
    figure, ax = make_chart(6.5, LINE_HEIGHT * len(outcomes) + 0.9)
    before, after = _collect_errors(outcomes)
    places = np.arange(len(outcomes))[::-1]
    ax.hlines(places, before, after, color=FAINT_COLOR, linewidth=1.2)
    ax.plot(before, places, "o", color=PRIOR_COLOR, markersize=5, label="even object")
    ax.plot(after, places, "o", color=LEARNED_COLOR, markersize=5, label="learned")
    names = [
        f"{outcome.seen.name}{' (held out)' if outcome.held_out else ''}" for outcome in outcomes
    ]
    ax.set_yticks(places, names)
    ax.set_xlim(left=0)
    ax.set_ylim(-0.7, len(outcomes) - 0.3)
    tidy(ax, "mean cell error of the final pose, mm", "")
    ax.legend(
        fontsize=FONT_SIZE, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2
    )
    return figure


def _draw_scatter(outcomes: Sequence[PushOutcome]) -> Figure:
    """Draws a point for each push: its error as learned over that of an even object."""
    figure, ax = make_chart(5.0, 4.6)
    before, after = _collect_errors(outcomes)
    held_out = np.array([outcome.held_out for outcome in outcomes])
    for which, color, label in (
        (~held_out, LEARNED_COLOR, "learned from"),
        (held_out, PRIOR_COLOR, "held out"),
    ):
        if which.any():
            ax.plot(
                before[which], after[which], "o", color=color, markersize=4, alpha=0.7, label=label
            )
    top = 1.05 * float(max(before.max(), after.max()))
    ax.plot([0, top], [0, top], color=FAINT_COLOR, linestyle="dashed", linewidth=1)
    ax.set_xlim(0, top)
    ax.set_ylim(0, top)
    ax.set_aspect("equal")
    tidy(ax, "cell error of an even object, mm", "cell error as learned, mm")
    ax.legend(fontsize=FONT_SIZE, frameon=False, loc="upper left")
    return figure


def draw_motion(obj: GridObject, push: Push, poses: Array) -> Figure:
    """Draws a simulated motion: the object from its beginning to its end, and the pusher's path.

    Args:
        obj: the object.
        push: the pusher's motion.
        poses: (T+1, 3) of the object, m and rad.
    """
    figure, ax = make_chart(MOTION_WIDTH, 0.75 * MOTION_WIDTH)
    for pose in poses[np.linspace(0, len(poses) - 1, GHOST_COUNT + 2).astype(int)[1:-1]]:
        draw_outline(ax, obj, pose=pose, color=FAINT_COLOR, alpha=0.5)
    draw_outline(ax, obj, pose=poses[0], color=FAINT_COLOR, linestyle="dashed")
    draw_cells(ax, obj, pose=poses[-1])
    draw_tips(ax, push, LEARNED_COLOR)
    ax.autoscale_view()
    return figure


def draw_scene_motion(
    objects: Sequence[GridObject], push: Push, poses: Array, observed: Array | None = None
) -> Figure:
    """Draws how several objects moved: each from its beginning to its end, and the pusher's path.

    Args:
        objects: the objects.
        push: the pusher's motion.
        poses: (T+1, N, 3) of the N objects, m and rad, such as `Motion.poses`.
        observed: (N, 3) where they were seen to end, m and rad; None where nobody saw them.
    """
    figure, ax = make_chart(MOTION_WIDTH, 0.75 * MOTION_WIDTH)
    shown = np.linspace(0, len(poses) - 1, GHOST_COUNT + 2).astype(int)[1:-1]
    for i, obj in enumerate(objects):
        color = PART_COLORS[i % len(PART_COLORS)]
        for pose in poses[shown, i]:
            draw_outline(ax, obj, pose=pose, color=FAINT_COLOR, alpha=0.5)
        draw_outline(ax, obj, pose=poses[0, i], color=FAINT_COLOR, linestyle="dashed")
        draw_cells(ax, obj, pose=poses[-1, i]).set_facecolor(color)
        if observed is not None:
            draw_outline(ax, obj, pose=observed[i], color=INK_COLOR)
    draw_tips(ax, push, LEARNED_COLOR)
    ax.autoscale_view()
    return figure

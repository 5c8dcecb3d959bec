"""Figures that set predicted beside observed poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import ObservedPush
from gridpush_drake.report.draw import FONT, INK, draw_outline
from gridpush_drake.report.maps import BEFORE, FAINT, LEARNED, PAGE_WIDTH, hide_axes, make_grid, tidy

Array = NDArray[np.float64]

MM = 1e3

MAX_OVERLAYS = 8
"""Pushes drawn one by one."""

MAX_DUMBBELLS = 32
"""Pushes compared line by line; above this, as a scatter of points."""

OVERLAY_COLUMNS = 4

LINE_HEIGHT = 0.22
"""Of a push in the line by line comparison, inches."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """How one push came out.

    Attributes:
        seen: the push.
        before: (3,) final pose predicted with uniform parameters, m and rad.
        after: (3,) as the learned model predicts it.
        error_before: mean cell error, m, of the one.
        error_after: of the other.
        held_out: whether the model never saw it.
    """

    seen: ObservedPush
    before: Array
    after: Array
    error_before: float
    error_after: float
    held_out: bool


def draw_overlays(obj: GridObject, outcomes: Sequence[Outcome]) -> Figure:
    """Draws up to MAX_OVERLAYS pushes: where the object was, where it went, and where it was predicted to go."""
    chosen = outcomes[:MAX_OVERLAYS]
    columns = min(OVERLAY_COLUMNS, max(len(chosen), 1))
    rows = max(1, -(-len(chosen) // columns))
    figure, axes = make_grid(rows, columns, PAGE_WIDTH, PAGE_WIDTH / columns + 0.2)
    for ax in axes.flat[len(chosen) :]:
        ax.set_axis_off()
    for ax, outcome in zip(axes.flat, chosen, strict=False):
        _draw_overlay(ax, obj, outcome)
    handles = [
        Line2D([], [], color=color, linestyle="dashed" if color == FAINT else "solid", linewidth=1.6, label=label)
        for label, color in (
            ("before the push", FAINT),
            ("observed", INK),
            ("uniform friction", BEFORE),
            ("learned", LEARNED),
        )
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=FONT)
    return figure


def _draw_overlay(ax: Axes, obj: GridObject, outcome: Outcome) -> None:
    seen = outcome.seen
    draw_outline(ax, obj, pose=seen.pose, color=FAINT, linestyle="dashed")
    draw_outline(ax, obj, pose=seen.final_pose, color=INK)
    draw_outline(ax, obj, pose=outcome.before, color=BEFORE, alpha=0.9)
    draw_outline(ax, obj, pose=outcome.after, color=LEARNED, alpha=0.9)
    ax.plot(*seen.push.xy.T, color=FAINT, linewidth=1)
    ax.plot(*seen.push.xy[-1], marker="o", markersize=4, color=FAINT)
    ax.autoscale_view()
    kind = ", held out" if outcome.held_out else ""
    hide_axes(ax, f"{seen.name}{kind}\n{outcome.error_before * MM:.1f} → {outcome.error_after * MM:.1f} mm")


def draw_errors(outcomes: Sequence[Outcome]) -> Figure:
    """Draws every push's cell error with uniform friction and as learned."""
    return _draw_dumbbells(outcomes) if len(outcomes) <= MAX_DUMBBELLS else _draw_scatter(outcomes)


def _draw_dumbbells(outcomes: Sequence[Outcome]) -> Figure:
    figure, axes = make_grid(1, 1, 6.5, LINE_HEIGHT * len(outcomes) + 0.9)
    ax = axes[0, 0]
    before, after = _errors(outcomes)
    places = np.arange(len(outcomes))[::-1]
    ax.hlines(places, before, after, color=FAINT, linewidth=1.2)
    ax.plot(before, places, "o", color=BEFORE, markersize=5, label="uniform friction")
    ax.plot(after, places, "o", color=LEARNED, markersize=5, label="learned")
    names = [f"{outcome.seen.name}{' (held out)' if outcome.held_out else ''}" for outcome in outcomes]
    ax.set_yticks(places, names)
    ax.set_xlim(left=0)
    ax.set_ylim(-0.7, len(outcomes) - 0.3)
    tidy(ax, "mean cell error of the final pose, mm", "")
    ax.legend(fontsize=FONT, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure


def _draw_scatter(outcomes: Sequence[Outcome]) -> Figure:
    figure, axes = make_grid(1, 1, 5.0, 4.6)
    ax = axes[0, 0]
    before, after = _errors(outcomes)
    held_out = np.array([outcome.held_out for outcome in outcomes])
    for which, color, label in ((~held_out, LEARNED, "learned from"), (held_out, BEFORE, "held out")):
        if which.any():
            ax.plot(before[which], after[which], "o", color=color, markersize=4, alpha=0.7, label=label)
    most = 1.05 * float(max(before.max(), after.max()))
    ax.plot([0, most], [0, most], color=FAINT, linestyle="dashed", linewidth=1)
    ax.set_xlim(0, most)
    ax.set_ylim(0, most)
    ax.set_aspect("equal")
    tidy(ax, "cell error with uniform friction, mm", "cell error as learned, mm")
    ax.legend(fontsize=FONT, frameon=False, loc="upper left")
    return figure


def _errors(outcomes: Sequence[Outcome]) -> tuple[Array, Array]:
    return (
        np.array([outcome.error_before for outcome in outcomes]) * MM,
        np.array([outcome.error_after for outcome in outcomes]) * MM,
    )

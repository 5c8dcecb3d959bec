"""Error against the number of simulations, as in the paper's Fig. 4."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gridpush_drake.bench.figure_file import save_figure
from gridpush_drake.bench.paper_tables import MM, UNIFORM, Score, mean_simulations, select, summarise

COLUMNS = 3
PANEL = (3.6, 2.7)
"""Width and height of a panel, inches."""


def write_figure(
    path: Path | str, scores: Sequence[Score], names: Sequence[str], methods: Sequence[str], training: int, force: bool
) -> None:
    """Draws a panel for each object and one for all, and writes the figure in the format of its ending.

    Args:
        path: PNG, PDF or SVG.
        scores: of all methods at several budgets.
        names: of the objects.
        methods: to draw.
        training: number of training pushes.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: as `check_figure`.
    """
    from matplotlib.figure import Figure

    panels = [*names, "all objects"]
    height = -(-len(panels) // COLUMNS)
    figure = Figure(figsize=(PANEL[0] * COLUMNS, PANEL[1] * height + 0.6), layout="constrained")
    axes = figure.subplots(height, COLUMNS, squeeze=False, sharex=True, sharey=True).ravel()
    for axis, panel in zip(axes, panels, strict=False):
        _draw_panel(axis, select(scores, training=training, **({"name": panel} if panel in names else {})), methods)
        axis.set_title(panel)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    figure.supxlabel("simulated pushes")
    figure.supylabel("mean test cell error, mm")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    save_figure(figure, path, force)


def _draw_panel(axis, scores: Sequence[Score], methods: Sequence[str]) -> None:  # type: ignore[no-untyped-def]
    """A line for each method over the pushes it simulated, with a band: its interval; a point where it ran once."""
    for i, method in enumerate(methods):
        chosen = select(scores, method=method)
        budgets = sorted({score.budget for score in chosen})
        spent = (
            budgets if method == UNIFORM else [mean_simulations(select(chosen, budget=budget)) for budget in budgets]
        )
        intervals = [summarise(select(chosen, budget=budget)) for budget in budgets]
        mean, low, high = (MM * np.array([getattr(each, key) for each in intervals]) for key in ("mean", "low", "high"))
        style = {"color": "0.4", "linestyle": "--"} if method == UNIFORM else {"color": f"C{i - 1}", "marker": "o"}
        axis.plot(spent, mean, label=method.replace("_", " "), markersize=3 if len(spent) > 1 else 6, **style)
        if len(spent) > 1:
            axis.fill_between(spent, low, high, color=style["color"], alpha=0.15, linewidth=0)
        elif np.isfinite(low).all():
            axis.vlines(spent, low, high, color=style["color"])
    axis.set_xscale("log")
    axis.set_yscale("log")
    for ticks in (axis.xaxis, axis.yaxis):
        ticks.set_major_formatter("{x:g}")
    axis.grid(alpha=0.3)

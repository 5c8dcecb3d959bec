"""The error on the CMU pushes against the number of training pushes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gridpush_drake.bench.figure_file import save_figure
from gridpush_drake.bench.paper_figure import PANEL
from gridpush_drake.bench.real import CENTRE, POSES, UNIFORM, Score, calc_split_means

COLUMNS = 2


def write_curve(
    path: Path | str, scores: Sequence[Score], names: Sequence[str], counts: Sequence[int], force: bool
) -> None:
    """Draws a panel a file and writes the figure.

    Args:
        path: PNG, PDF or SVG.
        scores: of the files' splits.
        names: of the files.
        counts: numbers of training pushes.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: the file exists or cannot be written.
    """
    from matplotlib.figure import Figure

    height = -(-len(names) // COLUMNS)
    figure = Figure(figsize=(PANEL[0] * COLUMNS, PANEL[1] * height + 0.6), layout="constrained")
    axes = figure.subplots(height, COLUMNS, squeeze=False, sharex=True, sharey=True).ravel()
    for axis, name in zip(axes, names, strict=False):
        for model, colour in ((POSES, "tab:blue"), (CENTRE, "tab:orange")):
            means = [calc_split_means(scores, [name], model, count) for count in counts]
            middle = np.array([values.mean() for values in means])
            spread = np.array([values.std(ddof=1) if len(values) > 1 else 0.0 for values in means])
            axis.plot(counts, middle, "o-", color=colour, label=model, markersize=4)
            axis.fill_between(counts, middle - spread, middle + spread, color=colour, alpha=0.15, linewidth=0)
        axis.axhline(calc_split_means(scores, [name], UNIFORM, 0).mean(), color="0.4", linestyle="--", label=UNIFORM)
        axis.set_title(name)
    axes[0].set_ylim(bottom=0)  # shared by all panels
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    figure.supxlabel("training pushes")
    figure.supylabel("held-out error, mm (band: one standard deviation of the splits)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    save_figure(figure, path, force)

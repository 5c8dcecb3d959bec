"""Pictures of `gridpush bench reality`: of each set the object, the pushes and the errors."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gridpush_drake.bench.data.real_sets import RealSet
from gridpush_drake.bench.reality.scores import LCP_ENGINE, RealityScore
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.geometry.se2 import transform_back
from gridpush_drake.report.table import FIGURE_DPI, PANEL_SIZE
from gridpush_drake.units import MM_PER_M

DRAWN_PUSHES = 40
"""Largest number of pushes whose paths are drawn."""

RANK_BINS = 10
"""Number of bins of the ranks."""

PANEL_TITLES = ("pushes, seen from the object", "error, mm", "rank of the error")
"""Titles of the three panels."""


def write_pictures(
    folder: Path, sets: Mapping[str, RealSet], scores: Sequence[RealityScore], force: bool
) -> None:
    """Writes NAME.png of each set into a folder, which is made.

    Args:
        folder: the folder.
        sets: the sets by name.
        scores: what was measured.
        force: whether pictures that exist may be replaced.

    Raises:
        OutputError: a picture cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, known in sets.items():
        path = folder / f"{name.replace('/', '_')}.png"
        check_writable(path, force)
        figure = Figure(figsize=(3 * PANEL_SIZE[0], PANEL_SIZE[1]), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        ours = [score for score in scores if score.name == name and score.engine == LCP_ENGINE]
        _draw_pushes(left, known)
        _draw_errors(middle, ours)
        _draw_ranks(right, ours)
        for axis, title in zip((left, middle, right), PANEL_TITLES, strict=True):
            axis.set_title(title)
        figure.suptitle(f"{name}: {len(known.log)} pushes")
        buffer = BytesIO()
        figure.savefig(buffer, format="png", dpi=FIGURE_DPI)
        write_whole(path, buffer.getvalue(), force)


def _draw_pushes(axis: Axes, known: RealSet) -> None:
    """Draws the object, and the path of each pusher in its frame at the push's beginning."""
    outline = MM_PER_M * np.array(known.obj.outline.exterior.coords)
    axis.fill(*outline.T, color="0.85")
    axis.plot(*outline.T, color="0.3")
    every = -(-len(known.log) // DRAWN_PUSHES)
    for seen in list(known.log)[::every]:
        push = seen.push
        path = MM_PER_M * transform_back(seen.pose, push.xy)
        axis.plot(*path.T, color="tab:blue", linewidth=0.8)
        axis.plot(*path[0], "o", color="tab:blue", markersize=2)
    axis.set_aspect("equal")
    axis.set_xlabel("x, mm")
    axis.set_ylabel("y, mm")


def _draw_errors(axis: Axes, scores: Sequence[RealityScore]) -> None:
    """Draws how many held-out pushes have an error below one, model by model."""
    for model, training in dict.fromkeys((score.model, score.training) for score in scores):
        chosen = [score for score in scores if (score.model, score.training) == (model, training)]
        errors = np.sort([MM_PER_M * error for score in chosen for error in score.errors])
        label = f"{model} ({training})" if training else model
        axis.step(errors, np.arange(1, len(errors) + 1) / len(errors), where="post", label=label)
    axis.set_xscale("log")
    axis.set_ylabel("fraction of the held-out pushes")
    axis.legend(frameon=False)


def _draw_ranks(axis: Axes, scores: Sequence[RealityScore]) -> None:
    """Draws how the ranks are spread, which is evenly where a model states its errors rightly."""
    for model, training in dict.fromkeys((s.model, s.training) for s in scores if s.ranks):
        chosen = [score for score in scores if (score.model, score.training) == (model, training)]
        ranks = [rank for score in chosen for rank in score.ranks]
        bins = np.linspace(0.0, 1.0, RANK_BINS + 1).tolist()
        label = f"{model} ({training})"
        axis.hist(ranks, bins, density=True, histtype="step", label=label)
    axis.axhline(1.0, color="0.4", linestyle="--")
    axis.set_xlabel("probability of a smaller error, as stated")
    axis.set_ylabel("density of the held-out pushes")
    axis.legend(frameon=False)

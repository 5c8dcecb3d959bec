"""How knowledge grew: what was known after each push, and how well each was predicted before it.

A push is predicted here by the estimate that was made of the pushes before it alone. So every error
is that of a prediction, and none of a fit; no push has to be held out for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.exploration.designed_pokes import calc_center_std
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.draw import (
    FONT_SIZE,
    INK_COLOR,
    LEARNED_COLOR,
    PAGE_WIDTH,
    PRIOR_COLOR,
    add_legend_below,
    make_grid,
    tidy,
)
from gridpush_drake.units import MM_PER_M

PANEL_HEIGHT = 3.3
"""Height of the figure, inches."""


@dataclass(frozen=True)
class ExpectedUncertainty:
    """What a push was expected to leave unknown.

    Attributes:
        pushes: how many pushes there were with it.
        center_std: expected standard deviation of the center of mass after it, m.
    """

    pushes: int
    center_std: float


@dataclass(frozen=True, eq=False)
class Progress:
    """How knowledge grew over K pushes.

    Attributes:
        pushes: (K + 1,) numbers of pushes learned from, the first one 0.
        center_std: (K + 1,) standard deviation of the center of mass in the direction in which it
            is known least, m.
        center_error: (K + 1,) distance of the estimated center of mass from the true one, m; empty
            where that is not known.
        names: names of the pushes that were predicted.
        predicted: mean cell error of each of these, as predicted from the pushes before it, m.
        even: mean cell error of each of these, as predicted of an even object, m.
    """

    pushes: Array
    center_std: Array
    center_error: Array
    names: tuple[str, ...]
    predicted: Array
    even: Array

    def describe(self) -> str:
        """Says the errors in a sentence; empty where no push was predicted."""
        if not len(self.predicted):
            return ""
        error = self.predicted.mean() * MM_PER_M
        even = self.even.mean() * MM_PER_M
        return (
            f"On average these predictions were off by {error:.1f} mm; those of an even object "
            f"would have been off by {even:.1f} mm."
        )


def calc_progress(
    estimates: Sequence[Identification], log: PushLog, truth: CellParameters | None = None
) -> Progress:
    """Follows what was learned.

    Args:
        estimates: made while the pushes came in, in order; at least one.
        log: all pushes, in order; those that the estimates do not use are predicted, too. Pushes in
            which a part hung over the table's edge are not.
        truth: what the object's cells really are, where that is known.

    Returns:
        What was known after each estimate, and how well each push was predicted.
    """
    last = estimates[-1]
    obj = last.obj
    stages = [describe_prior(obj, physics=last.physics), *estimates]
    known = [Belief.of_prior(obj), *(_make_uncertain(found, log) for found in estimates)]
    errors = []
    if truth is not None:
        center = truth.center_of_mass(obj)
        errors = [np.linalg.norm(one.params.center_of_mass(obj) - center) for one in stages]
    names = []
    predicted = []
    even = []
    supported = {seen.name for seen in log.supported}
    uniform = Model(obj, physics=last.physics)
    for i, seen in enumerate(log):
        if seen.name not in supported or not len(seen.poses_observed):
            continue
        before = {earlier.name for earlier in log[:i]}
        # The latest estimate that knows nothing of this push, nor of later ones.
        found = [one for one in stages if before.issuperset(one.push_names)][-1]
        names.append(seen.name)
        predicted.append(calc_mean_cell_error(found.with_physics(last.physics), log.subset([i])))
        even.append(calc_mean_cell_error(uniform, log.subset([i])))
    return Progress(
        pushes=np.array([len(found.push_names) for found in stages]),
        center_std=np.array([calc_center_std(model) for model in known]),
        center_error=np.array(errors),
        names=tuple(names),
        predicted=np.array(predicted),
        even=np.array(even),
    )


def draw_progress(progress: Progress, expectations: Sequence[ExpectedUncertainty] = ()) -> Figure:
    """Draws how well the center of mass was known, and how well each push was predicted."""
    figure, axes = make_grid(1, 2, PAGE_WIDTH, PANEL_HEIGHT)
    _draw_center(axes[0, 0], progress, expectations)
    _draw_predicted(axes[0, 1], progress)
    return figure


def _draw_center(ax: Axes, progress: Progress, expectations: Sequence[ExpectedUncertainty]) -> None:
    """Draws the center of mass's standard deviation, expected and found, and its true error."""
    ax.plot(
        progress.pushes, progress.center_std * MM_PER_M, "o-", color=LEARNED_COLOR, markersize=5
    )
    handles = [Line2D([], [], color=LEARNED_COLOR, marker="o", label="standard deviation")]
    if expectations:
        marks: dict[str, Any] = {
            "color": PRIOR_COLOR,
            "marker": "D",
            "markerfacecolor": "white",
            "linestyle": "none",
        }
        at = [one.pushes for one in expectations]
        ax.plot(at, [one.center_std * MM_PER_M for one in expectations], **marks)
        handles.append(Line2D([], [], label="expected before the poke", **marks))
    if len(progress.center_error):
        ax.plot(
            progress.pushes, progress.center_error * MM_PER_M, "x--", color=INK_COLOR, markersize=5
        )
        handles.append(
            Line2D([], [], color=INK_COLOR, marker="x", linestyle="dashed", label="true error")
        )
    ax.set_ylim(bottom=0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    tidy(ax, "pushes learned from", "mm")
    ax.set_title("How well the center of mass is known", fontsize=FONT_SIZE, color=INK_COLOR)
    add_legend_below(ax, handles, 2)


def _draw_predicted(ax: Axes, progress: Progress) -> None:
    """Draws the errors of the pushes that were predicted, and those of an even object."""
    at = np.arange(1, len(progress.names) + 1)
    ax.plot(at, progress.even * MM_PER_M, "o--", color=PRIOR_COLOR, markersize=5)
    ax.plot(at, progress.predicted * MM_PER_M, "o-", color=LEARNED_COLOR, markersize=5)
    handles = [
        Line2D([], [], color=PRIOR_COLOR, marker="o", linestyle="dashed", label="even object"),
        Line2D([], [], color=LEARNED_COLOR, marker="o", label="from the pushes before"),
    ]
    ax.set_ylim(bottom=0)
    ax.set_xticks(at, [name.replace("_", " ") for name in progress.names], rotation=90)
    tidy(ax, "", "mean cell error, mm")
    ax.set_title(
        "Each push, predicted before it was learned from", fontsize=FONT_SIZE, color=INK_COLOR
    )
    add_legend_below(ax, handles, 1)


def _make_uncertain(found: Identification, log: PushLog) -> Belief:
    used = log.subset([i for i, seen in enumerate(log) if seen.name in found.push_names])
    return Belief.of_identification(found, log=used)

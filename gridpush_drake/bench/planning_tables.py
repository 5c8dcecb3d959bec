"""The tables of `gridpush bench planning`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridpush_drake.bench.table import Table, Value

LEARNING, UNIFORM, TRUE, LOOK_AHEAD = "learning", "uniform", "true", "true, two ahead"
"""Which model pushes are planned with: learned on the way, uniform throughout, the truth; that looking two ahead."""

WITHIN = 0.001
"""m by which a decision may be worse than the exhaustive search's and count as good as it."""

ALL = "all"
MM = 1e3
MS = 1e3
PERCENT = 100.0


@dataclass(frozen=True)
class Decision:
    """One choice of a push.

    Attributes:
        name: of the object.
        method: of the search.
        simulations: that it took.
        gap: its cost above the exhaustive search's, m.
        seconds: wall clock.
    """

    name: str
    method: str
    simulations: int
    gap: float
    seconds: float


@dataclass(frozen=True)
class Run:
    """One object pushed towards one goal.

    Attributes:
        name: of the object.
        mode: of the model.
        success: whether it got there.
        fell: whether it fell off the table.
        pushes: made.
        status: that the driver ended with.
        first_error: of the first push's prediction, m; NaN where there was none.
        later_error: mean over the later pushes, m.
        simulations: of the planner.
        planning_seconds: wall clock.
        learning_seconds: wall clock.
    """

    name: str
    mode: str
    success: bool
    fell: bool
    pushes: int
    status: str
    first_error: float
    later_error: float
    simulations: int
    planning_seconds: float
    learning_seconds: float


def tabulate_decisions(decisions: Sequence[Decision], names: Sequence[str]) -> Table:
    """By object: how many simulations a decision takes, and how good it is beside the exhaustive search's."""
    columns = [
        "object", "decisions", "simulations", "most", "within 1 mm, %", "mean gap, mm", "worst gap, mm", "ms",
        "f. d. simulations", "f. d. within 1 mm, %", "f. d. ms", "exhaustive simulations", "exhaustive ms",
    ]  # fmt: skip
    rows: list[list[Value]] = []
    for name in (*names, ALL):
        chosen = [entry for entry in decisions if name in (entry.name, ALL)]
        by_method = {
            method: [entry for entry in chosen if entry.method == method]
            for method in ("gradient", "finite_difference", "exhaustive")
        }
        gradient, differences, exhaustive = by_method.values()
        gap = np.array([entry.gap for entry in gradient])
        rows.append(
            [
                name, len(gradient), _mean_simulations(gradient), max(entry.simulations for entry in gradient),
                PERCENT * _share_within(gradient), MM * float(gap.mean()), MM * float(gap.max()), _median_ms(gradient),
                _mean_simulations(differences), PERCENT * _share_within(differences), _median_ms(differences),
                _mean_simulations(exhaustive), _median_ms(exhaustive),
            ]
        )  # fmt: skip
    notes = [
        "One push towards the goal, the masses drawn by part. A simulation with its exact Jacobian counts as one; one "
        "simulation of a straight push tells the best distance along it too, in every method.",
        "The gradient method's starts are ranked by the ellipsoidal limit surface: no simulation, but counted in ms.",
        "Gap: mean cell error at the push's end above the exhaustive search's; negative is better than its grid.",
        "f. d.: finite differences, the paper's walk along the outline. Times are medians of wall clock.",
    ]
    return Table("Choosing a contact point", columns, rows, notes)


def tabulate_runs(runs: Sequence[Run], names: Sequence[str], modes: Sequence[str], max_pushes: int) -> Table:
    """By model and object: how often the goal is reached, and with how many pushes."""
    columns = [
        "model", "object", "runs", "success, %", "off the table", "pushes", "90 %", "most", "first prediction, mm",
        "later, mm", "simulations", "planning, s", "learning, s",
    ]  # fmt: skip
    rows: list[list[Value]] = []
    for mode in modes:
        for name in (*names, ALL):
            chosen = [run for run in runs if run.mode == mode and name in (run.name, ALL)]
            if not chosen:
                continue
            pushes = np.array([run.pushes for run in chosen])
            rows.append(
                [
                    mode, name, len(chosen), PERCENT * float(np.mean([run.success for run in chosen])),
                    sum(run.fell for run in chosen), float(pushes.mean()), float(np.quantile(pushes, 0.9)),
                    int(pushes.max()), MM * _mean_of_numbers([run.first_error for run in chosen]),
                    MM * _mean_of_numbers([run.later_error for run in chosen]),
                    float(np.mean([run.simulations for run in chosen])),
                    float(np.mean([run.planning_seconds for run in chosen])),
                    float(np.mean([run.learning_seconds for run in chosen])),
                ]
            )  # fmt: skip
    failed = sorted({run.status for run in runs if not run.success})
    notes = [
        f"Success: mean cell error under 2 cm within {max_pushes} pushes, on the round table of radius 0.5 m.",
        "Hidden masses by part; poses seen with 0.5 mm and 0.003 rad of noise. "
        "The table's edge does not change how the object rubs; it falls where its centre of mass loses its support.",
        "Models: learned on the way from the uniform one; uniform throughout; the true one, looking one push ahead "
        "(as the others do) and two.",
        "Predictions: mean cell error of a push's predicted end, of the first push and of the later ones.",
        "Pushes and seconds are means over the runs; the planner's simulations and seconds are a whole run's.",
    ]
    if failed:
        notes.append(f"Runs without success ended with: {', '.join(failed)}.")
    return Table("Pushing to a goal", columns, rows, notes, keys=2)


def _mean_simulations(decisions: Sequence[Decision]) -> float:
    return float(np.mean([entry.simulations for entry in decisions]))


def _share_within(decisions: Sequence[Decision]) -> float:
    return float(np.mean([entry.gap <= WITHIN for entry in decisions]))


def _median_ms(decisions: Sequence[Decision]) -> float:
    return MS * float(np.median([entry.seconds for entry in decisions]))


def _mean_of_numbers(values: Sequence[float]) -> float:
    numbers = [value for value in values if np.isfinite(value)]
    return float(np.mean(numbers)) if numbers else float("nan")

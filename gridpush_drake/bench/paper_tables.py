"""The scores of `bench.paper` as tables, with bootstrap confidence intervals over mass sets and their splits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridpush_drake.bench.paper_protocol import (
    DURATION,
    FINGER_RADIUS,
    OBSERVED_EVERY,
    SPEED,
    SUPPORT_FRICTION,
)
from gridpush_drake.bench.table import Table, Value

UNIFORM = "uniform prior"
DEFAULT = "default"

CONFIDENCE = 0.95
RESAMPLES = 9999
MM = 1e3

PAPER_MM = 15.3
"""The paper's mean test cell error in simulation."""


@dataclass(frozen=True)
class Score:
    """How a method did on one object with one mass set and its split.

    Attributes:
        name: of the object.
        mass_set: number of the mass set and of the split.
        training: number of training pushes.
        method: of identification.
        budget: simulated pushes it might spend.
        simulations: those it did.
        error: mean final cell error of the test pushes, m.
    """

    name: str
    mass_set: int
    training: int
    method: str
    budget: int
    simulations: int
    error: float


@dataclass(frozen=True)
class Interval:
    """A mean and the ends of its confidence interval, NaN where one value does not give any."""

    mean: float
    low: float
    high: float


def calc_interval(values: Sequence[float], seed: int = 0) -> Interval:
    """Mean and its 95 % bootstrap interval (percentiles)."""
    from scipy.stats import bootstrap

    sample = np.asarray(values, dtype=np.float64)
    if len(sample) < 2:
        return Interval(float(sample.mean()), np.nan, np.nan)
    ends = bootstrap(
        (sample,), np.mean, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, method="percentile",
        random_state=np.random.default_rng(seed),
    ).confidence_interval  # fmt: skip
    return Interval(float(sample.mean()), float(ends.low), float(ends.high))


def summarise(scores: Sequence[Score]) -> Interval:
    """The mean error, m: of each mass set over the objects, then over the mass sets; the interval is over these."""
    sets = sorted({score.mass_set for score in scores})
    return calc_interval([float(np.mean([s.error for s in scores if s.mass_set == i])) for i in sets])


def select(scores: Sequence[Score], **wanted: object) -> list[Score]:
    """The scores whose attributes are as given."""
    return [score for score in scores if all(getattr(score, key) == value for key, value in wanted.items())]


def tabulate_methods(
    scores: Sequence[Score], names: Sequence[str], methods: Sequence[str], training: int, budget: int
) -> Table:
    """Errors by method and object."""
    rows: list[list[Value]] = []
    for method in methods:
        chosen = select(scores, method=method, training=training, budget=budget)
        rows.append([method, *_cells(chosen, names), mean_simulations(chosen)])
    title = f"Mean test cell error, mm, by method: {training} training pushes, searches of {budget} simulated pushes"
    return Table(title, ("method", *names, "all", "simulations"), rows, [*_notes(scores), _describe_truth()])


def tabulate_training(scores: Sequence[Score], names: Sequence[str], method: str, budget: int) -> Table:
    """Errors of one method by number of training pushes."""
    rows: list[list[Value]] = []
    for training in sorted({score.training for score in scores}):
        chosen = select(scores, method=method, training=training, budget=budget)
        before = select(scores, method=UNIFORM, training=training, budget=budget)
        rows.append([training, *_cells(chosen, names), _format(summarise(before)), mean_simulations(chosen)])
    columns = ("training pushes", *names, "all", f"all, {UNIFORM}", "simulations")
    return Table(f"Mean test cell error, mm, of the {method} method by training pushes", columns, rows, _notes(scores))


def tabulate_budgets(scores: Sequence[Score], methods: Sequence[str], training: int) -> Table:
    """Errors over all objects by method and number of simulations."""
    budgets = sorted({score.budget for score in select(scores, training=training)})
    rows: list[list[Value]] = []
    for method in methods:
        chosen = select(scores, method=method, training=training)
        rows.append([method, *(_format_some(select(chosen, budget=budget)) for budget in budgets)])
    title = f"Mean test cell error, mm, by simulated pushes: {training} training pushes, all objects"
    return Table(title, ("method", *(f"at most {budget}" for budget in budgets)), rows, _notes(scores))


def _cells(scores: Sequence[Score], names: Sequence[str]) -> list[Value]:
    return [*(_format(summarise(select(scores, name=name))) for name in names), _format(summarise(scores))]


def mean_simulations(scores: Sequence[Score]) -> int:
    """Mean number of simulated pushes."""
    return round(float(np.mean([score.simulations for score in scores])))


def _format(interval: Interval) -> str:
    mean = f"{interval.mean * MM:.2f}"
    return mean if np.isnan(interval.low) else f"{mean} ({interval.low * MM:.2f} to {interval.high * MM:.2f})"


def _format_some(scores: Sequence[Score]) -> str | None:
    return _format(summarise(scores)) if scores else None


def _notes(scores: Sequence[Score]) -> list[str]:
    sets = len({score.mass_set for score in scores})
    return [
        f"Mean over {sets} mass sets, each with its own split; in brackets its {CONFIDENCE:.0%} bootstrap interval.",
        f"The paper reports {PAPER_MM:g} mm in simulation.",
    ]


def _describe_truth() -> str:
    return (
        f"Truth: our inertial simulation, hidden masses by label, friction {SUPPORT_FRICTION:g}, ten pushes at "
        f"{SPEED:g} m/s for {DURATION:g} s by a disc of {FINGER_RADIUS * 100:g} cm radius in place of the paper's 3 cm "
        f"square finger, pose seen every {OBSERVED_EVERY:g} s. The identifier sees neither labels nor the total mass."
    )

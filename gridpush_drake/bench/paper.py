"""`gridpush bench paper`: every method on the paper's simulated protocol, over the same number of simulations.

The scores have bootstrap confidence intervals over mass sets and their splits; the figure shows the
error against the number of simulations, as the paper's Fig. 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import bootstrap

from gridpush_drake.bench.jobs import QUIET, Execution, check_known, run_jobs
from gridpush_drake.bench.protocol import (
    DURATION,
    FINGER_RADIUS,
    MASS_SETS,
    OBSERVED_EVERY,
    SPEED,
    SUPPORT_FRICTION,
    Case,
    Protocol,
    make_case,
    make_protocol,
)
from gridpush_drake.bench.table import (
    CONFIDENCE,
    MM,
    Column,
    Mean,
    Table,
    check_figure,
    write_panels,
)
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import import_extra
from gridpush_drake.identification.learning import METHODS, identify
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.objects.parameters import CellParameters

UNIFORM = "uniform prior"
DEFAULT = "default"

RESAMPLES = 9999

PAPER_MM = 15.3
"""The paper's mean test cell error in simulation."""


@dataclass(frozen=True)
class Score:
    """How a method did on one object with one mass set and its split: mean final cell error of its test pushes, m.

    It might spend `budget` simulated pushes, and did spend `simulations`.
    """

    name: str
    mass_set: int
    training: int
    method: str
    budget: int
    simulations: int
    error: float


class Interval(NamedTuple):
    """A mean and the ends of its confidence interval, NaN where one value does not give any."""

    mean: float
    low: float
    high: float


def calc_interval(values: Sequence[float]) -> Interval:
    """Mean and its 95 % bootstrap interval (percentiles)."""
    sample = np.asarray(values, dtype=np.float64)
    if len(sample) < 2:
        return Interval(float(sample.mean()), np.nan, np.nan)
    ends = bootstrap(
        (sample,), np.mean, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, method="percentile",
        random_state=np.random.default_rng(0),
    ).confidence_interval  # fmt: skip
    return Interval(float(sample.mean()), float(ends.low), float(ends.high))


def summarize(scores: Sequence[Score]) -> Interval:
    """The mean error, m: of each mass set over the objects, then over the mass sets; the interval is over these."""
    sets = sorted({score.mass_set for score in scores})
    return calc_interval(
        [float(np.mean([s.error for s in scores if s.mass_set == i])) for i in sets]
    )


def select(scores: Sequence[Score], **wanted: object) -> list[Score]:
    """The scores whose attributes are as given."""
    return [
        score
        for score in scores
        if all(getattr(score, key) == value for key, value in wanted.items())
    ]


def tabulate_methods(
    scores: Sequence[Score],
    names: Sequence[str],
    methods: Sequence[str],
    training: int,
    budget: int,
) -> Table:
    """Errors by method and object."""
    groups = [
        ((method,), select(scores, method=method, training=training, budget=budget))
        for method in methods
    ]
    title = f"Mean test cell error, mm, by method: {training} training pushes, searches of {budget} simulated pushes"
    columns = {**_error_columns(names), "simulations": mean_simulations}
    notes = [
        *_notes(scores),
        f"Truth: our inertial simulation, hidden masses by label, friction {SUPPORT_FRICTION:g}, ten pushes at "
        f"{SPEED:g} m/s for {DURATION:g} s by a disc of {FINGER_RADIUS * 100:g} cm radius in place of the paper's 3 cm "
        f"square finger, pose seen every {OBSERVED_EVERY:g} s. The identifier sees neither labels nor the total mass.",
    ]
    return Table.of(title, ("method",), groups, columns, notes)


def tabulate_training(
    scores: Sequence[Score], names: Sequence[str], method: str, budget: int
) -> Table:
    """Errors of one method by number of training pushes."""
    counts = sorted({score.training for score in scores})
    groups = [
        ((count,), select(scores, method=method, training=count, budget=budget)) for count in counts
    ]

    def average_before(chosen: Sequence[Score]) -> Mean | None:
        return _average(scores, method=UNIFORM, training=chosen[0].training, budget=budget)

    columns = {
        **_error_columns(names),
        f"all, {UNIFORM}": average_before,
        "simulations": mean_simulations,
    }
    title = f"Mean test cell error, mm, of the {method} method by training pushes"
    return Table.of(title, ("training pushes",), groups, columns, _notes(scores))


def tabulate_budgets(scores: Sequence[Score], methods: Sequence[str], training: int) -> Table:
    """Errors over all objects by method and number of simulations."""
    groups = [((method,), select(scores, method=method, training=training)) for method in methods]
    budgets = sorted({score.budget for score in select(scores, training=training)})
    columns = {f"at most {budget}": partial(_average, budget=budget) for budget in budgets}
    title = (
        f"Mean test cell error, mm, by simulated pushes: {training} training pushes, all objects"
    )
    return Table.of(title, ("method",), groups, columns, _notes(scores))


def _error_columns(names: Sequence[str]) -> dict[str, Column]:
    return {**{name: partial(_average, name=name) for name in names}, "all": _average}


def mean_simulations(scores: Sequence[Score]) -> int:
    """Mean number of simulated pushes."""
    return round(float(np.mean([score.simulations for score in scores])))


def _average(scores: Sequence[Score], **wanted: object) -> Mean | None:
    chosen = select(scores, **wanted)
    if not chosen:
        return None
    mean, low, high = (MM * value for value in summarize(chosen))
    return Mean(mean) if np.isnan(low) else Mean(mean, low, high)


def _notes(scores: Sequence[Score]) -> list[str]:
    sets = len({score.mass_set for score in scores})
    return [
        f"Mean over {sets} mass sets, each with its own split; in brackets its {CONFIDENCE:.0%} bootstrap interval.",
        f"The paper reports {PAPER_MM:g} mm in simulation.",
    ]


TRUTH_PHYSICS = Physics(regime="inertial")
TRAINING_PUSHES = 5
BUDGET = 1500
"""Simulated pushes a search may spend; the default method decides itself, and takes about two
thirds of it."""

BUDGET_SHARES = (1 / 60, 1 / 30, 1 / 15, 1 / 6, 1 / 3, 1.0)
"""Shares of the budget at which the curve is measured, each by a run of its own."""

QUICK_MASS_SETS = 2


@dataclass(frozen=True)
class Job:
    """One object with one mass set and its split, learned from by some methods at some budgets."""

    data: Path | None
    name: str
    mass_set: int
    training: int
    methods: tuple[str, ...]
    budgets: tuple[int, ...]
    seed: int


def run(
    data: Path | str | None = None,
    mass_sets: int = MASS_SETS,
    objects: Sequence[str] | None = None,
    methods: Sequence[str] = METHODS,
    budget: int = BUDGET,
    seed: int = 0,
    execution: Execution = QUIET,
    *,
    quick: bool = False,
    figure: Path | str | None = None,
    force: bool = False,
) -> list[Table]:
    """Measures the methods on the paper's simulated protocol; the arguments are the options of `gridpush bench paper`.

    Mass set i goes with split i, and only QUICK_MASS_SETS of them are taken where `quick`. The
    default method decides itself how much of the budget it spends.

    Returns:
        Test cell error by method and object; by number of training pushes for the default method;
        and, with `figure`, by number of simulations.

    Raises:
        GridPushError: the data are not there, or an argument is out of range.
        MissingExtraError: CMA-ES is to be measured, and the package cma is not installed.
        OutputError: the figure cannot be written.
    """
    folder = None if data is None else Path(data).resolve()
    protocol = make_protocol(folder, seed)
    names = list(protocol.masses if objects is None else objects)
    sets = min(mass_sets, QUICK_MASS_SETS) if quick else mass_sets
    _check(protocol, names, methods, budget, sets)
    if figure is not None:
        check_figure(figure, force)
    budgets = choose_budgets(budget) if figure is not None else (budget,)
    others = [count for count in protocol.splits if count != TRAINING_PUSHES and DEFAULT in methods]
    jobs = [
        job
        for mass_set in range(sets)
        for name in names
        for job in (
            Job(folder, name, mass_set, TRAINING_PUSHES, tuple(methods), budgets, seed),
            *(
                Job(folder, name, mass_set, count, (DEFAULT,), budgets[-1:], seed)
                for count in others
            ),
        )
    ]
    done = run_jobs(
        run_job,
        jobs,
        lambda job: f"{job.name}, mass set {job.mass_set}, {job.training} training pushes",
        execution,
    )
    scores = [score for scores in done for score in scores]
    tables = [tabulate_methods(scores, names, (UNIFORM, *methods), TRAINING_PUSHES, budget)]
    if DEFAULT in methods:
        tables.append(tabulate_training(scores, names, DEFAULT, budget))
    if figure is not None:
        tables.append(tabulate_budgets(scores, (UNIFORM, *methods), TRAINING_PUSHES))
        write_figure(figure, scores, names, (UNIFORM, *methods), TRAINING_PUSHES, force)
    return tables


def choose_budgets(budget: int) -> tuple[int, ...]:
    """The budgets at which a curve is measured, the last one `budget`."""
    return tuple(sorted({max(TRAINING_PUSHES, round(budget * share)) for share in BUDGET_SHARES}))


def run_job(job: Job) -> list[Score]:
    """Identifies one case by each method at each budget, by the default only once, and predicts its test pushes."""
    protocol, case = (
        make_protocol(job.data, job.seed),
        _make_case(job.data, job.seed, job.name, job.mass_set),
    )
    split = protocol.splits[job.training][job.mass_set]
    train, test = case.log.subset(split.train), case.log.subset(split.test)

    def score(
        method: str, budget: int, simulations: int, params: CellParameters, physics: Physics
    ) -> Score:
        error = calc_mean_cell_error(case.obj, params, test, physics)
        return Score(job.name, job.mass_set, job.training, method, budget, simulations, error)

    scores = []
    for budget in job.budgets:
        scores.append(score(UNIFORM, budget, 0, CellParameters.uniform(case.obj), TRUTH_PHYSICS))
        for method in job.methods:
            if method == DEFAULT and budget != job.budgets[-1]:
                continue
            found = identify(case.obj, train, method=method, seed=job.seed, budget=budget)
            scores.append(score(method, budget, found.simulations, found.params, found.physics))
    return scores


def _check(
    protocol: Protocol, names: Sequence[str], methods: Sequence[str], budget: int, sets: int
) -> None:
    check_known("objects", names, tuple(protocol.masses))
    check_known("methods", methods, METHODS)
    if "cma_es" in methods:
        # said before the first job, not in one that runs after an hour of others
        import_extra("cma", "baselines")
    most = min(
        len(protocol.splits[TRAINING_PUSHES]), *(len(protocol.masses[name]) for name in names)
    )
    if not 1 <= sets <= most:
        raise GridPushError(f"mass sets: {sets}; expected 1 to {most}")
    if budget < TRAINING_PUSHES:
        raise GridPushError(
            f"budget: {budget}; expected at least {TRAINING_PUSHES}, one for each training push"
        )


@lru_cache(maxsize=1)
def _make_case(data: Path | None, seed: int, name: str, mass_set: int) -> Case:
    return make_case(make_protocol(data, seed), name, mass_set)


COLUMNS = 3
"""Of a figure's panels."""

ALL_OBJECTS = "all objects"


def write_figure(
    path: Path | str,
    scores: Sequence[Score],
    names: Sequence[str],
    methods: Sequence[str],
    training: int,
    force: bool,
) -> None:
    """Draws a panel for each object and one for all, see `write_panels`; scores of several budgets are connected."""

    def draw(axis: Axes, panel: str) -> None:
        of_panel = {} if panel == ALL_OBJECTS else {"name": panel}
        draw_panel(axis, select(scores, training=training, **of_panel), methods)

    labels = ("simulated pushes", "mean test cell error, mm")
    write_panels(path, [*names, ALL_OBJECTS], COLUMNS, labels, draw, force)


def draw_panel(axis: Axes, scores: Sequence[Score], methods: Sequence[str]) -> None:
    """A line for each method over the pushes it simulated, with a band: its interval; a point where it ran once."""
    for i, method in enumerate(methods):
        chosen = select(scores, method=method)
        budgets = sorted({score.budget for score in chosen})
        spent = (
            budgets
            if method == UNIFORM
            else [mean_simulations(select(chosen, budget=budget)) for budget in budgets]
        )
        mean, low, high = (
            MM * np.array([summarize(select(chosen, budget=budget)) for budget in budgets]).T
        )
        style: dict[str, Any] = (
            {"color": "0.4", "linestyle": "--"}
            if method == UNIFORM
            else {"color": f"C{i - 1}", "marker": "o"}
        )
        axis.plot(
            spent,
            mean,
            label=method.replace("_", " "),
            markersize=3 if len(spent) > 1 else 6,
            **style,
        )
        if len(spent) > 1:
            axis.fill_between(spent, low, high, color=style["color"], alpha=0.15, linewidth=0)
        elif np.isfinite(low).all():
            axis.vlines(spent, low, high, color=style["color"])
    axis.set_xscale("log")
    axis.set_yscale("log")
    for ticks in (axis.xaxis, axis.yaxis):
        ticks.set_major_formatter("{x:g}")
    axis.grid(alpha=0.3)

"""`gridpush bench paper`: every method on the paper's simulated protocol, over the same number of simulations."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from gridpush_drake.bench.paper_protocol import MASS_SETS, Case, Protocol, make_case, make_protocol
from gridpush_drake.bench.paper_tables import (
    DEFAULT,
    UNIFORM,
    Score,
    tabulate_budgets,
    tabulate_methods,
    tabulate_training,
)
from gridpush_drake.bench.table import Table
from gridpush_drake.bench.workers import QUIET, Conduct, run_jobs
from gridpush_drake.errors import GridPushError
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.identify import METHODS, identify
from gridpush_drake.identification.prediction import calc_pose_error, predict
from gridpush_drake.pushes.log import PushLog

TRUTH_REGIME = "inertial"
TRAINING_PUSHES = 5
BUDGET = 1500
"""Simulated pushes a search may spend; the default method decides itself, and takes about two thirds of it."""

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
    conduct: Conduct = QUIET,
    *,
    quick: bool = False,
    figure: Path | str | None = None,
    force: bool = False,
) -> list[Table]:
    """Measures the methods on the paper's simulated protocol.

    Args:
        data: folder of the paper's masks; None for the shipped objects alone.
        mass_sets: how many of an object's ten mass sets; set i goes with split i.
        objects: their names; all where None: the shipped ones, and those of the data.
        methods: of `identify`.
        budget: most simulated pushes of a search; the default method decides itself.
        seed: of everything random.
        conduct: how the jobs are run.
        quick: only `QUICK_MASS_SETS` mass sets.
        figure: file for the curve of the error against the number of simulations, by its ending (PNG, PDF, SVG).
        force: whether an existing figure may be replaced.

    Returns:
        Test cell error by method and object; by number of training pushes for the default method; and, with
        `figure`, by number of simulations.

    Raises:
        GridPushError: the data are not there, or an argument is out of range.
        OutputError: the figure cannot be written.
    """
    from gridpush_drake.bench.figure_file import check_figure
    from gridpush_drake.bench.paper_figure import write_figure

    folder = None if data is None else Path(data).resolve()
    protocol = make_protocol(folder, seed)
    names = list(protocol.masses if objects is None else objects)
    sets = min(mass_sets, QUICK_MASS_SETS) if quick else mass_sets
    _check(protocol, names, methods, budget, sets)
    if figure is not None:
        check_figure(figure, force)
    shares = BUDGET_SHARES if figure is not None else (1.0,)
    budgets = tuple(sorted({max(TRAINING_PUSHES, round(budget * share)) for share in shares}))
    jobs = _make_jobs(protocol, folder, names, sets, tuple(methods), budgets, seed)
    done = run_jobs(run_job, jobs, _describe, conduct)
    scores = [score for scores in done for score in scores]
    tables = [tabulate_methods(scores, names, (UNIFORM, *methods), TRAINING_PUSHES, budget)]
    if DEFAULT in methods:
        tables.append(tabulate_training(scores, names, DEFAULT, budget))
    if figure is not None:
        tables.append(tabulate_budgets(scores, (UNIFORM, *methods), TRAINING_PUSHES))
        write_figure(figure, scores, names, (UNIFORM, *methods), TRAINING_PUSHES, force)
    return tables


def run_job(job: Job) -> list[Score]:
    """Identifies one case by each method at each budget, by the default only once, and predicts its test pushes."""
    protocol, case = _make_protocol(job.data, job.seed), _make_case(job.data, job.seed, job.name, job.mass_set)
    split = protocol.splits[job.training][job.mass_set]
    train, test = case.log.subset(split.train), case.log.subset(split.test)

    def score(method: str, budget: int, simulations: int, params: CellParameters, regime: str) -> Score:
        error = calc_test_error(case, params, test, regime)
        return Score(job.name, job.mass_set, job.training, method, budget, simulations, error)

    scores = []
    for budget in job.budgets:
        scores.append(score(UNIFORM, budget, 0, CellParameters.uniform(case.obj), TRUTH_REGIME))
        for method in job.methods:
            if method == DEFAULT and budget != job.budgets[-1]:
                continue
            found = identify(case.obj, train, method=method, seed=job.seed, budget=budget)
            scores.append(score(method, budget, found.simulations, found.params, found.regime))
    return scores


def calc_test_error(case: Case, params: CellParameters, test: PushLog, regime: str) -> float:
    """Mean over pushes of the mean distance of the cells between predicted and observed final poses, m."""
    pairs = zip(predict(case.obj, params, test, regime), test, strict=True)
    return float(np.mean([calc_pose_error(case.obj, made.poses[-1], seen.final_pose).cell for made, seen in pairs]))


def _check(protocol: Protocol, names: Sequence[str], methods: Sequence[str], budget: int, sets: int) -> None:
    for what, given, known in (("objects", names, tuple(protocol.masses)), ("methods", methods, METHODS)):
        unknown = [name for name in given if name not in known]
        if unknown or not given:
            raise GridPushError(f"{what}: {', '.join(unknown) or 'none'}; expected some of {', '.join(known)}")
    most = min(len(protocol.splits[TRAINING_PUSHES]), *(len(protocol.masses[name]) for name in names))
    if not 1 <= sets <= most:
        raise GridPushError(f"mass sets: {sets}; expected 1 to {most}")
    if budget < TRAINING_PUSHES:
        raise GridPushError(f"budget: {budget}; expected at least {TRAINING_PUSHES}, one for each training push")


def _make_jobs(
    protocol: Protocol,
    data: Path | None,
    names: Sequence[str],
    sets: int,
    methods: tuple[str, ...],
    budgets: tuple[int, ...],
    seed: int,
) -> list[Job]:
    jobs = []
    for mass_set in range(sets):
        for name in names:
            jobs.append(Job(data, name, mass_set, TRAINING_PUSHES, methods, budgets, seed))
            others = [count for count in protocol.splits if count != TRAINING_PUSHES and DEFAULT in methods]
            jobs += [Job(data, name, mass_set, count, (DEFAULT,), budgets[-1:], seed) for count in others]
    return jobs


def _describe(job: Job) -> str:
    return f"{job.name}, mass set {job.mass_set}, {job.training} training pushes"


@lru_cache(maxsize=1)
def _make_protocol(data: Path | None, seed: int) -> Protocol:
    return make_protocol(data, seed)


@lru_cache(maxsize=1)
def _make_case(data: Path | None, seed: int, name: str, mass_set: int) -> Case:
    return make_case(_make_protocol(data, seed), name, mass_set)

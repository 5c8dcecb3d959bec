"""`gridpush bench paper`: every method on the paper's simulated protocol.

All methods may spend the same number of simulations.

The scores have bootstrap confidence intervals over mass sets and their splits. The figure shows the
error against the number of simulations, as the paper's Fig. 4 does. The paper's own figures are
made in `bench.paper_figures`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from gridpush_drake.bench.data.protocol import (
    FINGER_RADIUS,
    MASS_SETS,
    OBSERVED_EVERY,
    PUSH_DURATION,
    PUSH_SPEED,
    SUPPORT_FRICTION,
    Protocol,
    ProtocolCase,
    make_case,
    make_protocol,
)
from gridpush_drake.bench.study import (
    MASKS_OPTION,
    OBJECTS_OPTION,
    Done,
    JobKind,
    Study,
    StudyOptions,
    option,
)
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import import_extra
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.methods import METHOD_NAMES
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.jobs.run import check_known
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.report.table import (
    INTERVAL_CONFIDENCE,
    Column,
    Mean,
    Table,
    calc_interval,
    check_figure,
    write_panels,
)
from gridpush_drake.units import MM_PER_M

UNIFORM_PRIOR = "uniform prior"
"""Name of the model of which nothing was learned."""

DEFAULT_METHOD = "default"
"""Name of the default method of `identify`."""

PAPER_MM = 15.3
"""The paper's mean test cell error in simulation, mm."""

TRUTH_PHYSICS = Physics(regime="inertial")
"""Physics of the pushes that are learned from."""

TRAINING_PUSHES = 5
"""Number of pushes that all methods learn from."""

DEFAULT_BUDGET = 1500
"""Default of the greatest number of simulated pushes of a search. The default method decides
itself, and takes about two thirds of it."""

BUDGET_FRACTIONS = (1 / 60, 1 / 30, 1 / 15, 1 / 6, 1 / 3, 1.0)
"""Fractions of the budget at which the curve is measured, each by a run of its own."""

QUICK_MASS_SETS = 2
"""Number of mass sets of each object in the quick variant."""

PANEL_COLUMNS = 3
"""Number of columns of the figure's panels."""

ALL_OBJECTS = "all objects"
"""Title of the figure's panel of all objects."""


@dataclass(frozen=True)
class PaperScore:
    """How a method did on one object with one mass set and its split.

    Attributes:
        name: name of the object.
        mass_set: number of the mass set and of the split.
        training: number of training pushes.
        method: the method, or UNIFORM_PRIOR.
        budget: greatest number of simulated pushes that it might spend.
        simulations: number of simulated pushes that it spent.
        error: mean final cell error of the test pushes, m.
    """

    name: str
    mass_set: int
    training: int
    method: str
    budget: int
    simulations: int
    error: float


def summarize(scores: Sequence[PaperScore]) -> Mean:
    """Calculates the mean error, mm, and its interval.

    The mean is of each mass set over the objects, then over the mass sets; the interval is over
    these.
    """
    sets = sorted({score.mass_set for score in scores})
    return calc_interval(
        [float(np.mean([s.error for s in scores if s.mass_set == i])) for i in sets], MM_PER_M
    )


def select(scores: Sequence[PaperScore], **wanted: object) -> list[PaperScore]:
    """Selects the scores whose attributes are as given."""
    return [
        score
        for score in scores
        if all(getattr(score, key) == value for key, value in wanted.items())
    ]


def tabulate_methods(
    scores: Sequence[PaperScore],
    names: Sequence[str],
    methods: Sequence[str],
    training: int,
    budget: int,
) -> Table:
    """Tabulates the errors by method and object."""
    groups = [
        ((method,), select(scores, method=method, training=training, budget=budget))
        for method in methods
    ]
    title = (
        f"Mean test cell error, mm, by method: {training} training pushes, searches of {budget} "
        "simulated pushes"
    )
    columns = {**_make_error_columns(names), "simulations": mean_simulations}
    notes = [
        *_notes(scores),
        f"Truth: our inertial simulation, hidden masses by label, friction {SUPPORT_FRICTION:g}, "
        f"ten pushes at {PUSH_SPEED:g} m/s for {PUSH_DURATION:g} s by a disc of "
        f"{FINGER_RADIUS * 100:g} cm "
        f"radius in place of the paper's 3 cm square finger, pose seen every {OBSERVED_EVERY:g} s. "
        "The identifier sees neither the total mass nor, without --show-parts, labels.",
    ]
    return Table.of(title, ("method",), groups, columns, notes)


def tabulate_training(
    scores: Sequence[PaperScore], names: Sequence[str], method: str, budget: int
) -> Table:
    """Tabulates the errors of one method by number of training pushes."""
    counts = sorted({score.training for score in scores})
    groups = [
        ((count,), select(scores, method=method, training=count, budget=budget)) for count in counts
    ]

    def average_before(chosen: Sequence[PaperScore]) -> Mean | None:
        return _average(scores, method=UNIFORM_PRIOR, training=chosen[0].training, budget=budget)

    columns = {
        **_make_error_columns(names),
        f"all, {UNIFORM_PRIOR}": average_before,
        "simulations": mean_simulations,
    }
    title = f"Mean test cell error, mm, of the {method} method by training pushes"
    return Table.of(title, ("training pushes",), groups, columns, _notes(scores))


def tabulate_budgets(scores: Sequence[PaperScore], methods: Sequence[str], training: int) -> Table:
    """Tabulates the errors over all objects by method and number of simulations."""
    groups = [((method,), select(scores, method=method, training=training)) for method in methods]
    budgets = sorted({score.budget for score in select(scores, training=training)})
    columns = {f"at most {budget}": partial(_average, budget=budget) for budget in budgets}
    title = (
        f"Mean test cell error, mm, by simulated pushes: {training} training pushes, all objects"
    )
    return Table.of(title, ("method",), groups, columns, _notes(scores))


def _make_error_columns(names: Sequence[str]) -> dict[str, Column]:
    return {**{name: partial(_average, name=name) for name in names}, "all": _average}


def mean_simulations(scores: Sequence[PaperScore]) -> int:
    """Calculates the mean number of simulated pushes."""
    return round(float(np.mean([score.simulations for score in scores])))


def _average(scores: Sequence[PaperScore], **wanted: object) -> Mean | None:
    """Calculates the mean error of some scores, mm; None where there are none."""
    chosen = select(scores, **wanted)
    return summarize(chosen) if chosen else None


def _notes(scores: Sequence[PaperScore]) -> list[str]:
    sets = len({score.mass_set for score in scores})
    return [
        f"Mean over {sets} mass sets, each with its own split; in brackets its "
        f"{INTERVAL_CONFIDENCE:.0%} "
        "bootstrap interval.",
        f"The paper reports {PAPER_MM:g} mm in simulation.",
    ]


@dataclass(frozen=True)
class PaperBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        data: folder of the paper's masks; None for the shipped objects alone.
        objects: names of objects; all of them where None.
        sets: number of mass sets of each object; mass set i goes with split i.
        methods: methods of `identify`; all of them where None.
        budget: greatest number of simulated pushes of an identification. The default method decides
            itself how much of it it spends.
        show_parts: whether the default method sees which cells are of one part.
        density_spread: geometric standard deviation of the densities that it is told of these
            parts; None to tell none.
        figure: file of a figure of the error against the number of simulations; None for none.
    """

    data: Path | None = option(None, **MASKS_OPTION)
    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    sets: int = option(MASS_SETS, "Mass sets of each object.", least=1)
    methods: tuple[str, ...] | None = option(
        None, "A method; may be repeated.", name="--method", metavar="NAME", shown="all"
    )
    budget: int = option(DEFAULT_BUDGET, "Most simulated pushes of an identification.", least=1)
    show_parts: bool = option(
        False, "Show the learner which cells are of one part, as by their colors."
    )
    density_spread: float | None = option(
        None,
        "With --show-parts, also tell the learner the density of each part, wrong by a random "
        "factor of this geometric standard deviation, which it is told, too: 1.2 or 2.",
        metavar="FACTOR",
        shown="no densities",
        least=1,
    )
    figure: Path | None = option(
        None,
        "Also draw the error against the number of simulations.",
        metavar="FIGURE.png",
        ending=".png",
        is_setting=False,
    )

    @property
    def chosen_methods(self) -> tuple[str, ...]:
        """The methods that are measured."""
        return tuple(METHOD_NAMES) if self.methods is None else self.methods

    @property
    def folder(self) -> Path | None:
        """The folder of the masks, in full."""
        return None if self.data is None else Path(self.data).resolve()

    @property
    def budgets(self) -> tuple[int, ...]:
        """The budgets at which the error is measured; one, but for the figure."""
        return (self.budget,) if self.figure is None else choose_budgets(self.budget)


@dataclass(frozen=True)
class PaperJob:
    """One object with one mass set and its split, learned from by some methods at some budgets.

    Attributes:
        data: folder of the paper's masks; None without them.
        name: name of the object.
        mass_set: number of the mass set and of the split.
        training: number of training pushes.
        methods: methods of `identify`.
        budgets: greatest numbers of simulated pushes.
        seed: seed of everything random.
        show_parts: whether the learner sees which cells are of one part.
        density_spread: geometric standard deviation of the densities that it is told of these
            parts; None to tell none.
    """

    data: Path | None
    name: str
    mass_set: int
    training: int
    methods: tuple[str, ...]
    budgets: tuple[int, ...]
    seed: int
    show_parts: bool = False
    density_spread: float | None = None


def shorten(options: PaperBenchOptions) -> PaperBenchOptions:
    """Makes the options of the quick variant."""
    return replace(options, sets=min(options.sets, QUICK_MASS_SETS))


def make_jobs(options: PaperBenchOptions) -> list[PaperJob]:
    """Makes the jobs of each mass set and object.

    All methods learn from TRAINING_PUSHES pushes. The default method learns from every other number
    of pushes that the protocol has splits for, too.

    Raises:
        GridPushError: the data are not there, or an option is out of range.
        MissingExtraError: CMA-ES is to be measured, and the package cma is not installed.
        OutputError: the figure cannot be written.
    """
    protocol = make_protocol(options.folder, options.seed)
    names = _list_names(options, protocol)
    _check(protocol, names, options.chosen_methods, options.budget, options.sets)
    if options.density_spread is not None and not options.show_parts:
        raise GridPushError(
            f"density spread: {options.density_spread:g}; expected --show-parts with it"
        )
    if options.figure is not None:
        check_figure(options.figure, options.force)
    others = [count for count in protocol.splits if count != TRAINING_PUSHES]
    jobs = []
    for mass_set in range(options.sets):
        for name in names:
            job = PaperJob(
                data=options.folder,
                name=name,
                mass_set=mass_set,
                training=TRAINING_PUSHES,
                methods=options.chosen_methods,
                budgets=options.budgets,
                seed=options.seed,
                show_parts=options.show_parts,
                density_spread=options.density_spread,
            )
            jobs.append(job)
            if DEFAULT_METHOD in options.chosen_methods:
                jobs += [
                    replace(
                        job, training=count, methods=(DEFAULT_METHOD,), budgets=options.budgets[-1:]
                    )
                    for count in others
                ]
    return jobs


def _list_names(options: PaperBenchOptions, protocol: Protocol) -> list[str]:
    """Returns the names of the objects."""
    return list(protocol.masses if options.objects is None else options.objects)


def tabulate(options: PaperBenchOptions, done: Done) -> list[Table]:
    """Tabulates the errors by method and object, and by training pushes; draws the figure."""
    scores = [score for scores in done.of(LEARNING_JOBS) for score in scores]
    names = _list_names(options, make_protocol(options.folder, options.seed))
    methods = (UNIFORM_PRIOR, *options.chosen_methods)
    tables = [tabulate_methods(scores, names, methods, TRAINING_PUSHES, options.budget)]
    if DEFAULT_METHOD in methods:
        tables.append(tabulate_training(scores, names, DEFAULT_METHOD, options.budget))
    if options.figure is not None:
        tables.append(tabulate_budgets(scores, methods, TRAINING_PUSHES))
        write_figure(options.figure, scores, names, methods, TRAINING_PUSHES, options.force)
    return tables


def choose_budgets(budget: int) -> tuple[int, ...]:
    """Chooses the budgets at which a curve is measured, the last one `budget`."""
    return tuple(
        sorted({max(TRAINING_PUSHES, round(budget * fraction)) for fraction in BUDGET_FRACTIONS})
    )


def run_job(job: PaperJob) -> list[PaperScore]:
    """Learns one case by each method at each budget, and predicts its test pushes.

    The default method decides itself how much it spends, so that it learns only once.
    """
    protocol = make_protocol(job.data, job.seed)
    case = _make_case(
        job.data, job.seed, job.name, job.mass_set, job.show_parts, job.density_spread
    )
    split = protocol.splits[job.training][job.mass_set]
    train = case.log.subset(split.train)
    test = case.log.subset(split.test)

    def score(
        method: str, budget: int, simulations: int, params: CellParameters, physics: Physics
    ) -> PaperScore:
        error = calc_mean_cell_error(Model(case.obj, params, physics), test)
        return PaperScore(
            name=job.name,
            mass_set=job.mass_set,
            training=job.training,
            method=method,
            budget=budget,
            simulations=simulations,
            error=error,
        )

    scores = []
    for budget in job.budgets:
        scores.append(
            score(UNIFORM_PRIOR, budget, 0, CellParameters.uniform(case.obj), TRUTH_PHYSICS)
        )
        for method in job.methods:
            if method == DEFAULT_METHOD and budget != job.budgets[-1]:
                continue
            found = identify(Model(case.obj), train, method=method, seed=job.seed, budget=budget)
            scores.append(score(method, budget, found.simulations, found.params, found.physics))
    return scores


def _check(
    protocol: Protocol, names: Sequence[str], methods: Sequence[str], budget: int, sets: int
) -> None:
    check_known("objects", names, tuple(protocol.masses))
    check_known("methods", methods, METHOD_NAMES)
    if "cma_es" in methods:
        # That it is missing is said now, and not in a job that runs after an hour of others.
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
def _make_case(
    data: Path | None,
    seed: int,
    name: str,
    mass_set: int,
    show_parts: bool,
    density_spread: float | None,
) -> ProtocolCase:
    return make_case(make_protocol(data, seed), name, mass_set, show_parts, density_spread)


def write_figure(
    path: Path | str,
    scores: Sequence[PaperScore],
    names: Sequence[str],
    methods: Sequence[str],
    training: int,
    force: bool,
) -> None:
    """Draws a panel for each object and one for all; scores of several budgets are connected.

    Args:
        path: file of the figure.
        scores: the errors.
        names: names of the objects.
        methods: methods that are drawn.
        training: number of training pushes.
        force: whether a figure that exists may be replaced.
    """

    def draw(axis: Axes, panel: str) -> None:
        of_panel = {} if panel == ALL_OBJECTS else {"name": panel}
        draw_panel(axis, select(scores, training=training, **of_panel), methods)

    labels = ("simulated pushes", "mean test cell error, mm")
    write_panels(path, [*names, ALL_OBJECTS], PANEL_COLUMNS, labels, draw, force)


def draw_panel(axis: Axes, scores: Sequence[PaperScore], methods: Sequence[str]) -> None:
    """Draws a line for each method over the pushes that it simulated, with its interval as a band.

    A method that ran at one budget only is a point.
    """
    for i, method in enumerate(methods):
        chosen = select(scores, method=method)
        budgets = sorted({score.budget for score in chosen})
        spent = [mean_simulations(select(chosen, budget=budget)) for budget in budgets]
        style: dict[str, Any] = {"color": f"C{i - 1}", "marker": "o"}
        if method == UNIFORM_PRIOR:
            # it simulates nothing, and is drawn across the whole panel
            spent = budgets
            style = {"color": "0.4", "linestyle": "--"}
        mean, low, high = np.transpose(
            [summarize(select(chosen, budget=budget)).to_array() for budget in budgets]
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


LEARNING_JOBS = JobKind(
    job=PaperJob,
    run=run_job,
    describe=lambda job: f"{job.name}, mass set {job.mass_set}, {job.training} training pushes",
)
"""What is done with a job."""

STUDY = Study(
    name="paper",
    help="Repeat the paper's simulated identification, every method beside the others.",
    options=PaperBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(LEARNING_JOBS,),
    tabulate=tabulate,
)
"""`gridpush bench paper`, but for `--figures`; see `bench.paper_figures`."""

"""`gridpush bench paper --figures DIR`: the paper's own figures, made anew, each beside what the paper says.

    mass_maps            where the objects are heavy: hidden, learned, and how sure that is
    simulations          test error against the number of simulated pushes, every method (its Fig. 4
    a) real_pushes          error of foretold pushes with error bars; of real robots' pushes where
    they are cloned contact_points       contact points: simulations and what they are worth beside
    an exhaustive search (its Fig. 4 b) pregrasp             the hammer at the table's edge:
    learned, uniform, without a bound on the friction

The objects are the paper's masks where they are cloned, and else shipped objects of the same kind.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gridpush_drake.bench import paper, planning, real
from gridpush_drake.bench.jobs import QUIET, Execution, Job, Result, check_known, run_jobs
from gridpush_drake.bench.pregrasp import experiments as pregrasp
from gridpush_drake.bench.protocol import (
    make_case,
    make_planning_protocol,
    make_protocol,
    read_object,
)
from gridpush_drake.bench.table import MM, PERCENT, Table
from gridpush_drake.errors import GridPushError
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.identification.learning import METHODS, identify
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.report.draw import draw_cells, hide_axes, make_chart, make_grid, to_png, to_svg

SHIPPED = ("claw_hammer", "open_book", "snack_bag", "spray_bottle")
"""In place of the paper's hammer, book, snack and windex."""

SHIPPED_HAMMER = "claw_hammer"

FIGURES = ("mass_maps", "simulations", "real_pushes", "contact_points", "pregrasp")


@dataclass(frozen=True)
class Counts:
    """How much is run: mass sets, pairs of poses, splits of a log, hidden hammers, simulated pushes of a search."""

    sets: int = 3
    pairs: int = 5
    splits: int = 5
    tries: int = 12
    budget: int = paper.BUDGET


QUICK = Counts(1, 2, 2, 2, 150)

REAL_COUNTS = (1, 3, 7, 25)
"""Training pushes; the paper's robot made 7."""

PAPER_REAL, PAPER_SUCCESS = (
    22.7,
    {pregrasp.LEARNED: 100, pregrasp.UNBOUNDED: 81, pregrasp.UNIFORM: 75},
)
"""The paper's error of a real robot's pushes, mm, and its hammer's successes, %."""

PAPER_SIMULATIONS = {"gradient": (40, 75), "exhaustive": (280, 650)}
"""The paper's simulations of a decision, least and most."""

SLIDE_METHODS = (pregrasp.LEARNED, pregrasp.UNIFORM, pregrasp.UNBOUNDED, pregrasp.TRUE)

PANEL = (4.2, 3.2)
"""Width and height of a chart, inches."""

MAP_COLUMNS, MAP_SIZE = ("hidden", "learned", "standard deviation"), (8.0, 1.9)
"""Of the mass maps: the columns, and the figure's width and a row's height, inches."""

BAR, CAP = 0.8, 3
"""Share of its place that a group of bars takes, and the width of an error bar's ends, points."""


@dataclass(frozen=True)
class MapJob:
    """One object with one mass set, learned from five pushes."""

    data: Path | None
    name: str
    mass_set: int
    seed: int


@dataclass(frozen=True)
class MassMap:
    """What was hidden, and what was learned, each cell's share of the mass over the mean share (n,); test error, m."""

    name: str
    hidden: list[float]
    learned: list[float]
    std: list[float]
    error: float


@dataclass(frozen=True)
class Study:
    """What the figures are drawn from, and where they go; see `run`."""

    folder: Path
    data: Path | None
    names: Sequence[str]
    methods: Sequence[str]
    seed: int
    counts: Counts
    execution: Execution
    force: bool

    def run(self, function: Callable[[Job], Result], jobs: Sequence[Job]) -> list[Result]:
        """What the function makes of each job; the jobs are called by its name and, where they have them, theirs."""
        name = function.__name__
        return run_jobs(
            function, jobs, lambda job: f"{name}: {getattr(job, 'name', '')}", self.execution
        )

    def write(self, name: str, figure: Figure) -> None:
        """Writes a figure as PNG and as SVG."""
        write_whole(self.folder / f"{name}.png", to_png(figure), self.force)
        write_whole(self.folder / f"{name}.svg", to_svg(figure), self.force)


def run(
    folder: Path,
    data: Path | None = None,
    objects: Sequence[str] | None = None,
    methods: Sequence[str] = METHODS,
    seed: int = 0,
    execution: Execution = QUIET,
    *,
    quick: bool = False,
    counts: Counts | None = None,
    force: bool = False,
) -> list[Table]:
    """Measures, and draws the figures; the arguments are the options of `gridpush bench paper`.

    Args:
        folder: where the figures go, each as PNG and as SVG; made where it is not there.
        data: folder of the paper's masks and of real push logs; None for the shipped objects alone.
        objects: names; the masks where None, or SHIPPED.
        methods: of `identify`, for the error against simulations.
        seed: of everything random.
        execution: how the jobs are run.
        quick: whether as much is run as QUICK says.
        counts: how much is run instead.
        force: whether existing figures may be replaced.

    Returns:
        What each figure shows, beside what the paper says.

    Raises:
        GridPushError: the data are not there, or an object is not known.
        OutputError: a figure cannot be written.
    """
    root = None if data is None else Path(data).resolve()
    check_folder(folder, force)
    protocol = make_protocol(root, seed)
    names = list(objects or protocol.masks or SHIPPED)
    check_known("objects", names, tuple(protocol.masses))
    study = Study(
        folder,
        root,
        names,
        methods,
        seed,
        counts or (QUICK if quick else Counts()),
        execution,
        force,
    )
    drawn = [
        draw(study)
        for draw in (_draw_maps, _draw_simulations, _draw_real, _draw_contacts, _draw_pregrasp)
    ]
    rows = [[name, *said] for name, said in zip(FIGURES, drawn, strict=True)]
    notes = [f"In {folder}, each as PNG and SVG.", "Objects: " + ", ".join(names) + "."]
    return [Table("The paper's figures", ("figure", "here", "in the paper"), rows, notes)]


def check_folder(folder: Path, force: bool) -> None:
    """Makes the folder. Raises OutputError where a figure may not be written there."""
    if not folder.exists():
        check_writable(folder, force)
        folder.mkdir()
    for name in FIGURES:
        for ending in (".png", ".svg"):
            check_writable(folder / (name + ending), force)


def learn_map(job: MapJob) -> MassMap:
    """Learns one map."""
    protocol = make_protocol(job.data, job.seed)
    case = make_case(protocol, job.name, job.mass_set)
    split = protocol.splits[paper.TRAINING_PUSHES][job.mass_set]
    found = identify(case.obj, case.log.subset(split.train), seed=job.seed)
    hidden = np.array(protocol.masses[job.name][job.mass_set])[
        read_object(protocol, job.name).labels - 1
    ]
    error = calc_mean_cell_error(case.obj, found.params, case.log.subset(split.test), found.physics)
    mean = found.params.mass.mean()
    return MassMap(
        job.name, (hidden / hidden.mean()).tolist(), (found.params.mass / mean).tolist(),
        (found.std.mass / mean).tolist(), error,
    )  # fmt: skip


def _draw_maps(study: Study) -> tuple[str, str]:
    maps = study.run(learn_map, [MapJob(study.data, name, 0, study.seed) for name in study.names])
    figure, axes = make_grid(len(maps), len(MAP_COLUMNS), *MAP_SIZE)
    for row, found in zip(axes, maps, strict=True):
        obj = make_case(make_protocol(study.data, study.seed), found.name, 0).obj
        top = max(*found.hidden, *found.learned)
        for ax, title, values in zip(
            row, MAP_COLUMNS, (found.hidden, found.learned, found.std), strict=True
        ):
            draw_cells(ax, obj, values, label="mass / mean", limits=(0.0, top))
            hide_axes(ax, f"{found.name}, {title}")
    study.write("mass_maps", figure)
    likeness = [float(np.corrcoef(found.hidden, found.learned)[0, 1]) for found in maps]
    error = MM * float(np.mean([found.error for found in maps]))
    return (
        f"learned from {paper.TRAINING_PUSHES} pushes: correlation with the hidden mass "
        f"{np.mean(likeness):.2f} ({min(likeness):.2f} to {max(likeness):.2f}); test error {error:.1f} mm",
        "converges to the true masses; shown in colors, without a number",
    )


def _draw_simulations(study: Study) -> tuple[str, str]:
    training = paper.TRAINING_PUSHES
    budgets = paper.choose_budgets(study.counts.budget)
    jobs = [
        paper.Job(study.data, name, mass_set, training, tuple(study.methods), budgets, study.seed)
        for mass_set in range(study.counts.sets)
        for name in study.names
    ]
    scores = [score for scores in study.run(paper.run_job, jobs) for score in scores]
    shown = (paper.UNIFORM, *study.methods)
    figure, ax = make_chart(2 * PANEL[0], 1.5 * PANEL[1])
    paper.draw_panel(ax, scores, shown)
    ax.axhline(paper.PAPER_MM, color="0.7", linewidth=1, label=f"paper, {paper.PAPER_MM:g} mm")
    ax.set_xlabel("simulated pushes")
    ax.set_ylabel("mean test cell error, mm")
    ax.legend(fontsize="small", ncols=2)
    study.write("simulations", figure)
    best = {
        method: MM * paper.summarize(paper.select(scores, method=method, budget=budgets[-1])).mean
        for method in shown
    }
    said = ", ".join(f"{method.replace('_', ' ')} {error:.1f}" for method, error in best.items())
    return (
        f"mm, searches of at most {study.counts.budget} simulations: {said}",
        f"{paper.PAPER_MM:g} mm at most; its gradient needs the fewest simulations",
    )


def _draw_real(study: Study) -> tuple[str, str]:
    logs = _find_logs(study.data)
    if logs:
        known = real.name_logs(logs)
        kept = [entry for entry in known if entry[0] in real.FEET_SETS] or known
    else:
        kept = [(name, "simulated", find_shipped_object(name)) for name in SHIPPED]
    jobs = [
        real.Job(path, kind, split, REAL_COUNTS, study.seed, name)
        for name, kind, path in kept
        for split in range(study.counts.splits)
    ]
    scores = [score for scores in study.run(real.run_job, jobs) for score in scores]
    shown = list(dict.fromkeys(score.name for score in scores))
    steps = sorted(
        {score.training for score in scores if score.model in (real.UNIFORM, real.POSES)}
    )
    figure, ax = make_chart(2 * PANEL[0], 1.2 * PANEL[1])
    for i, count in enumerate(steps):
        model = real.POSES if count else real.UNIFORM
        label = f"learned from {count}" if count else real.UNIFORM
        _draw_bars(ax, i, len(steps), [_means(scores, name, model, count) for name in shown], label)
    what = "real pushes" if logs else "simulated stand-ins for real pushes"
    _finish_bars(ax, shown, "position error, mm")
    ax.set_title(
        f"Foretold positions of {what}, 95 % intervals over {study.counts.splits} splits",
        fontsize="small",
    )
    study.write("real_pushes", figure)
    last = steps[-1]
    means = [
        float(np.mean([np.mean(_means(scores, name, model, count)) for name in shown]))
        for model, count in ((real.UNIFORM, 0), (real.POSES, last))
    ]
    return (
        f"{what}: {means[0]:.1f} mm before, {means[1]:.1f} mm learned from {last}",
        f"{PAPER_REAL:g} mm at most, learned from 7 of a robot's own objects",
    )


def _means(scores: Sequence[real.Score], name: str, model: str, training: int) -> list[float]:
    """Mean position error of each split, mm."""
    wanted = (name, model, training)
    return [
        MM * float(np.mean(s.position)) for s in scores if (s.name, s.model, s.training) == wanted
    ]


def _find_logs(data: Path | None) -> list[tuple[str, Path]]:
    """The CMU's push logs below a folder; none where there are none."""
    if data is None:
        return []
    try:
        return [
            log
            for log in real.find_push_logs(data, real.CMU_TEST + max(REAL_COUNTS))
            if log[0] == "cmu"
        ]
    except GridPushError:
        return []


def _draw_contacts(study: Study) -> tuple[str, str]:
    jobs = [
        planning.Job("contact", study.data, name, number, study.counts.pairs, (), study.seed)
        for number in range(study.counts.sets)
        for name in study.names
    ]
    found = study.run(planning.run_job, jobs)
    decisions = [
        entry for entries in found for entry in entries if isinstance(entry, planning.Decision)
    ]
    methods = (planning.GRADIENT, planning.DIFFERENCES, planning.EXHAUSTIVE)
    figure, axes = make_grid(1, 2, 2.4 * PANEL[0], PANEL[1])
    for i, method in enumerate(methods):
        chosen = [
            [d for d in decisions if (d.name, d.method) == (name, method)] for name in study.names
        ]
        label = method.replace("_", " ")
        _draw_bars(
            axes[0, 0], i, len(methods), [[d.simulations for d in some] for some in chosen], label
        )
        _draw_bars(
            axes[0, 1], i, len(methods), [[MM * d.gap for d in some] for some in chosen], label
        )
    axes[0, 0].set_yscale("log")
    axes[0, 0].margins(y=0.3)  # room for the legend
    _finish_bars(axes[0, 0], study.names, "simulations of a decision")
    _finish_bars(axes[0, 1], study.names, "above the exhaustive search, mm")
    study.write("contact_points", figure)
    spent = {
        method: np.mean([d.simulations for d in decisions if d.method == method])
        for method in methods
    }
    gap = MM * float(np.mean([d.gap for d in decisions if d.method == planning.GRADIENT]))
    low, high = PAPER_SIMULATIONS["gradient"], PAPER_SIMULATIONS["exhaustive"]
    return (
        f"{spent['gradient']:.0f} simulations instead of {spent['exhaustive']:.0f}, {gap:.2f} mm worse on average",
        f"{low[0]} to {low[1]} simulations instead of {high[0]} to {high[1]}",
    )


def _draw_pregrasp(study: Study) -> tuple[str, str]:
    protocol = make_planning_protocol(study.data, study.seed)
    mask = protocol.masks.get(pregrasp.MASK_OBJECT)
    hammer = SHIPPED_HAMMER if mask is None else pregrasp.MASK_OBJECT
    jobs = [
        pregrasp.Job(hammer, mass_set, study.seed, method, mask=mask)
        for mass_set in range(study.counts.tries)
        for method in SLIDE_METHODS
    ]
    scores = [
        score
        for score in study.run(pregrasp.run_job, jobs)
        if isinstance(score, pregrasp.SlideScore)
    ]
    outcomes = {
        method: [score.outcome for score in scores if score.method == method]
        for method in SLIDE_METHODS
    }
    grasped = {
        method: PERCENT * float(np.mean([o.grasped for o in some]))
        for method, some in outcomes.items()
    }
    dropped = {
        method: PERCENT * float(np.mean([o.dropped for o in some]))
        for method, some in outcomes.items()
    }
    figure, ax = make_chart(2 * PANEL[0], PANEL[1])
    places = np.arange(len(SLIDE_METHODS))
    ends: list[tuple[str, str, Mapping[str, float]]] = [
        ("graspable", "tab:blue", grasped), ("dropped", "tab:red", dropped),
        ("in the paper: grasped", "0.75", PAPER_SUCCESS),
    ]  # fmt: skip
    for i, (label, color, values) in enumerate(ends):
        shares = [values.get(method, np.nan) for method in SLIDE_METHODS]
        ax.bar(
            places + (i - 1) * BAR / len(ends), shares, BAR / len(ends), color=color, label=label
        )
    ax.set_ylabel(f"{hammer}: share of {study.counts.tries} runs, %")
    ax.set_xticks(places, SLIDE_METHODS)
    ax.margins(y=0.35)  # room for the legend
    ax.legend(fontsize="x-small")
    study.write("pregrasp", figure)
    said = "; ".join(
        f"{method} {grasped[method]:.0f} % ({dropped[method]:.0f} % dropped)"
        for method in SLIDE_METHODS
    )
    paper_said = "; ".join(f"{method} {share} %" for method, share in PAPER_SUCCESS.items())
    return f"{hammer}: {said}", paper_said


def _draw_bars(
    ax: Axes, i: int, count: int, samples: Sequence[Sequence[float]], label: str
) -> None:
    """The i-th of `count` bars in each place: the mean of the place's sample, with its interval."""
    mean, low, high = np.array([paper.calc_interval(sample) for sample in samples]).T
    width = BAR / count
    places = np.arange(len(mean)) + (i - (count - 1) / 2) * width
    spread = np.nan_to_num(np.maximum([mean - low, high - mean], 0.0))
    ax.bar(places, mean, width, yerr=spread, capsize=CAP, label=label, error_kw={"linewidth": 1})


def _finish_bars(ax: Axes, names: Sequence[str], label: str) -> None:
    ax.set_xticks(np.arange(len(names)), names, rotation=20, ha="right", fontsize="small")
    ax.set_ylabel(label)
    ax.legend(fontsize="x-small", framealpha=0.6)
    ax.grid(axis="y", alpha=0.3)

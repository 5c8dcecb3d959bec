"""`gridpush bench paper --figures DIR`: the paper's own figures, made anew.

Each figure stands beside what the paper says:

    mass_maps       where the objects are heavy: hidden, learned, and how sure that is
    simulations     test error against the number of simulated pushes, every method (its Fig. 4 a)
    real_pushes     error of predicted pushes with error bars; of real robots' pushes where they are
                    cloned
    contact_points  contact points: simulations and what they are worth beside an exhaustive search
                    (its Fig. 4 b)
    pregrasp        the hammer at the table's edge: learned, uniform, without a bound on the
                    friction

The objects are the paper's masks where they are cloned, and else shipped objects of the same kind.
Without `--figures`, the study is that of `bench.paper`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gridpush_drake.bench import paper, planning, real
from gridpush_drake.bench.data.protocol import (
    make_case,
    make_planning_protocol,
    make_protocol,
    read_object,
)
from gridpush_drake.bench.pregrasp import experiments as pregrasp
from gridpush_drake.bench.study import Done, JobKind, Study, option
from gridpush_drake.errors import GridPushError
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.jobs.run import check_known
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.report.draw import draw_cells, hide_axes, make_chart, make_grid, to_png, to_svg
from gridpush_drake.report.table import Table, calc_interval
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

SHIPPED_SUBSTITUTES = ("claw_hammer", "open_book", "snack_bag", "spray_bottle")
"""Shipped objects in place of the paper's hammer, book, snack and windex."""

SHIPPED_HAMMER = "claw_hammer"
"""Shipped object in place of the paper's hammer."""

FIGURE_NAMES = ("mass_maps", "simulations", "real_pushes", "contact_points", "pregrasp")
"""Names of the figures."""


@dataclass(frozen=True)
class Counts:
    """How much is run.

    Attributes:
        sets: number of mass sets of each object.
        pairs: number of pairs of poses between which contact points are chosen.
        splits: number of divisions of a log.
        tries: number of hidden hammers.
        budget: greatest number of simulated pushes of a search.
    """

    sets: int = 3
    pairs: int = 5
    splits: int = 5
    tries: int = 12
    budget: int = paper.DEFAULT_BUDGET


QUICK_COUNTS = Counts(sets=1, pairs=2, splits=2, tries=2, budget=150)
"""How much is run in the quick variant."""

REAL_COUNTS = (1, 3, 7, 25)
"""Numbers of training pushes of the real pushes; the paper's robot made 7."""

PAPER_REAL = 22.7
"""The paper's error of a real robot's pushes, mm."""

PAPER_SUCCESS = {
    pregrasp.LEARNED_METHOD: 100,
    pregrasp.UNBOUNDED_METHOD: 81,
    pregrasp.UNIFORM_METHOD: 75,
}
"""The paper's successes with the hammer, %."""

PAPER_SIMULATIONS = {"gradient": (40, 75), "exhaustive": (280, 650)}
"""The paper's numbers of simulations of a decision, least and most."""

SLIDE_METHODS = (
    pregrasp.LEARNED_METHOD,
    pregrasp.UNIFORM_METHOD,
    pregrasp.UNBOUNDED_METHOD,
    pregrasp.TRUE_METHOD,
)
"""Methods of the pre-grasp experiment that are drawn."""

PANEL_SIZE = (4.2, 3.2)
"""Width and height of a chart, inches."""

MAP_COLUMNS = ("hidden", "learned", "standard deviation")
"""Columns of the mass maps."""

MAP_SIZE = (8.0, 1.9)
"""Width of the mass maps and height of a row, inches."""

BAR_GROUP_FRACTION = 0.8
"""Fraction of its place that a group of bars takes."""

CAP_WIDTH = 3
"""Width of an error bar's ends, points."""


@dataclass(frozen=True)
class PaperFigureOptions(paper.PaperBenchOptions):
    """What is measured, and what is drawn.

    Attributes:
        figures: folder of the figures, each as PNG and as SVG, made where it is not there; None
            measures what `bench.paper` does.
        counts: how much is run for the figures.
    """

    figures: Path | None = option(
        None,
        "Instead draw the paper's own figures there, as PNG and SVG, from fewer runs: mass maps, "
        "error against simulations, real pushes, contact points, the hammer at the edge. About 15 "
        "minutes on two cores.",
        metavar="DIR",
        is_setting=False,
    )
    counts: Counts = Counts()


@dataclass(frozen=True)
class MapJob:
    """One object with one mass set, learned from five pushes.

    Attributes:
        data: folder of the paper's masks; None without them.
        name: name of the object.
        mass_set: number of the mass set.
        seed: seed of everything random.
    """

    data: Path | None
    name: str
    mass_set: int
    seed: int


@dataclass(frozen=True)
class MassMap:
    """What was hidden, and what was learned.

    Attributes:
        name: name of the object.
        hidden: (n,) each cell's true mass over the mean mass.
        learned: (n,) each cell's learned mass over the mean mass.
        std: (n,) its standard deviation over the mean mass.
        error: mean test error, m.
    """

    name: str
    hidden: list[float]
    learned: list[float]
    std: list[float]
    error: float


def shorten(options: PaperFigureOptions) -> PaperFigureOptions:
    """Makes the options of the quick variant."""
    if options.figures is not None:
        return replace(options, counts=QUICK_COUNTS)
    return replace(options, sets=paper.shorten(options).sets)


def make_jobs(options: PaperFigureOptions) -> Sequence[object]:
    """Makes the jobs of all figures, or those of `bench.paper` without figures.

    Raises:
        GridPushError: the data are not there, or an object is not known.
        OutputError: a figure cannot be written.
    """
    if options.figures is None:
        return paper.make_jobs(options)
    check_folder(options.figures, options.force)
    names = _list_names(options)
    check_known("objects", names, tuple(make_protocol(options.folder, options.seed).masses))
    return [
        *(MapJob(options.folder, name, 0, options.seed) for name in names),
        *_make_simulation_jobs(options, names),
        *_make_real_jobs(options),
        *_make_contact_jobs(options, names),
        *_make_slide_jobs(options),
    ]


def _list_names(options: PaperFigureOptions) -> list[str]:
    """Returns the names of the objects: those given, the masks, or SHIPPED_SUBSTITUTES."""
    masses = make_protocol(options.folder, options.seed).masses
    return list(options.objects or masses or SHIPPED_SUBSTITUTES)


def _make_simulation_jobs(
    options: PaperFigureOptions, names: Sequence[str]
) -> list[paper.PaperJob]:
    return [
        paper.PaperJob(
            data=options.folder,
            name=name,
            mass_set=mass_set,
            training=paper.TRAINING_PUSHES,
            methods=options.chosen_methods,
            budgets=paper.choose_budgets(options.counts.budget),
            seed=options.seed,
        )
        for mass_set in range(options.counts.sets)
        for name in names
    ]


def _make_real_jobs(options: PaperFigureOptions) -> list[real.RealPushJob]:
    logs = _find_logs(options.folder)
    if logs:
        known = real.name_logs(logs)
        kept = [entry for entry in known if entry[0] in real.FEET_SETS] or known
    else:
        kept = [
            (name, real.SIMULATED_LOG, find_shipped_object(name)) for name in SHIPPED_SUBSTITUTES
        ]
    return [
        real.RealPushJob(
            path=path, kind=kind, split=split, counts=REAL_COUNTS, seed=options.seed, name=name
        )
        for name, kind, path in kept
        for split in range(options.counts.splits)
    ]


def _make_contact_jobs(
    options: PaperFigureOptions, names: Sequence[str]
) -> list[planning.PlanningJob]:
    return [
        planning.PlanningJob(
            kind=planning.CONTACT_PART,
            data=options.folder,
            name=name,
            number=number,
            pairs=options.counts.pairs,
            modes=(),
            seed=options.seed,
        )
        for number in range(options.counts.sets)
        for name in names
    ]


def _make_slide_jobs(options: PaperFigureOptions) -> list[pregrasp.PreGraspJob]:
    mask = make_planning_protocol(options.folder, options.seed).masks.get(pregrasp.MASK_OBJECT)
    return [
        pregrasp.PreGraspJob(
            name=SHIPPED_HAMMER if mask is None else pregrasp.MASK_OBJECT,
            mass_set=mass_set,
            seed=options.seed,
            method=method,
            mask=mask,
        )
        for mass_set in range(options.counts.tries)
        for method in SLIDE_METHODS
    ]


def tabulate(options: PaperFigureOptions, done: Done) -> list[Table]:
    """Draws the figures, and says what each shows, beside what the paper says."""
    if options.figures is None:
        return paper.tabulate(options, done)
    draw = (_draw_maps, _draw_simulations, _draw_real, _draw_contacts, _draw_pregrasp)
    rows = [[name, *each(options, done)] for name, each in zip(FIGURE_NAMES, draw, strict=True)]
    notes = [
        f"In {options.figures}, each as PNG and SVG.",
        "Objects: " + ", ".join(_list_names(options)) + ".",
    ]
    return [Table("The paper's figures", ("figure", "here", "in the paper"), rows, notes)]


def check_folder(folder: Path, force: bool) -> None:
    """Makes the folder. Raises OutputError where a figure may not be written there."""
    if not folder.exists():
        check_writable(folder, force)
        folder.mkdir()
    for name in FIGURE_NAMES:
        for ending in (".png", ".svg"):
            check_writable(folder / (name + ending), force)


def _write(options: PaperFigureOptions, name: str, figure: Figure) -> None:
    """Writes a figure as PNG and as SVG."""
    assert options.figures is not None
    write_whole(options.figures / f"{name}.png", to_png(figure), options.force)
    write_whole(options.figures / f"{name}.svg", to_svg(figure), options.force)


def learn_map(job: MapJob) -> MassMap:
    """Learns one map."""
    protocol = make_protocol(job.data, job.seed)
    case = make_case(protocol, job.name, job.mass_set)
    split = protocol.splits[paper.TRAINING_PUSHES][job.mass_set]
    found = identify(Model(case.obj), case.log.subset(split.train), seed=job.seed)
    masses = np.array(protocol.masses[job.name][job.mass_set])
    hidden = masses[read_object(protocol, job.name).labels - 1]
    error = calc_mean_cell_error(
        Model(case.obj, found.params, found.physics), case.log.subset(split.test)
    )
    mean = found.params.mass.mean()
    return MassMap(
        name=job.name,
        hidden=(hidden / hidden.mean()).tolist(),
        learned=(found.params.mass / mean).tolist(),
        std=(found.std.mass / mean).tolist(),
        error=error,
    )


Said = tuple[str, str]
"""What a figure shows here, and what the paper says."""


def _draw_maps(options: PaperFigureOptions, done: Done) -> Said:
    """Draws the mass maps."""
    maps = done.of(MAP_JOBS)
    figure, axes = make_grid(len(maps), len(MAP_COLUMNS), *MAP_SIZE)
    for row, found in zip(axes, maps, strict=True):
        obj = make_case(make_protocol(options.folder, options.seed), found.name, 0).obj
        top = max(*found.hidden, *found.learned)
        for ax, title, values in zip(
            row, MAP_COLUMNS, (found.hidden, found.learned, found.std), strict=True
        ):
            draw_cells(ax, obj, values, label="mass / mean", limits=(0.0, top))
            hide_axes(ax, f"{found.name}, {title}")
    _write(options, "mass_maps", figure)
    likeness = [float(np.corrcoef(found.hidden, found.learned)[0, 1]) for found in maps]
    error = MM_PER_M * float(np.mean([found.error for found in maps]))
    return (
        f"learned from {paper.TRAINING_PUSHES} pushes: correlation with the hidden mass "
        f"{np.mean(likeness):.2f} ({min(likeness):.2f} to {max(likeness):.2f}); test error "
        f"{error:.1f} mm",
        "converges to the true masses; shown in colors, without a number",
    )


def _draw_simulations(options: PaperFigureOptions, done: Done) -> Said:
    """Draws the error against the number of simulated pushes."""
    budget = options.counts.budget
    scores = [score for scores in done.of(paper.LEARNING_JOBS) for score in scores]
    shown = (paper.UNIFORM_PRIOR, *options.chosen_methods)
    figure, ax = make_chart(2 * PANEL_SIZE[0], 1.5 * PANEL_SIZE[1])
    paper.draw_panel(ax, scores, shown)
    ax.axhline(paper.PAPER_MM, color="0.7", linewidth=1, label=f"paper, {paper.PAPER_MM:g} mm")
    ax.set_xlabel("simulated pushes")
    ax.set_ylabel("mean test cell error, mm")
    ax.legend(fontsize="small", ncols=2)
    _write(options, "simulations", figure)
    best = {
        method: paper.summarize(paper.select(scores, method=method, budget=budget)).mean
        for method in shown
    }
    said = ", ".join(f"{method.replace('_', ' ')} {error:.1f}" for method, error in best.items())
    return (
        f"mm, searches of at most {budget} simulations: {said}",
        f"{paper.PAPER_MM:g} mm at most; its gradient needs the fewest simulations",
    )


def _draw_real(options: PaperFigureOptions, done: Done) -> Said:
    """Draws the error of predicted pushes, real ones or simulated ones in their place."""
    scores = [score for scores in done.of(real.SPLIT_JOBS) for score in scores]
    is_real = any(job.kind != real.SIMULATED_LOG for job, _ in done.list_pairs(real.SPLIT_JOBS))
    shown = list(dict.fromkeys(score.name for score in scores))
    steps = sorted(
        {
            score.training
            for score in scores
            if score.model in (real.UNIFORM_PRESSURE, real.POSES_MODEL)
        }
    )
    figure, ax = make_chart(2 * PANEL_SIZE[0], 1.2 * PANEL_SIZE[1])
    for i, count in enumerate(steps):
        model = real.POSES_MODEL if count else real.UNIFORM_PRESSURE
        label = f"learned from {count}" if count else real.UNIFORM_PRESSURE
        _draw_bars(ax, i, len(steps), [_means(scores, name, model, count) for name in shown], label)
    what = "real pushes" if is_real else "simulated stand-ins for real pushes"
    _finish_bars(ax, shown, "position error, mm")
    ax.set_title(
        f"Predicted positions of {what}, 95 % intervals over {options.counts.splits} splits",
        fontsize="small",
    )
    _write(options, "real_pushes", figure)
    last = steps[-1]
    means = [
        float(np.mean([np.mean(_means(scores, name, model, count)) for name in shown]))
        for model, count in ((real.UNIFORM_PRESSURE, 0), (real.POSES_MODEL, last))
    ]
    return (
        f"{what}: {means[0]:.1f} mm before, {means[1]:.1f} mm learned from {last}",
        f"{PAPER_REAL:g} mm at most, learned from 7 of a robot's own objects",
    )


def _means(
    scores: Sequence[real.RealPushScore], name: str, model: str, training: int
) -> list[float]:
    """Calculates the mean position error of each division, mm."""
    wanted = (name, model, training)
    return [
        MM_PER_M * float(np.mean(s.position))
        for s in scores
        if (s.name, s.model, s.training) == wanted
    ]


def _find_logs(data: Path | None) -> list[tuple[str, Path]]:
    """Finds the CMU's push logs below a folder; none where there are none."""
    if data is None:
        return []
    try:
        found = real.find_push_logs(data, real.CMU_TEST + max(REAL_COUNTS))
    except GridPushError:
        return []
    return [log for log in found if log[0] == real.CMU_LOG]


def _draw_contacts(options: PaperFigureOptions, done: Done) -> Said:
    """Draws what a decision for a contact point costs, and what it is worth."""
    names = _list_names(options)
    found = done.of(planning.PLANNING_JOBS)
    decisions = [
        entry for entries in found for entry in entries if isinstance(entry, planning.Decision)
    ]
    methods = (planning.GRADIENT_SEARCH, planning.DIFFERENCE_SEARCH, planning.EXHAUSTIVE_SEARCH)
    figure, axes = make_grid(1, 2, 2.4 * PANEL_SIZE[0], PANEL_SIZE[1])
    for i, method in enumerate(methods):
        chosen = [[d for d in decisions if (d.name, d.method) == (name, method)] for name in names]
        label = method.replace("_", " ")
        _draw_bars(
            axes[0, 0], i, len(methods), [[d.simulations for d in some] for some in chosen], label
        )
        _draw_bars(
            axes[0, 1],
            i,
            len(methods),
            [[MM_PER_M * d.gap for d in some] for some in chosen],
            label,
        )
    axes[0, 0].set_yscale("log")
    axes[0, 0].margins(y=0.3)  # room for the legend
    _finish_bars(axes[0, 0], names, "simulations of a decision")
    _finish_bars(axes[0, 1], names, "above the exhaustive search, mm")
    _write(options, "contact_points", figure)
    spent = {
        method: np.mean([d.simulations for d in decisions if d.method == method])
        for method in methods
    }
    gap = MM_PER_M * float(
        np.mean([d.gap for d in decisions if d.method == planning.GRADIENT_SEARCH])
    )
    low = PAPER_SIMULATIONS["gradient"]
    high = PAPER_SIMULATIONS["exhaustive"]
    return (
        f"{spent['gradient']:.0f} simulations instead of {spent['exhaustive']:.0f}, {gap:.2f} mm "
        "worse on average",
        f"{low[0]} to {low[1]} simulations instead of {high[0]} to {high[1]}",
    )


def _draw_pregrasp(options: PaperFigureOptions, done: Done) -> Said:
    """Draws how often the hammer could be grasped at the table's edge, and how often it fell."""
    scores = [
        score for score in done.of(pregrasp.PREGRASP_JOBS) if isinstance(score, pregrasp.SlideScore)
    ]
    hammer = scores[0].name
    outcomes = {
        method: [score.outcome for score in scores if score.method == method]
        for method in SLIDE_METHODS
    }
    grasped = {
        method: PERCENT_PER_ONE * float(np.mean([o.grasped for o in some]))
        for method, some in outcomes.items()
    }
    dropped = {
        method: PERCENT_PER_ONE * float(np.mean([o.dropped for o in some]))
        for method, some in outcomes.items()
    }
    figure, ax = make_chart(2 * PANEL_SIZE[0], PANEL_SIZE[1])
    places = np.arange(len(SLIDE_METHODS))
    ends: list[tuple[str, str, Mapping[str, float]]] = [
        ("graspable", "tab:blue", grasped),
        ("dropped", "tab:red", dropped),
        ("in the paper: grasped", "0.75", PAPER_SUCCESS),
    ]
    for i, (label, color, values) in enumerate(ends):
        fractions = [values.get(method, np.nan) for method in SLIDE_METHODS]
        ax.bar(
            places + (i - 1) * BAR_GROUP_FRACTION / len(ends),
            fractions,
            BAR_GROUP_FRACTION / len(ends),
            color=color,
            label=label,
        )
    ax.set_ylabel(f"{hammer}: fraction of {options.counts.tries} runs, %")
    ax.set_xticks(places, SLIDE_METHODS)
    ax.margins(y=0.35)  # room for the legend
    ax.legend(fontsize="x-small")
    _write(options, "pregrasp", figure)
    said = "; ".join(
        f"{method} {grasped[method]:.0f} % ({dropped[method]:.0f} % dropped)"
        for method in SLIDE_METHODS
    )
    paper_said = "; ".join(f"{method} {fraction} %" for method, fraction in PAPER_SUCCESS.items())
    return f"{hammer}: {said}", paper_said


def _draw_bars(
    ax: Axes, i: int, count: int, samples: Sequence[Sequence[float]], label: str
) -> None:
    """Draws the i-th of `count` bars in each place: the mean of its sample, with its interval."""
    mean, low, high = np.transpose([calc_interval(sample).to_array() for sample in samples])
    width = BAR_GROUP_FRACTION / count
    places = np.arange(len(mean)) + (i - (count - 1) / 2) * width
    spread = np.nan_to_num(np.maximum([mean - low, high - mean], 0.0))
    ax.bar(
        places, mean, width, yerr=spread, capsize=CAP_WIDTH, label=label, error_kw={"linewidth": 1}
    )


def _finish_bars(ax: Axes, names: Sequence[str], label: str) -> None:
    """Writes what the places are of, and what is drawn."""
    ax.set_xticks(np.arange(len(names)), names, rotation=20, ha="right", fontsize="small")
    ax.set_ylabel(label)
    ax.legend(fontsize="x-small", framealpha=0.6)
    ax.grid(axis="y", alpha=0.3)


MAP_JOBS = JobKind(job=MapJob, run=learn_map, describe=lambda job: f"mass map: {job.name}")
"""What is done to learn a mass map."""

STUDY = Study(
    name="paper",
    help="Repeat the paper's simulated identification, every method beside the others.",
    options=PaperFigureOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(
        MAP_JOBS,
        paper.LEARNING_JOBS,
        real.SPLIT_JOBS,
        planning.PLANNING_JOBS,
        pregrasp.PREGRASP_JOBS,
    ),
    tabulate=tabulate,
)
"""`gridpush bench paper`."""

"""`gridpush bench real`: learning from real robots' pushes, and predicting others of them.

The pushes are public data of other people. Without them, simulated pushes of the shipped objects
stand in (`simulate_log`), and the table says so: nothing in it is real. Their masses and frictions
are hidden, drawn by part. Every push begins at a random place of the outline, and the object is
seen with noise at its beginning and its end.

    CMU (Zhou et al. 2016)  25 of a file's 50 pushes are held out, 1 to 25 of the others train. The
                            metric is |dxy| + rho |dtheta|, with rho = 0.05 sqrt 2 m.
    MIT (Yu et al. 2016)    a fifth of a file's pushes trains, the rest are held out.

The standard error of one CMU split's mean is 0.15 mm: smaller differences say nothing.

A figure shows the error on the CMU pushes against the number of training pushes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scipy import stats

from gridpush_drake.bench.data.protocol import ANGLE_STD, POSITION_STD
from gridpush_drake.bench.data.real_logs import (
    CMU_LOG,
    CMU_RHO,
    MIT_LOG,
    SIMULATED_LOG,
    SIMULATED_PUSH_COUNT,
    find_push_logs,
    name_logs,
    simulate_log,
)
from gridpush_drake.bench.study import OBJECTS_OPTION, Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.worlds.plant import PUSH_LENGTH, PUSHER_SPEED
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_final_errors
from gridpush_drake.jobs.run import check_known
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects
from gridpush_drake.pushes.importers import find_importer
from gridpush_drake.pushes.importers.mit import read_model_errors
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.table import (
    INTERVAL_CONFIDENCE,
    Mean,
    Table,
    Value,
    check_figure,
    write_panels,
)
from gridpush_drake.units import MM_PER_M

FEET_SETS = ("hardboard_wide", "hardboard_middle", "plywood_wide", "plywood_middle")
"""The CMU files whose mean counts; others are shown beside."""

CMU_TEST = 25
"""Number of pushes of a CMU file that are held out."""

CMU_COUNTS = (1, 2, 3, 5, 8, 12, 18, 25)
"""Numbers of pushes of a CMU file that train."""

SHOWN_COUNTS = (5, 25)
"""Numbers of training pushes of the first CMU table and of the simulated pushes."""

MIT_FRACTION = 0.2
"""Fraction of the pushes of an MIT file that trains."""

DEFAULT_SPLIT_COUNT = 10
"""Number of divisions of a log into pushes to learn from and others, by default."""

QUICK_SPLITS = 2
"""Number of these divisions in the quick variant."""

POSE_COLUMNS = ("training", "position, mm", "angle, °")
"""Columns of the tables of poses."""

UNIFORM_PRESSURE = "uniform pressure"
"""Name of the model of which nothing was learned."""

POSES_MODEL = "poses only"
"""Name of the model that was learned from poses."""

CENTER_MODEL = "poses + center of mass"
"""Name of the model that was learned from poses, with a known center of mass."""


@dataclass(frozen=True)
class RealBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        data: folder of real pushes; None for simulated ones.
        objects: names of shipped objects whose pushes are simulated; all of them where None.
        splits: number of divisions of a log into pushes to learn from and others.
        figure: file of a figure of the error against the number of training pushes; None for none.
        counts: numbers of training pushes of the CMU files.
    """

    data: Path | None = option(
        None,
        "Real pushes: a clone of GitHub robinzhoucmu/MLab_EXP or "
        "robinzhoucmu/PlanarManipulationToolBox, or a folder of such logs. Without, simulated "
        "pushes stand in.",
        name="--data",
        metavar="DIR",
    )
    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    splits: int = option(
        DEFAULT_SPLIT_COUNT, "Divisions of a log into pushes to learn from and others.", least=1
    )
    figure: Path | None = option(
        None,
        "Also draw the error against the number of pushes.",
        metavar="FIGURE.png",
        ending=".png",
        is_setting=False,
    )
    counts: tuple[int, ...] = CMU_COUNTS


@dataclass(frozen=True)
class RealPushJob:
    """One division of one log.

    Attributes:
        path: the log's file, or the file of the object whose pushes are simulated.
        kind: CMU, MIT or SIMULATED_LOG.
        split: number of the division, and of the simulated truth.
        counts: numbers of pushes to learn from.
        seed: seed of everything random.
        name: name of the log; its file's where empty.
    """

    path: Path
    kind: str
    split: int
    counts: tuple[int, ...]
    seed: int
    name: str = ""


@dataclass(frozen=True)
class RealPushScore:
    """Errors of the held-out pushes of one log and division under one model.

    Attributes:
        name: name of the log.
        split: number of the division.
        model: UNIFORM_PRESSURE, POSES_MODEL or CENTER.
        training: number of pushes that were learned from.
        position: error of each push's final position, m.
        angle: error of each push's final angle, rad.
    """

    name: str
    split: int
    model: str
    training: int
    position: tuple[float, ...]
    angle: tuple[float, ...]

    def combined(self) -> np.ndarray:
        """Calculates |dxy| + rho |dtheta| of each push, mm."""
        return MM_PER_M * (np.array(self.position) + CMU_RHO * np.array(self.angle))


def shorten(options: RealBenchOptions) -> RealBenchOptions:
    """Makes the options of the quick variant."""
    return replace(options, splits=min(options.splits, QUICK_SPLITS), counts=SHOWN_COUNTS)


def make_jobs(options: RealBenchOptions) -> list[RealPushJob]:
    """Makes a job for each log and division.

    Raises:
        GridPushError: the data are not there, or an option does not go with them.
        PushLogError: a log cannot be read.
        OutputError: the figure cannot be written.
    """
    if options.figure is not None:
        check_figure(options.figure, options.force)
    if options.splits < 1:
        raise GridPushError(f"splits: {options.splits}; expected at least 1")
    if options.data is None and options.figure is not None:
        raise GridPushError("figure: is of real pushes; expected --data with it")
    if options.data is not None and options.objects is not None:
        raise GridPushError("objects: are for simulated pushes; expected none with --data")
    counts = SHOWN_COUNTS if options.data is None else options.counts
    return [
        RealPushJob(path=path, kind=kind, split=split, counts=counts, seed=options.seed, name=name)
        for name, kind, path in _find_files(options)
        for split in range(options.splits)
    ]


def _find_files(options: RealBenchOptions) -> list[tuple[str, str, Path]]:
    """Finds name, kind and file of each log, or of each object whose pushes are simulated."""
    if options.data is None:
        names = list_shipped_objects() if options.objects is None else options.objects
        files = [(name, SIMULATED_LOG, find_shipped_object(name)) for name in names]
        check_known("objects", names, list_shipped_objects())
        return files
    found = find_push_logs(Path(options.data).resolve(), CMU_TEST + max(options.counts))
    files = name_logs(found)
    for _, kind, path in files:
        _read(path, kind)
    return files


def tabulate(options: RealBenchOptions, done: Done) -> list[Table]:
    """Tabulates the errors of each kind of logs, and draws the figure."""
    scores = [score for scores in done.of(SPLIT_JOBS) for score in scores]
    files = {(job.name, job.kind): job.path for job, _ in done.list_pairs(SPLIT_JOBS)}
    names = {
        kind: [name for name, of in files if of == kind]
        for kind in (SIMULATED_LOG, CMU_LOG, MIT_LOG)
    }
    tables = []
    if names[SIMULATED_LOG]:
        tables.append(_tabulate_simulated(scores, names[SIMULATED_LOG]))
    if names[CMU_LOG]:
        tables.append(_tabulate_cmu(scores, names[CMU_LOG], options.counts))
        tables.append(_tabulate_curve(scores, names[CMU_LOG], options.counts))
        if options.figure is not None:
            feet = choose_feet(names[CMU_LOG])
            write_curve(options.figure, scores, feet, options.counts, options.force)
    if names[MIT_LOG]:
        tables.append(
            _tabulate_mit(scores, {name: files[name, MIT_LOG] for name in names[MIT_LOG]})
        )
    return tables


def run_job(job: RealPushJob) -> list[RealPushScore]:
    """Learns from one division of one log with each number of pushes, and predicts the others."""
    if job.kind == SIMULATED_LOG:
        log, obj = simulate_log(job.path, job.seed, job.split)
    else:
        log, obj = _read(job.path, job.kind)
    order = np.random.default_rng([job.seed, job.split]).permutation(len(log))
    models = [(POSES_MODEL, obj)]
    if job.kind == MIT_LOG:
        count = round(MIT_FRACTION * len(log))
        test = log.subset(order[count:])
        rest = order[:count]
        counts: tuple[int, ...] = (count,)
    else:
        test = log.subset(order[:CMU_TEST])
        rest = order[CMU_TEST:]
        counts = job.counts
    if job.kind == CMU_LOG:
        # the CMU's plates are even, so that their centers of mass are known
        models.append(
            (CENTER_MODEL, replace(obj, prior=replace(obj.prior, center_of_mass=(0.0, 0.0))))
        )
    scores = [_score(job, UNIFORM_PRESSURE, 0, Model(obj), test)]
    for count in counts:
        train = log.subset(rest[:count])
        for name, known in models:
            found = identify(Model(known), train, seed=job.seed)
            scores.append(_score(job, name, count, found, test))
    return scores


def _score(
    job: RealPushJob, label: str, training: int, model: Model, test: PushLog
) -> RealPushScore:
    """Predicts the held-out pushes with a model."""
    motions = model.predict(test, "quasi_static")
    errors = [error for error in calc_final_errors(model.obj, motions, test) if error is not None]
    return RealPushScore(
        name=job.name or job.path.stem,
        split=job.split,
        model=label,
        training=training,
        position=tuple(error.position for error in errors),
        angle=tuple(error.angle for error in errors),
    )


@lru_cache(maxsize=1)
def _read(path: Path, kind: str) -> tuple[PushLog, GridObject]:
    return find_importer(kind)().read(path)


def choose_feet(names: Sequence[str]) -> list[str]:
    """Chooses the files whose mean counts; all of them where none of FEET_SETS is among them."""
    return [name for name in names if name in FEET_SETS] or list(names)


def _choose(
    scores: Sequence[RealPushScore], names: Sequence[str], model: str, training: int
) -> list[RealPushScore]:
    return [s for s in scores if s.name in names and s.model == model and s.training == training]


def calc_split_means(
    scores: Sequence[RealPushScore], names: Sequence[str], model: str, training: int
) -> np.ndarray:
    """Calculates the mean error of each division, mm, averaged over the named files."""
    chosen = _choose(scores, names, model, training)
    splits = sorted({score.split for score in chosen})
    return np.array(
        [np.mean([s.combined().mean() for s in chosen if s.split == split]) for split in splits]
    )


def calc_splits_mean(values: np.ndarray) -> Mean:
    """Calculates mean and Student's confidence interval of the divisions' means."""
    mean = float(values.mean())
    if len(values) < 2:
        return Mean(mean)
    half = float(stats.t.ppf(0.5 + INTERVAL_CONFIDENCE / 2, len(values) - 1) * stats.sem(values))
    return Mean(mean, mean - half, mean + half, even=True)


def _tabulate_cmu(
    scores: Sequence[RealPushScore], names: Sequence[str], counts: Sequence[int]
) -> Table:
    """Tabulates the errors of the CMU's pushes, file by file, with two numbers of pushes."""
    rows: list[list[Value]] = []
    shown = [count for count in reversed(SHOWN_COUNTS) if count in counts] or list(counts[-1:])
    variants = [
        (UNIFORM_PRESSURE, 0),
        *((model, count) for count in shown for model in (CENTER_MODEL, POSES_MODEL)),
    ]
    feet = choose_feet(names)
    for model, training in variants:
        errors = np.concatenate([s.combined() for s in _choose(scores, feet, model, training)])
        means = [
            calc_split_means(scores, of, model, training)
            for of in (*([name] for name in names), feet)
        ]
        spread = [float(np.median(errors)), float(np.quantile(errors, 0.9))]
        rows.append([model, training, *map(calc_splits_mean, means), *spread])
    notes = (
        "|dxy| + rho |dtheta| of held-out pushes, rho = 70.7 mm; mean over splits ± 95 % "
        "confidence (Student's t).",
        f"Mean, median and 90th percentile over the feet sets: {', '.join(feet)}.",
        "Repeating the same push differs by about 1.4 mm.",
    )
    columns = ("model", "training", *names, "mean", "median", "p90")
    return Table("CMU pushes: held-out error, mm", columns, rows, notes, keys=2)


def _tabulate_curve(
    scores: Sequence[RealPushScore], names: Sequence[str], counts: Sequence[int]
) -> Table:
    """Tabulates the errors of the CMU's pushes by the number of training pushes."""
    rows: list[list[Value]] = []
    uniform = {name: calc_split_means(scores, [name], UNIFORM_PRESSURE, 0) for name in names}
    for count in counts:
        row: list[Value] = [count]
        for model in (CENTER_MODEL, POSES_MODEL):
            worse = {
                name: float((calc_split_means(scores, [name], model, count) - uniform[name]).mean())
                for name in names
            }
            worst = max(worse, key=lambda name: worse[name])
            feet = calc_split_means(scores, choose_feet(names), model, count)
            row += [calc_splits_mean(feet), worse[worst], worst]
        rows.append(row)
    notes = (
        "Worst: on the set where learning helps least, its mean error less that of uniform "
        "pressure, mm.",
    )
    columns = ("training", CENTER_MODEL, "worst", "on", POSES_MODEL, "worst", "on")
    return Table("CMU pushes: error by number of training pushes, mm", columns, rows, notes)


def _tabulate_mit(scores: Sequence[RealPushScore], paths: dict[str, Path]) -> Table:
    """Tabulates the errors of the MIT's pushes, beside those that their files state."""
    rows: list[list[Value]] = []
    for name, path in paths.items():
        position, angle = read_model_errors(path)
        rows.append(
            [
                name,
                "the file's own",
                None,
                Mean(MM_PER_M * position),
                Mean(float(np.degrees(angle))),
            ]
        )
        rows += [_make_pose_row(scores, name, model) for model in (UNIFORM_PRESSURE, POSES_MODEL)]
    notes = (
        f"{100 * MIT_FRACTION:.0f} % of the pushes train, the others are held out; mean over "
        "splits "
        "± 95 % confidence.",
    )
    return Table(
        "MIT pushes: held-out error", ("file", "model", *POSE_COLUMNS), rows, notes, keys=2
    )


def _tabulate_simulated(scores: Sequence[RealPushScore], names: Sequence[str]) -> Table:
    """Tabulates the errors of simulated pushes, object by object."""
    rows = [
        _make_pose_row(scores, name, model, training)
        for name in names
        for model, training in (
            (UNIFORM_PRESSURE, 0),
            *((POSES_MODEL, count) for count in SHOWN_COUNTS),
        )
    ]
    notes = (
        "Nothing here is real: pass real robots' pushes with --data.",
        f"Simulated by our own model: hidden masses and frictions by part, {SIMULATED_PUSH_COUNT} "
        "pushes of "
        f"{100 * PUSH_LENGTH:g} cm at {100 * PUSHER_SPEED:g} cm/s from random places, poses seen "
        "with "
        f"{1e3 * POSITION_STD:g} mm and {ANGLE_STD:g} rad of noise.",
        f"{CMU_TEST} pushes are held out; mean over splits, each with hidden parameters of its "
        "own, ± 95 % confidence.",
    )
    columns = ("object, simulated", "model", *POSE_COLUMNS)
    title = "Simulated stand-in for real pushes: held-out error of simulated pushes"
    return Table(title, columns, rows, notes, keys=2)


def _make_pose_row(
    scores: Sequence[RealPushScore], name: str, model: str, training: int | None = None
) -> list[Value]:
    chosen = [
        s for s in scores if s.name == name and s.model == model and training in (None, s.training)
    ]
    mm = np.array([MM_PER_M * np.mean(score.position) for score in chosen])
    degrees = np.array([np.degrees(np.mean(score.angle)) for score in chosen])
    return [name, model, chosen[0].training, calc_splits_mean(mm), calc_splits_mean(degrees)]


PANEL_COLUMNS = 2
"""Number of columns of the figure's panels."""


def write_curve(
    path: Path | str,
    scores: Sequence[RealPushScore],
    names: Sequence[str],
    counts: Sequence[int],
    force: bool,
) -> None:
    """Draws a panel for each file: the error against the number of training pushes.

    Args:
        path: file of the figure.
        scores: the errors.
        names: names of the files.
        counts: numbers of training pushes.
        force: whether a figure that exists may be replaced.
    """

    def draw(axis: Axes, name: str) -> None:
        """Draws the mean error of one file, and its spread over the splits."""
        for model, color in ((POSES_MODEL, "tab:blue"), (CENTER_MODEL, "tab:orange")):
            means = [calc_split_means(scores, [name], model, count) for count in counts]
            middle = np.array([values.mean() for values in means])
            spread = np.array([values.std(ddof=1) if len(values) > 1 else 0.0 for values in means])
            axis.plot(counts, middle, "o-", color=color, label=model, markersize=4)
            axis.fill_between(
                counts, middle - spread, middle + spread, color=color, alpha=0.15, linewidth=0
            )
        axis.axhline(
            calc_split_means(scores, [name], UNIFORM_PRESSURE, 0).mean(),
            color="0.4",
            linestyle="--",
            label=UNIFORM_PRESSURE,
        )

    labels = ("training pushes", "held-out error, mm (band: one standard deviation of the splits)")
    write_panels(path, names, PANEL_COLUMNS, labels, draw, force, from_zero=True)


SPLIT_JOBS = JobKind(
    job=RealPushJob, run=run_job, describe=lambda job: f"{job.name}, split {job.split}"
)
"""What is done with a job."""

STUDY = Study(
    name="real",
    help="Learn from real robots' pushes (--data), or simulated ones in their place, and predict "
    "others of them.",
    options=RealBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(SPLIT_JOBS,),
    tabulate=tabulate,
)
"""`gridpush bench real`."""

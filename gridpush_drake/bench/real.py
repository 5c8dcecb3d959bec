"""`gridpush bench real`: learning from real robots' pushes, and predicting others of them.

The pushes are public data of other people. Without them, simulated pushes of the shipped objects
stand in (`simulate_log`), and the table says so: nothing in it is real. Their masses and frictions
are hidden, drawn by part; every push begins at a random place of the outline, and the object is
seen with noise at its beginning and its end.

CMU (Zhou et al. 2016): 25 of a file's 50 pushes are held out, 1 to 25 of the others train; the
metric is
|dxy| + rho |dtheta|, rho = 0.05 sqrt 2 m. MIT (Yu et al. 2016): a fifth of a file's pushes trains,
the rest are held out. The standard error of one CMU split's mean is 0.15 mm: smaller differences
say nothing.

A figure shows the error on the CMU pushes against the number of training pushes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scipy import stats
from scipy.io import whosmat

from gridpush_drake.bench.jobs import QUIET, Execution, check_known, run_jobs
from gridpush_drake.bench.plant import DISTANCE, SPEED, draw_push
from gridpush_drake.bench.protocol import (
    ANGLE_STD,
    MASS_RANGE,
    POSITION_STD,
    add_pose_noise,
    check_folder,
    hide_parts,
)
from gridpush_drake.bench.table import (
    CONFIDENCE,
    MM,
    Mean,
    Table,
    Value,
    check_figure,
    write_panels,
)
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.prediction import calc_final_errors, predict
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.importers import find_importer
from gridpush_drake.pushes.importers.cmu import POSE_SIZE
from gridpush_drake.pushes.importers.mit import read_model_errors
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS, ObservedPush, PushLog

PUSHES = 50
"""A log, as many as the CMU's."""

FRICTION_RANGE = (0.2, 0.5)
"""Of a part's cells against the support."""


@lru_cache(maxsize=1)
def simulate_log(path: Path, seed: int, number: int) -> tuple[PushLog, GridObject]:
    """Simulates the log of an object's file with this number, quasi-static.

    The hidden parameters, pushes and noise of each number are its own. The object comes back as
    whoever learns sees it: one part of unknown mass.

    Raises:
        ObjectError: the file cannot be read.
        PushError: hardly any push moves the object.
    """
    obj = GridObject.from_yaml(path)
    rng = np.random.default_rng([seed, number])
    truth_seed, first = (int(value) for value in rng.integers(2**31, size=2))
    truth = CellParameters.random(obj, truth_seed, MASS_RANGE, FRICTION_RANGE)
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    pushes = []
    for i in range(PUSHES):
        push, pose = draw_push(obj, truth, first + i, radius)
        last = simulate(obj, truth, push, pose, regime="quasi_static").final_pose
        before, after = add_pose_noise(pose, rng), add_pose_noise(last, rng)
        pushes.append(
            ObservedPush(f"push_{i + 1:02d}", push, before, np.array([push.duration]), after[None])
        )
    plain = replace(obj, prior=replace(obj.prior, total_mass=None))
    return PushLog(tuple(pushes), source=f"{obj.name}, simulated, number {number}"), hide_parts(
        plain
    )


CMU_SOURCE, MIT_SOURCE = (
    "GitHub robinzhoucmu/MLab_EXP",
    "GitHub robinzhoucmu/PlanarManipulationToolBox",
)

RECORDS = "record_all"
"""The variable of a MATLAB file that holds pushes."""


def find_push_logs(data: Path, min_pushes: int) -> list[tuple[str, Path]]:
    """Finds real robots' push logs below a folder: the kind ("cmu" or "mit") and the file of each, CMU's first.

    Files of CMU's form with fewer than `min_pushes` are passed over.

    Raises:
        GridPushError: there is no such folder, or no push log in it.
    """
    expected = f"push logs as of {CMU_SOURCE} (text files of {min_pushes} or more pushes) or of {MIT_SOURCE} (.mat)"
    check_folder(data, expected)
    logs = [
        ("cmu", path)
        for path in sorted(data.rglob("*.txt"))
        if _count_cmu_pushes(path) >= min_pushes
    ]
    logs += [("mit", path) for path in sorted(data.rglob("*.mat")) if _has_records(path)]
    if not logs:
        raise GridPushError(f"{data}: holds no push log; expected {expected}")
    return logs


def _count_cmu_pushes(path: Path) -> int:
    """How many pushes a file of CMU's form begins by saying it has; 0 for another file."""
    try:
        with path.open() as file:
            count, before, after = (file.readline().split() for _ in range(3))
        if len(count) == 1 and len(before) == len(after) == POSE_SIZE:
            return int(count[0])
    except (OSError, ValueError):
        pass
    return 0


def _has_records(path: Path) -> bool:
    try:
        return any(name == RECORDS for name, _, _ in whosmat(path))
    except (OSError, ValueError, TypeError, NotImplementedError):
        return False


CMU_RHO = 0.05 * 2**0.5
"""m, of the metric."""

FEET_SETS = ("hardboard_wide", "hardboard_middle", "plywood_wide", "plywood_middle")
"""The CMU files whose mean counts; others are shown beside."""

CMU_TEST, CMU_COUNTS = 25, (1, 2, 3, 5, 8, 12, 18, 25)
SHOWN_COUNTS = (5, 25)
"""Numbers of training pushes of the first CMU table and of the simulated pushes."""

MIT_SHARE = 0.2
SPLITS, QUICK_SPLITS = 10, 2
POSE_COLUMNS = ("training", "position, mm", "angle, °")
UNIFORM, POSES, CENTER = "uniform pressure", "poses only", "poses + center of mass"


@dataclass(frozen=True)
class Job:
    """One log ("cmu", "mit" or "simulated" of an object's file) and split, and numbers of pushes to learn from.

    The split's number is also that of the simulated truth; a log without a name has its file's.
    """

    path: Path
    kind: str
    split: int
    counts: tuple[int, ...]
    seed: int
    name: str = ""


@dataclass(frozen=True)
class Score:
    """Errors of the held-out pushes of one file and split under one model."""

    name: str
    split: int
    model: str
    training: int
    position: tuple[float, ...]
    angle: tuple[float, ...]

    def combined(self) -> np.ndarray:
        """|dxy| + rho |dtheta| of each push, mm."""
        return MM * (np.array(self.position) + CMU_RHO * np.array(self.angle))


def run(
    data: Path | str | None = None,
    *,
    objects: Sequence[str] | None = None,
    splits: int = SPLITS,
    counts: Sequence[int] = CMU_COUNTS,
    seed: int = 0,
    quick: bool = False,
    figure: Path | str | None = None,
    force: bool = False,
    execution: Execution = QUIET,
) -> list[Table]:
    """Measures the default method on the public push data sets, or on simulated pushes that stand in for them.

    The arguments are the options of `gridpush bench real`, and `counts` the numbers of training
    pushes for the CMU files; `quick` leaves QUICK_SPLITS and SHOWN_COUNTS of them. `objects` are
    for simulated pushes, without `data`.

    Raises:
        GridPushError: the data are not there, or an argument does not go with them.
        PushLogError: a log cannot be read.
    """
    if figure is not None:
        check_figure(figure, force)
    splits, counts = (min(splits, QUICK_SPLITS), SHOWN_COUNTS) if quick else (splits, tuple(counts))
    if splits < 1:
        raise GridPushError(f"splits: {splits}; expected at least 1")
    if data is None:
        if figure is not None:
            raise GridPushError("figure: is of real pushes; expected --data with it")
        names, counts = list_shipped_objects() if objects is None else objects, SHOWN_COUNTS
        files = [(name, "simulated", find_shipped_object(name)) for name in names]
        check_known("objects", names, list_shipped_objects())
    else:
        if objects is not None:
            raise GridPushError("objects: are for simulated pushes; expected none with --data")
        files = name_logs(find_push_logs(Path(data).resolve(), CMU_TEST + max(counts)))
        for _, kind, path in files:
            _read(path, kind)
    jobs = [
        Job(path, kind, split, counts, seed, name)
        for name, kind, path in files
        for split in range(splits)
    ]
    results = run_jobs(run_job, jobs, lambda job: f"{job.name}, split {job.split}", execution)
    scores = [score for result in results for score in result]
    tables = [] if data is not None else [_tabulate_simulated(scores, names)]
    cmu = [name for name, kind, _ in files if kind == "cmu"]
    if cmu:
        tables += [_tabulate_cmu(scores, cmu, counts), _tabulate_curve(scores, cmu, counts)]
        if figure is not None:
            write_curve(figure, scores, choose_feet(cmu), counts, force)
    mit = {name: path for name, kind, path in files if kind == "mit"}
    if mit:
        tables.append(_tabulate_mit(scores, mit))
    return tables


def name_logs(logs: Sequence[tuple[str, Path]]) -> list[tuple[str, str, Path]]:
    """Names each log by its file, with as many of its folders as tell it from the others."""
    names = {path: path.stem for _, path in logs}
    for depth in range(1, max(len(path.parts) for path in names)):
        twice = [path for path, name in names.items() if list(names.values()).count(name) > 1]
        names |= {path: "/".join((*path.parts[-1 - depth : -1], path.stem)) for path in twice}
    return [(names[path], kind, path) for kind, path in logs]


def run_job(job: Job) -> list[Score]:
    """Learns from one split of one file with each number of pushes, and predicts its held-out pushes."""
    log, obj = (
        simulate_log(job.path, job.seed, job.split)
        if job.kind == "simulated"
        else _read(job.path, job.kind)
    )
    order = np.random.default_rng([job.seed, job.split]).permutation(len(log))
    models, counts = [(POSES, obj)], job.counts
    if job.kind == "mit":
        count = round(MIT_SHARE * len(log))
        test, rest, counts = log.subset(order[count:]), order[:count], (count,)
    else:
        test, rest = log.subset(order[:CMU_TEST]), order[CMU_TEST:]
    if job.kind == "cmu":
        models.append((CENTER, replace(obj, prior=replace(obj.prior, center_of_mass=(0.0, 0.0)))))
    scores = [_score(job, UNIFORM, 0, obj, CellParameters.uniform(obj), test)]
    for count in counts:
        train = log.subset(rest[:count])
        for model, known in models:
            found = identify(known, train, seed=job.seed)
            scores.append(_score(job, model, count, obj, found.params, test))
    return scores


def _score(
    job: Job, model: str, training: int, obj: GridObject, params: CellParameters, test: PushLog
) -> Score:
    errors = [
        error
        for error in calc_final_errors(obj, predict(obj, params, test, "quasi_static"), test)
        if error is not None
    ]
    position, angle = (
        tuple(error.position for error in errors),
        tuple(error.angle for error in errors),
    )
    return Score(job.name or job.path.stem, job.split, model, training, position, angle)


@lru_cache(maxsize=1)
def _read(path: Path, kind: str) -> tuple[PushLog, GridObject]:
    return find_importer(kind)().read(path)


def choose_feet(names: Sequence[str]) -> list[str]:
    """Those of the files whose mean counts; all where none of FEET_SETS is among them."""
    return [name for name in names if name in FEET_SETS] or list(names)


def _choose(
    scores: Sequence[Score], names: Sequence[str], model: str, training: int
) -> list[Score]:
    return [s for s in scores if s.name in names and s.model == model and s.training == training]


def calc_split_means(
    scores: Sequence[Score], names: Sequence[str], model: str, training: int
) -> np.ndarray:
    """Mean error of each split, mm, averaged over the named files."""
    chosen = _choose(scores, names, model, training)
    splits = sorted({score.split for score in chosen})
    return np.array(
        [np.mean([s.combined().mean() for s in chosen if s.split == split]) for split in splits]
    )


def calc_splits_mean(values: np.ndarray) -> Mean:
    """Mean and Student's confidence interval of the splits' means."""
    mean = float(values.mean())
    if len(values) < 2:
        return Mean(mean)
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * stats.sem(values))
    return Mean(mean, mean - half, mean + half, even=True)


def _tabulate_cmu(scores: Sequence[Score], names: Sequence[str], counts: Sequence[int]) -> Table:
    rows: list[list[Value]] = []
    shown = [count for count in reversed(SHOWN_COUNTS) if count in counts] or list(counts[-1:])
    variants = [(UNIFORM, 0), *((model, count) for count in shown for model in (CENTER, POSES))]
    feet = choose_feet(names)
    for model, training in variants:
        errors = np.concatenate([s.combined() for s in _choose(scores, feet, model, training)])
        means = [
            calc_split_means(scores, of, model, training)
            for of in (*([name] for name in names), feet)
        ]
        spread = float(np.median(errors)), float(np.quantile(errors, 0.9))
        rows.append([model, training, *map(calc_splits_mean, means), *spread])
    notes = (
        "|dxy| + rho |dtheta| of held-out pushes, rho = 70.7 mm; mean over splits ± 95 % confidence (Student's t).",
        f"Mean, median and 90th percentile over the feet sets: {', '.join(feet)}.",
        "Repeating the same push differs by about 1.4 mm.",
    )
    columns = ("model", "training", *names, "mean", "median", "p90")
    return Table("CMU pushes: held-out error, mm", columns, rows, notes, keys=2)


def _tabulate_curve(scores: Sequence[Score], names: Sequence[str], counts: Sequence[int]) -> Table:
    rows: list[list[Value]] = []
    uniform = {name: calc_split_means(scores, [name], UNIFORM, 0) for name in names}
    for count in counts:
        row: list[Value] = [count]
        for model in (CENTER, POSES):
            worse = {
                name: float((calc_split_means(scores, [name], model, count) - uniform[name]).mean())
                for name in names
            }
            worst = max(worse, key=lambda name: worse[name])
            feet = calc_split_means(scores, choose_feet(names), model, count)
            row += [calc_splits_mean(feet), worse[worst], worst]
        rows.append(row)
    notes = (
        "Worst: on the set where learning helps least, its mean error less that of uniform pressure, mm.",
    )
    columns = ("training", CENTER, "worst", "on", POSES, "worst", "on")
    return Table("CMU pushes: error by number of training pushes, mm", columns, rows, notes)


def _tabulate_mit(scores: Sequence[Score], paths: dict[str, Path]) -> Table:
    rows: list[list[Value]] = []
    for name, path in paths.items():
        position, angle = read_model_errors(path)
        rows.append(
            [name, "the file's own", None, Mean(MM * position), Mean(float(np.degrees(angle)))]
        )
        rows += [_make_pose_row(scores, name, model) for model in (UNIFORM, POSES)]
    notes = (
        f"{100 * MIT_SHARE:.0f} % of the pushes train, the others are held out; mean over splits ± 95 % confidence.",
    )
    return Table(
        "MIT pushes: held-out error", ("file", "model", *POSE_COLUMNS), rows, notes, keys=2
    )


def _tabulate_simulated(scores: Sequence[Score], names: Sequence[str]) -> Table:
    rows = [
        _make_pose_row(scores, name, model, training)
        for name in names
        for model, training in ((UNIFORM, 0), *((POSES, count) for count in SHOWN_COUNTS))
    ]
    notes = (
        "Nothing here is real: pass real robots' pushes with --data.",
        f"Simulated by our own model: hidden masses and frictions by part, {PUSHES} pushes of {100 * DISTANCE:g} cm at "
        f"{100 * SPEED:g} cm/s from random places, poses seen with {1e3 * POSITION_STD:g} mm and {ANGLE_STD:g} rad of "
        "noise.",
        f"{CMU_TEST} pushes are held out; mean over splits, each with hidden parameters of its own, ± 95 % confidence.",
    )
    columns = ("object, simulated", "model", *POSE_COLUMNS)
    title = "Simulated stand-in for real pushes: held-out error of simulated pushes"
    return Table(title, columns, rows, notes, keys=2)


def _make_pose_row(
    scores: Sequence[Score], name: str, model: str, training: int | None = None
) -> list[Value]:
    chosen = [
        s for s in scores if s.name == name and s.model == model and training in (None, s.training)
    ]
    mm = np.array([MM * np.mean(score.position) for score in chosen])
    degrees = np.array([np.degrees(np.mean(score.angle)) for score in chosen])
    return [name, model, chosen[0].training, calc_splits_mean(mm), calc_splits_mean(degrees)]


COLUMNS = 2
"""Of a figure's panels."""


def write_curve(
    path: Path | str,
    scores: Sequence[Score],
    names: Sequence[str],
    counts: Sequence[int],
    force: bool,
) -> None:
    """Draws a panel a file, see `write_panels`: the error against the number of training pushes."""

    def draw(axis: Axes, name: str) -> None:
        for model, color in ((POSES, "tab:blue"), (CENTER, "tab:orange")):
            means = [calc_split_means(scores, [name], model, count) for count in counts]
            middle = np.array([values.mean() for values in means])
            spread = np.array([values.std(ddof=1) if len(values) > 1 else 0.0 for values in means])
            axis.plot(counts, middle, "o-", color=color, label=model, markersize=4)
            axis.fill_between(
                counts, middle - spread, middle + spread, color=color, alpha=0.15, linewidth=0
            )
        axis.axhline(
            calc_split_means(scores, [name], UNIFORM, 0).mean(),
            color="0.4",
            linestyle="--",
            label=UNIFORM,
        )

    labels = ("training pushes", "held-out error, mm (band: one standard deviation of the splits)")
    write_panels(path, names, COLUMNS, labels, draw, force, from_zero=True)

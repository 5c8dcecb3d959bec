"""`gridpush bench hypotheses`: whether each load hypothesis pays for itself, on many kinds at once.

Bodies of many kinds are learned from a few pushes with all hypotheses of the default method, and
again without one of them. A hypothesis pays where others of the body's pushes are predicted better
with it, and costs where they are predicted worse. None may cost a kind more than one standard
error.

Kinds are those of `bench.truth.random_bodies`; bodies in MuJoCo of `bench.truth.sets`; the shipped
objects in the paper's simulated protocol; and, with `--data`, the real logs of `bench.real`.
Constants of the learner were chosen with seeds below REPORTED_SEED.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gridpush_drake.bench.data.protocol import MASS_SETS, make_case, make_protocol
from gridpush_drake.bench.data.real_logs import find_push_logs, name_logs
from gridpush_drake.bench.study import Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.truth.learning import CHI_SQUARE, calc_center_region
from gridpush_drake.bench.truth.random_bodies import BODY_DRAWERS as RANDOM_KINDS
from gridpush_drake.bench.truth.random_bodies import draw_body
from gridpush_drake.bench.truth.sets import (
    FOUNDATION_KIND,
    OUTLINE_NAMES,
    THREE_FEET,
    VERTICES_KIND,
    make_set,
)
from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.hypotheses import (
    DEFAULT_HYPOTHESES,
    NamedMaterials,
    UniformParts,
)
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.jobs.run import check_known
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.importers import find_importer
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.table import Mean, Table, Value
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

PAPER_KIND = "paper"
"""Kind of a shipped object in the paper's simulated protocol."""

LOGS_KIND = "logs"
"""Kind of all real logs; each log is a row by itself."""

MUJOCO_KINDS = (FOUNDATION_KIND, VERTICES_KIND, THREE_FEET)
"""Kinds of bodies that MuJoCo pushes."""

BODY_KINDS = (*RANDOM_KINDS, *MUJOCO_KINDS, PAPER_KIND, LOGS_KIND)
"""All kinds, in the order of the table."""

ALL_HYPOTHESES = "all"
"""Name of the set of all hypotheses."""

SMOOTH_FIELDS = "smooth fields alone"
"""Name of the set of the smooth fields, without any other hypothesis."""

WITHOUT_PREFIX = "without "
"""What the name of a set begins with that lacks one hypothesis."""

EVEN_MODEL = "even object"
"""Name of the model of which nothing was learned."""

DEFAULT_BODY_COUNT = 20
"""Number of bodies of each kind by default."""

QUICK_BODIES = 1
"""Number of bodies of each kind in the quick variant."""

DEFAULT_PUSH_COUNT = 5
"""Number of pushes to learn from by default."""

HELD_OUT = 10
"""Number of pushes of a body that are held out, at most."""

LOG_HELD_OUT = 25
"""Number of pushes of a real log that are held out."""

REPORTED_SEED = 1000
"""Seed of the first body by default. No constant was chosen with this or a greater one."""


def make_sets() -> dict[str, MapEnsemble]:
    """Makes the sets of hypotheses that are compared, by name."""
    # No object here has parts that the learner sees.
    of_parts = (UniformParts(), NamedMaterials())
    asked = [one for one in DEFAULT_HYPOTHESES if one not in of_parts]
    others = [one for one in asked if one.field_amplitude is None]
    sets = {ALL_HYPOTHESES: MapEnsemble()}
    for left_out in others:
        rest = tuple(one for one in asked if one is not left_out)
        sets[f"{WITHOUT_PREFIX}{left_out.name}"] = MapEnsemble(hypotheses=rest)
    fields = tuple(one for one in asked if one not in others)
    sets[SMOOTH_FIELDS] = MapEnsemble(hypotheses=fields)
    return sets


@dataclass(frozen=True)
class HypothesisBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        seed: seed of the first body of each kind; the next ones have the next seeds.
        kinds: kinds of bodies; all where None, but MuJoCo's only if it is installed, and the real
            logs only with `data`.
        bodies: number of bodies of each kind, and of divisions of each real log.
        pushes: number of pushes to learn from.
        data: folder of real logs; None for none.
    """

    seed: int = REPORTED_SEED
    kinds: tuple[str, ...] | None = option(
        None,
        f"{', '.join(BODY_KINDS[:-1])} or {BODY_KINDS[-1]}; may be repeated.",
        name="--kind",
        metavar="KIND",
        shown="all; logs with --data",
    )
    bodies: int = option(
        DEFAULT_BODY_COUNT, "Bodies of each kind, and divisions of each real log.", least=1
    )
    pushes: int = option(DEFAULT_PUSH_COUNT, "How many pushes to learn from.", least=1)
    data: Path | None = option(
        None,
        "Real pushes: a clone of GitHub robinzhoucmu/MLab_EXP or "
        "robinzhoucmu/PlanarManipulationToolBox, or a folder of such logs.",
        name="--data",
        metavar="DIR",
    )

    @property
    def chosen_kinds(self) -> tuple[str, ...]:
        """The kinds that are measured."""
        if self.kinds is not None:
            return self.kinds
        return BODY_KINDS if self.data is not None else BODY_KINDS[:-1]


@dataclass(frozen=True)
class HypothesisJob:
    """One body, learned with each set of hypotheses.

    Attributes:
        kind: one of BODY_KINDS.
        seed: seed of the body, or of the division of a log.
        pushes: number of pushes to learn from.
        path: file of a real log.
        log_kind: kind of this log, as `bench.data.real_logs` has it.
        name: name of this log.
    """

    kind: str
    seed: int
    pushes: int
    path: Path | None = None
    log_kind: str = ""
    name: str = ""


@dataclass(frozen=True)
class HypothesisScore:
    """How well a body was learned with one set of hypotheses.

    Attributes:
        kind: kind of the body, or name of the real log.
        seed: seed of the body.
        hypotheses: name of the set, or EVEN_MODEL.
        error: mean final cell error of the held-out pushes, m.
        covered: whether the true center of friction is within the 95 % region; None where it is
            not known, or nothing was learned.
    """

    kind: str
    seed: int
    hypotheses: str
    error: float
    covered: bool | None = None


def shorten(options: HypothesisBenchOptions) -> HypothesisBenchOptions:
    """Makes the options of the quick variant."""
    return replace(options, bodies=min(options.bodies, QUICK_BODIES))


def make_jobs(options: HypothesisBenchOptions) -> list[HypothesisJob]:
    """Makes a job for each body and each division of a log.

    Raises:
        GridPushError: an option is out of range, or the data are not there.
        MissingExtraError: a body in MuJoCo is asked for, and MuJoCo is not installed.
    """
    kinds = options.chosen_kinds
    check_known("kind", kinds, BODY_KINDS)
    if LOGS_KIND in kinds and options.data is None:
        raise GridPushError("kind: logs; expected --data DIR with it")
    if options.bodies < 1 or not 1 <= options.pushes <= HELD_OUT - 1:
        raise GridPushError(
            f"bodies: {options.bodies}, pushes: {options.pushes}; expected at least 1, and 1 to "
            f"{HELD_OUT - 1}"
        )
    if any(kind in MUJOCO_KINDS for kind in kinds):
        import_extra("mujoco", "bench")
    logs = [] if options.data is None else _find_logs(options.data.resolve())
    seeds = range(options.seed, options.seed + options.bodies)
    jobs = [
        HypothesisJob(kind=kind, seed=seed, pushes=options.pushes)
        for kind in kinds
        if kind != LOGS_KIND
        for seed in seeds
    ]
    if LOGS_KIND in kinds:
        jobs += [
            HypothesisJob(LOGS_KIND, seed, options.pushes, path=path, log_kind=log_kind, name=name)
            for name, log_kind, path in logs
            for seed in seeds
        ]
    return jobs


def _find_logs(data: Path) -> list[tuple[str, str, Path]]:
    """Finds name, kind and file of the real logs that have enough pushes."""
    return name_logs(find_push_logs(data, LOG_HELD_OUT + HELD_OUT))


def run_job(job: HypothesisJob) -> list[HypothesisScore]:
    """Learns one body with each set of hypotheses, and predicts its held-out pushes."""
    body = make_pushes(job)
    kind = job.name or job.kind
    scores: list[HypothesisScore] = []
    for name, ensemble in make_sets().items():
        found = identify(Model(body.obj), body.training, ensemble)
        if not scores:
            uniform = CellParameters.uniform(body.obj)
            even = calc_mean_cell_error(Model(body.obj, uniform, found.physics), body.held_out)
            scores.append(HypothesisScore(kind, job.seed, EVEN_MODEL, even))
        error = calc_mean_cell_error(Model(body.obj, found.params, found.physics), body.held_out)
        covered = None
        if body.center is not None:
            covered = calc_center_region(found, body.center)[0] <= CHI_SQUARE
        scores.append(HypothesisScore(kind, job.seed, name, error, covered))
    return scores


@dataclass(frozen=True, eq=False)
class Pushed:
    """A body's pushes, and what is known of it.

    Attributes:
        obj: the object as whoever learns sees it.
        training: pushes to learn from.
        held_out: pushes that are held out.
        center: (2,) its true center of friction, m, body frame; None where it is not known.
    """

    obj: GridObject
    training: PushLog
    held_out: PushLog
    center: Array | None = None


def make_pushes(job: HypothesisJob) -> Pushed:
    """Makes or reads a body's pushes."""
    if job.kind in RANDOM_KINDS:
        body = draw_body(job.kind, job.seed, job.pushes, HELD_OUT)
        # Friction is the same everywhere, so that both centers are one.
        center = body.truth.center_of_mass(body.obj)
        return Pushed(body.obj, body.training, body.held_out, center)
    if job.kind in MUJOCO_KINDS:
        outline = OUTLINE_NAMES[job.seed % len(OUTLINE_NAMES)]
        made = make_set(job.kind, outline, job.seed, job.pushes, HELD_OUT)
        return Pushed(made.obj, made.training, made.held_out, made.center_of_mass)
    rng = np.random.default_rng(job.seed)
    if job.kind == PAPER_KIND:
        protocol = make_protocol(None, job.seed)
        names = tuple(protocol.masses)
        case = make_case(protocol, names[job.seed % len(names)], int(rng.integers(MASS_SETS)))
        log = case.log
        obj = case.obj
        held_out = HELD_OUT
    else:
        assert job.path is not None
        log, obj = _read(job.path, job.log_kind)
        held_out = LOG_HELD_OUT
    order = rng.permutation(len(log))
    rest = order[job.pushes :][:held_out]
    return Pushed(obj, log.subset(order[: job.pushes]), log.subset(rest))


@lru_cache(maxsize=1)
def _read(path: Path, kind: str) -> tuple[PushLog, GridObject]:
    return find_importer(kind)().read(path)


def tabulate(options: HypothesisBenchOptions, done: Done) -> list[Table]:
    """Tabulates the errors by kind and set of hypotheses."""
    return [tabulate_scores([score for scores in done.of(BODY_JOBS) for score in scores])]


def tabulate_scores(scores: Sequence[HypothesisScore]) -> Table:
    """Makes a row for each kind: errors with all hypotheses, and how much more without each."""
    names = [name for name in make_sets() if name != ALL_HYPOTHESES]
    rows: list[list[Value]] = []
    for kind in dict.fromkeys(score.kind for score in scores):
        errors = {
            (score.hypotheses, score.seed): MM_PER_M * score.error
            for score in scores
            if score.kind == kind
        }
        seeds = sorted({seed for _, seed in errors})
        everything = np.array([errors[ALL_HYPOTHESES, seed] for seed in seeds])
        row: list[Value] = [kind, len(seeds)]
        row += [_calc_mean([errors[EVEN_MODEL, seed] for seed in seeds]), _calc_mean(everything)]
        row += [
            _calc_mean(np.array([errors[name, seed] for seed in seeds]) - everything)
            for name in names
        ]
        covered = [
            score.covered
            for score in scores
            if score.kind == kind
            and score.hypotheses == ALL_HYPOTHESES
            and score.covered is not None
        ]
        row.append(PERCENT_PER_ONE * float(np.mean(covered)) if covered else None)
        rows.append(row)
    columns = (
        "kind",
        "bodies",
        f"{EVEN_MODEL}, mm",
        f"{ALL_HYPOTHESES}, mm",
        *names,
        "center within, %",
    )
    notes = (
        "Mean final cell error of held-out pushes; ± is its standard error over the bodies.",
        "The other columns: how much greater the error is without a hypothesis, of the same "
        "bodies, mm. Where it is less by more than a standard error, the hypothesis costs more "
        "than it brings.",
        "Center within: bodies whose true center of friction is in the 95 % region, learned with "
        "all hypotheses.",
    )
    title = "What each load hypothesis brings, by kind of body"
    return Table(title, columns, rows, notes, keys=1)


def _calc_mean(values: Sequence[float] | np.ndarray) -> Mean:
    """Calculates a mean, less and plus its standard error."""
    sample = np.asarray(values, dtype=np.float64)
    mean = float(sample.mean())
    if len(sample) < 2:
        return Mean(mean)
    error = float(sample.std(ddof=1) / np.sqrt(len(sample)))
    return Mean(mean, mean - error, mean + error, even=True)


def _describe(job: HypothesisJob) -> str:
    return f"{job.name or job.kind} {job.seed}"


BODY_JOBS = JobKind(job=HypothesisJob, run=run_job, describe=_describe)
"""What is done with a body."""

STUDY = Study(
    name="hypotheses",
    help="Learn bodies of many kinds with all load hypotheses and without each of them, to see "
    "which ones pay.",
    options=HypothesisBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(BODY_JOBS,),
    tabulate=tabulate,
)
"""`gridpush bench hypotheses`."""

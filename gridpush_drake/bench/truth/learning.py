"""`gridpush bench truth`: how well bodies are learned that do not obey the model.

Each hidden body of `bench.truth.sets` is learned from the first few of its pushes by the default
method: of pushes that were drawn at random, or of those that `bench.truth.design` chooses. It is
judged by its held-out pushes, by its true center of mass, and by whether both are where the
identification says. The held-out pushes of a body are the same, and random, whatever it was learned
from. Bodies that hang over a table's edge are measured in `bench.truth.overhang`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gridpush_drake.bench.study import OBJECTS_OPTION, Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.truth import overhang
from gridpush_drake.bench.truth.design import find_designed_pushes
from gridpush_drake.bench.truth.overhang import OVERHANG_KIND, TIPPED_BODIES
from gridpush_drake.bench.truth.sets import (
    OUTLINE_NAMES,
    TRAINING_PUSH_COUNT,
    TRUTH_KINDS,
    TruthSet,
    make_set,
    read_set,
    write_set,
)
from gridpush_drake.dynamics.physics import QUASI_STATIC
from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import predict
from gridpush_drake.identification.result import Identification, calc_center_of_mass
from gridpush_drake.identification.spread import INTERVAL_PROBABILITY, predict_spread
from gridpush_drake.jobs.run import check_known
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.report.table import Table, Value, calc_interval
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

DEFAULT_SET_COUNT = 3
"""Number of hidden bodies of each kind and outline by default."""

QUICK_SETS = 1
"""Number of hidden bodies of each kind and outline in the quick variant."""

DEFAULT_PUSH_COUNTS = (3, 5, 8, 18)
"""Numbers of pushes to learn from by default."""

QUICK_COUNTS = (5,)
"""Numbers of pushes to learn from in the quick variant."""

UNIFORM_MODEL = "uniform"
"""Name of the model of which nothing was learned."""

TRUE_MASS_MODEL = "true masses"
"""Name of the model that is given each cell's true mass as its load."""

TRUE_LOAD_MODEL = "true loads"
"""Name of the model that is given each cell's true load at rest."""

SHIFTING_LOAD_MODEL = "true loads, shifting"
"""Name of the model that is given the true loads at rest, which shift with the pusher's force and
height."""

LEARNED_MODEL = "learned"
"""Name of the model that was learned."""

MODEL_ORDER = {
    UNIFORM_MODEL: 0,
    TRUE_MASS_MODEL: 1,
    TRUE_LOAD_MODEL: 2,
    SHIFTING_LOAD_MODEL: 3,
    LEARNED_MODEL: 4,
}
"""Order of the models in the table."""

RANDOM_CHOICE = "random"
"""Way of choosing the pushes to learn from: place, direction and speed are drawn."""

DESIGNED_CHOICE = "design"
"""Way of choosing them by what tells most, one after another (`bench.truth.design`)."""

CHOICE_NAMES = (RANDOM_CHOICE, DESIGNED_CHOICE)
"""Ways of choosing the pushes to learn from, in the order of the table."""

CHI_SQUARE = 5.991
"""Value that 95 % of chi squares of two degrees of freedom stay below."""

MIN_LOAD = 1e-6
"""Load of a cell that bears nothing, N: a mass must be positive."""


@dataclass(frozen=True)
class TruthBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        kinds: kinds of truth; OVERHANG_KIND is measured by itself, see `bench.truth.overhang`.
        objects: names of shipped objects whose outlines the bodies have; OUTLINE_NAMES where None.
        sets: number of bodies of each kind and outline; the first one has the seed `seed`.
        pushes: numbers of pushes to learn from.
        chosen: ways of choosing these pushes, of CHOICE_NAMES; RANDOM_CHOICE where None.
        out: folder of sets, each in KIND/OUTLINE_SEED. Those that are there are read, others are
            made and left there.
        force: whether sets that are there are made anew, and replaced.
        tipped: number of bodies of each outline that are pushed over the edge until they tip.
    """

    kinds: tuple[str, ...] | None = option(
        None,
        "own_weight, half_height, foundation, vertices, three_feet or overhang; may be repeated.",
        name="--kind",
        metavar="KIND",
        shown="all but overhang",
    )
    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    sets: int = option(DEFAULT_SET_COUNT, "Hidden bodies of each kind and object.", least=1)
    pushes: tuple[int, ...] | None = option(
        None,
        "How many pushes to learn from; may be repeated.",
        least=1,
        shown=", ".join(map(str, DEFAULT_PUSH_COUNTS)),
    )
    chosen: tuple[str, ...] | None = option(
        None,
        "How the pushes to learn from are chosen: random, or design, each by what tells most after "
        "the ones before; may be repeated, for both from the same bodies.",
        name="--chosen",
        metavar="WAY",
        shown=RANDOM_CHOICE,
    )
    out: Path | None = option(
        None,
        "Leave object files, pushes and truths there; those that are there are read, and made anew "
        "with --force.",
        name="--out",
        short="-o",
        metavar="DIR",
    )
    tipped: int = TIPPED_BODIES

    @property
    def chosen_kinds(self) -> tuple[str, ...]:
        """The kinds that are measured."""
        return TRUTH_KINDS if self.kinds is None else self.kinds

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the outlines."""
        return OUTLINE_NAMES if self.objects is None else self.objects

    @property
    def counts(self) -> tuple[int, ...]:
        """The numbers of pushes to learn from, each once and in order."""
        return tuple(sorted(set(DEFAULT_PUSH_COUNTS if self.pushes is None else self.pushes)))

    @property
    def ways(self) -> tuple[str, ...]:
        """The ways of choosing the pushes to learn from, in the order of CHOICE_NAMES."""
        return (
            (RANDOM_CHOICE,)
            if self.chosen is None
            else tuple(w for w in CHOICE_NAMES if w in self.chosen)
        )


@dataclass(frozen=True)
class TruthJob:
    """One hidden body, learned from several numbers of pushes.

    Attributes:
        kind: kind of truth.
        name: name of the outline.
        seed: seed of the body and its pushes.
        counts: numbers of pushes to learn from.
        ways: ways of choosing these pushes, of CHOICE_NAMES.
        out: folder of sets, where this one is looked up, and left if it has to be made; None keeps
            none.
        anew: whether to make it even if it is there.
    """

    kind: str
    name: str
    seed: int
    counts: tuple[int, ...]
    ways: tuple[str, ...] = (RANDOM_CHOICE,)
    out: Path | None = None
    anew: bool = False


@dataclass(frozen=True)
class TruthScore:
    """How one model of one hidden body did.

    Attributes:
        kind: kind of truth.
        name: name of the outline.
        seed: seed of the body.
        model: one of MODEL_ORDER.
        pushes: number of pushes that were learned from.
        error: mean final cell error of the held-out pushes, m.
        center_error: distance from the true center of mass, m.
        covered: whether the true center is within the 95 % region; None where nothing was learned.
        within: fraction of the held-out pushes whose final pose is as near to the predicted one as
            said; None where nothing was learned.
        region: radius of a circle as large as the 95 % region, m; None where nothing was learned.
        chosen: way in which the pushes that were learned from were chosen, of CHOICE_NAMES; None
            where nothing was learned.
    """

    kind: str
    name: str
    seed: int
    model: str
    pushes: int
    error: float
    center_error: float
    covered: bool | None = None
    within: float | None = None
    region: float | None = None
    chosen: str | None = None


def shorten(options: TruthBenchOptions) -> TruthBenchOptions:
    """Makes the options of the quick variant."""
    sets = min(options.sets, QUICK_SETS)
    return replace(options, sets=sets, pushes=QUICK_COUNTS, tipped=QUICK_SETS)


def make_jobs(
    options: TruthBenchOptions,
) -> list[TruthJob | overhang.OverhangJob | overhang.TippingJob]:
    """Makes a job for each kind, body and outline, and those of the overhang.

    Raises:
        GridPushError: an option is out of range.
        MissingExtraError: a set must be made, and MuJoCo is not installed.
    """
    check_known("kind", options.chosen_kinds, (*TRUTH_KINDS, OVERHANG_KIND))
    if options.sets < 1:
        raise GridPushError(f"sets: {options.sets}; expected at least 1")
    if options.chosen is not None:
        check_known("chosen", options.chosen, CHOICE_NAMES)
    counts = options.counts
    if not counts or not 1 <= counts[0] <= counts[-1] <= TRAINING_PUSH_COUNT:
        given = ", ".join(map(str, counts)) or "none"
        raise GridPushError(f"pushes: {given}; expected 1 to {TRAINING_PUSH_COUNT}")
    if options.out is None:
        # Only sets that lie in a folder already can be read without MuJoCo.
        import_extra("mujoco", "bench")
    folder = None if options.out is None else options.out.resolve()
    jobs = [
        TruthJob(
            kind=kind,
            name=name,
            seed=options.seed + i,
            counts=counts,
            ways=options.ways,
            out=folder,
            anew=options.force,
        )
        for kind in options.chosen_kinds
        if kind != OVERHANG_KIND
        for i in range(options.sets)
        for name in options.names
    ]
    if OVERHANG_KIND not in options.chosen_kinds:
        return [*jobs]
    over = overhang.make_jobs(options.names, options.sets, options.seed, options.tipped)
    return [*jobs, *over]


def run_job(job: TruthJob) -> list[TruthScore]:
    """Makes or reads one set, and learns from it.

    Raises:
        GridPushError: a set cannot be made or read, or has too few pushes.
        ObjectError: the outline's object is not shipped.
        OutputError: a file exists and may not be replaced, or cannot be written.
    """
    folder = None if job.out is None else job.out / job.kind / f"{job.name}_{job.seed}"
    if folder is not None and folder.exists() and not job.anew:
        made = read_set(folder)
    else:
        made = make_set(job.kind, job.name, job.seed)
        if folder is not None:
            write_set(made, folder, force=job.anew)
    if len(made.training) < job.counts[-1]:
        raise GridPushError(
            f"{folder}: holds {len(made.training)} pushes; expected {job.counts[-1]} to learn from"
        )
    # What the model does that knows the truth, or nothing.
    loads = CellParameters(
        np.maximum(made.loads, MIN_LOAD),
        made.params.friction,
        made.params.contact_friction,
        patch_ratio=MapEnsemble().choose_patch_ratio(made.obj),
    )
    known = {
        UNIFORM_MODEL: CellParameters.uniform(made.obj),
        TRUE_MASS_MODEL: made.params,
        TRUE_LOAD_MODEL: loads,
        SHIFTING_LOAD_MODEL: replace(loads, push_height=made.push_height),
    }
    scores = [_score(made, model, 0, params) for model, params in known.items()]
    for way in job.ways:
        log = made.training
        if way == DESIGNED_CHOICE:
            log = find_designed_pushes(made, job.counts[-1], folder, job.anew)
        for count in job.counts:
            found = identify(Model(made.obj), log[:count])
            score = _score(made, LEARNED_MODEL, count, found.params, found)
            scores.append(replace(score, chosen=way))
    return scores


def _score(
    made: TruthSet,
    model: str,
    pushes: int,
    params: CellParameters,
    found: Identification | None = None,
) -> TruthScore:
    """Judges one model; `found` is the identification that it comes from, if any."""
    physics = QUASI_STATIC if found is None else found.physics
    made_motions = predict(Model(made.obj, params, physics), made.held_out)
    poses = np.array([each.poses[-1] for each in made_motions])
    errors = calc_distances(made.obj, poses, np.array([seen.final_pose for seen in made.held_out]))
    off = params.center_of_mass(made.obj) - made.center_of_mass
    score = TruthScore(
        kind=made.kind,
        name=made.name,
        seed=made.seed,
        model=model,
        pushes=pushes,
        error=float(errors.mean()),
        center_error=float(np.linalg.norm(off)),
    )
    if found is None:
        return score
    chi_square, radius = calc_center_region(found, made.center_of_mass)
    within = errors <= [spread.cell_error for spread in predict_spread(found, made.held_out)]
    return replace(
        score, covered=chi_square <= CHI_SQUARE, within=float(within.mean()), region=radius
    )


def calc_distances(obj: GridObject, a: Array, b: Array) -> Array:
    """Calculates the mean distances of the cells (...,), m, at poses (..., 3) and (..., 3)."""
    return np.asarray(np.linalg.norm(obj.cells_at(a) - obj.cells_at(b), axis=-1).mean(axis=-1))


def calc_center_region(found: Identification, center: Array) -> tuple[float, float]:
    """Calculates where the center of mass is held to be.

    Args:
        found: the identification.
        center: (2,) the true one, m, body frame.

    Returns:
        Chi square of the true center, and the radius of a circle as large as the 95 % ellipse, m.
    """
    believed, covariance = calc_center_of_mass(found)
    off = center - believed
    radius = np.sqrt(CHI_SQUARE * np.sqrt(np.linalg.det(covariance)))
    return float(off @ np.linalg.solve(covariance, off)), float(radius)


def tabulate(options: TruthBenchOptions, done: Done) -> list[Table]:
    """Tabulates the bodies by kind and model, and what is measured at an edge."""
    scores = [score for scores in done.of(BODY_JOBS) for score in scores]
    tables = [tabulate_scores(scores)] if scores else []
    if scores and len(options.ways) > 1:
        tables.append(tabulate_difference(scores))
    pushed = [score for scores in done.of(overhang.OVERHANG_JOBS) for score in scores]
    if pushed:
        tables.append(overhang.tabulate_pushes(pushed))
        tables.append(overhang.tabulate_limit(done.of(overhang.TIPPING_JOBS)))
    return tables


def tabulate_scores(scores: Sequence[TruthScore]) -> Table:
    """Sums up scores by kind and model."""
    rows: list[list[Value]] = []
    for kind in dict.fromkeys(score.kind for score in scores):
        groups: dict[tuple[int, int, str], list[TruthScore]] = {}
        for score in scores:
            if score.kind == kind:
                key = (score.pushes, MODEL_ORDER[score.model], _name_model(score))
                groups.setdefault(key, []).append(score)
        # A name that is longer, as that of pushes by design, comes after.
        rows += [[kind, key[2], *_sum_up(groups[key])] for key in sorted(groups)]
    notes = (
        "Mean final cell error of held-out pushes, and the 95 % bootstrap interval of its mean "
        "over the bodies.",
        "True masses, true loads: what the model does when it is given each cell's mass, or its "
        "load at rest, N/g.",
        "Center: mean distance from the true center of mass; within: bodies whose center is in the "
        "95 % region;",
        "region: median radius of a circle as large as that region.",
        "Held-out within: pushes that end as near to the prediction as is said of "
        f"{INTERVAL_PROBABILITY:.0%} "
        "of them.",
    )
    columns = (
        "truth",
        "model",
        "bodies",
        "held-out, mm",
        "from",
        "to",
        "center, mm",
        "within, %",
        "region, mm",
        "held-out within, %",
    )
    title = "Bodies that do not obey the model, in MuJoCo"
    return Table(title, columns, rows, notes, keys=2)


def _name_model(score: TruthScore) -> str:
    """Names what a score is of, as the table says it."""
    if score.model != LEARNED_MODEL:
        return score.model
    return f"{score.pushes} pushes{' by design' if score.chosen == DESIGNED_CHOICE else ''}"


def tabulate_difference(scores: Sequence[TruthScore]) -> Table:
    """Compares what pushes by design and random ones taught of the same bodies."""
    learned = [score for score in scores if score.model == LEARNED_MODEL]
    rows: list[list[Value]] = []
    for kind, pushes in dict.fromkeys((score.kind, score.pushes) for score in learned):
        error = {
            (score.name, score.seed, score.chosen): score.error
            for score in learned
            if (score.kind, score.pushes) == (kind, pushes)
        }
        less = [
            error[name, seed, RANDOM_CHOICE] - value
            for (name, seed, chosen), value in error.items()
            if chosen == DESIGNED_CHOICE
        ]
        gain = calc_interval(less, MM_PER_M)
        better = PERCENT_PER_ONE * float(np.mean([value > 0 for value in less]))
        rows.append([kind, pushes, len(less), gain.mean, gain.low, gain.high, better])
    notes = (
        "Less: by how much the held-out error after pushes by design is less than after random "
        "pushes of the same body,",
        "and the 95 % bootstrap interval of its mean over the bodies; better: bodies for which it "
        "is less.",
    )
    columns = ("truth", "pushes", "bodies", "less, mm", "from", "to", "better, %")
    return Table("Pushes by design against random ones", columns, rows, notes, keys=2)


def _sum_up(scores: Sequence[TruthScore]) -> list[Value]:
    """Makes the figures of a row of the table."""
    error = calc_interval([score.error for score in scores], MM_PER_M)
    row: list[Value] = [len(scores), error.mean, error.low, error.high]
    row.append(MM_PER_M * float(np.mean([score.center_error for score in scores])))
    covered = [score.covered for score in scores if score.covered is not None]
    if not covered:
        return [*row, None, None, None]
    regions = [score.region for score in scores if score.region is not None]
    within = [score.within for score in scores if score.within is not None]
    return [
        *row,
        PERCENT_PER_ONE * float(np.mean(covered)),
        MM_PER_M * float(np.median(regions)),
        PERCENT_PER_ONE * float(np.mean(within)),
    ]


BODY_JOBS = JobKind(
    job=TruthJob, run=run_job, describe=lambda job: f"{job.kind}, {job.name} {job.seed}"
)
"""What is done with a hidden body."""

STUDY = Study(
    name="truth",
    help="Learn bodies that do not obey the model: MuJoCo pushes them, on feet, foundations and "
    "uneven bottoms.",
    options=TruthBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(BODY_JOBS, overhang.OVERHANG_JOBS, overhang.TIPPING_JOBS),
    tabulate=tabulate,
)
"""`gridpush bench truth`."""

"""`gridpush bench truth`: how well bodies are learned that do not obey the model (`bench.truth.sets`).

Each hidden body is learned from the first few of its pushes by the default method, and judged by
its held-out pushes, its true center of mass, and whether both are where the identification says.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gridpush_drake.bench.jobs import QUIET, Execution, check_known, run_jobs
from gridpush_drake.bench.paper import calc_interval
from gridpush_drake.bench.table import MM, PERCENT, Table, Value
from gridpush_drake.bench.truth import overhang
from gridpush_drake.bench.truth.overhang import OVERHANG, TIPPED_BODIES
from gridpush_drake.bench.truth.sets import (
    KINDS,
    OUTLINES,
    TRAINING,
    TruthSet,
    make_set,
    read_set,
    write_set,
)
from gridpush_drake.dynamics.physics import QUASI_STATIC
from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.map_ensemble import MapEnsemble
from gridpush_drake.identification.prediction import INTERVAL, predict, predict_spread
from gridpush_drake.identification.result import Identification, calc_center_of_mass
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

SETS, QUICK_SETS = 3, 1
"""Seeds of each outline."""

COUNTS, QUICK_COUNTS = (3, 5, 8, 18), (5,)
"""Pushes to learn from."""

UNIFORM, MASSES, LOADS, LEARNED = "uniform", "true masses", "true loads", "learned"
SHIFTING = "true loads, shifting"
"""Models: nothing learned; the masses as loads; the loads at rest, which may shift with the
pusher's force and height; and what was learned."""

CHI_SQUARE = 5.991
"""What 95 % of chi squares of two degrees of freedom stay below."""

MIN_LOAD = 1e-6
"""N of a cell that bears nothing: a mass must be positive."""


@dataclass(frozen=True)
class Job:
    """One hidden body, learned from several numbers of pushes.

    Attributes:
        kind: of truth.
        name: of the outline.
        seed: of the body and its pushes.
        counts: pushes to learn from.
        out: folder of sets, where this one is looked up, and left if it has to be made; None keeps
            none.
        anew: whether to make it even so.
    """

    kind: str
    name: str
    seed: int
    counts: tuple[int, ...]
    out: Path | None = None
    anew: bool = False


@dataclass(frozen=True)
class TruthScore:
    """How one model of one hidden body did; what only an identification says is None for others.

    Attributes:
        kind: of truth.
        name: of the outline.
        seed: of the body.
        model: one of ORDER.
        pushes: learned from.
        error: mean final cell error of the held-out pushes, m.
        center_error: distance from the true center of mass, m.
        covered: whether the true center is within the 95 % region.
        within: share of the held-out pushes whose final pose is as near to the predicted one as
            said.
        region: radius of a circle as large as the 95 % region, m.
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


def run(
    kinds: Sequence[str] = KINDS,
    objects: Sequence[str] | None = None,
    sets: int = SETS,
    pushes: Sequence[int] = COUNTS,
    seed: int = 0,
    execution: Execution = QUIET,
    *,
    quick: bool = False,
    out: Path | None = None,
    force: bool = False,
) -> list[Table]:
    """Measures the default method on hidden bodies.

    Args:
        kinds: of truth; OVERHANG is measured by itself, see `bench.truth.overhang`.
        objects: shipped objects whose outlines the bodies have; five by default.
        sets: bodies of each kind and outline.
        pushes: numbers of pushes to learn from.
        seed: of the first body; the others' follow.
        execution: how the jobs are run.
        quick: only `QUICK_SETS` bodies and `QUICK_COUNTS` pushes.
        out: folder of sets, each in KIND/OUTLINE_SEED; those that are there are read, others are
            made and left there.
        force: whether those that are there are made anew, and replaced.

    Returns:
        A row for each kind and model; of OVERHANG, the pushes' errors and the limit.

    Raises:
        GridPushError: an argument is out of range, or a set cannot be read or made.
        MissingExtraError: a set must be made, and MuJoCo is not installed.
        ObjectError: an object is not shipped.
        OutputError: a file exists and may not be replaced, or cannot be written.
    """
    sets, counts = (
        (min(sets, QUICK_SETS), QUICK_COUNTS) if quick else (sets, tuple(sorted(set(pushes))))
    )
    _check(kinds, sets, counts)
    if out is None:
        # only sets that lie in a folder already can be read without MuJoCo
        import_extra("mujoco", "bench")
    names = OUTLINES if objects is None else tuple(objects)
    flat = [kind for kind in kinds if kind != OVERHANG]
    jobs = [
        Job(kind, name, seed + i, counts, out, force)
        for kind in flat
        for i in range(sets)
        for name in names
    ]
    results = run_jobs(run_job, jobs, lambda job: f"{job.kind}, {job.name} {job.seed}", execution)
    tables = [tabulate([score for scores in results for score in scores])] if flat else []
    if OVERHANG in kinds:
        tables += overhang.run(names, sets, seed, execution, QUICK_SETS if quick else TIPPED_BODIES)
    return tables


def run_job(job: Job) -> list[TruthScore]:
    """Makes or reads one set, and learns from it."""
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
    friction, contact = made.params.friction, made.params.contact_friction
    patch_ratio = MapEnsemble().choose_patch_ratio(made.obj)
    loads = CellParameters(
        np.maximum(made.loads, MIN_LOAD), friction, contact, patch_ratio=patch_ratio
    )
    known = {UNIFORM: CellParameters.uniform(made.obj), MASSES: made.params, LOADS: loads}
    known[SHIFTING] = replace(loads, push_height=made.push_height)
    scores = [_score(made, model, 0, params) for model, params in known.items()]
    for count in job.counts:
        found = identify(made.obj, made.training[:count])
        scores.append(_score(made, LEARNED, count, found.params, found))
    return scores


def _score(
    made: TruthSet,
    model: str,
    pushes: int,
    params: CellParameters,
    found: Identification | None = None,
) -> TruthScore:
    physics = QUASI_STATIC if found is None else found.physics
    made_motions = predict(made.obj, params, made.held_out, physics=physics)
    poses = np.array([each.poses[-1] for each in made_motions])
    errors = calc_distances(made.obj, poses, np.array([seen.final_pose for seen in made.held_out]))
    off = params.center_of_mass(made.obj) - made.center_of_mass
    key = (
        made.kind,
        made.name,
        made.seed,
        model,
        pushes,
        float(errors.mean()),
        float(np.linalg.norm(off)),
    )
    if found is None:
        return TruthScore(*key)
    chi_square, radius = calc_center_region(found, made.center_of_mass)
    within = errors <= [spread.cell_error for spread in predict_spread(found, made.held_out)]
    return TruthScore(*key, chi_square <= CHI_SQUARE, float(within.mean()), radius)


def calc_distances(obj: GridObject, a: Array, b: Array) -> Array:
    """Mean distances of the cells (...,), m, at poses (..., 3) and (..., 3)."""
    return np.asarray(np.linalg.norm(obj.cells_at(a) - obj.cells_at(b), axis=-1).mean(axis=-1))


def calc_center_region(found: Identification, center: Array) -> tuple[float, float]:
    """Where the center of mass is held to be.

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


def tabulate(scores: Sequence[TruthScore]) -> Table:
    """Sums up scores by kind and model."""
    rows: list[list[Value]] = []
    for kind in dict.fromkeys(score.kind for score in scores):
        models = sorted(
            {(score.pushes, score.model) for score in scores},
            key=lambda each: (each[0], ORDER[each[1]]),
        )
        for pushes, model in models:
            chosen = [s for s in scores if (s.kind, s.model, s.pushes) == (kind, model, pushes)]
            rows.append([kind, model if model != LEARNED else f"{pushes} pushes", *_sum_up(chosen)])
    notes = (
        "Mean final cell error of held-out pushes, and the 95 % bootstrap interval of its mean over the bodies.",
        "True masses, true loads: what the model does when it is given each cell's mass, or its load at rest, N/g.",
        "Center: mean distance from the true center of mass; within: bodies whose center is in the 95 % region;",
        "region: median radius of a circle as large as that region.",
        f"Held-out within: pushes that end as near to the prediction as is said of {INTERVAL:.0%} of them.",
    )
    columns = (
        "truth", "model", "bodies", "held-out, mm", "from", "to", "center, mm", "within, %", "region, mm",
        "held-out within, %",
    )  # fmt: skip
    return Table("Bodies that do not obey the model, in MuJoCo", columns, rows, notes, keys=2)


ORDER = {UNIFORM: 0, MASSES: 1, LOADS: 2, SHIFTING: 3, LEARNED: 4}
"""Of models in the table."""


def _sum_up(scores: Sequence[TruthScore]) -> list[Value]:
    error = calc_interval([score.error for score in scores])
    row: list[Value] = [len(scores), *(MM * value for value in (error.mean, error.low, error.high))]
    row.append(MM * float(np.mean([score.center_error for score in scores])))
    covered = [score.covered for score in scores if score.covered is not None]
    if not covered:
        return [*row, None, None, None]
    region = MM * float(np.median([score.region for score in scores if score.region is not None]))
    within = PERCENT * float(
        np.mean([score.within for score in scores if score.within is not None])
    )
    return [*row, PERCENT * float(np.mean(covered)), region, within]


def _check(kinds: Sequence[str], sets: int, counts: Sequence[int]) -> None:
    check_known("kind", kinds, (*KINDS, OVERHANG))
    if sets < 1:
        raise GridPushError(f"sets: {sets}; expected at least 1")
    if not counts or not 1 <= counts[0] <= counts[-1] <= TRAINING:
        raise GridPushError(
            f"pushes: {', '.join(map(str, counts)) or 'none'}; expected 1 to {TRAINING}"
        )

"""`gridpush bench pregrasp`: slides to the table's rim with hidden masses, and what pokes are worth.

Two experiments in the quasi-static LCP world with a table's edge (`bench.pregrasp_world`):

    sliding     every object with hidden masses and frictions is explored, slid to the rim and grasped there, by the
                method, by the paper's two ablations, and with the true parameters
    exploring   pokes chosen by design, or at random, until the centre of mass's standard deviation is small
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gridpush_drake.bench.pregrasp_exploration import AIMS, DISTANCES, ExplorationScore, explore
from gridpush_drake.bench.pregrasp_objects import MASK_OBJECT, OBJECTS, find_mask, load_bench_object, make_table
from gridpush_drake.bench.pregrasp_tables import (
    SlideScore,
    tabulate_exploration,
    tabulate_exploration_by_object,
    tabulate_objects,
    tabulate_slides,
)
from gridpush_drake.bench.pregrasp_world import Believe, EdgeWorld, Learner, PaperLearner, run_pregrasp
from gridpush_drake.bench.table import Table
from gridpush_drake.bench.workers import QUIET, Conduct, run_jobs
from gridpush_drake.errors import GridPushError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.grasp_parts import GraspPart, Gripper, find_grasp_parts
from gridpush_drake.planning.pregrasp import PreGraspOptions, PreGraspPlanner

LEARNED, WIDE, TRUE = "learned", "learned, wide friction", "true"
UNIFORM, UNBOUNDED = "uniform", "unbounded"
METHODS = (LEARNED, WIDE, TRUE, UNIFORM, UNBOUNDED)
"""The method; the same where less is known of the friction; the true parameters; uniform mass; the paper's
identification without a bound on the friction."""

EXPLORING = {f"exploring, {aim}, {1e3 * distance:.0f} mm": (aim, distance) for distance in DISTANCES for aim in AIMS}
"""What is wanted of the centre of mass, and the pokes' length (m), of each comparison of pokes."""

SLIDING_ONLY, EXPLORING_ONLY, ALL = "sliding", "exploring", "all"
EXPERIMENTS = (ALL, SLIDING_ONLY, EXPLORING_ONLY)

MASS_SETS, SEEDS = 10, 3
QUICK_MASS_SETS, QUICK_SEEDS = 2, 1

FRICTION_RANGE = (0.3, 0.4)
"""What the frictions of an object's parts are drawn from, and what the method knows of them: as in the station, of
somebody who has seen what object and table are made of (`models/scenarios/grasp.yaml`)."""

WIDE_FRICTION_RANGE = (0.25, 0.5)
"""The same where hardly anything is known of them."""

CONTACT_FRICTION_RANGE = (0.35, 0.65)
"""Of the finger on the object."""

NO_BOUND = (0.01, 10.0)
"""Frictions that the unbounded ablation may believe in."""

MASS_RANGE = (0.1, 5.0)
"""kg a cell, log-uniform by part, as the paper's."""

DEPTH = 0.03
"""m of a part that must hang over: the fingers' depth."""

MOST_ARM = 0.06
"""m that the grasp may be from where the centre of mass is believed: held farther off, the object turns in the gripper.
Anywhere at the end of a handle, no mass distribution tips the object, and all methods do as well. So near, the object
must come close to tipping; the true masses still leave a grasp in every case."""

MOST_ARMS = {"toolbox": 0.15}
"""The same for objects that offer nothing to hold so near to their middle: this one can be taken by its rim only."""

ARM_SLACK = 0.02
"""m that a grasp may be farther from the true centre of mass than `MOST_ARM` and still count as near."""

OFFSET = 0.05
"""m, at most, of the object from the table's middle at the beginning."""

PAPER_PUSHES = 4
"""Pokes that the unbounded ablation learns from before it slides; the method decides itself."""


@dataclass(frozen=True)
class Job:
    """One object with one mass set and seed, by one method, or both ways of exploring."""

    name: str
    mass_set: int
    seed: int
    method: str
    depth: float = DEPTH
    mask: Path | None = None


def run(
    objects: Sequence[str] | None = None,
    mass_sets: int = MASS_SETS,
    seeds: int = SEEDS,
    methods: Sequence[str] = METHODS,
    seed: int = 0,
    conduct: Conduct = QUIET,
    *,
    depth: float = DEPTH,
    experiment: str = ALL,
    quick: bool = False,
    data: Path | None = None,
) -> list[Table]:
    """Measures both experiments.

    Args:
        objects: names; where None, all shipped objects with a graspable part, and the paper's hammer of the data.
        mass_sets: hidden sets of masses and frictions an object.
        seeds: tables, starts and noises a mass set; the table takes turns with both.
        methods: of METHODS.
        seed: of everything random.
        conduct: how the jobs are run.
        depth: of the gripper's fingers, m; the deeper, the nearer the object comes to tipping.
        experiment: of EXPERIMENTS.
        quick: only `QUICK_MASS_SETS` mass sets and `QUICK_SEEDS` seeds.
        data: folder of the paper's masks; None for the shipped objects alone.

    Returns:
        Slides by method; slides of the first method by object; and pokes by design and at random, by their length and
        by object. Pokes are compared with the first seed only.

    Raises:
        GridPushError: the data are not there, a name is not known, or a count is not positive.
    """
    mask = None if data is None else find_mask(data)
    known = OBJECTS if mask is None else (*OBJECTS, MASK_OBJECT)
    objects = known if objects is None else objects
    _check(objects, known, mass_sets, seeds, methods, experiment)
    if quick:
        mass_sets, seeds = min(mass_sets, QUICK_MASS_SETS), min(seeds, QUICK_SEEDS)
    sliding, exploring = experiment != EXPLORING_ONLY, experiment != SLIDING_ONLY
    jobs = [
        Job(name, mass_set, seed + i, method, depth, mask if name == MASK_OBJECT else None)
        for mass_set in range(mass_sets)
        for i in range(seeds)
        for name in objects
        for method in (*(methods if sliding else ()), *(EXPLORING if exploring and i == 0 else ()))
    ]
    done = run_jobs(run_job, jobs, _describe, conduct)
    slides = [score for score in done if isinstance(score, SlideScore)]
    pokes = [score for score in done if isinstance(score, ExplorationScore)]
    tables = []
    if sliding:
        tables += [tabulate_slides(slides, methods), tabulate_objects(slides, objects, methods[0])]
    if exploring:
        tables += [tabulate_exploration(pokes), tabulate_exploration_by_object(pokes, objects)]
    return tables


def run_job(job: Job) -> SlideScore | ExplorationScore:
    """Runs one job."""
    friction_range = WIDE_FRICTION_RANGE if job.method == WIDE else FRICTION_RANGE
    obj, parts = _load(job.name, job.depth, friction_range, job.mask)
    truth = make_truth(obj, job.mass_set)
    if job.method in EXPLORING:
        return explore(obj, truth, job.name, job.mass_set, job.seed, *EXPLORING[job.method])
    rng = np.random.default_rng([job.seed, job.mass_set])
    surface = make_table(job.seed + job.mass_set)
    start = np.append(rng.uniform(-OFFSET, OFFSET, 2), rng.uniform(-np.pi, np.pi))
    world = EdgeWorld(obj, truth, surface, start, rng)
    arm = MOST_ARMS.get(job.name, MOST_ARM)
    options = PreGraspOptions(least_pokes=_least_pokes(job.method), most_arm=arm)
    planner = PreGraspPlanner(obj, surface, options, parts)

    outcome = run_pregrasp(world, planner, _make_learner(obj, truth, job.method))
    return SlideScore(job.name, job.method, outcome, near=outcome.arm <= arm + ARM_SLACK)


def _make_learner(obj: GridObject, truth: CellParameters, method: str) -> Believe:
    if method in (LEARNED, WIDE):
        return Learner(obj)
    if method == UNBOUNDED:
        return PaperLearner(obj, NO_BOUND, PAPER_PUSHES)
    granted = Belief.of_parameters(obj, truth if method == TRUE else CellParameters.uniform(obj))
    return lambda log: granted


def make_truth(obj: GridObject, mass_set: int) -> CellParameters:
    """Hidden masses and frictions, by part, the frictions within what is known of them."""
    friction_range = (obj.prior.friction_min, obj.prior.friction_max)
    truth = CellParameters.random(obj, mass_set, MASS_RANGE, friction_range)
    rng = np.random.default_rng([mass_set, 1])
    return replace(truth, contact_friction=float(rng.uniform(*CONTACT_FRICTION_RANGE)))


def _least_pokes(method: str) -> int:
    known = PreGraspOptions().least_pokes
    return {LEARNED: known, WIDE: known, UNBOUNDED: PAPER_PUSHES}.get(method, 0)


@lru_cache(maxsize=32)
def _load(
    name: str, depth: float, friction_range: tuple[float, float], mask: Path | None
) -> tuple[GridObject, tuple[GraspPart, ...]]:
    obj = load_bench_object(name, friction_range, mask)
    return obj, tuple(find_grasp_parts(obj, Gripper(depth=depth)))


def _check(
    objects: Sequence[str],
    known_objects: Sequence[str],
    mass_sets: int,
    seeds: int,
    methods: Sequence[str],
    experiment: str,
) -> None:
    for what, given, known in (
        ("objects", objects, known_objects),
        ("methods", methods, METHODS),
        ("experiment", [experiment], EXPERIMENTS),
    ):
        unknown = [name for name in given if name not in known]
        if unknown or not given:
            raise GridPushError(f"{what}: {', '.join(unknown) or 'none'}; expected some of {', '.join(known)}")
    for what, count in (("mass sets", mass_sets), ("seeds", seeds)):
        if count < 1:
            raise GridPushError(f"{what}: {count}; expected at least 1")


def _describe(job: Job) -> str:
    return f"{job.name}, mass set {job.mass_set}, {job.method}"

"""`gridpush bench pregrasp`: slides to the table's edge with hidden masses, and what pokes are worth.

Two experiments in the quasi-static LCP world with a table's edge (`bench.pregrasp_world`):

    sliding     every object with hidden masses and frictions is explored, slid to the edge and grasped there, by the
                method, by the paper's two ablations, and with the true parameters
    exploring   pokes chosen by design, or at random, until the center of mass's standard deviation is small
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gridpush_drake.bench.jobs import QUIET, Execution, check_known, run_jobs
from gridpush_drake.bench.pregrasp_exploration import (
    AIMS,
    ALONG,
    BOTH,
    DISTANCES,
    WANTED_STD,
    ExplorationScore,
    explore,
)
from gridpush_drake.bench.pregrasp_world import EdgeWorld, MujocoWorld, Outcome, PaperLearner, run_pregrasp
from gridpush_drake.bench.protocol import MASS_RANGE, PLANNING_METERS_PER_PIXEL, find_masks
from gridpush_drake.bench.table import MM, PERCENT, Table, Value
from gridpush_drake.bench.truth_sets import KINDS
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import make_direction
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.grasp_parts import GraspPart, Gripper, find_grasp_parts
from gridpush_drake.planning.pregrasp.planner import PreGraspOptions, PreGraspPlanner
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.planning.support_surface import SupportSurface

MASK_OBJECT = "hammer"
"""The paper's own hammer, a mask among the public data."""

OBJECTS = (
    "claw_hammer",
    "combination_wrench",
    "pliers",
    "spray_bottle",
    "spring_clamp",
    "toolbox",
    "toothpaste_tube",
)
"""Those of the shipped objects that have a graspable part."""

RECTANGLE, RADIUS, HEXAGON = (0.9, 0.7), 0.45, 0.5
"""m: sides, radius, circumradius of the tables, which take turns by seed."""


def find_mask(data: Path) -> Path:
    """Finds the paper's hammer among the public data. Raises GridPushError where it is not there."""
    masks = find_masks(data)
    if MASK_OBJECT not in masks:
        raise GridPushError(f"{data}: holds no mask of {MASK_OBJECT}; expected {MASK_OBJECT}_label.pgm")
    return masks[MASK_OBJECT].resolve()


def load_bench_object(name: str, friction_range: tuple[float, float], mask: Path | None = None) -> GridObject:
    """Loads an object, its support friction known to be within a range, its parts' masses not at all.

    Args:
        name: of OBJECTS, or of the mask.
        friction_range: least and greatest coefficient of any cell.
        mask: file of the paper's object; None for a shipped one.

    Returns:
        The object; the prior coefficient is the range's geometric mean.

    Raises:
        ObjectError: no shipped object has this name, or the mask cannot be read.
    """
    if mask is not None:
        obj = GridObject.from_mask(mask, meters_per_pixel=PLANNING_METERS_PER_PIXEL, name=name)
    else:
        obj = GridObject.from_yaml(find_shipped_object(name))
    low, high = friction_range
    prior = replace(
        obj.prior, total_mass=None, friction=float(np.sqrt(low * high)), friction_min=low, friction_max=high
    )
    return replace(obj, prior=prior)


def make_table(seed: int) -> SupportSurface:
    """A rectangular, a round or a hexagonal table about the world's origin, in turn."""
    kind = seed % 3
    if kind == 0:
        return SupportSurface.rectangle((0.0, 0.0), RECTANGLE)
    if kind == 1:
        return SupportSurface.round((0.0, 0.0), RADIUS)
    return SupportSurface.from_polygon(HEXAGON * make_direction(np.pi / 3 * np.arange(6)))


LIKELY = {BOTH: 5.991 / 2, ALONG: 3.841}
"""What 95 % of chi squares stay below, per direction: of two degrees of freedom, and of one."""

SLIDE_COLUMNS = ("runs", "graspable, %", "dropped", "given up", "pokes", "slides")
EXPLORE_COLUMNS = ("runs", "by design", "at random", "ratio", "error, mm", "at random, mm", "within 95 %, %")


@dataclass(frozen=True)
class SlideScore:
    """How one run ended.

    Attributes:
        name: of the object.
        method: of what is believed.
        outcome: the end.
        near: whether the part to be grasped is as near to the true center of mass as asked.
    """

    name: str
    method: str
    outcome: Outcome
    near: bool = True


def tabulate_slides(scores: Sequence[SlideScore], methods: Sequence[str]) -> Table:
    """Successes, drops and refusals by method."""
    return Table(
        "Pre-grasp sliding, hidden masses and frictions",
        ("method", *SLIDE_COLUMNS),
        _make_slide_rows(methods, lambda method: [score for score in scores if score.method == method]),
        (
            "graspable: a part hangs over the edge far enough, and the object is at rest.",
            "dropped: it fell off the table on the way. given up: no safe way was found, and it is still on the table.",
            "learned: stability for all masses that agree with the pushes; true: hidden parameters known; "
            "uniform: uniform mass, nothing learned; unbounded: the paper's identification, friction without a bound.",
            "pokes, slides: mean number of pushes.",
        ),
    )


def tabulate_objects(scores: Sequence[SlideScore], objects: Sequence[str], method: str) -> Table:
    """One method's runs by object."""
    chosen = [score for score in scores if score.method == method]
    rows = _make_slide_rows(objects, lambda name: [score for score in chosen if score.name == name])
    return Table(f"Pre-grasp sliding by object, {method}", ("object", *SLIDE_COLUMNS), rows)


def _make_slide_rows(keys: Sequence[str], find: Callable[[str], list[SlideScore]]) -> list[tuple[Value, ...]]:
    """A row for each key that has scores."""
    rows: list[tuple[Value, ...]] = []
    for key in keys:
        outcomes = [score.outcome for score in find(key)]
        if outcomes:
            grasped, dropped = sum(o.grasped for o in outcomes), sum(o.dropped for o in outcomes)
            share, given_up = PERCENT * grasped / len(outcomes), len(outcomes) - grasped - dropped
            pokes, slides = (float(np.mean([getattr(o, what) for o in outcomes])) for what in ("pokes", "slides"))
            rows.append((key, len(outcomes), share, dropped, given_up, pokes, slides))
    return rows


def tabulate_exploration(scores: Sequence[ExplorationScore]) -> Table:
    """Pokes needed, by design and at random, by their length; and whether the stated spread is right."""
    lengths = sorted({score.distance for score in scores})
    return Table(
        f"Pokes until the center of mass is known to {WANTED_STD * MM:.0f} mm",
        ("wanted", "poke, mm", *EXPLORE_COLUMNS),
        _make_exploration_rows(
            {MM * length: [score for score in scores if score.distance == length] for length in lengths}
        ),
        (
            "by design, at random: mean number of pokes; the poke said to tell most, or any of the same pool.",
            "wanted: of the center of mass; in both directions the least known one counts.",
            "error: mean distance of the final estimate from the true center.",
            "within 95 %: runs of either kind whose true center is within the 95 % range that the estimate states.",
        ),
        keys=2,
    )


def tabulate_exploration_by_object(scores: Sequence[ExplorationScore], objects: Sequence[str]) -> Table:
    """The same by object, over all lengths."""
    rows = _make_exploration_rows({name: [score for score in scores if score.name == name] for name in objects})
    return Table("The same by object, pokes of all lengths", ("wanted", "object", *EXPLORE_COLUMNS), rows, keys=2)


def _make_exploration_rows(groups: Mapping[Any, Sequence[ExplorationScore]]) -> list[tuple[Value, ...]]:
    """A row for each aim and key of a group that has scores."""
    rows: list[tuple[Value, ...]] = []
    for aim in AIMS:
        for key, group in groups.items():
            chosen = [score for score in group if score.aim == aim]
            if chosen:
                active, random = [score.active for score in chosen], [score.random for score in chosen]
                designed, drawn = (float(np.mean([trace.pokes for trace in traces])) for traces in (active, random))
                errors = (MM * float(np.mean([trace.errors[-1] for trace in traces])) for traces in (active, random))
                within = np.mean([trace.chi_square <= LIKELY[aim] for trace in (*active, *random)])
                share = PERCENT * float(within)
                rows.append((aim, key, len(chosen), designed, drawn, designed / drawn, *errors, share))
    return rows


LEARNED, WIDE, TRUE = "learned", "learned, wide friction", "true"
UNIFORM, UNBOUNDED = "uniform", "unbounded"
METHODS = (LEARNED, WIDE, TRUE, UNIFORM, UNBOUNDED)
"""The method; the same where less is known of the friction; the true parameters; uniform mass; the paper's
identification without a bound on the friction."""

EXPLORING = {f"exploring, {aim}, {1e3 * distance:.0f} mm": (aim, distance) for distance in DISTANCES for aim in AIMS}
"""What is wanted of the center of mass, and the pokes' length (m), of each comparison of pokes."""

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

DEPTH = 0.03
"""m of a part that must hang over: the fingers' depth."""

MAX_ARM = 0.06
"""m that the grasp may be from where the center of mass is believed: held farther off, the object turns in the gripper.
Anywhere at the end of a handle, no mass distribution tips the object, and all methods do as well. So near, the object
must come close to tipping; the true masses still leave a grasp in every case."""

MAX_ARMS = {"toolbox": 0.15}
"""The same for objects that offer nothing to hold so near to their middle: this one can be taken by its edge only."""

ARM_SLACK = 0.02
"""m that a grasp may be farther from the true center of mass than `MAX_ARM` and still count as near."""

OFFSET = 0.05
"""m, at most, of the object from the table's middle at the beginning."""

PAPER_PUSHES = 4
"""Pokes that the unbounded ablation learns from before it slides; the method decides itself."""


@dataclass(frozen=True)
class Job:
    """One object with one mass set and seed, by one method, or both ways of exploring.

    Attributes:
        name: of the object.
        mass_set: its number.
        seed: of table, start and noise.
        method: of METHODS or EXPLORING.
        depth: of the gripper's fingers, m.
        mask: file of the paper's object.
        friction: range of the true frictions, and what is known of them.
        support: how a body in MuJoCo stands; None for the LCP world.
    """

    name: str
    mass_set: int
    seed: int
    method: str
    depth: float = DEPTH
    mask: Path | None = None
    friction: tuple[float, float] = FRICTION_RANGE
    support: str | None = None


def run(
    objects: Sequence[str] | None = None,
    mass_sets: int = MASS_SETS,
    seeds: int = SEEDS,
    methods: Sequence[str] = METHODS,
    seed: int = 0,
    execution: Execution = QUIET,
    *,
    depth: float = DEPTH,
    experiment: str = ALL,
    quick: bool = False,
    data: Path | None = None,
    friction: tuple[float, float] = FRICTION_RANGE,
    support: str | None = None,
) -> list[Table]:
    """Measures both experiments.

    Args:
        objects: names; where None, all shipped objects with a graspable part, and the paper's hammer of the data.
        mass_sets: hidden sets of masses and frictions an object.
        seeds: tables, starts and noises a mass set; the table takes turns with both.
        methods: of METHODS.
        seed: of everything random.
        execution: how the jobs are run.
        depth: of the gripper's fingers, m; the deeper, the nearer the object comes to tipping.
        experiment: of EXPERIMENTS.
        quick: only `QUICK_MASS_SETS` mass sets and `QUICK_SEEDS` seeds.
        data: folder of the paper's masks; None for the shipped objects alone.
        friction: range of the true frictions, which is known, but for the method WIDE.
        support: how a body stands that MuJoCo moves, of `truth_sets.KINDS`; only sliding, by the first method, on
            rectangular tables. None for the LCP world.

    Returns:
        Slides by method; slides of the first method by object; and pokes by design and at random, by their length and
        by object. Pokes are compared with the first seed only.

    Raises:
        GridPushError: the data are not there, a name is not known, or a count is not positive.
    """
    mask = None if data is None else find_mask(data)
    known = OBJECTS if mask is None else (*OBJECTS, MASK_OBJECT)
    objects = known if objects is None else objects
    if support is not None:
        methods, experiment = methods[:1], SLIDING_ONLY
    _check(objects, known, mass_sets, seeds, methods, experiment)
    _check_world(friction, support)
    if quick:
        mass_sets, seeds = min(mass_sets, QUICK_MASS_SETS), min(seeds, QUICK_SEEDS)
    sliding, exploring = experiment != EXPLORING_ONLY, experiment != SLIDING_ONLY
    jobs = [
        Job(name, mass_set, seed + i, method, depth, mask if name == MASK_OBJECT else None, friction, support)
        for mass_set in range(mass_sets)
        for i in range(seeds)
        for name in objects
        for method in (*(methods if sliding else ()), *(EXPLORING if exploring and i == 0 else ()))
    ]
    done = run_jobs(run_job, jobs, _describe, execution)
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
    friction_range = WIDE_FRICTION_RANGE if job.method == WIDE else job.friction
    obj, parts = _load(job.name, job.depth, friction_range, job.mask)
    truth = make_truth(obj, job.mass_set)
    if job.method in EXPLORING:
        return explore(obj, truth, job.name, job.mass_set, job.seed, *EXPLORING[job.method])
    rng = np.random.default_rng([job.seed, job.mass_set])
    start = np.append(rng.uniform(-OFFSET, OFFSET, 2), rng.uniform(-np.pi, np.pi))
    if job.support is None:
        world = EdgeWorld(obj, truth, make_table(job.seed + job.mass_set), start, rng)
    else:
        world = MujocoWorld(obj, truth, RECTANGLE, start, rng, job.support)
    arm = MAX_ARMS.get(job.name, MAX_ARM)
    options = PreGraspOptions(min_pokes=_min_pokes(job.method), max_arm=arm)
    planner = PreGraspPlanner(obj, world.surface, options, parts)

    outcome = _run(world, planner, job.method)
    return SlideScore(job.name, job.method, outcome, near=outcome.arm <= arm + ARM_SLACK)


def _run(world: EdgeWorld, planner: PreGraspPlanner, method: str) -> Outcome:
    if method in (LEARNED, WIDE):
        return run_pregrasp(world, planner)
    if method == UNBOUNDED:
        paper = PaperLearner(NO_BOUND, PAPER_PUSHES)
        return run_pregrasp(world, planner, paper.learn, paper.make_inference(world.obj))
    params = world.hidden if method == TRUE else CellParameters.uniform(world.obj)
    granted = UncertainModel.of_parameters(world.obj, params)
    return run_pregrasp(world, planner, None, lambda found, log: granted)


def make_truth(obj: GridObject, mass_set: int) -> CellParameters:
    """Hidden masses and frictions, by part, the frictions within what is known of them."""
    friction_range = (obj.prior.friction_min, obj.prior.friction_max)
    truth = CellParameters.random(obj, mass_set, MASS_RANGE, friction_range)
    rng = np.random.default_rng([mass_set, 1])
    return replace(truth, contact_friction=float(rng.uniform(*CONTACT_FRICTION_RANGE)))


def _min_pokes(method: str) -> int:
    known = PreGraspOptions().min_pokes
    return {LEARNED: known, WIDE: known, UNBOUNDED: PAPER_PUSHES}.get(method, 0)


@lru_cache(maxsize=32)
def _load(
    name: str, depth: float, friction_range: tuple[float, float], mask: Path | None
) -> tuple[GridObject, tuple[GraspPart, ...]]:
    obj = load_bench_object(name, friction_range, mask)
    return obj, tuple(find_grasp_parts(obj, Gripper(depth=depth)))


def _check_world(friction: tuple[float, float], support: str | None) -> None:
    if not 0 < friction[0] <= friction[1] < np.inf:
        raise GridPushError(f"friction: {friction[0]:g} to {friction[1]:g}; expected 0 < least <= greatest")
    if support is not None and support not in KINDS:
        raise GridPushError(f"support: {support}; expected one of {', '.join(KINDS)}")


def _check(
    objects: Sequence[str],
    known_objects: Sequence[str],
    mass_sets: int,
    seeds: int,
    methods: Sequence[str],
    experiment: str,
) -> None:
    check_known("objects", objects, known_objects)
    check_known("methods", methods, METHODS)
    check_known("experiment", [experiment], EXPERIMENTS)
    for what, count in (("mass sets", mass_sets), ("seeds", seeds)):
        if count < 1:
            raise GridPushError(f"{what}: {count}; expected at least 1")


def _describe(job: Job) -> str:
    return f"{job.name}, mass set {job.mass_set}, {job.method}"

"""`gridpush bench pregrasp`: slides to the table's edge with hidden masses, and what pokes are worth.

Experiments in the quasi-static LCP world with a table's edge (`bench.pregrasp.world`):

    sliding     every object with hidden masses and frictions is explored, slid to the edge and
    grasped there, by the
                method, by the paper's two ablations, and with the true parameters
    exploring   pokes chosen by design, or at random, until the center of mass's standard deviation
    is small materials   the method with objects that are partly of rubber and partly of steel, told
    bounds of the friction that
                hold, or do not
    bounds      what such bounds allow at best (`bench.pregrasp.bounds`)

and sliding, by the method, under truths that do not obey the model: bodies in MuJoCo, and the LCP
world beside them.

The center is wanted in both directions, or, as for a goal at the table's edge, across one line:
here along the object's longest direction. Both ways choose from the same pokes, all of one length.
A long poke tells more, whichever it is, and two or three of them are needed in any case: so the
shorter the pokes, the more there is to gain by design.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from gridpush_drake.bench.jobs import QUIET, Execution, check_known, run_jobs
from gridpush_drake.bench.pregrasp.bounds import (
    DRAWN,
    KNOWN,
    RUBBER,
    STEEL,
    TOLD,
    BoundsScore,
    describe_share,
    draw_materials,
    judge_bounds,
    tabulate_bounds,
)
from gridpush_drake.bench.pregrasp.world import (
    PUSH_HEIGHTS,
    EdgeWorld,
    MujocoEdgeWorld,
    Outcome,
    PaperLearner,
    know_height,
    run_pregrasp,
)
from gridpush_drake.bench.protocol import (
    ANGLE_STD,
    MASS_RANGE,
    PLANNING_METERS_PER_PIXEL,
    POSITION_STD,
    add_pose_noise,
    find_masks,
    know_friction,
)
from gridpush_drake.bench.table import MM, PERCENT, Column, Table, calc_mean, count_of, mean_of
from gridpush_drake.bench.truth.sets import KINDS
from gridpush_drake.bench.worlds import LCP, find_world
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array, make_direction
from gridpush_drake.identification.learning import identify
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.exploration import (
    PokeOptions,
    choose_poke,
    make_center_functional,
    make_pokes,
)
from gridpush_drake.planning.pregrasp.grasp_parts import GraspPart, find_grasp_parts
from gridpush_drake.planning.pregrasp.gripper import Gripper
from gridpush_drake.planning.pregrasp.planner import PreGraspOptions, PreGraspPlanner
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import PushWorld, WorldMaker
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

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
        raise GridPushError(
            f"{data}: holds no mask of {MASK_OBJECT}; expected {MASK_OBJECT}_label.pgm"
        )
    return masks[MASK_OBJECT].resolve()


def load_bench_object(
    name: str, friction_range: tuple[float, float], mask: Path | None = None
) -> GridObject:
    """Loads an object, or its mask, as `know_friction` has it. Raises ObjectError where there is no such object."""
    if mask is not None:
        obj = GridObject.from_mask(mask, meters_per_pixel=PLANNING_METERS_PER_PIXEL, name=name)
    else:
        obj = GridObject.from_yaml(find_shipped_object(name))
    return know_friction(obj, *friction_range)


def make_table(seed: int) -> SupportSurface:
    """A rectangular, a round or a hexagonal table about the world's origin, in turn."""
    kind = seed % 3
    if kind == 0:
        return SupportSurface.rectangle((0.0, 0.0), RECTANGLE)
    if kind == 1:
        return SupportSurface.round((0.0, 0.0), RADIUS)
    return SupportSurface.from_polygon(HEXAGON * make_direction(np.pi / 3 * np.arange(6)))


WANTED_STD = 0.005
"""m, of the center of mass, in the direction wanted or, of both, in the one least known."""

BOTH, ALONG = "both directions", "along the object"
AIMS = (BOTH, ALONG)
"""What of the center of mass is wanted."""

DISTANCES = (0.02, 0.04, 0.08)
"""Of the pokes, m."""

MAX_POKES = 20
"""Made before giving up; then counted as one more."""


LIKELY = {BOTH: 5.991 / 2, ALONG: 3.841}
"""What 95 % of chi squares stay below, per direction: of two degrees of freedom, and of one."""


@dataclass(frozen=True)
class SlideScore:
    """How one run with an object ended, by the method's belief."""

    name: str
    method: str
    outcome: Outcome


SLIDE_COLUMNS: dict[str, Column] = {
    "runs": len,
    "graspable, %": mean_of("grasped", PERCENT),
    "dropped": count_of("dropped", True),
    "given up": lambda outcomes: sum(
        not (outcome.grasped or outcome.dropped) for outcome in outcomes
    ),
    "pokes": mean_of("pokes"),
    "slides": mean_of("slides"),
}


def tabulate_slides(scores: Sequence[SlideScore], methods: Sequence[str]) -> Table:
    """Successes, drops and refusals by method."""
    groups = [
        ((method,), [score.outcome for score in scores if score.method == method])
        for method in methods
    ]
    notes = (
        "graspable: a part hangs over the edge far enough, and the object is at rest.",
        "dropped: it fell off the table on the way. given up: no safe way was found, and it is still on the table.",
        "learned: stability for all masses that agree with the pushes; true: hidden parameters known; "
        "uniform: uniform mass, nothing learned; unbounded: the paper's identification, friction without a bound.",
        "pokes, slides: mean number of pushes.",
    )
    return Table.of(
        "Pre-grasp sliding, hidden masses and frictions", ("method",), groups, SLIDE_COLUMNS, notes
    )


SHARE_COLUMNS: dict[str, Column] = {
    "runs": len,
    "reached, %": lambda outcomes: describe_share(
        sum(each.grasped for each in outcomes), len(outcomes)
    ),
    "dropped, %": lambda outcomes: describe_share(
        sum(each.dropped for each in outcomes), len(outcomes)
    ),
    "pokes": mean_of("pokes"),
    "slides": mean_of("slides"),
    "mm to spare": lambda outcomes: (
        MM * calc_mean(each.margin for each in outcomes if each.grasped)
    ),
}


def tabulate_shares(
    scores: Sequence[SlideScore], by: str, keys: Sequence[str], notes: Sequence[str]
) -> Table:
    """Successes and drops with their intervals, by truth or by what was told; `keys` are the scores' methods."""
    groups = [((key,), [score.outcome for score in scores if score.method == key]) for key in keys]
    notes = (
        *notes,
        "reached: a part hangs over the edge far enough, and the object is at rest; dropped: it fell, or tilts by 10°; "
        "in brackets 95 % Wilson intervals. The other runs were given up, the object on the table.",
        "to spare: stability margin at the worst where it was reached.",
    )
    return Table.of(f"Pre-grasp sliding by {by}", (by,), groups, SHARE_COLUMNS, notes)


def tabulate_objects(scores: Sequence[SlideScore], objects: Sequence[str], method: str) -> Table:
    """One method's runs by object."""
    groups = [
        ((name,), [s.outcome for s in scores if (s.method, s.name) == (method, name)])
        for name in objects
    ]
    return Table.of(f"Pre-grasp sliding by object, {method}", ("object",), groups, SLIDE_COLUMNS)


@dataclass(frozen=True)
class Trace:
    """One run: how many pokes were made until the standard deviation was small, `MAX_POKES` + 1 where it never was.

    The final estimate's error is of what is wanted, m; its square in units of its covariance, for
    each direction wanted, is 1 on average where that is right.
    """

    pokes: int
    error: float
    chi_square: float


@dataclass(frozen=True)
class ExplorationScore:
    """Both ways with one object and one mass set."""

    name: str
    aim: str
    distance: float
    active: Trace
    random: Trace


EXPLORE_COLUMNS: dict[str, Column] = {
    "runs": len,
    "by design": lambda scores: _mean_pokes(scores, "active"),
    "at random": lambda scores: _mean_pokes(scores, "random"),
    "ratio": lambda scores: _mean_pokes(scores, "active") / _mean_pokes(scores, "random"),
    "error, mm": lambda scores: MM * float(np.mean([score.active.error for score in scores])),
    "at random, mm": lambda scores: MM * float(np.mean([score.random.error for score in scores])),
    "within 95 %, %": lambda scores: (
        PERCENT * float(np.mean([_is_within(score) for score in scores]))
    ),
}


def _mean_pokes(scores: Sequence[ExplorationScore], way: str) -> float:
    return float(np.mean([getattr(score, way).pokes for score in scores]))


def _is_within(score: ExplorationScore) -> list[bool]:
    return [trace.chi_square <= LIKELY[score.aim] for trace in (score.active, score.random)]


def tabulate_exploration(scores: Sequence[ExplorationScore]) -> Table:
    """Pokes needed, by design and at random, by their length; and whether the stated spread is right."""
    lengths = sorted({score.distance for score in scores})
    groups = [
        (
            (aim, MM * length),
            [score for score in scores if (score.aim, score.distance) == (aim, length)],
        )
        for aim in AIMS
        for length in lengths
    ]
    title = f"Pokes until the center of mass is known to {WANTED_STD * MM:.0f} mm"
    notes = (
        "by design, at random: mean number of pokes; the poke said to tell most, or any of the same pool.",
        "wanted: of the center of mass; in both directions the least known one counts.",
        "error: mean distance of the final estimate from the true center.",
        "within 95 %: runs of either kind whose true center is within the 95 % range that the estimate states.",
    )
    return Table.of(title, ("wanted", "poke, mm"), groups, EXPLORE_COLUMNS, notes)


def tabulate_exploration_by_object(
    scores: Sequence[ExplorationScore], objects: Sequence[str]
) -> Table:
    """The same by object, over all lengths."""
    groups = [
        ((aim, name), [score for score in scores if (score.aim, score.name) == (aim, name)])
        for aim in AIMS
        for name in objects
    ]
    return Table.of(
        "The same by object, pokes of all lengths", ("wanted", "object"), groups, EXPLORE_COLUMNS
    )


LEARNED, WIDE, TRUE = "learned", "learned, wide friction", "true"
UNIFORM, UNBOUNDED = "uniform", "unbounded"
METHODS = (LEARNED, WIDE, TRUE, UNIFORM, UNBOUNDED)
"""The method; the same where less is known of the friction; the true parameters; uniform mass; the
paper's identification without a bound on the friction."""

EXPLORING = {
    f"exploring, {aim}, {1e3 * distance:.0f} mm": (aim, distance)
    for distance in DISTANCES
    for aim in AIMS
}
"""What is wanted of the center of mass, and the pokes' length (m), of each comparison of pokes."""

SLIDING_ONLY, EXPLORING_ONLY, MATERIALS, BOUNDS, ALL = (
    "sliding",
    "exploring",
    "materials",
    "bounds",
    "all",
)
EXPERIMENTS = (ALL, SLIDING_ONLY, EXPLORING_ONLY, MATERIALS, BOUNDS)

TRUTHS = (LCP, *KINDS)
"""What moves the objects: the model's own simulator, or MuJoCo bodies by how they stand."""

MASS_SETS, SEEDS = 10, 3
QUICK_MASS_SETS, QUICK_SEEDS = 2, 1

FRICTION_RANGE = (0.3, 0.4)
"""What the frictions of an object's parts are drawn from, and what the method knows of them: as in
the station, of somebody who has seen what object and table are made of
(`models/scenarios/grasp.yaml`)."""

WIDE_FRICTION_RANGE = (0.25, 0.5)
"""The same where hardly anything is known of them."""

CONTACT_FRICTION_RANGE = (0.35, 0.65)
"""Of the finger on the object."""

NO_BOUND = (0.01, 10.0)
"""Frictions that the unbounded ablation may believe in."""

DEPTH = Gripper.finger_depth
"""Depth of the gripper's fingers by default, m: so much of a part must hang over."""

MAX_ARM = 0.06
"""m that the grasp may be from where the center of mass is believed: held farther off, the object
turns in the gripper. Anywhere at the end of a handle, no mass distribution tips the object, and all
methods do as well. So near, the object must come close to tipping; the true masses still leave a
grasp in every case."""

MAX_ARMS = {"toolbox": 0.15}
"""The same for objects that offer nothing to hold so near to their middle: this one can be taken by
its edge only."""

OFFSET = 0.05
"""m, at most, of the object from the table's middle at the beginning."""

PAPER_PUSHES = 4
"""Pokes that the unbounded ablation learns from before it slides; the method decides itself."""


@dataclass(frozen=True)
class Job:
    """One object with one mass set and seed, by one of METHODS, EXPLORING or TOLD, or to judge bounds.

    Attributes:
        depth: of the gripper's fingers, m.
        mask: file of the paper's object.
        friction: range of the true frictions, and what is known of them; not by TOLD.
        truth: of TRUTHS, on a rectangular table; None for the LCP world, pushed at the table's
            height, on any.
        max_arm: that the grasp may be from where the center of mass is believed, m.
    """

    name: str
    mass_set: int
    seed: int
    method: str
    depth: float = DEPTH
    mask: Path | None = None
    friction: tuple[float, float] = FRICTION_RANGE
    truth: str | None = None
    max_arm: float = MAX_ARM


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
    truths: Sequence[str] | None = None,
    max_arm: float = MAX_ARM,
) -> list[Table]:
    """Measures experiments; the arguments are the options of `gridpush bench pregrasp`, and `methods` of METHODS.

    The table takes turns with mass sets and seeds; only QUICK_MASS_SETS and QUICK_SEEDS of them
    where `quick`. With `truths` (of TRUTHS) there is only sliding, by LEARNED, on rectangular
    tables, with the same objects, masses and starts under each. What is known of the friction is
    its range, but for the method WIDE and the materials.

    Returns:
        What bounds allow; or slides by method, truth, or bounds told, slides of the first of those
        by object, and pokes by design and at random, by their length and by object. Pokes are
        compared with the first seed only.

    Raises:
        GridPushError: the data are not there, a name is not known, or a count is not positive.
    """
    mask = None if data is None else find_mask(data)
    known = OBJECTS if mask is None else (*OBJECTS, MASK_OBJECT)
    objects = known if objects is None else objects
    check_known("objects", objects, known)
    check_known("methods", methods, METHODS)
    check_known("experiment", [experiment], EXPERIMENTS)
    if truths is not None:
        own = [truth for truth in truths if ":" in truth]
        check_known("truths", truths, (*TRUTHS, *own))
        for truth in own:
            find_world(truth)
        methods, experiment = (LEARNED,), SLIDING_ONLY
    for what, count in (("mass sets", mass_sets), ("seeds", seeds)):
        if count < 1:
            raise GridPushError(f"{what}: {count}; expected at least 1")
    if not 0 < friction[0] <= friction[1] < np.inf:
        raise GridPushError(
            f"friction: {friction[0]:g} to {friction[1]:g}; expected 0 < least <= greatest"
        )
    if not max_arm > 0:
        raise GridPushError(f"max arm: {max_arm:g} m; expected more than 0")
    if quick:
        mass_sets, seeds = min(mass_sets, QUICK_MASS_SETS), min(seeds, QUICK_SEEDS)
    sliding, exploring = experiment != EXPLORING_ONLY, experiment in (ALL, EXPLORING_ONLY)
    methods = {MATERIALS: tuple(TOLD), BOUNDS: (DRAWN, *KNOWN)}.get(experiment, methods)
    jobs = [
        Job(
            name,
            mass_set,
            seed + i,
            method,
            depth,
            mask if name == MASK_OBJECT else None,
            friction,
            truth,
            max_arm,
        )
        for mass_set in range(mass_sets)
        for i in range(seeds)
        for name in objects
        for truth in truths or (None,)
        for method in (*(methods if sliding else ()), *(EXPLORING if exploring and i == 0 else ()))
    ]
    done = run_jobs(
        run_job,
        jobs,
        lambda job: f"{job.name}, mass set {job.mass_set}, {job.truth or job.method}",
        execution,
    )
    if experiment == BOUNDS:
        return [
            tabulate_bounds([score for score in done if isinstance(score, BoundsScore)], friction)
        ]
    slides = [score for score in done if isinstance(score, SlideScore)]
    pokes = [score for score in done if isinstance(score, ExplorationScore)]
    tables = []
    if truths is not None:
        notes = f"The same bodies under each truth; frictions of {friction[0]:g} to {friction[1]:g}, as is told."
        tables += [
            tabulate_shares(slides, "truth", truths, (notes,)),
            tabulate_objects(slides, objects, truths[0]),
        ]
    elif experiment == MATERIALS:
        notes = f"One part's friction is {RUBBER:g}, the others' {STEEL:g}; other bounds than the first do not hold."
        tables += [
            tabulate_shares(slides, "told", methods, (notes,)),
            tabulate_objects(slides, objects, methods[0]),
        ]
    elif sliding:
        tables += [tabulate_slides(slides, methods), tabulate_objects(slides, objects, methods[0])]
    if exploring:
        tables += [tabulate_exploration(pokes), tabulate_exploration_by_object(pokes, objects)]
    return tables


def run_job(job: Job) -> SlideScore | ExplorationScore | BoundsScore:
    """Runs one job."""
    friction_range = {WIDE: WIDE_FRICTION_RANGE, **TOLD, **KNOWN}.get(job.method, job.friction)
    obj, parts = _load(job.name, job.depth, friction_range, job.mask)
    truth = make_truth(obj, job.mass_set)
    max_arm = max(job.max_arm, MAX_ARMS.get(job.name, 0.0))
    if job.method in (*TOLD, *KNOWN):
        truth = replace(truth, friction=draw_materials(obj, job.mass_set))
    if job.method in (DRAWN, *KNOWN):
        return judge_bounds(obj, truth, parts, make_table(0), max_arm, job.method)
    if job.method in EXPLORING:
        return explore(obj, truth, job.name, job.mass_set, job.seed, *EXPLORING[job.method])
    rng = np.random.default_rng([job.seed, job.mass_set])
    start = np.append(rng.uniform(-OFFSET, OFFSET, 2), rng.uniform(-np.pi, np.pi))
    surface = make_table(job.seed + job.mass_set)
    make_world: WorldMaker = EdgeWorld
    if job.truth is not None:
        # Truths are compared on one table, with everything pushed at the same height.
        surface = SupportSurface.rectangle((0.0, 0.0), RECTANGLE)
        if job.truth in KINDS:
            make_world = partial(MujocoEdgeWorld, support=job.truth)
        elif job.truth == LCP:
            obj = know_height(obj, PUSH_HEIGHTS[0])
            truth = replace(truth, push_height=PUSH_HEIGHTS[0])
        else:
            make_world = find_world(job.truth)
    world = make_world(
        obj, truth, start, surface, position_std=POSITION_STD, angle_std=ANGLE_STD, seed=rng
    )
    hidden = world.truth.params
    if job.truth in KINDS and hidden is not None:
        # MuJoCo's body stands where it can, and is pushed at a height that is known only then.
        obj = know_height(obj, hidden.push_height)
    known = PreGraspOptions().min_pokes
    min_pokes = {TRUE: 0, UNIFORM: 0, UNBOUNDED: PAPER_PUSHES}.get(job.method, known)
    options = PreGraspOptions(min_pokes=min_pokes, max_arm=max_arm)
    planner = PreGraspPlanner(obj, surface, options, parts)
    return SlideScore(job.name, job.truth or job.method, _run(world, planner, job.method))


def _run(world: PushWorld, planner: PreGraspPlanner, method: str) -> Outcome:
    """Runs the task by a method of METHODS or TOLD."""
    if method in (LEARNED, WIDE, *TOLD):
        return run_pregrasp(world, planner)
    if method == UNBOUNDED:
        paper = PaperLearner(NO_BOUND, PAPER_PUSHES)
        return run_pregrasp(world, planner, paper.learn, paper.make_inference(planner.obj))
    params = CellParameters.uniform(planner.obj)
    if method == TRUE:
        hidden = world.truth.params
        assert hidden is not None
        params = hidden
    granted = UncertainModel.of_parameters(planner.obj, params)
    return run_pregrasp(world, planner, None, lambda found, log: granted)


def make_truth(obj: GridObject, mass_set: int) -> CellParameters:
    """Hidden masses and frictions, by part, the frictions within what is known of them."""
    friction_range = (obj.prior.friction_min, obj.prior.friction_max)
    truth = CellParameters.random(obj, mass_set, MASS_RANGE, friction_range)
    rng = np.random.default_rng([mass_set, 1])
    return replace(truth, contact_friction=float(rng.uniform(*CONTACT_FRICTION_RANGE)))


@lru_cache(maxsize=32)
def _load(
    name: str, depth: float, friction_range: tuple[float, float], mask: Path | None
) -> tuple[GridObject, tuple[GraspPart, ...]]:
    obj = load_bench_object(name, friction_range, mask)
    return obj, tuple(find_grasp_parts(obj, Gripper(finger_depth=depth)))


def explore(
    obj: GridObject,
    truth: CellParameters,
    name: str,
    mass_set: int,
    seed: int,
    aim: str = BOTH,
    distance: float = PokeOptions().distance,
) -> ExplorationScore:
    """Pokes an object both ways, from the same hidden truth; `distance` is the pokes', m.

    All its cells are made to rub alike: only then is the center of friction the center of mass.
    """
    alike = CellParameters(truth.mass, np.full(obj.n, obj.prior.friction), truth.contact_friction)
    long = np.linalg.svd(obj.p_BC - obj.p_BC.mean(axis=0))[2][0]
    wanted = np.eye(2) if aim == BOTH else long[None]
    options = PokeOptions(distance=distance)
    runs = [
        _poke(obj, alike, wanted, options, active, np.random.default_rng([seed, mass_set]))
        for active in (True, False)
    ]
    return ExplorationScore(name, aim, distance, *runs)


def _poke(
    obj: GridObject,
    truth: CellParameters,
    wanted: Array,
    options: PokeOptions,
    active: bool,
    rng: np.random.Generator,
) -> Trace:
    """One run; `wanted` (1 or 2, 2) are the directions in which the center is."""
    center, found = wanted @ truth.center_of_mass(obj), None
    model, pose, log = UncertainModel.of_prior(obj), np.zeros(3), list[ObservedPush]()
    std = error = chi_square = np.inf
    while len(log) < MAX_POKES and not std < WANTED_STD:
        pokes = make_pokes(model, pose, options)
        if not pokes:  # there is no new place left
            break
        if active:
            F = wanted @ make_center_functional(model)
            push = choose_poke(model, pose, pokes, F).push
        else:
            push = pokes[int(rng.integers(len(pokes)))]
        after = add_pose_noise(
            simulate(obj, truth, push, pose, regime="quasi_static").final_pose, rng
        )
        log.append(
            ObservedPush(f"poke_{len(log)}", push, pose, np.array([push.duration]), after[None])
        )
        pose = after
        seen = PushLog(tuple(log))
        found = identify(obj, seen, regime="quasi_static", start=found)
        model = UncertainModel.of_identification(found, log=seen if active else None)
        covariance = wanted @ found.identifiability.center_of_friction_covariance @ wanted.T
        off = wanted @ found.identifiability.center_of_friction - center
        std, error = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])), float(np.linalg.norm(off))
        chi_square = float(off @ np.linalg.solve(covariance, off)) / len(wanted)
    return Trace(len(log) if std < WANTED_STD else MAX_POKES + 1, error, chi_square)

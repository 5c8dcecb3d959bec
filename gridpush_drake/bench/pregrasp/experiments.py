"""`gridpush bench pregrasp`: slides to the table's edge, and what pokes are worth.

These are the experiments. Objects lie in the quasi-static LCP world with a table's edge
(`bench.pregrasp.world`), if nothing else is said:

    sliding     every object with hidden masses and frictions is explored, slid to the edge and
                grasped there: by the method, by the paper's two ablations, and with the true
                parameters (`bench.pregrasp.sliding`)
    exploring   pokes chosen by design, or at random, until the center of mass's standard deviation
                is small (`bench.pregrasp.exploring`)
    materials   the method with objects that are partly of rubber and partly of steel, told bounds
                of the friction that hold, or do not
    bounds      what such bounds allow at best (`bench.pregrasp.bounds`)

With truths, there is sliding by the method in other worlds: bodies in MuJoCo that do not obey the
model, the LCP world beside them, or a world of the reader's own.
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal

import numpy as np

from gridpush_drake.bench.data.protocol import ANGLE_STD, POSITION_STD, find_masks
from gridpush_drake.bench.pregrasp.bounds import (
    DRAWN_EXPERIMENT,
    KNOWN_EXPERIMENTS,
    KNOWN_FRICTION_BOUNDS,
    RUBBER_FRICTION,
    STEEL_FRICTION,
    BoundsScore,
    draw_materials,
    judge_bounds,
    tabulate_bounds,
)
from gridpush_drake.bench.pregrasp.exploring import (
    POKE_COMPARISONS,
    ExplorationScore,
    explore,
    tabulate_exploration,
    tabulate_exploration_by_object,
)
from gridpush_drake.bench.pregrasp.sliding import (
    LEARNED_METHOD,
    MAX_ARMS,
    MAX_START_OFFSET,
    PAPER_PUSHES,
    RECTANGLE_SIDES,
    SLIDING_METHODS,
    TRUE_METHOD,
    UNBOUNDED_METHOD,
    UNIFORM_METHOD,
    WIDE_FRICTION_METHOD,
    WIDE_FRICTION_RANGE,
    SlideScore,
    load_bench_object,
    make_table,
    make_truth,
    run_method,
    tabulate_fractions,
    tabulate_objects,
    tabulate_slides,
)
from gridpush_drake.bench.pregrasp.world import (
    PUSH_HEIGHTS,
    EdgeWorld,
    MujocoEdgeWorld,
    know_height,
)
from gridpush_drake.bench.study import (
    MASKS_OPTION,
    OBJECTS_OPTION,
    Done,
    JobKind,
    Study,
    StudyOptions,
    option,
)
from gridpush_drake.bench.truth.sets import TRUTH_KINDS
from gridpush_drake.bench.worlds.by_name import LCP_WORLD, find_world
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.model import Model
from gridpush_drake.jobs.run import check_known
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import GraspPart, find_grasp_parts
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import WorldMaker
from gridpush_drake.report.table import Table

MASK_OBJECT = "hammer"
"""The paper's own hammer, a mask among the public data."""

OBJECTS_OF_BENCH = (
    "claw_hammer",
    "combination_wrench",
    "pliers",
    "spray_bottle",
    "spring_clamp",
    "toolbox",
    "toothpaste_tube",
)
"""Shipped objects that have a graspable part."""


def find_mask(data: Path) -> Path:
    """Finds the paper's hammer in a folder. Raises GridPushError where it is not there."""
    masks = find_masks(data)
    if MASK_OBJECT not in masks:
        raise GridPushError(
            f"{data}: holds no mask of {MASK_OBJECT}; expected {MASK_OBJECT}_label.pgm"
        )
    return masks[MASK_OBJECT].resolve()


SLIDING_ONLY = "sliding"
"""Experiment in which objects are slid to the edge."""

EXPLORING_ONLY = "exploring"
"""Experiment in which pokes by design are compared with random ones."""

MATERIALS_EXPERIMENT = "materials"
"""Experiment with objects that are partly of rubber."""

BOUNDS_EXPERIMENT = "bounds"
"""Experiment that says what bounds of the friction allow at best."""

ALL_EXPERIMENTS = "all"
"""Sliding and exploring."""

EXPERIMENT_NAMES = (
    ALL_EXPERIMENTS,
    SLIDING_ONLY,
    EXPLORING_ONLY,
    MATERIALS_EXPERIMENT,
    BOUNDS_EXPERIMENT,
)
"""Experiments that can be chosen."""

TRUTH_NAMES = (LCP_WORLD, *TRUTH_KINDS)
"""Truths by name: the model's own simulator, or MuJoCo bodies by how they stand."""

MASS_SETS = 10
"""Number of hidden sets of masses and frictions of each object by default."""

DEFAULT_SEED_COUNT = 3
"""Number of tables, starts and noises of each set by default."""

QUICK_MASS_SETS = 2
"""Number of hidden sets of masses and frictions in the quick variant."""

QUICK_SEEDS = 1
"""Number of tables, starts and noises in the quick variant."""

FRICTION_RANGE = (0.3, 0.4)
"""Least and greatest friction of an object's parts, true and known to the method. As much is known
in the station, of somebody who has seen what object and table are made of
(`models/scenarios/grasp.yaml`)."""


DEFAULT_FINGER_DEPTH = Gripper.finger_depth
"""Default depth of the gripper's fingers, m: so far must a part hang over."""

MAX_ARM = 0.06
"""Default of the greatest distance of the grasp from where the center of mass is believed, m. Held
farther off, the object turns in the gripper. Anywhere at the end of a handle, no mass distribution
tips the object, and all methods do as well. So near, the object must come close to tipping; the
true masses still leave a grasp in every case."""


@dataclass(frozen=True)
class PreGraspBenchOptions(StudyOptions):
    """What is measured.

    The table takes turns with mass sets and seeds. What is known of the friction is its range, but
    for the method WIDE_FRICTION_METHOD and the materials.

    Attributes:
        data: folder of the paper's masks; None without the paper's hammer.
        objects: names of objects; all of them where None.
        mass_sets: number of hidden sets of masses and frictions of each object.
        seeds: number of tables, starts and noises of each set. Pokes are compared with the first
            one only.
        depth: depth of the gripper's fingers, m.
        experiment: one of EXPERIMENT_NAMES.
        truths: what moves the objects, of TRUTH_NAMES or MODULE:CLASS of a world. With truths there
            is only sliding, by LEARNED_METHOD, on rectangular tables, with the same objects, masses
            and starts under each. None for the LCP world on any table.
        max_arm: greatest distance of the grasp from where the center of mass is believed, m.
        friction: least and greatest friction of any part against the table.
        methods: methods that slide, of SLIDING_METHODS.
    """

    data: Path | None = option(None, **MASKS_OPTION)
    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    mass_sets: int = option(
        MASS_SETS, "Hidden sets of masses and frictions of each object.", least=1
    )
    seeds: int = option(DEFAULT_SEED_COUNT, "Tables, starts and noises of each set.", least=1)
    depth: float = option(
        DEFAULT_FINGER_DEPTH, "Depth of the gripper's fingers, which must hang over, m."
    )
    experiment: Literal["all", "sliding", "exploring", "materials", "bounds"] = option(
        ALL_EXPERIMENTS,
        "What to measure: all stands for sliding and exploring; materials are objects of rubber "
        "and steel; bounds of the friction are judged by what they allow at best.",
        metavar="EXPERIMENT",
    )
    truths: tuple[str, ...] | None = option(
        None,
        "What moves the objects, on rectangular tables: lcp, the model's own simulator, or MuJoCo "
        "bodies that stand as own_weight, half_height, foundation, vertices or three_feet, or "
        "MODULE:CLASS of a world of your own; may be repeated.",
        name="--truth",
        metavar="TRUTH",
        shown="the model's own simulator, on any table",
    )
    max_arm: float = option(
        MAX_ARM, "How far from its believed center of mass an object may be taken, m."
    )
    friction: tuple[float, float] = option(
        FRICTION_RANGE,
        "Bounds of the friction of any part against the table, true and known.",
        metavar="LEAST GREATEST",
    )
    methods: tuple[str, ...] = SLIDING_METHODS

    @property
    def mask(self) -> Path | None:
        """The file of the paper's hammer; None without data."""
        return None if self.data is None else find_mask(self.data)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the objects."""
        known = OBJECTS_OF_BENCH if self.data is None else (*OBJECTS_OF_BENCH, MASK_OBJECT)
        return known if self.objects is None else self.objects

    @property
    def kind(self) -> str:
        """The experiment: with truths, there is only sliding."""
        return self.experiment if self.truths is None else SLIDING_ONLY

    @property
    def sliding(self) -> tuple[str, ...]:
        """The methods of the runs that are not comparisons of pokes."""
        if self.truths is not None:
            return (LEARNED_METHOD,)
        if self.experiment == EXPLORING_ONLY:
            return ()
        special = {
            MATERIALS_EXPERIMENT: tuple(KNOWN_FRICTION_BOUNDS),
            BOUNDS_EXPERIMENT: (DRAWN_EXPERIMENT, *KNOWN_EXPERIMENTS),
        }
        return special.get(self.experiment, self.methods)

    @property
    def exploring(self) -> tuple[str, ...]:
        """The names of the comparisons of pokes."""
        return tuple(POKE_COMPARISONS) if self.kind in (ALL_EXPERIMENTS, EXPLORING_ONLY) else ()


@dataclass(frozen=True)
class PreGraspJob:
    """One object with one mass set and seed.

    Attributes:
        name: name of the object.
        mass_set: number of its hidden set of masses and frictions.
        seed: seed of table, start and noise.
        method: one of SLIDING_METHODS, POKE_COMPARISONS or KNOWN_FRICTION_BOUNDS, or bounds that
            are judged.
        depth: depth of the gripper's fingers, m.
        mask: file of the paper's object; None for a shipped one.
        friction: least and greatest true friction, which is known, but to KNOWN_FRICTION_BOUNDS.
        truth: one of TRUTH_NAMES, or MODULE:CLASS of a world, on a rectangular table; None for the
            LCP world, pushed at the table's height, on any table.
        max_arm: greatest distance of the grasp from where the center of mass is believed, m.
    """

    name: str
    mass_set: int
    seed: int
    method: str
    depth: float = DEFAULT_FINGER_DEPTH
    mask: Path | None = None
    friction: tuple[float, float] = FRICTION_RANGE
    truth: str | None = None
    max_arm: float = MAX_ARM


def shorten(options: PreGraspBenchOptions) -> PreGraspBenchOptions:
    """Makes the options of the quick variant."""
    return replace(
        options,
        mass_sets=min(options.mass_sets, QUICK_MASS_SETS),
        seeds=min(options.seeds, QUICK_SEEDS),
    )


def make_jobs(options: PreGraspBenchOptions) -> list[PreGraspJob]:
    """Makes the jobs of each mass set, seed, object, truth and method.

    Raises:
        GridPushError: the data are not there, a name is not known, or a number is out of range.
    """
    mask = options.mask
    _check(options)
    return [
        PreGraspJob(
            name=name,
            mass_set=mass_set,
            seed=options.seed + i,
            method=method,
            depth=options.depth,
            mask=mask if name == MASK_OBJECT else None,
            friction=options.friction,
            truth=truth,
            max_arm=options.max_arm,
        )
        for mass_set in range(options.mass_sets)
        for i in range(options.seeds)
        for name in options.names
        for truth in options.truths or (None,)
        for method in (*options.sliding, *(options.exploring if i == 0 else ()))
    ]


def _check(options: PreGraspBenchOptions) -> None:
    """Raises GridPushError where an option is out of range."""
    known = OBJECTS_OF_BENCH if options.data is None else (*OBJECTS_OF_BENCH, MASK_OBJECT)
    check_known("objects", options.names, known)
    check_known("methods", options.methods, SLIDING_METHODS)
    check_known("experiment", [options.experiment], EXPERIMENT_NAMES)
    if options.truths is not None:
        own = [truth for truth in options.truths if ":" in truth]
        check_known("truths", options.truths, (*TRUTH_NAMES, *own))
        for truth in own:
            find_world(truth)
    for what, count in (("mass sets", options.mass_sets), ("seeds", options.seeds)):
        if count < 1:
            raise GridPushError(f"{what}: {count}; expected at least 1")
    least, greatest = options.friction
    if not 0 < least <= greatest < np.inf:
        raise GridPushError(f"friction: {least:g} to {greatest:g}; expected 0 < least <= greatest")
    if not options.max_arm > 0:
        raise GridPushError(f"max arm: {options.max_arm:g} m; expected more than 0")


def tabulate(options: PreGraspBenchOptions, done: Done) -> list[Table]:
    """Tabulates what bounds allow; or slides by method, truth or bounds told, and pokes.

    Slides are also tabulated by object, those of the first method, truth or bounds. Pokes are
    tabulated by their length and by object.
    """
    results = done.of(PREGRASP_JOBS)
    least, greatest = options.friction
    if options.kind == BOUNDS_EXPERIMENT:
        bounds = [score for score in results if isinstance(score, BoundsScore)]
        return [tabulate_bounds(bounds, options.friction)]
    slides = [score for score in results if isinstance(score, SlideScore)]
    pokes = [score for score in results if isinstance(score, ExplorationScore)]
    tables = []
    if options.truths is not None:
        note = (
            f"The same bodies under each truth; frictions of {least:g} to {greatest:g}, as is told."
        )
        tables.append(tabulate_fractions(slides, "truth", options.truths, (note,)))
        tables.append(tabulate_objects(slides, options.names, options.truths[0]))
    elif options.kind == MATERIALS_EXPERIMENT:
        note = (
            f"One part's friction is {RUBBER_FRICTION:g}, the others' {STEEL_FRICTION:g}; other "
            "bounds than the "
            "first do not hold."
        )
        tables.append(tabulate_fractions(slides, "told", options.sliding, (note,)))
        tables.append(tabulate_objects(slides, options.names, options.sliding[0]))
    elif options.sliding:
        tables.append(tabulate_slides(slides, options.sliding))
        tables.append(tabulate_objects(slides, options.names, options.sliding[0]))
    if options.exploring:
        tables.append(tabulate_exploration(pokes))
        tables.append(tabulate_exploration_by_object(pokes, options.names))
    return tables


def run_job(job: PreGraspJob) -> SlideScore | ExplorationScore | BoundsScore:
    """Runs one job, of whichever experiment it is."""
    friction_range = {
        WIDE_FRICTION_METHOD: WIDE_FRICTION_RANGE,
        **KNOWN_FRICTION_BOUNDS,
        **KNOWN_EXPERIMENTS,
    }.get(job.method, job.friction)
    obj, parts = _load(job.name, job.depth, friction_range, job.mask)
    truth = make_truth(obj, job.mass_set)
    max_arm = max(job.max_arm, MAX_ARMS.get(job.name, 0.0))
    if job.method in (*KNOWN_FRICTION_BOUNDS, *KNOWN_EXPERIMENTS):
        truth = replace(truth, friction=draw_materials(obj, job.mass_set))
    if job.method in (DRAWN_EXPERIMENT, *KNOWN_EXPERIMENTS):
        return judge_bounds(obj, truth, parts, make_table(0), max_arm, job.method)
    if job.method in POKE_COMPARISONS:
        return explore(obj, truth, job.name, job.mass_set, job.seed, *POKE_COMPARISONS[job.method])
    return _slide(job, obj, truth, parts, max_arm)


def _slide(
    job: PreGraspJob,
    obj: GridObject,
    truth: CellParameters,
    parts: tuple[GraspPart, ...],
    max_arm: float,
) -> SlideScore:
    """Slides one object to the edge, from a random start.

    Args:
        job: which object, table, world and method.
        obj: the object, with what is known of its frictions.
        truth: its hidden masses and frictions.
        parts: its graspable parts.
        max_arm: greatest distance of the grasp from where the center of mass is believed, m.
    """
    rng = np.random.default_rng([job.seed, job.mass_set])
    start = np.append(
        rng.uniform(-MAX_START_OFFSET, MAX_START_OFFSET, 2), rng.uniform(-np.pi, np.pi)
    )
    surface = make_table(job.seed + job.mass_set)
    make_world: WorldMaker = EdgeWorld
    if job.truth is not None:
        # Truths are compared on one table, with everything pushed at the same height.
        surface = SupportSurface.rectangle((0.0, 0.0), RECTANGLE_SIDES)
        if job.truth in TRUTH_KINDS:
            make_world = partial(MujocoEdgeWorld, support=job.truth)
        elif job.truth == LCP_WORLD:
            obj = know_height(obj, PUSH_HEIGHTS[0])
            truth = replace(truth, push_height=PUSH_HEIGHTS[0])
        else:
            make_world = find_world(job.truth)
    # Object and world are made; the truth of MuJoCo's bodies is known only now.
    world = make_world(
        Model(obj, truth), start, surface, position_std=POSITION_STD, angle_std=ANGLE_STD, seed=rng
    )
    hidden = world.truth.bodies
    if job.truth in TRUTH_KINDS and hidden is not None:
        # MuJoCo's body stands where it can, and is pushed at a height that is known only then.
        obj = know_height(obj, hidden.params.push_height)

    # Methods that learn nothing need no pokes.
    known = PreGraspOptions().min_pokes
    min_pokes = {TRUE_METHOD: 0, UNIFORM_METHOD: 0, UNBOUNDED_METHOD: PAPER_PUSHES}.get(
        job.method, known
    )
    options = PreGraspOptions(min_pokes=min_pokes, max_arm=max_arm)
    planner = PreGraspPlanner(obj, surface, options, parts)
    return SlideScore(job.name, job.truth or job.method, run_method(world, planner, job.method))


@lru_cache(maxsize=32)
def _load(
    name: str, depth: float, friction_range: tuple[float, float], mask: Path | None
) -> tuple[GridObject, tuple[GraspPart, ...]]:
    obj = load_bench_object(name, friction_range, mask)
    return obj, tuple(find_grasp_parts(obj, Gripper(finger_depth=depth)))


PREGRASP_JOBS = JobKind(
    job=PreGraspJob,
    run=run_job,
    describe=lambda job: f"{job.name}, mass set {job.mass_set}, {job.truth or job.method}",
)
"""What is done with a job."""

STUDY = Study(
    name="pregrasp",
    help="Slide objects of hidden masses to the table's edge, and compare pokes by design with "
    "random ones.",
    options=PreGraspBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(PREGRASP_JOBS,),
    tabulate=tabulate,
)
"""`gridpush bench pregrasp`."""

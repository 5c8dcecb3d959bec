"""`gridpush bench pregrasp`: slides to the table's edge, and what pokes are worth.

These are the experiments. Objects lie in the quasi-static LCP world with a table's edge
(`bench.pregrasp.world`), if nothing else is said:

    sliding     every object with hidden masses and frictions is explored, slid to the edge and
                grasped there: by the method, by the paper's two ablations, and with the true
                parameters
    exploring   pokes chosen by design, or at random, until the center of mass's standard deviation
                is small
    materials   the method with objects that are partly of rubber and partly of steel, told bounds
                of the friction that hold, or do not
    bounds      what such bounds allow at best (`bench.pregrasp.bounds`)

With truths, there is sliding by the method in other worlds: bodies in MuJoCo that do not obey the
model, the LCP world beside them, or a world of the reader's own.

When pokes are compared, the center of mass is wanted in both directions or, as for a goal at the
table's edge, across one line: here along the object's longest direction. Both ways choose from the
same pokes, all of one length. A long poke tells more, whichever it is, and two or three of them are
needed in any case: so the shorter the pokes, the more there is to gain by design.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal

import numpy as np

from gridpush_drake.bench.jobs import check_known
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
from gridpush_drake.bench.study import MASKS, OBJECTS, Done, Study, StudyOptions, Task, option
from gridpush_drake.bench.table import MM, PERCENT, Column, Table, calc_mean, count_of, mean_of
from gridpush_drake.bench.truth.sets import KINDS
from gridpush_drake.bench.worlds import LCP, find_world
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array, make_direction
from gridpush_drake.identification.learning import identify
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.exploration import (
    PokeOptions,
    choose_poke,
    make_center_functional,
    make_pokes,
)
from gridpush_drake.planning.pregrasp.grasp_parts import GraspPart, find_grasp_parts
from gridpush_drake.planning.pregrasp.gripper import Gripper
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import PushWorld, SimulatedWorld, WorldMaker
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

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

RECTANGLE = (0.9, 0.7)
"""Sides of the rectangular table, m."""

RADIUS = 0.45
"""Radius of the round table, m."""

HEXAGON = 0.5
"""Distance of the hexagonal table's corners from its middle, m."""


def find_mask(data: Path) -> Path:
    """Finds the paper's hammer in a folder. Raises GridPushError where it is not there."""
    masks = find_masks(data)
    if MASK_OBJECT not in masks:
        raise GridPushError(
            f"{data}: holds no mask of {MASK_OBJECT}; expected {MASK_OBJECT}_label.pgm"
        )
    return masks[MASK_OBJECT].resolve()


def load_bench_object(
    name: str, friction_range: tuple[float, float], mask: Path | None = None
) -> GridObject:
    """Loads an object, of which is known between which bounds its frictions are.

    Args:
        name: name of a shipped object, or what to call the one of the mask.
        friction_range: the bounds.
        mask: file of a mask; None for a shipped object.

    Raises:
        ObjectError: there is no such object.
    """
    if mask is not None:
        obj = GridObject.from_mask(mask, meters_per_pixel=PLANNING_METERS_PER_PIXEL, name=name)
    else:
        obj = GridObject.from_yaml(find_shipped_object(name))
    return know_friction(obj, *friction_range)


def make_table(seed: int) -> SupportSurface:
    """Makes a rectangular, a round or a hexagonal table about the world's origin, in turn."""
    kind = seed % 3
    if kind == 0:
        return SupportSurface.rectangle((0.0, 0.0), RECTANGLE)
    if kind == 1:
        return SupportSurface.round((0.0, 0.0), RADIUS)
    return SupportSurface.from_polygon(HEXAGON * make_direction(np.pi / 3 * np.arange(6)))


WANTED_STD = 0.005
"""Standard deviation of the center of mass that pokes are to reach, m: in the direction that is
wanted or, of both, in the one least known."""

BOTH = "both directions"
"""Aim at the center of mass in both directions."""

ALONG = "along the object"
"""Aim at the center of mass along the object's longest direction."""

AIMS = (BOTH, ALONG)
"""What of the center of mass is wanted."""

DISTANCES = (0.02, 0.04, 0.08)
"""Lengths of the pokes, m."""

MAX_POKES = 20
"""Number of pokes after which one gives up; it then counts as one more."""

LIKELY = {BOTH: 5.991 / 2, ALONG: 3.841}
"""Values per direction that 95 % of chi squares stay below: of two degrees of freedom, and of
one."""


@dataclass(frozen=True)
class SlideScore:
    """How one run with an object ended.

    Attributes:
        name: name of the object.
        method: the method or, where truths are compared, the truth.
        outcome: how the run ended.
    """

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
    """Tabulates successes, drops and refusals by method."""
    groups = [
        ((method,), [score.outcome for score in scores if score.method == method])
        for method in methods
    ]
    notes = (
        "graspable: a part hangs over the edge far enough, and the object is at rest.",
        "dropped: it fell off the table on the way. given up: no safe way was found, and it is "
        "still on the table.",
        "learned: stability for all masses that agree with the pushes; true: hidden parameters "
        "known; uniform: uniform mass, nothing learned; unbounded: the paper's identification, "
        "friction without a bound.",
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
    """Tabulates successes and drops with their intervals.

    Args:
        scores: how the runs ended.
        by: what the rows are of: truths, or bounds that were told.
        keys: the rows' names, which the scores have as their methods.
        notes: notes of the table before those on its columns.
    """
    groups = [((key,), [score.outcome for score in scores if score.method == key]) for key in keys]
    notes = (
        *notes,
        "reached: a part hangs over the edge far enough, and the object is at rest; dropped: it "
        "fell, or tilts by 10°; in brackets 95 % Wilson intervals. The other runs were given up, "
        "the object on the table.",
        "to spare: stability margin at the worst where it was reached.",
    )
    return Table.of(f"Pre-grasp sliding by {by}", (by,), groups, SHARE_COLUMNS, notes)


def tabulate_objects(scores: Sequence[SlideScore], objects: Sequence[str], method: str) -> Table:
    """Tabulates one method's runs by object."""
    groups = [
        ((name,), [s.outcome for s in scores if (s.method, s.name) == (method, name)])
        for name in objects
    ]
    return Table.of(f"Pre-grasp sliding by object, {method}", ("object",), groups, SLIDE_COLUMNS)


@dataclass(frozen=True)
class Trace:
    """One run of pokes.

    Attributes:
        pokes: number of pokes until the standard deviation was small; MAX_POKES + 1 where it never
            was.
        error: error of the final estimate of what is wanted, m.
        chi_square: its square in units of the estimate's covariance, for each direction wanted; 1
            on average where the covariance is right.
    """

    pokes: int
    error: float
    chi_square: float


@dataclass(frozen=True)
class ExplorationScore:
    """Pokes by design and at random, with one object and one mass set.

    Attributes:
        name: name of the object.
        aim: what of the center of mass is wanted, one of AIMS.
        distance: length of the pokes, m.
        active: the run of pokes by design.
        random: the run of pokes at random.
    """

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
    """Tabulates the pokes needed, by their length, and whether the stated spread is right."""
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
        "by design, at random: mean number of pokes; the poke said to tell most, or any of the "
        "same pool.",
        "wanted: of the center of mass; in both directions the least known one counts.",
        "error: mean distance of the final estimate from the true center.",
        "within 95 %: runs of either kind whose true center is within the 95 % range that the "
        "estimate states.",
    )
    return Table.of(title, ("wanted", "poke, mm"), groups, EXPLORE_COLUMNS, notes)


def tabulate_exploration_by_object(
    scores: Sequence[ExplorationScore], objects: Sequence[str]
) -> Table:
    """Tabulates the pokes needed by object, over all lengths."""
    groups = [
        ((aim, name), [score for score in scores if (score.aim, score.name) == (aim, name)])
        for aim in AIMS
        for name in objects
    ]
    return Table.of(
        "The same by object, pokes of all lengths", ("wanted", "object"), groups, EXPLORE_COLUMNS
    )


LEARNED = "learned"
"""Name of the method."""

WIDE = "learned, wide friction"
"""Name of the method where less is known of the friction."""

TRUE = "true"
"""Name of the method that knows the true parameters."""

UNIFORM = "uniform"
"""Name of the method that believes in a uniform mass."""

UNBOUNDED = "unbounded"
"""Name of the paper's identification without a bound on the friction."""

METHODS = (LEARNED, WIDE, TRUE, UNIFORM, UNBOUNDED)
"""Methods that slide objects to the edge."""

EXPLORING = {
    f"exploring, {aim}, {1e3 * distance:.0f} mm": (aim, distance)
    for distance in DISTANCES
    for aim in AIMS
}
"""Comparisons of pokes by their names, with what is wanted of the center of mass, and the pokes'
length, m."""

SLIDING_ONLY = "sliding"
"""Experiment in which objects are slid to the edge."""

EXPLORING_ONLY = "exploring"
"""Experiment in which pokes by design are compared with random ones."""

MATERIALS = "materials"
"""Experiment with objects that are partly of rubber."""

BOUNDS = "bounds"
"""Experiment that says what bounds of the friction allow at best."""

ALL = "all"
"""Sliding and exploring."""

EXPERIMENTS = (ALL, SLIDING_ONLY, EXPLORING_ONLY, MATERIALS, BOUNDS)
"""Experiments that can be chosen."""

TRUTHS = (LCP, *KINDS)
"""Truths by name: the model's own simulator, or MuJoCo bodies by how they stand."""

MASS_SETS = 10
"""Number of hidden sets of masses and frictions of each object by default."""

SEEDS = 3
"""Number of tables, starts and noises of each set by default."""

QUICK_MASS_SETS = 2
"""Number of hidden sets of masses and frictions in the quick variant."""

QUICK_SEEDS = 1
"""Number of tables, starts and noises in the quick variant."""

FRICTION_RANGE = (0.3, 0.4)
"""Least and greatest friction of an object's parts, true and known to the method. As much is known
in the station, of somebody who has seen what object and table are made of
(`models/scenarios/grasp.yaml`)."""

WIDE_FRICTION_RANGE = (0.25, 0.5)
"""Least and greatest friction of an object's parts where hardly anything is known of them."""

CONTACT_FRICTION_RANGE = (0.35, 0.65)
"""Least and greatest friction of the finger on the object."""

NO_BOUND = (0.01, 10.0)
"""Least and greatest friction that the unbounded ablation may believe in."""

DEPTH = Gripper.finger_depth
"""Default depth of the gripper's fingers, m: so far must a part hang over."""

MAX_ARM = 0.06
"""Default of the greatest distance of the grasp from where the center of mass is believed, m. Held
farther off, the object turns in the gripper. Anywhere at the end of a handle, no mass distribution
tips the object, and all methods do as well. So near, the object must come close to tipping; the
true masses still leave a grasp in every case."""

MAX_ARMS = {"toolbox": 0.15}
"""Greatest distance of the grasp from where the center of mass is believed, m, of objects that
offer nothing to hold so near to their middle. This one can be taken by its edge only."""

OFFSET = 0.05
"""Greatest distance of the object from the table's middle at the beginning, along each axis, m."""

PAPER_PUSHES = 4
"""Number of pokes that the unbounded ablation learns from before it slides; the method decides that
itself."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """What is measured.

    The table takes turns with mass sets and seeds. What is known of the friction is its range, but
    for the method WIDE and the materials.

    Attributes:
        data: folder of the paper's masks; None without the paper's hammer.
        objects: names of objects; all of them where None.
        mass_sets: number of hidden sets of masses and frictions of each object.
        seeds: number of tables, starts and noises of each set. Pokes are compared with the first
            one only.
        depth: depth of the gripper's fingers, m.
        experiment: one of EXPERIMENTS.
        truths: what moves the objects, of TRUTHS or MODULE:CLASS of a world. With truths there is
            only sliding, by LEARNED, on rectangular tables, with the same objects, masses and
            starts under each. None for the LCP world on any table.
        max_arm: greatest distance of the grasp from where the center of mass is believed, m.
        friction: least and greatest friction of any part against the table.
        methods: methods that slide, of METHODS.
    """

    data: Path | None = option(None, **MASKS)
    objects: tuple[str, ...] | None = option(None, **OBJECTS)
    mass_sets: int = option(
        MASS_SETS, "Hidden sets of masses and frictions of each object.", least=1
    )
    seeds: int = option(SEEDS, "Tables, starts and noises of each set.", least=1)
    depth: float = option(DEPTH, "Depth of the gripper's fingers, which must hang over, m.")
    experiment: Literal["all", "sliding", "exploring", "materials", "bounds"] = option(
        ALL,
        "What to measure: all stands for sliding and exploring; materials are objects of rubber "
        "and steel; bounds of the friction are judged by what they allow at best.",
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
    methods: tuple[str, ...] = METHODS

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
            return (LEARNED,)
        if self.experiment == EXPLORING_ONLY:
            return ()
        special = {MATERIALS: tuple(TOLD), BOUNDS: (DRAWN, *KNOWN)}
        return special.get(self.experiment, self.methods)

    @property
    def exploring(self) -> tuple[str, ...]:
        """The names of the comparisons of pokes."""
        return tuple(EXPLORING) if self.kind in (ALL, EXPLORING_ONLY) else ()


@dataclass(frozen=True)
class Job:
    """One object with one mass set and seed.

    Attributes:
        name: name of the object.
        mass_set: number of its hidden set of masses and frictions.
        seed: seed of table, start and noise.
        method: one of METHODS, EXPLORING or TOLD, or bounds that are judged.
        depth: depth of the gripper's fingers, m.
        mask: file of the paper's object; None for a shipped one.
        friction: least and greatest true friction, which is known, but to TOLD.
        truth: one of TRUTHS, or MODULE:CLASS of a world, on a rectangular table; None for the LCP
            world, pushed at the table's height, on any table.
        max_arm: greatest distance of the grasp from where the center of mass is believed, m.
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


def shorten(options: Options) -> Options:
    """Makes the options of the quick variant."""
    return replace(
        options,
        mass_sets=min(options.mass_sets, QUICK_MASS_SETS),
        seeds=min(options.seeds, QUICK_SEEDS),
    )


def make_jobs(options: Options) -> list[Job]:
    """Makes the jobs of each mass set, seed, object, truth and method.

    Raises:
        GridPushError: the data are not there, a name is not known, or a number is out of range.
    """
    mask = options.mask
    _check(options)
    return [
        Job(
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


def _check(options: Options) -> None:
    """Raises GridPushError where an option is out of range."""
    known = OBJECTS_OF_BENCH if options.data is None else (*OBJECTS_OF_BENCH, MASK_OBJECT)
    check_known("objects", options.names, known)
    check_known("methods", options.methods, METHODS)
    check_known("experiment", [options.experiment], EXPERIMENTS)
    if options.truths is not None:
        own = [truth for truth in options.truths if ":" in truth]
        check_known("truths", options.truths, (*TRUTHS, *own))
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


def tabulate(options: Options, done: Done) -> list[Table]:
    """Tabulates what bounds allow; or slides by method, truth or bounds told, and pokes.

    Slides are also tabulated by object, those of the first method, truth or bounds. Pokes are
    tabulated by their length and by object.
    """
    results = done.of(TASK)
    least, greatest = options.friction
    if options.kind == BOUNDS:
        bounds = [score for score in results if isinstance(score, BoundsScore)]
        return [tabulate_bounds(bounds, options.friction)]
    slides = [score for score in results if isinstance(score, SlideScore)]
    pokes = [score for score in results if isinstance(score, ExplorationScore)]
    tables = []
    if options.truths is not None:
        note = (
            f"The same bodies under each truth; frictions of {least:g} to {greatest:g}, as is told."
        )
        tables.append(tabulate_shares(slides, "truth", options.truths, (note,)))
        tables.append(tabulate_objects(slides, options.names, options.truths[0]))
    elif options.kind == MATERIALS:
        note = (
            f"One part's friction is {RUBBER:g}, the others' {STEEL:g}; other bounds than the "
            "first do not hold."
        )
        tables.append(tabulate_shares(slides, "told", options.sliding, (note,)))
        tables.append(tabulate_objects(slides, options.names, options.sliding[0]))
    elif options.sliding:
        tables.append(tabulate_slides(slides, options.sliding))
        tables.append(tabulate_objects(slides, options.names, options.sliding[0]))
    if options.exploring:
        tables.append(tabulate_exploration(pokes))
        tables.append(tabulate_exploration_by_object(pokes, options.names))
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
    """Draws hidden masses and frictions by part, the frictions within what is known of them."""
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
    """Pokes an object by design and at random, from the same hidden truth.

    All its cells are made to rub alike: only then is the center of friction the center of mass.

    Args:
        obj: the object.
        truth: its true masses.
        name: name of the object.
        mass_set: number of the hidden set of masses, which seeds the noise too.
        seed: seed of the noise.
        aim: what of the center of mass is wanted, one of AIMS.
        distance: length of the pokes, m.
    """
    alike = CellParameters(truth.mass, np.full(obj.n, obj.prior.friction), truth.contact_friction)
    long = np.linalg.svd(obj.p_BC - obj.p_BC.mean(axis=0))[2][0]
    wanted = np.eye(2) if aim == BOTH else long[None]
    options = PokeOptions(distance=distance)
    runs = [
        _poke(obj, alike, wanted, options, active, np.random.default_rng([seed, mass_set]))
        for active in (True, False)
    ]
    return ExplorationScore(name=name, aim=aim, distance=distance, active=runs[0], random=runs[1])


def _poke(
    obj: GridObject,
    truth: CellParameters,
    wanted: Array,
    options: PokeOptions,
    active: bool,
    rng: np.random.Generator,
) -> Trace:
    """Makes one run.

    Args:
        obj: the object.
        truth: its true masses and frictions.
        wanted: (1, 2) or (2, 2) the directions in which the center of mass is wanted.
        options: what pokes may be chosen from.
        active: whether pokes are chosen by design.
        rng: draws the noise and, at random, the pokes.
    """
    center = wanted @ truth.center_of_mass(obj)
    found = None
    model = UncertainModel.of_prior(obj)
    pose = np.zeros(3)
    world = SimulatedWorld(obj, truth, pose)
    log = list[ObservedPush]()
    std = np.inf
    error = np.inf
    chi_square = np.inf
    while len(log) < MAX_POKES and not std < WANTED_STD:
        pokes = make_pokes(model, pose, options)
        if not pokes:
            break  # there is no new place left
        if active:
            F = wanted @ make_center_functional(model)
            push = choose_poke(model, pose, pokes, F).push
        else:
            push = pokes[int(rng.integers(len(pokes)))]
        # The object is pushed from where it was seen: what is compared are the choices alone.
        world.put(pose)
        after = add_pose_noise(world.execute(push).final_pose, rng)
        log.append(
            ObservedPush(f"poke_{len(log)}", push, pose, np.array([push.duration]), after[None])
        )
        pose = after

        # What was learned, and how far off it is.
        seen = PushLog(tuple(log))
        found = identify(obj, seen, regime="quasi_static", start=found)
        model = UncertainModel.of_identification(found, log=seen if active else None)
        covariance = wanted @ found.identifiability.center_of_friction_covariance @ wanted.T
        off = wanted @ found.identifiability.center_of_friction - center
        std = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        error = float(np.linalg.norm(off))
        chi_square = float(off @ np.linalg.solve(covariance, off)) / len(wanted)
    pokes_needed = len(log) if std < WANTED_STD else MAX_POKES + 1
    return Trace(pokes=pokes_needed, error=error, chi_square=chi_square)


TASK = Task(
    job=Job,
    run=run_job,
    describe=lambda job: f"{job.name}, mass set {job.mass_set}, {job.truth or job.method}",
)
"""What is done with a job."""

STUDY = Study(
    name="pregrasp",
    help="Slide objects of hidden masses to the table's edge, and compare pokes by design with "
    "random ones.",
    options=Options,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(TASK,),
    tabulate=tabulate,
)
"""`gridpush bench pregrasp`."""

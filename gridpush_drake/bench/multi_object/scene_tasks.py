"""`gridpush bench scene-tasks`: tasks with several objects, in the plain world.

Shipped objects of hidden masses and frictions lie on a table, moved by the scene model with their
true parameters; poses are seen with noise.

    rearrange   1 to 4 objects at random poses are pushed to random goal poses, within 2 cm and
                0.2 rad, and within 5 mm and 3°
    separate    3 to 6 objects in a heap are pushed apart until each has 3 cm around it
    fetch       the wanted one of 2 to 4 objects in a heap is brought to the table's edge, so far
                that it can be grasped

What counts is where the objects truly lie at the end, and whether any fell.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import thread_time
from typing import TYPE_CHECKING

import numpy as np

from gridpush_drake.bench.study import Done, JobKind, Study, StudyOptions, option
from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.loop_run import LoopRun, run_loop
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.goals import calc_overhangs
from gridpush_drake.planning.scene.fetching import FetchLearning, FetchOptions, FetchPlanner
from gridpush_drake.planning.scene.joint_loop import STILL_WORLD, JointLoop, JointState
from gridpush_drake.planning.scene.loop import (
    SceneAction,
    SceneLearner,
    SceneLearning,
    ScenePlanner,
)
from gridpush_drake.planning.scene.random_scenes import FRICTION_RANGE, heap_up, hide, scatter
from gridpush_drake.planning.scene.rearrangement import (
    FINE_OPTIONS,
    RearrangeOptions,
    RearrangePlanner,
)
from gridpush_drake.planning.scene.rules import SceneRules
from gridpush_drake.planning.scene.separation import (
    WANTED_CLEARANCE,
    SeparatePlanner,
    calc_clearances,
)
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.report.table import (
    Mean,
    Proportion,
    Table,
    calc_interval,
    check_figure,
    write_panels,
)
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REARRANGE_PART = "rearrange"
FINE_REARRANGE_PART = "rearrange, 5 mm"
SEPARATE_PART = "separate"
FETCH_PART = "fetch"
PART_NAMES = (REARRANGE_PART, SEPARATE_PART, FETCH_PART)
"""Names of what is done; `FINE_REARRANGE_PART` belongs to `REARRANGE_PART`."""

OBJECT_COUNTS = {
    REARRANGE_PART: (1, 2, 3, 4),
    FINE_REARRANGE_PART: (1, 2, 3, 4),
    SEPARATE_PART: (3, 4, 5, 6),
    FETCH_PART: (2, 3, 4),
}
"""Numbers of objects of each task."""

EPISODE_OBJECTS = (
    "claw_hammer",
    "snack_bag",
    "toolbox",
    "toothpaste_tube",
    "combination_wrench",
    "pliers",
)
"""Shipped objects, of which some are drawn for each episode."""

FETCHED_OBJECTS = ("claw_hammer", "combination_wrench", "spray_bottle", "toothpaste_tube")
"""Shipped objects, one of which is fetched from among the others."""

EPISODE_COUNT = 20
"""Number of episodes of each task and number of objects."""

TABLE_SIDE = 1.2
"""Side of the table, m."""

POSITION_STD = 0.0005
"""Standard deviation of seen positions, per axis, m."""

ANGLE_STD = 0.003
"""Standard deviation of seen angles, rad."""

START_GAP = 0.01
"""Least distance of two objects at the beginning of rearranging, m."""

END_GAP = 0.02
"""Least distance of two goals, m."""

MAX_ARM = 0.1
"""Farthest that an object is grasped from its estimated center of mass, m."""

MAX_PUSHES = {REARRANGE_PART: 60, FINE_REARRANGE_PART: 80, SEPARATE_PART: 30, FETCH_PART: 60}
"""Number of pushes after which each task is given up."""

GOAL_TOLERANCE_FACTOR = 1.25
"""What was seen at a goal counts as there if it truly is within so many tolerances: it is seen with
noise."""

SECONDS_A_MINUTE = 60.0


@dataclass(frozen=True)
class SceneTaskOptions(StudyOptions):
    """What is measured.

    Attributes:
        parts: names of tasks.
        seeds: number of episodes of each task and number of objects; the first has the seed `seed`.
        figure: file of a figure of the simulated times; None for none.
    """

    parts: tuple[str, ...] | None = option(
        None,
        "rearrange, separate or fetch; may be repeated.",
        name="--part",
        metavar="PART",
        shown="all",
    )
    seeds: int = option(EPISODE_COUNT, "Episodes of each task and number of objects.", least=1)
    figure: Path | None = option(
        None,
        "Write a figure of the simulated times: a .png, .pdf or .svg file.",
        metavar="FILE",
        is_setting=False,
    )


@dataclass(frozen=True)
class SceneTaskJob:
    """An episode.

    Attributes:
        part: what is done.
        count: number of objects.
        seed: seed of everything random.
    """

    part: str
    count: int
    seed: int


@dataclass(frozen=True)
class SceneTaskOutcome:
    """What came of an episode.

    Attributes:
        part: what was done.
        count: number of objects.
        seed: seed of everything random.
        done: whether the planner ended it well.
        reached: whether it truly is done, and nothing fell.
        fell: number of objects that fell.
        time: simulated time, s.
        pushes: number of pushes.
        distance: greatest distance from a goal at the end, m; NaN in other tasks.
        turn: greatest turn from a goal at the end, rad; NaN in other tasks.
        room: least room around an object at the end, m.
        decision: mean time of a decision, with learning, s of one core.
        reason: how it ended.
    """

    part: str
    count: int
    seed: int
    done: bool
    reached: bool
    fell: int
    time: float
    pushes: int
    distance: float
    turn: float
    room: float
    decision: float
    reason: str


def run_job(job: SceneTaskJob) -> SceneTaskOutcome:
    """Runs an episode, and judges it by where the objects truly lie."""
    rng = np.random.default_rng((job.count, job.seed))
    surface = SupportSurface.rectangle((0.0, 0.0), (TABLE_SIDE, TABLE_SIDE))
    return PART_RUNNERS[job.part](job, rng, surface)


def _rearrange(
    job: SceneTaskJob, rng: np.random.Generator, surface: SupportSurface
) -> SceneTaskOutcome:
    """Brings objects from random poses to random goal poses."""
    names = rng.permutation(EPISODE_OBJECTS)[: job.count]
    objects = load_objects(names.tolist())
    begin = scatter(objects, rng, START_GAP, TABLE_SIDE / 4)
    truth = hide(objects, rng)
    goals = scatter(objects, rng, END_GAP, TABLE_SIDE / 4)
    options = FINE_OPTIONS if job.part == FINE_REARRANGE_PART else RearrangeOptions()
    planner = RearrangePlanner(objects, goals, options, SceneRules(surface), seed=job.seed)
    run, world, seconds = carry_out(job, truth, begin, surface, planner, SceneLearning())
    distance, turn = planner.calc_errors(world.truth.pose)
    near = distance.max() < GOAL_TOLERANCE_FACTOR * options.position_tolerance
    near = near and turn.max() < GOAL_TOLERANCE_FACTOR * options.angle_tolerance
    return _judge(job, run, world, seconds, bool(near), (float(distance.max()), float(turn.max())))


def _separate(
    job: SceneTaskJob, rng: np.random.Generator, surface: SupportSurface
) -> SceneTaskOutcome:
    """Moves the objects of a heap apart."""
    names = rng.permutation(EPISODE_OBJECTS)[: job.count]
    objects = load_objects(names.tolist())
    begin = heap_up(objects, rng)
    truth = hide(objects, rng)
    planner = SeparatePlanner(objects, rules=SceneRules(surface), seed=job.seed)
    run, world, seconds = carry_out(job, truth, begin, surface, planner, None)
    apart = (
        calc_clearances(objects, world.truth.pose).min() > WANTED_CLEARANCE / GOAL_TOLERANCE_FACTOR
    )
    return _judge(job, run, world, seconds, bool(apart))


def _fetch(
    job: SceneTaskJob, rng: np.random.Generator, surface: SupportSurface
) -> SceneTaskOutcome:
    """Fetches the wanted object, the first, out of a heap."""
    wanted = str(rng.choice(FETCHED_OBJECTS))
    others = [name for name in rng.permutation(EPISODE_OBJECTS).tolist() if name != wanted]
    objects = load_objects([wanted, *others[: job.count - 1]])
    begin = heap_up(objects, rng)
    truth = hide(objects, rng)
    options = FetchOptions(pregrasp=PreGraspOptions(max_arm=MAX_ARM))
    planner = FetchPlanner(objects, 0, surface, options, seed=job.seed)
    learning = FetchLearning(0, surface, friction_range=FRICTION_RANGE)
    run, world, seconds = carry_out(job, truth, begin, surface, planner, learning)
    held = False
    last = run.state.last
    if last is not None and last.action is SceneAction.GRASP and last.goal is not None:
        over = calc_overhangs([last.goal.part], world.truth.pose[0], surface)[0]
        held = bool(over > 0.0)
    return _judge(job, run, world, seconds, held)


PART_RUNNERS: dict[
    str, Callable[[SceneTaskJob, np.random.Generator, SupportSurface], SceneTaskOutcome]
] = {
    REARRANGE_PART: _rearrange,
    FINE_REARRANGE_PART: _rearrange,
    SEPARATE_PART: _separate,
    FETCH_PART: _fetch,
}
"""What runs an episode of each task."""


def carry_out(
    job: SceneTaskJob,
    truth: Bodies,
    begin: Array,
    surface: SupportSurface,
    planner: ScenePlanner,
    learning: SceneLearner | None,
) -> tuple[LoopRun[JointState], SimulatedWorld, float]:
    """Carries a task out in a world in which objects lie at poses (N, 3), m and rad.

    Returns:
        What came of it, the world, and the time that it took, s of one core.
    """
    world = SimulatedWorld(
        truth, begin, surface, position_std=POSITION_STD, angle_std=ANGLE_STD, seed=job.seed
    )
    loop = JointLoop(
        planner,
        Belief.of_even_objects(truth.objects, seed=job.seed),
        learning=learning,
        max_pushes=MAX_PUSHES[job.part],
        options=STILL_WORLD,
        seed=job.seed,
    )
    started = thread_time()
    run = run_loop(loop, world)
    return run, world, thread_time() - started


def _judge(
    job: SceneTaskJob,
    run: LoopRun[JointState],
    world: SimulatedWorld,
    seconds: float,
    reached: bool,
    errors: tuple[float, float] = (np.nan, np.nan),
) -> SceneTaskOutcome:
    """Writes down what came of an episode; `reached` tells if the task's own aim truly is."""
    truth = world.truth
    state = run.state
    fell = int(np.sum(truth.fallen))
    return SceneTaskOutcome(
        part=job.part,
        count=job.count,
        seed=job.seed,
        done=state.done,
        reached=state.done and reached and fell == 0,
        fell=fell,
        time=world.time,
        pushes=world.pushes,
        distance=errors[0],
        turn=errors[1],
        room=float(calc_clearances(world.bodies.objects, truth.pose).min()),
        decision=seconds / max(world.pushes, 1),
        reason=state.status.reason,
    )


def load_objects(names: Sequence[str]) -> list[GridObject]:
    """Loads shipped objects."""
    return [GridObject.from_yaml(find_shipped_object(name)) for name in names]


def make_jobs(options: SceneTaskOptions) -> list[SceneTaskJob]:
    """Makes the episodes of each task and number of objects.

    Raises:
        GridPushError: a task is unknown.
        OutputError: the figure cannot be written.
    """
    parts = PART_NAMES if options.parts is None else options.parts
    unknown = [part for part in parts if part not in PART_NAMES]
    if unknown:
        raise GridPushError(f"part: {', '.join(unknown)}; expected some of {', '.join(PART_NAMES)}")
    if options.figure is not None:
        check_figure(options.figure, options.force)
    tasks = []
    for part in dict.fromkeys(parts):
        tasks += [REARRANGE_PART, FINE_REARRANGE_PART] if part == REARRANGE_PART else [part]
    seeds = range(options.seed, options.seed + options.seeds)
    counts = {
        task: OBJECT_COUNTS[task][:1] if options.quick else OBJECT_COUNTS[task] for task in tasks
    }
    return [
        SceneTaskJob(part=task, count=count, seed=seed)
        for task in tasks
        for count in counts[task]
        for seed in seeds
    ]


def tabulate(options: SceneTaskOptions, done: Done) -> list[Table]:
    """Makes a table of each task, a row for each number of objects; draws the figure."""
    outcomes = done.of(EPISODE_JOBS)
    tables = []
    for part in (REARRANGE_PART, FINE_REARRANGE_PART, SEPARATE_PART, FETCH_PART):
        mine = [each for each in outcomes if each.part == part]
        if mine:
            tables.append(_tabulate_part(part, mine))
    if options.figure is not None:
        write_figure(options.figure, outcomes, options.force)
    return tables


PART_TITLES = {
    REARRANGE_PART: "Rearranging, within 2 cm and 0.2 rad",
    FINE_REARRANGE_PART: "Rearranging, within 5 mm and 3°",
    SEPARATE_PART: "Separating, 3 cm around each",
    FETCH_PART: "Fetching the wanted object to the table's edge",
}
"""Titles of the tables and panels."""


def _tabulate_part(part: str, outcomes: Sequence[SceneTaskOutcome]) -> Table:
    """Makes the table of a task."""
    groups = [
        ((count,), [each for each in outcomes if each.count == count])
        for count in OBJECT_COUNTS[part]
    ]
    columns: dict[str, Callable[[Sequence[SceneTaskOutcome]], str | float | int | Mean | None]] = {
        "episodes": len,
        "done": lambda some: Proportion.of(
            sum(each.reached for each in some), len(some)
        ).describe(),
        "fallen": lambda some: sum(each.fell for each in some),
        "simulated, min": lambda some: calc_interval(
            [each.time for each in some], 1 / SECONDS_A_MINUTE
        ),
        "90 %, min": lambda some: float(
            np.quantile([each.time / SECONDS_A_MINUTE for each in some], 0.9)
        ),
        "pushes": lambda some: calc_interval([each.pushes for each in some]),
        "s a decision": lambda some: float(np.mean([each.decision for each in some])),
    }
    if part in (REARRANGE_PART, FINE_REARRANGE_PART):
        columns["off, mm"] = lambda some: (
            MM_PER_M * float(np.median([each.distance for each in some]))
        )
        columns["turned, °"] = lambda some: (
            DEG_PER_RAD * float(np.median([each.turn for each in some]))
        )
    notes = [
        "done: fraction of the episodes, judged by where the objects truly lie, with nothing "
        "fallen; "
        "Wilson intervals at 95 %. simulated and pushes: means with bootstrap intervals at 95 %.",
        f"Shipped objects of hidden masses and frictions on a table of {TABLE_SIDE:g} m; poses "
        "are seen "
        f"with {POSITION_STD * MM_PER_M:g} mm and {ANGLE_STD:g} rad of noise. A decision is timed "
        "on one "
        "core, learning included.",
    ]
    notes += [
        f"{each.count} objects, seed {each.seed}: {each.reason}"
        for each in outcomes
        if not each.reached
    ]
    return Table.of(PART_TITLES[part], ("objects",), groups, columns, notes)


def write_figure(path: Path, outcomes: Sequence[SceneTaskOutcome], force: bool) -> None:
    """Writes a figure of the simulated times of all episodes, a panel for each task.

    Raises:
        OutputError: it cannot be written.
    """
    parts = {
        PART_TITLES[part]: part for part in PART_TITLES if any(one.part == part for one in outcomes)
    }

    def draw(axis: "Axes", title: str) -> None:
        mine = [each for each in outcomes if each.part == parts[title]]
        for reached, color, label in ((True, "teal", "done"), (False, "firebrick", "not done")):
            some = [each for each in mine if each.reached == reached]
            # side by side, so that episodes of the same time are seen
            shift = [0.3 * ((each.seed * 0.618) % 1.0 - 0.5) for each in some]
            axis.plot(
                [each.count + dx for each, dx in zip(some, shift, strict=True)],
                [each.time / SECONDS_A_MINUTE for each in some],
                ".",
                color=color,
                label=label,
            )
        counts = sorted({each.count for each in mine})
        means = [
            float(np.mean([one.time for one in mine if one.count == count])) for count in counts
        ]
        axis.plot(counts, np.array(means) / SECONDS_A_MINUTE, "k-", label="mean")

    write_panels(
        path, list(parts), 2, ("objects", "simulated time, min"), draw, force, from_zero=True
    )


def shorten(options: SceneTaskOptions) -> SceneTaskOptions:
    """Makes the options of the quick variant: two episodes of the fewest objects of each task."""
    return replace(options, seeds=min(options.seeds, 2))


EPISODE_JOBS = JobKind(
    job=SceneTaskJob,
    run=run_job,
    describe=lambda job: f"{job.part}, {job.count} objects, {job.seed}",
)
"""What is done with an episode."""

STUDY = Study(
    name="scene-tasks",
    help="Rearrange and separate several objects, and fetch one of them, in the plain world: "
    "success, simulated time, pushes.",
    options=SceneTaskOptions,
    tasks=(EPISODE_JOBS,),
    make_jobs=make_jobs,
    tabulate=tabulate,
    shorten=shorten,
)
"""`gridpush bench scene-tasks`."""

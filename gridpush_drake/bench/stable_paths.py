"""`gridpush bench stable`: paths of stable pushes, open loop, and pushes by one finger beside them.

Hidden bodies in MuJoCo that do not obey the model (`bench.truth.sets`) are learned from a few
random pokes by one finger, seen with noise. Each is then to come to a goal 0.3 m away, turned by
any angle. It is seen once, with noise, before the first push, and never after: all pushes are
planned beforehand. Two fingertips that turn push it along a path of stable pushes
(`planning.stable`); one finger by a sequence of pushes by the same model (`planning.goal`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count, islice

import numpy as np

from gridpush_drake.bench.steering.worlds import (
    POSE_SENSOR,
    STEERED_FINGER,
    HiddenBodyCase,
    make_case,
)
from gridpush_drake.bench.study import OBJECTS_OPTION, Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.truth.mujoco_world import MujocoWorld
from gridpush_drake.bench.truth.sets import OUTLINE_NAMES, TRUTH_KINDS
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import Pusher, PusherShape
from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.jobs.run import check_known
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_error
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_plan import plan_pushes
from gridpush_drake.planning.stable.stable_path import STABLE_PROBABILITY, plan_stable_path
from gridpush_drake.report.table import Proportion, Table, Value
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M, PERCENT_PER_ONE

STABLE_WAY = "stable pushes"
"""Name of the paths of stable pushes by two fingertips."""

FINGER_WAY = "one finger"
"""Name of the sequences of pushes by one finger."""

WAY_NAMES = (STABLE_WAY, FINGER_WAY)
"""Ways in which a body is pushed, in the order of the table."""

FINGERTIPS = Pusher(
    shape=PusherShape.discs([(0.0, -0.025), (0.0, 0.025)], 0.005), speed=0.05, clearance=0.001
)
"""The two fingertips, 50 mm apart."""

FINGER = Pusher(radius=STEERED_FINGER.radius, speed=0.05, clearance=0.001)
"""The one finger, with which the body is poked, too."""

WANTED_PROBABILITIES = (STABLE_PROBABILITY, 0.8, 0.5)
"""Probabilities that nothing slips which a path should have, one after the other, until there is a
path."""

GOAL_DISTANCE = 0.3
"""Distance of the goal from where the body lies, m."""

CLOSE_ENOUGH = 0.005
"""Distance of the body frame's origin from the goal's, m, within which the goal counts as reached;
the angle is stated by itself."""

POKES = 5
"""Pokes that are learned from."""

FINGER_TOLERANCE = 0.004
"""Mean cell error at which a sequence of one finger's pushes may end, m."""

FINGER_PUSHES = 25
"""Pushes of one finger at most."""

GOAL_SEED = 45
"""Goals and poses are drawn by a body's seed and this one."""

DEFAULT_BODY_COUNT = 60
"""Hidden bodies by default."""


@dataclass(frozen=True)
class StableBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        kinds: kinds of truth.
        objects: names of shipped objects whose outlines the bodies have.
        bodies: number of bodies. Kinds and objects take turns, and each round of all of them has a
            seed of its own; the first one is `seed`.
        ways: ways in which they are pushed, of WAY_NAMES.
    """

    kinds: tuple[str, ...] | None = option(
        None,
        "own_weight, half_height, foundation, vertices or three_feet; may be repeated.",
        name="--kind",
        metavar="KIND",
        shown="all",
    )
    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    bodies: int = option(
        DEFAULT_BODY_COUNT, "Hidden bodies; kinds and objects take turns.", least=1
    )
    ways: tuple[str, ...] = WAY_NAMES


@dataclass(frozen=True)
class StableJob:
    """One hidden body, and its goal.

    Attributes:
        kind: kind of truth.
        name: name of the outline.
        seed: seed of body, pokes, noise and goal.
        ways: ways in which it is pushed.
    """

    kind: str
    name: str
    seed: int
    ways: tuple[str, ...]


@dataclass(frozen=True)
class StableRun:
    """How a body came to its goal.

    Attributes:
        kind: kind of truth.
        name: name of the outline.
        seed: seed of the body.
        way: one of WAY_NAMES.
        pushes: number of pushes; 0 where no path was found.
        position: distance from the goal at the end, m.
        angle: difference from its angle, rad.
        cells: mean distance of the cells from where they should be, m.
        probability: that was stated that nothing slips; NaN of one finger.
        expected: mean distance of the cells that was expected, m.
    """

    kind: str
    name: str
    seed: int
    way: str
    pushes: int
    position: float
    angle: float
    cells: float
    probability: float
    expected: float

    @property
    def is_within(self) -> bool:
        """Whether a body that was pushed ended within CLOSE_ENOUGH."""
        return self.pushes > 0 and self.position <= CLOSE_ENOUGH


def shorten(options: StableBenchOptions) -> StableBenchOptions:
    """Makes the options of the quick variant: one body of each kind, by stable pushes alone."""
    bodies = min(options.bodies, len(TRUTH_KINDS))
    return replace(options, bodies=bodies, ways=(STABLE_WAY,))


def make_jobs(options: StableBenchOptions) -> list[StableJob]:
    """Makes a job for each body.

    Raises:
        GridPushError: a kind or an object is not known.
        MissingExtraError: MuJoCo is not installed.
    """
    import_extra("mujoco", "bench")
    kinds = TRUTH_KINDS if options.kinds is None else options.kinds
    check_known("kind", kinds, TRUTH_KINDS)
    names = OUTLINE_NAMES if options.objects is None else options.objects
    for name in names:
        find_shipped_object(name)
    if options.bodies < 1:
        raise GridPushError(f"bodies: {options.bodies}; expected at least 1")
    rounds = (
        (seed, name, kind) for seed in count(options.seed) for name in names for kind in kinds
    )
    return [
        StableJob(kind=kind, name=name, seed=seed, ways=options.ways)
        for seed, name, kind in islice(rounds, options.bodies)
    ]


def run_job(job: StableJob) -> list[StableRun]:
    """Learns a body from pokes, and pushes it to its goal in every way."""
    case = make_case(job.kind, job.name, job.seed, learns=True, poke_count=POKES)
    rng = np.random.default_rng((job.seed, GOAL_SEED))
    start = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    direction = rng.uniform(-np.pi, np.pi)
    place = GOAL_DISTANCE * np.array([np.cos(direction), np.sin(direction)])
    goal = np.array([*place, rng.uniform(-np.pi, np.pi)])
    noise = np.array([*[POSE_SENSOR.position_std] * 2, POSE_SENSOR.angle_std])
    seen = start + noise * rng.standard_normal(3)
    return [_run_way(job, way, case, start, seen, goal) for way in job.ways]


def _run_way(
    job: StableJob, way: str, case: HiddenBodyCase, start: Array, seen: Array, goal: Array
) -> StableRun:
    """Plans the pushes of a way from a seen pose (3,), and makes them from the true one."""
    assert case.learned is not None and case.body is not None
    pushes: list[Push] = []
    probability = np.nan
    expected = np.nan
    pusher: float | PusherShape
    if way == STABLE_WAY:
        assert FINGERTIPS.shape is not None
        pusher = FINGERTIPS.shape
        belief = Belief.of_identification(case.learned, log=case.pokes, seed=job.seed)
        for wanted in WANTED_PROBABILITIES:
            path = plan_stable_path(
                belief, FINGERTIPS, seen, goal, probability=wanted, seed=job.seed
            )
            if path is not None:
                pushes = [each.push for each in path.pushes]
                probability = path.probability
                expected = float(path.errors.mean())
                break
    else:
        assert FINGER.radius is not None
        pusher = FINGER.radius
        rules = GoalRules(
            contact=ContactOptions(pusher=FINGER),
            horizon=2,
            tolerance=FINGER_TOLERANCE,
            max_pushes=FINGER_PUSHES,
        )
        plan = plan_pushes(case.learned, seen, goal, rules)
        pushes = [each.push for each in plan.pushes]
        expected = plan.error
    world = MujocoWorld(case.body, pusher, pose=start)
    for push in pushes:
        world.execute(push)
    end = world.truth.pose
    return StableRun(
        kind=job.kind,
        name=job.name,
        seed=job.seed,
        way=way,
        pushes=len(pushes),
        position=float(np.linalg.norm(end[:2] - goal[:2])),
        angle=abs(float(wrap_angle(end[2] - goal[2]))),
        cells=float(calc_goal_error(case.obj, end, goal)),
        probability=probability,
        expected=expected,
    )


def tabulate(options: StableBenchOptions, done: Done) -> list[Table]:
    """Tabulates the runs by way and kind of truth."""
    return [tabulate_runs([run for runs in done.of(STABLE_JOBS) for run in runs])]


def tabulate_runs(runs: Sequence[StableRun]) -> Table:
    """Makes a row for each way and kind, and for each way in all."""
    rows: list[list[Value]] = []
    for way in dict.fromkeys(run.way for run in runs):
        of_way = [run for run in runs if run.way == way]
        kinds = dict.fromkeys(run.kind for run in of_way)
        for kind in kinds:
            rows.append([way, kind, *_sum_up([run for run in of_way if run.kind == kind])])
        if len(kinds) > 1:
            rows.append([way, "all", *_sum_up(of_way)])
    columns = (
        "way",
        "truth",
        "bodies",
        f"within {CLOSE_ENOUGH * MM_PER_M:g} mm, %",
        "from",
        "to",
        "median, mm",
        "90 %, mm",
        "median, °",
        "cells, median, mm",
        "pushes",
        "stated, %",
        "no path",
        "sure, but not within",
    )
    notes = (
        f"Goals {GOAL_DISTANCE:g} m away at any angle, open loop; learned from {POKES} pokes. Each "
        "body is seen once, with noise.",
        "Within: distance of the body frame's origin from the goal's; from, to: its 95 % interval "
        "(Wilson). Bodies without a path count as not within.",
        "Median and 90 %: of that distance, of the angle and of the cells' mean distance, of the "
        "bodies with a path.",
        "Stated: mean probability beforehand that nothing slips. Sure, but not within: bodies that "
        f"were not within though it was {PERCENT_PER_ONE * STABLE_PROBABILITY:g} % or more.",
    )
    return Table("Pushed to goals unseen, in MuJoCo", columns, rows, notes, keys=2)


def _sum_up(runs: Sequence[StableRun]) -> list[Value]:
    """Makes the figures of a row."""
    made = [run for run in runs if run.pushes]
    within = Proportion.of(sum(run.is_within for run in made), len(runs))
    figures: list[Value] = [
        len(runs),
        PERCENT_PER_ONE * within.count / within.total,
        PERCENT_PER_ONE * within.low,
        PERCENT_PER_ONE * within.high,
    ]
    if not made:
        return [*figures, None, None, None, None, None, None, len(runs), 0]
    positions = np.array([run.position for run in made])
    probability = float(np.mean([run.probability for run in made]))
    return [
        *figures,
        MM_PER_M * float(np.median(positions)),
        MM_PER_M * float(np.quantile(positions, 0.9)),
        DEG_PER_RAD * float(np.median([run.angle for run in made])),
        MM_PER_M * float(np.median([run.cells for run in made])),
        float(np.mean([run.pushes for run in made])),
        PERCENT_PER_ONE * probability,
        len(runs) - len(made),
        sum(run.probability >= STABLE_PROBABILITY and not run.is_within for run in made),
    ]


STABLE_JOBS = JobKind(
    job=StableJob, run=run_job, describe=lambda job: f"{job.kind}, {job.name} {job.seed}"
)
"""What is done with a hidden body."""

STUDY = Study(
    name="stable",
    help="Push bodies that do not obey the model to goals 0.3 m away, unseen: by stable pushes of "
    "two fingertips, and by pushes of one finger.",
    options=StableBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(STABLE_JOBS,),
    tabulate=tabulate,
)
"""`gridpush bench stable`."""

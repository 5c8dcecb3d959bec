"""`gridpush bench scene`: objects that push each other, and what is learned of them.

The same pushes are made in our model, in MuJoCo (`bench.multi_object.scene_rows`) and in Drake's
plant (`bench.multi_object.scene_plant`), and the last poses are compared; objects of hidden masses
are learned together (`bench.multi_object.joint_learning`); and pushes of 1 to 10 objects are timed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gridpush_drake.bench.multi_object.joint_learning import (
    LearnJob,
    make_learn_table,
    run_learn_job,
)
from gridpush_drake.bench.multi_object.scene_plant import MakePlantScene
from gridpush_drake.bench.multi_object.scene_rows import (
    PUSH_LENGTH,
    PUSHER_RADIUS,
    SLOW_PUSH_SPEED,
    draw_row,
    load_objects,
    make_mujoco_scene,
    make_row,
)
from gridpush_drake.bench.speed_cases import PAPER_TIME_STEP, PUSH_DURATION, PUSH_SPEED
from gridpush_drake.bench.study import Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.timing import measure, one_core
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.prediction import calc_cell_errors
from gridpush_drake.jobs.run import Report, count_steps
from gridpush_drake.report.table import Table, Value, mean_of
from gridpush_drake.units import MM_PER_M, MS_PER_S

OBJECT_COUNTS = (2, 3, 4)
"""Numbers of objects that push each other, in our model and in others."""

LEARNED_OBJECT_COUNTS = (2, 3)
"""Numbers of objects that are learned together."""

PUSH_COUNT = 100
"""Number of pushes of as many objects."""

MASS_SET_COUNT = 4
"""Number of sets of hidden masses of as many objects that are learned in each world."""

LEARNING_WORLDS = ("model", "mujoco")
"""Worlds in which the objects that are learned are pushed."""

TIMED_OBJECT_COUNTS = (1, 2, 3, 5, 10)
"""Numbers of objects of which a push is timed."""

TIMING_REPETITIONS = 20
"""How often each of them is timed."""


@dataclass(frozen=True)
class SceneBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        pushes: number of pushes of as many objects in all three simulators; 0 for none.
        repetitions: how often a push is timed; 0 for never.
        sets: number of sets of hidden masses that are learned, of as many objects in each world; 0
            for none.
        worlds: where they are pushed: "model", "mujoco".
        counts: numbers of objects that push each other in all three simulators.
        learned: numbers of objects that are learned.
        timed: numbers of objects of which a push is timed.
    """

    pushes: int = option(
        PUSH_COUNT,
        "Pushes of 2, 3 and 4 objects each, in our model, in MuJoCo and in Drake; 0 for none.",
        least=0,
    )
    repetitions: int = option(TIMING_REPETITIONS, "Runs of each timed push; 0 for none.", least=0)
    sets: int = option(
        MASS_SET_COUNT,
        "Sets of hidden masses that are learned, of 2 and 3 objects each; 0 for none.",
        least=0,
    )
    worlds: tuple[str, ...] = LEARNING_WORLDS
    counts: tuple[int, ...] = OBJECT_COUNTS
    learned: tuple[int, ...] = LEARNED_OBJECT_COUNTS
    timed: tuple[int, ...] = TIMED_OBJECT_COUNTS


@dataclass(frozen=True)
class ScenePushJob:
    """One push of some objects.

    Attributes:
        count: number of objects.
        seed: seed of masses, poses and push.
    """

    count: int
    seed: int


@dataclass(frozen=True)
class SceneScore:
    """How far three simulators are from each other after a push.

    Attributes:
        count: number of objects.
        moved: mean displacement of all objects' cells, m.
        last_moved: that of the object that is farthest from the pusher, m.
        drake: mean distance of the cells between our model and Drake's plant, m.
        mujoco: that between our model and MuJoCo, m.
        between: that between Drake's plant and MuJoCo, m.
        solved: whether every step of our model was solved.
    """

    count: int
    moved: float
    last_moved: float
    drake: float
    mujoco: float
    between: float
    solved: bool


def run_job(job: ScenePushJob) -> SceneScore:
    """Makes one push in our model, in Drake's plant and in MuJoCo."""
    bodies, begin, push = draw_row(load_objects(job.count), job.seed)
    motion = simulate(bodies, push, begin)
    end = np.array([push.duration])
    mujoco = make_mujoco_scene(bodies, begin, push)(end)[0]
    drake = MakePlantScene(bodies, begin, push)(end)[0]

    compare = partial(calc_cell_errors, bodies.objects)
    moved = compare(drake, begin)
    return SceneScore(
        count=job.count,
        moved=float(np.mean(moved)),
        last_moved=moved[-1],
        drake=float(np.mean(compare(motion.final_pose, drake))),
        mujoco=float(np.mean(compare(motion.final_pose, mujoco))),
        between=float(np.mean(compare(drake, mujoco))),
        solved=str(motion.status) == "ok",
    )


def measure_scenes(options: SceneBenchOptions, report: Report | None) -> list[Table]:
    """Times a push of several objects, with and without its Jacobian, on one core."""
    if options.repetitions == 0:
        return []
    with one_core():
        return [make_speed_table(options.timed, options.repetitions, report)]


def make_speed_table(timed: Sequence[int], repetitions: int, report: Report | None = None) -> Table:
    """Makes the table of times; `report` is called with what begins, as of jobs."""
    rows: list[list[Value]] = []
    steps = round(PUSH_DURATION / PAPER_TIME_STEP)
    announce = count_steps(report, len(timed))
    for count in timed:
        announce(f"{count} objects")
        bodies, poses, straight = make_row(load_objects(count), seed=count)
        push = Push(straight.start, (PUSH_SPEED, 0.0), PUSH_DURATION, PUSHER_RADIUS)
        push_all = partial(simulate_together, bodies, push, poses, PAPER_TIME_STEP)
        plain = measure(push_all, repetitions, warm_up=3)
        whole = measure(partial(push_all, gradients=True, record=[steps]), repetitions)
        motion = push_all()
        contacts = float((motion.modes > 0).sum(axis=1).mean())
        cells = sum(obj.n for obj in bodies.objects)
        rows.append(
            [
                count,
                cells,
                contacts,
                plain.median * MS_PER_S,
                plain.low * MS_PER_S,
                plain.high * MS_PER_S,
                whole.median * MS_PER_S,
                float(motion.iterations.mean()),
            ]
        )
    columns = (
        "objects",
        "cells",
        "contacts a step",
        "median, ms",
        "25 %, ms",
        "75 %, ms",
        "with Jacobian, ms",
        "iterations a step",
    )
    note = (
        f"A row of shipped objects, pushed at one end for {PUSH_DURATION:g} s at {PUSH_SPEED:g} "
        "m/s, step "
        f"{PAPER_TIME_STEP * MS_PER_S:g} ms, quasi-static; median and quartiles of {repetitions} "
        "runs. The Jacobian "
        "is of the final poses, by all masses, frictions, the push and the first poses."
    )
    return Table("A push of several objects", columns, rows, [note])


def make_jobs(options: SceneBenchOptions) -> list[ScenePushJob | LearnJob]:
    """Makes a job for each push of each number of objects, and for each set of masses."""
    seeds = range(options.seed, options.seed + options.pushes)
    sets = range(options.seed, options.seed + options.sets)
    jobs: list[ScenePushJob | LearnJob] = [
        ScenePushJob(count, seed) for count in options.counts for seed in seeds
    ]
    jobs += [
        LearnJob(count, seed, world)
        for world in options.worlds
        for count in options.learned
        for seed in sets
    ]
    return jobs


def tabulate(options: SceneBenchOptions, done: Done) -> list[Table]:
    """Sums up the scores by the number of objects."""
    scores = [score for job, score in done.pairs if isinstance(job, ScenePushJob)]
    learned = [score for job, score in done.pairs if isinstance(job, LearnJob)]
    groups = [
        ((count,), [score for score in scores if score.count == count])
        for count in sorted({score.count for score in scores})
    ]
    columns = {
        "pushes": len,
        "moved, mm": mean_of("moved", MM_PER_M),
        "last moved, mm": mean_of("last_moved", MM_PER_M),
        "model to Drake, mm": mean_of("drake", MM_PER_M),
        "model to MuJoCo, mm": mean_of("mujoco", MM_PER_M),
        "Drake to MuJoCo, mm": mean_of("between", MM_PER_M),
        "median to Drake, mm": lambda some: MM_PER_M * float(np.median([s.drake for s in some])),
        "median to MuJoCo, mm": lambda some: MM_PER_M * float(np.median([s.mujoco for s in some])),
        "solved": lambda some: sum(score.solved for score in some),
    }
    notes = (
        f"Mean distance of the cells after pushes of {PUSH_LENGTH * 100:g} cm at "
        f"{SLOW_PUSH_SPEED * 100:g} cm/s; "
        "random masses by part, each cell on a foot that bears its weight. Every push moves all "
        "objects.",
    )
    title = "Objects that push each other, in three simulators"
    tables = []
    if scores:
        tables.append(Table.of(title, ("objects",), groups, columns, notes))
    if learned:
        tables.append(make_learn_table(learned))
    return tables


def shorten(options: SceneBenchOptions) -> SceneBenchOptions:
    """Makes the options of the quick variant: two pushes and one set of two objects."""
    return replace(
        options,
        pushes=2,
        repetitions=3,
        sets=1,
        worlds=("model",),
        counts=(2,),
        learned=(2,),
        timed=(1, 2),
    )


STUDY = Study(
    name="scene",
    help="Compare the model of objects that push each other with Drake's plant and MuJoCo, learn "
    "such objects together, and time their pushes.",
    options=SceneBenchOptions,
    measure=measure_scenes,
    tasks=(
        JobKind(
            job=ScenePushJob, run=run_job, describe=lambda job: f"{job.count} objects, {job.seed}"
        ),
        JobKind(
            job=LearnJob,
            run=run_learn_job,
            describe=lambda job: f"learning {job.count} objects, {job.world}, {job.seed}",
        ),
    ),
    make_jobs=make_jobs,
    tabulate=tabulate,
    shorten=shorten,
)
"""`gridpush bench scene`."""

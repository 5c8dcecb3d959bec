"""`gridpush bench scene`: objects that push each other, in our model and in MuJoCo.

In MuJoCo every object is a free body. Its cells are boxes that stand on the table, each with its
own mass and friction; its outline is a wall of triangular prisms that touch the other objects and
the pusher. The same pushes are made in both, and the last poses are compared.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import shapely

from gridpush_drake.bench.jobs import Report, count_steps
from gridpush_drake.bench.speed import (
    DT,
    DURATION,
    MUJOCO_TIME_STEP,
    PUSHER_GAIN,
    PUSHER_MASS,
    SPEED,
    measure,
    one_core,
)
from gridpush_drake.bench.study import Done, Study, StudyOptions, Task, option
from gridpush_drake.bench.table import MM, MS, Table, Value, mean_of
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.scene.bodies import Scene, SceneBody
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.errors import PushError
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.identification.prediction import calc_pose_error
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters

OBJECTS = ("claw_hammer", "snack_bag", "toolbox", "toothpaste_tube")
"""Shipped objects that lie beside each other; of the first few as many as are wanted."""

COUNTS = (2, 3)
"""Numbers of objects that push each other."""

PUSHES = 20
"""Number of pushes of as many objects."""

TIMED = (1, 2, 3, 5, 10)
"""Numbers of objects of which a push is timed."""

REPETITIONS = 20
"""How often each of them is timed."""

PAIR_FRICTION = 0.3
"""Friction coefficient of two objects against each other."""

PUSHER_FRICTION = 0.3
"""Friction coefficient of every object against the pusher."""

CELL_MASS = (0.002, 0.02)
"""Least and greatest mass of a cell, kg."""

SEEDS_A_ROW = 100
"""Distance of the seeds of two rows' masses."""

RADIUS = 0.015
"""Radius of the pusher, m."""

SHIFT = 0.001
"""Step by which an object is moved aside until it is clear of those before it, m."""

SPREAD = 0.02
"""Greatest distance of an object's origin from the line that they lie along, m."""

LENGTH = 0.15
"""Length of a push, m."""

SLOW = 0.05
"""Speed of a push that is compared with MuJoCo, m/s."""

MIN_MOTION = 0.005
"""Least mean displacement of the last object's cells that makes a push one of all, m."""

TRIES = 50
"""Most rows that are tried for a push that moves all objects."""

HEIGHT = 0.02
"""Height of the objects in MuJoCo, m."""

CONTACT_TIME = 0.004
"""Time constant of MuJoCo's contacts, s: two of its steps, the stiffest that it recommends."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """What is measured.

    Attributes:
        pushes: number of pushes of as many objects.
        repetitions: how often a push is timed.
        counts: numbers of objects that push each other.
        timed: numbers of objects of which a push is timed.
    """

    pushes: int = option(PUSHES, "Pushes of as many objects.", least=1)
    repetitions: int = option(REPETITIONS, "Runs of each timed push.", least=3)
    counts: tuple[int, ...] = COUNTS
    timed: tuple[int, ...] = TIMED


@dataclass(frozen=True)
class Job:
    """One push of some objects.

    Attributes:
        count: number of objects.
        seed: seed of masses, poses and push.
    """

    count: int
    seed: int


@dataclass(frozen=True)
class Score:
    """How far two simulators are from each other after a push.

    Attributes:
        count: number of objects.
        moved: mean displacement of all objects' cells, m.
        last_moved: that of the object that is farthest from the pusher, m.
        error: mean distance of the cells between our model and MuJoCo, m.
        worst: that of the object that differs most, m.
        solved: whether every step of our model was solved.
    """

    count: int
    moved: float
    last_moved: float
    error: float
    worst: float
    solved: bool


def load_objects(count: int) -> list[GridObject]:
    """Loads as many shipped objects, those of `OBJECTS` over and over again."""
    names = [OBJECTS[i % len(OBJECTS)] for i in range(count)]
    return [GridObject.from_yaml(find_shipped_object(name)) for name in names]


def make_row(objects: Sequence[GridObject], seed: int, speed: float = SLOW) -> tuple[Scene, Push]:
    """Lays objects of random masses side by side along x, and makes a push along that line.

    Args:
        objects: the objects.
        seed: seed of masses, angles and of the push.
        speed: of the pusher, m/s.

    Returns:
        The scene, and the push of its first object.
    """
    rng = np.random.default_rng(seed)
    bodies = []
    taken = shapely.Polygon()
    for i, obj in enumerate(objects):
        pose = np.array([0.0, rng.uniform(-SPREAD, SPREAD), rng.uniform(-np.pi, np.pi)])
        while taken.intersects(transform_shape(pose, obj.outline)):
            pose[0] += SHIFT
        taken = taken.union(transform_shape(pose, obj.outline))
        params = CellParameters.random(obj, SEEDS_A_ROW * seed + i, CELL_MASS)
        bodies.append(SceneBody(obj, replace(params, contact_friction=PUSHER_FRICTION), pose))
    first = transform_shape(bodies[0].pose, objects[0].outline).bounds
    y = 0.5 * (first[1] + first[3]) + rng.uniform(-SPREAD, SPREAD) / 2
    push = Push((first[0] - RADIUS, y), (speed, 0.0), LENGTH / speed, RADIUS)
    return Scene(bodies, PAIR_FRICTION), push


def draw_row(count: int, seed: int) -> tuple[Scene, Push]:
    """Draws a row of objects, and a push that moves all of them.

    Raises:
        PushError: hardly any push does.
    """
    objects = load_objects(count)
    for attempt in range(TRIES):
        scene, push = make_row(objects, TRIES * seed + attempt)
        motion = simulate_scene(scene, push)
        last = calc_pose_error(objects[-1], motion.final_poses[-1], scene.poses[-1]).cell
        if last >= MIN_MOTION:
            return scene, push
    raise PushError(f"none of {TRIES} pushes moves the last of {count} objects")


def run_job(job: Job) -> Score:
    """Makes one push in our model and in MuJoCo."""
    scene, push = draw_row(job.count, job.seed)
    motion = simulate_scene(scene, push)
    theirs = make_mujoco_scene(scene, push)()
    errors = [
        calc_pose_error(obj, ours, other).cell
        for obj, ours, other in zip(scene.objects, motion.final_poses, theirs, strict=True)
    ]
    moved = [
        calc_pose_error(obj, end, begin).cell
        for obj, end, begin in zip(scene.objects, theirs, scene.poses, strict=True)
    ]
    return Score(
        count=job.count,
        moved=float(np.mean(moved)),
        last_moved=float(moved[-1]),
        error=float(np.mean(errors)),
        worst=float(np.max(errors)),
        solved=str(motion.status) == "ok",
    )


def make_mujoco_scene(scene: Scene, push: Push) -> Callable[[], Array]:
    """Prepares a push of a scene in MuJoCo.

    Returns:
        A function that runs it from the beginning and returns the final poses (N, 3), m and rad.

    Raises:
        ImportError: MuJoCo is not installed (`pip install 'gridpush-drake[bench]'`).
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(describe_scene(scene, push))
    data = mujoco.MjData(model)
    steps = round(push.duration / MUJOCO_TIME_STEP)
    targets = push.tip_at(np.arange(1, steps + 1) * MUJOCO_TIME_STEP) - push.start
    velocity = np.asarray(push.velocity)

    def run() -> Array:
        mujoco.mj_resetData(model, data)
        data.qvel[-2:] = velocity
        for target in targets:
            data.ctrl[:] = target
            mujoco.mj_step(model, data)
        poses = []
        for b in range(len(scene)):
            x, y, _, w, i, j, k = data.qpos[7 * b : 7 * b + 7]
            angle = np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
            poses.append([x, y, angle])
        return np.array(poses)

    return run


def describe_scene(scene: Scene, push: Push) -> str:
    """Describes a scene in MJCF.

    A cell touches the table alone, with its own friction; a wall the other walls and the pusher.
    """
    meshes = []
    bodies = []
    for b, (obj, params, pose) in enumerate(
        zip(scene.objects, scene.params, scene.poses, strict=True)
    ):
        half = obj.cell_size / 2
        geoms = [
            f'<geom type="box" pos="{x} {y} 0" size="{half} {half} {HEIGHT / 2}" mass="{mass}" '
            f'contype="1" conaffinity="0" friction="{mu} 0.005 0.0001"/>'
            for (x, y), mass, mu in zip(obj.p_BC, params.mass, params.friction, strict=True)
        ]
        for i, triangle in enumerate(cut_outline(obj.outline)):
            corners = " ".join(
                f"{x} {y} {z}" for z in (-HEIGHT / 2, HEIGHT / 2) for x, y in triangle
            )
            meshes.append(f'<mesh name="wall_{b}_{i}" vertex="{corners}" inertia="convex"/>')
            geoms.append(
                f'<geom type="mesh" mesh="wall_{b}_{i}" mass="0" contype="2" conaffinity="2" '
                f'friction="{PAIR_FRICTION} 0.005 0.0001"/>'
            )
        c = np.cos(pose[2] / 2)
        s = np.sin(pose[2] / 2)
        bodies.append(
            f'<body pos="{pose[0]} {pose[1]} {HEIGHT / 2}" quat="{c} 0 0 {s}"><freejoint/>'
            f"{''.join(geoms)}</body>"
        )
    damping = 2 * np.sqrt(PUSHER_GAIN * PUSHER_MASS)
    return f"""
<mujoco>
  <option timestep="{MUJOCO_TIME_STEP}" cone="elliptic" impratio="10"/>
  <default><geom solref="{CONTACT_TIME} 1"/></default>
  <asset>{"".join(meshes)}</asset>
  <worldbody>
    <geom type="plane" size="2 2 0.1" contype="0" conaffinity="1" friction="0 0.005 0.0001"/>
    {"".join(bodies)}
    <body pos="{push.start[0]} {push.start[1]} {HEIGHT / 2}" gravcomp="1">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
      <geom type="cylinder" size="{push.radius} {HEIGHT / 4}" mass="{PUSHER_MASS}" contype="2"
            conaffinity="0" priority="1" friction="{PUSHER_FRICTION} 0.005 0.0001"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="{PUSHER_GAIN}" kv="{damping}"/>
    <position joint="y" kp="{PUSHER_GAIN}" kv="{damping}"/>
  </actuator>
</mujoco>"""


def cut_outline(outline: shapely.Polygon) -> list[Array]:
    """Cuts an outline into triangles, (3, 2) each, m."""
    pieces = shapely.constrained_delaunay_triangles(outline)
    return [np.asarray(piece.exterior.coords)[:3] for piece in shapely.get_parts(pieces)]


def measure_scenes(options: Options, report: Report | None) -> list[Table]:
    """Times a push of several objects, with and without its Jacobian, on one core."""
    with one_core():
        return [make_speed_table(options.timed, options.repetitions, report)]


def make_speed_table(timed: Sequence[int], repetitions: int, report: Report | None = None) -> Table:
    """Makes the table of times; `report` is called with what begins, as of jobs."""
    rows: list[list[Value]] = []
    steps = round(DURATION / DT)
    announce = count_steps(report, len(timed))
    for count in timed:
        announce(f"{count} objects")
        scene, straight = make_row(load_objects(count), seed=count)
        push = Push(straight.start, (SPEED, 0.0), DURATION, RADIUS)
        push_all = partial(simulate_scene, scene, push, dt=DT)
        plain = measure(push_all, repetitions, warm_up=3)
        whole = measure(partial(push_all, gradients=True, record=[steps]), repetitions)
        motion = simulate_scene(scene, push, dt=DT)
        contacts = float((motion.modes > 0).sum(axis=1).mean())
        cells = sum(obj.n for obj in scene.objects)
        rows.append(
            [
                count,
                cells,
                contacts,
                plain.median * MS,
                plain.low * MS,
                plain.high * MS,
                whole.median * MS,
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
        f"A row of shipped objects, pushed at one end for {DURATION:g} s at {SPEED:g} m/s, step "
        f"{DT * MS:g} ms, quasi-static; median and quartiles of {repetitions} runs. The Jacobian "
        "is of the final poses, by all masses, frictions, the push and the first poses."
    )
    return Table("A push of several objects", columns, rows, [note])


def make_jobs(options: Options) -> list[Job]:
    """Makes a job for each number of objects and each push."""
    seeds = range(options.seed, options.seed + options.pushes)
    return [Job(count, seed) for count in options.counts for seed in seeds]


def tabulate(options: Options, done: Done) -> list[Table]:
    """Sums up the scores by the number of objects."""
    scores = [score for _, score in done.pairs]
    groups = [
        ((count,), [score for score in scores if score.count == count]) for count in options.counts
    ]
    columns = {
        "pushes": len,
        "moved, mm": mean_of("moved", MM),
        "last moved, mm": mean_of("last_moved", MM),
        "cells, mm": mean_of("error", MM),
        "median, mm": lambda some: MM * float(np.median([score.error for score in some])),
        "worst object, mm": lambda some: MM * max(score.worst for score in some),
        "solved": lambda some: sum(score.solved for score in some),
    }
    notes = (
        f"Mean distance of the cells after pushes of {LENGTH * 100:g} cm at {SLOW * 100:g} cm/s; "
        "random masses by part. Every push moves all objects.",
    )
    return [Table.of("MuJoCo against the scene model", ("objects",), groups, columns, notes)]


def shorten(options: Options) -> Options:
    """Makes the options of the quick variant: two pushes of two objects."""
    return replace(options, pushes=2, repetitions=3, counts=(2,), timed=(1, 2))


STUDY = Study(
    name="scene",
    help="Set MuJoCo beside the model of objects that push each other, and time their pushes.",
    options=Options,
    measure=measure_scenes,
    tasks=(Task(job=Job, run=run_job, describe=lambda job: f"{job.count} objects, {job.seed}"),),
    make_jobs=make_jobs,
    tabulate=tabulate,
    shorten=shorten,
)
"""`gridpush bench scene`."""

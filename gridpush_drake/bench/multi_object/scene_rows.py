"""Rows of objects that a bench pushes through each other, in our model and in MuJoCo.

In MuJoCo every object is a free body on feet, one below each cell and as stiff as the cell is
heavy, so that each cell bears its own weight; its outline is a thin wall of triangular prisms,
close to the table, that touch the other objects and the pusher.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import shapely

from gridpush_drake.bench.truth.mujoco_world import (
    PUSHER_HALF_LENGTH,
    PUSHER_INERTIA,
    PUSHER_MASS,
    calc_poses,
    describe_feet,
    describe_inertia,
    describe_options,
    describe_pairs,
)
from gridpush_drake.bench.worlds.mujoco_plant import set_springs
from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.identification.prediction import calc_pose_error
from gridpush_drake.multibody.mjcf import (
    FOUNDATION_SINKAGE,
    TABLE_HALF,
    TIME_STEP,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters

ROW_OBJECTS = ("claw_hammer", "snack_bag", "toolbox", "toothpaste_tube")
"""Shipped objects that lie beside each other; of the first few as many as are wanted."""

PAIR_FRICTION = 0.3
"""Friction coefficient of two objects against each other."""

PUSHER_FRICTION = 0.3
"""Friction coefficient of every object against the pusher."""

CELL_MASS = (0.002, 0.02)
"""Least and greatest mass of a cell, kg."""

SEEDS_A_ROW = 100
"""Distance of the seeds of two rows' masses."""

PUSHER_RADIUS = 0.015
"""Radius of the pusher, m."""

SHIFT_STEP = 0.001
"""Step by which an object is moved aside until it is clear of those before it, m."""

MAX_ROW_OFFSET = 0.02
"""Greatest distance of an object's origin from the line that they lie along, m."""

PUSH_LENGTH = 0.15
"""Length of a push, m."""

SLOW_PUSH_SPEED = 0.05
"""Speed of a push that is compared with MuJoCo, m/s."""

MIN_MOTION = 0.005
"""Least mean displacement of the last object's cells that makes a push one of all, m."""

MAX_ROW_TRIES = 50
"""Most rows that are tried for a push that moves all objects."""

WALL_HEIGHTS = (0.001, 0.003)
"""Heights above the table from which and up to which walls go in MuJoCo, m."""


def load_objects(count: int) -> list[GridObject]:
    """Loads as many shipped objects, those of `ROW_OBJECTS` over and over again."""
    names = [ROW_OBJECTS[i % len(ROW_OBJECTS)] for i in range(count)]
    return [GridObject.from_yaml(find_shipped_object(name)) for name in names]


def make_row(
    objects: Sequence[GridObject],
    seed: int,
    speed: float = SLOW_PUSH_SPEED,
    params: Sequence[CellParameters] | None = None,
) -> tuple[Bodies, Array, Push]:
    """Lays objects side by side along x, and makes a push along that line.

    Args:
        objects: the objects.
        seed: seed of angles and of the push, and of masses.
        speed: of the pusher, m/s.
        params: the cells' masses and frictions; random masses where None.

    Returns:
        The objects, their poses (N, 3), m and rad, and the push of the first one.
    """
    rng = np.random.default_rng(seed)
    masses = draw_params(objects, seed) if params is None else params
    poses: list[Array] = []
    taken = shapely.Polygon()
    for obj in objects:
        pose = np.array(
            [0.0, rng.uniform(-MAX_ROW_OFFSET, MAX_ROW_OFFSET), rng.uniform(-np.pi, np.pi)]
        )
        while taken.intersects(transform_shape(pose, obj.outline)):
            pose[0] += SHIFT_STEP
        taken = taken.union(transform_shape(pose, obj.outline))
        poses.append(pose)
    first = transform_shape(poses[0], objects[0].outline).bounds
    y = 0.5 * (first[1] + first[3]) + rng.uniform(-MAX_ROW_OFFSET, MAX_ROW_OFFSET) / 2
    push = Push((first[0] - PUSHER_RADIUS, y), (speed, 0.0), PUSH_LENGTH / speed, PUSHER_RADIUS)
    return Bodies(objects, masses, None, PAIR_FRICTION), np.array(poses), push


def draw_params(objects: Sequence[GridObject], seed: int) -> list[CellParameters]:
    """Draws the masses of objects, part by part."""
    drawn = [
        CellParameters.random(obj, SEEDS_A_ROW * seed + i, CELL_MASS)
        for i, obj in enumerate(objects)
    ]
    return [replace(params, contact_friction=PUSHER_FRICTION) for params in drawn]


def draw_row(
    objects: Sequence[GridObject], seed: int, params: Sequence[CellParameters] | None = None
) -> tuple[Bodies, Array, Push]:
    """Draws a row of objects, and a push that moves all of them.

    Args:
        objects: the objects.
        seed: seed of everything random.
        params: as of `make_row`.

    Raises:
        PushError: hardly any push does.
    """
    count = len(objects)
    for attempt in range(MAX_ROW_TRIES):
        bodies, poses, push = make_row(objects, MAX_ROW_TRIES * seed + attempt, params=params)
        ends = simulate(bodies, push, poses).final_pose
        if calc_pose_error(objects[-1], ends[-1], poses[-1]).cell >= MIN_MOTION:
            return bodies, poses, push
    raise PushError(f"none of {MAX_ROW_TRIES} pushes moves the last of {count} objects")


def make_mujoco_scene(bodies: Bodies, poses: Array, push: Push) -> Callable[[Array], Array]:
    """Prepares a push of objects at poses (N, 3), m and rad, in MuJoCo.

    Returns:
        A function that runs it from the beginning and returns the poses (K, N, 3), m and rad, at
        increasing times (K,) of the push, s.

    Raises:
        MissingExtraError: MuJoCo is not installed (`pip install '.[bench]'`).
    """
    mujoco = import_extra("mujoco", "bench")
    model = mujoco.MjModel.from_xml_string(describe_scene(bodies, poses, push))
    data = mujoco.MjData(model)
    for b, params in enumerate(bodies.parameters):
        inverse = float(model.body_invweight0[b + 1, 0])
        set_springs(model, f"foot{b}", params.mass * GRAVITY, FOUNDATION_SINKAGE, inverse)
    steps = round(push.duration / TIME_STEP)
    path = push.tip_at(np.arange(steps + 1) * TIME_STEP)
    speed = np.diff(path, axis=0) / TIME_STEP
    place = 7 * len(bodies)
    rate = 6 * len(bodies)

    def run(times: Array) -> Array:
        mujoco.mj_resetData(model, data)
        wanted = np.rint(np.asarray(times) / TIME_STEP).astype(int)
        seen = []
        for i in range(steps + 1):
            for _ in range(np.count_nonzero(wanted == i)):
                seen.append(calc_poses(data.qpos[: 7 * len(bodies)].reshape(-1, 7)))
            if i < steps:
                # the pusher goes its way, whatever is before it
                data.qpos[place : place + 2] = path[i]
                data.qvel[rate : rate + 2] = speed[i]
                mujoco.mj_step(model, data)
        return np.array(seen)

    return run


def describe_scene(objects: Bodies, poses: Array, push: Push) -> str:
    """Describes objects at poses (N, 3), m and rad, in MJCF.

    Feet touch the table alone, each with its cell's friction; walls the other walls and the pusher.
    """
    give = f'solref="{2 * TIME_STEP} 1"'
    meshes = []
    bodies = []
    pairs = []
    for b, ((obj, params), pose) in enumerate(zip(objects, poses, strict=True)):
        geoms = [describe_feet(obj.p_BC, name=f"f_{b}_")]
        pairs.append(describe_pairs(f"foot{b}", "table", f"f_{b}_", params.friction))
        for i, triangle in enumerate(cut_outline(obj.outline)):
            corners = " ".join(f"{x} {y} {z}" for z in WALL_HEIGHTS for x, y in triangle)
            meshes.append(f'<mesh name="wall_{b}_{i}" vertex="{corners}" inertia="convex"/>')
            geoms.append(
                f'<geom type="mesh" mesh="wall_{b}_{i}" contype="2" conaffinity="2" '
                f'friction="{PAIR_FRICTION} 0 0" {give}/>'
            )
        c = np.cos(pose[2] / 2)
        s = np.sin(pose[2] / 2)
        bodies.append(
            f'<body pos="{pose[0]} {pose[1]} {-FOUNDATION_SINKAGE}" quat="{c} 0 0 {s}"><freejoint/>'
            f"{describe_inertia(obj, params, WALL_HEIGHTS[1])}{''.join(geoms)}</body>"
        )
    return f"""
<mujoco>
  {describe_options(TIME_STEP)}
  <asset>{"".join(meshes)}</asset>
  <worldbody>
    <geom name="table" type="box" pos="0 0 -0.5" size="{TABLE_HALF} {TABLE_HALF} 0.5"/>
    {"".join(bodies)}
    <body gravcomp="1">
      <inertial pos="0 0 0" mass="{PUSHER_MASS}" diaginertia="1 1 1"/>
      <joint type="slide" axis="1 0 0" armature="{PUSHER_INERTIA}"/>
      <joint type="slide" axis="0 1 0" armature="{PUSHER_INERTIA}"/>
      <geom type="cylinder" size="{push.radius} {PUSHER_HALF_LENGTH}" contype="2" conaffinity="0"
       priority="1" friction="{PUSHER_FRICTION} 0 0" {give}/>
    </body>
  </worldbody>
  <contact>{"".join(pairs)}</contact>
</mujoco>"""


def cut_outline(outline: shapely.Polygon) -> list[Array]:
    """Cuts an outline into triangles, (3, 2) each, m."""
    pieces = shapely.constrained_delaunay_triangles(outline)
    return [np.asarray(piece.exterior.coords)[:3] for piece in shapely.get_parts(pieces)]

"""Pushes of bodies that hang over a table's edge: in MuJoCo, in Drake's plant, and in the model.

The table is the half-plane x < 0. A body with known masses lies on it with 10 to 45 % of its cells
beyond the edge and is pushed. It is also pushed towards the edge until it tips, to see on which
side of the limit the model lets it tip.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal
from zlib import crc32

import numpy as np
from shapely import LineString, Point

from gridpush_drake.bench.study import JobKind
from gridpush_drake.bench.truth.mujoco_world import BODY_HEIGHT, TABLE_HALF, MujocoWorld
from gridpush_drake.bench.truth.sets import (
    HALF_HEIGHT,
    MAX_PUSH_ANGLE,
    MIN_MOTION,
    PUSHER_CLEARANCE,
    draw_masses,
    make_body,
)
from gridpush_drake.bench.worlds.plant import PUSH_HEIGHT, PlantWorld
from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import choose_pusher_radius
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array, rotate, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import FALLEN_TILT, PushWorld, WorldMotion
from gridpush_drake.report.table import Column, Mean, Table, by_object, calc_interval, count_of
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M

WorldName = Literal["mujoco", "drake"]
"""Name of a world that the model is compared with."""

OVERHANG_KIND = "overhang"
"""Name of this kind of truth."""

COMPARED_WORLDS: tuple[WorldName, ...] = ("mujoco", "drake")
"""Worlds that the model is compared with."""

HALF_PLANE = (-TABLE_HALF, -TABLE_HALF, 0.0, TABLE_HALF)
"""Sides of the table in MuJoCo, m: least x, least y, greatest x, greatest y."""

MODEL_SURFACE = SupportSurface.rectangle((-TABLE_HALF / 2, 0.0), (TABLE_HALF, 2 * TABLE_HALF))
"""The table as the model knows it."""

OVERHANG_FRACTIONS = (0.10, 0.45)
"""Least and greatest fraction of the cells beyond the edge, at a push's beginning and at its
end."""

PUSH_COUNT = 4
"""Number of pushes of each body."""

PUSH_LENGTH = 0.05
"""Length of a push, m."""

PUSHER_SPEED = 0.05
"""Speed of the pusher, m/s."""

MIN_STABLE = 0.004
"""Distance that the center of mass is within the table at the beginning, m, beside what a push
takes away."""

MAX_TILT = np.radians(2)
"""Greatest tilt of a body that counts as staying flat while it is pushed over the edge, rad."""

TIPPING_TILT = np.radians(6)
"""Tilt from which a body tips, rad. With less, its bottom may come to rest on the edge when its
last foot has left the table."""

SETTLING_TIME = 0.3
"""Time that a body is given to come to rest over the edge, s."""

TIP_SPEED = 0.02
"""Speed of the pushes across the limit, m/s."""

TIP_DISTANCE = 0.05
"""Length of the pushes across the limit, m."""

TIP_START = 0.025
"""Distance of the center of mass from the edge at their beginning, m."""

TIP_SLACK = 0.005
"""Length of the pusher's path before and behind the limit, m, at which the model is asked."""

STABLE_TIME = 1.0
"""Time after a push in which a body that is to stay must not tip, s."""

PLANT_SPHERES = 4
"""Number of contact spheres of each cell in Drake's plant, so that a cell may lie half over the
edge."""

TIPPED_BODIES = 20
"""Number of bodies of each outline that are pushed until they tip."""

MAX_PUSH_TRIES = 300
"""Number of random pushes that are tried before it is said that none is as asked for."""


@dataclass(frozen=True)
class OverhangJob:
    """Pushes of one body with some of its cells over the edge.

    Attributes:
        world: name of the world that the model is compared with.
        name: name of the outline.
        seed: seed of the body and its pushes.
        pushes: number of pushes.
    """

    world: WorldName
    name: str
    seed: int
    pushes: int = PUSH_COUNT


@dataclass(frozen=True)
class OverhangScore:
    """How far the model's last pose is from the true one.

    Attributes:
        world: name of the world in which the body was pushed.
        name: name of the outline.
        seed: seed of the body.
        fraction: fraction of the cells beyond the edge at the end.
        moved: mean distance that the cells went, m.
        position: distance of the centers of mass of a model that knows of the table, m.
        angle: difference of its angle, rad.
        endless: distance of the centers of mass of a model that knows of no edge, m.
        tips: whether the model says that the body tips; it did not.
    """

    world: str
    name: str
    seed: int
    fraction: float
    moved: float
    position: float
    angle: float
    endless: float
    tips: bool


@dataclass(frozen=True)
class TippingJob:
    """A body that is pushed across the limit.

    Attributes:
        name: name of the outline.
        seed: seed of the body and its pushes.
    """

    name: str
    seed: int


@dataclass(frozen=True)
class TippingScore:
    """What the model says of pushes that end before and behind the limit.

    Attributes:
        name: name of the outline.
        seed: seed of the body.
        stayed: whether the model lets it tip where it truly stays.
        tipped: whether it lets it tip where it truly tips.
    """

    name: str
    seed: int
    stayed: bool
    tipped: bool


def make_jobs(
    names: Sequence[str], sets: int, seed: int, bodies: int
) -> list[OverhangJob | TippingJob]:
    """Makes the jobs of both measurements.

    Args:
        names: names of the outlines.
        sets: number of bodies of each outline that are pushed over the edge.
        seed: seed of the first body; the others' follow.
        bodies: number of bodies of each outline that are pushed until they tip.
    """
    pushes = [
        OverhangJob(world, name, seed + i)
        for world in COMPARED_WORLDS
        for i in range(sets)
        for name in names
    ]
    limits = [TippingJob(name, seed + i) for i in range(bodies) for name in names]
    return [*pushes, *limits]


def run_overhang(job: OverhangJob) -> list[OverhangScore]:
    """Pushes one body over the edge, and lets the model do the same.

    Raises:
        GridPushError: hardly any push holds the body over the edge without tipping it.
    """
    rng = np.random.default_rng(
        [job.seed, crc32(job.name.encode()), COMPARED_WORLDS.index(job.world)]
    )
    obj, params = draw_masses(job.name, rng)
    radius = choose_pusher_radius(obj)
    world, height = _make_world(job.world, obj, params, radius, rng)
    known = replace(params, push_height=height)
    scores: list[OverhangScore] = []
    for _ in range(MAX_PUSH_TRIES):
        if len(scores) == job.pushes:
            return scores
        pose = _draw_pose(obj, known, rng)
        push = _draw_push(obj, pose, radius, rng)
        if pose is None or push is None:
            continue
        motion = _execute_flat(world, push, pose)
        if motion is None:
            continue
        score = _score(job, obj, known, push, *motion.poses[[0, -1]])
        if (
            OVERHANG_FRACTIONS[0] <= score.fraction <= OVERHANG_FRACTIONS[1]
            and score.moved >= MIN_MOTION
        ):
            scores.append(score)
    raise GridPushError(
        f"{job.name}: {MAX_PUSH_TRIES} random pushes hold only {len(scores)} over the edge "
        "that do not tip it"
    )


def _make_world(
    name: WorldName,
    obj: GridObject,
    params: CellParameters,
    radius: float,
    rng: np.random.Generator,
) -> tuple[PushWorld, float]:
    """Makes a world of a body, and says at what height the pusher touches it, m."""
    if name == "drake":
        world = PlantWorld(
            Model(obj, params), radius=radius, base="free", edge=0.0, spheres_per_cell=PLANT_SPHERES
        )
        return world, PUSH_HEIGHT
    body = make_body(HALF_HEIGHT, obj, params, rng).harden()
    return MujocoWorld(body, radius, HALF_PLANE, settle=SETTLING_TIME), BODY_HEIGHT / 2


def _execute_flat(world: PushWorld, push: Push, pose: Array) -> WorldMotion | None:
    """Pushes a body from a pose (3,); returns its motion, or None where it does not stay flat."""
    world.put(pose)
    if world.truth.tilt > MAX_TILT:
        return None
    world.execute(push)
    motion = world.truth.motion
    assert motion is not None
    if motion.tilt is not None and motion.tilt.max() >= MAX_TILT:
        return None
    return motion


def _draw_pose(obj: GridObject, params: CellParameters, rng: np.random.Generator) -> Array | None:
    """Draws a pose (3,) with some of the cells beyond the edge; None where the body would tip."""
    theta = rng.uniform(-np.pi, np.pi)
    fraction = rng.uniform(*OVERHANG_FRACTIONS)
    edge = np.quantile(rotate(theta, obj.p_BC)[:, 0], 1 - fraction)
    center = rotate(theta, params.center_of_mass(obj))[0] - edge
    reach = float(params.friction.max()) * params.push_height + MIN_STABLE
    return np.array([-edge, 0.0, theta]) if center <= -reach else None


def _draw_push(
    obj: GridObject, pose: Array | None, radius: float, rng: np.random.Generator
) -> Push | None:
    """Draws a push from the outline inwards; None without a pose, or where no pusher fits."""
    place = rng.uniform(0, obj.edges.perimeter)
    angle = rng.uniform(-MAX_PUSH_ANGLE, MAX_PUSH_ANGLE)
    point, _, normal = obj.edges.at(place)
    if (
        pose is None
        or obj.outline.distance(Point(point + normal * (radius + PUSHER_CLEARANCE))) < radius
    ):
        return None
    return Push.on_outline(
        obj,
        place,
        angle,
        PUSH_LENGTH,
        radius=radius,
        speed=PUSHER_SPEED,
        pose=pose,
        clearance=PUSHER_CLEARANCE,
    )


def _score(
    job: OverhangJob, obj: GridObject, params: CellParameters, push: Push, begin: Array, end: Array
) -> OverhangScore:
    """Compares the poses (3,) at which a push truly began and ended with those of the model."""
    motion = simulate(
        Model(obj, params), push, begin, regime="quasi_static", table=MODEL_SURFACE.corners
    )
    endless = simulate(Model(obj, params), push, begin, regime="quasi_static").final_pose
    center = params.center_of_mass(obj)

    def find_center(pose: Array) -> Array:
        return np.asarray(pose[:2] + rotate(pose[2], center))

    cells = obj.cells_at(end)
    there = find_center(end)
    return OverhangScore(
        world=job.world,
        name=job.name,
        seed=job.seed,
        fraction=float((cells[:, 0] > 0).mean()),
        moved=float(np.linalg.norm(cells - obj.cells_at(begin), axis=1).mean()),
        position=float(np.linalg.norm(find_center(motion.final_pose) - there)),
        angle=float(abs(wrap_angle(motion.final_pose[2] - end[2]))),
        endless=float(np.linalg.norm(find_center(endless) - there)),
        tips=motion.status == MotionStatus.TIPS,
    )


def run_tipping(job: TippingJob) -> TippingScore:
    """Pushes one body across the limit, and asks the model before and behind it.

    Raises:
        GridPushError: hardly any push brings the body across such a limit.
    """
    rng = np.random.default_rng([job.seed, crc32(job.name.encode()), len(COMPARED_WORLDS)])
    obj, params = draw_masses(job.name, rng)
    radius = choose_pusher_radius(obj)
    body = make_body(HALF_HEIGHT, obj, params, rng).harden()
    world = MujocoWorld(body, radius, HALF_PLANE, settle=SETTLING_TIME)
    known = Model(obj, replace(params, push_height=BODY_HEIGHT / 2))
    for _ in range(MAX_PUSH_TRIES):
        theta = rng.uniform(-np.pi, np.pi)
        center = rotate(theta, params.center_of_mass(obj))
        pose = np.array([-center[0] - TIP_START, -center[1], theta])
        push = _aim(obj, pose, radius)
        limit = _find_limit(world, push, pose)
        if limit is None:
            continue
        before = _cut(push, limit - TIP_SLACK)
        behind = _cut(push, limit + TIP_SLACK)
        if _tips(world, before, pose):
            continue
        world.put(pose)
        begin = world.truth.pose
        stayed, tipped = (
            known.simulate(each, begin, regime="quasi_static", table=MODEL_SURFACE.corners).status
            == MotionStatus.TIPS
            for each in (before, behind)
        )
        return TippingScore(job.name, job.seed, stayed, tipped)
    raise GridPushError(
        f"{job.name}: none of {MAX_PUSH_TRIES} pushes brings it over the edge as a limit asks for"
    )


def _aim(obj: GridObject, pose: Array, radius: float) -> Push:
    """Aims a push along x through the center of mass, which is at y = 0, from beside the body."""
    ring = LineString(rotate(pose[2], np.array(obj.outline.exterior.coords)) + pose[:2])
    path = LineString([(ring.bounds[0] - 2 * radius, 0.0), (-TIP_START, 0.0)])
    touch = path.intersection(ring.buffer(radius).exterior).bounds[0]
    start = (touch - PUSHER_CLEARANCE, 0.0)
    return Push(start, (TIP_SPEED, 0.0), TIP_DISTANCE / TIP_SPEED, radius)


def _cut(push: Push, distance: float) -> Push:
    """Shortens a push to a distance, m."""
    return Push(push.start, push.velocity, distance / TIP_SPEED, push.radius)


def _find_limit(world: PushWorld, push: Push, pose: Array) -> float | None:
    """Finds the length of the pusher's path at which the body begins to tip, m.

    Returns:
        The length; None where the body never stood, where it still stands at the push's end, or
        where the limit is too near to the push's beginning or end.
    """
    world.put(pose)
    if world.truth.tilt > TIPPING_TILT:
        return None
    world.execute(push)
    motion = world.truth.motion
    assert motion is not None
    assert motion.tilt is not None
    fallen = np.flatnonzero(motion.tilt > FALLEN_TILT)
    if not len(fallen):
        return None
    last = np.flatnonzero(motion.tilt[: fallen[0]] < TIPPING_TILT)[-1]
    limit = float(motion.times[last] * TIP_SPEED)
    return limit if TIP_SLACK < limit < TIP_DISTANCE - TIP_SLACK else None


def _tips(world: MujocoWorld, push: Push, pose: Array) -> bool:
    """Says whether the body tips while it is pushed, or within STABLE_TIME afterwards."""
    world.put(pose)
    world.execute(push)
    motion = world.truth.motion
    assert motion is not None
    assert motion.tilt is not None
    world.wait(STABLE_TIME)
    return max(float(motion.tilt.max()), world.truth.tilt) > FALLEN_TILT


def tabulate_pushes(scores: Sequence[OverhangScore]) -> Table:
    """Tabulates the errors by world and object."""
    groups = [
        group
        for world in dict.fromkeys(score.world for score in scores)
        for group in _group_by_name([score for score in scores if score.world == world], world)
    ]
    columns: dict[str, Column] = {
        "pushes": len,
        "over, %": lambda some: 100 * float(np.mean([score.fraction for score in some])),
        "moved, mm": lambda some: MM_PER_M * float(np.mean([score.moved for score in some])),
        "mean, mm": lambda some: _calc_interval(some, "position", MM_PER_M).mean,
        "to": lambda some: _calc_interval(some, "position", MM_PER_M).high,
        "mean, °": lambda some: _calc_interval(some, "angle", DEG_PER_RAD).mean,
        "to, °": lambda some: _calc_interval(some, "angle", DEG_PER_RAD).high,
        "endless, mm": lambda some: MM_PER_M * float(np.mean([score.endless for score in some])),
        "tips": count_of("tips", True),
    }
    notes = (
        f"Pushes of {PUSH_LENGTH * 100:g} cm, {OVERHANG_FRACTIONS[0]:.0%} to "
        f"{OVERHANG_FRACTIONS[1]:.0%} of the cells over the "
        "edge; true masses.",
        "mm: distance of the center of mass from the truth's; to: the upper end of the mean's 95 % "
        "interval.",
        "endless: of a model that does not know of the edge. tips: pushes that the model lets tip; "
        "none did.",
    )
    return Table.of("Pushes over a table's edge", ("world", "object"), groups, columns, notes)


def tabulate_limit(scores: Sequence[TippingScore]) -> Table:
    """Tabulates by object what the model says on both sides of the limit."""
    columns: dict[str, Column] = {
        "bodies": len,
        "said to stay before": count_of("stayed", False),
        "said to tip behind": count_of("tipped", True),
    }
    notes = (
        f"Bodies in MuJoCo, pushed across the edge; the model is asked {TIP_SLACK * MM_PER_M:g} "
        "mm of "
        "the pusher's path before and behind the place where the body begins to tip.",
    )
    return Table.of("The limit", ("object",), _group_by_name(scores), columns, notes)


def _group_by_name(scores: Sequence[Any], *keys: str) -> list[tuple[tuple[str, ...], list[Any]]]:
    """Groups scores by the outlines that they are of, with a group of all."""
    return by_object(scores, list(dict.fromkeys(score.name for score in scores)), *keys)


def _calc_interval(scores: Sequence[OverhangScore], field: str, scale: float) -> Mean:
    """Calculates the mean of a field and its interval, times `scale`."""
    return calc_interval([getattr(score, field) for score in scores], scale)


OVERHANG_JOBS = JobKind(
    job=OverhangJob, run=run_overhang, describe=lambda job: f"{job.world}, {job.name} {job.seed}"
)
"""What is done with a body that is pushed over the edge."""

TIPPING_JOBS = JobKind(
    job=TippingJob, run=run_tipping, describe=lambda job: f"tipping, {job.name} {job.seed}"
)
"""What is done with a body that is pushed until it tips."""

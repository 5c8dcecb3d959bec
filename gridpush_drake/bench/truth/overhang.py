"""Pushes of bodies that hang over a table's edge, in MuJoCo and in Drake's free plant, and the model beside them.

The table is the half-plane x < 0. A body with known masses lies on it with 10 to 45 % of its cells
beyond the edge and is pushed; and it is pushed towards the edge until it tips, to see on which side
of the limit the model does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal
from zlib import crc32

import numpy as np
from shapely import LineString, Point

from gridpush_drake.bench.jobs import QUIET, Execution, run_jobs
from gridpush_drake.bench.paper import calc_interval
from gridpush_drake.bench.plant import PUSH_HEIGHT, PlantPusher
from gridpush_drake.bench.table import MM, Table, Value
from gridpush_drake.bench.truth.mujoco_world import BODY_HEIGHT, TABLE_HALF, TruthWorld
from gridpush_drake.bench.truth.sets import (
    CLEARANCE,
    HALF_HEIGHT,
    MIN_MOTION,
    OUTLINES,
    SLANT,
    draw_masses,
    make_body,
)
from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array, rotate, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS

World = Literal["mujoco", "drake"]

OVERHANG = "overhang"
"""The kind's name."""

WORLDS: tuple[World, ...] = ("mujoco", "drake")

HALF_PLANE = (-TABLE_HALF, -TABLE_HALF, 0.0, TABLE_HALF)
SURFACE = SupportSurface.rectangle((-TABLE_HALF / 2, 0.0), (TABLE_HALF, 2 * TABLE_HALF))

SHARE = (0.10, 0.45)
"""Of the cells beyond the edge, at a push's beginning and its end."""

PUSHES, DISTANCE, SPEED = 4, 0.05, 0.05
"""Of each body; m and m/s."""

MIN_STABLE = 0.004
"""m that the center of mass is within the table at the beginning, beside what a push takes away."""

MAX_TILT = np.radians(2)
"""Of a body that is pushed over the edge."""

TIPPING_TILT = np.radians(6)
"""From which a body tips: before, its bottom may come to rest on the edge when its last foot has
left the table."""

FALLEN = np.radians(10)
"""Tilt from which a body counts as dropped."""

SETTLE = 0.3
"""s that a body is given to come to rest over the edge."""

TIP_SPEED, TIP_DISTANCE = 0.02, 0.05
"""m/s and m, of the pushes across the limit."""

TIP_START = 0.025
"""m of the center of mass from the edge at their beginning."""

TIP_SLACK = 0.005
"""m of the pusher's path before and behind the limit at which the model is asked."""

WAIT = 1.0
"""s after a push in which a body that is to stay must not tip."""

TIPPED_BODIES = 20
"""Of each outline."""

TRIES = 300


@dataclass(frozen=True)
class OverhangJob:
    """Pushes of one body with some of its cells over the edge."""

    world: World
    name: str
    seed: int
    pushes: int = PUSHES


@dataclass(frozen=True)
class OverhangScore:
    """How far the model's last pose is from the truth's, with the table and without.

    Attributes:
        world: that the truth is of.
        name: of the outline.
        seed: of the body.
        share: of the cells beyond the edge at the end.
        moved: mean distance that the cells went, m.
        position: distance of the centers of mass, m, knowing of the table.
        angle: rad.
        endless: the distance of a model that does not know of it, m.
        tips: whether the model says that it tips; it did not.
    """

    world: str
    name: str
    seed: int
    share: float
    moved: float
    position: float
    angle: float
    endless: float
    tips: bool


@dataclass(frozen=True)
class TippingJob:
    """A body that is pushed across the limit."""

    name: str
    seed: int


@dataclass(frozen=True)
class TippingScore:
    """What the model says of pushes that end before and behind the limit.

    Attributes:
        name: of the outline.
        seed: of the body.
        stayed: whether the model lets it tip where it truly stays.
        tipped: whether it lets it tip where it truly tips.
    """

    name: str
    seed: int
    stayed: bool
    tipped: bool


def run(
    objects: Sequence[str] | None,
    sets: int,
    seed: int,
    execution: Execution = QUIET,
    bodies: int = TIPPED_BODIES,
) -> list[Table]:
    """Sets the model beside both worlds.

    Args:
        objects: shipped objects' names; five by default.
        sets: bodies of each object that are pushed over the edge.
        seed: of the first body; the others' follow.
        execution: how the jobs are run.
        bodies: of each object that are pushed until they tip.

    Returns:
        A table of the pushes' errors, and one of the limit.

    Raises:
        GridPushError: MuJoCo is not installed, or no such push is found.
    """
    names = OUTLINES if objects is None else tuple(objects)
    pushes = [
        OverhangJob(world, name, seed + i)
        for world in WORLDS
        for i in range(sets)
        for name in names
    ]
    limits = [TippingJob(name, seed + i) for i in range(bodies) for name in names]
    found = run_jobs(
        run_overhang, pushes, lambda job: f"{job.world}, {job.name} {job.seed}", execution
    )
    sides = run_jobs(run_tipping, limits, lambda job: f"tipping, {job.name} {job.seed}", execution)
    return [tabulate_pushes([score for scores in found for score in scores]), tabulate_limit(sides)]


def run_overhang(job: OverhangJob) -> list[OverhangScore]:
    """Pushes one body over the edge, and lets the model do the same."""
    rng = np.random.default_rng([job.seed, crc32(job.name.encode()), WORLDS.index(job.world)])
    obj, params = draw_masses(job.name, rng)
    move, radius, height = _make_world(job.world, obj, params, rng)
    known = replace(params, push_height=height)
    scores: list[OverhangScore] = []
    for _ in range(TRIES):
        if len(scores) == job.pushes:
            return scores
        pose = _draw_pose(obj, known, rng)
        push = _draw_push(obj, pose, radius, rng)
        done = None if pose is None or push is None else move(push, pose)
        if push is not None and done is not None and done[1] < MAX_TILT:
            score = _score(job, obj, known, push, *done[0][[0, -1]])
            if SHARE[0] <= score.share <= SHARE[1] and score.moved >= MIN_MOTION:
                scores.append(score)
    raise GridPushError(
        f"{job.name}: {TRIES} random pushes hold only {len(scores)} over the edge that do not tip it"
    )


Move = Callable[[Push, Array], tuple[Array, float] | None]
"""From a push and a pose to the poses (T+1, 3) and the greatest tilt, rad; None where the body does
not rest there."""


def _make_world(
    world: World, obj: GridObject, params: CellParameters, rng: np.random.Generator
) -> tuple[Move, float, float]:
    """What moves a body, the pusher's radius and the height at which it touches, m."""
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    if world == "drake":
        plant = PlantPusher(obj, params, radius, "free", edge=0.0, spheres_per_cell=4)

        def move_in_plant(push: Push, pose: Array) -> tuple[Array, float]:
            motion = plant.push(params, push, pose)
            return motion.poses, motion.tilt

        return move_in_plant, radius, PUSH_HEIGHT
    truth = TruthWorld(make_body(HALF_HEIGHT, obj, params, rng).harden(), radius, HALF_PLANE)

    def move(push: Push, pose: Array) -> tuple[Array, float] | None:
        truth.put(pose)
        truth.wait(SETTLE)
        if truth.read_tilt() > MAX_TILT:
            return None
        motion = truth.push(push)
        return motion.poses, float(motion.tilt.max())

    return move, radius, BODY_HEIGHT / 2


def _draw_pose(obj: GridObject, params: CellParameters, rng: np.random.Generator) -> Array | None:
    """A pose (3,) with some of the cells beyond the edge, where the body stands; None where it does not."""
    theta, share = rng.uniform(-np.pi, np.pi), rng.uniform(*SHARE)
    edge = np.quantile(rotate(theta, obj.p_BC)[:, 0], 1 - share)
    center = rotate(theta, params.center_of_mass(obj))[0] - edge
    reach = float(params.friction.max()) * params.push_height + MIN_STABLE
    return np.array([-edge, 0.0, theta]) if center <= -reach else None


def _draw_push(
    obj: GridObject, pose: Array | None, radius: float, rng: np.random.Generator
) -> Push | None:
    place, angle = rng.uniform(0, obj.edges.perimeter), rng.uniform(-SLANT, SLANT)
    point, _, normal = obj.edges.at(place)
    if pose is None or obj.outline.distance(Point(point + normal * (radius + CLEARANCE))) < radius:
        return None
    return Push.on_outline(
        obj, place, angle, DISTANCE, radius=radius, speed=SPEED, pose=pose, clearance=CLEARANCE
    )


def _score(
    job: OverhangJob, obj: GridObject, params: CellParameters, push: Push, begin: Array, end: Array
) -> OverhangScore:
    motion = simulate(obj, params, push, begin, regime="quasi_static", table=SURFACE.corners)
    endless = simulate(obj, params, push, begin, regime="quasi_static").final_pose
    center = params.center_of_mass(obj)

    def find(pose: Array) -> Array:
        return np.asarray(pose[:2] + rotate(pose[2], center))

    cells = obj.cells_at(end)
    return OverhangScore(
        job.world, job.name, job.seed, float((cells[:, 0] > 0).mean()),
        float(np.linalg.norm(cells - obj.cells_at(begin), axis=1).mean()),
        float(np.linalg.norm(find(motion.final_pose) - find(end))),
        float(abs(wrap_angle(motion.final_pose[2] - end[2]))), float(np.linalg.norm(find(endless) - find(end))),
        motion.status == MotionStatus.TIPS,
    )  # fmt: skip


def run_tipping(job: TippingJob) -> TippingScore:
    """Pushes one body across the limit, and asks the model before and behind it."""
    rng = np.random.default_rng([job.seed, crc32(job.name.encode()), len(WORLDS)])
    obj, params = draw_masses(job.name, rng)
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    world = TruthWorld(make_body(HALF_HEIGHT, obj, params, rng).harden(), radius, HALF_PLANE)
    known = replace(params, push_height=BODY_HEIGHT / 2)
    for _ in range(TRIES):
        theta = rng.uniform(-np.pi, np.pi)
        center = rotate(theta, params.center_of_mass(obj))
        pose = np.array([-center[0] - TIP_START, -center[1], theta])
        push = _aim(obj, pose, radius)
        limit = _find_limit(world, push, pose)
        if limit is None:
            continue
        before, behind = (_cut(push, limit + slack) for slack in (-TIP_SLACK, TIP_SLACK))
        if _tips(world, before, pose):
            continue
        begin = _put(world, pose)
        told = [
            simulate(obj, known, each, begin, regime="quasi_static", table=SURFACE.corners)
            for each in (before, behind)
        ]
        stayed, tipped = (motion.status == MotionStatus.TIPS for motion in told)
        return TippingScore(job.name, job.seed, stayed, tipped)
    raise GridPushError(
        f"{job.name}: none of {TRIES} pushes brings it over the edge as a limit asks for"
    )


def _aim(obj: GridObject, pose: Array, radius: float) -> Push:
    """A push along x through the center of mass, which is at y = 0, from where the disc nearly touches."""
    ring = LineString(rotate(pose[2], np.array(obj.outline.exterior.coords)) + pose[:2])
    path = LineString([(ring.bounds[0] - 2 * radius, 0.0), (-TIP_START, 0.0)])
    touch = path.intersection(ring.buffer(radius).exterior).bounds[0]
    return Push((touch - CLEARANCE, 0.0), (TIP_SPEED, 0.0), TIP_DISTANCE / TIP_SPEED, radius)


def _cut(push: Push, distance: float) -> Push:
    return Push(push.start, push.velocity, distance / TIP_SPEED, push.radius)


def _put(world: TruthWorld, pose: Array) -> Array:
    """(3,) where the body comes to rest."""
    world.put(pose)
    world.wait(SETTLE)
    return world.read_pose()


def _find_limit(world: TruthWorld, push: Push, pose: Array) -> float | None:
    """The pusher's path, m, at which the body begins to tip; None where it stands at the end, or never stood."""
    _put(world, pose)
    if world.read_tilt() > TIPPING_TILT:
        return None
    motion = world.push(push)
    fallen = np.flatnonzero(motion.tilt > FALLEN)
    if not len(fallen):
        return None
    last = np.flatnonzero(motion.tilt[: fallen[0]] < TIPPING_TILT)[-1]
    limit = float(motion.times[last] * TIP_SPEED)
    return limit if TIP_SLACK < limit < TIP_DISTANCE - TIP_SLACK else None


def _tips(world: TruthWorld, push: Push, pose: Array) -> bool:
    _put(world, pose)
    tilt = float(world.push(push).tilt.max())
    world.wait(WAIT)
    return max(tilt, world.read_tilt()) > FALLEN


def tabulate_pushes(scores: Sequence[OverhangScore]) -> Table:
    """Errors by world and object."""
    rows: list[list[Value]] = []
    for world in dict.fromkeys(score.world for score in scores):
        chosen = [score for score in scores if score.world == world]
        for name in (*dict.fromkeys(score.name for score in chosen), "all"):
            some = [score for score in chosen if name in (score.name, "all")]
            position = calc_interval([score.position for score in some])
            angle = calc_interval([score.angle for score in some])
            rows.append([
                world, name, len(some), 100 * float(np.mean([s.share for s in some])),
                MM * float(np.mean([s.moved for s in some])), MM * position.mean, MM * position.high,
                float(np.degrees(angle.mean)), float(np.degrees(angle.high)),
                MM * float(np.mean([s.endless for s in some])), sum(s.tips for s in some),
            ])  # fmt: skip
    notes = (
        f"Pushes of {DISTANCE * 100:g} cm, {SHARE[0]:.0%} to {SHARE[1]:.0%} of the cells over the edge; true masses.",
        "mm: distance of the center of mass from the truth's; to: the upper end of the mean's 95 % interval.",
        "endless: of a model that does not know of the edge. tips: pushes that the model lets tip; none did.",
    )
    columns = (
        "world", "object", "pushes", "over, %", "moved, mm", "mean, mm", "to", "mean, °", "to, °", "endless, mm",
        "tips",
    )  # fmt: skip
    return Table("Pushes over a table's edge", columns, rows, notes, keys=2)


def tabulate_limit(scores: Sequence[TippingScore]) -> Table:
    """What the model says on both sides of the limit, by object."""
    rows: list[list[Value]] = []
    for name in (*dict.fromkeys(score.name for score in scores), "all"):
        some = [score for score in scores if name in (score.name, "all")]
        rows.append([name, len(some), sum(not s.stayed for s in some), sum(s.tipped for s in some)])
    notes = (
        f"Bodies in MuJoCo, pushed across the edge; the model is asked {TIP_SLACK * MM:g} mm of the pusher's path "
        "before and behind the place where the body begins to tip.",
    )
    return Table(
        "The limit", ("object", "bodies", "said to stay before", "said to tip behind"), rows, notes
    )

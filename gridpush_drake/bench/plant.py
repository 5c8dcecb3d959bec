"""The same pushes in Drake's MultibodyPlant and in the grid LCP model.

Random parts, random pushes of 10 cm from random places of the outline. The plant's sphere feet resist no spin, so the
model's exact counterpart is spin="none"; "coupled", the default elsewhere, gives cells their area. With the "planar"
base each cell bears its own weight, as the model assumes; with the "free" base the loads shift because the push acts
above the table.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from typing import Literal

import numpy as np
from shapely import Point

from gridpush_drake.bench.table import Table, Value
from gridpush_drake.bench.workers import QUIET, Conduct, run_jobs
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulate import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.object_file import find_shipped_object
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.pushes.log import DEFAULT_PUSHER_RADIUS

OBJECTS = ("claw_hammer", "combination_wrench", "toolbox", "spray_bottle")
PUSHES = 20
"""An object."""

DISTANCE, SPEED = 0.1, 0.05
"""m and m/s."""

SLANT = radians(30)
"""Furthest from the outline's normal."""

LEAST_MOTION = 0.01
"""m, mean over the cells; pushes that move the object less are drawn again."""

MODEL_TIME_STEP = 1e-3
"""s, of the model: the plant's."""

TRIES = 100
BASES: tuple[Literal["planar", "free"], ...] = ("planar", "free")
SPINS: tuple[Literal["none", "coupled"], ...] = ("none", "coupled")
MM = 1e3


@dataclass(frozen=True)
class PlantJob:
    """The pushes of one object, held in one way."""

    name: str
    base: Literal["planar", "free"]
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class PlantScore:
    """How far plant and model differ at the end of one push.

    Attributes:
        name: the object.
        base: how the plant holds it.
        seed: of its parts and of the push.
        spin: the model's.
        position: distance of B's origins, m.
        angle: rad.
        cells: mean distance of the cells, m.
        moved: mean distance that the plant's cells went, m.
        tracking_error: of the plant's pusher, m.
        tilt: greatest of the plant's object, rad.
    """

    name: str
    base: str
    seed: int
    spin: str
    position: float
    angle: float
    cells: float
    moved: float
    tracking_error: float
    tilt: float


def run(
    objects: Sequence[str] = OBJECTS,
    pushes: int = PUSHES,
    bases: Sequence[Literal["planar", "free"]] = BASES,
    *,
    seed: int = 0,
    conduct: Conduct = QUIET,
) -> list[Table]:
    """Compares the two.

    Args:
        objects: shipped objects' names.
        pushes: how many of each.
        bases: how the plant holds the object.
        seed: the first push's; the others' follow.
        conduct: how the jobs are run.

    Returns:
        One table: a row for each object, base and spin model, and one over all objects.

    Raises:
        ObjectError: an object is not shipped.
    """
    return [make_table(calc_scores(objects, pushes, bases, seed=seed, conduct=conduct))]


def calc_scores(
    objects: Sequence[str] = OBJECTS,
    pushes: int = PUSHES,
    bases: Sequence[Literal["planar", "free"]] = BASES,
    *,
    seed: int = 0,
    conduct: Conduct = QUIET,
) -> list[PlantScore]:
    """As `run`, push by push."""
    for name in objects:
        find_shipped_object(name)
    seeds = tuple(range(seed, seed + pushes))
    jobs = [PlantJob(name, base, seeds) for base in bases for name in objects]
    results = run_jobs(run_job, jobs, lambda job: f"{job.name}, {job.base}", conduct)
    return [score for result in results for score in result]


def run_job(job: PlantJob) -> list[PlantScore]:
    """Pushes one object in the plant and in the model, once a seed."""
    from gridpush_drake.bench.plant_push import PlantPusher
    from gridpush_drake.scene.truth import hide_truth

    obj = GridObject.from_yaml(find_shipped_object(job.name))
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    pusher = PlantPusher(obj, CellParameters.uniform(obj), radius, job.base)
    scores = []
    for seed in job.seeds:
        params = hide_truth(obj, seed, friction_by_part=True)
        push, pose = draw_push(obj, params, seed, radius)
        motion = pusher.push(params, push, pose)
        last, moved = motion.poses[-1], _calc_distance(obj, motion.poses[-1], pose)
        for spin in SPINS:
            expected = simulate(obj, params, push, pose, MODEL_TIME_STEP, spin=spin).final_pose
            angle = abs((last[2] - expected[2] + np.pi) % (2 * np.pi) - np.pi)
            scores.append(
                PlantScore(
                    job.name, job.base, seed, spin, float(np.linalg.norm(last[:2] - expected[:2])), float(angle),
                    _calc_distance(obj, last, expected), moved, motion.tracking_error, motion.tilt,
                )
            )  # fmt: skip
    return scores


def draw_push(obj: GridObject, params: CellParameters, seed: int, radius: float) -> tuple[Push, np.ndarray]:
    """Draws a pose of the object and a push that moves it.

    Args:
        obj: the object.
        params: its masses and frictions.
        seed: of the draw.
        radius: of the pusher, m.

    Returns:
        The push, from a place of the outline inwards, and the pose (3,).

    Raises:
        PushError: hardly any push moves the object.
    """
    rng = np.random.default_rng((seed, 3))
    for _ in range(TRIES):
        pose = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-np.pi, np.pi)])
        place, angle = rng.uniform(0, obj.edges.perimeter), rng.uniform(-SLANT, SLANT)
        point, _, normal = obj.edges.at(place)
        if obj.outline.distance(Point(point + normal * radius)) < (1 - 1e-6) * radius:
            continue
        push = Push.on_outline(obj, place, angle, DISTANCE, radius=radius, speed=SPEED, pose=pose)
        if _calc_distance(obj, simulate(obj, params, push, pose).final_pose, pose) >= LEAST_MOTION:
            return push, pose
    raise PushError(f"{obj.name}: none of {TRIES} random pushes moves it by {LEAST_MOTION * MM:g} mm")


def make_table(scores: Sequence[PlantScore]) -> Table:
    """Sums up scores by object, base and spin model."""
    names = list(dict.fromkeys(score.name for score in scores))
    rows: list[list[Value]] = []
    for base in dict.fromkeys(score.base for score in scores):
        for spin in SPINS:
            chosen = [score for score in scores if (score.base, score.spin) == (base, spin)]
            rows += [[name, base, spin, *_sum_up([s for s in chosen if s.name == name])] for name in names]
            if len(names) > 1:
                rows.append(["all", base, spin, *_sum_up(chosen)])
    worst = max(score.tracking_error for score in scores)
    notes = (
        f"Difference of the last poses after pushes of {DISTANCE * 100:g} cm at {SPEED * 100:g} cm/s; random parts.",
        "Planar: every foot bears its cell's weight, dt 1 ms.",
        "Free: six degrees of freedom, pushed 12 mm above the table, dt 2 ms: load shifts to the cells in front.",
        "Spin: the model's; none is the plant's sphere feet.",
        f"The plant's pusher left its path by at most {worst * 1e6:.1f} µm.",
    )
    columns = (
        "object", "base", "spin", "pushes", "moved, mm", "mean, mm", "max, mm", "mean, °", "max, °", "cells, mm",
    )  # fmt: skip
    return Table("MultibodyPlant against the grid LCP", columns, rows, notes, keys=3)


def _sum_up(scores: Sequence[PlantScore]) -> list[Value]:
    position = MM * np.array([score.position for score in scores])
    angle = np.degrees([score.angle for score in scores])
    return [
        len(scores), MM * float(np.mean([score.moved for score in scores])), float(position.mean()),
        float(position.max()), float(angle.mean()), float(angle.max()),
        MM * float(np.mean([score.cells for score in scores])),
    ]  # fmt: skip


def _calc_distance(obj: GridObject, a: np.ndarray, b: np.ndarray) -> float:
    """Mean distance of the cells at two poses, m."""
    return float(np.linalg.norm(obj.cells_at(a) - obj.cells_at(b), axis=1).mean())

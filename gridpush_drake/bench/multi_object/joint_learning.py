"""The learning part of `gridpush bench scene`: objects of hidden masses, learned together.

Rows of objects are pushed at one end, so that each push moves all of them. From some of the pushes,
seen with noise, all objects are learned (`identify`); others are held out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridpush_drake.bench.multi_object.scene_rows import (
    PAIR_FRICTION,
    draw_params,
    draw_row,
    load_objects,
    make_mujoco_scene,
)
from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.multi_object.joint_fit import JointEnsemble, calc_end_errors
from gridpush_drake.identification.multi_object.joint_result import JointIdentification
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.table import Table, mean_of
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

TRAINING = 6
"""Number of pushes that are learned from."""

HELD_OUT = 4
"""Number of pushes that are held out."""

OBSERVED = 6
"""Number of poses that are seen of each push after the first one."""

NOISE = (5e-4, 5e-4, 3e-3)
"""Standard deviations of seen poses, m, m and rad."""

MODEL_NOISE = {"model": NOISE, "mujoco": (2e-3, 2e-3, 1.5e-2)}
"""What poses are expected to be off from their predictions in each world, m, m and rad."""

INTERVAL = 1.96
"""Half the width of a 95 % interval, in standard deviations."""

SEEDS = 1000
"""Distance of the seeds of two sets of pushes."""


@dataclass(frozen=True)
class LearnJob:
    """One set of hidden masses.

    Attributes:
        count: number of objects.
        seed: seed of masses, pushes and noise.
        world: "model", or "mujoco" with bodies that bear their own weight.
    """

    count: int
    seed: int
    world: str


@dataclass(frozen=True)
class LearnScore:
    """How well the models of several objects predict pushes that they were not learned from.

    Attributes:
        count: number of objects.
        world: where the pushes were made.
        even: mean cell error of the even objects on held-out pushes, m.
        learned: that of the learned ones, m.
        true: that of the model with the true masses and frictions, m: next to nothing in the
            model's own world, and in MuJoCo's what nothing that is learned can do away with.
        held: fraction of the 95 % intervals that hold: of the objects' loads beside each other, of
            the centers of friction, and of the pairs' friction.
    """

    count: int
    world: str
    even: float
    learned: float
    true: float
    held: float


def run_learn_job(job: LearnJob) -> LearnScore:
    """Pushes objects of hidden masses, learns them, and predicts other pushes."""
    objects = load_objects(job.count)
    truth = draw_params(objects, job.seed)
    rng = np.random.default_rng((job.seed, 7))
    seen = []
    for i in range(TRAINING + HELD_OUT):
        true, begin, push = draw_row(objects, SEEDS * job.seed + i, truth)
        noise = NOISE if i < TRAINING else (0.0, 0.0, 0.0)
        seen.append(_observe(f"push {i}", true, begin, push, job.world, noise, rng))
    names = tuple(f"object {b}" for b in range(job.count))
    log = PushLog(tuple(seen[:TRAINING]), names=names)
    found = identify(Model(objects), log, JointEnsemble(MODEL_NOISE[job.world]))
    return LearnScore(
        count=job.count,
        world=job.world,
        even=float(calc_end_errors(Model(objects), seen[TRAINING:]).mean()),
        learned=float(calc_end_errors(found, seen[TRAINING:]).mean()),
        true=float(calc_end_errors(true, seen[TRAINING:]).mean()),
        held=_calc_held(found, truth),
    )


def _observe(
    name: str,
    bodies: Bodies,
    begin: Array,
    push: Push,
    world: str,
    noise: tuple[float, float, float],
    rng: np.random.Generator,
) -> ObservedPush:
    """Makes a push in a world, and sees the objects with noise."""
    times = push.duration * np.arange(1, OBSERVED + 1) / OBSERVED
    if world == "mujoco":
        poses = make_mujoco_scene(bodies, begin, push)(times)
    else:
        steps = round(push.length / 1e-3 / OBSERVED) * OBSERVED
        motion = simulate(bodies, push, begin, times=np.linspace(0, push.duration, steps + 1))
        poses = motion.poses[steps // OBSERVED :: steps // OBSERVED]
    drawn = poses + rng.normal(size=poses.shape) * noise
    return ObservedPush(name, push, begin, times, drawn)


def _calc_held(found: JointIdentification, truth: Sequence[CellParameters]) -> float:
    """Calculates the fraction of the 95 % intervals that hold what is true."""
    offs: list[float] = []
    n = len(truth)
    for b in range(1, n):
        ratio, std = found.calc_load_ratio(b, 0)
        true_loads = [float(truth[each].mass @ truth[each].friction) for each in (b, 0)]
        offs.append((ratio - np.log(true_loads[0] / true_loads[1])) / std)
    for b, params in enumerate(truth):
        center, covariance = found.calc_center(b)
        true_center: Array = params.relative_friction() @ found.objects[b].p_BC
        offs.extend((center - true_center) / np.sqrt(np.diag(covariance)))
    i, j = np.triu_indices(n, 1)
    friction = np.log(found.pair_friction[i, j] / PAIR_FRICTION)
    offs.extend(friction / found.calc_pair_friction_std())
    return float(np.mean(np.abs(offs) <= INTERVAL))


def make_learn_table(scores: Sequence[LearnScore]) -> Table:
    """Sums up the scores by world and number of objects."""
    keys = sorted({(score.world, score.count) for score in scores})
    groups = [
        (key, [score for score in scores if (score.world, score.count) == key]) for key in keys
    ]
    columns = {
        "sets": len,
        "even, mm": mean_of("even", MM_PER_M),
        "learned, mm": mean_of("learned", MM_PER_M),
        "true, mm": mean_of("true", MM_PER_M),
        "intervals, %": mean_of("held", PERCENT_PER_ONE),
    }
    notes = (
        f"Mean cell error of {HELD_OUT} held-out pushes, learned from {TRAINING} pushes that all "
        "move all objects; poses seen with 0.5 mm and 3 mrad of noise.",
        "True: the model with the true masses and frictions, which its own world follows exactly.",
        "Intervals: how many of the 95 % intervals hold, of loads beside each other, centers of "
        "friction and the objects' friction on each other.",
    )
    return Table.of("Objects learned together", ("world", "objects"), groups, columns, notes)

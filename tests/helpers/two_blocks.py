"""Two blocks, each heavy at one end, that push each other, or lie far apart; and what is seen of them."""

from dataclasses import replace

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.observed_push import ObservedPush
from tests.helpers.scene_cases import Layout
from tests.helpers.shapes import rectangle

PAIR_FRICTION = 0.25
NOISE = (2e-4, 2e-4, 2e-3)
RADIUS = 0.008
LENGTH = 0.08


def make_truth():
    """Two blocks, of which one end is heavy, and the second one twice as heavy as the first."""
    bodies = []
    for b, (heavy, total) in enumerate(((1.0, 0.4), (-1.0, 0.8))):
        obj = GridObject.from_outline(rectangle(0.10, 0.05), max_cells=18, name=f"block {b}")
        mass = np.where(heavy * obj.p_BC[:, 0] > 0.015, 6.0, 1.0)
        params = CellParameters(total * mass / mass.sum(), np.full(obj.n, 0.35), 0.3)
        bodies.append((obj, params, (0.106 * b, 0.0, 0.0)))
    return Layout.of(bodies, PAIR_FRICTION)


def push_scene(truth, seed, noise=NOISE):
    """A push of the first block into the second, or of the second into the first, seen with noise."""
    rng = np.random.default_rng(seed)
    side = -1.0 if seed % 2 else 1.0
    spread = rng.uniform(-0.2, 0.2, 2)
    poses = truth.poses + rng.uniform(-1, 1, (2, 3)) * (0.0, 0.012, 0.0)
    middle = 0.053
    place = poses[0 if side > 0 else 1, 1] + rng.uniform(-0.018, 0.018)
    start = (middle - side * (0.103 + RADIUS + 1e-3), place)
    push = Push(start, np.array([side, 0.3 * spread[0]]) * 0.04, LENGTH / 0.04, RADIUS)
    scene = truth.with_poses(poses)
    motion = scene.simulate(push)
    times = np.linspace(0, push.duration, 7)[1:]
    rows = np.searchsorted(motion.times, times - 1e-9)
    seen = motion.poses[rows] + rng.normal(size=(6, 2, 3)) * noise
    return ObservedPush(f"push {seed}", push, poses, motion.times[rows], seen)


def push_apart(truth, seed, noise=NOISE, with_force=False):
    """A push of one of two blocks that lie far apart, perhaps with its force."""
    rng = np.random.default_rng(seed)
    poses = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, 0.0]])
    body = seed % 2
    start = poses[body, :2] + (-0.05 - RADIUS - 1e-3, rng.uniform(-0.018, 0.018))
    push = Push(start, (0.04, 0.0), LENGTH / 0.04, RADIUS)
    motion = truth.with_poses(poses).simulate(push)
    rows = np.searchsorted(motion.times, np.linspace(0, push.duration, 7)[1:] - 1e-9)
    seen = motion.poses[rows] + rng.normal(size=(6, 2, 3)) * noise
    made = ObservedPush(f"push {seed}", push, poses, motion.times[rows], seen)
    if not with_force:
        return made
    force = motion.calc_net_forces().sum(axis=1)
    return replace(made, force_t=motion.times[1:], force=force + rng.normal(0, 0.05, force.shape))

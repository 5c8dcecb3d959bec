"""Several objects learned together, from pushes in which they push each other."""

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.scene.bodies import Scene, SceneBody
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.errors import IdentificationError
from gridpush_drake.identification.prediction import calc_pose_error
from gridpush_drake.identification.scene_learning import identify_scene
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.scene_log import ObservedScenePush, SceneLog
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
        bodies.append(SceneBody(obj, params, (0.106 * b, 0.0, 0.0)))
    return Scene(bodies, PAIR_FRICTION)


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
    motion = simulate_scene(scene, push)
    times = np.linspace(0, push.duration, 7)[1:]
    rows = np.searchsorted(motion.times, times - 1e-9)
    seen = motion.poses[rows] + rng.normal(size=(6, 2, 3)) * noise
    return ObservedScenePush(f"push {seed}", push, poses, motion.times[rows], seen)


def calc_errors(scene, pushes):
    """Mean cell error of each held-out push, m."""
    errors = []
    for seen in pushes:
        moved = scene.with_poses(seen.poses)
        last = simulate_scene(moved, seen.push).final_poses
        for obj, mine, theirs in zip(scene.objects, last, seen.poses_observed[-1], strict=True):
            errors.append(calc_pose_error(obj, mine, theirs).cell)
    return np.array(errors)


def test_two_objects_are_learned_together():
    truth = make_truth()
    log = SceneLog(tuple(push_scene(truth, seed) for seed in range(6)), ("block 0", "block 1"))
    held_out = [push_scene(truth, seed, noise=0.0) for seed in range(100, 106)]
    found = identify_scene(truth.objects, log, noise=NOISE, amplitudes=(0.3, 0.7))
    even = Scene(
        [
            SceneBody(obj, CellParameters.uniform(obj), pose)
            for obj, pose in zip(truth.objects, truth.poses, strict=True)
        ]
    )
    learned = calc_errors(found.scene, held_out)
    before = calc_errors(even, held_out)
    print(f"cell error {1e3 * before.mean():.2f} mm, learned {1e3 * learned.mean():.2f} mm")
    assert learned.mean() < 2.5e-3
    assert learned.mean() < before.mean() / 3
    assert found.noise_scale < 2.0

    # What was hidden is where the posterior says that it may be.
    ratio, std = found.calc_load_ratio(1, 0)
    assert abs(ratio - np.log(2)) < 4 * std
    assert std < 0.3
    for b in range(2):
        center, covariance = found.calc_center(b)
        true_center = truth.params[b].relative_friction() @ truth.objects[b].p_BC
        off = center - true_center
        assert off @ np.linalg.solve(covariance, off) < 16
        assert np.sqrt(covariance[0, 0]) < 0.01
    i, j = np.triu_indices(2, 1)
    off = np.log(found.scene.pair_friction[i, j] / PAIR_FRICTION)
    assert (np.abs(off) < 4 * found.calc_pair_friction_std()).all()


def test_what_is_refused():
    truth = make_truth()
    log = SceneLog((push_scene(truth, 0),), ("block 0", "block 1"))
    with pytest.raises(IdentificationError, match="holds no push"):
        identify_scene(truth.objects, SceneLog((), ()))
    with pytest.raises(IdentificationError, match=r"of 2 objects .* expected 1"):
        identify_scene(truth.objects[:1], log)
    with pytest.raises(IdentificationError, match="noise"):
        identify_scene(truth.objects, log, noise=(0.0, 1.0, 1.0))

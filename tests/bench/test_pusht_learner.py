"""Learning a block's center of friction and arm from how it moves."""

import numpy as np
import pytest

from gridpush_drake.bench.pusht.block_learner import BlockLearner, BlockLearnerOptions
from gridpush_drake.bench.pusht.experiments import make_block
from tests.helpers.pusht import TRUE, make_world


def push_here_and_there(learner, world, decisions=12, noise=0.0, seed=0):
    """Pushes the block's long face at random places along it."""
    rng = np.random.default_rng(seed)
    for _ in range(decisions):
        before = np.concatenate([world.disc, world.velocity])
        pose = world.pose
        aim = pose[:2] + rng.uniform([-40.0, 20.0], [40.0, 90.0])
        world.step(aim)
        learner.add(before, pose, aim, world.pose + rng.normal(0.0, [noise, noise, noise / 44.0]))


def calc_error(learner):
    estimate = learner.estimate
    center = np.hypot(estimate.center_x - TRUE.center_x, estimate.center_y - TRUE.center_y)
    return center, abs(np.log(estimate.arm / TRUE.arm))


def test_it_finds_the_true_block():
    learner = BlockLearner(make_block())
    first = calc_error(learner)
    push_here_and_there(learner, make_world([250.0, 200.0], [256.0, 236.0, 0.0]))
    center, arm = calc_error(learner)
    assert first[0] > 10.0
    assert center < 0.05
    assert arm < 0.002


def test_noise_is_averaged_and_the_spread_tells_of_it():
    options = BlockLearnerOptions(noise=0.3 / make_block().gyration_radius)
    errors = []
    for seed in range(12):
        learner = BlockLearner(make_block(), options)
        world = make_world([250.0, 200.0], [256.0, 236.0, 0.0])
        push_here_and_there(learner, world, noise=0.3, seed=seed)
        z = np.array(
            [learner.estimate.center_x, learner.estimate.center_y, np.log(learner.estimate.arm)]
        )
        off = z - [TRUE.center_x, TRUE.center_y, np.log(TRUE.arm)]
        errors.append(off @ np.linalg.solve(learner.covariance, off))
    # of three unknowns, the mean is 3 where the spread is right
    assert 1.0 < np.mean(errors) < 9.0


def test_a_decision_without_motion_says_nothing():
    learner = BlockLearner(make_block())
    before = learner.estimate
    pose = np.array([256.0, 236.0, 0.0])
    assert not learner.add(np.array([100.0, 100.0, 0.0, 0.0]), pose, np.zeros(2), pose)
    assert learner.estimate is before


def test_decisions_at_a_wall_and_inside_the_block_are_left_out():
    learner = BlockLearner(make_block())
    moved = np.array([1.0, 0.0, 0.01])
    at_wall = np.array([256.0, 8.0, 0.0])
    assert not learner.add(np.array([256.0, 60.0, 0, 0]), at_wall, np.zeros(2), at_wall + moved)
    middle = np.array([256.0, 236.0, 0.0])
    assert not learner.add(np.array([256.0, 250.0, 0, 0]), middle, np.zeros(2), middle + moved)
    assert learner.add(
        np.array([256.0, 221.5, 0, 50.0]), middle, np.array([256.0, 300.0]), middle + moved
    )


def test_one_wrong_pose_does_not_lead_it_astray():
    learner = BlockLearner(make_block())
    world = make_world([250.0, 200.0], [256.0, 236.0, 0.0])
    push_here_and_there(learner, world, 6)
    before = np.concatenate([world.disc, world.velocity])
    pose = world.pose
    world.step(pose[:2] + [10.0, 60.0])
    learner.add(before, pose, pose[:2] + [10.0, 60.0], world.pose + [9.0, -7.0, 0.3])
    push_here_and_there(learner, world, 6, seed=1)
    center, arm = calc_error(learner)
    assert center < 1.0
    assert arm < 0.03


def test_an_angle_that_jumps_by_a_turn_is_the_same_angle():
    estimates = []
    for jump in (0.0, 2.0 * np.pi):
        learner = BlockLearner(make_block())
        world = make_world([230.0, 200.0], [256.0, 236.0, 0.0])
        for _ in range(6):
            before = np.concatenate([world.disc, world.velocity])
            pose = world.pose
            world.step([235.0, 300.0])
            learner.add(before, pose, np.array([235.0, 300.0]), world.pose + [0.0, 0.0, jump])
        estimates.append(learner.estimate)
    assert estimates[1].center_x == pytest.approx(estimates[0].center_x, abs=1e-6)
    assert estimates[1].arm == pytest.approx(estimates[0].arm, rel=1e-8)

"""Pushing with feedback to a goal."""

import numpy as np
import pytest

from gridpush_drake.bench.pusht.feedback_controller import FeedbackOptions
from gridpush_drake.bench.pusht.sliding_block import BlockEstimate
from gridpush_drake.errors import PlanningError
from tests.helpers.pusht import TRUE, make_controller, make_world, play

START = ([120.0, 400.0], [330.0, 180.0, -2.0])


@pytest.mark.parametrize("start", [START, ([400.0, 90.0], [180.0, 300.0, 1.2])])
def test_an_uneven_block_is_brought_to_its_goal(start):
    controller = make_controller(seed=1)
    decisions, coverages = play(make_world(*start), controller)
    assert coverages[-1] > 0.95
    assert len(decisions) < 60
    assert max(coverages[:-1], default=0.0) <= 0.95
    estimate = controller.learner.estimate
    assert np.hypot(estimate.center_x - TRUE.center_x, estimate.center_y - TRUE.center_y) < 0.5


def test_the_same_seed_decides_the_same():
    targets = []
    for seed in (1, 1, 2):
        world = make_world(*START)
        controller = make_controller(seed=seed)
        run = []
        for _ in range(8):
            run.append(controller.decide(world.disc, world.pose).target)
            world.step(run[-1])
        targets.append(np.array(run))
    np.testing.assert_array_equal(targets[0], targets[1])
    assert np.abs(targets[0] - targets[2]).max() > 1.0


def test_targets_stay_where_the_disc_may_go():
    world = make_world([60.0, 60.0], [180.0, 120.0, 2.0])
    decisions, _ = play(world, make_controller(seed=3), 40)
    targets = np.array([decision.target for decision in decisions])
    assert targets.min() >= 0.0 and targets.max() <= 512.0


def test_a_pose_that_is_missing_for_a_moment_does_not_stop_it():
    world = make_world(*START)
    controller = make_controller(seed=1)
    statuses = []
    for k in range(80):
        pose = None if k % 4 == 3 else world.pose
        decision = controller.decide(world.disc, pose)
        statuses.append(decision.status)
        world.step(decision.target)
        if k > 20 and np.hypot(*(world.pose[:2] - 256.0)) < 3.0:
            break
    assert set(statuses) == {"pushing"}
    assert np.hypot(*(world.pose[:2] - 256.0)) < 3.0


def test_poses_that_never_come_leave_the_disc_at_rest():
    world = make_world(*START)
    controller = make_controller(seed=1)
    for _ in range(3):
        world.step(controller.decide(world.disc, world.pose).target)
    decisions = []
    for _ in range(12):
        decisions.append(controller.decide(world.disc, np.full(3, np.nan)))
        world.step(decisions[-1].target)
    assert [decision.status for decision in decisions[-9:]] == ["no_pose"] * 9
    assert decisions[-1].reason == "no pose of the block came"
    assert np.hypot(*world.velocity) < 0.5
    # and when they come again, it goes on
    assert controller.decide(world.disc, world.pose).status == "pushing"


def test_a_block_that_moves_on_its_own_is_given_up():
    world = make_world(*START)
    controller = make_controller(seed=1)
    rng = np.random.default_rng(0)
    statuses = []
    for _ in range(12):
        # somebody else moves it about
        pose = np.array([*rng.uniform(150, 350, 2), rng.uniform(-3, 3)])
        decision = controller.decide(world.disc, pose)
        statuses.append(decision.status)
        world.step(decision.target)
    assert statuses[0] == "pushing"
    assert statuses[-1] == "unlike_model"
    assert "unlike the model" in decision.reason
    np.testing.assert_array_equal(decision.target, controller.decide(decision.target, pose).target)


def test_a_shove_is_recovered_from():
    world = make_world(*START)
    controller = make_controller(seed=1)
    for _ in range(8):
        world.step(controller.decide(world.disc, world.pose).target)
    world.put(world.pose + [30.0, -25.0, 0.35])
    _, coverages = play(world, controller)
    assert coverages[-1] > 0.95


@pytest.mark.slow
def test_what_the_learned_block_is_worth():
    """With the even block's estimate, and no learning, an uneven block takes longer."""
    steps = {True: [], False: []}
    other = BlockEstimate(center_x=25.0, center_y=45.0, arm=50.0)
    for learns in steps:
        for seed in range(4):
            controller = make_controller(seed=seed)
            if not learns:
                controller.learner.add = lambda *_: False
            rng = np.random.default_rng(seed)
            pose = [*rng.uniform(150, 350, 2), rng.uniform(-3, 3)]
            world = make_world([30.0, 30.0], pose, other)
            steps[learns].append(len(play(world, controller)[0]))
    assert np.mean(steps[True]) < np.mean(steps[False])


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: make_controller().decide([np.nan, 0.0], [0.0, 0.0, 0.0]), "disc"),
        (lambda: FeedbackOptions(strokes=0), "strokes is 0; expected 1 or more"),
        (lambda: FeedbackOptions(success=1.0), "success is 1.0; expected between 0 and 1"),
    ],
)
def test_refuses_bad_input(call, says):
    with pytest.raises(PlanningError, match=says):
        call()

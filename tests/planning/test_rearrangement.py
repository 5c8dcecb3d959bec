"""Objects whose masses are other than believed are brought to goals, those in the way moved aside."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.fit.hypotheses import SmoothField
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.scene.loop import SceneAction, SceneLearning
from gridpush_drake.planning.scene.rearrangement import (
    FINE_OPTIONS,
    RearrangeOptions,
    RearrangePlanner,
)
from gridpush_drake.planning.scene.rollouts import SceneRollouts
from gridpush_drake.planning.scene.rules import SceneRules
from gridpush_drake.planning.scene.search import SceneSearch, SceneSearchOptions
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import PushWorld, SimulatedWorld
from tests.helpers.random_pushes import make_random_contents
from tests.helpers.scene_cases import Layout, make_row, run_task
from tests.helpers.shapes import make_shape

TABLE = SupportSurface.rectangle((0.0, 0.0), (1.2, 1.2))
QUICK = SceneSearchOptions(candidates=24, variations=4, firsts=3, seconds=8, compared=3)
COARSE = RearrangeOptions(search=QUICK)


def make_truth(shapes, poses, seed=0):
    rng = np.random.default_rng(seed)
    bodies = []
    for shape, pose in zip(shapes, poses, strict=True):
        obj = make_shape(shape, 20)
        bodies.append((obj, make_random_contents(rng, obj), pose))
    return Layout.of(bodies, 0.25)


def rearrange(truth, goals, options=COARSE, seed=0, **more):
    world = SimulatedWorld(*truth, TABLE, position_std=0.0005, angle_std=0.003, seed=seed)
    planner = RearrangePlanner(truth.objects, goals, options, SceneRules(TABLE), seed=seed)
    belief = Belief.of_even_objects(truth.objects, sample_count=2, seed=seed)
    return run_task(world, planner, belief, seed=seed, **more), world, planner


def test_objects_are_brought_to_goals():
    truth = make_truth(["square", "bar"], [(0, 0, 0), (0.2, 0.05, 0.4)])
    goals = [(-0.1, 0.15, 0.8), (0.1, -0.2, 0.0)]
    run, world, planner = rearrange(truth, goals)
    assert run.state.done and run.state.last.action is SceneAction.DONE
    assert planner.find_reached(world.truth.pose).all()
    assert len(run.state.poses) == world.pushes == len(run.log)
    assert world.time > 0
    again, *_ = rearrange(truth, goals)
    np.testing.assert_array_equal(again.state.poses, run.state.poses)


@pytest.mark.slow
def test_two_objects_change_places():
    truth = make_truth(["square", "bar"], [(-0.12, 0, 0), (0.12, 0, 0.3)])
    goals = truth.poses[::-1].copy()
    run, world, planner = rearrange(truth, goals)
    assert run.state.done and planner.find_reached(world.truth.pose).all()
    # whoever goes first must not lie in the other's goal for good
    first = planner.choose_targets(truth.poses, [])
    assert first.is_buffered.sum() == 1


def test_threads_choose_the_same_push():
    truth = make_truth(["square", "bar"], [(-0.12, 0, 0), (0.12, 0, 0.3)])
    belief = Belief.of_even_objects(truth.objects)
    chosen = []
    for workers in (1, 2):
        options = RearrangeOptions(search=replace(QUICK, workers=workers))
        planner = RearrangePlanner(
            truth.objects, [(0.1, 0.2, 0.5), (0.3, -0.1, 0)], options, SceneRules(TABLE)
        )
        chosen.append(planner.decide(truth.poses, belief, []))
    assert chosen[0].body == chosen[1].body
    np.testing.assert_array_equal(chosen[0].push.xy, chosen[1].push.xy)
    np.testing.assert_array_equal(chosen[0].expected, chosen[1].expected)


def test_an_object_without_a_goal_is_moved_out_of_one():
    truth = make_truth(["square", "bar"], [(-0.25, 0, 0), (0.0, 0, 0.3)])
    goals = [(0.0, 0.0, 0.0), (np.nan, np.nan, np.nan)]
    run, world, planner = rearrange(truth, goals)
    assert run.state.done and planner.find_reached(world.truth.pose).all()
    assert {step.decision.body for step in run.state.steps} == {0, 1}


def test_fine_goals_are_reached_after_learning():
    truth = make_truth(["square", "bar"], [(0, 0, 0), (0.4, -0.4, 0)], seed=3)
    options = replace(FINE_OPTIONS, search=QUICK)
    learning = SceneLearning(after=(2,), hypotheses=(SmoothField(0.7),))
    goals = [(0.12, 0.1, 1.0), (np.nan, np.nan, np.nan)]
    run, world, planner = rearrange(truth, goals, options, learning=learning)
    distance, turn = planner.calc_errors(world.truth.pose)
    assert (
        run.state.done and run.state.learned[0] == 2 and run.state.belief.identification is not None
    )
    assert distance.max() < 0.006 and turn.max() < np.radians(3.5)


def test_nothing_comes_nearer_to_the_edge_than_it_may():
    truth = make_truth(["bar", "square"], [(0.4, 0.0, 0.0), (0.25, 0.1, 0.0)])
    goals = [(0.4, 0.25, 1.2), (0.1, 0.1, 0.5)]
    run, world, _ = rearrange(truth, goals)
    assert run.state.done and not np.any(world.truth.fallen)
    assert all(TABLE.contains_cells(truth.objects[0], poses[0]) for poses in run.state.poses)


def test_a_fallen_object_ends_the_task_and_is_out_of_the_way():
    truth = make_truth(["square", "bar"], [(0.55, 0.0, 0.0), (0.0, 0.0, 0.0)])
    world = SimulatedWorld(*truth, TABLE)
    assert isinstance(world, PushWorld)
    world.execute(Push((0.45, 0.0), (0.05, 0.0), 4.0, 0.008))
    assert world.truth.fallen.tolist() == [True, False]
    assert world.observe() is None
    before = world.truth.pose[0].copy()
    world.execute(Push((0.45, 0.0), (0.05, 0.0), 4.0, 0.008))
    np.testing.assert_array_equal(world.truth.pose[0], before)


def test_rollouts_are_those_of_the_simulator():
    scene, push = make_row(1, ["square", "bar", "triangle"])
    rollouts = SceneRollouts(scene.bodies, tip_step=0.002)
    rolled = rollouts.roll(push, scene.poses)
    times = np.linspace(0.0, push.duration, len(rolled.traveled))
    motion = scene.simulate(push, times=times)
    np.testing.assert_allclose(rolled.poses, motion.poses, atol=1e-9)
    assert rolled.touched and rolled.solved and rollouts.simulations == 1
    threaded = SceneRollouts(scene.bodies, tip_step=0.002, workers=2).roll_all(
        [push] * 3, scene.poses
    )
    for each in threaded:
        np.testing.assert_array_equal(each.poses, rolled.poses)


def test_a_push_stops_between_the_steps_of_its_simulation():
    truth = make_truth(["square"], [(0, 0, 0)])
    one = replace(QUICK, candidates=1, refined=0, firsts=0, slant=0.1)
    for seed in range(6):
        goal = 0.03 + 0.0005 * seed

        def cost(poses, goal=goal):
            return 1e4 * np.abs(np.hypot(poses[:, 0, 0], poses[:, 0, 1]) - goal)

        search = SceneSearch(Belief.of_parameters(truth.bodies), options=one)
        found = search.find_push(truth.poses, cost, [0], np.random.default_rng(seed))
        last = truth.simulate(found.push).final_pose[0]
        assert abs(np.hypot(*last[:2]) - goal) < 5e-4
        np.testing.assert_allclose(last, found.poses[0], atol=5e-4)


def test_a_good_second_push_is_made_at_once():
    truth = make_truth(["square"], [(0, 0, 0)])
    # one first push is drawn, hardly ever a good one, and many second ones
    few = replace(QUICK, candidates=1, refined=0, firsts=1, seconds=40)

    def cost(poses):
        return 100.0 * np.hypot(poses[:, 0, 0] - 0.06, poses[:, 0, 1] - 0.06)

    search = SceneSearch(Belief.of_parameters(truth.bodies), options=few)
    left = [
        search.find_push(truth.poses, cost, [0], np.random.default_rng(seed)).left
        for seed in range(6)
    ]
    assert np.median(left) < 0.5 * cost(truth.poses[None])[0]


@pytest.mark.slow
def test_draws_surround_what_was_learned():
    truth = make_truth(["square", "bar"], [(0, 0, 0), (0.2, 0.05, 0.4)])
    run, *_ = rearrange(
        truth,
        [(-0.1, 0.15, 0.8), (0.1, -0.2, 0.0)],
        learning=SceneLearning(after=(2,), hypotheses=(SmoothField(0.7),)),
    )
    found = run.state.belief.identification
    assert len(run.state.belief.samples) > 0
    log_ratio = [
        np.log(draw.parameters[0].mass / found.parameters[0].mass)
        for draw in run.state.belief.samples
    ]
    spread = np.sqrt(np.diag(found.covariance)[: truth.objects[0].n])
    assert 0.2 < np.std(log_ratio) / spread.mean() < 3.0


def test_what_is_refused():
    truth = make_truth(["square", "bar"], [(0, 0, 0), (0.3, 0, 0)])
    objects = truth.objects
    with pytest.raises(PlanningError, match=r"that of square and that of bar overlap by"):
        RearrangePlanner(objects, [(0, 0, 0), (0.01, 0, 0)])
    with pytest.raises(PlanningError, match=r"that of bar is nearer to the table's edge"):
        RearrangePlanner(objects, [(0, 0, 0), (0.6, 0, 0)], rules=SceneRules(TABLE))
    with pytest.raises(PlanningError, match=r"shape \(1, 3\)"):
        RearrangePlanner(objects, [(0, 0, 0)])
    with pytest.raises(PlanningError, match="NaN"):
        RearrangePlanner(objects, [(0, 0, 0), (np.nan, 0, 0)])
    with pytest.raises(PlanningError, match="lengths"):
        SceneSearchOptions(lengths=(0.2, 0.1))
    with pytest.raises(PlanningError, match="goal_fraction"):
        RearrangeOptions(goal_fraction=0.0)
    with pytest.raises(PlanningError, match="min_move"):
        SceneLearning(min_move=0.0)
    with pytest.raises(PlanningError, match="position_std"):
        SimulatedWorld(*truth, position_std=-1.0)


def test_an_object_that_no_finger_reaches_is_named_with_what_is_around_it():
    truth = make_truth(["square", "bar"], [(0, 0, 0), (0.3, 0, 0)])
    huge = replace(QUICK, pusher=Pusher(2.0))
    planner = RearrangePlanner(
        truth.objects,
        [(-0.3, 0, 0), (np.nan,) * 3],
        RearrangeOptions(search=huge),
        SceneRules(TABLE),
    )
    belief = Belief.of_even_objects(truth.objects)
    decision = planner.decide(truth.poses, belief, [])
    assert decision.action is SceneAction.FAIL
    assert "square" in decision.reason and "between bar" in decision.reason
    assert CellParameters.uniform(truth.objects[0]).n == truth.objects[0].n

"""Objects that touch are moved apart, though their masses are other than believed."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import Point

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import PlanningError
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.scene.loop import SceneAction
from gridpush_drake.planning.scene.rules import SceneRules, place_outlines
from gridpush_drake.planning.scene.separation import (
    SeparatePlanner,
    SeparationOptions,
    calc_clearances,
    calc_clearances_along,
)
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from tests.helpers.scene_cases import PLATE, make_row, run_task
from tests.helpers.shapes import SHAPES

SEARCH = SeparationOptions().search


@pytest.mark.parametrize("seed", range(3))
def test_objects_are_separated(seed):
    shapes = np.random.default_rng(seed).permutation(list(SHAPES))[:3]
    truth, _ = make_row(seed, shapes, cells=20)
    assert calc_clearances(truth.objects, truth.poses).min() < 0.002
    options = SeparationOptions(search=replace(SEARCH, candidates=25))
    planner = SeparatePlanner(truth.objects, options, seed=seed)
    believed = Belief.of_parameters(Bodies(truth.objects))
    worlds = [SimulatedWorld(*truth) for _ in range(2)]
    first, again = (run_task(world, planner, believed) for world in worlds)
    assert first.state.done
    assert calc_clearances(truth.objects, worlds[0].truth.pose).min() >= options.margin
    np.testing.assert_array_equal(again.state.poses, first.state.poses)


@pytest.mark.parametrize("seed", range(2))
def test_objects_are_separated_by_a_plate_that_comes_down_beside_them(seed):
    shapes = np.random.default_rng(seed).permutation(list(SHAPES))[:3]
    truth, _ = make_row(seed, shapes, cells=20)
    pusher = Pusher(speed=0.05, shape=PLATE)
    options = SeparationOptions(search=replace(SEARCH, candidates=25, pusher=pusher))
    planner = SeparatePlanner(truth.objects, options, seed=seed)
    world = SimulatedWorld(*truth)
    run = run_task(world, planner, Belief.of_parameters(Bodies(truth.objects)))
    assert run.state.done and len(run.log) > 0
    assert calc_clearances(truth.objects, world.truth.pose).min() >= options.margin
    for made in run.log:
        assert made.push.shape is PLATE
        # It looks where it goes, and comes down where nothing lies.
        direction = np.array([np.cos(made.push.yaw[0]), np.sin(made.push.yaw[0])])
        speed = np.linalg.norm(made.push.velocity)
        np.testing.assert_allclose(made.push.velocity, speed * direction, atol=1e-12)
        outlines = place_outlines(truth.objects, made.pose)
        assert shapely.distance(made.push.find_area(0.0), outlines).min() > 0.0


def test_nothing_is_done_where_there_is_room():
    truth, _ = make_row(0, ["square", "bar"], cells=20)
    poses = truth.poses + [[0, 0, 0], [1, 0, 0]]
    planner = SeparatePlanner(truth.objects)
    decision = planner.decide(poses, Belief.of_parameters(truth.bodies), [])
    assert decision.action is SceneAction.DONE and decision.push is None


def test_what_is_refused():
    with pytest.raises(PlanningError, match="margin"):
        SeparationOptions(margin=0.0)
    truth, _ = make_row(0, ["square", "bar"], cells=20)
    # the finger comes to none of them
    far = SceneRules(finger_region=Point(5.0, 5.0).buffer(0.1))
    planner = SeparatePlanner(
        truth.objects, SeparationOptions(search=replace(SEARCH, candidates=4)), far
    )
    decision = planner.decide(truth.poses, Belief.of_parameters(truth.bodies), [])
    assert decision.action is SceneAction.FAIL
    assert "square, bar: no place was found where a finger of 8 mm fits" in decision.reason
    search = replace(SEARCH, candidates=4, pusher=Pusher(shape=PLATE))
    planner = SeparatePlanner(truth.objects, SeparationOptions(search=search), far)
    reason = planner.decide(truth.poses, Belief.of_parameters(truth.bodies), []).reason
    assert "a pusher that reaches 32.9 mm fits beside it" in reason


def test_a_push_apart_is_planned_by_itself():
    truth, _ = make_row(0, ["square", "bar"], cells=20)
    planner = SeparatePlanner(
        truth.objects, SeparationOptions(search=replace(SEARCH, candidates=12)), seed=1
    )
    decision = planner.decide(truth.poses, Belief.of_parameters(truth.bodies), [])
    after = truth.simulate(decision.push).final_pose
    before = calc_clearances(truth.objects, truth.poses).min()
    assert calc_clearances(truth.objects, after).min() > before + 0.01


def test_objects_are_separated_in_a_world_and_stay_on_its_table():
    truth, _ = make_row(5, ["bar", "square", "triangle"], cells=20)
    middle = truth.poses.mean(axis=0) * [1, 1, 0]
    truth = truth.with_poses(truth.poses - middle)
    table = SupportSurface.rectangle((0.0, 0.0), (0.7, 0.7))
    world = SimulatedWorld(*truth, table, position_std=0.0005, angle_std=0.003, seed=2)
    options = SeparationOptions(search=replace(SEARCH, candidates=12))
    planner = SeparatePlanner(truth.objects, options, SceneRules(table), seed=2)
    belief = Belief.of_even_objects(truth.objects, sample_count=2)
    run = run_task(world, planner, belief, seed=2)
    assert run.state.done and run.state.last.action is SceneAction.DONE
    assert calc_clearances(truth.objects, world.truth.pose).min() > options.margin - 0.003
    assert not np.any(world.truth.fallen)
    for obj, pose in zip(truth.objects, world.truth.pose, strict=True):
        assert table.contains_cells(obj, pose, 0.01)


def test_the_room_along_a_push_is_that_of_each_state():
    truth, _ = make_row(1, ["bar", "square", "triangle"], cells=20)
    states = np.array([truth.poses, truth.poses * [2.0, 1.0, 1.0]])
    along = calc_clearances_along(truth.objects, states)
    each = [calc_clearances(truth.objects, state) for state in states]
    np.testing.assert_allclose(along, each, atol=1e-12)

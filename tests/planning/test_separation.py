"""Objects that touch are moved apart, though their masses are other than believed."""

import numpy as np
import pytest
from shapely import Point

from gridpush_drake.dynamics.scene.bodies import Scene, SceneBody
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.errors import PlanningError
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.scene.belief import SceneBelief
from gridpush_drake.planning.scene.loop import SceneAction, run_scene_task
from gridpush_drake.planning.scene.rules import SceneRules
from gridpush_drake.planning.scene.separation import (
    SeparatePlanner,
    SeparationOptions,
    calc_clearances,
    calc_clearances_along,
    plan_separating_push,
    separate,
)
from gridpush_drake.planning.scene.world import SimulatedSceneWorld
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.scene_cases import make_row
from tests.helpers.shapes import SHAPES


@pytest.mark.parametrize("seed", range(3))
def test_objects_are_separated(seed):
    shapes = np.random.default_rng(seed).permutation(list(SHAPES))[:3]
    truth, _ = make_row(seed, shapes, cells=20)
    assert calc_clearances(truth.objects, truth.poses).min() < 0.002
    believed = Scene(
        [
            SceneBody(obj, CellParameters.uniform(obj), pose)
            for obj, pose in zip(truth.objects, truth.poses, strict=True)
        ]
    )

    def execute(push, poses):
        motion = simulate_scene(truth.with_poses(poses, may_overlap=True), push)
        return motion.final_poses

    options = SeparationOptions(candidates=25)
    found = separate(believed, execute, options, seed=seed)
    print(f"{len(found.pushes)} pushes, clearances {np.round(1e3 * found.clearances[-1])} mm")
    assert found.done
    assert found.clearances[-1].min() >= options.margin
    assert len(found.poses) == len(found.pushes) + 1
    again = separate(believed, execute, options, seed=seed)
    np.testing.assert_array_equal(again.poses, found.poses)


def test_nothing_is_done_where_there_is_room():
    truth, _ = make_row(0, ["square", "bar"], cells=20)
    poses = truth.poses + [[0, 0, 0], [1, 0, 0]]

    def execute(push, poses):
        raise AssertionError

    found = separate(truth.with_poses(poses), execute)
    assert found.done and found.pushes == ()


def test_what_is_refused():
    with pytest.raises(PlanningError, match="margin"):
        SeparationOptions(margin=0.0)
    with pytest.raises(PlanningError, match="lengths"):
        SeparationOptions(lengths=(0.2, 0.1))
    truth, _ = make_row(0, ["square", "bar"], cells=20)
    # the finger comes to none of them
    far = SceneRules(finger_region=Point(5.0, 5.0).buffer(0.1))
    planner = SeparatePlanner(truth.objects, SeparationOptions(candidates=4), far)
    decision = planner.decide(truth.poses, SceneBelief.of_truth(truth), [])
    assert decision.action is SceneAction.FAIL
    assert "square, bar: no place was found where a finger of 8 mm fits" in decision.reason


def test_a_push_apart_is_planned_by_itself():
    truth, _ = make_row(0, ["square", "bar"], cells=20)
    push = plan_separating_push(truth, SeparationOptions(candidates=12), np.random.default_rng(1))
    after = simulate_scene(truth, push).final_poses
    before = calc_clearances(truth.objects, truth.poses).min()
    assert calc_clearances(truth.objects, after).min() > before + 0.01


def test_objects_are_separated_in_a_world_and_stay_on_its_table():
    truth, _ = make_row(5, ["bar", "square", "triangle"], cells=20)
    middle = truth.poses.mean(axis=0) * [1, 1, 0]
    truth = truth.with_poses(truth.poses - middle)
    table = SupportSurface.rectangle((0.0, 0.0), (0.7, 0.7))
    world = SimulatedSceneWorld(truth, table, position_std=0.0005, angle_std=0.003, seed=2)
    options = SeparationOptions(candidates=12)
    planner = SeparatePlanner(truth.objects, options, SceneRules(table), seed=2)
    belief = SceneBelief.of_prior(truth.objects, truth.poses, draws=2)
    run = run_scene_task(world, planner, belief, seed=2)
    assert run.done and run.last.action is SceneAction.DONE
    assert calc_clearances(truth.objects, world.truth.poses).min() > options.margin - 0.003
    assert not any(world.truth.fallen)
    for obj, pose in zip(truth.objects, world.truth.poses, strict=True):
        assert table.contains_cells(obj, pose, 0.01)


def test_the_room_along_a_push_is_that_of_each_state():
    truth, _ = make_row(1, ["bar", "square", "triangle"], cells=20)
    states = np.array([truth.poses, truth.poses * [2.0, 1.0, 1.0]])
    along = calc_clearances_along(truth.objects, states)
    each = [calc_clearances(truth.objects, state) for state in states]
    np.testing.assert_allclose(along, each, atol=1e-12)

"""Objects that touch are moved apart, though their masses are other than believed."""

import numpy as np
import pytest

from gridpush_drake.dynamics.scene.bodies import Scene, SceneBody
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.errors import PlanningError
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.scene.separation import (
    SeparationOptions,
    calc_clearances,
    plan_separating_push,
    separate,
)
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
    huge = SeparationOptions(radius=0.05, candidates=1)
    rng = np.random.default_rng(1)
    around = truth.with_poses(truth.poses)
    for _ in range(20):
        try:
            plan_separating_push(around, huge, rng)
        except PlanningError as error:
            assert "square, bar" in str(error)
            return
    pytest.fail("so large a pusher fits everywhere")

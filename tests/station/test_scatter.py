"""Objects that lie elsewhere with every seed: a scenario's `scatter`."""

import numpy as np
import pytest
import shapely

from gridpush_drake import PushScenario, read_scenario
from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.scene.scatter import MIN_EDGE_DISTANCE, MIN_OBJECT_GAP, scatter_objects
from gridpush_drake.station.schema.scenario import PostConfig


def list_poses(scenario):
    return np.array([scenario.object_pose, *(other.pose for other in scenario.others)])


@pytest.fixture(scope="module")
def scene():
    resolved = resolve(read_scenario("fetch_three"))
    return resolved.obj, resolved.others, resolved.table_top


def test_objects_lie_beside_each_other_elsewhere_with_every_seed(scene):
    obj, others, table = scene
    drawn = []
    for seed in range(40):
        scenario = read_scenario("fetch_three")
        scenario.seed = seed
        scenario.posts = [PostConfig(position=[0.62, -0.22], radius=0.01)]
        post = shapely.Point(0.62, -0.22).buffer(0.01)
        moved = scatter_objects(scenario, obj, others, table)
        poses = list_poses(moved)
        off = np.abs(poses - list_poses(scenario))
        assert off[:, :2].max() <= 0.04 and off[:, 2].max() <= 0.6
        outlines = [
            transform_shape(pose, each.outline)
            for pose, each in zip(poses, (obj, *others), strict=True)
        ]
        apart = [a.distance(b) for k, a in enumerate(outlines) for b in [*outlines[:k], post]]
        assert min(apart) >= MIN_OBJECT_GAP
        assert all(table.buffer(1e-9 - MIN_EDGE_DISTANCE).covers(outline) for outline in outlines)
        drawn.append(poses)
        # the same seed draws the same again, and what is drawn stays where it lies
        again = scatter_objects(scenario, obj, others, table)
        np.testing.assert_array_equal(list_poses(again), poses)
        assert scatter_objects(moved, obj, others, table) is moved
    # all of the range is used
    spread = np.ptp(drawn, axis=0)
    assert spread[:, :2].min() > 0.05 and spread[:, 2].min() > 0.8


def test_a_resolved_scenario_has_the_drawn_poses_and_draws_no_others():
    scenario = read_scenario("fetch_two")
    resolved = resolve(scenario)
    moved = list_poses(resolved.scenario)
    assert np.abs(moved - list_poses(scenario))[:, :2].max() > 1e-3
    np.testing.assert_array_equal(list_poses(resolve(resolved.scenario).scenario), moved)


def test_without_scatter_objects_lie_where_the_scenario_has_them():
    scenario = read_scenario("fetch")
    assert resolve(scenario).scenario is scenario


def test_where_there_is_no_room_the_object_is_named():
    scenario = PushScenario(
        object="open_book",
        object_pose=[0.6, 0.0, 0.0],
        others=[{"object": "pliers", "pose": [0.6, 0.0, 0.0]}],
        scatter={"distance": 0.01},
    )
    with pytest.raises(ScenarioError, match=r"scatter: no place was found for pliers near others"):
        resolve(scenario)


def test_a_negative_scatter_is_refused():
    with pytest.raises(ScenarioError, match=r"scatter.turn is -1.0; expected"):
        PushScenario(scatter={"turn": -1.0})

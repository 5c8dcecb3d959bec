"""Predictions of where a push takes an object that is not seen."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.tracking.pose_prediction import (
    PosePrediction,
    PushModel,
    ScenePrediction,
    ScenePushModel,
    Tip,
    predict_pose,
    predict_scene_poses,
)
from tests.helpers.scene_cases import PLATE, Layout

OBJ = GridObject.from_outline(shapely.box(-0.06, -0.03, 0.06, 0.03), max_cells=20)
PARAMS = CellParameters.uniform(OBJ)
MODEL = PushModel(OBJ, top=0.03, radius=0.006)
START = np.array([0.1, -0.05, 0.4])
BEGIN = PosePrediction(last_seen=START, pose=START)


def go(path, z=0.01, before=BEGIN, dt=0.1):
    """Predicts along a path (K, 2) of the tip, from picture to picture."""
    tips = [Tip(dt * k, np.array([*place, z])) for k, place in enumerate(path)]
    for last, now in pairwise(tips):
        before = predict_pose(before, MODEL, lambda: PARAMS, last, now)
    return before


def make_path(count=12):
    start = START[:2] + [-0.055, -0.065]
    return start + np.linspace(0, 1, count)[:, None] * [0.01, 0.09]


def test_a_prediction_in_steps_is_that_of_one_push():
    path = make_path()
    found = go(path)
    whole = simulate(Model(OBJ, PARAMS), Push.along(0.1 * np.arange(len(path)), path, 0.006), START)
    assert np.abs(whole.final_pose - START).max() > 0.05
    np.testing.assert_allclose(found.pose, whole.final_pose, atol=2e-3)
    expected = found.expect()
    np.testing.assert_array_equal(expected.pose, found.pose)
    way = np.linalg.norm(found.pose[:2] - START[:2])
    assert expected.place_deviation == pytest.approx(max(0.005, 0.3 * way))


def test_a_shape_is_predicted_with_its_front_where_it_moves():
    path = make_path(2)
    model = replace(MODEL, shape=PLATE, radius=PLATE.reach)
    last, now = (
        Tip(t, np.array([*place, 0.01])) for t, place in zip((0.0, 1.0), path, strict=True)
    )
    found = predict_pose(BEGIN, model, lambda: PARAMS, last, now)
    x, y = path[1] - path[0]
    push = Push.along([0.0, 1.0], path, shape=PLATE, yaw=np.arctan2(y, x))
    expected = simulate(Model(OBJ, PARAMS), push, START, regime="quasi_static").final_pose
    assert np.abs(expected - go(path).pose).max() > 1e-3
    np.testing.assert_array_equal(found.pose, expected)


def test_a_tip_above_the_object_or_beside_it_says_nothing():
    for path, z in ((make_path(), 0.05), (make_path() + [0.5, 0.0], 0.01)):
        found = go(path, z)
        np.testing.assert_array_equal(found.pose, START)
        assert found.known
        assert found.expect() is None


def test_what_the_model_cannot_follow_is_not_predicted_any_more():
    pushed = go(make_path())
    assert pushed.expect() is not None
    gone = predict_pose(
        pushed, MODEL, lambda: PARAMS, Tip(0.0, np.zeros(3)), Tip(0.1, np.full(3, np.nan))
    )
    assert gone.expect() is None
    # nor is what the tip is in the middle of
    inside = go([START[:2], START[:2] + [0.01, 0.0]])
    assert inside.expect() is None
    assert replace(pushed, known=False).expect() is None


BLOCK = GridObject.from_outline(shapely.box(-0.02, -0.02, 0.02, 0.02), max_cells=16)
SCENE = Layout.of(
    [(OBJ, PARAMS, START), (BLOCK, CellParameters.uniform(BLOCK), (0.04, -0.02, 0.4))]
)
SCENE_MODEL = ScenePushModel(SCENE.bodies, top=0.03, radius=0.006)
SCENE_BEGIN = ScenePrediction(SCENE.poses, SCENE.poses, np.ones(2, dtype=bool))


def test_what_is_pushed_through_another_object_is_predicted_too():
    path = make_path()
    found = SCENE_BEGIN
    tips = [Tip(0.1 * k, np.array([*place, 0.01])) for k, place in enumerate(path)]
    for last, now in pairwise(tips):
        found = predict_scene_poses(found, SCENE_MODEL, last, now)
    whole = SCENE.simulate(Push.along(0.1 * np.arange(len(path)), path, 0.006))
    moved = np.linalg.norm(whole.poses[-1, :, :2] - SCENE.poses[:, :2], axis=1)
    assert moved.min() > 0.01
    np.testing.assert_allclose(found.poses[:, :2], whole.poses[-1, :, :2], atol=1e-3)
    np.testing.assert_allclose(found.poses[:, 2], whole.poses[-1, :, 2], atol=0.01)
    expected = found.expect()
    np.testing.assert_array_equal(expected[1].pose, found.poses[1])
    assert expected[1].place_deviation == pytest.approx(max(0.005, 0.3 * moved[1]), rel=0.1)

    # one of them is seen again: it is expected nowhere else, and the other one still is
    seen = np.array([[0.1, 0.0, 0.4], [np.nan] * 3])
    again = found.see(seen)
    np.testing.assert_array_equal(again.poses, [seen[0], found.poses[1]])
    assert again.expect()[0] is None
    np.testing.assert_array_equal(again.expect()[1].pose, found.poses[1])


def test_with_an_unknown_tip_nothing_is_predicted_until_objects_are_seen():
    tips = [Tip(0.0, np.zeros(3)), Tip(0.1, np.full(3, np.nan))]
    gone = predict_scene_poses(SCENE_BEGIN, SCENE_MODEL, *tips)
    assert not gone.known.any()
    assert gone.expect() == (None, None)
    seen = np.array([SCENE.poses[0], [np.nan] * 3])
    np.testing.assert_array_equal(gone.see(seen).known, [True, False])
    # above all objects nothing is pushed
    high = [Tip(0.1 * k, np.array([*place, 0.05])) for k, place in enumerate(make_path())]
    assert predict_scene_poses(SCENE_BEGIN, SCENE_MODEL, high[0], high[-1]) is SCENE_BEGIN

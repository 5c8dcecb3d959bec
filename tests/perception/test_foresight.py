"""Where a push takes an object that is not seen."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.foresight import Foresight, PushModel, Tip, foresee

OBJ = GridObject.from_outline(shapely.box(-0.06, -0.03, 0.06, 0.03), max_cells=20)
PARAMS = CellParameters.uniform(OBJ)
MODEL = PushModel(OBJ, top=0.03, radius=0.006)
START = np.array([0.1, -0.05, 0.4])
BEGIN = Foresight(told=START, pose=START)


def go(path, z=0.01, before=BEGIN, dt=0.1):
    """Foretells along a path (K, 2) of the tip, from picture to picture."""
    tips = [Tip(dt * k, np.array([*place, z])) for k, place in enumerate(path)]
    for last, now in pairwise(tips):
        before = foresee(before, MODEL, lambda: PARAMS, last, now)
    return before


def make_path(count=12):
    start = START[:2] + [-0.055, -0.065]
    return start + np.linspace(0, 1, count)[:, None] * [0.01, 0.09]


def test_in_steps_it_foretells_what_the_model_does_in_one_push():
    path = make_path()
    found = go(path)
    whole = simulate(OBJ, PARAMS, Push.along(0.1 * np.arange(len(path)), path, 0.006), START)
    assert np.abs(whole.final_pose - START).max() > 0.05
    np.testing.assert_allclose(found.pose, whole.final_pose, atol=2e-3)
    expected = found.expect()
    np.testing.assert_array_equal(expected.pose, found.pose)
    way = np.linalg.norm(found.pose[:2] - START[:2])
    assert expected.place_deviation == pytest.approx(max(0.005, 0.3 * way))


def test_a_tip_above_the_object_or_beside_it_says_nothing():
    for path, z in ((make_path(), 0.05), (make_path() + [0.5, 0.0], 0.01)):
        found = go(path, z)
        np.testing.assert_array_equal(found.pose, START)
        assert found.known
        assert found.expect() is None


def test_what_it_cannot_follow_is_not_foretold_any_more():
    pushed = go(make_path())
    assert pushed.expect() is not None
    gone = foresee(
        pushed, MODEL, lambda: PARAMS, Tip(0.0, np.zeros(3)), Tip(0.1, np.full(3, np.nan))
    )
    assert gone.expect() is None
    # nor is what the tip is in the middle of
    inside = go([START[:2], START[:2] + [0.01, 0.0]])
    assert inside.expect() is None
    assert replace(pushed, known=False).expect() is None

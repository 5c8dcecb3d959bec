"""What both searches for plans share: windows, shifts, cuts, and where a stroke begins."""

import numpy as np
import pytest
from shapely.geometry import box

from gridpush_drake.dynamics.kernels.steering.plan_search import (
    ANGLE,
    CHANGE_POINTS,
    END_DECISIONS,
    PLACE,
    PRIMITIVE_SIZE,
    ROUND,
    Plan,
    aim_primitive,
    begin_window,
    find_cut,
    keep_plan,
    shift_places,
    take_plan,
    walk_to_aim,
)
from gridpush_drake.planning.feedback.ways import make_outline_path

RADIUS = 0.01


@pytest.fixture(scope="module")
def ways():
    return make_outline_path(box(-0.05, -0.03, 0.05, 0.03), RADIUS)


def make_primitive(**fields):
    primitive = np.zeros(PRIMITIVE_SIZE)
    primitive[PLACE] = fields.get("place", 0.3)
    primitive[ANGLE] = fields.get("angle", 0.2)
    primitive[ROUND] = 1.0
    return primitive


def test_a_candidate_that_is_kept_and_taken_again_is_the_same():
    rng = np.random.default_rng(0)
    made = Plan(targets=rng.normal(size=(5, 2)), states=rng.normal(size=(6, 4)))
    best = Plan(targets=np.zeros((5, 2)), states=made.states.copy())
    best.states[3:] = 0.0
    keep_plan(made, best, 2, 4)
    assert np.array_equal(best.targets[2:4], made.targets[2:4])
    assert np.array_equal(best.states[3:5], made.states[3:5])
    assert not best.targets[:2].any() and not best.states[5].any()
    again = Plan(targets=np.zeros((5, 2)), states=np.zeros((6, 4)))
    take_plan(again, best, 2, 4)
    assert np.array_equal(again.targets[2:4], made.targets[2:4])
    assert np.array_equal(again.states[2], made.states[2])


def test_windows_take_turns_and_a_cut_leaves_a_decision():
    assert [begin_window(turn, 10) for turn in range(4)] == [0, 5, 10 - END_DECISIONS, 0]
    assert begin_window(2, END_DECISIONS - 1) == 0
    assert [find_cut(fraction, 10, 12) for fraction in (0.0, 0.5, 1.0)] == [0, 5, 10]
    assert find_cut(1.0, 12, 12) == 11


def test_a_shift_has_the_given_ends_and_middle():
    change = np.arange(1.0, 2 * CHANGE_POINTS + 1)
    targets = np.zeros((7, 2))
    shift_places(targets, change, 0.5, 1, 6)
    assert targets[1] == pytest.approx(0.5 * change[:2])
    assert targets[5] == pytest.approx(0.5 * change[2:4])
    middle = 0.5 * (change[:2] + change[2:4]) + 0.5 * change[4:]
    assert targets[3] == pytest.approx(0.5 * middle)
    assert not targets[[0, 6]].any()


def test_a_stroke_begins_its_standoff_outside_the_place_that_it_touches(ways):
    aim = aim_primitive(ways, make_primitive())
    touch = int(0.3 * len(ways.touch))
    assert not aim.pushing
    assert aim.heading == pytest.approx(0.2 + ways.inward[touch])
    back = ways.touch[touch] - [aim.x, aim.y]
    assert np.hypot(*back) == pytest.approx(ways.standoff)
    assert np.arctan2(back[1], back[0]) == pytest.approx(ways.inward[touch])
    at_once = aim_primitive(ways, make_primitive(place=-1.0))
    assert at_once.pushing and at_once.heading == 0.2


def test_the_way_to_a_stroke_is_the_same_wherever_the_object_lies(ways):
    primitive = make_primitive()
    aim = aim_primitive(ways, primitive)
    tip = np.array([0.07, -0.05])
    here = np.empty(2)
    assert not walk_to_aim(ways, primitive, aim, 0.0, 0.0, 0.0, *tip, here)
    assert walk_to_aim(ways, primitive, aim, 0.0, 0.0, 0.0, aim.x, aim.y, np.empty(2))
    x, y, theta = 0.4, -0.2, 2.0
    R = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    there = np.empty(2)
    assert not walk_to_aim(ways, primitive, aim, x, y, theta, *(R @ tip + [x, y]), there)
    assert there == pytest.approx(R @ here + [x, y])

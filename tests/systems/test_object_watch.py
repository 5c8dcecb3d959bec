from dataclasses import replace

import numpy as np
import pytest
import shapely

from gridpush_drake.systems.sensing.object_watch import MAX_LEVER_RATIO, ObjectWatch, WatchState
from tests.helpers.scene_cases import PLATE

LOOK, PERIOD = 1 / 30, 0.005
WATCH = ObjectWatch(shapely.box(-0.1, -0.03, 0.1, 0.03), height=0.03, tip_radius=0.01)
POSE = np.array([0.6, 0.1, 0.0])
BESIDE, ABOVE, AWAY = [0.5 - 0.011, 0.1, 0.012], [0.6, 0.1, 0.12], [0.45, -0.2, 0.012]


def watch(tip, pose, duration=1.0):
    """What is said first of a tip and an object whose places are given by the time."""
    state, look = WatchState(), None
    for time in np.arange(0.0, duration, PERIOD):
        if look is None or time - look > LOOK:
            look, seen = time, np.asarray(pose(time), float)
        state, fault = WATCH.watch(state, time, seen, np.asarray(tip(time), float))
        if fault:
            return fault, time
    return "", duration


@pytest.mark.parametrize("tip", [AWAY, ABOVE])
@pytest.mark.parametrize("speed", [0.02, 0.75, 0.87])
def test_an_object_that_moves_while_nothing_touches_it_is_noticed(tip, speed):
    """25 to 29 mm at every look, 30 looks a second; and much slower."""
    fault, time = watch(lambda t: tip, lambda t: POSE + [speed * t, 0, 0])
    assert "while nothing touched it; up to 10 mm may be noise" in fault
    assert time < 0.01 / speed + 2 * LOOK


@pytest.mark.parametrize("speed", [0.75, 0.87, 5.8])
def test_an_object_that_is_faster_than_the_finger_at_it_is_noticed(speed):
    def tip(t):
        return BESIDE + np.array([0.08 * t, 0, 0])

    fault, time = watch(tip, lambda t: POSE + [speed * t, 0, 0])
    assert "; the finger at it moved by " in fault
    assert time < 5 * LOOK


def test_a_pusher_of_another_shape_is_near_by_its_angle():
    """A plate 60 mm wide and 15 mm thick, whose front is at the tip."""
    plate = replace(WATCH, shape=PLATE, tip_radius=PLATE.reach)
    place = np.array([0.5 - 0.03, 0.1, 0.012])
    assert [plate.is_near(POSE, place, yaw) for yaw in (0.0, np.pi, np.pi / 2)] == [
        False,
        True,
        True,
    ]
    assert not plate.is_near(POSE, np.array([*place[:2], 0.12]), np.pi / 2)


def test_in_clutter_a_low_finger_counts_as_near_wherever_it_is():
    """It may push the object through another one; above all of them it moves nothing."""
    clutter = replace(WATCH, pushed_by_others=True)
    for place, height, near in ((AWAY, 0.012, True), (AWAY, 0.12, False), (BESIDE, 0.012, True)):
        assert clutter.is_near(POSE, np.array([*place[:2], height])) is near
    assert not WATCH.is_near(POSE, np.array(AWAY))


def test_an_object_that_is_pushed_turned_or_seen_with_noise_is_none_of_that():
    rng = np.random.default_rng(3)

    def noise():
        return rng.normal(size=3) * [0.0005, 0.0005, 0.0035]

    pushed = watch(
        lambda t: BESIDE + np.array([0.08 * t, 0, 0]),
        lambda t: POSE + [0.08 * max(t - 0.05, 0), 0, 0] + noise(),
    )
    still = watch(lambda t: AWAY, lambda t: POSE + noise(), duration=5.0)
    turned = watch(
        lambda t: [0.6 + 0.09, 0.06 + 0.1 * t, 0.012],
        lambda t: POSE + [0, 0, MAX_LEVER_RATIO * 0.5 * t] + noise(),
        duration=0.3,
    )
    assert (pushed[0], still[0], turned[0]) == ("", "", "")


def test_an_object_comes_to_rest_where_the_finger_left_it_and_may_not_move_on():
    def tip(t):
        return BESIDE + np.array([0.08 * t, 0, 0]) if t < 0.5 else AWAY

    def pose(t):
        return POSE + [0.08 * min(t, 0.55) + 0.1 * max(t - 1.5, 0.0), 0, 0]

    fault, time = watch(tip, pose, duration=3.0)
    assert "while nothing touched it" in fault
    assert 1.6 < time < 1.7


def test_after_it_forgot_the_object_may_lie_anywhere():
    state, _ = WATCH.watch(WatchState(), 0.0, POSE, np.array(AWAY))
    state, fault = WATCH.watch(WATCH.forget(state), 1.0, POSE + [0.2, 0, 1.0], np.array(AWAY))
    assert fault == ""
    assert (
        "seen to move by 40 mm" in WATCH.watch(state, 1.1, POSE + [0.24, 0, 1.0], np.array(AWAY))[1]
    )

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridpush_drake.systems.safety.arm_path import ArmPath, brake, calc_stop_distance, follow

PERIOD = 0.005
SPEED, ACCELERATION = np.array([1.0, 2.0]), np.array([10.0, 5.0])


def calc_tip(q):
    """A planar arm of two links, 0.5 and 0.4 m."""
    return np.array([0.5 * np.cos(q[0]) + 0.4 * np.cos(q[0] + q[1]),
                     0.5 * np.sin(q[0]) + 0.4 * np.sin(q[0] + q[1]), 0.05])  # fmt: skip


@settings(max_examples=20, deadline=None)
@given(
    targets=st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2)), min_size=2, max_size=15),
    hold=st.integers(1, 30),
)
def test_whatever_is_wanted_the_limits_are_kept_and_rest_is_reached(targets, hold):
    motion, before = [(np.zeros(2), np.zeros(2))], np.zeros(2)
    for target in [*np.repeat(targets, hold, axis=0), *[np.array(targets[-1])] * 1000]:
        motion.append(follow(*motion[-1], before, target, SPEED, ACCELERATION, PERIOD))
        before = target
    q, v = (np.array(part) for part in zip(*motion, strict=True))
    assert (np.abs(v) <= SPEED * (1 + 1e-9)).all()
    assert (np.abs(np.diff(v, axis=0)) <= ACCELERATION * PERIOD * (1 + 1e-9)).all()
    np.testing.assert_allclose(np.diff(q, axis=0), v[1:] * PERIOD, atol=1e-12)
    np.testing.assert_allclose(q[-1], targets[-1], atol=1e-9)
    np.testing.assert_allclose(v[-1], 0.0, atol=1e-9)


def test_a_target_that_keeps_the_limits_is_not_overshot():
    """Joints that begin at rest anywhere, behind targets that speed up, brake and turn at random."""
    rng = np.random.default_rng(3)
    n = 500
    speed, acceleration = rng.uniform(0.3, 2.0, n), rng.uniform(2.0, 10.0, n)
    unit = acceleration * PERIOD
    q, v, target, w, change = rng.uniform(-1, 1, n), *np.zeros((4, n))
    lower, upper = np.minimum(q, target), np.maximum(q, target)
    for _ in range(1000):
        change = np.where(rng.random(n) < 0.03, rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], n), change)
        w = np.clip(w + change * unit, -speed, speed)
        before, target = target, target + PERIOD * w
        q, v = follow(q, v, before, target, speed, acceleration, PERIOD)
        left = calc_stop_distance(np.abs(w), unit, PERIOD) - PERIOD * np.abs(w)
        lower = np.minimum(lower, target + np.sign(w) * left)
        upper = np.maximum(upper, target + np.sign(w) * left)
        assert np.maximum(q - upper, lower - q).max() < 1e-12


def test_braking_keeps_the_direction_and_takes_as_long_as_the_slowest_joint_needs():
    v = v0 = np.array([0.2, -0.5])
    steps = 0
    while v.any():
        before, v = v, brake(v, ACCELERATION, PERIOD)
        assert (np.abs(v - before) <= ACCELERATION * PERIOD * (1 + 1e-9)).all()
        assert abs(v[0] * v0[1] - v[1] * v0[0]) < 1e-12
        steps += 1
    assert steps == pytest.approx(0.5 / 5.0 / PERIOD, abs=1)


def go(path, commands, measured=None, begin=0):
    """Sends commands, one a period; the arm is measured where it was told to be, or elsewhere."""
    measured = commands if measured is None else measured
    before = measured[0]
    for k, (command, place) in enumerate(zip(commands, measured, strict=True), begin):
        path = path.confirm(before, place)
        path = path.add(k * PERIOD, command, length=0.02, calc_tip=calc_tip)
        before = place
    return path


def measure_length(way):
    tips = np.array([calc_tip(q) for q in way.positions])
    return np.linalg.norm(np.diff(tips, axis=0), axis=1).sum()


def plan(path, position, distance):
    return path.plan_retreat(position, distance, 0.1 * SPEED, 0.05, 0.04, calc_tip)


def test_the_way_back_is_the_way_that_the_arm_came_as_far_as_the_tip_may_travel():
    t = np.arange(0.0, 1.0, PERIOD)
    commands = np.transpose([0.3 * t, -0.7 + 0.4 * t**2])
    path = go(ArmPath.begin(commands[0], 0.0, calc_tip(commands[0])), commands)
    way = plan(path, commands[-1], 0.01)
    assert measure_length(way) == pytest.approx(0.01, abs=1e-6)
    for position in way.positions:
        assert np.abs(commands - position).max(axis=1).min() < 2e-3
    assert way.duration >= 0.01 / 0.05 - 1e-9
    np.testing.assert_array_equal(way.calc_position(0.0), commands[-1])
    np.testing.assert_array_equal(way.calc_position(1e3), way.positions[-1])
    # the memory is bounded, and holds no more than a retreat needs
    assert len(path.passed) < 100
    assert len(path.commands) < 60


def test_an_arm_that_did_not_follow_is_led_back_to_where_it_stayed_and_on_from_there():
    t = np.arange(0.0, 1.0, PERIOD)
    commands = np.transpose([0.2 * t, -0.7 + 0.1 * t])
    measured = np.minimum(commands, commands[150])  # blocked
    path = go(ArmPath.begin(commands[0], 0.0, calc_tip(commands[0])), commands, measured)
    way = plan(path, commands[-1], 0.1)
    skipped = [q for q in way.positions if 0.16 < q[0] < 0.195]
    assert len(skipped) < 10  # one straight line to where it was blocked
    assert measure_length(way) < 0.1 + 1e-9
    near = np.abs(way.positions - commands[150]).max(axis=1).min()
    assert near < 6e-3


def test_one_wrong_measurement_neither_makes_a_way_nor_leads_anywhere():
    commands = np.tile([0.3, -0.7], (30, 1))
    measured = commands.copy()
    measured[20] += 1.5
    path = go(ArmPath.begin(commands[0], 0.0, calc_tip(commands[0])), commands, measured)
    way = plan(path, commands[-1], 0.01)
    np.testing.assert_array_equal(way.positions, np.tile([0.3, -0.7], (len(way.positions), 1)))


def test_a_joint_that_comes_late_is_not_off_but_one_that_stays_behind_is():
    t = np.arange(0.0, 1.0, PERIOD)
    commands = np.transpose([0.5 * t, 0.0 * t])
    path = go(ArmPath.begin(commands[0], 0.0, calc_tip(commands[0])), commands)
    late = commands[-9]
    np.testing.assert_array_equal(path.calc_error(late, t[-1], 0.05), [0.0, 0.0])
    np.testing.assert_allclose(path.calc_error(commands[-31], t[-1], 0.05), [0.05, 0.0], atol=1e-9)
    np.testing.assert_allclose(path.calc_error(commands[-1] + [0.1, -0.2], t[-1], 0.05), [0.1, 0.2])

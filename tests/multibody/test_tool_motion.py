"""A leg's motion in time: quadrature, bounds, ends."""

import numpy as np
import pytest
from scipy.integrate import quad

from gridpush_drake.multibody.tool_motion import TURNING_RADIUS, TrajectorySegment
from gridpush_drake.systems.messages import PushPhase

A, B = (0.1, 0.2, 0.3), (0.4, 0.2, -0.1)  # 0.5 m apart

LEGS = [
    TrajectorySegment(PushPhase.PUSHING, A, B, 0.3, 1.0),
    TrajectorySegment(PushPhase.PUSHING, A, B, 0.05, 0.5, 0.3),
    TrajectorySegment(PushPhase.PUSHING, A, B, 10.0, 1.0),
    TrajectorySegment(PushPhase.PUSHING, A, B, 0.7, 2.0),
]


@pytest.mark.parametrize("leg", LEGS)
def test_leg_goes_from_start_to_end_and_rests_there(leg):
    assert leg.length == pytest.approx(0.5)
    np.testing.assert_array_equal(leg.position(-1.0), A)
    np.testing.assert_array_equal(leg.position(0.0), A)
    np.testing.assert_allclose(leg.position(leg.moving_time), B, atol=1e-15)
    np.testing.assert_allclose(leg.position(leg.duration + 1.0), B, atol=1e-15)
    assert leg.duration == leg.moving_time + leg.wait
    for t in (-1.0, 0.0, leg.moving_time, leg.duration + 1.0):
        np.testing.assert_allclose(leg.velocity(t), 0.0, atol=1e-12)


@pytest.mark.parametrize("leg", LEGS)
def test_position_is_the_velocity_s_integral(leg):
    for t in np.linspace(0.0, 1.1 * leg.moving_time, 9):
        way = [
            quad(lambda s, i=i: leg.velocity(s)[i], 0.0, t, points=[leg.ramp, leg.moving_time - leg.ramp])[0]
            for i in range(3)
        ]
        np.testing.assert_allclose(leg.position(t), np.add(A, way), atol=1e-8)


@pytest.mark.parametrize("leg", LEGS)
def test_speed_and_acceleration_reach_their_bounds_and_no_more(leg):
    t = np.linspace(-0.1, leg.moving_time + 0.1, 20_001)
    v = np.array([leg.velocity(s) for s in t])
    speed, acceleration = np.linalg.norm(v, axis=1), np.linalg.norm(np.diff(v, axis=0), axis=1) / (t[1] - t[0])
    assert speed.max() == pytest.approx(leg.top_speed, rel=1e-6)
    assert leg.top_speed <= leg.speed
    assert acceleration.max() == pytest.approx(leg.acceleration, rel=1e-3)
    jerk = np.abs(np.diff(acceleration)).max() / (t[1] - t[0])
    assert jerk < 4.1 * leg.acceleration / leg.ramp  # 6 v / T^2 = 4 a / T: the acceleration does not jump


def test_short_leg_is_slower():
    leg = LEGS[2]
    assert leg.top_speed == pytest.approx(np.sqrt(2 * leg.acceleration * leg.length / 3))
    assert leg.moving_time == pytest.approx(2 * leg.ramp)


def test_position_is_the_ramp_s_closed_form():
    leg = LEGS[1]
    v, T = leg.top_speed, leg.ramp
    for t in np.linspace(0.0, T, 7):
        u = t / T
        for at, s in ((t, v * T * (u**3 - u**4 / 2)), (leg.moving_time - t, leg.length - v * T * (u**3 - u**4 / 2))):
            np.testing.assert_allclose(
                leg.position(at), np.add(A, s / leg.length * np.subtract(B, A)), rtol=0, atol=1e-12
            )


def test_a_tool_turns_by_more_than_half_a_turn():
    leg = TrajectorySegment(PushPhase.PUSHING, (*A, -3.0), (*A, 3.0), 0.3, 1.0)
    assert leg.length == pytest.approx(6.0 * TURNING_RADIUS)
    yaws = [leg.position(t)[3] for t in np.linspace(0.0, leg.duration, 50)]
    assert (np.diff(yaws) > 0.0).all()
    assert yaws[-1] == pytest.approx(3.0)


def test_wait_and_leg_of_no_length():
    leg = TrajectorySegment(PushPhase.PUSHING, A, A, wait=0.3)
    assert (leg.length, leg.moving_time, leg.duration) == (0.0, 0.0, 0.3)
    for t in (-1.0, 0.0, 0.1, 1.0):
        np.testing.assert_array_equal(leg.position(t), A)
        np.testing.assert_array_equal(leg.velocity(t), 0.0)


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.5, 0.9])
def test_stop_is_the_same_motion_first_and_then_the_soonest_end(leg, share):
    t = share * leg.moving_time
    stopped = leg.stop_from(t)
    for s in np.linspace(0.0, min(t, stopped.moving_time / 2), 9):
        np.testing.assert_allclose(stopped.position(s), leg.position(s), atol=1e-12)
        np.testing.assert_allclose(stopped.velocity(s), leg.velocity(s), atol=1e-12)
    np.testing.assert_allclose(stopped.position(t), leg.position(t), atol=1e-12)
    assert stopped.moving_time == pytest.approx(min(max(t, leg.ramp) + leg.ramp, leg.moving_time))
    assert stopped.stop_from(t + 0.1 * leg.ramp) == stopped


def test_stop_before_the_beginning_is_no_motion():
    assert LEGS[0].stop_from(0.0).end == A
    assert LEGS[0].stop_from(0.0).length == 0.0

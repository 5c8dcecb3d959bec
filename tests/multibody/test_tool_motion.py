"""A segment's motion in time: quadrature, bounds, ends."""

import numpy as np
import pytest
from scipy.integrate import quad

from gridpush_drake.multibody.tool_motion import TURNING_RADIUS, TrajectorySegment
from gridpush_drake.systems.base.messages import PushPhase

A, B = (0.1, 0.2, 0.3), (0.4, 0.2, -0.1)  # 0.5 m apart

SEGMENTS = [
    TrajectorySegment(PushPhase.PUSHING, A, B, 0.3, 1.0),
    TrajectorySegment(PushPhase.PUSHING, A, B, 0.05, 0.5, 0.3),
    TrajectorySegment(PushPhase.PUSHING, A, B, 10.0, 1.0),
    TrajectorySegment(PushPhase.PUSHING, A, B, 0.7, 2.0),
]


@pytest.mark.parametrize("segment", SEGMENTS)
def test_segment_goes_from_start_to_end_and_rests_there(segment):
    assert segment.length == pytest.approx(0.5)
    np.testing.assert_array_equal(segment.position(-1.0), A)
    np.testing.assert_array_equal(segment.position(0.0), A)
    np.testing.assert_allclose(segment.position(segment.moving_time), B, atol=1e-15)
    np.testing.assert_allclose(segment.position(segment.duration + 1.0), B, atol=1e-15)
    assert segment.duration == segment.moving_time + segment.wait
    for t in (-1.0, 0.0, segment.moving_time, segment.duration + 1.0):
        np.testing.assert_allclose(segment.velocity(t), 0.0, atol=1e-12)


@pytest.mark.parametrize("segment", SEGMENTS)
def test_position_is_the_velocity_s_integral(segment):
    for t in np.linspace(0.0, 1.1 * segment.moving_time, 9):
        way = [
            quad(
                lambda s, i=i: segment.velocity(s)[i],
                0.0,
                t,
                points=[segment.ramp, segment.moving_time - segment.ramp],
            )[0]
            for i in range(3)
        ]
        np.testing.assert_allclose(segment.position(t), np.add(A, way), atol=1e-8)


@pytest.mark.parametrize("segment", SEGMENTS)
def test_speed_and_acceleration_reach_their_bounds_and_no_more(segment):
    t = np.linspace(-0.1, segment.moving_time + 0.1, 20_001)
    v = np.array([segment.velocity(s) for s in t])
    speed, acceleration = (
        np.linalg.norm(v, axis=1),
        np.linalg.norm(np.diff(v, axis=0), axis=1) / (t[1] - t[0]),
    )
    assert speed.max() == pytest.approx(segment.top_speed, rel=1e-6)
    assert segment.top_speed <= segment.speed
    assert acceleration.max() == pytest.approx(segment.acceleration, rel=1e-3)
    jerk = np.abs(np.diff(acceleration)).max() / (t[1] - t[0])
    assert (
        jerk < 4.1 * segment.acceleration / segment.ramp
    )  # 6 v / T^2 = 4 a / T: the acceleration does not jump


def test_short_leg_is_slower():
    segment = SEGMENTS[2]
    assert segment.top_speed == pytest.approx(
        np.sqrt(2 * segment.acceleration * segment.length / 3)
    )
    assert segment.moving_time == pytest.approx(2 * segment.ramp)


def test_position_is_the_ramp_s_closed_form():
    segment = SEGMENTS[1]
    v, T = segment.top_speed, segment.ramp
    for t in np.linspace(0.0, T, 7):
        u = t / T
        for at, s in (
            (t, v * T * (u**3 - u**4 / 2)),
            (segment.moving_time - t, segment.length - v * T * (u**3 - u**4 / 2)),
        ):
            np.testing.assert_allclose(
                segment.position(at),
                np.add(A, s / segment.length * np.subtract(B, A)),
                rtol=0,
                atol=1e-12,
            )


def test_a_tool_turns_by_more_than_half_a_turn():
    segment = TrajectorySegment(PushPhase.PUSHING, (*A, -3.0), (*A, 3.0), 0.3, 1.0)
    assert segment.length == pytest.approx(6.0 * TURNING_RADIUS)
    yaws = [segment.position(t)[3] for t in np.linspace(0.0, segment.duration, 50)]
    assert (np.diff(yaws) > 0.0).all()
    assert yaws[-1] == pytest.approx(3.0)


def test_wait_and_leg_of_no_length():
    segment = TrajectorySegment(PushPhase.PUSHING, A, A, wait=0.3)
    assert (segment.length, segment.moving_time, segment.duration) == (0.0, 0.0, 0.3)
    for t in (-1.0, 0.0, 0.1, 1.0):
        np.testing.assert_array_equal(segment.position(t), A)
        np.testing.assert_array_equal(segment.velocity(t), 0.0)


@pytest.mark.parametrize("segment", SEGMENTS)
@pytest.mark.parametrize("fraction", [0.02, 0.3, 0.5, 0.9])
def test_stop_is_the_same_motion_first_and_then_the_soonest_end(segment, fraction):
    t = fraction * segment.moving_time
    stopped = segment.stop_from(t)
    for s in np.linspace(0.0, min(t, stopped.moving_time / 2), 9):
        np.testing.assert_allclose(stopped.position(s), segment.position(s), atol=1e-12)
        np.testing.assert_allclose(stopped.velocity(s), segment.velocity(s), atol=1e-12)
    np.testing.assert_allclose(stopped.position(t), segment.position(t), atol=1e-12)
    assert stopped.moving_time == pytest.approx(
        min(max(t, segment.ramp) + segment.ramp, segment.moving_time)
    )
    assert stopped.stop_from(t + 0.1 * segment.ramp) == stopped


def test_stop_before_the_beginning_is_no_motion():
    assert SEGMENTS[0].stop_from(0.0).end == A
    assert SEGMENTS[0].stop_from(0.0).length == 0.0

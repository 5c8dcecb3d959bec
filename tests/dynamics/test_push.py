"""Pushes: straight, sampled, from an outline, by a force; and their default steps."""

from dataclasses import replace

import numpy as np
import pytest
from shapely import Point

from gridpush_drake.dynamics import DEFAULT_DT, DEFAULT_TIP_STEP, make_path_times
from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape


def test_straight_push():
    push = Push((1.0, 2.0), (0.3, 0.4), 2, 0.01)
    np.testing.assert_allclose(push.tip_at([0.0, 1.0, 2.0]), [[1, 2], [1.3, 2.4], [1.6, 2.8]])
    np.testing.assert_allclose(push.tip_at([-1.0, 9.0]), [[1, 2], [1.6, 2.8]])
    assert push.length == pytest.approx(1.0)
    assert push.start_tangent is None
    assert isinstance(push.duration, float)


def test_sampled_push():
    t, xy = np.array([3.0, 4.0, 6.0]), np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.2]])
    push = Push.along(t, xy, 0.01)
    np.testing.assert_array_equal(push.t, [0, 1, 3])
    np.testing.assert_allclose(push.velocity, [0.1 / 3, 0.2 / 3])
    np.testing.assert_allclose(push.tip_at(2.0), [[0.1, 0.1]])
    assert push.length == pytest.approx(0.3)
    assert push.duration == 3.0


@pytest.mark.parametrize(
    "change",
    [
        {"velocity": (0.2, 0.0)},
        {"start": (1.0, 0.0)},
        {"duration": 2.0},
        {"t": [0.0, 0.5, 1.0]},
        {"t": [0.0, np.nan]},
        {"t": [-1.0, 1.0]},
        {"xy": [[0.0, 0.0], [0.1, np.nan]]},
    ],
)
def test_samples_that_disagree_with_the_rest_of_a_push_are_refused(change):
    push = Push((0.0, 0.0), (0.1, 0.0), 1.0, 0.01)
    assert replace(push, radius=0.02).radius == 0.02
    with pytest.raises(PushError, match=r"t and xy|t of shape"):
        replace(push, **change)


def test_callers_arrays_are_copied():
    t, xy, start = np.array([0.0, 1.0]), np.array([[0.0, 0.0], [0.1, 0.0]]), np.zeros(2)
    pushes = (Push.along(t, xy, 0.01), Push(start, (0.1, 0.0), 1.0, 0.01, t=t, xy=xy))
    for array in (t, xy, start):
        array += 7.0
    for push in pushes:
        assert push.t[0] == 0.0
        assert not push.xy[0].any()
        with pytest.raises(ValueError, match="read-only"):
            push.xy[0] = 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0.0,), (1.0, 0.0), 1.0, 0.01), "start"),
        (((0.0, 0.0), (np.inf, 0.0), 1.0, 0.01), "velocity"),
        (((0.0, 0.0), (1.0, 0.0), 0.0, 0.01), "duration"),
        (((0.0, 0.0), (1.0, 0.0), np.nan, 0.01), "duration"),
        (((0.0, 0.0), (1.0, 0.0), 1.0, -0.01), "radius"),
    ],
)
def test_bad_straight_pushes(arguments, message):
    with pytest.raises(PushError, match=message):
        Push(*arguments)


@pytest.mark.parametrize(
    ("t", "xy", "message"),
    [
        ([0.0], [[0.0, 0.0]], "shape"),
        ([0.0, 1.0], [[0.0, 0.0]], "shape"),
        ([[0.0, 1.0]], [[0.0, 0.0], [1.0, 0.0]], "shape"),
        ([0.0, np.nan], [[0.0, 0.0], [1.0, 0.0]], "finite"),
        ([0.0, 1.0], [[0.0, 0.0], [np.inf, 0.0]], "finite"),
        ([0.0, 1.0, 1.0], [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], r"t\[2\]"),
    ],
)
def test_bad_sampled_pushes(t, xy, message):
    with pytest.raises(PushError, match=message):
        Push.along(t, xy, 0.01)


def test_push_on_an_outline():
    obj, pose = make_shape("square", 16), (0.3, -0.1, np.pi / 2)
    # the outline's first vertex is (-0.05, -0.05); 0.03 m along its bottom side, turned by 90°
    push = Push.on_outline(obj, 0.03, 0.0, 0.1, radius=0.01, speed=0.05, pose=pose, clearance=0.002)
    np.testing.assert_allclose(push.start, [0.3 + 0.062, -0.1 - 0.02])
    np.testing.assert_allclose(push.velocity, [-0.05, 0.0], atol=1e-15)
    np.testing.assert_allclose(push.start_tangent, [0.0, 1.0], atol=1e-15)
    assert push.duration == pytest.approx(2.0)
    turned = Push.on_outline(
        obj, 0.03, 0.5, 0.1, radius=0.01, duration=2.0, pose=pose, clearance=0.002
    )
    np.testing.assert_allclose(turned.velocity, 0.05 * np.array([-np.cos(0.5), -np.sin(0.5)]))
    again = Push.on_outline(
        obj, 0.43, 0.5, 0.1, radius=0.01, duration=2.0, pose=pose, clearance=0.002
    )
    np.testing.assert_allclose(again.start, turned.start)


@pytest.mark.parametrize("shape", ["triangle", "disc", "claw_hammer"])
def test_start_moves_along_its_tangent(shape):
    obj, pose, step = make_shape(shape, 20), (0.1, 0.2, 0.7), 1e-7
    for s in np.linspace(0.003, obj.edges.perimeter, 23)[:-1]:
        one, other = (
            Push.on_outline(obj, s + d, 0.1, 0.1, radius=0.004, speed=0.1, pose=pose)
            for d in (0.0, step)
        )
        np.testing.assert_allclose((other.start - one.start) / step, one.start_tangent, atol=1e-6)
        body = np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]]) @ (
            one.start - pose[:2]
        )
        if shape != "claw_hammer":
            assert obj.outline.distance(Point(body)) == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radius": 0.01}, "either duration or speed"),
        ({"radius": 0.01, "speed": 0.1, "duration": 1.0}, "either duration or speed"),
        ({"radius": 0.0, "speed": 0.1}, "radius"),
        ({"radius": 0.01, "speed": -0.1}, "speed"),
        ({"radius": 0.01, "duration": 0.0}, "duration"),
        ({"radius": 0.01, "speed": 0.1, "distance": 0.0}, "distance"),
        ({"radius": 0.01, "speed": 0.1, "clearance": -0.1}, "clearance"),
        ({"radius": 0.01, "speed": 0.1, "angle": np.nan}, "angle"),
        ({"radius": 0.01, "speed": 0.1, "pose": (0.0, 0.0)}, "pose"),
    ],
)
def test_bad_pushes_on_an_outline(options, message):
    arguments = {"arc_length": 0.01, "angle": 0.0, "distance": 0.1, **options}
    with pytest.raises(PushError, match=message):
        Push.on_outline(make_shape("square", 4), **arguments)


def test_force_push():
    push = ForcePush((0.01, 0.0), [[1.0, 0.0], [0.0, 2.0]], 1.0, t=[0.0, 0.4])
    times = np.array([0.0, 0.2, 0.4, 0.6, 2.0])
    np.testing.assert_array_equal(push.force_during(times), [[1, 0], [1, 0], [0, 2], [0, 2]])
    one = ForcePush((0.0, 0.0), (1.0, 2.0), 1.0)
    np.testing.assert_array_equal(one.force_during(times), [[1, 2]] * 4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0.0,), (1.0, 0.0), 1.0), "shape"),
        (((0.0, 0.0), (1.0, 0.0, 0.0), 1.0), "shape"),
        (((0.0, 0.0), (np.nan, 0.0), 1.0), "finite"),
        (((0.0, 0.0), (1.0, 0.0), -1.0), "duration"),
        (((0.0, 0.0), [[1.0, 0.0], [1.0, 0.0]], 1.0), "shape"),
        (((0.0, 0.0), [[1.0, 0.0], [1.0, 0.0]], 1.0, [0.1, 0.2]), "begin at 0"),
        (((0.0, 0.0), [[1.0, 0.0], [1.0, 0.0]], 1.0, [0.0, 0.0]), "increase"),
    ],
)
def test_bad_force_pushes(arguments, message):
    with pytest.raises(PushError, match=message):
        ForcePush(*arguments)


SPEEDS = np.concatenate([np.geomspace(0.003, 0.6, 200), 0.05 * (1 + np.linspace(-1e-3, 1e-3, 21))])


@pytest.mark.parametrize("length", [0.0123, 0.1, 0.2])
def test_the_default_step_is_a_continuous_function_of_the_speed(length):
    for speed in SPEEDS:
        push = Push((0.0, 0.0), (speed, 0.0), length / speed, 0.01)
        times = make_path_times(push, "inertial")
        steps, longest = np.diff(times), min(DEFAULT_DT, DEFAULT_TIP_STEP / speed)
        assert times[0] == 0.0
        assert times[-1] == push.duration
        np.testing.assert_allclose(steps[:-2], longest, rtol=1e-7)
        assert steps.max() <= longest * (1 + 1e-7)
        assert steps[-2:].min() >= 0.5 * longest * (1 - 1e-7)


def test_where_the_number_of_steps_changes_the_motion_hardly_does():
    """Around 0.05 m/s a push of 0.1 m takes 200 steps or 201."""
    obj = make_shape("square", 36)
    params, poses, counts = CellParameters.uniform(obj, 1.0, 0.4, 0.2), [], []
    for speed in (0.05 * (1 - 1e-6), 0.05, 0.05 * (1 + 1e-6)):
        motion = simulate(
            Model(obj, params), Push((-0.055, 0.02), (speed, 0.0), 0.1 / speed, 0.005)
        )
        poses.append(motion.final_pose)
        counts.append(len(motion.times) - 1)
    assert counts == [201, 200, 200]
    np.testing.assert_allclose(poses[0], poses[1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(poses[2], poses[1], rtol=0, atol=1e-6)

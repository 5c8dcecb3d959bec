"""Finding pushes and writing them down, from scripted samples of a tip and of an object that the LCP moves."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_csv import MIN_TIME_STEP
from gridpush_drake.pushes.segmentation import Sample, calc_rest_pose, thin_path
from tests.helpers.scripted_stream import HIGH, LOW, NOISE, PERIOD, RADIUS, RECORD, Script
from tests.helpers.shapes import make_shape


@pytest.fixture
def script() -> Script:
    return Script(make_shape("l_bracket", 20))


def check_poses(push: ObservedPush, first, last) -> None:
    """Averages lie within four standard errors, of ten looks or more, of the truth."""
    for seen, truth in ((push.pose, first), (push.final_pose, last)):
        assert (np.abs(seen - truth) < 4 * NOISE / np.sqrt(10)).all()


def test_one_push_from_above(script):
    script.lower(-0.06, 0.01).push(0.04, 0.01).wait(0.3).lift().wait(1.0)
    (push,) = script.segment()
    check_poses(push, np.zeros(3), script.q)
    assert np.linalg.norm(script.q[:2]) > 0.03
    np.testing.assert_allclose(push.push.start, (-0.06, 0.01), atol=1e-12)
    np.testing.assert_allclose(push.push.xy[-1], (0.04, 0.01), atol=1e-12)
    assert push.push.length == pytest.approx(0.1) and push.push.radius == RADIUS
    assert len(push.t_observed) == RECORD.observations and push.t_observed[-1] == push.push.duration
    assert len(push.push.t) <= RECORD.observations + 3, "a straight push needs few samples"
    assert np.isin(push.t_observed, push.push.t).all()


@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.01), (17.0, 0.01), (0.0, 0.03), (17.0, 0.05)])
def test_times_of_forces_and_poses_are_the_same_or_apart(script, begin, end):
    """Rounding sets no two of a push's times apart, which its file could not hold."""
    script.lower(-0.06, 0.01).push(end, 0.01).wait(0.3).lift().wait(1.0)
    script.samples = [
        seen._replace(t=begin + seen.t, force=(0.1, 0.2, 0.3)) for seen in script.samples
    ]
    (push,) = script.segment()
    times = np.unique(np.concatenate([push.push.t, push.t_observed, push.force_t]))
    assert np.diff(times).min() >= MIN_TIME_STEP


def test_forces_on_the_object_are_written_down_without_the_sensor_s_offset(script):
    """What is felt with the tip still in contact after the push before is no offset."""
    for _ in range(2):
        x = float(script.q[0])
        script.lower(x - 0.06, 0.01).push(x + 0.04, 0.01).wait(0.3).lift().wait(0.2)
    script.wait(1.0)
    offset, touching = np.array([0.4, -0.3, 0.6]), np.array([-2.0, 0.5, -0.7])
    script.samples = [
        seen._replace(force=tuple(offset + touching * (seen.tip[2] < LOW + 1e-9)))
        for seen in script.samples
    ]
    first, second = script.segment()
    for push in (first, second):
        assert len(push.force_t) == 20
        assert np.isin(push.force_t, push.push.t).all()
        assert push.force_t[0] >= 0 and push.force_t[-1] <= push.push.duration
        np.testing.assert_allclose(push.force[1:-1], np.tile([2.0, -0.5], (18, 1)))
        np.testing.assert_allclose(push.lift_force[1:-1], 0.7)
    # A force that is not measured is not made up.
    script.samples = [seen._replace(force=(np.nan,) * 3) for seen in script.samples]
    assert all(push.force is None and push.lift_force is None for push in script.segment())


def test_poses_are_matched_with_the_tip_s_place_at_their_time(script):
    script.noise = np.zeros(3)
    script.lower(-0.06, 0.01).push(0.04, 0.01).wait(0.3).lift().wait(1.0)
    (push,) = script.segment()
    motion = simulate(
        Model(script.obj, script.params),
        push.push,
        push.pose,
        times=np.append(0.0, push.t_observed),
        regime="quasi_static",
    )
    fine = simulate(
        Model(script.obj, script.params),
        push.push,
        push.pose,
        regime="quasi_static",
        times=np.union1d(np.linspace(0, push.push.duration, 400), push.t_observed),
    )
    predicted = fine.poses[np.searchsorted(fine.times, push.t_observed)]
    assert motion.status == "ok"
    np.testing.assert_allclose(predicted, push.poses_observed, atol=2e-4)


def test_old_poses_are_dated_back(script):
    script.noise = np.zeros(3)
    script.lower(-0.06, 0.01).push(0.04, 0.01).wait(0.5).lift().wait(1.0)
    (exact,) = script.segment()
    delayed = [script.samples[0], *script.samples[:-1]]
    script.samples = [
        now._replace(pose=old.pose) for now, old in zip(script.samples, delayed, strict=True)
    ]
    (corrected,) = script.segment(replace(RECORD, pose_delay=PERIOD))
    np.testing.assert_allclose(corrected.t_observed[:-1], exact.t_observed[:-1], atol=1e-9)
    np.testing.assert_allclose(corrected.poses_observed, exact.poses_observed, atol=1e-9)


def test_planar_pusher_that_is_never_lifted():
    """z = 0 throughout: a push ends when the tip has stood for a while, or when the next one begins."""
    script = Script(make_shape("l_bracket", 20), start=(-0.06, 0.01, 0.0))
    script.move((0.0, 0.01, 0.0), 0.03).wait(1.5)
    middle = script.q.copy()
    script.move((0.04, 0.01, 0.0), 0.03).wait(0.4).move((0.07, 0.01, 0.0), 0.03).wait(1.5)
    first, second, third = script.segment()
    check_poses(first, np.zeros(3), middle)
    assert second.push.length == pytest.approx(0.04) and third.push.length == pytest.approx(0.03)
    assert (np.abs(second.pose - first.final_pose) < 4 * NOISE / 3).all()
    assert (np.abs(third.final_pose - script.q) < 4 * NOISE / 3).all()


def test_short_stop_is_part_of_the_push(script):
    script.lower(-0.06, 0.01).push(0.0, 0.01).wait(0.1).push(0.04, 0.01).wait(0.3).lift().wait(1.0)
    (push,) = script.segment()
    assert push.push.length == pytest.approx(0.1)


def test_two_pushes_in_a_row_without_lifting(script):
    script.lower(-0.06, 0.01).push(0.0, 0.01).wait(0.4)
    middle = script.q.copy()
    script.push(0.04, 0.02).wait(0.3).lift().wait(1.0)
    first, second = script.segment()
    for seen in (first.final_pose, second.pose):
        assert (np.abs(seen - middle) < 4 * NOISE / np.sqrt(5)).all()
    check_poses(second, middle, script.q)


def test_push_that_is_broken_off_by_lifting(script):
    script.lower(-0.06, 0.01).push(0.03, 0.01).lift().wait(1.0)
    (push,) = script.segment()
    check_poses(push, np.zeros(3), script.q)
    assert push.push.length == pytest.approx(0.09, abs=1e-3)


def test_brief_touch_and_far_way_are_no_pushes(script):
    script.lower(-0.06, 0.01).push(-0.058, 0.01).wait(0.3).lift().wait(0.5)
    script.lower(-0.3, -0.3).push(-0.3, 0.3, 0.1).wait(0.3).lift().wait(1.0)
    assert script.segment() == [None, None]


def test_descent_with_a_drift_is_no_push(script):
    script.move((-0.06, 0.01, HIGH), 0.3).move((-0.055, 0.01, LOW)).push(0.04, 0.01).wait(
        0.3
    ).lift().wait(1.0)
    (push,) = script.segment()
    assert push.push.length == pytest.approx(0.095, abs=1e-3)


def test_gaps_in_what_is_seen(script):
    script.lower(-0.06, 0.01)
    begin = len(script.samples)
    script.push(0.04, 0.01)
    end = len(script.samples)
    script.wait(0.5).lift().wait(1.0).blind(begin - 3, begin + 30).blind(end, end + 6)
    (push,) = script.segment()
    check_poses(push, np.zeros(3), script.q)
    assert 2 <= len(push.t_observed) < RECORD.observations + 1
    script.blind(end, len(script.samples))
    (push,) = script.segment()
    assert push.t_observed[-1] < push.push.duration
    script.blind(begin, len(script.samples))
    assert script.segment() == [None], "never seen again"
    script.blind(0, begin)
    assert script.segment() == [None]


def test_unknown_tip_is_passed_over(script):
    script.lower(-0.06, 0.01).push(0.04, 0.01).wait(0.3).lift().wait(1.0)
    whole = script.segment()[0]
    missing = [i for i in range(len(script.samples)) if i % 7 == 3]
    for i in missing:
        script.samples[i] = script.samples[i]._replace(tip=(np.nan,) * 3)
    (push,) = script.segment()
    assert push.push.length == pytest.approx(whole.push.length, abs=1e-3)
    check_poses(push, np.zeros(3), script.q)


def test_object_that_was_put_elsewhere_by_hand(script):
    """Looks from before the move, and a single bad one, do not count."""
    script.wait(0.5)
    script.q = np.array([0.01, 0.02, 0.3])
    script.wait(0.5)
    script.samples[-4] = script.samples[-4]._replace(pose=(0.5, 0.5, 0.0))
    assert (
        np.abs(calc_rest_pose(script.samples, RECORD) - script.q) < 4 * NOISE / np.sqrt(10)
    ).all()
    assert calc_rest_pose([], RECORD) is None


def test_rest_pose_across_the_cut_of_the_angle():
    looks = [
        Sample(i, (0.0, 0.0, sign * (np.pi - 0.001)), (0,) * 3, (0,) * 3)
        for i, sign in enumerate((1, -1) * 3)
    ]
    assert abs(abs(calc_rest_pose(looks, RECORD)[2]) - np.pi) < 1e-9


def test_thinned_path_stays_within_its_tolerance():
    t = np.linspace(0, 3, 91)
    xy = np.column_stack([0.03 * t, 0.01 * np.sin(2 * t)])
    times, places = thin_path(t, xy, np.array([0.5, 1.01]), 2e-5)
    assert len(times) < 70 and {0.0, 0.5, 1.01, 3.0} <= set(times.tolist())
    back = np.column_stack([np.interp(t, times, places[:, axis]) for axis in (0, 1)])
    assert np.linalg.norm(back - xy, axis=1).max() <= 2e-5

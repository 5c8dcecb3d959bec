import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from gridpush_drake.systems.observed_pose import ObservedPose, find_pose
from gridpush_drake.systems.record_ports import RecordSender
from gridpush_drake.systems.robot_records import PoseObservation

PERIOD, MAX_AGE = 0.01, 0.1


def observe(held, context, time, pose):
    observation = AbstractValue.Make(PoseObservation(time, pose))
    held.GetInputPort("observation").FixValue(context, observation)


class Bench:
    """A system to which a test gives observations."""

    def __init__(self):
        self.held = ObservedPose(PERIOD, MAX_AGE)
        self.simulator = Simulator(self.held)
        self.give(0, (0.0, 0.0, 0.0))

    def give(self, time, pose):
        observe(self.held, self.simulator.get_mutable_context(), time, pose)

    def read(self, time):
        self.simulator.AdvanceTo(time)
        return np.array(self.held.GetOutputPort("object_pose").Eval(self.simulator.get_context()))


def test_a_pose_is_held_until_the_next_observation_or_until_it_is_too_old():
    bench = Bench()
    assert np.isnan(bench.read(0.05)).all()
    bench.give(1, (0.6, -0.1, 0.3))
    np.testing.assert_allclose(bench.read(0.065), [0.6, -0.1, 0.3], atol=1e-15)
    np.testing.assert_allclose(bench.read(0.145), [0.6, -0.1, 0.3], atol=1e-15)
    assert np.isnan(bench.read(0.19)).all()
    bench.give(2, (0.6, -0.1, 0.3))
    np.testing.assert_allclose(bench.read(0.205), [0.6, -0.1, 0.3], atol=1e-15)
    bench.give(3, (np.nan, np.nan, np.nan))
    assert np.isnan(bench.read(0.225)).all()


def test_a_pose_is_told_at_its_age_between_the_observations_of_it():
    """The object moves evenly; observations come late, unevenly and not all."""
    delay, end = 0.2, 3.0
    held = ObservedPose(PERIOD, 1.0, delay)
    simulator = Simulator(held)
    context = simulator.get_mutable_context()
    rng = np.random.default_rng(5)

    def calc_pose(t):
        return np.array([0.1 * t, -0.05 * t, 3.0 + 0.4 * t])

    taken = np.sort(rng.uniform(0, end, 60))
    heard = np.maximum.accumulate(taken + rng.uniform(0.01, 0.1, 60))
    for time in np.arange(PERIOD / 2, end, PERIOD):
        count = int(np.searchsorted(heard, time))
        if count:
            observe(held, context, taken[count - 1], calc_pose(taken[count - 1]))
        held.GetInputPort("time").FixValue(context, [time])
        simulator.AdvanceTo(time)
        told = held.GetOutputPort("object_pose").Eval(context)
        if taken[0] + delay < time < taken[count - 1] + delay:
            np.testing.assert_allclose(told, calc_pose(time - delay), atol=2e-6)
        if count:
            newest = held.GetOutputPort("newest_pose").Eval(context)
            np.testing.assert_allclose(newest, calc_pose(taken[count - 1]), atol=2e-6)
    assert count > 50


def test_between_two_poses_of_which_one_is_not_seen_nothing_is():
    kept = np.array(
        [[-np.inf, *[np.nan] * 3], [1.0, 0.1, 0.2, 0.3], [2.0, 0.2, 0.4, 0.5], [3.0, *[np.nan] * 3]]
    )
    for time, x in (
        (0.5, 0.1),
        (1.0, 0.1),
        (1.25, 0.125),
        (2.0, 0.2),
        (2.5, np.nan),
        (9.0, np.nan),
    ):
        np.testing.assert_allclose(find_pose(kept, time)[0], x, atol=1e-15)
    np.testing.assert_allclose(find_pose(kept[:3], 9.0), [0.2, 0.4, 0.5], atol=1e-15)


def test_the_yaw_counts_whole_turns_even_where_the_object_was_not_seen():
    bench = Bench()
    for k in range(1, 30):
        yaw = 0.5 * k
        wrapped = np.arctan2(np.sin(yaw), np.cos(yaw))
        bench.give(k, (0.0, 0.0, wrapped if k % 5 else np.nan))
        if k % 5:
            assert bench.read(0.01 * k + 0.005)[2] == pytest.approx(yaw)


def test_what_is_sent_at_even_times_is_what_is_held():
    sent = []
    sender = RecordSender(
        lambda time, pose: PoseObservation(time, pose),
        {"pose": 3},
        sent.append,
        period=0.5,
        offset=0.25,
    )
    simulator = Simulator(sender)
    sender.get_input_port().FixValue(simulator.get_mutable_context(), [0.6, -0.1, 0.3])
    simulator.AdvanceTo(1.3)
    assert [record.time for record in sent] == [0.25, 0.75, 1.25]
    bench = Bench()
    bench.give(sent[0].time, sent[0].pose)
    np.testing.assert_allclose(bench.read(0.005), [0.6, -0.1, 0.3], atol=1e-15)


def test_a_clock_that_was_set_back_is_followed():
    """The poses by the clock before it would be taken for newer ones."""
    held = ObservedPose(PERIOD, 1.0, 0.05)
    simulator = Simulator(held)
    context = simulator.get_mutable_context()
    for k in range(1, 61):
        seconds = 100.0 + PERIOD * k if k <= 30 else 5.0 + PERIOD * k
        observe(held, context, seconds, [0.01 * k, 0.0, 0.0])
        held.GetInputPort("time").FixValue(context, [seconds])
        simulator.AdvanceTo(PERIOD * k + PERIOD / 2)
        told = held.GetOutputPort("object_pose").Eval(context)
        if k > 36:
            assert told[0] == pytest.approx(0.01 * (k - 5), abs=1e-6)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e300])
def test_a_pose_that_no_tracker_measures_is_not_seen_and_changes_nothing_after_it(wrong):
    for spoiled in range(3):
        bench, pose = Bench(), [0.6, -0.1, 0.3]
        bench.give(1, [wrong if k == spoiled else pose[k] for k in range(3)])
        assert np.isnan(bench.read(0.005)).all()
        bench.give(2, pose)
        np.testing.assert_allclose(bench.read(0.015), pose, atol=1e-15)

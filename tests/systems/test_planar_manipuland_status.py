import numpy as np
import pytest
from drake import lcmt_planar_manipuland_status
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from gridpush_drake.systems.planar_manipuland_status import PlanarManipulandStatusReceiver, PlanarManipulandStatusSender

PERIOD, MAX_AGE = 0.01, 0.1


class Bench:
    """A receiver to which a test gives messages."""

    def __init__(self):
        self.receiver = PlanarManipulandStatusReceiver(PERIOD, MAX_AGE)
        self.simulator = Simulator(self.receiver)
        self.give(0, (0.0, 0.0, 0.0))

    def give(self, utime, pose):
        message = lcmt_planar_manipuland_status()
        message.utime, message.position, message.theta = utime, [*pose[:2]], pose[2]
        port = self.receiver.get_input_port()
        port.FixValue(self.simulator.get_mutable_context(), AbstractValue.Make(message))

    def read(self, time):
        self.simulator.AdvanceTo(time)
        return np.array(self.receiver.get_output_port().Eval(self.simulator.get_context()))


def test_a_pose_is_held_until_the_next_message_or_until_it_is_too_old():
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


def test_the_yaw_counts_whole_turns_even_where_the_object_was_not_seen():
    bench = Bench()
    for k in range(1, 30):
        yaw = 0.5 * k
        wrapped = np.arctan2(np.sin(yaw), np.cos(yaw))
        bench.give(k, (0.0, 0.0, wrapped if k % 5 else np.nan))
        if k % 5:
            assert bench.read(0.01 * k + 0.005)[2] == pytest.approx(yaw)


def test_what_the_sender_says_is_what_the_receiver_hears():
    sender = PlanarManipulandStatusSender()
    context = sender.CreateDefaultContext()
    context.SetTime(1.25)
    sender.get_input_port().FixValue(context, [0.6, -0.1, 0.3])
    message = lcmt_planar_manipuland_status.decode(sender.get_output_port().Eval(context).encode())
    assert (message.utime, list(message.position), message.theta) == (1_250_000, [0.6, -0.1], 0.3)
    bench = Bench()
    bench.give(message.utime, (*message.position, message.theta))
    np.testing.assert_allclose(bench.read(0.005), [0.6, -0.1, 0.3], atol=1e-15)

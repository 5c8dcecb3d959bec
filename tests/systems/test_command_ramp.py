import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from gridpush_drake.systems.robot_records import ArmCommand
from gridpush_drake.systems.safety.command_ramp import CommandRamp
from gridpush_drake.systems.safety.guard_status import GuardMode

PERIOD = 0.005
SPEED, ACCELERATION = np.array([1.0, 2.0]), np.array([10.0, 5.0])
BEGIN = np.array([0.3, -0.7])


class RampBench:
    """A `CommandRamp` whose commands a test sends, or not."""

    def __init__(self):
        self.ramp = CommandRamp(SPEED, ACCELERATION, max_age=0.02, period=PERIOD)
        self.simulator = Simulator(self.ramp)
        self.context, self.positions = self.simulator.get_mutable_context(), []
        self.ramp.GetInputPort("position_measured").FixValue(self.context, BEGIN)
        self.target, self.sent = BEGIN, 0.0

    def command(self, position, sent):
        command = AbstractValue.Make(ArmCommand(sent, position))
        self.ramp.GetInputPort("command").FixValue(self.context, command)
        self.target, self.sent = np.array(position), sent

    def step(self):
        self.simulator.AdvanceTo(len(self.positions) * PERIOD)
        self.simulator.AdvancePendingEvents()
        self.positions.append(np.array(self.ramp.GetOutputPort("position").Eval(self.context)))
        return self.ramp.GetOutputPort("status").Eval(self.context)

    def go(self, count, velocity=(0.4, -0.3)):
        """Commands that speed up to a velocity within the limits."""
        speed = (
            np.zeros(2)
            if len(self.positions) < 2
            else (self.positions[-1] - self.positions[-2]) / PERIOD
        )
        for _ in range(count):
            unit = ACCELERATION * PERIOD
            speed = np.clip(velocity, speed - unit, speed + unit)
            self.command(self.target + PERIOD * speed, self.sent + PERIOD)
            status = self.step()
        return status


def test_a_ramp_passes_commands_on_and_brings_the_arm_to_rest_where_none_come():
    bench = RampBench()
    assert bench.step().mode == GuardMode.WAITING
    assert bench.go(60).mode == GuardMode.FOLLOWING
    np.testing.assert_allclose(bench.positions[-1], bench.target, atol=1e-12)
    last = len(bench.positions) - 1
    statuses = [bench.step() for _ in range(30)]
    modes = [status.mode for status in statuses]
    assert modes[:3] == [GuardMode.FOLLOWING] * 3
    assert modes[3] == GuardMode.STOPPING
    assert modes[-1] == GuardMode.HOLDING
    assert statuses[-1].reason == "no command has come for 20 ms; 20 ms are allowed"
    velocity = np.diff(bench.positions, axis=0) / PERIOD
    np.testing.assert_allclose(velocity[last : last + 3], [[0.4, -0.3]] * 3, atol=1e-9)
    assert not velocity[last + 3 + round(0.06 / PERIOD) :].any()  # 0.3 rad/s at 5 rad/s2
    # commands that begin again where they were left off are followed again, from where the arm is
    assert bench.go(200, (0.1, 0.1)).mode == GuardMode.FOLLOWING
    np.testing.assert_allclose(bench.positions[-1], bench.target, atol=1e-9)
    velocity = np.diff(bench.positions, axis=0) / PERIOD
    assert (np.abs(velocity) <= SPEED * (1 + 1e-9)).all()
    assert (np.abs(np.diff(velocity, axis=0)) <= ACCELERATION * PERIOD * (1 + 1e-9)).all()


def test_a_ramp_bridges_a_missing_command_and_leaves_out_what_was_overtaken_or_is_no_number():
    bench = RampBench()
    bench.step()
    bench.go(60)
    before = bench.positions[-1]
    for position, sent in (
        (bench.target - [0.1, 0.1], bench.sent - 2 * PERIOD),
        ([np.nan, 0.0], bench.sent + PERIOD),
        (bench.target, bench.sent),
    ):
        target, last = bench.target, bench.sent
        bench.command(position, sent)
        assert bench.step().mode == GuardMode.FOLLOWING
        bench.command(target + PERIOD * np.array([0.4, -0.3]), last + PERIOD)
    bench.step()
    np.testing.assert_allclose(
        bench.positions[-1], before + 4 * PERIOD * np.array([0.4, -0.3]), atol=2e-3
    )
    bench.go(20)
    np.testing.assert_allclose(bench.positions[-1], bench.target, atol=1e-9)

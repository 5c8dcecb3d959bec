import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator

from gridpush_drake.systems.arm_guard import (
    BY_SILENCE,
    ArmGuard,
    CommandRamp,
    GuardLimits,
    GuardMode,
    brake,
    follow,
)

PERIOD = 0.005
LIMITS = GuardLimits(
    speed=np.array([1.0, 2.0]), acceleration=np.array([10.0, 5.0]), torque=np.array([30.0, 4.0])
)
BEGIN = np.array([0.3, -0.7])
POSE = np.array([0.6, 0.1, 0.2])


class Bench:
    """A guard whose inputs a test sets, one update after another."""

    def __init__(self, validator=None):
        self.guard = ArmGuard(LIMITS, validator, PERIOD)
        self.simulator = Simulator(self.guard)
        self.context = self.simulator.get_mutable_context()
        self.inputs = {
            "position_desired": BEGIN, "position_measured": BEGIN, "torque_external": np.zeros(2),
            "force": np.zeros(3), "time_measured": np.zeros(1), "pusher_state": np.zeros(6), "object_pose": POSE,
            "stop": np.zeros(1),
        }  # fmt: skip
        self.positions, self.clock = [], 0.0

    def step(self, fresh=True, **changed):
        """One update, with a new status unless told otherwise; returns the guard's status.

        The robot's clock goes on by a period with every update.
        """
        self.clock += PERIOD
        self.inputs |= {name: np.asarray(value, float) for name, value in changed.items()}
        if fresh and "time_measured" not in changed:
            self.inputs["time_measured"] = np.array([self.clock])
        for name, value in self.inputs.items():
            self.guard.GetInputPort(name).FixValue(self.context, value)
        if self.positions:
            self.simulator.AdvanceTo(len(self.positions) * PERIOD)
        self.simulator.AdvancePendingEvents()
        self.positions.append(np.array(self.guard.GetOutputPort("position").Eval(self.context)))
        return self.guard.GetOutputPort("status").Eval(self.context)

    def run(self, count, **changed):
        return [self.step(**changed) for _ in range(count)][-1]

    def follow_ramp(self, count=40, velocity=(0.4, -0.3)):
        """Brings the joints to a velocity, which the command has by then."""
        speed = np.zeros(2)
        for _ in range(count):
            speed = np.clip(
                speed + LIMITS.acceleration * PERIOD, -np.abs(velocity), np.abs(velocity)
            )
            desired = self.inputs["position_desired"] + PERIOD * speed * np.sign(velocity)
            self.step(
                position_desired=desired,
                position_measured=self.positions[-1] if self.positions else BEGIN,
            )
        np.testing.assert_allclose(self.velocity, velocity, rtol=1e-9)

    @property
    def velocity(self):
        return (self.positions[-1] - self.positions[-2]) / PERIOD

    def check_limits(self):
        velocity = np.diff(self.positions, axis=0) / PERIOD
        assert (np.abs(velocity) <= LIMITS.speed * (1 + 1e-9)).all()
        assert (
            np.abs(np.diff(velocity, axis=0)) <= LIMITS.acceleration * PERIOD * (1 + 1e-9)
        ).all()


def check_stopped(bench, says):
    """It stops at once, as fast as is allowed, keeps the limits, stays where it is, and says why."""
    status = bench.guard.GetOutputPort("status").Eval(bench.context)
    assert says in status.reason
    assert status.mode in (GuardMode.STOPPING, GuardMode.HOLDING)
    fastest = np.max(np.abs(bench.velocity) / LIMITS.acceleration)
    noticed = status.since
    while bench.step(fresh=False).mode != GuardMode.HOLDING:
        assert bench.context.get_time() - noticed < fastest + 2 * PERIOD + 0.1
    held = bench.positions[-1]
    # nothing moves it any more: neither what is wanted, nor that all is well again
    status = bench.run(
        20, position_desired=held + 1.0, torque_external=np.zeros(2), object_pose=POSE, stop=[0]
    )
    assert (status.mode, says in status.reason, status.since) == (GuardMode.HOLDING, True, noticed)
    np.testing.assert_array_equal(bench.positions[-1], held)
    bench.check_limits()


def test_it_waits_for_the_robot_and_begins_where_that_is():
    bench = Bench()
    assert bench.step(position_measured=[np.nan, np.nan]).mode == GuardMode.WAITING
    assert np.isnan(bench.positions[-1]).all()
    far = BEGIN + [0.5, -0.5]
    assert bench.step(position_measured=BEGIN, position_desired=far).mode == GuardMode.FOLLOWING
    np.testing.assert_array_equal(bench.positions[-1], BEGIN)
    bench.positions = bench.positions[1:]
    bench.run(300)
    np.testing.assert_allclose(bench.positions[-1], far, atol=1e-12)
    bench.check_limits()
    assert np.diff(bench.positions, axis=0)[:, 0].min() > -1e-12  # it does not overshoot


def test_what_keeps_the_limits_is_passed_on_as_it_is():
    bench = Bench()
    bench.step()
    for t in np.arange(0.0, 2.0, PERIOD):
        desired = BEGIN + np.array([0.2, -0.3]) * (1 - np.cos(2 * t)) / 2
        bench.step(position_desired=desired)
        np.testing.assert_allclose(bench.positions[-1], desired, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(
    targets=st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2)), min_size=2, max_size=15),
    hold=st.integers(1, 30),
)
def test_whatever_is_wanted_the_limits_are_kept_and_rest_is_reached(targets, hold):
    motion, before = [(np.zeros(2), np.zeros(2))], np.zeros(2)
    for target in [*np.repeat(targets, hold, axis=0), *[np.array(targets[-1])] * 1000]:
        motion.append(
            follow(*motion[-1], before, target, LIMITS.speed, LIMITS.acceleration, PERIOD)
        )
        before = target
    q, v = (np.array(part) for part in zip(*motion, strict=True))
    assert (np.abs(v) <= LIMITS.speed * (1 + 1e-9)).all()
    assert (np.abs(np.diff(v, axis=0)) <= LIMITS.acceleration * PERIOD * (1 + 1e-9)).all()
    np.testing.assert_allclose(np.diff(q, axis=0), v[1:] * PERIOD, atol=1e-12)
    np.testing.assert_allclose(q[-1], targets[-1], atol=1e-9)
    np.testing.assert_allclose(v[-1], 0.0, atol=1e-9)


def test_braking_keeps_the_direction_and_takes_as_long_as_the_slowest_joint_needs():
    v = v0 = np.array([0.2, -0.5])
    steps = 0
    while v.any():
        before, v = v, brake(v, LIMITS.acceleration, PERIOD)
        assert (np.abs(v - before) <= LIMITS.acceleration * PERIOD * (1 + 1e-9)).all()
        assert abs(v[0] * v0[1] - v[1] * v0[0]) < 1e-12
        steps += 1
    assert steps == pytest.approx(0.5 / 5.0 / PERIOD, abs=1)


def test_an_old_status_stops_the_arm_no_sooner_than_is_allowed():
    bench = Bench()
    bench.follow_ramp()
    allowed = round(LIMITS.status_age / PERIOD) - 1
    for _ in range(allowed):
        assert bench.step(fresh=False).mode == GuardMode.FOLLOWING
    assert bench.step(fresh=False).mode == GuardMode.STOPPING
    check_stopped(bench, "no status for 50 ms; 50 ms are allowed")


def test_a_blocked_arm_goes_back_to_where_it_was_when_that_was_noticed():
    bench = Bench()
    bench.follow_ramp()
    touched = bench.positions[-1] - [0.004, -0.003]
    bench.step(position_measured=touched, torque_external=[12.0, -3.9])
    assert bench.step(torque_external=[12.0, -4.1]).mode == GuardMode.STOPPING
    check_stopped(bench, "the external torque on joint 2 is 4.1 N m; 4.0 N m are allowed")
    np.testing.assert_allclose(bench.positions[-1], touched, atol=1e-9)


@pytest.mark.parametrize(
    ("pose", "says"),
    [
        ((0.6, 0.14, 0.2), "jump by 40 mm and 0.00 rad"),
        ((0.6, 0.1, 0.2 - 0.4), "jump by 0 mm and 0.40 rad"),
    ],
)
def test_a_jump_of_the_pose_stops_the_arm(pose, says):
    bench = Bench()
    bench.follow_ramp()
    assert bench.step(object_pose=pose).mode == GuardMode.STOPPING
    check_stopped(bench, says)


def test_an_object_that_slides_turns_round_or_is_hidden_for_a_while_is_no_jump():
    bench = Bench()
    bench.follow_ramp()
    assert bench.step(object_pose=POSE + [0.005, 0.0, 2 * np.pi]).mode == GuardMode.FOLLOWING
    bench.run(60, object_pose=np.full(3, np.nan))  # 0.3 s
    assert bench.step(object_pose=POSE + [0.15, 0.0, 0.0]).mode == GuardMode.FOLLOWING
    assert bench.step(object_pose=POSE + [0.15, 0.034, 0.0]).stopped


def test_leaving_the_workspace_ctrl_c_and_numbers_that_are_none_stop_the_arm():
    def validator(p_WP):
        return "the tip is too low" if p_WP[2] < 0 else None

    for change, says in (
        ({"pusher_state": [0, 0, -0.01, 0, 0, 0]}, "the tip is too low"),
        ({"stop": [1]}, "stopped by the user"),
        ({"position_desired": [np.nan, 0.0]}, "position_desired has numbers that are not finite"),
        ({"position_measured": [np.inf, 0.0]}, "position_measured has numbers that are not finite"),
    ):
        bench = Bench(validator)
        bench.follow_ramp()
        assert bench.step(**change).mode == GuardMode.STOPPING
        bench.step(pusher_state=np.zeros(6), position_measured=BEGIN)
        check_stopped(bench, says)


def test_after_a_pause_of_the_commands_they_begin_at_rest():
    bench = Bench()
    bench.follow_ramp()
    last, now = bench.positions[-1], bench.inputs["time_measured"]
    desired = bench.inputs["position_desired"] + PERIOD * np.array([0.4, -0.3])
    assert bench.step(time_measured=now + 1.0, position_desired=desired).mode == GuardMode.FOLLOWING
    assert (
        np.abs(bench.positions[-1] - last) <= LIMITS.acceleration * PERIOD**2 * (1 + 1e-9)
    ).all()


def test_two_contexts_do_not_meet():
    bench = Bench()
    bench.follow_ramp()
    other = bench.context.Clone()
    bench.step(stop=[1])
    assert bench.guard.GetOutputPort("status").Eval(other).mode == GuardMode.FOLLOWING
    fresh = bench.guard.CreateDefaultContext()
    assert bench.guard.GetOutputPort("status").Eval(fresh).mode == GuardMode.WAITING


def test_told_of_a_silence_it_holds_what_it_commanded_last():
    bench = Bench()
    bench.follow_ramp()
    last = bench.positions[-1]
    status = bench.step(fresh=False, stop=[BY_SILENCE])
    assert status.mode == GuardMode.HOLDING
    assert "the robot has sent no status for 50 ms" in status.reason
    np.testing.assert_array_equal(bench.positions[-1], last)


def test_a_force_on_the_tip_stops_the_arm_and_takes_it_back():
    bench = Bench()
    bench.follow_ramp()
    touched = bench.positions[-1] - [0.002, -0.001]
    assert (
        bench.step(position_measured=touched, force=[0.0, 18.0, -23.9]).mode == GuardMode.FOLLOWING
    )
    assert bench.step(force=[0.0, 18.0, -24.1]).mode == GuardMode.STOPPING
    bench.step(force=np.zeros(3))
    check_stopped(bench, "the force on the finger's tip is 30.1 N; 30.0 N are allowed")
    np.testing.assert_allclose(bench.positions[-1], touched, atol=1e-9)


class RampBench:
    """A `CommandRamp` whose commands a test sends, or not."""

    def __init__(self):
        self.ramp = CommandRamp(LIMITS.speed, LIMITS.acceleration, max_age=0.02, period=PERIOD)
        self.simulator = Simulator(self.ramp)
        self.context, self.positions = self.simulator.get_mutable_context(), []
        self.command(BEGIN, 0.0)

    def command(self, position, sent):
        self.ramp.GetInputPort("position_desired").FixValue(self.context, position)
        self.ramp.GetInputPort("time_sent").FixValue(self.context, [sent])
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
            unit = LIMITS.acceleration * PERIOD
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
    assert (np.abs(velocity) <= LIMITS.speed * (1 + 1e-9)).all()
    assert (np.abs(np.diff(velocity, axis=0)) <= LIMITS.acceleration * PERIOD * (1 + 1e-9)).all()


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

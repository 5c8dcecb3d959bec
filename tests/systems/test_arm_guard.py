import os
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator

from gridpush_drake.systems.base.messages import GraspPhase, GraspStatus
from gridpush_drake.systems.safety.arm_guard import CONFIRM_TIME, ArmGuard
from gridpush_drake.systems.safety.guard_retreat import RETREAT_SPEED_FRACTION, RETREAT_TIP_SPEED
from gridpush_drake.systems.safety.guard_status import (
    BY_SILENCE,
    BY_USER,
    RETREAT_DONE,
    GuardLimits,
    GuardMode,
    StopKind,
)
from gridpush_drake.systems.sensing.object_watch import ObjectWatch

PERIOD = 0.005
LIMITS = GuardLimits(
    speed=np.array([1.0, 2.0]),
    acceleration=np.array([10.0, 5.0]),
    torque=np.array([30.0, 4.0]),
    position_lower=np.array([-2.4, -2.2]),
    position_upper=np.array([2.4, 2.2]),
)
BEGIN = np.array([0.3, -0.7])
POSE = np.array([0.6, 0.1, 0.2])
LATE = 3
"""Periods that the arm is behind its commands, as the twin's is."""

MM = 1e-3


def calc_tip(q):
    """A planar arm of two links, 0.5 and 0.4 m."""
    x = 0.5 * np.cos(q[0]) + 0.4 * np.cos(q[0] + q[1])
    y = 0.5 * np.sin(q[0]) + 0.4 * np.sin(q[0] + q[1])
    return np.array([x, y, 0.05])


class Bench:
    """A guard with an arm that follows its commands a little late; a test may spoil what it is told.

    Attributes:
        positions: (n,) commanded, one a period.
        clock: the robot's, s; it goes on by a period with every update.
        blocked: whether the arm cannot move; the torques then grow with the commands.
    """

    def __init__(self, validator=None, object_watch=None, limits=LIMITS):
        self.limits = limits
        self.guard = ArmGuard(limits, calc_tip, validator, PERIOD, object_watch)
        self.simulator = Simulator(self.guard)
        self.context = self.simulator.get_mutable_context()
        self.inputs = {
            "position_desired": BEGIN, "position_measured": BEGIN, "torque_external": np.zeros(2),
            "force": np.zeros(3), "time_measured": np.zeros(1), "pusher_state": np.zeros(6), "object_pose": POSE,
            "stop": np.zeros(1),
        }  # fmt: skip
        self.positions, self.clock, self.steps = [], 0.0, 0
        self.blocked, self.place = False, BEGIN
        self.fix(self.inputs)

    def fix(self, values):
        """Writes values, by the ports' names."""
        self.inputs |= values
        for name, value in values.items():
            self.guard.GetInputPort(name).FixValue(self.context, value)

    def step(self, fresh=True, follows=True, **changed):
        """One update, with a new status unless told otherwise; returns the guard's status."""
        self.clock += PERIOD
        if not self.blocked and len(self.positions) >= LATE:
            self.place = self.positions[-LATE]
        told = {"position_measured": self.place} if follows else {}
        if follows and "pusher_state" not in changed:
            told["pusher_state"] = np.concatenate([calc_tip(self.place), np.zeros(3)])
        told |= {name: np.asarray(value, float) for name, value in changed.items()}
        if fresh and "time_measured" not in changed:
            told["time_measured"] = np.array([self.clock])
        self.fix(told)
        if self.steps:
            self.simulator.AdvanceTo(self.steps * PERIOD)
        self.simulator.AdvancePendingEvents()
        self.steps += 1
        position = np.array(self.guard.GetOutputPort("position").Eval(self.context))
        if np.isfinite(position).all():
            self.positions.append(position)
        return self.status

    @property
    def status(self):
        return self.guard.GetOutputPort("status").Eval(self.context)

    @property
    def time(self):
        return self.context.get_time()

    def run(self, count, **changed):
        return [self.step(**changed) for _ in range(count)][-1]

    def follow_ramp(self, count=40, velocity=(0.4, -0.3)):
        """Brings the joints to a velocity, which the command has by then."""
        while self.step().mode == GuardMode.WAITING:
            pass
        speed = np.zeros(2)
        for _ in range(count):
            speed = np.clip(
                speed + LIMITS.acceleration * PERIOD, -np.abs(velocity), np.abs(velocity)
            )
            desired = self.inputs["position_desired"] + PERIOD * speed * np.sign(velocity)
            assert self.step(position_desired=desired).mode == GuardMode.FOLLOWING, self.status
        np.testing.assert_allclose(self.velocity, velocity, rtol=1e-9)

    def rest(self, seconds=2.0, **changed):
        """Goes on until a stopped arm is at rest."""
        for _ in range(round(seconds / PERIOD)):
            if self.step(**changed).ended:
                return self.status
        raise AssertionError(f"it does not come to rest: {self.status}")

    @property
    def velocity(self):
        return (self.positions[-1] - self.positions[-2]) / PERIOD

    def check_limits(self):
        velocity = np.diff(self.positions, axis=0) / PERIOD
        assert (np.abs(velocity) <= LIMITS.speed * (1 + 1e-9)).all()
        assert (
            np.abs(np.diff(velocity, axis=0)) <= LIMITS.acceleration * PERIOD * (1 + 1e-9)
        ).all()


def measure_travel(positions):
    """How far the tip goes through joint positions, m."""
    tips = np.array([calc_tip(q) for q in positions])
    return float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())


def check_stop(positions, stopped, retreats, limits=LIMITS, rested=()):
    """What is promised of the commands from `stopped` on, the index of the first one after a stop.

    They brake in a straight line, as short as the accelerations allow; then they rest, or go back
    along the way that they came, by no more than the retreat. Returns the index at which they have
    braked.
    """
    velocity = (positions[stopped - 1] - positions[stopped - 2]) / PERIOD
    duration = float(np.max(np.abs(velocity) / limits.acceleration))
    braked = stopped - 1 + int(np.ceil(duration / PERIOD - 1e-6))
    braked = min([braked, len(positions) - 1, *(k - 1 for k in rested if k >= stopped)])
    line = np.array(positions[stopped - 1 : braked + 1]) - positions[stopped - 1]
    forward = np.abs(line) <= np.abs(velocity) * duration / 2 + 1e-9
    assert forward.all()
    assert (line * velocity >= -1e-12).all()
    after = positions[braked:]
    if not retreats:
        assert np.abs(np.array(after) - positions[braked]).max() < 1e-12
        return braked
    assert measure_travel(after) <= limits.retreat + 1e-7
    came = np.array(positions[: braked + 1])
    for position in after[::5]:
        assert np.abs(came - position).max(axis=1).min() < 0.006, "it left the way that it came"
    return braked


def check_stopped(bench, says, retreats=False, **others):
    """It stops at once, keeps the limits, stays where it is, and says why."""
    stopped = len(bench.positions) - 1
    status, noticed = bench.status, bench.status.since
    assert says in status.reason
    assert status.stopped
    assert bench.rest(**others).mode == GuardMode.HOLDING
    held = bench.positions[-1]
    # nothing moves it any more: neither what is wanted, nor that all is well again
    healthy = {"torque_external": np.zeros(2), "force": np.zeros(3), "object_pose": POSE}
    status = bench.run(20, position_desired=held + 1.0, stop=[0], **healthy)
    assert (status.mode, says in status.reason, status.since) == (GuardMode.HOLDING, True, noticed)
    np.testing.assert_array_equal(bench.positions[-1], held)
    bench.check_limits()
    check_stop(bench.positions, stopped, retreats)


def test_it_waits_for_the_robot_and_begins_where_two_statuses_say_that_it_is():
    bench = Bench()
    assert bench.step(position_measured=[np.nan, np.nan]).mode == GuardMode.WAITING
    assert bench.step(position_measured=BEGIN + 1.0).mode == GuardMode.WAITING  # a wrong one
    far = BEGIN + [0.5, -0.5]
    assert bench.step(position_desired=far).mode == GuardMode.WAITING
    assert not bench.positions
    assert bench.step().mode == GuardMode.FOLLOWING
    np.testing.assert_array_equal(bench.positions[-1], BEGIN)
    bench.run(300)
    np.testing.assert_allclose(bench.positions[-1], far, atol=1e-12)
    bench.check_limits()
    assert np.diff(bench.positions, axis=0)[:, 0].min() > -1e-12  # it does not overshoot


def test_what_keeps_the_limits_is_passed_on_as_it_is():
    bench = Bench()
    bench.run(2)
    for t in np.arange(0.0, 2.0, PERIOD):
        desired = BEGIN + np.array([0.2, -0.3]) * (1 - np.cos(2 * t)) / 2
        bench.step(position_desired=desired)
        np.testing.assert_allclose(bench.positions[-1], desired, atol=1e-12)


def begin_near_limit(**limits):
    """A guard whose first joint stands 0.2 rad before its upper limit, 2.4 rad."""
    bench = Bench(limits=replace(LIMITS, **limits))
    bench.place = np.array([2.2, 0.0])
    while bench.step(position_desired=bench.place).mode == GuardMode.WAITING:
        pass
    return bench


@pytest.mark.parametrize("speed", [0.1, 0.4, 1.0, 100.0])
def test_a_joint_that_is_desired_beyond_its_limits_stops_within_them(speed):
    bench = begin_near_limit()
    desired = bench.place
    for _ in range(500):
        desired = np.minimum(desired + [PERIOD * speed, 0.0], [2.5, 0.0])
        if bench.step(position_desired=desired).stopped:
            break
    assert desired[0] > LIMITS.position_upper[0]
    check_stopped(bench, "joint 1 is wanted at 2.")
    assert "; its limits are -2.400 and 2.400 rad" in bench.status.reason
    assert np.max(bench.positions, axis=0)[0] <= LIMITS.position_upper[0]


def test_braking_in_a_straight_line_ends_within_the_limits_of_each_joint():
    """Joint 2 needs 0.4 s to brake, joint 1 alone 0.05 s: together they would go 2.45 rad far."""
    bench = begin_near_limit()
    speed = np.zeros(2)
    while bench.positions[-1][0] < 2.35:
        speed = np.minimum(speed + LIMITS.acceleration * PERIOD, [0.5, 2.0])
        desired = bench.inputs["position_desired"] + PERIOD * speed
        assert bench.step(position_desired=desired).mode == GuardMode.FOLLOWING
    assert bench.velocity[1] / LIMITS.acceleration[1] > 0.25
    assert bench.step(stop=[BY_USER]).mode == GuardMode.STOPPING
    assert bench.rest().mode == GuardMode.HOLDING
    assert np.max(bench.positions, axis=0)[0] <= LIMITS.position_upper[0]
    bench.check_limits()


@pytest.mark.parametrize(
    ("wrong", "kind"),
    [
        ({"stop": [BY_USER]}, StopKind.USER),
        ({"force": [0.0, 0.0, 31.0]}, StopKind.FORCE),
        ({"torque_external": [31.0, 0.0]}, StopKind.TORQUE),
        ({"force": [np.nan, 0.0, 0.0]}, StopKind.NOT_FINITE),
        ({"position_desired": [2.5, 0.0]}, StopKind.JOINT_LIMIT),
    ],
)
def test_what_is_wrong_in_the_period_in_which_it_begins_to_follow_stops_the_arm(wrong, kind):
    bench = Bench()
    assert bench.step().mode == GuardMode.WAITING
    assert bench.step(**wrong).mode == GuardMode.STOPPING
    assert bench.status.kinds == (kind,)
    healthy = {"stop": [0.0], "force": np.zeros(3), "torque_external": np.zeros(2)}
    bench.run(40, position_desired=BEGIN + 0.1, **healthy)
    assert bench.status.mode == GuardMode.HOLDING
    np.testing.assert_array_equal(np.array(bench.positions), np.tile(BEGIN, (41, 1)))


@pytest.mark.parametrize(
    ("stop", "kind"), [(BY_USER, StopKind.USER), (RETREAT_DONE, StopKind.DONE)]
)
def test_a_stop_while_it_waits_for_the_robot_is_kept(stop, kind):
    bench = Bench()
    status = bench.step(position_measured=[np.nan, np.nan], stop=[stop])
    assert (status.mode, status.kinds, status.ended) == (GuardMode.WAITING, (kind,), True)
    bench.run(40, stop=[0.0], position_desired=BEGIN + 0.1)
    assert (bench.status.mode, bench.status.kinds) == (GuardMode.HOLDING, (kind,))
    np.testing.assert_array_equal(np.ptp(bench.positions, axis=0), [0.0, 0.0])


def test_an_old_status_stops_the_arm_no_sooner_than_is_allowed():
    bench = Bench()
    bench.follow_ramp()
    allowed = round(LIMITS.status_age / PERIOD) - 1
    for _ in range(allowed):
        assert bench.step(fresh=False, follows=False).mode == GuardMode.FOLLOWING
    assert bench.step(fresh=False, follows=False).mode == GuardMode.STOPPING
    check_stopped(bench, "no status for 50 ms; 50 ms are allowed")


def test_it_is_held_only_where_it_is_measured_at_rest():
    for spoiled in (
        {"fresh": False},  # no status
        {"follows": False},  # one that says the same for ever, away from the commands
    ):
        bench = Bench()
        bench.follow_ramp()
        bench.inputs["position_measured"] = bench.place - 0.1
        status = bench.step(stop=[BY_USER], position_measured=bench.place - 0.03)
        assert status.mode == GuardMode.STOPPING
        assert bench.rest(**spoiled).mode == GuardMode.UNCONFIRMED
        # where it is measured at rest again after all, it is held
        status = bench.run(20)
        assert status.mode == GuardMode.HOLDING
        assert status.by_user
    # an arm that swings on though it was told to rest
    bench = Bench()
    bench.follow_ramp()
    bench.step(stop=[BY_USER])
    begun, angle = bench.time, 0.0
    while not bench.status.ended:
        angle += 0.5
        swing = 0.005 * np.sin(angle)
        bench.step(position_measured=bench.place + swing)
    assert bench.status.mode == GuardMode.UNCONFIRMED
    assert bench.time - begun > CONFIRM_TIME


def press(bench, stiffness=2000.0):
    """Torques of an arm that cannot move, by how far its commands are away."""
    return stiffness * (bench.place - bench.positions[-1])


def test_a_blocked_arm_goes_back_along_its_way_and_presses_no_more():
    bench = Bench()
    bench.follow_ramp(count=60)
    bench.blocked = True
    before = len(bench.positions)
    velocity = bench.velocity
    while not bench.status.stopped:
        desired = bench.inputs["position_desired"] + PERIOD * velocity
        bench.step(position_desired=desired, torque_external=press(bench))
        assert len(bench.positions) < before + 20
    stopped, pressed = len(bench.positions) - 1, press(bench)
    assert "the external torque on joint 2 is" in bench.status.reason
    assert "4.0 N m are allowed" in bench.status.reason
    while not bench.status.ended:
        bench.step(torque_external=press(bench))
    status = bench.status
    assert (status.mode, status.kinds) == (GuardMode.HOLDING, (StopKind.TORQUE,))
    assert (press(bench) * pressed < 0).all()  # it pulls the other way, after 10 mm
    braked = check_stop(bench.positions, stopped, retreats=True)
    assert measure_travel(bench.positions[braked:]) > 0.9 * LIMITS.retreat
    bench.check_limits()


def test_a_force_on_the_tip_stops_the_arm_and_takes_it_back_slowly():
    bench = Bench()
    bench.follow_ramp(count=80)
    assert bench.step(force=[0.0, 18.0, -23.9]).mode == GuardMode.FOLLOWING
    assert bench.step(force=[0.0, 18.0, -24.1]).mode == GuardMode.STOPPING
    begun, stopped = bench.time, len(bench.positions) - 1
    check_stopped(
        bench,
        "the force on the finger's tip is 30.1 N; 30.0 N are allowed",
        retreats=True,
        force=np.zeros(3),
    )
    assert bench.status.kinds == (StopKind.FORCE,)
    braked = check_stop(bench.positions, stopped, retreats=True)
    assert measure_travel(bench.positions[braked:]) == pytest.approx(LIMITS.retreat, rel=1e-3)
    back = np.diff(bench.positions[braked:], axis=0) / PERIOD
    assert (np.abs(back) <= RETREAT_SPEED_FRACTION * LIMITS.speed + 1e-9).all()
    tips = np.array([calc_tip(q) for q in bench.positions[braked:]])
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 1.2 * RETREAT_TIP_SPEED * PERIOD
    assert bench.time - begun > LIMITS.retreat / RETREAT_TIP_SPEED


@pytest.mark.parametrize("wrong", [[1.5, -1.5], [0.1, 0.0], [-0.03, 0.02], [np.nan, 0.0]])
@pytest.mark.parametrize("lasting", [1, 1000])
def test_wrong_joints_with_a_torque_lead_the_arm_nowhere_but_back_on_its_way(wrong, lasting):
    """A bit error, or the status of another robot, in one status or from then on."""
    bench = Bench()
    bench.follow_ramp(count=80)
    stopped = len(bench.positions)
    spoiled = {"position_measured": bench.place + wrong, "torque_external": [60.0, 0.0]}
    for _ in range(min(lasting, 400)):
        bench.step(**spoiled)
    bench.run(300, torque_external=[0.0, 0.0])
    assert bench.status.stopped
    bench.check_limits()
    check_stop(bench.positions, stopped, retreats=True)
    assert bench.status.mode == GuardMode.HOLDING


def test_it_says_when_it_will_have_gone_back():
    bench = Bench(limits=replace(LIMITS, retreat=0.1))
    bench.follow_ramp(count=150)
    assert np.isnan(bench.status.back_at)
    status = bench.step(force=[40.0, 0.0, 0.0])
    assert status.kinds == (StopKind.FORCE,)
    assert np.isnan(status.back_at)  # it brakes first
    status = bench.rest(seconds=6.0, force=np.zeros(3))
    assert status.mode == GuardMode.HOLDING
    assert bench.time - status.since > 0.1 / RETREAT_TIP_SPEED
    assert abs(bench.time - status.back_at) < 0.1  # and it was measured at rest


def test_a_further_fault_ends_the_retreat_where_it_is_and_is_told():
    for spoiled, says in (
        ({"force": [0, 0, 45.0]}, "the force on the finger's tip is 45.0 N"),
        ({"pusher_state": [0, 0, -0.01, 0, 0, 0]}, "the tip is too low"),
        ({"torque_external": [np.nan, 0]}, "torque_external has numbers that are not finite"),
        ({"position_measured": BEGIN + 1.0}, "was measured to move at"),
        ({"stop": [BY_USER]}, "stopped by the user"),
    ):
        bench = Bench(lambda p_WP, yaw: "the tip is too low" if p_WP[2] < 0 else None)
        bench.follow_ramp(count=80)
        bench.step(torque_external=[31.0, 0.0])
        bench.run(30, torque_external=np.zeros(2))
        assert bench.status.mode == GuardMode.STOPPING
        place = bench.positions[-1]
        bench.step(**spoiled)
        healthy = {"force": np.zeros(3), "torque_external": np.zeros(2), "stop": [0.0]}
        bench.rest(**healthy)
        assert (
            f"; then, while it was stopped, {says}" in bench.status.reason
            or says in bench.status.reason
        )
        assert bench.status.reason.startswith("the external torque on joint 1 is 31.0 N m")
        assert not bench.status.by_user
        assert measure_travel([place, bench.positions[-1]]) < 1 * MM
        bench.check_limits()


def test_a_torque_that_falls_slowly_is_not_a_further_one():
    bench = Bench()
    bench.follow_ramp(count=80)
    stopped = len(bench.positions)
    torque = 31.0
    bench.step(torque_external=[torque, 0.0])
    while not bench.status.ended:
        early = bench.time - bench.status.since < 0.05
        torque *= 1.02 if early else 0.99
        bench.step(torque_external=[torque, 0.0])
    assert bench.status.kinds == (StopKind.TORQUE,)
    assert measure_travel(bench.positions[stopped:]) > 0.9 * LIMITS.retreat


def test_what_goes_wrong_while_it_is_held_is_told_and_moves_nothing():
    bench = Bench()
    bench.follow_ramp()
    bench.step(stop=[RETREAT_DONE])
    assert bench.rest().mode == GuardMode.HOLDING
    assert not bench.status.failed
    held = bench.positions[-1]
    status = bench.run(20, torque_external=[40.0, 0.0])
    assert status.reason == (
        "the work is done; then, while it was held, the external torque on joint 1 is 40.0 N m; "
        "30.0 N m are allowed"
    )
    assert status.failed
    status = bench.run(20, torque_external=[50.0, 0.0], force=[99.0, 0.0, 0.0])
    assert status.kinds == (StopKind.DONE, StopKind.TORQUE, StopKind.FORCE)  # each is told once
    np.testing.assert_array_equal(bench.positions[-1], held)


def test_joints_that_stay_behind_their_commands_stop_the_arm():
    bench = Bench()
    bench.follow_ramp()
    rng, place, begun, velocity = np.random.default_rng(1), bench.place, bench.time, bench.velocity
    while not bench.status.stopped:
        desired = bench.inputs["position_desired"] + PERIOD * velocity
        noise = 1e-5 * rng.normal(size=2)
        bench.step(position_desired=desired, position_measured=place + noise)
    assert (
        "rad from where it was told to be, for more than 50 ms; 0.020 rad is allowed"
        in bench.status.reason
    )
    assert bench.status.kinds == (StopKind.FOLLOWING,)
    assert bench.time - begun < 2 * 0.05 + 0.02 / 0.4 + 2 * PERIOD
    stopped = len(bench.positions) - 1
    bench.run(400, position_measured=place)
    check_stop(bench.positions, stopped, retreats=False)
    assert bench.status.mode == GuardMode.UNCONFIRMED  # it is not where it was told to be
    assert bench.status.failed


@pytest.mark.parametrize("speed", [0.03, 0.4])
def test_joints_that_are_frozen_in_the_status_are_noticed_within_moments(speed):
    bench = Bench()
    bench.follow_ramp(velocity=(speed, -speed / 2))
    place, begun, velocity = bench.place, bench.time, bench.velocity
    while not bench.status.stopped:
        desired = bench.inputs["position_desired"] + PERIOD * velocity
        bench.step(position_desired=desired, position_measured=place)
    assert "no joint's measured position has changed for" in bench.status.reason
    assert bench.time - begun < 0.1 + 0.002 / speed + 4 * PERIOD
    assert np.abs(bench.positions[-1] - place).max() < 0.008 + 0.2 * speed


def test_an_error_for_less_than_the_allowed_time_is_none():
    bench = Bench()
    bench.follow_ramp()
    velocity = bench.velocity
    for k in range(100):
        desired = bench.inputs["position_desired"] + PERIOD * velocity
        phase = k % 20  # too far off for 40 ms of 100
        gap = np.array([0.006 * min(phase, 4, max(14 - phase, 0)), 0.0])
        status = bench.step(position_desired=desired, position_measured=bench.place + gap)
        assert status.mode == GuardMode.FOLLOWING, status


def test_a_joint_that_is_measured_to_move_faster_than_it_can_stops_the_arm():
    bench = Bench()
    bench.follow_ramp()
    assert bench.step(position_measured=bench.place + [0.0, 0.05]).mode == GuardMode.STOPPING
    assert "between two statuses; it can move at 2.00 rad/s" in bench.status.reason
    check_stopped(bench, "joint 2 was measured to move at 10.00 rad/s")


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


WATCH = ObjectWatch(shapely.box(-0.1, -0.03, 0.1, 0.03), height=0.03, tip_radius=0.01)
BLADE = np.array([1.2, 0.5, 0.0])
"""Where the arm of these tests does not come near the object."""


def creep(bench, step, periods=7):
    """Moves the object on at every look, below what counts as a jump, until the arm stops."""
    pose, velocity = BLADE.copy(), bench.velocity
    for k in range(10 * periods):
        if bench.status.stopped:
            break
        pose = pose + [step if k % periods == 0 else 0.0, 0.0, 0.0]
        desired = bench.inputs["position_desired"] + PERIOD * velocity
        bench.step(object_pose=pose, position_desired=desired)
    return pose


@pytest.mark.parametrize("step", [0.005, 0.025, 0.029])
def test_an_object_that_creeps_with_nothing_near_it_stops_the_arm(step):
    bench = Bench(object_watch=WATCH)
    bench.fix({"object_pose": BLADE})
    bench.follow_ramp()
    pose = creep(bench, step)
    assert pose[0] - BLADE[0] < 0.01 + 1.5 * step
    assert "while nothing touched it; up to 10 mm may be noise" in bench.status.reason
    assert bench.status.kinds == (StopKind.OBJECT,)
    assert bench.rest().mode == GuardMode.HOLDING


def test_an_object_may_be_moved_by_hand_while_the_arm_is_idle_and_by_the_gripper():
    bench = Bench(object_watch=WATCH)
    bench.run(120)
    bench.inputs["position_desired"] = BEGIN
    for k in range(100):  # 0.2 m/s
        assert bench.step(object_pose=POSE + [0.001 * k, 0, 0]).mode == GuardMode.FOLLOWING
    bench = Bench(object_watch=WATCH)
    lifting = GraspStatus(phase=GraspPhase.LIFTING, command_id=1)
    bench.guard.GetInputPort("grasp_status").FixValue(bench.context, Value(lifting))
    bench.follow_ramp()
    for k in range(100):
        desired = bench.inputs["position_desired"] + PERIOD * np.array([0.4, -0.3])
        moved = bench.step(object_pose=POSE + [0.001 * k, 0, 0], position_desired=desired)
        assert moved.mode == GuardMode.FOLLOWING


def test_leaving_the_workspace_ctrl_c_and_numbers_that_are_none_stop_the_arm():
    def validator(p_WP, yaw):
        return "the tip is too low" if p_WP[2] < 0 else None

    nan = np.nan
    for change, says in (
        ({"pusher_state": [0, 0, -0.01, 0, 0, 0]}, "the tip is too low"),
        ({"pusher_state": [0, nan, 0.1, 0, 0, 0]}, "pusher_state has numbers that are not finite"),
        ({"stop": [1]}, "stopped by the user"),
        ({"stop": [nan]}, "stop has numbers that are not finite"),
        ({"position_desired": [nan, 0.0]}, "position_desired has numbers that are not finite"),
        ({"position_measured": [np.inf, 0.0]}, "position_measured has numbers that are not finite"),
        ({"time_measured": [nan]}, "time_measured has numbers that are not finite"),
        ({"force": [nan, 0.0, 0.0]}, "force has numbers that are not finite"),
    ):
        bench = Bench(validator)
        bench.follow_ramp()
        assert bench.step(**change).mode == GuardMode.STOPPING
        check_stopped(bench, says, stop=[0.0], force=np.zeros(3))


def test_after_a_pause_of_the_commands_they_begin_at_rest():
    bench = Bench()
    bench.follow_ramp()
    last = bench.positions[-1]
    bench.clock += 1.0
    desired = bench.inputs["position_desired"] + PERIOD * np.array([0.4, -0.3])
    assert bench.step(position_desired=desired).mode == GuardMode.FOLLOWING
    assert (
        np.abs(bench.positions[-1] - last) <= LIMITS.acceleration * PERIOD**2 * (1 + 1e-9)
    ).all()


def test_a_clock_that_goes_back_brings_no_new_status():
    bench = Bench()
    bench.follow_ramp()
    bench.clock -= 10.0
    modes = [bench.step().mode for _ in range(12)]
    assert modes[:9] == [GuardMode.FOLLOWING] * 9
    assert "the robot has sent no status for 50 ms" in bench.status.reason


def test_two_contexts_do_not_meet():
    bench = Bench()
    bench.follow_ramp()
    other = bench.context.Clone()
    bench.step(stop=[1])
    assert bench.guard.GetOutputPort("status").Eval(other).mode == GuardMode.FOLLOWING
    fresh = bench.guard.CreateDefaultContext()
    assert bench.guard.GetOutputPort("status").Eval(fresh).mode == GuardMode.WAITING


def test_told_of_a_silence_it_stays_at_what_it_commanded_last_and_calls_that_no_holding():
    bench = Bench()
    bench.follow_ramp()
    last = bench.positions[-1]
    status = bench.step(fresh=False, follows=False, stop=[BY_SILENCE])
    assert status.mode == GuardMode.UNCONFIRMED
    assert status.reason == (
        "the robot has sent no status for longer than the 50 ms that are allowed"
    )
    np.testing.assert_array_equal(bench.positions[-1], last)


# Sequences of faults, drawn at random.

PERIODS = int(os.environ.get("GRIDPUSH_GUARD_PERIODS", "4000"))
"""How many updates of a guard the drawn sequences have together, about."""

LENGTH = 200
"""Updates in one sequence."""

NAN_PORTS = (
    "position_desired", "position_measured", "torque_external", "force", "time_measured",
    "pusher_state", "object_pose", "stop",
)  # fmt: skip

FAULTS = (
    "wrong joints", "frozen joints", "blocked", "torque", "force", "nan", "infinity", "silence",
    "clock ahead", "clock back", "one status ahead", "pause", "object jumps", "object creeps",
    "object hidden", "desired jumps", "user", "done", "by silence", "tip away",
)  # fmt: skip

EPISODE = st.fixed_dictionaries(
    {
        "fault": st.sampled_from(FAULTS),
        "begin": st.integers(0, LENGTH - 20),
        "duration": st.sampled_from([1, 1, 2, 5, 20, LENGTH]),
        "size": st.floats(-2.0, 2.0),
        "port": st.sampled_from(NAN_PORTS),
    }
)


def make_episode(fault, begin, duration=1, size=0.0, port="stop"):
    return {"fault": fault, "begin": begin, "duration": duration, "size": size, "port": port}


MOTION = st.fixed_dictionaries(
    {
        "amplitude": st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8)),
        "frequency": st.floats(0.5, 4.0),
        "noise": st.sampled_from([0.0, 1e-6, 1e-5]),
    }
)


class Story:
    """A guard, an arm in motion and what goes wrong; what is promised is checked at every update."""

    def __init__(self, motion, episodes):
        self.bench = Bench(
            validator=lambda p, yaw: "the tip is too far" if np.hypot(*p[:2]) > 1.5 else None,
            object_watch=WATCH,
        )
        self.motion, self.episodes = motion, episodes
        self.rng = np.random.default_rng(7)
        self.offset = 0.0  # of the robot's clock, s
        self.newest, self.came = (
            np.nan,
            0.0,
        )  # greatest time of a status so far, and when that came, s
        self.pose = POSE.copy()
        self.frozen = None
        self.stopped = None  # how many commands there were before the stop
        self.rested = []  # indices of commands at which the arm itself was at rest

    def run(self):
        for k in range(LENGTH):
            self._update(k)
        if self.stopped is not None:
            self._check_stop()

    def _update(self, k):
        bench, active = (
            self.bench,
            [one for one in self.episodes if one["begin"] <= k < one["begin"] + one["duration"]],
        )
        amplitude = np.array(self.motion["amplitude"])
        t = k * PERIOD
        desired = BEGIN + amplitude * (1 - np.cos(self.motion["frequency"] * t)) / 2
        told = {
            "position_desired": desired,
            "torque_external": np.zeros(2),
            "force": np.zeros(3),
            "stop": [0.0],
            "object_pose": self.pose,
        }
        faults = {one["fault"]: one for one in active}
        bench.blocked = "blocked" in faults
        if bench.blocked and bench.positions:
            told["torque_external"] = press(bench, stiffness=3000.0)
        place = (
            bench.place if bench.blocked or len(bench.positions) < LATE else bench.positions[-LATE]
        )
        told["position_measured"] = place + self.motion["noise"] * self.rng.normal(size=2)
        self.frozen = (
            None
            if "frozen joints" not in faults
            else (told["position_measured"] if self.frozen is None else self.frozen)
        )
        fresh = "silence" not in faults
        for name, one in faults.items():
            self._spoil(told, name, one)
        if self.frozen is not None:
            told["position_measured"] = self.frozen
        for name, one in faults.items():
            if name in ("nan", "infinity"):
                value = np.array(told.get(one["port"], bench.inputs[one["port"]]), float)
                value[0] = np.nan if name == "nan" else np.inf
                told[one["port"]] = value
        sent = told["time_measured"][0] if "time_measured" in told else None
        if fresh and sent is None:
            told["time_measured"] = [bench.clock + PERIOD + self.offset]
        was = bench.status
        count = len(bench.positions)
        bench.step(fresh=fresh, **told)
        now = bench.inputs["time_measured"][0]
        # where the robot's clock leaps, or it is silent, the arm itself rests: commands begin anew
        leaps = np.isfinite(now) and (now - self.newest) - (bench.time - self.came) > 0.05 + 1e-9
        if np.isfinite(now) and not now <= self.newest:
            self.newest, self.came = now, bench.time
        if leaps or (bench.status.stopped and told["stop"][0] == BY_SILENCE):
            self.rested.append(count)
        self._check(was, count)

    def _spoil(self, told, name, one):
        """Writes a fault into what the guard is told, but for what is not finite."""
        size = one["size"]
        if name == "wrong joints":
            told["position_measured"] = told["position_measured"] + [size, -size / 3]
        elif name == "torque":
            told["torque_external"] = np.array([40.0 * size, 3.0 * size])
        elif name == "force":
            told["force"] = np.array([30.0 * size, 0.0, 10.0])
        elif name == "clock ahead":
            self.offset += abs(size)
        elif name == "clock back":
            self.offset -= abs(size)
        elif name == "one status ahead":
            told["time_measured"] = [self.bench.clock + 100.0 * abs(size)]
        elif name == "pause":
            self.offset += 0.06
        elif name == "object jumps":
            self.pose = self.pose + [0.2 * size, 0.0, size / 2]
        elif name == "object creeps":
            self.pose = self.pose + [0.0, 0.029, 0.0]
        elif name == "object hidden":
            told["object_pose"] = np.full(3, np.nan)
        elif name == "desired jumps":
            told["position_desired"] = told["position_desired"] + size
        elif name in ("user", "done", "by silence"):
            told["stop"] = [{"user": BY_USER, "done": RETREAT_DONE, "by silence": BY_SILENCE}[name]]
        elif name == "tip away":
            told["pusher_state"] = [2.0, 0.0, 0.1, 0.0, 0.0, 0.0]

    def _check(self, was, count):
        bench = self.bench
        positions, status = bench.positions, bench.status
        assert len(positions) == count + (status.mode != GuardMode.WAITING)
        if count == 0:
            return
        # commands: finite, and within the limits of position, speed and acceleration
        assert np.isfinite(positions[-1]).all()
        assert (positions[-1] >= LIMITS.position_lower - 1e-12).all()
        assert (positions[-1] <= LIMITS.position_upper + 1e-12).all()
        velocity = (positions[-1] - positions[-2]) / PERIOD
        assert (np.abs(velocity) <= LIMITS.speed * (1 + 1e-9) + 1e-9).all()
        before = (positions[-2] - positions[-3]) / PERIOD if count > 1 else np.zeros(2)
        if count in self.rested:
            before = np.zeros(2)
        change = np.abs(velocity - before)
        assert (change <= LIMITS.acceleration * PERIOD * (1 + 1e-9) + 1e-9).all(), (was, status)
        # a stop is for good, and says why
        if was.stopped:
            assert status.stopped
            assert status.since == was.since
            assert status.reason.startswith(was.reason)
            assert len(status.kinds) <= 12
        elif status.stopped:
            self.stopped = count
        if status.mode == GuardMode.HOLDING:
            assert (np.abs(velocity) < 1e-9).all()
            assert (
                np.abs(bench.inputs["position_measured"] - positions[-1]).max()
                <= LIMITS.following_error
            )

    def _check_stop(self):
        kinds = self.bench.status.kinds
        retreats = kinds[0] in (StopKind.TORQUE, StopKind.FORCE)
        positions = self.bench.positions
        stopped, rested = self.stopped, self.rested
        if stopped < 2:  # it was stopped before it had moved
            positions = [positions[0]] * 2 + positions
            stopped, rested = stopped + 2, [index + 2 for index in rested]
        check_stop(positions, stopped, retreats, rested=rested)


@settings(
    max_examples=max(PERIODS // LENGTH, 1),
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    database=None,
)
@given(motion=MOTION, episodes=st.lists(EPISODE, min_size=1, max_size=5))
@example(  # the way back has a bend, where the arm had paused
    motion={"amplitude": (0.5, -0.5), "frequency": 1.0, "noise": 0.0},
    episodes=[
        make_episode("clock ahead", begin=69, size=1.0),
        make_episode("blocked", begin=89),
    ],
)
@example(  # joints somewhere else, in a status without a time, at an arm that has not moved yet
    motion={"amplitude": (0.0, 0.0), "frequency": 1.0, "noise": 0.0},
    episodes=[
        make_episode("wrong joints", begin=5, size=1.0),
        make_episode("nan", begin=5, port="time_measured"),
    ],
)
def test_whatever_goes_wrong_the_commands_keep_what_is_promised(motion, episodes):
    Story(motion, episodes).run()


@settings(max_examples=5, deadline=None, derandomize=True, database=None)
@given(motion=MOTION)
def test_where_nothing_goes_wrong_nothing_stops_the_arm(motion):
    story = Story(motion, [])
    story.run()
    assert story.bench.status.mode == GuardMode.FOLLOWING

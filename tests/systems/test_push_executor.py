"""`PushExecutor` by itself: the way, the phases, the refusals, the Context."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from gridpush_drake.multibody.tool_motion import calc_tool_pose
from gridpush_drake.systems.base.messages import GraspStatus, PushCommand, PushStatus
from gridpush_drake.systems.execution.push_executor import PushExecutor, PushTrajectoryOptions
from tests.helpers.scene_cases import PLATE

HOME = (0.6, 0.1, 0.2)
OUTLINE = shapely.box(-0.05, -0.02, 0.05, 0.02)
PUSH = PushCommand(1, 0.45, -0.05, 0.4, 0.1, 0.05)
STYLE = PushTrajectoryOptions()


class Run:
    """An executor, commands at will, and the desired position as time goes on."""

    def __init__(
        self, outline=None, reach=None, pose=(0.6, 0.0, 0.0), home=HOME, step=0.005, lookouts=()
    ):
        self.step = step
        self.executor = PushExecutor(home, outline, reach, STYLE, lookouts)
        self.simulator = Simulator(self.executor)
        self.context = self.simulator.get_mutable_context()
        self.see(pose)
        self.give(PushCommand())
        self.t, self.p, self.phases = [], [], []

    def see(self, pose):
        self.executor.GetInputPort("object_pose").FixValue(self.context, pose)

    def give(self, command):
        self.executor.GetInputPort("push_command").FixValue(self.context, command.to_vector())

    @property
    def status(self):
        return self.executor.GetOutputPort("status").Eval(self.context)

    @property
    def pose(self):
        return self.executor.GetOutputPort("tip_pose").Eval(self.context)

    def advance(self, duration, step=None):
        step = step or self.step
        for _ in range(round(duration / step)):
            self.simulator.AdvanceTo(self.context.get_time() + step)
            self.t.append(self.context.get_time())
            self.p.append(self.pose.translation().copy())
            self.phases.append(self.status.phase)
        return self

    def carry_out(self, command):
        self.give(command)
        self.advance(0.02)
        while not self.status.ready:
            self.advance(0.05)
        return self


@pytest.fixture(scope="module")
def whole():
    """Two pushes one after the other."""
    run = Run(step=0.001).advance(0.05).carry_out(PUSH)
    return run.carry_out(PushCommand(2, 0.7, 0.1, -2.0, 0.06, 0.1)).advance(0.05)


def find_order(phases):
    return [phase for i, phase in enumerate(phases) if i == 0 or phase != phases[i - 1]]


def test_phases_come_in_order(whole):
    push = ["approaching", "descending", "pushing", "settling", "retracting", "idle"]
    assert find_order(whole.phases) == ["idle", *push, *push]
    assert whole.status == PushStatus("idle", 2, executed=2)


def test_position_velocity_and_acceleration_are_continuous(whole):
    t, p = np.array(whole.t), np.array(whole.p)
    h = t[1] - t[0]
    speed = np.linalg.norm(np.diff(p, axis=0), axis=1) / h
    acceleration = np.linalg.norm(np.diff(p, 2, axis=0), axis=1) / h**2
    jerk = np.linalg.norm(np.diff(p, 3, axis=0), axis=1) / h**3
    assert speed.max() == pytest.approx(STYLE.travel_speed, rel=1e-3)
    assert acceleration.max() < 1.01 * STYLE.travel_acceleration
    # The steepest ramp is that of the slowest motion: 4 a / T with T = 3 v / (2 a).
    slowest = min(
        PUSH.speed / STYLE.push_acceleration**2, STYLE.vertical_speed / STYLE.travel_acceleration**2
    )
    assert jerk.max() < 1.05 * 8.0 / 3.0 / slowest


def test_push_is_straight_level_and_at_the_commanded_speed(whole):
    pushing = np.array(
        [p for p, phase in zip(whole.p, whole.phases, strict=True) if phase == "pushing"]
    )
    first = pushing[
        : np.flatnonzero(np.linalg.norm(np.diff(pushing, axis=0), axis=1) > 0.01)[0] + 1
    ]
    np.testing.assert_allclose(first[0, :2], PUSH.start, atol=1e-4)
    np.testing.assert_allclose(first[-1, :2], PUSH.end, atol=1e-6)
    np.testing.assert_allclose(first[:, 2], STYLE.push_height, atol=1e-15)
    across = (first[:, :2] - PUSH.start) @ [-np.sin(PUSH.direction), np.cos(PUSH.direction)]
    np.testing.assert_allclose(across, 0.0, atol=1e-15)
    speed = np.linalg.norm(np.diff(first, axis=0), axis=1) / 1e-3
    assert np.median(speed) == pytest.approx(PUSH.speed, rel=1e-6)
    assert speed.max() == pytest.approx(PUSH.speed, rel=1e-6)


def test_it_goes_up_before_it_goes_over_and_settles_long_enough(whole):
    for p, phase, before in zip(whole.p[1:], whole.phases[1:], whole.p[:-1], strict=True):
        if np.linalg.norm(p[:2] - before[:2]) > 1e-9 and phase != "pushing":
            assert p[2] > STYLE.travel_height - 1e-9
    settling = whole.phases.count("settling") * 1e-3 / 2
    assert settling == pytest.approx(STYLE.settle_time, abs=2 * STYLE.period)


def test_tool_points_down_at_all_times(whole):
    np.testing.assert_allclose(whole.pose.rotation().matrix() @ [0, 0, 1], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(whole.pose.rotation().matrix() @ [1, 0, 0], [-1, 0, 0], atol=1e-15)


def test_a_shape_is_turned_to_where_it_pushes_before_it_goes_down():
    asked = []

    def reach(path, speeds, yaws):
        asked.append(yaws)

    executor = PushExecutor(HOME, OUTLINE, reach, replace(STYLE, shape=PLATE))
    run = Run()
    run.executor = executor
    run.simulator = Simulator(executor)
    run.context = run.simulator.get_mutable_context()
    run.see((0.6, 0.0, 0.0))
    command = replace(PUSH, direction=2.0)
    run.give(command)
    yaws = []
    while not (run.status.ready and run.status.executed):
        run.advance(0.01)
        *_, z, yaw = calc_tool_pose(run.pose)
        yaws.append(yaw)
        if z < STYLE.travel_height - 1e-9:
            assert yaw == pytest.approx(2.0 - np.pi)  # it looks the same after half a turn
    assert np.abs(np.diff(yaws)).max() < 0.02
    assert {len(np.unique(each)) for each in asked} == {2}

    # It begins beside the object, whichever way it is turned.
    run.give(PushCommand(2, 0.6, 0.03, 0.0, 0.05, 0.05))
    run.advance(0.02)
    assert "start inside the object" in run.status.reason
    run.give(PushCommand(3, 0.6, 0.03, -np.pi / 2, 0.05, 0.05))
    run.advance(0.02)
    assert not run.status.reason


UNSEEN = (np.nan, np.nan, np.nan)


def test_where_the_object_is_hidden_the_arm_goes_to_its_lookout():
    run = Run(OUTLINE, lookouts=[HOME]).carry_out(PUSH)
    run.see(UNSEEN)
    run.advance(0.25)
    assert run.status.ready
    run.advance(0.1)
    assert run.status.phase == "clearing"
    run.advance(4.0)
    assert run.status == PushStatus("idle", 1, executed=1)
    np.testing.assert_allclose(run.p[-1], HOME, atol=1e-12)
    assert (
        np.linalg.norm(np.diff(run.p, axis=0), axis=1).max() < 1.01 * STYLE.travel_speed * run.step
    )
    run.advance(1.0)
    assert run.status.ready  # there it stays
    run.see((0.6, 0.0, 0.0))
    assert run.carry_out(PushCommand(2, 0.7, 0.1, -2.0, 0.06, 0.1)).status.executed == 2


def test_where_it_stays_hidden_the_other_lookouts_are_tried_and_the_arm_rests_at_last():
    aside, away = (0.4, -0.4, 0.2), (0.4, 0.4, 0.2)
    run = Run(
        OUTLINE,
        lambda path, speeds: "no" if path[-1, 1] == aside[1] else None,
        lookouts=[HOME, aside, away],
    )
    run.carry_out(PUSH).see(UNSEEN)
    run.advance(15.0)
    where = [
        next((i for i, at in enumerate((HOME, aside, away)) if np.allclose(at, p)), None)
        for p in run.p
    ]
    assert find_order([i for i in where if i is not None]) == [0, 2, 0]
    assert np.linalg.norm(np.subtract(run.p, aside), axis=1).min() > 0.3  # where it cannot go
    assert run.status.ready
    run.see((0.6, 0.0, 0.0))
    run.advance(0.1).see(UNSEEN)
    np.testing.assert_allclose(run.advance(2.5).pose.translation(), away, atol=1e-12)


def test_no_lookout_while_a_grasp_is_under_way_or_without_one():
    run = Run(OUTLINE, lookouts=[HOME]).carry_out(PUSH)
    run.executor.GetInputPort("grasp_status").FixValue(
        run.context, AbstractValue.Make(GraspStatus("closing", 1))
    )
    run.see(UNSEEN)
    run.advance(1.0)
    assert run.status.ready
    run = Run(OUTLINE).carry_out(PUSH)
    run.see(UNSEEN)
    assert run.advance(1.0).status.ready


def test_low_home_is_left_upwards():
    run = Run(home=(0.6, 0.1, 0.05)).carry_out(PUSH)
    sideways = np.linalg.norm(np.array(run.p)[:, :2] - HOME[:2], axis=1)
    low = np.array(run.p)[:, 2] < STYLE.travel_height - 1e-6
    assert low[0]
    assert sideways[low & (np.array(run.phases) == "approaching")].max() < 1e-9


def test_it_holds_without_a_command_and_does_nothing_twice():
    run = Run().advance(0.5)
    np.testing.assert_array_equal(run.p, np.broadcast_to(HOME, (100, 3)))
    run.carry_out(PUSH)
    rest = run.p[-1]
    run.advance(0.2)
    assert run.status == PushStatus("idle", 1, executed=1)
    np.testing.assert_array_equal(run.p[-1], rest)


def test_command_that_comes_during_a_push_waits():
    run = Run()
    run.give(PUSH)
    run.advance(0.5)
    run.carry_out(PushCommand(2, 0.7, 0.1, -2.0, 0.06, 0.1)).carry_out(
        PushCommand(2, 0.7, 0.1, -2.0, 0.06, 0.1)
    )
    assert run.status == PushStatus("idle", 2, executed=2)


def test_withdrawn_command_is_broken_off_smoothly():
    run = Run(step=0.001)
    run.give(PUSH)
    while run.status.phase != "pushing":
        run.advance(0.005)
    run.advance(0.8)
    at = run.p[-1]
    run.give(PushCommand())
    run.advance(3.0)
    assert (run.status.ready, run.status.executed, run.status.refused) == (True, 1, 0)
    pushed = np.array(run.p)[np.array(run.phases) == "pushing"]
    way = np.linalg.norm(pushed[-1] - at)
    ramp = 1.5 * PUSH.speed / STYLE.push_acceleration
    assert way == pytest.approx(
        PUSH.speed * (ramp / 2 + STYLE.period), abs=1.1 * PUSH.speed * STYLE.period
    )
    assert np.linalg.norm(pushed[-1] - pushed[0]) < 0.6 * PUSH.distance
    np.testing.assert_allclose(run.p[-1], [*pushed[-1][:2], STYLE.travel_height], atol=1e-9)
    v = np.diff(np.array(run.p), axis=0) / run.step
    a = np.linalg.norm(np.diff(v, axis=0), axis=1) / run.step
    assert a.max() < 1.05 * STYLE.travel_acceleration
    phases = [phase for i, phase in enumerate(run.phases) if i == 0 or phase != run.phases[i - 1]]
    assert phases[-4:] == ["pushing", "settling", "retracting", "idle"]


def test_command_withdrawn_on_the_way_down_pushes_nothing():
    run = Run()
    run.give(PUSH)
    while run.status.phase != "descending":
        run.advance(0.005)
    run.give(PushCommand())
    run.advance(3.0)
    assert run.status.ready
    low = np.array(run.p)[np.array(run.p)[:, 2] < 0.1 - 1e-9]
    np.testing.assert_allclose(low[:, :2], np.broadcast_to(PUSH.start, (len(low), 2)), atol=1e-9)
    run.carry_out(PushCommand(2, PUSH.x, PUSH.y, PUSH.direction, PUSH.distance, PUSH.speed))
    assert run.status.executed == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distance": 0.0}, "distance 0 m"),
        ({"distance": -0.1}, "distance -0.1 m"),
        ({"speed": 0.0}, "speed 0 m/s"),
        ({"speed": -0.05}, "speed"),
        ({"speed": 0.5}, r"speed 0.5 m/s; .* at most 0.2"),
        ({"x": np.nan}, "not finite"),
        ({"distance": np.inf}, "not finite"),
        ({"x": 0.6, "y": 0.0}, r"inside the object, at \(0.600, 0.000\)"),
        ({"x": 0.66, "y": 0.0}, None),
        ({"x": 0.657, "y": 0.0}, "would start -0.0010 m from the object"),
    ],
)
def test_push_is_refused_with_its_reason(change, message):
    run = Run(OUTLINE)
    run.give(PushCommand(**{**PUSH.__dict__, **change}))
    run.advance(0.05)
    if message is None:
        assert run.status == PushStatus("approaching", 1)
        return
    assert (run.status.phase, run.status.command_id, run.status.refused, run.status.executed) == (
        "idle",
        1,
        1,
        0,
    )
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(run.status.reason)
    np.testing.assert_array_equal(run.p, np.broadcast_to(HOME, (10, 3)))


def test_overlap_is_judged_where_the_object_is():
    """The outline's long side lies along B's x axis; with B turned by 90 degrees it lies along W's y axis."""
    start = PushCommand(1, 0.6, 0.045, 0.0, 0.1, 0.05)
    flat, turned = Run(OUTLINE), Run(OUTLINE, pose=(0.6, 0.0, np.pi / 2))
    for run in (flat, turned):
        run.give(start)
        run.advance(0.02)
    assert flat.status.phase == "approaching"
    assert "inside" in turned.status.reason


def test_command_waits_while_the_object_is_not_seen():
    run = Run(OUTLINE, pose=(np.nan, np.nan, np.nan))
    run.give(PUSH)
    run.advance(0.1)
    assert run.status == PushStatus()
    run.executor.GetInputPort("object_pose").FixValue(run.context, (0.6, 0.0, 0.0))
    run.advance(0.02)
    assert run.status == PushStatus("approaching", 1)


def test_next_command_after_a_refusal_is_taken_up():
    run = Run()
    run.give(PushCommand(1, 0.5, 0.0, 0.0, -0.1, 0.05))
    run.advance(0.05)
    run.carry_out(PushCommand(2, 0.5, 0.0, 0.0, 0.1, 0.05))
    assert run.status == PushStatus("idle", 2, executed=1, refused=1)


def test_reach_is_asked_about_the_whole_way_and_again_at_less_speed():
    asked = []

    def reach(way, speeds):
        asked.append((way, speeds))
        return "too fast" if speeds[0] > 0.2 else None

    run = Run(reach=reach)
    run.give(PUSH)
    run.advance(0.05)
    assert run.status.phase == "approaching"
    (way, speeds), (same, slower), _, (back, _) = asked
    (x0, y0), (x1, y1), high, low = PUSH.start, PUSH.end, STYLE.travel_height, STYLE.push_height
    corners = [HOME, (x0, y0, high), (x0, y0, low), (x1, y1, low), (x1, y1, low), (x1, y1, high)]
    np.testing.assert_allclose(way, corners)
    np.testing.assert_array_equal(way, same)
    assert speeds[2] == slower[2] == PUSH.speed
    assert slower[0] == speeds[0] / 2
    # and at last about the way home from where the push ends
    np.testing.assert_allclose(back[[0, -1]], [corners[-1], HOME])


def test_a_push_from_whose_end_the_arm_could_not_go_home_is_refused():
    """On its way the arm just keeps a limit, which it would not keep from there."""
    end = (*PUSH.end, STYLE.travel_height)

    def reach(way, speeds):
        return "joint 2 would come to its limit" if np.allclose(way[0], end) else None

    run = Run(reach=reach)
    run.give(PUSH)
    run.advance(0.05)
    refused = PushStatus("idle", 1, refused=1, reason="joint 2 would come to its limit")
    assert run.status == refused


def test_where_the_arm_cannot_go_straight_to_a_push_it_goes_home_first():
    """From anywhere but its home the arm would come to the push in another posture."""
    (x0, y0), high = PUSH.start, STYLE.travel_height

    def reach(way, speeds):
        at = [k for k, place in enumerate(way) if np.allclose(place, (x0, y0, high))]
        if at and at[0] > 0 and not np.allclose(way[at[0] - 1], HOME):
            return "joint 2 would come to its limit"
        return None

    run = Run(reach=reach).carry_out(PushCommand(1, 0.7, 0.1, -2.0, 0.06, 0.1))
    assert run.status.executed == 1 and not np.allclose(run.p[-1], HOME)
    begin = len(run.p)
    run.carry_out(replace(PUSH, command_id=2))
    assert run.status == PushStatus("idle", 2, executed=2)
    way = np.array(run.p[begin:])
    assert np.linalg.norm(way - HOME, axis=1).min() < 0.01
    assert find_order(run.phases[begin:]) == [
        "approaching",
        "descending",
        "pushing",
        "settling",
        "retracting",
        "idle",
    ]


def test_what_the_arm_cannot_reach_is_refused():
    run = Run(reach=lambda way, speeds: "the arm does not reach it")
    run.give(PUSH)
    run.advance(0.05)
    assert run.status == PushStatus("idle", 1, refused=1, reason="the arm does not reach it")


def test_state_is_all_in_the_context():
    run = Run()
    run.give(PUSH)
    run.advance(1.0)
    clone = run.context.Clone()
    before = run.pose.translation().copy()
    run.advance(2.0)
    np.testing.assert_array_equal(
        run.executor.GetOutputPort("tip_pose").Eval(clone).translation(), before
    )
    other = Simulator(run.executor, clone)
    other.AdvanceTo(run.context.get_time())
    np.testing.assert_array_equal(
        run.executor.GetOutputPort("tip_pose").Eval(clone).translation(), run.p[-1]
    )
    assert run.executor.GetOutputPort("status").Eval(clone) == run.status


def test_reset_and_reuse_gives_the_same_again():
    run = Run().carry_out(PUSH)
    first, run.p = np.array(run.p), []
    run.context.SetTime(0.0)
    run.executor.SetDefaultContext(run.context)
    run.simulator.Initialize()
    assert run.status == PushStatus()
    run.carry_out(PUSH)
    np.testing.assert_array_equal(run.p, first)


def test_outputs_are_not_fed_through():
    executor = PushExecutor(HOME)
    assert not executor.HasAnyDirectFeedthrough()
    assert [executor.get_input_port(i).get_name() for i in range(2)] == [
        "push_command",
        "object_pose",
    ]
    assert [executor.get_output_port(i).get_name() for i in range(2)] == ["tip_pose", "status"]

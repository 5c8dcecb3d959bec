"""The finger is steered by its velocity: down, along, held back, up and back."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from shapely import box

from gridpush_drake.multibody.tool_motion import R_WP_DOWN, calc_tool_pose
from gridpush_drake.systems.base.messages import PushPhase, PushStatus, SteerCommand, SteerPhase
from gridpush_drake.systems.execution.steer_executor import SteerExecutor, SteerOptions

HOME = np.array([0.5, 0.0, 0.2])
STYLE = SteerOptions()
PLACE = (0.6, 0.1)


class Steered:
    """An executor whose inputs are set by hand, and the tip's places at every update."""

    def __init__(self, region=None, reach=None, style=None):
        builder = DiagramBuilder()
        self.executor = builder.AddSystem(SteerExecutor(region, reach, style))
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.executor.GetMyMutableContextFromRoot(
            self.simulator.get_mutable_context()
        )
        home = AbstractValue.Make(RigidTransform(R_WP_DOWN, HOME))
        self.executor.GetInputPort("passed_tip_pose").FixValue(self.context, home)
        self.tell_pushes(PushStatus())
        self.command(SteerCommand())
        self.tips = []

    def tell_pushes(self, status):
        self.executor.GetInputPort("push_status").FixValue(self.context, AbstractValue.Make(status))

    def press(self, force):
        self.executor.GetInputPort("tip_force").FixValue(self.context, [0.0, -force, 0.0])

    def command(self, command):
        self.executor.GetInputPort("steer_command").FixValue(self.context, command.to_vector())

    @property
    def tip(self):
        return self.executor.GetOutputPort("tip_pose").Eval(self.context).translation().copy()

    @property
    def yaw(self):
        return calc_tool_pose(self.executor.GetOutputPort("tip_pose").Eval(self.context))[3]

    @property
    def status(self):
        return self.executor.GetOutputPort("status").Eval(self.context)

    def go(self, duration):
        end = self.simulator.get_context().get_time() + duration
        while self.simulator.get_context().get_time() < end - 1e-9:
            self.simulator.AdvanceTo(self.simulator.get_context().get_time() + STYLE.period)
            self.tips.append(self.tip)

    def go_down(self, number=1):
        self.command(SteerCommand(number, *PLACE))
        self.go(4.0)
        assert self.status.phase == SteerPhase.STEERING


def test_it_comes_down_is_steered_and_goes_back():
    run = Steered()
    run.go(0.05)
    assert run.tip == pytest.approx(HOME)
    assert run.status.ready
    run.go_down()
    assert run.tip == pytest.approx([*PLACE, STYLE.push_height])
    run.command(SteerCommand(1, *PLACE, 0.05, -0.1))
    run.go(1.0)
    # it gets up to its speed within its acceleration, and then keeps it
    lost = np.hypot(0.05, 0.1) / STYLE.acceleration / 2
    assert run.tip[:2] == pytest.approx(
        np.array(PLACE) + (1.0 - lost) * np.array([0.05, -0.1]), abs=1e-3
    )
    run.command(SteerCommand())
    run.go(4.0)
    assert run.status.ready
    assert run.tip == pytest.approx(HOME)
    # nothing jumps: neither the place nor, beyond what the accelerations allow, the velocity
    steps = np.diff(run.tips, axis=0) / STYLE.period
    assert np.linalg.norm(steps, axis=1).max() < STYLE.travel_speed + 1e-6
    changes = np.linalg.norm(np.diff(steps, axis=0), axis=1) / STYLE.period
    assert changes.max() < STYLE.acceleration + 1e-6


def test_it_is_held_back_at_the_border_of_its_region():
    run = Steered(region=box(0.4, -0.3, 0.65, 0.3))
    run.go_down()
    run.command(SteerCommand(1, *PLACE, 0.2, 0.0))
    run.go(1.5)
    assert np.array(run.tips)[:, 0].max() < 0.65
    assert run.tip[0] > 0.62
    assert "leave the region" in run.status.reason
    # back it may go
    run.command(SteerCommand(1, *PLACE, -0.1, 0.0))
    run.go(0.5)
    assert run.tip[0] < 0.61
    assert run.status.reason == ""


def test_a_velocity_that_is_too_fast_is_shortened_and_one_that_is_no_number_stops_the_finger():
    run = Steered()
    run.go_down()
    run.command(SteerCommand(1, *PLACE, 3.0, 0.0))
    run.go(1.0)
    speeds = np.diff(np.array(run.tips)[-20:, 0]) / STYLE.period
    assert speeds == pytest.approx(STYLE.max_speed)
    run.command(SteerCommand(1, *PLACE, np.nan, 0.0))
    run.go(0.5)
    assert run.tips[-1] == pytest.approx(run.tips[-2])
    assert "not finite" in run.status.reason


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (SteerCommand(1, 0.9, 0.1), "leave the region"),
        (SteerCommand(1, np.nan, 0.1), "not finite"),
    ],
)
def test_it_refuses_where_it_may_not_come_down(command, reason):
    run = Steered(region=box(0.4, -0.3, 0.8, 0.3))
    run.command(command)
    run.go(0.5)
    assert run.status.refused
    assert run.status.ready
    assert reason in run.status.reason
    assert run.tip == pytest.approx(HOME)


def test_it_refuses_what_the_arm_cannot_follow_and_waits_for_pushes():
    run = Steered(reach=lambda path, speeds: "the arm is too short")
    run.tell_pushes(PushStatus(phase=PushPhase.PUSHING))
    run.command(SteerCommand(1, *PLACE))
    run.go(0.5)
    assert run.status.command_id == 0
    run.tell_pushes(PushStatus())
    run.go(0.5)
    assert run.status.refused
    assert run.status.reason == "the arm is too short"


def test_the_finger_goes_up_by_itself_where_it_presses_too_hard():
    run = Steered(style=SteerOptions(max_force=15.0))
    run.press(0.0)
    run.go_down()
    run.command(SteerCommand(1, *PLACE, 0.1, 0.0))
    run.press(10.0)
    run.go(0.5)
    assert run.status.phase == SteerPhase.STEERING
    before = run.tip[0]
    run.press(16.0)
    # it brakes as hard as an arm can, but no harder: its joints could not keep the tip's height
    braking = 0.1 / run.executor.style.hard_braking
    run.go(braking + 0.03)
    assert run.status.phase == SteerPhase.RETRACTING
    assert "16 N; 15 N are allowed" in run.status.reason
    assert run.tip[0] - before < 0.1 * (braking / 2 + 0.01)
    run.press(0.0)
    run.go(4.0)
    assert run.status.ready
    assert run.tip == pytest.approx(HOME)
    # the same command is not taken up again, another one is
    run.go(0.5)
    assert run.status.ready
    run.go_down(2)


def test_a_tool_that_turns_comes_down_turned_and_is_steered_with_its_angle():
    style = SteerOptions(turns=True, max_turning_speed=0.8)
    asked = []
    run = Steered(reach=lambda path, speeds, yaws: asked.append(yaws), style=style)
    run.command(SteerCommand(1, *PLACE, yaw=0.7))
    run.go(4.0)
    assert run.status.phase == SteerPhase.STEERING
    assert run.yaw == pytest.approx(0.7)
    assert asked[0] == pytest.approx([0.0, 0.7, 0.7])
    # no faster than it may, after a time to get there
    run.command(SteerCommand(1, *PLACE, 0.05, 0.0, yaw_rate=2.0))
    run.go(0.5)
    lost = 0.8 / style.turning_acceleration / 2
    assert run.yaw == pytest.approx(0.7 + 0.8 * (0.5 - lost), abs=0.01)
    run.command(SteerCommand())
    run.go(5.0)
    assert run.status.ready
    assert run.tip == pytest.approx(HOME)
    assert run.yaw == pytest.approx(0.0, abs=1e-9)

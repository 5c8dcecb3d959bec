"""`GraspExecutor` on its own: what it asks the arm and the gripper for, given what the gripper says of itself."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from gridpush_drake.multibody.tool_motion import (
    TURNING_RADIUS,
    ToolTrajectorySegment,
    calc_tool_pose,
    make_transform,
)
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.systems.base.messages import (
    GraspCommand,
    GraspPhase,
    GraspStatus,
    PushPhase,
    PushStatus,
)
from gridpush_drake.systems.execution.grasp_executor import GraspExecutor
from gridpush_drake.systems.execution.grasp_trajectory import (
    GraspTrajectoryOptions,
    calc_tip,
    calc_yaws,
)

REST = (0.5, -0.1, 0.12, 0.0)
COMMAND = GraspCommand(1, 0.5, 0.18, 0.015, -np.pi / 2, 0.1)
STYLE = GraspTrajectoryOptions(hold_time=0.5)


def test_options_are_made_from_the_gripper():
    gripper = Gripper(opening=0.08, max_force=140.0, closing_speed=0.1, standoff=0.12)
    style = GraspTrajectoryOptions.of_gripper(gripper, 450.0, hold_time=0.5)
    assert style == GraspTrajectoryOptions(
        opening=0.08, force=140.0, closing_speed=0.1, standoff=0.12, hold_time=0.5
    )
    assert GraspTrajectoryOptions.of_gripper(gripper, 60.0).force == 60.0
    assert GraspTrajectoryOptions.of_gripper(Gripper(), 80.0) == GraspTrajectoryOptions()


STEP = 0.01
THICK = 0.03  # m, of what is between the pads


class Bench:
    """An executor, with a gripper that closes as far as it is told to and what is in it lets it."""

    def __init__(self, width=THICK, lost_at=np.inf, **options):
        self.system = GraspExecutor(style=STYLE, **options)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.width, self.lost_at = width, lost_at
        self.poses, self.phases, self.openings = [], [], []
        self.fix("push_tip_pose", AbstractValue.Make(make_transform(REST)))
        self.fix("push_status", AbstractValue.Make(PushStatus()))
        self.fix("gripper_state", [-0.05, 0.05, 0.0, 0.0])

    def fix(self, port, value):
        self.system.GetInputPort(port).FixValue(self.context, value)

    def read(self, port):
        return self.system.GetOutputPort(port).Eval(self.context)

    @property
    def status(self) -> GraspStatus:
        return self.read("status")

    def run(self, command, limit=60.0):
        """Goes on until there is an outcome and the tool rests."""
        self.fix("grasp_command", command.to_vector())
        while self.context.get_time() < limit:
            self.simulator.AdvanceTo(self.context.get_time() + STEP)
            self.poses.append(np.array(calc_tool_pose(self.read("tip_pose"))))
            self.phases.append(self.status.phase)
            self.openings.append(float(self.read("gripper_position")[0]))
            lost = self.status.phase == "lifting" and self.poses[-1][2] > self.lost_at
            opening = max(self.openings[-1], 0.0 if lost or not self.width else self.width)
            self.fix("gripper_state", [-opening / 2, opening / 2, 0.0, 0.0])
            if self.status.outcome == "held" or (
                self.status.command_id == command.command_id and self.status.ready
            ):
                return self.status
        raise AssertionError(f"not done after {limit} s: {self.status}")

    def seen(self):
        return list(dict.fromkeys(self.phases))


def test_passes_the_finger_s_pose_on_while_there_is_nothing_to_do():
    bench = Bench()
    for pose in (REST, (0.6, 0.2, 0.012, 0.0)):
        bench.fix("push_tip_pose", AbstractValue.Make(make_transform(pose)))
        bench.simulator.AdvanceTo(bench.context.get_time() + 0.1)
        assert bench.read("tip_pose").IsExactlyEqualTo(make_transform(pose))
    assert bench.read("gripper_position") == [STYLE.opening]
    assert bench.read("gripper_force_limit") == [STYLE.force]
    assert bench.status == GraspStatus()


def test_goes_in_from_beyond_closes_lifts_and_holds():
    bench = Bench()
    status = bench.run(COMMAND)
    assert (status.outcome, status.phase, status.reason) == ("held", "holding", "")
    assert (
        bench.seen()
        == ["idle", "approaching", "entering", "closing", "lifting", "holding"][
            bench.phases[0] != "idle" :
        ]
    )
    poses, phases = np.array(bench.poses), np.array(bench.phases)
    X_WP = make_transform(poses[phases == "closing"][-1])
    p_WG = X_WP @ np.array(STYLE.p_PG)
    np.testing.assert_allclose(p_WG, COMMAND.p_WG, atol=1e-9)
    ahead = X_WP.rotation().matrix() @ [1.0, 0.0, 0.0]  # the fingers'
    np.testing.assert_allclose(ahead, [*COMMAND.heading, 0.0], atol=1e-9)
    assert poses[-1][2] - poses[phases == "closing"][-1][2] == pytest.approx(COMMAND.lift)
    entering = poses[phases == "entering"]
    across = np.array([-COMMAND.heading[1], COMMAND.heading[0]])
    assert np.ptp(entering[:, :2] @ across) < 1e-9
    assert np.ptp(entering[:, 2:], axis=0).max() < 1e-9
    assert set(np.array(bench.openings)[phases == "lifting"]) == {STYLE.squeeze}


@pytest.mark.parametrize(
    ("options", "outcome"), [({"width": 0.0}, "missed"), ({"lost_at": -0.16}, "slipped")]
)
def test_goes_back_to_the_finger_s_rest_where_it_fails(options, outcome):
    bench = Bench(**options)
    status = bench.run(COMMAND)
    assert (status.outcome, status.phase, status.ready) == (outcome, "idle", True)
    assert "mm" in status.reason
    np.testing.assert_allclose(bench.poses[-1], REST, atol=1e-9)
    assert bench.seen()[-3:] == ["opening", "retreating", "idle"] or bench.seen()[-2:] == [
        "opening",
        "retreating",
    ]
    assert bench.openings[-1] == STYLE.opening
    bench.width, bench.lost_at = THICK, np.inf
    assert bench.run(GraspCommand(2, *COMMAND.to_vector()[1:]), 120.0).outcome == "held"


def test_pose_speed_and_acceleration_are_continuous():
    bench = Bench(width=0.0)
    bench.run(COMMAND)
    poses = np.array(bench.poses) * [1.0, 1.0, 1.0, TURNING_RADIUS]
    speed = np.diff(poses, axis=0) / STEP
    acceleration = np.diff(speed, axis=0) / STEP
    assert np.abs(speed).max() < STYLE.travel_speed * 1.01
    assert np.abs(acceleration).max() < STYLE.travel_acceleration * 1.01
    assert (
        np.abs(np.diff(acceleration, axis=0)).max() < 0.3
    )  # a jump would show as the whole acceleration


def test_waits_for_the_push_to_end_and_for_a_new_number():
    bench = Bench()
    bench.fix("grasp_command", COMMAND.to_vector())
    bench.fix("push_status", AbstractValue.Make(PushStatus(PushPhase.PUSHING, 3)))
    bench.simulator.AdvanceTo(0.2)
    assert bench.status == GraspStatus()
    bench.fix("push_status", AbstractValue.Make(PushStatus()))
    bench.simulator.AdvanceTo(0.3)
    assert bench.status.phase == "approaching"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"x": np.nan}, "not finite"),
        ({"approach": np.inf}, "not finite"),
        ({"lift": 0.0}, "lift 0 m"),
        ({"lift": 0.5}, "lift 0.5 m"),
    ],
)
def test_refuses_what_is_not_usable(change, reason):
    bench = Bench()
    status = bench.run(GraspCommand(**{**vars(COMMAND), **change}), 1.0)
    assert (status.outcome, status.phase, status.command_id) == ("refused", "idle", 1)
    assert reason in status.reason
    assert set(bench.phases) == {"idle"}


def test_refuses_what_the_arm_cannot_follow_and_what_is_objected_to():
    asked = []

    def reach(way, speeds, yaws):
        asked.append((way, speeds, yaws))
        return "too far"

    assert Bench(reach=reach).run(COMMAND).reason == "too far"
    assert {len(way) - len(speeds) for way, speeds, _ in asked} == {1}
    assert {round(float(yaws[-1]), 6) for *_, yaws in asked} == {
        round(yaw, 6) for yaw in calc_yaws(COMMAND.approach)
    }
    assert Bench(validator=lambda command: "in the way").run(COMMAND).reason == "in the way"


def test_slows_down_where_the_arm_cannot_follow_fast():
    fast = Bench()
    fast.run(COMMAND)
    slow = Bench(reach=lambda way, speeds, yaws: "too fast" if speeds[0] > 0.1 else None)
    assert slow.run(COMMAND).outcome == "held"
    assert slow.context.get_time() > fast.context.get_time() + 2.0


def test_goes_home_to_where_the_push_executor_has_its_finger_by_then():
    bench = Bench(width=0.0)
    bench.fix("grasp_command", COMMAND.to_vector())
    while "retreating" not in bench.status.phase:
        bench.simulator.AdvanceTo(bench.context.get_time() + STEP)
        opening = max(float(bench.read("gripper_position")[0]), 0.0)
        bench.fix("gripper_state", [-opening / 2, opening / 2, 0.0, 0.0])
    elsewhere = (0.6, -0.2, 0.12, 0.0)
    bench.fix("push_tip_pose", AbstractValue.Make(make_transform(elsewhere)))
    bench.run(COMMAND)
    np.testing.assert_allclose(bench.poses[-1], elsewhere, atol=1e-9)
    assert np.abs(np.diff(bench.poses, axis=0)).max() < 0.02


def test_state_is_in_the_context_alone():
    bench = Bench()
    bench.fix("grasp_command", COMMAND.to_vector())
    bench.simulator.AdvanceTo(3.0)
    copy = bench.context.Clone()
    other = Simulator(bench.system, copy)
    for simulator in (bench.simulator, other):
        simulator.AdvanceTo(4.0)
    poses = [
        bench.system.GetOutputPort("tip_pose").Eval(context) for context in (bench.context, copy)
    ]
    assert poses[0].IsExactlyEqualTo(poses[1])
    assert not poses[0].IsNearlyEqualTo(make_transform(REST), 0.05)


@pytest.mark.parametrize("approach", np.linspace(-np.pi, np.pi, 9))
def test_yaws_point_the_fingers_along_the_approach(approach):
    for yaw in calc_yaws(approach):
        X_WP = make_transform((*calc_tip(STYLE, COMMAND.p_WG, yaw), yaw))
        np.testing.assert_allclose(X_WP @ np.array(STYLE.p_PG), COMMAND.p_WG, atol=1e-12)
        np.testing.assert_allclose(
            X_WP.rotation().matrix()[:2, 0], [np.cos(approach), np.sin(approach)], atol=1e-12
        )


def test_a_leg_turns_and_moves_with_one_share():
    leg = ToolTrajectorySegment(
        GraspPhase.APPROACHING, (0.0, 0.0, 0.1, 0.0), (0.3, 0.0, 0.1, 1.0), 0.2, 1.0
    )
    middle = leg.position(leg.duration / 2)
    np.testing.assert_allclose(middle, [0.15, 0.0, 0.1, 0.5], atol=1e-12)
    assert leg.length == pytest.approx(np.hypot(0.3, TURNING_RADIUS))
    turn = ToolTrajectorySegment(
        GraspPhase.APPROACHING, (0.0, 0.0, 0.1, 0.0), (0.0, 0.0, 0.1, 1.0), 0.2, 1.0
    )
    assert turn.duration > TURNING_RADIUS / 0.2
    assert isinstance(make_transform(turn.position(1.0)), RigidTransform)

"""An arm that presses at the table's edge in the full station, where it is told nothing."""

import numpy as np
import pytest
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import transform, wrap_angle
from gridpush_drake.multibody.ground_truth import SetGridObjectPose
from gridpush_drake.planning.pregrasp.weighing_planner import list_edges
from gridpush_drake.planning.weighing.plan import PressRules, list_rests
from gridpush_drake.planning.weighing.press import PressOutcome
from gridpush_drake.station.lcm.hardware_station import MakeHardwareStation
from gridpush_drake.station.limit_monitor import LimitMonitor
from gridpush_drake.station.push_station import MakePushStation
from gridpush_drake.station.robot import make_robot_directives
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.station import make_surface
from gridpush_drake.station.tasks import PreGraspKind
from gridpush_drake.systems.messages import PressCommand, PushCommand

NEAR = np.array([0.5, 0.15])
"""A place on the edge of the table beyond which the arms reach, m."""


def make_scenario(robot=None):
    scenario = PreGraspKind().make_scenario()
    scenario.nothing_told = True
    if robot is not None:
        scenario.directives = make_robot_directives(robot, grasping=True)
    return scenario


class PressBench:
    """A station whose object lies where a press is planned, its center known to a centimeter."""

    def __init__(self, scenario):
        self.station = station = MakePushStation(scenario)
        self.mass = station.truth.total_mass
        self.center = station.truth.center_of_mass(station.obj)
        centers = self.center + 0.01 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        edges = [edge.line for edge in list_edges(make_surface(station.table_top))]
        self.edge = min(edges, key=lambda edge: abs(edge.calc_beyond(NEAR)))
        rules = PressRules(
            tip_radius=station.robot.finger.tip_radius,
            max_force=24.0,
        )
        rests = list_rests(
            station.obj,
            centers,
            0.4,
            self.edge,
            scenario.object_height,
            rules,
            along=float(self.edge.calc_along(NEAR)),
        )
        self.planned = min(rests, key=lambda one: one.relative_std)
        self.simulator = Simulator(station)
        self.context = self.simulator.get_mutable_context()
        station.SetStart(self.context, scenario.seed)
        plant = station.plant
        SetGridObjectPose(
            plant,
            plant.GetMyMutableContextFromRoot(self.context),
            station.object_in_plant,
            self.planned.pose,
        )
        self.fix("push_command", PushCommand())
        self.fix("press_command", PressCommand())
        self.monitor = LimitMonitor(station)
        self.simulator.set_monitor(self.monitor)
        self.tilt = 0.0

    def fix(self, port, command):
        self.station.GetInputPort(port).FixValue(self.context, command.to_vector())

    def read(self, port):
        return self.station.GetOutputPort(port).Eval(self.context)

    def make_command(self, number=1):
        x, y, theta = self.planned.pose.tolist()
        return PressCommand.from_target(number, self.planned.target, (x, y, theta))

    def run(self, until, longest=20.0):
        """Goes on until something is true of the press's status, and notes the greatest tilt."""
        end = self.context.get_time() + longest
        while self.context.get_time() < end:
            self.simulator.AdvanceTo(self.context.get_time() + 0.02)
            body = int(self.station.object_in_plant.body.index())
            R = self.read("body_poses")[body].rotation().matrix()
            self.tilt = max(self.tilt, float(np.arccos(np.clip(R[2, 2], -1, 1))))
            if until(self.read("press.status")):
                break
        return self.read("press.status")


def is_over(status):
    return status.ready and status.outcome is not None


def check_press(bench):
    bench.fix("press_command", bench.make_command())
    status = bench.run(is_over)
    assert status.outcome == PressOutcome.TILTED, status.reason
    assert status.weighed
    # It is caught: it tilts by less than a degree, and lies where it lay.
    assert 0.0 < bench.tilt < np.radians(1.0)
    off = bench.read("object.pose_true") - bench.planned.pose
    assert np.abs(off[:2]).max() < 1.5e-3
    assert abs(wrap_angle(off[2])) < 0.02
    assert bench.monitor.limit_report.ok, bench.monitor.limit_report
    # F a = m g b, by a force that is told from the joints' torques, with noise and an offset.
    (press,) = bench.read("weighing.log").presses
    b = -bench.edge.calc_beyond(transform(bench.planned.pose, bench.center[None])[0])
    assert press.force * press.arm == pytest.approx(bench.mass * GRAVITY * b, rel=0.04)
    np.testing.assert_array_equal(press.pose, bench.planned.pose)


def test_an_arm_weighs_what_hangs_over_the_edge_and_leaves_it_where_it_lies():
    check_press(PressBench(make_scenario()))


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["panda", "ur5e", "xarm6"])
def test_every_arm_with_a_gripper_presses(robot):
    check_press(PressBench(make_scenario(robot)))


def test_a_press_keeps_to_the_force_that_is_safe_and_can_be_taken_back():
    scenario = make_scenario()
    scenario.safety.force = 4.0
    bench = PressBench(scenario)
    bench.fix("press_command", bench.make_command())
    status = bench.run(is_over)
    assert status.outcome == PressOutcome.TOO_HEAVY
    assert not status.weighed
    assert not len(bench.read("weighing.log"))
    # Another one is taken back as soon as it has begun to press: the tip goes up at once.
    bench.fix("press_command", bench.make_command(2))
    bench.run(lambda status: status.step == "pressing")
    bench.fix("press_command", PressCommand())
    status = bench.run(is_over, longest=5.0)
    assert (status.command_id, status.outcome) == (2, PressOutcome.BROKEN_OFF)
    home = bench.read("executor.tip_pose").translation()
    np.testing.assert_allclose(bench.read("pusher.state")[:3], home, atol=2e-3)


def test_a_station_that_is_told_what_the_object_weighs_has_nothing_to_press_with():
    station = MakePushStation(PreGraspKind().make_scenario())
    assert not station.HasInputPort("press_command")
    assert not station.HasOutputPort("weighing.log")
    with pytest.raises(StationError, match=r"nothing is weighed; expected .* nothing_told: true"):
        station.FindPressObstacle(PressCommand(1))
    assert station.obj.prior.total_mass == pytest.approx(0.68)


def test_nothing_is_told_but_the_outline():
    station = MakePushStation(make_scenario())
    prior = station.obj.prior
    assert prior.total_mass is None
    assert (prior.friction_min, prior.friction_max) == (0.1, 0.9)
    assert station.truth.total_mass == pytest.approx(0.68)


def test_the_hidden_mass_may_be_drawn_from_a_range():
    scenario = PushScenario(nothing_told=True)
    scenario.truth.total_mass = [0.1, 3.0]
    station = MakePushStation(scenario)
    context = station.CreateDefaultContext()
    masses = []
    for seed in range(6):
        station.SetStart(context, seed)
        masses.append(station.GetTruth(context).total_mass)
    assert min(masses) > 0.1
    assert max(masses) < 3.0
    assert max(masses) > 3 * min(masses)


def test_a_real_arm_s_station_presses_by_what_its_joints_feel():
    station = MakeHardwareStation(make_scenario(), lcm=DrakeLcm("memq://"))
    assert station.HasInputPort("press_command")
    assert station.HasOutputPort("press.status")
    assert station.HasOutputPort("weighing.log")
    assert station.obj.prior.total_mass is None
    # No noise is added to what a real arm says.
    sensor = station.GetSubsystemByName("load_sensor")
    assert not sensor._noise.sample_std.any()
    assert not sensor._noise.offset_std.any()

"""An arm that presses at the table's edge in the full station, where it is told nothing."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import transform, wrap_angle
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.tilt_tests.weighed_model import estimate_masses
from gridpush_drake.multibody.ground_truth import SetGridObjectPose
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.weighing_planner import list_edges
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.plan import PressRules, list_placements
from gridpush_drake.planning.weighing.press import PressOutcome
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import LiftTest, MassTestLog, TiltTest
from gridpush_drake.station.hardware.hardware_station import MakeHardwareStation
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.scene.contents import load_object
from gridpush_drake.station.scene.setting import make_surface
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.limit_monitor import LimitMonitor
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.tasks.pregrasp_kind import PreGraspKind
from gridpush_drake.station.tasks.pregrasp_task import PreGraspRecord
from gridpush_drake.station.tasks.task import TaskStatus, TaskStep
from gridpush_drake.station.tasks.task_kind import write_files
from gridpush_drake.systems.base.messages import (
    PreGraspMode,
    PreGraspStatus,
    PressCommand,
    PushCommand,
)
from gridpush_drake.systems.execution.press_executor import MAX_MOVE
from tests.identification.simulated_pokes import make_pokes

NEAR = np.array([0.5, 0.15])
"""A place on the edge of the table beyond which the arms reach, m."""


def make_scenario(robot=None):
    scenario = PreGraspKind().make_scenario()
    scenario.unknown_inertia = True
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
        rests = list_placements(
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


def check_press(bench, moved=1.5e-3):
    bench.fix("press_command", bench.make_command())
    status = bench.run(is_over)
    assert status.outcome == PressOutcome.TILTED, status.reason
    assert status.weighed
    # It is caught: it tilts by hardly more than is meant, and lies where it lay.
    assert 0.0 < bench.tilt < np.radians(5.0)
    off = bench.read("object.pose_true") - bench.planned.pose
    assert np.abs(off[:2]).max() < moved
    assert abs(wrap_angle(off[2])) < 0.02
    assert bench.monitor.limit_report.ok, bench.monitor.limit_report
    # F a = m g b, by a force that is told from the joints' torques, with noise and an offset.
    (press,) = bench.read("weighing.log").presses
    b = -bench.edge.calc_beyond(transform(bench.planned.pose, bench.center[None])[0])
    b -= press.center_shift
    assert press.force * press.arm == pytest.approx(bench.mass * GRAVITY * b, rel=0.04)
    np.testing.assert_array_equal(press.pose, bench.planned.pose)


@pytest.mark.slow
def test_an_arm_weighs_what_hangs_over_the_edge_and_leaves_it_where_it_lies():
    check_press(PressBench(make_scenario()))


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["panda", "ur5e", "xarm6"])
def test_every_arm_with_a_gripper_presses(robot):
    # An arm that gives way sideways takes the object along; four times as far would end the press.
    check_press(PressBench(make_scenario(robot)), moved=MAX_MOVE / 4)


@pytest.mark.slow
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
    with pytest.raises(
        StationError, match=r"nothing is weighed; expected .* unknown_inertia: true"
    ):
        station.FindPressObstacle(PressCommand(1))
    assert station.obj.prior.total_mass == pytest.approx(0.68)


def test_nothing_is_told_but_the_outline():
    station = MakePushStation(make_scenario())
    prior = station.obj.prior
    assert prior.total_mass is None
    assert (prior.friction_min, prior.friction_max) == (0.1, 0.9)
    assert station.truth.total_mass == pytest.approx(0.68)


@pytest.mark.slow
def test_the_hidden_mass_may_be_drawn_from_a_range():
    scenario = PushScenario(unknown_inertia=True)
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
    station = MakeHardwareStation(make_scenario())
    assert station.HasInputPort("press_command")
    assert station.HasOutputPort("press.status")
    assert station.HasOutputPort("weighing.log")
    assert station.obj.prior.total_mass is None
    # No noise is added to what a real arm says.
    sensor = station.GetSubsystemByName("load_sensor")
    assert not sensor._noise.sample_std.any()
    assert not sensor._noise.offset_std.any()


@pytest.fixture(scope="module")
def weighed(tmp_path_factory):
    """A record of a run in which an object was pushed, pressed and lifted, and its scenario."""
    scenario = make_scenario()
    obj = load_object(scenario).forget()
    truth = CellParameters.uniform(obj, 0.7, 0.35)
    log = make_pokes(obj, truth, 2, 5, observations=3, length=0.05)
    log = PushLog(
        tuple(
            replace(seen, force_t=np.array([0.5]), force=2.0 * seen.push.velocity[None] / 0.05)
            for seen in log
        )
    )
    # A file has the tip's place in each row: what was read is written the same.
    path = tmp_path_factory.mktemp("weighed") / "pushes.csv"
    log.write_csv(path)
    log = PushLog.read_csv(path)
    press = TiltTest(np.zeros(3), np.array([0.1, 0.0]), 5.0, np.array([0.05, 0.0]), 0.0)
    lift = LiftTest(np.zeros(3), np.array([0.0, 0.1]), 6.9, np.array([0.7, 0.0]))
    weighings = MassTestLog((press,), (lift,))
    pushed = identify(Model(obj), log, regime="quasi_static")
    status = PreGraspStatus(PreGraspMode.HOLDING, "The object is lifted and held.", presses=1)
    record = PreGraspRecord(
        obj=obj,
        truth=truth,
        surface=SupportSurface.rectangle((0.0, 0.0), (0.8, 0.8)),
        last=status,
        log=log,
        estimates=[pushed, estimate_masses(pushed, weighings)],
        weighings=weighings,
        status=TaskStatus.HELD,
        message="The object was lifted and held.",
        raised=0.1,
    )
    for step in (replace(status, mode=PreGraspMode.WEIGHING), status):
        record.steps.append(TaskStep(time=1.0, status=step, pose=np.zeros(3)))
    return record, scenario


def test_what_was_weighed_is_told_beside_the_truth(weighed):
    record, _ = weighed
    absolute = record.estimates[-1].absolute
    summary = PreGraspKind().summarize(record)
    assert summary["presses"] == 1
    assert summary["weighed"]["total_mass"] == absolute.total_mass
    assert summary["weighed"]["true"]["total_mass"] == pytest.approx(0.7)
    json.dumps(summary["weighed"])
    lines = "\n".join(PreGraspKind().describe(summary))
    assert "weighed by 1 press at the edge, 1 lift and " in lines
    low, high = absolute.mass_interval
    assert (
        f"mass: {absolute.total_mass:.3f} kg, {low:.3f} to {high:.3f} kg; truly 0.700 kg" in lines
    )
    assert "center of mass: x " in lines
    assert "mean friction: " in lines
    assert "truly 0.350" in lines
    # Where nobody knows the truth, nothing is said of it.
    unknown = PreGraspKind().summarize(replace(record, truth=None))
    assert "truly" not in "\n".join(PreGraspKind().describe(unknown))


def test_a_run_that_is_given_up_says_so_in_one_sentence(weighed):
    why = "No safe way: the margin is 3.1 mm of 8.0 mm; it may be 12 mm off, after 6 pokes."
    given_up = replace(
        weighed[0],
        status=TaskStatus.FAILED,
        message=why,
        raised=-0.0001,
        last=replace(weighed[0].last, grasps=0),
    )
    lines = PreGraspKind().describe(PreGraspKind().summarize(given_up))
    assert lines[0].endswith(": The robot gave the object up.")
    assert lines[1].strip() == why
    report = PreGraspKind().make_summary(given_up)
    assert report.headline.startswith("The robot gave the object up. It took ")
    assert "raised by" not in dict(report.facts)
    grasped = replace(given_up, last=replace(given_up.last, grasps=1))
    assert dict(PreGraspKind().make_summary(grasped).facts)["raised by"] == "0 mm"


@pytest.mark.slow
def test_the_files_of_a_weighed_run_make_the_same_model_again(weighed, tmp_path, undrawn):
    record, scenario = weighed
    written = write_files(PreGraspKind(), tmp_path, scenario, record, None, force=False)
    assert tmp_path / "weighings.csv" in written
    assert "truly 0.700 kg" in (tmp_path / "report.html").read_text()
    read = MassTestLog.read_csv(tmp_path / "weighings.csv")
    assert [lift.weight for lift in read.lifts] == [6.9]
    obj = GridObject.from_yaml(tmp_path / "object.yaml")
    assert obj.prior.total_mass is None
    again = identify(Model(obj), PushLog.read_csv(tmp_path / "pushes.csv"), regime="quasi_static")
    absolute = estimate_masses(again, read).absolute
    np.testing.assert_array_equal(absolute.mean, record.estimates[-1].absolute.mean)

"""Grasps in full physics: what overhangs the edge is taken from the side, lifted and held; the masses are hidden."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from gridpush_drake.errors import StationError
from gridpush_drake.multibody.ground_truth import SetGridObjectPose
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.planning.pregrasp.grasp.side_grasp import choose_varied, find_side_grasps
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.station.scene.setting import make_style
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.simulated.limit_monitor import LimitMonitor
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.systems.base.messages import GraspCommand, PushCommand

TRIED = 20  # of the best grasps, that the arm is asked about
LIFT = 0.1
OVERHANGING = {
    "claw_hammer": (0.5, 0.07, np.pi / 2),  # the head hangs over
    "combination_wrench": (0.5, 0.125, np.pi / 3),
    "spray_bottle": (0.5, 0.09, np.pi),
}


def make_station(name="claw_hammer"):
    scenario = read_scenario(find_models() / "scenarios/grasp.yaml")
    scenario.object = name
    return MakePushStation(scenario)


@pytest.fixture(scope="module")
def hammer():
    return make_station()


class Run:
    """A station from its start, with the object at a pose of one's own."""

    def __init__(self, station, pose, seed=0):
        self.station = station
        self.simulator = Simulator(station, station.CreateDefaultContext())
        self.context = self.simulator.get_mutable_context()
        station.SetStart(self.context, seed)
        plant_context = station.plant.GetMyMutableContextFromRoot(self.context)
        SetGridObjectPose(station.plant, plant_context, station.object_in_plant, pose)
        self.pose = pose
        station.GetInputPort("push_command").FixValue(self.context, PushCommand().to_vector())
        self.monitor = LimitMonitor(station, 0.005)
        self.simulator.set_monitor(self.monitor)
        self.simulator.Initialize()

    def read(self, port):
        return self.station.GetOutputPort(port).Eval(self.context)

    @property
    def height(self):
        """Of the object's origin, and how far it is tipped, m and rad."""
        X_WB = self.read("body_poses")[int(self.station.object_in_plant.body.index())]
        return X_WB.translation()[2], np.arccos(min(X_WB.rotation().matrix()[2, 2], 1.0))

    def find_best(self):
        """The command for the best grasp by the true center of mass that the arm can carry out."""
        station = self.station
        center = station.truth.center_of_mass(station.obj)
        found = find_side_grasps(
            station.obj, self.pose, SupportSurface(station.table_top), aim=center
        )
        for grasp in choose_varied(found, TRIED):
            command = GraspCommand(1, *grasp.p_WG, 0.015, grasp.approach, LIFT)
            if station.FindGraspObstacle(command) is None:
                return command
        raise AssertionError("no grasp")

    def grasp(self, command, limit=60.0):
        """Carries a command out to its end."""
        self.station.GetInputPort("grasp_command").FixValue(self.context, command.to_vector())
        while self.context.get_time() < limit:
            self.simulator.AdvanceTo(self.context.get_time() + 0.1)
            status = self.read("grasp.status")
            if status.outcome == "held" or (
                status.command_id == command.command_id and status.ready
            ):
                return status
        raise AssertionError(f"not done after {limit} s: {status}")


def check_held(run, status):
    assert status.outcome == "held", status
    height, tilt = run.height
    assert height == pytest.approx(LIFT, abs=0.005)
    assert tilt < np.radians(1.0)
    assert run.monitor.limit_report.ok, run.monitor.limit_report
    assert len(run.read("estimate.push_log")) == 0  # a grasp is no push


@pytest.mark.slow
def test_the_hammer_is_taken_by_its_overhanging_head_lifted_and_held(hammer):
    run = Run(hammer, OVERHANGING["claw_hammer"])
    check_held(run, run.grasp(run.find_best()))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "pose"), [(1, (0.5, 0.063, 1.31)), (2, (0.5, 0.178, -1.83))])
def test_the_hammer_is_held_however_its_mass_is_spread(hammer, seed, pose):
    run = Run(hammer, pose, seed)
    check_held(run, run.grasp(run.find_best()))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["combination_wrench", "spray_bottle"])
def test_other_objects_are_held(name):
    run = Run(make_station(name), OVERHANGING[name])
    check_held(run, run.grasp(run.find_best()))


@pytest.mark.slow
def test_a_book_wider_than_the_gripper_opens_is_held_by_its_rim():
    """Under its 9 N the controller's spring between the fingers' middle and the body's gives way by 4.5 mm."""
    station = make_station("open_book")
    run = Run(station, (0.5, 0.115, 0.0), station.scenario.seed)
    status = run.grasp(run.find_best())
    assert status.outcome == "held", status
    height, tilt = run.height
    assert LIFT - 0.006 < height < LIFT
    assert tilt < np.radians(0.5)
    assert run.monitor.limit_report.ok, run.monitor.limit_report


@pytest.mark.slow
def test_a_grasp_at_nothing_goes_back_and_the_station_can_push_again(hammer):
    run = Run(hammer, (0.5, -0.15, 0.0))
    home = run.read("executor.tip_pose").translation().copy()
    status = run.grasp(GraspCommand(1, 0.5, 0.18, 0.015, -np.pi / 2, LIFT))
    assert (status.outcome, status.phase) == ("missed", "idle")
    assert "nothing is in it" in status.reason
    np.testing.assert_allclose(run.read("executor.tip_pose").translation(), home, atol=1e-6)
    np.testing.assert_allclose(run.read("pusher.state")[:3], home, atol=1e-3)
    assert run.read("gripper.state")[:2] == pytest.approx([-0.05, 0.05], abs=2e-3)
    hammer.GetInputPort("push_command").FixValue(
        run.context, PushCommand(1, 0.5, -0.3, np.pi / 2, 0.14, 0.1).to_vector()
    )
    run.simulator.AdvanceTo(run.context.get_time() + 8.0)
    assert run.read("executor.status").executed == 1
    assert len(run.read("estimate.push_log")) == 1
    assert run.monitor.limit_report.ok, run.monitor.limit_report


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (GraspCommand(1, 0.85, 0.18, 0.015, -np.pi / 2, LIFT), "reach"),
        (GraspCommand(1, 0.5, 0.10, 0.015, -np.pi / 2, LIFT), "hit the table"),
        (GraspCommand(1, 0.5, -0.3, 0.015, np.pi / 2, LIFT), "hit the table"),
    ],
)
def test_what_is_out_of_reach_or_in_the_table_is_refused(hammer, command, reason):
    assert reason in hammer.FindGraspObstacle(command)
    run = Run(hammer, (0.5, -0.15, 0.0))
    status = run.grasp(command, 1.0)
    assert (status.outcome, status.phase) == ("refused", "idle")
    assert reason in status.reason


def test_much_of_the_edge_is_within_reach_for_grasps_and_all_of_it_for_pushes(hammer):
    places = np.arange(0.2, 0.8, 0.025)
    reached = [
        hammer.FindGraspObstacle(GraspCommand(1, x, 0.18, 0.015, -np.pi / 2, LIFT)) is None
        for x in places.tolist()
    ]
    assert 0.025 * sum(reached) >= 0.35
    for x in places[reached][places[reached] > 0.45].tolist():
        assert hammer.FindObstacle(PushCommand(1, x, 0.02, np.pi / 2, 0.1, 0.03)) is None


def test_a_scene_without_a_gripper_has_none():
    station = MakePushStation(PushScenario())
    assert station.gripper is None
    assert not station.HasInputPort("grasp_command")
    with pytest.raises(StationError, match="no gripper"):
        station.FindGraspObstacle(GraspCommand())
    assert make_style(station.scenario, station.robot) == station.style

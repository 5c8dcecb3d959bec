"""A robot is a folder: its measures stand beside its model, and another arm needs no change to the package."""

from dataclasses import fields

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from gridpush_drake.errors import ScenarioError
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.planning.pregrasp.side_grasp import SideGripper
from gridpush_drake.station.push_station import MakePushStation
from gridpush_drake.station.robot import FingerMeasures, find_robot, read_measures
from gridpush_drake.station.scenario import read_scenario
from gridpush_drake.station.scene import CalcTipReach, check_scenario
from gridpush_drake.systems.messages import PushCommand

BASE = (0.05, -0.02, 0.08)
"""Of the second arm's base in the world, m."""

SCENARIO = """
object_pose: [0.65, 0.0, 0.0]
directives:
- add_model: {{name: other, file: file://{folder}/arm.urdf}}
- add_weld: {{parent: world, child: 'other::other_link_0', X_PC: {{translation: [{x}, {y}, {z}]}}}}
- add_model: {{name: stick, file: 'package://gridpush_drake/fingers/rod/finger.sdf'}}
- add_weld: {{parent: 'other::other_link_ee_kuka', child: 'stick::finger'}}
- add_model: {{name: table, file: 'package://gridpush_drake/tables/rectangle.sdf'}}
- add_weld: {{parent: world, child: 'table::table', X_PC: {{translation: [0.6, 0.0, 0.0]}}}}
"""


@pytest.fixture
def second_arm(tmp_path):
    """A scenario with an arm of other names at another height, its folder outside the package."""
    iiwa = find_models() / "robots/iiwa14"
    for source, target in (("iiwa14_primitives.urdf", "arm.urdf"), ("robot.yaml", "robot.yaml")):
        (tmp_path / target).write_text((iiwa / source).read_text().replace("iiwa_", "other_"))
    path = tmp_path / "scenario.yaml"
    path.write_text(SCENARIO.format(folder=tmp_path, x=BASE[0], y=BASE[1], z=BASE[2]))
    return path


def test_a_second_arm_pushes(second_arm):
    scenario = read_scenario(second_arm)
    check_scenario(scenario)
    station = MakePushStation(scenario)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.SetStart(context)
    home = np.array(station.robot.arm.home) + [BASE[0], BASE[1], 0.0]
    assert station.GetOutputPort("pusher.state").Eval(context)[:3] == pytest.approx(home, abs=1e-5)
    push = PushCommand(1, 0.65, -0.12, np.pi / 2, 0.16, 0.05)
    assert station.FindObstacle(push) is None
    station.GetInputPort("push_command").FixValue(context, push.to_vector())
    simulator.Initialize()
    before = station.GetOutputPort("object.pose_true").Eval(context).copy()
    simulator.AdvanceTo(12.0)
    status = station.GetOutputPort("executor.status").Eval(context)
    assert (status.executed, status.refused) == (1, 0)
    moved = station.GetOutputPort("object.pose_true").Eval(context) - before
    assert moved[1] > 0.01


def test_reach_is_measured_from_the_base_wherever_it_stands(second_arm):
    station = MakePushStation(read_scenario(second_arm))
    axis, low, high = CalcTipReach(station.plant, station.robot, 0.012)
    assert axis == pytest.approx(BASE[:2])
    assert (low, high) == pytest.approx(station.robot.arm.reach.calc_ring(0.16, 0.012 - BASE[2]))


def test_the_grippers_measures_are_those_that_grasps_are_planned_with():
    robot = find_robot(read_scenario(find_models() / "scenarios/grasp.yaml").directives)
    measured, default = robot.gripper.make_side_gripper(), SideGripper()
    assert {f.name: getattr(measured, f.name) for f in fields(default)} == {
        f.name: getattr(default, f.name) for f in fields(default)
    }


def test_a_tip_radius_that_is_not_the_models_is_refused(second_arm):
    folder = second_arm.parent / "finger"
    folder.mkdir()
    (folder / "finger.sdf").write_text((find_models() / "fingers/rod/finger.sdf").read_text())
    (folder / "finger.yaml").write_text("tip_frame: finger_tip\ntip_radius: 0.01")
    text = second_arm.read_text().replace("package://gridpush_drake/fingers/rod", f"file://{folder}")
    second_arm.write_text(text)
    with pytest.raises(ScenarioError, match=r"tip_radius is 0\.01 m; expected 0\.008 m"):
        check_scenario(read_scenario(second_arm))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tip_frame: tip", "tip_radius is missing; expected a positive number, in m"),
        ("tip_frame: tip\ntip_radius: -1", "tip_radius is -1; expected a positive number, in m"),
        ("tip_frame: tip\ntip_radios: 1", "tip_radios: unknown key; did you mean tip_radius"),
        ("- 1", "expected finger measures"),
    ],
)
def test_measures_that_will_not_do_are_refused(tmp_path, text, message):
    path = tmp_path / "finger.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=message) as caught:
        read_measures(path, FingerMeasures)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("base_frame: other_link_0", "base_frame: foot", "there is no frame other::foot"),
        ("robot.yaml", None, "there is no robot; expected a model in whose folder there is a robot"),
    ],
)
def test_a_robot_that_is_not_there_is_refused(second_arm, old, new, message):
    path = second_arm.parent / "robot.yaml"
    if new is None:
        path.unlink()
    else:
        path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ScenarioError, match=message):
        check_scenario(read_scenario(second_arm))

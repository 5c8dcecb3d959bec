"""`--ros2` and `--ros-args` on the command line, where there is no ROS 2."""

import sys

import pytest
from pydrake.systems.analysis import Simulator

from gridpush_drake.cli.run.open_link import check_robot
from gridpush_drake.cli.shell.ros_args import split_ros_arguments
from gridpush_drake.errors import StationError
from gridpush_drake.station.hardware import MakeTwin
from gridpush_drake.station.links.ros2.ros2_robot import MakeRosRobot
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.systems.robot_records import ArmStatus, GripperStatus, PoseObservation


@pytest.mark.slow
def test_robot_twin_and_tracker_say_what_is_missing(refuses, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    for command in ("robot", "twin", "tracker"):
        refuses(command, "--ros2", says=["--ros2", "expected ROS 2 in this shell"])


@pytest.mark.parametrize("robot", ["panda", "gantry"])
def test_every_robot_can_be_spoken_to_over_ros_2_its_hand_too(robot):
    """Drake has no LCM message for a Panda's hand, and a gantry names none at all."""
    scenario = read_scenario("grasp") if robot == "panda" else PushScenario()
    scenario.directives = make_robot_directives(robot, grasping=None)
    resolved = resolve(scenario)
    with pytest.raises(StationError):
        check_robot(resolved.robot, ros2=False)
    check_robot(resolved.robot, ros2=True)
    found = MakeRosRobot(resolved)
    assert len(found.joints) == len(resolved.q_start)
    assert (found.gripper is None) == (robot == "gantry")
    said = []
    simulator = Simulator(MakeTwin(resolved, said.append))
    simulator.get_system().SetStart(simulator.get_mutable_context())
    simulator.AdvanceTo(0.06)
    kinds = {type(record) for record in said}
    assert kinds == {ArmStatus, PoseObservation} | (set() if robot == "gantry" else {GripperStatus})


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["robot", "--ros-args", "-r", "a:=b"], ["--ros-args", "expected --ros2 beside it"]),
        (["demo", "--ros-args", "-r", "a:=b"], ["--ros-args", "robot, tracker, twin"]),
        (["robot", "--ros2", "--lcm", "udpm://239.1.1.1:7667"], ["--lcm and --ros2"]),
    ],
)
def test_options_that_do_not_go_together_are_refused(refuses, arguments, says):
    refuses(*arguments, says=says)


def test_arguments_of_ros_are_told_from_the_commands_own():
    line = ["robot", "--ros2", "--ros-args", "-r", "a:=b", "-p", "c:=1", "--", "--go"]
    assert split_ros_arguments(line) == (["robot", "--ros2", "--go"], ("-r", "a:=b", "-p", "c:=1"))
    assert split_ros_arguments(["export", "--", "x"]) == (["export", "--", "x"], ())

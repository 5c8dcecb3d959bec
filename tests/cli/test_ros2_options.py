"""`--ros2` and `--ros-args` on the command line, where there is no ROS 2."""

import sys

import pytest

from gridpush_drake.cli.ros_args import split_ros_arguments


def test_robot_twin_and_tracker_say_what_is_missing(refuses, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    for command in ("robot", "twin", "tracker"):
        refuses(command, "--ros2", says=["--ros2", "expected ROS 2 in this shell"])


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

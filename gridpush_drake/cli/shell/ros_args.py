"""Arguments of ROS on a command line: what stands between `--ros-args` and `--`, or the line's end.

`ros2 run` and launch files write them like this, and so do ROS users by hand:
`gridpush robot --ros2 --ros-args -r joint_states:=/ur/joint_states -p use_sim_time:=true`.
"""

from collections.abc import Sequence
from contextvars import ContextVar

ROS_ARGS_FLAG = "--ros-args"
ROS_ARGS_END = "--"

ROS_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("ros_arguments", default=())
"""The arguments of ROS of the command that is running."""


def split_ros_arguments(args: Sequence[str]) -> tuple[list[str], tuple[str, ...]]:
    """Splits a command line into what is the command's and what is for ROS."""
    own: list[str] = []
    ros: list[str] = []
    target = own
    for arg in args:
        if arg == ROS_ARGS_FLAG:
            target = ros
        elif arg == ROS_ARGS_END and target is ros:
            target = own
        else:
            target.append(arg)
    return own, tuple(ros)

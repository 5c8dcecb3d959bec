"""What `gridpush robot`, `twin` and `tracker` are linked by: LCM, or ROS 2 with `--ros2`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake.cli.shell.ros_args import ROS_ARGUMENTS
from gridpush_drake.errors import StationError
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.station.links.lcm.lcm_address import DEFAULT_URL, check_url, open_lcm
from gridpush_drake.station.links.lcm.lcm_link import LcmLink
from gridpush_drake.station.links.lcm.lcm_messages import find_arm_messages
from gridpush_drake.station.links.link import LinkRole
from gridpush_drake.station.links.ros2.ros2_link import Ros2Link
from gridpush_drake.station.links.ros2.ros2_robot import MakeRosRobot
from gridpush_drake.station.robot.robot import Robot
from gridpush_drake.station.scene.camera import make_camera
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import format_scenario, parse_scenario

LcmUrl = Annotated[
    str,
    typer.Option(
        "--lcm",
        metavar="URL",
        help="The LCM network over which robot, twin and tracker speak; the default stays on this "
        "computer.",
    ),
]

ByRos2 = Annotated[
    bool,
    typer.Option(
        "--ros2",
        help="Speak over ROS 2 instead of LCM, by the rclpy of the ROS 2 that is sourced in this "
        "shell. What follows --ros-args is for ROS: namespaces, remapping, use_sim_time.",
    ),
]


def check_robot(robot: Robot, ros2: bool) -> None:
    """Checks that a robot can be spoken to. Over ROS 2 every robot can, its gripper, too.

    Raises:
        StationError: over LCM, the messages of the robot's driver are not known.
    """
    if not ros2:
        find_arm_messages(robot)


def check_address(ros2: bool, lcm: str) -> None:
    """Checks what the command line says of the network, without opening it.

    Raises:
        StationError: LCM and ROS 2 were both asked for, or the URL is not one of LCM.
    """
    arguments = ROS_ARGUMENTS.get()
    if ros2 and lcm != DEFAULT_URL:
        raise StationError("--lcm and --ros2 are both given; expected one of them")
    if arguments and not ros2:
        raise StationError("--ros-args: is for ROS; expected --ros2 beside it")
    if not ros2:
        check_url(lcm)


def open_link(
    role: LinkRole, resolved: ResolvedScenario, ros2: bool, lcm: str
) -> LcmLink | Ros2Link:
    """Opens the link of a command.

    Raises:
        StationError: the network is not there, both were asked for, an argument of ROS will not do,
            or the messages of the robot's driver are not known.
    """
    check_address(ros2, lcm)
    camera = find_camera(resolved.scenario)
    if ros2:
        return Ros2Link(role, MakeRosRobot(resolved, camera), ROS_ARGUMENTS.get())
    others = len(resolved.others)
    network = open_lcm(lcm)
    return LcmLink(network, resolved.robot, role, camera=camera, others=others, where=lcm)


def make_camera_opener(
    scenario: PushScenario, ros2: bool, lcm: str
) -> Callable[[], LcmLink | Ros2Link]:
    """What opens the link for the twin's camera, in a process of its own."""
    return partial(_open_for_camera, format_scenario(scenario), ros2, lcm, ROS_ARGUMENTS.get())


def _open_for_camera(
    scenario: str, ros2: bool, lcm: str, arguments: tuple[str, ...]
) -> LcmLink | Ros2Link:
    ROS_ARGUMENTS.set(arguments)
    resolved = resolve(parse_scenario(Path("scenario.yaml"), scenario))
    return open_link(LinkRole.CAMERA, resolved, ros2, lcm)


def find_camera(scenario: PushScenario) -> Camera | None:
    """The color and depth camera of a scenario; None where it has an ideal one."""
    return None if scenario.camera.kind == "ideal" else make_camera(scenario.camera)

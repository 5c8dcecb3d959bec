"""What `gridpush robot`, `twin` and `tracker` are linked by: LCM, or ROS 2 with `--ros2`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake.cli.ros_args import ROS_ARGUMENTS
from gridpush_drake.errors import StationError
from gridpush_drake.perception.camera import Camera
from gridpush_drake.station.camera import make_camera
from gridpush_drake.station.links.bus import Bus
from gridpush_drake.station.links.lcm.lcm_address import check_url, open_lcm
from gridpush_drake.station.links.lcm.robot_messages import (
    GRIPPER_COMMAND,
    GRIPPER_STATUS,
    PICTURES,
    find_arm_messages,
    name_object_channel,
)
from gridpush_drake.station.links.link_bus import LinkBus
from gridpush_drake.station.links.ros2.ros2_link import Ros2Link, Ros2Role, open_ros2
from gridpush_drake.station.links.ros2.ros2_pictures import COLOR
from gridpush_drake.station.links.ros2.ros2_robot import MakeRosRobot
from gridpush_drake.station.links.ros2.ros2_topics import (
    JOINT_STATES,
    OBJECT_POSE,
    name_object_topic,
)
from gridpush_drake.station.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scenario_file import format_scenario, parse_scenario

DEFAULT_URL = "udpm://239.255.76.67:7667?ttl=0"
"""The LCM network that robot, twin and tracker use by default: multicast on this computer."""

LcmUrl = Annotated[
    str,
    typer.Option(
        "--lcm",
        metavar="URL",
        help="The LCM network over which robot, twin and tracker speak; the default stays on this "
        "computer.",
    ),
]

ROS2_MESSAGES = "iiwa"
"""The messages that are used inside if the link is ROS 2."""

ByRos2 = Annotated[
    bool,
    typer.Option(
        "--ros2",
        help="Speak over ROS 2 instead of LCM, by the rclpy of the ROS 2 that is sourced in this "
        "shell. What follows --ros-args is for ROS: namespaces, remapping, use_sim_time.",
    ),
]


@dataclass
class OpenedLink:
    """The link of a command.

    Attributes:
        bus: that the station's messages go over.
        ros: the node behind it; None for LCM.
        where: the network, in words.
        names: what the channels are called there, where they have other names than over LCM.
    """

    bus: Bus
    ros: Ros2Link | None
    where: str
    names: Mapping[str, str] = field(default_factory=dict)

    def rename(self, text: str) -> str:
        """A text with the channels called as the network calls them."""
        for channel, name in self.names.items():
            text = text.replace(channel, name)
        return text

    def close(self) -> None:
        """Leaves the network."""
        if self.ros is not None:
            self.ros.close()


def prepare_link(resolved: ResolvedScenario, ros2: bool) -> ResolvedScenario:
    """Prepares a scenario's robot for a link.

    Over LCM a driver speaks the messages that robot.yaml names. Over ROS 2 every driver speaks the
    same; the messages that station and twin use inside are then an iiwa's, which carry any number
    of joints, for every arm, with a gripper or without.
    """
    if not ros2:
        return resolved
    arm = resolved.robot.arm.model_copy(update={"messages": ROS2_MESSAGES})
    return replace(resolved, robot=replace(resolved.robot, arm=arm))


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


def open_link(role: Ros2Role, resolved: ResolvedScenario, ros2: bool, lcm: str) -> OpenedLink:
    """Opens the link of a command.

    Raises:
        StationError: the network is not there, both were asked for, or an argument of ROS will not
            do.
    """
    check_address(ros2, lcm)
    if not ros2:
        return OpenedLink(open_lcm(lcm), None, lcm)
    return open_ros2_link(role, resolved, ROS_ARGUMENTS.get())


def open_ros2_link(
    role: Ros2Role, resolved: ResolvedScenario, arguments: tuple[str, ...]
) -> OpenedLink:
    """Opens a link over ROS 2; see `open_link`."""
    camera = find_camera(resolved.scenario)
    node = open_ros2(role, MakeRosRobot(resolved, camera), arguments)
    others = len(resolved.others)
    bus = LinkBus(node, resolved.robot, camera=camera, others=others)
    messages = find_arm_messages(resolved.robot)
    names = {
        messages.status: JOINT_STATES,
        messages.command: "the arm's commands",
        GRIPPER_STATUS: f"{JOINT_STATES} of the gripper",
        GRIPPER_COMMAND: "the gripper's commands",
        # The last one first: its channel's name begins with that of object 0.
        **{
            name_object_channel(number): name_object_topic(OBJECT_POSE, number)
            for number in range(others, -1, -1)
        },
        PICTURES: COLOR,
    }
    return OpenedLink(bus, node, f"ROS 2 as node {node.node.get_fully_qualified_name()}", names)


def make_camera_opener(scenario: PushScenario, ros2: bool, lcm: str) -> Callable[[], Bus]:
    """What opens the network for the twin's camera, in a process of its own."""
    if not ros2:
        return partial(open_lcm, lcm)
    return partial(_open_for_camera, format_scenario(scenario), ROS_ARGUMENTS.get())


def _open_for_camera(scenario: str, arguments: tuple[str, ...]) -> Bus:
    scene = resolve(parse_scenario(Path("scenario.yaml"), scenario))
    resolved = prepare_link(scene, True)
    return open_ros2_link(Ros2Role.CAMERA, resolved, arguments).bus


def find_camera(scenario: PushScenario) -> Camera | None:
    """The color and depth camera of a scenario; None where it has an ideal one."""
    return None if scenario.camera.kind == "ideal" else make_camera(scenario.camera)

"""`TwinLink`: passes messages between a twin and the LCM network, but for bad commands.

Commands that cannot be used are left out and counted before the twin's systems see them. Drake ends
the process over a command that is not whole, and a gripper that is told to go to NaN ends the
simulation. Which commands come too late, or were overtaken, is decided by the twin's `CommandRamp`.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any

from drake import lcmt_schunk_wsg_command
from pydrake.lcm import DrakeLcm

from gridpush_drake.errors import StationError
from gridpush_drake.station.links.bus import Bus
from gridpush_drake.station.links.channel import count_reason
from gridpush_drake.station.links.lcm.message_forms import decode_message, find_form_fault
from gridpush_drake.station.links.lcm.robot_messages import (
    GRIPPER_COMMAND,
    GRIPPER_STATUS,
    find_arm_messages,
    name_object_channels,
)
from gridpush_drake.station.robot import Robot


class TwinLink:
    """Passes a twin's messages to the network, and usable commands from the network to the twin.

    Attributes:
        bus: the twin's own LCM, for `MakeTwin(..., listens=False)`.
        left_out: number of commands that could not be used, by why.
    """

    def __init__(self, lcm: Bus, robot: Robot, others: int = 0) -> None:
        """Listens from now on.

        Args:
            lcm: the network.
            robot: the robot, whose joints, driver and gripper say which messages there are.
            others: number of other objects on the table, whose poses are said, too.
        """
        self.bus = DrakeLcm("memq://")
        self.left_out = Counter[str]()
        self._lcm = lcm
        messages = find_arm_messages(robot)
        # Channels out of the twin; and channels into it, with their type and number of joints.
        statuses = [messages.status, *name_object_channels(others)]
        commands = {messages.command: (messages.command_type, len(robot.arm.posture))}
        if robot.gripper is not None:
            statuses.append(GRIPPER_STATUS)
            commands[GRIPPER_COMMAND] = (lcmt_schunk_wsg_command, 0)
        for name in statuses:
            self.bus.Subscribe(name, self._make_sender(name))
        for name, (kind, count) in commands.items():
            lcm.Subscribe(name, self._make_taker(name, kind, count))

    def exchange(self) -> None:
        """Passes on what has come from either side since the last call.

        Call it at least every `ARM_PERIOD`.
        """
        self._lcm.HandleSubscriptions(0)
        self.bus.HandleSubscriptions(0)

    def describe_left_out(self) -> str:
        """Says how many commands were left out, and why; empty if none were."""
        return "; ".join(f"{count} left out: {why}" for why, count in self.left_out.items())

    def leave_out(self, why: str) -> None:
        """Counts a command that cannot be used, by why."""
        count_reason(self.left_out, why)

    def _make_sender(self, name: str) -> Callable[[bytes], None]:
        """Makes a function that passes a channel's messages to the network."""
        return lambda data: self._lcm.Publish(name, data)

    def _make_taker(self, name: str, kind: Any, joints: int) -> Callable[[bytes], None]:
        """Makes a function that passes a channel's usable messages to the twin."""

        def take(data: bytes) -> None:
            try:
                why = find_form_fault(decode_message(kind, name, data), name, joints)
            except StationError as error:  # the caller is C and takes no exceptions
                why = str(error)
            if why:
                self.leave_out(why)
            else:
                self.bus.Publish(name, data)

        return take

"""`TwinLink`: takes commands from a link to a twin, but for bad ones.

Commands that cannot be used are left out and counted before the twin's systems see them: a gripper
that is told to go to NaN ends the simulation. Which commands come too late, or were overtaken, is
decided by the twin's `CommandRamp`.
"""

from collections import Counter

from pydrake.systems.framework import Context

from gridpush_drake.station.hardware.twin import Twin
from gridpush_drake.station.links.channel import count_reason
from gridpush_drake.station.links.link import Link, Unusable
from gridpush_drake.station.links.record_forms import find_form_fault
from gridpush_drake.station.robot.robot import Robot
from gridpush_drake.systems.robot_records import ArmCommand, GripperCommand


class TwinLink:
    """Passes usable commands from a link to the twin that speaks over it.

    Attributes:
        left_out: number of commands that could not be used, by why.
    """

    def __init__(self, link: Link, robot: Robot) -> None:
        """Has heard nothing yet.

        Args:
            link: what the twin is linked by.
            robot: the robot, which says how many joints there are, and whether there is a gripper.
        """
        self.left_out = Counter[str]()
        self._link = link
        self._joints = len(robot.arm.posture)
        self._kinds = (ArmCommand,) if robot.gripper is None else (ArmCommand, GripperCommand)

    def exchange(self, twin: Twin, root_context: Context) -> None:
        """Gives the twin the commands that have come since the last call.

        Call it at least every `ARM_PERIOD`.
        """
        for message in self._link.receive(0.0):
            if isinstance(message, Unusable):
                count_reason(self.left_out, message.why)
            elif isinstance(message, self._kinds):
                name = self._link.get_name(type(message))
                why = find_form_fault(message, name, self._joints)
                if why:
                    count_reason(self.left_out, why)
                else:
                    twin.TakeCommand(root_context, message)

    def describe_left_out(self) -> str:
        """Says how many commands were left out, and why; empty if none were."""
        return "; ".join(f"{count} left out: {why}" for why, count in self.left_out.items())

"""`Link`: the small protocol between control and the world, over which records pass.

A link carries records in both directions. To `gridpush robot` it brings how the arm, the gripper
and the object are, and takes commands away; to a twin it brings commands, and takes statuses away;
to a tracker it brings pictures and takes poses away. So one kind of link (LCM, ROS 2, an SDK, a
pair of queues) serves all three. A link over a network makes records of its messages as they come,
and messages of records as they go; nothing else of this package knows them.

What a link need not do: it need not judge. Records that are doubled, late, out of order, from the
future, or not finite are left out and counted by those who read them (`links.channel`), whatever
the link, and no command goes out but through the `ArmGuard`. What a link cannot make a record of it
reports as `Unusable`, and it is counted with the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    PoseObservation,
)

ARM_PERIOD = 0.005
"""Time between two statuses of an arm, and between two commands, s; drake-iiwa-driver keeps it."""

GRIPPER_PERIOD = 0.05
"""Time between two statuses of a gripper, and between two commands, s."""

MILLISECONDS = 1e3
"""Milliseconds in a second."""


class LinkRole(StrEnum):
    """Who speaks over a link; over ROS 2 it is the name of the node, too."""

    CONTROL = "gridpush_robot"
    ROBOT = "gridpush_twin"
    TRACKER = "gridpush_tracker"
    CAMERA = "gridpush_camera"


@dataclass(frozen=True)
class Unusable:
    """Something that came and of which no record can be made.

    Attributes:
        why: the reason, in words that are the same for all that come for this reason: they are
            counted by it.
        kind: type of the record that it should have been; None if that is not known.
        number: the object's number, for the observation of a pose.
    """

    why: str
    kind: type | None = None
    number: int = 0


SKIPPED = Unusable("a newer picture came meanwhile", Frame)
"""Stands for a picture that a link did not unpack, because it also had a newer one."""

Record = ArmStatus | GripperStatus | PoseObservation | Frame | ArmCommand | GripperCommand
"""What passes along a link. A camera's picture is a `Frame`, whose time is by the arm's clock."""

LinkMessage = Record | Unusable


class Link(Protocol):
    """What stands between control, or a twin, or a tracker, and the rest of the world.

    Attributes:
        place: where the other side is to be looked for, in messages to the user.
    """

    place: str = "on this link"

    def receive(self, timeout: float) -> Sequence[LinkMessage]:
        """Waits until something comes, but no longer than `timeout`, s; 0 to wait for nothing.

        Returns:
            All that has come since the last call, in its order.
        """

    def send(self, record: Record) -> None:
        """Sends a record at once. It must not wait for whoever receives it."""

    def get_name(self, kind: type, number: int = 0) -> str:
        """Returns what the network calls records of a type, for messages to the user.

        Args:
            kind: type of the records.
            number: the object's number, for observations of poses.
        """
        return f"{kind.__name__} {number}" if number else kind.__name__

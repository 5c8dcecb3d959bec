"""`Link`: the small protocol between control and the world, and the records that pass along it.

A link carries records in both directions. To `gridpush robot` it brings how the arm, the gripper
and the object are, and takes commands away; to a twin it brings commands, and takes statuses away;
to a tracker it brings pictures and takes poses away. So one kind of link (ROS 2, an SDK, a pair of
queues) serves all three.

What a link need not do: it need not judge. Records that are doubled, late, out of order, from the
future, or not finite are left out and counted by those who read them (`station.links.channel`),
whatever the link, and no command goes out but through the `ArmGuard`. What a link cannot make a
record of it reports as `Unusable`, and it is counted with the others.

`LinkBus` puts a link in the place of an LCM network, whose messages the station speaks inside.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.perception.frames import Color, Depth

Numbers = Sequence[float] | NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ArmStatus:
    """How an arm is.

    Attributes:
        time: when it was measured, s, by the clock of whoever measures it; it grows from status to
            status.
        position: (n,) measured positions of the joints, rad.
        velocity: (n,) their velocities, rad/s.
        torque_external: (n,) torques on the joints from outside, N m: what is measured beyond what
            gravity and the arm's own motion explain. Zeros where nobody knows: the guard then
            notices an obstacle only by joints that do not follow.
        position_commanded: (n,) positions that the joints were last told to take, rad; None where
            that is not known.
    """

    time: float
    position: Numbers
    velocity: Numbers
    torque_external: Numbers
    position_commanded: Numbers | None = None


@dataclass(frozen=True)
class GripperStatus:
    """How a gripper is.

    Attributes:
        time: when it was measured, s, by the arm's clock or by one of its own.
        opening: distance between the fingers, m.
        speed: of the opening, m/s, positive while it opens.
        force: with which the fingers press, N.
    """

    time: float
    opening: float
    speed: float = 0.0
    force: float = 0.0


@dataclass(frozen=True, eq=False)
class ObjectSight:
    """Where an object was seen.

    The objects of a scenario are numbered: 0 is its `object`, and 1 and so on are its `others`.

    Attributes:
        time: when the picture was taken, s, by the arm's clock.
        pose: (3,) x and y of the object's body frame in the scenario's W, m, and its turn about
            the vertical, rad; NaN where it was not seen.
        number: the object's number.
    """

    time: float
    pose: Numbers
    number: int = 0


@dataclass(frozen=True, eq=False)
class Picture:
    """What a camera saw.

    Attributes:
        time: when, s, by the arm's clock.
        color: (height, width, 3) uint8, red, green, blue.
        depth: (height, width) float32, m, registered to `color`, 0 where it was not measured; None
            without depth.
    """

    time: float
    color: Color
    depth: Depth | None = None


@dataclass(frozen=True, eq=False)
class ArmCommand:
    """Where an arm's joints are to go.

    Attributes:
        time: when the command was made, s, by its sender's clock.
        position: (n,) positions of the joints, rad.
    """

    time: float
    position: Numbers


@dataclass(frozen=True)
class GripperCommand:
    """What a gripper is to do.

    Attributes:
        time: when the command was made, s, by its sender's clock.
        opening: distance between the fingers that is wanted, m.
        force: greatest force that the fingers may press with, N.
    """

    time: float
    opening: float
    force: float


@dataclass(frozen=True)
class Unusable:
    """Something that came and of which no record can be made.

    Attributes:
        why: the reason, in words that are the same for all that come for this reason: they are
            counted by it.
    """

    why: str


LinkMessage = (
    ArmStatus | GripperStatus | ObjectSight | Picture | ArmCommand | GripperCommand | Unusable
)


class Link(Protocol):
    """What stands between control, or a twin, or a tracker, and the rest of the world."""

    def receive(self, timeout: float) -> Sequence[LinkMessage]:
        """Waits until something comes, but no longer than `timeout`, s; 0 to wait for nothing.

        Returns:
            All that has come since the last call, in its order.
        """

    def send(self, message: LinkMessage) -> None:
        """Sends a record at once. It must not wait for whoever receives it."""

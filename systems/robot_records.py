"""Records that pass between control, a robot or its twin, and a tracker; systems hold nothing else.

LCM and ROS 2 stand at the edge, see `station.links`: there a message is made a record once, or a
record a message.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array

Numbers = Sequence[float] | NDArray[np.float64]

LEFT_FINGER = -0.5
"""Position of a gripper's left finger, in openings; that of the right one is opposite."""


class OwnNumbers(Unchanging):
    """Base of records that keep their numbers, whatever becomes of the arrays they were made of.

    An SDK may give out its own array, and write into it again.
    """

    def __post_init__(self) -> None:
        """Copies lists and arrays."""
        for name, value in self.__dict__.items():
            if isinstance(value, list):
                self.__dict__[name] = tuple(value)
            elif isinstance(value, np.ndarray):
                own = value.copy()
                own.setflags(write=False)
                self.__dict__[name] = own


@dataclass(frozen=True, eq=False)
class ArmStatus(OwnNumbers):
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
        torque_commanded: (n,) torques that the joints' motors were told to give, N m; None where
            that is not known.
        torque_measured: (n,) measured torques of the joints, N m; None where they are not.
    """

    time: float
    position: Numbers
    velocity: Numbers
    torque_external: Numbers
    position_commanded: Numbers | None = None
    torque_commanded: Numbers | None = None
    torque_measured: Numbers | None = None


@dataclass(frozen=True)
class GripperStatus(Unchanging):
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

    def calc_finger_state(self) -> Array:
        """Calculates (4,) positions of the left and right finger, m, and their velocities, m/s."""
        position = LEFT_FINGER * self.opening
        velocity = LEFT_FINGER * self.speed
        return np.array([position, -position, velocity, -velocity])


@dataclass(frozen=True, eq=False)
class PoseObservation(OwnNumbers):
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
class ArmCommand(OwnNumbers):
    """Where an arm's joints are to go.

    Attributes:
        time: when the command was made, s, by its sender's clock.
        position: (n,) positions of the joints, rad.
    """

    time: float
    position: Numbers


@dataclass(frozen=True)
class GripperCommand(Unchanging):
    """What a gripper is to do.

    Attributes:
        time: when the command was made, s, by its sender's clock.
        opening: distance between the fingers that is wanted, m.
        force: greatest force that the fingers may press with, N.
    """

    time: float
    opening: float
    force: float

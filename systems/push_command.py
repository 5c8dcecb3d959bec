"""What a push command is on a port: a vector of six numbers."""

from dataclasses import dataclass
from math import atan2, cos, isfinite, sin

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push

PUSH_COMMAND_SIZE = 6


@dataclass(frozen=True)
class PushCommand:
    """A straight push of the finger's tip in the plane of the table, world frame.

    Attributes:
        number: counts the commands from 1; a command is new when its number is. 0 stands for no command.
        x: of the tip's centre where the push begins, m.
        y: likewise.
        direction: of the motion, rad from W's x axis, counterclockwise.
        distance: to move, m.
        speed: on the way, m/s.
    """

    number: int = 0
    x: float = 0.0
    y: float = 0.0
    direction: float = 0.0
    distance: float = 0.0
    speed: float = 0.0

    @property
    def start(self) -> NDArray[np.float64]:
        """(2,) p_WP of the tip's centre at the beginning, m."""
        return np.array([self.x, self.y])

    @property
    def end(self) -> NDArray[np.float64]:
        """(2,) p_WP at the end, m."""
        return self.start + self.distance * np.array([cos(self.direction), sin(self.direction)])

    def to_vector(self) -> NDArray[np.float64]:
        """(6,) as on a port: number, x, y, direction, distance, speed."""
        return np.array([self.number, self.x, self.y, self.direction, self.distance, self.speed])

    @classmethod
    def from_vector(cls, vector: NDArray[np.float64]) -> "PushCommand":
        """Reads what `to_vector` wrote; a number that is not finite is none, 0."""
        number, *rest = vector.tolist()
        return cls(round(number) if isfinite(number) else 0, *rest)

    @classmethod
    def from_push(cls, number: int, push: Push) -> "PushCommand":
        """The command for a straight push."""
        x, y = push.start.tolist()
        direction = atan2(push.velocity[1], push.velocity[0])
        return cls(number, x, y, direction, push.length, push.length / push.duration)

"""What a grasp command is on a port: a vector of six numbers."""

from dataclasses import dataclass
from math import cos, isfinite, sin

import numpy as np
from numpy.typing import NDArray

GRASP_COMMAND_SIZE = 6


@dataclass(frozen=True)
class GraspCommand:
    """A grasp from beyond the table's rim, one jaw under the object and one over it, world frame.

    Attributes:
        number: counts the commands from 1; a command is new when its number is. 0 stands for no command.
        x: of the grasp point p_WG, the middle between the pads, m.
        y: likewise.
        z: likewise; half the object's thickness where it lies on the table.
        approach: heading in which the fingers point while they go in, level, rad from W's x axis, counterclockwise.
        lift: how high to lift what was grasped, m.
    """

    number: int = 0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    approach: float = 0.0
    lift: float = 0.0

    @property
    def p_WG(self) -> NDArray[np.float64]:
        """(3,) the grasp point, m."""
        return np.array([self.x, self.y, self.z])

    @property
    def heading(self) -> NDArray[np.float64]:
        """(2,) unit vector in which the fingers point, in W."""
        return np.array([cos(self.approach), sin(self.approach)])

    def to_vector(self) -> NDArray[np.float64]:
        """(6,) as on a port: number, x, y, z, approach, lift."""
        return np.array([self.number, self.x, self.y, self.z, self.approach, self.lift])

    @classmethod
    def from_vector(cls, vector: NDArray[np.float64]) -> "GraspCommand":
        """Reads what `to_vector` wrote; a number that is not finite is none, 0."""
        number, *rest = vector.tolist()
        return cls(round(number) if isfinite(number) else 0, *rest)

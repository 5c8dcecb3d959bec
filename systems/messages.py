"""What systems say to each other on their ports: commands, as vectors, and what becomes of them, as abstract values.

What executors say of themselves is in `planning.robot_status`; what controllers
say is the status of their loops, `planning.goal.push_to_goal` and
`planning.pregrasp.pregrasp_loop`.
"""

from dataclasses import astuple, dataclass
from math import atan2, cos, isfinite, sin
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.planning.goal.push_to_goal import ContactPointMode as ContactPointMode
from gridpush_drake.planning.goal.push_to_goal import ContactPointStatus as ContactPointStatus
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspMode as PreGraspMode
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspStatus as PreGraspStatus
from gridpush_drake.planning.robot_status import GraspOutcome as GraspOutcome
from gridpush_drake.planning.robot_status import GraspPhase as GraspPhase
from gridpush_drake.planning.robot_status import GraspStatus as GraspStatus
from gridpush_drake.planning.robot_status import PushPhase as PushPhase
from gridpush_drake.planning.robot_status import PushStatus as PushStatus

PUSH_COMMAND_SIZE = 6


@dataclass(frozen=True)
class _Command:
    command_id: int = 0

    def to_vector(self) -> NDArray[np.float64]:
        """(6,) as on a port: the attributes in their order."""
        return np.array(astuple(self), dtype=np.float64)

    @classmethod
    def from_vector(cls, vector: NDArray[np.float64]) -> Self:
        """Reads what `to_vector` wrote; an id that is not finite is none, 0."""
        command_id, *rest = vector.tolist()
        return cls(round(command_id) if isfinite(command_id) else 0, *rest)


@dataclass(frozen=True)
class PushCommand(_Command):
    """A straight push of the finger's tip in the plane of the table, world frame.

    Attributes:
        command_id: counts the commands from 1; a command is new when its id is. 0 stands for no
            command.
        x: of the tip's center where the push begins, m.
        y: likewise.
        direction: of the motion, rad from W's x axis, counterclockwise.
        distance: to move, m.
        speed: on the way, m/s.
    """

    x: float = 0.0
    y: float = 0.0
    direction: float = 0.0
    distance: float = 0.0
    speed: float = 0.0

    @property
    def start(self) -> NDArray[np.float64]:
        """(2,) p_WP of the tip's center at the beginning, m."""
        return np.array([self.x, self.y])

    @property
    def end(self) -> NDArray[np.float64]:
        """(2,) p_WP at the end, m."""
        return self.start + self.distance * np.array([cos(self.direction), sin(self.direction)])

    @classmethod
    def from_push(cls, command_id: int, push: Push | None) -> "PushCommand":
        """The command for a straight push; no command for None."""
        if push is None:
            return cls()
        x, y = push.start.tolist()
        direction = atan2(push.velocity[1], push.velocity[0])
        return cls(command_id, x, y, direction, push.length, push.length / push.duration)


GRASP_COMMAND_SIZE = 6


@dataclass(frozen=True)
class GraspCommand(_Command):
    """A grasp from beyond the table's edge, one jaw under the object and one over it, world frame.

    Attributes:
        command_id: counts the commands from 1; a command is new when its id is. 0 stands for no
            command.
        x: of the grasp point p_WG, the middle between the pads, m.
        y: likewise.
        z: likewise; half the object's thickness where it lies on the table.
        approach: heading in which the fingers point while they go in, level, rad from W's x axis,
            counterclockwise.
        lift: how high to lift what was grasped, m.
    """

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

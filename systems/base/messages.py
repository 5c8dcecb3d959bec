"""The values on the ports between systems: commands, as vectors, and statuses, as abstract values.

The statuses are defined elsewhere, and can be imported from here: those of executors are in
`planning.robot_status`, those of controllers in `planning.goal.push_to_goal` and
`planning.pregrasp.pregrasp_loop`.
"""

from dataclasses import astuple, dataclass
from math import atan2, cos, isfinite, sin
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.planning.goal.push_to_goal_loop import ContactPointMode as ContactPointMode
from gridpush_drake.planning.goal.push_to_goal_loop import ContactPointStatus as ContactPointStatus
from gridpush_drake.planning.pregrasp.grasp.side_grasp import SideGrasp
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspMode as PreGraspMode
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspStatus as PreGraspStatus
from gridpush_drake.planning.robot_status import GraspOutcome as GraspOutcome
from gridpush_drake.planning.robot_status import GraspPhase as GraspPhase
from gridpush_drake.planning.robot_status import GraspStatus as GraspStatus
from gridpush_drake.planning.robot_status import PressStatus as PressStatus
from gridpush_drake.planning.robot_status import PressStep as PressStep
from gridpush_drake.planning.robot_status import PushPhase as PushPhase
from gridpush_drake.planning.robot_status import PushStatus as PushStatus
from gridpush_drake.planning.robot_status import SteerPhase as SteerPhase
from gridpush_drake.planning.robot_status import SteerStatus as SteerStatus
from gridpush_drake.planning.weighing.press import PressTarget

PUSH_COMMAND_SIZE = 6
"""Length of a `PushCommand` as a vector."""


@dataclass(frozen=True)
class _Command:
    """A command that stands on a port as a vector."""

    command_id: int = 0

    def to_vector(self) -> NDArray[np.float64]:
        """Returns the command as the vector on a port: the attributes in their order."""
        return np.array(astuple(self), dtype=np.float64)

    @classmethod
    def from_vector(cls, vector: NDArray[np.float64]) -> Self:
        """Reads a vector that `to_vector` made; an id that is not finite stands for no command."""
        command_id, *rest = vector.tolist()
        return cls(round(command_id) if isfinite(command_id) else 0, *rest)


@dataclass(frozen=True)
class PushCommand(_Command):
    """A straight push of the finger's tip in the plane of the table, world frame.

    Attributes:
        command_id: counts the commands from 1; a command is new when its id is. 0 stands for no
            command.
        x: x of the tip's center where the push begins, m.
        y: y of the tip's center where the push begins, m.
        direction: direction of the motion, from W's x axis, counterclockwise, rad. A pusher that is
            no disc is turned to it.
        distance: length of the motion, m.
        speed: speed of the motion, m/s.
    """

    x: float = 0.0
    y: float = 0.0
    direction: float = 0.0
    distance: float = 0.0
    speed: float = 0.0

    @property
    def start(self) -> NDArray[np.float64]:
        """Position p_WP (2,) of the tip's center at the beginning, m."""
        return np.array([self.x, self.y])

    @property
    def end(self) -> NDArray[np.float64]:
        """Position p_WP (2,) of the tip's center at the end, m."""
        return self.start + self.distance * np.array([cos(self.direction), sin(self.direction)])

    @classmethod
    def from_push(cls, command_id: int, push: Push | None) -> "PushCommand":
        """Makes the command for a straight push; no command for None."""
        if push is None:
            return cls()
        x, y = push.start.tolist()
        return cls(
            command_id=command_id,
            x=x,
            y=y,
            direction=atan2(push.velocity[1], push.velocity[0]),
            distance=push.length,
            speed=push.length / push.duration,
        )


PRESS_COMMAND_SIZE = 11
"""Length of a `PressCommand` as a vector."""


@dataclass(frozen=True)
class PressCommand(_Command):
    """A press on a part of an object that hangs over the table's edge, world frame.

    Attributes:
        command_id: counts the commands from 1; a command is new when its id is. 0 stands for no
            command.
        x: x of the tip's center, m.
        y: y of the tip's center, m.
        edge_x: x of a point of the edge, m.
        edge_y: y of a point of the edge, m.
        edge_angle: direction of the edge's outward normal, from W's x axis, counterclockwise, rad.
        top: height of the object's top above the table, m.
        object_x: x of the object's body frame as it was seen at rest, m.
        object_y: y of it, m.
        object_theta: heading of it, rad.
        no_tip_force: force up to which the object surely lies still, N.
    """

    x: float = 0.0
    y: float = 0.0
    edge_x: float = 0.0
    edge_y: float = 0.0
    edge_angle: float = 0.0
    top: float = 0.0
    object_x: float = 0.0
    object_y: float = 0.0
    object_theta: float = 0.0
    no_tip_force: float = 0.0

    @property
    def object_pose(self) -> NDArray[np.float64]:
        """Pose X_WB (3,) of the object as it was seen at rest, m and rad."""
        return np.array([self.object_x, self.object_y, self.object_theta])

    def make_target(self, tip_radius: float) -> PressTarget:
        """Makes the target of the press, for a tip whose sphere has a radius, m."""
        return PressTarget(
            place=(self.x, self.y),
            edge_point=(self.edge_x, self.edge_y),
            edge_angle=self.edge_angle,
            top=self.top,
            tip_radius=tip_radius,
            no_tip_force=self.no_tip_force,
        )

    @classmethod
    def from_target(
        cls,
        command_id: int,
        target: PressTarget | None,
        pose: tuple[float, float, float] | None,
    ) -> "PressCommand":
        """Makes the command for a press; no command for None.

        Args:
            command_id: number of the command, from 1.
            target: where to press.
            pose: (x, y, theta) of the object as it was seen at rest, X_WB, m and rad.
        """
        if target is None or pose is None:
            return cls()
        x, y = target.place
        edge_x, edge_y = target.edge_point
        object_x, object_y, object_theta = pose
        return cls(
            command_id=command_id,
            x=x,
            y=y,
            edge_x=edge_x,
            edge_y=edge_y,
            edge_angle=target.edge_angle,
            top=target.top,
            object_x=object_x,
            object_y=object_y,
            object_theta=object_theta,
            no_tip_force=target.no_tip_force,
        )


GRASP_COMMAND_SIZE = 6
"""Length of a `GraspCommand` as a vector."""


@dataclass(frozen=True)
class GraspCommand(_Command):
    """A grasp from beyond the table's edge, one jaw under the object and one over it, world frame.

    Attributes:
        command_id: counts the commands from 1; a command is new when its id is. 0 stands for no
            command.
        x: x of the grasp point p_WG, the middle between the pads, m.
        y: y of the grasp point, m.
        z: z of the grasp point, m; half the height of an object that lies on the table.
        approach: direction in which the fingers point while they go in, level, from W's x axis,
            counterclockwise, rad.
        lift: height to which the object is lifted, m.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    approach: float = 0.0
    lift: float = 0.0

    @property
    def p_WG(self) -> NDArray[np.float64]:
        """Position (3,) of the grasp point, m."""
        return np.array([self.x, self.y, self.z])

    @property
    def heading(self) -> NDArray[np.float64]:
        """Unit vector (2,) in W in which the fingers point."""
        return np.array([cos(self.approach), sin(self.approach)])

    @classmethod
    def from_grasp(
        cls, command_id: int, grasp: SideGrasp | None, height: float, lift: float
    ) -> "GraspCommand":
        """Makes the command for a grasp; no command for None.

        Args:
            command_id: number of the command, from 1.
            grasp: the grasp.
            height: z of the grasp point, m.
            lift: height to which the object is lifted, m.
        """
        if grasp is None:
            return cls()
        x, y = grasp.p_WG.tolist()
        return cls(command_id, x=x, y=y, z=height, approach=grasp.approach, lift=lift)


STEER_COMMAND_SIZE = 7
"""Length of a `SteerCommand` as a vector."""


@dataclass(frozen=True)
class SteerCommand(_Command):
    """A finger that is steered by its velocity, world frame.

    With a new id the finger comes down at (x, y). Then it moves with the velocity on the port,
    which changes while the id stays. With id 0 it goes up and back.

    Attributes:
        command_id: counts the commands from 1; a command is new when its id is. 0 stands for no
            command.
        x: x of the tip's center where the finger comes down, m.
        y: y of the tip's center there, m.
        vx: velocity of the tip along x, m/s.
        vy: velocity of the tip along y, m/s.
        yaw: angle of a pusher that is no disc where it comes down, rad.
        yaw_rate: speed at which it turns, rad/s.
    """

    x: float = 0.0
    y: float = 0.0
    vx: float = 0.0
    vy: float = 0.0
    yaw: float = 0.0
    yaw_rate: float = 0.0

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocity (3,) of the tip's center, m/s, and of its angle, rad/s."""
        return np.array([self.vx, self.vy, self.yaw_rate])

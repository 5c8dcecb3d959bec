"""`PlanarPoseSensor`: an ideal camera, which measures an object's pose on the table with noise."""

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS

DEFAULT_PERIOD = 1 / 30
"""Time between two pictures, s."""


class PlanarPoseSensor(LeafSystem):
    """Samples the pose of a body in the plane of the table, with Gaussian noise.

    .. pydrake_system::

        name: PlanarPoseSensor
        input_ports:
        - body_poses
        output_ports:
        - object_pose

    * body_poses: abstract `list[RigidTransform]`, X_WB of all bodies, as a MultibodyPlant has it.
    * object_pose: vector of 3, x and y of the body's origin in W, m, and its yaw, rad, as last
      seen. The yaw counts whole turns. NaN if the body is out of sight, or its pose is not finite.

    The noise of the k-th picture depends only on k and the seed, which is numeric parameter 0, so
    that a Context and its clone see the same. The body is out of sight if the z of its origin in W
    is less than `lowest`, and while the lens is covered, which numeric parameter 1 says.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        body: BodyIndex,
        *,
        period: float = DEFAULT_PERIOD,
        position_noise: float = 0.0,
        angle_noise: float = 0.0,
        lowest: float = -np.inf,
        seed: int = 0,
    ) -> None:
        """Makes the sensor.

        Args:
            body: index of the body in the plant.
            period: time between two pictures, s.
            position_noise: standard deviation of the noise of x and y, m.
            angle_noise: standard deviation of the noise of the yaw, rad.
            lowest: if the body's origin is lower than this in W, the body is out of sight, m.
            seed: seed of the noise.
        """
        super().__init__()
        self._body = int(body)
        self._std = np.array([position_noise, position_noise, angle_noise])
        self._lowest = lowest
        self._seed = self.DeclareNumericParameter(BasicVector([float(seed)]))
        self._covered = self.DeclareNumericParameter(BasicVector([0.0]))
        self._body_poses = self.DeclareAbstractInputPort(
            "body_poses", Value[list[RigidTransform]]()
        )
        # The pose on the port; the last true yaw, rad; and the number of pictures so far.
        self._seen = self.DeclareDiscreteState(np.full(3, np.nan))
        self._yaw = self.DeclareDiscreteState(1)
        self._count = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("object_pose", self._seen)
        self.DeclareInitializationDiscreteUpdateEvent(self._look_first)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._take_picture)

    def SetSeed(self, root_context: Context, seed: int) -> None:
        """Sets the seed of the noise in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(self._seed).SetFromVector([float(seed)])

    def SetCovered(self, root_context: Context, covered: bool) -> None:
        """Covers the lens in a Diagram's Context, or uncovers it, from the next picture on."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(self._covered).SetFromVector([float(covered)])

    def _look_first(self, context: Context, state: DiscreteValues) -> None:
        """Looks in advance at what the first picture will show, so that a pose is known at once."""
        if context.get_discrete_state(self._count).value()[0] == 0:
            self._see(context, state, 0)

    def _take_picture(self, context: Context, state: DiscreteValues) -> None:
        """Takes the next picture."""
        count = int(context.get_discrete_state(self._count).value()[0])
        state.set_value(self._count, [count + 1])
        self._see(context, state, count)

    def _see(self, context: Context, state: DiscreteValues, count: int) -> None:
        """Writes into the state what the picture of a number, from 0, shows."""
        X_WB: RigidTransform = self._body_poses.Eval(context)[self._body]
        covered = bool(context.get_numeric_parameter(self._covered).value()[0])
        hidden = not np.isfinite(X_WB.GetAsMatrix34()).all() or X_WB.translation()[2] < self._lowest
        if covered or hidden:
            state.set_value(self._seen, np.full(3, np.nan))
            return
        q = project_pose(X_WB, float(context.get_discrete_state(self._yaw).value()[0]))
        state.set_value(self._yaw, [q[2]])
        seed = int(context.get_numeric_parameter(self._seed).value()[0])
        noise = self._std * np.random.default_rng((seed, count)).normal(size=3)
        state.set_value(self._seen, q + noise)


def project_pose(X_WB: RigidTransform, near: float = 0.0) -> NDArray[np.float64]:
    """Projects a pose into the plane: (3,) x, y, m, and yaw, rad.

    Of all yaws that differ by whole turns, it is the one nearest to `near`, rad.
    """
    yaw = RollPitchYaw(X_WB.rotation()).yaw_angle()
    yaw += 2 * np.pi * round((near - yaw) / (2 * np.pi))
    return np.array([*X_WB.translation()[:2], yaw])

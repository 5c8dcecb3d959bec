"""A camera that sees where an object lies on the table, now and then and not quite exactly."""

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS

DEFAULT_PERIOD = 1 / 30
"""Between two pictures, s."""


class PlanarPoseSensor(LeafSystem):
    """Samples the pose of a body in the plane of the table, with Gaussian noise.

    .. pydrake_system::

        name: PlanarPoseSensor
        input_ports:
        - body_poses
        output_ports:
        - object_pose

    * body_poses: abstract `list[RigidTransform]`, as a MultibodyPlant gives it.
    * object_pose: vector of 3, x and y of the body's origin in W, m, and its yaw, rad, as last
      seen; the yaw is continuous, it counts whole turns. NaN where the body is lost from sight, or
      its pose is not finite.

    The noise of the k-th picture depends on k and the seed alone, which is numeric parameter 0: a
    Context and its clone see the same. The body is lost from sight where its origin lies lower than
    `lowest` above z = 0, and while the lens is covered, which numeric parameter 1 says.
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
            body: index of the body among the plant's.
            period: between two pictures, s.
            position_noise: standard deviation per axis, m.
            angle_noise: standard deviation, rad.
            lowest: z in W below which the body's origin is out of sight, m.
            seed: of the noise.
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
        """Covers the lens in a Diagram's Context, or uncovers it; it counts from the next picture."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(self._covered).SetFromVector([float(covered)])

    def _look_first(self, context: Context, state: DiscreteValues) -> None:
        """Sees what the first picture will show, so that something is known from the beginning."""
        if context.get_discrete_state(self._count).value()[0] == 0:
            self._see(context, state, 0)

    def _take_picture(self, context: Context, state: DiscreteValues) -> None:
        count = int(context.get_discrete_state(self._count).value()[0])
        state.set_value(self._count, [count + 1])
        self._see(context, state, count)

    def _see(self, context: Context, state: DiscreteValues, count: int) -> None:
        X_WB: RigidTransform = self._body_poses.Eval(context)[self._body]
        covered = bool(context.get_numeric_parameter(self._covered).value()[0])
        hidden = not np.isfinite(X_WB.GetAsMatrix34()).all() or X_WB.translation()[2] < self._lowest
        if covered or hidden:
            state.set_value(self._seen, np.full(3, np.nan))
            return
        q = project_pose(X_WB, float(context.get_discrete_state(self._yaw).value()[0]))
        state.set_value(self._yaw, [q[2]])
        seed = int(context.get_numeric_parameter(self._seed).value()[0])
        state.set_value(
            self._seen, q + self._std * np.random.default_rng((seed, count)).normal(size=3)
        )


def project_pose(X_WB: RigidTransform, near: float = 0.0) -> NDArray[np.float64]:
    """The pose in the plane, (3,) x, y in m and yaw in rad, by whole turns the one nearest to `near`."""
    yaw = RollPitchYaw(X_WB.rotation()).yaw_angle()
    yaw += 2 * np.pi * round((near - yaw) / (2 * np.pi))
    return np.array([*X_WB.translation()[:2], yaw])

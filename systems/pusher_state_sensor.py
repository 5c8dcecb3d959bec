"""Where the finger's tip is and how fast it moves, as the arm's joints tell."""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly


class PusherStateSensor(LeafSystem):
    """Position and velocity of a point of a body, from what a MultibodyPlant says of its bodies.

    .. pydrake_system::

        name: PusherStateSensor
        input_ports:
        - body_poses
        - body_spatial_velocities
        output_ports:
        - pusher_state

    * body_poses: abstract `list[RigidTransform]`, as a MultibodyPlant gives it.
    * body_spatial_velocities: abstract `list[SpatialVelocity]`, as a MultibodyPlant gives it.
    * pusher_state: vector of 6, the tip's center p_WP, m, and its velocity v_WP, m/s, in W.
    """

    __slots__ = NO_SLOTS

    def __init__(self, body: BodyIndex, p_BP: np.ndarray | None = None) -> None:
        """Makes the sensor.

        Args:
            body: index of the body among the plant's.
            p_BP: (3,) the point in the body's frame, m; its origin by default.
        """
        super().__init__()
        self._body = int(body)
        self._p_BP = np.zeros(3) if p_BP is None else np.array(p_BP, dtype=np.float64)
        self._body_poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        self._velocities = self.DeclareAbstractInputPort("body_spatial_velocities", Value[list[SpatialVelocity]]())
        self.DeclareVectorOutputPort(
            "pusher_state",
            6,
            weakly(self._calc_pusher_state),
            prerequisites_of_calc={self._body_poses.ticket(), self._velocities.ticket()},
        )

    def _calc_pusher_state(self, context: Context, output: BasicVector) -> None:
        X_WB: RigidTransform = self._body_poses.Eval(context)[self._body]
        V_WB: SpatialVelocity = self._velocities.Eval(context)[self._body]
        p_BP_W = X_WB.rotation() @ self._p_BP
        v_WP = V_WB.translational() + np.cross(V_WB.rotational(), p_BP_W)
        output.SetFromVector(np.concatenate([X_WB.translation() + p_BP_W, v_WP]))

"""Where the finger's tip is, how fast it moves and what presses on it, as the arm's joints tell."""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, JacobianWrtVariable
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
        self._body_poses = self.DeclareAbstractInputPort(
            "body_poses", Value[list[RigidTransform]]()
        )
        self._velocities = self.DeclareAbstractInputPort(
            "body_spatial_velocities", Value[list[SpatialVelocity]]()
        )
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


class ArmTipSensor(LeafSystem):
    """Position, velocity and load of the finger's tip of an arm that is not simulated, from its joints.

    .. pydrake_system::

        name: ArmTipSensor
        input_ports:
        - position_measured
        - velocity_estimated
        - torque_external
        output_ports:
        - pusher_state
        - force

    * position_measured: vector of n, the joints' angles, rad.
    * velocity_estimated: vector of n, their velocities, rad/s.
    * torque_external: vector of n, on the joints from outside, N m.
    * pusher_state: vector of 6, the tip's center p_WP, m, and its velocity v_WP, m/s, in W.
    * force: vector of 3, on the tip, in W, N: the one that says most of the torques, by least
      squares of J^T f = tau with the Jacobian J of the tip's velocity. What the joints cannot feel
      is 0 in it.
    """

    __slots__ = NO_SLOTS

    def __init__(self, control_plant: MultibodyPlant, tip_frame: str) -> None:
        """Makes the sensor.

        Args:
            control_plant: the robot alone, with n positions.
            tip_frame: name of the tip's frame in it.
        """
        super().__init__()
        self._plant, self._tip_frame = control_plant, tip_frame
        self._plant_context = control_plant.CreateDefaultContext()
        self._q = self.DeclareVectorInputPort("position_measured", control_plant.num_positions())
        self._v = self.DeclareVectorInputPort("velocity_estimated", control_plant.num_velocities())
        self._torque = self.DeclareVectorInputPort(
            "torque_external", control_plant.num_velocities()
        )
        self.DeclareVectorOutputPort(
            "pusher_state", 6, weakly(self._calc_pusher_state), {self._q.ticket(), self._v.ticket()}
        )
        self.DeclareVectorOutputPort(
            "force", 3, weakly(self._calc_force), {self._q.ticket(), self._torque.ticket()}
        )

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        plant, scratch = self._plant, self._plant_context
        plant.SetPositions(scratch, self._q.Eval(context))
        tip, world = plant.GetFrameByName(self._tip_frame), plant.world_frame()
        J = plant.CalcJacobianTranslationalVelocity(
            scratch, JacobianWrtVariable.kV, tip, np.zeros(3), world, world
        )
        torque = self._torque.Eval(context)
        finite = np.isfinite(torque).all() and np.isfinite(J).all()
        output.SetFromVector(np.linalg.lstsq(J.T, torque)[0] if finite else np.full(3, np.nan))

    def _calc_pusher_state(self, context: Context, output: BasicVector) -> None:
        plant, scratch = self._plant, self._plant_context
        plant.SetPositions(scratch, self._q.Eval(context))
        plant.SetVelocities(scratch, self._v.Eval(context))
        tip = plant.GetFrameByName(self._tip_frame)
        v_WP = tip.CalcSpatialVelocityInWorld(scratch).translational()
        output.SetFromVector(np.concatenate([tip.CalcPoseInWorld(scratch).translation(), v_WP]))

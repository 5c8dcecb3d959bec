"""Sensors of the finger's tip: its position, its velocity, and the force on it.

`PusherStateSensor` reads a simulated plant, `ArmTipSensor` the measured joints of an arm.
"""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, JacobianWrtVariable
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from gridpush_drake.multibody.tool_motion import calc_tool_pose
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly


class PusherStateSensor(LeafSystem):
    """Measures position and velocity of a point of a body in a MultibodyPlant.

    .. pydrake_system::

        name: PusherStateSensor
        input_ports:
        - body_poses
        - body_spatial_velocities
        output_ports:
        - pusher_state
        - pusher_yaw

    * body_poses: abstract `list[RigidTransform]`, X_WB of all bodies, as a MultibodyPlant has it.
    * body_spatial_velocities: abstract `list[SpatialVelocity]`, V_WB of all bodies, as a
      MultibodyPlant has it.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity v_WP, m/s.
    * pusher_yaw: vector of 1, angle by which the tool is turned about the vertical, rad.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        body: BodyIndex,
        p_BP: np.ndarray | None = None,
        R_BP: RotationMatrix | None = None,
    ) -> None:
        """Makes the sensor.

        Args:
            body: index of the body in the plant.
            p_BP: (3,) position of the point in the body's frame, m; the origin by default.
            R_BP: rotation of the tool's frame in the body's frame; identity by default.
        """
        super().__init__()
        self._body = int(body)
        self._p_BP = np.zeros(3) if p_BP is None else np.array(p_BP, dtype=np.float64)
        self._R_BP = R_BP or RotationMatrix()
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
        self.DeclareVectorOutputPort(
            "pusher_yaw", 1, weakly(self._calc_yaw), {self._body_poses.ticket()}
        )

    def _calc_pusher_state(self, context: Context, output: BasicVector) -> None:
        X_WB: RigidTransform = self._body_poses.Eval(context)[self._body]
        V_WB: SpatialVelocity = self._velocities.Eval(context)[self._body]
        p_BP_W = X_WB.rotation() @ self._p_BP
        v_WP = V_WB.translational() + np.cross(V_WB.rotational(), p_BP_W)
        output.SetFromVector(np.concatenate([X_WB.translation() + p_BP_W, v_WP]))

    def _calc_yaw(self, context: Context, output: BasicVector) -> None:
        X_WB: RigidTransform = self._body_poses.Eval(context)[self._body]
        output.SetFromVector([calc_tool_pose(X_WB @ RigidTransform(self._R_BP, np.zeros(3)))[3]])


class ArmTipSensor(LeafSystem):
    """Calculates position, velocity and load of the finger's tip from an arm's measured joints.

    .. pydrake_system::

        name: ArmTipSensor
        input_ports:
        - position_measured
        - velocity_estimated
        - torque_external
        output_ports:
        - pusher_state
        - pusher_yaw
        - force

    * position_measured: vector of n, angles of the joints, rad.
    * velocity_estimated: vector of n, velocities of the joints, rad/s.
    * torque_external: vector of n, torques on the joints from outside, N m.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity v_WP, m/s.
    * pusher_yaw: vector of 1, angle by which the tool is turned about the vertical, rad.
    * force: vector of 3, force f on the tip in W, N, that explains the torques tau best: the least
      squares solution of J^T f = tau, with the Jacobian J of the tip's velocity. Its component in a
      direction that the joints cannot feel is 0. NaN if the torques are not finite.
    """

    __slots__ = NO_SLOTS

    def __init__(self, control_plant: MultibodyPlant, tip_frame: str) -> None:
        """Makes the sensor.

        Args:
            control_plant: the robot alone, with n positions.
            tip_frame: name of the tip's frame in that plant.
        """
        super().__init__()
        self._plant = control_plant
        self._tip_frame = tip_frame
        # Used within a calculation only, so that it holds no state between two of them.
        self._plant_context = control_plant.CreateDefaultContext()
        self._q = self.DeclareVectorInputPort("position_measured", control_plant.num_positions())
        self._v = self.DeclareVectorInputPort("velocity_estimated", control_plant.num_velocities())
        self._torque = self.DeclareVectorInputPort(
            "torque_external", control_plant.num_velocities()
        )
        self.DeclareVectorOutputPort(
            "pusher_state", 6, weakly(self._calc_pusher_state), {self._q.ticket(), self._v.ticket()}
        )
        self.DeclareVectorOutputPort("pusher_yaw", 1, weakly(self._calc_yaw), {self._q.ticket()})
        self.DeclareVectorOutputPort(
            "force", 3, weakly(self._calc_force), {self._q.ticket(), self._torque.ticket()}
        )

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        plant = self._plant
        scratch = self._plant_context
        plant.SetPositions(scratch, self._q.Eval(context))
        tip = plant.GetFrameByName(self._tip_frame)
        world = plant.world_frame()
        J = plant.CalcJacobianTranslationalVelocity(
            scratch, JacobianWrtVariable.kV, tip, np.zeros(3), world, world
        )
        torque = self._torque.Eval(context)
        force = np.full(3, np.nan)
        if np.isfinite(torque).all() and np.isfinite(J).all():
            force = np.linalg.lstsq(J.T, torque)[0]
        output.SetFromVector(force)

    def _calc_pusher_state(self, context: Context, output: BasicVector) -> None:
        plant = self._plant
        scratch = self._plant_context
        plant.SetPositions(scratch, self._q.Eval(context))
        plant.SetVelocities(scratch, self._v.Eval(context))
        tip = plant.GetFrameByName(self._tip_frame)
        v_WP = tip.CalcSpatialVelocityInWorld(scratch).translational()
        output.SetFromVector(np.concatenate([tip.CalcPoseInWorld(scratch).translation(), v_WP]))

    def _calc_yaw(self, context: Context, output: BasicVector) -> None:
        self._plant.SetPositions(self._plant_context, self._q.Eval(context))
        tip = self._plant.GetFrameByName(self._tip_frame)
        output.SetFromVector([calc_tool_pose(tip.CalcPoseInWorld(self._plant_context))[3]])

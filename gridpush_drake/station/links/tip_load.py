"""`TipLoad`: a force on an arm's tool as torques on its joints, and the other way round.

Some arms say which torques act on their joints from outside (iiwa, Panda). Others have a sensor of
force and torque at the flange, or estimate the force on it (UR, xArm). The guard reads torques.
With the Jacobian J of the flange, force f and torque t on it are torques

    tau = J_angular^T t + J_linear^T f

on the joints, which is exact where nothing but the tool is touched.
"""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.station.robot.robot import Robot

FRAME_ORIGIN = np.zeros(3)


class TipLoad:
    """Converts between a wrench on the flange and torques on the joints."""

    def __init__(self, control_plant: MultibodyPlant, robot: Robot) -> None:
        """Takes the plant that `MakeControlPlant` makes of a robot."""
        self._plant = control_plant
        self._context = control_plant.CreateDefaultContext()
        self._flange = control_plant.GetFrameByName(robot.arm.flange_frame)
        self._tip = control_plant.GetFrameByName(robot.finger.tip_frame)

    def calc_torque(self, q: ArrayLike, force: ArrayLike, torque: ArrayLike) -> Array:
        """Torques (n,) on the joints, N m, of a wrench of the world on the flange.

        Args:
            q: (n,) positions of the joints, rad.
            force: (3,) on the flange, in the flange's frame, N.
            torque: (3,) about the flange's origin, in the flange's frame, N m.
        """
        self._plant.SetPositions(self._context, np.asarray(q, float))
        world = self._plant.world_frame()
        J = self._plant.CalcJacobianSpatialVelocity(
            self._context, JacobianWrtVariable.kV, self._flange, FRAME_ORIGIN, world, self._flange
        )
        wrench = np.concatenate([np.asarray(torque, float), np.asarray(force, float)])
        return np.asarray(J.T @ wrench)

    def calc_wrench(self, q: ArrayLike, torque: ArrayLike) -> tuple[Array, Array]:
        """What a sensor at the flange feels of the force on the finger's tip.

        Args:
            q: (n,) positions of the joints, rad.
            torque: (n,) on the joints from outside, N m.

        Returns:
            Force (3,), N, and torque (3,), N m, in the flange's frame: those of the force on the
            tip that says most of the torques, by least squares, as `ArmTipSensor` has it.
        """
        self._plant.SetPositions(self._context, np.asarray(q, float))
        world = self._plant.world_frame()
        J = self._plant.CalcJacobianTranslationalVelocity(
            self._context, JacobianWrtVariable.kV, self._tip, FRAME_ORIGIN, world, self._flange
        )
        force = np.linalg.lstsq(J.T, np.asarray(torque, float))[0]
        p_FP = self._tip.CalcPose(self._context, self._flange).translation()
        return force, np.cross(p_FP, force)

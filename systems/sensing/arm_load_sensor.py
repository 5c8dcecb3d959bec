"""`ArmLoadSensor`: what an arm feels at its fingertip and in its gripper, by its joints."""

from dataclasses import dataclass
from math import exp

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.weak_calc import NO_SLOTS

DEFAULT_PERIOD = 0.005
"""Time between two samples, s: that of the iiwa's messages."""

FORCE_ENTRIES = slice(0, 3)
"""Where the force on the tip stands in the noise of a sample."""

GRASP_TORQUE = slice(3, 6)
"""Where the torque about the grasp point stands in it."""

GRASP_FORCE = slice(6, 9)
"""Where the force between the pads stands in it."""

SAMPLE_SIZE = 9
"""Number of values in a sample."""

SMOOTHING_TIME = 0.03
"""Time over which the smooth force is averaged, s: about that between two poses of the camera,
with which it is written down."""

FRAME_ORIGIN = np.zeros(3)
"""Origin of a frame in that frame, m."""


@dataclass(frozen=True)
class LoadNoise:
    """How wrong an arm tells forces, as standard deviations; all are 0 for an arm that is real.

    Attributes:
        force: of each sample of a force, per axis, N.
        torque: of each sample of a torque about the grasp point, per axis, N m.
        force_offset: of a force's offset, which stays the same for a run, per axis, N.
        torque_offset: of a torque's offset, per axis, N m.
    """

    force: float = 0.0
    torque: float = 0.0
    force_offset: float = 0.0
    torque_offset: float = 0.0

    @property
    def sample_std(self) -> Array:
        """(9,) standard deviations of a sample's values."""
        return np.repeat([self.force, self.torque, self.force], 3)

    @property
    def offset_std(self) -> Array:
        """(9,) standard deviations of the offsets of these values."""
        return np.repeat([self.force_offset, self.torque_offset, self.force_offset], 3)


class ArmLoadSensor(LeafSystem):
    """Samples the force on the fingertip and the load in the gripper, told by external torques.

    .. pydrake_system::

        name: ArmLoadSensor
        input_ports:
        - position_measured
        - torque_external
        output_ports:
        - tip_force
        - smooth_tip_force
        - grasp_wrench

    * position_measured: vector of n, angles of the joints, rad.
    * torque_external: vector of n, torques on the joints from outside, N m.
    * tip_force: vector of 3, the force f on the tip in W, N, that explains the torques tau best if
      nothing but the tip is touched: the least squares solution of J^T f = tau.
    * smooth_tip_force: vector of 3, a running average of `tip_force`, N, for readers that take few
      samples: with the period h, a sample x changes it by (1 - exp(-h / SMOOTHING_TIME)) (x -
      smooth). It begins anew after a sample that is not finite.
    * grasp_wrench: vector of 6, torque about the grasp point, N m, above force, N, on the gripper
      in W, which explain the torques best if nothing but the gripper is touched. NaN without a
      gripper, and if the arm has fewer than six joints.

    All are NaN if the torques are not finite. Noise and offsets are added.

    Discrete state: the twelve values on the ports, and the number of samples so far. The noise of
    the k-th sample, and the offsets, depend only on k and the seed, which is numeric parameter 0.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        control_plant: MultibodyPlant,
        tip_frame: str,
        grasp_frame: str | None = None,
        *,
        noise: LoadNoise | None = None,
        period: float = DEFAULT_PERIOD,
        seed: int = 0,
    ) -> None:
        """Makes the sensor.

        Args:
            control_plant: the robot alone, with n positions.
            tip_frame: name of the tip's frame in that plant.
            grasp_frame: name of the frame whose origin is the grasp point; None without a gripper.
            noise: of what is told.
            period: time between two samples, s.
            seed: seed of noise and offsets.
        """
        super().__init__()
        self._plant = control_plant
        self._tip_frame = tip_frame
        self._grasp_frame = grasp_frame
        self._noise = noise or LoadNoise()
        # Used within a calculation only, so that it holds no state between two of them.
        self._plant_context = control_plant.CreateDefaultContext()
        self._fraction = 1 - exp(-period / SMOOTHING_TIME)
        self._seed = self.DeclareNumericParameter(BasicVector([float(seed)]))
        self._q = self.DeclareVectorInputPort("position_measured", control_plant.num_positions())
        self._torque = self.DeclareVectorInputPort(
            "torque_external", control_plant.num_velocities()
        )
        self._force_on_port = self.DeclareDiscreteState(3)
        self._smooth_on_port = self.DeclareDiscreteState([np.nan] * 3)
        self._wrench_on_port = self.DeclareDiscreteState(6)
        self._count = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("tip_force", self._force_on_port)
        self.DeclareStateOutputPort("smooth_tip_force", self._smooth_on_port)
        self.DeclareStateOutputPort("grasp_wrench", self._wrench_on_port)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)

    def SetSeed(self, root_context: Context, seed: int) -> None:
        """Sets the seed of noise and offsets in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(self._seed).SetFromVector([float(seed)])

    def _sample(self, context: Context, state: DiscreteValues) -> None:
        """Takes the next sample."""
        count = int(context.get_discrete_state(self._count).value()[0])
        seed = int(context.get_numeric_parameter(self._seed).value()[0])
        # The offsets are the same in every sample, the noise is not.
        offset = np.random.default_rng((seed, 0)).normal(size=SAMPLE_SIZE)
        noise = np.random.default_rng((seed, 1, count)).normal(size=SAMPLE_SIZE)
        error = self._noise.offset_std * offset + self._noise.sample_std * noise
        # J^T f = tau at the tip, and J^T w = tau at the grasp point.
        q = self._q.Eval(context)
        torque = self._torque.Eval(context)
        force = np.full(3, np.nan)
        wrench = np.full(6, np.nan)
        if np.isfinite(q).all() and np.isfinite(torque).all():
            self._plant.SetPositions(self._plant_context, q)
            force = np.linalg.lstsq(self._calc_jacobian(self._tip_frame)[3:].T, torque)[0]
            if self._grasp_frame is not None and len(torque) >= len(wrench):
                wrench = np.linalg.lstsq(self._calc_jacobian(self._grasp_frame).T, torque)[0]
        measured = force + error[FORCE_ENTRIES]
        state.set_value(self._force_on_port, measured)
        state.set_value(self._smooth_on_port, self._smooth(context, measured))
        state.set_value(
            self._wrench_on_port,
            wrench + np.concatenate([error[GRASP_TORQUE], error[GRASP_FORCE]]),
        )
        state.set_value(self._count, [count + 1])

    def _smooth(self, context: Context, measured: Array) -> Array:
        """Calculates the running average after one more force (3,)."""
        before = context.get_discrete_state(self._smooth_on_port).value()
        if not np.isfinite(before).all():
            return measured
        return np.asarray(before + self._fraction * (measured - before))

    def _calc_jacobian(self, frame: str) -> Array:
        """Calculates the Jacobian (6, n) of a frame's spatial velocity in W, at the scratch's q."""
        world = self._plant.world_frame()
        return np.asarray(
            self._plant.CalcJacobianSpatialVelocity(
                self._plant_context,
                JacobianWrtVariable.kV,
                self._plant.GetFrameByName(frame),
                FRAME_ORIGIN,
                world,
                world,
            )
        )

"""How the arm comes to a posture, whether it can follow a path, and what moves it along one.

Posture: of all in which the finger's tip is somewhere, the one that is nearest to the nominal posture. With q the joint
angles, J(q) the tip's Jacobian (rotation above translation) and e the pose's error, one step of

    dq = J+ e + (I - J+ J)(q_nominal - q)

moves the tip where it should be and, in the null space, as near to q_nominal as possible. Drake's differential inverse
kinematics with joint centering, which moves the arm by way of its iiwa driver (it drives any arm), has the same fixed
point: what is found here is what the moving arm does. The tool points down; its turn about the vertical (yaw) is zero
at `R_WP_DOWN`.

Path: followed in steps before the arm goes. Measured on 30 pushes' paths, of which 19 can be followed: this search
takes 8 ms a path; Drake's differential inverse kinematics in its place 11 ms, and takes joints at their limits for
arrived (7 paths of 10 instead of 6); Drake's `InverseKinematics` by SNOPT 510 ms, and misses a quarter of the postures.
"""

from dataclasses import dataclass
from threading import RLock

import numpy as np
from numpy.typing import ArrayLike
from pydrake.manipulation import IiwaDriver, SimIiwaDriver
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsIntegrator,
    DifferentialInverseKinematicsParameters,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, ModelInstanceIndex
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, System
from pydrake.systems.primitives import SharedPointerSystem

from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.tool_motion import R_WP_DOWN, TURNING_RADIUS, calc_tool_rotation
from gridpush_drake.station.robot import AddRobot, ControlMeasures, Robot

POSITION_TOLERANCE = 1e-6
"""m and rad, of a pose that counts as reached."""

CENTERING_TOLERANCE = 1e-6
"""rad, of the last step."""

MAX_STEPS = 200
"""Of the search for one posture from another that may be far off."""


class ArmPosture:
    """The tip's kinematics and their inverse.

    Attributes:
        lower: (7,) joint limits, rad.
        upper: likewise.
        speed: (7,) rad/s.
    """

    def __init__(self, control_plant: MultibodyPlant, robot: Robot):
        """Takes the plant that `MakeControlPlant` makes of a robot."""
        self._plant = control_plant
        self._context = control_plant.CreateDefaultContext()
        self._lock = RLock()  # of the Context: planning may go on beside the Diagram (`systems.worker`)
        self._tip, self._world = control_plant.GetFrameByName(robot.finger.tip_frame), control_plant.world_frame()
        self.lower, self.upper = control_plant.GetPositionLowerLimits(), control_plant.GetPositionUpperLimits()
        self.speed = control_plant.GetVelocityUpperLimits()

    def calc_tip_pose(self, q: Array) -> RigidTransform:
        """X_WP of the tip's frame at the joint angles q (7,), rad."""
        with self._lock:
            self._plant.SetPositions(self._context, q)
            return self._tip.CalcPoseInWorld(self._context)

    def calc_step(
        self, q: Array, p_WP: Array, q_nominal: Array, R_WP: RotationMatrix = R_WP_DOWN
    ) -> tuple[Array, float]:
        """One step towards the tool pointing down with its tip at p_WP.

        Args:
            q: (7,) rad.
            p_WP: (3,) m.
            q_nominal: (7,) rad.
            R_WP: of the tool, see `calc_tool_rotation`.

        Returns:
            dq (7,), rad, and the error's norm before the step, m and rad.
        """
        with self._lock:
            X_WP = self.calc_tip_pose(q)
            J = self._plant.CalcJacobianSpatialVelocity(
                self._context, JacobianWrtVariable.kV, self._tip, np.zeros(3), self._world, self._world
            )
        e = np.concatenate([_calc_rotation_error(X_WP.rotation().matrix(), R_WP.matrix()), p_WP - X_WP.translation()])
        J_plus = np.linalg.pinv(J)
        away = q_nominal - q
        return J_plus @ e + away - J_plus @ (J @ away), float(np.linalg.norm(e))

    def solve(self, p_WP: ArrayLike, q_nominal: Array, q_seed: Array) -> Array | None:
        """Finds the posture with the tool down and its tip at p_WP.

        Args:
            p_WP: (3,) m.
            q_nominal: (7,) posture to stay near to, rad.
            q_seed: (7,) where the search begins, rad.

        Returns:
            (7,) rad, or None where the search does not arrive. Joint limits are not looked at.
        """
        q, target = q_seed, np.asarray(p_WP, float)
        for _ in range(MAX_STEPS):
            dq, error = self.calc_step(q, target, q_nominal)
            q = q + dq
            if error < POSITION_TOLERANCE and np.abs(dq).max() < CENTERING_TOLERANCE:
                return q
            if not np.abs(q).max() < 2.0 * np.pi:
                return None
        return None


def CalcStartPosture(control_plant: MultibodyPlant, robot: Robot, p_WP: ArrayLike) -> Array:
    """Calculates the posture in which the tool points down with its tip at p_WP.

    Args:
        control_plant: as `MakeControlPlant` makes it.
        robot: the robot; the search begins at its `posture`.
        p_WP: (3,) m.

    Returns:
        (7,) rad.

    Raises:
        StationError: there is none within the joint limits.
    """
    posture, seed = ArmPosture(control_plant, robot), np.array(robot.arm.posture)
    q = posture.solve(p_WP, seed, seed)
    if q is None or (q < posture.lower).any() or (q > posture.upper).any():
        where = np.round(np.asarray(p_WP, float), 3).tolist()
        raise StationError(f"tip at {where} m: the arm does not reach it with the finger down")
    return q


def _calc_rotation_error(R_WP: Array, R_wanted: Array) -> Array:
    """(3,) rotation vector in W that turns R_WP into the wanted one, for small angles exact to second order, rad."""
    R = R_wanted @ R_WP.T
    sine = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    length = np.linalg.norm(sine)
    angle = np.arctan2(length, (np.trace(R) - 1.0) / 2.0)
    return sine if length < np.finfo(float).eps else angle / length * sine


STEP = 0.02
"""m along the path, between the postures searched."""

STEPS_PER_POSTURE = 8
"""Newton's, at most, from one posture to the next; three or four are enough where the arm is not stretched."""

ARRIVED = 1e-5
"""m and rad, of a posture that is reached."""


class ArmReach:
    """Leads the arm along a path in steps and says what stops it.

    It is what a `PushExecutor` and a `GraspExecutor` take as `reach`. The postures are those of `ArmPosture`, to which
    the moving arm is drawn.
    """

    def __init__(
        self,
        control_plant: MultibodyPlant,
        robot: Robot,
        q_nominal: ArrayLike,
    ):
        """Makes the question.

        Args:
            control_plant: as `MakeControlPlant` makes it.
            robot: the robot; its `control` says how far paths keep from the joints' limits.
            q_nominal: (7,) the posture that the arm is drawn to, rad.
        """
        self._posture = ArmPosture(control_plant, robot)
        margin, share = robot.arm.control.path_limit_margin, robot.arm.control.path_speed_share
        self._nominal = np.array(q_nominal, float)
        self._p_WN = self._posture.calc_tip_pose(self._nominal).translation()
        self._lower, self._upper = self._posture.lower + margin, self._posture.upper - margin
        self._speed = share * self._posture.speed

    def __call__(self, path: ArrayLike, speeds: ArrayLike, yaws: ArrayLike | None = None) -> str | None:
        """None where the tip can go along `path`, else a sentence that says why not.

        Args:
            path: (k, 3) corners p_WP of the tip's path, m.
            speeds: (k - 1,) greatest on its pieces, m/s; of the path that `tool_motion` measures where the tool turns.
            yaws: (k,) of the tool at the corners, rad; None where it does not turn.
        """
        corners = np.array(path, float)
        turns = np.zeros(len(corners)) if yaws is None else np.asarray(yaws, float)
        corners = np.column_stack([corners, turns])
        q, reason = self._follow(self._nominal, np.append(self._p_WN, 0.0), corners[0], None)
        for start, end, speed in zip(corners[:-1], corners[1:], np.asarray(speeds, float), strict=True):
            if reason is not None:
                break
            q, reason = self._follow(q, start, end, float(speed))
        return reason

    def _follow(self, q: Array, start: Array, end: Array, speed: float | None) -> tuple[Array, str | None]:
        """Leads the arm from posture q, tip and yaw at `start` (4,), to `end`; returns its last posture and stop."""
        turn = float(end[3] - start[3])
        length = float(np.hypot(np.linalg.norm(end[:3] - start[:3]), TURNING_RADIUS * turn))
        count = int(np.ceil(length / STEP))
        for i in range(1, count + 1):
            p_WP = start[:3] + (end[:3] - start[:3]) * (i / count)
            R_WP = calc_tool_rotation(float(start[3]) + turn * (i / count))
            before, where = q, "({:.2f}, {:.2f}, {:.2f}) m".format(*p_WP)
            for _ in range(STEPS_PER_POSTURE):
                dq, error = self._posture.calc_step(q, p_WP, self._nominal, R_WP)
                q = q + dq
                if error < ARRIVED:
                    break
            if not error < ARRIVED:
                return q, f"the arm does not reach {where}"
            stopped = np.flatnonzero((q < self._lower) | (q > self._upper))
            if stopped.size:
                return q, f"joint {stopped[0] + 1} of the arm would come to its limit at {where}"
            if speed is not None:
                share = np.abs(q - before) * speed * count / length / self._speed
                if share.max() > 1.0:
                    k = int(share.argmax())
                    needed = share[k] * self._speed[k]
                    return q, f"joint {k + 1} of the arm would have to turn at {needed:.2f} rad/s at {where}"
        return q, None


@dataclass(frozen=True)
class ArmControl:
    """What `AddArmControl` put into a builder.

    Attributes:
        driver: the `SimIiwaDriver`; its output ports are those of Drake's stations (`position_measured`, ...).
        kinematics: the differential inverse kinematics.
        tip_pose: the port for the tip's desired pose X_WP.
        q_start: (7,) the posture at the beginning, rad.
    """

    driver: System
    kinematics: DifferentialInverseKinematicsIntegrator
    tip_pose: InputPort
    q_start: Array


def MakeControlPlant(robot: Robot, X_WB: RigidTransform | None = None) -> MultibodyPlant:
    """Makes the plant that the controllers know: the robot, its gripper rigid, and nothing else.

    Args:
        robot: the robot.
        X_WB: of its base; identity by default.
    """
    plant = MultibodyPlant(time_step=0.0)
    AddRobot(plant, robot, X_WB)
    plant.Finalize()
    plant.set_name("control_plant")
    return plant


def AddArmControl(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    robot: Robot,
    arm: ModelInstanceIndex,
    control_plant: MultibodyPlant,
    q_start: ArrayLike,
) -> ArmControl:
    """Adds the arm's driver and inverse kinematics. Call it after Finalize.

    The builder keeps the control plant alive.

    Args:
        builder: the plant is in it.
        plant: has the arm.
        robot: the robot.
        arm: its arm's model instance.
        control_plant: as `MakeControlPlant` makes it.
        q_start: (n,) the posture at the beginning, which is also the one that the arm is drawn to, rad.

    Returns:
        The systems and the port to be connected.
    """
    SharedPointerSystem.AddToBuilder(builder, control_plant)
    control = robot.arm.control
    q = np.array(q_start, float)
    plant.SetDefaultPositions(arm, q)
    gains = np.full(plant.num_positions(arm), control.stiffness)
    config = IiwaDriver(control_mode="position_only", desired_kp_gains=gains)
    driver = SimIiwaDriver.AddToBuilder(builder, plant, arm, config, control_plant)
    kinematics = builder.AddNamedSystem(
        "iiwa_kinematics",
        DifferentialInverseKinematicsIntegrator(
            control_plant,
            control_plant.GetFrameByName(robot.finger.tip_frame),
            control.period,
            _make_parameters(control_plant, q, control),
        ),
    )
    builder.Connect(kinematics.GetOutputPort("joint_positions"), driver.GetInputPort("position"))
    return ArmControl(driver, kinematics, kinematics.GetInputPort("X_AE_desired"), q)


def SetArmStart(
    diagram: Diagram, root_context: Context, plant: MultibodyPlant, arm: ModelInstanceIndex, control: ArmControl
) -> None:
    """Puts arm and inverse kinematics into the start's posture, at rest.

    Call it on every fresh or reset context: the integrator's own default is zero.
    """
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    plant.SetPositions(plant_context, arm, control.q_start)
    plant.SetVelocities(plant_context, arm, np.zeros_like(control.q_start))
    control.kinematics.SetPositions(control.kinematics.GetMyMutableContextFromRoot(root_context), control.q_start)


def _make_parameters(
    control_plant: MultibodyPlant, q_nominal: Array, control: ControlMeasures
) -> DifferentialInverseKinematicsParameters:
    """Limits and centering of the inverse kinematics."""
    n = control_plant.num_positions()
    parameters = DifferentialInverseKinematicsParameters(n, n)
    parameters.set_nominal_joint_position(q_nominal)
    parameters.set_joint_centering_gain(control.centering_gain * np.eye(n))
    lower, upper = control_plant.GetPositionLowerLimits(), control_plant.GetPositionUpperLimits()
    parameters.set_joint_position_limits((lower + control.limit_margin, upper - control.limit_margin))
    slowest, fastest = control_plant.GetVelocityLowerLimits(), control_plant.GetVelocityUpperLimits()
    parameters.set_joint_velocity_limits((slowest, fastest))
    return parameters

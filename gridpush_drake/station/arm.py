"""How the arm comes to a posture, whether it can follow a path, and what moves it along one.

Posture: of all in which the finger's tip is somewhere, the one that is nearest to the nominal
posture. With q the joint angles, J(q) the tip's Jacobian (rotation above translation) and e the
pose's error, one step of

    dq = J+ e + (I - J+ J)(q_nominal - q) = J+ (e - J (q_nominal - q)) + q_nominal - q

moves the tip where it should be and, in the null space, as near to q_nominal as possible. Drake's
differential inverse kinematics with joint centering, which moves the arm by way of its driver, has
the same fixed point: what is found here is what the moving arm does. The tool points down; its turn
about the vertical (yaw) is zero at `R_WP_DOWN`. An arm of fewer than six joints, such as a gantry,
need not be able to turn its tool, only to keep it pointing down.

Path: followed in steps before the arm goes. Measured on 30 pushes' paths, of which 19 can be
followed: this search takes 8 ms a path; Drake's differential inverse kinematics in its place 11 ms,
and takes joints at their limits for arrived (7 paths of 10 instead of 6); Drake's
`InverseKinematics` by SNOPT 510 ms, and misses a quarter of the postures.
"""

from functools import lru_cache
from threading import RLock

import numpy as np
import shapely
from numpy.typing import ArrayLike
from pydrake.manipulation import IiwaDriver, SimIiwaDriver
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsIntegrator,
    DifferentialInverseKinematicsParameters,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Frame,
    JacobianWrtVariable,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
)
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import (
    Demultiplexer,
    PassThrough,
    SharedPointerSystem,
    StateInterpolatorWithDiscreteDerivative,
)
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.tool_motion import R_WP_DOWN, TURNING_RADIUS, calc_tool_rotation
from gridpush_drake.station.robot import AddRobot, Robot

POSITION_TOLERANCE = 1e-6
"""m and rad, of a pose that counts as reached."""

CENTERING_TOLERANCE = 1e-6
"""rad, of the last step."""

SPATIAL = 6
"""Directions in which a body can turn and move."""

ROUND_OFF = 1e-6
"""Of a Jacobian's entry that is zero; a model's pi has eight digits or so."""

MAX_STEPS = 200
"""Of the search for one posture from another that may be far off."""


class ArmPosture:
    """The tip's kinematics and their inverse.

    Attributes:
        lower: (n,) joint limits, rad.
        upper: likewise.
        speed: (n,) rad/s.
    """

    def __init__(self, control_plant: MultibodyPlant, robot: Robot):
        """Takes the plant that `MakeControlPlant` makes of a robot."""
        self._plant = control_plant
        self._context = control_plant.CreateDefaultContext()
        self._lock = (
            RLock()
        )  # of the Context: planning may go on beside the Diagram (`systems.worker`)
        self._tip, self._world = (
            control_plant.GetFrameByName(robot.finger.tip_frame),
            control_plant.world_frame(),
        )
        self.lower, self.upper = (
            control_plant.GetPositionLowerLimits(),
            control_plant.GetPositionUpperLimits(),
        )
        self.speed = control_plant.GetVelocityUpperLimits()
        joints = (control_plant.get_joint(index) for index in control_plant.GetJointIndices())
        self._slides = {
            joint.position_start()
            for joint in joints
            if joint.type_name() == PrismaticJoint.kTypeName
        }

    def describe_speed(self, k: int, speed: float) -> str:
        """Says that joint k, counted from 0, would have to move at a speed, rad/s or m/s."""
        slides = k in self._slides
        return (
            f"joint {k + 1} of the arm would have to {'slide' if slides else 'turn'} at {speed:.2f} "
            + ("m/s" if slides else "rad/s")
        )

    def calc_tip_pose(self, q: Array) -> RigidTransform:
        """X_WP of the tip's frame at the joint angles q (n,), rad."""
        with self._lock:
            self._plant.SetPositions(self._context, q)
            return self._tip.CalcPoseInWorld(self._context)

    def calc_jacobian(self, q: Array) -> Array:
        """(6, n) of the tip's rotation and translation, in the tip's frame, at the joint positions q (n,)."""
        with self._lock:
            self.calc_tip_pose(q)
            return self._calc_jacobian(self._tip)

    def _calc_jacobian(self, frame: Frame) -> Array:
        return np.asarray(
            self._plant.CalcJacobianSpatialVelocity(
                self._context, JacobianWrtVariable.kV, self._tip, np.zeros(3), self._world, frame
            )
        )

    def calc_step(
        self, q: Array, p_WP: Array, q_nominal: Array, R_WP: RotationMatrix = R_WP_DOWN
    ) -> tuple[Array, float]:
        """One step towards the tool pointing down with its tip at p_WP.

        Args:
            q: (n,) rad.
            p_WP: (3,) m.
            q_nominal: (n,) rad.
            R_WP: of the tool, see `calc_tool_rotation`.

        Returns:
            dq (n,), rad, and the error's norm before the step, m and rad.
        """
        with self._lock:
            X_WP = self.calc_tip_pose(q)
            J = self._calc_jacobian(self._world)
        turn = (R_WP @ X_WP.rotation().inverse()).ToAngleAxis()
        e = np.concatenate([turn.angle() * turn.axis(), p_WP - X_WP.translation()])
        away = q_nominal - q
        return np.linalg.lstsq(J, e - J @ away)[0] + away, float(np.linalg.norm(e))

    def solve(self, p_WP: ArrayLike, q_nominal: Array, q_seed: Array) -> Array | None:
        """Finds the posture with the tool down and its tip at p_WP.

        Args:
            p_WP: (3,) m.
            q_nominal: (n,) posture to stay near to, rad.
            q_seed: (n,) where the search begins, rad.

        Returns:
            (n,) rad, or None where the search does not arrive. Joint limits are not looked at.
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
        (n,) rad.

    Raises:
        StationError: there is none within the joint limits.
    """
    posture, seed = ArmPosture(control_plant, robot), np.array(robot.arm.posture)
    q = posture.solve(p_WP, seed, seed)
    if q is None or (q < posture.lower).any() or (q > posture.upper).any():
        where = np.round(np.asarray(p_WP, float), 3).tolist()
        raise StationError(f"tip at {where} m: the arm does not reach it with the finger down")
    return q


STEP = 0.02
"""m along the path, between the postures searched."""

STEPS_PER_POSTURE = 8
"""Newton's, at most, from one posture to the next; three or four are enough where the arm is not
stretched."""

ARRIVED = 1e-5
"""m and rad, of a posture that is reached."""

LEADS = 1024
"""Straight pieces of paths whose postures are kept."""

REGION_STEP = 0.025
"""m, between places that are tried to find out how far an arm reaches."""


class ArmReach:
    """Leads the arm along a path in steps and says what stops it.

    It is what a `PushExecutor` and a `GraspExecutor` take as `reach`. The postures are those of
    `ArmPosture`, to which the moving arm is drawn.
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
            q_nominal: (n,) the posture that the arm is drawn to, rad.
        """
        self._posture = ArmPosture(control_plant, robot)
        margin, share = robot.arm.control.path_limit_margin, robot.arm.control.path_speed_share
        self._nominal = np.array(q_nominal, float)
        self._p_WN = self._posture.calc_tip_pose(self._nominal).translation()
        self._lower, self._upper = self._posture.lower + margin, self._posture.upper - margin
        self._speed = share * self._posture.speed
        self._lead = lru_cache(LEADS)(
            self._find_postures
        )  # a path is asked about at several speeds

    def __call__(
        self, path: ArrayLike, speeds: ArrayLike, yaws: ArrayLike | None = None
    ) -> str | None:
        """None where the tip can go along `path`, else a sentence that says why not.

        Args:
            path: (k, 3) corners p_WP of the tip's path, m.
            speeds: (k - 1,) greatest on its pieces, m/s; of the path that `tool_motion` measures
                where the tool turns.
            yaws: (k,) of the tool at the corners, rad; None where it does not turn.
        """
        corners = np.array(path, float)
        turns = np.zeros(len(corners)) if yaws is None else np.asarray(yaws, float)
        corners = np.column_stack([corners, turns])
        q, reason = self._follow(self._nominal, np.append(self._p_WN, 0.0), corners[0], None)
        for start, end, speed in zip(
            corners[:-1], corners[1:], np.asarray(speeds, float), strict=True
        ):
            if reason is not None:
                break
            q, reason = self._follow(q, start, end, float(speed))
        return reason

    def find_region(
        self, bounds: ArrayLike, height: float, step: float = REGION_STEP
    ) -> BaseGeometry:
        """Finds where the tip can be, led from the start's posture from place to place.

        Args:
            bounds: (4,) least x and y, greatest x and y, W, m.
            height: of the tip's center, z in W, m.
            step: between places, m.

        Returns:
            The squares of that side about the places that are reached, within the bounds, W, m; it
            may be empty.
        """
        x0, y0, x1, y1 = np.asarray(bounds, float).tolist()
        xs, ys = (np.arange(low + step / 2, high, step) for low, high in ((x0, x1), (y0, y1)))
        places = {
            (i, j): np.array([x, y, height, 0.0])
            for i, x in enumerate(xs)
            for j, y in enumerate(ys)
        }
        reached: dict[tuple[int, int], Array] = {}
        home = np.append(self._p_WN, 0.0)
        for first in sorted(places, key=lambda at: float(np.linalg.norm(places[at] - home))):
            q, reason = self._follow(self._nominal, home, places[first], None)
            if reason is None:
                reached[first] = q
                break
        front = list(reached)
        while front:
            i, j = at = front.pop(0)
            for near in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
                if near in places and near not in reached:
                    q, reason = self._follow(reached[at], places[at], places[near], None)
                    if reason is None:
                        reached[near] = q
                        front.append(near)
        squares = [
            shapely.Point(places[at][:2]).buffer(step / 2, cap_style="square") for at in reached
        ]
        return shapely.union_all(squares) & shapely.box(x0, y0, x1, y1)

    def _follow(
        self, q: Array, start: Array, end: Array, speed: float | None
    ) -> tuple[Array, str | None]:
        """Leads the arm from posture q, tip and yaw at `start` (4,), to `end`; returns its last posture and stop."""
        postures, reason = self._lead(tuple(q), tuple(start), tuple(end))
        if speed is not None and len(postures) > 1:
            length, count = _measure(start, end)
            shares = np.abs(np.diff(postures, axis=0)) * speed * count / length / self._speed
            too_fast = np.flatnonzero(shares.max(axis=1) > 1.0)
            if too_fast.size:
                i = int(too_fast[0])
                k = int(shares[i].argmax())
                where = _describe_place(start, end, (i + 1) / count)
                return postures[
                    i + 1
                ], f"{self._posture.describe_speed(k, shares[i, k] * self._speed[k])} at {where}"
        return postures[-1], reason

    def _find_postures(
        self, q: tuple[float, ...], start: tuple[float, ...], end: tuple[float, ...]
    ) -> tuple[Array, str | None]:
        """(k, n) the postures on the way, from q itself to the last within the limits, and what stops the arm."""
        first, last = np.array(start), np.array(end)
        count, postures = _measure(first, last)[1], [np.array(q)]
        for i in range(1, count + 1):
            *p_WP, yaw = first + (last - first) * (i / count)
            posture, target, R_WP = postures[-1], np.array(p_WP), calc_tool_rotation(float(yaw))
            for _ in range(STEPS_PER_POSTURE):
                dq, error = self._posture.calc_step(posture, target, self._nominal, R_WP)
                posture = posture + dq
                if error < ARRIVED:
                    break
            if not error < ARRIVED:
                return np.array(
                    postures
                ), f"the arm does not reach {_describe_place(first, last, i / count)}"
            stopped = np.flatnonzero((posture < self._lower) | (posture > self._upper))
            if stopped.size:
                where = _describe_place(first, last, i / count)
                return np.array(
                    postures
                ), f"joint {stopped[0] + 1} of the arm would come to its limit at {where}"
            postures.append(posture)
        return np.array(postures), None


def _measure(start: Array, end: Array) -> tuple[float, int]:
    """Length of a straight piece of a path, m, a turn counted at TURNING_RADIUS, and its number of steps."""
    length = float(
        np.hypot(np.linalg.norm(end[:3] - start[:3]), TURNING_RADIUS * (end[3] - start[3]))
    )
    return length, int(np.ceil(length / STEP))


def _describe_place(start: Array, end: Array, share: float) -> str:
    return "({:.2f}, {:.2f}, {:.2f}) m".format(*(start + (end - start) * share)[:3])


DRIVER_OUTPUTS = (
    "position_commanded",
    "position_measured",
    "velocity_estimated",
    "state_estimated",
    "torque_commanded",
    "torque_measured",
    "torque_external",
)
"""Ports of an arm's driver."""


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


def AddArmDriver(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    robot: Robot,
    arm: ModelInstanceIndex,
    control_plant: MultibodyPlant,
) -> System:
    """Adds what stands between the joint positions wanted and the joints, as the robot's measures say.

    Args:
        builder: the plant is in it; it keeps the control plant alive.
        plant: has the arm, on which `SetJointServos` was called; finalised.
        robot: the robot.
        arm: its arm's model instance.
        control_plant: as `MakeControlPlant` makes it.

    Returns:
        The driver; whichever it is, its output ports are those of Drake's `SimIiwaDriver`,
        `DRIVER_OUTPUTS`.
    """
    SharedPointerSystem.AddToBuilder(builder, control_plant)
    control = robot.arm.control
    if control.driver == "position":
        return _AddServoDriver(builder, plant, arm, control_plant, control.period)
    gains = _expand(control.stiffness, plant.num_positions(arm))
    config = IiwaDriver(control_mode="position_only", desired_kp_gains=gains)
    return SimIiwaDriver.AddToBuilder(builder, plant, arm, config, control_plant)


def AddArmKinematics(
    builder: DiagramBuilder, robot: Robot, control_plant: MultibodyPlant, q_nominal: Array
) -> DifferentialInverseKinematicsIntegrator:
    """Adds the inverse kinematics of the tip.

    Its Context begins at zero: on every fresh one call its `SetPositions`.

    Args:
        builder: to add it to.
        robot: the robot.
        control_plant: as `MakeControlPlant` makes it; it must outlive the builder's Diagram, see
            `AddArmDriver`.
        q_nominal: (n,) the posture that the arm is drawn to, rad.
    """
    kinematics: DifferentialInverseKinematicsIntegrator = builder.AddNamedSystem(
        f"{robot.arm_model}_kinematics",
        DifferentialInverseKinematicsIntegrator(
            control_plant,
            control_plant.GetFrameByName(robot.finger.tip_frame),
            robot.arm.control.period,
            _make_parameters(control_plant, q_nominal, robot),
        ),
    )
    return kinematics


def SetJointServos(plant: MultibodyPlant, robot: Robot, arm: ModelInstanceIndex) -> None:
    """Gives the joints of an arm whose driver is "position" their servos. Call it before Finalize."""
    control = robot.arm.control
    if control.driver != "position" or control.damping is None:
        return
    motors = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    motors = [motor for motor in motors if motor.model_instance() == arm]
    gains = (_expand(gain, len(motors)).tolist() for gain in (control.stiffness, control.damping))
    for motor, p, d in zip(motors, *gains, strict=True):
        motor.set_controller_gains(PdControllerGains(p=p, d=d))


def _expand(gains: tuple[float, ...], count: int) -> Array:
    """One for each joint, where one may stand for all."""
    return np.array(np.broadcast_to(gains, count), float)


def _AddServoDriver(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    arm: ModelInstanceIndex,
    control_plant: MultibodyPlant,
    period: float,
) -> Diagram:
    """Adds what asks the joints' servos for positions, and compensates gravity; connects it to the plant."""
    n, inner = plant.num_positions(arm), DiagramBuilder()
    wanted = inner.AddNamedSystem(
        "wanted", StateInterpolatorWithDiscreteDerivative(n, period, True)
    )
    gravity = InverseDynamics(
        control_plant, InverseDynamics.InverseDynamicsMode.kGravityCompensation
    )
    gravity = inner.AddNamedSystem("gravity", gravity)
    parts = inner.AddNamedSystem("parts", Demultiplexer([n, n]))
    passed = [
        inner.AddNamedSystem(f"passed_{k}", PassThrough(size))
        for k, size in enumerate((n, 2 * n, n, n))
    ]
    position, state, torque, external = passed
    inner.ExportInput(position.get_input_port(), "position")
    inner.ConnectInput("position", wanted.get_input_port())
    inner.ExportInput(state.get_input_port(), "state")
    for consumer in (gravity.get_input_port_estimated_state(), parts.get_input_port()):
        inner.ConnectInput("state", consumer)
    inner.ExportInput(torque.get_input_port(), "torque")
    inner.ExportInput(external.get_input_port(), "external")
    outputs = (
        position.get_output_port(), parts.get_output_port(0), parts.get_output_port(1), state.get_output_port(),
        torque.get_output_port(), torque.get_output_port(), external.get_output_port(),
    )  # fmt: skip
    for name, port in zip(DRIVER_OUTPUTS, outputs, strict=True):
        inner.ExportOutput(port, name)
    inner.ExportOutput(wanted.get_output_port(), "wanted_state")
    inner.ExportOutput(gravity.get_output_port(), "gravity_torque")
    driver: Diagram = builder.AddNamedSystem("servo_driver", inner.Build())
    for source, target in (
        (plant.get_state_output_port(arm), driver.GetInputPort("state")),
        (plant.get_net_actuation_output_port(arm), driver.GetInputPort("torque")),
        (plant.get_generalized_contact_forces_output_port(arm), driver.GetInputPort("external")),
        (driver.GetOutputPort("wanted_state"), plant.get_desired_state_input_port(arm)),
        (driver.GetOutputPort("gravity_torque"), plant.get_actuation_input_port(arm)),
    ):
        builder.Connect(source, target)
    return driver


def _make_parameters(
    control_plant: MultibodyPlant, q_nominal: Array, robot: Robot
) -> DifferentialInverseKinematicsParameters:
    """Limits and centering of the inverse kinematics, and what of the tool's motion the arm can choose."""
    n, control = control_plant.num_positions(), robot.arm.control
    parameters = DifferentialInverseKinematicsParameters(n, n)
    parameters.set_nominal_joint_position(q_nominal)
    parameters.set_joint_centering_gain(control.centering_gain * np.eye(n))
    lower, upper = control_plant.GetPositionLowerLimits(), control_plant.GetPositionUpperLimits()
    parameters.set_joint_position_limits(
        (lower + control.limit_margin, upper - control.limit_margin)
    )
    slowest, fastest = (
        control_plant.GetVelocityLowerLimits(),
        control_plant.GetVelocityUpperLimits(),
    )
    parameters.set_joint_velocity_limits((slowest, fastest))
    if n < SPATIAL:
        J = ArmPosture(control_plant, robot).calc_jacobian(q_nominal)
        parameters.set_end_effector_velocity_flag(np.abs(J).max(axis=1) > ROUND_OFF)
    return parameters

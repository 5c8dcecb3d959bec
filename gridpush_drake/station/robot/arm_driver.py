"""What moves an arm: its driver in the simulation, and the inverse kinematics before it.

The driver stands between desired joint positions and the joints. A simulated arm has either Drake's
`SimIiwaDriver` or, with `driver: position` in its robot.yaml, servos in its joints. The inverse
kinematics makes the joint positions of a pose of the finger's tip, for a real arm as well. Which
posture comes out is described in `station.robot.arm`.
"""

import numpy as np
from pydrake.manipulation import IiwaDriver, SimIiwaDriver
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsIntegrator,
    DifferentialInverseKinematicsParameters,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, PdControllerGains
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import (
    Demultiplexer,
    PassThrough,
    SharedPointerSystem,
    StateInterpolatorWithDiscreteDerivative,
)

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.station.robot.arm import ArmPosture
from gridpush_drake.station.robot.robot import Robot

SPATIAL_DIRECTIONS = 6
"""Number of directions in which a body can turn and move."""

ROUND_OFF = 1e-6
"""An entry of a Jacobian that is smaller than this counts as zero. Models give pi with about eight
digits, and what should be zero is of that order."""

DRIVER_OUTPUTS = (
    "position_commanded",
    "position_measured",
    "velocity_estimated",
    "state_estimated",
    "torque_commanded",
    "torque_measured",
    "torque_external",
)
"""Names of an arm driver's output ports, as Drake's `SimIiwaDriver` has them."""

STATUS_PORTS = {
    "position": "position_measured",
    "velocity": "velocity_estimated",
    "torque_external": "torque_external",
    "position_commanded": "position_commanded",
    "torque_commanded": "torque_commanded",
    "torque_measured": "torque_measured",
}
"""Names of those output ports of which an `ArmStatus` is made, by its fields."""


def AddArmDriver(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    robot: Robot,
    arm: ModelInstanceIndex,
    control_plant: MultibodyPlant,
) -> System:
    """Adds the driver that makes the joints of a simulated arm follow desired positions.

    Args:
        builder: the builder that has the plant; it also keeps the control plant alive.
        plant: the finalised plant with the arm. `SetJointServos` was called on it.
        robot: the robot; its `control.driver` says which driver it has.
        arm: the arm's model instance.
        control_plant: the robot alone, as `MakeControlPlant` makes it.

    Returns:
        The driver. Either kind has the input port `position` and the output ports
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
    """Adds Drake's differential inverse kinematics, from poses of the tip to joint positions.

    Its Context begins with all joints at zero: call its `SetPositions` on every fresh one.

    Args:
        builder: the builder to which it is added.
        robot: the robot.
        control_plant: the robot alone, as `MakeControlPlant` makes it. It must outlive the
            Diagram, see `AddArmDriver`.
        q_nominal: (n,) nominal posture to which the arm is drawn in its null space, rad.
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
    """Gives an arm's joints servos if its driver is "position". Call it before Finalize.

    Drake takes the gains of a joint's servo only before Finalize, unlike the rest of the driver.
    """
    control = robot.arm.control
    if control.driver != "position" or control.damping is None:
        return
    motors = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    motors = [motor for motor in motors if motor.model_instance() == arm]
    stiffness = _expand(control.stiffness, len(motors)).tolist()
    damping = _expand(control.damping, len(motors)).tolist()
    for motor, p, d in zip(motors, stiffness, damping, strict=True):
        motor.set_controller_gains(PdControllerGains(p=p, d=d))


def _expand(gains: tuple[float, ...], count: int) -> Array:
    """Returns gains (count,), one for each joint; a single gain stands for all joints."""
    return np.array(np.broadcast_to(gains, count), float)


def _AddServoDriver(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    arm: ModelInstanceIndex,
    control_plant: MultibodyPlant,
    period: float,
) -> Diagram:
    """Adds the driver of an arm whose joints have servos, and connects it to the plant."""
    driver: Diagram = builder.AddNamedSystem(
        "servo_driver", _BuildServoDriver(plant.num_positions(arm), control_plant, period)
    )
    builder.Connect(plant.get_state_output_port(arm), driver.GetInputPort("state"))
    builder.Connect(plant.get_net_actuation_output_port(arm), driver.GetInputPort("torque"))
    builder.Connect(
        plant.get_generalized_contact_forces_output_port(arm), driver.GetInputPort("external")
    )
    builder.Connect(driver.GetOutputPort("wanted_state"), plant.get_desired_state_input_port(arm))
    builder.Connect(driver.GetOutputPort("gravity_torque"), plant.get_actuation_input_port(arm))
    return driver


def _BuildServoDriver(n: int, control_plant: MultibodyPlant, period: float) -> Diagram:
    """Builds the driver of n joints that have servos; its input `position` comes every period, s.

    Its outputs are `DRIVER_OUTPUTS`, some of them inputs that are passed through, and what the
    plant needs: `wanted_state` of the servos and `gravity_torque`.
    """
    builder = DiagramBuilder()

    # A Diagram cannot export an input as an output: each input goes through a PassThrough.
    position = builder.AddNamedSystem("passed_position", PassThrough(n))
    state = builder.AddNamedSystem("passed_state", PassThrough(2 * n))
    torque = builder.AddNamedSystem("passed_torque", PassThrough(n))
    external = builder.AddNamedSystem("passed_external", PassThrough(n))
    builder.ExportInput(position.get_input_port(), "position")
    builder.ExportInput(state.get_input_port(), "state")
    builder.ExportInput(torque.get_input_port(), "torque")
    builder.ExportInput(external.get_input_port(), "external")

    # The servos want a velocity as well, and the weight of the arm is taken from them.
    wanted = builder.AddNamedSystem(
        "wanted", StateInterpolatorWithDiscreteDerivative(n, period, True)
    )
    gravity = builder.AddNamedSystem(
        "gravity",
        InverseDynamics(control_plant, InverseDynamics.InverseDynamicsMode.kGravityCompensation),
    )
    builder.ConnectInput("position", wanted.get_input_port())
    builder.ConnectInput("state", gravity.get_input_port_estimated_state())
    builder.ExportOutput(wanted.get_output_port(), "wanted_state")
    builder.ExportOutput(gravity.get_output_port(), "gravity_torque")

    # The ports that every driver has.
    halves = builder.AddNamedSystem("halves", Demultiplexer([n, n]))
    builder.ConnectInput("state", halves.get_input_port())
    outputs = {
        "position_commanded": position.get_output_port(),
        "position_measured": halves.get_output_port(0),
        "velocity_estimated": halves.get_output_port(1),
        "state_estimated": state.get_output_port(),
        "torque_commanded": torque.get_output_port(),
        "torque_measured": torque.get_output_port(),
        "torque_external": external.get_output_port(),
    }
    for name in DRIVER_OUTPUTS:
        builder.ExportOutput(outputs[name], name)
    return builder.Build()


def _make_parameters(
    control_plant: MultibodyPlant, q_nominal: Array, robot: Robot
) -> DifferentialInverseKinematicsParameters:
    """Makes the parameters of Drake's inverse kinematics from the robot's measures."""
    n = control_plant.num_positions()
    control = robot.arm.control
    parameters = DifferentialInverseKinematicsParameters(n, n)
    parameters.set_nominal_joint_position(q_nominal)
    parameters.set_joint_centering_gain(control.centering_gain * np.eye(n))
    lower = control_plant.GetPositionLowerLimits() + control.limit_margin
    upper = control_plant.GetPositionUpperLimits() - control.limit_margin
    parameters.set_joint_position_limits((lower, upper))
    parameters.set_joint_velocity_limits(
        (control_plant.GetVelocityLowerLimits(), control_plant.GetVelocityUpperLimits())
    )
    if n < SPATIAL_DIRECTIONS:
        # An arm of few joints moves its tool only in some of the six directions. Drake is told to
        # look at these alone; otherwise it would find no joint motion for any wanted velocity.
        J = ArmPosture(control_plant, robot).calc_jacobian(q_nominal)
        parameters.set_end_effector_velocity_flag(np.abs(J).max(axis=1) > ROUND_OFF)
    return parameters

"""What moves the arm: differential inverse kinematics before Drake's iiwa driver, which drives any arm.

`SetTipFriction` replaces the friction of the finger's tip after the model was parsed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import ProximityProperties, RoleAssign, SceneGraph
from pydrake.manipulation import IiwaDriver, SimIiwaDriver
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsIntegrator,
    DifferentialInverseKinematicsParameters,
)
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, System
from pydrake.systems.primitives import SharedPointerSystem

from gridpush_drake.errors import StationError
from gridpush_drake.station.robot import AddRobot, ControlMeasures, Robot

Array = NDArray[np.float64]


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


def MakeControlPlant(
    robot: Robot, X_WB: RigidTransform | None = None, gravity: ArrayLike | None = None
) -> MultibodyPlant:
    """Makes the plant that the controllers know: the robot, its gripper rigid, and nothing else.

    Args:
        robot: the robot.
        X_WB: of its base; identity by default.
        gravity: (3,) of the plant to be controlled, m/s²; Drake's by default.
    """
    plant = MultibodyPlant(time_step=0.0)
    AddRobot(plant, robot, X_WB)
    if gravity is not None:
        plant.mutable_gravity_field().set_gravity_vector(np.asarray(gravity, float))
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
    stiffness: float | None = None,
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
        stiffness: instead of the robot's own, 1/s².

    Returns:
        The systems and the port to be connected.
    """
    SharedPointerSystem.AddToBuilder(builder, control_plant)
    control = robot.arm.control
    q = np.array(q_start, float)
    plant.SetDefaultPositions(arm, q)
    gains = np.full(plant.num_positions(arm), stiffness or control.stiffness)
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


def SetTipFriction(
    plant: MultibodyPlant, scene_graph: SceneGraph, robot: Robot, finger: ModelInstanceIndex, friction: float
) -> None:
    """Gives the finger's tip a Coulomb friction. Call it before a Context is made.

    Drake combines two frictions a and b as 2 a b / (a + b): where both are mu, the contact has mu.

    Args:
        plant: has the finger.
        scene_graph: the plant's.
        robot: the robot.
        finger: its finger's model instance.
        friction: coefficient, static and dynamic.

    Raises:
        StationError: the coefficient is negative.
    """
    if not friction >= 0.0:
        raise StationError(f"friction of the tip is {friction!r}; expected a number of 0 or more")
    inspector, source = scene_graph.model_inspector(), plant.get_source_id()
    for geometry in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(robot.finger.tip_frame, finger)):
        properties = ProximityProperties(inspector.GetProximityProperties(geometry))
        properties.UpdateProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
        scene_graph.AssignRole(source, geometry, properties, RoleAssign.kReplace)

"""An iiwa with a finger, and what moves it: differential inverse kinematics before Drake's iiwa driver.

The friction of the finger's tip, replaced after the model was parsed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import ProximityProperties, RoleAssign, SceneGraph
from pydrake.manipulation import IiwaDriver, SimIiwaDriver
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsIntegrator,
    DifferentialInverseKinematicsParameters,
)
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, ModelInstanceIndex
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, System
from pydrake.systems.primitives import SharedPointerSystem

from gridpush_drake.errors import StationError
from gridpush_drake.multibody.parser import MakeParser
from gridpush_drake.station.arm_kinematics import TIP_FRAME

Array = NDArray[np.float64]

IIWA_URL = "package://gridpush_drake/iiwa/iiwa14_primitives.urdf"
"""The arm's model."""

FINGER_URL = "package://gridpush_drake/finger/finger.sdf"
"""The finger's model."""

BRACKET_URL = "package://gridpush_drake/gripper/bracket.sdf"
"""The bracket's model, that carries finger and gripper."""

GRIPPER_URL = "package://gridpush_drake/gripper/wsg_50.sdf"
"""The gripper's model."""

GRASP_FRAME = "grasp"
"""Name of the frame in the middle between the gripper's pads."""

BASE_FRAME = "iiwa_link_0"
"""Fixed to the world."""

FLANGE_FRAME = "iiwa_link_ee_kuka"
"""Carries the finger."""

TIP_RADIUS = 0.008
"""Of the sphere in the finger's model, m."""

CONTROL_PERIOD = 0.005
"""Of the inverse kinematics, s: the robot's own rate."""

CENTERING_GAIN = 10.0
"""Of the pull to the nominal posture in the null space, 1/s."""

STIFFNESS = 4000.0
"""Default kp of the driver, 1/s²."""

LIMIT_MARGIN = 0.02
"""Kept from the joints' limits by the inverse kinematics, rad."""


@dataclass(frozen=True)
class Arm:
    """What `AddIiwa` put into a plant.

    Attributes:
        iiwa: the arm's model instance.
        finger: the finger's.
        gripper: the gripper's; None where there is none.
    """

    iiwa: ModelInstanceIndex
    finger: ModelInstanceIndex
    gripper: ModelInstanceIndex | None = None


@dataclass(frozen=True)
class ArmControl:
    """What `AddIiwaControl` put into a builder.

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


def AddIiwa(plant: MultibodyPlant) -> Arm:
    """Adds the arm, fixed at the world's origin, with the finger on its flange. Call it before Finalize."""
    parser = MakeParser(plant)
    (iiwa,) = parser.AddModelsFromUrl(IIWA_URL)
    (finger,) = parser.AddModelsFromUrl(FINGER_URL)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(BASE_FRAME, iiwa))
    plant.WeldFrames(plant.GetFrameByName(FLANGE_FRAME, iiwa), plant.GetFrameByName("finger", finger))
    return Arm(iiwa, finger)


def MakeControlPlant(gravity: ArrayLike | None = None, gripper: bool = False) -> MultibodyPlant:
    """Makes the plant that the controllers know: arm and finger, and nothing else.

    Args:
        gravity: (3,) of the plant to be controlled, m/s²; Drake's by default.
        gripper: whether the flange carries bracket, finger and gripper instead of the finger alone. The gripper is
            rigid, so that the plant has the arm's positions only; it has its frame `GRASP_FRAME`.
    """
    plant = MultibodyPlant(time_step=0.0)
    if gripper:
        _add_iiwa_with_gripper(plant)
    else:
        AddIiwa(plant)
    if gravity is not None:
        plant.mutable_gravity_field().set_gravity_vector(np.asarray(gravity, float))
    plant.Finalize()
    plant.set_name("control_plant")
    return plant


def _add_iiwa_with_gripper(plant: MultibodyPlant) -> None:
    """Adds the arm with bracket, finger and a rigid gripper, as in the scenes that have one."""
    parser = MakeParser(plant)
    iiwa, bracket, finger = (parser.AddModelsFromUrl(url)[0] for url in (IIWA_URL, BRACKET_URL, FINGER_URL))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(BASE_FRAME, iiwa))
    plant.WeldFrames(plant.GetFrameByName(FLANGE_FRAME, iiwa), plant.GetFrameByName("bracket", bracket))
    plant.WeldFrames(plant.GetFrameByName("finger_mount", bracket), plant.GetFrameByName("finger", finger))
    whole = MultibodyPlant(time_step=0.0)
    (wsg,) = MakeParser(whole).AddModelsFromUrl(GRIPPER_URL)
    whole.Finalize()
    context, base = whole.CreateDefaultContext(), whole.GetFrameByName("body", wsg)
    inertia = whole.CalcSpatialInertia(context, base, whole.GetBodyIndices(wsg))
    instance = plant.AddModelInstance("gripper")
    rigid = plant.AddRigidBody("body", instance, inertia)
    for name in ("mount", GRASP_FRAME):
        X_BF = whole.GetFrameByName(name, wsg).CalcPose(context, base)
        plant.AddFrame(FixedOffsetFrame(name, rigid.body_frame(), X_BF, instance))
    plant.WeldFrames(plant.GetFrameByName("gripper_mount", bracket), plant.GetFrameByName("mount", instance))


def AddIiwaControl(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    arm: Arm,
    control_plant: MultibodyPlant,
    q_start: ArrayLike,
    period: float = CONTROL_PERIOD,
    stiffness: float = STIFFNESS,
) -> ArmControl:
    """Adds the arm's driver and inverse kinematics. Call it after Finalize.

    The builder keeps the control plant alive.

    Args:
        builder: the plant is in it.
        plant: has the arm.
        arm: as `AddIiwa` returned it.
        control_plant: as `MakeControlPlant` makes it.
        q_start: (7,) the posture at the beginning, which is also the one that the arm is drawn to, rad.
        period: of the inverse kinematics, s.
        stiffness: kp of the driver's inverse dynamics controller, critically damped, 1/s².

    Returns:
        The systems and the port to be connected.
    """
    SharedPointerSystem.AddToBuilder(builder, control_plant)
    q = np.array(q_start, float)
    plant.SetDefaultPositions(arm.iiwa, q)
    gains = np.full(plant.num_positions(arm.iiwa), stiffness)
    config = IiwaDriver(control_mode="position_only", desired_kp_gains=gains)
    driver = SimIiwaDriver.AddToBuilder(builder, plant, arm.iiwa, config, control_plant)
    kinematics = builder.AddNamedSystem(
        "iiwa_kinematics",
        DifferentialInverseKinematicsIntegrator(
            control_plant, control_plant.GetFrameByName(TIP_FRAME), period, _make_parameters(control_plant, q)
        ),
    )
    builder.Connect(kinematics.GetOutputPort("joint_positions"), driver.GetInputPort("position"))
    return ArmControl(driver, kinematics, kinematics.GetInputPort("X_AE_desired"), q)


def SetArmStart(diagram: Diagram, root_context: Context, plant: MultibodyPlant, arm: Arm, control: ArmControl) -> None:
    """Puts arm and inverse kinematics into the start's posture, at rest.

    Call it on every fresh or reset context: the integrator's own default is zero.
    """
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    plant.SetPositions(plant_context, arm.iiwa, control.q_start)
    plant.SetVelocities(plant_context, arm.iiwa, np.zeros_like(control.q_start))
    control.kinematics.SetPositions(control.kinematics.GetMyMutableContextFromRoot(root_context), control.q_start)


def _make_parameters(control_plant: MultibodyPlant, q_nominal: Array) -> DifferentialInverseKinematicsParameters:
    """Limits and centering of the inverse kinematics."""
    n = control_plant.num_positions()
    parameters = DifferentialInverseKinematicsParameters(n, n)
    parameters.set_nominal_joint_position(q_nominal)
    parameters.set_joint_centering_gain(CENTERING_GAIN * np.eye(n))
    lower, upper = control_plant.GetPositionLowerLimits(), control_plant.GetPositionUpperLimits()
    parameters.set_joint_position_limits((lower + LIMIT_MARGIN, upper - LIMIT_MARGIN))
    slowest, fastest = control_plant.GetVelocityLowerLimits(), control_plant.GetVelocityUpperLimits()
    parameters.set_joint_velocity_limits((slowest, fastest))
    return parameters


TIP_BODY = "finger_tip"
"""Name of the body that is the sphere; whatever else touches the object or the table is at fault."""


def SetTipFriction(plant: MultibodyPlant, scene_graph: SceneGraph, finger: ModelInstanceIndex, friction: float) -> None:
    """Gives the finger's tip a Coulomb friction. Call it before a Context is made.

    Drake combines two frictions a and b as 2 a b / (a + b): where both are mu, the contact has mu.

    Args:
        plant: has the finger.
        scene_graph: the plant's.
        finger: the finger's model instance.
        friction: coefficient, static and dynamic.

    Raises:
        StationError: the coefficient is negative.
    """
    if not friction >= 0.0:
        raise StationError(f"friction of the tip is {friction!r}; expected a number of 0 or more")
    inspector, source = scene_graph.model_inspector(), plant.get_source_id()
    for geometry in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(TIP_BODY, finger)):
        properties = ProximityProperties(inspector.GetProximityProperties(geometry))
        properties.UpdateProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
        scene_graph.AssignRole(source, geometry, properties, RoleAssign.kReplace)

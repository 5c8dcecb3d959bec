"""What the station has where its scene has a gripper: what grasps, what moves the gripper, and their ports."""

from pydrake.manipulation import SchunkWsgPositionController
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from shapely.geometry.base import BaseGeometry

from gridpush_drake.scene.scenario import PushScenario
from gridpush_drake.station.arm_posture import TIP_FRAME
from gridpush_drake.station.arm_reach import ArmReach
from gridpush_drake.station.exports import ExportOutputs
from gridpush_drake.station.grasp_clearance import GraspClearance
from gridpush_drake.station.iiwa import GRASP_FRAME, Arm
from gridpush_drake.systems.grasp_executor import GraspExecutor
from gridpush_drake.systems.grasp_way import GraspingStyle
from gridpush_drake.systems.push_executor import PushExecutor
from gridpush_drake.systems.pusher_gate import PusherGate

GRIPPER = "gripper"
"""Name of the gripper's model instance; a scene need not have one."""


def FindGripper(plant: MultibodyPlant) -> ModelInstanceIndex | None:
    """The gripper's model instance in a plant; None where there is none."""
    return plant.GetModelInstanceByName(GRIPPER) if plant.HasModelInstanceNamed(GRIPPER) else None


def make_grasping_style(scenario: PushScenario, control_plant: MultibodyPlant) -> GraspingStyle:
    """How the scenario's gripper grasps, carried by the arm of a plant that `MakeControlPlant` made."""
    grasp, tip = (control_plant.GetFrameByName(name) for name in (GRASP_FRAME, TIP_FRAME))
    x, y, z = grasp.CalcPose(control_plant.CreateDefaultContext(), tip).translation().tolist()
    pregrasp = scenario.pregrasp
    return GraspingStyle(
        p_PG=(x, y, z), travel_height=scenario.finger.travel_height, force=pregrasp.force, hold_time=pregrasp.hold
    )


def AddGrasping(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    arm: Arm,
    executor: PushExecutor,
    reach: ArmReach,
    table_top: BaseGeometry,
    style: GraspingStyle,
) -> GraspExecutor:
    """Adds what moves the gripper, and the tool while it grasps.

    Args:
        builder: the plant is in it.
        plant: has the arm with its gripper.
        arm: the robot in the plant.
        executor: of pushes, whose pose is passed on where nothing is grasped.
        reach: of the arm.
        table_top: the table's, a polygon in W, m.
        style: how to grasp.

    Returns:
        The executor of grasps, whose `tip_pose` is the tool's.
    """
    grasping: GraspExecutor = builder.AddNamedSystem(
        "grasp_executor", GraspExecutor(reach, style, GraspClearance(table_top, style))
    )
    controller = builder.AddNamedSystem("gripper_controller", SchunkWsgPositionController())
    state: OutputPort = plant.get_state_output_port(arm.gripper)
    for source, target in (
        (executor.GetOutputPort("tip_pose"), grasping.GetInputPort("push_tip_pose")),
        (executor.GetOutputPort("status"), grasping.GetInputPort("push_status")),
        (state, grasping.GetInputPort("gripper_state")),
        (state, controller.get_state_input_port()),
        (grasping.GetOutputPort("gripper_position"), controller.get_desired_position_input_port()),
        (grasping.GetOutputPort("gripper_force_limit"), controller.get_force_limit_input_port()),
        (controller.get_generalized_force_output_port(), plant.get_actuation_input_port(arm.gripper)),
    ):
        builder.Connect(source, target)
    return grasping


def AddPusherGate(builder: DiagramBuilder, tip: System, grasping: GraspExecutor) -> PusherGate:
    """Keeps the tip's motions in a grasp from being taken for pushes."""
    gate: PusherGate = builder.AddNamedSystem("pusher_gate", PusherGate())
    builder.Connect(tip.GetOutputPort("pusher_state"), gate.GetInputPort("pusher_state"))
    builder.Connect(grasping.GetOutputPort("status"), gate.GetInputPort("grasp_status"))
    return gate


def ExportGrasping(builder: DiagramBuilder, plant: MultibodyPlant, arm: Arm, grasping: GraspExecutor) -> None:
    """Exports the ports that the station has only with a gripper."""
    builder.ExportInput(grasping.GetInputPort("grasp_command"), "grasp_command")
    ExportOutputs(builder, grasping, "grasp", ("status",))
    builder.ExportOutput(plant.get_state_output_port(arm.gripper), "gripper.state")

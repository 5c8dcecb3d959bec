"""What the station has where its scene has a gripper: what grasps, what moves the gripper, and their ports.

`GraspClearance`: whether a grasp from the side keeps clear of the table: the gripper reaches in
below the table's top.

Ports of a Diagram's parts, exported under a common prefix.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from pydrake.manipulation import SchunkWsgPositionController
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from shapely.geometry.base import BaseGeometry

from gridpush_drake.planning.pregrasp.side_grasp import SideGripper
from gridpush_drake.station.arm import ArmReach
from gridpush_drake.station.robot import COUPLING, GripperMeasures
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.systems.grasp_executor import (
    CONTROLLER_STIFFNESS,
    GraspExecutor,
    GraspTrajectoryOptions,
)
from gridpush_drake.systems.messages import GraspCommand
from gridpush_drake.systems.push_executor import PushExecutor
from gridpush_drake.systems.pusher_gate import PusherGate

DAMPING = 5.0
"""Of Drake's controller, with a coupling of COUPLING, N s/m."""


@dataclass(frozen=True, eq=False)
class GraspClearance:
    """What a `GraspExecutor` takes as `validator`.

    Attributes:
        table_top: the table's, a polygon in W, m.
        style: of the executor.
        gripper: its measures.
        clearance: least between table and gripper, m; a little less than what grasps are planned
            with.
    """

    table_top: BaseGeometry
    style: GraspTrajectoryOptions
    gripper: SideGripper
    clearance: float = 0.001

    def __call__(self, command: GraspCommand) -> str | None:
        """None where the gripper is clear of the table all the way in, else a sentence."""
        gripper = self.gripper
        lanes = [(gripper.body_front, -gripper.jaw_reach, gripper.jaw_width)]
        lanes.append((gripper.body_back, gripper.body_front, gripper.body_width))
        u = command.heading
        v = np.array([-u[1], u[0]])
        for back, front, width in lanes:
            far, near = (
                command.p_WG[:2] - (back + self.style.standoff) * u,
                command.p_WG[:2] - front * u,
            )
            lane = shapely.Polygon(
                [
                    far - width / 2 * v,
                    near - width / 2 * v,
                    near + width / 2 * v,
                    far + width / 2 * v,
                ]
            )
            if lane.distance(self.table_top) < self.clearance:
                return f"the gripper would hit the table on its way to ({command.x:.3f}, {command.y:.3f}) m"
        return None


def ExportOutputs(
    builder: DiagramBuilder, system: System, prefix: str, ports: Sequence[str]
) -> None:
    """Exports output ports of a system, each as `prefix.port`."""
    for port in ports:
        builder.ExportOutput(system.GetOutputPort(port), f"{prefix}.{port}")


def make_grasp_trajectory_options(
    scenario: PushScenario, control_plant: MultibodyPlant, gripper: GripperMeasures, tip_frame: str
) -> GraspTrajectoryOptions:
    """How the scenario's gripper grasps, carried by the arm of a plant that `MakeControlPlant` made."""
    grasp, tip = (control_plant.GetFrameByName(name) for name in (gripper.grasp_frame, tip_frame))
    x, y, z = grasp.CalcPose(control_plant.CreateDefaultContext(), tip).translation().tolist()
    pregrasp = scenario.pregrasp
    return GraspTrajectoryOptions(
        p_PG=(x, y, z),
        travel_height=scenario.finger.travel_height,
        force=gripper.limit_force(pregrasp.force),
        opening=gripper.opening,
        closing_speed=gripper.closing_speed,
        hold_time=pregrasp.hold,
    )


def AddGraspExecutor(
    builder: DiagramBuilder,
    measures: GripperMeasures,
    executor: PushExecutor,
    reach: ArmReach,
    table_top: BaseGeometry,
    style: GraspTrajectoryOptions,
) -> GraspExecutor:
    """Adds what moves the tool while it grasps; what moves the gripper is to be connected to it.

    Args:
        builder: the executor of pushes is in it.
        measures: the gripper's.
        executor: of pushes, whose pose is passed on where nothing is grasped.
        reach: of the arm.
        table_top: the table's, a polygon in W, m.
        style: how to grasp.

    Returns:
        The executor of grasps, whose `tip_pose` is the tool's.
    """
    grasping: GraspExecutor = builder.AddNamedSystem(
        "grasp_executor",
        GraspExecutor(reach, style, GraspClearance(table_top, style, measures.make_side_gripper())),
    )
    builder.Connect(executor.GetOutputPort("tip_pose"), grasping.GetInputPort("push_tip_pose"))
    builder.Connect(executor.GetOutputPort("status"), grasping.GetInputPort("push_status"))
    builder.Connect(grasping.GetOutputPort("status"), executor.GetInputPort("grasp_status"))
    return grasping


def AddGripperController(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    gripper: ModelInstanceIndex,
    measures: GripperMeasures,
) -> SchunkWsgPositionController:
    """Adds what moves a plant's gripper to the opening, m, and with the force, N, on its input ports."""
    damping = DAMPING * float(np.sqrt(measures.coupling / COUPLING))
    controller = builder.AddNamedSystem(
        "gripper_controller",
        SchunkWsgPositionController(
            kp_command=CONTROLLER_STIFFNESS, kp_constraint=measures.coupling, kd_constraint=damping
        ),
    )
    builder.Connect(plant.get_state_output_port(gripper), controller.get_state_input_port())
    builder.Connect(
        controller.get_generalized_force_output_port(), plant.get_actuation_input_port(gripper)
    )
    return controller


def AddPusherGate(
    builder: DiagramBuilder, pusher_state: OutputPort, grasping: GraspExecutor
) -> PusherGate:
    """Keeps the tip's motions in a grasp from being taken for pushes."""
    gate: PusherGate = builder.AddNamedSystem("pusher_gate", PusherGate())
    builder.Connect(pusher_state, gate.GetInputPort("pusher_state"))
    builder.Connect(grasping.GetOutputPort("status"), gate.GetInputPort("grasp_status"))
    return gate


def ExportGrasping(builder: DiagramBuilder, state: OutputPort, grasping: GraspExecutor) -> None:
    """Exports the ports that a station has only with a gripper; `state` is the gripper's (4,)."""
    builder.ExportInput(grasping.GetInputPort("grasp_command"), "grasp_command")
    ExportOutputs(builder, grasping, "grasp", ("status",))
    builder.ExportOutput(state, "gripper.state")

"""The systems that a station has only if its scene has a gripper, and how they are connected.

`AddGraspExecutor` moves the tool in a grasp, `AddGripperController` a simulated gripper's fingers.
`GraspClearance` tells whether the gripper keeps clear of the table: in a grasp from the side it
reaches in below the table's top.
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

from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.station.robot.arm import ArmReach
from gridpush_drake.station.robot.measures import FINGER_COUPLING, GripperMeasures
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.base.messages import GraspCommand
from gridpush_drake.systems.execution.grasp_executor import GraspExecutor
from gridpush_drake.systems.execution.grasp_trajectory import (
    CONTROLLER_STIFFNESS,
    GraspTrajectoryOptions,
)
from gridpush_drake.systems.execution.push_executor import PushExecutor
from gridpush_drake.systems.sensing.pusher_gate import PusherGate

GRIPPER_DAMPING = 5.0
"""Damping of Drake's gripper controller at a coupling of `FINGER_COUPLING`, N s/m. It grows with
the root of the coupling, so that the fingers' middle stays damped by the same ratio."""


@dataclass(frozen=True, eq=False)
class GraspClearance:
    """Tells if the gripper keeps clear of the table; a `GraspExecutor` takes it as `validator`.

    Attributes:
        table_top: the table's top, a polygon in W, m.
        gripper: the gripper.
        clearance: least distance between table and gripper, m. It is a little less than the
            clearance with which grasps are planned, so that no planned grasp is refused.
    """

    table_top: BaseGeometry
    gripper: Gripper
    clearance: float = 0.001

    def __call__(self, command: GraspCommand) -> str | None:
        """Says in a sentence that the gripper would hit the table on its way in; None if not."""
        gripper = self.gripper
        forward = command.heading
        left = np.array([-forward[1], forward[0]])
        for back, front, width in (gripper.swept_jaw, gripper.swept_body):
            # What the rectangle sweeps on its straight way in, which is `standoff` long.
            p_WStart = command.p_WG[:2] + back * forward
            p_WEnd = command.p_WG[:2] + front * forward
            swept = shapely.Polygon(
                [
                    p_WStart - width / 2 * left,
                    p_WEnd - width / 2 * left,
                    p_WEnd + width / 2 * left,
                    p_WStart + width / 2 * left,
                ]
            )
            if swept.distance(self.table_top) < self.clearance:
                return (
                    "the gripper would hit the table on its way to "
                    f"({command.x:.3f}, {command.y:.3f}) m"
                )
        return None


def ExportOutputs(
    builder: DiagramBuilder, system: System, prefix: str, ports: Sequence[str]
) -> None:
    """Exports output ports of a system, each as `prefix.port`."""
    for port in ports:
        builder.ExportOutput(system.GetOutputPort(port), f"{prefix}.{port}")


def make_grasp_trajectory_options(
    scenario: PushScenario, control_plant: MultibodyPlant, measures: GripperMeasures, tip_frame: str
) -> GraspTrajectoryOptions:
    """Makes the options of grasps from scenario and gripper.

    Args:
        scenario: the scenario, with force, lift and time to hold.
        control_plant: the robot, as `MakeControlPlant` makes it; it says where the gripper is.
        measures: of the gripper.
        tip_frame: name of the frame at the finger's tip, by which the arm is led.
    """
    gripper = measures.make_gripper()
    grasp = control_plant.GetFrameByName(measures.grasp_frame)
    tip = control_plant.GetFrameByName(tip_frame)
    x, y, z = grasp.CalcPose(control_plant.CreateDefaultContext(), tip).translation().tolist()
    pregrasp = scenario.pregrasp
    return GraspTrajectoryOptions.of_gripper(
        gripper,
        pregrasp.force,
        p_PG=(x, y, z),
        travel_height=scenario.finger.travel_height,
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
    """Adds the executor of grasps, and connects it with the executor of pushes.

    Args:
        builder: the builder that has the executor of pushes.
        measures: measures of the gripper.
        executor: the executor of pushes. Its tip pose is passed on while nothing is grasped.
        reach: says whether the arm can follow a path.
        table_top: the table's top, a polygon in W, m.
        style: options of grasps.

    Returns:
        The executor of grasps. Its `tip_pose` leads the arm from now on; its outputs for the
        gripper are not connected yet.
    """
    grasping: GraspExecutor = builder.AddNamedSystem(
        "grasp_executor",
        GraspExecutor(reach, style, GraspClearance(table_top, measures.make_gripper())),
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
    """Adds Drake's controller to a simulated gripper.

    Its input ports are the opening, m, and the greatest force, N.

    Args:
        builder: the builder that has the plant.
        plant: the plant with the gripper, finalised.
        gripper: the gripper's model instance.
        measures: measures of the gripper, with its coupling.
    """
    damping = GRIPPER_DAMPING * float(np.sqrt(measures.coupling / FINGER_COUPLING))
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
    """Adds a gate that keeps the identifier from taking the tip's motions in a grasp for pushes."""
    gate: PusherGate = builder.AddNamedSystem("pusher_gate", PusherGate())
    builder.Connect(pusher_state, gate.GetInputPort("pusher_state"))
    builder.Connect(grasping.GetOutputPort("status"), gate.GetInputPort("grasp_status"))
    return gate


def ExportGrasping(builder: DiagramBuilder, state: OutputPort, grasping: GraspExecutor) -> None:
    """Exports the ports that a station has only with a gripper.

    Args:
        builder: the builder of the station.
        state: (4,) state of the gripper's fingers, see `Station`.
        grasping: the executor of grasps.
    """
    builder.ExportInput(grasping.GetInputPort("grasp_command"), "grasp_command")
    ExportOutputs(builder, grasping, "grasp", ("status", "gripper_position"))
    builder.ExportOutput(state, "gripper.state")

"""The names by which ROS 2 knows a scenario's robot: its joints, its gripper's, its frames.

They are those of `robot.yaml` and `gripper.yaml` (`ros2`), and the model's own where these say
nothing. Nothing of ROS is needed here; what speaks is `ros2.Ros2Link`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import ModelInstanceIndex

from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.station.links.tip_load import TipLoad
from gridpush_drake.station.robot.robot import GetRobotInPlant
from gridpush_drake.station.scene.resolve import ResolvedScenario


@dataclass(frozen=True)
class GripperJoints:
    """The joints of a gripper as ROS knows them.

    Attributes:
        names: of the joints.
        closed: their positions when the gripper is closed, m or rad.
        open: their positions when it is wide open, m or rad.
        opening: distance between the fingers then, m.
    """

    names: tuple[str, ...]
    closed: Array
    open: Array
    opening: float

    def calc_fraction(self, position: Array) -> float:
        """How far the gripper is open, 0 to 1, by the mean of its joints."""
        return float(np.mean((position - self.closed) / (self.open - self.closed)))

    def calc_position(self, opening: float) -> list[float]:
        """The joints' positions at an opening, m."""
        fraction = opening / self.opening
        return [float(p) for p in self.closed + fraction * (self.open - self.closed)]


@dataclass(frozen=True, eq=False)
class RosRobot:
    """What of a scenario's robot and camera a link needs to know.

    Attributes:
        joints: names of the arm's joints in `JointState`, in the model's order.
        gripper: the gripper's joints; None where there is none.
        command: "trajectory" or "position": what the arm's controller takes.
        load: "wrench", "effort" or "none": what says the load on the arm from outside.
        base_frame: name of the robot's base in headers.
        flange_frame: name of the frame of wrenches.
        X_WR: pose of the robot's base.
        tip_load: converts between wrenches and torques.
        camera: that the scenario has; None for an ideal one.
        max_force: greatest force of the gripper, N.
        others: number of other objects on the table, whose poses are said, too.
    """

    joints: tuple[str, ...]
    gripper: GripperJoints | None
    command: str
    load: str
    base_frame: str
    flange_frame: str
    X_WR: RigidTransform
    tip_load: TipLoad
    camera: Camera | None = None
    max_force: float = 0.0
    others: int = 0


def MakeRosRobot(resolved: ResolvedScenario, camera: Camera | None = None) -> RosRobot:
    """Finds the names of a scenario's robot; the model's, where `robot.yaml` has no others.

    Raises:
        StationError: `robot.yaml` names another number of joints than the arm has.
    """
    robot, plant = resolved.robot, resolved.scene.plant
    instances = GetRobotInPlant(plant, robot)
    spoken = robot.arm.ros2
    own = list_joints(plant, instances.arm)
    joints = tuple(spoken.joints or own)
    if len(joints) != len(own):
        raise StationError(
            f"robot.yaml of {robot.arm_model}: ros2.joints has {len(joints)} names; "
            f"expected {len(own)}"
        )
    gripper, max_force = None, 0.0
    if robot.gripper is not None and instances.gripper is not None:
        gripper = _find_gripper_joints(plant, instances.gripper, robot.gripper)
        max_force = robot.gripper.max_force
    return RosRobot(
        joints=joints,
        gripper=gripper,
        command=spoken.command,
        load=spoken.load,
        base_frame=robot.arm.base_frame,
        flange_frame=robot.arm.flange_frame,
        X_WR=resolved.X_WR,
        tip_load=TipLoad(resolved.control_plant, robot),
        camera=camera,
        max_force=max_force,
        others=len(resolved.others),
    )


def list_joints(plant: Any, instance: ModelInstanceIndex) -> list[str]:
    """Names of a model's moving joints, in the order of its positions."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(instance)]
    moving = [joint for joint in joints if joint.num_positions() == 1]
    return [joint.name() for joint in sorted(moving, key=lambda joint: joint.position_start())]


def _find_gripper_joints(plant: Any, instance: ModelInstanceIndex, measures: Any) -> GripperJoints:
    """As gripper.yaml names them; else the model's, which slide by half the opening each."""
    if measures.ros2_joints:
        names = tuple(measures.ros2_joints)
        closed, wide = np.array(list(measures.ros2_joints.values()), float).T
        return GripperJoints(names, closed, wide, measures.opening)
    names = tuple(list_joints(plant, instance))
    half = measures.opening / 2
    lower = np.array([plant.GetJointByName(n, instance).position_lower_limit() for n in names])
    return GripperJoints(
        names=names,
        closed=np.zeros(len(names)),
        open=np.where(lower < 0.0, -half, half),
        opening=measures.opening,
    )

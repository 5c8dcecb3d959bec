"""`Robot`: which of a scene's models are arm, finger and gripper, and their measures, which stand beside the models.

An arm's model has a `robot.yaml` in its folder, a finger's a `finger.yaml`, a gripper's a `gripper.yaml`. So a scene
says which robot there is by the models it adds, and another robot is another folder: nothing here or anywhere else
in the station knows a robot's measures or the names of its frames.

Of an arm whose tool points down, the wrist stands over the finger's tip; from the shoulder it is as far as the elbow
lets it be:

    d^2 = a^2 + b^2 + 2 a b cos(q4),   |q4| <= elbow_limit

with upper arm a and forearm b. At a given height of the tip its distance from the robot's axis lies between two radii.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sqrt
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import ConfigDict, Field, Strict
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    AddWeld,
    FlattenModelDirectives,
    GetScopedFrameByName,
    ModelDirective,
    ModelDirectives,
    PackageMap,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, ModelInstanceIndex

from gridpush_drake.errors import ScenarioError
from gridpush_drake.files import is_file
from gridpush_drake.multibody.parser import AddModelsPackage, MakeParser
from gridpush_drake.planning.pregrasp.side_grasp import SideGripper
from gridpush_drake.yaml_file import StrictSchema, check_mapping, read_mapping

Length = Annotated[float, Field(gt=0, description="a positive number, in m")]
Positive = Annotated[float, Field(gt=0, description="a positive number")]
Name = Annotated[str, Field(pattern=r"\S", description="a name")]
Numbers = Annotated[tuple[float, ...], Strict(False)]


class _Measures(StrictSchema):
    model_config = ConfigDict(frozen=True)


class ReachMeasures(_Measures):
    """How far the arm gets while the tool points down.

    Attributes:
        shoulder_height: above the base, m.
        upper_arm: from shoulder to elbow, m.
        forearm: from elbow to wrist, m.
        elbow_limit: furthest that the elbow bends, rad.
        wrist_to_flange: m.
    """

    shoulder_height: Length
    upper_arm: Length
    forearm: Length
    elbow_limit: Positive
    wrist_to_flange: Length

    def calc_ring(self, tool_length: float, tip_height: float) -> tuple[float, float]:
        """Calculates how far from the robot's axis the tip can be while the tool points down.

        Args:
            tool_length: from the flange to the tip's center, m.
            tip_height: of the tip's center above the robot's base, m.

        Returns:
            Least and greatest distance, m; the greatest is 0 where the arm is nowhere long enough.
        """
        a, b = self.upper_arm, self.forearm
        above_shoulder = tip_height + tool_length + self.wrist_to_flange - self.shoulder_height
        folded = a**2 + b**2 + 2 * a * b * cos(self.elbow_limit)
        least, greatest = (max(0.0, d2 - above_shoulder**2) for d2 in (folded, (a + b) ** 2))
        return sqrt(least), sqrt(greatest)


class ControlMeasures(_Measures):
    """How the arm is moved.

    Attributes:
        period: of the inverse kinematics, s.
        stiffness: kp of the driver's inverse dynamics controller, critically damped, 1/s².
        centering_gain: of the pull to the nominal posture in the null space, 1/s.
        limit_margin: kept from the joints' limits by the inverse kinematics, rad.
        path_limit_margin: kept from them by paths that are planned, rad.
        path_speed_share: of the joints' greatest speeds that such paths may use.
    """

    period: Positive
    stiffness: Positive
    centering_gain: Positive
    limit_margin: Positive
    path_limit_margin: Positive
    path_speed_share: Positive


class ArmMeasures(_Measures):
    """A robot's `robot.yaml`: what the model of the arm does not say.

    Attributes:
        base_frame: of the body that stands in the world.
        flange_frame: carries the tool.
        home: (3,) p_WP of the tip at the beginning, x and y from the robot's base, z from the table's top, m.
        posture: where the search for the posture at home begins, about as it will be, rad.
        reach: how far the arm gets.
        control: how it is moved.
    """

    base_frame: Name
    flange_frame: Name
    home: Annotated[Numbers, Field(min_length=3, max_length=3, description="a point [x, y, z], in m")]
    posture: Annotated[Numbers, Field(min_length=1, description="joint angles, in rad")]
    reach: ReachMeasures
    control: ControlMeasures


class FingerMeasures(_Measures):
    """A finger's `finger.yaml`.

    Attributes:
        tip_frame: of the body that is the sphere at the finger's tip, at its center, z along the finger.
        tip_radius: of that sphere, m.
    """

    tip_frame: Name
    tip_radius: Length


class GripperMeasures(_Measures):
    """A gripper's `gripper.yaml`; see `SideGripper` for the lengths.

    Attributes:
        mount_frame: by which it is carried.
        grasp_frame: in the middle between the pads.
        fingers: the bodies that may touch what is grasped.
    """

    mount_frame: Name
    grasp_frame: Name
    fingers: Annotated[tuple[str, ...], Strict(False), Field(min_length=2, description="names of bodies")]
    opening: Length
    pad_length: Length
    pad_width: Length
    jaw_reach: Length
    jaw_width: Length
    body_front: Length
    body_width: Length
    body_back: Length

    def make_side_gripper(self) -> SideGripper:
        """The gripper as grasps from the side are planned with it."""
        return SideGripper(**self.model_dump(exclude={"mount_frame", "grasp_frame", "fingers"}))


M = TypeVar("M", bound=_Measures)


def read_measures(path: Path, schema: type[M]) -> M:
    """Reads a robot.yaml, finger.yaml or gripper.yaml. Raises ScenarioError by file, field and expected form."""
    return check_mapping(path, read_mapping(path, f"{path.stem} measures", ScenarioError), schema, ScenarioError)


@dataclass(frozen=True, eq=False)
class Robot:
    """Arm, finger and perhaps gripper of a scene.

    Attributes:
        arm: measures of the arm.
        finger: of the finger.
        gripper: of the gripper; None where there is none.
        arm_model: name of the arm's model in the scene.
        finger_model: of the finger's.
        gripper_model: of the gripper's; empty where there is none.
        directives: those of the scene that add the arm and all that it carries, in the scene's order.
    """

    arm: ArmMeasures
    finger: FingerMeasures
    gripper: GripperMeasures | None
    arm_model: str
    finger_model: str
    gripper_model: str
    directives: tuple[ModelDirective, ...]


@dataclass(frozen=True)
class RobotInPlant:
    """A robot's model instances in a plant.

    Attributes:
        arm: the arm's.
        finger: the finger's.
        gripper: the gripper's; None where there is none.
    """

    arm: ModelInstanceIndex
    finger: ModelInstanceIndex
    gripper: ModelInstanceIndex | None = None


def find_robot(directives: Sequence[ModelDirective]) -> Robot:
    """Finds the robot in a scene, and reads its measures.

    Args:
        directives: the scene's.

    Returns:
        The robot.

    Raises:
        ScenarioError: a directive cannot be carried out, there is no arm with a finger, there are several, or a file of
            measures is not what it should be.
    """
    package_map = PackageMap()
    AddModelsPackage(package_map)
    try:
        flat = FlattenModelDirectives(ModelDirectives(directives=list(directives)), package_map).directives
        folders = {d.add_model.name: Path(package_map.ResolveUrl(d.add_model.file)).parent for d in flat if d.add_model}
    except (RuntimeError, ValueError) as error:
        raise ScenarioError(f"directives: {' '.join(str(error).split())}") from error
    arm_model, arm = _find_measures(folders, "robot.yaml", ArmMeasures)
    finger_model, finger = _find_measures(folders, "finger.yaml", FingerMeasures)
    gripper_model, gripper = _find_measures(folders, "gripper.yaml", GripperMeasures)
    if arm is None or finger is None:
        missing = "robot" if arm is None else "finger"
        raise ScenarioError(
            f"directives: there is no {missing}; expected a model in whose folder there is a {missing}.yaml"
        )
    carried = _list_carried(flat, arm_model)
    return Robot(arm, finger, gripper, arm_model, finger_model, gripper_model, carried)


def _find_measures(folders: dict[str, Path], file: str, schema: type[M]) -> tuple[str, M | None]:
    found = [(name, folder / file) for name, folder in folders.items() if is_file(folder / file)]
    if len(found) > 1:
        raise ScenarioError(f"directives: {' and '.join(name for name, _ in found)} each have a {file}; expected one")
    return (found[0][0], read_measures(found[0][1], schema)) if found else ("", None)


def _list_carried(flat: Sequence[ModelDirective], arm_model: str) -> tuple[ModelDirective, ...]:
    """The directives of the arm's model and of all that is welded to it."""
    carried = {arm_model}
    welds = [(_model_of(d.add_weld.parent), _model_of(d.add_weld.child)) for d in flat if d.add_weld]
    for _ in welds:
        carried |= {child for parent, child in welds if parent in carried}

    def concerns(d: ModelDirective) -> bool:
        if d.add_weld:
            return _model_of(d.add_weld.parent) in carried
        if d.add_frame:
            return _model_of(d.add_frame.X_PF.base_frame or "") in carried
        return bool(d.add_model and d.add_model.name in carried)

    return tuple(d for d in flat if concerns(d))


def _model_of(frame: str) -> str:
    return frame.rpartition("::")[0]


def GetRobotInPlant(plant: MultibodyPlant, robot: Robot) -> RobotInPlant:
    """Gets a robot's model instances from a plant to which its scene was added.

    Raises:
        ScenarioError: a body or frame that the measures name is not there.
    """
    wanted = [(robot.arm_model, robot.arm.base_frame), (robot.arm_model, robot.arm.flange_frame)]
    wanted += [(robot.finger_model, robot.finger.tip_frame)]
    if robot.gripper is not None:
        wanted += [(robot.gripper_model, name) for name in (robot.gripper.mount_frame, robot.gripper.grasp_frame)]
    for model, frame in wanted:
        if not plant.HasFrameNamed(frame, plant.GetModelInstanceByName(model)):
            raise ScenarioError(f"directives: there is no frame {model}::{frame}, which the measures of {model} name")
    arm, finger = map(plant.GetModelInstanceByName, (robot.arm_model, robot.finger_model))
    return RobotInPlant(arm, finger, plant.GetModelInstanceByName(robot.gripper_model) if robot.gripper_model else None)


def AddRobot(plant: MultibodyPlant, robot: Robot, X_WB: RigidTransform | None = None) -> RobotInPlant:
    """Adds a robot alone, and nothing else of its scene, to a plant. Call it before Finalize.

    A gripper is rigid, so that the plant has the arm's positions only; it has its mount and grasp frames.

    Args:
        plant: to add it to.
        robot: the robot.
        X_WB: of its base; identity by default.

    Returns:
        Its model instances.
    """
    kept = [d for d in robot.directives if not _is_of_gripper(d, robot)]
    ProcessModelDirectives(ModelDirectives(directives=kept), MakeParser(plant))
    arm = plant.GetModelInstanceByName(robot.arm_model)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(robot.arm.base_frame, arm), X_WB or RigidTransform())
    if robot.gripper is not None:
        _AddRigidGripper(plant, robot, robot.gripper)
    return GetRobotInPlant(plant, robot)


def _is_of_gripper(directive: ModelDirective, robot: Robot) -> bool:
    if directive.add_model:
        return bool(directive.add_model.name == robot.gripper_model)
    return bool(directive.add_weld and _model_of(directive.add_weld.child) == robot.gripper_model)


def _AddRigidGripper(plant: MultibodyPlant, robot: Robot, measures: GripperMeasures) -> None:
    own = [d for d in robot.directives if _is_of_gripper(d, robot)]
    whole = MultibodyPlant(time_step=0.0)
    (model,) = (d.add_model for d in own if d.add_model)
    (gripper,) = MakeParser(whole).AddModelsFromUrl(model.file)
    whole.Finalize()
    context, base = whole.CreateDefaultContext(), whole.GetFrameByName(measures.mount_frame, gripper).body()
    inertia = whole.CalcSpatialInertia(context, base.body_frame(), whole.GetBodyIndices(gripper))
    instance = plant.AddModelInstance(robot.gripper_model)
    rigid = plant.AddRigidBody(base.name(), instance, inertia)
    for name in (measures.mount_frame, measures.grasp_frame):
        X_BF = whole.GetFrameByName(name, gripper).CalcPose(context, base.body_frame())
        plant.AddFrame(FixedOffsetFrame(name, rigid.body_frame(), X_BF, instance))
    for weld in (d.add_weld for d in own if d.add_weld):
        _Weld(plant, weld)


def _Weld(plant: MultibodyPlant, weld: AddWeld) -> None:
    X_PC = RigidTransform() if weld.X_PC is None else weld.X_PC.GetDeterministicValue()
    plant.WeldFrames(GetScopedFrameByName(plant, weld.parent), GetScopedFrameByName(plant, weld.child), X_PC)

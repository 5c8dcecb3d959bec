"""`Robot`: arm, finger and gripper in a scene, and the measures that stand beside their models.

The folder of an arm's model has a `robot.yaml`, that of a finger a `finger.yaml`, and that of a
gripper a `gripper.yaml`. A scene says which robot there is by the models that it adds. So another
robot is another folder, and no code in the station knows a robot's measures or the names of its
frames.

The fields of these files are in `station.robot.measures`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    AddDirectives,
    ModelDirective,
    PackageMap,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Joint, ModelInstanceIndex, RigidBody

from gridpush_drake.dynamics.pusher import Pusher, PusherShape
from gridpush_drake.errors import ScenarioError
from gridpush_drake.files import is_file
from gridpush_drake.multibody.parser import (
    NO_PACKAGES,
    MakePackageMap,
    MakeParser,
    ProcessDirectives,
    Weld,
    check_model,
    find_models,
    flatten_directives,
    list_world_welds,
)
from gridpush_drake.station.robot.measures import (
    GAINS_DESCRIPTION,
    ArmMeasures,
    FingerMeasures,
    GripperMeasures,
    MeasuresType,
    PusherKind,
    read_measures,
)
from gridpush_drake.systems.robot_records import GripperStatus
from gridpush_drake.yaml_file import suggest

SceneKind = Literal["push", "grasp", "gripper"]
"""A scene that a robot.yaml names, see `SceneFiles`."""


@dataclass(frozen=True, eq=False)
class GripperTip:
    """The ends of a gripper's fingers, with which it pushes.

    Attributes:
        shape: all with which it touches objects, seen from above: of a closed gripper its convex
            hull, of two fingers that of each. Its frame is at the gripper's `tip_frame`.
        depth: how far the fingers reach below that frame, m.
        reach: how far all of the gripper that is no higher than the highest post or object reaches
            from that frame to the side, m.
    """

    shape: PusherShape
    depth: float
    reach: float


@dataclass(frozen=True, eq=False)
class Robot:
    """Arm, finger and perhaps gripper of a scene.

    Attributes:
        arm: measures of the arm.
        finger: measures of the finger.
        gripper: measures of the gripper that grasps; None if there is none, or if it pushes.
        arm_model: name of the arm's model in the scene.
        finger_model: name of the finger's model, or of that of the gripper that pushes.
        gripper_model: name of the model of the gripper that grasps; empty if there is none.
        directives: the scene's directives that add the arm and all that it carries, in the
            scene's order.
        packages: folders of packages by their names: the scenario's, and the robot.yaml's.
        pushing_gripper: measures of the gripper that pushes in place of a finger; None if a finger
            pushes.
        opening: how far its fingers are apart while it pushes, m; 0 of a closed gripper.
        tip: what touches where a gripper pushes; None of a finger.
    """

    arm: ArmMeasures
    finger: FingerMeasures
    gripper: GripperMeasures | None
    arm_model: str
    finger_model: str
    gripper_model: str
    directives: tuple[ModelDirective, ...]
    packages: Mapping[str, str]
    pushing_gripper: GripperMeasures | None = None
    opening: float = 0.0
    tip: GripperTip | None = None

    @property
    def shape(self) -> PusherShape | None:
        """What pushes, seen from above; None if it is the round tip of a finger."""
        return None if self.tip is None else self.tip.shape

    @property
    def tip_depth(self) -> float:
        """How far the finger or the gripper reaches below its tip's frame, m."""
        return self.finger.tip_radius if self.tip is None else self.tip.depth

    @property
    def clear_radius(self) -> float:
        """Least distance of the tip's frame from posts and other objects, m."""
        return self.finger.tip_radius if self.tip is None else self.tip.reach

    @property
    def pusher(self) -> Pusher:
        """What pushes, at the usual speed."""
        return Pusher(self.finger.tip_radius) if self.shape is None else Pusher(shape=self.shape)


@dataclass(frozen=True)
class RobotInPlant:
    """A robot's model instances in a plant.

    Attributes:
        arm: the arm's model instance.
        finger: the finger's model instance.
        gripper: the gripper's model instance; None if there is none.
    """

    arm: ModelInstanceIndex
    finger: ModelInstanceIndex
    gripper: ModelInstanceIndex | None = None


def find_robot(
    directives: Sequence[ModelDirective],
    packages: Mapping[str, str] = NO_PACKAGES,
    pusher: PusherKind = "finger",
) -> Robot:
    """Finds the robot in a scene, and reads its measures.

    Args:
        directives: the directives of the scene.
        packages: folders of packages by their names, as the scenario has them.
        pusher: what pushes, as the scenario says.

    Returns:
        The robot.

    Raises:
        ScenarioError: a directive cannot be carried out, there is no arm with a finger, there are
            several, or a file of measures is not what it should be.
    """
    package_map = MakePackageMap(packages)
    flat, folders = _flatten(directives, package_map)
    arm_model, arm = _find_measures(folders, "robot.yaml", ArmMeasures)
    finger_model, finger = _find_measures(folders, "finger.yaml", FingerMeasures)
    gripper_model, gripper = _find_measures(folders, "gripper.yaml", GripperMeasures)
    pushing = None
    if pusher != "finger" and arm is not None:
        if finger is not None:
            raise ScenarioError(
                f"pusher is {pusher}, but the scene has a finger, {finger_model}; expected a scene "
                "whose robot has a gripper alone, such as a robot.yaml's `scenes.gripper`"
            )
        finger_model, pushing, finger = _take_gripper(gripper_model, gripper, pusher)
        gripper_model, gripper = "", None
    if arm is None or finger is None:
        missing = "robot" if arm is None else "finger"
        or_else = "" if arm is None or gripper is None else ", or pusher: gripper"
        raise ScenarioError(
            f"directives: there is no {missing}; "
            f"expected a model in whose folder there is a {missing}.yaml{or_else}"
        )
    packages = _find_packages(folders[arm_model], arm) | dict(packages)
    package_map = MakePackageMap(packages)
    for directive in flat:
        if directive.add_model:
            check_model(directive.add_model.file, package_map)
    return Robot(
        arm=arm,
        finger=finger,
        gripper=gripper,
        arm_model=arm_model,
        finger_model=finger_model,
        gripper_model=gripper_model,
        directives=_list_carried(flat, arm_model),
        packages=packages,
        pushing_gripper=pushing,
    )


def _take_gripper(
    model: str, gripper: GripperMeasures | None, pusher: PusherKind
) -> tuple[str, GripperMeasures, FingerMeasures]:
    """Takes a scene's gripper for its finger; how wide it is `MeasureGripperTip` finds out.

    Raises:
        ScenarioError: there is no gripper, or it does not say by which frame it is led.
    """
    if gripper is None:
        raise ScenarioError(
            f"pusher is {pusher}, but the scene has no gripper; expected a model in whose folder "
            "there is a gripper.yaml, or pusher: finger"
        )
    if gripper.tip_frame is None:
        raise ScenarioError(
            f"pusher is {pusher}, but tip_frame in the gripper.yaml of {model} is missing; "
            "expected the name of a frame at the ends of its fingers, or pusher: finger"
        )
    return model, gripper, FingerMeasures(tip_frame=gripper.tip_frame, tip_radius=gripper.jaw_reach)


def _find_packages(folder: Path, arm: ArmMeasures) -> dict[str, str]:
    """Finds the folders of the packages that a robot.yaml, which stands in a folder, names."""
    return {name: str((folder / place).resolve()) for name, place in arm.packages.items()}


def list_robots(scene: SceneKind = "push") -> list[str]:
    """Lists the names of the robots that come with the package and have a scene of a kind."""
    found = {
        path.parent.name: read_measures(path, ArmMeasures).scenes
        for path in _find_shipped().glob("*/robot.yaml")
    }
    return sorted(name for name, scenes in found.items() if scenes and getattr(scenes, scene))


def make_robot_directives(
    robot: str, *, grasping: bool | None, pusher: PusherKind = "finger"
) -> list[ModelDirective]:
    """Makes the directives of a scene that has a robot at a table.

    Args:
        robot: name of a robot that comes with the package; or the folder of a robot, or its
            robot.yaml.
        grasping: whether the scene is one to grasp in; None to grasp if the robot can. A gripper
            that pushes does not grasp, but with True its table stands where something could be.
        pusher: what pushes.

    Returns:
        The directives.

    Raises:
        ScenarioError: there is no such robot, its robot.yaml is not what it should be, or names no
            such scene.
    """
    path = Path(robot)
    shipped = _find_shipped() / path.name / "robot.yaml"
    if robot == path.name and is_file(shipped):
        path = shipped
    elif path.name != "robot.yaml":
        path = path / "robot.yaml"
    if not is_file(path):
        near = suggest(robot, list_robots())
        raise ScenarioError(f"robot {robot} is not known{near}, or the folder of a robot.yaml")
    arm = read_measures(path, ArmMeasures)
    scenes = arm.scenes
    at_edge = bool(grasping)
    if grasping is None:
        grasping = scenes is not None and scenes.grasp is not None
    what: SceneKind = "grasp" if grasping else "push"
    if pusher != "finger":
        what = "gripper"
    scene = scenes and getattr(scenes, what)
    if not scene:
        why = "" if what == "push" else " has no gripper"
        or_else = {
            "push": "",
            "grasp": ", or a task that only pushes",
            "gripper": ", or pusher: finger",
        }[what]
        able = ", ".join(list_robots(what))
        raise ScenarioError(
            f"robot {robot}{why}: its robot.yaml has no `scenes: {{{what}: FILE}}`; "
            f"expected one of {able}{or_else}"
        )
    package_map = MakePackageMap(_find_packages(path.parent, arm))
    directives = _include(path, scene)
    if what == "gripper" and at_edge and scenes is not None and scenes.grasp:
        directives = _place_as(directives, _include(path, scenes.grasp), package_map)
    if path is not shipped:
        flat, folders = _flatten(directives, package_map)
        _refuse_other_robot(path, f"scenes.{what} is {scene}", folders)
        if arm.packages:
            # Whoever takes the directives does not know the robot.yaml's packages yet.
            for directive in flat:
                if directive.add_model:
                    file = Path(package_map.ResolveUrl(directive.add_model.file))
                    directive.add_model.file = file.resolve().as_uri()
            return flat
    return directives


def _include(path: Path, scene: str) -> list[ModelDirective]:
    """Makes the directives that include the file of a scene, which a robot.yaml at `path` names."""
    url = scene if "://" in scene else (path.resolve().parent / scene).as_uri()
    return [ModelDirective(add_directives=AddDirectives(file=url))]


def _place_as(
    directives: Sequence[ModelDirective], example: Sequence[ModelDirective], packages: PackageMap
) -> list[ModelDirective]:
    """Lets what both scenes weld to the world, such as the table, stand where the example has it.

    Raises:
        ScenarioError: a directive cannot be carried out.
    """
    welds = {
        d.add_weld.child: d
        for d in _flatten(example, packages)[0]
        if d.add_weld and d.add_weld.parent == "world"
    }
    flat, _ = _flatten(directives, packages)
    return [welds.get(d.add_weld.child, d) if d.add_weld else d for d in flat]


def _refuse_other_robot(path: Path, says: str, folders: Mapping[str, Path]) -> None:
    """Refuses a scene with another robot than the one whose robot.yaml names it.

    That robot.yaml would be passed over, and the other's be taken.

    Args:
        path: the robot.yaml.
        says: what it says of the scene, for the message.
        folders: folders of the scene's models, by the models' names.

    Raises:
        ScenarioError: the scene has another robot.
    """
    robots = [folder.resolve() for folder in folders.values() if is_file(folder / path.name)]
    if robots and path.parent.resolve() not in robots:
        raise ScenarioError(
            f"{path}: {says}, where the robot of {robots[0]} stands; expected a scene with the "
            "model beside this robot.yaml"
        )


def _flatten(
    directives: Sequence[ModelDirective], package_map: PackageMap
) -> tuple[list[ModelDirective], dict[str, Path]]:
    """Reads the files that directives name, down to the last one.

    Returns:
        All directives, and the folder of each model's file by the model's name.

    Raises:
        ScenarioError: a directive cannot be carried out.
    """
    flat = flatten_directives(directives, package_map)
    try:
        folders = {
            d.add_model.name: Path(package_map.ResolveUrl(d.add_model.file)).parent
            for d in flat
            if d.add_model
        }
    except (RuntimeError, ValueError) as error:
        raise ScenarioError(f"directives: {' '.join(str(error).split())}") from error
    return flat, folders


def _find_shipped() -> Path:
    """Finds the folder of the robots that come with the package."""
    return find_models() / "robots"


def _find_measures(
    folders: dict[str, Path], file: str, schema: type[MeasuresType]
) -> tuple[str, MeasuresType | None]:
    """Finds the model in whose folder there is a file of measures, and reads that.

    Args:
        folders: folders of the scene's models, by the models' names.
        file: name of the file of measures.
        schema: what it should hold.

    Returns:
        The model's name and its measures; empty and None if there is no such model.

    Raises:
        ScenarioError: there are several such models, or the file is not what it should be.
    """
    found = [(name, folder / file) for name, folder in folders.items() if is_file(folder / file)]
    if not found:
        return "", None
    if len(found) > 1:
        names = " and ".join(name for name, _ in found)
        raise ScenarioError(
            f"directives: {names} each have a {file}; expected one model with a {file} in a scene"
        )
    name, path = found[0]
    return name, read_measures(path, schema)


def _list_carried(flat: Sequence[ModelDirective], arm_model: str) -> tuple[ModelDirective, ...]:
    """Lists the directives of the arm's model and of all that is welded to it."""
    carried = {arm_model}
    welds = [
        (_model_of(d.add_weld.parent), _model_of(d.add_weld.child)) for d in flat if d.add_weld
    ]
    # A chain of welds may stand in any order; each round finds at least one more link of it.
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
    """Returns the name of the model that a scoped frame belongs to."""
    return frame.rpartition("::")[0]


def GetRobotInPlant(plant: MultibodyPlant, robot: Robot) -> RobotInPlant:
    """Gets a robot's model instances from a plant to which its scene was added.

    Raises:
        ScenarioError: a body or frame that the measures name is not there.
    """
    wanted = [(robot.arm_model, robot.arm.base_frame), (robot.arm_model, robot.arm.flange_frame)]
    wanted += [(robot.finger_model, robot.finger.tip_frame)]
    for model, gripper in _list_grippers(robot):
        wanted += [(model, name) for name in (gripper.mount_frame, gripper.grasp_frame)]
    for model, frame in wanted:
        if not plant.HasFrameNamed(frame, plant.GetModelInstanceByName(model)):
            raise ScenarioError(
                f"directives: there is no frame {model}::{frame}, "
                f"which the measures of {model} name"
            )
    grasping = None
    if robot.gripper_model:
        grasping = plant.GetModelInstanceByName(robot.gripper_model)
    return RobotInPlant(
        arm=plant.GetModelInstanceByName(robot.arm_model),
        finger=plant.GetModelInstanceByName(robot.finger_model),
        gripper=grasping,
    )


def _list_grippers(robot: Robot) -> list[tuple[str, GripperMeasures]]:
    """Lists the model and the measures of a robot's gripper, whether it grasps or pushes."""
    grippers = {robot.gripper_model: robot.gripper, robot.finger_model: robot.pushing_gripper}
    return [(model, measures) for model, measures in grippers.items() if measures is not None]


def GetTipInBody(plant: MultibodyPlant, robot: Robot) -> tuple[RigidBody, RigidTransform]:
    """Gets the body that carries a robot's tip, and X_BP, the pose of the tip's frame in it."""
    frame = plant.GetFrameByName(
        robot.finger.tip_frame, plant.GetModelInstanceByName(robot.finger_model)
    )
    return frame.body(), frame.GetFixedPoseInBodyFrame()


def list_touching_bodies(plant: MultibodyPlant, robot: Robot) -> list[RigidBody]:
    """Lists the bodies with which a robot pushes: the finger's tip, or the gripper's fingers."""
    if robot.pushing_gripper is None:
        return [plant.GetBodyByName(robot.finger.tip_frame)]
    gripper = plant.GetModelInstanceByName(robot.finger_model)
    return [plant.GetBodyByName(name, gripper) for name in robot.pushing_gripper.fingers]


def SetGripperOpening(plant: MultibodyPlant, robot: Robot) -> None:
    """Holds the fingers of a gripper that pushes as far apart as it should, in new Contexts.

    Args:
        plant: a finalised plant with the robot's scene.
        robot: the robot; nothing is done where a finger pushes.
    """
    if robot.pushing_gripper is None:
        return
    gripper = plant.GetModelInstanceByName(robot.finger_model)
    fingers = GripperStatus(0.0, robot.opening).calc_finger_state()[:2]
    plant.SetDefaultPositions(gripper, fingers)


def list_moving_joints(plant: MultibodyPlant, instance: ModelInstanceIndex) -> list[Joint]:
    """Lists the joints of a model that are not welds, in the order of the model's positions."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(instance)]
    return [joint for joint in joints if joint.num_positions() > 0]


def check_robot(plant: MultibodyPlant, robot: Robot) -> None:
    """Checks the joints of a robot in a finalised plant.

    Raises:
        ScenarioError: a frame that the measures name is not there; the arm has another number of
            joints than its measures, or joints without limits or motors; or the gripper does not
            open as Drake's controller needs it.
    """
    instances = GetRobotInPlant(plant, robot)
    _check_joints(plant, robot, instances.arm)
    for model, _ in _list_grippers(robot):
        _check_gripper(plant, model)


def _check_joints(plant: MultibodyPlant, robot: Robot, arm: ModelInstanceIndex) -> None:
    """Checks that the measures fit the arm's joints, and that these have limits and motors."""
    model = robot.arm_model
    control = robot.arm.control
    joints = list_moving_joints(plant, arm)
    names = ", ".join(joint.name() for joint in joints)
    if control.driver == "position" and control.damping is None:
        raise ScenarioError(
            f"directives: control.damping in the robot.yaml of {model} is missing; "
            f"expected {GAINS_DESCRIPTION}, as its driver is position"
        )
    # There is one number for each joint; a single gain may stand for all.
    one_each = {
        "posture": robot.arm.posture,
        "stiffness": control.stiffness,
        "damping": control.damping or (),
    }
    for name, numbers in one_each.items():
        if len(numbers) != len(joints) and (name == "posture" or len(numbers) > 1):
            raise ScenarioError(
                f"directives: {name} in the robot.yaml of {model} has {len(numbers)} numbers; "
                f"expected {len(joints)}, one for each joint: {names}"
            )
    for joint in joints:
        limits = [
            joint.position_lower_limits(),
            joint.position_upper_limits(),
            joint.velocity_upper_limits(),
        ]
        if joint.num_positions() > 1 or not np.isfinite(limits).all():
            raise ScenarioError(
                f"directives: joint {joint.name()} of {model} has no limits; "
                "expected its model to limit position and velocity"
            )
    motors = [
        plant.get_joint_actuator(index).joint().name()
        for index in plant.GetJointActuatorIndices(arm)
    ]
    if motors != [joint.name() for joint in joints]:
        raise ScenarioError(
            f"directives: joints of {model} with a motor are {', '.join(motors) or 'none'}; "
            f"expected transmissions for {names}, in this order"
        )


def _check_gripper(plant: MultibodyPlant, model: str) -> None:
    """Checks that a gripper opens by two fingers that slide, the first the negative way.

    Drake's `SchunkWsgPositionController` moves no other.
    """
    limits = [
        (joint.position_lower_limits().tolist(), joint.position_upper_limits().tolist())
        for joint in list_moving_joints(plant, plant.GetModelInstanceByName(model))
    ]
    if not (len(limits) == 2 and limits[0][1] == [0.0] and limits[1][0] == [0.0]):
        raise ScenarioError(
            f"directives: gripper {model} does not open by two joints; "
            "expected the first to go from -x to 0 and the second from 0 to x, m"
        )


def AddRobot(
    plant: MultibodyPlant, robot: Robot, X_WB: RigidTransform | None = None
) -> RobotInPlant:
    """Adds a robot, and nothing else of its scene, to a plant before Finalize.

    A gripper becomes one rigid body, closed, with the frames that its measures name, so that the
    plant's positions are those of the arm alone.

    Args:
        plant: the plant to which the robot is added.
        robot: the robot.
        X_WB: pose of its base B in the world; identity by default.

    Returns:
        The robot's model instances.
    """
    grippers = _list_grippers(robot)
    models = [model for model, _ in grippers]
    kept = [d for d in robot.directives if _model_added(d) not in models]
    ProcessDirectives(kept, MakeParser(plant, robot.packages))
    arm = plant.GetModelInstanceByName(robot.arm_model)
    for weld in list_world_welds(plant, arm):  # the model's own, to where it stands in its file
        plant.RemoveJoint(weld)
    plant.WeldFrames(
        plant.world_frame(),
        plant.GetFrameByName(robot.arm.base_frame, arm),
        X_WB or RigidTransform(),
    )
    for model, measures in grippers:
        own = [d for d in robot.directives if _model_added(d) == model]
        _AddRigidGripper(plant, robot.packages, own, measures)
    return GetRobotInPlant(plant, robot)


def _model_added(directive: ModelDirective) -> str:
    """Returns the name of the model that a directive adds or welds to something; "" for none."""
    if directive.add_model:
        return str(directive.add_model.name)
    return _model_of(directive.add_weld.child) if directive.add_weld else ""


def _AddRigidGripper(
    plant: MultibodyPlant,
    packages: Mapping[str, str],
    own: Sequence[ModelDirective],
    measures: GripperMeasures,
) -> None:
    """Adds a gripper to a plant as one rigid body, with the inertia of all its parts.

    Args:
        plant: the plant.
        packages: folders of packages by their names.
        own: the directives that add and weld it.
        measures: of the gripper.
    """
    # The gripper with its fingers, in a plant of its own, to measure it.
    whole = MultibodyPlant(time_step=0.0)
    (model,) = (d.add_model for d in own if d.add_model)
    (gripper,) = MakeParser(whole, packages).AddModelsFromUrl(model.file)
    whole.Finalize()
    context = whole.CreateDefaultContext()
    base = whole.GetFrameByName(measures.mount_frame, gripper).body()
    inertia = whole.CalcSpatialInertia(context, base.body_frame(), whole.GetBodyIndices(gripper))
    # The rigid body that replaces it.
    instance = plant.AddModelInstance(model.name)
    rigid = plant.AddRigidBody(base.name(), instance, inertia)
    names = (measures.mount_frame, measures.grasp_frame, measures.tip_frame)
    for name in dict.fromkeys(filter(None, names)):
        X_BF = whole.GetFrameByName(name, gripper).CalcPose(context, base.body_frame())
        if not plant.HasFrameNamed(name, instance):  # a body's frame is there from the beginning
            plant.AddFrame(FixedOffsetFrame(name, rigid.body_frame(), X_BF, instance))
    for weld in (d.add_weld for d in own if d.add_weld):
        Weld(plant, weld)

"""`Robot`: arm, finger and gripper in a scene, and the measures that stand beside their models.

The folder of an arm's model has a `robot.yaml`, that of a finger a `finger.yaml`, and that of a
gripper a `gripper.yaml`. A scene says which robot there is by the models that it adds. So another
robot is another folder, and no code in the station knows a robot's measures or the names of its
frames.

How far an arm reaches is found by its inverse kinematics (`station.arm`). For some arms, such as an
iiwa, a formula says it at once: those whose shoulder, elbow and wrist lie on one line when the arm
is stretched. While the tool points down, the wrist is straight above the finger's tip. Its distance
d from the shoulder depends on the angle q4 of the elbow alone:

    d^2 = a^2 + b^2 + 2 a b cos(q4),   |q4| <= elbow_limit

with upper arm a and forearm b. At a given height of the tip, the tip's distance from the robot's
axis therefore lies between two radii.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import cos, sqrt
from pathlib import Path
from typing import Annotated, Literal, TypeVar, get_args

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, Strict
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    AddDirectives,
    AddWeld,
    FlattenModelDirectives,
    GetScopedFrameByName,
    ModelDirective,
    ModelDirectives,
    PackageMap,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Joint, ModelInstanceIndex

from gridpush_drake.errors import ScenarioError
from gridpush_drake.files import is_file
from gridpush_drake.multibody.parser import (
    AddModelsPackage,
    MakeParser,
    check_directives,
    find_models,
)
from gridpush_drake.planning.pregrasp.gripper import Gripper
from gridpush_drake.yaml_file import StrictSchema, check_mapping, read_mapping, suggest

Length = Annotated[float, Field(gt=0, description="a positive number, in m")]
Positive = Annotated[float, Field(gt=0, description="a positive number")]
Name = Annotated[str, Field(pattern=r"\S", description="a name")]
Numbers = Annotated[tuple[float, ...], Strict(False)]


class _Measures(StrictSchema):
    model_config = ConfigDict(frozen=True)


class ReachMeasures(_Measures):
    """Lengths that say how far an arm reaches whose shoulder, elbow and wrist have no offsets.

    Attributes:
        shoulder_height: height of the shoulder above the base, m.
        upper_arm: distance from shoulder to elbow, m.
        forearm: distance from elbow to wrist, m.
        elbow_limit: greatest angle by which the elbow bends, rad.
        wrist_to_flange: distance from wrist to flange, m.
    """

    shoulder_height: Length
    upper_arm: Length
    forearm: Length
    elbow_limit: Positive
    wrist_to_flange: Length

    def calc_ring(self, tool_length: float, tip_height: float) -> tuple[float, float]:
        """Calculates how far from the robot's axis the tip can be while the tool points down.

        Args:
            tool_length: distance from the flange to the tip's center, m.
            tip_height: height of the tip's center above the robot's base, m.

        Returns:
            Least and greatest distance, m. The greatest is 0 if the arm is too short for this
            height.
        """
        a = self.upper_arm
        b = self.forearm
        wrist_above_shoulder = (
            tip_height + tool_length + self.wrist_to_flange - self.shoulder_height
        )
        # d^2 with the arm folded and stretched, see the module's equation.
        folded = a**2 + b**2 + 2 * a * b * cos(self.elbow_limit)
        stretched = (a + b) ** 2
        least = max(0.0, folded - wrist_above_shoulder**2)
        greatest = max(0.0, stretched - wrist_above_shoulder**2)
        return sqrt(least), sqrt(greatest)


GAINS = "a positive number, or one for each joint"
"""Description of a field that holds `Gains`."""

Gains = Annotated[
    tuple[Positive, ...],
    Strict(False),
    BeforeValidator(lambda value: value if isinstance(value, list | tuple) else (value,)),
    Field(min_length=1, description=GAINS),
]
"""Gains of the joints, one for each; a single gain stands for all joints."""

Driver = Literal["iiwa", "position"]
"""Kind of an arm's driver, see `ControlMeasures.driver`."""


class ControlMeasures(_Measures):
    """How the arm is moved. If a joint slides, read m for rad.

    Attributes:
        driver: what makes the joints of the simulated arm follow the wanted positions. "iiwa":
            Drake's `SimIiwaDriver`, with inverse dynamics and torques (it drives any arm);
            "position": a servo in each joint, with gravity compensated.
        period: period of the inverse kinematics, s.
        stiffness: with the driver "iiwa", kp of its critically damped inverse dynamics controller,
            1/s²; with "position", stiffness of the joints' servos, N m/rad, or N/m. One number for
            all joints, or one for each.
        damping: damping of the joints' servos, N m s/rad, or N s/m. One number for all joints, or
            one for each; null with the driver "iiwa".
        centering_gain: gain of the pull to the nominal posture in the null space, 1/s.
        limit_margin: distance that the inverse kinematics keeps from the joints' limits, rad.
        path_limit_margin: distance that planned paths keep from the joints' limits, rad.
        path_speed_share: planned paths use at most this share of the joints' greatest speeds.
    """

    driver: Annotated[Driver, Field(description=f"one of {', '.join(get_args(Driver))}")] = "iiwa"
    period: Positive
    stiffness: Gains
    damping: Annotated[Gains | None, Field(description=GAINS)] = None
    centering_gain: Positive
    limit_margin: Positive
    path_limit_margin: Positive
    path_speed_share: Positive


class Ros2Measures(_Measures):
    """What an arm's ROS 2 driver speaks, see `station.links.ros2`.

    Attributes:
        joints: names of the joints in `JointState` and in commands, in the model's order; null for
            the model's own names.
        command: what the arm's controller takes. "trajectory": `JointTrajectory` of one point
            (joint_trajectory_controller); "position": `Float64MultiArray`
            (forward_position_controller).
        load: what says how the world presses on the arm. "wrench": `WrenchStamped` on the flange,
            where there is one; "effort": the efforts in `JointState`, where these are the torques
            from outside and not the motors'; "none": nothing.
    """

    joints: Annotated[
        tuple[str, ...] | None, Strict(False), Field(description="names of joints, or null")
    ] = None
    command: Annotated[
        Literal["trajectory", "position"], Field(description="trajectory or position")
    ] = "trajectory"
    load: Annotated[
        Literal["wrench", "effort", "none"], Field(description="wrench, effort or none")
    ] = "wrench"


class SceneFiles(_Measures):
    """Scenes with the robot at a table: files of Drake's model directives.

    Each is a URL, such as package://..., or a path relative to the robot.yaml.

    Attributes:
        push: scene to push in.
        grasp: scene to push and grasp in; null if the robot has no gripper.
    """

    push: Name
    grasp: Name | None = None


class ArmMeasures(_Measures):
    """A `robot.yaml`: what the model of an arm does not say. Joint limits are the model's.

    Attributes:
        base_frame: name of the frame of the body that stands in the world.
        flange_frame: name of the frame that carries the tool.
        home: [x, y, z] of the tip at the beginning, m; x and y from the robot's base, z from the
            table's top.
        posture: joint positions at home, roughly, from which the search for them begins, rad, or m
            for a joint that slides.
        reach: lengths of a formula for how far the arm reaches; null to find it out by inverse
            kinematics.
        control: how the arm is moved.
        messages: LCM messages that its driver speaks, see `station.lcm.robot_messages`; null if
            there are none.
        ros2: what its driver speaks over ROS 2.
        scenes: scenes that have this robot. A command or a scenario may then name the robot
            instead of a scene. null for none.
    """

    base_frame: Name
    flange_frame: Name
    home: Annotated[
        Numbers, Field(min_length=3, max_length=3, description="a point [x, y, z], in m")
    ]
    posture: Annotated[Numbers, Field(min_length=1, description="joint positions, in rad or m")]
    reach: ReachMeasures | None = None
    control: ControlMeasures
    messages: Annotated[
        Literal["iiwa", "panda"] | None, Field(description="iiwa, panda or null")
    ] = None
    ros2: Ros2Measures = Ros2Measures()
    scenes: SceneFiles | None = None


class FingerMeasures(_Measures):
    """A `finger.yaml`: the sphere at the tip of a finger, with which it touches.

    Attributes:
        tip_frame: name of the frame of the body that is the sphere. It is at the sphere's center,
            with z along the finger.
        tip_radius: radius of the sphere, m.
    """

    tip_frame: Name
    tip_radius: Length


COUPLING = 2000.0
"""How stiffly Drake's gripper controller keeps the fingers' middle where it is by default, N/m."""


class GripperMeasures(_Measures):
    """A gripper's `gripper.yaml`: the names in its model, and what it measures.

    The lengths are those of `Gripper` (`planning.pregrasp.gripper`), which explains them.

    Attributes:
        mount_frame: frame by which the gripper is carried.
        grasp_frame: frame in the middle between the pads.
        fingers: the bodies that may touch what is grasped.
        max_force: greatest force with which both fingers press together, N.
        closing_speed: greatest change of the opening, m/s.
        coupling: how stiffly the simulated fingers keep their middle where it is, N/m.
        ros2_joints: the joints of its ROS 2 driver by name, each with its positions when the
            gripper is closed and when it is open by `opening`; null for the model's own.
        opening: how far the jaws open, m.
        pad_length: of the pads' contact area along the fingers, m.
        pad_width: of the pads' contact area across the fingers, m.
        jaw_reach: how far the jaws reach beyond the grasp point, m.
        jaw_width: of a jaw, across the fingers, m.
        body_front: from the grasp point back to the front of the gripper's body, m.
        body_width: of body, bracket or pushing finger, the widest, m.
        body_back: from the grasp point back to the end of body, bracket and finger, m.
    """

    mount_frame: Name
    grasp_frame: Name
    fingers: Annotated[
        tuple[str, ...], Strict(False), Field(min_length=2, description="names of bodies")
    ]
    max_force: Positive = Gripper.max_force
    closing_speed: Positive = Gripper.closing_speed
    coupling: Positive = COUPLING
    ros2_joints: Annotated[
        dict[str, tuple[float, float]] | None,
        Strict(False),
        Field(description="joints by name, each with its positions [closed, open], or null"),
    ] = None
    opening: Length
    pad_length: Length
    pad_width: Length
    jaw_reach: Length
    jaw_width: Length
    body_front: Length
    body_width: Length
    body_back: Length

    def make_gripper(self) -> Gripper:
        """The gripper as everything is planned and carried out with it."""
        measures = {field.name for field in fields(Gripper)} & set(GripperMeasures.model_fields)
        return Gripper(**self.model_dump(include=measures))


M = TypeVar("M", bound=_Measures)


def read_measures(path: Path, schema: type[M]) -> M:
    """Reads a robot.yaml, finger.yaml or gripper.yaml.

    Raises:
        ScenarioError: the file cannot be read, or holds what will not do. The message names the
            file, the field and the expected form.
    """
    return check_mapping(
        path, read_mapping(path, f"{path.stem} measures", ScenarioError), schema, ScenarioError
    )


@dataclass(frozen=True, eq=False)
class Robot:
    """Arm, finger and perhaps gripper of a scene.

    Attributes:
        arm: measures of the arm.
        finger: measures of the finger.
        gripper: measures of the gripper; None if there is none.
        arm_model: name of the arm's model in the scene.
        finger_model: name of the finger's model.
        gripper_model: name of the gripper's model; empty if there is none.
        directives: the scene's directives that add the arm and all that it carries, in the
            scene's order.
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
        arm: the arm's model instance.
        finger: the finger's model instance.
        gripper: the gripper's model instance; None if there is none.
    """

    arm: ModelInstanceIndex
    finger: ModelInstanceIndex
    gripper: ModelInstanceIndex | None = None


def find_robot(directives: Sequence[ModelDirective]) -> Robot:
    """Finds the robot in a scene, and reads its measures.

    Args:
        directives: the directives of the scene.

    Returns:
        The robot.

    Raises:
        ScenarioError: a directive cannot be carried out, there is no arm with a finger, there are
            several, or a file of measures is not what it should be.
    """
    flat, folders = _flatten(directives)
    arm_model, arm = _find_measures(folders, "robot.yaml", ArmMeasures)
    finger_model, finger = _find_measures(folders, "finger.yaml", FingerMeasures)
    gripper_model, gripper = _find_measures(folders, "gripper.yaml", GripperMeasures)
    if arm is None or finger is None:
        missing = "robot" if arm is None else "finger"
        raise ScenarioError(
            f"directives: there is no {missing}; "
            f"expected a model in whose folder there is a {missing}.yaml"
        )
    return Robot(
        arm=arm,
        finger=finger,
        gripper=gripper,
        arm_model=arm_model,
        finger_model=finger_model,
        gripper_model=gripper_model,
        directives=_list_carried(flat, arm_model),
    )


def list_robots(*, grasping: bool = False) -> list[str]:
    """Lists the names of the robots that come with the package, or only of those that can grasp."""
    found = {
        path.parent.name: read_measures(path, ArmMeasures).scenes
        for path in _find_shipped().glob("*/robot.yaml")
    }
    return sorted(
        name for name, scenes in found.items() if scenes and (scenes.grasp or not grasping)
    )


def make_robot_directives(robot: str, *, grasping: bool | None) -> list[ModelDirective]:
    """Makes the directives of a scene that has a robot at a table.

    Args:
        robot: name of a robot that comes with the package; or the folder of a robot, or its
            robot.yaml.
        grasping: whether the scene is one to grasp in; None to grasp if the robot can.

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
    scenes = read_measures(path, ArmMeasures).scenes
    if grasping is None:
        grasping = scenes is not None and scenes.grasp is not None
    scene = scenes and (scenes.grasp if grasping else scenes.push)
    if not scene:
        what = "grasp" if grasping else "push"
        why = " has no gripper" if grasping else ""
        or_else = ", or a task that only pushes" if grasping else ""
        able = ", ".join(list_robots(grasping=grasping))
        raise ScenarioError(
            f"robot {robot}{why}: its robot.yaml has no `scenes: {{{what}: FILE}}`; "
            f"expected one of {able}{or_else}"
        )
    url = scene if "://" in scene else (path.resolve().parent / scene).as_uri()
    directives = [ModelDirective(add_directives=AddDirectives(file=url))]
    if path is not shipped:
        key = "grasp" if grasping else "push"
        _refuse_other_robot(path, f"scenes.{key} is {scene}", directives)
    return directives


def _refuse_other_robot(path: Path, says: str, directives: Sequence[ModelDirective]) -> None:
    """Refuses a scene with another robot than the one whose robot.yaml names it.

    That robot.yaml would be passed over, and the other's be taken.

    Args:
        path: the robot.yaml.
        says: what it says of the scene, for the message.
        directives: the scene.

    Raises:
        ScenarioError: the scene has another robot, or a directive cannot be carried out.
    """
    _, folders = _flatten(directives)
    robots = [folder.resolve() for folder in folders.values() if is_file(folder / path.name)]
    if robots and path.parent.resolve() not in robots:
        raise ScenarioError(
            f"{path}: {says}, where the robot of {robots[0]} stands; expected a scene with the "
            "model beside this robot.yaml"
        )


def _flatten(
    directives: Sequence[ModelDirective],
) -> tuple[list[ModelDirective], dict[str, Path]]:
    """Reads the files that directives name, down to the last one.

    Returns:
        All directives, and the folder of each model's file by the model's name.

    Raises:
        ScenarioError: a directive cannot be carried out.
    """
    package_map = PackageMap()
    AddModelsPackage(package_map)
    check_directives(directives, package_map)
    try:
        flat = FlattenModelDirectives(
            ModelDirectives(directives=list(directives)), package_map
        ).directives
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


def _find_measures(folders: dict[str, Path], file: str, schema: type[M]) -> tuple[str, M | None]:
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
    if robot.gripper is not None:
        wanted += [
            (robot.gripper_model, name)
            for name in (robot.gripper.mount_frame, robot.gripper.grasp_frame)
        ]
    for model, frame in wanted:
        if not plant.HasFrameNamed(frame, plant.GetModelInstanceByName(model)):
            raise ScenarioError(
                f"directives: there is no frame {model}::{frame}, "
                f"which the measures of {model} name"
            )
    gripper = None
    if robot.gripper_model:
        gripper = plant.GetModelInstanceByName(robot.gripper_model)
    return RobotInPlant(
        arm=plant.GetModelInstanceByName(robot.arm_model),
        finger=plant.GetModelInstanceByName(robot.finger_model),
        gripper=gripper,
    )


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
    if instances.gripper is not None:
        _check_gripper(plant, robot, instances.gripper)


def _check_joints(plant: MultibodyPlant, robot: Robot, arm: ModelInstanceIndex) -> None:
    """Checks that the measures fit the arm's joints, and that these have limits and motors."""
    model = robot.arm_model
    control = robot.arm.control
    joints = list_moving_joints(plant, arm)
    names = ", ".join(joint.name() for joint in joints)
    if control.driver == "position" and control.damping is None:
        raise ScenarioError(
            f"directives: control.damping in the robot.yaml of {model} is missing; "
            f"expected {GAINS}, as its driver is position"
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


def _check_gripper(plant: MultibodyPlant, robot: Robot, gripper: ModelInstanceIndex) -> None:
    """Checks that a gripper opens by two fingers that slide, the first the negative way.

    Drake's `SchunkWsgPositionController` moves no other.
    """
    limits = [
        (joint.position_lower_limits().tolist(), joint.position_upper_limits().tolist())
        for joint in list_moving_joints(plant, gripper)
    ]
    if not (len(limits) == 2 and limits[0][1] == [0.0] and limits[1][0] == [0.0]):
        raise ScenarioError(
            f"directives: gripper {robot.gripper_model} does not open by two joints; "
            "expected the first to go from -x to 0 and the second from 0 to x, m"
        )


def AddRobot(
    plant: MultibodyPlant, robot: Robot, X_WB: RigidTransform | None = None
) -> RobotInPlant:
    """Adds a robot, and nothing else of its scene, to a plant before Finalize.

    A gripper becomes one rigid body with its mount and grasp frames, so that the plant's positions
    are those of the arm alone.

    Args:
        plant: the plant to which the robot is added.
        robot: the robot.
        X_WB: pose of its base B in the world; identity by default.

    Returns:
        The robot's model instances.
    """
    kept = [d for d in robot.directives if not _is_of_gripper(d, robot)]
    ProcessModelDirectives(ModelDirectives(directives=kept), MakeParser(plant))
    arm = plant.GetModelInstanceByName(robot.arm_model)
    plant.WeldFrames(
        plant.world_frame(),
        plant.GetFrameByName(robot.arm.base_frame, arm),
        X_WB or RigidTransform(),
    )
    if robot.gripper is not None:
        _AddRigidGripper(plant, robot, robot.gripper)
    return GetRobotInPlant(plant, robot)


def _is_of_gripper(directive: ModelDirective, robot: Robot) -> bool:
    """Returns whether a directive adds or welds the robot's gripper."""
    if directive.add_model:
        return bool(directive.add_model.name == robot.gripper_model)
    return bool(directive.add_weld and _model_of(directive.add_weld.child) == robot.gripper_model)


def _AddRigidGripper(plant: MultibodyPlant, robot: Robot, measures: GripperMeasures) -> None:
    """Adds a robot's gripper to a plant as one rigid body, with the inertia of all its parts."""
    own = [d for d in robot.directives if _is_of_gripper(d, robot)]
    # The gripper with its fingers, in a plant of its own, to measure it.
    whole = MultibodyPlant(time_step=0.0)
    (model,) = (d.add_model for d in own if d.add_model)
    (gripper,) = MakeParser(whole).AddModelsFromUrl(model.file)
    whole.Finalize()
    context = whole.CreateDefaultContext()
    base = whole.GetFrameByName(measures.mount_frame, gripper).body()
    inertia = whole.CalcSpatialInertia(context, base.body_frame(), whole.GetBodyIndices(gripper))
    # The rigid body that replaces it.
    instance = plant.AddModelInstance(robot.gripper_model)
    rigid = plant.AddRigidBody(base.name(), instance, inertia)
    for name in (measures.mount_frame, measures.grasp_frame):
        X_BF = whole.GetFrameByName(name, gripper).CalcPose(context, base.body_frame())
        if not plant.HasFrameNamed(name, instance):  # a body's frame is there from the beginning
            plant.AddFrame(FixedOffsetFrame(name, rigid.body_frame(), X_BF, instance))
    for weld in (d.add_weld for d in own if d.add_weld):
        _Weld(plant, weld)


def _Weld(plant: MultibodyPlant, weld: AddWeld) -> None:
    """Welds two bodies of a plant as a directive says."""
    X_PC = RigidTransform() if weld.X_PC is None else weld.X_PC.GetDeterministicValue()
    plant.WeldFrames(
        GetScopedFrameByName(plant, weld.parent), GetScopedFrameByName(plant, weld.child), X_PC
    )

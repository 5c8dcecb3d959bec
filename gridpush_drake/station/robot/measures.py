"""What a robot's folders say of it: the fields of `robot.yaml`, `finger.yaml` and `gripper.yaml`.

How far an arm reaches is found by its inverse kinematics (`station.robot.arm`). For some arms, such
as an iiwa, a formula says it at once: those whose shoulder, elbow and wrist lie on one line when
the arm is stretched. While the tool points down, the wrist is straight above the finger's tip. Its
distance d from the shoulder depends on the angle q4 of the elbow alone:

    d^2 = a^2 + b^2 + 2 a b cos(q4),   |q4| <= elbow_limit

with upper arm a and forearm b. At a given height of the tip, the tip's distance from the robot's
axis therefore lies between two radii.
"""

from dataclasses import fields
from math import cos, sqrt
from pathlib import Path
from typing import Annotated, Literal, TypeVar, get_args

from pydantic import BeforeValidator, ConfigDict, Field, Strict

from gridpush_drake.errors import ScenarioError
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.yaml_file import StrictSchema, check_mapping, read_mapping

Length = Annotated[float, Field(gt=0, description="a positive number, in m")]
Positive = Annotated[float, Field(gt=0, description="a positive number")]
Name = Annotated[str, Field(pattern=r"\S", description="a name")]
Numbers = Annotated[tuple[float, ...], Strict(False)]

PACKAGES_DESCRIPTION = "folders of packages by their names"
"""Description of a field that holds `Packages`."""

Packages = Annotated[dict[Name, Name], Field(description=PACKAGES_DESCRIPTION)]
"""Where `package://NAME/...` is found, by the package's name."""

GAINS_DESCRIPTION = "a positive number, or one for each joint"
"""Description of a field that holds `Gains`."""

Gains = Annotated[
    tuple[Positive, ...],
    Strict(False),
    BeforeValidator(lambda value: value if isinstance(value, list | tuple) else (value,)),
    Field(min_length=1, description=GAINS_DESCRIPTION),
]
"""Gains of the joints, one for each; a single gain stands for all joints."""

Driver = Literal["iiwa", "position"]
"""Kind of an arm's driver, see `ControlMeasures.driver`."""


PusherKind = Literal["finger", "gripper", "fingertips"]
"""What pushes: the round tip of a finger, the closed gripper, or both its fingers, held apart."""


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
        path_speed_share: planned paths use at most this fraction of the joints' greatest speeds.
    """

    driver: Annotated[Driver, Field(description=f"one of {', '.join(get_args(Driver))}")] = "iiwa"
    period: Positive
    stiffness: Gains
    damping: Annotated[Gains | None, Field(description=GAINS_DESCRIPTION)] = None
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
        gripper: scene to push in with the gripper, which points down at the flange; null if the
            robot has none.
    """

    push: Name
    grasp: Name | None = None
    gripper: Name | None = None


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
        messages: LCM messages that its driver speaks, see `links.lcm.lcm_messages`; null if
            there are none.
        ros2: what its driver speaks over ROS 2.
        scenes: scenes that have this robot. A command or a scenario may then name the robot
            instead of a scene. null for none.
        packages: folders of the packages that the model's `package://NAME/...` names, by name; each
            is a path relative to the robot.yaml.
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
    packages: Packages = Field(default_factory=dict)


class FingerMeasures(_Measures):
    """A `finger.yaml`: the sphere at the tip of a finger, with which it touches.

    Attributes:
        tip_frame: name of the frame of the body that is the sphere. It is at the sphere's center,
            with z along the finger.
        tip_radius: radius of the sphere, m.
    """

    tip_frame: Name
    tip_radius: Length


FINGER_COUPLING = 2000.0
"""How stiffly Drake's gripper controller keeps the fingers' middle where it is by default, N/m."""


class GripperMeasures(_Measures):
    """A gripper's `gripper.yaml`: the names in its model, and what it measures.

    The lengths are those of `Gripper` (`planning.pregrasp.grasp.gripper`), which explains them.

    Attributes:
        mount_frame: frame by which the gripper is carried.
        grasp_frame: frame in the middle between the pads.
        tip_frame: frame by which the gripper is led where it pushes: in the middle of the fingers'
            ends, with z along the fingers, and y along the way in which they close; null
            of a gripper that does not push.
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
    tip_frame: Annotated[Name | None, Field(description="a name, or null")] = None
    fingers: Annotated[
        tuple[str, ...], Strict(False), Field(min_length=2, description="names of bodies")
    ]
    max_force: Positive = Gripper.max_force
    closing_speed: Positive = Gripper.closing_speed
    coupling: Positive = FINGER_COUPLING
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


MeasuresType = TypeVar("MeasuresType", bound=_Measures)


def read_measures(path: Path, schema: type[MeasuresType]) -> MeasuresType:
    """Reads a robot.yaml, finger.yaml or gripper.yaml.

    Raises:
        ScenarioError: the file cannot be read, or holds what will not do. The message names the
            file, the field and the expected form.
    """
    return check_mapping(
        path, read_mapping(path, f"{path.stem} measures", ScenarioError), schema, ScenarioError
    )

"""`PushScenario`: all that a station is made from, with a default for every field.

These classes say what each field means and which values it may have, and refuse all others. The
camera's fields are in `station.schema.camera_config`, those of a section that one task alone needs
beside that task (`station.schema.task_table`), and the kinds of values in
`station.schema.fields`. How a scenario's YAML file is found, read and written is in
`station.schema.scenario_file`. Whether a scenario makes sense as a whole is decided in
`station.scene.resolve`.

Lengths are in m, angles in rad, times in s, masses in kg. Poses (x, y, theta) are those of the
object's body frame B in the world frame W, whose plane z = 0 is the top of the table. The
description of each field is what a message says that the field should hold.
"""

from dataclasses import dataclass, field, replace
from math import radians
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import BeforeValidator, Field, InstanceOf, PrivateAttr, ValidationError
from pydrake.common.yaml import yaml_dump as dump_tagged
from pydrake.common.yaml import yaml_load_typed
from pydrake.multibody.parsing import AddDirectives, ModelDirective

from gridpush_drake.errors import ScenarioError
from gridpush_drake.multibody.ground_truth import (
    CELL_MASS_RANGE,
    CONTACT_FRICTION_RANGE,
    FRICTION_RANGE,
    Support,
)
from gridpush_drake.station.robot.measures import Packages, PusherKind
from gridpush_drake.station.schema.camera_config import CameraConfig
from gridpush_drake.station.schema.fields import (
    MAX_SIZE,
    MIN_SIZE,
    RANGE_DESCRIPTION,
    YAML_REFUSALS,
    Config,
    Delay,
    Increasing,
    Interval,
    Number,
    Pair,
    Point,
    Pose,
    Positive,
    Range,
    check_keys,
    not_negative,
    positive,
    whole,
    within,
)
from gridpush_drake.station.schema.task_table import add_task_sections
from gridpush_drake.yaml_file import explain, list_expected

CURRENT_VERSION = 1
"""Version of the schema. A scenario file of another version is refused."""

DEFAULT_SCENE = "package://gridpush_drake/scenes/iiwa_push.dmd.yaml"
"""The scene of a scenario that names none: an iiwa with a finger at a table."""

MAX_RETREAT = 0.1
"""Greatest distance that a stopped arm may be told to go back, m."""

MAX_RIM_GAP = 0.002
"""Greatest height of an object's underside above the table, m. Beyond it the object would rock so
far that no press at the edge tells anything."""

MAX_SEED = 2**63 - 1
"""Greatest seed: seeds are kept as 64-bit integers."""

MIN_POKE = 0.01
"""Least path of a push that explores, m. `RandomPokeOptions` makes no push that moves the object
less."""


class FingerConfig(Config):
    """The finger that pushes.

    Attributes:
        push_height: height of the tip's center above the table while it pushes, m.
        travel_height: height of the tip's center above the table while it passes over objects, m.
        opening: how far the gripper's fingers are apart where they push (`pusher: fingertips`), m;
            null for half of what the gripper opens.
    """

    push_height: Annotated[Number, positive("m")] = 0.012
    travel_height: Annotated[Number, positive("m")] = 0.12
    opening: Annotated[
        Number | None,
        Field(
            ge=MIN_SIZE,
            le=MAX_SIZE,
            description=f"a positive number, in m, from {MIN_SIZE:g} to {MAX_SIZE:g}, or null",
        ),
    ] = None


class PokeConfig(Config):
    """The pushes that explore, and those held out to test what was learned.

    Attributes:
        count: number of pushes to learn from.
        test_count: number of pushes afterwards, which are only predicted.
        distance: [least, greatest] length of the tip's path in a push to learn from, m.
        test_distance: length of the tip's path in a test push, m.
        speed: speed of the tip in a push, m/s.
        slant: greatest angle between a push and the normal of the object's outline, rad.
        clearance: distance between tip and object where a push begins, m.
    """

    count: Annotated[int, whole(1)] = 8
    test_count: Annotated[int, whole(0)] = 6
    distance: Annotated[
        Pair,
        Field(description=f"[least, greatest], positive, in m, from {MIN_POKE:g} to {MAX_SIZE:g}"),
        Increasing,
        within(MIN_POKE, MAX_SIZE),
    ] = [0.06, 0.10]
    test_distance: Annotated[Number, positive("m", low=MIN_POKE)] = 0.10
    speed: Annotated[Number, positive("m/s", low=1e-4)] = 0.03
    slant: Annotated[
        Number,
        Field(ge=0, lt=radians(90), description="an angle from 0 to less than pi / 2, in rad"),
    ] = radians(30)
    clearance: Annotated[Number, not_negative("m")] = 0.008


class GoalConfig(Config):
    """The goal to which the object is pushed.

    Attributes:
        pose: [x, y, theta] of B in W at the goal, m and rad.
        tolerance: the goal is reached once the mean distance of the object's cells from where they
            should be is less than this, m. Where several objects are rearranged, it is the distance
            of each object's cells' centroid, and its turn from the goal is at most 10 rad/m times
            this.
        max_pushes: number of pushes after which the robot gives up.
    """

    pose: Pose = [0.6, 0.15, 2.5]
    tolerance: Annotated[Number, positive("m")] = 0.02
    max_pushes: Annotated[int, whole(1)] = 25


class PreGraspConfig(Config):
    """How the object is slid to the table's edge and grasped there.

    Attributes:
        margin: least distance that the center of mass must have from where the object would tip,
            wherever it may be by what was learned, m.
        min_pokes: number of pokes made before the object is slid, as long as one keeps it on the
            table.
        max_pokes: number of pokes after which the robot gives up.
        max_slides: number of slides after which the robot gives up.
        max_arm: greatest distance of the grasp from the estimated center of mass, m.
        force: force with which the gripper presses, N; less if the gripper cannot give as much.
        lift: height to which the object is lifted, m.
        hold: time for which the object is held up, s.
    """

    margin: Annotated[Number, positive("m")] = 0.003
    min_pokes: Annotated[int, whole(1)] = 3
    max_pokes: Annotated[int, whole(1)] = 12
    max_slides: Annotated[int, whole(1)] = 20
    max_arm: Annotated[Number, positive("m")] = 0.1
    force: Annotated[Number, positive("N")] = 80.0
    lift: Annotated[Number, positive("m")] = 0.1
    hold: Annotated[Number, positive("s", high=3600.0)] = 3.0


class TiltTestConfig(Config):
    """How the object is pressed at the table's edge and weighed, and how the arm feels forces.

    It has an effect only if the robot is told nothing of the object (`unknown_inertia`). A press
    ends at 80 % of `safety.force` at the latest.

    Attributes:
        max_presses: number of presses that tilted the object after which no more are made.
        force_noise: standard deviation of each sample of a simulated arm's forces, told from its
            joints' torques, per axis, N.
        torque_noise: standard deviation of each sample of the torque about the gripper's pads, per
            axis, N m.
        force_offset: standard deviation of the offset of these forces, which is drawn once for a
            run, N.
        torque_offset: standard deviation of the offset of these torques, N m.
    """

    max_presses: Annotated[int, whole(1)] = 8
    force_noise: Annotated[Number, not_negative("N")] = 0.2
    torque_noise: Annotated[Number, not_negative("N m")] = 0.02
    force_offset: Annotated[Number, not_negative("N")] = 0.5
    torque_offset: Annotated[Number, not_negative("N m")] = 0.05


class PartTruth(Config):
    """True values for a part of the object, instead of a random draw.

    Attributes:
        label: number of the part, as in the object's file.
        cell_mass: mass of each of its cells, kg; null to draw it.
        friction: coefficient of friction of its cells against the table; null to draw it.
    """

    label: Annotated[int, whole(1)] = 1
    cell_mass: Annotated[
        Positive | None, Field(description="a positive number, in kg, or null")
    ] = None
    friction: Annotated[Positive | None, Field(description="a positive number, or null")] = None


class TruthConfig(Config):
    """The object's true parameters, which only the simulated world knows.

    They are drawn from the scenario's seed, one value for each part of the object.

    Attributes:
        cell_mass: [least, greatest] mass of a cell, in any unit: all masses are scaled so that
            together they are the object's total mass.
        total_mass: [least, greatest] mass of the object, kg, of which one is drawn, evenly in its
            logarithm; null for the mass in the object's file.
        friction: [least, greatest] coefficient of friction of a cell against the table.
        contact_friction: [least, greatest] coefficient of friction of the finger against the
            object.
        friction_by_part: whether each part has a friction of its own; otherwise one is drawn for
            all parts. Slow pushes cannot tell a heavy part from a rough one: if both vary, the
            center of mass cannot be learned.
        support: how a free object stands on the table. "own_weight": each cell bears its own
            weight, as the model assumes; "foundation": the object's bottom is compliant, evenly;
            "three_feet": it stands on three feet, at places that are drawn from the seed;
            "vertices": on uneven feet at the vertices of its outline's hull.
        rim_gap: height of the underside above the table, m, of an object on three feet or on its
            vertices; feet at the vertices are uneven by up to as much. An object that is pressed at
            the table's edge first rocks on its feet, until its underside meets the edge.
        parts: true values that are given instead of drawn. Masses given here are not scaled.
    """

    cell_mass: Annotated[Range, Field(description=RANGE_DESCRIPTION)] = list(CELL_MASS_RANGE)
    total_mass: Annotated[Range | None, Field(description=f"{RANGE_DESCRIPTION}, or null")] = None
    friction: Annotated[Range, Field(description=RANGE_DESCRIPTION)] = list(FRICTION_RANGE)
    contact_friction: Annotated[Range, Field(description=RANGE_DESCRIPTION)] = list(
        CONTACT_FRICTION_RANGE
    )
    friction_by_part: Annotated[bool, Field(description="true or false")] = False
    support: Annotated[Support, Field(description=f"one of {', '.join(get_args(Support))}")] = (
        "own_weight"
    )
    rim_gap: Annotated[Number, not_negative("m", high=MAX_RIM_GAP)] = 0.0
    parts: Annotated[list[PartTruth], Field(description="a list of parts, each with a label")] = []


class SimulationConfig(Config):
    """How the world is simulated.

    Attributes:
        time_step: time step of the plant, s.
        stiction_tolerance: speed below which the plant takes a contact for sticking, m/s.
        answer_delay: simulated time that learning and planning take, s. With 0 the simulation
            waits for them, and their answer is there in the same step. With more they go on beside
            the simulation, which waits for them only when the delay is over, so that a run is the
            same every time. With null, for real time, the simulation never waits: the last answer
            holds until the next one comes.
    """

    time_step: Annotated[Number, positive("s", low=1e-5, high=0.1)] = 0.002
    stiction_tolerance: Annotated[Number, positive("m/s", low=1e-9)] = 1e-4
    answer_delay: Annotated[
        Delay | None, Field(description="a number of seconds, 0 or more, or null")
    ] = 0.0


class SafetyConfig(Config):
    """Limits beyond which a real arm is stopped; see `ArmGuard`. If a joint slides, read m for rad.

    Attributes:
        status_age: greatest age of the robot's last status, s; beyond it the arm is stopped.
        command_age: greatest age of the last command, s; beyond it a twin brings the arm to rest,
            see `CommandRamp`.
        clock_jump: how far a message's time may be ahead of its sender's clock, s; a message from
            further in the future is left out, see `station.links.channel`.
        acceleration: greatest acceleration of a joint in the commands, rad/s².
        torque_share: greatest torque on a joint from outside, as a fraction of what the joint can
            give; beyond it the arm is stopped and goes back along the way that it has come.
        force: greatest force on the finger's tip, N; beyond it the arm is stopped and goes back
            along the way that it has come.
        retreat: farthest that the finger's tip travels back after a torque or a force over its
            limit, m; 0 for not at all.
        following_error: how far a joint may be measured from all positions that it was told within
            the last `following_time`, rad; farther off for longer than that, the arm is stopped.
            Healthy arms in simulation are at most 0.0015 rad off.
        following_time: how long a joint may be farther off than that, s; and how late it may come
            without being off at all. Healthy arms in simulation are 0.015 s late.
        pose_jump: farthest that the object may be seen to move from one look to the next, m; beyond
            it the arm is stopped.
        pose_turn: farthest that the object may be seen to turn from one look to the next, rad;
            beyond it the arm is stopped.
        margin: how far beyond workspace and home the finger's tip may be, m; beyond it the arm is
            stopped.
    """

    status_age: Annotated[Number, positive("s")] = 0.05
    command_age: Annotated[Number, positive("s")] = 0.01
    clock_jump: Annotated[Number, positive("s")] = 0.1
    acceleration: Annotated[Number, positive("rad/s²")] = 10.0
    torque_share: Annotated[Number, positive("of the joint's own", high=1.0)] = 0.1
    force: Annotated[Number, positive("N")] = 30.0
    retreat: Annotated[Number, not_negative("m", high=MAX_RETREAT)] = 0.01
    following_error: Annotated[Number, positive("rad")] = 0.02
    following_time: Annotated[Number, positive("s", high=1.0)] = 0.05
    pose_jump: Annotated[Number, positive("m")] = 0.03
    pose_turn: Annotated[Number, positive("rad")] = 0.3
    margin: Annotated[Number, not_negative("m")] = 0.1


class WorkspaceConfig(Config):
    """The box in which the finger's tip may move, frame W.

    Attributes:
        x: [least, greatest], m.
        y: [least, greatest], m.
    """

    x: Interval = [0.42, 0.8]
    y: Interval = [-0.4, 0.4]


Section = TypeVar("Section", bound=Config)


def _read_directives(data: Any) -> Any:
    """Makes Drake's model directives of YAML data.

    A directive that is made already stays as it is. So does what is no list, for pydantic to refuse
    with a message that says what was expected.
    """
    if not isinstance(data, list):
        return data
    return [
        item if isinstance(item, ModelDirective) else _read_directive(item, at)
        for at, item in enumerate(data)
    ]


def _read_directive(data: Any, at: int) -> ModelDirective:
    """Makes one of Drake's model directives of YAML data, the one at an index, from 0."""
    check_keys(data, ModelDirective, f"directives[{at}]")
    try:
        directive: ModelDirective = yaml_load_typed(schema=ModelDirective, data=dump_tagged(data))
    except YAML_REFUSALS as error:
        raise ScenarioError(f"directives: {' '.join(str(error).split())}") from error
    return directive


def _default_directives() -> list[ModelDirective]:
    """Makes the directives of a scenario that names none."""
    return [ModelDirective(add_directives=AddDirectives(file=DEFAULT_SCENE))]


class OtherConfig(Config):
    """Another object on the table: a free body. Only tasks with several objects push it.

    Attributes:
        object: name of a shipped object, or an object file, relative to the scenario's own file.
        pose: [x, y, theta] of its body frame in W at the beginning, m and rad.
        height: height of the object, m.
        goal: [x, y, theta] of its body frame in W where it should lie at last, m and rad; null if
            it may lie anywhere. Only the task to rearrange objects asks for it.
        parts: true values that are given instead of drawn, as in `truth.parts`.
    """

    object: Annotated[
        str, Field(pattern=r"\S", description="the name of a shipped object or of an object file")
    ]
    pose: Pose
    height: Annotated[Number, positive("m")] = 0.03
    goal: Annotated[Pose | None, Field(description="[x, y, theta], m and rad, or null")] = None
    parts: Annotated[list[PartTruth], Field(description="a list of parts, each with a label")] = []


class ObjectConfig(OtherConfig):
    """One of several objects on the table, in a scenario's `objects`.

    Attributes:
        wanted: whether the task is about this object: it is learned, fetched and grasped, and
            becomes the scenario's `object`. If none is wanted, the first one is.
    """

    wanted: Annotated[bool, Field(description="true or false")] = False


SINGLE_OBJECT_FIELDS = {
    "object": "object",
    "pose": "object_pose",
    "height": "object_height",
    "goal": "goal.pose",
    "parts": "truth.parts",
}
"""Fields of a scenario that say of the pushed object what those of an `OtherConfig` say of others,
by the names of the latter."""


@dataclass(frozen=True)
class ObjectNames:
    """The names by which whoever wrote a scenario knows its objects, for messages.

    They have no part in a comparison: two scenarios that say the same in different forms are equal.

    Attributes:
        places: for each object its place in `objects`, the pushed one first and then the others in
            their order; empty if the scenario was not written with `objects`.
        elsewhere: those of the pushed object's fields that were not given in `objects`, such as
            "goal" if that stands as `goal.pose`.
        has_no_goal: whether the scenario was written with `objects`, and says nowhere where the
            pushed object should come.
    """

    places: tuple[int, ...] = field(default=(), compare=False)
    elsewhere: tuple[str, ...] = field(default=(), compare=False)
    has_no_goal: bool = field(default=False, compare=False)

    def name_object(self, number: int) -> str:
        """Names an object: `object`, `others[0]`, or `objects[1]`; `number` is 0 for the pushed."""
        if self.places:
            return f"objects[{self.places[number]}]"
        return "object" if number == 0 else f"others[{number - 1}]"

    def name_rest(self) -> str:
        """Names the field in which the other objects are given, or would be."""
        return "objects" if self.places else "others"

    def name_others(self, number: int) -> list[str]:
        """Names so many other objects, as `name_object` does."""
        return [self.name_object(1 + at) for at in range(number)]

    def name_field(self, number: int, name: str) -> str:
        """Names a field of an object, such as `object_pose`, `others[0].pose`, `objects[1].pose`.

        Args:
            number: 0 for the pushed object, 1 for the first of the others, and so on.
            name: the field's name in `OtherConfig`.
        """
        if number == 0 and (not self.places or name in self.elsewhere):
            return SINGLE_OBJECT_FIELDS[name]
        return f"{self.name_object(number)}.{name}"


class PostConfig(Config):
    """A round post that is fixed on the table: an obstacle.

    Attributes:
        position: [x, y] of its axis in W, m.
        radius: radius of the post, m.
        height: height of the post, m; the finger passes over it.
    """

    position: Annotated[Point, Field(description=f"[x, y], in m, at most {MAX_SIZE:g}")]
    radius: Annotated[Number, positive("m", low=1e-3)] = 0.02
    height: Annotated[Number, positive("m", low=1e-3)] = 0.06


class ScatterConfig(Config):
    """How far objects lie from their poses in the scenario, drawn anew for each seed.

    Attributes:
        distance: greatest distance of an object's origin from where the scenario has it, along x
            and along y, m.
        turn: greatest angle by which it is turned from there, rad.
    """

    distance: Annotated[Number, not_negative("m")] = 0.0
    turn: Annotated[Number, not_negative("rad")] = 0.0


@add_task_sections
class PushScenario(Config):
    """An object, the scene it lies in, and what is to be done with it.

    Besides these fields it has the section of each task that declares one, under the task's name.

    Attributes:
        version: version of the schema.
        object: name of a shipped object, or an object file, relative to the scenario's own file.
        object_pose: [x, y, theta] of B in W at the beginning, m and rad.
        object_height: height of the object, m. If a command names another object with `--object`,
            the height in that object's file is taken, if it has one.
        object_friction: [least, greatest] coefficient of friction of the object's cells against the
            table, as it is known beforehand. The object's file may bound it, too; then both hold.
            The narrower the range, the better the pushes show where the mass is. null to leave it
            to the file.
        unknown_inertia: whether the robot is told nothing of the object but its outline: neither
            mass nor center of mass nor friction, so that `object_friction` has no effect. The
            pre-grasp task then weighs the object at the table's edge where it would have to give
            up.
        base: "free": the object can tip and be lifted; "planar": it only slides and turns, and
            each cell bears exactly its own weight.
        pusher: "finger": the round tip of a finger pushes; "gripper": the robot's closed gripper,
            which points down and has no finger beside it; "fingertips": both fingers of the
            gripper, which is held open.
        finger: heights at which the finger, or the gripper, pushes and travels.
        pokes: the pushes that explore, and those that test.
        camera: how the robot sees the object.
        truth: true masses and frictions of the object.
        simulation: how the world is simulated.
        workspace: where the finger's tip may be.
        goal: goal of the task to push the object somewhere.
        pregrasp: how the object is slid to the table's edge and grasped, in the task to do this.
            Its scene has a gripper.
        weighing: how the object is weighed at the table's edge, if nothing is told of it.
        safety: limits beyond which a real arm is stopped.
        others: other objects on the table, around which pushes are planned, or which are pushed,
            too, in a task with several objects; see `station.scene.other_objects`.
        scatter: how far all objects lie from their poses in the scenario, drawn from its seed; see
            `station.scene.scatter`.
        posts: posts fixed on the table, around which pushes are planned; see `station.scene.posts`.
        objects: all objects in one list, instead of `object`, `object_pose`, `object_height` and
            `others`: the wanted one takes the place of the first three, and the rest are the
            others, in their order.
        seed: seed of everything random.
        directives: all models in the scene but the objects, as Drake's model directives: a robot
            with a finger, see `station.robot.robot`, and a model with the name `table`.
        packages: folders of the packages that `package://NAME/...` in directives and models names,
            by name; each is a path relative to the scenario's file.

    Raises:
        ScenarioError: a field is unknown, or holds what will not do.
    """

    version: Annotated[int, Field(description="a whole number")] = CURRENT_VERSION
    object: Annotated[
        str, Field(pattern=r"\S", description="the name of a shipped object or of an object file")
    ] = "claw_hammer"
    object_pose: Pose = [0.6, 0.0, 0.0]
    object_height: Annotated[Number, positive("m")] = 0.03
    object_friction: Annotated[Range | None, Field(description=f"{RANGE_DESCRIPTION}, or null")] = (
        None
    )
    unknown_inertia: Annotated[bool, Field(description="true or false")] = False
    base: Annotated[Literal["free", "planar"], Field(description="one of free, planar")] = "free"
    pusher: Annotated[PusherKind, Field(description="one of finger, gripper, fingertips")] = (
        "finger"
    )
    finger: FingerConfig = FingerConfig()
    pokes: PokeConfig = PokeConfig()
    camera: CameraConfig = CameraConfig()
    truth: TruthConfig = TruthConfig()
    simulation: SimulationConfig = SimulationConfig()
    workspace: WorkspaceConfig = WorkspaceConfig()
    goal: GoalConfig = GoalConfig()
    pregrasp: PreGraspConfig = PreGraspConfig()
    weighing: TiltTestConfig = TiltTestConfig()
    safety: SafetyConfig = SafetyConfig()
    others: Annotated[
        list[OtherConfig], Field(description="a list of objects, each with a pose")
    ] = []
    posts: Annotated[
        list[PostConfig], Field(description="a list of posts, each with a position")
    ] = []
    scatter: ScatterConfig = ScatterConfig()
    objects: Annotated[
        list[ObjectConfig], Field(description="a list of objects, each with a pose")
    ] = []
    seed: Annotated[int, whole(0, MAX_SEED)] = 0
    directives: Annotated[
        list[InstanceOf[ModelDirective]],
        BeforeValidator(_read_directives),
        Field(
            default_factory=_default_directives, description="a list of Drake's model directives"
        ),
    ]
    packages: Packages = {}
    _names: ObjectNames = PrivateAttr(default_factory=ObjectNames)

    def __init__(self, **fields: Any) -> None:
        """Takes the fields by name."""
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise ScenarioError(explain(error, EXPECTED_FIELDS, RENAMED_KEYS)) from error
        if self.objects:
            self._take_objects(fields)

    def _take_objects(self, fields: dict[str, Any]) -> None:
        """Makes `object` and `others` of the list of all objects.

        Raises:
            ScenarioError: the same is said in both forms, or more than one object is wanted.
        """
        for name in ONE_OBJECT:
            if name in fields:
                raise ScenarioError(f"objects and {name} are both given; expected one of them")
        wanted = [at for at, each in enumerate(self.objects) if each.wanted]
        if len(wanted) > 1:
            raise ScenarioError(
                f"objects[{wanted[1]}].wanted is true, and so is objects[{wanted[0]}].wanted; "
                "expected one wanted object at most"
            )
        first = wanted[0] if wanted else 0
        listed = self.objects
        self.object = listed[first].object
        self.object_pose = listed[first].pose
        self.object_height = listed[first].height
        if listed[first].goal is not None:
            self.goal = self.goal.model_copy(update={"pose": listed[first].goal})
        if listed[first].parts:
            self.truth = self.truth.model_copy(update={"parts": listed[first].parts})
        rest = [at for at in range(len(listed)) if at != first]
        self.others = [
            OtherConfig(**{name: getattr(listed[at], name) for name in OtherConfig.model_fields})
            for at in rest
        ]
        self._names = ObjectNames(
            places=(first, *rest),
            elsewhere=tuple(
                name
                for name, place in (("goal", "goal"), ("parts", "truth"))
                if place in fields and not getattr(listed[first], name)
            ),
            has_no_goal=listed[first].goal is None and "goal" not in fields,
        )
        self.objects = []

    @property
    def names(self) -> ObjectNames:
        """The names by which messages call the objects: those that the scenario was written with.

        A scenario that was written with `objects` keeps their places there.
        """
        return self._names

    def section(self, kind: type[Section]) -> Section:
        """Returns the section of a kind, such as one that a task declares."""
        return next(each for _, each in self if isinstance(each, kind))

    def replace_object(self, name: str) -> None:
        """Puts a shipped object, or that of an object file, in the place of the pushed one."""
        self.object = name
        self._names = replace(self._names, elsewhere=(*self._names.elsewhere, "object"))

    def check(self) -> None:
        """Checks all fields again: they may have been changed since the scenario was made.

        Raises:
            ScenarioError: a field holds what will not do.
        """
        PushScenario(**dict(self))


ONE_OBJECT = ("object", "object_pose", "object_height", "others")
"""Fields that say in another form what `objects` says."""

EXPECTED_FIELDS = list_expected(PushScenario)
"""What each field should hold, in words, by the field's place, such as "finger.push_height"."""

RENAMED_KEYS = {
    "finger.tip_radius": "is no longer a scenario's; "
    "it stands as tip_radius in finger.yaml beside the finger's model"
}
"""What became of keys that older scenarios had, for the message that refuses them."""

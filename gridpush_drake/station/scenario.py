"""`PushScenario`: all that a station is made from, with a default for every field.

These classes say what each field means and which values it may have, and refuse all others. How a
scenario's YAML file is found, read and written is in `station.scenario_file`.

Lengths are in m, angles in rad, times in s, masses in kg. Poses (x, y, theta) are the object's body
frame B in the world frame W, whose plane z = 0 is the top of the table. Each field's description is
what a message says it should hold. Whether a scenario makes sense as a whole is
`station.resolve`'s to say.
"""

from collections.abc import Mapping
from math import radians
from typing import Annotated, Any, Literal, get_args

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    InstanceOf,
    PlainSerializer,
    ValidationError,
)
from pydrake.common.yaml import yaml_dump as dump_tagged
from pydrake.common.yaml import yaml_dump_typed, yaml_load_data, yaml_load_typed
from pydrake.multibody.parsing import AddDirectives, ModelDirective
from pydrake.systems.sensors import CameraConfig as DrakeCameraConfig

from gridpush_drake.errors import ScenarioError
from gridpush_drake.multibody.ground_truth import (
    CELL_MASS_RANGE,
    CONTACT_FRICTION_RANGE,
    FRICTION_RANGE,
    Support,
)
from gridpush_drake.yaml_file import (
    explain,
    list_expected,
    shorten,
    suggest,
)

CURRENT_VERSION = 1
"""Of the schema; a scenario of another one is refused."""

DEFAULT_SCENE = "package://gridpush_drake/scenes/iiwa_push.dmd.yaml"

MIN_SIZE, MAX_SIZE = 1e-6, 1e4
"""Least and greatest of a positive number whose field says nothing else, in SI units."""

MAX_COUNT = 10_000
"""Of pushes and the like."""

MAX_RETREAT = 0.1
"""Farthest that a stopped arm may be told to go back, m."""

MAX_SEED = 2**63 - 1

MIN_POKE = 0.01
"""Least path of a push that explores, m: as far as it must move the object to be made
(`RandomPokeOptions`)."""

REFUSALS = (RuntimeError, TypeError, ValueError, AssertionError, AttributeError, yaml.YAMLError)
"""What Drake's reader of typed YAML raises."""


def _read_number(value: Any) -> Any:
    """A number may stand in quotes."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


Number = Annotated[float, BeforeValidator(_read_number)]


MAX_DELAY = 60.0
"""s, of an answer."""


def _positive(unit: str, low: float = MIN_SIZE, high: float = MAX_SIZE) -> Any:
    return Field(
        ge=low, le=high, description=f"a positive number, in {unit}, from {low:g} to {high:g}"
    )


def _not_negative(unit: str) -> Any:
    return Field(
        ge=0, le=MAX_SIZE, description=f"a number, 0 or more, in {unit}, at most {MAX_SIZE:g}"
    )


def _count(low: int, high: int = MAX_COUNT) -> Any:
    return Field(ge=low, le=high, description=f"a whole number, {low} or more, at most {high}")


def _is_increasing(values: list[float]) -> list[float]:
    if not values[0] <= values[1]:
        raise ValueError
    return values


def _is_interval(values: list[float]) -> list[float]:
    if not values[0] < values[1]:
        raise ValueError
    return values


def _is_within(low: float, high: float) -> AfterValidator:
    def check(values: list[float]) -> list[float]:
        if not all(low <= value <= high for value in values):
            raise ValueError
        return values

    return AfterValidator(check)


Delay = Annotated[Number, Field(ge=0, le=MAX_DELAY)]

Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]

Range = Annotated[Pair, AfterValidator(_is_increasing), _is_within(MIN_SIZE, MAX_SIZE)]
"""[least, greatest] of something positive."""

RANGE = f"[least, greatest], positive, from {MIN_SIZE:g} to {MAX_SIZE:g}"

Pose = Annotated[
    list[Number],
    Field(
        min_length=3, max_length=3, description=f"[x, y, theta], in m and rad, at most {MAX_SIZE:g}"
    ),
    _is_within(-MAX_SIZE, MAX_SIZE),
]

Point = Annotated[
    list[Number],
    Field(min_length=3, max_length=3, description=f"[x, y, z], in m, at most {MAX_SIZE:g}"),
    _is_within(-MAX_SIZE, MAX_SIZE),
]

Interval = Annotated[
    Pair,
    Field(description=f"[least, greatest], in m, at most {MAX_SIZE:g}"),
    AfterValidator(_is_interval),
    _is_within(-MAX_SIZE, MAX_SIZE),
]

Positive = Annotated[Number, Field(ge=MIN_SIZE, le=MAX_SIZE)]


class _Config(BaseModel):
    """A part of a scenario; it can be changed, and is checked again by whoever takes it."""

    model_config = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, revalidate_instances="always"
    )


class FingerConfig(_Config):
    """The finger that pushes.

    Attributes:
        push_height: of the tip's center while it pushes, m.
        travel_height: of the tip's center while it passes over the object, m.
    """

    push_height: Annotated[Number, _positive("m")] = 0.012
    travel_height: Annotated[Number, _positive("m")] = 0.12


class PokeConfig(_Config):
    """The pushes that explore, and those held out to test what was learned.

    Attributes:
        count: pushes to learn from.
        test_count: pushes afterwards, which are only predicted.
        distance: [least, greatest] path of a push, m.
        test_distance: path of a test push, m.
        speed: of the tip, m/s.
        slant: furthest from the outline's normal, rad.
        clearance: between tip and object where a push begins, m.
    """

    count: Annotated[int, _count(1)] = 8
    test_count: Annotated[int, _count(0)] = 6
    distance: Annotated[
        Pair,
        Field(description=f"[least, greatest], positive, in m, from {MIN_POKE:g} to {MAX_SIZE:g}"),
        AfterValidator(_is_increasing),
        _is_within(MIN_POKE, MAX_SIZE),
    ] = [0.06, 0.10]
    test_distance: Annotated[Number, _positive("m", low=MIN_POKE)] = 0.10
    speed: Annotated[Number, _positive("m/s", low=1e-4)] = 0.03
    slant: Annotated[
        Number,
        Field(ge=0, lt=radians(90), description="an angle from 0 to less than pi / 2, in rad"),
    ] = radians(30)
    clearance: Annotated[Number, _not_negative("m")] = 0.008


class GoalConfig(_Config):
    """Where to push the object to.

    Attributes:
        pose: [x, y, theta] of B in W at the goal, m and rad.
        tolerance: mean distance of the cells from where they should be at which it is reached, m.
        max_pushes: made before giving up.
    """

    pose: Pose = [0.6, 0.15, 2.5]
    tolerance: Annotated[Number, _positive("m")] = 0.02
    max_pushes: Annotated[int, _count(1)] = 25


class PreGraspConfig(_Config):
    """How the object is slid to the table's edge and grasped there.

    Attributes:
        margin: least distance of the center of mass, at its worst, from where the object would tip,
            m.
        min_pokes: made in any case before it slides.
        max_pokes: made before giving up.
        max_slides: made before giving up.
        max_arm: farthest that the gripper may take it from its estimated center of mass, m.
        force: of the gripper, N.
        lift: height, m.
        hold: how long it is held up, s.
    """

    margin: Annotated[Number, _positive("m")] = 0.003
    min_pokes: Annotated[int, _count(1)] = 3
    max_pokes: Annotated[int, _count(1)] = 12
    max_slides: Annotated[int, _count(1)] = 20
    max_arm: Annotated[Number, _positive("m")] = 0.1
    force: Annotated[Number, _positive("N")] = 80.0
    lift: Annotated[Number, _positive("m")] = 0.1
    hold: Annotated[Number, _positive("s", high=3600.0)] = 3.0


RGBD: dict[str, Any] = {
    "width": 640,
    "height": 480,
    "focal": {"y": 42.0, "_tag": "!FovDegrees"},
    "clipping_near": 0.1,
    "clipping_far": 5.0,
    "z_near": 0.1,
    "z_far": 5.0,
    "X_PB": {
        "translation": [0.6, -0.38, 1.0],
        "rotation": {"deg": [-162.768, 0.0, 1.848], "_tag": "!Rpy"},
    },
    "background": {"rgba": [0.30, 0.31, 0.33, 1.0]},
    "output_delay": 0.0,
}
"""What the camera is where a scenario does not say it: beside the table, looking down on it
aslant."""

RENAMED_RGBD = {
    "fov_y": "is Drake's focal now; expected focal: !FovDegrees {y: DEGREES}",
    "position": "is Drake's X_PB now; expected X_PB: {translation: [x, y, z], rotation: !Rpy {deg: [...]}}",
    "target": "is Drake's X_PB now; expected X_PB: {translation: [x, y, z], rotation: !Rpy {deg: [...]}}",
    "latency": "is Drake's output_delay now, in s",
    "fps": "is not read here; camera.rate says it, in Hz",
    **{
        name: f"stands above now; expected camera.{name}"
        for name in ("depth_noise", "depth_edge", "color_noise", "exposure_noise")
    },
}
"""What became of keys of old, and where Drake's CameraConfig has what stands elsewhere."""

RGBD_KEYS = (*RGBD, "center_x", "center_y", "X_BC", "X_BD")
"""Keys of Drake's CameraConfig that say something here: the renderer is the station's, and all
images are taken."""

MIN_SIDE, MAX_SIDE = 64, 4096
"""Of a picture, pixels."""


def _read_rgbd(data: Any) -> DrakeCameraConfig:
    """Makes Drake's CameraConfig of what YAML has of it; one that is made already is checked again."""
    place = "camera.rgbd"
    data = _dump_rgbd(data) if isinstance(data, DrakeCameraConfig) else data
    for key in data if isinstance(data, dict) else ():
        if key in RENAMED_RGBD:
            raise ScenarioError(f"{place}.{key}: {RENAMED_RGBD[key]}")
    _check_keys(data, DrakeCameraConfig, place)
    for key in data:
        if key not in RGBD_KEYS:
            raise ScenarioError(
                f"{place}.{key}: says nothing here; expected one of {', '.join(RGBD_KEYS)}"
            )
    try:
        config: DrakeCameraConfig = yaml_load_typed(
            schema=DrakeCameraConfig, data=dump_tagged(RGBD | data)
        )
        config.MakeCameras()
    except REFUSALS as error:
        raise ScenarioError(f"{place}: {' '.join(str(error).split())}") from error
    for name in ("width", "height"):
        if not MIN_SIDE <= getattr(config, name) <= MAX_SIDE:
            side = getattr(config, name)
            raise ScenarioError(
                f"{place}.{name} is {side}; expected {MIN_SIDE} to {MAX_SIDE} pixels"
            )
    if not 0 <= config.output_delay <= MAX_DELAY:
        raise ScenarioError(
            f"{place}.output_delay is {config.output_delay}; expected 0 to {MAX_DELAY:g} s"
        )
    return config


def _dump_rgbd(config: DrakeCameraConfig) -> dict[str, Any]:
    """What YAML has of it, with tags under _tag, as Drake's own reader leaves them."""
    data = yaml_load_data(yaml_dump_typed(config, schema=DrakeCameraConfig))
    return {key: data[key] for key in RGBD_KEYS if key in data}


CameraKind = Literal["ideal", "rgbd"]

RGBD_RATE = 10.0
"""Pictures a second that `CameraConfig.use` leaves an rgbd camera at most, Hz: each takes long to
render."""


class CameraConfig(_Config):
    """What sees the object's pose. Its noise is drawn from the scenario's seed.

    Attributes:
        kind: "ideal": the pose as it is, with noise; "rgbd": pictures are rendered, the robot finds
            the object in the first one and its pose in all.
        rate: poses a second, Hz.
        position_noise: standard deviation per axis, m; of an ideal one.
        angle_noise: standard deviation, rad; of an ideal one.
        depth_noise: standard deviation of depth at a distance of 1 m, m; it grows with the distance
            squared.
        depth_edge: jump of depth between neighbors, m, at which depth is not measured.
        color_noise: standard deviation of a color's value, of 255.
        exposure_noise: standard deviation of a picture's exposure, a share.
        rgbd: the color and depth camera, as Drake's CameraConfig, of which RGBD_KEYS are read;
            `output_delay` is the time from a picture to its pose. `gridpush object --camera` reads
            the same.
    """

    kind: Annotated[CameraKind, Field(description="one of ideal, rgbd")] = "ideal"
    rate: Annotated[Number, _positive("Hz", low=0.1, high=1000.0)] = 30.0
    position_noise: Annotated[Number, _not_negative("m")] = 0.0005
    angle_noise: Annotated[Number, _not_negative("rad")] = radians(0.2)
    depth_noise: Annotated[Number, _not_negative("m")] = 0.0015
    depth_edge: Annotated[Number, _positive("m")] = 0.01
    color_noise: Annotated[Number, _not_negative("of 255")] = 2.0
    exposure_noise: Annotated[Number, _not_negative("a share")] = 0.02
    rgbd: Annotated[
        InstanceOf[DrakeCameraConfig],
        BeforeValidator(_read_rgbd),
        PlainSerializer(_dump_rgbd),
    ] = Field(default_factory=lambda: _read_rgbd({}), description="keys of Drake's CameraConfig")

    def use(self, kind: CameraKind) -> None:
        """Takes a camera of another kind in place of the scenario's."""
        self.kind = kind
        if kind == "rgbd":
            self.rate = min(self.rate, RGBD_RATE)


class PartTruth(_Config):
    """What a part of the object truly is, instead of a random draw.

    Attributes:
        label: of the part, as in the object's file.
        cell_mass: of each of its cells, kg; null where it is drawn.
        friction: of its cells against the table; null where it is drawn.
    """

    label: Annotated[int, _count(1)] = 1
    cell_mass: Annotated[
        Positive | None, Field(description="a positive number, in kg, or null")
    ] = None
    friction: Annotated[Positive | None, Field(description="a positive number, or null")] = None


class TruthConfig(_Config):
    """The object's true parameters, which only the simulated world knows. They are drawn by part from the seed.

    Attributes:
        cell_mass: [least, greatest] of a cell, relative: all are scaled to the object's total mass.
        friction: [least, greatest] of a cell against the table.
        contact_friction: [least, greatest] of the finger against the object.
        friction_by_part: whether each part has a friction of its own; else one draw does for all.
            Slow pushes cannot tell a heavy part from a rough one: where both vary, the center of
            mass cannot be learned.
        support: how a free object stands. "own_weight": each cell bears its own, as the model
            supposes; "foundation": on an evenly compliant bottom; "three_feet": on three feet at
            places drawn from the seed.
        parts: given instead of drawn; masses given here are not scaled.
    """

    cell_mass: Annotated[Range, Field(description=RANGE)] = list(CELL_MASS_RANGE)
    friction: Annotated[Range, Field(description=RANGE)] = list(FRICTION_RANGE)
    contact_friction: Annotated[Range, Field(description=RANGE)] = list(CONTACT_FRICTION_RANGE)
    friction_by_part: Annotated[bool, Field(description="true or false")] = False
    support: Annotated[Support, Field(description=f"one of {', '.join(get_args(Support))}")] = (
        "own_weight"
    )
    parts: Annotated[list[PartTruth], Field(description="a list of parts, each with a label")] = []


class SimulationConfig(_Config):
    """How the world is simulated.

    Attributes:
        time_step: of the plant, s.
        stiction_tolerance: speed below which the plant takes contacts for sticking, m/s.
        answer_delay: simulated, after which what takes long, learning and planning, is answered, s:
            0 in the same update, while the Diagram waits; otherwise beside the Diagram, which waits
            only when the delay is over, so that a run is the same every time. null for real time:
            outputs hold until the answer comes.
    """

    time_step: Annotated[Number, _positive("s", low=1e-5, high=0.1)] = 0.002
    stiction_tolerance: Annotated[Number, _positive("m/s", low=1e-9)] = 1e-4
    answer_delay: Annotated[
        Delay | None, Field(description="a number of seconds, 0 or more, or null")
    ] = 0.0


class SafetyConfig(_Config):
    """What stops a real arm; see `ArmGuard`. Where a joint slides, read m for rad.

    Attributes:
        status_age: greatest age of the robot's last status, s; beyond it the arm is stopped.
        command_age: greatest age of the last command, s; beyond it a twin brings the arm to rest,
            see `CommandRamp`.
        clock_jump: how far a message's time may be ahead of its sender's clock, s; a message from
            further in the future is left out, see `station.lcm.channel`.
        acceleration: greatest acceleration of a joint in the commands, rad/s².
        torque_share: greatest torque on a joint from outside, as a share of what the joint can
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

    status_age: Annotated[Number, _positive("s")] = 0.05
    command_age: Annotated[Number, _positive("s")] = 0.01
    clock_jump: Annotated[Number, _positive("s")] = 0.1
    acceleration: Annotated[Number, _positive("rad/s²")] = 10.0
    torque_share: Annotated[Number, _positive("of the joint's own", high=1.0)] = 0.1
    force: Annotated[Number, _positive("N")] = 30.0
    retreat: Annotated[
        Number,
        Field(
            ge=0, le=MAX_RETREAT, description=f"a number, 0 or more, in m, at most {MAX_RETREAT:g}"
        ),
    ] = 0.01
    following_error: Annotated[Number, _positive("rad")] = 0.02
    following_time: Annotated[Number, _positive("s", high=1.0)] = 0.05
    pose_jump: Annotated[Number, _positive("m")] = 0.03
    pose_turn: Annotated[Number, _positive("rad")] = 0.3
    margin: Annotated[Number, _not_negative("m")] = 0.1


class WorkspaceConfig(_Config):
    """The box in which the finger's tip may move, frame W.

    Attributes:
        x: [least, greatest], m.
        y: [least, greatest], m.
    """

    x: Interval = [0.42, 0.8]
    y: Interval = [-0.4, 0.4]


def _read_directives(data: Any) -> Any:
    """Makes Drake's model directives of YAML data; what already is one, or is no list, stays."""
    if not isinstance(data, list):
        return data
    return [
        item if isinstance(item, ModelDirective) else _read_directive(item, at)
        for at, item in enumerate(data)
    ]


def _read_directive(data: Any, at: int) -> ModelDirective:
    """Drake refuses what does not fit, but names neither the place nor the nearest known key."""
    _check_keys(data, ModelDirective, f"directives[{at}]")
    try:
        directive: ModelDirective = yaml_load_typed(schema=ModelDirective, data=dump_tagged(data))
    except REFUSALS as error:
        raise ScenarioError(f"directives: {' '.join(str(error).split())}") from error
    return directive


def _check_keys(data: Any, schema: Any, place: str) -> None:
    """Refuses a key that one of Drake's structs does not have."""
    if not isinstance(data, Mapping):
        raise ScenarioError(f"{place} is {shorten(data)}; expected `key: value` lines")
    types = {field.name: field.type for field in schema.__fields__}
    for key, value in data.items():
        if key not in types:
            raise ScenarioError(f"{place}.{key}: unknown key{suggest(str(key), list(types))}")
        choices = [kind for kind in get_args(types[key]) or (types[key],) if kind is not type(None)]
        if len(choices) == 1 and hasattr(kind := choices[0], "__fields__") and value is not None:
            _check_keys(value, kind, f"{place}.{key}")


def _default_directives() -> list[ModelDirective]:
    return [ModelDirective(add_directives=AddDirectives(file=DEFAULT_SCENE))]


class OtherConfig(_Config):
    """Another object on the table, a free body of which nothing is known beforehand and nothing is learned.

    Attributes:
        object: name of a shipped object, or an object file, relative to the scenario's own file.
        pose: [x, y, theta] of its body frame in W at the beginning, m and rad.
        height: its thickness, m.
    """

    object: Annotated[
        str, Field(pattern=r"\S", description="the name of a shipped object or of an object file")
    ]
    pose: Pose
    height: Annotated[Number, _positive("m")] = 0.03


class PushScenario(_Config):
    """An object, the scene it lies in, and what is to be done with it.

    Attributes:
        version: of the schema.
        object: name of a shipped object, or an object file, relative to the scenario's own file.
        object_pose: [x, y, theta] of B in W at the beginning, m and rad.
        object_height: thickness of the object, m; of another object (`use_object`) that which its
            file says.
        object_friction: [least, greatest] friction of any of its cells against the table, as it is
            known beforehand, beside what the object's file says: what both allow holds. The
            narrower, the better the pushes show where the mass is. null where the file says it all.
        base: "free": it can tip and be lifted; "planar": it slides and turns only, each cell's load
            being exact.
        finger: that pushes.
        pokes: how it pushes.
        camera: what sees the object.
        truth: what the object truly weighs and how it rubs.
        simulation: of the world.
        workspace: of the finger's tip.
        goal: where to push the object to, where that is the task.
        pregrasp: how to slide it to the edge and grasp it, where that is the task; the scene has a
            `gripper`.
        safety: what stops the arm, where it is a real one.
        others: further objects on the table, which pushes keep clear of, see `station.others`.
        seed: of everything random.
        directives: what stands in the scene besides the object, as Drake's model directives: a
            robot with a finger, see `station.robot`, and a model `table`.

    Raises:
        ScenarioError: a field is unknown, or holds what will not do.
    """

    version: Annotated[int, Field(description="a whole number")] = CURRENT_VERSION
    object: Annotated[
        str, Field(pattern=r"\S", description="the name of a shipped object or of an object file")
    ] = "claw_hammer"
    object_pose: Pose = [0.6, 0.0, 0.0]
    object_height: Annotated[Number, _positive("m")] = 0.03
    object_friction: Annotated[Range | None, Field(description=f"{RANGE}, or null")] = None
    base: Annotated[Literal["free", "planar"], Field(description="one of free, planar")] = "free"
    finger: FingerConfig = FingerConfig()
    pokes: PokeConfig = PokeConfig()
    camera: CameraConfig = CameraConfig()
    truth: TruthConfig = TruthConfig()
    simulation: SimulationConfig = SimulationConfig()
    workspace: WorkspaceConfig = WorkspaceConfig()
    goal: GoalConfig = GoalConfig()
    pregrasp: PreGraspConfig = PreGraspConfig()
    safety: SafetyConfig = SafetyConfig()
    others: Annotated[
        list[OtherConfig], Field(description="a list of objects, each with a pose")
    ] = []
    seed: Annotated[int, _count(0, MAX_SEED)] = 0
    directives: Annotated[
        list[InstanceOf[ModelDirective]],
        BeforeValidator(_read_directives),
        Field(
            default_factory=_default_directives, description="a list of Drake's model directives"
        ),
    ]

    def __init__(self, **fields: Any) -> None:
        """Takes the fields by name."""
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise ScenarioError(explain(error, EXPECTED, RENAMED)) from error

    def check(self) -> None:
        """Checks the fields again, which may have been changed. Raises ScenarioError as the constructor does."""
        PushScenario(**dict(self))


EXPECTED = list_expected(PushScenario)
"""What each field should hold, by its place."""

RENAMED = {
    "finger.tip_radius": "is no longer a scenario's; it stands as tip_radius in finger.yaml beside the finger's model"
}
"""What became of keys of old."""

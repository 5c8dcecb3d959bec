"""`PushScenario`: all that a station is made from, as one YAML document with a default for every field.

The classes are plain dataclasses as `pydrake.common.yaml` reads and writes them. Lengths are in m, angles in rad, times
in s, masses in kg. Poses (x, y, theta) are the object's body frame B in the world frame W, whose plane z = 0 is the top
of the table. Each field's metadata says what it should hold; `scenario_check` and `scenario_file` read it there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import isfinite, radians
from typing import Any

from pydrake.multibody.parsing import AddDirectives, ModelDirective

from gridpush_drake.multibody.ground_truth import CELL_MASS_RANGE, CONTACT_FRICTION_RANGE, FRICTION_RANGE

CURRENT_VERSION = 1
"""Of the schema; a scenario of another one is refused."""

DEFAULT_SCENE = "package://gridpush_drake/scenes/iiwa_push.dmd.yaml"

MIN_SIZE, MAX_SIZE = 1e-6, 1e4
"""Least and greatest of a positive number whose field says nothing else, in SI units."""

MAX_COUNT = 10_000
"""Of pushes and the like."""

MAX_SEED = 2**63 - 1

MIN_POKE = 0.01
"""Least path of a push that explores, m: as far as it must move the object to be made (`RandomPokeOptions`)."""

EXPECTED = "expected"
"""Key of a field's metadata: its `Expected`."""


@dataclass(frozen=True)
class Expected:
    """What a field should hold.

    Attributes:
        text: in words, for messages.
        holds: whether a value of the right type will do.
    """

    text: str
    holds: Callable[[Any], bool]


def _expecting(text: str, holds: Callable[[Any], bool], default: Any) -> Any:
    return field(default=default, metadata={EXPECTED: Expected(text, holds)})


def _positive(default: float, unit: str, low: float = MIN_SIZE, high: float = MAX_SIZE) -> Any:
    return _expecting(
        f"a positive number, in {unit}, from {low:g} to {high:g}", lambda value: low <= value <= high, default
    )


def _optional(unit: str) -> Any:
    """Positive, or None."""
    return _expecting(
        f"a positive number{unit}, or null", lambda value: value is None or MIN_SIZE <= value <= MAX_SIZE, None
    )


def _not_negative(default: float, text: str) -> Any:
    return _expecting(
        f"a number, 0 or more, {text}, at most {MAX_SIZE:g}", lambda value: 0 <= value <= MAX_SIZE, default
    )


def _count(default: int, least: int, greatest: int = MAX_COUNT) -> Any:
    return _expecting(
        f"a whole number, {least} or more, at most {greatest}", lambda value: least <= value <= greatest, default
    )


def _word(default: str, words: Sequence[str]) -> Any:
    return _expecting(f"one of {', '.join(words)}", lambda value: value in words, default)


def _range(unit: str, low: float = MIN_SIZE, high: float = MAX_SIZE) -> dict[str, Expected]:
    """Metadata of a range of positive numbers."""

    def holds(value: list[float]) -> bool:
        return len(value) == 2 and low <= value[0] <= value[1] <= high

    return {EXPECTED: Expected(f"[least, greatest], positive{unit}, from {low:g} to {high:g}", holds)}


def _are_places(value: list[float]) -> bool:
    return all(isfinite(number) and abs(number) <= MAX_SIZE for number in value)


def _optional_range() -> dict[str, Expected]:
    """Metadata of a range of positive numbers, or None."""
    known = _range("")[EXPECTED]
    return {EXPECTED: Expected(f"{known.text}, or null", lambda value: value is None or known.holds(value))}


def _is_interval(value: list[float]) -> bool:
    return len(value) == 2 and _are_places(value) and value[0] < value[1]


INTERVAL = {EXPECTED: Expected(f"[least, greatest], in m, at most {MAX_SIZE:g}", _is_interval)}

POSE = {
    EXPECTED: Expected(
        f"[x, y, theta], in m and rad, at most {MAX_SIZE:g}", lambda value: len(value) == 3 and _are_places(value)
    )
}


@dataclass
class FingerConfig:
    """The finger that pushes.

    Attributes:
        tip_radius: of the sphere at its tip, m; as the scene's finger has it.
        push_height: of the tip's center while it pushes, m.
        travel_height: of the tip's center while it passes over the object, m.
    """

    tip_radius: float = _positive(0.008, "m")
    push_height: float = _positive(0.012, "m")
    travel_height: float = _positive(0.12, "m")


@dataclass
class PokeConfig:
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

    count: int = _count(8, 1)
    test_count: int = _count(6, 0)
    distance: list[float] = field(default_factory=lambda: [0.06, 0.10], metadata=_range(", in m", low=MIN_POKE))
    test_distance: float = _positive(0.10, "m", low=MIN_POKE)
    speed: float = _positive(0.03, "m/s", low=1e-4)
    slant: float = _expecting(
        "an angle from 0 to less than pi / 2, in rad", lambda value: 0 <= value < radians(90), radians(30)
    )
    clearance: float = _not_negative(0.008, "in m")


@dataclass
class GoalConfig:
    """Where to push the object to.

    Attributes:
        pose: [x, y, theta] of B in W at the goal, m and rad.
        tolerance: mean distance of the cells from where they should be at which it is reached, m.
        max_pushes: made before giving up.
    """

    pose: list[float] = field(default_factory=lambda: [0.6, 0.15, 2.5], metadata=POSE)
    tolerance: float = _positive(0.02, "m")
    max_pushes: int = _count(25, 1)


@dataclass
class PreGraspConfig:
    """How the object is slid to the table's edge and grasped there.

    Attributes:
        margin: least distance of the center of mass, at its worst, from where the object would tip, m.
        min_pokes: made in any case before it slides.
        max_pokes: made before giving up.
        max_slides: made before giving up.
        max_arm: farthest that the gripper may take it from its estimated center of mass, m.
        force: of the gripper, N.
        lift: height, m.
        hold: how long it is held up, s.
    """

    margin: float = _positive(0.003, "m")
    min_pokes: int = _count(3, 1)
    max_pokes: int = _count(12, 1)
    max_slides: int = _count(20, 1)
    max_arm: float = _positive(0.1, "m")
    force: float = _positive(80.0, "N")
    lift: float = _positive(0.1, "m")
    hold: float = _positive(3.0, "s", high=3600.0)


@dataclass
class CameraConfig:
    """What sees the object's pose. Its noise is drawn from the scenario's seed.

    Attributes:
        rate: poses a second, Hz.
        position_noise: standard deviation per axis, m.
        angle_noise: standard deviation, rad.
    """

    rate: float = _positive(30.0, "Hz", low=0.1, high=1000.0)
    position_noise: float = _not_negative(0.0005, "in m")
    angle_noise: float = _not_negative(radians(0.2), "in rad")


@dataclass
class PartTruth:
    """What a part of the object truly is, instead of a random draw.

    Attributes:
        label: of the part, as in the object's file.
        cell_mass: of each of its cells, kg; null where it is drawn.
        friction: of its cells against the table; null where it is drawn.
    """

    label: int = _count(1, 1)
    cell_mass: float | None = _optional(", in kg")
    friction: float | None = _optional("")


@dataclass
class TruthConfig:
    """The object's true parameters, which only the simulated world knows. They are drawn by part from the seed.

    Attributes:
        cell_mass: [least, greatest] of a cell, relative: all are scaled to the object's total mass.
        friction: [least, greatest] of a cell against the table.
        contact_friction: [least, greatest] of the finger against the object.
        friction_by_part: whether each part has a friction of its own; else one draw does for all. Slow pushes cannot
            tell a heavy part from a rough one: where both vary, the center of mass cannot be learned.
        parts: given instead of drawn; masses given here are not scaled.
    """

    cell_mass: list[float] = field(default_factory=lambda: list(CELL_MASS_RANGE), metadata=_range(""))
    friction: list[float] = field(default_factory=lambda: list(FRICTION_RANGE), metadata=_range(""))
    contact_friction: list[float] = field(default_factory=lambda: list(CONTACT_FRICTION_RANGE), metadata=_range(""))
    friction_by_part: bool = _expecting("true or false", lambda value: True, False)
    parts: list[PartTruth] = field(default_factory=list)


@dataclass
class SimulationConfig:
    """How the world is simulated.

    Attributes:
        time_step: of the plant, s.
        stiction_tolerance: speed below which the plant takes contacts for sticking, m/s.
    """

    time_step: float = _positive(0.002, "s", low=1e-5, high=0.1)
    stiction_tolerance: float = _positive(1e-4, "m/s", low=1e-9)


@dataclass
class WorkspaceConfig:
    """The box in which the finger's tip may move, frame W.

    Attributes:
        x: [least, greatest], m.
        y: [least, greatest], m.
    """

    x: list[float] = field(default_factory=lambda: [0.42, 0.8], metadata=INTERVAL)
    y: list[float] = field(default_factory=lambda: [-0.4, 0.4], metadata=INTERVAL)


def _default_directives() -> list[ModelDirective]:
    return [ModelDirective(add_directives=AddDirectives(file=DEFAULT_SCENE))]


@dataclass
class PushScenario:
    """An object, the scene it lies in, and what is to be done with it.

    Attributes:
        version: of the schema.
        object: name of a shipped object, or an object file, relative to the scenario's own file.
        object_pose: [x, y, theta] of B in W at the beginning, m and rad.
        object_height: thickness of the object, m.
        object_friction: [least, greatest] friction of any of its cells against the table, as it is known beforehand,
            beside what the object's file says: what both allow holds. The narrower, the better the pushes show where
            the mass is. null where the file says it all.
        base: "free": it can tip and be lifted; "planar": it slides and turns only, each cell's load being exact.
        directives: what stands in the scene besides the object, as Drake's model directives: a model `iiwa` with a
            body `iiwa_link_ee_kuka`, a model `finger` with a body `finger_tip`, and a model `table`.
        finger: that pushes.
        pokes: how it pushes.
        camera: what sees the object.
        truth: what the object truly weighs and how it rubs.
        simulation: of the world.
        workspace: of the finger's tip.
        goal: where to push the object to, where that is the task.
        pregrasp: how to slide it to the edge and grasp it, where that is the task; the scene has a `gripper`.
        seed: of everything random.
    """

    version: int = CURRENT_VERSION
    object: str = _expecting(
        "the name of a shipped object or of an object file", lambda value: bool(value.strip()), "claw_hammer"
    )
    object_pose: list[float] = field(default_factory=lambda: [0.6, 0.0, 0.0], metadata=POSE)
    object_height: float = _positive(0.03, "m")
    object_friction: list[float] | None = field(default=None, metadata=_optional_range())
    base: str = _word("free", ("free", "planar"))
    directives: list[ModelDirective] = field(default_factory=_default_directives)
    finger: FingerConfig = field(default_factory=FingerConfig)
    pokes: PokeConfig = field(default_factory=PokeConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    truth: TruthConfig = field(default_factory=TruthConfig)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    workspace: WorkspaceConfig = field(default_factory=WorkspaceConfig)
    goal: GoalConfig = field(default_factory=GoalConfig)
    pregrasp: PreGraspConfig = field(default_factory=PreGraspConfig)
    seed: int = _count(0, 0, MAX_SEED)

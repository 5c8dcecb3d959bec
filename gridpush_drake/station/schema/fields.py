"""Kinds of values that a scenario's fields may have, and what a message says of each.

The fields themselves are in `station.schema.scenario` and `station.schema.camera_config`.
"""

from collections.abc import Mapping
from math import pi
from typing import Annotated, Any, get_args

import yaml
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from gridpush_drake.errors import ScenarioError
from gridpush_drake.yaml_file import shorten, suggest

MIN_SIZE = 1e-6
"""Least value of a positive number whose field names no other, in SI units."""

MAX_SIZE = 1e4
"""Greatest magnitude of a number whose field names no other, in SI units."""

MAX_COUNT = 10_000
"""Greatest value of a whole number, such as a number of pushes, whose field names no other."""

MAX_DELAY = 60.0
"""Greatest delay, s."""

YAML_REFUSALS = (
    RuntimeError,
    TypeError,
    ValueError,
    AssertionError,
    AttributeError,
    yaml.YAMLError,
)
"""Exceptions that Drake's reader of typed YAML raises over data that does not fit."""


class Config(BaseModel):
    """A part of a scenario. It may be changed; whoever takes it checks it again.

    In pydantic an instance is otherwise taken to be valid, whatever was assigned to it.
    """

    model_config = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, revalidate_instances="always"
    )


def _read_number(value: Any) -> Any:
    """Reads a number that stands in quotes, as YAML 1.1 gives 1e-4; all else stays as it is."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


Number = Annotated[float, BeforeValidator(_read_number)]
"""A finite number."""


def positive(unit: str, low: float = MIN_SIZE, high: float = MAX_SIZE) -> Any:
    """Describes a field that holds a positive number in a unit."""
    return Field(
        ge=low, le=high, description=f"a positive number, in {unit}, from {low:g} to {high:g}"
    )


def not_negative(unit: str, high: float = MAX_SIZE) -> Any:
    """Describes a field that holds a number in a unit that may be 0."""
    return Field(ge=0, le=high, description=f"a number, 0 or more, in {unit}, at most {high:g}")


def whole(low: int, high: int = MAX_COUNT) -> Any:
    """Describes a field that holds a whole number."""
    return Field(ge=low, le=high, description=f"a whole number, {low} or more, at most {high}")


def _check_order(values: list[float]) -> list[float]:
    if not values[0] <= values[1]:
        raise ValueError
    return values


def _check_strict_order(values: list[float]) -> list[float]:
    if not values[0] < values[1]:
        raise ValueError
    return values


Increasing = AfterValidator(_check_order)
"""Refuses a pair whose first number is greater than its second."""


def within(low: float, high: float) -> AfterValidator:
    """Makes a check that refuses a list with a number beyond some limits."""

    def check(values: list[float]) -> list[float]:
        if not all(low <= value <= high for value in values):
            raise ValueError
        return values

    return AfterValidator(check)


Delay = Annotated[Number, Field(ge=0, le=MAX_DELAY)]
"""A delay, s."""

Positive = Annotated[Number, Field(ge=MIN_SIZE, le=MAX_SIZE)]
"""A positive number."""

Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
"""Two numbers."""

Range = Annotated[Pair, Increasing, within(MIN_SIZE, MAX_SIZE)]
"""[least, greatest] of something positive; both may be the same."""

RANGE_DESCRIPTION = f"[least, greatest], positive, from {MIN_SIZE:g} to {MAX_SIZE:g}"
"""Description of a field that holds a `Range`."""

Interval = Annotated[
    Pair,
    Field(description=f"[least, greatest], in m, at most {MAX_SIZE:g}"),
    AfterValidator(_check_strict_order),
    within(-MAX_SIZE, MAX_SIZE),
]
"""[least, greatest] of a coordinate, m; they differ."""

Point = Annotated[Pair, within(-MAX_SIZE, MAX_SIZE)]
"""[x, y] of a place in W, m."""

MAX_ANGLE = 4 * pi
"""Greatest angle of a pose, rad: one of more turns is taken for one in degrees."""


def _check_angle(values: list[float]) -> list[float]:
    if abs(values[2]) > MAX_ANGLE:
        raise ValueError
    return values


Pose = Annotated[
    list[Number],
    Field(
        min_length=3,
        max_length=3,
        description=f"[x, y, theta], in m and rad, at most {MAX_SIZE:g} m and {MAX_ANGLE:.3g} rad",
    ),
    within(-MAX_SIZE, MAX_SIZE),
    AfterValidator(_check_angle),
]
"""[x, y, theta] of an object in W, m and rad."""


def check_keys(data: Any, schema: Any, place: str) -> None:
    """Checks YAML data for one of Drake's structs: it has no key that the struct does not have.

    Drake's reader refuses such a key, too, but its message names neither the place nor the nearest
    known key.

    Args:
        data: the data.
        schema: the struct, a class with Drake's `__fields__`.
        place: where the data stands in the scenario, for the message.

    Raises:
        ScenarioError: the data is no mapping, or has an unknown key.
    """
    if not isinstance(data, Mapping):
        raise ScenarioError(f"{place} is {shorten(data)}; expected `key: value` lines")
    types = {field.name: field.type for field in schema.__fields__}
    for key, value in data.items():
        if key not in types:
            raise ScenarioError(f"{place}.{key}: unknown key{suggest(str(key), list(types))}")
        choices = [kind for kind in get_args(types[key]) or (types[key],) if kind is not type(None)]
        if len(choices) == 1 and hasattr(kind := choices[0], "__fields__") and value is not None:
            check_keys(value, kind, f"{place}.{key}")

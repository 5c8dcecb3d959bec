"""Whether YAML data fits a scenario's schema, said in words a user can act on.

`pydrake.common.yaml` refuses what does not fit, but names neither the place nor the nearest known key.
"""

import dataclasses
from collections.abc import Mapping
from difflib import get_close_matches
from numbers import Integral, Real
from types import UnionType
from typing import Any, Union, get_args, get_origin

from gridpush_drake.errors import ScenarioError
from gridpush_drake.scene.scenario import EXPECTED

FORMS = {bool: "true or false", int: "a whole number", float: "a number", str: "some text"}

MOST_SHOWN = 60
"""Characters of a refused value that a message repeats."""


def check_data(data: Any, schema: type, place: str = "") -> None:
    """Checks that the keys and types of YAML data are those of a schema.

    Args:
        data: as YAML loads it.
        schema: a dataclass, or a struct of Drake's.
        place: of the data in its document, such as "camera".

    Raises:
        ScenarioError: a key is unknown, or a value of the wrong type; the message names its place and what is
            expected there.
    """
    types = _types_of(schema)
    if not isinstance(data, Mapping):
        raise ScenarioError(f"{place or 'the scenario'} is {shorten(data)}; expected `key: value` lines")
    for key in data:
        if key not in types:
            raise ScenarioError(f"{_join(place, key)}: unknown key{suggest(str(key), list(types))}")
    for key, value in data.items():
        _check_value(value, types[key], _join(place, key), _form_of(schema, key))


def check_values(value: Any, place: str = "") -> None:
    """Checks that each field of a dataclass, and of those within it, holds what its metadata asks for.

    Args:
        value: the dataclass's instance.
        place: of it in its document.

    Raises:
        ScenarioError: a field does not; the message names its place and what is expected there.
    """
    for field in dataclasses.fields(value):
        item, inner = getattr(value, field.name), _join(place, field.name)
        expected = field.metadata.get(EXPECTED)
        if expected is not None and not (_is_of(item, field.type) and expected.holds(item)):
            raise ScenarioError(f"{inner} is {shorten(item)}; expected {expected.text}")
        if isinstance(field.type, type) and dataclasses.is_dataclass(field.type):
            if not isinstance(item, field.type):
                raise ScenarioError(f"{inner} is {shorten(item)}; expected a {field.type.__name__}")
            check_values(item, inner)
        for at, part in enumerate(item) if isinstance(item, list) else ():
            if dataclasses.is_dataclass(part):
                check_values(part, f"{inner}[{at}]")


def suggest(word: str, known: list[str]) -> str:
    """The end of a message about an unknown word: the nearest known one, and all."""
    near = get_close_matches(word, known, n=1)
    guess = f"; did you mean {near[0]}?" if near else ";"
    return f"{guess} expected one of {', '.join(known)}"


def shorten(value: Any) -> str:
    """A refused value for a message."""
    text = "empty" if value is None else repr(value)
    return text if len(text) <= MOST_SHOWN else text[: MOST_SHOWN - 3] + "..."


def _form_of(schema: type, key: str) -> str | None:
    """What a field is expected to hold, by its metadata; None where it does not say."""
    if not dataclasses.is_dataclass(schema):
        return None
    field = next(field for field in dataclasses.fields(schema) if field.name == key)
    return field.metadata[EXPECTED].text if EXPECTED in field.metadata else None


def _types_of(schema: Any) -> dict[str, Any]:
    fields = dataclasses.fields(schema) if dataclasses.is_dataclass(schema) else schema.__fields__
    return {field.name: field.type for field in fields}


def _join(place: str, key: Any) -> str:
    return f"{place}.{key}" if place else str(key)


def _check_value(value: Any, schema: Any, place: str, form: str | None) -> None:
    origin, arguments = get_origin(schema), get_args(schema)
    if origin in (Union, UnionType) and arguments[1:] == (type(None),):
        if value is not None:
            _check_value(value, arguments[0], place, form)
    elif schema in FORMS:
        if not _is_of(value, schema) and not (schema is float and _reads_as_number(value)):
            raise ScenarioError(f"{place} is {shorten(value)}; expected {form or FORMS[schema]}")
    elif origin is list:
        if not isinstance(value, list):
            raise ScenarioError(f"{place} is {shorten(value)}; expected {form or 'a list'}")
        for at, item in enumerate(value):
            _check_value(item, arguments[0], f"{place}[{at}]", None)
    elif origin is dict:
        if not isinstance(value, Mapping):
            raise ScenarioError(f"{place} is {shorten(value)}; expected `key: value` lines")
        for key, item in value.items():
            _check_value(item, arguments[1], _join(place, key), None)
    elif dataclasses.is_dataclass(schema) or hasattr(schema, "__fields__"):
        check_data(value, schema, place)


def _is_of(value: Any, schema: Any) -> bool:
    """Whether a plain value, or a list of them, is of a type; whole numbers are numbers."""
    if get_origin(schema) in (Union, UnionType):
        return any(_is_of(value, choice) for choice in get_args(schema))
    if get_origin(schema) is list:
        (inner,) = get_args(schema)
        return isinstance(value, list) and all(_is_of(item, inner) for item in value)
    if schema in (int, float):
        return isinstance(value, Integral if schema is int else Real) and not isinstance(value, bool)
    return isinstance(value, schema)


def _reads_as_number(value: Any) -> bool:
    """Whether Drake will read a text as a number, such as 1e-3, which YAML 1.1 takes for one."""
    try:
        return isinstance(value, str) and float(value) is not None
    except ValueError:
        return False

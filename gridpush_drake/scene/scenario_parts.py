"""What a scenario names, made: the object and the scene's models."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from pydrake.multibody.parsing import ModelDirectives, ModelInstanceInfo, Parser, ProcessModelDirectives

from gridpush_drake.errors import ObjectError, ScenarioError
from gridpush_drake.files import is_file
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.object_file import find_shipped_object, read_object
from gridpush_drake.scene.scenario import PushScenario


def load_object(scenario: PushScenario) -> GridObject:
    """Reads the scenario's object; a file goes before a shipped object of the same name.

    The bounds of its friction, `prior.friction_min` and `friction_max`, are those that its file and the scenario's
    `object_friction` both allow; the prior coefficient is the file's, or the nearest bound.

    Raises:
        ScenarioError: there is none, its file is not what it should be, where the message suggests the nearest name; or
            scenario and file allow no common friction.
    """
    path = Path(scenario.object)
    try:
        obj = read_object(path if path.suffix or is_file(path) else find_shipped_object(scenario.object))
    except ObjectError as error:
        raise ScenarioError(f"object: {error}") from error
    return obj if scenario.object_friction is None else _bound_friction(obj, *scenario.object_friction)


def _bound_friction(obj: GridObject, least: float, greatest: float) -> GridObject:
    prior = obj.prior
    low, high = max(least, prior.friction_min), min(greatest, prior.friction_max)
    if low > high:
        raise ScenarioError(
            f"object_friction is [{least:g}, {greatest:g}]; expected a range that overlaps that of {obj.name}'s file, "
            f"{prior.friction_min:g} to {prior.friction_max:g}"
        )
    friction = min(max(prior.friction, low), high)
    return replace(obj, prior=replace(prior, friction=friction, friction_min=low, friction_max=high))


def AddScene(parser: Parser, scenario: PushScenario) -> list[ModelInstanceInfo]:
    """Adds what stands in the scene besides the object to the parser's plant, before that is finalised.

    Args:
        parser: `MakeParser(plant)`.
        scenario: its `directives`.

    Returns:
        What was added.

    Raises:
        ScenarioError: a directive cannot be carried out.
    """
    directives = ModelDirectives(directives=scenario.directives)
    try:
        return ProcessModelDirectives(directives, parser)
    except (RuntimeError, ValueError) as error:
        raise ScenarioError(f"directives: {_first_line(str(error).splitlines())}") from error


def _first_line(lines: Iterable[str]) -> str:
    return next((line.strip() for line in lines if line.strip()), "cannot be carried out")

"""What a scenario names, made: the object and the scene's models."""

from collections.abc import Iterable
from pathlib import Path

from pydrake.multibody.parsing import ModelDirectives, ModelInstanceInfo, Parser, ProcessModelDirectives

from gridpush_drake.errors import ObjectError, ScenarioError
from gridpush_drake.files import is_file
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.object_file import find_shipped_object, read_object
from gridpush_drake.scene.scenario import PushScenario


def load_object(scenario: PushScenario) -> GridObject:
    """Reads the scenario's object; a file goes before a shipped object of the same name.

    Raises:
        ScenarioError: there is none, or its file is not what it should be; the message suggests the nearest name.
    """
    path = Path(scenario.object)
    try:
        return read_object(path if path.suffix or is_file(path) else find_shipped_object(scenario.object))
    except ObjectError as error:
        raise ScenarioError(f"object: {error}") from error


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

"""Scenario files: a `PushScenario` as YAML, read strictly and written whole."""

from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_dump_typed, yaml_load_data, yaml_load_typed

from gridpush_drake.errors import ScenarioError
from gridpush_drake.files import is_file, read_text, write_whole
from gridpush_drake.grid.yaml_file import MAX_YAML_SIZE, NOT_YAML, check_yaml
from gridpush_drake.scene.scenario import CURRENT_VERSION, PushScenario
from gridpush_drake.scene.scenario_schema import check_data, check_values, shorten

WHAT = "a scenario (object, base, directives, ...)"


def read_scenario(path: Path | str, *, child_name: str | None = None) -> PushScenario:
    """Reads a scenario, or one of several in a file.

    Args:
        path: the YAML file.
        child_name: key of the document's root under which the scenario stands; the root itself where None.

    Returns:
        The scenario. What the file does not say is as `PushScenario` has it; an object file it names is looked up
        beside it and named in full.

    Raises:
        ScenarioError: the file cannot be read, is of another schema, has an unknown key or a value that will not do;
            the message names the file, the field and the expected form. Whether the scene as a whole makes
            sense is `check_scenario`'s to say.
    """
    path = Path(path)
    text = read_text(path, WHAT, ScenarioError, MAX_YAML_SIZE)
    data = _parse(path, text)
    where = str(path)
    if child_name is not None:
        where, data = f"{path}, {child_name}", _pick_child(path, data, child_name)
    try:
        _check_version(data)
        check_data(data, PushScenario)
        scenario: PushScenario = yaml_load_typed(schema=PushScenario, data=text, child_name=child_name)
        check_values(scenario)
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error
    except (RuntimeError, TypeError, ValueError, AssertionError, AttributeError) as error:
        raise ScenarioError(f"{where}: directives: {' '.join(str(error).split())}") from error
    beside = path.parent / scenario.object
    if beside.suffix or is_file(beside):
        scenario.object = str(beside.resolve())
    return scenario


def write_scenario(path: Path | str, scenario: PushScenario, force: bool = False) -> None:
    """Writes a scenario with every field, so that `read_scenario` gives it back.

    Args:
        path: the YAML file to be written.
        scenario: to be written.
        force: whether an existing file may be replaced.

    Raises:
        ScenarioError: a field holds what will not do.
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    check_values(scenario)
    write_whole(path, yaml_dump_typed(scenario, schema=PushScenario), force)


def _parse(path: Path, text: str) -> dict[str, Any]:
    check_yaml(path, text, WHAT, ScenarioError)
    try:
        data = yaml_load_data(text, private=True)
    except (yaml.YAMLError, *NOT_YAML) as error:
        raise ScenarioError(f"{path}: is not valid YAML: {' '.join(str(error).split())}") from error
    if data is None:
        raise ScenarioError(f"{path}: is empty; expected {WHAT}")
    if not isinstance(data, dict):
        raise ScenarioError(f"{path}: is {shorten(data)} at its top level; expected {WHAT}: `key: value` lines")
    for key in data:
        if not isinstance(key, str):
            raise ScenarioError(f"{path}: {key}: unknown key; expected {WHAT}")
    return {key: value for key, value in data.items() if not key.startswith("_")}


def _pick_child(path: Path, data: dict[str, Any], name: str) -> Any:
    if name in data:
        return data[name]
    near = get_close_matches(name, map(str, data), n=1)
    guess = f"; did you mean {near[0]}?" if near else ";"
    raise ScenarioError(f"{path}: has no scenario {name}{guess} it has {', '.join(map(str, data))}")


def _check_version(data: Any) -> None:
    version = data.get("version", CURRENT_VERSION) if isinstance(data, dict) else CURRENT_VERSION
    if isinstance(version, int) and version != CURRENT_VERSION:
        age = "an older" if version < CURRENT_VERSION else "a newer"
        raise ScenarioError(f"version is {version}, {age} schema; this release reads version {CURRENT_VERSION}")

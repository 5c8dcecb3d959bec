"""Scenario files: a `PushScenario` as YAML, read strictly and written whole."""

from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_dump_typed, yaml_load_data, yaml_load_typed

from gridpush_drake.errors import ScenarioError
from gridpush_drake.files import write_whole
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
    text = _read_text(path)
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
    if beside.suffix or beside.is_file():
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


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except IsADirectoryError as error:
        raise ScenarioError(f"{path}: is a folder; expected {WHAT}") from error
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}; expected {WHAT}") from error
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: is not UTF-8 text; expected {WHAT}") from error


def _parse(path: Path, text: str) -> dict[str, Any]:
    try:
        _refuse_twins(path, yaml.compose(text, Loader=yaml.SafeLoader))
        data = yaml_load_data(text, private=True)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise ScenarioError(f"{path}{where}: is not valid YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError) as error:
        raise ScenarioError(f"{path}: is not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise ScenarioError(f"{path}: is nested too deeply; expected {WHAT}") from error
    if data is None:
        raise ScenarioError(f"{path}: is empty; expected {WHAT}")
    if not isinstance(data, dict):
        raise ScenarioError(f"{path}: is {shorten(data)} at its top level; expected {WHAT}: `key: value` lines")
    for key in data:
        if not isinstance(key, str):
            raise ScenarioError(f"{path}: {key}: unknown key; expected {WHAT}")
    return {key: value for key, value in data.items() if not key.startswith("_")}


def _refuse_twins(path: Path, node: yaml.Node | None) -> None:
    """Raises where a key occurs twice, which YAML's loader would settle in silence."""
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_twins(path, item)
    if not isinstance(node, yaml.MappingNode):
        return
    seen = set()
    for key, value in node.value:
        if isinstance(key, yaml.ScalarNode) and key.value in seen:
            raise ScenarioError(f"{path}, line {key.start_mark.line + 1}: {key.value}: this key occurs twice")
        seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        _refuse_twins(path, value)


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

"""The file of a scenario: found by its path or by its name, read, checked and written.

What a scenario holds, and what each of its fields may be, is in `station.schema.scenario`. Whether
a scenario makes sense as a whole is decided in `station.scene.resolve`.
"""

from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_args

import yaml
from pydrake.common.yaml import yaml_dump_typed
from pydrake.multibody.parsing import ModelDirectives

from gridpush_drake.errors import ScenarioError
from gridpush_drake.files import is_file, read_text, shorten_path, write_whole
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.station.robot.measures import PusherKind
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.schema.scenario import CURRENT_VERSION, OtherConfig, PushScenario
from gridpush_drake.yaml_file import (
    MAX_YAML_SIZE,
    NO_MAPPING,
    TAG_KEY,
    add_core_forms,
    parse_yaml,
    shorten,
)

ROBOT_KEY = "robot"
"""Key of a scenario file that names a robot. It stands in place of `directives`, and means the
directives of the scene that comes with this robot."""

EXPECTED_SCENARIO = "a scenario (object, base, directives, ...)"
"""What a scenario file should hold, in a message's words."""

LINE_LENGTH = 120
"""Greatest length of a line in a written scenario, in characters."""


RENAMED_SCENARIOS = {"grasp_untold": "grasp_unknown_inertia"}
"""Shipped scenarios by their old names, which are still found."""


RENAMED_FIELDS = {"nothing_told": "unknown_inertia"}
"""Keys of scenario files by their old names, which are still read."""


def list_shipped_scenarios() -> list[str]:
    """Lists the names of the scenarios that come with the package, sorted."""
    return sorted(path.stem for path in _find_shipped().glob("*.yaml"))


def find_scenario(scenario: Path | str) -> Path:
    """Finds the file of a scenario by its path, or by the name of one that comes with the package.

    If there are both, the path is taken.

    Raises:
        ScenarioError: a word that is neither a file nor the name of a shipped scenario; the message
            suggests the nearest name and lists all.
    """
    path = Path(scenario)
    is_path = bool(path.suffix) or path.name != str(scenario)
    if is_path or is_file(path):
        return path
    known = list_shipped_scenarios()
    name = RENAMED_SCENARIOS.get(path.name, path.name)
    if name in known:
        return _find_shipped() / f"{name}.yaml"
    near = get_close_matches(path.name, known, n=1)
    guess = f"; did you mean {near[0]}?" if near else "."
    raise ScenarioError(
        f"{shorten_path(path)}: no shipped scenario has this name, and no file{guess} "
        f"Shipped are: {', '.join(known)}"
    )


def _find_shipped() -> Path:
    """Finds the folder of the scenarios that come with the package."""
    return find_models() / "scenarios"


def read_scenario(path: Path | str, *, child_name: str | None = None) -> PushScenario:
    """Reads a scenario, or one of several in a file.

    Args:
        path: the YAML file, or the name of a scenario that comes with the package, see
            `list_shipped_scenarios`. Instead of `directives` the file may have `robot`: the name of
            a robot that comes with the package, or the folder of a robot.yaml. The scene is then
            the one that the robot.yaml names; if the robot can grasp, one to grasp in.
        child_name: key under which the scenario stands at the top level of the file; None if the
            whole file is one scenario.

    Returns:
        The scenario. Fields that the file leaves out have the defaults of `PushScenario`. Paths of
        object files and packages, which are relative to the scenario's file, have become absolute.

    Raises:
        ScenarioError: there is no such file or shipped scenario; the file cannot be read, is of
            another schema, has an unknown key, or holds a value that will not do. The message names
            the file, the field and the expected form.
    """
    path = find_scenario(path)
    return parse_scenario(
        path,
        read_text(path, EXPECTED_SCENARIO, ScenarioError, MAX_YAML_SIZE),
        child_name=child_name,
    )


def parse_scenario(path: Path, text: str, *, child_name: str | None = None) -> PushScenario:
    """Makes a scenario of the text of its file.

    Args:
        path: the file that the text is from, for messages and to find object files. It need not
            exist.
        text: text of the file, YAML.
        child_name: see `read_scenario`.

    Returns:
        The scenario, see `read_scenario`.

    Raises:
        ScenarioError: the text is no scenario, see `read_scenario`.
    """
    data = _parse(path, text)
    where = str(path)
    if child_name is not None:
        where = f"{path}, {child_name}"
        data = _pick_child(path, data, child_name)
    try:
        if not isinstance(data, dict):
            raise ScenarioError(f"the scenario is {shorten(data)}; expected `key: value` lines")
        _check_version(data.get("version", CURRENT_VERSION))
        if ROBOT_KEY in data:
            data = _name_robot(path, data)
        scenario = PushScenario(**_rename_fields(data))
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error
    # Names of object files become absolute. What has no suffix and is no file is a shipped object.
    having_object: list[PushScenario | OtherConfig] = [scenario, *scenario.others]
    for each in having_object:
        beside = path.parent / each.object
        if beside.suffix or is_file(beside):
            each.object = str(beside.resolve())
    scenario.packages = {
        name: str((path.parent / folder).resolve()) for name, folder in scenario.packages.items()
    }
    return scenario


def _rename_fields(data: dict[str, Any]) -> dict[str, Any]:
    """Gives a scenario's keys of old their names of today.

    Raises:
        ScenarioError: a key is given by both names.
    """
    for old, new in RENAMED_FIELDS.items():
        if old in data and new in data:
            raise ScenarioError(f"{old} and {new} are both given; expected one of them")
    return {RENAMED_FIELDS.get(key, key): value for key, value in data.items()}


def write_scenario(path: Path | str, scenario: PushScenario, force: bool = False) -> None:
    """Writes a scenario with every field, so that `read_scenario` gives it back.

    Args:
        path: the YAML file.
        scenario: the scenario.
        force: whether an existing file may be replaced.

    Raises:
        ScenarioError: a field holds what will not do.
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    write_whole(path, format_scenario(scenario), force)


def format_scenario(scenario: PushScenario) -> str:
    """Formats a scenario with every field as YAML.

    Raises:
        ScenarioError: a field holds what will not do.
    """
    scenario.check()
    fields = scenario.model_dump(exclude={"directives"})
    text = yaml.dump(
        fields,
        Dumper=_TaggedDumper,
        sort_keys=False,
        default_flow_style=None,
        allow_unicode=True,
        width=LINE_LENGTH,
    )
    directives = ModelDirectives(directives=scenario.directives)
    return text + str(yaml_dump_typed(directives, schema=ModelDirectives))


class _TaggedDumper(yaml.SafeDumper):
    """A safe dumper that writes a mapping's _tag as its YAML tag, which Drake's reader expects."""


def _represent_mapping(dumper: yaml.SafeDumper, data: dict[str, Any]) -> yaml.Node:
    """Represents a mapping with the tag that stands in it under _tag, if there is one."""
    tag = data.get("_tag", yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG)
    return dumper.represent_mapping(
        tag, {key: value for key, value in data.items() if key != "_tag"}
    )


_TaggedDumper.add_representer(dict, _represent_mapping)
add_core_forms(_TaggedDumper)


def _parse(path: Path, text: str) -> dict[str, Any]:
    """Parses the text of a scenario file; keys that begin with _, for anchors, are left out."""
    data = _mark_tags(parse_yaml(path, text, EXPECTED_SCENARIO, ScenarioError, tagged=True))
    if data is None:
        raise ScenarioError(f"{path}: is empty; expected {EXPECTED_SCENARIO}")
    if not isinstance(data, dict):
        raise ScenarioError(f"{path}: {NO_MAPPING}; expected {EXPECTED_SCENARIO}")
    for key in data:
        if not isinstance(key, str):
            raise ScenarioError(f"{path}: {key}: unknown key; expected {EXPECTED_SCENARIO}")
    return {key: value for key, value in data.items() if not key.startswith("_")}


def _mark_tags(data: Any) -> Any:
    """Puts the tag of each mapping where Drake has it: under _tag, with an exclamation mark."""
    if isinstance(data, list):
        return [_mark_tags(each) for each in data]
    if not isinstance(data, dict):
        return data
    marked = {key: _mark_tags(value) for key, value in data.items() if key != TAG_KEY}
    return marked | {"_tag": f"!{data[TAG_KEY]}"} if TAG_KEY in data else marked


def _name_robot(path: Path, data: dict[str, Any]) -> dict[str, Any]:
    """Replaces the robot that the data names by the directives of its scene."""
    robot = data[ROBOT_KEY]
    if not isinstance(robot, str) or not robot.strip():
        raise ScenarioError(
            f"{ROBOT_KEY} is {shorten(robot)}; expected a robot's name, or the folder of a "
            "robot.yaml"
        )
    if "directives" in data:
        raise ScenarioError(f"{ROBOT_KEY} and directives are both given; expected one of them")
    beside = path.parent / robot
    # one that is not known is refused with all other fields
    known: tuple[PusherKind, ...] = get_args(PusherKind)
    pusher = next((kind for kind in known if kind == data.get("pusher")), known[0])
    directives = make_robot_directives(
        str(beside) if is_file(beside / "robot.yaml") else robot,
        grasping=None,
        pusher=pusher,
    )
    return {key: value for key, value in data.items() if key != ROBOT_KEY} | {
        "directives": directives
    }


def _pick_child(path: Path, data: dict[str, Any], name: str) -> Any:
    """Picks one of several scenarios in a file."""
    if name in data:
        return data[name]
    near = get_close_matches(name, map(str, data), n=1)
    guess = f"; did you mean {near[0]}?" if near else ";"
    raise ScenarioError(f"{path}: has no scenario {name}{guess} it has {', '.join(map(str, data))}")


def _check_version(version: Any) -> None:
    """Checks that the file is of this schema; pydantic refuses what is no number."""
    if isinstance(version, int) and version != CURRENT_VERSION:
        age = "an older" if version < CURRENT_VERSION else "a newer"
        raise ScenarioError(
            f"version is {version}, {age} schema; this release reads version {CURRENT_VERSION}"
        )

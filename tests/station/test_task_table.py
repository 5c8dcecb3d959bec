"""A task declares itself: nothing else of the package names it."""

import ast
import re
from pathlib import Path

import pytest

import gridpush_drake
from gridpush_drake.station.schema.fields import Config
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import parse_scenario
from gridpush_drake.station.schema.task_table import DEFAULT_TASK, TASKS, list_sections
from gridpush_drake.station.tasks.registry import TASK_KINDS, explain_tasks, name_tasks

PACKAGE = Path(gridpush_drake.__file__).parent

TABLE = "station/schema/task_table.py"

MAX_FILES_OF_A_TASK = 6
"""Files of the package, scenarios among them, that may name a task that is added."""

READERS = ("station", "cli/run", "report", "jobs")
"""Rooms whose files might name a task: they run, show, record or count whatever task is asked for."""

OTHER_MEANINGS = {"push"}
"""Names of tasks that are words for something else, too."""


def list_files():
    """Lists the package's own files, by their paths within it."""
    paths = [*PACKAGE.rglob("*.py"), *PACKAGE.glob("models/scenarios/*.yaml")]
    return {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in paths}


FILES = list_files()


def list_declared(name):
    """Lists the names of the modules and classes in which a task is declared."""
    return [word for place in TASKS[name] for word in place.split(":") if word]


@pytest.mark.parametrize("name", TASKS)
def test_what_declares_a_task_is_named_beside_the_tasks_and_in_the_table_alone(name):
    words = re.compile(rf"\b({'|'.join(list_declared(name))})\b")
    found = {file for file, text in FILES.items() if words.search(text)}
    # a public name, and a bench of the whole station
    elsewhere = {"bench/drake.py"} if name == "identify" else set()
    assert {f for f in found if not f.startswith("station/tasks/")} == {TABLE, *elsewhere}


@pytest.mark.parametrize("room", READERS)
def test_no_text_of_the_program_is_a_tasks_name(room):
    names = set(TASKS) - OTHER_MEANINGS
    found = {
        f"{file}: {node.value}"
        for file, text in FILES.items()
        if file.startswith(f"{room}/") and not file.startswith("station/tasks/") and file != TABLE
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant) and node.value in names
    }
    assert not found


@pytest.mark.parametrize("name", ["line"])
def test_a_task_is_added_by_a_few_files(name):
    key = re.compile(rf"^{name}:", re.MULTILINE)
    words = re.compile(rf"\b({'|'.join(list_declared(name))})\b")
    found = {
        file
        for file, text in FILES.items()
        if (key.search(text) if file.endswith(".yaml") else words.search(text))
    }
    assert {TABLE, f"models/scenarios/{TASK_KINDS[name].scenario}.yaml"} < found
    assert len(found) <= MAX_FILES_OF_A_TASK, found


@pytest.mark.parametrize("name", TASKS)
def test_a_task_declares_all_that_commands_ask_for(name):
    kind = TASK_KINDS[name]
    assert not kind.help.endswith(".") and kind.help[0].islower()
    assert kind.sentence.count("{}") == 1 and kind.sentence.endswith(".")
    assert f"{name}: {kind.help}" in explain_tasks()
    assert kind.count_steps(kind.make_scenario()) > 0


def test_tasks_are_named_by_what_they_do():
    assert DEFAULT_TASK in TASKS
    assert name_tasks(lambda kind: kind.counts_pokes) == "identify"
    assert name_tasks(lambda kind: kind.weighs) == "pregrasp or slide"
    assert name_tasks(lambda kind: kind.hides) == "follow or line"


def test_a_scenario_has_the_tasks_sections(tmp_path):
    text = "follow: {speed: 0.04}\nline: {points: [[0.6, 0.1]]}\n"
    scenario = parse_scenario(tmp_path / "cell.yaml", text)
    sections = dict(list_sections())
    assert list(sections) == ["follow", "line"]
    for name, kind in sections.items():
        assert issubclass(kind, Config)
        assert scenario.section(kind) is getattr(scenario, name)
    assert scenario.section(sections["follow"]).speed == 0.04
    assert scenario.section(sections["line"]).points == [[0.6, 0.1]]
    # each scenario has sections of its own
    assert PushScenario().section(sections["line"]).points == []

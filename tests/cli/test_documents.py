"""README and the pages of the site: their commands, code, files and links are there, and run.

The notebooks among them run when the site is built; the controller of `docs/extending.md` in
`tests/station/test_own_controller.py`.
"""

import os
import re
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import typer
import yaml
from pydantic import BaseModel

from gridpush_drake.cli.main import app
from gridpush_drake.cli.shell.lazy_group import LazyCommand
from gridpush_drake.cli.shell.ros_args import split_ros_arguments
from gridpush_drake.dynamics.kernels.friction.laws import FRICTION_LAWS
from gridpush_drake.errors import MissingExtraError, PushLogError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import list_shipped_objects
from gridpush_drake.pushes.push_csv import PUSH_COLUMNS
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario_file import (
    find_scenario,
    list_shipped_scenarios,
    parse_scenario,
)
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.made_logs import make_pushed_block

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
PAGES = [page for page in PAGES if page.is_file() and "generated" not in page.parts]
TEXTS = {str(page.relative_to(ROOT)): page.read_text(encoding="utf-8") for page in PAGES}
NOTEBOOKS = {name for name, text in TEXTS.items() if "mystnb" in text}
RUN_ELSEWHERE = NOTEBOOKS | {"docs/extending.md"}
DIRECTIVES = (
    "{toctree}",
    "{public-names}",
    "{scenario-sections}",
    "{station-diagram}",
    "{eval-rst}",
    "{figure}",
    "{include}",
    "{literalinclude}",
)
EVERYWHERE = {"--help"}
"""Options of every command."""

STAND_INS = {"lab", "yours"}
"""Names of importers that the reader writes."""

pytestmark = pytest.mark.skipif(
    not DOCS.is_dir(), reason="a wheel's tests have no docs beside them"
)


def find_blocks(name, language):
    return re.findall(rf"```{language}\n(.*?)```", TEXTS[name], re.DOTALL)


LONG_EXAMPLES = {"docs/howto/gym.md-1"}
"""A game that is played to its end; `tests/gym` plays it, too."""

EXAMPLES = [
    pytest.param(
        name,
        block,
        id=f"{name}-{i}",
        marks=[pytest.mark.slow] if f"{name}-{i}" in LONG_EXAMPLES else [],
    )
    for name in sorted(TEXTS.keys() - RUN_ELSEWHERE)
    for i, block in enumerate(find_blocks(name, "python"))
]


def find_commands(text):
    """All command lines of `gridpush` in a page, each once: indented, or in backticks."""
    lines = re.findall(r"^    (gridpush [^#\n]*)", text, re.MULTILINE) + re.findall(
        r"`(gridpush [^`\n]*)`", text
    )
    return sorted({line.strip() for line in lines})


@pytest.mark.parametrize(("name", "example"), EXAMPLES)
def test_the_python_runs(name, example, block, pushes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    block.rename("object.yaml")
    exec(compile(example, name, "exec"), {})


@pytest.mark.slow
def test_the_python_type_checks(tmp_path):
    mypy = pytest.importorskip("mypy.api", reason="mypy is not installed")
    files = []
    for i, example in enumerate(EXAMPLES):
        files.append(tmp_path / f"example_{i}.py")
        files[-1].write_text(example.values[1])
    assert len(files) >= 3
    settings = ROOT / "pyproject.toml"
    out, err, code = mypy.run(
        [*map(str, files), f"--config-file={settings}", "--follow-imports=silent", "--strict"]
    )
    assert code == 0, out + err


@pytest.mark.parametrize("name", sorted(name for name, text in TEXTS.items() if "import" in text))
def test_the_python_names_public_things_only(name):
    blocks = re.findall(
        r"```(?:python|\{code-cell\}|\{code-block\} python).*?\n(.*?)```", TEXTS[name], re.DOTALL
    )
    code = "\n".join(
        block for block in blocks if not block.startswith('"""')
    )  # which is a file within the package
    ours = re.findall(
        r"^ *from gridpush_drake([\w.]*) import (?:\(([^)]*)\)|([^\n]*))", code, re.MULTILINE
    )
    for module, many, few in ours:
        try:
            package = import_module(f"gridpush_drake{module}")
        except MissingExtraError:  # its own tests are skipped, too
            continue
        names = {
            part.strip() for part in (many or few).replace("\n", " ").split(",") if part.strip()
        }
        public = set(getattr(package, "__all__", ())) or {
            n for n in vars(package) if n.endswith(("Error", "Warning"))
        }
        assert names <= public, f"gridpush_drake{module}: {names - public}"


def run_fragment(number, monkeypatch):
    """The names that a fragment of `docs/extending.md` defines: a file to be put beside those of the package."""
    fragment = find_blocks("docs/extending.md", r"\{code-block\} python")[number]
    module = ModuleType(f"fragment_{number}")
    monkeypatch.setitem(
        sys.modules, module.__name__, module
    )  # where a dataclass looks for its annotations
    exec(compile(fragment, "docs/extending.md", "exec"), vars(module))
    return vars(module)


def test_the_friction_law_is_one(monkeypatch):
    monkeypatch.setitem(FRICTION_LAWS, "ribbed", None)  # registered for this test only
    law = run_fragment(0, monkeypatch)["RIBBED"]
    rng = np.random.default_rng(0)
    cells, k, xi, eps = (
        rng.normal(size=(2, 9)),
        rng.uniform(0.1, 1.0, 9),
        np.array([0.1, -0.2, 0.3]),
        1e-2,
    )

    def dissipation(xi, k=k):
        return law.calc_dissipation.py_func(law.make(k, 0.1, "coupled"), cells, eps, xi)

    def derivatives(xi, k=k):
        g, H = np.zeros(3), np.zeros((3, 3))
        law.add_derivatives.py_func(law.make(k, 0.1, "coupled"), cells, eps, xi, False, g, H)
        return g, H

    f = np.zeros((3, 9))
    law.fill_load_derivatives.py_func(law.make(k, 0.1, "coupled"), cells, eps, xi, f)
    g, H = derivatives(xi)
    check_jacobian(dissipation, xi, g, step=1e-3, order=4)
    check_jacobian(lambda xi: derivatives(xi)[0], xi, H, step=1e-3, order=4)
    check_jacobian(lambda k: derivatives(xi, k)[0], k, f, step=1e-3)


def test_the_importer_is_one(tmp_path, block, monkeypatch):
    importer = run_fragment(2, monkeypatch)["LabImporter"]
    tracks = tmp_path / "tracks.txt"
    tracks.write_text(
        "0 -90 0 0 0 0\n500 -80 0 0 0 0\n1000 -70 0 8 0 1\n\n0 -60 0 8 0 1\n900 -50 0 17 0 2\n"
    )
    log, obj = importer(GridObject.from_yaml(block)).read(tracks)
    assert obj.name and [len(push.t_observed) for push in log] == [2, 1]
    np.testing.assert_allclose(log[0].final_pose, [0.008, 0.0, np.radians(1)])
    np.testing.assert_allclose((log[0].push.radius, log[0].push.length), (0.006, 0.02))
    tracks.write_text("0 -90 0 0 0 0\n")
    with pytest.raises(PushLogError, match=r"tracks\.txt: block 1; expected blocks"):
        importer(obj).read(tracks)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(PushLogError, match="pipe: cannot be read: is a pipe"):
        importer(obj).read(tmp_path / "pipe")


def test_the_method_is_one(monkeypatch):
    method = run_fragment(6, monkeypatch)["method"]
    made = make_pushed_block()
    found = identify(Model(made.obj), made.log, method, budget=60, regime="quasi_static")
    assert found.method == "powell"
    assert found.message.startswith("The search ended after 60 simulations: budget spent.")
    assert found.history[-1].loss < found.history[0].loss


def test_the_entry_of_a_bench_is_one():
    entry = find_blocks("docs/extending.md", r"\{code-block\} python")[8]
    (name,) = entries = eval("{" + entry + "}", {"LazyCommand": LazyCommand})
    study = find_blocks("docs/extending.md", r"\{code-block\} python")[7]
    assert entries[name].target == f"gridpush_drake.bench.{name}:STUDY"
    assert f'name="{name}"' in study
    assert f'help="{entries[name].help}"' in study


def test_two_objects_are_a_scenario():
    scene = find_blocks("docs/extending.md", "yaml")[3]
    assert scene == find_scenario("two_objects").read_text()


def test_how_presses_are_set_is_a_scenario():
    (block,) = find_blocks("docs/howto/weigh_at_the_edge.md", "yaml")
    scenario = parse_scenario(Path("weigh.yaml"), block)
    assert scenario.unknown_inertia
    assert scenario.weighing.max_presses == 8
    assert scenario.safety.force == 30.0


def test_a_gripper_that_pushes_is_a_scenario():
    (block,) = find_blocks("docs/howto/pushers.md", "yaml")
    scenario = parse_scenario(Path("cell.yaml"), block)
    (meant,) = make_robot_directives("panda", grasping=False, pusher=scenario.pusher)
    assert scenario.directives[0].add_directives.file == meant.add_directives.file


def test_a_robot_s_scenes_are_those_that_the_page_names():
    (block,) = find_blocks("docs/reference/files.md", "yaml")
    named = parse_scenario(Path("cell.yaml"), block).directives[0].add_directives.file
    (meant,) = make_robot_directives("ur5e", grasping=False)
    assert named == meant.add_directives.file
    taken = parse_scenario(Path("cell.yaml"), "robot: ur5e")
    top = resolve(taken).table_top
    np.testing.assert_allclose(top.bounds, [0.2, -1.05, 1.0, 0.15])


def test_every_block_is_tried_somewhere():
    """Python runs (`EXAMPLES`); of all else there is a test, here or where the page is named in the tests."""
    found = {
        (name, language): len(find_blocks(name, re.escape(language)))
        for name in TEXTS.keys() - NOTEBOOKS
        for language in re.findall(r"^```([^\n]*\w[^\n]*)\n", TEXTS[name], re.MULTILINE)
        if language != "python" and not language.startswith(DIRECTIVES)
    }
    assert (
        found
        == {
            (
                "docs/extending.md",
                "{code-block} python",
            ): 9,  # a law, its use, an importer, its entry, a second identifier, a world's use, a method,
            # a study, its entry
            (
                "docs/extending.md",
                "yaml",
            ): 4,  # a robot, its scene and its gripper (tests/station/test_robot.py), two objects
            ("docs/howto/autodiff.md", "{code-block} python"): 1,  # tests/interop/test_examples.py
            ("docs/howto/own_object.md", "yaml"): 1,
            ("docs/howto/own_pushes.md", "csv"): 2,
            ("docs/howto/pushers.md", "yaml"): 1,
            ("docs/howto/weigh_at_the_edge.md", "yaml"): 1,
            ("docs/reference/files.md", "yaml"): 1,
        }
    )


def test_there_are_as_many_notebooks_as_the_pages_say():
    assert len(NOTEBOOKS) == 7
    for name in ("README.md", "docs/index.md", "docs/tutorials/index.md"):
        assert "seven notebooks" in TEXTS[name].lower()


def test_the_object_and_the_pushes_can_be_read(tmp_path):
    text = find_blocks("docs/howto/own_object.md", "yaml")[0]
    assert set(yaml.safe_load(text)) >= {
        "name",
        "outline",
        "parts",
        "total_mass",
        "center_of_mass",
        "pusher",
    }
    (tmp_path / "object.yaml").write_text(text)
    obj = GridObject.from_yaml(tmp_path / "object.yaml")
    assert set(obj.labels) == {1, 2}
    alone, several = find_blocks("docs/howto/own_pushes.md", "csv")
    (tmp_path / "pushes.csv").write_text(alone)
    assert len(PushLog.read_csv(tmp_path / "pushes.csv")) == 1
    (tmp_path / "scene.csv").write_text(several)
    assert PushLog.read_csv(tmp_path / "scene.csv").names == ("hammer", "box")


def test_every_column_object_and_scenario_is_named():
    for column in PUSH_COLUMNS:
        assert f"`{column}`" in TEXTS["docs/howto/own_pushes.md"]
    for shipped in list_shipped_objects():
        assert f"`{shipped}`" in TEXTS["docs/first_steps.md"]
    for path in sorted((ROOT / "models/scenarios").glob("*.yaml")):
        assert f"`{path.stem}`" in TEXTS["docs/reference/files.md"]


@pytest.mark.parametrize(
    "name", sorted(name for name, text in TEXTS.items() if find_commands(text))
)
def test_the_commands_are_the_commands(name):
    for line in find_commands(TEXTS[name]):
        command = typer.main.get_command(app)
        words, _ = split_ros_arguments(line.split()[1:])
        while words and hasattr(command, "commands") and not words[0].startswith("-"):
            found = command.get_command(None, words[0])
            assert found is not None or words[0] in STAND_INS or words[0].isupper(), line
            if found is None:
                words = []
            else:
                command, words = found, words[1:]
        options = {
            option
            for parameter in command.params
            for option in (*parameter.opts, *parameter.secondary_opts)
        }
        used = {word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)}
        assert used <= options | EVERYWHERE, f"{line}: {used - options}"


def test_the_tree_is_the_tree():
    if not (ROOT / "gridpush_drake").is_dir():
        pytest.skip("the tests stand beside an installed package, not in its checkout")
    package = TEXTS["docs/reference/layout.md"].partition("Beside it")[0]
    folders = set(re.findall(r"^\| `(\w+)/`", package, re.MULTILINE))
    packages = {path.parent.name for path in (ROOT / "gridpush_drake").glob("*/__init__.py")}
    assert folders - {"models"} == packages


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_named_files_are_there(name):
    named = re.findall(r"`((?:gridpush_drake|systems|models|tests|docs)/[\w/.]+)`", TEXTS[name])
    if name == "docs/theory/paper.md":
        below = re.findall(r"`((?:dynamics|identification|planning)/[\w/]+\.py)`", TEXTS[name])
        assert len(below) > 20
        named += [f"gridpush_drake/{file}" for file in below]
    assert [file for file in named if not (ROOT / file).exists()] == []


def test_every_part_of_a_file_is_explained():
    """The scenario's and the robot's: what stands on the page is there, and all of it stands there."""
    named = re.findall(
        r"^\.\. autoclass:: ([\w.]+)\.(\w+)$", TEXTS["docs/reference/files.md"], re.MULTILINE
    )
    schemas = {
        (module, name)
        for module in sorted({module for module, _ in named})
        for name, thing in vars(import_module(module)).items()
        if isinstance(thing, type)
        and issubclass(thing, BaseModel)
        and thing.__module__ == module
        and name[0] != "_"
    }
    assert set(named) == schemas - {("gridpush_drake.station.schema.scenario", "PushScenario")}


def test_the_theory_names_its_files():
    for name in ("model", "identification", "planning", "perception"):
        assert TEXTS[f"docs/theory/{name}.md"].count("*In the code:*") >= 4


def test_the_links_of_readme_lead_somewhere():
    links = re.findall(r"\]\(([^)#:]+)\)", TEXTS["README.md"])
    assert len(links) > 8
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_ros_is_had_by_pip_as_it_is_tested():
    page = (ROOT / "docs/howto/ros2.md").read_text()
    packages = re.search(r"pip install (ros-jazzy-\{[\w,-]+\})", page)[1]
    assert packages in (ROOT / ".ci/run").read_text()
    scenarios = set(re.findall(r"--scenario (\S+)", page))
    assert scenarios <= set(list_shipped_scenarios())

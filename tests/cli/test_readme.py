import re
from pathlib import Path

import pytest
import yaml

import gridpush_drake
from gridpush_drake.cli.main import app
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import list_shipped_objects
from gridpush_drake.pushes.push_log import COLUMNS, PushLog

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_the_python_runs(block, pushes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    block.rename("object.yaml")
    examples = blocks("python")
    assert len(examples) == 3
    for example in examples:
        exec(compile(example, "README.md", "exec"), {})


def test_the_python_names_public_things_only():
    for example in blocks("python"):
        ours = re.findall(r"from gridpush_drake([\w.]*) import ([\w, ]+)", example)
        assert ours
        for module, names in ours:
            assert module == "" and set(names.split(", ")) <= set(gridpush_drake.__all__)


def test_the_python_type_checks(tmp_path):
    mypy = pytest.importorskip("mypy.api", reason="mypy is not installed")
    files = []
    for i, example in enumerate(blocks("python")):
        files.append(tmp_path / f"example_{i}.py")
        files[-1].write_text(example)
    settings = ROOT / "pyproject.toml"
    out, err, code = mypy.run([*map(str, files), f"--config-file={settings}", "--follow-imports=silent", "--strict"])
    assert code == 0, out + err


def test_the_object_and_the_pushes_can_be_read(tmp_path):
    (text,) = blocks("yaml")
    assert set(yaml.safe_load(text)) >= {"name", "outline", "parts", "total_mass", "center_of_mass", "pusher"}
    (tmp_path / "object.yaml").write_text(text)
    obj = GridObject.from_yaml(tmp_path / "object.yaml")
    assert set(obj.labels) == {1, 2}
    (text,) = blocks("csv")
    (tmp_path / "pushes.csv").write_text(text)
    assert len(PushLog.read_csv(tmp_path / "pushes.csv")) == 1


def test_it_names_every_column_and_object():
    for name in (*COLUMNS, *list_shipped_objects()):
        assert f"`{name}`" in README


def test_its_commands_are_the_commands(gridpush):
    lines = re.findall(r"^    gridpush (\w+)(?: (cmu|speed|paper|real|drake|planning|pregrasp))?", README, re.MULTILINE)
    assert len(lines) >= 6
    for line in lines:
        assert gridpush(*filter(None, line), "--help").code == 0
    assert app.info.name == "gridpush"


def test_its_tree_is_the_tree():
    if not (ROOT / "gridpush_drake").is_dir():
        pytest.skip("the tests stand beside an installed package, not in its checkout")
    folders = set(re.findall(r"^ {6}(\w+)/ ", README, re.MULTILINE))
    packages = {path.parent.name for path in (ROOT / "gridpush_drake").glob("*/__init__.py")}
    assert folders | {"systems"} == packages

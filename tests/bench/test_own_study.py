"""A bench of the reader's own, as `docs/extending.md` writes one, from the file to the command."""

import json
import re
from importlib import import_module
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from gridpush_drake.cli.bench.command import make_command
from gridpush_drake.jobs.results import open_results
from gridpush_drake.jobs.run import Execution

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"

pytestmark = pytest.mark.skipif(
    not PAGE.is_file(), reason="a wheel's tests have no docs beside them"
)


@pytest.fixture
def study(tmp_path, monkeypatch):
    """The page's study, in a module that can be imported."""
    blocks = re.findall(r"```\{code-block\} python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (code,) = [block for block in blocks if block.startswith('"""The bench "sides"')]
    (tmp_path / "sides.py").write_text(code)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return import_module("sides").STUDY


def test_it_runs_and_goes_on_where_it_ended(study, tmp_path):
    quiet = Execution(workers=0)
    (table,) = study.run(execution=quiet, objects=("pliers",), sets=3, seed=4)
    assert [row[:2] for row in table.rows] == [["pliers", 3], ["all", 3]]
    assert 1.0 < table.rows[0][2] < 60.0
    (other,) = study.run(execution=quiet, objects=("pliers",), sets=3, seed=40)
    assert other.rows[0][2] != table.rows[0][2]
    for sets, told in ((1, 1), (3, 2)):
        results = open_results(tmp_path / "kept.jsonl", "sides", {})
        said = []
        execution = Execution(0, lambda *what, said=said: said.append(what[0]), results)
        (again,) = study.run(execution=execution, objects=("pliers",), sets=sets, seed=4)
        assert len([what for what in said if "set" in what]) == told
    assert again.rows == table.rows


def test_its_command_is_made_of_its_options(study, monkeypatch):
    monkeypatch.setattr("gridpush_drake.cli.shell.options.compile_all", lambda: None)
    app = typer.Typer(add_completion=False)
    app.command()(make_command(study))
    arguments = ["--objects", "pliers", "--quick", "--workers", "1", "--json"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    (table,) = json.loads(done.stdout)["tables"]
    assert [row[:2] for row in table["rows"]] == [["pliers", 1], ["all", 1]]
    assert CliRunner().invoke(app, ["--sets", "0"]).exit_code == 2

import subprocess
import sys

import pytest
import typer

from gridpush_drake.cli.bench.group import BENCHES
from gridpush_drake.cli.main import COMMANDS, app

LISTED_ONLY = """
import os, sys
from gridpush_drake.cli import main
try:
    main.main({args})
except SystemExit:
    pass
named = {{command.target.partition(":")[0] for command in main.COMMANDS.values()}}
benches = {{name for name in sys.modules if name.startswith("gridpush_drake.cli.bench.")}}
print("imported:", *sorted(named & set(sys.modules) | benches))
"""


def run_and_list_imports(args):
    """Runs `gridpush` in a process of its own; returns what it printed, and the command modules it imported."""
    printed = subprocess.run(
        [sys.executable, "-c", LISTED_ONLY.format(args=args)],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    shown, _, imported = printed.rpartition("imported:")
    return shown, imported.split()


@pytest.mark.parametrize("args", [["--help"], ["--version"], [], ["pull"]], ids=" ".join)
def test_what_lists_the_commands_imports_none(args):
    assert run_and_list_imports(args)[1] == []


@pytest.mark.parametrize(
    ("args", "says", "module"),
    [("show", "gridpush show", "view.show"), ("bench", "perception", "bench.group")],
)
def test_a_command_imports_itself_only(args, says, module):
    shown, imported = run_and_list_imports([args, "--help"])
    assert says in shown
    assert imported == [f"gridpush_drake.cli.{module}"]


@pytest.mark.parametrize(
    ("path", "table", "name"),
    [((), COMMANDS, name) for name in COMMANDS] + [(("bench",), BENCHES, name) for name in BENCHES],
)
def test_the_list_says_what_the_command_itself_says_first(path, table, name):
    command = typer.main.get_command(app)
    for word in (*path, name):
        command = command.get_command(None, word)
    assert command.name == name
    assert table[name].help == (command.short_help or command.help).partition("\n\n")[0]


def test_the_list_is_the_same_once_all_are_imported():
    group = typer.main.get_command(app)
    before = group.get_help(group.make_context("gridpush", [], resilient_parsing=True))
    for name in COMMANDS:
        group.get_command(None, name)
    assert group.get_help(group.make_context("gridpush", [], resilient_parsing=True)) == before


def test_completion_in_the_shell_imports_no_command_to_list_them():
    script = (
        "import sys, typer\n"
        "from gridpush_drake.cli.main import app\n"
        "group = typer.main.get_command(app)\n"
        "context = group.make_context('gridpush', [], resilient_parsing=True)\n"
        "print(*[each.value for each in group.shell_complete(context, 'tra')])\n"
        "print('gridpush_drake.cli.camera.track' in sys.modules)\n"
    )
    printed = subprocess.run(
        [sys.executable, "-c", script], check=True, capture_output=True, text=True
    ).stdout
    assert printed.split() == ["track", "tracker", "False"]

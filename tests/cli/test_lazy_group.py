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
print("imported:", *sorted(named & set(sys.modules)))
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


def test_a_command_imports_itself_only():
    shown, imported = run_and_list_imports(["show", "--help"])
    assert "gridpush show" in shown
    assert imported == ["gridpush_drake.cli.view.show"]


@pytest.mark.parametrize("name", COMMANDS)
def test_the_list_says_what_the_command_itself_says_first(name):
    command = typer.main.get_command(app).get_command(None, name)
    assert command.name == name
    assert COMMANDS[name].help == (command.short_help or command.help).partition("\n\n")[0]


def test_the_list_is_the_same_once_all_are_imported():
    group = typer.main.get_command(app)
    before = group.get_help(group.make_context("gridpush", [], resilient_parsing=True))
    for name in COMMANDS:
        group.get_command(None, name)
    assert group.get_help(group.make_context("gridpush", [], resilient_parsing=True)) == before


def test_the_list_of_benches_imports_none():
    script = (
        "import sys\n"
        "from gridpush_drake.cli.main import main\n"
        "try:\n"
        "    main(['bench', '--help'])\n"
        "except SystemExit:\n"
        "    pass\n"
        "print('imported:', *[name for name in sys.modules if name.startswith('gridpush_drake.cli.bench.')])\n"
    )
    printed = subprocess.run(
        [sys.executable, "-c", script], check=True, capture_output=True, text=True
    ).stdout
    shown, _, imported = printed.rpartition("imported:")
    assert "perception" in shown
    assert imported.split() == ["gridpush_drake.cli.bench.group"]


@pytest.mark.parametrize("name", BENCHES)
def test_the_list_says_what_the_bench_itself_says_first(name):
    group = typer.main.get_command(app).get_command(None, "bench")
    command = group.get_command(None, name)
    assert command.name == name
    assert BENCHES[name].help == (command.short_help or command.help).partition("\n\n")[0]


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

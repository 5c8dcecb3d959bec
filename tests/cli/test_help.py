"""What `gridpush COMMAND --help` shows: every word that was written, and a command to begin with."""

import re

import pytest
import typer

from gridpush_drake.cli.bench.group import BENCHES
from gridpush_drake.cli.main import COMMANDS, app
from gridpush_drake.pushes.importers import IMPORTER_CLASSES
from tests.helpers.command_line import run_gridpush

EVERY = [
    *[(name,) for name in COMMANDS if name not in ("bench", "import")],
    *[("import", name) for name in IMPORTER_CLASSES],
    *[("bench", name) for name in BENCHES],
]


def find_command(words):
    """Finds the command of some words, such as ("import", "bag")."""
    command = typer.main.get_command(app)
    for word in words:
        command = command.get_command(None, word)
    return command


def squeeze(text):
    """Returns a text without white space, and without the frame of the help's tables."""
    return "".join(text.replace("│", " ").split())


@pytest.mark.parametrize("words", EVERY, ids=" ".join)
def test_a_command_and_every_word_of_its_options_are_explained(capsys, monkeypatch, words):
    """Rich takes `[word]` for markup and leaves it out, unless it is escaped."""
    monkeypatch.setenv("COLUMNS", "2000")
    outcome = run_gridpush(capsys, *words, "--help")
    assert (outcome.code, outcome.err) == (0, "")
    assert f"Usage: gridpush {' '.join(words)}" in outcome.out
    assert words[0] == "bench" or f"Example: gridpush {' '.join(words)}" in outcome.out
    shown = squeeze(outcome.out)
    for option in find_command(words).params:
        assert option.help.endswith("."), option.name
        assert squeeze(option.help.replace("\\[", "[")) in shown, option.name


@pytest.mark.parametrize("words", EVERY, ids=" ".join)
def test_what_an_option_takes_is_named_whole_on_a_narrow_terminal(capsys, monkeypatch, words):
    """A column of 24 characters would break a list of names in the middle of a name."""
    monkeypatch.setenv("COLUMNS", "80")
    shown = run_gridpush(capsys, *words, "--help").out
    broken = [line for line in shown.splitlines() if re.search(r"<(?!=)[^>]*$", line)]
    assert not broken
    for option in find_command(words).params:
        assert option.metavar is None or option.metavar in shown, option.name

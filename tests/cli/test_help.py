"""What `gridpush COMMAND --help` shows: every word that was written, and a command to begin with."""

import re

import pytest
import typer

from gridpush_drake.cli.bench.group import BENCHES
from gridpush_drake.cli.main import COMMANDS, app
from gridpush_drake.pushes.importers import IMPORTER_CLASSES
from tests.helpers.command_line import run_gridpush

PLAIN = [(name,) for name in COMMANDS if name not in ("bench", "import")]
OTHERS = [("import", name) for name in IMPORTER_CLASSES]


def find_command(words):
    """Finds the command of some words, such as ("import", "bag")."""
    command = typer.main.get_command(app)
    for word in words:
        command = command.get_command(None, word)
    return command


def squeeze(text):
    """Returns a text without white space, and without the frame of the help's tables."""
    return "".join(text.replace("│", " ").split())


@pytest.mark.parametrize(
    "words", [*PLAIN, *OTHERS, *[("bench", name) for name in BENCHES]], ids=" ".join
)
def test_every_word_of_an_option_is_shown(capsys, monkeypatch, words):
    """Rich takes `[word]` for markup and leaves it out, unless it is escaped."""
    monkeypatch.setenv("COLUMNS", "2000")
    shown = squeeze(run_gridpush(capsys, *words, "--help").out)
    for option in find_command(words).params:
        said = squeeze((option.help or "").replace("\\[", "["))
        assert said in shown, option.name


@pytest.mark.parametrize(
    "words", [*PLAIN, *OTHERS, *[("bench", name) for name in BENCHES]], ids=" ".join
)
def test_what_an_option_takes_is_named_whole_on_a_narrow_terminal(capsys, monkeypatch, words):
    """A column of 24 characters would break a list of names in the middle of a name."""
    monkeypatch.setenv("COLUMNS", "80")
    shown = run_gridpush(capsys, *words, "--help").out
    broken = [line for line in shown.splitlines() if re.search(r"<(?!=)[^>]*$", line)]
    assert not broken
    for option in find_command(words).params:
        assert option.metavar is None or option.metavar in shown, option.name


@pytest.mark.parametrize("words", [*PLAIN, *OTHERS], ids=" ".join)
def test_a_command_and_all_its_options_are_explained(capsys, monkeypatch, words):
    monkeypatch.setenv("COLUMNS", "200")
    assert f"Example: gridpush {' '.join(words)}" in run_gridpush(capsys, *words, "--help").out
    for option in find_command(words).params:
        assert option.help, option.name
        assert option.help.endswith("."), option.name

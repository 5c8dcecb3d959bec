import pytest

from gridpush_drake.cli.shell import console
from gridpush_drake.cli.shell.console import PlainProgress, count_progress, search_progress
from gridpush_drake.identification.result import HistoryEntry


@pytest.fixture
def clock(monkeypatch):
    """Seconds that only the test lets pass."""
    now = [0.0]
    monkeypatch.setattr(console, "monotonic", lambda: now[0])
    return now


def test_plain_lines_tell_what_is_new_at_once_and_the_rest_now_and_then(clock, capsys):
    progress = PlainProgress(period=5.0)
    for doing, detail, at in (
        ("exploring", "1 s", 0.0),
        ("exploring", "2 s", 1.0),
        ("exploring", "9 s", 6.0),
        ("exploring", "9 s", 12.0),
        ("sliding", "9 s", 12.1),
        ("sliding", "10 s", 12.2),
    ):
        clock[0] = at
        progress.update(doing, detail)
    printed = capsys.readouterr()
    assert printed.err.splitlines() == ["exploring, 1 s", "exploring, 9 s", "sliding, 9 s"]
    assert printed.out == ""


def test_without_a_terminal_progress_is_plain_lines_on_standard_error(clock, capsys):
    with count_progress("the robot", 2) as report:
        report("waiting", "0 s simulated", 0)
        report("exploring", "3 s simulated", 1)
    with search_progress("timing", None) as report:
        report(HistoryEntry(1, 0.0025, "a push"))
    printed = capsys.readouterr()
    assert printed.err.splitlines() == [
        "the robot: waiting, 0 s simulated",
        "the robot: exploring, 3 s simulated",
        "timing: a push, 1 simulations, cell error 2.50 mm",
    ]
    assert printed.out == ""

import os
import re
import signal
import subprocess
import sys

import pytest
import typer

import gridpush_drake
from gridpush_drake.cli.main import app
from gridpush_drake.cli.shell.options import OptionError, parse_numbers

PATIENCE = 60
"""s after which a process that should have ended is given up."""


def test_a_paragraph_of_help_has_no_line_breaks_of_the_source():
    """Typer keeps the line breaks of a help text, so that none may be left within a sentence."""
    pending, commands = [typer.main.get_command(app)], []
    while pending:
        command = pending.pop()
        if hasattr(command, "list_commands"):
            pending += [command.get_command(None, name) for name in command.list_commands(None)]
        else:
            commands.append(command)
    assert len(commands) > 25
    paragraphs = [text for command in commands for text in command.help.split("\n\n")]
    assert [text for text in paragraphs if "\n" in text] == []


@pytest.mark.parametrize("command", ["identify", "predict", "record"])
def test_a_terminal_of_80_columns_shows_all_columns_of_a_log(gridpush, command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = gridpush(command, "--help").out
    assert "object_theta" in shown and "…" not in shown


@pytest.mark.parametrize("command", [(), ("import",), ("bench",)], ids=" ".join)
def test_a_group_shows_its_help_also_where_nothing_is_asked(gridpush, command):
    outcome = gridpush(*command)
    assert f"Usage: {' '.join(['gridpush', *command])}" in outcome.out
    assert "Commands" in outcome.out
    assert (outcome.code, outcome.err) == (0, "")
    assert gridpush(*command, "--help").out.split() == outcome.out.split()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["demoo"], ["gridpush demoo: there is no such command; did you mean demo?", "identify"]),
        (["bench", "fast"], ["gridpush bench fast: there is no such command", "speed", "pusht"]),
        (
            ["import", "mitt"],
            ["gridpush import mitt: there is no such", "did you mean mit?", "bag"],
        ),
    ],
    ids=" ".join,
)
def test_names_the_commands_that_there_are(refuses, words, says):
    refuses(*words, says=says)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--task", "juggle"], "'--task': 'juggle' is not one of 'identify', 'push',"),
        (["--seed", "many"], "'--seed': expected a whole number\n"),
        (["--seed", "-1"], "'--seed': expected at least 0\n"),
        (["--realtime-rate", "slow"], "'--realtime-rate': expected a number\n"),
    ],
    ids=" ".join,
)
def test_says_plainly_what_an_option_takes(refuses, words, says):
    refuses("demo", *words, says=[says])


def test_prints_its_version(gridpush):
    assert gridpush("--version").out == f"gridpush {gridpush_drake.__version__}\n"


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("pull",), ["pull"]),
        (("show", "claw_hammer"), ["--out"]),
        (("show", "claw_hammer", "--out", "a.png", "--color"), ["--color"]),
        (
            ("identify", "a.yaml", "b.csv", "--out", "m.yaml", "--method", "guess"),
            ["--method", "guess"],
        ),
        (
            (
                "simulate",
                "claw_hammer",
                "--start",
                "0,0",
                "--velocity",
                "0,1",
                "--duration",
                "long",
            ),
            ["--duration"],
        ),
    ],
)
def test_says_in_one_line_what_is_wrong_with_its_arguments(refuses, args, says):
    refuses(*args, says=says)


def test_completes_in_the_shell(tmp_path):
    def run(*args, **settings):
        from_bash = ["bash", "-c", '"$@"; exit $?', "bash"]
        command = [*from_bash, sys.executable, "-m", "gridpush_drake.cli.main", *args]
        environment = os.environ | {"HOME": str(tmp_path)} | settings
        return subprocess.run(
            command, check=True, capture_output=True, text=True, env=environment
        ).stdout

    assert "complete -o default -F _gridpush_completion gridpush" in run("--show-completion")
    run("--install-completion")
    assert "_gridpush_completion" in (tmp_path / ".bash_completions/gridpush.sh").read_text()
    asked = {
        "_GRIDPUSH_COMPLETE": "complete_bash",
        "COMP_WORDS": "gridpush ident",
        "COMP_CWORD": "1",
    }
    assert run(**asked).split() == ["identify"]


@pytest.mark.parametrize("module", ["gridpush_drake", "gridpush_drake.cli.main"])
def test_imports_nothing_heavy(module):
    heavy = ("numpy", "numba", "scipy", "matplotlib", "shapely", "jinja2", "pydantic", "pydrake")
    code = f"import sys, {module}; print(*[name for name in {heavy} if name in sys.modules])"
    printed = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout
    assert set(printed.split()) <= {"pydantic"}  # Typer's own


def test_every_public_name_is_there():
    assert list(gridpush_drake.__all__) == sorted(gridpush_drake.__all__)
    for name in gridpush_drake.__all__:
        assert getattr(gridpush_drake, name).__name__ == name
        assert name in dir(gridpush_drake)
    assert re.match(r"\d+\.\d+", gridpush_drake.__version__)
    with pytest.raises(AttributeError, match="nothing"):
        _ = gridpush_drake.nothing


def test_reads_numbers():
    assert parse_numbers("--start", "-0.1,2e-3", "x,y", "m") == (-0.1, 0.002)
    for text in ("", "1", "1,2,3", "1,b", "1,nan", "1;2"):
        with pytest.raises(OptionError, match=r"--start.*x,y \(m\)"):
            parse_numbers("--start", text, "x,y", "m")


LATE = """
import atexit, os, signal, sys

class Late:
    def __del__(self, kill=os.kill, pid=os.getpid(), number=int(sys.argv[1])):
        kill(pid, number)

late = Late()
atexit.register(os.kill, os.getpid(), int(sys.argv[1]))
sys.argv[1:] = ["--version"]
from gridpush_drake.cli.main import main
main()
"""
"""Sends a signal while the interpreter shuts down, and another once its signal handlers are
gone."""


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_after_the_work_changes_nothing(number):
    done = subprocess.run(
        [sys.executable, "-c", LATE, str(int(number))], capture_output=True, text=True, timeout=PATIENCE, check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("gridpush ")


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_an_interrupt_that_python_ignores_ends_the_process_all_the_same(number, code):
    """One raised in a finalizer is lost; the process ends a moment later."""
    script = (
        "import os, signal, sys, time\n"
        "from gridpush_drake.cli import main\n"
        "class Deaf:\n"
        "    def __del__(self):\n"
        f"        os.kill(os.getpid(), {int(number)})\n"
        "        time.sleep(0.1)\n"
        "def run(args):\n"
        "    Deaf()\n"
        f"    time.sleep({10 * PATIENCE})\n"
        "main._run = run\n"
        "main.main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE, check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert done.returncode == code
    assert done.stderr.endswith("gridpush: interrupted; no file was left half-written\n")

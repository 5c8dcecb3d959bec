import errno
import fcntl
import os
import pty
import signal
import subprocess
import sys
import termios
import time

import pytest

from gridpush_drake.cli.run.robot import _stopping
from gridpush_drake.cli.shell.interrupts import set_handlers
from gridpush_drake.cli.shell.output import LosableOutput, losable_outputs, safe_output

pytestmark = pytest.mark.skipif(os.name == "nt", reason="POSIX signals and terminals")

WORK = """
import sys, time
from pathlib import Path
from gridpush_drake.cli import main

def run(args):
    Path(sys.argv[1]).write_text("begun")
    try:
        while True:
            time.sleep(0.01)
    finally:
        print("clearing up")
        print("clearing up", file=sys.stderr, flush=True)
        Path(sys.argv[1]).write_text("cleared up")

main._run = run
main.main()
"""
"""A command that works until it is asked to end, and then says so."""


def start(folder, **options):
    process = subprocess.Popen([sys.executable, "-c", WORK, folder / "told"], **options)
    end = time.monotonic() + 60
    while not (folder / "told").exists() and time.monotonic() < end:
        time.sleep(0.02)
    return process


def test_a_lost_terminal_ends_a_command_as_a_signal_does(tmp_path):
    """Its output can go nowhere by then, and the signal comes more than once."""
    try:
        ours, its = pty.openpty()
    except OSError as error:  # such as in a file system without /dev/pts
        pytest.skip(f"no terminal can be made here: {error}")
    process = start(
        tmp_path, stdin=its, stdout=its, stderr=its, start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    )  # fmt: skip
    os.close(its)
    os.close(ours)
    process.send_signal(signal.SIGHUP)
    assert process.wait(30) == 129
    assert (tmp_path / "told").read_text() == "cleared up"


def test_a_hangup_still_reaches_the_file_that_output_goes_to(tmp_path):
    process = start(tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.send_signal(signal.SIGHUP)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 129
    assert out == "clearing up\n"
    assert err == "clearing up\ngridpush: interrupted; no file was left half-written\n"


def test_under_nohup_a_hangup_changes_nothing(tmp_path):
    process = start(
        tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )  # fmt: skip
    process.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30)
    assert process.returncode == 143


def test_the_handlers_before_are_given_back():
    before = signal.getsignal(signal.SIGHUP)
    handlers = set_handlers(lambda number, frame: None)
    try:
        assert handlers[signal.SIGHUP] == before
        assert set(handlers) == {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def test_output_that_nobody_reads_any_more_is_told_once_and_raises_nothing():
    reader, writer = os.pipe()
    errors = []
    with os.fdopen(writer, "w", buffering=1) as stream:
        output = LosableOutput(stream, errors.append)
        assert output.write("heard\n") == 6
        os.close(reader)
        assert errors == []
        for _ in range(3):
            assert output.write("unheard\n") == 8
            output.flush()
        assert [error.errno for error in errors] == [errno.EPIPE]
        assert output.fileno() == writer


def test_print_and_progress_go_through_it(capsys, monkeypatch):
    def refuse(text):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    errors, before = [], sys.stderr
    with losable_outputs(errors.append):
        print("on standard output")
        monkeypatch.setattr(before, "write", refuse)
        print("on a lost terminal", file=sys.stderr)
        print("and again", file=sys.stderr)
    assert sys.stderr is before
    assert [error.errno for error in errors] == [errno.EIO]
    assert capsys.readouterr().out == "on standard output\n"


def test_a_command_that_loses_its_output_is_told_within_the_command_line_too(monkeypatch):
    def refuse(text):
        raise OSError(errno.EPIPE, os.strerror(errno.EPIPE))

    errors = []
    monkeypatch.setattr(sys.stdout, "write", refuse)
    with safe_output() as output, losable_outputs(errors.append):
        print("unheard")
        print("unheard")
    assert [error.errno for error in errors] == [errno.EPIPE]
    assert output.problem == "cannot be written: Broken pipe"


class Link:
    """Counts how often the robot is asked to stop."""

    def __init__(self):
        self.stops, self.notes = 0, []

    def request_stop(self):
        self.stops += 1

    def note(self, text):
        self.notes.append(text)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_stops_the_arm_and_only_a_second_ctrl_c_ends_the_process(number):
    link = Link()
    before = signal.signal(number, signal.default_int_handler)
    try:
        with _stopping(link) as asked:
            signal.raise_signal(number)
            assert (link.stops, asked.number) == (1, number)
            assert link.notes == [f"asked to stop by {number.name}"]
            if number == signal.SIGHUP:
                signal.raise_signal(number)
            else:
                with pytest.raises(KeyboardInterrupt):
                    signal.raise_signal(number)
        assert signal.getsignal(number) == signal.default_int_handler
    finally:
        signal.signal(number, before)

"""How a command ends when it is asked to by a signal, and what becomes of its output when the terminal is lost.

SIGINT (Ctrl-C), SIGTERM and SIGHUP (a terminal or an ssh connection that is lost) end a command in
the same way: its files are whole or not there, and its exit code is 128 + the signal's number.
After SIGHUP nothing is printed on the lost terminal any more, where that would fail. A SIGHUP that
is ignored when the command begins, as by `nohup`, stays ignored.

`robot` answers these signals itself, see `gridpush_drake.cli.robot`.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Timer, current_thread, main_thread
from types import FrameType
from typing import Any

from gridpush_drake.cli.output import discard_output

SIGNALS = (
    signal.SIGINT,
    signal.SIGTERM,
    *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()),
)
"""Signals that ask a command to end; Windows has no SIGHUP."""

SIGNALED = 128
"""What shells add to a signal's number to make an exit code: 130 for SIGINT, 143 for SIGTERM, 129 for SIGHUP."""

SIGNAL_CODES = frozenset(SIGNALED + number for number in SIGNALS)
"""Exit codes of commands that were asked to end."""

EXIT_INTERRUPTED = SIGNALED + signal.SIGINT

UNWIND_WITHIN = 1.5
"""Time that the work has to clear up after itself, s; then the process ends as it is."""

OUTPUTS = (1, 2)
"""File descriptors of standard output and standard error."""


class Interrupts:
    """What came of the signals.

    Attributes:
        code: to exit with where a signal came; None where none did.
    """

    code: int | None = None

    def __init__(self, graceful: bool) -> None:
        """Has seen no signal yet; `graceful` commands may take their time to end."""
        self._graceful, self._finished = graceful, False
        self._terminals = [number for number in OUTPUTS if _is_terminal(number)]

    def finish(self) -> None:
        """From now on the work is done, and a signal changes nothing."""
        self._finished = True

    def handle(self, number: int, _: FrameType | None) -> None:
        """Interrupts the work; a second signal ends the process at once."""
        if is_hangup(number):
            self.abandon_terminals()
        if self._finished:
            return
        if self.code is not None:
            if is_hangup(number):  # the shell and the system both send one
                return
            self.end()
        self.code = SIGNALED + number
        # the exception may be lost: Python ignores those that are raised in a callback of C code or
        # in a finalizer
        if not self._graceful:
            timer = Timer(UNWIND_WITHIN, self.end)
            timer.daemon = True
            timer.start()
        raise KeyboardInterrupt

    def abandon_terminals(self) -> None:
        """Sends nowhere what is still printed on a terminal; what goes to a file or a pipe still goes there."""
        for number in self._terminals:
            discard_output(number)
        self._terminals.clear()

    def end(self) -> None:
        """Ends the process with all the workers that it has."""
        from multiprocessing import active_children  # for start-up

        if self._finished:
            return
        for child in active_children():
            child.kill()
        say_interrupted()
        os._exit(self.code or 0)


@contextmanager
def watch_interrupts(last: bool, graceful: bool) -> Iterator[Interrupts]:
    """Handles the signals while a command runs.

    Args:
        last: whether the process ends with the command; if so, the signals stay handled, for Python
            would end by the signal itself where one comes while it shuts down.
        graceful: whether the command may take its time to end, as one that writes what was done so
            far.

    Yields:
        What came of them; nothing is handled outside the main thread.
    """
    interrupts = Interrupts(graceful)
    if current_thread() is not main_thread():
        yield interrupts
        return
    before = set_handlers(interrupts.handle)
    try:
        yield interrupts
    finally:
        interrupts.finish()
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if last else handler)


def set_handlers(handle: Callable[[int, FrameType | None], None]) -> dict[int, Any]:
    """Has all signals that ask a command to end handled by a function.

    Returns:
        The handlers before, by the signals' numbers; without SIGHUP where that is ignored.
    """
    numbers = [
        number
        for number in SIGNALS
        if not (is_hangup(number) and signal.getsignal(number) == signal.SIG_IGN)
    ]
    return {int(number): signal.signal(number, handle) for number in numbers}


def is_hangup(number: int) -> bool:
    """Whether a signal says that the terminal is lost."""
    return number == getattr(signal, "SIGHUP", None)


def say_interrupted() -> None:
    """Says on standard error what an interrupted user wants to know, where anybody can still read it."""
    with suppress(OSError):
        print("gridpush: interrupted; no file was left half-written", file=sys.stderr, flush=True)


def _is_terminal(number: int) -> bool:
    try:
        return os.isatty(number)
    except OSError:
        return False

"""How a signal ends a command.

SIGINT (Ctrl-C), SIGTERM, and SIGHUP (the terminal or the ssh connection is lost) end a command in
the same way: each of its files is either whole or not there, the processes that it has started are
ended, and its exit code is 128 plus the signal's number. After SIGHUP nothing is printed on the
lost terminal any more. A SIGHUP that is ignored when the command begins, as by `nohup`, stays
ignored.

The command `robot` handles these signals itself; see `gridpush_drake.cli.run.robot`.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Timer, current_thread, main_thread
from types import FrameType
from typing import Any

from gridpush_drake.cli.shell.output import discard_output

ENDING_SIGNALS = (
    signal.SIGINT,
    signal.SIGTERM,
    *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()),
)
"""Signals that ask a command to end; Windows has no SIGHUP."""

SIGNAL_EXIT_BASE = 128
"""What is added to a signal's number to make an exit code, as shells do: SIGINT makes 130, SIGTERM
143, SIGHUP 129."""

SIGNAL_CODES = frozenset(SIGNAL_EXIT_BASE + number for number in ENDING_SIGNALS)
"""Exit codes of commands that were asked to end."""

EXIT_INTERRUPTED = SIGNAL_EXIT_BASE + signal.SIGINT
"""Exit code of a command that was ended by Ctrl-C."""

UNWIND_WITHIN = 1.5
"""Time that a command has to clean up after a signal, s. Then the process is ended as it is."""

OUTPUT_DESCRIPTORS = (1, 2)
"""File descriptors of standard output and standard error."""


class Interrupts:
    """Handles the signals while a command runs, and remembers the first.

    Attributes:
        code: exit code of a command that a signal has ended; None if no signal came.
    """

    code: int | None = None

    def __init__(self, graceful: bool) -> None:
        """Begins; no signal has come yet.

        Args:
            graceful: whether the command may take as long as it needs to end.
        """
        self._graceful = graceful
        self._finished = False
        self._terminals = [number for number in OUTPUT_DESCRIPTORS if _is_terminal(number)]

    def finish(self) -> None:
        """Notes that the command is done: a signal that comes now changes nothing."""
        self._finished = True

    def handle(self, number: int, _: FrameType | None) -> None:
        """Interrupts the work; a second signal ends the process at once."""
        if is_hangup(number):
            self.abandon_terminals()
        if self._finished:
            return
        if self.code is not None:
            # A lost terminal sends SIGHUP twice, once by the shell and once by the system. The
            # second one is no request to hurry.
            if is_hangup(number):
                return
            self.end()
        self.code = SIGNAL_EXIT_BASE + number
        # The exception below may never arrive: Python drops exceptions that are raised while C code
        # calls back, or in a finalizer. Then the timer ends the process.
        if not self._graceful:
            timer = Timer(UNWIND_WITHIN, self.end)
            timer.daemon = True
            timer.start()
        raise KeyboardInterrupt

    def abandon_terminals(self) -> None:
        """Discards what is printed on a terminal from now on; files and pipes still get theirs."""
        for number in self._terminals:
            discard_output(number)
        self._terminals.clear()

    def end(self) -> None:
        """Ends the process and all its workers at once."""
        # imported here, for it would make every start of `gridpush` slower
        from multiprocessing import active_children

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
        last: whether the process ends with the command. If so, the signals are ignored afterwards:
            one that comes while Python shuts down would otherwise change the exit code.
        graceful: whether the command may take as long as it needs to end, for instance to write
            what was done so far.

    Yields:
        The handler, which knows whether a signal came. Outside the main thread, where Python does
        not allow it, no signal is handled.
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
    """Lets a function handle all signals that ask a command to end.

    Returns:
        The earlier handlers by the signals' numbers, to be restored later. SIGHUP is not among
        them if it is ignored; it is left alone then.
    """
    numbers = [
        number
        for number in ENDING_SIGNALS
        if not (is_hangup(number) and signal.getsignal(number) == signal.SIG_IGN)
    ]
    return {int(number): signal.signal(number, handle) for number in numbers}


def is_hangup(number: int) -> bool:
    """Returns whether a signal means that the terminal is lost."""
    return number == getattr(signal, "SIGHUP", None)


def say_interrupted() -> None:
    """Says on standard error that the command was interrupted and left no broken file."""
    with suppress(OSError):
        print("gridpush: interrupted; no file was left half-written", file=sys.stderr, flush=True)


def _is_terminal(number: int) -> bool:
    """Returns whether a file descriptor is a terminal; one that is closed is none."""
    try:
        return os.isatty(number)
    except OSError:
        return False

"""How the command ends on SIGINT and SIGTERM: at once, all it started with it, and with an exit code that says so."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer, current_thread, main_thread
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)

SIGNALLED = 128
"""What shells add to a signal's number to make an exit code: 130 for SIGINT, 143 for SIGTERM."""

UNWIND_WITHIN = 1.5
"""s that the work has to clear up after itself; then the process ends as it is."""


class Interrupts:
    """What came of the signals.

    Attributes:
        code: to exit with where a signal came; None where none did.
    """

    code: int | None = None

    def __init__(self, graceful: bool) -> None:
        self._graceful, self._finished = graceful, False

    def finish(self) -> None:
        """From now on the work is done, and a signal changes nothing."""
        self._finished = True

    def handle(self, number: int, _: FrameType | None) -> None:
        """Interrupts the work; a second signal ends the process at once."""
        if self._finished:
            return
        if self.code is not None:
            self.end()
        self.code = SIGNALLED + number
        # the exception may be lost: Python ignores those that are raised in a callback of C code or in a finalizer
        if not self._graceful:
            timer = Timer(UNWIND_WITHIN, self.end)
            timer.daemon = True
            timer.start()
        raise KeyboardInterrupt

    def end(self) -> None:
        """Ends the process with all the workers that it has."""
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
        last: whether the process ends with the command; if so, the signals stay handled, for Python would end by the
            signal itself where one comes while it shuts down.
        graceful: whether the command may take its time to end, as one that writes what was done so far.

    Yields:
        What came of them; nothing is handled outside the main thread.
    """
    interrupts = Interrupts(graceful)
    if current_thread() is not main_thread():
        yield interrupts
        return
    before = {number: signal.signal(number, interrupts.handle) for number in SIGNALS}
    try:
        yield interrupts
    finally:
        interrupts.finish()
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if last else handler)


def say_interrupted() -> None:
    """Says on standard error what an interrupted user wants to know."""
    print("gridpush: interrupted; no file was left half-written", file=sys.stderr, flush=True)

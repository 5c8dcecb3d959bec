"""Lets a command go on when standard output or standard error cannot be written to.

They may be closed, full, a terminal that is lost, or of an encoding other than UTF-8. A command
should do its work and write its files even so, and a program that moves an arm must not break off
in the middle of a motion because a line cannot be printed. Therefore a failed write never raises an
error here; it is reported once, at the end.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

STANDARD_ERROR = 2
"""File descriptor of standard error, the last of the three standard files."""


class LosableOutput:
    """A stream to which a write may fail: the failure is reported once, and never raised.

    A write fails if the terminal is lost (EIO), if nobody reads the pipe any more (EPIPE), or if
    the disk is full. After the first failure everything else that is written is discarded.

    Attributes:
        problem: what went wrong first, for a message; empty if everything could be written.
        listeners: functions that are called with the error of the first write that fails.
    """

    def __init__(
        self, stream: TextIO | None, tell: Callable[[OSError], None] | None = None
    ) -> None:
        """Wraps a stream.

        Args:
            stream: the stream to write to; None if it was closed before the process began.
            tell: the first of the `listeners`.
        """
        self._stream = stream
        self.problem = ""
        self.listeners = [] if tell is None else [tell]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @property
    def encoding(self) -> str:
        """Name of the encoding in which the stream writes text."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    def isatty(self) -> bool:
        """Returns whether the stream is a terminal."""
        with suppress(OSError, ValueError):
            return self._stream is not None and self._stream.isatty()
        return False

    def write(self, text: str) -> int:
        """Writes text. Returns the text's length, also if it could not be written."""
        if self._stream is None:
            if text and not self.problem:
                self.problem = "is closed"
        elif not self.problem:
            try:
                return self._stream.write(text)
            except OSError as error:
                self._lose(error)
        return len(text)

    def flush(self) -> None:
        """Writes the text that the stream has kept back so far."""
        if self._stream is not None and not self.problem:
            try:
                self._stream.flush()
            except OSError as error:
                self._lose(error)

    def _lose(self, error: OSError) -> None:
        """Notes the first failure, and tells the listeners."""
        self.problem = f"cannot be written: {error.strerror or error}"
        with suppress(OSError, ValueError, AttributeError):
            # Python writes what is kept back once more when it exits; that would fail again
            discard_output(self._stream.fileno())  # type: ignore[union-attr]
        for tell in self.listeners:
            tell(error)


def discard_output(number: int) -> None:
    """Redirects a file descriptor, so that what is written to it from now on is discarded."""
    with suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, number)
        os.close(nowhere)


@contextmanager
def losable_outputs(tell: Callable[[OSError], None]) -> Iterator[None]:
    """Keeps a failed write to standard output or standard error from raising an error.

    Args:
        tell: is called with the error of the first write that fails; see `LosableOutput`.
    """
    before = (sys.stdout, sys.stderr)
    outputs = [
        stream if isinstance(stream, LosableOutput) else LosableOutput(stream) for stream in before
    ]
    for output in outputs:
        output.listeners.append(tell)
    sys.stdout, sys.stderr = outputs
    try:
        yield
    finally:
        for output in outputs:
            output.flush()
            output.listeners.remove(tell)
        sys.stdout, sys.stderr = before


@contextmanager
def safe_output() -> Iterator[LosableOutput]:
    """Lets a command write to standard output and standard error, whatever these are.

    Letters that their encoding does not have are written as escapes.

    Yields:
        Standard output, whose `problem` says afterwards whether anything could not be written.
    """
    _keep_places()
    before = (sys.stdout, sys.stderr)
    errors = [(stream, getattr(stream, "errors", None)) for stream in before]
    _set_errors([(stream, "backslashreplace") for stream in before])
    output = LosableOutput(sys.stdout)
    error_output = LosableOutput(sys.stderr)
    sys.stdout = output
    sys.stderr = error_output
    try:
        yield output
    finally:
        output.flush()
        error_output.flush()
        sys.stdout, sys.stderr = before
        _set_errors(errors)


def _set_errors(errors: list[tuple[Any, str | None]]) -> None:
    """Sets how streams handle a letter that their encoding lacks, if the streams allow it."""
    for stream, wanted in errors:
        if hasattr(stream, "reconfigure") and wanted is not None:
            with suppress(OSError, ValueError):
                stream.reconfigure(errors=wanted)


def _keep_places() -> None:
    """Opens the standard files that are closed.

    Otherwise the next file that is opened would take the number of standard output, say, and
    whatever is printed would go into that file.
    """
    with suppress(OSError):
        number = os.open(os.devnull, os.O_RDWR)
        while number <= STANDARD_ERROR:
            os.set_inheritable(number, True)
            number = os.open(os.devnull, os.O_RDWR)
        os.close(number)

"""Standard output and standard error that may be full, closed, lost or of another encoding than UTF-8.

A command first does its work and writes its files. That what it says of them finds no place is no
reason to lose them: it is said once, at the end. And what moves an arm must go on all the same.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

STANDARD_ERROR = 2
"""Number of the last of the three standard files."""


class LosableOutput:
    """A stream that nobody may be able to read any more: a failed write is told once, and never raised.

    Terminals that are lost refuse what is written to them (EIO), as pipes do that nobody reads
    (EPIPE) and disks that are full.

    Attributes:
        problem: the first thing that went wrong, for a message; empty where all was written.
        listeners: what is called with the error of the first write that fails.
    """

    def __init__(
        self, stream: TextIO | None, tell: Callable[[OSError], None] | None = None
    ) -> None:
        """Writes to a stream, None for one that was closed before the process began, and tells `tell`."""
        self._stream = stream
        self.problem = ""
        self.listeners = [] if tell is None else [tell]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @property
    def encoding(self) -> str:
        """The stream's."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        with suppress(OSError, ValueError):
            return self._stream is not None and self._stream.isatty()
        return False

    def write(self, text: str) -> int:
        """Writes text; returns its length, whether it could be written or not."""
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
        """Writes what was kept back."""
        if self._stream is not None and not self.problem:
            try:
                self._stream.flush()
            except OSError as error:
                self._lose(error)

    def _lose(self, error: OSError) -> None:
        self.problem = f"cannot be written: {error.strerror or error}"
        with suppress(OSError, ValueError, AttributeError):
            # what is kept back would fail again at exit
            discard_output(self._stream.fileno())  # type: ignore[union-attr]
        for tell in self.listeners:
            tell(error)


def discard_output(number: int) -> None:
    """Sends nowhere what is still written to a file descriptor."""
    with suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, number)
        os.close(nowhere)


@contextmanager
def losable_outputs(tell: Callable[[OSError], None]) -> Iterator[None]:
    """Lets standard output and standard error be lost meanwhile, which is told; see `LosableOutput`."""
    before = sys.stdout, sys.stderr
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
    """Lets a command write to standard output and standard error whatever these are; yields the former.

    Letters that their encoding does not have are written as escapes.
    """
    _keep_places()
    before = sys.stdout, sys.stderr
    errors = [(stream, getattr(stream, "errors", None)) for stream in before]
    _set_errors([(stream, "backslashreplace") for stream in before])
    output, error_output = (LosableOutput(stream) for stream in before)
    sys.stdout, sys.stderr = output, error_output
    try:
        yield output
    finally:
        output.flush()
        error_output.flush()
        sys.stdout, sys.stderr = before
        _set_errors(errors)


def _set_errors(errors: list[tuple[Any, str | None]]) -> None:
    """Sets what streams do with a letter that they cannot write, where they can be told."""
    for stream, wanted in errors:
        if hasattr(stream, "reconfigure") and wanted is not None:
            with suppress(OSError, ValueError):
                stream.reconfigure(errors=wanted)


def _keep_places() -> None:
    """Opens standard files that are closed, so that no file opened later takes their number, and their text."""
    with suppress(OSError):
        number = os.open(os.devnull, os.O_RDWR)
        while number <= STANDARD_ERROR:
            os.set_inheritable(number, True)
            number = os.open(os.devnull, os.O_RDWR)
        os.close(number)

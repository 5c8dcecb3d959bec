"""What the commands print.

Words, tables and JSON documents go to standard output. Notices, warnings and progress go to
standard error, so that the output of a command can be read by another program.
"""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from gridpush_drake.identification.result import HistoryEntry
from gridpush_drake.units import MM_PER_M

PIPE_WIDTH = 160
"""Width of a table, in characters, if standard output is not a terminal."""

LINE_EVERY = 10.0
"""Shortest time between two plain lines about the progress of long work, such as a campaign, s."""


PLACE_FORMAT = "({:.3f}, {:.3f}) m, turned by {:.2f} rad"
"""Where an object lies, in words: to be formatted with x and y, m, and its heading, rad."""

PLAIN_PERIOD = 5.0
"""Shortest time between two plain lines about the same stage of a search or a run, s."""


def count_noun(count: int, noun: str) -> str:
    """Returns a count with its noun in the right form: "1 push", "2 pushes", "3 cells"."""
    if count == 1:
        return f"{count} {noun}"
    ending = "es" if noun.endswith("sh") else "s"
    return f"{count} {noun}{ending}"


def print_line(text: str = "") -> None:
    """Prints a line of plain words on standard output, wrapped to the terminal."""
    Console(soft_wrap=not sys.stdout.isatty()).print(text, markup=False, highlight=False)


def print_table(table: RenderableType) -> None:
    """Prints a table on standard output, as wide as the terminal, or PIPE_WIDTH without one."""
    console = Console()
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    console.print(table)


def print_notice(text: str) -> None:
    """Prints a line on standard error."""
    print(text, file=sys.stderr)


def print_json(document: dict[str, Any]) -> None:
    """Prints one JSON document on standard output.

    If the output's encoding lacks some letters, all letters beyond ASCII are written as escapes.
    """
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    print(to_json(document, ascii_only=not encoding.lower().startswith("utf")))


def print_found(document: dict[str, Any], lines: Iterable[str], as_json: bool) -> None:
    """Prints what a command found, either as one JSON document or as lines of words.

    Args:
        document: the findings for machines.
        lines: the same findings for people.
        as_json: whether to print the document instead of the lines.
    """
    if as_json:
        print_json(document)
    else:
        for line in lines:
            print_line(line)


def to_json(document: dict[str, Any], ascii_only: bool = False) -> str:
    """Returns a document as JSON text.

    Arrays become lists, numbers that are not finite become null, and objects of other kinds become
    the text that `str` makes of them.

    Args:
        document: what to write.
        ascii_only: whether letters beyond ASCII are written as escapes.
    """
    return json.dumps(_plain(document), indent=2, ensure_ascii=ascii_only, allow_nan=False)


def _plain(value: Any) -> Any:
    """Replaces everything that JSON does not know, at every depth."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not (abs(value) < float("inf")):
        return None
    return value if isinstance(value, str | int | float | bool | None) else str(value)


@contextmanager
def search_progress(what: str, budget: int | None) -> Iterator[Callable[[HistoryEntry], None]]:
    """Shows on standard error how a search of the identification gets on.

    Args:
        what: the search, in a few words.
        budget: the number of simulations after which it ends; None if it ends by itself.

    Yields:
        The function that the search calls with each of its steps.
    """
    with count_progress(what, budget) as show:

        def report(entry: HistoryEntry) -> None:
            detail = f"{entry.simulations} simulations, cell error {entry.loss * MM_PER_M:.2f} mm"
            show(entry.stage, detail, entry.simulations)

        yield report


@contextmanager
def work_progress(what: str) -> Iterator[Callable[[str, int, int], None]]:
    """Shows on standard error how many jobs of some long work are done.

    Args:
        what: the work, in a few words.

    Yields:
        A function `report(doing, done, total)` that the work calls as often as it likes: with the
        job that it works on or has just done, how many are done, and how many there are.
    """
    with count_progress(what, None, LINE_EVERY) as show:
        begun = monotonic()

        def report(doing: str, done: int, total: int) -> None:
            last = f"{doing}, " if doing else ""
            show(f"of {total}", f"{done} done, {last}{monotonic() - begun:.0f} s", done, total)

        yield report


class PlainProgress:
    """Progress as plain lines, for a standard error that is no terminal, such as a log file.

    A line is printed whenever a new stage begins, and from time to time while it goes on. The same
    line is never printed twice in a row.

    Attributes:
        period: shortest time between two lines about the same stage, s.
    """

    def __init__(self, period: float = PLAIN_PERIOD) -> None:
        """Begins; nothing has been printed yet."""
        self.period = period
        self._last_stage = ""
        self._last_line = ""
        self._printed_at = float("-inf")

    def update(self, doing: str, detail: str = "") -> None:
        """Prints how the work gets on, unless it is too early for another line.

        Args:
            doing: the stage of the work.
            detail: what changes all the time during the stage, such as a count.
        """
        line = f"{doing}, {detail}" if detail else doing
        now = monotonic()
        too_early = doing == self._last_stage and now - self._printed_at < self.period
        if too_early or line == self._last_line:
            return
        self._last_stage = doing
        self._last_line = line
        self._printed_at = now
        print(line, file=sys.stderr, flush=True)


@contextmanager
def count_progress(
    what: str, total: int | None, period: float = PLAIN_PERIOD
) -> Iterator[Callable[..., None]]:
    """Shows on standard error how some work gets on: as a bar on a terminal, else as plain lines.

    Args:
        what: the work, in a few words.
        total: the count at which the work is done; None if it is not known beforehand.
        period: shortest time between two plain lines about the same stage, s.

    Yields:
        A function `report(doing, detail, count, of)` that the work calls from time to time: with
        the stage it is at, a detail that changes all the time (such as the simulated time), the
        count, and the count at which it is done.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        plain = PlainProgress(period)
        yield lambda doing, detail="", count=0, of=total: plain.update(f"{what}: {doing}", detail)
        return
    words = TextColumn("{task.description}", markup=False)
    columns = (SpinnerColumn(), words, BarColumn(bar_width=20), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)

        def show(doing: str, detail: str = "", count: int = 0, of: int | None = total) -> None:
            bar.update(
                task,
                completed=count,
                total=of,
                description=f"{what}: {doing}{detail and f', {detail}'}",
            )

        yield show

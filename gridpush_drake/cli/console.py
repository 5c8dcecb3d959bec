"""What the commands print: words and tables on standard output, notices and progress on standard error."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from gridpush_drake.identification.result import HistoryEntry

PIPE_WIDTH = 160
"""Columns that a table may take where standard output is not a terminal."""

LINE_EVERY = 10.0
"""s, at least, between two plain lines about work that takes long."""

MM = 1e3
"""Millimeters in a meter."""

PLAIN_PERIOD = 5.0
"""s, at least, between two plain lines about the same thing."""


def count_noun(count: int, noun: str) -> str:
    """Says how many there are: "1 push", "2 pushes", "3 cells"."""
    return (
        f"{count} {noun}" if count == 1 else f"{count} {noun}{'es' if noun.endswith('sh') else 's'}"
    )


def print_line(text: str = "") -> None:
    """Prints a line of plain words on standard output, wrapped to the terminal."""
    Console(soft_wrap=not sys.stdout.isatty()).print(text, markup=False, highlight=False)


def print_table(table: RenderableType) -> None:
    """Prints a table on standard output; as wide as it likes where that is not a terminal."""
    console = Console()
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    console.print(table)


def print_notice(text: str) -> None:
    """Prints a line on standard error."""
    print(text, file=sys.stderr)


def print_json(document: dict[str, Any]) -> None:
    """Prints one JSON document on standard output; with escapes where that does not take all letters."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    print(to_json(document, ascii_only=not encoding.lower().startswith("utf")))


def print_found(document: dict[str, Any], lines: Iterable[str], as_json: bool) -> None:
    """Prints what a command found: as one JSON document, or in lines of words."""
    if as_json:
        print_json(document)
    else:
        for line in lines:
            print_line(line)


def to_json(document: dict[str, Any], ascii_only: bool = False) -> str:
    """A document as JSON; numbers that are not finite become null, arrays lists, and whatever else its text."""
    return json.dumps(_plain(document), indent=2, ensure_ascii=ascii_only, allow_nan=False)


def _plain(value: Any) -> Any:
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
    """Shows how a search goes, on standard error; yields what the search calls with each of its steps.

    The budget is of simulations; None where the search decides itself.
    """
    with count_progress(what, budget) as show:

        def report(entry: HistoryEntry) -> None:
            found = f"{entry.simulations} simulations, cell error {entry.loss * MM:.2f} mm"
            show(entry.stage, found, entry.simulations)

        yield report


@contextmanager
def work_progress(what: str) -> Iterator[Callable[[str, int, int], None]]:
    """Shows how much of some work is done: a bar on a terminal's standard error, elsewhere a plain line now and then.

    Yields:
        What the work calls, as often as it likes, with what it is at or did last, how many steps
        are done, and how many there are.
    """
    with count_progress(what, None, LINE_EVERY) as show:
        begun = monotonic()

        def report(doing: str, done: int, total: int) -> None:
            last = f"{doing}, " if doing else ""
            show(f"of {total}", f"{done} done, {last}{monotonic() - begun:.0f} s", done, total)

        yield report


class PlainProgress:
    """What a bar shows, as plain lines: for standard error where that is no terminal, such as a log file.

    A line is printed when something new is being done, and now and then while it goes on; never
    twice the same.

    Attributes:
        period: at least so long between two lines about the same thing, s.
    """

    def __init__(self, period: float = PLAIN_PERIOD) -> None:
        """Has said nothing yet."""
        self.period = period
        self._doing = self._said = ""
        self._said_at = float("-inf")

    def update(self, doing: str, detail: str = "") -> None:
        """Takes in what is being done, and a detail of it that may change all the time."""
        text = f"{doing}, {detail}" if detail else doing
        now = monotonic()
        if text == self._said or (doing == self._doing and now - self._said_at < self.period):
            return
        self._doing, self._said, self._said_at = doing, text, now
        print(text, file=sys.stderr, flush=True)


@contextmanager
def count_progress(
    what: str, total: int | None, period: float = PLAIN_PERIOD
) -> Iterator[Callable[..., None]]:  # fmt: skip
    """Shows work on standard error: a bar on a terminal, else plain lines.

    Args:
        what: the work.
        total: to count to; None where it is not known beforehand.
        period: between two plain lines about the same thing, s.

    Yields:
        What the work calls now and then, with what it is doing, a detail that changes all the time,
        such as the simulated time, the count, and what to count to: `report(doing, detail, count,
        of)`.
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

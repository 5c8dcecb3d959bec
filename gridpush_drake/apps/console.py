"""What the commands print: words and tables on standard output, notices and progress on standard error."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gridpush_drake.identification.result import HistoryEntry

PIPE_WIDTH = 160
"""Columns that a table may take where standard output is not a terminal."""

LINE_EVERY = 10.0
"""s, at least, between two lines of progress where standard error is no terminal."""

MM = 1e3
"""Millimetres in a metre."""


def print_line(text: str = "") -> None:
    """Prints a line of plain words on standard output, wrapped to the terminal."""
    from rich.console import Console

    Console(soft_wrap=not sys.stdout.isatty()).print(text, markup=False, highlight=False)


def print_table(table: "RenderableType") -> None:
    """Prints a table on standard output; as wide as it likes where that is not a terminal."""
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    console.print(table)


def print_notice(text: str) -> None:
    """Prints a line on standard error."""
    print(text, file=sys.stderr)


def print_json(document: dict[str, Any]) -> None:
    """Prints one JSON document on standard output."""
    print(to_json(document))


def to_json(document: dict[str, Any]) -> str:
    """A document as JSON; numbers that are not finite become null, arrays lists, and whatever else its text."""
    return json.dumps(_plain(document), indent=2, ensure_ascii=False, allow_nan=False)


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
def search_progress(what: str, budget: int | None) -> Iterator[Callable[["HistoryEntry"], None]]:
    """Shows how a search goes, on a terminal's standard error only.

    Args:
        what: the search, in a word or two.
        budget: simulations it may spend; None where it decides itself.

    Yields:
        What the search calls with each of its steps.
    """
    with _bar() as progress:
        task = progress.add_task(what, total=budget)

        def report(entry: "HistoryEntry") -> None:
            found = f"{entry.simulations} simulations, cell error {entry.loss * MM:.2f} mm, {entry.stage}"
            progress.update(task, completed=entry.simulations, description=f"{what}: {found}")

        yield report


@contextmanager
def step_progress(what: str, total: int | None = None) -> Iterator[Callable[[str], None]]:
    """Shows which step a longer piece of work is at, on a terminal's standard error only.

    Args:
        what: the work.
        total: how many steps it has, where known.

    Yields:
        What the work calls at the beginning of each step, with its description.
    """
    with _bar() as progress:
        task = progress.add_task(what, total=total)
        begun = 0

        def report(description: str) -> None:
            nonlocal begun
            progress.update(task, completed=begun, description=f"{what}: {description}")
            begun += 1

        yield report


@contextmanager
def count_progress(what: str, total: int) -> Iterator[Callable[[str, int], None]]:
    """Shows how far a count has come, and what is being done, on a terminal's standard error only.

    Args:
        what: the work.
        total: to count to.

    Yields:
        What the work calls now and then, with what it is doing and its count.
    """
    with _bar() as progress:
        task = progress.add_task(what, total=total)

        def report(doing: str, count: int) -> None:
            progress.update(task, completed=count, description=f"{what}: {doing}")

        yield report


@contextmanager
def work_progress(what: str) -> Iterator[Callable[[str, int, int], None]]:
    """Shows how much of some work is done: a bar on a terminal's standard error, elsewhere a plain line now and then.

    Args:
        what: the work.

    Yields:
        What the work calls, as often as it likes, with what it is at or did last, how many steps are done, and how many
        there are.
    """
    with _bar() as progress:
        task, begun = progress.add_task(what, total=None), monotonic()
        said = begun

        def report(doing: str, done: int, total: int) -> None:
            nonlocal said
            line = f"{what}: {done} of {total}{f', {doing}' if doing else ''}"
            progress.update(task, completed=done, total=total, description=line)
            if progress.disable and monotonic() - said >= LINE_EVERY:
                said = monotonic()
                print_notice(f"{line}, {said - begun:.0f} s")

        yield report


def _bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )

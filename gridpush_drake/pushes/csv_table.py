"""Tables in CSV files, read row by row: what push logs, scene logs, weighings and streams share.

A cell that cannot be read is refused by a message that names file, line, column and the expected
form. What the columns mean is not said here but by each reader.
"""

import csv
import difflib
import io
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from gridpush_drake.errors import MAX_NUMBER, PushLogError, PushLogWarning
from gridpush_drake.files import read_text

NO_NUMBER = "nan"
"""Text of an empty cell where pandas or NumPy wrote the file."""

COLUMN_SEPARATORS = {";": "semicolons", "\t": "tabs"}
"""What separates the columns of other programs' tables, and its name."""

SUGGESTION_CUTOFF = 0.5
"""Similarity (0 to 1) from which a known column is suggested for an unknown one."""

TYPO_CUTOFF = 0.88
"""Similarity (0 to 1) to a column that is not there, from which a further column is taken for a
misspelled one and refused, lest what it holds is lost."""

MAX_SHOWN = 60
"""Characters of a refused value that a message repeats."""

MAX_NAMED = 5
"""Further columns that a warning names."""


def read_table(
    path: Path,
    what: str,
    required: Sequence[str],
    check_header: Callable[[Path, int, list[str]], None],
) -> Iterator[tuple[int, dict[str, str]]]:
    """Reads a CSV file row by row.

    Args:
        path: the file.
        what: it should hold, for messages.
        required: the columns that it must have, for messages.
        check_header: is called with path, line and header before the first row.

    Yields:
        Each row's line in the file, and its cells by column.

    Raises:
        PushLogError: the file cannot be read, is empty or no CSV, or a row is longer or shorter
            than the header.
    """
    text = read_text(path, what, PushLogError)
    if "\0" in text:
        raise PushLogError(f"{path}: is not UTF-8 text (it holds a NUL); expected {what}")
    reader = csv.reader(io.StringIO(text, newline=""))
    header: list[str] = []
    try:
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if not header:
                header = [cell.strip() for cell in cells]
                _refuse_other_separators(path, reader.line_num, header)
                check_header(path, reader.line_num, header)
            elif len(cells) != len(header):
                number = f"has {len(cells)} fields; the header has {len(header)}"
                raise PushLogError(f"{path}, line {reader.line_num}: {number}")
            else:
                yield reader.line_num, dict(zip(header, cells, strict=True))
    except csv.Error as error:
        raise PushLogError(f"{path}, line {reader.line_num}: is not CSV: {error}") from error
    if not header:
        raise PushLogError(f"{path}: is empty; expected the header {','.join(required)}")


def _refuse_other_separators(path: Path, line: int, header: list[str]) -> None:
    """Refuses a header whose columns are separated by something else than commas."""
    if len(header) > 1:
        return
    for separator, name in COLUMN_SEPARATORS.items():
        if separator in header[0]:
            raise PushLogError(
                f"{path}, line {line}: its columns are separated by {name}; expected commas"
            )


def refuse_misspelled(
    path: Path, line: int, header: list[str], columns: Sequence[str], form: str
) -> None:
    """Refuses a further column that is all but called as one that is not there.

    Args:
        path: the file, for the message.
        line: of its header.
        header: the columns that it has.
        columns: those that it may have.
        form: what is expected, for the message.

    Raises:
        PushLogError: there is such a column.
    """
    absent = [name for name in columns if name not in header]
    for name in header:
        if name not in columns:
            close = difflib.get_close_matches(name.lower(), absent, 1, TYPO_CUTOFF)
            if close:
                fail(path, line, name, f"is unknown; did you mean {close[0]!r}? {form}")


def warn_of_further(path: Path, header: list[str], columns: Sequence[str]) -> None:
    """Says which further columns of a file are passed over, with a PushLogWarning."""
    further = [name for name in header if name not in columns]
    if further:
        shown = ", ".join(name[:MAX_SHOWN] or "(without a name)" for name in further[:MAX_NAMED])
        more = f" and {len(further) - MAX_NAMED} more" if len(further) > MAX_NAMED else ""
        noun = "columns" if len(further) > 1 else "column"
        warnings.warn(
            f"{path}: passed over the {noun} {shown}{more}; known are {','.join(columns)}",
            PushLogWarning,
            stacklevel=2,
        )


def is_empty(cell: str) -> bool:
    """Whether a cell holds nothing: blanks, or nan as pandas and NumPy write it."""
    text = cell.strip()
    return not text or text.lower() == NO_NUMBER


def parse_number(cell: str) -> float | None:
    """Reads a cell's number; None where it is not one that was measured."""
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if abs(value) <= MAX_NUMBER and "_" not in cell else None


def read_number(path: Path, line: int, column: str, cell: str, form: str) -> float:
    """Reads a cell's number.

    Args:
        path: the file, for the message.
        line: the row's line, for the message.
        column: the column, for the message.
        cell: the cell's text.
        form: what is expected, for the message.

    Returns:
        The number.

    Raises:
        PushLogError: it is not a number that was measured.
    """
    value = parse_number(cell)
    if value is None:
        large = False
        with suppress(ValueError):
            large = MAX_NUMBER < abs(float(cell)) < math.inf
        limit = f", at most {MAX_NUMBER:g}" if large else ""
        fail(path, line, column, f"is {cell.strip()[:MAX_SHOWN]!r}; expected {form}{limit}")
    return value


def fail(path: Path, line: int, column: str, what: str) -> NoReturn:
    """Raises a PushLogError that names file, line and column."""
    raise PushLogError(f"{path}, line {line}, column {column[:MAX_SHOWN]}: {what}")

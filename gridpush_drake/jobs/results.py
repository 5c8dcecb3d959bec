"""Keeps the results of a bench's jobs in a file, so that an interrupted run goes on from there.

The file is JSON lines: first the settings, then a line for each finished job. Each line is written
at once and whole. A last line that was cut off is dropped when the file is read, and a file whose
first line was cut off is begun anew.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from gridpush_drake.errors import GridPushError, OutputError
from gridpush_drake.files import check_writable

RESULTS_FOLDER = Path("gridpush_bench")
"""Folder in the current one where results are kept, unless another file is named."""

DATA_SUFFIXES = (".yaml", ".sdf", ".urdf")
"""Endings of the names of the package's data on which results depend."""

SOURCE_SUFFIXES = (".py", *DATA_SUFFIXES)
"""Endings of the names of the package's files that results depend on."""

NO_SOURCES = "cli"
"""Folder of the package that no results depend on."""

ANY_PROGRAM = "any"
"""What stands for the program where each result says itself which one made it."""

RESULTS_HEAD = b'{"bench": "'
"""First bytes of every file of results."""

MAX_HEAD = 2**20
"""Most bytes that a file's first line is read for; the settings take far less."""

HASH_DIGITS = 12
"""Number of digits of a hash, enough to tell two files from each other."""

Result = TypeVar("Result")


ADDED_LATER = {"added_later": True}
"""Metadata of a job's field that older results do not have; see `make_key`."""


class Results:
    """Results by job, in a file that is begun with the first of them.

    Attributes:
        path: the file.
        lines: results that are in it, by job.
        stamps: what else stands beside each result, by job, such as the commit that made it.
    """

    def __init__(
        self,
        path: Path,
        lines: dict[str, Any],
        head: dict[str, Any] | None,
        stamps: dict[str, dict[str, str]] | None = None,
        stamp: dict[str, str] | None = None,
    ) -> None:
        """Takes what is known of a file.

        Args:
            path: the file.
            lines: results that are in it, by job.
            head: first line of a file that is to be begun; None goes on with the one that is there.
            stamps: what stands beside these results, by job.
            stamp: what is to stand beside those that are made now; None for nothing.
        """
        self.path = path
        self.lines = lines
        self.stamps = stamps or {}
        self._stamp = stamp or {}
        self._head = head

    def find(self, function: Callable[[Any], Result], jobs: Sequence[Any]) -> dict[int, Result]:
        """Finds a function's results of finished jobs, by the job's number.

        Raises:
            GridPushError: one is of another form than the function is annotated with.
        """
        found = {
            i: self.lines[key] for i, key in enumerate(map(make_key, jobs)) if key in self.lines
        }
        try:
            return {
                i: _find_adapter(function).validate_python(result) for i, result in found.items()
            }
        except ValidationError as error:
            raise GridPushError(
                f"{self.path}: holds a result of another form; pass --force to start anew "
                f"({error.title})"
            ) from error

    def find_stamp(self, job: Any) -> dict[str, str]:
        """Returns what stands beside a job's result; nothing where there is none."""
        return self.stamps.get(make_key(job), {})

    def forget(self, job: Any) -> None:
        """Lets a finished job be done again. In the file a later result counts, not an earlier."""
        self.lines.pop(make_key(job), None)

    def append(self, function: Callable[[Any], Result], job: Any, result: Result) -> None:
        """Writes a function's result of a job at once, NumPy's numbers as Python's.

        Raises:
            OutputError: the file cannot be written.
        """
        plain = _find_adapter(function).dump_python(
            result, mode="json", warnings=False, fallback=np.generic.item
        )
        key = make_key(job)
        line = {"job": json.loads(key), "result": plain} | self._stamp
        self.stamps[key] = self._stamp
        self.lines[key] = plain
        try:
            if self._head is not None:
                self.path.parent.mkdir(exist_ok=True)
                self.path.write_bytes(_to_line(self._head))
                self._head = None
            with self.path.open("ab", buffering=0) as file:
                file.write(_to_line(line))
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from error


@cache
def _find_adapter(function: Callable[[Any], Any]) -> TypeAdapter[Any]:
    """Makes what reads and writes results of a function's annotated type."""
    return TypeAdapter(get_type_hints(function)["return"])


def make_key(job: Any) -> str:
    """Writes a job, a dataclass, as text: its type and all that it is compared by.

    A field with the metadata `ADDED_LATER` is left out where it has its default, so that results
    that were written before there was such a field are found.
    """
    compared = {
        field.name
        for field in fields(job)
        if field.compare
        and not (field.metadata == ADDED_LATER and getattr(job, field.name) == field.default)
    }
    held = {name: value for name, value in asdict(job).items() if name in compared}
    return json.dumps([type(job).__name__, held], default=str)


def open_results(
    path: Path | str | None,
    bench: str,
    settings: dict[str, Any],
    force: bool = False,
    stamp: dict[str, str] | None = None,
) -> Results:
    """Opens the file of a bench's results, or begins one.

    Args:
        path: the file; None for one in RESULTS_FOLDER, another one for every choice of settings and
            every change of the program.
        bench: name of the bench.
        settings: all that was chosen and that results depend on.
        force: whether to begin a file anew that is there.
        stamp: what is to stand beside each result. Whoever gives it says by it which program made
            a result, and so the file may hold those of several; None for one program.

    Raises:
        GridPushError: the file is of other settings, or is no such file.
        OutputError: it cannot be written.
    """
    head = {
        "bench": bench,
        "program": ANY_PROGRAM if stamp else hash_sources(),
        "settings": json.loads(json.dumps(settings, default=str)),
    }
    if path is None:
        check_writable(
            RESULTS_FOLDER / bench if RESULTS_FOLDER.is_dir() else RESULTS_FOLDER, force=True
        )
        path = RESULTS_FOLDER / f"{bench}-{hash_content(_to_line(head))}.jsonl"
    else:
        path = check_writable(path, force=True)
    if path.exists() and not force and not _is_cut(path):
        lines, stamps = _read(path, head)
        return Results(path, lines, None, stamps, stamp)
    return Results(path, {}, head, stamp=stamp)


def _is_cut(path: Path) -> bool:
    """Says whether a file of results ends before its first line does.

    It does where the disk was full, or the machine went off.
    """
    with path.open("rb") as file:
        line = file.readline(MAX_HEAD)
    return (
        not line.endswith(b"\n")
        and len(line) < MAX_HEAD
        and line[: len(RESULTS_HEAD)] == RESULTS_HEAD[: len(line)]
    )


def _read(path: Path, head: dict[str, Any]) -> tuple[dict[str, Any], dict[str, dict[str, str]]]:
    """Reads results, and what stands beside them, by job; drops a last line that was cut off."""
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    try:
        first, *lines = [json.loads(line) for line in whole.splitlines()]
        stamps = {json.dumps(line.pop("job")): line for line in map(dict, lines)}
        known = {key: line.pop("result") for key, line in stamps.items()}
        there = {"bench": first["bench"], "program": first["program"], **first["settings"]}
    except (ValueError, KeyError, TypeError) as error:
        raise GridPushError(
            f"{path}: is no file of results; expected JSON lines as gridpush bench writes them, or "
            "another name"
        ) from error
    here = {"bench": head["bench"], "program": head["program"], **head["settings"]}
    changed = [key for key in {**here, **there} if here.get(key) != there.get(key)]
    if changed:
        said = ", ".join(
            f"{key} {json.dumps(there.get(key))}, now {json.dumps(here.get(key))}"
            for key in changed
        )
        raise GridPushError(
            f"{path}: was made with other settings ({said}); pass --force to start anew"
        )
    if len(whole) < len(content):
        os.truncate(path, len(whole))
    return known, stamps


def hash_sources() -> str:
    """Hashes the files of the package that results depend on."""
    package = Path(str(files("gridpush_drake")))
    return hash_files(package, list_sources(package, SOURCE_SUFFIXES))


def list_sources(package: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    """Yields the files of the package that results may depend on, with these endings."""
    for folder, folders, names in os.walk(package, followlinks=True):
        if Path(folder) == package and NO_SOURCES in folders:
            folders.remove(NO_SOURCES)
        yield from (Path(folder, name) for name in names if name.endswith(suffixes))


def hash_files(
    package: Path, paths: Iterable[Path], read: Callable[[Path], bytes] = Path.read_bytes
) -> str:
    """Hashes files of the package, with their places in it.

    Args:
        package: the package's folder.
        paths: the files.
        read: reads what counts of a file; all of it by default.
    """
    sums = [f"{path.relative_to(package)} {hash_content(read(path))}" for path in paths]
    return hash_content("\n".join(sorted(sums)).encode())


def hash_content(content: bytes) -> str:
    """Hashes a file's content."""
    return hashlib.sha256(content).hexdigest()[:HASH_DIGITS]


def _to_line(line: dict[str, Any]) -> bytes:
    """Writes a line of the file."""
    return json.dumps(line, ensure_ascii=False).encode() + b"\n"

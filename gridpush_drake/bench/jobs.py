"""Runs jobs in worker processes, which end with this one, and keeps what each of them found.

What a worker was doing that ended, or was killed, is done again by another. An interrupted run goes
on from the file in which the results of finished jobs are kept. It is JSON lines: first the
settings, then a line for each finished job. Each line is written at once and whole; a last line
that was cut off is dropped when the file is read, and a file whose first line was is begun anew.
"""

import hashlib
import json
import os
import signal
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib.resources import files
from itertools import count
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from os import _exit
from pathlib import Path
from threading import Thread
from typing import Any, Protocol, TypeVar, get_type_hints

from pydantic import TypeAdapter, ValidationError

from gridpush_drake.errors import GridPushError, OutputError
from gridpush_drake.files import check_writable

FOLDER = Path("gridpush_bench")
"""Where results are kept unless told otherwise, in the current folder."""

SOURCES, NO_SOURCES = (".py", ".yaml", ".sdf", ".urdf"), "cli"
"""Endings of the package's files that results depend on, and its folder that none does."""

HEAD = b'{"bench": "'
"""First bytes of every file of results."""

MAX_HEAD = 2**20
"""Most bytes that a file's first line is read for; the settings take far less."""

DIGITS = 12
"""Of a hash, enough to tell two files from each other."""

Result = TypeVar("Result")


class Results:
    """Results by job, in a file that is begun with the first of them.

    Attributes:
        path: of the file.
        lines: results that were in it when it was opened.
    """

    def __init__(self, path: Path, lines: dict[str, Any], head: dict[str, Any] | None) -> None:
        """Takes the first line of a file that is to be begun; None goes on with the file that is there."""
        self.path, self.lines, self._head = path, lines, head

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

    def append(self, function: Callable[[Any], Result], job: Any, result: Result) -> None:
        """Writes a function's result of a job at once. Raises OutputError where the disk refuses."""
        plain = _find_adapter(function).dump_python(result, mode="json")
        line = {"job": json.loads(make_key(job)), "result": plain}
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
    """Reads and writes what a function is annotated to give."""
    return TypeAdapter(get_type_hints(function)["return"])


def make_key(job: Any) -> str:
    """A job, a dataclass, as text: its type and all that it is compared by."""
    compared, held = {field.name for field in fields(job) if field.compare}, asdict(job)
    return json.dumps(
        [type(job).__name__, {key: held[key] for key in held if key in compared}], default=str
    )


def open_results(
    path: Path | str | None, bench: str, settings: dict[str, Any], force: bool = False
) -> Results:
    """Opens the file of a bench's results, or begins it, anew where `force`.

    Args:
        path: of the file; None for one in FOLDER, another for every choice of settings and every
            change of the program.
        bench: the bench's name.
        settings: all that was chosen.
        force: whether to begin anew.

    Raises:
        GridPushError: the file is of other settings, or is no such file.
        OutputError: it cannot be written.
    """
    head = {
        "bench": bench,
        "program": hash_sources(),
        "settings": json.loads(json.dumps(settings, default=str)),
    }
    if path is None:
        check_writable(FOLDER / bench if FOLDER.is_dir() else FOLDER, force=True)
        path = FOLDER / f"{bench}-{hash_content(_to_line(head))}.jsonl"
    else:
        path = check_writable(path, force=True)
    if path.exists() and not force and not _is_cut(path):
        return Results(path, _read(path, head), None)
    return Results(path, {}, head)


def _is_cut(path: Path) -> bool:
    """Whether a file of results ends before its first line does: the disk was full, or the machine went off."""
    with path.open("rb") as file:
        line = file.readline(MAX_HEAD)
    return (
        not line.endswith(b"\n") and len(line) < MAX_HEAD and line[: len(HEAD)] == HEAD[: len(line)]
    )


def _read(path: Path, head: dict[str, Any]) -> dict[str, Any]:
    """Reads the results, and cuts off a last line that is not whole."""
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    try:
        first, *lines = [json.loads(line) for line in whole.splitlines()]
        known = {json.dumps(line["job"]): line["result"] for line in lines}
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
    return known


def hash_sources() -> str:
    """Hashes the files of the package that results depend on."""
    package, sums = Path(str(files("gridpush_drake"))), []
    for folder, folders, names in os.walk(package, followlinks=True):
        if Path(folder) == package:
            folders.remove(NO_SOURCES)
        paths = [Path(folder, name) for name in names if name.endswith(SOURCES)]
        sums += [f"{path.relative_to(package)} {hash_content(path.read_bytes())}" for path in paths]
    return hash_content("\n".join(sorted(sums)).encode())


def hash_content(content: bytes) -> str:
    """A hash of a file's content."""
    return hashlib.sha256(content).hexdigest()[:DIGITS]


def _to_line(line: dict[str, Any]) -> bytes:
    return json.dumps(line, ensure_ascii=False).encode() + b"\n"


Job = TypeVar("Job")
Report = Callable[[str, int, int], None]
"""Called now and then with what was done last, how many jobs are done, and how many there are."""

WORKERS = 2
"""Processes by default."""

REPORT_EVERY, END_WITHIN = 1.0, 1.0
"""s, at most, between two calls of a report, and that a killed worker is waited for."""

MAX_LOST = 3
"""Workers that a job may lose; then it is taken to be what ends them."""


Found = tuple[int, Any] | None
"""A job's number and its result; None where none came for a while."""


class Executor(Protocol):
    """What runs jobs in place of worker processes here, such as a cluster."""

    def run(
        self, function: Callable[[Any], Any], jobs: Sequence[tuple[int, Any]]
    ) -> Iterator[Found]:
        """Runs a function on numbered jobs; yields their results as they come, and None every REPORT_EVERY without.

        Raises LostJobsError, once all others are done, where jobs lost MAX_LOST workers each.
        """


class LostJobsError(GridPushError):
    """Jobs lost every worker that they were given to.

    Attributes:
        jobs: their numbers.
        why: what the last worker ended with.
    """

    def __init__(self, jobs: Sequence[int], why: str) -> None:
        super().__init__(f"{len(jobs)} jobs lost {MAX_LOST} workers each: {why}")
        self.jobs, self.why = tuple(jobs), why


@dataclass(frozen=True)
class Execution:
    """How jobs are run; it changes no result.

    Attributes:
        workers: processes; 0 runs the jobs in this one.
        report: what to call now and then; None where nobody looks.
        results: where results are kept, and found again; None keeps none.
        prepare: what to call before the first job, where there is any to do.
        executor: runs the jobs instead of processes here; None for those.
    """

    workers: int = WORKERS
    report: Report | None = None
    results: Results | None = None
    prepare: Callable[[], None] | None = None
    executor: Executor | None = None


QUIET = Execution()
"""Nothing is said and nothing kept."""


def run_jobs(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    describe: Callable[[Job], str],
    execution: Execution = QUIET,
) -> list[Result]:
    """Runs a function on every job whose result is not known yet.

    Args:
        function: of a job; importable, as is the job, a dataclass; its result's type is annotated.
        jobs: what to do.
        describe: a job in a few words.
        execution: how.

    Returns:
        The results in the jobs' order, which does not depend on the workers.

    Raises:
        GridPushError: a job lost MAX_LOST workers, which is said when all others are done, or the
            results cannot be kept.
    """
    kept = execution.results
    done = {} if kept is None else kept.find(function, jobs)
    report = execution.report or (lambda *_: None)
    said = "" if not done else f"{len(done)} known from before"
    left = [(i, job) for i, job in enumerate(jobs) if i not in done]
    if left and execution.prepare is not None:
        execution.prepare()
    report(said, len(done), len(jobs))
    try:
        for found in _run(function, left, execution):
            if found is not None:
                i, result = found
                done[i], said = result, describe(jobs[i])
                if kept is not None:
                    kept.append(function, jobs[i], result)
            report(said, len(done), len(jobs))
    except LostJobsError as lost:
        names = "; ".join(describe(jobs[i]) for i in lost.jobs)
        raise GridPushError(
            f"{names}: ended {MAX_LOST} workers without an answer, {lost.why}"
        ) from lost
    return [done[i] for i in range(len(jobs))]


def check_known(what: str, given: Sequence[str], known: Sequence[str]) -> None:
    """Raises GridPushError where none is given, one that is not known, or one twice, whose runs would count twice."""
    unknown = [name for name in given if name not in known]
    if not unknown and len(set(given)) < len(given):
        raise GridPushError(f"{what}: {', '.join(given)}; expected each once")
    if unknown or not given:
        raise GridPushError(
            f"{what}: {', '.join(unknown) or 'none'}; expected some of {', '.join(known)}"
        )


def count_steps(report: Report | None, total: int) -> Callable[[str], None]:
    """What to call at the beginning of each of `total` steps, where they are no jobs."""
    done = count()
    return lambda doing: None if report is None else report(doing, next(done), total)


def _run(
    function: Callable[[Job], Result], jobs: Sequence[tuple[int, Job]], execution: Execution
) -> Iterator[tuple[int, Result] | None]:
    """Yields numbers and results as they come, and None where none came for a while."""
    if not jobs:
        return
    if execution.executor is not None:
        yield from execution.executor.run(function, jobs)
    elif execution.workers == 0:
        yield from ((i, function(job)) for i, job in jobs)
    else:
        yield from _run_in_processes(function, jobs, execution.workers)


def _run_in_processes(
    function: Callable[[Job], Result], jobs: Sequence[tuple[int, Job]], workers: int
) -> Iterator[tuple[int, Result] | None]:
    """As `_run`; a worker that ends is replaced, and its job is done again."""
    waiting, lost = deque(jobs), Counter[int]()
    idle, busy = list[Connection](), dict[Connection, tuple[int, Job]]()
    given_up, code = list[int](), None
    with _Pool(function) as pool:
        while waiting or busy:
            while waiting and len(busy) < workers:
                connection = idle.pop() if idle else pool.start()
                try:
                    connection.send(waiting[0])
                    busy[connection] = waiting.popleft()
                except ConnectionError:
                    pool.drop(connection)
            ready = wait(list(busy), REPORT_EVERY)
            if not ready:
                yield None
            for connection in [each for each in list(busy) if each in ready]:
                i, job = busy.pop(connection)
                try:
                    found = _receive(connection)
                except (EOFError, ConnectionError):
                    code, lost[i] = pool.drop(connection), lost[i] + 1
                    if lost[i] < MAX_LOST:
                        waiting.append((i, job))
                    else:
                        given_up.append(i)
                    continue
                idle.append(connection)
                yield found
    if given_up:
        raise LostJobsError(given_up, f"exit code {code}")


def _receive(connection: Connection) -> Any:
    i, result, error = connection.recv()
    if error is not None:
        raise error
    return i, result


@contextmanager
def _blocked_signals() -> Iterator[None]:
    """Holds back the signals that end a command; a process that is started meanwhile never has them."""
    blocked = signal.pthread_sigmask(
        signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
    )
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


class _Pool:
    """Worker processes by the pipe to each; as a context, at whose end they are killed, whatever they do."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self._function, self._context = (
            function,
            get_context("spawn"),
        )  # a fork would copy other threads' locks
        self._workers: dict[Connection, BaseProcess] = {}

    def __enter__(self) -> "_Pool":
        with _blocked_signals():
            # begun along with the first worker, it would unblock the signals
            resource_tracker.ensure_running()
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers.values():
            worker.kill()
        for connection in list(self._workers):
            self.drop(connection)

    def start(self) -> Connection:
        """Starts a worker; returns the pipe to it."""
        # an interrupt waits until the new process is known here; the process itself inherits it
        # blocked
        with _blocked_signals():
            here, there = self._context.Pipe()
            process = self._context.Process(target=_work, args=(there, self._function), daemon=True)
            process.start()
            there.close()
            self._workers[here] = process
        return here

    def drop(self, connection: Connection) -> int | None:
        """Forgets a worker that has ended; returns its exit code."""
        worker = self._workers.pop(connection)
        worker.join(END_WITHIN)
        connection.close()
        return worker.exitcode


def _work(connection: Connection, function: Callable[[Any], Any]) -> None:
    """A worker's life: jobs in, answers out, until the pipe or the parent ends."""
    signal.pthread_sigmask(
        signal.SIG_UNBLOCK, [signal.SIGTERM]
    )  # an interrupt is the parent's business
    Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            i, job = connection.recv()
        except EOFError:
            return
        try:
            connection.send((i, function(job), None))
        except Exception as error:
            error.add_note(traceback.format_exc())
            connection.send((i, None, error))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        _exit(1)

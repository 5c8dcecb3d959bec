"""Runs jobs in worker processes, which end with this one, and keeps what each of them found."""

import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from os import _exit
from threading import Thread
from typing import Any, TypeVar

from gridpush_drake.bench.results import Results
from gridpush_drake.errors import GridPushError

Job = TypeVar("Job")
Result = TypeVar("Result")
Report = Callable[[str, int, int], None]
"""Called now and then with what was done last, how many jobs are done, and how many there are."""

WORKERS = 2
"""Processes by default."""

BEAT = 1.0
"""s, at most, between two calls of a report."""

END_WITHIN = 1.0
"""s that a killed worker is waited for."""


@dataclass(frozen=True)
class Execution:
    """How jobs are run; it changes no result.

    Attributes:
        workers: processes; 0 runs the jobs in this one.
        report: what to call now and then; None where nobody looks.
        results: where results are kept, and found again; None keeps none.
        prepare: what to call before the first job, where there is any to do.
    """

    workers: int = WORKERS
    report: Report | None = None
    results: Results | None = None
    prepare: Callable[[], None] | None = None


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
        GridPushError: a worker ended without an answer, or the results cannot be kept.
    """
    kept = execution.results.bind(function) if execution.results is not None else None
    done = {} if kept is None else kept.find(jobs)
    report = execution.report or (lambda *_: None)
    said = "" if not done else f"{len(done)} known from before"
    left = [(i, job) for i, job in enumerate(jobs) if i not in done]
    if left and execution.prepare is not None:
        execution.prepare()
    report(said, len(done), len(jobs))
    for found in _run(function, left, execution.workers):
        if found is not None:
            i, result = found
            done[i], said = result, describe(jobs[i])
            if kept is not None:
                kept.append(jobs[i], result)
        report(said, len(done), len(jobs))
    return [done[i] for i in range(len(jobs))]


def count_steps(report: Report | None, total: int) -> Callable[[str], None]:
    """What to call at the beginning of each of `total` steps, where they are no jobs."""
    done = count()
    return lambda doing: None if report is None else report(doing, next(done), total)


def _run(
    function: Callable[[Job], Result], jobs: Sequence[tuple[int, Job]], workers: int
) -> Iterator[tuple[int, Result] | None]:
    """Yields numbers and results as they come, and None where none came for a while."""
    if workers == 0 or not jobs:
        yield from ((i, function(job)) for i, job in jobs)
        return
    with _pool(function, min(workers, len(jobs))) as pool:
        waiting = list(reversed(jobs))
        for connection in pool:
            connection.send(waiting.pop())
        busy = dict(pool)
        while busy:
            ready = wait(list(busy), BEAT)
            if not ready:
                yield None
            for connection in [each for each in pool if each in ready]:
                found = _receive(connection, busy[connection])
                if waiting:
                    connection.send(waiting.pop())
                else:
                    del busy[connection]
                yield found


def _receive(connection: Connection, process: BaseProcess) -> Any:
    try:
        i, result, error = connection.recv()
    except (EOFError, ConnectionError) as ended:
        process.join(END_WITHIN)
        raise GridPushError(f"worker {process.pid} ended without an answer, exit code {process.exitcode}") from ended
    if error is not None:
        raise error
    return i, result


@contextmanager
def _pool(function: Callable[[Any], Any], workers: int) -> Iterator[dict[Connection, BaseProcess]]:
    """Worker processes by the pipe to each; they are killed in the end, whatever they do."""
    context = get_context("spawn")  # fresh processes: a fork would copy other threads' locks
    pool: dict[Connection, BaseProcess] = {}
    resource_tracker.ensure_running()  # begun along with the first worker, it would unblock the signals
    try:
        for _ in range(workers):
            # an interrupt waits until the new process is known here; the process itself inherits it blocked
            blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM])
            try:
                here, there = context.Pipe()
                process = context.Process(target=_work, args=(there, function), daemon=True)
                process.start()
                there.close()
                pool[here] = process
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        yield pool
    finally:
        for worker in pool.values():
            worker.kill()
        for connection, worker in pool.items():
            worker.join(END_WITHIN)
            connection.close()


def _work(connection: Connection, function: Callable[[Any], Any]) -> None:
    """A worker's life: jobs in, answers out, until the pipe or the parent ends."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])  # an interrupt is the parent's business
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

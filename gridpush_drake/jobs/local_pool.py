"""Worker processes on this computer, which end with this process whatever happens to it.

What a worker was doing that ended, or was killed, is done again by another one; a job that ends
every worker is named, and the others are done. This pool is our own because the libraries that were
tried cannot do all of that (CONTRIBUTING.md): in loky and Pebble the workers share a pipe, and one
that is killed may take all jobs with it; a LocalCluster of `distributed` cannot say what a worker
ended with, and would be needed by everybody who runs a bench.
"""

import signal
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from os import _exit
from threading import Thread
from typing import Any

from gridpush_drake.jobs.executor import MAX_LOST, REPORT_EVERY, Found, LostJobsError

END_WITHIN = 1.0
"""Time that a killed worker is waited for, s."""


class LocalPool:
    """An `Executor` of jobs in worker processes here.

    Attributes:
        workers: number of processes, 1 or more.
    """

    def __init__(self, workers: int) -> None:
        """Takes the number of processes."""
        self.workers = workers

    def run(
        self, function: Callable[[Any], Any], jobs: Iterable[tuple[int, Any]]
    ) -> Iterator[Found]:
        """Runs a function on numbered jobs; see `Executor.run`."""
        coming = iter(jobs)
        again: deque[tuple[int, Any]] = deque()
        lost = Counter[int]()
        idle: list[Connection] = []
        busy: dict[Connection, tuple[int, Any]] = {}
        given_up: list[int] = []
        code: int | None = None
        with _Workers(function) as pool:
            while True:
                # Every worker that has nothing to do gets a job; those that lost theirs come last.
                while len(busy) < self.workers:
                    given = next(coming, None) or (again.popleft() if again else None)
                    if given is None:
                        break
                    busy[pool.give(given[1], idle)] = given
                if not busy:
                    break

                ready = wait(list(busy), REPORT_EVERY)
                if not ready:
                    yield None
                for connection in [each for each in list(busy) if each in ready]:
                    i, job = busy.pop(connection)
                    try:
                        result, error = connection.recv()
                    except (EOFError, OSError):
                        # The worker has ended, maybe in the middle of its answer: its job is done
                        # again, unless it ends them all.
                        code = pool.drop(connection)
                        lost[i] += 1
                        if lost[i] < MAX_LOST:
                            again.append((i, job))
                        else:
                            given_up.append(i)
                        continue
                    if error is not None:
                        raise error
                    idle.append(connection)
                    yield i, result
        if given_up:
            raise LostJobsError(given_up, f"exit code {code}")


@contextmanager
def _blocked_signals() -> Iterator[None]:
    """Holds back the signals that end a command; a process started meanwhile never gets them."""
    blocked = signal.pthread_sigmask(
        signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
    )
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


class _Workers:
    """Worker processes, by the pipe to each; a context at whose end they are killed."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        """Takes what the workers do with a job."""
        self._function = function
        # a fork would copy other threads' locks
        self._context = get_context("spawn")
        self._workers: dict[Connection, BaseProcess] = {}

    def __enter__(self) -> "_Workers":
        with _blocked_signals():
            # If the tracker were started along with the first worker, it would unblock the signals.
            resource_tracker.ensure_running()
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers.values():
            worker.kill()
        for connection in list(self._workers):
            self.drop(connection)

    def start(self) -> Connection:
        """Starts a worker; returns the pipe to it."""
        # An interrupt waits until the new process is known here; the process inherits the block.
        with _blocked_signals():
            here, there = self._context.Pipe()
            process = self._context.Process(target=_work, args=(there,), daemon=True)
            process.start()
            here.send(self._function)
            there.close()
            self._workers[here] = process
        return here

    def give(self, job: Any, idle: list[Connection]) -> Connection:
        """Gives a job to an idle worker, or to a new one; returns the pipe to it.

        Idle workers that ended meanwhile are forgotten.
        """
        while True:
            connection = idle.pop() if idle else self.start()
            try:
                connection.send(job)
                return connection
            except ConnectionError:
                self.drop(connection)

    def drop(self, connection: Connection) -> int | None:
        """Forgets a worker that has ended; returns its exit code."""
        worker = self._workers.pop(connection)
        worker.join(END_WITHIN)
        connection.close()
        return worker.exitcode


def _work(connection: Connection) -> None:
    """Does a worker's work: the function and jobs in, answers out, until pipe or parent ends."""
    # SIGTERM ends a worker; an interrupt is the parent's business.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
    Thread(target=_end_with_parent, daemon=True).start()
    # What the function needs is imported only now, for that may take seconds.
    function = connection.recv()
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        try:
            connection.send((function(job), None))
        except Exception as error:
            error.add_note(traceback.format_exc())
            connection.send((None, error))


def _end_with_parent() -> None:
    """Ends this process when its parent has ended, however that happened."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        _exit(1)

"""Runs jobs on the workers of a Dask cluster that is there already.

`distributed`, an extra, is imported where a cluster is used.

The cluster's scheduler hands out the jobs, and those of a worker that was lost to another one.
Workers must have the same sources of this package; a worker does one job at a time, so that one
thread each is best.
"""

import logging
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from queue import Empty, Queue
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any

from gridpush_drake.errors import GridPushError
from gridpush_drake.jobs.executor import REPORT_EVERY, Found, LostJobsError
from gridpush_drake.jobs.results import hash_sources

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_WITHIN = 5.0
"""Time that a scheduler has to answer, s."""

EXPECTED_ADDRESS = "the address of a Dask scheduler that runs, such as tcp://host:8786"
"""What is expected where no cluster is found, for errors."""


@contextmanager
def open_cluster(address: str) -> "Iterator[DaskCluster]":
    """Connects to the cluster of a scheduler.

    In the end, jobs that the cluster has not done are dropped.

    Args:
        address: address of the scheduler, such as tcp://host:8786.

    Raises:
        GridPushError: `distributed` is not installed, or no scheduler answers within
            CONNECT_WITHIN.
    """
    client = _connect(address)
    try:
        yield DaskCluster(address, client)
    finally:
        client.close(timeout=REPORT_EVERY)


def _connect(address: str) -> "Client":
    try:
        from distributed import Client
    except ImportError as error:
        raise GridPushError("--dask: needs distributed; pip install '.[cluster]'") from error
    logging.getLogger(Client.__module__).setLevel(
        logging.CRITICAL
    )  # what it has to say is said here
    answer: Queue[Client | Exception] = Queue()

    def connect() -> None:
        try:
            answer.put(Client(address, timeout=CONNECT_WITHIN, set_as_default=False))
        except Exception as error:  # what is no scheduler may answer anything
            answer.put(error)

    Thread(
        target=connect, daemon=True
    ).start()  # what listens but never answers is waited for without end
    try:
        found = answer.get(timeout=CONNECT_WITHIN + REPORT_EVERY)
    except Empty:
        found = TimeoutError(f"nothing answered within {CONNECT_WITHIN:g} s")
    if isinstance(found, Exception):
        raise GridPushError(
            f"--dask: no cluster at {address!r} ({found}); expected {EXPECTED_ADDRESS}"
        ) from found
    return found


class DaskCluster:
    """An `Executor` of jobs on a cluster.

    Attributes:
        address: address of its scheduler.
    """

    def __init__(self, address: str, client: "Client") -> None:
        """Takes a client that is connected to the scheduler of an address."""
        self.address = address
        self._client = client

    def run(
        self, function: Callable[[Any], Any], jobs: Iterable[tuple[int, Any]]
    ) -> Iterator[Found]:
        """Runs a function on numbered jobs; see `Executor.run`.

        The scheduler gets all of them at once.

        Raises:
            LostJobsError: jobs lost more workers than the cluster allows, which is said when all
                others are done.
            GridPushError: the scheduler is lost, or a worker has other sources.
        """
        from distributed import KilledWorker

        done: Queue[Future] = Queue()
        program = hash_sources()
        futures = {
            i: self._client.submit(_do, function, job, program, pure=False) for i, job in jobs
        }
        numbers = {future.key: i for i, future in futures.items()}
        for future in futures.values():
            future.add_done_callback(done.put)
        given_up = list[int]()
        why = ""
        for _ in numbers:
            while True:
                try:
                    future = done.get(timeout=REPORT_EVERY)
                    break
                except Empty:
                    self._check_alive()
                    yield None
            try:
                yield numbers[future.key], self._take(future)
            except KilledWorker as error:
                given_up.append(numbers[future.key])
                why = str(error)
        if given_up:
            raise LostJobsError(given_up, why)

    def _take(self, future: "Future") -> Any:
        """Takes a finished job's result, which the scheduler need not keep any longer."""
        from distributed.client import FutureCancelledError

        try:
            result = future.result(timeout=CONNECT_WITHIN)
        except (FutureCancelledError, TimeoutError) as error:
            raise self._lost() from error
        future.release()
        return result

    def _check_alive(self) -> None:
        if self._client.status != "running":
            raise self._lost()

    def _lost(self) -> GridPushError:
        return GridPushError(
            f"--dask: the cluster at {self.address!r} answers no longer; what was done is kept"
        )


_find_program = cache(hash_sources)

_TURN = Lock()


def _do(function: Callable[[Any], Any], job: Any, program: str) -> Any:
    """Does a job on a worker, if it has the same program; a worker's threads take turns."""
    if _find_program() != program:
        raise GridPushError(
            f"--dask: the worker on {socket.gethostname()} has other sources; expected the same "
            "package"
        )
    with _TURN:
        return function(job)

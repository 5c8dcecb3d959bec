"""`Worker`: a thread in which a system of a Diagram calculates what takes long.

A system makes a `Request` and keeps it in its state. At later updates it takes the answer, which
becomes part of its state, too. A request is a pure function of frozen arguments, so that a Context
may be cloned, or used again later, with a request under way: two clones share one calculation, and
a calculation whose result is gone is made again.

    request = worker.ask(partial(decide, now, seen), time)  # in one update
    answer = worker.take(request, time)  # in later ones; None while there is no answer yet
"""

import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from math import isfinite
from threading import Lock
from typing import Any
from weakref import WeakKeyDictionary

from gridpush_drake.errors import PlanningError
from gridpush_drake.frozen import Unchanging

TIME_ROUNDING = 1e-9
"""A time may be early by this much, s: the times of periodic updates are sums, with round-off."""

SWITCH_INTERVAL = 5e-4
"""Longest time for which a thread of Python keeps others waiting while there is work in real time,
s."""


@dataclass(frozen=True, eq=False)
class Request(Unchanging):
    """A calculation that was asked for.

    Attributes:
        work: a pure function.
        time: time at which it was asked for, s.
    """

    work: Callable[[], Any]
    time: float


@dataclass(frozen=True, eq=False)
class WorkerResult:
    """The result of a calculation.

    Attributes:
        value: value of the function; None if it raised.
        error: what the function raised, as part of a sentence; empty if it raised nothing.
    """

    value: Any = None
    error: str = ""


class Worker:
    """A thread that answers requests, one after another. It ends with the system that has it.

    Attributes:
        delay: simulated time after which an answer is taken, s. If it is not there by then, the
            Diagram waits for it, so that a run does not depend on how fast the computer is. None
            for real time: an answer is taken once it is there, and nobody waits.
    """

    def __init__(self, delay: float | None) -> None:
        """Takes the delay. The thread begins with the first request."""
        self.delay = delay
        self._futures: WeakKeyDictionary[Request, Future[Any]] = WeakKeyDictionary()
        self._pool: ThreadPoolExecutor | None = None
        self._lock = Lock()

    def ask(self, work: Callable[[], Any], time: float) -> Request:
        """Asks for the value of a pure function, at a time, s."""
        request = Request(work, time)
        self._find(request)
        return request

    def take(self, request: Request, time: float) -> WorkerResult | None:
        """Takes the answer to a request. It raises nothing.

        Args:
            request: the request, from whatever Context.
            time: time now, s.

        Returns:
            The answer, which tells if the function raised or its thread was ended; None if it is
            not to be taken yet.
        """
        future = self._find(request)
        is_due = future.done()
        if self.delay is not None:  # then the answer is waited for
            is_due = time >= request.time + self.delay - TIME_ROUNDING
        return answer_now(future.result) if is_due else None

    def close(self) -> None:
        """Ends the thread after what it is at; requests that wait are cancelled."""
        with self._lock:
            if self._pool is not None:
                self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None

    def _find(self, request: Request) -> "Future[Any]":
        """Finds the calculation of a request, which begins now if it is not under way."""
        with self._lock:
            future = self._futures.get(request)
            if future is None:
                if self._pool is None:
                    self._pool = ThreadPoolExecutor(1, "gridpush-worker")
                work = request.work if self.delay is not None else _Yielding(request.work)
                try:
                    future = self._pool.submit(work)
                except RuntimeError as error:  # the computer has no more threads
                    future = Future()
                    future.set_exception(error)
                self._futures[request] = future
            return future


def answer_now(work: Callable[[], Any]) -> WorkerResult:
    """Calls a function, and returns its value or what it raised. It raises nothing."""
    try:
        return WorkerResult(work())
    except (Exception, SystemExit) as error:
        return WorkerResult(error=f"{type(error).__name__}: {error}")


def make_worker(answer_delay: float | None) -> Worker | None:
    """Makes the worker that a system needs.

    Args:
        answer_delay: simulated time after which answers are taken, s. With 0 the system calculates
            them by itself, in the same update. With None they are taken in real time, whenever they
            are there.

    Returns:
        The worker; None if none is needed.

    Raises:
        PlanningError: the delay is negative or not finite.
    """
    if answer_delay is not None and not (isfinite(answer_delay) and answer_delay >= 0):
        raise PlanningError(
            f"answer_delay is {answer_delay!r}; expected a number >= 0 (s), or None for real time"
        )
    return None if answer_delay == 0 else Worker(answer_delay)


@dataclass(frozen=True)
class _Yielding:
    """Lets other threads of Python have their turn more often while a function is at work."""

    work: Callable[[], Any]

    def __call__(self) -> Any:
        before = sys.getswitchinterval()
        sys.setswitchinterval(min(before, SWITCH_INTERVAL))
        try:
            return self.work()
        finally:
            sys.setswitchinterval(before)

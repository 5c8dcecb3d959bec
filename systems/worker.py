"""`Worker`: what takes long is calculated beside the Diagram, which never waits for it.

A system asks a `Request` and keeps it in its state; at later updates it takes the answer, which
then is state, too. What is asked is a pure function of frozen arguments, so that a Context may be
cloned, or come back later, with a request under way: two clones share one calculation, and one that
is gone is made again.

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

ROUNDING = 1e-9
"""s by which a time may be early: those of periodic updates are sums."""

SWITCH_INTERVAL = 5e-4
"""s for which a thread of Python may keep the others waiting while there is work in real time."""


@dataclass(frozen=True, eq=False)
class Request(Unchanging):
    """What was asked.

    Attributes:
        work: a pure function.
        time: when it was asked, s.
    """

    work: Callable[[], Any]
    time: float


@dataclass(frozen=True, eq=False)
class Answer:
    """What came of it.

    Attributes:
        value: of the function; None where it raised.
        error: in a sentence's part, what it raised; empty where it did not.
    """

    value: Any = None
    error: str = ""


class Worker:
    """One thread that answers requests, one after another. It ends with the system that has it.

    Attributes:
        delay: s, simulated, after which an answer is taken ("lockstep"): it is waited for then, so
            that a run does not depend on how fast the computer is. None: "real time", an answer is
            taken once it is there.
    """

    def __init__(self, delay: float | None) -> None:
        """Takes the delay; the thread begins with the first request."""
        self.delay = delay
        self._futures: WeakKeyDictionary[Request, Future[Any]] = WeakKeyDictionary()
        self._pool: ThreadPoolExecutor | None = None
        self._lock = Lock()

    def ask(self, work: Callable[[], Any], time: float) -> Request:
        """Begins with a pure function, at a time, s."""
        request = Request(work, time)
        self._find(request)
        return request

    def take(self, request: Request, time: float) -> Answer | None:
        """The answer; None while it is not to be taken.

        Args:
            request: as `ask` returned it; of whatever Context.
            time: now, s.

        Returns:
            The answer, which says so where the function raised or its thread was ended; never
            raises itself.
        """
        future = self._find(request)
        if not (
            future.done() if self.delay is None else time >= request.time + self.delay - ROUNDING
        ):
            return None
        return answer_now(future.result)

    def close(self) -> None:
        """Ends the thread after what it is at; requests that wait are cancelled."""
        with self._lock:
            if self._pool is not None:
                self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None

    def _find(self, request: Request) -> "Future[Any]":
        """What becomes of a request; begun where it is not under way here."""
        with self._lock:
            future = self._futures.get(request)
            if future is None:
                if self._pool is None:
                    self._pool = ThreadPoolExecutor(1, "gridpush-worker")
                work = request.work if self.delay is not None else _Yielding(request.work)
                try:
                    future = self._pool.submit(work)
                except RuntimeError as error:  # there are no more threads to be had
                    future = Future()
                    future.set_exception(error)
                self._futures[request] = future
            return future


def answer_now(work: Callable[[], Any]) -> Answer:
    """The answer of a function, which says so where it raised; never raises itself."""
    try:
        return Answer(work())
    except (Exception, SystemExit) as error:
        return Answer(error=f"{type(error).__name__}: {error}")


def make_worker(answer_delay: float | None) -> Worker | None:
    """Makes the worker that a system needs.

    Args:
        answer_delay: s, simulated, after which what takes long is answered; 0: in the same update,
            by the Diagram itself; None: in real time, whenever the answer is there.

    Returns:
        The worker; None where none is needed.

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

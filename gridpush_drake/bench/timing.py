"""How long something takes, measured again and again, on one core if need be."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits


class Timing(NamedTuple):
    """How long something takes.

    Attributes:
        median: median over the repetitions, s.
        low: lower quartile, s.
        high: upper quartile, s.
    """

    median: float
    low: float
    high: float


def measure(
    work: Callable[[], object],
    repetitions: int,
    warm_up: int = 1,
    clock: Callable[[], float] = perf_counter,
) -> Timing:
    """Times `work` by a clock that gives s, after `warm_up` runs that are not counted."""
    for _ in range(warm_up):
        work()
    seconds = []
    for _ in range(repetitions):
        begin = clock()
        work()
        seconds.append(clock() - begin)
    low, median, high = np.quantile(seconds, [0.25, 0.5, 0.75])
    return Timing(float(median), float(low), float(high))


@contextmanager
def one_core() -> Iterator[bool]:
    """Keeps this process to one core and one thread; yields whether the system can do that."""
    with threadpool_limits(1):
        if not hasattr(os, "sched_setaffinity"):
            yield False
            return
        before = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {max(before)})
        try:
            yield True
        finally:
            os.sched_setaffinity(0, before)

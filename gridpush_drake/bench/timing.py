"""Wall-clock timing on one core."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits


@dataclass(frozen=True)
class Timing:
    """How long something takes, s: the median and the quartiles over the repetitions."""

    median: float
    low: float
    high: float
    repetitions: int


def measure(work: Callable[[], object], repetitions: int, warm_up: int = 1) -> Timing:
    """Times `work`.

    Args:
        work: what is timed.
        repetitions: how often.
        warm_up: runs before, not counted.

    Returns:
        Median and quartiles.
    """
    for _ in range(warm_up):
        work()
    seconds = []
    for _ in range(repetitions):
        begin = perf_counter()
        work()
        seconds.append(perf_counter() - begin)
    low, median, high = np.quantile(seconds, [0.25, 0.5, 0.75])
    return Timing(float(median), float(low), float(high), repetitions)


@contextmanager
def one_core() -> Iterator[bool]:
    """Keeps this process to one core and one thread; yields whether the system can keep it to a core."""
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

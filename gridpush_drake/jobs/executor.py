"""What runs jobs somewhere else than in this thread, and how it says that jobs were lost."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol

from gridpush_drake.errors import GridPushError

REPORT_EVERY = 1.0
"""Longest time between two calls of a report, s."""

MAX_LOST = 3
"""Number of workers that a job may lose; then it is taken to be what ends them."""

Found = tuple[int, Any] | None
"""Number of a job and its result; None where none came for a while."""


class Executor(Protocol):
    """What runs jobs somewhere else than in this thread: worker processes, or a cluster."""

    def run(
        self, function: Callable[[Any], Any], jobs: Iterable[tuple[int, Any]]
    ) -> Iterator[Found]:
        """Runs a function on numbered jobs.

        Args:
            function: does a job.
            jobs: number of each job, and the job; each is asked for when it can be begun.

        Yields:
            Number and result of each job, as they come, and None after every REPORT_EVERY without.

        Raises:
            LostJobsError: jobs lost MAX_LOST workers each, which is said when all others are done.
        """
        ...


class LostJobsError(GridPushError):
    """Jobs lost every worker that they were given to.

    Attributes:
        jobs: numbers of the jobs.
        why: what the last worker ended with.
    """

    def __init__(self, jobs: Sequence[int], why: str) -> None:
        """Takes the numbers of the jobs, and what the last worker ended with."""
        super().__init__(f"{len(jobs)} jobs lost {MAX_LOST} workers each: {why}")
        self.jobs = tuple(jobs)
        self.why = why

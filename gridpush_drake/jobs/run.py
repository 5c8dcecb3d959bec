"""Runs jobs in this process, in worker processes or on a cluster, and keeps their results.

Where jobs are run changes no result. What runs them is an `Executor`: `jobs.local_pool.LocalPool`
or `jobs.cluster.DaskCluster`. Results are kept, and found again, in `jobs.results`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count, takewhile
from math import inf
from time import monotonic
from typing import TypeVar

from gridpush_drake.errors import GridPushError
from gridpush_drake.jobs.executor import MAX_LOST, Executor, LostJobsError
from gridpush_drake.jobs.local_pool import LocalPool
from gridpush_drake.jobs.results import Results

Job = TypeVar("Job")
Result = TypeVar("Result")

Report = Callable[[str, int, int], None]
"""Function that is called now and then with what was done last, how many jobs are done, and how
many there are."""

DEFAULT_WORKERS = 2
"""Number of worker processes by default."""


@dataclass(frozen=True)
class Execution:
    """How jobs are run; it changes no result.

    Attributes:
        workers: number of worker processes; 0 runs the jobs in this process.
        report: called now and then; None where nobody looks.
        results: where results are kept, and found again; None keeps none.
        prepare: called before the first job, if there is any to do; None calls nothing.
        executor: runs the jobs instead of worker processes here; None for those.
        begin_until: time of the monotonic clock, s, after which no job is begun.
    """

    workers: int = DEFAULT_WORKERS
    report: Report | None = None
    results: Results | None = None
    prepare: Callable[[], None] | None = None
    executor: Executor | None = None
    begin_until: float = inf


QUIET_EXECUTION = Execution()
"""How jobs are run where nothing is said and nothing is kept."""


def run_jobs(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    describe: Callable[[Job], str],
    execution: Execution = QUIET_EXECUTION,
) -> list[Result]:
    """Runs a function on every job whose result is not known yet.

    Args:
        function: does a job. It must be importable, and its result's type must be annotated.
        jobs: the jobs, importable dataclasses.
        describe: says in a few words which job it is.
        execution: how the jobs are run.

    Returns:
        The results in the jobs' order, which does not depend on the workers; without those of jobs
        that were not begun, if `execution` has an end.

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
                done[i] = result
                said = describe(jobs[i])
                if kept is not None:
                    kept.append(function, jobs[i], result)
            report(said, len(done), len(jobs))
    except LostJobsError as lost:
        names = "; ".join(describe(jobs[i]) for i in lost.jobs)
        raise GridPushError(
            f"{names}: ended {MAX_LOST} workers without an answer, {lost.why}"
        ) from lost
    return [done[i] for i in sorted(done)]


def check_known(what: str, given: Sequence[str], known: Sequence[str]) -> None:
    """Checks names that were given.

    Args:
        what: what they are names of, for the error.
        given: the names.
        known: those that there are.

    Raises:
        GridPushError: none is given, one is not known, or one is given twice: its runs would count
            twice.
    """
    unknown = [name for name in given if name not in known]
    if not unknown and len(set(given)) < len(given):
        raise GridPushError(f"{what}: {', '.join(given)}; expected each once")
    if unknown or not given:
        raise GridPushError(
            f"{what}: {', '.join(unknown) or 'none'}; expected some of {', '.join(known)}"
        )


def count_steps(report: Report | None, total: int) -> Callable[[str], None]:
    """Makes what is to be called at the beginning of each of `total` steps that are no jobs."""
    done = count()
    return lambda doing: None if report is None else report(doing, next(done), total)


def _run(
    function: Callable[[Job], Result], jobs: Sequence[tuple[int, Job]], execution: Execution
) -> Iterator[tuple[int, Result] | None]:
    """Runs a function on numbered jobs, by what an execution says; see `Executor.run`."""
    if not jobs:
        return
    begun = takewhile(lambda _: monotonic() < execution.begin_until, jobs)
    if execution.executor is not None:
        yield from execution.executor.run(function, begun)
    elif execution.workers == 0:
        yield from ((i, function(job)) for i, job in begun)
    else:
        yield from LocalPool(execution.workers).run(function, begun)

"""Runs jobs in worker processes, with a progress bar."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")
Report = Callable[[str], None]

WORKERS = 2
"""Processes by default."""


def run_jobs(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    describe: Callable[[Job], str],
    *,
    title: str,
    workers: int = WORKERS,
    progress: bool | Report = True,
) -> list[Result]:
    """Runs a function on every job.

    Args:
        function: of a job; importable, as is the job.
        jobs: what to do.
        describe: a job in a few words.
        title: of the bar.
        workers: processes.
        progress: whether to show a bar on standard error, or what to call with each job that is done.

    Returns:
        The results in the jobs' order, which does not depend on the workers.
    """
    results: dict[int, Result] = {}
    with _reporter(title, len(jobs), progress) as report:
        for i, result in _iterate(function, jobs, workers):
            results[i] = result
            report(describe(jobs[i]))
    return [results[i] for i in range(len(jobs))]


def _iterate(function: Callable[[Job], Result], jobs: Sequence[Job], workers: int) -> Iterator[tuple[int, Result]]:
    if workers == 1:
        yield from ((i, function(job)) for i, job in enumerate(jobs))
        return
    # fresh processes: a fork would copy the locks of the progress bar's thread
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        futures = {pool.submit(function, job): i for i, job in enumerate(jobs)}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _reporter(title: str, total: int, progress: bool | Report) -> Iterator[Report]:
    if callable(progress):
        yield progress
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not progress) as bar:
        task = bar.add_task(title, total=total)
        yield lambda what: bar.update(task, advance=1, description=what)

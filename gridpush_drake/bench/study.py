"""A bench, declared once; and the harness that runs any of them.

A `Study` says what its options are, which jobs they ask for, what is done with a job, and how the
results are tabulated. Everything else is the same for all benches and is done here and in
`jobs.run`: the command line's options, the quick variant, the seeds, worker processes or a
cluster, results that are kept and found again, progress, interruption, tables and JSON.

To add a study, write one file like `bench.grasp` and name it in `cli.bench.group.BENCHES`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

from gridpush_drake.jobs.run import QUIET_EXECUTION, Execution, Report, run_jobs
from gridpush_drake.report.table import Table


def option(
    default: Any,
    text: str | None = None,
    *,
    name: str | None = None,
    short: str | None = None,
    metavar: str | None = None,
    least: int | None = None,
    shown: str | None = None,
    ending: str | None = None,
    is_setting: bool = True,
) -> Any:
    """Declares a field of a study's options, from which the command line's option is made.

    Args:
        default: the field's default.
        text: what the command's help says of it; without, the field is no option of the command.
        name: the option's name; the field's own, with hyphens, where None.
        short: the option's short name, such as -o.
        metavar: what stands for the value in the help.
        least: least number that may be given.
        shown: what the help shows as the default where the default itself says nothing.
        ending: ending that a file's name must have.
        is_setting: whether the results depend on it. Results that are kept are found again only
            with the same settings.

    Returns:
        A field of a dataclass.
    """
    metadata = {
        "text": text,
        "name": name,
        "short": short,
        "metavar": metavar,
        "least": least,
        "shown": shown,
        "ending": ending,
        "is_setting": is_setting,
    }
    return field(default=default, metadata=metadata)


OBJECTS_OPTION: dict[str, Any] = {
    "text": "An object; may be repeated.",
    "metavar": "NAME",
    "shown": "all of the bench's",
}
"""Arguments of `option` for the option of several benches that says which objects are measured."""

MASKS_OPTION: dict[str, Any] = {
    "text": "The paper's objects too: a clone of GitHub changkyu/rss2020_changkyu, or another "
    "folder of masks, NAME_label.pgm.",
    "name": "--data",
    "metavar": "DIR",
}
"""Arguments of `option` for the option of several benches that says where the paper's masks are."""


@dataclass(frozen=True)
class StudyOptions:
    """What can be chosen of every study; the options of a study derive from it.

    Attributes:
        seed: seed of everything random.
        quick: whether fewer runs are made, to see that the study works.
        force: whether files that exist may be replaced.
    """

    seed: int = 0
    quick: bool = False
    force: bool = option(False, is_setting=False)


OptionsType = TypeVar("OptionsType", bound=StudyOptions)
Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True)
class JobKind(Generic[Job, Result]):
    """What is done with the jobs of one kind.

    Attributes:
        job: their class, a frozen dataclass of plain values, which can be sent to another process.
        run: does one of them. Worker processes import it, and its result's type is annotated.
        describe: says in a few words which job it is.
    """

    job: type[Job]
    run: Callable[[Job], Result]
    describe: Callable[[Job], str]


class Done:
    """The results of a study's jobs.

    Attributes:
        pairs: each job with its result, in the order in which the jobs were declared.
    """

    def __init__(self, pairs: Iterable[tuple[Any, Any]]) -> None:
        """Takes each job with its result."""
        self.pairs = list(pairs)

    def of(self, task: JobKind[Job, Result]) -> list[Result]:
        """Returns the results of one task."""
        return [result for _, result in self.list_pairs(task)]

    def list_pairs(self, task: JobKind[Job, Result]) -> list[tuple[Job, Result]]:
        """Returns the jobs of one task, each with its result."""
        return [(job, result) for job, result in self.pairs if type(job) is task.job]


@dataclass(frozen=True)
class Study(Generic[OptionsType]):
    """A bench.

    Attributes:
        name: the command's name, after `gridpush bench`.
        help: what the command does, a sentence.
        options: class of what can be chosen.
        tabulate: makes the tables of the options and the results. It may also write files that the
            options ask for.
        tasks: what is done with each kind of jobs; without any, everything is measured in this
            process.
        make_jobs: checks the options, and makes the jobs that they ask for.
        shorten: makes the options of the quick variant.
        measure: measures what needs this process for itself, such as times, before the jobs are
            run; it is called with the options and what reports progress.
    """

    name: str
    help: str
    options: type[OptionsType]
    tabulate: Callable[[OptionsType, Done], list[Table]] = lambda options, done: []
    tasks: Sequence[JobKind[Any, Any]] = ()
    make_jobs: Callable[[OptionsType], Sequence[Any]] = lambda options: ()
    shorten: Callable[[OptionsType], OptionsType] = lambda options: options
    measure: Callable[[OptionsType, Report | None], list[Table]] | None = None

    def run(
        self,
        options: OptionsType | None = None,
        execution: Execution = QUIET_EXECUTION,
        **chosen: Any,
    ) -> list[Table]:
        """Runs the study.

        Args:
            options: what was chosen; the defaults where None.
            execution: how the jobs are run.
            chosen: fields of the options that are chosen instead.

        Returns:
            The tables.

        Raises:
            GridPushError: an option makes no sense, or a job fails; see `run_jobs`.
        """
        used = replace(self.options() if options is None else options, **chosen)
        if used.quick:
            used = self.shorten(used)
        jobs = self.make_jobs(used)
        kinds = {task.job for task in self.tasks}
        for job in jobs:
            if type(job) not in kinds:
                raise TypeError(f"{self.name}: {type(job).__name__} is the job of no task")

        # Times are measured first, while no worker processes are at work beside.
        tables = []
        if self.measure is not None:
            if execution.prepare is not None:
                execution.prepare()
            tables = self.measure(used, execution.report)

        # The jobs are run task by task; results go back to the places of their jobs.
        results: dict[int, Any] = {}
        for task in self.tasks:
            numbers = [i for i, job in enumerate(jobs) if type(job) is task.job]
            if not numbers:
                continue
            found = run_jobs(task.run, [jobs[i] for i in numbers], task.describe, execution)
            results.update(zip(numbers, found, strict=True))
        done = Done((job, results[i]) for i, job in enumerate(jobs))
        return [*tables, *self.tabulate(used, done)]

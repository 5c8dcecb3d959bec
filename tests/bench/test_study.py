"""The harness that runs every bench: a small study of its own goes through all of it."""

import json
from dataclasses import dataclass, replace

import pytest
import typer
from typer.testing import CliRunner

from gridpush_drake.bench.study import JobKind, Study, StudyOptions, option
from gridpush_drake.errors import GridPushError
from gridpush_drake.jobs.results import open_results
from gridpush_drake.jobs.run import Execution
from gridpush_drake.report.table import Table, mean_of


@dataclass(frozen=True)
class Options(StudyOptions):
    """Numbers whose squares and cubes are asked for.

    Attributes:
        count: how many numbers.
        words: which powers.
        note: a file that is written; it changes no result.
    """

    count: int = option(4, "How many numbers.", least=1)
    words: tuple[str, ...] | None = option(
        None, "A power; may be repeated.", name="--power", metavar="NAME", shown="both"
    )
    note: str | None = option(None, "What to say.", is_setting=False)
    hidden: int = 2


@dataclass(frozen=True)
class SquareJob:
    number: int


@dataclass(frozen=True)
class CubeJob:
    number: int


@dataclass(frozen=True)
class Power:
    number: int
    value: float


def calc_square(job: SquareJob) -> Power:
    return Power(job.number, float(job.number**2))


def calc_cube(job: CubeJob) -> Power:
    return Power(job.number, float(job.number**3))


def make_jobs(options: Options) -> list[SquareJob | CubeJob]:
    if options.count > 100:
        raise GridPushError(f"count: {options.count}; expected at most 100")
    numbers = range(options.seed, options.seed + options.count)
    kinds = {"square": SquareJob, "cube": CubeJob}
    # squares and cubes take turns: results must come back to their own jobs
    return [kinds[word](number) for number in numbers for word in options.words or kinds]


SQUARE = JobKind(job=SquareJob, run=calc_square, describe=lambda job: f"square of {job.number}")
CUBE = JobKind(job=CubeJob, run=calc_cube, describe=lambda job: f"cube of {job.number}")


def tabulate(options, done):
    groups = [(("squares",), done.of(SQUARE)), (("cubes",), done.of(CUBE))]
    columns = {"numbers": len, "mean": mean_of("value", 1.0)}
    notes = () if options.note is None else (options.note,)
    return [Table.of("Powers", ("power",), groups, columns, notes)]


STUDY = Study(
    name="powers",
    help="Calculate powers of numbers.",
    options=Options,
    shorten=lambda options: replace(options, count=1),
    measure=lambda options, report: [Table("Measured", ("hidden",), [[options.hidden]])],
    make_jobs=make_jobs,
    tasks=(SQUARE, CUBE),
    tabulate=tabulate,
)


def list_rows(tables):
    return [list(row) for row in tables[-1].rows]


@pytest.mark.parametrize("workers", [0, 1])
def test_results_come_back_to_their_own_jobs(workers):
    tables = STUDY.run(execution=Execution(workers=workers))
    assert list_rows(tables) == [["squares", 4, 3.5], ["cubes", 4, 9.0]]
    assert tables[0].rows == [[2]]


def test_options_quick_and_seed_choose_the_jobs():
    quiet = Execution(workers=0)
    assert list_rows(STUDY.run(execution=quiet, quick=True, seed=5))[0] == ["squares", 1, 25.0]
    assert list_rows(STUDY.run(Options(count=2, words=("cube",)), quiet)) == [["cubes", 2, 0.5]]
    with pytest.raises(GridPushError, match="count: 101"):
        STUDY.run(count=101)


def test_a_job_that_no_task_does_is_refused_before_anything_is_run():
    told = []
    execution = Execution(0, lambda *what: told.append(what))
    with pytest.raises(TypeError, match="powers: CubeJob is the job of no task"):
        replace(STUDY, tasks=(SQUARE,)).run(execution=execution)
    assert told == []


def test_what_is_known_is_not_run_again(tmp_path):
    def run(count):
        results = open_results(tmp_path / "kept.jsonl", "powers", {})
        told = []
        execution = Execution(0, lambda *what: told.append(what), results)
        return list_rows(STUDY.run(execution=execution, count=count)), told

    first, told = run(2)
    assert [what[0] for what in told if what[0]] == [
        "square of 0", "square of 1", "cube of 0", "cube of 1",
    ]  # fmt: skip
    again, told = run(3)
    assert [what[0] for what in told if " of " in what[0]] == ["square of 2", "cube of 2"]
    assert again[0] == ["squares", 3, pytest.approx(5 / 3)]
    assert first[0][1] == 2


def invoke(*arguments):
    # Worker processes import this module, and do not need the command line.
    from gridpush_drake.cli.bench.command import make_command

    app = typer.Typer(add_completion=False)
    app.command()(make_command(STUDY))
    return CliRunner().invoke(app, [str(each) for each in arguments])


def test_the_command_has_the_studys_options_and_those_of_all(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gridpush_drake.cli.shell.options.compile_all", lambda: None)
    shown = invoke("--help").output
    for name in ("--count", "--power", "--note", "--quick", "--seed", "--workers", "--results"):
        assert name in shown
    assert "--hidden" not in shown
    kept = tmp_path / "kept.jsonl"
    out = tmp_path / "powers.md"
    given = ("--count", 3, "--power", "square", "--workers", 1, "--results", kept)
    done = invoke(*given, "--out", out, "--json", "--note", "so")
    assert done.exit_code == 0, done.output
    tables = json.loads(done.stdout)["tables"]
    assert tables[1]["rows"] == [["squares", 3, pytest.approx(5 / 3)]]
    assert tables[1]["notes"] == ["so"]
    assert "### Powers" in out.read_text()
    head, *lines = map(json.loads, kept.read_text().splitlines())
    assert head["settings"] == {"count": 3, "words": ["square"], "quick": False, "seed": 0}
    assert len(lines) == 3

    # another note is no other setting, another count is one
    assert invoke(*given, "--note", "other").exit_code == 0
    refused = invoke("--count", 4, *given[2:])
    assert isinstance(refused.exception, GridPushError)
    assert "count 3, now 4" in str(refused.exception)
    assert invoke("--count", 0).exit_code == 2

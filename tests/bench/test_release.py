"""The bench of what the pages state: sittings, pages, and rows whose code has changed."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

import gridpush_drake
from gridpush_drake.bench import release
from gridpush_drake.bench.release import ROWS, STUDY, ReleaseRow, hash_code, list_code, list_imports
from gridpush_drake.bench.study import Done, JobKind, Study, StudyOptions
from gridpush_drake.errors import GridPushError
from gridpush_drake.jobs.results import DATA_SUFFIXES, list_sources
from gridpush_drake.report.table import Table
from tests.helpers.command_line import run_gridpush

PACKAGE = Path(gridpush_drake.__file__).parent


@dataclass(frozen=True)
class Double:
    """A job: a number that is doubled."""

    number: int


def double(job: Double) -> int:
    return 2 * job.number


def tabulate(options: StudyOptions, done: Done) -> list[Table]:
    return [Table("Doubled", ("number",), [[number] for number in sorted(done.of(DOUBLING))])]


DOUBLING = JobKind(Double, double, str)
DOUBLES = Study(
    name="doubles",
    help="Double numbers.",
    options=StudyOptions,
    make_jobs=lambda options: [Double(number) for number in range(6)],
    tasks=(DOUBLING,),
    tabulate=tabulate,
)
QUICK = ReleaseRow(f"{__name__}:DOUBLES", {})


def measure(folder, **more):
    return STUDY.run(rows=("quick",), folder=folder, workers=0, **more)


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setitem(ROWS, "quick", QUICK)


def test_a_row_goes_on_where_it_was_and_its_table_is_written_into_pages(tmp_path, quick):
    page = tmp_path / "page.md"
    page.write_text("Before.\n\n<!-- release: quick -->\nold\n<!-- release end -->\n\nAfter.\n")
    begun = measure(tmp_path / "kept", minutes=0.0, pages=(str(page),))
    assert begun[0].rows[0][1] == 0 and len(begun) == 1
    assert "not measured yet" in page.read_text() and "old" not in page.read_text()

    done = measure(tmp_path / "kept", pages=(str(page),))
    (file,) = (tmp_path / "kept").glob("*.jsonl")
    lines = file.read_text().splitlines()
    total = done[0].rows[0][2]
    assert done[0].rows[0][1] == total == len(lines) - 1 == 6
    assert done[1].rows == [[0], [2], [4], [6], [8], [10]]
    text = page.read_text()
    assert text.startswith("Before.") and text.endswith("<!-- release end -->\n\nAfter.\n")
    assert f"{total} of {total} jobs" in text and done[1].title in text
    assert "has changed" not in text

    written = file.stat().st_mtime_ns
    again = measure(tmp_path / "kept", force=True)
    assert file.stat().st_mtime_ns == written
    assert [table.rows for table in again] == [table.rows for table in done]


def test_a_folder_stands_for_its_pages_that_have_a_place_for_a_row(tmp_path, quick):
    pages = tmp_path / "pages"
    pages.mkdir()
    with pytest.raises(GridPushError, match="pages: has no row"):
        measure(tmp_path / "kept", minutes=0.0, pages=(str(pages),))
    (pages / "index.md").write_text("Nothing is measured here.\n")
    for name in ("one.md", "two.md"):
        (pages / name).write_text("<!-- release: quick -->\nold\n<!-- release end -->\n")
    measure(tmp_path / "kept", pages=(str(pages),))
    assert (pages / "index.md").read_text() == "Nothing is measured here.\n"
    assert (pages / "one.md").read_text() == (pages / "two.md").read_text()
    assert "Doubled" in (pages / "one.md").read_text()


def test_a_row_of_other_settings_is_begun_anew_only_if_forced(tmp_path, quick, monkeypatch):
    measure(tmp_path)
    monkeypatch.setitem(ROWS, "quick", ReleaseRow(QUICK.target, {"seed": 1}))
    with pytest.raises(GridPushError, match="made with other settings"):
        measure(tmp_path)
    assert measure(tmp_path, force=True)[0].rows[0][1] == 6


def test_the_command_runs_jobs_on_as_many_workers_as_asked(tmp_path, quick, monkeypatch, capsys):
    monkeypatch.setattr("gridpush_drake.jobs.run.LocalPool", None)
    given = ("--row", "quick", "--folder", tmp_path / "kept", "--workers", 0, "--json")
    done = run_gridpush(capsys, "bench", "release", *given)
    assert done.code == 0, done.err
    assert json.loads(done.out)["tables"][0]["rows"][0][1] == 6


def test_a_row_whose_code_changed_says_so_and_is_measured_anew_if_asked(tmp_path, quick):
    page = tmp_path / "page.md"
    page.write_text("<!-- release: quick -->\n<!-- release end -->\n")
    measure(tmp_path)
    file = tmp_path / "quick.jsonl"
    head, *lines = file.read_text().splitlines()
    old = [json.dumps(json.loads(line) | {"code": "0" * 12, "commit": "old"}) for line in lines]
    file.write_text("\n".join([head, *old, ""]))
    assert measure(tmp_path, pages=(str(page),))[0].rows[0][-2:] == ["old", 6]
    assert "**The code has changed since.**" in page.read_text()
    file.write_text("\n".join([head, *old[:2], *lines[2:], ""]))
    assert measure(tmp_path, pages=(str(page),))[0].rows[0][-1] == 2
    assert "**The code has changed since 2 of them.**" in page.read_text()
    renewed = measure(tmp_path, renew=True, pages=(str(page),))[0].rows[0]
    assert renewed[-1] == 0 and renewed[-2] != "old"
    assert "has changed" not in page.read_text()


def test_the_hash_follows_whatever_a_bench_imports(tmp_path, monkeypatch):
    package = tmp_path / release.PACKAGE
    package.mkdir()
    texts = {
        "top": "def f():\n    from gridpush_drake.low import x\n",
        "low": "x = 1\n",
        "other": "",
    }
    for name, text in texts.items():
        (package / f"{name}.py").write_text(text)
    monkeypatch.setattr(release, "files", lambda name: package)
    calc = hash_code.__wrapped__
    before = calc("gridpush_drake.top")
    (package / "other.py").write_text("y = 2\n")
    assert calc("gridpush_drake.top") == before
    (package / "low.py").write_text('"""What is low."""\n\nx = 1  # m\n"""How low."""\n')
    assert calc("gridpush_drake.top") == before
    (package / "low.py").write_text("x = 2\n")
    assert calc("gridpush_drake.top") != before


def test_every_row_is_of_a_bench_with_jobs_and_of_options_that_it_has():
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    for name, row in ROWS.items():
        study = row.load()
        jobs = study.make_jobs(study.options(**row.settings))
        assert jobs and study.tasks, name
        assert row.command.startswith(f"gridpush bench {study.name}"), name


def test_whole_runs_stand_on_the_tasks_and_on_the_data():
    code = list_code(PACKAGE, ROWS["grasp"].module)
    # The table of tasks names what it imports only when it is asked for.
    assert "gridpush_drake.station.tasks.pregrasp_task" in code
    assert "gridpush_drake.systems.execution.push_executor" in code
    # Where jobs are run changes no result.
    assert "gridpush_drake.cli.main" not in code
    assert "gridpush_drake.jobs.run" not in code
    data = set(list_sources(PACKAGE, DATA_SUFFIXES))
    assert PACKAGE / "models" / "scenarios" / "grasp.yaml" in data


def test_a_row_says_how_to_measure_the_same():
    assert ROWS["paths"].command == "gridpush bench feedback --kind path --runs 15 --seed 2000"
    assert ROWS["unknown_inertia_camera"].command.endswith(
        "--objects toothpaste_tube --seeds 7 --seed 4000 --unknown-inertia --camera rgbd"
    )


def test_the_simulation_stands_on_the_kernels():
    found = set(list_imports(PACKAGE / "dynamics" / "simulation.py"))
    assert "gridpush_drake.dynamics.kernels.step" in found


@pytest.mark.parametrize(
    ("text", "words"),
    [("nothing", "has no row"), ("<!-- release: gone -->\n<!-- release end -->", "has gone")],
)
def test_a_page_without_a_place_for_a_row_is_refused(tmp_path, text, words):
    page = tmp_path / "page.md"
    page.write_text(text)
    with pytest.raises(GridPushError, match=words):
        STUDY.run(rows=("grasp",), folder=tmp_path, minutes=0.0, pages=(str(page),))
    with pytest.raises(GridPushError, match="expected some of"):
        STUDY.run(rows=("gone",), folder=tmp_path, minutes=0.0)

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from math import isnan, nan
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from gridpush_drake.errors import GridPushError, OutputError
from gridpush_drake.jobs.local_pool import LocalPool
from gridpush_drake.jobs.results import open_results
from gridpush_drake.jobs.run import Execution, check_known, run_jobs

STARTED_WITHIN, ENDED_WITHIN = 240.0, 6.0
"""s: kernels may have to be compiled before the workers start; the end takes 2 s on a machine that
has nothing else to do."""


@dataclass(frozen=True)
class Job:
    number: int
    folder: Path


@dataclass(frozen=True)
class Found:
    double: int
    fraction: float


def double(job: Job) -> list[Found]:
    with (job.folder / "runs").open("a") as file:
        file.write(f"{job.number}\n")
    if job.number < 0:
        raise GridPushError(f"{job.number}: expected a positive number")
    return [Found(2 * job.number, nan if job.number == 1 else 0.1)]


def leave(job: Job) -> list[Found]:
    os._exit(7)


def leave_some(job: Job) -> list[Found]:
    return leave(job) if job.number < 0 else double(job)


def stumble(job: Job) -> list[Found]:
    with (job.folder / "tries").open("a") as file:
        file.write(f"{job.number}\n")
    if job.number == 1 and (job.folder / "tries").read_text().count("1") < 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return double(job)


def lose_link(job: Job) -> list[Found]:
    raise ConnectionResetError(f"{job.number}: the link is lost")


def break_off(job: Job) -> list[Found]:
    """The first worker is killed in the middle of its answer."""

    def send_half(self, content, write=os.write):
        write(self.fileno(), content[: len(content) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    if not (job.folder / "runs").exists():
        Connection._send = send_half
    return double(job)


def make_jobs(tmp_path, numbers):
    return [Job(number, tmp_path) for number in numbers]


def describe(job):
    return str(job.number)


@pytest.mark.parametrize("workers", [0, 2])
def test_results_are_in_the_jobs_order_and_reported(tmp_path, workers):
    told = []
    execution = Execution(workers, lambda *what: told.append(what))
    found = run_jobs(double, make_jobs(tmp_path, range(5)), describe, execution)
    assert [results[0].double for results in found] == [0, 2, 4, 6, 8]
    assert told[0] == ("", 0, 5)
    assert [done for _, done, _ in told if done] == sorted(done for _, done, _ in told if done)
    assert told[-1][1:] == (5, 5)


@pytest.mark.parametrize("workers", [0, 1])
def test_no_job_is_begun_once_time_is_up(tmp_path, workers):
    ended = Execution(workers, begin_until=time.monotonic())
    assert run_jobs(double, make_jobs(tmp_path, range(3)), describe, ended) == []
    assert not (tmp_path / "runs").exists()
    # What was begun is done.
    results = open_results(tmp_path / "kept.jsonl", "double", {})
    soon = Execution(workers, results=results, begin_until=time.monotonic() + 3600)
    found = run_jobs(double, make_jobs(tmp_path, range(3)), describe, soon)
    assert [one[0].double for one in found] == [0, 2, 4]


def test_jobs_are_asked_for_one_by_one(tmp_path):
    """So that time may run out while others are done."""
    pool = LocalPool(1)
    asked = []

    def list_jobs():
        for number in range(3):
            asked.append(number)
            yield number, Job(number, tmp_path)

    answers = [found for found in pool.run(double, list_jobs()) if found is not None]
    assert [number for number, _ in answers] == [0, 1, 2] == asked
    slow = pool.run(double, list_jobs())
    asked.clear()
    while next(slow) is None:
        pass
    assert asked == [0]
    slow.close()


@pytest.mark.parametrize(
    ("workers", "function", "kind", "says"),
    [
        (0, double, GridPushError, "-1: expected a positive number"),
        (1, double, GridPushError, "-1: expected a positive number"),
        (1, lose_link, ConnectionResetError, "1: the link is lost"),  # not the worker's own link
    ],
)
def test_a_jobs_error_is_the_benchs(tmp_path, workers, function, kind, says):
    with pytest.raises(kind, match=says):
        run_jobs(function, make_jobs(tmp_path, [1, -1]), describe, Execution(workers))


def test_a_job_whose_worker_is_killed_in_the_middle_of_its_answer_is_done_again(tmp_path):
    found = run_jobs(break_off, make_jobs(tmp_path, [2, 3]), describe, Execution(1))
    assert [results[0].double for results in found] == [4, 6]
    assert (tmp_path / "runs").read_text().split() == ["2", "3", "2"]


def test_a_killed_workers_job_is_done_again(tmp_path):
    found = run_jobs(stumble, make_jobs(tmp_path, [1, 2, 3]), describe, Execution(2))
    assert [results[0].double for results in found] == [2, 4, 6]
    assert sorted((tmp_path / "tries").read_text().split()) == ["1", "1", "1", "2", "3"]
    assert sorted((tmp_path / "runs").read_text().split()) == ["1", "2", "3"]


def test_a_job_that_ends_every_worker_is_named_when_the_others_are_done(tmp_path):
    def told(job):
        return f"job {job.number}"

    results = open_results(tmp_path / "kept.jsonl", "leaving", {})
    with pytest.raises(
        GridPushError, match="job -7: ended 3 workers without an answer, exit code 7"
    ):
        run_jobs(leave_some, make_jobs(tmp_path, [-7, 2, 3]), told, Execution(1, None, results))
    assert len(open_results(tmp_path / "kept.jsonl", "leaving", {}).lines) == 2


def test_finished_jobs_are_not_run_again(tmp_path):
    path, jobs, prepared = tmp_path / "kept.jsonl", make_jobs(tmp_path, [-1, 1, 2]), []

    def execution():
        return Execution(
            0, None, open_results(path, "doubling", {"seed": 0}), lambda: prepared.append(True)
        )

    run_jobs(double, jobs[1:2], describe, execution())
    with pytest.raises(GridPushError, match="positive"):
        run_jobs(double, jobs, describe, execution())
    found = run_jobs(double, jobs[1:], describe, execution())
    assert [results[0].double for results in found] == [2, 4]
    assert isnan(found[0][0].fraction)
    assert found[1] == [Found(4, 0.1)]
    assert (tmp_path / "runs").read_text().split() == ["1", "-1", "2"]
    assert len(prepared) == 3
    run_jobs(double, jobs[1:], describe, execution())
    assert len(prepared) == 3


def measure_with_numpy(job: Job) -> tuple[bool, int, float]:
    return np.float64(2.0) < 1.0, np.int64(job.number), np.float64(0.5)  # type: ignore[return-value]


def test_numbers_of_numpy_are_kept_as_pythons(tmp_path):
    jobs = make_jobs(tmp_path, [3])
    for _ in range(2):
        results = open_results(tmp_path / "kept.jsonl", "measuring", {})
        run_jobs(measure_with_numpy, jobs, describe, Execution(0, None, results))
    assert results.lines == {next(iter(results.lines)): [False, 3, 0.5]}


def test_a_line_that_was_cut_off_is_dropped(tmp_path):
    path, jobs = tmp_path / "kept.jsonl", make_jobs(tmp_path, [3, 4])
    run_jobs(double, jobs, describe, Execution(0, None, open_results(path, "doubling", {})))
    whole = path.read_bytes()
    path.write_bytes(whole[:-9])
    results = open_results(path, "doubling", {})
    assert len(results.lines) == 1
    assert run_jobs(double, jobs, describe, Execution(0, None, results)) == [
        [Found(6, 0.1)],
        [Found(8, 0.1)],
    ]
    assert path.read_bytes() == whole
    assert (tmp_path / "runs").read_text().split() == ["3", "4", "4"]


def test_other_settings_are_refused_or_begun_anew(tmp_path, monkeypatch):
    path, jobs = tmp_path / "kept.jsonl", make_jobs(tmp_path, [3])
    run_jobs(
        double,
        jobs,
        describe,
        Execution(0, None, open_results(path, "doubling", {"seed": 0, "sets": 2})),
    )
    for bench, settings, says in (
        ("doubling", {"seed": 1, "sets": 2}, r"seed 0, now 1\); pass --force"),
        ("halving", {"seed": 0, "sets": 2}, 'bench "doubling", now "halving"'),
        ("doubling", {"seed": 0}, "sets 2, now null"),
    ):
        with pytest.raises(GridPushError, match=says):
            open_results(path, bench, settings)
    results = open_results(path, "doubling", {"seed": 1}, force=True)
    assert results.lines == {}
    run_jobs(double, jobs, describe, Execution(0, None, results))
    assert len(open_results(path, "doubling", {"seed": 1}).lines) == 1
    monkeypatch.setattr("gridpush_drake.jobs.results.hash_sources", lambda: "another")
    with pytest.raises(GridPushError, match="program"):
        open_results(path, "doubling", {"seed": 1})


@pytest.mark.parametrize("kept", [0, 1, 8, 30, -1])
def test_a_file_whose_first_line_was_cut_off_is_begun_anew(tmp_path, kept):
    path, jobs = tmp_path / "kept.jsonl", make_jobs(tmp_path, [3])
    run_jobs(double, jobs, describe, Execution(0, None, open_results(path, "doubling", {})))
    whole = path.read_bytes()
    path.write_bytes(whole.splitlines()[0][:kept])
    results = open_results(path, "doubling", {})
    assert not results.lines
    run_jobs(double, jobs, describe, Execution(0, None, results))
    assert path.read_bytes() == whole


@pytest.mark.parametrize("content", ["{", "a note", '{"object": "bench"}'])
def test_another_file_of_one_line_is_kept(tmp_path, content):
    path = tmp_path / "kept.jsonl"
    path.write_text(content + " ")
    with pytest.raises(GridPushError, match=r"kept\.jsonl: is no file of results"):
        open_results(path, "doubling", {})
    assert path.read_text() == content + " "


@pytest.mark.parametrize("content", ["{}\n", "no JSON\n", "\n", '{"bench": "doubling"}\n[]\n'])
def test_another_file_is_refused(tmp_path, content):
    path = tmp_path / "kept.jsonl"
    path.write_text(content)
    with pytest.raises(GridPushError, match=r"kept\.jsonl: is no file of results"):
        open_results(path, "doubling", {})
    assert path.read_text() == content


def test_nothing_is_written_before_the_first_result(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, other = (open_results(None, "doubling", {"seed": seed}) for seed in (0, 1))
    assert first.path != other.path
    assert list(tmp_path.iterdir()) == []
    run_jobs(double, make_jobs(tmp_path, [3]), describe, Execution(0, None, first))
    assert first.path.exists()
    with pytest.raises(OutputError, match="does not exist"):
        open_results(tmp_path / "none" / "kept.jsonl", "doubling", {})


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    ("number", "group", "code"),
    [
        (signal.SIGINT, True, 130),  # Ctrl-C, of which the workers hear, too
        (signal.SIGTERM, False, 143),
        (signal.SIGHUP, True, 129),
    ],
)
def test_a_signal_ends_everything(tmp_path, number, group, code):
    process = start_bench(tmp_path)
    try:
        deadline = time.monotonic() + STARTED_WITHIN
        while (
            len(find_group(process.pid)) < 4 and time.monotonic() < deadline
        ):  # two workers, resource tracker
            assert process.poll() is None
            time.sleep(0.1)
        time.sleep(3.0)
        (os.killpg if group else os.kill)(process.pid, number)
        _, err = process.communicate(timeout=ENDED_WITHIN)
        time.sleep(0.5)  # the resource tracker ends by itself
        assert find_group(process.pid) == []
    finally:
        for pid in find_group(process.pid):
            os.kill(pid, signal.SIGKILL)
    assert process.returncode == code, err
    assert "Traceback" not in err
    assert err.endswith("gridpush: interrupted; no file was left half-written\n")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_workers_end_with_a_killed_parent(tmp_path):
    process = start_bench(tmp_path)
    try:
        deadline = time.monotonic() + STARTED_WITHIN
        while len(find_group(process.pid)) < 4 and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(3.0)
        process.kill()
        process.communicate(timeout=ENDED_WITHIN)
        deadline = time.monotonic() + ENDED_WITHIN
        while find_group(process.pid) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert find_group(process.pid) == []
    finally:
        for pid in find_group(process.pid):
            os.kill(pid, signal.SIGKILL)


def start_bench(folder):
    """Two endless jobs in two workers."""
    return subprocess.Popen(
        [
            sys.executable, "-m", "gridpush_drake.cli.main", "bench", "paper", "--objects", "pliers", "--sets", "2",
            "--method", "random_search", "--budget", "100000000", "--results", folder / "kept.jsonl",
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def find_group(group):
    """Processes of a group, but those that have ended."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, of = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(of) == group and state != "Z":
            found.append(int(stat.parent.name))
    return found


def test_settings_are_in_the_first_line(tmp_path):
    path = tmp_path / "kept.jsonl"
    settings = {"seed": 0, "data": tmp_path, "objects": ["a"]}
    run_jobs(
        double,
        make_jobs(tmp_path, [3]),
        describe,
        Execution(0, None, open_results(path, "doubling", settings)),
    )
    first, line = map(json.loads, path.read_text().splitlines())
    assert first["settings"] == {"seed": 0, "data": str(tmp_path), "objects": ["a"]}
    assert line == {
        "job": ["Job", {"number": 3, "folder": str(tmp_path)}],
        "result": [{"double": 6, "fraction": 0.1}],
    }


def test_a_name_given_twice_is_refused_as_its_runs_would_count_twice():
    check_known("objects", ["pliers", "toolbox"], ["pliers", "toolbox"])
    with pytest.raises(GridPushError, match="objects: pliers, pliers; expected each once"):
        check_known("objects", ["pliers", "pliers"], ["pliers"])

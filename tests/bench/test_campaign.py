import json
import os
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from gridpush_drake.cli.run.demo import demo
from gridpush_drake.errors import GridPushError, OutputError
from gridpush_drake.jobs.executor import LostJobsError
from gridpush_drake.jobs.results import open_results
from gridpush_drake.jobs.run import Execution
from gridpush_drake.planning.scene.joint_loop import SceneMode, SceneStatus
from gridpush_drake.station.campaign.episodes import (
    BROKEN_STATUS,
    DROPPED_OUTCOME,
    GAVE_UP,
    NOT_LIFTED,
    RECORDINGS_FOLDER,
    REFUSED_STATUS,
    Campaign,
    EpisodeJob,
    EpisodeOutcome,
    Proportion,
    describe_settings,
    drop_recordings,
    run,
    run_episode,
)
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import format_scenario, read_scenario
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.station.tasks.scene_task import SceneTaskRecord
from gridpush_drake.station.tasks.task import TaskStatus, TaskStep
from gridpush_drake.systems.base.messages import PushCommand
from tests.helpers.command_line import run_gridpush

HELD = EpisodeOutcome(
    "pliers", 0, "held", "It was lifted.", "held", 5, 3, 2, 0.1, 0.002, 60.0, 30.0
)


def make_campaign(folder=Path("out")):
    return Campaign(
        "pregrasp",
        folder,
        [
            HELD,
            replace(HELD, seed=1, pokes=6, center_of_mass_error=0.004, duration=80.0),
            replace(HELD, seed=2, status="failed", message="No safe way.", outcome=GAVE_UP),
            EpisodeOutcome("a b/brick.yaml", 0, REFUSED_STATUS, "brick: too thick", GAVE_UP),
            replace(
                HELD,
                object="a b/brick.yaml",
                seed=7,
                status="dropped",
                message="It fell.",
                outcome=DROPPED_OUTCOME,
            ),
        ],
    )


def test_the_table_counts_and_gives_wilson_intervals():
    table = make_campaign().tabulate()
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [row["object"] for row in rows] == ["pliers", "brick", "all"]
    assert [row["episodes"] for row in rows] == [3, 2, 5]
    # Wilson (1927) by hand: (k + z²/2 ± z sqrt(k (n - k) / n + z²/4)) / (n + z²) with z = 1.96
    assert rows[0]["held"] == "2 (20.8 to 93.9 %)"
    assert rows[2]["dropped"] == "1 (3.6 to 62.4 %)"
    assert rows[1]["held"] == "0 (0.0 to 65.8 %)"
    assert rows[0]["gave up"] == "1 (6.1 to 79.2 %)"
    assert rows[0]["CoM error, mm"] == pytest.approx(8 / 3)
    assert rows[1]["pokes"] == pytest.approx(3.0)  # of the one that has any


def test_the_table_tells_how_well_objects_were_weighed():
    campaign = make_campaign()
    assert "mass error, %" not in campaign.tabulate().columns
    weighed = [
        replace(HELD, mass_error=-0.02, friction_error=0.01, mass_holds=True, center_holds=True),
        replace(HELD, mass_error=0.04, friction_error=-0.03, mass_holds=False, center_holds=True),
    ]
    table = replace(campaign, episodes=[*campaign.episodes, *weighed]).tabulate()
    row = dict(zip(table.columns, table.rows[-1], strict=True))
    assert row["mass error, %"] == pytest.approx(3.0)
    assert row["friction error"] == pytest.approx(0.02)
    assert (row["mass held, %"], row["CoM held, %"]) == (50.0, 100.0)
    assert "friction held, %" not in table.columns


def test_what_the_gripper_did_not_raise_is_not_dropped():
    campaign = make_campaign()
    before = campaign.tabulate()
    assert "not lifted" not in before.columns
    assert "not lifted" not in before.notes[0]
    left = replace(HELD, seed=3, status="not_lifted", message="It stayed.", outcome=NOT_LIFTED)
    table = replace(campaign, episodes=[*campaign.episodes, left]).tabulate()
    row = dict(zip(table.columns, table.rows[-1], strict=True))
    assert [row[end].split()[0] for end in ("held", "dropped", "not lifted", "gave up")] == [
        "2",
        "1",
        "1",
        "2",
    ]
    assert (
        " not lifted: the gripper closed and went up, and the object stayed. gave up: anything"
        in table.notes[0]
    )


def test_intervals_hold_what_they_say():
    """Over all counts, weighted by how likely they are: nearly 95 % of the intervals hold the true fraction."""
    fraction, total = 0.9, 60
    likely = 0.0
    chance = (1 - fraction) ** total
    for count in range(total + 1):
        interval = Proportion.of(count, total)
        likely += chance * (interval.low <= fraction <= interval.high)
        chance *= (total - count) / (count + 1) * fraction / (1 - fraction)
    assert likely == pytest.approx(0.95, abs=0.025)


def test_every_failure_has_its_reason_and_its_replay():
    campaign = make_campaign()
    notes = campaign.tabulate().notes[1:]
    assert notes[0::2] == [
        "pliers, seed 2: failed. No safe way.",
        "brick, seed 0: refused. brick: too thick",
        "brick, seed 7: dropped. It fell.",
    ]
    assert shlex.split(notes[5])[1:] == [
        "demo", "--task", "pregrasp", "--scenario", "out/scenario.yaml", "--object", "a b/brick.yaml", "--seed", "7",
        "--out", "out/replays/brick-7",
    ]  # fmt: skip
    assert [failure["replay"] for failure in campaign.to_dict()["failures"]] == list(notes[1::2])
    for replay in notes[1::2]:
        app = typer.Typer()
        app.command("demo")(demo)
        parsed = CliRunner().invoke(app, [*shlex.split(replay)[2:], "--help"])
        assert parsed.exit_code == 0, parsed.output


def test_what_cannot_be_run_says_why(monkeypatch):
    text = format_scenario(PushScenario())
    refused = run_episode(EpisodeJob("claw_hammer", 3, task="pregrasp", scenario=text))
    assert (refused.status, refused.outcome) == (REFUSED_STATUS, GAVE_UP)
    assert "no model gripper" in refused.message

    def stumble(resolved):
        scenario = resolved.scenario
        raise RuntimeError(f"with {scenario.object}, seed {scenario.seed}")

    monkeypatch.setattr(TASK_KINDS["push"], "station", stumble, raising=False)
    broken = run_episode(EpisodeJob("pliers", 4, task="push", scenario=text))
    assert (broken.status, broken.outcome) == (BROKEN_STATUS, GAVE_UP)
    assert broken.message.startswith("RuntimeError in test_campaign.py, line ")
    assert broken.message.endswith("with pliers, seed 4")


def make_scene_task(resolved, fallen=()):
    """A task with several objects as it is after three pushes; some objects may have fallen."""

    def read(port):
        return np.full(3, np.nan) if port.split(".")[0] in fallen else np.zeros(3)

    objects = (resolved.obj, *resolved.others)
    zeros = np.zeros((len(objects), 3))
    record = SceneTaskRecord(
        obj=resolved.obj,
        truth=None,
        surface=None,
        last=SceneStatus(mode=SceneMode.HOLDING, pushes=3),
        objects=objects,
        names=("hammer", "pliers"),
        goals=zeros,
        poses=zeros,
        begin=zeros,
        status=TaskStatus.HELD,
        message="It was lifted.",
        raised=0.098,
        duration=40.0,
        steps=[
            TaskStep(1.0 * k, SceneStatus(kind=kind), np.zeros(3), push=PushCommand(k))
            for k, kind in enumerate(("clear", "poke", "slide"), start=1)
        ],
    )
    others = [SimpleNamespace(name=f"other_{k}") for k in range(len(resolved.others))]
    return SimpleNamespace(
        run=lambda progress: record, station=SimpleNamespace(others=others), read=read
    )


@pytest.mark.parametrize(
    ("fallen", "outcome"),
    [((), "held"), (("object",), DROPPED_OUTCOME), (("other_0",), DROPPED_OUTCOME)],
)
def test_an_episode_with_several_objects_counts_pushes_and_whatever_fell(
    monkeypatch, fallen, outcome
):
    monkeypatch.setattr(
        TASK_KINDS["fetch"], "station", partial(make_scene_task, fallen=fallen), raising=False
    )
    text = format_scenario(read_scenario("fetch"))
    episode = run_episode(EpisodeJob("claw_hammer", 3, task="fetch", scenario=text))
    assert (episode.outcome, episode.status) == (outcome, "held"), episode.message
    assert (episode.pushes, episode.pokes, episode.slides, episode.raised) == (3, 1, 1, 0.098)


class Instead:
    """An executor that makes episodes up, until it was asked for `most`."""

    def __init__(self, most=1000):
        self.most, self.asked, self.recordings = most, [], []

    def run(self, function, jobs):
        assert function is run_episode
        for i, job in jobs:
            if len(self.asked) == self.most:
                raise KeyboardInterrupt
            self.asked.append((job.object, job.seed))
            self.recordings.append(job.recording)
            yield None
            yield (
                i,
                replace(
                    HELD, object=job.object, seed=job.seed, outcome="held" if job.seed else GAVE_UP
                ),
            )


def run_instead(
    folder, seeds, executor, objects=("pliers", "toolbox"), scenario=None, force=False, record=False
):
    scenario = scenario or PushScenario()
    results = open_results(
        folder / "episodes.jsonl", "campaign", describe_settings("pregrasp", scenario), force
    )
    execution = Execution(results=results, executor=executor)
    names = dict.fromkeys(objects, "")
    return run("pregrasp", scenario, names, seeds, folder, execution, record)


def test_episodes_that_are_there_are_not_run_again(tmp_path):
    first = Instead(most=3)
    with pytest.raises(KeyboardInterrupt):
        run_instead(tmp_path, range(3), first)
    assert first.asked == [("pliers", 0), ("toolbox", 0), ("pliers", 1)]
    head, *lines = (tmp_path / "episodes.jsonl").read_text().splitlines()
    assert json.loads(head)["settings"]["scenario.pregrasp.force"] == 80.0
    assert [json.loads(line)["result"]["object"] for line in lines] == [
        "pliers",
        "toolbox",
        "pliers",
    ]
    second = Instead()
    campaign = run_instead(tmp_path, range(3), second)
    assert second.asked == [("toolbox", 1), ("pliers", 2), ("toolbox", 2)]
    assert [(each.object, each.seed) for each in campaign.episodes] == [
        (name, seed) for name in ("pliers", "toolbox") for seed in range(3)
    ]
    third = Instead()
    more = run_instead(tmp_path, range(1, 4), third, objects=("pliers", "snack_bag"))
    assert third.asked == [("snack_bag", 1), ("snack_bag", 2), ("pliers", 3), ("snack_bag", 3)]
    assert len(more.episodes) == 6 and not more.failures
    changed = PushScenario()
    changed.pregrasp.force = 40.0
    with pytest.raises(GridPushError, match=r"scenario\.pregrasp\.force 80\.0, now 40\.0"):
        run_instead(tmp_path, range(3), Instead(), scenario=changed)
    anew = Instead()
    run_instead(tmp_path, [0], anew, scenario=changed, force=True)
    assert len(anew.asked) == 2


def test_episodes_that_were_not_recorded_are_run_again_to_be_recorded(tmp_path):
    pytest.importorskip("rosbags")
    run_instead(tmp_path, range(2), Instead(), objects=("pliers",))
    # Seed 0 gave up, which is worth a recording; that of seed 1 is there
    (tmp_path / RECORDINGS_FOLDER).mkdir()
    (tmp_path / RECORDINGS_FOLDER / "pliers-1.mcap").write_bytes(b"")
    again = Instead()
    campaign = run_instead(tmp_path, range(2), again, objects=("pliers",), record=True)
    assert again.asked == [("pliers", 0)]
    assert again.recordings == [str(tmp_path / RECORDINGS_FOLDER / "pliers-0.mcap")]
    assert [episode.seed for episode in campaign.episodes] == [0, 1]
    drop_recordings(tmp_path)
    assert not list((tmp_path / RECORDINGS_FOLDER).iterdir())
    both = Instead()
    run_instead(tmp_path, range(2), both, objects=("pliers",), record=True)
    assert both.asked == [("pliers", 0), ("pliers", 1)]


def test_an_episode_that_could_not_be_run_is_not_run_again_for_its_recording(tmp_path):
    pytest.importorskip("rosbags")

    class Refusing(Instead):
        def run(self, function, jobs):
            for found in super().run(function, jobs):
                yield found and (found[0], replace(found[1], status=REFUSED_STATUS))

    run_instead(tmp_path, [3], Refusing(), record=True)
    again = Instead()
    run_instead(tmp_path, [3], again, record=True)
    assert again.asked == []


def test_objects_of_one_name_are_recorded_in_files_of_their_own():
    jobs = [EpisodeJob(f"/{folder}/a.yaml", 7, object_hash=folder) for folder in ("x", "y")]
    assert [job.name_recording() for job in jobs] == ["a-x-7.mcap", "a-y-7.mcap"]


@pytest.mark.slow
def test_a_recording_that_cannot_be_written_ends_the_campaign(tmp_path):
    pytest.importorskip("rosbags")
    scenario = PushScenario.model_validate(
        {
            "base": "planar",
            "object": "open_book",
            "pokes": {"count": 1, "test_count": 0},
        }
    )
    scenario.directives = make_robot_directives("gantry", grasping=False)
    job = EpisodeJob(
        "open_book",
        0,
        task="identify",
        scenario=format_scenario(scenario),
        recording=str(tmp_path / "missing" / "a.mcap"),
    )
    with pytest.raises(OutputError, match="missing does not exist"):
        run_episode(job)


def test_what_ends_every_worker_is_named_when_the_rest_is_done(tmp_path):
    class Losing(Instead):
        def run(self, function, jobs):
            lost, *others = jobs
            yield from super().run(function, others)
            raise LostJobsError([lost[0]], "exit code -9")

    with pytest.raises(
        GridPushError, match="pliers, seed 0: ended 3 workers without an answer, exit code -9"
    ):
        run_instead(tmp_path, range(2), Losing())
    assert len((tmp_path / "episodes.jsonl").read_text().splitlines()) == 4


def test_refuses_none(tmp_path):
    with pytest.raises(GridPushError, match="objects: none"):
        run_instead(tmp_path, [0], Instead(), objects=())
    with pytest.raises(GridPushError, match="seeds: none"):
        run_instead(tmp_path, [], Instead())


CHEAP = """
object: pliers
base: planar
pokes: {count: 1, test_count: 0, distance: [0.03, 0.04], speed: 0.1}
simulation: {time_step: 0.004}
"""
"""A scenario whose episodes of `identify` take 3 s."""

ENDS_WITHIN = 300.0
"""s, on a machine that is busy with other things."""


def start_campaign(folder, *more):
    (folder / "cheap.yaml").write_text(CHEAP)
    return subprocess.Popen(
        [
            sys.executable, "-m", "gridpush_drake.cli.main", "campaign", folder / "cheap.yaml", "--task", "identify",
            "--objects", "pliers,snack_bag", "--seeds", "0:2", "--out", folder / "out", *more,
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def wait_for(condition, process):
    deadline = time.monotonic() + ENDS_WITHIN
    while not condition():
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)


def has_episodes(folder, count):
    path = folder / "out" / "episodes.jsonl"
    return lambda: path.exists() and len(path.read_bytes().splitlines()) > count


def find_workers(parent):
    """Processes of multiprocessing that do jobs for a parent."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            of = int(stat.read_text().rpartition(")")[2].split()[1])
            if of == parent and b"spawn_main" in stat.with_name("cmdline").read_bytes():
                found.append(int(stat.parent.name))
        except OSError:
            continue
    return found


def read_table(folder):
    return (folder / "out" / "table.md").read_text()


@pytest.fixture(scope="module")
def local_campaign(tmp_path_factory):
    """The folder of a campaign here, one of whose workers was killed, and that was interrupted and went on."""
    folder = tmp_path_factory.mktemp("local")
    process = start_campaign(folder)
    wait_for(has_episodes(folder, 1), process)
    victim = find_workers(process.pid)[0]
    os.kill(victim, signal.SIGKILL)
    wait_for(has_episodes(folder, 2), process)
    assert victim not in find_workers(process.pid)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=ENDS_WITHIN)
    assert (process.returncode, "Traceback" in err) == (130, False)
    assert not (folder / "out" / "table.md").exists()
    before = (folder / "out" / "episodes.jsonl").read_bytes()
    process = start_campaign(folder)
    out, err = process.communicate(timeout=ENDS_WITHIN)
    assert process.returncode == 0, err
    after = (folder / "out" / "episodes.jsonl").read_bytes()
    assert after.startswith(before)
    jobs = [json.dumps(json.loads(line)["job"]) for line in after.splitlines()[1:]]
    assert len(jobs) == len(set(jobs)) == 4
    assert "from before" in err and "of 4, " in err  # progress without a terminal
    assert "pliers" in out and "95 % Wilson" in out
    return folder


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_goes_on_after_a_killed_worker_and_an_interrupt(local_campaign):
    table = read_table(local_campaign)
    assert "| all | 4 | 4 (51.0 to 100.0 %) | 0 (0.0 to 49.0 %) | 0 (0.0 to 49.0 %) |" in table


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_a_replay_is_the_episode_again(local_campaign, capsys):
    _, *lines = (local_campaign / "out" / "episodes.jsonl").read_text().splitlines()
    episodes = [EpisodeOutcome(**json.loads(line)["result"]) for line in lines]
    # workers end in any order, so that one is taken by its name
    (episode,) = (each for each in episodes if (each.object, each.seed) == ("snack_bag", 0))
    words = shlex.split(
        Campaign("identify", local_campaign / "out", [episode]).make_replay(episode)
    )
    outcome = run_gridpush(capsys, *words[1:], "--json")
    assert outcome.code == 0, outcome.err
    summary = json.loads(outcome.out)
    assert summary["after"]["center_of_mass_error"] == episode.center_of_mass_error
    assert summary["simulated_seconds"] == episode.duration
    replays = local_campaign / "out" / "replays"
    assert (replays / f"{episode.object}-{episode.seed}" / "recording.html").exists()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_a_cluster_that_loses_a_worker_gives_the_same_table(local_campaign, tmp_path):
    pytest.importorskip("distributed", reason="distributed is not installed")
    dask, told = [sys.executable, "-m", "dask"], tmp_path / "scheduler.json"
    at_home = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", told]
    each = [
        "--scheduler-file",
        told,
        "--no-nanny",
        "--nthreads",
        "1",
        "--no-dashboard",
        "--host",
        "127.0.0.1",
    ]
    commands = [[*dask, "scheduler", *at_home], [*dask, "worker", *each], [*dask, "worker", *each]]
    with (tmp_path / "log").open("wb") as log:
        cluster = [
            subprocess.Popen(command, stdout=log, stderr=log, cwd=tmp_path) for command in commands
        ]
    try:
        wait_for(told.exists, cluster[0])
        process = start_campaign(tmp_path, "--dask", json.loads(told.read_text())["address"])
        wait_for(has_episodes(tmp_path, 1), process)
        cluster[1].kill()
        _, err = process.communicate(timeout=ENDS_WITHIN)
        assert process.returncode == 0, err
        assert cluster[2].poll() is None
    finally:
        for each in cluster:
            each.kill()
            each.wait()
    assert read_table(tmp_path) == read_table(local_campaign)

"""`gridpush export --lerobot`: the episodes of a campaign as a LeRobot dataset."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from gridpush_drake.jobs.results import open_results
from gridpush_drake.station.campaign.episodes import (
    GAVE_UP,
    RECORDINGS_FOLDER,
    SCENARIO_FILE,
    EpisodeJob,
    EpisodeOutcome,
    describe_settings,
    run_episode,
)
from gridpush_drake.station.campaign.lerobot_dataset import (
    calc_picture_statistics,
    calc_statistics,
    count_brightnesses,
)
from gridpush_drake.station.campaign.lerobot_frames import (
    ACTION_FEATURE,
    ENVIRONMENT_FEATURE,
    PICTURES_FEATURE,
    STATE_FEATURE,
    make_frames,
)
from gridpush_drake.station.recording.run_recording import RecordingError, read_run
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import format_scenario
from tests.helpers.command_line import run_gridpush
from tests.helpers.made_recordings import (
    SEEN_FROM,
    find_command,
    find_joints,
    find_pose,
    paint,
    write_made_run,
)

SIZE = (24, 32)
"""Height and width of the pictures, pixels."""

LEROBOT_PYTHON = "GRIDPUSH_LEROBOT_PYTHON"
"""Environment variable that names a Python with `lerobot`, which asks for another OpenCV."""


def find_lerobot():
    """Finds a Python that has LeRobot; None without one."""
    return sys.executable if find_spec("lerobot") else os.environ.get(LEROBOT_PYTHON)


def make_campaign(folder, ends, size=None, gripper=False):
    """Makes the folder of a campaign; the episode of seed i ends after ends[i] seconds."""
    scenario = PushScenario()
    (folder / RECORDINGS_FOLDER).mkdir(parents=True)
    (folder / SCENARIO_FILE).write_text(format_scenario(scenario))
    settings = describe_settings("identify", scenario)
    results = open_results(folder / "episodes.jsonl", "campaign", settings)
    for seed, end in enumerate(ends):
        job = EpisodeJob("claw_hammer", seed, task="identify")
        outcome = GAVE_UP if seed else "finished"
        episode = EpisodeOutcome("claw_hammer", seed, "finished", "It was poked.", outcome)
        results.append(run_episode, job, episode)
        if end is not None:
            write_made_run(folder / RECORDINGS_FOLDER / job.name_recording(), end, size, gripper)
    return folder


def test_a_frame_has_the_newest_of_everything_at_its_time(tmp_path):
    pytest.importorskip("rosbags")
    file = tmp_path / "run.mcap"
    write_made_run(file, 3.0, SIZE, gripper=True)
    frames = make_frames(read_run(file))
    # The object is seen from 0.25 s on, and the joints are looked at up to 3 s
    assert len(frames) == 28
    assert frames.names[STATE_FEATURE][:5] == ("joint_1", "joint_2", "tip_x", "tip_y", "tip_z")
    assert frames.names[STATE_FEATURE][5:] == (
        "flange_force_x",
        "flange_force_y",
        "flange_force_z",
        "left",
        "right",
    )
    assert frames.names[ACTION_FEATURE] == ("joint_1", "joint_2", "gripper_opening")
    for k in (0, 1, 27):
        time = SEEN_FROM + k / 10
        noted = 0.2 + k / 10  # joints are noted every 0.1 s
        np.testing.assert_allclose(frames.values[STATE_FEATURE][k, :2], find_joints(noted))
        np.testing.assert_allclose(frames.values[STATE_FEATURE][k, 3], 0.1 * time)
        np.testing.assert_allclose(frames.values[STATE_FEATURE][k, 5], noted)
        np.testing.assert_allclose(frames.values[ACTION_FEATURE][k, :2], find_command(noted))
        np.testing.assert_allclose(frames.values[ACTION_FEATURE][k, 2], 2 * noted)
        # The angle goes on beyond half a turn, though the recording has it from -pi to pi
        np.testing.assert_allclose(frames.values[ENVIRONMENT_FEATURE][k], find_pose(time))
        assert frames.pictures[k] == paint(np.floor(noted * 5 + 1e-6) / 5, SIZE)


def test_a_run_without_what_frames_need_is_refused(tmp_path):
    pytest.importorskip("rosbags")
    file = tmp_path / "run.mcap"
    write_made_run(file, 0.2)
    with pytest.raises(RecordingError, match=r"run\.mcap: holds no /object_pose"):
        make_frames(read_run(file))


def test_statistics_are_those_of_numpy():
    values = np.random.default_rng(0).normal(size=(500, 3))
    found = calc_statistics(values)
    np.testing.assert_allclose(found["mean"], values.mean(axis=0))
    np.testing.assert_allclose(found["std"], values.std(axis=0))
    np.testing.assert_allclose(found["q10"], np.quantile(values, 0.1, axis=0))
    assert found["count"] == [500]


def test_statistics_of_pictures_are_those_of_their_pixels():
    pictures = [paint(time, SIZE) for time in np.linspace(0, 20, 250)]
    shape, counts = count_brightnesses(pictures)
    assert shape == (*SIZE, 3)
    found = calc_picture_statistics(counts)
    assert found["count"] == [84]  # every third of 250
    reds = np.round(10 * np.linspace(0, 20, 250)[::3]) / 255
    red, green, blue = np.array(found["mean"]).ravel()
    # JPEG changes colors by a level or two
    assert red == pytest.approx(reds.mean(), abs=0.01)
    assert green == pytest.approx(0.0, abs=0.02)
    assert blue == pytest.approx(200 / 255, abs=0.02)
    assert np.array(found["std"]).ravel()[0] == pytest.approx(reds.std(), abs=0.01)
    assert np.array(found["q90"]).ravel()[0] == pytest.approx(np.quantile(reds, 0.9), abs=0.02)
    assert np.array(found["max"]).shape == (3, 1, 1)


def test_the_folder_is_that_of_the_format(capsys, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    campaign = make_campaign(tmp_path / "campaign", [1.0, None, 2.0], SIZE)
    out = tmp_path / "dataset"
    done = run_gridpush(capsys, "export", campaign, "--lerobot", out, "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert (told["episodes"], told["frames"], told["without_recording"]) == (2, 8 + 18, 1)

    info = json.loads((out / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (2, 26, 1)
    assert (info["fps"], info["robot_type"], info["splits"]) == (10, "iiwa", {"train": "0:2"})
    assert info["features"]["action"] == {
        "dtype": "float32",
        "shape": [2],
        "names": ["joint_1", "joint_2"],
    }
    assert info["features"][PICTURES_FEATURE]["shape"] == [*SIZE, 3]

    frames = parquet.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    assert set(frames) == set(info["features"])
    assert frames["index"] == list(range(26))
    assert frames["episode_index"] == [0] * 8 + [1] * 18
    assert frames["frame_index"] == [*range(8), *range(18)]
    np.testing.assert_allclose(frames["timestamp"], [k / 10 for k in frames["frame_index"]])
    assert [i for i, done in enumerate(frames["next.done"]) if done] == [7, 25]
    assert [i for i, good in enumerate(frames["next.success"]) if good] == [7]

    episodes = parquet.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
    assert episodes["dataset_from_index"] == [0, 8]
    assert episodes["dataset_to_index"] == [8, 26]
    assert episodes["tasks"] == [["Poke the claw hammer to learn where it is heavy."]] * 2
    statistics = json.loads((out / "meta/stats.json").read_text())
    assert set(statistics) == set(info["features"])
    actions = np.array(frames["action"])
    np.testing.assert_allclose(statistics["action"]["mean"], actions.mean(axis=0), rtol=1e-6)
    ours = json.loads((out / "meta/gridpush.json").read_text())
    assert [episode["seed"] for episode in ours["episodes"]] == [0, 2]

    again = run_gridpush(capsys, "export", campaign, "--lerobot", out)
    assert (again.code, "--force" in again.err) == (2, True)
    before = sorted(out.rglob("*"))
    assert run_gridpush(capsys, "export", campaign, "--lerobot", out, "--force").code == 0
    assert sorted(out.rglob("*")) == before
    assert not list(tmp_path.glob(".dataset*"))


def test_files_of_frames_are_begun_anew_when_one_is_full(capsys, tmp_path, monkeypatch):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    monkeypatch.setattr("gridpush_drake.station.campaign.lerobot_dataset.MAX_FILE_SIZE", 1e-3)
    monkeypatch.setattr("gridpush_drake.station.campaign.lerobot_dataset.CHUNK_SIZE", 2)
    campaign = make_campaign(tmp_path / "campaign", [1.0, 1.0, 1.0])
    out = tmp_path / "dataset"
    assert run_gridpush(capsys, "export", campaign, "--lerobot", out).code == 0
    files = sorted(str(path.relative_to(out / "data")) for path in out.glob("data/*/*"))
    assert files == [
        "chunk-000/file-000.parquet",
        "chunk-000/file-001.parquet",
        "chunk-001/file-000.parquet",
    ]
    episodes = parquet.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
    assert episodes["data/chunk_index"] == [0, 0, 1]
    assert episodes["data/file_index"] == [0, 1, 0]


def test_refuses(refuses, tmp_path):
    refuses("export", tmp_path / "none", says=["OUT: missing", "--lerobot"])
    refuses("export", "claw_hammer", "a.sdf", "--lerobot", tmp_path / "b", says=["OUT"])
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    out = ("--lerobot", tmp_path / "dataset")
    refuses("export", tmp_path / "none", *out, says=["none", "the folder of a campaign"])
    silent = make_campaign(tmp_path / "silent", [None])
    refuses("export", silent, *out, says=["none of its 1 episodes", "--record"])
    mixed = make_campaign(tmp_path / "mixed", [1.0, 1.0])
    write_made_run(mixed / RECORDINGS_FOLDER / "claw_hammer-1.mcap", 1.0, SIZE)
    refuses("export", mixed, *out, says=["claw_hammer-1.mcap", "other joints or pictures"])
    (mixed / RECORDINGS_FOLDER / "claw_hammer-0.mcap").write_bytes(b"no recording")
    refuses("export", mixed, *out, says=["claw_hammer-0.mcap", "cannot be read"])
    (mixed / "episodes.jsonl").write_text("{}")
    refuses("export", mixed, *out, says=["episodes.jsonl", "the folder of a campaign"])
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("mine")
    refuses("export", silent, "--lerobot", mine, "--force", says=["mine", "something else"])
    assert (mine / "notes.txt").read_text() == "mine"
    assert not (tmp_path / "dataset").exists()


CHECK = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
data = LeRobotDataset("here/pushes", root=sys.argv[1], delta_timestamps={"action": [0.0, 0.1, 0.2]})
first, last = data[0], data[len(data) - 1]
print(json.dumps({
    "frames": len(data),
    "episodes": data.num_episodes,
    "fps": data.fps,
    "task": last["task"],
    "state": first["observation.state"].tolist(),
    "actions": first["action"].tolist(),
    "padded": last["action_is_pad"].tolist(),
    "picture": list(first["observation.images.camera"].shape),
    "blue": float(first["observation.images.camera"][2].mean()),
    "mean": data.meta.stats["action"]["mean"].tolist(),
    "second": len(LeRobotDataset("here/pushes", root=sys.argv[1], episodes=[1])),
}))
"""
"""What LeRobot itself reads of a dataset."""


@pytest.mark.skipif(not find_lerobot(), reason=f"no lerobot here, and no {LEROBOT_PYTHON}")
def test_lerobot_itself_reads_it(capsys, tmp_path):
    campaign = make_campaign(tmp_path / "campaign", [1.0, 2.0], SIZE, gripper=True)
    out = tmp_path / "dataset"
    assert run_gridpush(capsys, "export", campaign, "--lerobot", out).code == 0
    done = subprocess.run(
        [find_lerobot(), "-c", CHECK, str(out)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "HF_HUB_OFFLINE": "1", "PYTHONPATH": "", "HF_HOME": str(tmp_path)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert (told["frames"], told["episodes"], told["fps"], told["second"]) == (26, 2, 10, 18)
    assert told["task"] == "Poke the claw hammer to learn where it is heavy."
    np.testing.assert_allclose(told["state"][:2], find_joints(0.2), rtol=1e-6)
    np.testing.assert_allclose(told["actions"][1][:2], find_command(0.3), rtol=1e-6)
    assert told["padded"] == [False, True, True]
    assert told["picture"] == [3, *SIZE]
    assert told["blue"] == pytest.approx(200 / 255, abs=0.02)
    frames = [json.loads((Path(out) / "meta/stats.json").read_text())["action"]["mean"]]
    np.testing.assert_allclose(told["mean"], frames[0])

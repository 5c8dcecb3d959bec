"""`--record`: a run as an MCAP file with standard ROS 2 messages, from which the same pushes are read again."""

import json

import numpy as np
import pytest

from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.run_recorder import TOPICS
from tests.helpers.command_line import run_gridpush

pytest.importorskip("rosbags")

SCENARIO = """
object: open_book
object_pose: [0.55, 0.0, 0.0]
base: planar
pokes: {count: 1, test_count: 0, speed: 0.06}
"""


def read_topics(path):
    """Times, s, and messages by topic."""
    from rosbags.highlevel import AnyReader

    topics = {}
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            topics.setdefault(connection.topic, []).append((1e-9 * time, message))
            assert TOPICS[connection.topic] == connection.msgtype
    return topics


def test_a_demo_is_recorded_and_its_pushes_are_read_again(capsys, tmp_path):
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    out, file = tmp_path / "out", tmp_path / "run.mcap"
    arguments = ["--task", "identify", "--scenario", tmp_path / "scenario.yaml", "--out", out]
    done = run_gridpush(capsys, "demo", *arguments, "--record", file, "--json")
    assert done.code == 0, done.err
    assert str(file) in json.loads(done.out)["written"]
    assert file.read_bytes().startswith(b"\x89MCAP0")
    topics = read_topics(file)
    assert topics.keys() == TOPICS.keys() - {"/camera/color/compressed"}
    times = [time for time, _ in topics["/joint_states"]]
    assert np.diff(times).min() > 0.05
    state = topics["/joint_states"][-1][1]
    assert state.name == [f"iiwa_joint_{k}" for k in range(1, 8)]
    assert len(state.position) == len(state.velocity) == 7
    felt = [m.wrench.force for _, m in topics["/wrench"]]
    assert 1.0 < max(np.linalg.norm([f.x, f.y, f.z]) for f in felt) < 30.0
    assert len(topics["/push"]) == 1
    assert {"pushing", "idle"} <= {message.data for _, message in topics["/phase"]}
    spread = topics["/center_of_mass"][-1][1].pose.covariance
    assert 0 < spread[0] < 0.01

    again = tmp_path / "again"
    poses = ["--object-topic", "/object_pose", "--tip-topic", "/tip_pose"]
    read = run_gridpush(
        capsys, "import", "bag", file, "--object", "open_book", *poses, "--out-dir", again
    )
    assert read.code == 0, read.err
    (log,) = again.glob("*.csv")
    first, second = PushLog.read_csv(out / "pushes.csv"), PushLog.read_csv(log)
    assert len(first) == len(second) == 1
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(other.final_pose, one.final_pose, atol=2e-3)
        np.testing.assert_allclose(other.push.start, one.push.start, atol=3e-3)
        assert other.push.length == pytest.approx(one.push.length, abs=3e-3)


def test_a_file_that_exists_is_not_replaced_unasked(capsys, tmp_path):
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    file = tmp_path / "run.mcap"
    file.write_text("mine")
    arguments = ["--task", "identify", "--scenario", tmp_path / "scenario.yaml"]
    done = run_gridpush(capsys, "demo", *arguments, "--out", tmp_path / "out", "--record", file)
    assert done.code == 2
    assert "run.mcap" in done.err
    assert file.read_text() == "mine"

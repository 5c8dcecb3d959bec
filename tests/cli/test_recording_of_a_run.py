"""`--record`: a run as an MCAP file with standard ROS 2 messages, from which the same pushes are read again."""

import json
from importlib.util import find_spec

import numpy as np
import pytest

from gridpush_drake.cli.shell.options import load_object
from gridpush_drake.identification.model_file import read_model
from gridpush_drake.identification.result import calc_center_of_mass
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.recording.rerun_replay import show_run
from gridpush_drake.station.recording.run_recorder import RunRecorder
from gridpush_drake.station.recording.run_recording import TOPIC_TYPES, read_run
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.tasks.registry import TASK_KINDS
from tests.helpers.command_line import run_gridpush
from tests.helpers.rerun_files import ENTITIES, print_rerun
from tests.helpers.two_processes import find_obstacle, run_in_namespace

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
            assert TOPIC_TYPES[connection.topic] == connection.msgtype
    return topics


def read_pushes(capsys, file, folder):
    """Reads the pushes from a recording again, by way of a folder."""
    poses = ["--object-topic", "/object_pose", "--tip-topic", "/tip_pose"]
    read = run_gridpush(
        capsys, "import", "bag", file, "--object", "open_book", *poses, "--out-dir", folder
    )
    assert read.code == 0, read.err
    (log,) = folder.glob("*.csv")
    return PushLog.read_csv(log)


@pytest.mark.slow
def test_a_demo_is_recorded_and_its_pushes_are_read_again(capsys, tmp_path, undrawn):
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    out, file = tmp_path / "out", tmp_path / "run.mcap"
    arguments = ["--task", "identify", "--scenario", tmp_path / "scenario.yaml", "--out", out]
    done = run_gridpush(capsys, "demo", *arguments, "--record", file, "--json")
    assert done.code == 0, done.err
    assert str(file) in json.loads(done.out)["written"]
    assert file.read_bytes().startswith(b"\x89MCAP0")
    topics = read_topics(file)
    of_others = {"/camera/color/compressed", "/gripper_states", "/gripper_command", "/pusher"}
    assert topics.keys() == TOPIC_TYPES.keys() - of_others
    times = [time for time, _ in topics["/joint_states"]]
    assert np.diff(times).min() > 0.05
    state = topics["/joint_states"][-1][1]
    assert state.name == [f"iiwa_joint_{k}" for k in range(1, 8)]
    assert len(state.position) == len(state.velocity) == 7
    # The arm follows what it is told, and the tip is where it is told to be
    told = topics["/joint_commands"][-1][1]
    assert told.name == state.name
    np.testing.assert_allclose(told.position, state.position, atol=0.02)
    wanted, there = topics["/tip_command"], topics["/tip_pose"]
    assert len(wanted) == len(times)
    at_end = [message.pose.position for message in (wanted[-1][1], there[-1][1])]
    gap = [at_end[0].x - at_end[1].x, at_end[0].y - at_end[1].y, at_end[0].z - at_end[1].z]
    assert np.linalg.norm(gap) < 0.01
    felt = [m.wrench.force for _, m in topics["/wrench"]]
    assert 1.0 < max(np.linalg.norm([f.x, f.y, f.z]) for f in felt) < 30.0
    assert len(topics["/push"]) == 1
    assert {"pushing", "idle"} <= {message.data for _, message in topics["/phase"]}
    # The cells are shown in the frame of the object, which moves as the object does
    (cells,) = topics["/cells"][-1][1].markers
    assert len(cells.points) == len(cells.colors) == load_object("open_book").n
    (frame,) = topics["/tf"][-1][1].transforms
    assert cells.header.frame_id == frame.child_frame_id == "object"
    last = topics["/object_pose"][-1][1].pose
    assert frame.transform.translation.x == last.position.x
    assert frame.transform.rotation.z == last.orientation.z
    spread = topics["/center_of_mass"][-1][1].pose.covariance
    assert 0 < spread[0] < 0.01

    first = PushLog.read_csv(out / "pushes.csv")
    second = read_pushes(capsys, file, tmp_path / "again")
    assert len(first) == len(second) == 1
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(other.final_pose, one.final_pose, atol=2e-3)
        np.testing.assert_allclose(other.push.start, one.push.start, atol=3e-3)
        assert other.push.length == pytest.approx(one.push.length, abs=3e-3)

    # What is shown of the recording is what was learned, in the body frame
    seen = Seen()
    show_run(seen, read_run(file))
    learned = read_model(out / "model.yaml")
    center, covariance = calc_center_of_mass(learned)
    np.testing.assert_allclose(seen.calls["show_center"]["center"], center, atol=1e-6)
    np.testing.assert_allclose(seen.calls["show_center"]["covariance"], covariance, atol=1e-9)
    np.testing.assert_allclose(seen.calls["show_cells"]["p_BC"], learned.obj.p_BC)
    assert seen.calls["show_cells"]["side"] == pytest.approx(learned.obj.cell_size)
    assert {"show_object", "show_tip", "show_push", "say", "plot"} <= seen.calls.keys()

    if find_spec("rerun"):
        rrd = tmp_path / "run.rrd"
        shown = run_gridpush(capsys, "view", file, "--rerun", rrd)
        assert shown.code == 0, shown.err
        printed = print_rerun(rrd)
        for entity in (*ENTITIES, "/felt/force_n", "/joints/iiwa_joint_1"):
            assert entity in printed, entity


class Seen:
    """A scene that only writes down the last of each kind of thing that it was to show."""

    def __init__(self):
        self.calls = {}

    def __getattr__(self, name):
        return lambda *_, **given: self.calls.update({name: given})


def test_a_file_that_exists_is_not_replaced_unasked(capsys, tmp_path):
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    file = tmp_path / "run.mcap"
    file.write_text("mine")
    arguments = ["--task", "identify", "--scenario", tmp_path / "scenario.yaml"]
    done = run_gridpush(capsys, "demo", *arguments, "--out", tmp_path / "out", "--record", file)
    assert done.code == 2
    assert "run.mcap" in done.err
    assert file.read_text() == "mine"


@pytest.mark.slow
def test_the_episodes_of_a_campaign_are_recorded(capsys, tmp_path):
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    out = tmp_path / "out"
    arguments = ["--task", "identify", "--seeds", "3", "--out", out, "--workers", 1, "--record"]
    done = run_gridpush(capsys, "campaign", tmp_path / "scenario.yaml", *arguments)
    assert done.code == 0, done.err
    assert "recordings" in done.out
    (file,) = (out / "recordings").iterdir()
    assert file.name == "open_book-3.mcap"
    assert len(read_pushes(capsys, file, tmp_path / "again")) == 1


@pytest.mark.slow
def test_a_grippers_fingers_and_what_it_is_told_are_recorded(tmp_path):
    scenario = read_scenario("grasp")
    scenario.camera.use("ideal")
    task = TASK_KINDS["pregrasp"].station(resolve(scenario))
    recorder = RunRecorder()
    task.begin(0)
    task.simulator.AdvanceTo(0.1)
    recorder.note(task)
    file = tmp_path / "run.mcap"
    recorder.write(file, task.make_record())
    topics = read_topics(file)
    ((_, told),) = topics["/gripper_command"]
    ((_, fingers),) = topics["/gripper_states"]
    assert told.data == task.station.robot.gripper.opening
    assert len(fingers.name) == len(fingers.position) == len(fingers.velocity) == 2
    # The opening is what is between the two fingers
    assert fingers.position[1] - fingers.position[0] == pytest.approx(told.data, abs=5e-3)


@pytest.mark.slow
def test_a_robots_run_is_recorded_and_its_pushes_are_read_again(capsys, tmp_path):
    """Twin and robot are processes of their own, and the robot writes what it saw and did."""
    obstacle = find_obstacle()
    if obstacle:
        pytest.skip(obstacle)
    told = run_in_namespace("record_a_run", tmp_path)
    assert told["robot"]["code"] == 0, told["robot"]["err"]
    file = tmp_path / "run.mcap"
    assert f"The run is recorded in {file}." in " ".join(told["robot"]["err"].split())
    topics = read_topics(file)
    poses = {"/object_pose", "/tip_pose", "/tip_command"}
    joints = {"/joint_states", "/joint_commands", "/wrench"}
    learned = {"/center_of_mass", "/cells"}
    assert topics.keys() == poses | joints | learned | {"/push", "/phase", "/tf"}
    felt = [m.wrench.force for _, m in topics["/wrench"]]
    assert 1.0 < max(np.linalg.norm([f.x, f.y, f.z]) for f in felt) < 30.0
    first = PushLog.read_csv(tmp_path / "robot" / "pushes.csv")
    second = read_pushes(capsys, file, tmp_path / "again")
    assert len(first) == len(second) == 1
    np.testing.assert_allclose(second[0].final_pose, first[0].final_pose, atol=2e-3)
    assert second[0].push.length == pytest.approx(first[0].push.length, abs=3e-3)

    # One and the same run was shown in the Rerun viewer, too, where that is installed
    if told["rerun"]:
        printed = print_rerun(tmp_path / "run.rrd")
        for entity in ENTITIES:
            assert entity in printed, entity

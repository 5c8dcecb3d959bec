import json
import os
import shutil
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest
import yaml

from gridpush_drake.cli.run import demo
from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.display.server import StartMeshcatServer, looks_like_recording
from gridpush_drake.errors import GridPushError, StationError
from gridpush_drake.identification.model_file import read_model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.schema import scenario_file
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.station.tasks.task_kind import TaskKind
from tests.helpers.chromium import find_pixels, freeze_recording, take_picture
from tests.helpers.renderer import require_renderer

MIN_SEEN = 500
"""Pixels that a whole object takes at least."""

SHORT = "object: {object}\npokes: {{count: {count}, test_count: {test_count}, speed: 0.06}}\n"


def test_every_task_begins_its_files_with_a_report():
    for task in TASK_KINDS.values():
        assert task.files[0] == "report.html"
        assert {"recording.html", "scenario.yaml", "truth.yaml"} <= set(task.files)


def write_scenario(folder, object_name="open_book", count=2, test_count=1):
    path = folder / "scenario.yaml"
    path.write_text(SHORT.format(object=object_name, count=count, test_count=test_count))
    return path


@pytest.mark.slow
def test_learns_and_reports(gridpush, tmp_path):
    out = tmp_path / "demo"
    outcome = gridpush(
        "demo",
        "--task",
        "identify",
        "--scenario",
        write_scenario(tmp_path),
        "--out",
        out,
        "--port",
        "0",
        "--json",
    )
    assert outcome.code == 0, outcome.err
    assert sorted(path.name for path in out.iterdir()) == sorted(TASK_KINDS["identify"].files)
    summary = json.loads(outcome.out)
    assert (summary["status"], summary["pushes"], summary["held_out"]) == ("finished", 2, 1)
    assert summary["limit_report"]["touched"] == []
    assert (
        max(
            summary["limit_report"][f"{what}_fraction"]
            for what in ("position", "velocity", "torque")
        )
        <= 1
    )
    assert looks_like_recording(out / "recording.html")
    assert "Push by push" in (out / "report.html").read_text()
    assert yaml.safe_load((out / "truth.yaml").read_text())["object"] == "open_book"
    assert read_scenario(out / "scenario.yaml").pokes.count == 2

    check_recording(out, summary["simulated_seconds"], tmp_path)

    # the same files, offline
    offline = tmp_path / "offline.yaml"
    again = gridpush("identify", out / "object.yaml", out / "pushes.csv", "--out", offline)
    assert again.code == 0, again.err
    np.testing.assert_array_equal(
        read_model(offline).params.mass, read_model(out / "model.yaml").params.mass
    )
    held_out = PushLog.read_csv(out / "held_out.csv")
    assert len(held_out) == 1

    # and from what was seen all along the same pushes, to the last digit
    both = (*PushLog.read_csv(out / "pushes.csv"), *held_out)
    check_recorded_again(gridpush, out, tmp_path / "recorded.csv", both, "rectangle:0.8x1.2@0.6,0")


def check_recorded_again(gridpush, out, path, pushes, table):
    """`gridpush record` makes the demo's pushes of its stream, which says how late its poses are."""
    scenario = read_scenario(out / "scenario.yaml")
    height = GridObject.from_yaml(out / "object.yaml").height or scenario.object_height
    outcome = gridpush(
        "record", out / "stream.csv", "--object", out / "object.yaml", "--out", path,
        "--engaged-below", height, "--table", table,
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    log, of_demo = PushLog.read_csv(path), PushLog.read_csv(out / "pushes.csv")
    np.testing.assert_allclose(
        sorted(log.table.tolist()), sorted(of_demo.table.tolist()), atol=1e-9
    )
    for one, other in zip(log, pushes, strict=True):
        assert (one.name, one.overhang) == (other.name, other.overhang)
        for name in ("pose", "t_observed", "poses_observed"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        np.testing.assert_array_equal(one.push.t, other.push.t)
        np.testing.assert_array_equal(one.push.xy, other.push.xy)


def check_recording(out, duration, tmp_path):
    """A real browser shows the cells in the colors of their estimate: even at first, as learned at last.

    Cells that are learned to be hardly off the mean look even at last, too. At first the region of possible centers
    veils most cells, so fewer of them are seen to be even than are.
    """
    model = read_model(out / "model.yaml")
    even = CellColors().calc_colors(CellParameters.uniform(model.obj).mass, model.params.friction)[
        0
    ]
    learned = CellColors().calc_colors(model.params.mass, model.params.friction)
    off = np.linalg.norm(learned - even, axis=1)
    others = np.unique(learned[off > off.max() / 2].round(1), axis=0)
    seen = []
    for name, moment in (("first", 0.2), ("last", duration - 0.2)):
        frozen = freeze_recording(out / "recording.html", moment, tmp_path / f"{name}.html")
        picture = take_picture(frozen, tmp_path / f"{name}.png")
        changed = np.any([find_pixels(picture, color) for color in others], axis=0)
        seen.append([int(find_pixels(picture, even).sum()), int(changed.sum())])
    (even_first, changed_first), (even_last, changed_last) = seen
    assert even_first > MIN_SEEN, seen
    assert changed_last > max(MIN_SEEN / 10, 3 * changed_first), seen
    assert even_last < 0.6 * even_first, seen


def test_replaces_nothing_unasked(refuses, tmp_path):
    out = tmp_path / "demo"
    out.mkdir()
    (out / "pushes.csv").write_text("mine")
    refuses("demo", "--task", "identify", "--out", out, says=["pushes.csv", "--force"])
    assert (out / "pushes.csv").read_text() == "mine"


def test_refuses_an_unknown_object(refuses, tmp_path):
    refuses(
        "demo",
        "--task",
        "identify",
        "--object",
        "claw_hamer",
        "--out",
        tmp_path / "demo",
        says=["--object: claw_hamer", "claw_hammer"],
    )


def test_takes_a_shipped_scenario_by_its_name(refuses, tmp_path):
    more = ["--out", tmp_path / "demo"]
    wrong = ["--object", "claw_hamer"]  # which is looked up after the scenario
    refuses("demo", "--scenario", "grasp_heavy", *wrong, *more, says=["claw_hamer"])
    refuses("demo", "--scenario", "heavy_grasp", *more, says=["heavy_grasp", "Shipped are"])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("version: 0\n", ["version", "older"]),
        ("objekt: claw_hammer\n", ["objekt", "object"]),
        ("object_pose: [2.0, 0.0, 0.0]\n", ["object_pose", "table"]),
        (
            "finger: {push_height: 0}\n",
            ["finger.push_height is 0", "expected a positive number, in m"],
        ),
        (
            "finger: {push_height: 0.05}\n",
            ["finger.push_height is 0.05 m", "at most the object's height"],
        ),
        ("workspace: {x: [2.0, 3.0]}\n", ["workspace", "reach"]),
    ],
)
def test_refuses_a_scenario_that_makes_no_sense(refuses, tmp_path, text, says):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    refuses(
        "demo",
        "--task",
        "identify",
        "--scenario",
        path,
        "--out",
        tmp_path / "demo",
        says=[path, *says],
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (
            ["--robot", "pandaa"],
            ["pandaa", "did you mean panda", "gantry, iiwa14, panda, ur5e, xarm6"],
        ),
        (
            ["--robot", "gantry"],
            ["gantry has no gripper", "expected one of iiwa14, panda, ur5e, xarm6"],
        ),
        (
            ["--task", "push", "--robot", "gantry", "--pusher", "gripper"],
            ["gantry has no gripper", "`scenes: {gripper: FILE}`", "or pusher: finger"],
        ),
        (
            ["--robot", "panda", "--pusher", "gripper"],
            ["pusher is gripper", "identify, push, slide, follow, line, separate and rearrange"],
        ),
        (["--pusher", "gripper"], ["--pusher gripper: expected --robot NAME beside it"]),
    ],
)
def test_refuses_a_robot_that_it_cannot_have(refuses, tmp_path, arguments, says):
    refuses("demo", *arguments, "--out", tmp_path / "demo", says=says)


def test_refuses_an_unknown_camera(refuses, tmp_path):
    refuses(
        "demo", "--camera", "lidar", "--out", tmp_path / "demo", says=["--camera", "lidar", "rgbd"]
    )


def test_tells_the_robot_nothing_if_it_is_asked_to(gridpush, refuses, tmp_path, monkeypatch):
    def take(self, resolved, *_):
        taken.append(resolved.scenario.unknown_inertia)
        raise GridPushError("no further")

    taken = []
    monkeypatch.setattr(TaskKind, "run", take)
    for more in ([], ["--unknown-inertia"], ["--nothing-told"]):
        done = gridpush("demo", "--camera", "ideal", "--out", tmp_path / "demo", *more)
    assert taken == [False, True, True]
    assert "warning: --nothing-told is called --unknown-inertia now\n" in done.err
    refuses(
        "demo",
        "--task",
        "push",
        "--unknown-inertia",
        "--out",
        tmp_path / "demo",
        says=[
            "--unknown-inertia",
            "goes with --task pregrasp or slide only",
            "in --task push nothing",
        ],
    )


@pytest.mark.slow
def test_weighs_what_it_is_told_nothing_of_and_lifts_it(gridpush, tmp_path):
    out = tmp_path / "untold"
    outcome = gridpush("demo", "--unknown-inertia", "--camera", "ideal", "--out", out, "--json")
    assert outcome.code == 0, outcome.err
    summary = json.loads(outcome.out)
    assert summary["status"] == "held"
    assert summary["presses"] >= 1
    assert summary["limit_report"]["touched"] == []
    weighed, true = summary["weighed"], summary["weighed"]["true"]
    assert weighed["lifts"] == 1
    assert weighed["total_mass"] == pytest.approx(true["total_mass"], rel=0.03)
    low, high = weighed["total_mass_interval"]
    assert low <= true["total_mass"] <= high
    # The center lies within the 99.9 % ellipse, and that is small.
    off = np.subtract(weighed["center_of_mass"], true["center_of_mass"])
    covariance = np.array(weighed["center_of_mass_covariance"])
    assert off @ np.linalg.solve(covariance, off) < 13.8
    assert np.sqrt(np.linalg.eigvalsh(covariance).max()) < 0.002
    assert weighed["friction"] == pytest.approx(true["friction"], abs=0.05)
    assert sorted(path.name for path in out.iterdir()) == sorted(TASK_KINDS["pregrasp"].files)
    report = (out / "report.html").read_text()
    assert "truly 0.680 kg" in report
    # From the files alone, the same model to the last digit.
    offline = tmp_path / "offline.yaml"
    files = [out / "object.yaml", out / "pushes.csv", "--weighings", out / "weighings.csv"]
    again = gridpush("identify", *files, "--out", offline)
    assert again.code == 0, again.err
    assert offline.read_text() == (out / "model.yaml").read_text()


@pytest.mark.parametrize(
    ("task", "more", "renders", "kind"),
    [
        *((task, [], True, "rgbd") for task in TASK_KINDS),
        *((task, [], False, "ideal") for task in ("identify", "separate")),
        ("identify", ["--camera", "ideal"], True, "ideal"),
        ("identify", ["--scenario"], True, "ideal"),
    ],
)
def test_the_camera_that_it_takes(gridpush, tmp_path, monkeypatch, task, more, renders, kind):
    def refuse():
        raise StationError("pictures need libegl1")

    def take(self, resolved, *_):
        taken.append(resolved.scenario.camera.kind)
        raise GridPushError("no further")

    taken = []
    monkeypatch.setattr(demo, "check_renderer", (lambda: None) if renders else refuse)
    monkeypatch.setattr(TaskKind, "run", take)
    if more == ["--scenario"]:
        more = ["--scenario", str(tmp_path / "scenario.yaml")]
        scenario_file.write_scenario(tmp_path / "scenario.yaml", TASK_KINDS[task].make_scenario())
    outcome = gridpush("demo", "--task", task, "--out", tmp_path / "demo", *more)
    # with several objects, and where the arm hides the object, the robot is told all poses
    told = task in {"follow", "line", "separate", "rearrange", "fetch"}
    assert taken == ["ideal" if told else kind]
    assert ("libegl1" in outcome.err) == (not renders and not told)
    assert not (tmp_path / "demo").exists()


@pytest.mark.parametrize("folder", ["demo", "deep/er/demo", "there/demo"])
def test_one_that_fails_leaves_no_empty_folder(gridpush, tmp_path, monkeypatch, folder):
    def fail(*_):
        raise GridPushError("no further")

    (tmp_path / "there" / "demo").mkdir(parents=True)
    monkeypatch.setattr(TaskKind, "run", fail)
    assert gridpush("demo", "--camera", "ideal", "--out", tmp_path / folder).code == 2
    assert [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*"))] == [
        "there",
        "there/demo",
    ]


@pytest.mark.parametrize("taken", ["removed", "replaced", "occupied", "file"])
def test_one_whose_place_is_taken_meanwhile_keeps_what_it_made_beside_it(
    gridpush, tmp_path, monkeypatch, taken
):
    out = tmp_path / "demo"
    (tmp_path / "demo-1").mkdir()

    def take(*_):
        if taken in ("removed", "replaced"):
            out.rmdir()
        if taken == "replaced":
            out.write_text("a file")
        if taken == "occupied":
            (out / "report.html").mkdir()
        if taken == "file":
            (out / "model.yaml").write_text("another's")

    def write(task, folder, *_):
        (folder / "report.html").write_text("what was done")
        return [folder / "report.html"]

    monkeypatch.setattr(TaskKind, "run", take)
    monkeypatch.setattr(demo, "write_files", write)
    monkeypatch.setattr(TASK_KINDS["pregrasp"], "summarize", lambda record: {"status": "held"})
    outcome = gridpush("demo", "--camera", "ideal", "--out", out, "--json")
    assert outcome.code == 0
    kept = tmp_path / "demo-2"
    assert f"The files of this run are kept in {kept} instead." in outcome.err
    assert str(out) in outcome.err
    assert (kept / "report.html").read_text() == "what was done"
    assert json.loads(outcome.out)["written"] == [str(kept / "report.html")]
    if taken == "file":
        assert (out / "model.yaml").read_text() == "another's"


def test_refuses_an_object_larger_than_the_table(refuses, tmp_path):
    door = tmp_path / "door.yaml"
    door.write_text(
        "name: door\noutline: [[-1, -0.4], [1, -0.4], [1, 0.4], [-1, 0.4]]\nmax_cells: 60\n"
    )
    refuses(
        "demo",
        "--task",
        "identify",
        "--object",
        door,
        "--out",
        tmp_path / "demo",
        says=["door", "larger than the table"],
    )


def test_takes_the_height_that_the_object_s_file_says(refuses, tmp_path):
    post = tmp_path / "post.yaml"
    post.write_text(
        "name: post\noutline: [[0, 0], [0.05, 0], [0.05, 0.05], [0, 0.05]]\nmax_cells: 9\nheight: 0.3\n"
    )
    says = ["finger.travel_height", "more than the object's height", "0.308 m"]
    refuses("demo", "--task", "identify", "--object", post, "--out", tmp_path / "demo", says=says)


def test_says_where_to_watch_only_what_can_begin(refuses, tmp_path):
    # Whether goals overlap is known only when the whole station is made.
    refuses(
        "demo",
        "--task",
        "rearrange",
        "--object",
        "pliers",
        "--out",
        tmp_path / "demo",
        says=["objects[0].goal of pliers and objects[1].goal of combination_wrench overlap"],
    )


GOAL_ON_A_POST = """
object: toothpaste_tube
object_pose: [0.58, -0.30, 1.5708]
posts: [{position: [0.60, 0.32]}]
goal: {pose: [0.60, 0.32, 1.5708]}
"""

GOAL_OFF_THE_TABLE = """
object: pliers
goal: {pose: [3.0, 0.0, 0.0]}
"""

ONE_GOAL_FOR_TWO = """
objects:
- {object: claw_hammer, pose: [0.56, -0.1, 0.0], goal: [0.5, 0.2, 0]}
- {object: pliers, pose: [0.55, 0.04, 0.1], goal: [0.5, 0.2, 0]}
"""


@pytest.mark.parametrize(
    ("task", "text", "says"),
    [
        ("follow", GOAL_ON_A_POST, "goal.pose is [0.6, 0.32, 1.5708]: there the object is nearer"),
        ("push", GOAL_OFF_THE_TABLE, "goal.pose is [3, 0, 0]: there the object is nearer"),
        ("follow", GOAL_OFF_THE_TABLE, "goal.pose is [3, 0, 0]: there the object is nearer"),
        ("separate", "object: pliers\n", "others: empty; expected other objects on the table"),
        (
            "rearrange",
            ONE_GOAL_FOR_TWO,
            "objects[0].goal of claw_hammer and objects[1].goal of pliers overlap",
        ),
    ],
)
def test_names_the_file_of_a_scenario_in_which_its_task_cannot_be_done(
    refuses, tmp_path, task, text, says
):
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(text)
    out = tmp_path / "demo"
    arguments = ("--task", task, "--scenario", scenario, "--out", out)
    refuses("demo", *arguments, says=[f"{scenario}: {says}"])


def test_refuses_a_recording_by_another_ending(refuses, tmp_path):
    record = tmp_path / "run.bag"
    arguments = ("--out", tmp_path / "demo", "--record", record)
    refuses("demo", *arguments, says=["--record", f"is '{record}'", "ends with .mcap"])


def test_refuses_a_port_in_use(gridpush, tmp_path):
    server = StartMeshcatServer(0)
    with socket.socket() as probe:
        assert probe.connect_ex(("localhost", server.port())) == 0
    outcome = gridpush(
        "demo", "--task", "identify", "--out", tmp_path / "demo", "--port", str(server.port())
    )
    assert outcome.code == 2
    assert str(server.port()) in outcome.err
    assert "in use" in outcome.err


@pytest.mark.slow
def test_an_interrupted_demo_keeps_what_was_done(tmp_path):
    out = tmp_path / "demo"
    command = shutil.which("gridpush") or sys.executable
    arguments = [
        command,
        "demo",
        "--task",
        "identify",
        "--scenario",
        write_scenario(tmp_path, count=5),
        "--out",
        out,
        "--port",
        "0",
        "--json",
    ]
    process = subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert "Watch it at" in _read_until(process.stderr, "Watch it at")
    assert "push 4 of 6" in _read_until(process.stderr, "push 4 of 6")
    os.kill(process.pid, signal.SIGINT)
    printed, errors = process.communicate(timeout=60)
    assert "Traceback" not in errors
    assert process.returncode == 130, errors
    summary = json.loads(printed)
    assert summary["status"] == "interrupted"
    assert (out / "recording.html").exists()
    assert (out / "scenario.yaml").exists()
    assert ("model.yaml" in {path.name for path in out.iterdir()}) == (summary["pushes"] > 0)


def _read_until(stream, text):
    read = ""
    while text not in read:
        line = stream.readline()
        if not line:
            break
        read += line
    return read


@pytest.mark.slow
def test_pokes_slides_and_lifts_as_readme_says(gridpush, tmp_path, monkeypatch):
    require_renderer()
    monkeypatch.chdir(tmp_path)
    outcome = gridpush("demo", "--json")
    assert outcome.code == 0, outcome.err
    summary = json.loads(outcome.out)
    assert summary["status"] == "held"
    assert summary["raised"] > 0.08
    assert summary["pokes"] >= 3
    assert summary["slides"] >= 1
    assert summary["limit_report"]["touched"] == []
    assert (
        max(
            summary["limit_report"][f"{what}_fraction"]
            for what in ("position", "velocity", "torque")
        )
        <= 1
    )
    out = tmp_path / "gridpush_demo"
    assert read_scenario(out / "scenario.yaml").camera.kind == "rgbd"
    # Nothing was weighed.
    expected = sorted(set(TASK_KINDS["pregrasp"].files) - {"weighings.csv"})
    assert sorted(path.name for path in out.iterdir()) == expected
    assert "What the robot did" in (out / "report.html").read_text()
    check_same_offline(gridpush, out, tmp_path)
    log = PushLog.read_csv(out / "pushes.csv")
    check_recorded_again(
        gridpush, out, tmp_path / "recorded.csv", log, "rectangle:0.8x1.2@0.6,-0.45"
    )


def check_same_offline(gridpush, out, tmp_path):
    """From the files alone the same model, to the last digit, with the pushes over the edge too."""
    offline = tmp_path / "offline.yaml"
    again = gridpush("identify", out / "object.yaml", out / "pushes.csv", "--out", offline)
    assert again.code == 0, again.err
    assert f"{len(PushLog.read_csv(out / 'pushes.csv'))} pushes" in again.out
    assert "hung over" not in again.out
    assert offline.read_text() == (out / "model.yaml").read_text()


def test_refuses_a_file_for_a_folder(refuses, tmp_path):
    (tmp_path / "out").write_text("mine")
    refuses("demo", "--out", tmp_path / "out", says=[f"{tmp_path / 'out'}: is a file; expected"])

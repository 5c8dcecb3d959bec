import json
from types import SimpleNamespace

import numpy as np
import pytest

from gridpush_drake.cli.run.robot import _look
from gridpush_drake.cli.run.tracker import _find
from gridpush_drake.cli.run.twin import read_robot_scenario
from gridpush_drake.perception.tracking.tracking import NOT_SEEN, TrackedPose
from gridpush_drake.station.hardware.twin import MakeTwin
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.base.messages import PushCommand
from tests.helpers.renderer import require_renderer
from tests.helpers.two_processes import SEEN_SCENARIO, find_obstacle, run_in_namespace

STOPS_WITHIN = 0.1
"""s of the robot's time after a fault."""

MIN_SPEED = 0.02
"""rad/s of a joint in the middle of a push."""

MAX_COMMANDS_UNDER_WAY = 2
"""Commands that may still follow the robot's last status."""


@pytest.mark.parametrize("command", ["twin", "tracker", "robot"])
def test_says_in_one_line_what_is_wrong(refuses, command, tmp_path):
    refuses(
        command, "--lcm", "nonsense", says=["--lcm: 'nonsense'", "expected udpm://ADDRESS:PORT"]
    )
    refuses(command, "--scenario", tmp_path / "missing.yaml", says=["missing.yaml"])
    refuses(command, "--scenario", "grsp", says=["grsp", "did you mean grasp?", "planar"])
    refuses(command, "--object", "hamer", says=["hamer", "hammer"])


def test_by_pictures_the_robot_must_be_told_which_object_the_tracker_follows(refuses, tmp_path):
    (tmp_path / "seen.yaml").write_text(SEEN_SCENARIO)
    refuses(
        "robot",
        "--scenario",
        tmp_path / "seen.yaml",
        says=["--object: missing", "gridpush tracker"],
    )


FAR = "objects:\n- {object: pliers, pose: [0.6, 0.1, 0]}\n"
"""A scenario with one object in its list."""

UNSUITED = [
    ("separate", FAR, ["objects: empty; expected other objects"]),
    ("fetch", "base: planar\n", ["others: empty", "Also: base is planar", "no model gripper"]),
    ("pregrasp", FAR, ["no model gripper"]),
    ("push", "goal: {pose: [2, 0, 0]}\n", ["goal.pose is [2, 0, 0]", "the table's edge"]),
    ("push", "camera: {kind: rgbd}\nrobot: gantry\n", ["--object: missing", "has no messages"]),
    ("follow", "follow: {path: [[0.6, 0, 0], [2, 0, 0]]}\n", ["follow.path[1] is [2, 0, 0]"]),
    ("follow", "follow: {speed: 0.3}\n", ["follow.speed is 0.3 m/s", "follow.finger_speed"]),
    ("rearrange", FAR + "- {object: pliers, pose: [0.6, -0.1, 0]}\n", ["objects[0].goal: missing"]),
]


@pytest.mark.parametrize(("task", "text", "says"), UNSUITED)
def test_what_does_not_suit_the_task_is_told_before_the_robot_is_spoken_to(
    refuses, monkeypatch, tmp_path, task, text, says
):
    def open_nothing(*_):
        raise AssertionError("a link was opened")

    monkeypatch.setattr("gridpush_drake.cli.run.robot.open_link", open_nothing)
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    refuses("robot", "--task", task, "--scenario", path, says=[f"{path}: ", *says])


def test_what_does_not_suit_the_shipped_scenario_names_it_and_others(refuses, monkeypatch):
    monkeypatch.delattr("gridpush_drake.cli.run.robot.open_link")
    says = ["error: grasp: others: empty", "The shipped scenarios separate, rearrange and fetch"]
    refuses("robot", "--task", "separate", says=says)


def test_a_twin_whose_messages_nobody_knows_is_refused_before_a_link_is_opened(
    refuses, monkeypatch, tmp_path
):
    monkeypatch.delattr("gridpush_drake.cli.run.twin.open_link")
    path = tmp_path / "cell.yaml"
    path.write_text("robot: gantry\n")
    refuses("twin", "--scenario", path, says=[f"{path}: robot.yaml of gantry has no messages"])


def test_a_station_that_cannot_be_made_is_refused_before_the_robot_is_spoken_to(
    refuses, monkeypatch, tmp_path
):
    """Where the finger comes to is known only once there is a station."""
    monkeypatch.delattr("gridpush_drake.cli.run.robot.open_link")
    path = tmp_path / "cell.yaml"
    path.write_text("workspace: {x: [0.42, 0.8], y: [-0.2, 0.4]}\ngoal: {pose: [0.6, -0.4, 0]}\n")
    says = [f"{path}: ", "goal.pose is [0.6, -0.4, 0]", "the finger does not come"]
    refuses("robot", "--task", "push", "--scenario", path, says=says)


def make_two():
    """A scenario with the wanted object last in its list."""
    first = {"object": "open_book", "pose": [0.56, -0.1, 0.25]}
    second = {"object": "pliers", "pose": [0.6, 0.07, -1.5]}
    return PushScenario(objects=[first, second])


class Waiting:
    """A task with two objects before its first push, and what its robot is linked by."""

    status_age = 0.004

    def __init__(self):
        others = (SimpleNamespace(name="other_0"),)
        self.station = SimpleNamespace(
            robot=SimpleNamespace(arm_model="iiwa"), others=others, scenario=make_two()
        )

    def preview(self, link, within):
        return PushCommand(1, 0.5, -0.2, 0.3, 0.04, 0.05)

    def read(self, port):
        return {
            "object.pose": np.array([0.56, -0.1, 0.25]),
            "other_0.pose": np.array([0.6, 0.07, -1.5]),
            "pusher.state": np.zeros(6),
            "iiwa.position_measured": np.zeros(7),
        }[port]


def test_the_robot_says_where_it_sees_each_of_several_objects(capsys):
    _look(Waiting(), Waiting(), False)
    lines = capsys.readouterr().out.splitlines()
    assert "The object lies at (0.560, -0.100) m, turned by 0.25 rad." in lines
    assert "objects[1] lies at (0.600, 0.070) m, turned by -1.50 rad." in lines
    _look(Waiting(), Waiting(), True)
    assert json.loads(capsys.readouterr().out)["other_poses"] == [[0.6, 0.07, -1.5]]


class Follower:
    """Sees the second of two objects only in the second picture."""

    def __init__(self):
        self.names, self.obj = ("pliers", "open_book"), object()
        first = TrackedPose(np.array([0.5, -0.1, 0.2]), np.eye(3), True, 0.1)
        second = TrackedPose(np.array([0.6, 0.15, -1.0]), np.eye(3), True, 0.1)
        self.pictures = [(first, NOT_SEEN), (), (first, second)]

    def step_all(self, timeout):
        return self.pictures.pop(0)

    def find_obstacle(self):
        return ""


def test_the_tracker_waits_for_all_objects_and_says_where_each_is(capsys):
    follower = Follower()
    _find(follower, None, False)
    assert follower.pictures == []
    assert capsys.readouterr().out.splitlines() == [
        "pliers is seen at (0.500, -0.100) m, turned by 0.20 rad.",
        "open_book is seen at (0.600, 0.150) m, turned by -1.00 rad.",
    ]


@pytest.mark.parametrize(
    ("line", "height"),
    [("height: 0.042\n", 0.042), ("", PushScenario().object_height)],
    ids=["its file's height", "the scenario's height"],
)
def test_the_object_in_the_scene_has_the_height_that_its_file_gives(tmp_path, line, height):
    path = tmp_path / "block.yaml"
    sides = "outline: [[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]]\n"
    path.write_text(f"name: block\n{line}{sides}")
    scenario, obj = read_robot_scenario(None, str(path), 5)
    resolved = resolve(scenario, known_object=obj)
    assert scenario.seed == 5
    assert resolved.obj.name == "block"
    twin = MakeTwin(resolved, lambda record: None)
    assert twin.world.object_in_plant.height == height


def check_stop(story):
    assert story["speed_before"] > MIN_SPEED
    assert story["stopped_within"] < STOPS_WITHIN
    assert story["held_for"] > 0.5


def tell(story, folder):
    obstacle = find_obstacle()
    if obstacle:
        pytest.skip(obstacle)
    return run_in_namespace(story, folder)


@pytest.mark.slow
def test_two_processes_and_the_controller_is_killed_interrupted_and_begun_again(tmp_path):
    told = tell("lose_controller", tmp_path)
    for name in ("killed", "interrupted"):
        print(name, {key: told[name][key] for key in ("stopped_within", "held_for")})
        check_stop(told[name])
    interrupted = told["interrupted"]
    assert interrupted["code"] == 130
    assert interrupted["summary"]["status"] == "interrupted"
    assert "guard holding: stopped by the user" in interrupted["log"]
    assert "The arm was stopped at" in interrupted["err"]
    finished = told["finished"]
    assert finished["code"] == 0, finished["err"]
    assert (finished["summary"]["status"], finished["summary"]["pushes"]) == ("finished", 1)
    assert "guard holding: the work is done" in finished["log"]
    print("the loop", finished["summary"]["loop"])
    assert finished["summary"]["loop"]["commands"] > 100
    assert told["twin_code"] == 0
    assert "model.yaml" in {path.name for path in (tmp_path / "finished").iterdir()}


@pytest.mark.slow
def test_two_processes_and_the_terminal_is_lost(tmp_path):
    told = tell("lose_terminal", tmp_path)
    print({key: told[key] for key in ("stopped_within", "held_for", "speed_before")})
    check_stop(told)
    assert told["code"] == 129, told
    assert "asked to stop by SIGHUP" in told["log"]
    assert "guard holding: stopped by the user" in told["log"]
    assert {"object.yaml", "robot.log", "scenario.yaml", "stream.csv"} <= set(told["files"])
    assert told["twin_code"] == 129
    assert "Traceback" not in told["twin_err"]


@pytest.mark.slow
def test_two_processes_and_the_robot_is_lost(tmp_path):
    told = tell("lose_twin", tmp_path)
    alone = told["alone"]
    assert alone["code"] == 2
    assert alone["err"].startswith(
        "gridpush: error: the robot sends no status on IIWA_STATUS within 5 s"
    )
    assert alone["err"].count("\n") == 1
    robot = told["robot"]
    assert robot["code"] == 1, robot["err"]
    # without any status nobody can know that the arm is at rest, and it is not called held
    assert "guard holding: " not in robot["log"]
    assert "guard holding, not seen at rest: the robot has sent no status for" in robot["log"]
    assert "No usable status of the robot came for 1.0" in robot["log"]
    message = robot["summary"]["message"]
    assert "was not seen at rest: the robot has sent no status for longer than the 50 ms" in message
    assert "the robot's driver brings the arm to rest" in message
    assert message in robot["err"]
    # one command may answer the last status, and one the status before, if it was under way
    assert told["commands_after_last_status"] <= MAX_COMMANDS_UNDER_WAY
    assert told["largest_step"] < 0.01
    looked = told["looked"]
    assert looked["code"] == 0, looked["err"]
    assert len(looked["summary"]["first_push"]) == 4
    assert looked["summary"]["status_age"] < 1.0


@pytest.mark.slow
def test_a_tracker_beside_them_finds_the_object_in_the_twins_pictures(tmp_path):
    require_renderer()
    told = tell("see_by_pictures", tmp_path)
    robot, tracker = told["robot"], told["tracker"]
    print(tracker["err"])
    assert robot["code"] == 0, robot
    assert (robot["summary"]["status"], robot["summary"]["pushes"]) == ("finished", 1)
    assert tracker["code"] == 0
    assert tracker["out"].startswith("An object of ")
    assert f"Wrote {tmp_path / 'object.yaml'}" in " ".join(tracker["out"].split())
    assert "pictures, the object seen in " in tracker["err"]
    assert told["poses"] > 30
    blind = told["blind"]
    assert blind["code"] == 2
    assert "nobody says where the object is on PLANAR_MANIPULAND_STATUS within 5 s" in blind["err"]
    assert told["twin_code"] == 0


def test_the_tracker_replaces_no_file_of_the_user_s(refuses, tmp_path):
    (tmp_path / "object.yaml").write_text("mine")
    refuses("tracker", "--out", tmp_path / "object.yaml", says=["object.yaml", "--force"])
    assert (tmp_path / "object.yaml").read_text() == "mine"

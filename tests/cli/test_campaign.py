import socket

import pytest

from gridpush_drake.cli.run.campaign import parse_seeds
from gridpush_drake.cli.shell.options import OptionError
from gridpush_drake.errors import GridPushError
from gridpush_drake.station.schema.scenario_file import format_scenario

SCENARIO = "object: pliers\nbase: planar\npokes: {count: 1, test_count: 0}\n"


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(SCENARIO)
    return path


def test_reads_seeds():
    assert parse_seeds("--seeds", "0:3", 10) == [0, 1, 2]
    assert parse_seeds("--seeds", "7,3,5:7,3", 10) == [3, 5, 6, 7]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a",
        "1.5",
        "-1",
        "0:",
        ":3",
        "3:3",
        "5:2",
        "0:3:1",
        "0:99",
        "0:9,20:30",
        "²",
        "9" * 30,
        "9" * 5000,
        f"0:{2**63}",
    ],
)
def test_refuses_other_seeds(text):
    with pytest.raises(OptionError, match="--seeds"):
        parse_seeds("--seeds", text, 10)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--seeds", "0-9"], ["--seeds", "0-9", "0:1000"]),
        (["--seeds", "0:3", "--objects", "pliers,plyers"], ["plyers", "did you mean pliers"]),
        (["--seeds", "0:3", "--objects", "pliers,"], ["--objects", "pliers,", "commas"]),
        (["--seeds", "0:3", "--task", "dance"], ["--task", "dance"]),
        (["--seeds", "0:3", "--objects", "none/such.yaml"], ["none/such.yaml"]),
        (
            ["--seeds", "0:3", "--dask", "tcp://a:8786", "--record"],
            ["--record", "on this computer", "no --dask"],
        ),
        (["--seeds", "0:3", "--dask", "nowhere"], ["--dask", "nowhere", "tcp://host:8786"]),
    ],
)
def test_refuses_bad_input(refuses, scenario, tmp_path, more, says):
    if "--task" not in more:
        more = [*more, "--task", "identify"]
    refuses("campaign", scenario, "--out", tmp_path / "out", *more, says=says)


def test_refuses_a_scenario_that_makes_no_sense(refuses, scenario, tmp_path):
    scenario.write_text(SCENARIO + "object_pose: [2.0, 0.0, 0.0]\n")
    refuses("campaign", scenario, "--seeds", "0:3", "--out", tmp_path / "out", says=["object_pose"])
    refuses(
        "campaign",
        tmp_path / "none.yaml",
        "--seeds",
        "0:3",
        "--out",
        tmp_path / "out",
        says=["none.yaml"],
    )


def test_refuses_a_scenario_that_does_not_suit_the_task(refuses, scenario, tmp_path):
    more = ["--seeds", "0:3", "--out", tmp_path / "out"]
    says = ["others: empty; expected other objects"]
    refuses("campaign", scenario, "--task", "separate", *more, says=says)
    scenario.write_text(
        "directives:\n- add_directives:\n    file: package://gridpush_drake/scenes/iiwa_push.dmd.yaml\n"
    )
    refuses("campaign", scenario, *more, says=["no model gripper"])


def test_takes_a_shipped_scenario_by_its_name(refuses, tmp_path):
    more = ["--seeds", "0:3", "--out", tmp_path / "out", "--objects", "pliers,plyers"]
    refuses("campaign", "grasp", *more, says=["plyers"])  # which is looked up after the scenario
    refuses("campaign", "grsp", *more, says=["grsp", "did you mean grasp?", "Shipped are"])


def test_refuses_a_folder_of_another_campaign(refuses, scenario, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "scenario.yaml").write_text("object: toolbox\n")
    refuses(
        "campaign",
        scenario,
        "--task",
        "identify",
        "--seeds",
        "0:3",
        "--out",
        out,
        says=["differs from the scenario given", "--force"],
    )
    (out / "scenario.yaml").unlink()
    (out / "episodes.jsonl").write_text(
        '{"bench": "campaign", "program": "1", "settings": {"task": "push"}}\n'
    )
    refuses(
        "campaign",
        scenario,
        "--task",
        "identify",
        "--seeds",
        "0:3",
        "--out",
        out,
        says=["other settings", '"push", now "identify"'],
    )


@pytest.mark.slow
def test_refuses_a_cluster_that_does_not_answer(refuses, scenario, tmp_path, monkeypatch):
    monkeypatch.setattr("gridpush_drake.jobs.cluster.CONNECT_WITHIN", 1.0)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        for port in (silent.getsockname()[1], 9):
            address = f"tcp://127.0.0.1:{port}"
            more = ["--seeds", "0:3", "--task", "identify", "--out", tmp_path / "out"]
            says = ["no cluster at", address]
            refuses("campaign", scenario, *more, "--dask", address, says=says)
    refuses("bench", "grasp", "--quick", "--dask", address, says=["no cluster at", address])


def test_takes_the_options_of_the_demo(gridpush, tmp_path, monkeypatch):
    def take(task, scenario, *_):
        taken.append(scenario)
        raise GridPushError("no further")

    taken = []
    monkeypatch.setattr("gridpush_drake.cli.run.campaign.run", take)
    options = ["--camera", "rgbd", "--robot", "xarm6", "--unknown-inertia"]
    gridpush("campaign", "grasp", "--seeds", "0", "--out", tmp_path / "out", *options)
    (scenario,) = taken
    assert scenario.camera.rgbd is not None
    assert scenario.unknown_inertia
    assert "xarm6" in format_scenario(scenario)

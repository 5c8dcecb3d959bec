import json

import numpy as np
import pytest
import yaml
from PIL import Image

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_csv import read_shape

GOAL = ("--goal", "0.15,0.1,0.8")
TABLE = ("--table", "rectangle:0.8x0.6")


def test_writes_a_plan_that_can_be_followed(gridpush, block, tmp_path):
    out, picture = tmp_path / "plan.yaml", tmp_path / "plan.png"
    outcome = gridpush("plan", block, *GOAL, *TABLE, "--out", out, "--picture", picture)
    assert outcome.code == 0, outcome.err
    assert "reached" in outcome.out
    assert "push 1" in outcome.out
    plan = yaml.safe_load(out.read_text())
    assert (plan["gridpush_plan"], plan["status"], plan["goal"]) == (1, "reached", [0.15, 0.1, 0.8])
    obj = GridObject.from_yaml(block)
    pose = plan["start"]
    for step in plan["pushes"]:
        push = Push(step["start"], step["velocity"], step["duration"], plan["pusher_radius"])
        pose = simulate(Model(obj), push, pose, regime="quasi_static").final_pose
        np.testing.assert_allclose(pose, step["pose"], atol=1e-5)
    assert plan["pushes"][-1]["error"] == plan["error"] <= 0.005
    with Image.open(picture) as image:
        assert image.format == "PNG"
        assert image.width > 400


def test_a_plate_pushes_if_it_is_asked_for(gridpush, block, tmp_path):
    out, picture = tmp_path / "plan.yaml", tmp_path / "plan.png"
    plate = ("--pusher", "plate:0.05x0.02x0.003", "--out", out, "--picture", picture)
    outcome = gridpush("plan", block, *GOAL, *TABLE, *plate)
    assert outcome.code == 0, outcome.err
    plan = yaml.safe_load(out.read_text())
    obj = GridObject.from_yaml(block)
    pose = plan["start"]
    assert plan["pushes"]
    for step in plan["pushes"]:
        shape = read_shape(out, 1, step["pusher"])
        assert shape.core[:, 1].max() + shape.radius == pytest.approx(0.025)
        end = np.add(step["start"], np.multiply(step["duration"], step["velocity"]))
        push = Push.along(
            [0.0, step["duration"]], [step["start"], end], shape=shape, yaw=step["yaw"]
        )
        pose = simulate(Model(obj), push, pose, regime="quasi_static").final_pose
        np.testing.assert_allclose(pose, step["pose"], atol=1e-5)


def test_prints_one_json_document(gridpush, model):
    outcome = gridpush("plan", model, *GOAL, "--start", "0.1,0.1,0.5", "--json")
    document = json.loads(outcome.out)
    assert (outcome.code, document["status"], document["written"]) == (0, "reached", [])
    assert document["start"] == [0.1, 0.1, 0.5]
    assert outcome.err == ""


def test_goes_round_an_obstacle(gridpush, block):
    obstacle = ("--obstacle", "rectangle:0.03x0.1@0.1,0", "--obstacle", "round:0.02@0.1,-0.1")
    outcome = gridpush(
        "plan", block, "--goal", "0.25,0,0", *obstacle, "--tolerance", "0.01", "--json"
    )
    document = json.loads(outcome.out)
    assert document["status"] == "reached"
    assert max(abs(push["pose"][1]) for push in document["pushes"]) > 0.05


def test_says_that_there_is_no_path(gridpush, block, tmp_path):
    out = tmp_path / "plan.yaml"
    outcome = gridpush(
        "plan",
        block,
        "--goal",
        "0.25,0,0",
        *TABLE,
        "--obstacle",
        "rectangle:0.02x1@0.12,0",
        "-o",
        out,
    )
    assert outcome.code == 1
    assert "no_path" in outcome.out
    assert yaml.safe_load(out.read_text())["pushes"] == []


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("--goal", "0.1,0.1"), ["--goal", "x,y,theta (m, rad)"]),
        (("--goal", "0.1,0.1,90"), ["--goal: theta is 90: in degrees? expected", "(m, rad)"]),
        ((*GOAL, "--table", "rectangle:800x600"), ["--table", "spans 800 m: in millimeters?"]),
        (("--goal", "2,0,0", *TABLE), ["--goal: At the goal pose the object hangs over the table"]),
        (
            ("--goal", "2,0,0", *TABLE, "--overhang", "5"),
            ["--goal: At the goal pose", "expected x,y,theta (m, rad)"],
        ),
        ((*GOAL, *TABLE, "--overhang", "nan"), ["--overhang", "expected a finite number (m)"]),
        ((*GOAL, "--table", "rectangle:0.8x0.001"), ["--goal: At the goal pose", "on the table"]),
        (("--goal", "0.3,0,0", "--obstacle", "round:0.05@0.3,0"), ["--goal: ", "obstacle"]),
        ((*GOAL, *TABLE, "--start", "3,0,0"), ["--start: ", "not over the table"]),
        ((*GOAL, "--start=a,b,c"), ["--start", "x,y,theta"]),
        ((*GOAL, "--table", "square:1"), ["--table", "rectangle:WxH"]),
        ((*GOAL, "--table", "round:-1"), ["--table", "radius"]),
        ((*GOAL, "--obstacle", "round:x"), ["--obstacle", "round:R"]),
        ((*GOAL, "--radius", "-1"), ["--radius: radius is -1.0; expected a positive number"]),
        (
            (*GOAL, "--radius", "0.01", "--pusher", "discs:0.004@0,-0.02;0,0.02"),
            ["--radius: is 0.01, the radius of a disc", "expected one of them"],
        ),
        ((*GOAL, "--pusher", "hand"), ["--pusher", "hand", "plate:WxTxR"]),
        ((*GOAL, "--tolerance", "0"), ["tolerance", "positive"]),
        ((*GOAL, "--speed", "0"), ["speed", "positive"]),
        (("--goal", "1e300,0,0"), ["--goal", "1e300,0,0", "x,y,theta"]),
        ((*GOAL, "--radius", "1e300"), ["radius is 1e+300", "at most 1e+12 (m)"]),
        ((*GOAL, "--speed", "1e300"), ["speed is 1e+300", "at most 1e+12 (m/s)"]),
        ((*GOAL, "--table", "round:1e300"), ["--table: radius is 1e+300", "at most 1e+12 (m)"]),
        (
            (*GOAL, "--table", "polygon:0,0;1e300,0;0,1"),
            ["--table: a corner is at 1e+300 m", "at most 1e+12 m"],
        ),
        ((*GOAL, "--obstacle", "round:1e200@0.3,0"), ["--obstacle: radius is 1e+200"]),
    ],
)
def test_refuses(refuses, block, args, says):
    refuses("plan", block, *args, says=says)


def test_does_not_write_over_a_file(gridpush, block, tmp_path):
    out = tmp_path / "plan.yaml"
    out.write_text("mine")
    outcome = gridpush("plan", block, *GOAL, "--out", out)
    assert outcome.code == 2
    assert out.read_text() == "mine"

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
import yaml
from PIL import Image

from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior

TABLE = ("--table", "rectangle:0.6x0.5@0.4,0.1")
SURE = PhysicalPrior(
    friction=0.3, friction_min=0.29, friction_max=0.31, center_of_mass=(-0.05, 0.0)
)


@pytest.fixture
def pan(tmp_path):
    """A plate with a handle, its center of mass known beforehand."""
    outline = shapely.box(-0.14, -0.07, 0.0, 0.07).union(shapely.box(0.0, -0.015, 0.2, 0.015))
    path = tmp_path / "pan.yaml"
    GridObject.from_outline(outline, max_cells=40, name="pan", prior=SURE).write_yaml(path)
    return path


def test_plans_draws_and_writes(gridpush, pan, tmp_path):
    out, picture = tmp_path / "plan.yaml", tmp_path / "plan.png"
    outcome = gridpush("slide", pan, *TABLE, "--out", out, "--picture", picture)
    assert outcome.code == 0, outcome.err
    assert "pan: ready" in outcome.out
    assert str(out) in outcome.out
    plan = yaml.safe_load(out.read_text())
    assert plan["status"] == "ready"
    assert plan["pushes"]
    assert plan["goal"]["stability_margin"] > 0.002
    grasp = np.array(plan["goal"]["grasp"]["at"])
    assert not shapely.box(0.1, -0.15, 0.7, 0.35).contains(shapely.Point(grasp))
    with Image.open(picture) as image:
        assert image.width > 600


@pytest.mark.slow
def test_a_plate_slides_if_it_is_asked_for(gridpush, pan):
    plate = ("--pusher", "plate:0.05x0.02x0.003", "--json")
    outcome = gridpush("slide", pan, *TABLE, *plate)
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    assert found["status"] == "ready" and found["pushes"]
    for push in found["pushes"]:
        assert push["pusher"].startswith("POLYGON") and push["radius"] == 0.003
        # its front faces where it goes, but for how it slants
        along = np.subtract(push["to"], push["from"])
        turned = push["yaw"] - np.arctan2(along[1], along[0])
        assert np.cos(turned) > 0.7


def test_refuses_an_object_of_160_m_before_anything_is_planned(refuses, tmp_path, monkeypatch):
    monkeypatch.delattr("gridpush_drake.cli.run.slide.plan_pregrasp")
    plate = GridObject.from_outline(shapely.box(-80, -1, 80, 1), max_cells=40, name="plate")
    plate.write_yaml(tmp_path / "plate.yaml")
    refuses(
        "slide",
        tmp_path / "plate.yaml",
        *TABLE,
        says=["plate: its outline spans 160 m", "at most 10"],
    )


def test_a_tray_is_taken_by_its_rim_where_the_pads_hold_it(gridpush, refuses, tmp_path):
    square, tray = shapely.box(-0.08, -0.08, 0.08, 0.08), tmp_path / "tray.yaml"

    def write(**known):
        prior = PhysicalPrior(
            friction=0.3, friction_min=0.29, friction_max=0.31, center_of_mass=(0.0, 0.0), **known
        )
        obj = GridObject.from_outline(square, max_cells=16, name="tray", prior=prior)
        replace(obj, height=0.02).write_yaml(tray, force=True)

    slide = ("slide", tray, "--table", "rectangle:0.5x0.5", "--start", "0,0.16,0")
    write(total_mass=0.3)
    refuses(*slide, "--opening", "0.1", says=["tray", "no graspable part"])
    outcome = gridpush(*slide, "--opening", "0.1", "--pad-force", 80, "--json")
    assert outcome.code == 0, outcome
    document = json.loads(outcome.out)
    grasp = document["goal"]["grasp"]
    assert document["graspable_parts"] == 0 < document["rim_parts"] and grasp["by"] == "rim"
    at, inward = (
        np.array(grasp["at"]),
        np.array([np.cos(grasp["approach"]), np.sin(grasp["approach"])]),
    )
    assert not shapely.box(-0.25, -0.25, 0.25, 0.25).contains(shapely.Point(at))
    assert (
        shapely.Point(at).distance(shapely.box(-0.25, -0.25, 0.25, 0.25)) < 0.05 and inward @ at < 0
    )
    write(total_mass=3.0)
    outcome = gridpush(*slide, "--opening", "0.1", "--pad-force", 80)
    assert outcome.code == 1 and "the pads cannot hold it" in outcome.out
    refuses(
        *slide,
        "--opening",
        "0.03",
        "--pad-force",
        80,
        says=["tray", "0.02 m thick", "expected at most"],
    )
    refuses(
        *slide,
        "--opening",
        "0.1",
        "--pad-force",
        0,
        says=["force is 0", "expected a positive number"],
    )


@pytest.mark.slow
def test_one_json_document_tells_what_a_poke_is_worth(gridpush):
    outcome = gridpush("slide", "claw_hammer", "--table", "round:0.4", "--margin", 0.02, "--json")
    assert outcome.code == 1, outcome.err
    document = json.loads(outcome.out)
    assert document["status"] == "poke_first"
    assert document["model"] == "prior"
    assert document["pushes"] == []
    assert len(document["poke"]["from"]) == 2
    assert "standard deviation" in document["message"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("open_book", "--table", "round:0.4"), ["open_book", "no graspable part"]),
        (
            ("claw_hammer", "--table", "rectangle:0.2x0.2@0,0"),
            ["table", "smaller than claw_hammer"],
        ),
        (("claw_hammer", "--table", "triangle:1"), ["--table", "rectangle:WxH@x,y"]),
        (("claw_hammer", "--table", "round:0.4@0"), ["--table", "round:R@x,y"]),
        (("claw_hammer", "--table", "round:-1"), ["table", "radius"]),
        (("claw_hammer", "--table", "polygon:0,0;1,1;1,0;0,1"), ["table", "cross itself"]),
        (
            ("claw_hammer", "--table", "rectangle:1e300x1"),
            ["--table: size is", "at most 1e+12 (m)"],
        ),
        (("claw_hammer", *TABLE, "--opening", "0"), ["gripper", "opening"]),
        (("claw_hammer", *TABLE, "--depth", "-0.1"), ["gripper", "depth"]),
        (("claw_hammer", *TABLE, "--margin", "-0.1"), ["margin"]),
        (("claw_hammer", *TABLE, "--friction", "0.5,0.2"), ["friction_range"]),
        (("claw_hammer", *TABLE, "--radius", "0"), ["--radius: radius is 0.0"]),
        (("claw_hammer", *TABLE, "--start", "5,0,0"), ["--start", "on the table"]),
        (("claw_hammer", *TABLE, "--start", "0,0"), ["--start", "x,y,theta"]),
        (("nothing", *TABLE), ["nothing"]),
    ],
)
def test_refuses_what_makes_no_sense(refuses, arguments, says):
    refuses("slide", *arguments, says=says)

import json

import numpy as np
import pytest
from PIL import Image

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import PushLog

PUSH = ("--start=-0.05,-0.035", "--velocity", "0,0.05", "--duration", "1")


def test_moves_an_object_and_says_where_to(gridpush, block):
    outcome = gridpush("simulate", block, *PUSH)
    assert outcome.code == 0
    assert "block, inertial: ok" in outcome.out
    assert "theta" in outcome.out


def test_prints_one_json_document(gridpush, block):
    outcome = gridpush("simulate", block, *PUSH, "--regime", "quasi_static", "--json")
    document = json.loads(outcome.out)
    assert (document["status"], document["regime"], document["written"]) == (
        "ok",
        "quasi_static",
        [],
    )
    assert document["final_pose"][1] > 0.001
    assert outcome.err == ""


def test_writes_a_log_that_can_be_read(gridpush, block, tmp_path):
    out, picture = tmp_path / "log.csv", tmp_path / "motion.png"
    outcome = gridpush(
        "simulate", block, *PUSH, "--pose", "0.1,0.2,0", "--start=0.05,0.16", "--samples", "4",
        "--out", out, "--picture", picture, "--json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    (seen,) = PushLog.read_csv(out)
    assert len(seen.t_observed) == 4
    np.testing.assert_array_equal(seen.pose, [0.1, 0.2, 0])
    np.testing.assert_array_equal(seen.final_pose, json.loads(outcome.out)["final_pose"])
    with Image.open(picture) as image:
        assert image.format == "PNG"


def test_knows_the_shipped_objects_and_models(gridpush, model):
    assert (
        gridpush(
            "simulate", "claw_hammer", "--start=0,-0.05", "--velocity", "0,0.05", "--duration", "1"
        ).code
        == 0
    )
    outcome = gridpush("simulate", model, *PUSH)
    assert "quasi_static" in outcome.out


def test_random_masses_follow_their_seed(gridpush, block):
    first, again, other = (
        gridpush("simulate", block, *PUSH, "--mass-seed", seed, "--json").out for seed in (1, 1, 2)
    )  # fmt: skip
    assert first == again != other


def test_a_push_that_misses_is_no_error(gridpush, block):
    outcome = gridpush(
        "simulate", block, "--start", "1,1", "--velocity", "0.1,0", "--duration", "1"
    )
    assert outcome.code == 0
    assert "no_contact" in outcome.out


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("--start", "0"), ["--start", "x,y"]),
        (("--velocity", "fast,0"), ["--velocity", "vx,vy"]),
        (("--pose", "0,0"), ["--pose", "x,y,theta"]),
        (("--duration", "-1"), ["duration", "positive"]),
        (("--duration", "nan"), ["duration", "positive"]),
        (("--radius", "0"), ["--radius: radius is 0.0; expected a positive number"]),
        (("--radius", "1e300"), ["radius is 1e+300", "at most 1e+12"]),
        (("--duration", "1e300"), ["duration is 1e+300", "at most 1e+12"]),
        (("--pose", "0,0,1e300"), ["--pose", "0,0,1e300"]),
    ],
)
def test_refuses(refuses, block, args, says):
    refuses("simulate", block, *PUSH, *args, says=says)


def test_refuses_an_unknown_object(refuses):
    refuses("simulate", "claw_hamer", *PUSH, says=["claw_hamer", "did you mean claw_hammer?"])


def test_block_is_what_it_was(block):
    assert GridObject.from_yaml(block).n == 18

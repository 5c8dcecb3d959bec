import json

import numpy as np
import pytest

from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.stream import record_pushes, write_stream_csv
from tests.helpers.scripted_stream import PERIOD, Script, poke_four_times
from tests.helpers.shapes import make_shape

OBJECT = "l_bracket"


@pytest.fixture(scope="module")
def script():
    return poke_four_times(Script(make_shape(OBJECT, 20)))


@pytest.fixture
def stream(script, tmp_path):
    path = tmp_path / "stream.csv"
    write_stream_csv(script.samples, path)
    return path


@pytest.fixture
def thing(script, tmp_path):
    path = tmp_path / "object.yaml"
    script.obj.write_yaml(path)
    return path


def check_same(log, other_log):
    """Two logs hold the same pushes, bit for bit."""
    for one, other in zip(log, other_log, strict=True):
        np.testing.assert_array_equal(one.t_observed, other.t_observed)
        np.testing.assert_array_equal(one.poses_observed, other.poses_observed)
        np.testing.assert_array_equal(one.push.xy, other.push.xy)


def test_writes_the_pushes_of_a_stream(gridpush, script, stream, thing, tmp_path):
    out = tmp_path / "pushes.csv"
    outcome = gridpush("record", stream, "--object", thing, "--out", out, "--json")
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    assert (found["pushes"], found["unfinished"], found["overhanging"]) == (4, False, [])
    delay = found["delay"]
    assert delay["applied"] == 0 and delay["told_by"] is None
    assert abs(delay["found"]["value"]) < 2 * delay["found"]["std"]
    expected = record_pushes(script.samples, script.obj, 0.005).log
    check_same(expected, PushLog.read_csv(out))


def test_the_pushers_shape_is_told_by_the_user_and_its_angle_by_the_stream(
    gridpush, refuses, script, thing, tmp_path
):
    path, out = tmp_path / "turned.csv", tmp_path / "pushes.csv"
    write_stream_csv([each._replace(yaw=0.3) for each in script.samples], path)
    shape = "POLYGON ((-0.008 -0.02, -0.002 -0.02, -0.002 0.02, -0.008 0.02, -0.008 -0.02)) RADIUS 0.002"
    arguments = ("record", path, "--object", thing, "--out", out, "--force")
    for told in (shape, "plate:0.044x0.01x0.002"):
        outcome = gridpush(*arguments, "--pusher", told)
        assert outcome.code == 0, outcome.err
        for seen in PushLog.read_csv(out):
            assert seen.push.shape.radius == 0.002 and seen.push.shape.joined
            np.testing.assert_allclose(seen.push.shape.area.bounds, [-0.01, -0.022, 0, 0.022])
            np.testing.assert_array_equal(seen.push.yaw, 0.3)
    for told, says in (
        ("plate:0.04", "expected plate:WxTxR, discs:R@x,y;x,y or MULTIPOINT"),
        ("discs:0.004", "expected plate:WxTxR, discs:R@x,y;x,y or MULTIPOINT"),
        ("POLYGON ((0 0, 1 0, 1 1))", "expected plate:WxTxR, discs:R@x,y;x,y or MULTIPOINT"),
        ("plate:0.04x0.01x0.02", "the polygon is thinner than 0.04 m"),
    ):
        refuses(*arguments, "--pusher", told, says=["--pusher", says])


def test_a_delay_is_found_taken_out_and_agreed_with(gridpush, script, stream, thing, tmp_path):
    late = [
        now._replace(pose=old.pose)
        for now, old in zip(script.samples[3:], script.samples[:-3], strict=True)
    ]
    write_stream_csv(late, stream, force=True)

    def record(name, *more):
        outcome = gridpush(
            "record", stream, "--object", thing, "--out", tmp_path / name, *more, "--json"
        )
        assert outcome.code == 0, outcome.err
        return json.loads(outcome.out)["delay"], PushLog.read_csv(tmp_path / name)

    found, log = record("found.csv")
    assert found["applied"] == found["found"]["value"] == pytest.approx(3 * PERIOD, abs=0.02)
    # told its own number, it writes the same pushes, and has nothing to object
    told, again = record("told.csv", "--pose-delay", found["applied"])
    assert told["found"] == found["found"] and not told["contradicted"]
    check_same(log, again)
    # what the file says goes before what is found, and what the user says before both
    write_stream_csv(late, stream, force=True, pose_delay=3 * PERIOD)
    of_file, _ = record("file.csv")
    assert (of_file["applied"], of_file["told_by"]) == (3 * PERIOD, "object_delay")
    of_user, _ = record("user.csv", "--pose-delay", 0.0)
    assert (of_user["applied"], of_user["told_by"]) == (0.0, "--pose-delay")
    assert of_user["contradicted"]
    outcome = gridpush(
        "record", stream, "--object", thing, "--out", tmp_path / "said.csv", "--pose-delay", "0"
    )
    assert "taken to be 0 ms late, as --pose-delay says, but they are" in outcome.out


def test_says_what_hangs_over(gridpush, script, stream, thing, tmp_path):
    x = script.truth[-1][0] + 0.02
    table = f"polygon:-1,-1;{x},-1;{x},1;-1,1"
    outcome = gridpush(
        "record", stream, "--object", thing, "--out", tmp_path / "a.csv", "--table", table
    )
    assert outcome.code == 0, outcome.err
    flags = [seen.overhang for seen in PushLog.read_csv(tmp_path / "a.csv")]
    assert flags[-1] and not flags[0]


def test_refuses_a_stream_in_degrees(refuses, script, stream, thing, tmp_path):
    turned = [
        sample._replace(pose=(*sample.pose[:2], np.degrees(sample.pose[2])))
        for sample in script.samples
    ]
    write_stream_csv(turned, stream, force=True)
    refuses(
        "record",
        stream,
        "--object",
        thing,
        "--out",
        tmp_path / "pushes.csv",
        says=[stream, "in degrees"],
    )


def test_doubts_a_stream_in_millimeters(refuses, script, stream, thing, tmp_path):
    scaled = [
        sample._replace(
            tip=(1e3 * sample.tip[0], 1e3 * sample.tip[1], sample.tip[2]),
            velocity=tuple(1e3 * v for v in sample.velocity),
            pose=(1e3 * sample.pose[0], 1e3 * sample.pose[1], sample.pose[2]),
        )
        for sample in script.samples
    ]
    write_stream_csv(scaled, stream, force=True)
    says = [stream, "tip_x, tip_y: in millimeters? expected m, they span"]
    refuses("record", stream, "--object", thing, "--out", tmp_path / "pushes.csv", says=says)


def test_says_why_there_is_no_push(refuses, script, stream, thing, tmp_path):
    moving = [
        i
        for i, sample in enumerate(script.samples)
        if sample.tip[2] < 0.05 and abs(sample.velocity[0]) > 0.01
    ]
    command = ("record", stream, "--object", thing, "--out", tmp_path / "pushes.csv")
    write_stream_csv(script.samples[: moving[0] + 5], stream, force=True)
    refuses(*command, says=[stream, "it ends within a push"])


def test_names_a_push_of_what_was_not_seen_at_rest(gridpush, script, stream, thing, tmp_path):
    first = next(
        i
        for i, sample in enumerate(script.samples)
        if sample.tip[2] < 0.05 and np.hypot(*sample.velocity[:2]) > 0.01
    )
    write_stream_csv(script.samples[first + 2 :], stream, force=True)
    outcome = gridpush(
        "record", stream, "--object", thing, "--out", tmp_path / "pushes.csv", "--json"
    )
    found = json.loads(outcome.out)
    assert found["pushes"] == 3
    assert "was not seen at rest" in found["unusable"][0]


def test_refuses(refuses, stream, thing, tmp_path):
    out = tmp_path / "pushes.csv"
    refuses(
        "record", stream, "--object", "claw_hamer", "--out", out, says=["claw_hamer", "claw_hammer"]
    )
    refuses("record", tmp_path / "none.csv", "--object", thing, "--out", out, says=["none.csv"])
    refuses(
        "record",
        stream,
        "--object",
        thing,
        "--out",
        out,
        "--pose-delay",
        "nan",
        says=["--pose-delay"],
    )
    refuses(
        "record", stream, "--object", thing, "--out", out, "--pose-delay", "100",
        says=["--pose-delay: is 100", "(s), at most 10"],
    )  # fmt: skip
    refuses(
        "record",
        stream,
        "--object",
        thing,
        "--out",
        out,
        "--engaged-below",
        "0.001",
        says=[stream, "holds no push"],
    )
    refuses("record", stream, "--object", thing, "--out", stream, says=[stream, "--force"])
    for read in (stream, thing):
        refuses(
            "record",
            stream,
            "--object",
            thing,
            "--out",
            read,
            "--force",
            says=[read, "is also read by this command"],
        )


def test_a_push_log_is_told_from_a_stream(gridpush, stream, thing, tmp_path):
    log = tmp_path / "pushes.csv"
    assert gridpush("record", stream, "--object", thing, "--out", log).code == 0
    outcome = gridpush("record", log, "--object", thing, "--out", tmp_path / "again.csv")
    assert outcome.code == 2 and not (tmp_path / "again.csv").exists()
    said = outcome.err.splitlines()[-1]
    assert f"{log}, line" in said and "is it a push log, which has a column push?" in said

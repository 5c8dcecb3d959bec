import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import yaml

from gridpush_drake.cli.learn import identify as command
from gridpush_drake.identification.methods import METHOD_NAMES
from gridpush_drake.identification.model_file import read_model
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.made_logs import log_elsewhere


def test_learns_a_model_and_reports_it(gridpush, block, pushes, tmp_path):
    model, report = tmp_path / "learned.yaml", tmp_path / "report.html"
    outcome = gridpush("identify", block, pushes, "--out", model, "--report", report, "--seed", "1")
    assert outcome.code == 0, outcome.err
    for text in ("block", "cell error", "contact friction", "cannot", str(model), str(report)):
        assert text in outcome.out
    learned = read_model(model)
    assert learned.seed == 1
    assert learned.obj.prior.pusher_radius == 0.004
    assert report.read_text().startswith("<!doctype html>")
    assert gridpush("predict", model, pushes, "--out", tmp_path / "predicted.csv").code == 0
    assert gridpush("show", model, "--out", tmp_path / "picture.png").code == 0


def test_an_outline_in_another_frame_is_placed_by_the_pushes_or_by_hand(
    gridpush, refuses, block, pushes, tmp_path
):
    # the same pushes, logged in a frame in which the outline's is at (4, -3) mm
    shift = [0.004, -0.003, 0.0]
    log = PushLog.read_csv(pushes)
    shifted = tmp_path / "shifted.csv"
    log_elsewhere(log, np.array(shift)).write_csv(shifted)
    learned, placed = tmp_path / "learned.yaml", tmp_path / "placed.yaml"
    outcome = gridpush("identify", block, shifted, "--out", learned, "--fit-frame", "--json")
    found = json.loads(outcome.out)["outline_pose"]
    assert abs(found["pose"][0] - 0.004) < 2 * found["std"][0] < 0.006
    assert abs(found["pose"][1] + 0.003) < 2 * found["std"][1] < 0.006
    assert read_model(learned).obj.outline_pose.pose == tuple(found["pose"])

    by_hand = ("identify", block, shifted, "--out", placed, "--body-at", "0.004,-0.003,0")
    outcome = gridpush(*by_hand)
    assert (
        "the outline's frame is in the body frame of the log at x 4.0 mm, y -3.0 mm" in outcome.out
    )
    assert read_model(placed).obj.outline_pose.pose == tuple(shift)
    refuses(*by_hand[:-1], "0.004,-0.003", "--force", says=["--body-at", "x,y,theta"])


def test_prints_one_json_document(gridpush, block, pushes, tmp_path):
    outcome = gridpush(
        "identify", block, pushes, "--out", tmp_path / "learned.yaml", "--method", "random_search", "--budget", "40",
        "--regime", "quasi_static", "--json",
    )  # fmt: skip
    document = json.loads(outcome.out)
    assert document["hypotheses"] == []
    assert (document["method"], document["regime"]) == ("random_search", "quasi_static")
    assert document["mean_cell_error"] <= document["mean_cell_error_before"] * 1.05


def test_offers_every_method():
    assert get_args(command.Method) == METHOD_NAMES


def test_refuses_to_replace_a_file_before_it_begins(refuses, block, pushes, tmp_path, monkeypatch):
    monkeypatch.setattr(command, "learn", None)
    for name in ("learned.yaml", "report.html"):
        (tmp_path / name).write_text("mine")
        outputs = ("--out", tmp_path / "learned.yaml", "--report", tmp_path / "report.html")
        refuses("identify", block, pushes, *outputs, says=[name, "--force"])
        (tmp_path / name).unlink()


def test_refuses_one_file_for_two_outputs(refuses, block, pushes, tmp_path):
    same = tmp_path / "out.html"
    refuses(
        "identify", block, pushes, "--out", same, "--report", same, says=[same, "written twice"]
    )


def test_refuses_a_budget_that_it_would_not_keep(refuses, block, pushes, tmp_path):
    refuses(
        "identify",
        block,
        pushes,
        "--out",
        tmp_path / "learned.yaml",
        "--budget",
        "5",
        says=["--budget"],
    )


def test_refuses_a_model_in_place_of_an_object(refuses, model, pushes, tmp_path):
    refuses(
        "identify",
        model,
        pushes,
        "--out",
        tmp_path / "learned.yaml",
        says=[model, "is a learned model"],
    )


@pytest.mark.slow
def test_doubts_a_model_that_explains_too_little(gridpush, block, pushes, tmp_path):
    """The same angle measured clockwise."""
    right = gridpush("identify", block, pushes, "--out", tmp_path / "right.yaml", "--json")
    document = json.loads(right.out)
    assert document["doubt"] is None
    assert sum(one["weight"] for one in document["hypotheses"]) == pytest.approx(1.0)
    assert {"smooth field 0.05", "rigid bottom"} <= {one["name"] for one in document["hypotheses"]}
    log = PushLog.read_csv(pushes)
    mirrored = [
        replace(seen, poses_observed=seen.pose + (seen.poses_observed - seen.pose) * [1, 1, -1])
        for seen in log
    ]
    pushes.unlink()
    replace(log, pushes=tuple(mirrored)).write_csv(pushes)
    outcome = gridpush(
        "identify", block, pushes, "--out", tmp_path / "wrong.yaml", "--report", tmp_path / "r.html"
    )
    assert outcome.code == 3, outcome.err
    assert "Learned from the pushes." not in outcome.out
    assert "should not be used" in (tmp_path / "r.html").read_text()
    assert read_model(tmp_path / "wrong.yaml").status == "explains_little"
    found = json.loads(gridpush("identify", block, pushes, "-o", tmp_path / "w.yaml", "--json").out)
    assert found["status"] == "explains_little"
    assert found["doubt"] == found["message"]
    for text in (outcome.out, (tmp_path / "r.html").read_text()):
        assert "explains these pushes poorly" in text


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("object_theta", "theta", "object_theta"),
        ("push_1,0.0,", "push_1,soon,", "soon"),
        ("push,t", "PUSH,t", "rename 'PUSH' to 'push'"),
    ],
)
def test_refuses_a_log(refuses, block, pushes, tmp_path, old, new, says):
    pushes.write_text(pushes.read_text().replace(old, new, 1))
    refuses("identify", block, pushes, "--out", tmp_path / "learned.yaml", says=[pushes, says])


def test_an_interrupt_leaves_nothing(gridpush, block, pushes, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "learn", interrupted)
    outcome = gridpush("identify", block, pushes, "--out", tmp_path / "learned.yaml")
    assert outcome.code == 130
    assert outcome.err == "gridpush: interrupted; no file was left half-written\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["block.yaml", "pushes.csv"]


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_an_interrupted_process_leaves_nothing(block, pushes, tmp_path):
    process = subprocess.Popen(
        [
            sys.executable, "-m", "gridpush_drake.cli.main", "identify", block, pushes, "--out", tmp_path / "m.yaml",
            "--method", "random_search", "--budget", "100000000",
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )  # fmt: skip
    try:
        began = process.stderr.readline()  # said when the search begins
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, (began, err)
    assert out == ""
    assert "Traceback" not in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["block.yaml", "pushes.csv"]


def test_pushes_over_the_edge_are_left_out_bit_for_bit(gridpush, block, pushes, tmp_path):
    """The same model as from the log without them."""
    log = PushLog.read_csv(pushes)
    marked = PushLog(tuple(replace(seen, overhang=i in (1, 4)) for i, seen in enumerate(log)))
    marked.write_csv(tmp_path / "marked.csv")
    log[[0, 2, 3]].write_csv(tmp_path / "kept.csv")
    log[[2, 3]].write_csv(tmp_path / "fewer.csv")

    def learn(name, *options):
        outcome = gridpush(
            "identify",
            block,
            tmp_path / f"{name}.csv",
            "--out",
            tmp_path / f"{name}.yaml",
            *options,
        )
        assert outcome.code == 0, outcome.err
        return outcome.out, (tmp_path / f"{name}.yaml").read_text()

    told, model = learn("marked")
    assert "left out 2 pushes, as the object hung over the table's edge: push_2, push_5" in told
    assert model == learn("kept")[1]
    assert model != learn("fewer")[1]


def test_refuses_a_log_of_nothing_but_pushes_over_the_edge(refuses, block, pushes, tmp_path):
    log = PushLog.read_csv(pushes)
    PushLog(tuple(replace(seen, overhang=True) for seen in log)).write_csv(tmp_path / "over.csv")
    for name in ("identify", "predict"):
        says = [tmp_path / "over.csv", "overhang", "expected"]
        refuses(name, block, tmp_path / "over.csv", "--out", tmp_path / "out", says=says)


@pytest.mark.parametrize("command", ["identify", "predict"])
def test_refuses_a_table_that_the_object_is_not_on(command, refuses, block, pushes, tmp_path):
    log = tmp_path / "far.csv"
    header, first, *rest = pushes.read_text().splitlines()
    for table, says in (
        (
            "POLYGON ((1 1, 2 1, 2 2, 1 2, 1 1))",
            ["push_1", "column table", "no cell of block", "expected an object on"],
        ),
        ("POLYGON ((-1 -1, 1 -1, 1 1, -1 1))", ["line 2", "column table", "ends where it begins"]),
    ):
        log.write_text(
            "\n".join([f"{header},table", f'{first},"{table}"', *(f"{row}," for row in rest)])
        )
        refuses(command, block, log, "--out", tmp_path / "out", says=[log, *says])


@pytest.mark.parametrize(
    ("height", "says"), [("0", "positive number, in meters"), ("9", "expected less than")]
)
def test_refuses_a_pusher_of_no_height_or_too_high(
    height, says, gridpush, refuses, block, pushes, tmp_path
):
    high = tmp_path / "high.yaml"
    document = yaml.safe_load(block.read_text())
    high.write_text(
        yaml.safe_dump(document | {"pusher": {"radius": 0.005, "height": float(height)}})
    )
    says = [high, f"pusher.height is {height}", says]
    for arguments in (
        ("identify", high, pushes, "--out", tmp_path / "out"),
        ("predict", high, pushes, "--out", tmp_path / "out"),
        ("plan", high, "--goal", "0.1,0,0"),
        ("slide", high, "--table", "round:0.4"),
        ("simulate", high, "--start=-0.1,0", "--velocity", "0.02,0", "--duration", "1"),
    ):
        refuses(*arguments, says=says)


def test_refuses_what_cannot_be_true(refuses, block, tmp_path):
    log = tmp_path / "log.csv"
    header = "push,t,tip_x,tip_y,object_x,object_y,object_theta\n"
    for rows, says in (
        (
            "a,0,-0.02,0.034,0,0,0\na,1,-0.02,0.024,9.9,0,0\n",
            ["push 'a'", "object_x", "moves 9.9 m", "lost track"],
        ),
        ("a,0,-20,34,10,0,0\na,1,-20,24,10,-5,0\n", ["push 'a'", "tip_x", "in millimeters?"]),
        ("a,0,1,1,0,0,0\na,1,1,1.1,0,0,0\n", ["no push touches block", "'a'"]),
    ):
        log.write_text(header + rows)
        refuses("identify", block, log, "--out", tmp_path / "model.yaml", says=[log, *says])


@pytest.fixture
def weighings(tmp_path):
    """The block of the tests, whose edge lies along y: a weight of 7.5 N, 40 mm inside the edge."""
    path = tmp_path / "weighings.csv"
    path.write_text(
        "kind,object_x,object_y,object_theta,place_x,place_y,force,edge_x,edge_y,edge_angle,"
        "force_std\n"
        "press,-0.04,0,0,0.03,0,10.0,0,0,0,0.05\n"
        "press,-0.04,0.1,3.14159265,0.03,0.1,10.0,0,0,0,0.05\n"
        "lift,-0.04,0,0,0.01,0,7.5,,,,0.05\n"
    )
    return path


def test_weighings_give_absolute_numbers(gridpush, block, pushes, weighings, tmp_path, undrawn):
    model, report = tmp_path / "learned.yaml", tmp_path / "report.html"
    outcome = gridpush(
        "identify", block, pushes, "--weighings", weighings, "--out", model, "--report", report,
        "--json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)["absolute"]
    low, high = found["total_mass_interval"]
    assert low < 7.5 / 9.81 < high < 1.05 * low
    assert found["center_of_mass"][0] == pytest.approx(0, abs=0.002)
    assert (found["presses"], found["lifts"], found["friction"]) == (2, 1, None)
    learned = read_model(model)
    assert learned.params.total_mass == pytest.approx(found["total_mass"], rel=1e-12)
    assert yaml.safe_load(model.read_text())["absolute"]["total_mass"]["low"] == low
    assert "weighed: " in report.read_text()
    told = gridpush("identify", block, pushes, "--weighings", weighings, "--out", model, "--force")
    assert "Weighed by 2 presses at the edge and 1 lift: the object weighs 0.76" in told.out
    for name in ("block.sdf", "block.urdf", "block.xml"):
        exported = gridpush("export", model, tmp_path / name)
        assert exported.code == 0 and "is assumed" not in exported.err
        text = (tmp_path / name).read_text()
        assert "weighed by 2 presses at the edge and 1 lift; with a probability of 95 %" in text
    drawn = gridpush("export", model, tmp_path / "block.sdf", "--samples", "2")
    assert drawn.code == 0, drawn.err
    masses = [
        float((tmp_path / f"block_{i}.sdf").read_text().split("<mass>")[1].split("<")[0])
        for i in (1, 2)
    ]
    assert masses[0] != masses[1]


def test_names_what_is_wrong_with_weighings(refuses, block, pushes, weighings, tmp_path):
    weighings.write_text(weighings.read_text().replace("lift", "left"))
    arguments = ("identify", block, pushes, "--weighings", weighings)
    says = [f"{weighings}, line 4, column kind: is 'left'; expected 'press' or 'lift'"]
    refuses(*arguments, "--out", tmp_path / "learned.yaml", says=says)
    outcome = ("--out", weighings)
    refuses(*arguments, *outcome, says=[weighings])


def test_weighings_that_cannot_be_true_are_never_learned_from(
    gridpush, refuses, block, pushes, weighings, tmp_path
):
    good = weighings.read_text()
    model = tmp_path / "learned.yaml"
    arguments = ("identify", block, pushes, "--weighings", weighings, "--out", model)
    for told, instead, column in (("10.0", "1.2e10", "force"), ("0.05", "3.5e-11", "force_std")):
        weighings.write_text(good.replace(told, instead))
        refuses(*arguments, says=[weighings, f"press 1, column {column}"])
    assert not model.exists()
    # Forces by which it balances where there is nothing of it: the presses are left out, and the
    # weight is that of the lift.
    header, press, _, lift = good.splitlines()
    nearer = press.replace("0.03,0,10.0", "0.025,0,42.0")
    weighings.write_text("\n".join([header, press.replace("10.0", "35.0"), nearer, lift]))
    found = json.loads(gridpush(*arguments, "--json").out)["absolute"]
    assert [test["line"] for test in found["tests"]] == ["none", "none"]
    assert all(abs(test["residual"]) > 5 for test in found["tests"])
    assert found["total_mass"] == pytest.approx(7.5 / 9.81, rel=0.02)
    assert abs(found["center_of_mass"][0]) < 0.02

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.identification.model_file import read_model
from gridpush_drake.identification.prediction import calc_final_errors, predict
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import PushLog


def test_predicts_final_poses_and_prints_errors(gridpush, model, pushes, tmp_path):
    out = tmp_path / "predicted.csv"
    outcome = gridpush("predict", model, pushes, "--out", out)
    assert outcome.code == 0, outcome.err
    for text in ("position", "angle", "cell", "combined", "mean", "median", "90 %", "mm", "°"):
        assert text in outcome.out
    learned, log = read_model(model), PushLog.read_csv(pushes)
    expected = predict(learned, log.with_radius(0.004), learned.regime)
    with out.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["push", "x", "y", "theta"]
    assert [row[0] for row in rows[1:]] == [seen.name for seen in log]
    np.testing.assert_array_equal(
        np.array([row[1:] for row in rows[1:]], dtype=float),
        [prediction.poses[-1] for prediction in expected],
    )


@pytest.mark.parametrize("command", ["predict", "identify"])
def test_replaces_no_file_that_it_reads(refuses, model, block, pushes, tmp_path, command):
    source = model if command == "predict" else block
    (tmp_path / "link.csv").symlink_to(pushes)
    before = pushes.read_bytes(), source.read_bytes()
    for out in (pushes, source, tmp_path / "link.csv"):
        refuses(
            command,
            source,
            pushes,
            "--out",
            out,
            "--force",
            says=[out, "is also read by this command; expected another file"],
        )
    assert (pushes.read_bytes(), source.read_bytes()) == before


def test_predicts_with_an_objects_prior_and_says_so(gridpush, block, pushes, tmp_path):
    outcome = gridpush("predict", block, pushes, "--out", tmp_path / "predicted.csv")
    assert outcome.code == 0
    assert "an object, not a model: its mass and friction are assumed to be spread" in outcome.out


def test_says_which_radius_it_takes(gridpush, block, pushes, tmp_path):
    plain = GridObject.from_yaml(block)
    replace(plain, prior=replace(plain.prior, pusher_radius=None)).write_yaml(
        tmp_path / "plain.yaml"
    )
    said = [
        gridpush("predict", path, pushes, "--out", tmp_path / f"{path.stem}.csv").err
        for path in (block, tmp_path / "plain.yaml")
    ]
    assert said == [
        "",
        "block: its file has no pusher.radius; the pusher's radius is assumed to be 0.008 m\n",
    ]


def test_prints_one_json_document(gridpush, model, pushes, tmp_path):
    outcome = gridpush("predict", model, pushes, "--out", tmp_path / "predicted.csv", "--json")
    document = json.loads(outcome.out)
    assert document["model"] == "learned"
    assert [error["name"].split(",")[0] for error in document["errors"]] == [
        "position",
        "angle",
        "cell",
        "combined",
    ]
    assert all(error["pushes"] == 5 for error in document["errors"])
    assert [error["unit"] for error in document["errors"]] == ["mm", "deg", "mm", "mm"]
    spread = document["spread_by_push"]
    assert [push["push"] for push in spread] == [
        push["push"] for push in document["errors_by_push"]
    ]
    pairs = zip(spread, document["errors_by_push"], strict=True)
    within = sum(expected["cell_90_mm"] >= error["cell_mm"] for expected, error in pairs)
    assert document["within_interval"] == [within, 5]
    assert all(
        push[key] > 0 for push in spread for key in ("x_std_mm", "y_std_mm", "theta_std_deg")
    )


def test_errors_of_each_push_and_their_summary_say_their_units(gridpush, model, pushes, tmp_path):
    outcome = gridpush("predict", model, pushes, "--out", tmp_path / "predicted.csv", "--json")
    document = json.loads(outcome.out)
    learned, log = read_model(model), PushLog.read_csv(pushes)
    expected = calc_final_errors(learned.obj, predict(learned, log.with_radius(0.004)), log)
    by_push = document["errors_by_push"]
    assert [error["push"] for error in by_push] == [seen.name for seen in log]
    rho = learned.obj.radius_of_gyration
    assert document["rho_mm"] == pytest.approx(1e3 * rho)
    for found, error in zip(by_push, expected, strict=True):
        assert found["position_mm"] == pytest.approx(1e3 * error.position)
        assert found["angle_deg"] == pytest.approx(np.degrees(error.angle))
        assert found["cell_mm"] == pytest.approx(1e3 * error.cell)
        assert found["combined_mm"] == pytest.approx(1e3 * (error.position + rho * error.angle))
    columns = ("position_mm", "angle_deg", "cell_mm", "combined_mm")
    for summary, column in zip(document["errors"], columns, strict=True):
        values = [error[column] for error in by_push]
        assert summary["mean"] == pytest.approx(np.mean(values))
        assert summary["median"] == pytest.approx(np.median(values))
        assert summary["p90"] == pytest.approx(np.quantile(values, 0.9))


def test_final_poses_need_not_be_known(gridpush, model, tmp_path):
    path = tmp_path / "plan.csv"
    path.write_text(
        "push,t,tip_x,tip_y,object_x,object_y,object_theta\n"
        "near,0,-0.05,-0.035,0,0,0\nnear,1,-0.05,0,,,\nfar,0,1,1,0,0,0\nfar,1,1,2,,,\n"
    )
    outcome = gridpush("predict", model, path, "--out", tmp_path / "predicted.csv")
    assert outcome.code == 0, outcome.err
    assert "never touches the object in: far" in outcome.out
    assert "rror" not in outcome.out
    document = json.loads(
        gridpush("predict", model, path, "--out", tmp_path / "p.csv", "--json").out
    )
    assert (document["errors"], document["untouched"]) == ([], ["far"])
    assert [(error["push"], error["cell_mm"]) for error in document["errors_by_push"]] == [
        ("near", None),
        ("far", None),
    ]


@pytest.mark.parametrize(
    ("header", "row", "says"),
    [
        ("push,t,tip_x,tip_y,object_x,object_y", "a,0,0,0,0,0", ["object_theta", "is missing"]),
        (
            "push,t,tip_x,tip_y,object_x,object_y,theta",
            "a,0,0,0,0,0,0",
            ["object_theta", "rename 'theta'"],
        ),
        (
            "push,t,tip_x,tip_y,object_x,object_y,object_theta",
            "a,0,nought,0,0,0,0",
            ["tip_x", "nought"],
        ),
        ("push,t,tip_x,tip_y,object_x,object_y,object_theta", "a,0,nan,0,0,0,0", ["tip_x"]),
        (
            "push,t,tip_x,tip_y,object_x,object_y,object_theta",
            "a,0,0,0,0,0,0\na,0,0,0,,,",
            ["t", "line 3"],
        ),
        ("push,t,tip_x,tip_y,object_x,object_y,object_theta", "", ["holds no push"]),
    ],
)
def test_refuses_a_log(refuses, model, tmp_path, header, row, says):
    path = tmp_path / "bad.csv"
    path.write_text(f"{header}\n{row}\n")
    refuses("predict", model, path, "--out", tmp_path / "predicted.csv", says=[path, *says])


def test_refuses_an_empty_log(refuses, model, tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text("")
    refuses("predict", model, path, "--out", tmp_path / "predicted.csv", says=[path, "is empty"])


def test_refuses_a_broken_model(refuses, model, pushes, tmp_path):
    model.write_text(model.read_text().replace("seed: 0", "seed: zero", 1))
    refuses(
        "predict",
        model,
        pushes,
        "--out",
        tmp_path / "predicted.csv",
        says=[model, "seed", "integer"],
    )


def test_leaves_out_pushes_over_the_edge(gridpush, model, pushes, tmp_path):
    log = PushLog.read_csv(pushes)
    PushLog(tuple(replace(seen, overhang=i == 0) for i, seen in enumerate(log))).write_csv(
        tmp_path / "marked.csv"
    )
    outcome = gridpush(
        "predict", model, tmp_path / "marked.csv", "--out", tmp_path / "predicted.csv"
    )
    assert "left out 1 push, as the object hung over the table's edge: push_1" in outcome.out
    assert "Errors of 4 final poses" in outcome.out
    assert "push_1" not in (tmp_path / "predicted.csv").read_text()


def test_refuses_a_log_in_which_nothing_touches(refuses, model, tmp_path):
    path = tmp_path / "far.csv"
    path.write_text(
        "push,t,tip_x,tip_y,object_x,object_y,object_theta\nfar,0,1,1,0,0,0\nfar,1,1,2,,,\n"
    )
    refuses(
        "predict",
        model,
        path,
        "--out",
        tmp_path / "p.csv",
        says=[path, "no push touches", "'far'", "1.35 m"],
    )


def test_warns_in_one_line_of_a_pose_that_jumps(gridpush, model, tmp_path):
    path = tmp_path / "jump.csv"
    path.write_text(
        "push,t,tip_x,tip_y,object_x,object_y,object_theta\na,0,-0.02,0.034,0,0,0\na,1,-0.02,0.024,9.9,0,0\n"
    )
    outcome = gridpush("predict", model, path, "--out", tmp_path / "predicted.csv")
    assert outcome.code == 0
    assert outcome.err.startswith(
        f"gridpush: warning: {path}: push 'a', column object_x: the object moves 9.9 m"
    )
    assert outcome.err.count("\n") == 1

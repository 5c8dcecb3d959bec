import json

import numpy as np
import pytest
import yaml

from gridpush_drake.apps.demo import FILES
from gridpush_drake.apps.demo_experiment import PushStyle, describe_truth, hide_truth, make_pushes
from gridpush_drake.identification.model_file import read_model
from gridpush_drake.pushes.log import PushLog
from tests.helpers.made_identifications import make_block


def test_learns_and_reports(gridpush, block, tmp_path):
    out = tmp_path / "demo"
    outcome = gridpush("demo", "--object", block, "--pushes", "4", "--out", out, "--json")
    assert outcome.code == 0, outcome.err
    assert sorted(path.name for path in out.iterdir()) == sorted(FILES)
    verdict = json.loads(outcome.out)
    assert verdict["pushes"] == 4
    assert verdict["after"]["held_out_cell_error"] < verdict["before"]["held_out_cell_error"]
    assert read_model(out / "model.yaml").push_names == tuple(
        seen.name for seen in PushLog.read_csv(out / "pushes.csv")
    )
    assert yaml.safe_load((out / "truth.yaml").read_text())["object"] == "block"


def test_replaces_nothing_unasked(gridpush, refuses, block, tmp_path):
    out = tmp_path / "demo"
    out.mkdir()
    (out / "pushes.csv").write_text("mine")
    refuses("demo", "--object", block, "--out", out, says=["pushes.csv", "--force"])
    assert (out / "pushes.csv").read_text() == "mine"


def test_refuses_an_unknown_object(refuses, tmp_path):
    refuses("demo", "--object", "hamer", "--out", tmp_path / "demo", says=["hamer", "claw_hammer"])


def test_the_experiment_follows_its_seed():
    obj = make_block()
    first, again, other = (make_pushes(obj, hide_truth(obj, seed), 3, seed) for seed in (5, 5, 6))
    for one, same in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.poses_observed, same.poses_observed)
    assert not np.array_equal(first[0].pose, other[0].pose)


def test_the_pusher_starts_at_the_outline_and_goes_inwards():
    obj, style = make_block(), PushStyle()
    for seen in make_pushes(obj, hide_truth(obj, 0), 6, 0, style):
        moved = np.linalg.norm(obj.cells_at(seen.final_pose) - obj.cells_at(seen.pose), axis=1).mean()
        assert moved > 0.8 * style.least_motion
        assert style.shortest - 1e-9 <= seen.push.length <= style.longest + 1e-9
        assert len(seen.t_observed) == style.samples


def test_the_truth_keeps_the_total_mass():
    obj = make_block()
    truth = hide_truth(obj, 0)
    assert truth.total_mass == pytest.approx(1.2)
    described = describe_truth(obj, truth)
    assert sum(part["cells"] * part["cell_mass"] for part in described["parts"]) == pytest.approx(1.2)
    assert sum(part["relative_friction"] for part in described["parts"]) == pytest.approx(1)


@pytest.mark.slow
def test_the_hammer_as_readme_says(gridpush, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = gridpush("demo")
    assert outcome.code == 0, outcome.err
    assert "claw hammer after 8 simulated pushes" in outcome.out
    assert (tmp_path / "gridpush_demo" / "report.html").exists()

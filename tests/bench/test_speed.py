import json

import numpy as np
import pytest

from gridpush_drake.bench.speed import STUDY
from gridpush_drake.bench.speed_cases import make_bench_push
from gridpush_drake.bench.worlds.mujoco_boxes import make_mujoco_push
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.command_line import run_gridpush
from tests.helpers.made_identifications import make_block


@pytest.mark.slow
def test_measures_everything():
    push, sizes, batches, identification, decisions, start_up = STUDY.run(
        repetitions=3, sizes=(4, 400, 900), logs=((16, 3),), draws=2, mujoco=False
    )
    assert push.rows[0][0] == "inertial"
    assert [row[0] for row in sizes.rows] == [4, 400, 900]
    assert "slope" in sizes.notes[-1]
    assert [row[:2] for row in identification.rows] == [[16, 3]]
    assert all(value > 0 for value in identification.rows[0][2:])
    assert all(row[1] > 0 for row in decisions.rows)
    assert all(exact > 0 and fast > 0 for _, _, exact, fast, _ in batches.rows)
    # a push by a drawn model is one of a hundred by each of two
    assert decisions.rows[-2][1] == pytest.approx(200 * decisions.rows[-1][1])
    assert len(start_up.rows) == 3


def test_mujoco_pushes_as_we_do():
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    obj = make_block()
    whole, params = make_bench_push(obj), CellParameters.uniform(obj)
    push = Push(whole.start, whole.velocity, 0.5, whole.radius)
    expected, found = (
        simulate(Model(obj, params), push).final_pose,
        make_mujoco_push(Model(obj, params), push)(),
    )
    np.testing.assert_allclose(found[:2], expected[:2], atol=0.003)
    assert abs(found[2] - expected[2]) < 0.1


@pytest.mark.slow
def test_the_command(capsys, tmp_path):
    out = tmp_path / "speed.md"
    outcome = run_gridpush(
        capsys, "bench", "speed", "--repetitions", "3", "--no-mujoco", "--out", out, "--json"
    )
    assert outcome.code == 0, outcome.err
    assert len(json.loads(outcome.out)["tables"]) == 6
    assert out.read_text().startswith("### One push")

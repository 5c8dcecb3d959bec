"""The bench of hidden bodies reads and keeps its sets, and judges what was learned from them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.bench.jobs import Execution
from gridpush_drake.bench.truth import learning as truth
from gridpush_drake.bench.truth.learning import (
    LEARNED,
    LOADS,
    MASSES,
    SHIFTING,
    UNIFORM,
    TruthScore,
    calc_center_region,
    tabulate_scores,
)
from gridpush_drake.bench.truth.sets import make_set, write_set
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.result import calc_center_of_mass
from tests.helpers.command_line import run_gridpush

pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with one set of five pushes."""
    path = tmp_path_factory.mktemp("sets")
    write_set(
        make_set("three_feet", "spray_bottle", 0, training=3, held_out=2),
        path / "three_feet" / "spray_bottle_0",
    )
    return path


def test_learns_from_a_set_that_is_there(folder, capsys):
    arguments = (
        "--kind",
        "three_feet",
        "--objects",
        "spray_bottle",
        "--sets",
        "1",
        "--pushes",
        "3",
    )
    done = run_gridpush(
        capsys, "bench", "truth", *arguments, "--out", folder, "--workers", "1", "--results",
        folder / "results.jsonl", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    (table,) = json.loads(done.out)["tables"]
    error = {row[1]: row[3] for row in table["rows"]}
    assert list(error) == [UNIFORM, MASSES, LOADS, SHIFTING, "3 pushes"]
    assert error[LOADS] < 0.5 * error[UNIFORM]
    assert error[LOADS] < 0.5 * error[MASSES]
    assert error[SHIFTING] < error[LOADS]
    assert error["3 pushes"] < error[UNIFORM]


def test_the_region_is_the_covariances(folder):
    made = truth.read_set(folder / "three_feet" / "spray_bottle_0")
    found = identify(made.obj, made.training)
    wide = replace(
        found, posterior=replace(found.posterior, covariance=4 * found.posterior.covariance)
    )
    center, covariance = calc_center_of_mass(found)
    chi_square, radius = calc_center_region(found, center + [np.sqrt(covariance[0, 0]), 0.0])
    assert chi_square >= 1.0
    assert calc_center_region(wide, center)[1] == pytest.approx(2 * radius)


def test_the_table_counts_what_happened():
    scores = [
        TruthScore(
            "vertices", "a", seed, LEARNED, 5, error, error / 2, error < 0.0015, within, error
        )
        for seed, error, within in ((0, 0.001, 1.0), (1, 0.002, 0.5), (2, 0.006, 0.6))
    ]
    (row,) = tabulate_scores(scores).rows
    assert row[:4] == ["vertices", "5 pushes", 3, pytest.approx(3.0)]
    assert row[6:] == [
        pytest.approx(1.5),
        pytest.approx(100 / 3),
        pytest.approx(2.0),
        pytest.approx(70.0),
    ]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"kinds": ["jelly"]}, "kind: jelly"),
        ({"kinds": []}, "kind: none"),
        ({"sets": 0}, "sets: 0"),
        ({"pushes": [19]}, "pushes: 19; expected 1 to 18"),
    ],
)
def test_refuses_what_makes_no_sense(arguments, says):
    with pytest.raises(GridPushError, match=says):
        truth.STUDY.run(execution=Execution(workers=0), **arguments)

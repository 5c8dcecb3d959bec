"""The bench of hidden bodies reads and keeps its sets, and judges what was learned from them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.bench.truth import design
from gridpush_drake.bench.truth import learning as truth
from gridpush_drake.bench.truth.design import find_designed_pushes
from gridpush_drake.bench.truth.learning import (
    LEARNED_MODEL,
    SHIFTING_LOAD_MODEL,
    TRUE_LOAD_MODEL,
    TRUE_MASS_MODEL,
    UNIFORM_MODEL,
    TruthScore,
    calc_center_region,
    tabulate_scores,
)
from gridpush_drake.bench.truth.sets import (
    DESIGNED_PUSHES,
    PUSH_LENGTH,
    draw_world,
    make_set,
    write_set,
)
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import transform_back
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import calc_center_of_mass
from gridpush_drake.jobs.run import Execution
from gridpush_drake.pushes.push_log import PushLog
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


@pytest.mark.slow
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
    assert list(error) == [
        UNIFORM_MODEL,
        TRUE_MASS_MODEL,
        TRUE_LOAD_MODEL,
        SHIFTING_LOAD_MODEL,
        "3 pushes",
    ]
    assert error[TRUE_LOAD_MODEL] < 0.5 * error[UNIFORM_MODEL]
    assert error[TRUE_LOAD_MODEL] < 0.5 * error[TRUE_MASS_MODEL]
    assert error[SHIFTING_LOAD_MODEL] < error[TRUE_LOAD_MODEL]
    assert error["3 pushes"] < error[UNIFORM_MODEL]


def test_the_region_is_the_covariances(folder):
    made = truth.read_set(folder / "three_feet" / "spray_bottle_0")
    found = identify(Model(made.obj), made.training)
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
            "vertices", "a", seed, LEARNED_MODEL, 5, error, error / 2, error < 0.0015, within, error
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
        ({"chosen": ["well"]}, "chosen: well; expected some of random, design"),
        ({"chosen": ["design", "design"]}, "chosen: design, design; expected each once"),
    ],
)
def test_refuses_what_makes_no_sense(arguments, says):
    with pytest.raises(GridPushError, match=says):
        truth.STUDY.run(execution=Execution(workers=0), **arguments)


@pytest.mark.slow
def test_pushes_by_design_tell_more_than_random_ones_of_the_same_body(folder, capsys):
    arguments = (
        "bench", "truth", "--kind", "three_feet", "--objects", "spray_bottle", "--sets", "1",
        "--pushes", "1", "--pushes", "3", "--chosen", "design", "--chosen", "random", "--workers",
        "1", "--json",
    )  # fmt: skip
    done = run_gridpush(capsys, *arguments, "--out", folder, "--results", folder / "design.jsonl")
    assert done.code == 0, done.err
    models, difference = json.loads(done.out)["tables"]
    error = {row[1]: row[3] for row in models["rows"]}
    region = {row[1]: row[8] for row in models["rows"]}
    names = ["1 pushes", "1 pushes by design", "3 pushes", "3 pushes by design"]
    assert list(error) == [
        UNIFORM_MODEL,
        TRUE_MASS_MODEL,
        TRUE_LOAD_MODEL,
        SHIFTING_LOAD_MODEL,
        *names,
    ]
    assert region["3 pushes by design"] < region["3 pushes"]
    # The second table compares them, body by body.
    for row, (drawn, chosen) in zip(difference["rows"], (names[:2], names[2:]), strict=True):
        assert row[3] == pytest.approx(error[drawn] - error[chosen])
        assert row[6] == (100.0 if row[3] > 0 else 0.0)

    # The chosen pushes lie beside the others, and are read again: without MuJoCo, and bit for bit.
    made = truth.read_set(folder / "three_feet" / "spray_bottle_0")
    path = folder / "three_feet" / "spray_bottle_0" / DESIGNED_PUSHES
    log = PushLog.read_csv(path, made.obj.prior.pusher_radius)
    assert len(log) == 3
    assert find_designed_pushes(made, 2, path.parent)[1].final_pose == pytest.approx(
        log[1].final_pose, abs=0.0
    )
    # The body is the same as the random pushes': the first of them, made anew, ends where it did.
    _, world, _ = draw_world(made.kind, made.name, made.seed)
    world.put(made.training[0].pose)
    again = world.execute(made.training[0].push)
    assert again.final_pose == pytest.approx(made.training[0].final_pose, abs=1e-6)


@pytest.mark.slow
def test_a_push_by_design_begins_away_from_those_before_it(folder):
    made = truth.read_set(folder / "three_feet" / "spray_bottle_0")
    log = find_designed_pushes(made, 3)
    starts = np.array([transform_back(seen.pose, seen.push.start[None])[0] for seen in log])
    apart = np.linalg.norm(starts[:, None] - starts, axis=2)[np.triu_indices(3, 1)]
    assert apart.min() >= 0.04 * made.obj.outline.length
    assert [seen.push.length for seen in log] == pytest.approx([PUSH_LENGTH] * 3)


@pytest.mark.slow
def test_where_no_new_place_is_left_a_push_by_design_begins_where_one_did(folder, monkeypatch):
    made = truth.read_set(folder / "three_feet" / "spray_bottle_0")
    # Pushes this far from each other there are two of at most.
    monkeypatch.setattr(design, "PUSH_SEPARATIONS", (0.4, 0.0))
    _, world, _ = draw_world(made.kind, made.name, made.seed)
    assert len(design.choose_pushes(made, world, 3)) == 3


def test_refuses_a_set_of_another_body(folder):
    made = truth.read_set(folder / "three_feet" / "spray_bottle_0")
    other = replace(made, loads=made.loads[::-1])
    with pytest.raises(GridPushError, match="another body than seed 0 draws; expected one that"):
        find_designed_pushes(other, 1)

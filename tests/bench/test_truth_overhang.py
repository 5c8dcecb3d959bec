"""Bodies over a table's edge: they rest, tip where they must, and the model goes with them."""

import numpy as np
import pytest

from gridpush_drake.bench.truth.overhang import (
    HALF_PLANE,
    OVERHANG_FRACTIONS,
    OverhangJob,
    TippingJob,
    TippingScore,
    run_overhang,
    run_tipping,
    tabulate_limit,
    tabulate_pushes,
)
from gridpush_drake.bench.truth.sets import draw_masses, make_body

pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")

from gridpush_drake.bench.truth.mujoco_world import MujocoWorld


@pytest.mark.parametrize("kind", ["half_height", "three_feet"])
def test_a_box_tips_where_its_center_of_mass_leaves_the_table(kind):
    rng = np.random.default_rng(5)
    obj, params = draw_masses("toolbox", rng)
    world = MujocoWorld(make_body(kind, obj, params, rng).harden(), 0.01, HALF_PLANE)
    center = params.center_of_mass(obj)
    assert np.abs(center).max() < 0.1
    for x, tips in ((-0.008, False), (0.003, True)):
        world.put((x - center[0], 0.0, 0.0))
        world.wait(0.8)
        assert (world.truth.tilt > np.radians(10)) == tips
        assert world.truth.stays != tips


@pytest.mark.slow
def test_the_model_with_a_table_predicts_pushes_over_its_edge():
    scores = run_overhang(OverhangJob("mujoco", "claw_hammer", 0, 2))
    assert len(scores) == 2
    assert all(
        OVERHANG_FRACTIONS[0] <= score.fraction <= OVERHANG_FRACTIONS[1] and not score.tips
        for score in scores
    )
    assert max(score.position for score in scores) < 0.002
    assert max(score.endless for score in scores) > 0.004
    row = tabulate_pushes(scores).rows[-1]
    assert row[:3] == ["mujoco", "all", 2]
    assert row[5] == pytest.approx(1e3 * np.mean([score.position for score in scores]))


@pytest.mark.slow
def test_the_model_tips_behind_the_limit_and_not_before():
    score = run_tipping(TippingJob("claw_hammer", 1))
    assert not score.stayed
    assert score.tipped
    wrong = TippingScore("claw_hammer", 2, True, False)
    assert [row[1:] for row in tabulate_limit([score, wrong]).rows] == [[2, 1, 1], [2, 1, 1]]

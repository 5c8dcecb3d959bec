"""How far off predictions are expected to be."""

import numpy as np
import pytest

from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.noise import NoiseModel
from gridpush_drake.identification.prediction import (
    INTERVAL,
    calc_final_errors,
    calc_norm_quantile,
    predict,
    predict_spread,
)
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

NOISE = (5e-4, 3.5e-3)


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (3.0, 1.0, 0.2), (1.0, 1e-3, 1e-3)])
def test_quantile_of_the_norm_is_that_of_draws(axes: tuple[float, ...]) -> None:
    root = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0] * axes
    drawn = np.linalg.norm(np.random.default_rng(1).normal(size=(40000, 3)) @ root.T, axis=1)
    assert calc_norm_quantile(root @ root.T) == pytest.approx(np.quantile(drawn, INTERVAL), rel=0.05)


def test_fewer_pushes_make_the_tails_longer_as_students_t_has_them() -> None:
    rng, freedom = np.random.default_rng(2), 9.0
    stretched = np.sqrt(freedom / rng.chisquare(freedom, (40000, 1)))
    drawn = np.linalg.norm(rng.normal(size=(40000, 3)) * stretched, axis=1)
    assert calc_norm_quantile(np.eye(3), freedom) == pytest.approx(np.quantile(drawn, INTERVAL), rel=0.02)
    noise = NoiseModel()
    assert noise.calc_freedom(3) < noise.calc_freedom(9) < noise.calc_freedom(0)
    assert calc_norm_quantile(np.eye(3), noise.calc_freedom(0)) == pytest.approx(calc_norm_quantile(np.eye(3)))


def test_discrepancy_is_one_where_errors_are_as_said_and_follows_them_the_more_pushes_there_are() -> None:
    noise = NoiseModel()
    assert noise.calc_discrepancy(3.0 * 4, 4) == pytest.approx(1.0)
    few, many = (noise.calc_discrepancy(4.0 * 3 * count, count) for count in (2, 200))
    assert 1 < few < many == pytest.approx(2.0, rel=0.01)


def test_errors_of_held_out_pushes_are_as_large_as_expected() -> None:
    within = []
    for name, seed in (("square", 0), ("l_bracket", 1), ("claw_hammer", 2)):
        obj = make_shape(name, 30)
        truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.02, 0.3, 0.06), np.full(obj.n, 0.4), 0.35)
        found = identify(obj, make_pokes(obj, truth, 4, seed, noise=NOISE))
        held_out = make_pokes(obj, truth, 12, 50 + seed, noise=NOISE, observations=1)
        errors = calc_final_errors(obj, predict(obj, found.params, held_out), held_out)
        spreads = predict_spread(found, held_out)
        assert [spread.name for spread in spreads] == [seen.name for seen in held_out]
        within += [error.cell <= spread.cell_error for error, spread in zip(errors, spreads, strict=True)]
    assert np.mean(within) >= 0.8


def test_more_pushes_leave_less_spread() -> None:
    obj = make_shape("square", 30)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.02, 0.3, 0.06), np.full(obj.n, 0.4), 0.35)
    log, held_out = make_pokes(obj, truth, 6, 0, noise=NOISE), make_pokes(obj, truth, 5, 60)
    few, many = (
        np.mean([spread.cell_error for spread in predict_spread(identify(obj, log[:count]), held_out)])
        for count in (1, 6)
    )
    assert many < 0.6 * few

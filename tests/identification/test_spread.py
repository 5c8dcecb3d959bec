"""How far off predictions are expected to be."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_final_errors, predict
from gridpush_drake.identification.spread import (
    INTERVAL_PROBABILITY,
    calc_norm_probability,
    calc_norm_quantile,
    predict_spread,
)
from gridpush_drake.identification.statistics.friction_gradient import calc_gradient_std
from gridpush_drake.identification.statistics.noise import NoiseModel
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.push_cases import make_table_edge
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

NOISE = (5e-4, 3.5e-3)


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (3.0, 1.0, 0.2), (1.0, 1e-3, 1e-3)])
def test_quantile_of_the_norm_is_that_of_draws(axes: tuple[float, ...]) -> None:
    root = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0] * axes
    drawn = np.linalg.norm(np.random.default_rng(1).normal(size=(40000, 3)) @ root.T, axis=1)
    assert calc_norm_quantile(root @ root.T) == pytest.approx(
        np.quantile(drawn, INTERVAL_PROBABILITY), rel=0.05
    )


def test_fewer_pushes_make_the_tails_longer_as_students_t_has_them() -> None:
    rng, freedom = np.random.default_rng(2), 9.0
    stretched = np.sqrt(freedom / rng.chisquare(freedom, (40000, 1)))
    drawn = np.linalg.norm(rng.normal(size=(40000, 3)) * stretched, axis=1)
    assert calc_norm_quantile(np.eye(3), freedom) == pytest.approx(
        np.quantile(drawn, INTERVAL_PROBABILITY), rel=0.02
    )
    noise = NoiseModel()
    assert noise.calc_freedom(3) < noise.calc_freedom(9) < noise.calc_freedom(0)
    assert calc_norm_quantile(np.eye(3), noise.calc_freedom(0)) == pytest.approx(
        calc_norm_quantile(np.eye(3))
    )


def test_ranks_of_errors_are_spread_evenly() -> None:
    rng, freedom = np.random.default_rng(3), 6.0
    stretched = np.sqrt(freedom / rng.chisquare(freedom, (4000, 1)))
    root = np.diag([1.2, 1.0, 0.8])
    drawn = np.linalg.norm(rng.normal(size=(4000, 3)) @ root * stretched, axis=1)
    covariance = root @ root
    ranks = [calc_norm_probability(covariance, freedom, norm) for norm in drawn]
    np.testing.assert_allclose(np.histogram(ranks, 5, (0, 1))[0] / len(ranks), 0.2, atol=0.03)
    quantile = calc_norm_quantile(covariance, freedom, 0.7)
    assert calc_norm_probability(covariance, freedom, quantile) == pytest.approx(0.7)


def test_regions_hold_what_they_say_of_pushes_some_of_which_are_much_farther_off_than_most() -> (
    None
):
    """Each push's errors are N(0, v_p C), v_p of mean 1: Student's t of 4 degrees of freedom."""
    noise = NoiseModel()
    rng = np.random.default_rng(4)
    pushes = 12
    # kappa is learned from a few such pushes, and the next one is like them.
    freedom = noise.push_freedom
    shape = (20000, pushes + 1)
    v = (freedom - 2) / rng.chisquare(freedom, shape)
    squared = v * rng.chisquare(3, shape) / 3
    kappa2 = np.array([noise.calc_discrepancy(one) ** 2 for one in squared[:, :-1]])
    next_one = np.sqrt(3 * squared[:, -1] / kappa2)
    # (Of few pushes the typical mean square is less than the mean, so that they hold a little less.)
    for probability, tolerance in ((0.9, 0.03), (0.99, 0.01)):
        limit = calc_norm_quantile(
            noise.calc_typical_fraction(pushes) * np.eye(3), noise.calc_freedom(pushes), probability
        )
        assert np.mean(next_one <= limit) == pytest.approx(probability, abs=tolerance)
    # Taken for normal, and kappa for known from all numbers that were seen, too many surprise.
    surer = calc_norm_quantile(np.eye(3), 3.0 * pushes + 1, 0.99)
    assert np.mean(next_one > surer) > 0.025


def test_discrepancy_is_one_where_errors_are_as_said_and_follows_them_the_more_pushes_there_are() -> (
    None
):
    noise = NoiseModel()
    assert noise.calc_discrepancy(np.ones(4)) == pytest.approx(1.0)
    few, many = (noise.calc_discrepancy(np.full(count, 4.0)) for count in (2, 200))
    assert 1 < few < many == pytest.approx(2.0, rel=0.01)


def test_errors_of_held_out_pushes_are_as_large_as_expected() -> None:
    within = []
    for name, seed in (("square", 0), ("l_bracket", 1), ("claw_hammer", 2)):
        obj = make_shape(name, 30)
        truth = CellParameters(
            np.where(obj.p_BC[:, 0] > 0.02, 0.3, 0.06), np.full(obj.n, 0.4), 0.35
        )
        found = identify(Model(obj), make_pokes(obj, truth, 4, seed, noise=NOISE))
        held_out = make_pokes(obj, truth, 12, 50 + seed, noise=NOISE, observations=1)
        errors = calc_final_errors(obj, predict(Model(obj, found.params), held_out), held_out)
        spreads = predict_spread(found, held_out)
        assert [spread.name for spread in spreads] == [seen.name for seen in held_out]
        within += [
            error.cell <= spread.cell_error for error, spread in zip(errors, spreads, strict=True)
        ]
    assert np.mean(within) >= 0.8


def test_more_pushes_leave_less_spread() -> None:
    obj = make_shape("square", 30)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.02, 0.3, 0.06), np.full(obj.n, 0.4), 0.35)
    log, held_out = make_pokes(obj, truth, 6, 0, noise=NOISE), make_pokes(obj, truth, 5, 60)
    few, many = (
        np.mean(
            [
                spread.cell_error
                for spread in predict_spread(identify(Model(obj), log[:count]), held_out)
            ]
        )
        for count in (1, 6)
    )
    assert many < 0.6 * few


def test_the_spread_is_that_of_pushes_on_the_same_table() -> None:
    """J S J^T by differences of simulations along the posterior's axes."""
    obj = make_shape("claw_hammer", 30)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.02, 0.3, 0.06), np.full(obj.n, 0.4), 0.35)
    found = identify(Model(obj), make_pokes(obj, truth, 6, 3, noise=NOISE))
    log = make_pokes(obj, truth, 5, 60, noise=NOISE, observations=1)[:2]
    values, vectors = np.linalg.eigh(found.posterior.covariance)
    axes, mean = (vectors * np.sqrt(np.maximum(values, 0.0))).T, found.posterior.mean
    stds = []
    for table in (None, make_table_edge(obj, np.zeros(3), 0.0, 0.17)):
        chosen = replace(log, table=table)
        assert "tips" not in [
            prediction.status for prediction in predict(Model(obj, found.params), chosen)
        ]
        problem = PushProblem(obj, chosen, found.params, found.physics)
        ahead, behind = (
            np.array([problem.residuals(mean + side * axis) for axis in axes])
            for side in (1e-6, -1e-6)
        )
        covered = (((ahead - behind) / 2e-6) ** 2).sum(axis=0)
        noise = [
            np.diag(found.noise.calc_covariance(J, found.noise_scale))
            for J in problem.linearize(mean).by_inputs
        ]
        expected = np.sqrt((covered + noise).sum(axis=1)) * found.interval_scale
        stds.append(
            [
                spread.std * (1, 1, obj.radius_of_gyration)
                for spread in predict_spread(found, chosen)
            ]
        )
        np.testing.assert_allclose(np.linalg.norm(stds[-1], axis=1), expected, rtol=0.01)
    assert np.abs(np.divide(*stds) - 1).max() > 0.3


def test_the_noise_that_a_fit_supposed_is_that_of_its_predictions() -> None:
    obj = make_shape("square", 30)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.02, 0.3, 0.06), np.full(obj.n, 0.4), 0.35)
    rough = NoiseModel(pose=0.008)
    found = identify(
        Model(obj), make_pokes(obj, truth, 4, 1, noise=NOISE), method=MapEnsemble(noise=rough)
    )
    assert found.noise == replace(rough, friction_gradient=calc_gradient_std(obj.prior))
    assert found.noise_scale.pose == pytest.approx(found.noise_std / 0.008)
    log = make_pokes(obj, truth, 2, 9, observations=1)
    surer = replace(found, noise=replace(rough, tip=1e-5, log_contact_friction=1e-4))
    assert predict_spread(surer, log)[0].cell_error < predict_spread(found, log)[0].cell_error

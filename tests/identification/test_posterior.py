import numpy as np
import pytest

from gridpush_drake.identification.fit.load_prior import calc_smooth_covariance
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.statistics.posterior import Posterior, calc_center_jacobian
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.shapes import make_shape

OBJ = make_shape("l_bracket", 40)
CENTER_STD = 0.001
"""Of the center of friction once it was learned, m."""


def make_prior(amplitude=2.0):
    covariance = np.zeros((OBJ.n + 1, OBJ.n + 1))
    covariance[:-1, :-1] = amplitude**2 * calc_smooth_covariance(OBJ)
    covariance[-1, -1] = 0.04
    mean = np.append(np.linspace(-0.5, 0.5, OBJ.n), np.log(0.4))
    return Posterior(mean, covariance, covariance)


def learn_center(prior):
    """What is left after the center of friction was seen, by Gaussian conditioning."""
    F = calc_center_jacobian(prior.calc_fraction(), OBJ.p_BC)
    S = prior.covariance
    gain = S @ F.T @ np.linalg.inv(F @ S @ F.T + CENTER_STD**2 * np.eye(2))
    after = S - gain @ F @ S
    return Posterior(prior.mean, (after + after.T) / 2, S)


def draw_normally(posterior, count, seed):
    """Independent of `Posterior.draw`: plain draws of z, which forget what holds for shares."""
    values, vectors = np.linalg.eigh(posterior.covariance)
    dz = (
        np.random.default_rng(seed).standard_normal((count, OBJ.n + 1))
        @ (vectors * np.sqrt(np.maximum(values, 0))).T
    )
    k = np.exp(posterior.mean[:-1] + dz[:, :-1])
    return k / k.sum(axis=1, keepdims=True), np.exp(posterior.mean[-1] + dz[:, -1])


def test_the_center_s_derivatives_agree_with_differences():
    posterior = make_prior()

    def calc_center(z):
        k = np.exp(z[:-1])
        return k @ OBJ.p_BC / k.sum()

    check_jacobian(
        calc_center, posterior.mean, calc_center_jacobian(posterior.calc_fraction(), OBJ.p_BC)
    )


def test_draws_keep_what_the_pushes_showed():
    posterior = learn_center(make_prior(amplitude=MapEnsemble().widest.field_amplitude))
    known = posterior.calc_fraction() @ OBJ.p_BC
    fractions, _ = posterior.draw(400, seed=3)
    plain, _ = draw_normally(posterior, 400, seed=3)
    error = np.sqrt(((fractions @ OBJ.p_BC - known) ** 2).mean(axis=0))
    naive = np.sqrt(((plain @ OBJ.p_BC - known) ** 2).mean(axis=0))
    assert (error < 1.2 * CENTER_STD).all()
    assert (error > 0.8 * CENTER_STD).all()
    assert (naive > 5 * CENTER_STD).all()
    assert np.log(fractions).std(axis=0).min() > 0.3, "single cells stay unknown"


def test_nothing_is_moved_where_nothing_was_learned():
    prior = make_prior()
    for drawn, plain in zip(prior.draw(20, seed=5), draw_normally(prior, 20, seed=5), strict=True):
        np.testing.assert_allclose(drawn, plain, rtol=1e-9)


def test_draws_follow_their_seed():
    posterior = learn_center(make_prior())
    for one, same, other in zip(*(posterior.draw(7, seed) for seed in (1, 1, 2)), strict=True):
        np.testing.assert_array_equal(one, same)
        assert not np.array_equal(one, other)


def test_drawn_parameters_share_the_estimate_s_frictions_and_their_sum():
    params = CellParameters(np.linspace(0.1, 0.2, OBJ.n), np.linspace(0.3, 0.5, OBJ.n), 0.4)
    posterior = learn_center(make_prior())
    drawn = posterior.draw_parameters(params, 5, seed=2)
    fractions, contact_friction = posterior.draw(5, seed=2)
    for sample, fraction, mu_c in zip(drawn, fractions, contact_friction, strict=True):
        np.testing.assert_array_equal(sample.friction, params.friction)
        np.testing.assert_allclose(sample.relative_friction(), fraction, rtol=1e-9)
        assert sample.mass @ sample.friction == pytest.approx(params.mass @ params.friction)
        assert sample.contact_friction == mu_c
    assert posterior.draw_parameters(params, 0) == []

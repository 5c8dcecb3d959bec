from dataclasses import replace

import numpy as np

from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import calc_center_of_mass
from gridpush_drake.identification.sentences import describe_poor_fit
from gridpush_drake.identification.statistics.posterior import Posterior
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes


def test_covariance_is_that_of_samples_where_the_spread_is_small() -> None:
    obj = make_shape("l_bracket", 20)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.03, 0.2, 0.05), np.full(obj.n, 0.4), 0.35)
    found = identify(Model(obj), make_pokes(obj, truth, 3, 0))
    small = Posterior(
        found.posterior.mean, 0.01 * found.posterior.covariance, found.posterior.prior_covariance
    )
    found = replace(found, posterior=small)
    center, covariance = calc_center_of_mass(found)
    np.testing.assert_allclose(center, found.params.center_of_mass(obj), atol=1e-15)
    drawn = np.array([sample.center_of_mass(obj) for sample in found.draws(4000, seed=1)])
    np.testing.assert_allclose(np.cov(drawn.T), covariance, atol=0.1 * np.trace(covariance))
    np.testing.assert_allclose(drawn.mean(axis=0), center, atol=0.1 * np.sqrt(np.trace(covariance)))


def test_frictions_that_differ_move_the_center_of_mass_off_that_of_friction() -> None:
    obj = make_shape("square", 16)
    truth = CellParameters.uniform(obj)
    found = identify(Model(obj), make_pokes(obj, truth, 1, 0))
    friction = np.where(obj.p_BC[:, 0] > 0, 0.5, 0.25)
    mass = np.exp(found.posterior.mean[:-1]) / friction
    uneven = found.with_params(CellParameters(mass / mass.sum(), friction, 0.4))
    center, covariance = calc_center_of_mass(uneven)
    np.testing.assert_allclose(center, mass @ obj.p_BC / mass.sum(), atol=1e-15)
    step = 1e-6
    for i in (0, 7):
        moved = mass.copy()
        moved[i] *= np.exp(step)
        slope = (moved @ obj.p_BC / moved.sum() - center) / step
        alone = np.zeros((obj.n + 1, obj.n + 1))
        alone[i, i] = 1.0
        one = replace(uneven, posterior=replace(uneven.posterior, covariance=alone))
        np.testing.assert_allclose(
            calc_center_of_mass(one)[1], np.outer(slope, slope), rtol=1e-4, atol=1e-12
        )
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_a_center_of_mass_that_is_told_is_where_it_is_told_and_the_center_of_friction_not_far() -> (
    None
):
    obj = make_shape("l_bracket", 80)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.03, 0.2, 0.05), np.full(obj.n, 0.4), 0.35)
    at = truth.center_of_mass(obj)
    log = make_pokes(obj, truth, 6, 3, noise=(5e-4, 3e-3))
    for std in (1e-12, 0.0005, 0.002):
        told = replace(obj.prior, center_of_mass=(at[0], at[1]), center_of_mass_std=std)
        found = identify(Model(replace(obj, prior=told)), log)
        np.testing.assert_array_equal(calc_center_of_mass(found)[0], at)
        np.testing.assert_allclose(found.identifiability.center_of_friction, at, atol=2e-3)
        assert describe_poor_fit(found) is None
    wrong = replace(told, center_of_mass=(at[0] - 0.03, at[1]))
    doubt = describe_poor_fit(identify(Model(replace(obj, prior=wrong)), log))
    assert doubt is not None and "center_of_mass.at" in doubt

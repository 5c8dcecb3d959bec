"""Identification that begins where one from fewer pushes ended."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.errors import IdentificationError
from gridpush_drake.identification.fit.load_prior import calc_prior_factor, calc_smooth_covariance
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.fit.map_fit import fit_map
from gridpush_drake.identification.learning import describe_prior, identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import FitStart
from gridpush_drake.identification.statistics.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

NOISE = (5e-4, 3.5e-3)


def make_case(name: str, seed: int, cells: int = 18, pushes: int = 5):
    obj = make_shape(name, cells)
    heavy = obj.p_BC[:, 0] > np.quantile(obj.p_BC[:, 0], 0.6)
    truth = CellParameters(np.where(heavy, 0.3, 0.06), np.full(obj.n, 0.4), 0.35)
    return obj, make_pokes(obj, truth, pushes, seed, noise=NOISE)


@pytest.mark.parametrize(("name", "seed"), [("claw_hammer", 0), ("l_bracket", 1), ("square", 2)])
def test_warm_start_changes_the_way_and_not_the_answer(name: str, seed: int) -> None:
    obj, log = make_case(name, seed)
    before = None
    for count in (3, 5):
        cold, warm = (
            identify(Model(obj), log[:count]),
            identify(Model(obj), log[:count], start=before),
        )
        std = np.sqrt(np.diag(cold.posterior.covariance))
        assert (np.abs(warm.posterior.mean - cold.posterior.mean) < 0.3 * std).all()
        assert warm.status == cold.status
        before = warm


def test_same_start_same_bits() -> None:
    obj, log = make_case("l_bracket", 3)
    start = identify(Model(obj), log[:3])
    one, other = (
        identify(Model(obj), log[:4], start=start),
        identify(Model(obj), log[:4], start=start),
    )
    np.testing.assert_array_equal(one.posterior.mean, other.posterior.mean)


def test_bad_start_does_no_harm() -> None:
    """Where the start is the less probable one, the fit begins as it would have."""
    obj, log = make_case("l_bracket", 3)
    start = identify(Model(obj), log[:3])
    rng = np.random.default_rng(0)
    astray = tuple(
        FitStart(fit.z + rng.normal(0, 3, len(fit.z)), NoiseScale(), fit.name)
        for fit in start.starts
    )
    cold, warm = (
        identify(Model(obj), log),
        identify(Model(obj), log, start=replace(start, starts=astray)),
    )
    std = np.sqrt(np.diag(cold.posterior.covariance))
    assert (np.abs(warm.posterior.mean - cold.posterior.mean) < 0.3 * std).all()


def test_start_without_fits_will_do() -> None:
    """Such as a model read from a file, or one of other hypotheses."""
    obj, log = make_case("square", 4, pushes=4)
    read = replace(identify(Model(obj), log[:3]), starts=())
    cold, warm = identify(Model(obj), log), identify(Model(obj), log, start=read)
    std = np.sqrt(np.diag(cold.posterior.covariance))
    assert (np.abs(warm.posterior.mean - cold.posterior.mean) < 0.3 * std).all()


def test_start_of_another_object_is_refused() -> None:
    obj, log = make_case("square", 4, pushes=1)
    with pytest.raises(IdentificationError, match="start"):
        identify(Model(obj), log, start=describe_prior(make_shape("disc", 12)))


def test_fit_that_begins_at_its_own_end_costs_less() -> None:
    obj, log = make_case("claw_hammer", 0)
    z0_params = CellParameters.uniform(obj)
    problem = PushProblem(obj, log, z0_params)
    z0 = problem.unknowns(z0_params)
    A = calc_prior_factor(calc_smooth_covariance(obj), 1.5, 0.3)
    cold = fit_map(problem, z0, A, NoiseModel())
    spent = problem.simulations
    warm = fit_map(problem, z0, A, NoiseModel(), warm_start=FitStart(cold.z, cold.scale))
    assert problem.simulations - spent < 0.8 * spent
    assert warm.log_evidence == pytest.approx(cold.log_evidence, abs=0.5)


def test_prior_is_what_a_log_without_contact_gives() -> None:
    obj: GridObject = make_shape("square", 16)
    prior = describe_prior(obj)
    assert prior.status == "no_usable_pushes" and prior.push_names == () and prior.simulations == 0
    np.testing.assert_allclose(prior.params.mass, 1.0 / obj.n)
    widest = MapEnsemble().widest.field_amplitude
    np.testing.assert_allclose(np.diag(prior.posterior.covariance)[:-1].mean(), widest**2)

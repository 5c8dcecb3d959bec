import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.map_ensemble import MapEnsemble
from gridpush_drake.identification.noise import NoiseModel
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.uncertainty import PRIOR_AMPLITUDE, PlausibleMassSet, UncertainModel
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from tests.helpers.made_identifications import make_identification
from tests.helpers.shapes import make_shape


@pytest.fixture(scope="module")
def found():
    return make_identification(seed=2)


def test_one_path_leads_from_an_identification_to_samples_and_masses(found):
    model = UncertainModel.of_identification(found, friction_range=(0.2, 0.5), sample_count=3, seed=7)
    assert model.params is found.params
    assert model.posterior is found.posterior
    noise = NoiseModel()
    expected = (found.noise_std / noise.pose, found.load_shift_std / noise.load_shift)
    assert model.noise_scale == pytest.approx(expected)
    for sample, expected in zip(model.samples, found.samples(3, seed=7), strict=True):
        np.testing.assert_array_equal(sample.mass, expected.mass)
    expected = PlausibleMassSet.from_posterior(found.obj, found.posterior, (0.2, 0.5), seed=7)
    np.testing.assert_array_equal(model.masses.mass_min, expected.mass_min)
    np.testing.assert_array_equal(model.masses.mass_max, expected.mass_max)


def test_the_prior_is_described_as_any_identification():
    obj = make_shape("square", 16)
    model = UncertainModel.of_prior(obj)
    prior = describe_prior(obj, MapEnsemble(amplitudes=(PRIOR_AMPLITUDE,)))
    np.testing.assert_array_equal(model.posterior.covariance, prior.posterior.covariance)
    np.testing.assert_allclose(np.diag(model.posterior.covariance)[:-1].mean(), PRIOR_AMPLITUDE**2)
    assert (model.samples, model.noise_scale, len(model.poke_starts)) == ((), (1.0, 1.0), 0)


def test_parameters_taken_for_granted_leave_nothing_to_learn():
    obj = make_shape("square", 16)
    params = CellParameters.uniform(obj)
    model = UncertainModel.of_parameters(obj, params)
    assert model.samples == ()
    np.testing.assert_array_equal(model.masses.mass_min, model.masses.mass_max)
    with pytest.raises(PlanningError, match="taken for granted"):
        model.require_posterior()


def test_knows_where_pokes_began_in_the_body_frame(found):
    pose, p_BS = np.array([0.3, -0.2, 2.1]), np.array([0.05, 0.02])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    start = pose[:2] + np.array([[c, -s], [s, c]]) @ p_BS
    seen = ObservedPush("poke", Push(tuple(start), (0.03, 0.0), 1.0, 0.008), pose, np.array([1.0]), pose[None])
    model = UncertainModel.of_identification(found, log=PushLog((seen,)))
    np.testing.assert_allclose(model.poke_starts, p_BS[None], atol=1e-12)


def test_refuses_a_friction_range_that_is_none(found):
    with pytest.raises(PlanningError, match="friction_range"):
        _ = UncertainModel.of_identification(found, friction_range=(0.5, 0.2)).masses

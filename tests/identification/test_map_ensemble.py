"""The average over amplitudes."""

import numpy as np

from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.map_ensemble import SHARED_SHIFT, MapEnsemble
from gridpush_drake.identification.posterior import calc_center_jacobian
from gridpush_drake.identification.problem import PushProblem
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

NOISE = (5e-4, 3.5e-3)


def learn(mass_ratio: float, amplitudes: tuple[float, ...] = MapEnsemble().amplitudes):
    obj = make_shape("l_bracket", 20)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.03, mass_ratio, 1.0), np.full(obj.n, 0.4), 0.35)
    return identify(obj, make_pokes(obj, truth, 4, 5, noise=NOISE), ensemble=MapEnsemble(amplitudes=amplitudes))


def test_evidence_chooses_the_amplitude_that_the_pushes_ask_for() -> None:
    even, uneven = learn(1.0), learn(8.0)
    assert even.status == "prior_kept" and uneven.status == "learned"
    prior_variance = [np.diag(found.posterior.prior_covariance)[:-1].mean() for found in (even, uneven)]
    assert prior_variance[0] < 0.5**2 < prior_variance[1]


def test_average_lies_among_its_fits_and_its_spread_covers_theirs() -> None:
    found = learn(4.0)
    fits = np.array([start.z for start in found.starts])
    assert (found.posterior.mean >= fits.min(axis=0)).all() and (found.posterior.mean <= fits.max(axis=0)).all()
    alone = [learn(4.0, (amplitude,)).posterior.covariance for amplitude in MapEnsemble().amplitudes]
    assert np.trace(found.posterior.covariance) >= min(np.trace(covariance) for covariance in alone)


def test_no_number_of_pushes_makes_the_center_surer_than_what_their_loads_share() -> None:
    obj = make_shape("l_bracket", 20)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.03, 2.0, 1.0), np.full(obj.n, 0.4), 0.35)
    for count in (3, 12):
        found = identify(obj, make_pokes(obj, truth, count, 5, noise=NOISE))
        x = found.posterior.calc_share()
        problem = PushProblem(obj, make_pokes(obj, truth, 1, 5), truth.friction)
        floor = problem.calc_tilt_covariance(SHARED_SHIFT * found.load_shift_std)
        F = calc_center_jacobian(x, obj.p_BC)
        excess = found.identifiability.center_of_friction_covariance - F @ floor @ F.T
        assert np.linalg.eigvalsh(excess).min() > 0


def test_a_tilt_shifts_the_center_of_even_loads_by_as_much_as_it_says() -> None:
    obj = make_shape("l_bracket", 20)
    truth = CellParameters.uniform(obj)
    covariance = PushProblem(obj, make_pokes(obj, truth, 1, 5), truth.friction).calc_tilt_covariance(0.002)
    F = calc_center_jacobian(np.full(obj.n, 1 / obj.n), obj.p_BC)
    np.testing.assert_allclose(F @ covariance @ F.T, 0.002**2 * np.eye(2), atol=1e-4 * 0.002**2)

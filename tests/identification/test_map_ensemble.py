"""The average over amplitudes."""

import numpy as np

from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.map_ensemble import MapEnsemble
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

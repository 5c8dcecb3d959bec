"""What was known after each push, and how well each was predicted."""

import numpy as np
import pytest

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.identification.learning import describe_prior, identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.report.page import make_report
from gridpush_drake.report.progress import ExpectedUncertainty, calc_progress, draw_progress
from tests.helpers.made_identifications import make_block
from tests.helpers.simulated_pushes import make_pushes


@pytest.fixture(scope="module")
def run():
    obj = make_block()
    truth = sample_ground_truth(obj, 1)
    log = make_pushes(obj, truth, 4, 1)
    physics = Physics(regime="quasi_static")
    # The second estimate came after two further pushes, and the last push was not learned from.
    estimates = [identify(Model(obj, physics=physics), log[:count], budget=120) for count in (1, 3)]
    return obj, truth, log, estimates


def test_each_push_is_predicted_by_what_was_learned_before_it(run):
    obj, truth, log, estimates = run
    progress = calc_progress(estimates, log, truth)
    assert progress.names == tuple(seen.name for seen in log)
    physics = estimates[-1].physics
    before, first, second = (
        found.params for found in (describe_prior(obj, physics=physics), *estimates)
    )
    wanted = [
        calc_mean_cell_error(Model(obj, params, physics), log.subset([i]))
        for i, params in enumerate((before, first, first, second))
    ]
    np.testing.assert_allclose(progress.predicted, wanted)
    even = CellParameters.uniform(obj)
    assert progress.even[3] == calc_mean_cell_error(Model(obj, even, physics), log.subset([3]))
    np.testing.assert_array_equal(progress.pushes, [0, 1, 3])


def test_what_is_known_of_the_center_is_followed(run):
    obj, truth, log, estimates = run
    progress = calc_progress(estimates, log, truth)
    assert (np.diff(progress.center_std) < 0).all()
    off = estimates[-1].params.center_of_mass(obj) - truth.center_of_mass(obj)
    assert progress.center_error[-1] == pytest.approx(np.linalg.norm(off))
    assert not len(calc_progress(estimates, log).center_error)
    (left, right) = draw_progress(progress, [ExpectedUncertainty(1, 0.02)]).axes
    shown = [line.get_ydata() for line in left.lines]
    np.testing.assert_allclose(shown[0], progress.center_std * 1e3)
    np.testing.assert_allclose(shown[1], [20.0])
    np.testing.assert_allclose(right.lines[1].get_ydata(), progress.predicted * 1e3)


def test_the_report_sets_predictions_and_fits_apart_and_links_the_recording(run, undrawn):
    _, truth, log, estimates = run
    progress = calc_progress(estimates, log, truth)
    page = make_report(estimates[-1], log[:3], truth=truth, progress=progress)
    assert "What was known after each push" in page
    assert progress.describe() in page
    assert "errors as learned are of a fit; those of\npredictions are above" in page
    assert "recording" not in page
    assert "diamonds" not in page
    page = make_report(
        estimates[-1],
        log[:3],
        progress=progress,
        expectations=[ExpectedUncertainty(1, 0.02)],
        recording="recording.html",
    )
    assert '<a href="recording.html">' in page
    assert "diamonds" in page
    plain = make_report(estimates[-1], log[:3])
    assert "What was known after each push" not in plain
    assert "errors as learned are of a fit." in plain

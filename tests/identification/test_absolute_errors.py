"""Errors of an estimate of mass, center of mass and friction, as a judge sees them."""

import numpy as np
import pytest

from gridpush_drake.identification.absolute.errors import compare_with_truth
from gridpush_drake.identification.absolute.estimate import AbsoluteEstimate
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import rectangle

BAR = GridObject.from_outline(rectangle(0.3, 0.06), max_cells=60, name="bar")


def make_estimate(mass, center, friction, std):
    mean = np.array([np.log(mass), *center, np.log(friction)])
    return AbsoluteEstimate(mean=mean, covariance=np.diag(np.square(std)), presses=3, pushes=5)


def test_errors_and_intervals_are_judged_one_by_one():
    truth = CellParameters.uniform(BAR, 0.5, 0.4)
    stds = (0.02, 0.001, 0.001, 0.05)
    right = compare_with_truth(make_estimate(0.51, (0.001, 0.0), 0.41, stds), BAR, truth)
    assert right.mass == pytest.approx(0.02)
    assert right.center == pytest.approx(0.001)
    assert right.friction == pytest.approx(0.01)
    assert right.mass_holds and right.center_holds and right.friction_holds
    # 2.2 standard deviations of the mass, sqrt(6.1) of the center, 2.1 of the friction.
    off = make_estimate(0.5 * np.exp(0.044), (0.0, np.sqrt(6.1) * 1e-3), 0.4 * np.exp(-0.105), stds)
    wrong = compare_with_truth(off, BAR, truth)
    assert not (wrong.mass_holds or wrong.center_holds or wrong.friction_holds)
    assert wrong.friction < 0 < wrong.mass

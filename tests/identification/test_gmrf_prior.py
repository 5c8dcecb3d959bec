import numpy as np

from gridpush_drake.identification.fit.load_prior import calc_smooth_covariance
from gridpush_drake.objects.grid_object import GridObject


def make_row(cells: int = 60) -> GridObject:
    return GridObject.from_outline([[0, 0], [0.6, 0], [0.6, 0.01], [0, 0.01]], max_cells=cells)


def test_covariance_is_positive_with_unit_mean_variance() -> None:
    C = calc_smooth_covariance(make_row())
    assert np.linalg.eigvalsh(C).min() > 0
    np.testing.assert_allclose(np.diag(C).mean(), 1.0, rtol=1e-12)
    np.testing.assert_allclose(C, C.T, atol=1e-12)


def test_correlation_falls_to_about_a_tenth_at_the_range() -> None:
    # Lindgren, Rue, Lindström (2011): at sqrt(8 nu)/kappa the Matérn correlation is near 0.1.
    obj = make_row()
    order = np.argsort(obj.p_BC[:, 0])
    C = calc_smooth_covariance(obj, range_cells=10.0)[np.ix_(order, order)]
    middle = len(C) // 2
    correlation = C[middle] / np.sqrt(C[middle, middle] * np.diag(C))
    assert 0.05 < correlation[middle + 10] < 0.3
    assert np.all(np.diff(correlation[middle : middle + 10]) < 0)

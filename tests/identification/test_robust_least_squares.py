"""Least squares with a prior in which some blocks are far off, and steps that stay where it is told."""

import numpy as np
import pytest

from gridpush_drake.identification.statistics.robust_least_squares import (
    MAX_CHANGE,
    MAX_STEP,
    calc_loss,
    fit_robustly,
)

rng = np.random.default_rng(3)
A = rng.normal(size=(12, 2, 3))
TRUE = np.array([0.3, -0.5, 0.8])
SEEN = A @ TRUE


def test_without_outliers_it_is_the_least_squares_with_the_prior():
    scale = 0.2
    root = np.diag([1.0, 2.0, 0.5])

    def calc(u):
        return scale * (A @ u - SEEN), scale * A

    fit = fit_robustly(calc, np.zeros(3), root, np.zeros(3))
    J = scale * A.reshape(-1, 3) @ root
    exact = np.linalg.solve(J.T @ J + np.eye(3), J.T @ (scale * SEEN.ravel()))
    np.testing.assert_allclose(fit.v, exact, atol=1e-2)
    np.testing.assert_allclose(fit.curvature, J.T @ J, rtol=0.02, atol=1e-3)
    assert fit.weights.min() > 0.97


def test_blocks_that_are_far_off_count_for_little():
    off = np.zeros_like(SEEN)
    off[[2, 7]] = 50.0

    def calc(u):
        return 30.0 * (A @ u - SEEN - off), 30.0 * A

    fit = fit_robustly(calc, np.zeros(3), np.eye(3), np.zeros(3))
    np.testing.assert_allclose(fit.v, TRUE, atol=0.02)
    assert (fit.weights[[2, 7]] < 1e-4).all() and np.delete(fit.weights, [2, 7]).min() > 0.9
    # the derivative of the loss is zero at the minimum
    for i in range(3):
        step = 1e-5 * np.eye(3)[i]
        above = calc_loss(calc(fit.v + step)[0], fit.v + step)
        below = calc_loss(calc(fit.v - step)[0], fit.v - step)
        assert abs(above - below) / 2e-5 < 0.05 * 30.0


@pytest.mark.parametrize("wall", [np.nan, np.inf])
def test_it_never_goes_where_nothing_can_be_calculated(wall):
    asked = []

    def calc(u):
        asked.append(u.copy())
        r = np.full((1, 1), wall if u[0] > 3.0 else 100.0 - u[0])
        return 10.0 * r, np.full((1, 1, 1), -10.0)

    fit = fit_robustly(calc, np.zeros(1), np.full((1, 1), 100.0), np.zeros(1))
    assert 1.5 < fit.v[0] * 100.0 <= 3.0
    assert np.isfinite(fit.loss)
    taken = np.diff(np.ravel(asked[:3]))
    assert np.abs(taken).max() <= MAX_STEP + 1e-12


def test_no_unknown_goes_farther_than_it_may():
    def calc(u):
        return 10.0 * (20.0 - u[:1, None]), np.full((1, 1, 1), -10.0)

    fit = fit_robustly(calc, np.zeros(1), np.full((1, 1), 1e3), np.zeros(1))
    assert 0.5 * MAX_CHANGE < fit.v[0] * 1e3 <= MAX_CHANGE

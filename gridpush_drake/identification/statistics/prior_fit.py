"""Least squares with a normal prior: the one way in which unknowns are fitted to what was seen.

With unknowns u = mean + root v and v ~ N(0, I) beforehand, and residuals r(u) ~ N(0, I),

    min over v of  (|r(mean + root v)|² + |v|²)/2

by SciPy's `least_squares`, a trust-region method with given derivatives.
"""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import least_squares

from gridpush_drake.geometry.se2 import Array


def fit_with_prior(
    calc_residuals: Callable[[Array], Array],
    calc_derivatives: Callable[[Array], Array],
    mean: Array,
    root: Array,
    start: Array,
    limits: Mapping[str, float],
) -> tuple[float, Array]:
    """Minimizes half the sum of squares, the prior's included.

    Args:
        calc_residuals: calculates the residuals (R,) at u (N,).
        calc_derivatives: calculates their derivatives (R, N) by u; it is asked at points where the
            residuals were.
        mean: (N,) of the unknowns beforehand.
        root: (N, N) of their covariance.
        start: (N,) v to begin with.
        limits: where it ends: "xtol", "ftol", "gtol" and "max_nfev" of `least_squares`.

    Returns:
        The loss, and v (N,).
    """

    def calc_all(v: Array) -> Array:
        return np.append(calc_residuals(mean + root @ v), v)

    def derive_all(v: Array) -> Array:
        return np.vstack([calc_derivatives(mean + root @ v) @ root, np.eye(len(v))])

    found = least_squares(calc_all, start, derive_all, **limits)
    return float(found.cost), np.asarray(found.x)

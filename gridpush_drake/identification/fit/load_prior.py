"""What hypotheses about a load are asked with (`HypothesisInputs`), and answer (`LoadPrior`).

A hypothesis proposes normal priors N(mean, A A^T) of z = (log k, log mu_c), the logarithms of the
cells' loads and of the contact friction. Which hypotheses there are, and which priors they propose,
is in `hypotheses`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject

RANGE_CELLS = 4.0
"""Distance, in cells, at which the log-frictions of two cells are nearly independent."""

KAPPA_RANGE = 8.0**0.5
"""kappa times the correlation range of the Matérn field of smoothness one (Lindgren, Rue and
Lindström 2011, section 2)."""


@dataclass(frozen=True, eq=False)
class LoadPrior:
    """One normal prior of z, z ~ N(mean, factor factor^T), as a hypothesis proposes it.

    Attributes:
        mean: (n+1,) prior mean of z.
        factor: (n+1, n+1) lower triangular factor of the prior covariance of z.
        weight: prior weight, relative to those of all other priors.
        p_BC: (n, 2) points at which the cells bear their loads, m, body frame; the object's own
            `p_BC` itself where they bear them at their centers.
        evidence_fraction: factor on the evidence of this prior's fit. It is less than 1 if the
            prior is the best of many that were tried, as the best of many fits well by chance.
        start: (n+1,) z at which the fit begins; None for the prior mean.
        stands_for_even: whether the prior describes an almost even object.
    """

    mean: Array
    factor: Array
    weight: float
    p_BC: Array
    evidence_fraction: float = 1.0
    start: Array | None = None
    stands_for_even: bool = False


@dataclass(frozen=True, eq=False)
class LinearizedPushes:
    """Pushes to first order about the prior mean z_0: r = residuals + J (z - z_0) ~ N(0, I).

    Attributes:
        residuals: (R,) whitened residuals at z_0.
        J: (R, n+1) their derivatives by z.
        known: how many of the residuals, counted from the end, are prior knowledge of the center of
            mass. They are no evidence.
    """

    residuals: Array
    J: Array
    known: int = 0

    def shift(self, step: Array) -> "LinearizedPushes":
        """Returns the same pushes to first order about z_0 + step, step (n+1,)."""
        return replace(self, residuals=self.residuals + self.J @ step)


@dataclass(frozen=True, eq=False)
class HypothesisInputs:
    """The question to a hypothesis: all that it may use to propose its priors.

    Attributes:
        obj: the object.
        z0: (n+1,) z of the even object, log k_0 and log mu_c.
        log_contact_friction_std: prior standard deviation of log mu_c.
        pushes: the training pushes to first order. Only hypotheses that need them
            (`LoadHypothesis.needs_pushes`) get them; for all others it is None.
    """

    obj: GridObject
    z0: Array
    log_contact_friction_std: float
    pushes: LinearizedPushes | None = None

    @cached_property
    def _covariances(self) -> dict[float, Array]:
        return {}

    def calc_smooth_covariance(self, range_cells: float) -> Array:
        """Returns `calc_smooth_covariance` (n, n) for a range in cells; each is calculated once."""
        if range_cells not in self._covariances:
            self._covariances[range_cells] = calc_smooth_covariance(self.obj, range_cells)
        return self._covariances[range_cells]

    def with_pushes(self, pushes: LinearizedPushes) -> "HypothesisInputs":
        """Returns a copy of this setting that has the training pushes to first order."""
        setting = HypothesisInputs(self.obj, self.z0, self.log_contact_friction_std, pushes)
        setting._covariances.update(self._covariances)
        return setting


def calc_smooth_covariance(obj: GridObject, range_cells: float = RANGE_CELLS) -> Array:
    """Calculates the covariance C of a smooth field on the cells (a Matérn field).

    C^-1 is proportional to (L + kappa² I)², with L the graph Laplacian of the cells.

    Args:
        obj: the object.
        range_cells: correlation range, cells.

    Returns:
        (n, n) covariance, scaled so that the mean variance of a cell is 1.
    """
    i, j = obj.adjacency.T
    L = np.zeros((obj.n, obj.n))
    np.add.at(L, (i, i), 1.0)
    np.add.at(L, (j, j), 1.0)
    L[i, j] = L[j, i] = -1.0
    root = np.linalg.inv(L + KAPPA_RANGE**2 / range_cells**2 * np.eye(obj.n))
    C = root @ root
    return C / np.diag(C).mean()


def calc_prior_factor(C: Array, amplitude: float, log_contact_friction_std: float) -> Array:
    """Cholesky factor (n+1, n+1) of blockdiag(a² C, sigma²), the prior covariance of z."""
    return np.asarray(
        block_diag(amplitude * np.linalg.cholesky(C), np.diag([log_contact_friction_std]))
    )

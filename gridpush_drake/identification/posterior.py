"""The spread of what was learned: a Gaussian on the logarithms of the cells' friction (Laplace's approximation)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Posterior:
    """z = (log k_1 .. log k_n, log mu_c) is normal.

    Attributes:
        mean: (n+1,) of z.
        covariance: (n+1, n+1) of z.
        prior_covariance: (n+1, n+1) before the pushes.
    """

    mean: Array
    covariance: Array
    prior_covariance: Array

    def draw(self, count: int, seed: int = 0) -> tuple[Array, Array]:
        """Draws relative support frictions (count, n), each summing to one, and contact frictions (count,)."""
        values, vectors = np.linalg.eigh(self.covariance)
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        rng = np.random.default_rng(seed)
        z = self.mean + rng.standard_normal((count, len(self.mean))) @ factor.T
        k = np.exp(z[:, :-1] - z[:, :-1].max(axis=1, keepdims=True))
        return k / k.sum(axis=1, keepdims=True), np.exp(z[:, -1])

    def calc_share_covariance(self) -> Array:
        """(n, n) covariance of the relative friction k / sum k, to first order."""
        share = self.calc_share()
        slope = np.diag(share) - np.outer(share, share)
        return slope @ self.covariance[:-1, :-1] @ slope

    def calc_share(self) -> Array:
        """(n,) relative friction at the mean, summing to one."""
        k = np.exp(self.mean[:-1] - self.mean[:-1].max())
        return k / k.sum()

"""The spread of what was learned: a Gaussian on the logarithms of the cells' friction (Laplace's approximation).

Draws from a posterior that agree with what the pushes showed, however little they showed of single cells.

What was learned is z = (log k_1 .. log k_n, log mu_c) ~ N(mean, S), a normal about the best fit. Pushes fix a few
combinations a.dz of dz = z - mean and leave single cells unknown by factors: there dz is large, and what is known of
a.dz is worth nothing for the draw's own k, whose center may be anywhere. But the balance of forces in a motion that was
seen is linear in k, not in log k: with the shares x = k / sum k and x0 those at the mean, what a push fixes is

    a.(x/x0 - 1) = a.dz,    dz the draw

which for small dz is the same. Each draw is moved, as little as can be in the prior's norm, until that holds for every
learned combination. Learned are those combinations whose variance the pushes cut to less than a share of the prior's:
the generalized eigenvectors of S and the prior covariance. Nothing is moved where nothing was learned.
"""

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


LEARNED = 0.5
"""Share of the prior variance, below which a combination counts as learned."""

STEPS = 25
"""Newton steps at most; the few draws that need more stay wider than they ought to be, which is safe."""

TOLERANCE = 0.05
"""Of a combination, in standard deviations of the posterior, at which a draw is left alone."""

MAX_STEP = 2.0
"""Of any cell's log friction."""

RIDGE = 1e-10
"""Relative, where combinations of a draw all but agree."""

FARTHEST = 30.0
"""Of log k from the mean, against overflow."""


def draw_consistent(posterior: Posterior, count: int, seed: int = 0) -> tuple[Array, Array]:
    """Draws relative support frictions and contact frictions.

    Args:
        posterior: of z.
        count: how many draws.
        seed: of the draws.

    Returns:
        (count, n) shares, each summing to one; (count,) contact frictions.
    """
    values, vectors = np.linalg.eigh(posterior.covariance)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    dz = rng.standard_normal((count, len(posterior.mean))) @ factor.T
    A, variances, root = _find_learned(posterior)
    if len(A):
        _correct(dz, posterior.calc_share(), A, np.sqrt(variances), root)
    return _calc_shares(posterior.calc_share(), dz), np.exp(posterior.mean[-1] + dz[:, -1])


def _find_learned(posterior: Posterior) -> tuple[Array, Array, Array]:
    """Learned combinations A (m, n+1), each of prior variance one, their variances (m,), and the prior's root."""
    values, vectors = np.linalg.eigh(posterior.prior_covariance)
    size = np.sqrt(np.maximum(values, np.finfo(float).eps * values[-1]))
    root = vectors * size
    inverse = (vectors / size).T
    ratio, directions = np.linalg.eigh(inverse @ posterior.covariance @ inverse.T)
    learned = ratio < LEARNED
    A = directions[:, learned].T @ inverse
    A[:, :-1] -= A[:, :-1].mean(axis=1, keepdims=True)  # no push shows the common scale, nor do shares
    return A, np.maximum(ratio[learned], np.finfo(float).tiny), root


def _correct(dz: Array, share: Array, A: Array, stds: Array, root: Array) -> None:
    """Moves draws dz (count, n+1), in place, until their shares have the combinations that dz had."""
    wanted = dz @ A.T
    rest = np.arange(len(dz))
    for _ in range(STEPS):
        x = _calc_shares(share, dz[rest])
        ratio = x / share
        lack = wanted[rest] - (ratio - 1) @ A[:, :-1].T - dz[rest, -1:] * A[:, -1]
        far = np.abs(lack / stds).max(axis=1) > TOLERANCE
        rest, x, ratio, lack = rest[far], x[far], ratio[far], lack[far]
        if not len(rest):
            return
        # d(ratio_i) = ratio_i (dz_i - sum_j x_j dz_j)
        slope = np.empty((len(rest), *A.shape))
        slope[:, :, :-1] = A[:, :-1] * ratio[:, None] - (ratio @ A[:, :-1].T)[:, :, None] * x[:, None]
        slope[:, :, -1] = A[:, -1]
        J = slope @ root
        JT = np.swapaxes(J, 1, 2)
        K = J @ JT
        K += RIDGE * np.trace(K, axis1=1, axis2=2)[:, None, None] * np.eye(len(A))
        step = (JT @ np.linalg.solve(K, lack[:, :, None]))[:, :, 0] @ root.T
        step *= np.minimum(1.0, MAX_STEP / np.abs(step).max(axis=1, keepdims=True))
        dz[rest] = np.clip(dz[rest] + step, -FARTHEST, FARTHEST)


def _calc_shares(share: Array, dz: Array) -> Array:
    """(count, n) shares of draws."""
    z = np.log(share) + dz[:, :-1]
    k = np.exp(z - z.max(axis=1, keepdims=True))
    return np.asarray(k / k.sum(axis=1, keepdims=True))

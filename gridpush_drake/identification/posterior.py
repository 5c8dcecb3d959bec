"""The spread of what was learned, and draws from it that agree with what the pushes showed.

z = (log k_1 .. log k_n, log mu_c) ~ N(mean, S), Laplace's normal about the best fit. A draw dz = z
- mean is moved, as little as can be in the prior's norm, until its shares x = k / sum k keep every
combination a that the pushes fixed,

    a.(x/x0 - 1) = a.dz,    x0 the shares at the mean

which for small dz is the draw itself (`docs/theory/identification.md`, section 6). Where the pushes
are at hand, they have the last word (`evidence`).
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.notebook import count, describe_range
from gridpush_drake.objects.parameters import CellParameters

GLOBALS = ("log_contact_friction",)
"""What z holds after the cells' log k, one entry each."""

CELLS, GLOBAL = slice(0, -len(GLOBALS)), slice(-len(GLOBALS), None)
"""Where in z the cells' log k stand, and the rest."""

CONTACT_FRICTION = GLOBALS.index("log_contact_friction") - len(GLOBALS)
"""Where in z log mu_c stands."""

LEARNED_SHARE = 0.5
"""A combination, or a cell, counts as learned where the pushes took away this share of its prior
variance."""

MIN_SHARE = 1e-12
"""Of the friction that a cell is given where a draw has none: masses must be positive."""

STEPS = 25
"""Newton steps at most; the few draws that need more stay wider than they ought to be, which is
safe."""

TOLERANCE = 0.05
"""Of a combination, in standard deviations of the posterior, at which a draw is left alone."""

MAX_STEP = 2.0
"""Of any cell's log friction."""

RIDGE = 1e-10
"""Relative, where combinations of a draw all but agree."""

FARTHEST = 30.0
"""Of log k from the mean, against overflow."""


class DrawJudge(Protocol):
    """What says more of draws than their covariance."""

    def draw_in(self, dz: Array) -> Array:
        """Draws dz (count, n+1) from the mean, those that cannot be drawn in towards it."""
        ...


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

    def __repr__(self) -> str:
        """What is spread, and how widely, in a line."""
        cells = count(len(self.mean) - 1, "cell")
        std = describe_range(np.sqrt(np.maximum(np.diag(self.covariance)[CELLS], 0.0)))
        return f"Posterior of {cells}: standard deviation of a cell's log friction {std}"

    def draw(
        self, count: int, seed: int = 0, judge: DrawJudge | None = None
    ) -> tuple[Array, Array]:
        """Draws relative support frictions and contact frictions that agree with what the pushes showed.

        Args:
            count: how many draws.
            seed: of the draws.
            judge: of the draws, such as the pushes themselves.

        Returns:
            (count, n) shares k / sum k, each positive and summing to one, but for MIN_SHARE;
            (count,) mu_c.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        rng = np.random.default_rng(seed)
        dz = rng.standard_normal((count, len(self.mean))) @ factor.T
        share = self.calc_share()
        A, variances, root = _find_learned(self)
        if len(A):
            _correct(dz, share, A, np.sqrt(variances), root)
        if judge is not None:
            dz = judge.draw_in(dz)
        return np.maximum(_calc_shares(share, dz), MIN_SHARE), np.exp(
            self.mean[CONTACT_FRICTION] + dz[:, CONTACT_FRICTION]
        )

    @threadpool_limits.wrap(
        limits=1, user_api="blas"
    )  # small matrices: threads only cost, and reorder sums
    def draw_parameters(
        self, params: CellParameters, count: int, seed: int = 0, judge: DrawJudge | None = None
    ) -> list[CellParameters]:
        """Draws parameters that agree with the pushes; every cell's friction is that of `params`, its mass varies.

        Args:
            params: the estimate, whose sum of mu_i m_i the draws share.
            count: how many draws.
            seed: of the draws.
            judge: of the draws, such as the pushes themselves.

        Returns:
            The parameters.
        """
        if not count:
            return []
        shares, contact_friction = self.draw(count, seed, judge)
        total = float(params.mass @ params.friction)
        friction = np.maximum(params.friction, np.finfo(float).tiny)
        return [
            replace(params, mass=total * share / friction, contact_friction=float(mu_c))
            for share, mu_c in zip(shares, contact_friction, strict=True)
        ]

    def calc_share(self) -> Array:
        """(n,) relative friction at the mean, summing to one."""
        return calc_share(self.mean)

    def calc_share_covariance(self) -> Array:
        """(n, n) covariance of the relative friction k / sum k, to first order."""
        share = self.calc_share()
        slope = np.diag(share) - np.outer(share, share)
        return slope @ self.covariance[CELLS, CELLS] @ slope


def calc_share(z: Array) -> Array:
    """(n,) relative friction at z (n+1,), summing to one."""
    k = np.exp(z[CELLS] - z[CELLS].max())
    return np.asarray(k / k.sum())


def calc_center_jacobian(share: Array, p_BC: Array) -> Array:
    """Derivatives share_i (p_i - c) by z of the center c = sum_i share_i p_i.

    Args:
        share: (n,) weights proportional to exp z_i, summing to one: of friction or, with mu_i held,
            of mass.
        p_BC: (n, 2) the cells' centers, body frame, m.

    Returns:
        (2, n+1) m; the columns after the cells', by log mu_c, are zero.
    """
    J = np.zeros((2, len(share) + len(GLOBALS)))
    J[:, CELLS] = (share[:, None] * (p_BC - share @ p_BC)).T
    return J


def compare_covariances(prior: Array, after: Array) -> tuple[Array, Array, Array, Array]:
    """Finds the combinations of z whose variance the pushes cut most: generalized eigenvectors of two covariances.

    Args:
        prior: (n, n) before the pushes.
        after: (n, n) after them.

    Returns:
        Ratios (n,) of the variances after to before, increasing; the columns (n, n) of their
        directions in coordinates u, z = root u, in which the prior is the identity; root (n, n),
        and its inverse.
    """
    values, vectors = np.linalg.eigh(prior)
    size = np.sqrt(np.maximum(values, np.finfo(float).eps * values[-1]))
    inverse = (vectors / size).T
    ratio, directions = np.linalg.eigh(inverse @ after @ inverse.T)
    return ratio, directions, vectors * size, inverse


def _find_learned(posterior: Posterior) -> tuple[Array, Array, Array]:
    """Learned combinations A (m, n+1), each of prior variance one, their variances (m,), and the prior's root."""
    ratio, directions, root, inverse = compare_covariances(
        posterior.prior_covariance, posterior.covariance
    )
    learned = ratio < 1 - LEARNED_SHARE
    A = directions[:, learned].T @ inverse
    A[:, CELLS] -= A[:, CELLS].mean(
        axis=1, keepdims=True
    )  # no push shows the common scale, nor do shares
    return A, np.maximum(ratio[learned], np.finfo(float).tiny), root


def _correct(dz: Array, share: Array, A: Array, stds: Array, root: Array) -> None:
    """Moves draws dz (count, n+1), in place, until their shares have the combinations that dz had."""
    wanted = dz @ A.T
    rest = np.arange(len(dz))
    for _ in range(STEPS):
        x = _calc_shares(share, dz[rest])
        ratio = x / share
        lack = wanted[rest] - (ratio - 1) @ A[:, CELLS].T - dz[rest, GLOBAL] @ A[:, GLOBAL].T
        far = np.abs(lack / stds).max(axis=1) > TOLERANCE
        rest, x, ratio, lack = rest[far], x[far], ratio[far], lack[far]
        if not len(rest):
            return
        # d(ratio_i) = ratio_i (dz_i - sum_j x_j dz_j)
        slope = np.empty((len(rest), *A.shape))
        slope[:, :, CELLS] = (
            A[:, CELLS] * ratio[:, None] - (ratio @ A[:, CELLS].T)[:, :, None] * x[:, None]
        )
        slope[:, :, GLOBAL] = A[:, GLOBAL]
        J = slope @ root
        JT = np.swapaxes(J, 1, 2)
        K = J @ JT
        K += RIDGE * np.trace(K, axis1=1, axis2=2)[:, None, None] * np.eye(len(A))
        step = (JT @ np.linalg.solve(K, lack[:, :, None]))[:, :, 0] @ root.T
        step *= np.minimum(1.0, MAX_STEP / np.abs(step).max(axis=1, keepdims=True))
        dz[rest] = np.clip(dz[rest] + step, -FARTHEST, FARTHEST)


def _calc_shares(share: Array, dz: Array) -> Array:
    """(count, n) shares of draws."""
    z = np.log(share) + dz[:, CELLS]
    k = np.exp(z - z.max(axis=1, keepdims=True))
    return np.asarray(k / k.sum(axis=1, keepdims=True))

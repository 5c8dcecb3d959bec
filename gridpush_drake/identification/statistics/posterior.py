"""The spread of what was learned, and draws from it that agree with what the pushes showed.

The estimate is a normal distribution (Laplace's approximation about the best fit),
z = (log k_1 .. log k_n, log mu_c) ~ N(mean, S). Pushes determine some combinations of the
normalized loads x = k / sum k. Far from the mean, a draw z = mean + dz would contradict them, as x
depends on z exponentially. Each draw is therefore moved, by the smallest step in the prior's norm,
until for every combination a that the pushes determined

    a.(x/x0 - 1) = a.dz,    x0 the normalized loads at the mean

A small dz fulfills this as it is (`docs/theory/identification.md`, section 6). If the pushes
themselves are at hand, draws are also checked by them (`evidence`).

How the best fit is found is not here but in `map_fit` and `map_ensemble`.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.notebook import count, describe_range
from gridpush_drake.objects.parameters import CellParameters

GLOBAL_NAMES = ("log_contact_friction",)
"""Names of the entries of z that follow the cells' log k."""

CELL_ENTRIES = slice(0, -len(GLOBAL_NAMES))
"""Entries of z that are the cells' log k."""

GLOBAL_ENTRIES = slice(-len(GLOBAL_NAMES), None)
"""Entries of z that belong to no cell, named by `GLOBAL_NAMES`."""

CONTACT_FRICTION = GLOBAL_NAMES.index("log_contact_friction") - len(GLOBAL_NAMES)
"""Index in z of log mu_c, counted from the end."""

LEARNED_FRACTION = 0.5
"""Fraction of the prior variance that pushes must take away from a combination, or a cell, for it
to count as learned."""

MIN_FRACTION = 1e-12
"""Smallest fraction of the friction that a cell of a draw is given, because masses must be
positive."""

MAX_NEWTON_STEPS = 25
"""Greatest number of Newton steps by which draws are moved. The few draws that would need more stay
farther from the mean than they ought to be. The spread then seems too large, which is safe."""

DRAW_TOLERANCE = 0.05
"""Largest error of a draw's combinations, in standard deviations of the posterior. A draw with
smaller errors is not moved any more."""

MAX_STEP = 2.0
"""Largest change of any entry of z in one Newton step. A longer step is shortened to it."""

RIDGE_FRACTION = 1e-10
"""Fraction of the trace that is added to the diagonal of a step's equations, so that they can be
solved even if two combinations are all but the same for a draw."""

MAX_ENTRY_DISTANCE = 30.0
"""Largest distance of an entry of z from the mean. Draws are clipped to it against overflow."""


class DrawJudge(Protocol):
    """Judges draws by more than their covariance, such as by the pushes that were learned from."""

    def draw_in(self, dz: Array) -> Array:
        """Shortens draws dz (count, n+1) from the mean until each of them is possible."""
        ...


@dataclass(frozen=True, eq=False)
class Posterior:
    """Normal distribution of z = (log k_1 .. log k_n, log mu_c) after the pushes.

    Attributes:
        mean: (n+1,) mean of z.
        covariance: (n+1, n+1) covariance of z.
        prior_covariance: (n+1, n+1) covariance of z before the pushes.
    """

    mean: Array
    covariance: Array
    prior_covariance: Array

    def __repr__(self) -> str:
        """Says in a line of how many cells it is, and how widely they are spread."""
        cells = count(len(self.mean) - 1, "cell")
        std = describe_range(np.sqrt(np.maximum(np.diag(self.covariance)[CELL_ENTRIES], 0.0)))
        return f"Posterior of {cells}: standard deviation of a cell's log friction {std}"

    def draw(
        self, count: int, seed: int = 0, judge: DrawJudge | None = None
    ) -> tuple[Array, Array]:
        """Draws normalized loads and contact frictions that agree with what the pushes showed.

        Args:
            count: how many draws.
            seed: seed of the draws.
            judge: knows more of the draws, such as the pushes themselves; None where nothing does.

        Returns:
            (count, n) shares k / sum k, each positive and summing to one, but for MIN_FRACTION;
            (count,) mu_c.
        """
        # dz ~ N(0, S). S may be singular, so that its factor is taken from its eigenvalues.
        values, vectors = np.linalg.eigh(self.covariance)
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        rng = np.random.default_rng(seed)
        dz = rng.standard_normal((count, len(self.mean))) @ factor.T

        # Far from the mean such draws contradict what was learned, and are moved (section 6).
        fraction = self.calc_fraction()
        A, variances, root = _find_learned(self)
        if len(A):
            _correct(dz, fraction, A, np.sqrt(variances), root)
        if judge is not None:
            dz = judge.draw_in(dz)

        fractions = np.maximum(_calc_fractions(fraction, dz), MIN_FRACTION)
        contact_friction = np.exp(self.mean[CONTACT_FRICTION] + dz[:, CONTACT_FRICTION])
        return fractions, contact_friction

    # The matrices are small: threads of BLAS would only cost time, and change the order of sums.
    @threadpool_limits.wrap(limits=1, user_api="blas")
    def draw_parameters(
        self, params: CellParameters, count: int, seed: int = 0, judge: DrawJudge | None = None
    ) -> list[CellParameters]:
        """Draws parameters that agree with the pushes.

        Every cell's friction is that of `params`, and its mass varies.

        Args:
            params: the estimate, whose sum of mu_i m_i the draws share.
            count: how many draws.
            seed: seed of the draws.
            judge: knows more of the draws, such as the pushes themselves; None where nothing does.

        Returns:
            The parameters.
        """
        if not count:
            return []
        fractions, contact_friction = self.draw(count, seed, judge)
        total = float(params.mass @ params.friction)
        # m_i = k_i / mu_i, also where a cell's friction is zero.
        friction = np.maximum(params.friction, np.finfo(float).tiny)
        return [
            replace(params, mass=total * fraction / friction, contact_friction=float(mu_c))
            for fraction, mu_c in zip(fractions, contact_friction, strict=True)
        ]

    def widen(self, factor: float) -> "Posterior":
        """The posterior as if pushes had shown less: what they showed is less sure by a factor.

        Args:
            factor: on the standard deviations, 1 or more. No combination of z becomes less sure
                than it was before the pushes.
        """
        ratio, directions, root, _ = compare_covariances(self.prior_covariance, self.covariance)
        wider = np.maximum(ratio, np.minimum(factor**2 * ratio, 1.0))
        scaled = root @ directions
        return replace(self, covariance=(scaled * wider) @ scaled.T)

    def calc_fraction(self) -> Array:
        """Normalized loads x (n,) at the mean: nonnegative, summing to one."""
        return calc_fraction(self.mean)

    def calc_fraction_covariance(self) -> Array:
        """Covariance (n, n) of the normalized loads x = k / sum k, to first order."""
        # dx = (diag x - x x^T) dz
        fraction = self.calc_fraction()
        slope = np.diag(fraction) - np.outer(fraction, fraction)
        return slope @ self.covariance[CELL_ENTRIES, CELL_ENTRIES] @ slope


def calc_fraction(z: Array) -> Array:
    """Normalized loads x = k / sum k (n,) at z (n+1,), summing to one."""
    # The common scale drops out; without it, exp cannot overflow.
    k = np.exp(z[CELL_ENTRIES] - z[CELL_ENTRIES].max())
    return np.asarray(k / k.sum())


def calc_center_jacobian(fraction: Array, p_BC: Array) -> Array:
    """Calculates the derivatives fraction_i (p_i - c) by z of the center c = sum_i fraction_i p_i.

    Args:
        fraction: (n,) weights proportional to exp z_i, summing to one: of friction or, with mu_i
            held, of mass.
        p_BC: (n, 2) the cells' centers, body frame, m.

    Returns:
        (2, n+1) m; the columns after the cells', by log mu_c, are zero.
    """
    J = np.zeros((2, len(fraction) + len(GLOBAL_NAMES)))
    J[:, CELL_ENTRIES] = (fraction[:, None] * (p_BC - fraction @ p_BC)).T
    return J


def compare_covariances(prior: Array, after: Array) -> tuple[Array, Array, Array, Array]:
    """Finds the combinations of z whose variance the pushes cut most.

    They are the generalized eigenvectors of both covariances.

    Args:
        prior: (n, n) covariance before the pushes.
        after: (n, n) covariance after them.

    Returns:
        Ratios (n,) of the variances after to before, increasing; the columns (n, n) of their
        directions in coordinates u, z = root u, in which the prior is the identity; root (n, n),
        and its inverse.
    """
    # A prior that is all but singular keeps a little variance everywhere, so that it has an
    # inverse.
    values, vectors = np.linalg.eigh(prior)
    size = np.sqrt(np.maximum(values, np.finfo(float).eps * values[-1]))
    inverse = (vectors / size).T
    ratio, directions = np.linalg.eigh(inverse @ after @ inverse.T)
    return ratio, directions, vectors * size, inverse


def _find_learned(posterior: Posterior) -> tuple[Array, Array, Array]:
    """Finds the combinations of z that the pushes determined.

    Returns:
        Combinations A (m, n+1), each of prior variance one, their variances (m,) now, and the
        prior's root (n+1, n+1).
    """
    ratio, directions, root, inverse = compare_covariances(
        posterior.prior_covariance, posterior.covariance
    )
    learned = ratio < 1 - LEARNED_FRACTION
    A = directions[:, learned].T @ inverse
    # No push shows the common scale of all loads, and normalized loads do not have it.
    A[:, CELL_ENTRIES] -= A[:, CELL_ENTRIES].mean(axis=1, keepdims=True)
    return A, np.maximum(ratio[learned], np.finfo(float).tiny), root


def _correct(dz: Array, fraction: Array, A: Array, stds: Array, root: Array) -> None:
    """Moves draws, in place, until they agree with the learned combinations; see the module.

    Args:
        dz: (count, n+1) draws from the mean.
        fraction: (n,) x_0, shares at the mean.
        A: (m, n+1) learned combinations.
        stds: (m,) their standard deviations.
        root: (n+1, n+1) root of the prior, in whose norm the moves are the shortest.
    """
    by_cells = A[:, CELL_ENTRIES]
    by_globals = A[:, GLOBAL_ENTRIES]
    wanted = dz @ A.T
    rest = np.arange(len(dz))
    for _ in range(MAX_NEWTON_STEPS):
        # The two sides of a.(x/x0 - 1) = a.dz differ by `lack`. Where it is small, a draw is done.
        x = _calc_fractions(fraction, dz[rest])
        ratio = x / fraction
        lack = wanted[rest] - (ratio - 1) @ by_cells.T - dz[rest, GLOBAL_ENTRIES] @ by_globals.T
        far = np.abs(lack / stds).max(axis=1) > DRAW_TOLERANCE
        rest = rest[far]
        x = x[far]
        ratio = ratio[far]
        lack = lack[far]
        if not len(rest):
            return

        # d(ratio_i) = ratio_i (dz_i - sum_j x_j dz_j)
        slope = np.empty((len(rest), *A.shape))
        common = (ratio @ by_cells.T)[:, :, None] * x[:, None]
        slope[:, :, CELL_ENTRIES] = by_cells * ratio[:, None] - common
        slope[:, :, GLOBAL_ENTRIES] = by_globals

        # Newton's step that is shortest in the prior's norm: dz = R J^T (J J^T)^-1 lack.
        J = slope @ root
        JT = np.swapaxes(J, 1, 2)
        K = J @ JT
        K += RIDGE_FRACTION * np.trace(K, axis1=1, axis2=2)[:, None, None] * np.eye(len(A))
        step = (JT @ np.linalg.solve(K, lack[:, :, None]))[:, :, 0] @ root.T
        step *= np.minimum(1.0, MAX_STEP / np.abs(step).max(axis=1, keepdims=True))
        dz[rest] = np.clip(dz[rest] + step, -MAX_ENTRY_DISTANCE, MAX_ENTRY_DISTANCE)


def _calc_fractions(fraction: Array, dz: Array) -> Array:
    """Normalized loads (count, n) of draws dz (count, n+1) about the shares (n,) at the mean."""
    z = np.log(fraction) + dz[:, CELL_ENTRIES]
    k = np.exp(z - z.max(axis=1, keepdims=True))
    return np.asarray(k / k.sum(axis=1, keepdims=True))

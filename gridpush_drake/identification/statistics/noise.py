"""What pushes show besides the model: errors of poses, pusher and friction, and loads that shift.

A push's residuals share their errors,

    Sigma = s² (sigma² K/K_eff I + sigma_tip² J_start J_start^T + sigma_mu² J_mu J_mu^T)
            + t² sigma_c² J_c J_c^T + sigma_g² J_g J_g^T

with K_eff = sqrt(K) of K observations, J_c the derivatives by a shift of the load's center, and s
and t what the pushes make of the stated deviations (`docs/theory/identification.md`, section 4).
J_g are the derivatives by the friction's gradient (`friction_gradient`), which matters only over a
table's edge. It is the same in all pushes; here each has its own, so that many pushes over the edge
count for a little more than they tell.
The numbers are the fields of `NoiseModel`. How s and t follow from a fit is in `map_fit`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log, sqrt
from typing import NamedTuple

import numpy as np

from gridpush_drake.geometry.se2 import Array

POSE_SIZE = 3
"""Number of coordinates in a pose: x, y and theta."""

NORMAL_DOF = 1e6
"""Degrees of freedom at which Student's t is as good as a normal distribution."""


class NoiseScale(NamedTuple):
    """How many times larger than a noise model states it the noise is, as the pushes show it.

    Attributes:
        pose: s, factor on all standard deviations but the one of the load's shift.
        shift: t, factor on the standard deviation of the load's shift.
    """

    pose: float = 1.0
    shift: float = 1.0


@dataclass(frozen=True, eq=False)
class LeftOutEnds:
    """How far off the last pose of each push is from what all other pushes predict of it.

    Attributes:
        errors: (P, 3) errors of the predictions, as residuals have them, m.
        covariances: (P, 3, 3) covariances that are stated of them, m².
    """

    errors: Array
    covariances: Array

    @property
    def ratios(self) -> Array:
        """Squared lengths (P,) of the errors, as cells move, over the expected ones."""
        expected = np.trace(self.covariances, axis1=1, axis2=2)
        return np.asarray((self.errors**2).sum(axis=1) / expected)


@dataclass(frozen=True, eq=False)
class Whitening:
    """W = (I - M T M^T) / a, which makes a push's residuals independent with unit variance.

    Attributes:
        std: a, m.
        inputs: (3K, I) M, the residuals' derivatives by the I inputs, 5 or 7, each input in its
            standard deviations, over a.
        inner: (I, I) T = 1 / (r (r + 1)) with r = (I + M^T M)^(1/2).
        log_determinant: half the log determinant of Sigma, where Sigma^-1 = W².
    """

    std: float
    inputs: Array
    inner: Array
    log_determinant: float

    def apply(self, values: Array) -> Array:
        """Whitens `values`, (3K,) or (3K, p): returns W times them."""
        # From right to left, so that no matrix of 3K by 3K is made.
        shared = self.inputs @ (self.inner @ (self.inputs.T @ values))
        return np.asarray((values - shared) / self.std)


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviations at scale one, and the priors on their scales.

    Attributes:
        pose: sigma, standard deviation of a residual (a coordinate of the centroid, or the turn at
            the radius of gyration), m.
        tip: sigma_tip, standard deviation of the pusher's place per axis, m.
        log_contact_friction: sigma_mu, standard deviation of log mu_c from push to push.
        load_shift: sigma_c, standard deviation of the load's center per axis from push to push, m.
        prior_weight: how many residuals the prior belief s = 1 is worth.
        shift_weight: how many shifts the prior belief t = 1 is worth.
        discrepancy_weight: how many predicted numbers the prior belief kappa = 1 is worth.
        push_freedom: degrees of freedom of the Student's t distribution that single pushes have
            even if kappa is known well, greater than 2. Some pushes, such as those in which the
            pusher changes from sticking to slipping, end much farther off than most.
        outlier: if the root mean square of a push's whitened residuals is above this, in standard
            deviations, its loss grows linearly instead of quadratically (Huber).
        friction_gradient: sigma_g, standard deviation of how much log mu changes along one radius
            of gyration.
    """

    pose: float = 0.0008
    tip: float = 0.0015
    log_contact_friction: float = 0.3
    load_shift: float = 0.0012
    prior_weight: float = 20.0
    shift_weight: float = 10.0
    discrepancy_weight: float = 1.0
    push_freedom: float = 4.0
    outlier: float = 0.7
    friction_gradient: float = 0.0

    def calc_covariance(self, input_jacobian: Array, scale: NoiseScale) -> Array:
        """Calculates the covariance of a push's residuals.

        Args:
            input_jacobian: (3K, 5) derivatives of the residuals by start x, start y (both per m),
                log mu_c (m), and a shift of the load's center in x and y (per m); or (3K, 7), also
                by the friction's gradient in x and y (m).
            scale: s and t.

        Returns:
            Sigma (3K, 3K), m².
        """
        # K/K_eff = sqrt(K): the poses of a push share a part of their errors.
        rows = len(input_jacobian)
        measured = (scale.pose * self.pose) ** 2 * np.sqrt(rows / 3) * np.eye(rows)
        inputs = input_jacobian * self._calc_stds(scale)[: input_jacobian.shape[1]]
        return measured + inputs @ inputs.T

    def make_whitenings(
        self, input_jacobians: Sequence[Array], scale: NoiseScale
    ) -> list[Whitening]:
        """Makes W with W² = Sigma^-1 for many pushes.

        The cost is that of the few inputs rather than of the many rows.

        Args:
            input_jacobians: (3K, 5) or (3K, 7) of each push, as for `calc_covariance`; alike for
                all pushes.
            scale: s and t.

        Returns:
            One whitening a push.
        """
        # Sigma = a² (I + M M^T), with a² = s² sigma² sqrt(K).
        stds = self._calc_stds(scale)
        floor = scale.pose * self.pose
        std = [floor * (len(J) / 3) ** 0.25 for J in input_jacobians]
        inputs = [
            J * (stds[: J.shape[1]] / one) for J, one in zip(input_jacobians, std, strict=True)
        ]

        # T = 1 / (r (r + 1)) is a function of the matrix r² = I + M^T M: of its eigenvalues.
        size2, V = np.linalg.eigh(np.array([M.T @ M for M in inputs]))
        root = np.sqrt(1 + np.maximum(size2, 0.0))
        inner = (V / (root * (root + 1))[:, None]) @ np.swapaxes(V, 1, 2)

        # 1/2 log det Sigma = 3K log a + log det r
        log_roots = np.log(root).sum(axis=1).tolist()
        return [
            Whitening(std=a, inputs=M, inner=T, log_determinant=len(M) * log(a) + log_root)
            for a, M, T, log_root in zip(std, inputs, inner, log_roots, strict=True)
        ]

    def calc_scale_loss(self, scale: NoiseScale) -> float:
        """Negative log prior of s and t, but for a constant: eta (log s + 1/2 s^-2) of each."""
        weighted = ((self.prior_weight, scale.pose), (self.shift_weight, scale.shift))
        return sum(weight * float(np.log(value) + 0.5 * value**-2) for weight, value in weighted)

    def calc_discrepancy(self, ratios: Array) -> float:
        """Calculates how much more than stated pushes differ from what the other pushes predict.

        Args:
            ratios: (P,) squared lengths of the differences of the last poses over the expected
                ones, each of POSE numbers.

        Returns:
            kappa, 1 if they differ by as much as was stated.
        """
        # Section 5: the mean of a scaled inverse chi-square distribution.
        weight = self.discrepancy_weight
        return sqrt((POSE_SIZE * float(ratios.sum()) + weight) / (POSE_SIZE * len(ratios) + weight))

    def calc_log_predictive(self, ends: LeftOutEnds) -> float:
        """Calculates how probable the last poses of pushes are by what the others predict of them.

        The distribution is the one by which poses of new pushes are predicted: Student's t, as much
        wider or narrower than stated as the errors of these pushes are.

        Returns:
            Sum of the log densities of all pushes, up to a constant that depends on their number
            alone.
        """
        pushes = len(ends.errors)
        freedom = self.calc_freedom(pushes)
        factor = self.calc_typical_fraction(pushes) * self.calc_discrepancy(ends.ratios) ** 2
        scales = factor * ends.covariances
        # log t_f(e; 0, C) = -1/2 log det C - (f + 3)/2 log(1 + e^T C^-1 e / f) + constant
        pulls = np.linalg.solve(scales, ends.errors[:, :, None])[:, :, 0]
        squares = (ends.errors * pulls).sum(axis=1)
        spread = np.linalg.slogdet(scales)[1]
        tails = (freedom + POSE_SIZE) * np.log1p(squares / freedom)
        return -0.5 * float((spread + tails).sum())

    def calc_freedom(self, pushes: int) -> float:
        """Degrees of freedom of the Student's t distribution of a predicted coordinate.

        Args:
            pushes: how many pushes kappa is known from. With none it is not in doubt, and the
                distribution is normal.
        """
        if not pushes:
            return NORMAL_DOF
        # Section 5: pushes differ among each other, and kappa is known from few of them.
        known_from = POSE_SIZE * pushes + self.discrepancy_weight
        return 1 / (1 / self.push_freedom + 1 / known_from)

    def calc_typical_fraction(self, pushes: int) -> float:
        """Fraction of the mean square of an error that belongs to a typical push.

        kappa is a root mean square, to which the few pushes that end far off contribute much.

        Args:
            pushes: as for `calc_freedom`.

        Returns:
            Scale of Student's t over its variance, both squared, if kappa were known well.
        """
        return 1 - 2 / self.push_freedom if pushes else 1.0

    def scaled(self, scale: NoiseScale) -> "NoiseModel":
        """Returns a noise model whose standard deviations are multiplied by s and t."""
        return replace(
            self,
            pose=scale.pose * self.pose,
            tip=scale.pose * self.tip,
            log_contact_friction=scale.pose * self.log_contact_friction,
            load_shift=scale.shift * self.load_shift,
        )

    def calc_weight(self, whitened: Array) -> float:
        """Huber's weight of a push, 1 or less, from its whitened residuals (3K,)."""
        size = _calc_size(whitened)
        return 1.0 if size <= self.outlier else self.outlier / size

    def calc_loss(self, whitened: Array) -> float:
        """Huber's loss of a push from its whitened residuals (3K,).

        It is the negative log likelihood, but for its normalization.
        """
        # Beyond `outlier` the loss goes on along its tangent: linear, and without a kink.
        size = _calc_size(whitened)
        squared = size**2 if size <= self.outlier else self.outlier * (2 * size - self.outlier)
        return 0.5 * calc_effective_count(len(whitened)) * squared

    def _calc_stds(self, scale: NoiseScale) -> Array:
        """Standard deviations (7,) of the inputs, in the order of `calc_covariance`."""
        noise = self.scaled(scale)
        return np.array(
            [
                noise.tip,
                noise.tip,
                noise.log_contact_friction,
                noise.load_shift,
                noise.load_shift,
                noise.friction_gradient,
                noise.friction_gradient,
            ]
        )


def calc_effective_count(rows: int) -> float:
    """Number of independent residuals that a push's 3K residuals count for: 3 K_eff = 3 sqrt(K)."""
    return 3.0 * sqrt(rows / 3)


def _calc_size(whitened: Array) -> float:
    """Root mean square of whitened residuals; it is 1 where the noise is as large as supposed."""
    return sqrt(float(whitened @ whitened) / calc_effective_count(len(whitened)))

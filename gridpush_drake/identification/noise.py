"""What pushes show besides the model: errors of the poses, of the pusher's place, of friction and of loads that shift.

A push's residuals share their errors,

    Sigma = s² (sigma² K/K_eff I + sigma_tip² J_start J_start^T + sigma_mu² J_mu J_mu^T) + t²
    sigma_c² J_c J_c^T

with K_eff = sqrt(K) of K observations, J_c the derivatives by a shift of the load's center, and s
and t what the pushes make of the stated deviations (`docs/theory/identification.md`, section 4).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log, sqrt
from typing import NamedTuple

import numpy as np

from gridpush_drake.geometry.se2 import Array

POSE = 3
"""Numbers in a pose."""

NORMAL = 1e6
"""Freedom at which Student's t is as good as normal."""


class NoiseScale(NamedTuple):
    """Of a noise model, as large as the pushes said: s of all but the load's shift, t of that."""

    pose: float = 1.0
    shift: float = 1.0


@dataclass(frozen=True, eq=False)
class Whitening:
    """W = (I - M T M^T) / a, which makes a push's residuals independent with unit variance.

    Attributes:
        std: a, m.
        inputs: (3K, 5) M, the residuals' derivatives by the inputs, in standard deviations, over a.
        inner: (5, 5) T = 1 / (r (r + 1)) with r = (I + M^T M)^(1/2).
        log_determinant: half log det Sigma, Sigma^-1 = W².
    """

    std: float
    inputs: Array
    inner: Array
    log_determinant: float

    def apply(self, values: Array) -> Array:
        """W times (3K,) or (3K, p)."""
        return np.asarray(
            (values - self.inputs @ (self.inner @ (self.inputs.T @ values))) / self.std
        )


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviations at scale one, and the priors on their scales.

    Attributes:
        pose: of a residual (a coordinate of the centroid, or the turn at the radius of gyration),
            m.
        tip: of the pusher's place per axis, m.
        log_contact_friction: of log mu_c from push to push.
        load_shift: of the load's center per axis from push to push, m.
        prior_weight: how many residuals the prior on scale one is worth.
        shift_weight: how many shifts the prior on the shift's scale one is worth.
        discrepancy_weight: how many predicted numbers the prior on a discrepancy of one is worth.
        outlier: a push whose whitened residual is this many standard deviations counts less from
            there on (Huber).
    """

    pose: float = 0.0008
    tip: float = 0.0015
    log_contact_friction: float = 0.3
    load_shift: float = 0.0012
    prior_weight: float = 20.0
    shift_weight: float = 10.0
    discrepancy_weight: float = 1.0
    outlier: float = 0.7

    def calc_covariance(self, input_jacobian: Array, scale: NoiseScale) -> Array:
        """Sigma (3K, 3K), m².

        Args:
            input_jacobian: (3K, 5) residuals by start x, start y (both per m), log mu_c, m, and
                shift of the load's center in x and y (per m).
            scale: s and t.
        """
        rows = len(input_jacobian)
        inputs = input_jacobian * self._calc_stds(scale)
        return (scale.pose * self.pose) ** 2 * np.sqrt(rows / 3) * np.eye(rows) + inputs @ inputs.T

    def make_whitenings(
        self, input_jacobians: Sequence[Array], scale: NoiseScale
    ) -> list[Whitening]:
        """Makes W with W² = Sigma^-1 for many pushes, at the cost of the few inputs rather than of the many rows.

        Args:
            input_jacobians: of each push, as of `calc_covariance`.
            scale: s and t.
        """
        stds, floor = self._calc_stds(scale), scale.pose * self.pose
        std = [floor * (len(J) / 3) ** 0.25 for J in input_jacobians]
        inputs = [J * (stds / one) for J, one in zip(input_jacobians, std, strict=True)]
        size2, V = np.linalg.eigh(np.array([M.T @ M for M in inputs]))
        root = np.sqrt(1 + np.maximum(size2, 0.0))
        inner = (V / (root * (root + 1))[:, None]) @ np.swapaxes(V, 1, 2)
        log_roots = np.log(root).sum(axis=1).tolist()
        return [
            Whitening(a, M, T, len(M) * log(a) + spread)
            for a, M, T, spread in zip(std, inputs, inner, log_roots, strict=True)
        ]

    def calc_scale_loss(self, scale: NoiseScale) -> float:
        """Negative log prior of s and t, but for a constant."""
        return sum(
            weight * float(np.log(value) + 0.5 * value**-2)
            for weight, value in ((self.prior_weight, scale.pose), (self.shift_weight, scale.shift))
        )

    def calc_discrepancy(self, ratios: Array) -> float:
        """kappa, by how much more than said the pushes' last poses differ from what the others predict.

        Args:
            ratios: (P,) squared lengths of the differences over the expected ones, each of POSE
                numbers.
        """
        weight = self.discrepancy_weight
        return sqrt((POSE * float(ratios.sum()) + weight) / (POSE * len(ratios) + weight))

    def calc_freedom(self, pushes: int) -> float:
        """Of Student's t of a predicted number, kappa known from so many pushes; a normal's where there are none."""
        return POSE * pushes + self.discrepancy_weight if pushes else NORMAL

    def scaled(self, scale: NoiseScale) -> "NoiseModel":
        """The same with its deviations times s and t."""
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
        """Huber's loss of a push from its whitened residuals (3K,): -log likelihood but for its normalization."""
        size = _calc_size(whitened)
        squared = size**2 if size <= self.outlier else self.outlier * (2 * size - self.outlier)
        return 0.5 * calc_effective_count(len(whitened)) * squared

    def _calc_stds(self, scale: NoiseScale) -> Array:
        """(5,) of the inputs."""
        noise = self.scaled(scale)
        return np.array(
            [noise.tip, noise.tip, noise.log_contact_friction, noise.load_shift, noise.load_shift]
        )


def calc_effective_count(rows: int) -> float:
    """How many independent residuals a push's 3K count for: 3 K_eff."""
    return 3.0 * sqrt(rows / 3)


def _calc_size(whitened: Array) -> float:
    """Root mean square of the whitened residuals, one where the noise is as large as supposed."""
    return sqrt(float(whitened @ whitened) / calc_effective_count(len(whitened)))

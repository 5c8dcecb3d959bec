"""What the model leaves unexplained, push by push.

A push that is sensitive to where exactly it began says less than one that is not. The covariance of a push's residuals

    Sigma = s² (sigma² K/K_eff I + sigma_tip² J_start J_start^T + sigma_mu² J_mu J_mu^T)

has three sources: the poses' measurement, the pusher's place, and the contact friction's wandering from push to push.
The last two come from the exact Jacobian. The scale s is learned from the data. K observations along one push share
their errors; together they count as K_eff = sqrt(K).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviations at scale one, and how firmly the scale is believed.

    Attributes:
        pose: of a residual (a coordinate of the centroid, or the turn at the radius of gyration), m.
        tip: of the pusher's place per axis, m.
        log_contact_friction: of log mu_c from push to push.
        prior_weight: how many residuals the belief in scale one is worth.
        outlier: a push whose whitened residual is this many standard deviations counts less from there on (Huber).
    """

    pose: float = 0.0008
    tip: float = 0.0015
    log_contact_friction: float = 0.3
    prior_weight: float = 20.0
    outlier: float = 1.0

    def calc_factor(self, input_jacobian: Array, scale: float) -> Array:
        """Lower Cholesky factor (3K, 3K) of Sigma.

        Args:
            input_jacobian: (3K, 3) residuals by start x, start y (both per m) and log mu_c, m.
            scale: s.
        """
        rows = len(input_jacobian)
        count = rows / 3
        inputs = input_jacobian * np.array([self.tip, self.tip, self.log_contact_friction])
        sigma = self.pose**2 * np.sqrt(count) * np.eye(rows) + inputs @ inputs.T
        return scale * np.linalg.cholesky(sigma)

    def calc_weight(self, whitened: Array) -> float:
        """Huber's weight of a push, 1 or less, from its whitened residuals (3K,)."""
        size = _calc_size(whitened)
        return 1.0 if size <= self.outlier else self.outlier / size

    def calc_loss(self, whitened: Array) -> float:
        """Huber's loss of a push from its whitened residuals (3K,): -log likelihood but for its normalisation."""
        size = _calc_size(whitened)
        squared = size**2 if size <= self.outlier else self.outlier * (2 * size - self.outlier)
        return 0.5 * calc_effective_count(len(whitened)) * squared


def calc_effective_count(rows: int) -> float:
    """How many independent residuals a push's 3K count for: 3 K_eff."""
    return 3.0 * float(np.sqrt(rows / 3))


def _calc_size(whitened: Array) -> float:
    """Root mean square of the whitened residuals, one where the noise is as large as supposed."""
    return float(np.sqrt(whitened @ whitened / calc_effective_count(len(whitened))))

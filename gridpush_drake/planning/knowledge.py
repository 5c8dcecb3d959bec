"""What is known of an object's cells, in the form that exploration takes: a normal z and what a push shows of it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.default import DefaultOptions, calc_prior_factor
from gridpush_drake.identification.identify import SMALLEST_CONTACT_FRICTION
from gridpush_drake.identification.noise import NoiseModel
from gridpush_drake.identification.posterior import Posterior
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.smoothness import calc_smooth_covariance
from gridpush_drake.pushes.log import PushLog

Array = NDArray[np.float64]

PRIOR_AMPLITUDE = 1.0
"""Standard deviation of log k before the first poke: a half to twice, or so."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known of an object's cells.

    Attributes:
        obj: the object.
        posterior: of z.
        noise: of what is seen of a push.
        scale: of the noise.
        made: (K, 2) where the finger's centre was as the pushes learned from began, body frame, m.
    """

    obj: GridObject
    posterior: Posterior
    noise: NoiseModel = field(default_factory=NoiseModel)
    scale: float = 1.0
    made: Array = field(default_factory=lambda: np.empty((0, 2)))

    @classmethod
    def of_prior(cls, obj: GridObject, amplitude: float = PRIOR_AMPLITUDE) -> "Knowledge":
        """Before any push: the smoothness prior about uniform friction.

        Args:
            obj: the object.
            amplitude: standard deviation of log k.
        """
        options = DefaultOptions()
        mu_c = max(obj.prior.contact_friction, SMALLEST_CONTACT_FRICTION)
        C = calc_smooth_covariance(obj, options.range_cells)
        A = calc_prior_factor(C, amplitude, obj.prior.contact_friction_std / mu_c)
        start = CellParameters.uniform(obj)
        z = np.append(np.log(start.mass * start.friction), np.log(mu_c))
        return cls(obj, Posterior(z, A @ A.T, A @ A.T), options.noise)

    @classmethod
    def of_identification(
        cls, found: Identification, log: PushLog | None = None, noise: NoiseModel | None = None
    ) -> "Knowledge":
        """After pushes; the noise is as large as they said.

        Args:
            found: the model with its posterior.
            log: the pushes, so that they are not repeated.
            noise: that it was learned with.
        """
        noise = noise or NoiseModel()
        made = [turn_back(seen.push.start - seen.pose[:2], seen.pose[2]) for seen in log or ()]
        return cls(found.obj, found.posterior, noise, found.noise_std / noise.pose, np.array(made).reshape(-1, 2))

    @property
    def params(self) -> CellParameters:
        """The cells' parameters at the mean, every friction that of the prior."""
        z, mu = self.posterior.mean, self.obj.prior.friction
        return CellParameters(np.exp(z[:-1]) / mu, np.full(self.obj.n, mu), float(np.exp(z[-1])))


def turn_back(vector: Array, angle: float) -> Array:
    """A vector (2,) in W as a body at the angle (rad) sees it."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] + s * vector[1], -s * vector[0] + c * vector[1]])

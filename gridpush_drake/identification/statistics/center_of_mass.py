"""What is known of the center of mass before any push, and what friction makes of it."""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.statistics.posterior import calc_center_jacobian, calc_fraction
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior

FRICTION_STD = 0.2
"""Standard deviation of log mu from cell to cell. Where the bounds of an object's friction allow
less, it is what they allow."""

MIN_CENTER_STD = 1e-4
"""Smallest standard deviation of a given center of mass, m. A smaller one is raised to it, for with
a sharper one the fit's equations are singular."""


@dataclass(frozen=True)
class CenterOfMass:
    """Where the center of mass is held to be, and how far from it the center of friction may be.

    Friction differs from place to place. Where loads x_i rest on frictions mu_i that scatter by
    themselves, the center of friction scatters about the center of mass with the covariance
    sigma_mu² sum_i x_i² (p_i - c) (p_i - c)^T: a body on three feet far apart by a lot, one that
    rests evenly by little.

    Attributes:
        at: (2,) body frame, m.
        std: standard deviation per axis, m.
        friction_std: standard deviation of log mu from cell to cell, each by itself.
    """

    at: tuple[float, float]
    std: float
    friction_std: float = 0.0

    @classmethod
    def of_prior(cls, prior: PhysicalPrior) -> "CenterOfMass | None":
        """Reads it from what is told of an object; None where no center of mass is told.

        Frictions scatter no more than their bounds allow.
        """
        if prior.center_of_mass is None:
            return None
        return cls(
            at=prior.center_of_mass,
            std=max(prior.center_of_mass_std, MIN_CENTER_STD),
            friction_std=min(FRICTION_STD, prior.log_friction_std),
        )

    def make_whitening(self, obj: GridObject, z: Array) -> tuple[Array, float]:
        """Makes W_c, which whitens the center of friction's distance from `at`.

        Args:
            obj: the object.
            z: (n+1,) where the scatter is taken.

        Returns:
            W_c (2, 2), 1/m, and -log det W_c.
        """
        fraction = calc_fraction(z)
        center = fraction @ obj.p_BC
        arm = fraction[:, None] * (obj.p_BC - center)
        # Section 4: (W_c^T W_c)^-1 = sigma_c0² I + sigma_mu² sum_i x_i² (p_i - c) (p_i - c)^T.
        covariance = self.std**2 * np.eye(2) + self.friction_std**2 * (arm.T @ arm)
        L = np.linalg.cholesky(covariance)
        return np.linalg.inv(L), float(np.log(np.diag(L)).sum())

    def linearize(self, obj: GridObject, z: Array, whitening: Array) -> tuple[Array, Array]:
        """Whitened residual (2,) of the center of friction at z (n+1,), and its Jacobian (2, n+1).

        The whitening is taken as a constant: its own derivative by z is left out.
        """
        fraction = calc_fraction(z)
        residual = whitening @ (fraction @ obj.p_BC - self.at)
        J = whitening @ calc_center_jacobian(fraction, obj.p_BC)
        return residual, J

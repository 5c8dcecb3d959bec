"""Friction that changes along an object, so that its center of mass is not its center of friction.

Pushes on the table show how the loads k_i = mu_i m_i lie. Over the table's edge loads shift about
the center of mass, and where that is depends on how friction is spread. What is not known of it is
taken for an even change along the object, of g = (g_x, g_y) in log mu per radius of gyration rho:

    log mu_i -> log mu_i + g·(p_i - p_c) / rho,    m_i = k_i / mu_i,    g ~ N(0, s² I)

with p_c the cells' centroid. Beforehand s is as much as the bounds of the friction allow, and at
most `FRICTION_GRADIENT`; weighings make it less (`docs/theory/identification.md`, section 11).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters

FRICTION_GRADIENT = 0.3
"""Greatest standard deviation s that is supposed beforehand. It lets the center of mass be
elsewhere than the center of friction."""


@dataclass(frozen=True, eq=False)
class HeldFriction:
    """Frictions of an object's cells, as weighings tell them, and how surely.

    Attributes:
        coefficients: (n,) mu_i.
        gradient_std: s, what weighings leave of it.
    """

    coefficients: Array
    gradient_std: float = 0.0


def calc_gradient_std(prior: PhysicalPrior) -> float:
    """Calculates s, the standard deviation of the gradient of log mu, from the friction's bounds.

    A friction that is anywhere between them, evenly in its logarithm, has a standard deviation of
    log(greatest / least) / sqrt(12). If the center of mass was told, it is 0.
    """
    if prior.center_of_mass is not None:
        return 0.0
    return min(FRICTION_GRADIENT, prior.log_friction_std)


def calc_arms(obj: GridObject) -> Array:
    """(n, 2) by how much log mu_i changes per unit of g: (p_i - p_c) / rho."""
    return np.asarray((obj.p_BC - obj.p_BC.mean(axis=0)) / obj.radius_of_gyration)


def draw_gradients(
    obj: GridObject, models: Sequence[CellParameters], std: float, seed: int
) -> list[CellParameters]:
    """Gives each of some models another gradient of friction, with the same loads mu_i m_i.

    Args:
        obj: the object.
        models: parameters, such as draws from a posterior.
        std: s.
        seed: of the gradients.

    Returns:
        The models, each with its total mass as before; themselves where s is zero.
    """
    if std <= 0:
        return list(models)
    rng = np.random.default_rng((seed, len(models)))
    gradients = std * rng.standard_normal((len(models), 2))
    factors = np.exp(gradients @ calc_arms(obj).T)
    return [_scale_friction(one, by) for one, by in zip(models, factors, strict=True)]


def _scale_friction(params: CellParameters, factor: Array) -> CellParameters:
    """Multiplies the frictions by (n,) factors and divides the masses, but for their sum."""
    mass = params.mass / factor
    scale = params.total_mass / float(mass.sum())
    return replace(params, mass=scale * mass, friction=params.friction * factor / scale)

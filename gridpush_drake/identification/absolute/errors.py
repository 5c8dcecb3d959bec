"""How far an estimate of mass, center of mass and friction is from a truth that somebody knows.

It is for judges: benchmarks, campaigns and tests. The estimate itself is in `absolute`.
"""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.identification.absolute.estimate import AbsoluteEstimate
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

CHI_SQUARE = 5.991
"""95 % quantile of a chi square with two degrees of freedom."""


@dataclass(frozen=True)
class AbsoluteErrors:
    """Errors of an estimate, and whether its regions of 95 % hold the truth.

    Attributes:
        mass: error of the mass, relative to the true one.
        center: distance of the center of mass from the true one, m.
        friction: error of the mean friction coefficient.
        mass_holds: whether the interval of the mass holds it.
        center_holds: whether the region of the center of mass holds it.
        friction_holds: whether the interval of the mean friction holds it.
    """

    mass: float
    center: float
    friction: float
    mass_holds: bool
    center_holds: bool
    friction_holds: bool


def compare_with_truth(
    absolute: AbsoluteEstimate, obj: GridObject, truth: CellParameters
) -> AbsoluteErrors:
    """Compares an estimate with the truth.

    Args:
        absolute: the estimate.
        obj: the object, whose body frame the center of mass is in.
        truth: the true masses and frictions of its cells.
    """
    mass = float(truth.total_mass)
    friction = float(truth.mass @ truth.friction) / mass
    off = absolute.center_of_mass - truth.center_of_mass(obj)
    distance = float(off @ np.linalg.solve(absolute.center_covariance, off))
    low, high = absolute.mass_interval
    least, most = absolute.friction_interval
    return AbsoluteErrors(
        mass=absolute.total_mass / mass - 1,
        center=float(np.linalg.norm(off)),
        friction=absolute.friction - friction,
        mass_holds=low <= mass <= high,
        center_holds=distance <= CHI_SQUARE,
        friction_holds=least <= friction <= most,
    )

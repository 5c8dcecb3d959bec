"""What pushes can tell, and what they cannot (`design/physics.md`, section 6).

Slow pushes observed by their poses see only the relative support friction k_i = mu_i m_i / sum(mu m), and of it only
the combinations that the pushes excited. Mass and friction by themselves need a weight, a measured force, a fast push,
or bounds: with mu_min <= mu_i <= mu_max every mass distribution k_i/mu_max <= m_i/c <= k_i/mu_min agrees with the data.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.posterior import Posterior

Array = NDArray[np.float64]

KNOWN_SHARE = 0.5
"""A combination, or a cell, counts as learned where the pushes took away at least this share of its prior variance."""


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What the data determine.

    Attributes:
        relative_friction: (n,) k, summing to one.
        relative_friction_std: (n,) its standard deviation.
        centre_of_friction: (2,) sum k_i p_BC_i, m, body frame.
        centre_of_friction_covariance: (2, 2) m².
        learned_directions: how many independent combinations of the cells' log-friction the pushes determined.
        null_space: (n - learned_directions, n) orthonormal basis (in units of the prior's spread) of those they did not;
            its first row is the common scale, which no slow push shows.
        learned_share: (n,) share of each cell's prior variance that the pushes took away, 0 to 1.
        mass_min: (n,) kg, the least mass each cell may have, given the friction bounds and the total mass.
        mass_max: (n,) kg, the greatest.
        centre_of_mass_box: (2, 2) rows min and max of the centres of mass that agree with k and the bounds, m.
        statements: the same in sentences, for a report.
    """

    relative_friction: Array
    relative_friction_std: Array
    centre_of_friction: Array
    centre_of_friction_covariance: Array
    learned_directions: int
    null_space: Array
    learned_share: Array
    mass_min: Array
    mass_max: Array
    centre_of_mass_box: Array
    statements: tuple[str, ...]

"""The centre of mass of an identified object, and its spread.

With z = (log k, log mu_c) and the cells' frictions mu_i held, m_i is proportional to k_i/mu_i = exp(z_i)/mu_i, and

    c = sum_i a_i p_i,    a_i = m_i / sum m,    dc/dz_i = a_i (p_i - c),    Cov c = (dc/dz) Cov z (dc/dz)^T

to first order. What the frictions themselves may be is left out: see `Identifiability.centre_of_mass_box`.
"""

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.identification.result import Identification

Array = NDArray[np.float64]


def calc_centre_of_mass(found: Identification) -> tuple[Array, Array]:
    """Calculates where the centre of mass is held to be.

    Args:
        found: the identification.

    Returns:
        p_BBcm (2,), m, body frame, and its covariance (2, 2), m².
    """
    centre = found.params.centre_of_mass(found.obj)
    share = found.params.mass / found.params.total_mass
    J = (share[:, None] * (found.obj.p_BC - centre)).T
    return centre, J @ found.posterior.covariance[:-1, :-1] @ J.T

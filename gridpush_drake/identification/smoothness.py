"""The smoothness prior: a Gaussian Markov random field on the logarithm of the cells' friction.

    log k ~ N(log k_prior, a² C),      C^-1 proportional to (L + kappa² I)²,      kappa² = 8 / range²

with L the graph Laplacian of neighbouring cells: the Matérn field of smoothness one on a grid (Lindgren, Rue and
Lindström 2011, section 2). C has unit mean variance; `a`, the amplitude, is the strength that identification chooses.
"""

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.grid.object import GridObject

RANGE_CELLS = 4.0
"""Distance, in cells, at which two cells' log-frictions are nearly independent."""


def calc_smooth_covariance(obj: GridObject, range_cells: float = RANGE_CELLS) -> NDArray[np.float64]:
    """Makes C (n, n), unit mean variance, of the field over the object's cells.

    Args:
        obj: the object.
        range_cells: correlation range, cells.

    Returns:
        The covariance.
    """
    i, j = obj.adjacency.T
    L = np.zeros((obj.n, obj.n))
    np.add.at(L, (i, i), 1.0)
    np.add.at(L, (j, j), 1.0)
    L[i, j] = L[j, i] = -1.0
    root = np.linalg.inv(L + 8.0 / range_cells**2 * np.eye(obj.n))
    C = root @ root
    return C / np.diag(C).mean()

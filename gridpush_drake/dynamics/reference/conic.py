"""Clarabel, an interior point solver of cone programs, with the settings of the reference forms."""

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from gridpush_drake.errors import SimulationError

CONIC_TOLERANCE = 1e-13
"""Clarabel's relative and absolute tolerance, on problems scaled to one."""

USABLE = ("Solved", "AlmostSolved", "InsufficientProgress")
"""Statuses whose point is near enough to be refined; the caller verifies what it makes of it."""


def solve_conic(
    P: csc_array, q: NDArray[np.float64], A: csc_array, cones: list[object]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Solves  min x·P x/2 + q·x  s.t.  -A x in the cones.

    Args:
        P: (k, k) upper triangle of the Hessian.
        q: (k,) linear cost.
        A: (r, k) constraints.
        cones: Clarabel's cones, r rows in all.

    Returns:
        x (k,) and the duals z (r,).

    Raises:
        SimulationError: the solver stopped short.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = settings.tol_ktratio = CONIC_TOLERANCE
    solution = clarabel.DefaultSolver(P, q, A, np.zeros(A.shape[0]), cones, settings).solve()
    if str(solution.status) not in USABLE:
        raise SimulationError(f"Clarabel stopped with {solution.status}")
    return np.array(solution.x), np.array(solution.z)

"""Reference solvers of the maximal LCP: as an LCP and as a QP.

The LCP is the KKT system of a convex QP, so its velocities are unique and two unrelated solvers must agree on them:

    min 1/2 |xdot - xdot_t|²_M - dt F·xdot + sum_j bound_j max(0, -(J_f xdot)_j)    s.t.  J_e xdot = 0

Both are slow and exact; the compiled kernel is what simulations run on.
"""

from collections.abc import Callable
from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csc_array, csr_array, diags_array, eye_array, vstack

from gridpush_drake.dynamics.reference.conic import solve_conic
from gridpush_drake.dynamics.reference.isotropic_socp import solve_isotropic_socp
from gridpush_drake.dynamics.reference.maximal_kkt import (
    KktResiduals,
    NormalizedLcp,
    calc_residuals,
    normalize,
    project,
)
from gridpush_drake.dynamics.reference.maximal_lcp import MaximalLcp
from gridpush_drake.errors import SimulationError

__all__ = ["LcpSolution", "LcpSolver", "solve_as_lcp", "solve_as_qp", "solve_isotropic_socp"]

SIGN_TOLERANCE = 1e-11
"""Violation of a sign, in the dimensionless LCP, that counts as a wrong active set."""

MAX_ACTIVE_SETS = 600
"""Active sets to try before giving up."""

STICK, SLIDE, REVERSE = 0, 1, 2

LcpSolver = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
"""Solves 0 <= z ⟂ M z + q >= 0 for (M, q)."""


@dataclass(frozen=True, eq=False)
class LcpSolution:
    """A solution of the maximal LCP.

    Attributes:
        xdot: (3n,) velocities after the step, rad/s and m/s; unique.
        lam_e: (3k,) rigidity impulses, N m s and N s.
        lam_f: (2n,) friction impulses, N s then N m s; where several rows stick they are not unique.
        gamma: (2n,) speeds of what slides and spins, m/s then rad/s.
        residuals: how well every line of the LCP holds.
    """

    xdot: NDArray[np.float64]
    lam_e: NDArray[np.float64]
    lam_f: NDArray[np.float64]
    gamma: NDArray[np.float64]
    residuals: KktResiduals


def solve_as_lcp(lcp: MaximalLcp, lcp_solver: LcpSolver) -> LcpSolution:
    """Eliminates xdot and lam_e and solves the LCP in (s, gamma) that is left.

    With P the projector onto the null space of C, y = h + P G^T s and

        0 <= [s; gamma]  ⟂  [[G P G^T, 1], [-1, 0]] [s; gamma] + [G h; 1] >= 0.

    Args:
        lcp: the LCP.
        lcp_solver: a solver of dense LCPs, Lemke's for instance.

    Returns:
        The solution; as good as `lcp_solver` is, see its residuals.
    """
    unit = normalize(lcp)
    k = len(unit.rows)
    G = unit.G.toarray()
    P_GT, _ = project(unit.C, G.T)
    one, zero = np.eye(k), np.zeros((k, k))
    z = np.zeros(0)
    if k:
        z = lcp_solver(np.block([[G @ P_GT, one], [-one, zero]]), np.concatenate([G @ unit.h, np.ones(k)]))
    y, lam = project(unit.C, unit.h + G.T @ z[:k])
    return _restore(lcp, unit, y, lam, z[:k], z[k:])


def solve_as_qp(lcp: MaximalLcp) -> LcpSolution:
    """Solves the convex QP with an interior point method, then the equations of its active set exactly.

    Every friction row slides (s = 1), sticks (G y = 0) or is carried backwards (s = 0). The interior point solution
    tells which; y and the multipliers then solve linear equations, whose signs are verified. Where one is wrong the
    active set method for the dual (a QP in 0 <= s <= 1) takes over: s goes towards the equations' solution up to the
    first bound, whose row is held there; when none is in the way the row that moves against its state is released.

    Args:
        lcp: the LCP.

    Returns:
        The solution, to round-off.

    Raises:
        SimulationError: the interior point method failed, or no active set has the right signs.
    """
    unit = normalize(lcp)
    y, lam, s, slack = _interior_point(unit)
    fastest = np.abs(unit.G @ unit.h).max(initial=0.0) or 1.0
    state = np.where(s < (unit.G @ y + slack) / fastest, REVERSE, np.where(1 - s < slack / fastest, SLIDE, STICK))
    s = np.clip(s, 0, 1)
    for _ in range(MAX_ACTIVE_SETS):
        y, lam, target = _solve_active_set(unit, state, lam, s)
        beyond = (state == STICK) & (np.maximum(target - 1, -target) > SIGN_TOLERANCE)
        if beyond.any():
            share = np.full(len(s), np.inf)
            share[beyond] = (np.where(target > 1, 1.0, 0.0) - s)[beyond] / (target - s)[beyond]
            first = share.argmin()
            state[first] = SLIDE if target[first] > 1 else REVERSE
            s = np.clip(s + share[first] * (target - s), 0, 1)
            continue
        s, along = target, unit.G @ y
        wrong = np.choose(state, [np.zeros(len(s)), along, -along])
        if not (wrong > SIGN_TOLERANCE * fastest).any():
            return _restore(lcp, unit, y, lam, s, np.where(state == SLIDE, np.maximum(0, -along), 0.0))
        state[wrong.argmax()] = STICK
    raise SimulationError(f"the friction QP of {lcp.n} cells found no active set with the right signs")


def _restore(
    lcp: MaximalLcp,
    unit: NormalizedLcp,
    y: NDArray[np.float64],
    lam: NDArray[np.float64],
    s: NDArray[np.float64],
    slack: NDArray[np.float64],
) -> LcpSolution:
    """Gives the dimensionless solution its units back; rows left out slide freely, lam_f = 0."""
    xdot = unit.e * y / unit.root_mass
    lam_e = -unit.e * (unit.lam_0 + lam) / unit.norm
    lam_f, gamma = np.zeros(2 * lcp.n), np.maximum(0.0, -(lcp.J_f @ xdot))
    lam_f[unit.rows] = lcp.bound[unit.rows] * s
    gamma[unit.rows] = unit.e**2 * slack / lcp.bound[unit.rows]
    return LcpSolution(xdot, lam_e, lam_f, gamma, calc_residuals(lcp, xdot, lam_e, lam_f, gamma))


def _interior_point(
    unit: NormalizedLcp,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Solves for y, lam, s, t:  min 1/2 |y|² - h·y + sum t  s.t.  C y = 0 (lam), t >= 0 (1 - s), t + G y >= 0 (s)."""
    k, N = unit.G.shape
    E, m = unit.C.shape[0], unit.C.shape[0] + k
    A = block_array([[unit.C, csr_array((E, k))], [csr_array((k, N)), -eye_array(k)], [-unit.G, -eye_array(k)]])
    P = diags_array(np.concatenate([np.ones(N), np.zeros(k)]))
    x, z = solve_conic(
        csc_array(P),
        np.concatenate([-unit.h, np.ones(k)]),
        csc_array(A),
        [clarabel.ZeroConeT(E), clarabel.NonnegativeConeT(2 * k)],
    )
    return x[:N], z[:E], z[m:], x[N:]


def _solve_active_set(
    unit: NormalizedLcp, state: NDArray[np.int64], lam: NDArray[np.float64], s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Solves for y, lam and s with s = 1 where rows slide, 0 where they are reversed, G y = 0 where they stick."""
    sticks = state == STICK
    G_s = unit.G[sticks]
    length = np.sqrt((G_s * G_s).sum(axis=1))
    C = csr_array(vstack([unit.C, -(diags_array(1 / length) @ G_s)])) if sticks.any() else unit.C
    start = np.concatenate([lam, np.clip(s[sticks], 0, 1) * length])
    s = np.where(state == SLIDE, 1.0, 0.0)
    y, lam = project(C, unit.h + unit.G.T @ s, start)
    s[sticks] = lam[len(unit.norm) :] / length
    return y, lam[: len(unit.norm)], s

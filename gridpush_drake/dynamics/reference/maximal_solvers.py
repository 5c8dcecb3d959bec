"""Reference solvers of the maximal LCP: as an LCP and as a QP. Both are slow and exact.

The LCP is the KKT system of a convex QP, so its velocities are unique and two unrelated solvers
must agree on them:

    min 1/2 |xdot - xdot_t|²_M - dt F·xdot + sum_j bound_j max(0, -(J_f xdot)_j)
    s.t.  J_e xdot = 0

They share a dimensionless form, an exact linear solve, and the residuals. With e the largest entry
of the momentum without friction, y = M^(1/2) xdot / e and lam_f = D(bound) s, the LCP reads

    y - h + C^T lam - G^T s = 0,    e (h + C^T lam_0) = M^(-1/2) (M xdot_t + dt F),   C h = 0
    C y = 0,                        C = N J_e M^(-1/2), rows of unit length
    0 <= G y + gamma ⟂ s >= 0,      G = D(bound) J_f M^(-1/2) / e
    0 <= 1 - s ⟂ gamma >= 0

(here gamma stands for D(bound) gamma / e²). Rows of J_f that are zero or whose bound is zero carry
no friction and are left out.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from scipy.sparse import block_array, csc_array, csr_array, diags_array, eye_array, vstack
from scipy.sparse.linalg import splu

from gridpush_drake.dynamics.reference.isotropic_socp import solve_conic, solve_isotropic_socp
from gridpush_drake.dynamics.reference.maximal_lcp import MaximalLcp
from gridpush_drake.errors import SimulationError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array, IntArray

clarabel = import_extra("clarabel", "reference")

PROXIMAL_WEIGHT = 1e-12
"""Weight delta in `project`, which makes redundant rows of C harmless. Its effect is iterated
away."""

MAX_REFINEMENTS = 40
"""Largest number of refinements of a linear solution."""

ROUND_OFF = 1e-15
"""Relative residual at which refinement stops."""

NEAR_ROUND_OFF = 1e3
"""Multiple of `ROUND_OFF` below which refinement stops once the residual halves no more."""


@dataclass(frozen=True, eq=False)
class NormalizedLcp:
    """The LCP without units (see the module's docstring).

    Attributes:
        root_mass: (3n,) M^(1/2).
        e: the momentum scale, (N s)/kg^(1/2).
        rows: indices of the friction rows that are kept, (k,).
        h: (3n,) momentum without friction, that of a rigid motion.
        lam_0: multipliers of rigidity without friction.
        C: (3(n-1) or more, 3n) rigidity.
        norm: lengths of J_e M^(-1/2)'s rows.
        G: (k, 3n) friction.
    """

    root_mass: Array
    e: float
    rows: IntArray
    h: Array
    lam_0: Array
    C: csr_array
    norm: Array
    G: csr_array


@dataclass(frozen=True)
class KktResiduals:
    """How well each line of the LCP holds.

    Each figure is the largest violation, as a fraction of the problem's own scale.

    Impulses are measured by P, the largest cell's m |v_t| + dt |F| + bound; velocities by V, the
    same of the whole body over its mass; moments and yaw rates by P s and V / s, s the cell size;
    products by P V.

    Attributes:
        momentum: |M (xdot - xdot_t) - dt F - J_e^T lam_e - J_f^T lam_f|.
        rigidity: |J_e xdot|.
        rho: max(0, -rho), rho = J_f xdot + gamma.
        lam_f: max(0, -lam_f).
        xi: max(0, -xi), xi = bound - lam_f.
        gamma: max(0, -gamma).
        rho_lam_f: |rho lam_f|.
        xi_gamma: |xi gamma|.
    """

    momentum: float
    rigidity: float
    rho: float
    lam_f: float
    xi: float
    gamma: float
    rho_lam_f: float
    xi_gamma: float

    @property
    def worst(self) -> float:
        """The largest of them."""
        return max(getattr(self, field.name) for field in fields(self))


def normalize(lcp: MaximalLcp) -> NormalizedLcp:
    """Takes the units out of the LCP; the equations are at the head of this module."""
    root_mass = np.sqrt(lcp.M)
    per_root_mass = diags_array(1 / root_mass)
    rows = np.flatnonzero((lcp.bound > 0) & (abs(lcp.J_f).sum(axis=1) > 0))
    C = csr_array(lcp.J_e @ per_root_mass)
    norm = np.sqrt((C * C).sum(axis=1))
    C = csr_array(diags_array(1 / norm) @ C)
    h, lam_0 = project(C, (lcp.M * lcp.xdot + lcp.dt * lcp.F) / root_mass)
    e = np.abs(h).max() or 1.0
    G = csr_array(diags_array(lcp.bound[rows] / e) @ lcp.J_f[rows] @ per_root_mass)
    return NormalizedLcp(
        root_mass=root_mass,
        e=e,
        rows=rows,
        h=h / e,
        lam_0=lam_0 / e,
        C=C,
        norm=norm,
        G=G,
    )


def project(C: csr_array, r: Array, lam: Array | None = None) -> tuple[Array, Array]:
    """Solves y + C^T lam = r, C y = 0.

    y is r (N,) or (N, j), projected onto the null space of C (k, N).

    The proximal method of multipliers, [[1, C^T], [C, -delta]] [dy; dlam] = residual, repeated down
    to round-off: one sparse factorization that does not mind redundant rows. Where those leave lam
    open the result stays next to the lam that it started from, zero where not given.
    """
    k, N = C.shape
    y = np.zeros_like(r)
    lam = np.zeros((k,) + r.shape[1:]) if lam is None else lam.copy()
    if not k or not r.size:
        return r.copy(), lam
    matrix = block_array([[eye_array(N), C.T], [C, -PROXIMAL_WEIGHT * eye_array(k)]])
    factor = splu(matrix.tocsc())
    best = np.inf
    goal = ROUND_OFF * np.abs(r).max(initial=0.0)
    for _ in range(MAX_REFINEMENTS):
        residual = np.concatenate([r - y - C.T @ lam, -(C @ y)])
        size = np.abs(residual).max()
        if size <= goal or (best < NEAR_ROUND_OFF * goal and size > best / 2):
            break
        best = min(best, size)
        step = factor.solve(residual)
        y = y + step[:N]
        lam = lam + step[N:]
    return y, lam


def calc_residuals(
    lcp: MaximalLcp,
    xdot: Array,
    lam_e: Array,
    lam_f: Array,
    gamma: Array,
) -> KktResiduals:
    """Evaluates every line of the LCP for velocities (3n,), impulses, and speeds gamma (2n,)."""
    # Moments over s are forces, and yaw rates times s are speeds.
    n = lcp.n
    s = lcp.cell_size
    length = np.tile([s, 1.0, 1.0], n)
    length_f = np.repeat([1.0, s], n)
    length_e = np.tile([s, 1.0, 1.0], len(lam_e) // 3)

    # The scales P and V; 1 where nothing moves and nothing acts.
    b = (lcp.bound / length_f).reshape(2, n).sum(axis=0)
    acting = (np.abs(lcp.M * lcp.xdot) + np.abs(lcp.dt * lcp.F)) / length
    impulses = acting.reshape(n, 3).sum(axis=1) + b
    V = impulses.sum() / lcp.mass.sum() or 1.0
    P = impulses.max() or 1.0

    rho = lcp.J_f @ xdot + gamma
    xi = lcp.bound - lam_f
    momentum = lcp.M * (xdot - lcp.xdot) - lcp.dt * lcp.F - lcp.J_e.T @ lam_e - lcp.J_f.T @ lam_f

    def largest(value: Array) -> float:
        """Largest magnitude; zero of nothing."""
        return float(np.abs(value).max(initial=0.0))

    return KktResiduals(
        momentum=largest(momentum / length) / P,
        rigidity=largest((lcp.J_e @ xdot) * length_e) / V,
        rho=largest(np.minimum(rho, 0) * length_f) / V,
        lam_f=largest(np.minimum(lam_f, 0) / length_f) / P,
        xi=largest(np.minimum(xi, 0) / length_f) / P,
        gamma=largest(np.minimum(gamma, 0) * length_f) / V,
        rho_lam_f=largest(rho * lam_f) / (P * V),
        xi_gamma=largest(xi * gamma) / (P * V),
    )


__all__ = ["LcpSolution", "LcpSolver", "solve_as_lcp", "solve_as_qp", "solve_isotropic_socp"]

SIGN_TOLERANCE = 1e-11
"""Violation of a sign, in the dimensionless LCP, that counts as a wrong active set."""

MAX_ACTIVE_SETS = 600
"""Largest number of active sets that are tried."""

STICKING_ROW = 0
"""State of a friction row that does not move."""

SLIDING_ROW = 1
"""State of a friction row that moves against its friction, which is at its bound."""

REVERSED_ROW = 2
"""State of a friction row that is carried backwards, without friction."""

LcpSolver = Callable[[Array, Array], Array]
"""Solves 0 <= z ⟂ M z + q >= 0 for (M, q)."""


@dataclass(frozen=True, eq=False)
class LcpSolution:
    """A solution of the maximal LCP.

    Attributes:
        xdot: (3n,) velocities after the step, rad/s and m/s; unique.
        lam_e: (3k,) rigidity impulses, N m s and N s.
        lam_f: (2n,) friction impulses, N s then N m s; where several rows stick they are not
            unique.
        gamma: (2n,) speeds of what slides and spins, m/s then rad/s.
        residuals: how well every line of the LCP holds.
    """

    xdot: Array
    lam_e: Array
    lam_f: Array
    gamma: Array
    residuals: KktResiduals


def solve_as_lcp(lcp: MaximalLcp, lcp_solver: LcpSolver) -> LcpSolution:
    """Eliminates xdot and lam_e, and solves the dense LCP in (s, gamma) that is left.

    With P the projector onto the null space of C, y = h + P G^T s and

        0 <= [s; gamma]  ⟂  [[G P G^T, 1], [-1, 0]] [s; gamma] + [G h; 1] >= 0.

    The solution is as good as that solver is, see its residuals.
    """
    unit = normalize(lcp)
    k = len(unit.rows)
    G = unit.G.toarray()
    P_GT, _ = project(unit.C, G.T)
    one = np.eye(k)
    zero = np.zeros((k, k))
    z = np.zeros(0)
    if k:
        M = np.block([[G @ P_GT, one], [-one, zero]])
        q = np.concatenate([G @ unit.h, np.ones(k)])
        z = lcp_solver(M, q)
    y, lam = project(unit.C, unit.h + G.T @ z[:k])
    return _restore(lcp, unit, y, lam, z[:k], z[k:])


def solve_as_qp(lcp: MaximalLcp) -> LcpSolution:
    """Solves the convex QP by an interior point method, then its active set's equations exactly.

    Every friction row slides (s = 1), sticks (G y = 0) or is carried backwards (s = 0). The
    interior point solution tells which; y and the multipliers then solve linear equations, whose
    signs are verified. Where one is wrong the active set method for the dual (a QP in 0 <= s <= 1)
    takes over: s goes towards the equations' solution up to the first bound, whose row is held
    there; when none is in the way the row that moves against its state is released.

    Raises:
        SimulationError: the interior point method failed, or no active set has the right signs.
    """
    unit = normalize(lcp)
    y, lam, s, slack = _interior_point(unit)

    # Of each complementary pair the interior point has one much smaller than the other.
    fastest = np.abs(unit.G @ unit.h).max(initial=0.0) or 1.0
    slides_or_sticks = np.where(1 - s < slack / fastest, SLIDING_ROW, STICKING_ROW)
    state = np.where(s < (unit.G @ y + slack) / fastest, REVERSED_ROW, slides_or_sticks)
    s = np.clip(s, 0, 1)
    for _ in range(MAX_ACTIVE_SETS):
        y, lam, target = _solve_active_set(unit, state, lam, s)
        # Rows that stick must be within their bounds. The first that leaves them is held there.
        beyond = (state == STICKING_ROW) & (np.maximum(target - 1, -target) > SIGN_TOLERANCE)
        if beyond.any():
            fraction = np.full(len(s), np.inf)
            reached = np.where(target > 1, 1.0, 0.0)
            fraction[beyond] = (reached - s)[beyond] / (target - s)[beyond]
            first = fraction.argmin()
            state[first] = SLIDING_ROW if target[first] > 1 else REVERSED_ROW
            s = np.clip(s + fraction[first] * (target - s), 0, 1)
            continue
        # Rows that slide must move against their friction, reversed ones with it.
        s = target
        along = unit.G @ y
        wrong = np.choose(state, [np.zeros(len(s)), along, -along])
        if not (wrong > SIGN_TOLERANCE * fastest).any():
            slack = np.where(state == SLIDING_ROW, np.maximum(0, -along), 0.0)
            return _restore(lcp, unit, y, lam, s, slack)
        state[wrong.argmax()] = STICKING_ROW
    raise SimulationError(
        f"the friction QP of {lcp.n} cells found no active set with the right signs"
    )


def _restore(
    lcp: MaximalLcp,
    unit: NormalizedLcp,
    y: Array,
    lam: Array,
    s: Array,
    slack: Array,
) -> LcpSolution:
    """Gives the dimensionless solution its units back; rows left out slide freely, lam_f = 0."""
    xdot = unit.e * y / unit.root_mass
    lam_e = -unit.e * (unit.lam_0 + lam) / unit.norm
    lam_f = np.zeros(2 * lcp.n)
    gamma = np.maximum(0.0, -(lcp.J_f @ xdot))
    lam_f[unit.rows] = lcp.bound[unit.rows] * s
    gamma[unit.rows] = unit.e**2 * slack / lcp.bound[unit.rows]
    return LcpSolution(
        xdot=xdot,
        lam_e=lam_e,
        lam_f=lam_f,
        gamma=gamma,
        residuals=calc_residuals(lcp, xdot, lam_e, lam_f, gamma),
    )


def _interior_point(
    unit: NormalizedLcp,
) -> tuple[Array, Array, Array, Array]:
    """Solves a QP for y, t and the multipliers lam, s.

    min 1/2 |y|² - h·y + sum t  s.t.  C y = 0 (lam), t >= 0 (1 - s), t + G y >= 0 (s)
    """
    k, N = unit.G.shape
    E = unit.C.shape[0]
    m = unit.C.shape[0] + k
    A = block_array(
        [
            [unit.C, csr_array((E, k))],
            [csr_array((k, N)), -eye_array(k)],
            [-unit.G, -eye_array(k)],
        ]
    )
    P = diags_array(np.concatenate([np.ones(N), np.zeros(k)]))
    x, z = solve_conic(
        csc_array(P),
        np.concatenate([-unit.h, np.ones(k)]),
        csc_array(A),
        [clarabel.ZeroConeT(E), clarabel.NonnegativeConeT(2 * k)],
    )
    return x[:N], z[:E], z[m:], x[N:]


def _solve_active_set(
    unit: NormalizedLcp, state: IntArray, lam: Array, s: Array
) -> tuple[Array, Array, Array]:
    """Solves for y, lam and s, with s = 1 where rows slide and 0 where they are reversed.

    Where they stick, G y = 0.
    """
    sticks = state == STICKING_ROW
    G_s = unit.G[sticks]
    length = np.sqrt((G_s * G_s).sum(axis=1))
    # The rows that stick are further rows of C.
    C = unit.C
    if sticks.any():
        C = csr_array(vstack([unit.C, -(diags_array(1 / length) @ G_s)]))
    start = np.concatenate([lam, np.clip(s[sticks], 0, 1) * length])
    s = np.where(state == SLIDING_ROW, 1.0, 0.0)
    y, lam = project(C, unit.h + unit.G.T @ s, start)
    s[sticks] = lam[len(unit.norm) :] / length
    return y, lam[: len(unit.norm)], s

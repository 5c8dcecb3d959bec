"""What the two solvers of the maximal LCP share: its dimensionless form, an exact linear solve, and the residuals.

With e the largest entry of the momentum without friction, y = M^(1/2) xdot / e and lam_f = D(bound) s, the LCP reads

    y - h + C^T lam - G^T s = 0,    e (h + C^T lam_0) = M^(-1/2) (M xdot_t + dt F),   C h = 0
    C y = 0,                        C = N J_e M^(-1/2), rows of unit length
    0 <= G y + gamma ⟂ s >= 0,      G = D(bound) J_f M^(-1/2) / e
    0 <= 1 - s ⟂ gamma >= 0

(here gamma stands for D(bound) gamma / e²). Rows of J_f that are zero or whose bound is zero carry no friction and
are left out.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csr_array, diags_array, eye_array
from scipy.sparse.linalg import splu

from gridpush_drake.dynamics.reference.maximal_lcp import MaximalLcp

PROXIMAL_WEIGHT = 1e-12
"""delta of `project`: makes redundant rows of C harmless; its effect is iterated away."""

MAX_REFINEMENTS = 40

ROUND_OFF = 1e-15
"""Relative residual at which refinement stops."""

NEAR_ROUND_OFF = 1e3
"""Multiple of it below which refinement stops once it halves no more."""


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

    root_mass: NDArray[np.float64]
    e: float
    rows: NDArray[np.int64]
    h: NDArray[np.float64]
    lam_0: NDArray[np.float64]
    C: csr_array
    norm: NDArray[np.float64]
    G: csr_array


@dataclass(frozen=True)
class KktResiduals:
    """How well each line of the LCP holds: the largest violation, as a share of the problem's own scale.

    Impulses are measured by P, the largest cell's m |v_t| + dt |F| + bound; velocities by V, the same of the
    whole body over its mass; moments and yaw rates by P s and V / s, s the cell size; products by P V.

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
    """Takes the units out of the LCP.

    Args:
        lcp: the LCP.

    Returns:
        Its dimensionless form.
    """
    root_mass = np.sqrt(lcp.M)
    per_root_mass = diags_array(1 / root_mass)
    rows = np.flatnonzero((lcp.bound > 0) & (abs(lcp.J_f).sum(axis=1) > 0))
    C = csr_array(lcp.J_e @ per_root_mass)
    norm = np.sqrt((C * C).sum(axis=1))
    C = csr_array(diags_array(1 / norm) @ C)
    h, lam_0 = project(C, (lcp.M * lcp.xdot + lcp.dt * lcp.F) / root_mass)
    e = np.abs(h).max() or 1.0
    G = csr_array(diags_array(lcp.bound[rows] / e) @ lcp.J_f[rows] @ per_root_mass)
    return NormalizedLcp(root_mass, e, rows, h / e, lam_0 / e, C, norm, G)


def project(
    C: csr_array, r: NDArray[np.float64], lam: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Solves y + C^T lam = r, C y = 0: y is r projected onto the null space of C.

    The proximal method of multipliers, [[1, C^T], [C, -delta]] [dy; dlam] = residual, repeated down to round-off:
    one sparse factorization that does not mind redundant rows. Where those leave lam open the result stays
    next to the lam that it started from.

    Args:
        C: (k, N) rows, best of unit length.
        r: (N,) or (N, j).
        lam: multipliers to start from; zero where not given.

    Returns:
        y and lam.
    """
    k, N = C.shape
    y = np.zeros_like(r)
    lam = np.zeros((k,) + r.shape[1:]) if lam is None else lam.copy()
    if not k or not r.size:
        return r.copy(), lam
    factor = splu(block_array([[eye_array(N), C.T], [C, -PROXIMAL_WEIGHT * eye_array(k)]]).tocsc())
    best, goal = np.inf, ROUND_OFF * np.abs(r).max(initial=0.0)
    for _ in range(MAX_REFINEMENTS):
        residual = np.concatenate([r - y - C.T @ lam, -(C @ y)])
        size = np.abs(residual).max()
        if size <= goal or (best < NEAR_ROUND_OFF * goal and size > best / 2):
            break
        best = min(best, size)
        step = factor.solve(residual)
        y, lam = y + step[:N], lam + step[N:]
    return y, lam


def calc_residuals(
    lcp: MaximalLcp,
    xdot: NDArray[np.float64],
    lam_e: NDArray[np.float64],
    lam_f: NDArray[np.float64],
    gamma: NDArray[np.float64],
) -> KktResiduals:
    """Evaluates every line of the LCP.

    Args:
        lcp: the LCP.
        xdot: (3n,) velocities after the step, rad/s and m/s.
        lam_e: (3k,) rigidity impulses, N m s and N s.
        lam_f: (2n,) friction impulses, N s and N m s.
        gamma: (2n,) speeds of what slides and spins, m/s and rad/s.

    Returns:
        The residuals.
    """
    n, s = lcp.n, lcp.cell_size
    length = np.tile([s, 1.0, 1.0], n)
    length_f = np.repeat([1.0, s], n)
    length_e = np.tile([s, 1.0, 1.0], len(lam_e) // 3)
    b = (lcp.bound / length_f).reshape(2, n).sum(axis=0)
    P = ((np.abs(lcp.M * lcp.xdot) + np.abs(lcp.dt * lcp.F)) / length).reshape(n, 3).sum(axis=1) + b
    V = P.sum() / lcp.mass.sum() or 1.0
    P = P.max() or 1.0
    rho, xi = lcp.J_f @ xdot + gamma, lcp.bound - lam_f
    momentum = lcp.M * (xdot - lcp.xdot) - lcp.dt * lcp.F - lcp.J_e.T @ lam_e - lcp.J_f.T @ lam_f

    def largest(value: NDArray[np.float64]) -> float:
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

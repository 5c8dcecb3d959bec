"""The paper's closed-form gradient of one step of the maximal LCP.

Song & Boularias, RSS 2020, section V.

The object moves, and pose, xdot_t, F and hence J_e and J_f are constant. Each friction row then
either slides, lam_f = bound, or is carried backwards, lam_f = 0, or sticks, J_f xdot = 0. With C =
[J_e; J_f of sticking rows], D_s = 1 for rows that slide and 0 elsewhere, and xdot the velocity
after the step, differentiate

    M (xdot - xdot_t) - dt F - C^T lam - J_f^T D_s bound = 0,    C xdot = 0:
    M dxdot + dM (xdot - xdot_t) - C^T dlam - J_f^T D_s dbound = 0,    C dxdot = 0.

Solve the first line for dxdot, insert it in the second, and eliminate dlam:

    dxdot = -X11 [dM (xdot - xdot_t) - J_f^T D_s dbound],
    X11 = M^-1 - M^-1 C^T (C M^-1 C^T)^-1 C M^-1.

J_f's rows point against the motion, so more friction slows: -J_f^T is the direction of motion. X11
maps an impulse to the velocity that it gives the rigid body, so with xdot = T nu and M_B = T^T M T,

    X11 = T X_B T^T,
    X_B = M_B^-1                                        where nothing sticks,
    X_B = M_B^-1 - M_B^-1 J^T (J M_B^-1 J^T)^+ J M_B^-1    else, with J = J_f T of sticking rows.

A cell's mass enters M as (s²/6, 1, 1) dm_i and the bounds as dbound/dm_i = bound/m_i; its friction
enters the bounds as (m_i g dt, c s m_i g dt) dmu_i. (The paper writes both as one mu diag(M) of 3n
numbers; friction has 2n rows.)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.friction.friction_law import calc_spin_lever_arm
from gridpush_drake.dynamics.kernels.friction.lagged_friction import SPEED_AT_REST, YAW_RATE_AT_REST
from gridpush_drake.dynamics.reference.maximal_lcp import (
    STANDARD_GRAVITY,
    MaximalLcp,
    twist_to_cells,
)
from gridpush_drake.dynamics.reference.maximal_solvers import LcpSolution
from gridpush_drake.geometry.se2 import Array

AT_BOUND = 1e-9
"""Fraction of the bound within which a friction impulse counts as zero or as at its bound."""

REDUNDANT_ROW_RATIO = 1e-10
"""Relative singular value below which rows of C count as redundant."""


@dataclass(frozen=True, eq=False)
class PaperGradient:
    """Derivatives of the cells' velocities after one step.

    Attributes:
        mass: (3n, n) d xdot / d m_i, (rad/s and m/s)/kg.
        friction: (3n, n) d xdot / d mu_i, rad/s and m/s.
    """

    mass: Array
    friction: Array


def calc_x11(lcp: MaximalLcp, solution: LcpSolution, T: Array | None = None) -> Array:
    """Makes X11 (3n, 3n), from impulses on the cells to the velocities that they cause.

    With T (3n, 3), `twist_to_cells`, by the condensed form T X_B T^T; without it by the paper's
    formula in J_e, O(n³).
    """
    if T is not None:
        return T @ _condensed_x11(lcp, solution, T) @ T.T
    C = np.concatenate([lcp.J_e.toarray(), lcp.J_f.toarray()[_sticks(lcp, solution)]])
    # In M^(-1/2): the projector 1 - A^T (A A^T)^+ A, A = C M^(-1/2), whose rows may be redundant
    root_mass = np.sqrt(lcp.M)
    A = C / root_mass
    A /= np.linalg.norm(A, axis=1, keepdims=True)
    _, size, V_T = np.linalg.svd(A, full_matrices=False)
    V_T = V_T[size > REDUNDANT_ROW_RATIO * size.max(initial=0.0)]
    return (np.eye(3 * lcp.n) - V_T.T @ V_T) / np.outer(root_mass, root_mass)


def calc_paper_gradient(
    lcp: MaximalLcp,
    solution: LcpSolution,
    T: Array | None = None,
    *,
    g: float = STANDARD_GRAVITY,
) -> PaperGradient:
    """Differentiates the velocities after a step by every cell's mass and friction.

    The object must be moving.

    With T (3n, 3), `twist_to_cells`, by the condensed route in O(n²); without it by the explicit
    one in O(n³).
    """
    by_mass, by_friction = _impulse_derivatives(lcp, solution, g)
    if T is None:
        X11 = calc_x11(lcp, solution)
        return PaperGradient(mass=X11 @ by_mass, friction=X11 @ by_friction)
    X_B = _condensed_x11(lcp, solution, T)
    return PaperGradient(
        mass=T @ (X_B @ (T.T @ by_mass)),
        friction=T @ (X_B @ (T.T @ by_friction)),
    )


def calc_paper_loss_gradient(
    lcp: MaximalLcp,
    solution: LcpSolution,
    error: ArrayLike,
    T: Array | None = None,
    *,
    g: float = STANDARD_GRAVITY,
) -> tuple[Array, Array]:
    """Differentiates the paper's loss |x_{t+1} - x*_{t+1}|².

    x_{t+1} = x_t + xdot dt, so dloss/dxdot = 2 dt error.

    Args:
        lcp: the step.
        solution: its solution.
        error: (3n,) x_{t+1} - x*_{t+1} in the cells' order, rad and m; zero where the loss ignores
            an entry.
        T: as in `calc_paper_gradient`.
        g: gravity, m/s².

    Returns:
        dloss/dm (n,), per kg, and dloss/dmu (n,).
    """
    by_mass, by_friction = _impulse_derivatives(lcp, solution, g)
    dloss_dxdot = 2 * lcp.dt * np.asarray(error, dtype=np.float64)
    if T is None:
        adjoint: Array = calc_x11(lcp, solution) @ dloss_dxdot
    else:
        adjoint = T @ (_condensed_x11(lcp, solution, T) @ (T.T @ dloss_dxdot))
    return np.asarray(adjoint @ by_mass), np.asarray(adjoint @ by_friction)


def calc_paper_step_jacobian(
    bodies: Bodies,
    q: ArrayLike,
    nu: ArrayLike,
    nu_next: ArrayLike,
    dt: float,
    g: float = STANDARD_GRAVITY,
) -> tuple[Array, Array]:
    """Calculates the gradient with three unknowns, for use in a rollout: O(n) work.

        dnu'/dm_i  = -M_B^-1 [T_i^T diag(s²/6, 1, 1) T_i (nu' - nu) + mu_i g dt f_i]
        dnu'/dmu_i = -M_B^-1 m_i g dt f_i,      f_i = (d_i, r_i × d_i + c s sgn w)

    with d_i the direction of cell i before the step, or after it where the cell was at rest
    (impending motion). A motion that the step reversed has no friction; a body that the step brings
    to rest stays there, with no derivative.

    Args:
        bodies: one object, with its parameters.
        q: (3,) pose X_WB before the step, m and rad.
        nu: (3,) velocity of B's origin in W, m/s, and yaw rate, rad/s, before the step.
        nu_next: (3,) the same velocity and rate after the step.
        dt: the step, s.
        g: gravity, m/s².

    Returns:
        dnu'/dm (3, n), per kg, and dnu'/dmu (3, n).
    """
    obj = bodies.obj
    params = bodies.params
    nu = np.asarray(nu, dtype=np.float64)
    nu_next = np.asarray(nu_next, dtype=np.float64)
    n = obj.n
    s = obj.cell_size
    m = params.mass
    T = twist_to_cells(obj, q)
    inertia = np.array([s**2 / 6, 1.0, 1.0])
    if abs(nu_next[2]) <= YAW_RATE_AT_REST and np.linalg.norm(nu_next[:2]) <= SPEED_AT_REST:
        return np.zeros((3, n)), np.zeros((3, n))

    # d_i and the sense of spin: by the motion before the step, or after it for what was at rest.
    before = (T @ nu).reshape(n, 3)
    after = (T @ nu_next).reshape(n, 3)
    v = before[:, 1:]
    w = before[:, :1]
    v = np.where(np.linalg.norm(v, axis=1, keepdims=True) > SPEED_AT_REST, v, after[:, 1:])
    w = np.where(np.abs(w) > YAW_RATE_AT_REST, w, after[:, :1])
    speed = np.linalg.norm(v, axis=1, keepdims=True)
    slides = (speed > SPEED_AT_REST) & ((v * after[:, 1:]).sum(axis=1, keepdims=True) > 0)
    spins = (np.abs(w) > YAW_RATE_AT_REST) & (w * after[:, :1] > 0)
    d = np.where(slides, v / np.where(slides, speed, 1.0), 0.0)
    sense = np.where(spins, calc_spin_lever_arm(obj, params) * np.sign(w), 0.0)

    # f_i = T_i^T (c s sgn w, d_i), and T_i^T diag(s²/6, 1, 1) T_i (nu' - nu)
    cells = T.reshape(n, 3, 3)
    f = np.einsum("nij,ni->jn", cells, np.hstack([sense, d]))
    momentum = np.einsum("nij,ni->jn", cells, inertia * (after - before))
    M_B = T.T @ ((m[:, None] * inertia).ravel()[:, None] * T)
    by_mass = momentum + params.friction * g * dt * f
    by_friction = m * g * dt * f
    dnu = np.linalg.solve(M_B, -np.hstack([by_mass, by_friction]))
    return dnu[:, :n], dnu[:, n:]


def _sticks(lcp: MaximalLcp, solution: LcpSolution) -> NDArray[np.bool_]:
    """Finds the friction rows (2n,) that stick: 0 < lam_f < bound."""
    above = solution.lam_f > AT_BOUND * lcp.bound
    below = solution.lam_f < (1 - AT_BOUND) * lcp.bound
    return above & below


def _condensed_x11(lcp: MaximalLcp, solution: LcpSolution, T: Array) -> Array:
    """Makes X_B (3, 3), from impulses on the rigid body to its twist; see the module's head."""
    X_B = np.asarray(np.linalg.inv(T.T @ (lcp.M[:, None] * T)), dtype=np.float64)
    J = lcp.J_f[_sticks(lcp, solution)] @ T
    if not len(J):
        return X_B
    # X_B - X_B J^T (J X_B J^T)^+ J X_B
    X_J = X_B @ J.T
    inverse = np.linalg.pinv(J @ X_J, rcond=REDUNDANT_ROW_RATIO, hermitian=True)
    return np.asarray(X_B - X_J @ inverse @ X_J.T)


def _impulse_derivatives(lcp: MaximalLcp, solution: LcpSolution, g: float) -> tuple[Array, Array]:
    """Makes -[dM (xdot - xdot_t) - J_f^T D_s dbound], a column (3n,) for every dm_i and dmu_i."""
    n = lcp.n
    s = lcp.cell_size
    cell = np.arange(n)
    slides = (lcp.bound > 0) & (solution.lam_f >= (1 - AT_BOUND) * lcp.bound)
    # A row without friction slides, too: more friction would act on it, if it moves along.
    slides |= (lcp.bound == 0) & (solution.gamma > 0)
    J_f = lcp.J_f.toarray() * slides[:, None]
    # dbound/dm_i = bound/m_i, and dbound/dmu_i = m_i g dt for sliding, c s m_i g dt for spin
    load = lcp.mass * g * lcp.dt
    dbound_dm = (lcp.bound / np.tile(lcp.mass, 2)).reshape(2, n)
    dbound_dmu = np.stack([load, lcp.spin_lever_arm * load])
    by_mass = np.zeros((3 * n, n))
    by_friction = np.zeros((3 * n, n))
    for row in range(2):
        J_row = J_f[row * n : (row + 1) * n].T
        by_mass += J_row * dbound_dm[row]
        by_friction += J_row * dbound_dmu[row]
    dM_dm = np.array([s**2 / 6, 1.0, 1.0])
    by_mass.reshape(n, 3, n)[cell, :, cell] -= dM_dm * (solution.xdot - lcp.xdot).reshape(n, 3)
    return by_mass, by_friction

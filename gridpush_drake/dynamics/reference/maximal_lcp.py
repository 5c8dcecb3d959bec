"""The paper's LCP in maximal coordinates: n cells with three velocities each.

Song & Boularias, RSS 2020, Fig. 2.

Given pose, velocities xdot_t, applied force F, masses and frictions, find xdot, lam_e, lam_f, gamma
with

    M (xdot - xdot_t) - dt F - J_e^T lam_e - J_f^T lam_f = 0
    J_e xdot = 0
    rho = J_f xdot + gamma,      0 <= rho ⟂ lam_f >= 0
    xi  = bound - lam_f,         0 <= xi  ⟂ gamma >= 0

Frame W throughout. A cell's velocities are ordered [theta_dot, x_dot, y_dot]. This is the reference
form: sparse, built once a step, and what the condensed step and the closed-form gradient are tested
against.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import minimum_spanning_tree

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.friction.friction_law import calc_spin_lever_arm
from gridpush_drake.dynamics.kernels.friction.lagged_friction import (
    IMPENDING_AT_REST,
    SPEED_AT_REST,
    YAW_RATE_AT_REST,
)
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.objects.grid_object import GridObject

STANDARD_GRAVITY = 9.81
"""Gravity, m/s²."""


@dataclass(frozen=True, eq=False)
class MaximalLcp:
    """The data of one step.

    Attributes:
        M: (3n,) diagonal of the mass matrix, [I_i, m_i, m_i] with I_i = m_i s²/6, kg m² and kg.
        J_e: (3k, 3n) rigidity of k adjacent pairs: equal yaw rate, equal velocity of the point
            shared.
        J_f: (2n, 3n) friction directions, n rows for sliding, then n for spinning.
        bound: (2n,) greatest friction impulses, b_i = mu_i m_i g dt (N s), then beta_i = arm b_i (N
            m s).
        spin_lever_arm: arm = c s, see `calc_spin_lever_arm`, m.
        xdot: (3n,) velocities before the step, rad/s and m/s.
        F: (3n,) applied torque and force on every cell, N m and N.
        dt: time step, s.
    """

    M: Array
    J_e: csr_array
    J_f: csr_array
    bound: Array
    spin_lever_arm: float
    xdot: Array
    F: Array
    dt: float

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.M) // 3

    @property
    def mass(self) -> Array:
        """Masses m_i (n,) of the cells, kg."""
        return self.M[1::3]

    @property
    def cell_size(self) -> float:
        """Side of a cell, s = sqrt(6 I/m), m."""
        return sqrt(6 * self.M[0] / self.M[1])


def make_maximal_lcp(
    bodies: Bodies,
    q: ArrayLike,
    xdot: ArrayLike,
    F: ArrayLike,
    dt: float,
    g: float = STANDARD_GRAVITY,
    spanning_tree: bool = True,
) -> MaximalLcp:
    """Writes down the LCP of one step.

    Args:
        bodies: one object, with its parameters.
        q: (3,) pose X_WB, m and rad.
        xdot: (3n,) velocities of the cells, rad/s and m/s.
        F: (3n,) torque and force applied to the cells, N m and N.
        dt: the step, s.
        g: gravity, m/s².
        spanning_tree: whether one tree of the adjacent pairs is kept, or all pairs. With all of
            them rows are redundant, and velocities the same.

    Raises:
        SimulationError: a shape disagrees, a number is not finite, or dt is not positive.
    """
    obj = bodies.obj
    params = bodies.params
    q = np.array(q, dtype=np.float64)
    xdot = np.array(xdot, dtype=np.float64)
    F = np.array(F, dtype=np.float64)
    shapes_agree = q.shape == (3,) and xdot.shape == F.shape == (3 * obj.n,)
    if not shapes_agree or params.n != obj.n:
        raise SimulationError(
            f"q {q.shape}, xdot {xdot.shape}, F {F.shape}, parameters of {params.n} cells; "
            "expected (3,), "
            f"({3 * obj.n},), ({3 * obj.n},) and {obj.n}, as {obj.name} has"
        )
    all_finite = all(np.isfinite(value).all() for value in (q, xdot, F))
    if not (all_finite and 0 < dt < np.inf):
        raise SimulationError(
            f"dt is {dt!r}; expected a positive number (s), and finite q, xdot and F"
        )
    s = obj.cell_size
    m = params.mass
    M = np.stack([m * s**2 / 6, m, m], axis=1).ravel()
    b = params.friction * m * g * dt
    spin_lever_arm = calc_spin_lever_arm(obj, params)
    pairs = _spanning_tree(obj.adjacency, obj.n) if spanning_tree else obj.adjacency
    return MaximalLcp(
        M=M,
        J_e=_rigidity(obj.cells_at(q), pairs),
        J_f=_friction_directions(twist_to_cells(obj, q), M, xdot, F, dt),
        bound=np.concatenate([b, spin_lever_arm * b]),
        spin_lever_arm=spin_lever_arm,
        xdot=xdot,
        F=F,
        dt=float(dt),
    )


def twist_to_cells(obj: GridObject, q: ArrayLike) -> Array:
    """Makes T (3n, 3) with xdot = T nu, where nu = (vx, vy, w) is of B's origin in W.

        v_i = v + w z × r_i

    Args:
        obj: the object.
        q: (3,) pose X_WB, m and rad; it turns r_i, the arm from B's origin to cell i, into W.
    """
    q = np.asarray(q, dtype=np.float64)
    rx, ry = (obj.cells_at(q) - q[:2]).T
    T = np.zeros((obj.n, 3, 3))
    T[:, 0, 2] = 1.0
    T[:, 1, 0] = 1.0
    T[:, 1, 2] = -ry
    T[:, 2, 1] = 1.0
    T[:, 2, 2] = rx
    return T.reshape(3 * obj.n, 3)


def _spanning_tree(pairs: IntArray, n: int) -> IntArray:
    """Chooses (n-1, 2) of the pairs (m, 2), enough to connect all n cells."""
    i, j = pairs.reshape(-1, 2).T
    tree = minimum_spanning_tree(csr_array((np.ones(len(i)), (i, j)), shape=(n, n))).tocoo()
    return np.stack([tree.row, tree.col], axis=1).astype(np.int64)


def _rigidity(p_WC: Array, pairs: IntArray) -> csr_array:
    """Makes J_e, three rows for each pair of cells.

    w_i = w_j and v_i + w_i z × (P - p_i) = v_j + w_j z × (P - p_j), with P the midpoint.
    """
    k = len(pairs)
    i, j = pairs.reshape(-1, 2).T
    ax, ay = ((p_WC[j] - p_WC[i]) / 2).T
    one = np.ones(k)
    row = 3 * np.arange(k)
    # (row, column, value); P - p_i = a, P - p_j = -a
    entries = [
        # w_i = w_j
        (row, 3 * i, one),
        (row, 3 * j, -one),
        # along x
        (row + 1, 3 * i + 1, one),
        (row + 1, 3 * i, -ay),
        (row + 1, 3 * j + 1, -one),
        (row + 1, 3 * j, -ay),
        # along y
        (row + 2, 3 * i + 2, one),
        (row + 2, 3 * i, ax),
        (row + 2, 3 * j + 2, -one),
        (row + 2, 3 * j, ax),
    ]
    rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))
    return csr_array(coo_array((values, (rows, columns)), shape=(3 * k, 3 * len(p_WC))))


def _friction_directions(
    T: Array,
    M: Array,
    xdot: Array,
    F: Array,
    dt: float,
) -> csr_array:
    """Makes J_f: minus each cell's direction of motion, and minus its sense of rotation.

    A cell at rest takes the impending motion's, and that is the rigid body's, T dt M_B^-1 T^T F,
    and not the cell's own dt F_i/m_i: the cells cannot part, so the cell that is pushed sets all of
    them in motion, and with its own direction a cell that nobody pushes would carry no friction at
    all. Where that is zero too (no force, or the cell is the instantaneous center) nothing is known
    of the direction and the row is zero: no friction.
    """
    # The rigid body's impending motion, T dt M_B^-1 T^T F
    n = len(M) // 3
    M_B = T.T @ (M[:, None] * T)
    impending = (dt * T @ np.linalg.solve(M_B, T.T @ F)).reshape(n, 3)

    # Each cell's own direction, or where it is at rest the impending one.
    w, v = _find_senses(xdot.reshape(n, 3), SPEED_AT_REST, YAW_RATE_AT_REST)
    fastest = np.linalg.norm(impending[:, 1:], axis=1).max()
    s = sqrt(6 * M[0] / M[1])
    slow = IMPENDING_AT_REST * max(fastest, s * abs(impending[0, 0]))
    w_impending, v_impending = _find_senses(impending, slow, slow / s)
    w = np.where(w == 0, w_impending, w)
    v = np.where((v == 0).all(axis=1, keepdims=True), v_impending, v)
    cell = np.arange(n)
    rows = np.concatenate([cell, cell, n + cell])
    columns = np.concatenate([3 * cell + 1, 3 * cell + 2, 3 * cell])
    values = -np.concatenate([v[:, 0], v[:, 1], w])
    J_f = csr_array(coo_array((values, (rows, columns)), shape=(2 * n, 3 * n)))
    J_f.eliminate_zeros()
    return J_f


def _find_senses(xdot: Array, slow: float, slow_yaw: float) -> tuple[Array, Array]:
    """Calculates the senses of rotation and the directions of motion of cells.

    Args:
        xdot: (n, 3) velocities, rad/s and m/s.
        slow: speed below which a cell is at rest, m/s.
        slow_yaw: yaw rate below which a cell does not turn, rad/s.

    Returns:
        The senses (n,), and unit directions (n, 2); both are zero where there is no motion.
    """
    w = xdot[:, 0]
    v = xdot[:, 1:]
    speed = np.linalg.norm(v, axis=1, keepdims=True)
    moves = speed > slow
    senses = np.where(np.abs(w) > slow_yaw, np.sign(w), 0.0)
    directions = np.where(moves, v / np.where(moves, speed, 1.0), 0.0)
    return senses, directions

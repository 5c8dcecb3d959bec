"""The step with isotropic Coulomb friction as a second-order cone program.

It is slow and independent of the kernel, which is tested against it.

Clarabel's solution is good to 1e-7; Newton's method then takes it to round-off, on the subspace in
which the norms that vanish (what sticks) stay zero.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import null_space
from scipy.sparse import csc_array, diags_array

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.friction.friction_law import SPIN_MODELS, calc_spin_lever_arm
from gridpush_drake.dynamics.reference.maximal_lcp import STANDARD_GRAVITY, twist_to_cells
from gridpush_drake.errors import SimulationError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array

clarabel = import_extra("clarabel", "reference")

CONIC_TOLERANCE = 1e-13
"""Clarabel's relative and absolute tolerance, on problems scaled to one."""

USABLE_STATUSES = ("Solved", "AlmostSolved", "InsufficientProgress")
"""Clarabel's statuses whose point is near enough to be refined. The caller verifies the refined
one."""

STEP_FRACTION = 0.9
"""Longest step of the interior-point method, as a fraction of the way to the cones' boundary. With
Clarabel's 0.99 round-off stops it earlier, on some processors by 4e-6 of the pusher's speed."""


def solve_conic(
    P: csc_array, q: Array, A: csc_array, cones: list[object], b: Array | None = None
) -> tuple[Array, Array]:
    """Solves a quadratic cone program.

        min 1/2 x·P x + q·x    s.t.  b - A x in the cones

    Args:
        P: (k, k) upper triangle.
        q: (k,) linear cost.
        A: (r, k) constraints.
        cones: Clarabel's cones, of r rows in all.
        b: (r,) constraints' right-hand sides; zeros by default.

    Returns:
        x (k,) and the duals z (r,).

    Raises:
        SimulationError: the solver stopped short.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = CONIC_TOLERANCE
    settings.tol_gap_rel = CONIC_TOLERANCE
    settings.tol_feas = CONIC_TOLERANCE
    settings.tol_ktratio = CONIC_TOLERANCE
    settings.max_step_fraction = STEP_FRACTION
    program = (P, q, A, np.zeros(A.shape[0]) if b is None else b, cones)
    solution = clarabel.DefaultSolver(*program, settings).solve()
    if str(solution.status) not in USABLE_STATUSES:
        raise SimulationError(f"Clarabel stopped with {solution.status}")
    return np.array(solution.x), np.array(solution.z)


ZERO_NORMS = (1e-9, 1e-7, 1e-5)
"""Relative sizes below which |A_i u| of the cone program's solution is taken for zero, tried in
turn."""

SUBSPACE_TOLERANCE = 1e-10
"""Relative singular value below which the subspace of vanishing norms ignores a direction."""

POLISH_DISTANCE = 1e-4
"""Largest correction that Newton's method may make to the cone program's solution."""

MAX_NEWTON_STEPS = 30
"""Largest number of Newton's steps."""

NEWTON_TOLERANCE = 1e-13
"""Relative Newton step that ends the polish."""


def solve_isotropic_socp(
    bodies: Bodies,
    q: ArrayLike,
    nu: ArrayLike,
    wrench: ArrayLike,
    dt: float,
    g: float = STANDARD_GRAVITY,
    spin: str = "separate",
) -> Array:
    """Takes one implicit step with isotropic Coulomb friction, as a second-order cone program.

        "separate":  min 1/2 |nu' - nu|²_M_B - dt W·nu' + sum_i b_i |v_i(nu')| + sum_i beta_i |w'|
        "coupled":   min 1/2 |nu' - nu|²_M_B - dt W·nu' + sum_i b_i sqrt(|v_i(nu')|² + (c s w')²)

    and "none" is the first without its last term. M_B = T^T M T = L L^T; in u = L^T nu' / |L^T
    nu_free| the first two terms are |u - u_free|² / 2, with u_free of unit length: three unknowns,
    and one epigraph variable a cone.

    Args:
        bodies: one object, with its parameters.
        q: (3,) pose X_WB, m and rad.
        nu: (3,) velocity of B's origin in W, m/s, and yaw rate, rad/s.
        wrench: (3,) W = force in W, N, and moment about B's origin, N m.
        dt: the step, s.
        g: gravity, m/s².
        spin: "separate", "coupled" or "none".

    Returns:
        nu' (3,), accurate to 1e-9 of the speed without friction.

    Raises:
        SimulationError: `spin` is none of the three, or the solver failed.
    """
    obj = bodies.obj
    params = bodies.params
    if spin not in SPIN_MODELS:
        raise SimulationError(f"spin is {spin!r}; expected one of {', '.join(SPIN_MODELS)}")
    nu = np.asarray(nu, dtype=np.float64)
    wrench = np.asarray(wrench, dtype=np.float64)
    n = obj.n
    s = obj.cell_size
    m = params.mass

    # The free motion in u, which has length one once it is divided by `speed`.
    T = twist_to_cells(obj, q)
    M = np.stack([m * s**2 / 6, m, m], axis=1).ravel()
    L = np.linalg.cholesky(T.T @ (M[:, None] * T))
    u_free = L.T @ nu + np.linalg.solve(L, dt * wrench)
    speed = float(np.linalg.norm(u_free))
    if speed == 0:
        return np.zeros(3)

    # A cone b_i |A_i u| a cell; a last one for the spin friction of all cells together.
    b = params.friction * m * g * dt / speed
    rows = (np.linalg.solve(L, T.T).T).reshape(n, 3, 3)
    arm = calc_spin_lever_arm(obj, params)
    scale = np.array([arm if spin == "coupled" else 0.0, 1.0, 1.0])
    cones = list(b[:, None, None] * scale[:, None] * rows)
    if spin == "separate":
        cones.append(arm * b.sum() * rows[0, :1])
    u = _minimize_norms(u_free / speed, [cone for cone in cones if np.abs(cone).max() > 0])
    return np.linalg.solve(L.T, speed * u)


def _minimize_norms(u_free: Array, cones: list[Array]) -> Array:
    """Minimizes |u - u_free|²/2 + sum_i |A_i u| over u (3,).

    The sum is that of t_i, with (t_i, A_i u) in second-order cones.
    """
    # Unknowns: u, then a bound t_i for each norm. Rows of a cone: t_i, then A_i u.
    k = len(cones)
    P = diags_array(np.concatenate([np.ones(3), np.zeros(k)]))
    A = np.zeros((sum(1 + len(A_i) for A_i in cones), 3 + k))
    row = 0
    for i, A_i in enumerate(cones):
        A[row, 3 + i] = -1.0
        A[row + 1 : row + 1 + len(A_i), :3] = -A_i
        row += 1 + len(A_i)
    types = [clarabel.SecondOrderConeT(1 + len(A_i)) for A_i in cones]
    x, _ = solve_conic(csc_array(P), np.concatenate([-u_free, np.ones(k)]), csc_array(A), types)
    # Which norms vanish cannot be told from a point that is good to 1e-7 only: several guesses are
    # tried, and the one that ends near that point is right.
    for zero in ZERO_NORMS:
        u = _polish(u_free, cones, x[:3], zero)
        if u is not None and np.abs(u - x[:3]).max() < POLISH_DISTANCE:
            return u
    raise SimulationError(f"the cone program of {k} norms was not solved to the accuracy promised")


def _polish(
    u_free: Array,
    cones: list[Array],
    u: Array,
    zero: float,
) -> Array | None:
    """Refines u by Newton's method, on the subspace B where the norms that vanish at u do.

    Returns:
        The minimizer; None if the method fails.
    """
    held = [np.zeros((1, 3))]
    sliding = []
    for A_i in cones:
        size = np.abs(A_i).max()
        if np.linalg.norm(A_i @ u) <= zero * size:
            held.append(A_i / size)
        else:
            sliding.append(A_i)
    B = null_space(np.concatenate(held), rcond=SUBSPACE_TOLERANCE)
    moving = [A_i @ B for A_i in sliding]
    # With e = A y / |A y|: gradient A^T e, Hessian (A^T A - A^T e e^T A) / |A y|.
    y = B.T @ u
    for _ in range(MAX_NEWTON_STEPS):
        gradient = y - B.T @ u_free
        hessian = np.eye(len(y))
        for A_i in moving:
            norm = np.linalg.norm(A_i @ y)
            if norm == 0:
                return None
            e = A_i @ y / norm
            gradient = gradient + A_i.T @ e
            hessian = hessian + (A_i.T @ A_i - np.outer(A_i.T @ e, A_i.T @ e)) / norm
        step = np.linalg.solve(hessian, -gradient)
        y = y + step
        if np.abs(step).max(initial=0.0) < NEWTON_TOLERANCE:
            return B @ y
    return None

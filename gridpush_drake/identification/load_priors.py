"""Ideas of how an object bears on the table, each a normal distribution of z = (log k, log mu_c).

* A smooth field: log k ~ N(log k_0, a² C), neighboring cells alike, of one amplitude a.
* Two parts, as of steel and of wood, that meet at a straight cut: h is 1/2 on one side and -1/2 on
  the other,

      log k ~ N(log k_0, a_p² C + sigma_p² h h^T)

  Of all cuts those are tried that explain the pushes best to first order, see `choose_parts`.
* A rigid bottom, which stands on corners of the outline.

See `docs/theory/identification.md`, sections 3 and 5.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.linalg import block_diag, solve_triangular

from gridpush_drake.geometry.se2 import Array, make_direction
from gridpush_drake.identification.posterior import CELLS
from gridpush_drake.objects.grid_object import GridObject

RANGE_CELLS = 4.0
"""Distance, in cells, at which two cells' log-frictions are nearly independent."""

KAPPA_RANGE = 8.0**0.5
"""kappa times the range, of the Matérn field of smoothness one (Lindgren, Rue and Lindström 2011,
section 2)."""

WEAKNESS = 0.65
"""Power of 1/a that an amplitude a weighs beforehand: few noisy pushes are not to talk the model
out of uniformity."""

CENTER_STD = 0.6
"""Of the center of friction about the cells' centroid where nothing is known of it, per axis, in
radii of gyration."""

PART_STD, PART_AMPLITUDE = 1.5, 0.3
"""sigma_p and a_p: of log k between two parts, and within each."""

PART_WEIGHT = 1.0
"""Of two parts beforehand, all cuts together, where all fields together have 12.0."""

PART_FITS = 3
"""How many cuts are fitted, no two alike."""

CUT_ANGLES, CUT_SPACING = 18, 1.5
"""Directions of cuts, and the distance between cuts of one direction, cells."""

MIN_PART = 0.08
"""Of all cells, what a part has at least."""

ALIKE = 0.8
"""Correlation beyond which two cuts are alike."""

CORNER_STD = 2.5
"""Of log k at a corner: some of a rigid bottom's corners bear next to nothing."""

CORNER_REST, CORNER_REST_STD = 0.02, 0.05
"""Of a rigid bottom's load, what is not on corners, and the standard deviation of log k there."""

CORNER_WEIGHT = 0.05
"""Of a rigid bottom beforehand: one push alone must not speak for it."""


@dataclass(frozen=True, eq=False)
class LoadPrior:
    """An idea of how the object bears on the table: z ~ N(mean, factor factor^T).

    Attributes:
        mean: (n+1,).
        factor: (n+1, n+1).
        weight: beforehand, up to a constant.
        p_BC: (n, 2) where the cells' loads are, m, body frame.
        share: by how much less than its own fit's the evidence of the idea is, where it is the best
            of many.
    """

    mean: Array
    factor: Array
    weight: float
    p_BC: Array
    share: float = 1.0


def calc_smooth_covariance(
    obj: GridObject, range_cells: float = RANGE_CELLS
) -> NDArray[np.float64]:
    """Makes C (n, n), unit mean variance: C^-1 ~ (L + kappa² I)², L the graph Laplacian of neighboring cells.

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
    root = np.linalg.inv(L + KAPPA_RANGE**2 / range_cells**2 * np.eye(obj.n))
    C = root @ root
    return C / np.diag(C).mean()


def calc_prior_factor(C: Array, amplitude: float, log_contact_friction_std: float) -> Array:
    """Cholesky factor (n+1, n+1) of blockdiag(a² C, sigma²), the prior covariance of z."""
    return np.asarray(
        block_diag(amplitude * np.linalg.cholesky(C), np.diag([log_contact_friction_std]))
    )


def make_field(
    obj: GridObject, z0: Array, C: Array, amplitude: float, log_contact_friction_std: float
) -> LoadPrior:
    """A smooth field of one amplitude about z0 (n+1,)."""
    return LoadPrior(
        z0,
        calc_prior_factor(C, amplitude, log_contact_friction_std),
        amplitude**-WEAKNESS,
        obj.p_BC,
    )


def make_bottom(obj: GridObject, z0: Array, log_contact_friction_std: float) -> LoadPrior:
    """A rigid bottom on the outline's corners, about z0 (n+1,)."""
    corners, p_corners = find_corners(obj)
    rest = np.setdiff1d(np.arange(obj.n), corners)
    mean, variance, p_BC = z0.copy(), np.full(obj.n, CORNER_STD**2), obj.p_BC.copy()
    mean[rest] += np.log(CORNER_REST * len(corners) / max(len(rest), 1))
    variance[rest] = CORNER_REST_STD**2
    p_BC[corners] = p_corners
    factor = calc_prior_factor(np.diag(variance), 1.0, log_contact_friction_std)
    return LoadPrior(mean, factor, CORNER_WEIGHT, p_BC)


def find_corners(obj: GridObject) -> tuple[NDArray[np.int64], Array]:
    """Finds where a rigid flat bottom comes to rest: the corners of the outline's convex hull.

    Args:
        obj: the object.

    Returns:
        The cells nearest to corners, increasing, and the place (corners, 2), m, of each one's
        corner, or of the mean of its corners.
    """
    corners = shapely.get_coordinates(obj.outline.convex_hull)[:-1]
    nearest = np.linalg.norm(corners[:, None] - obj.p_BC, axis=2).argmin(axis=1)
    cells = np.unique(nearest)
    return cells, np.array([corners[nearest == cell].mean(axis=0) for cell in cells])


def find_cuts(obj: GridObject) -> Array:
    """Finds the straight cuts that leave each part its least share of the cells.

    Args:
        obj: the object.

    Returns:
        (cuts, n) h of each, between -1/2 and 1/2 in cells that the cut goes through.
    """
    cuts = [np.empty((0, obj.n))]
    for across in make_direction(np.pi / CUT_ANGLES * np.arange(CUT_ANGLES)):
        x = obj.p_BC @ across / obj.cell_size
        h = np.clip(x - np.arange(x.min(), x.max(), CUT_SPACING)[:, None], -0.5, 0.5)
        smaller = np.minimum((h > 0).mean(axis=1), (h < 0).mean(axis=1))
        cuts.append(h[smaller >= MIN_PART])
    return np.concatenate(cuts)


def choose_parts(
    obj: GridObject,
    z0: Array,
    C: Array,
    log_contact_friction_std: float,
    residuals: Array,
    J: Array,
    known: int = 0,
) -> list[tuple[LoadPrior, Array]]:
    """Chooses the two parts that explain the pushes best to first order, r = residuals + J (z - z0) ~ N(0, I).

    Args:
        obj: the object.
        z0: (n+1,) prior mean.
        C: (n, n) of `calc_smooth_covariance`.
        log_contact_friction_std: prior standard deviation of log mu_c.
        residuals: (R,) at z0, whitened.
        J: (R, n+1) their derivatives by z.
        known: how many of the residuals, the last ones, are prior knowledge and no evidence.

    Returns:
        At most PART_FITS priors, the most probable first, each with the z (n+1,) to begin its fit
        at.
    """
    cuts = find_cuts(obj)
    if len(residuals) > len(z0):  # the same with fewer rows
        seen = len(residuals) - known
        rotated = np.asarray(np.linalg.qr(np.column_stack([J[:seen], residuals[:seen]]), mode="r"))
        J, residuals = (
            np.vstack([rotated[:, :-1], J[seen:]]),
            np.append(rotated[:, -1], residuals[seen:]),
        )
    within = block_diag(PART_AMPLITUDE**2 * C, log_contact_friction_std**2)
    log_evidence = calc_cut_evidence(cuts, within, residuals, J)
    if known:
        log_evidence -= calc_cut_evidence(cuts, within, residuals[-known:], J[-known:])
    left = np.ones(len(cuts), dtype=bool)
    found: list[tuple[LoadPrior, Array]] = []
    while left.any() and len(found) < PART_FITS:
        best = int(np.argmax(np.where(left, log_evidence, -np.inf)))
        alike = left & (_correlate(cuts, cuts[best]) > ALIKE)
        share = float(np.exp(log_evidence[alike] - log_evidence[best]).sum() / len(cuts))
        covariance = within[CELLS, CELLS] + PART_STD**2 * np.outer(cuts[best], cuts[best])
        A = calc_prior_factor(covariance, 1.0, log_contact_friction_std)
        B = J @ A
        u = -B.T @ np.linalg.solve(np.eye(len(B)) + B @ B.T, residuals)
        found.append((LoadPrior(z0, A, PART_WEIGHT, obj.p_BC, share), z0 + A @ u))
        left &= ~alike
    return found


def calc_cut_evidence(cuts: Array, within: Array, residuals: Array, J: Array) -> Array:
    """Log evidence (cuts,) of each cut (cuts, n), less that of no cut: h adds one rank to `within` (n+1, n+1)."""
    L = np.linalg.cholesky(np.eye(len(residuals)) + J @ within @ J.T)
    r = solve_triangular(L, residuals, lower=True)
    g = PART_STD * solve_triangular(L, J[:, CELLS] @ cuts.T, lower=True)
    size2 = 1 + (g * g).sum(axis=0)
    return np.asarray(0.5 * ((r @ g) ** 2 / size2 - np.log(size2)))


def _correlate(cuts: Array, cut: Array) -> Array:
    """Size of the correlation (cuts,) of each cut with one."""
    a, b = cuts - cuts.mean(axis=1, keepdims=True), cut - cut.mean()
    return np.asarray(np.abs(a @ b) / np.sqrt((a * a).sum(axis=1) * (b @ b)))

"""Where loads may lie, by the outline: corners, straight cuts, the radius, rings; and by the parts.

Hypotheses of how an object bears on the table (`hypotheses`) are made of these. What the pushes say
of them is not decided here. Theory: `docs/theory/identification.md`, section 5.
"""

import numpy as np
import shapely

from gridpush_drake.geometry.se2 import Array, IntArray, make_direction
from gridpush_drake.identification.statistics.center_of_mass import FRICTION_STD
from gridpush_drake.objects.grid_object import GridObject

CUT_ANGLES = 18
"""Number of directions in which the cuts between two parts are tried."""

CUT_SPACING = 1.5
"""Distance between neighboring cuts of one direction, cells."""

MIN_PART = 0.08
"""Smallest fraction of the cells that a part may have."""

LEAST_RING = 0.3
"""Radius of the smallest ring that is tried, radii of gyration."""

GREATEST_RING = 0.85
"""Radius of the greatest ring that is tried, as a fraction of the farthest cell's distance from the
middle."""

RING_SPACING = 0.1
"""Difference of the radii of neighboring rings, radii of gyration."""

RING_WIDTH = 0.2
"""w, standard deviation of a ring's profile, radii of gyration."""

LEAST_RING_STD = 1e-3
"""Standard deviation of a ring's profile over the cells below which it lies between all cells."""

EQUAL_DISTANCES = 1e-9
"""If the squared distances of the cells from the middle scatter by less than this fraction of a
cell's area, all cells count as equally far from it."""


def find_corners(obj: GridObject) -> tuple[IntArray, Array]:
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
    """Finds the straight cuts that leave each part its least fraction of the cells.

    Args:
        obj: the object.

    Returns:
        (cuts, n) h of each cut, between -1/2 and 1/2 in cells that the cut goes through.
    """
    cuts = [np.empty((0, obj.n))]
    for across in make_direction(np.pi / CUT_ANGLES * np.arange(CUT_ANGLES)):
        x = obj.p_BC @ across / obj.cell_size
        h = np.clip(x - np.arange(x.min(), x.max(), CUT_SPACING)[:, None], -0.5, 0.5)
        smaller = np.minimum((h > 0).mean(axis=1), (h < 0).mean(axis=1))
        cuts.append(h[smaller >= MIN_PART])
    return np.concatenate(cuts)


def calc_radius_mode(obj: GridObject) -> Array:
    """Calculates q (n,), the squared distance of each cell from the centroid of all, standardized.

    Its mean over the cells is 0 and its variance 1. It is 0 everywhere where all cells are equally
    far from the centroid.
    """
    arm = obj.p_BC - obj.p_BC.mean(axis=0)
    distance2 = (arm * arm).sum(axis=1)
    difference = distance2 - distance2.mean()
    std = float(difference.std())
    # Distances that differ by rounding alone are equal.
    if std <= EQUAL_DISTANCES * obj.cell_size**2:
        return np.zeros(obj.n)
    return np.asarray(difference / std)


def find_rings(obj: GridObject) -> Array:
    """Finds rings about the middle: h = exp(-(d - r)² / (2 w²)), standardized over the cells.

    Here d is a cell's distance from the centroid of all cells, and r and w are the radius and the
    width of the ring.

    Args:
        obj: the object.

    Returns:
        (rings, n) h of each ring, of mean 0 and variance 1; none where all cells are equally far
        from the centroid.
    """
    if not calc_radius_mode(obj).any():
        return np.empty((0, obj.n))
    distance = np.linalg.norm(obj.p_BC - obj.p_BC.mean(axis=0), axis=1) / obj.radius_of_gyration
    radii = np.arange(LEAST_RING, GREATEST_RING * distance.max(), RING_SPACING)
    h = np.exp(-0.5 * ((distance - radii[:, None]) / RING_WIDTH) ** 2)
    h -= h.mean(axis=1, keepdims=True)
    std = h.std(axis=1, keepdims=True)
    # A ring that lies between all cells is none.
    informed = std[:, 0] > LEAST_RING_STD
    return np.asarray(h[informed] / std[informed])


def calc_part_modes(obj: GridObject) -> Array:
    """Calculates h (parts, n): 1 on the cells of each part, 0 on all others, less its mean."""
    h = (obj.labels == np.unique(obj.labels)[:, None]).astype(np.float64)
    return np.asarray(h - h.mean(axis=1, keepdims=True))


def calc_material_loads(obj: GridObject) -> Array:
    """Calculates m (n,), log k of the cells as their materials' densities say, less log k_0.

    The mean load is k_0, for only the ratios of densities count. Parts of which no material is
    known are expected to be of the others' geometric mean. All is 0 where no material is known.
    """
    m = np.zeros(obj.n)
    known = np.zeros(obj.n, dtype=bool)
    for material in obj.prior.materials:
        of_part = obj.labels == material.label
        m[of_part] = np.log(material.density)
        known |= of_part
    if known.any():
        m[~known] = m[known].mean()
    return np.asarray(m - np.log(np.mean(np.exp(m - m.max()))) - m.max())


def calc_material_stds(obj: GridObject, unknown_std: float) -> Array:
    """Calculates how far log k of each part may be from what its material's density says.

    Args:
        obj: the object.
        unknown_std: that of parts of which no material is known.

    Returns:
        (parts,) standard deviations, in the order of the labels. They hold what the part's friction
        may differ by from that of the others.
    """
    friction_std = min(FRICTION_STD, obj.prior.log_friction_std)
    known = {
        material.label: float(np.hypot(np.log(material.spread), friction_std))
        for material in obj.prior.materials
    }
    return np.array([known.get(label, unknown_std) for label in np.unique(obj.labels).tolist()])


def find_part_borders(obj: GridObject) -> IntArray:
    """Finds the cells that share a side with a cell of another part, increasing."""
    labels = obj.labels[obj.adjacency]
    return np.unique(obj.adjacency[labels[:, 0] != labels[:, 1]])

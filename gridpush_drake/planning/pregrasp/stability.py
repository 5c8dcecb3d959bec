"""Whether an object stays on the table, judged on the set of masses that agree with what was seen.

The object stays put while its center of mass, wherever it may be (`uncertainty.PlausibleMassSet`),
is inside the convex hull of what holds it: the cells whose centers are on the table, at least an
inset away from its edge. That hull is found, compiled, for many poses at once by the monotone chain
(Andrew 1979), for which points must be sorted by x, then y; the order is the body frame's, the same
at every pose.
"""

from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.geometry.polygons import hull_of
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface, find_supported

SUPPORT_INSET = 0.002
"""m inside the edge that a cell's center must be to count as supported: what a pose may be wrong
by."""


def calc_support_polygon(
    obj: GridObject, pose: ArrayLike, surface: SupportSurface, inset: float = SUPPORT_INSET
) -> Array:
    """What holds the object: the convex hull of the cells' centers that are on the table, `inset` (m) inside its edge.

    (V, 2) corners, body frame, m, counterclockwise; empty where no three cells hold it.
    """
    return hull_of(obj.p_BC[find_supported(obj, pose, surface, inset)])


def calc_stability_margins(
    masses: PlausibleMassSet,
    poses: ArrayLike,
    surface: SupportSurface,
    inset: float = SUPPORT_INSET,
) -> Array:
    """How far the center of mass at its worst stays inside what holds the object, (K,) m, at poses (K, 3), m and rad.

    Negative where some mass distribution tips; a cell's center must be `inset` (m) inside the edge
    to hold.
    """
    obj = masses.obj
    q = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    order = np.lexsort((obj.p_BC[:, 1], obj.p_BC[:, 0]))
    supported = find_supported(obj, q, surface, inset)[:, order]
    margins = np.empty(len(q))
    calc_margins(
        obj.p_BC[order], np.ascontiguousarray(supported), masses.center_of_mass_polygon, margins
    )
    return margins


def calc_stability_margin(
    masses: PlausibleMassSet, pose: ArrayLike, surface: SupportSurface, inset: float = SUPPORT_INSET
) -> float:
    """The margin at one pose (3,), m; see `calc_stability_margins`."""
    return float(calc_stability_margins(masses, pose, surface, inset)[0])


@kernel()
def calc_margins(points, supported, inner, margins):
    """Fills in `margins` (K,): the least distance of `inner` inside the hull's edges, m; -inf where three do not hold.

    Args:
        points: (n, 2) in order of x, then y, m.
        supported: (K, n) which of them are on the table, pose by pose.
        inner: (V, 2) points that must stay inside the hull of those, m.
    """
    n = points.shape[0]
    hull = np.empty((2 * n + 2, 2))
    for row in range(supported.shape[0]):
        size = _chain(points, supported[row], hull)
        if size < 3:
            margins[row] = -np.inf
            continue
        least = np.inf
        for i in range(size):
            j = (i + 1) % size
            ex, ey = hull[j, 0] - hull[i, 0], hull[j, 1] - hull[i, 1]
            length = sqrt(ex * ex + ey * ey)
            for v in range(inner.shape[0]):
                inside = (
                    ex * (inner[v, 1] - hull[i, 1]) - ey * (inner[v, 0] - hull[i, 0])
                ) / length
                least = min(least, inside)
        margins[row] = least


@kernel()
def _chain(points, supported, hull):
    """The hull's corners, counterclockwise, in `hull`; returns how many."""
    n = points.shape[0]
    size = 0
    for i in range(n):
        if supported[i]:
            size = _append(points[i], hull, size, 0)
    lower = size
    for i in range(n - 1, -1, -1):
        if supported[i] and not (
            hull[size - 1, 0] == points[i, 0] and hull[size - 1, 1] == points[i, 1]
        ):
            size = _append(points[i], hull, size, lower - 1)
    return size - 1


@kernel()
def _append(point, hull, size, floor):
    """Appends a point to a chain that began at `floor`, without the points that it leaves inside."""
    while size - floor >= 2:
        ax, ay = hull[size - 2, 0], hull[size - 2, 1]
        bx, by = hull[size - 1, 0], hull[size - 1, 1]
        if (bx - ax) * (point[1] - ay) - (by - ay) * (point[0] - ax) > 0.0:
            break
        size -= 1
    hull[size, 0], hull[size, 1] = point[0], point[1]
    return size + 1

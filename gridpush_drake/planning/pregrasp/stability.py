"""Whether an object stays on the table, by all masses that agree with what was seen.

The object stays put while its center of mass, wherever it may be (`uncertainty.PlausibleMassSet`),
is inside the convex hull of what holds it: the cells whose centers are on the table, at least an
inset away from its edge. The *stability margin* of a pose q is how far inside it stays at the
worst,

    m(q) = min over the hull's edges e and the corners c of the centers of mass
           of the distance of c from e, inwards

That hull is found in compiled code, for many poses at once, by the monotone chain (Andrew 1979).
It needs the points in order of x, then y; the order is the body frame's, and so the same at every
pose. On a convex table the cells are looked at only in poses in which the object comes near an
edge; in all others all of them hold it, and the margin is the same. The theory is in
`docs/theory/planning.md`, section 3.
"""

from math import cos, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.geometry.polygons import hull_of
from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.support_surface import ROUND_OFF, SupportSurface, find_supported

SUPPORT_INSET = 0.002
"""How far inside the edge a cell's center must be to count as supported, m: what a pose may be
wrong by."""


def calc_support_polygon(
    obj: GridObject, pose: ArrayLike, surface: SupportSurface, inset: float = SUPPORT_INSET
) -> Array:
    """Calculates what holds the object: the hull of the cells' centers that are on the table.

    Args:
        obj: the object.
        pose: (3,) X_WB, m and rad.
        surface: the table.
        inset: how far inside the edge a cell's center must be to hold, m.

    Returns:
        (V, 2) corners, body frame, m, counterclockwise; empty where no three cells hold it.
    """
    return hull_of(obj.p_BC[find_supported(obj, pose, surface, inset)])


def calc_stability_margins(
    masses: PlausibleMassSet,
    poses: ArrayLike,
    surface: SupportSurface,
    inset: float = SUPPORT_INSET,
) -> Array:
    """Calculates how far the center of mass at its worst stays inside what holds the object.

    Args:
        masses: that the object may have.
        poses: (K, 3) X_WB, m and rad.
        surface: the table.
        inset: how far inside the edge a cell's center must be to hold, m.

    Returns:
        (K,) m; negative where some mass distribution tips.
    """
    obj = masses.obj
    q = np.array(poses, dtype=np.float64).reshape(-1, 3)
    points = obj.p_BC[np.lexsort((obj.p_BC[:, 1], obj.p_BC[:, 0]))]
    margins = np.empty(len(q))
    if surface.is_convex:
        calc_margins_on_convex_table(
            points=points,
            reach=float(np.linalg.norm(points, axis=1).max()),
            poses=q,
            normals=surface.edge_normals,
            offsets=surface.edge_offsets,
            inset=float(inset),
            inner=masses.center_of_mass_polygon,
            margins=margins,
        )
        return margins
    supported = surface.contains(transform(q, points), inset)
    calc_margins(points, supported, masses.center_of_mass_polygon, margins)
    return margins


def calc_stability_margin(
    masses: PlausibleMassSet, pose: ArrayLike, surface: SupportSurface, inset: float = SUPPORT_INSET
) -> float:
    """The stability margin at one pose (3,), m; see `calc_stability_margins`."""
    return float(calc_stability_margins(masses, pose, surface, inset)[0])


@kernel()
def calc_margins_on_convex_table(points, reach, poses, normals, offsets, inset, inner, margins):
    """Calculates how far points stay inside what holds an object on a convex table.

    Args:
        points: (n, 2) cells' centers in order of x, then y, body frame, m.
        reach: greatest distance of one of them from the body frame's origin, m.
        poses: (K, 3) X_WB, m and rad.
        normals: (E, 2) outward unit normals of the table's edges, W.
        offsets: (E,) n.p of any point p of each edge, m.
        inset: how far inside the edge a cell's center must be to hold, m.
        inner: (V, 2) points that must stay inside the hull, body frame, m.
        margins: (K,) is filled in: the least distance of `inner` inside the hull's edges, m; -inf
            where three points do not make a hull.
    """
    n = points.shape[0]
    hull = np.empty((2 * n + 2, 2))
    supported = np.ones(n, np.bool_)
    whole = _calc_margin(points, supported, hull, inner)
    near = np.empty(offsets.shape[0], np.int64)
    for row in range(poses.shape[0]):
        x = poses[row, 0]
        y = poses[row, 1]
        # The edges that some cell may be too near to, or beyond.
        count = 0
        for e in range(offsets.shape[0]):
            gap = offsets[e] - (x * normals[e, 0] + y * normals[e, 1])
            if gap < reach + inset + ROUND_OFF:
                near[count] = e
                count += 1
        if count == 0:
            margins[row] = whole
            continue
        c = cos(poses[row, 2])
        s = sin(poses[row, 2])
        for i in range(n):
            cell_x = x + (c * points[i, 0] - s * points[i, 1])
            cell_y = y + (s * points[i, 0] + c * points[i, 1])
            supported[i] = True
            for j in range(count):
                e = near[j]
                if offsets[e] - (cell_x * normals[e, 0] + cell_y * normals[e, 1]) < inset:
                    supported[i] = False
                    break
        margins[row] = _calc_margin(points, supported, hull, inner)


@kernel()
def calc_margins(points, supported, inner, margins):
    """Calculates how far points stay inside convex hulls, one hull for every pose.

    Args:
        points: (n, 2) in order of x, then y, m.
        supported: (K, n) which of them make the hull, pose by pose.
        inner: (V, 2) points that must stay inside the hull, m.
        margins: (K,) is filled in: the least distance of `inner` inside the hull's edges, m; -inf
            where three points do not make a hull.
    """
    hull = np.empty((2 * points.shape[0] + 2, 2))
    for row in range(supported.shape[0]):
        margins[row] = _calc_margin(points, supported[row], hull, inner)


@kernel()
def _calc_margin(points, supported, hull, inner):
    """Calculates how far points stay inside one convex hull.

    Args:
        points: (n, 2) in order of x, then y, m.
        supported: (n,) which of them make the hull.
        hull: (2 n + 2, 2) room for the hull's corners.
        inner: (V, 2) points that must stay inside the hull, m.

    Returns:
        The least distance of `inner` inside the hull's edges, m; -inf where three points do not
        make a hull.
    """
    size = _chain(points, supported, hull)
    if size < 3:
        return -np.inf
    least = np.inf
    for i in range(size):
        # Edge from corner i to corner j; inside is to its left.
        j = (i + 1) % size
        ex = hull[j, 0] - hull[i, 0]
        ey = hull[j, 1] - hull[i, 1]
        length = sqrt(ex * ex + ey * ey)
        for v in range(inner.shape[0]):
            inside = (ex * (inner[v, 1] - hull[i, 1]) - ey * (inner[v, 0] - hull[i, 0])) / length
            least = min(least, inside)
    return least


@kernel()
def _chain(points, supported, hull):
    """Finds a hull's corners, counterclockwise, by Andrew's monotone chain.

    Args:
        points: (n, 2) in order of x, then y, m.
        supported: (n,) which of them make the hull.
        hull: (2 n + 2, 2) the first rows are filled in.

    Returns:
        How many corners there are.
    """
    n = points.shape[0]
    # The lower chain, from left to right.
    size = 0
    for i in range(n):
        if supported[i]:
            size = _append(points[i], hull, size, 0)
    # The upper chain, from right to left, after the lower one's last point, back to the first.
    lower = size
    for i in range(n - 1, -1, -1):
        if supported[i] and not (
            hull[size - 1, 0] == points[i, 0] and hull[size - 1, 1] == points[i, 1]
        ):
            size = _append(points[i], hull, size, lower - 1)
    return size - 1


@kernel()
def _append(point, hull, size, floor):
    """Appends a point to a chain of corners, dropping those that it leaves inside.

    Args:
        point: (2,) m.
        hull: the corners so far.
        size: how many there are.
        floor: where the chain begins among them.

    Returns:
        How many there are then.
    """
    while size - floor >= 2:
        # The last two corners a, b and the point turn left: b is a corner.
        ax = hull[size - 2, 0]
        ay = hull[size - 2, 1]
        bx = hull[size - 1, 0]
        by = hull[size - 1, 1]
        if (bx - ax) * (point[1] - ay) - (by - ay) * (point[0] - ax) > 0.0:
            break
        size -= 1
    hull[size, 0] = point[0]
    hull[size, 1] = point[1]
    return size + 1

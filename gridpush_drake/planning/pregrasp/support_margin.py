"""Compiled: how far points stay inside the convex hull of what holds an object, for many poses at once.

The hull of the supported points is found by the monotone chain (Andrew 1979), for which they must be sorted by x, then
y; the order is the body frame's, the same at every pose.
"""

from math import sqrt

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel

_EMPTY = -np.inf


@kernel()
def calc_margins(points, supported, inner, margins):
    """Calculates margins.

    Args:
        points: (n, 2) in order of x, then y, m.
        supported: (K, n) which of them are on the table, pose by pose.
        inner: (V, 2) points that must stay inside the hull of those, m.
        margins: (K,) out: the least distance of `inner` inside the hull's edges, m; -inf where three do not hold.
    """
    n = points.shape[0]
    hull = np.empty((2 * n + 2, 2))
    for row in range(supported.shape[0]):
        size = _chain(points, supported[row], hull)
        if size < 3:
            margins[row] = _EMPTY
            continue
        least = np.inf
        for i in range(size):
            j = (i + 1) % size
            ex, ey = hull[j, 0] - hull[i, 0], hull[j, 1] - hull[i, 1]
            length = sqrt(ex * ex + ey * ey)
            for v in range(inner.shape[0]):
                inside = (ex * (inner[v, 1] - hull[i, 1]) - ey * (inner[v, 0] - hull[i, 0])) / length
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
        if supported[i] and not (hull[size - 1, 0] == points[i, 0] and hull[size - 1, 1] == points[i, 1]):
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

"""Straight edges fitted through a traced contour, so that their normals do not hang on two of its points."""

import numpy as np
from numpy.typing import NDArray

TRIM = 2.0
"""Length left out of the fit at each end of an edge, pixels: corners are rounded there."""

LEAST_FITTED = 6.0
"""Shorter edges are not fitted but drawn from vertex to vertex, pixels."""

STRAIGHT = 0.75
"""Two edges become one when no point between their ends leaves the line through both by more, pixels."""

LEAST_CORNERS = 3
"""No ring is left fewer."""

LEAST_SINE = 0.1
"""Edges that turn by less than this do not meet at a usable intersection."""

FARTHEST_MOVE = 1.5
"""No vertex is moved further, pixels."""


def fit_edges(ring: NDArray[np.float64], simple: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fits the edges of a simplified ring to the points it was made from.

    Args:
        ring: (k, 2) traced points of a closed ring, first one not repeated, pixels.
        simple: (v, 2) vertices of the simplified ring, some of those points in the same order.

    Returns:
        (w, 2) vertices, w <= v: near-straight corners are dropped, the others are where fitted edges meet.
    """
    index = {tuple(point): i for i, point in enumerate(ring)}
    corners = _drop_straight(ring, [index[tuple(point)] for point in simple])
    spans = list(zip(corners, corners[1:] + corners[:1], strict=True))
    lines = [_fit_line(_between(ring, a, b)) for a, b in spans]
    return np.array([_meet(lines[i - 1], lines[i], ring[corners[i]]) for i in range(len(corners))])


def _drop_straight(ring: NDArray[np.float64], corners: list[int]) -> list[int]:
    after = dict(zip(corners, corners[1:] + corners[:1], strict=True))
    before = {b: a for a, b in after.items()}
    waiting = list(reversed(corners))
    while waiting and len(after) > LEAST_CORNERS:
        corner = waiting.pop()
        if corner not in after:
            continue
        a, b = before[corner], after[corner]
        points = _between(ring, a, b)
        middle, normal = _fit_line(points)
        if np.abs((points - middle) @ normal).max() <= STRAIGHT:
            after[a], before[b] = b, a
            del after[corner], before[corner]
            waiting += [b, a]
    return list(after)


def _between(ring: NDArray[np.float64], a: int, b: int) -> NDArray[np.float64]:
    return ring[a : b + 1] if a < b else np.concatenate([ring[a:], ring[: b + 1]])


def _trim(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Leaves out what is near the ends; short edges are left their two ends only."""
    near = np.minimum(*(np.linalg.norm(points - end, axis=1) for end in (points[0], points[-1])))
    inner = points[near >= TRIM]
    long_enough = np.linalg.norm(points[-1] - points[0]) >= LEAST_FITTED and len(inner) > 1
    return inner if long_enough else points[[0, -1]]


def _fit_line(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A point on the line and its unit normal, by total least squares."""
    inner = _trim(points)
    middle = inner.mean(axis=0)
    return middle, np.linalg.svd(inner - middle, full_matrices=False)[2][1]


def _meet(
    one: tuple[NDArray[np.float64], NDArray[np.float64]],
    other: tuple[NDArray[np.float64], NDArray[np.float64]],
    corner: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Where two lines cross, if that is near `corner`; else the mean of its feet on both."""
    normals = np.array([one[1], other[1]])
    gaps = np.array([(middle - corner) @ normal for middle, normal in (one, other)])
    if abs(np.linalg.det(normals)) >= LEAST_SINE:
        move = np.linalg.solve(normals, gaps)
        if np.linalg.norm(move) <= FARTHEST_MOVE:
            return corner + move
    return corner + gaps @ normals / 2

"""Where pads that point along a heading fit on an object, to the last tenth of a millimeter.

Seen along the heading, with x along it and y across, a rectangle [back, front] x [-w, w] about the point (x, y) crosses
no edge of a polygon exactly if for every edge, cut to the strip y - w .. y + w and there reaching from xa to xb,

    x <= xa - front   or   x >= xb - back

so that on a line of constant y what is free is what a union of intervals leaves. On wide objects evenly spaced lines
and headings will do. A handle hardly wider than the pads asks for the very heading, the bisector of its two sides, and
for the very lines: on which a side of the pads touches a corner of the handle, and between two such lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from gridpush_drake.geometry.se2 import Array, make_rotation

TOUCH = 1e-6
"""m, for round-off: rectangles may cross an edge by as much."""

NEARLY_PARALLEL = np.radians(12)
"""Between the two sides of a handle."""

SAME = np.radians(0.2)
"""Between headings of which only that of the longer sides is tried: across the pads' length it is a tenth of a
millimeter."""

ALONG = 4
"""Times as far apart as the lines, places on a line are tried: its ends and what is nearest to the aim are exact."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Edges that a rectangle must not cross.

    Attributes:
        edges: (e, 2, 2) their ends, m.
        back: of the rectangle along the heading, from the grasp point, m.
        front: likewise.
        width: of the rectangle, m.
    """

    edges: Array
    back: float
    front: float
    width: float


def get_edges(shape: BaseGeometry) -> Array:
    """The edges (e, 2, 2) of all rings of polygons, counterclockwise about what is inside."""
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(shape)))
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    within = np.flatnonzero(ring[:-1] == ring[1:])
    return np.stack([corners[within], corners[within + 1]], axis=1)


@dataclass(frozen=True, eq=False)
class Handle:
    """A narrow stretch of an object.

    Attributes:
        heading: along it, rad.
        corners: (k, 2) ends of its sides, m.
    """

    heading: float
    corners: Array


def find_handles(edges: Array, shortest: float, widest: float) -> list[Handle]:
    """Narrow handles: pairs of edges that face each other; their heading is the bisector.

    Args:
        edges: (e, 2, 2) of polygons, counterclockwise, m.
        shortest: edge that counts, m.
        widest: handle that counts, m.

    Returns:
        Those of longer edges first, each with a heading in [0, pi); those of the same heading are one.
    """
    along = edges[:, 1] - edges[:, 0]
    length = np.linalg.norm(along, axis=1)
    edges, along, length = (array[length >= shortest] for array in (edges, along, length))
    angle = np.arctan2(along[:, 1], along[:, 0])
    i, j = np.triu_indices(len(angle), 1)
    slant = np.remainder(angle[j] - angle[i], 2 * np.pi) - np.pi
    near = np.abs(slant) <= NEARLY_PARALLEL
    i, j, slant = i[near], j[near], slant[near]
    # what lies to the left of an edge is inside
    across = along[i, 0] * (edges[j] - edges[i, :1])[..., 1].mean(axis=1)
    across -= along[i, 1] * (edges[j] - edges[i, :1])[..., 0].mean(axis=1)
    gap = shapely.distance(shapely.linestrings(edges[i]), shapely.linestrings(edges[j]))
    rank = np.where((gap <= widest) & (across > 0), np.minimum(length[i], length[j]), 0.0)
    found: list[Handle] = []
    for k in np.argsort(-rank, kind="stable")[: np.count_nonzero(rank)]:
        heading, corners = float((angle[i[k]] + slant[k] / 2) % np.pi), edges[[i[k], j[k]]].reshape(4, 2)
        for n, other in enumerate(found):
            if abs((heading - other.heading + np.pi / 2) % np.pi - np.pi / 2) <= SAME:
                found[n] = Handle(other.heading, np.concatenate([other.corners, corners]))
                break
        else:
            found.append(Handle(heading, corners))
    return found


def find_places(
    shape: BaseGeometry,
    pads: Walls,
    others: Sequence[Walls],
    tries: Sequence[tuple[float, Array | None]],
    aim: Array,
    step: float,
) -> tuple[Array, Array]:
    """Points and headings with which the pads lie on an object.

    Args:
        shape: what the pads must lie on, m.
        pads: the pads, and the edges of `shape`; the grasp point lies in them.
        others: further rectangles and what they must not cross.
        tries: headings, rad, with the corners (k, 2) of a narrow handle, to look there only, or None for everywhere.
        aim: (2,) point near which places are wanted, m.
        step: between lines, at most, m.

    Returns:
        (k, 2) points, m, and (k,) headings, rad.
    """
    headings = np.array([heading for heading, _ in tries])
    R = make_rotation(headings)
    y_aim = aim @ R[:, :, 1].T
    across = pads.edges.reshape(-1, 2) @ R[:, :, 1].T
    half = pads.width / 2
    chosen = [
        _choose_lines(across[:, k], half, y_aim[k], step)
        if corners is None
        else _choose_lines_in_handle(corners @ R[k, :, 1], half, step)
        for k, (_, corners) in enumerate(tries)
    ]
    lines = np.concatenate([np.empty(0), *chosen])
    counts = np.array([len(ys) for ys in chosen], dtype=int)
    R, headings = (np.repeat(array, counts, axis=0) for array in (R, headings))
    blocked = [_block(lines, wall, R) for wall in (pads, *others)]
    row, low, high = _find_gaps(*(np.concatenate(ends, axis=1) for ends in zip(*blocked, strict=True)))
    inside = shapely.contains_xy(shape, *_turn_back((low + high) / 2, lines[row], R[row]).T)
    row, low, high = row[inside], low[inside], high[inside]
    count = np.ceil((high - low) / (ALONG * step)).astype(int) + 1
    which, share = _divide(count)
    x = low[which] + (high - low)[which] * share / np.maximum(count - 1, 1)[which]
    x = np.append(x, np.clip(R[row, :, 0] @ aim, low, high))
    row = np.append(row[which], row)
    return _turn_back(x, lines[row], R[row]), headings[row]


def _turn_back(x: Array, y: Array, R: Array) -> Array:
    """Points (k, 2) in W of those along and across headings, whose rotations are (k, 2, 2)."""
    return x[:, None] * R[:, :, 0] + y[:, None] * R[:, :, 1]


def _choose_lines(corners: Array, half: float, aim: float, step: float) -> Array:
    """The y on which to look in an outline whose corners are at y (k,)."""
    low, high = corners.min() + half, corners.max() - half
    if high < low:
        return np.empty(0)
    even = np.linspace(low, high, int(np.ceil((high - low) / step)) + 1)
    return np.append(even, np.clip(aim, low, high))


def _choose_lines_in_handle(corners: Array, half: float, step: float) -> Array:
    """The y on which to look in a handle whose corners are at y (k,): touching one, and between."""
    touching = np.sort(np.concatenate([corners + half, corners - half]))
    touching = touching[(touching >= corners.min() + half - TOUCH) & (touching <= corners.max() - half + TOUCH)]
    if not len(touching):
        return touching
    touching = touching[np.append(True, np.diff(touching) > TOUCH)]
    gaps = np.diff(touching)
    count = np.ceil(gaps / step).astype(int)
    which, share = _divide(count)
    return np.concatenate([touching, touching[which] + gaps[which] * (share + 0.5) / count[which]])


def _divide(count: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of (k,) counts, each as often as it counts, and how often it was there before."""
    which = np.repeat(np.arange(len(count)), count)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)


def _block(lines: Array, wall: Walls, R: Array) -> tuple[Array, Array]:
    """Where on the lines (l,), whose rotations are (l, 2, 2), the edges begin and cease to block, two (l, e).

    Infinite where they do not.
    """
    x0, x1, y0, y1 = (R[:, :, axis] @ wall.edges[:, end].T for axis in (0, 1) for end in (0, 1))
    low, high = ((lines + side * (wall.width / 2 - TOUCH))[:, None] for side in (-1, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(((low - y0) / (y1 - y0), (high - y0) / (y1 - y0)), 0.0, 1.0)
    xa, xb = x0 + (x1 - x0) * share
    met = (np.maximum(y0, y1) > low) & (np.minimum(y0, y1) < high)
    begin = np.where(met, np.minimum(xa, xb) - wall.front + TOUCH, np.inf)
    return begin, np.where(met, np.maximum(xa, xb) - wall.back - TOUCH, -np.inf)


def _find_gaps(begin: Array, end: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Bounded gaps between intervals (l, e) on every line: their line's index, and where they begin and end."""
    order = np.argsort(begin, axis=1)
    begin = np.take_along_axis(begin, order, axis=1)
    end = np.maximum.accumulate(np.take_along_axis(end, order, axis=1), axis=1)
    row, k = np.nonzero((begin[:, 1:] >= end[:, :-1]) & np.isfinite(begin[:, 1:]))
    return row, end[row, k], begin[row, k + 1]

"""The outline of a mask: smooth enough that a pusher feels the object's sides, not its pixels."""

from itertools import pairwise

import numpy as np
import shapely
from contourpy import FillType, contour_generator
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from shapely import Polygon
from shapely.geometry.polygon import orient

from gridpush_drake.grid.edge_fit import fit_edges

HALF = 0.5
"""Share at which a pixel counts as object, and the offset of a pixel's middle from its corner."""

SMOOTHING = 1.0
"""Standard deviation of the Gaussian, pixels."""

TOLERANCE = 0.75
"""How far the simplified outline may leave the contour, pixels: just more than a pixel's step."""

SMALLEST_HOLE = 9.0
"""Holes of less area are dropped, pixels."""

AREA_TOLERANCE = 0.02
"""The smooth outline is kept while its area is within this part of the mask's; thin objects fail it."""

MOST_STEPS = 60_000
"""A mask whose boundary takes more pixel sides than this is noise at its own scale; it is traced at a coarser one."""

STITCH = 0.05
"""Pixels that only touch at a corner are joined by a bridge of about this half width, pixels."""


def calc_contour(coverage: NDArray[np.float64]) -> Polygon:
    """Traces the outline of a mask.

    Args:
        coverage: (height, width) share of each pixel that is object, 0 to 1; one 8-connected piece.

    Returns:
        A valid polygon with holes in pixels from the upper left corner, x right and y *down*, its outer ring
        counterclockwise in these axes.
    """
    scale = 1
    while _count_steps(coverage) > MOST_STEPS:
        coverage, scale = _halve(coverage), 2 * scale
    outline = _trace_smooth(coverage)
    if outline is None or abs(outline.area / coverage.sum() - 1) > AREA_TOLERANCE:
        outline = _trace_pixels(coverage)
    return orient(shapely.transform(outline, lambda points: points * scale))


def _count_steps(coverage: NDArray[np.float64]) -> int:
    solid = coverage >= HALF
    return sum(int(np.count_nonzero(np.diff(solid, axis=axis))) for axis in (0, 1))


def _halve(coverage: NDArray[np.float64]) -> NDArray[np.float64]:
    even = np.pad(coverage, [(0, side % 2) for side in coverage.shape])
    return even.reshape(even.shape[0] // 2, 2, -1, 2).mean(axis=(1, 3))


def _trace_smooth(coverage: NDArray[np.float64]) -> Polygon | None:
    margin = int(np.ceil(4 * SMOOTHING))
    field = gaussian_filter(np.pad(coverage, margin), SMOOTHING)
    generator = contour_generator(z=field, fill_type=FillType.OuterOffset)
    pieces = []
    for points, offsets in zip(*generator.filled(HALF, np.inf), strict=True):
        rings = [_from_corner(points[a:b]) + (HALF - margin) for a, b in pairwise(offsets)]
        pieces.append(Polygon(rings[0], [ring for ring in rings[1:] if Polygon(ring).area >= SMALLEST_HOLE]))
    if not pieces:
        return None
    traced = max(pieces, key=lambda piece: piece.area)
    simple = _simplify(traced)
    return None if simple is None else _fit(traced, simple)


def _fit(traced: Polygon, simple: Polygon) -> Polygon:
    """Edges fitted through the traced points, where that leaves a valid polygon."""
    points = [np.array(ring.coords)[:-1] for ring in (traced.exterior, *traced.interiors)]
    corners = [np.array(ring.coords)[:-1] for ring in (simple.exterior, *simple.interiors)]
    starts = {tuple(ring[0]): ring for ring in points}
    if any(tuple(ring[0]) not in starts for ring in corners):
        return simple
    outer, *holes = (fit_edges(starts[tuple(ring[0])], ring) for ring in corners)
    fitted = Polygon(outer, holes)
    return fitted if fitted.is_valid and abs(fitted.area / traced.area - 1) <= AREA_TOLERANCE else simple


def _from_corner(ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """Begins a closed ring at its point farthest from the middle: simplification never moves the first point."""
    ring = ring[:-1]
    far = int(np.argmax(((ring - ring.mean(axis=0)) ** 2).sum(axis=1)))
    return np.roll(ring, -far, axis=0)


def _trace_pixels(coverage: NDArray[np.float64]) -> Polygon:
    """Exact union of the pixels at least half object (of those touched, where they fall apart)."""
    for least in (0.5, np.finfo(float).tiny):
        row, column = np.nonzero(coverage >= least)
        if not len(row):
            continue
        union = shapely.union_all(shapely.box(column, row, column + 1, row + 1)).buffer(STITCH, join_style="mitre")
        if isinstance(union, Polygon):
            holes = [ring for ring in union.interiors if Polygon(ring).area >= SMALLEST_HOLE]
            union = Polygon(union.exterior, holes)
            return _simplify(union) or union
    return max(union.geoms, key=lambda piece: piece.area)


def _simplify(polygon: Polygon) -> Polygon | None:
    simple = polygon.simplify(TOLERANCE, preserve_topology=True)
    usable = isinstance(simple, Polygon) and not simple.is_empty and simple.is_valid and simple.area > 0
    return simple if usable else None

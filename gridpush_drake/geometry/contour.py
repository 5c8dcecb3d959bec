"""The outline of a mask: smooth enough that a pusher feels the object's sides, not its pixels.

The contour at half coverage of the smoothed mask is traced and simplified; then straight edges are
fitted through the traced points, so that their normals do not hang on two of them.
"""

from itertools import pairwise

import numpy as np
import shapely
from contourpy import FillType, contour_generator
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from shapely import Polygon
from shapely.geometry.polygon import orient

HALF = 0.5  # share at which a pixel counts as object, and the offset of a pixel's middle from its corner
SMOOTHING = 1.0  # standard deviation of the Gaussian, pixels: a mask's steps do not show
TOLERANCE = 0.75  # how far the simplified outline may leave the contour, pixels: just more than a pixel's step
MIN_HOLE = 9.0  # holes of less area are dropped, pixels

AREA_TOLERANCE = 0.02
"""The smooth outline is kept while its area is within this part of the mask's; thin objects fail
it."""

MAX_STEPS = 60_000
"""A mask whose boundary takes more pixel sides than this is noise at its own scale; it is traced at
a coarser one."""

STITCH = 0.05  # pixels that only touch at a corner are joined by a bridge of about this half width, pixels
TRIM = 2.0  # length left out of the fit at each end of an edge, pixels: corners are rounded there
MIN_FITTED = 6.0  # shorter edges are not fitted but drawn from vertex to vertex, pixels

STRAIGHT = 0.75
"""Two edges become one when no point between their ends leaves the line through both by more,
pixels."""

MIN_CORNERS = 3  # no ring is left fewer
MIN_SINE = 0.1  # edges that turn by less than this do not meet at a usable intersection
MAX_MOVE = 1.5  # no vertex is moved further, pixels


def calc_contour(coverage: NDArray[np.float64], smoothing: float = SMOOTHING) -> Polygon:
    """Traces the outline of a mask, one 8-connected piece.

    Args:
        coverage: (height, width) share of each pixel that is object.
        smoothing: standard deviation of the Gaussian that it goes through, pixels; less rounds
            corners less, but takes a coverage finer than yes and no.

    Returns:
        A valid polygon with holes in pixels from the upper left corner, x right and y *down*, its
        outer ring counterclockwise in these axes.
    """
    scale = 1
    while _count_steps(coverage) > MAX_STEPS:
        coverage, scale = _halve(coverage), 2 * scale
    outline = _trace_smooth(coverage, smoothing)
    if outline is None or abs(outline.area / coverage.sum() - 1) > AREA_TOLERANCE:
        outline = _trace_pixels(coverage)
    return orient(shapely.transform(outline, lambda points: points * scale))


def _count_steps(coverage: NDArray[np.float64]) -> int:
    solid = coverage >= HALF
    return sum(int(np.count_nonzero(np.diff(solid, axis=axis))) for axis in (0, 1))


def _halve(coverage: NDArray[np.float64]) -> NDArray[np.float64]:
    even = np.pad(coverage, [(0, side % 2) for side in coverage.shape])
    return even.reshape(even.shape[0] // 2, 2, -1, 2).mean(axis=(1, 3))


def _trace_smooth(coverage: NDArray[np.float64], smoothing: float) -> Polygon | None:
    margin = int(np.ceil(4 * smoothing))
    field = gaussian_filter(np.pad(coverage, margin), smoothing)
    generator = contour_generator(z=field, fill_type=FillType.OuterOffset)
    pieces = []
    for points, offsets in zip(*generator.filled(HALF, np.inf), strict=True):
        rings = [_from_corner(points[a:b]) + (HALF - margin) for a, b in pairwise(offsets)]
        pieces.append(
            Polygon(rings[0], [ring for ring in rings[1:] if Polygon(ring).area >= MIN_HOLE])
        )
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
    return (
        fitted
        if fitted.is_valid and abs(fitted.area / traced.area - 1) <= AREA_TOLERANCE
        else simple
    )


def _from_corner(ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """Begins a closed ring at its point farthest from the middle: simplification never moves the first point."""
    ring = ring[:-1]
    far = int(np.argmax(((ring - ring.mean(axis=0)) ** 2).sum(axis=1)))
    return np.roll(ring, -far, axis=0)


def _trace_pixels(coverage: NDArray[np.float64]) -> Polygon:
    """Exact union of the pixels at least half object (of those touched, where they fall apart)."""
    for min_share in (HALF, np.finfo(float).tiny):
        row, column = np.nonzero(coverage >= min_share)
        if not len(row):
            continue
        union = shapely.union_all(shapely.box(column, row, column + 1, row + 1)).buffer(
            STITCH, join_style="mitre"
        )
        if isinstance(union, Polygon):
            holes = [ring for ring in union.interiors if Polygon(ring).area >= MIN_HOLE]
            union = Polygon(union.exterior, holes)
            return _simplify(union) or union
    return max(union.geoms, key=lambda piece: piece.area)


def _simplify(polygon: Polygon) -> Polygon | None:
    simple = polygon.simplify(TOLERANCE, preserve_topology=True)
    usable = (
        isinstance(simple, Polygon) and not simple.is_empty and simple.is_valid and simple.area > 0
    )
    return simple if usable else None


def fit_edges(ring: NDArray[np.float64], simple: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fits the edges of a simplified ring to the points it was made from.

    Args:
        ring: (k, 2) traced points of a closed ring, first one not repeated, pixels.
        simple: (v, 2) vertices of the simplified ring, some of those points in the same order.

    Returns:
        (w, 2) vertices, w <= v: near-straight corners are dropped, the others are where fitted
        edges meet.
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
    while waiting and len(after) > MIN_CORNERS:
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
    long_enough = np.linalg.norm(points[-1] - points[0]) >= MIN_FITTED and len(inner) > 1
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
    if abs(np.linalg.det(normals)) >= MIN_SINE:
        move = np.linalg.solve(normals, gaps)
        if np.linalg.norm(move) <= MAX_MOVE:
            return corner + move
    return corner + gaps @ normals / 2

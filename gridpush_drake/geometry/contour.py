"""The outline of a mask: smooth enough that a pusher feels the object's sides, not its pixels.

A mask's boundary is a staircase. Its outline is found in four steps:

1. The mask is smoothed by a Gaussian, and the contour at half coverage is traced.
2. The contour is simplified to few vertices, which are some of the traced points.
3. Corners at which the contour hardly turns are dropped.
4. A straight line is fitted through the traced points along each edge, and the vertices move to
   where neighboring lines meet. The edges' normals, which decide where a push leads, so hang on all
   points along an edge and not on two of them.

Where an object is so thin that smoothing changes its area, the pixels' own boundary is simplified
instead. A mask with a very long boundary is halved in resolution first.

Lengths here are in pixels, from the upper left corner of the mask, x to the right and y *down*. How
large a pixel is, and where the body frame lies, is decided in `objects.mask`.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
import shapely
from contourpy import FillType, contour_generator
from scipy.ndimage import gaussian_filter
from shapely import LinearRing, Polygon
from shapely.geometry.polygon import orient

from gridpush_drake.geometry.se2 import Array

HALF_PIXEL = 0.5
"""Fraction of a pixel that is object from which on the pixel counts as object. It is also the
distance in x and y of a pixel's center from its upper left corner, pixels."""

MASK_SMOOTHING = 1.0
"""Standard deviation of the Gaussian that hides the steps of a mask, pixels."""

SMOOTHING_REACH = 4
"""Margin around a mask before it is smoothed, in standard deviations of the Gaussian, so that the
contour closes."""

CONTOUR_TOLERANCE = 0.75
"""Farthest that the simplified outline may leave the contour, pixels. It is just more than the
pixels' steps leave the contour, so that no step becomes an edge."""

MIN_HOLE = 9.0
"""Smallest area of a hole that is kept, pixels²."""

AREA_TOLERANCE = 0.02
"""Largest relative change of the area by smoothing and by fitting. Beyond it, as with thin objects,
the smoothed or fitted outline is not used."""

MAX_STEPS = 60_000
"""Largest number of pixel sides in the boundary of a mask. One with more is noise at its own scale;
it is traced at half the resolution, or less."""

STITCH_HALF_WIDTH = 0.05
"""Half width of the bridge by which pixels that touch at a corner only are joined, pixels."""

EDGE_TRIM = 2.0
"""Length of the contour at each end of an edge that is left out of the fit, pixels, for smoothing
rounds the corners."""

MIN_FITTED = 6.0
"""Length of an edge from which on a line is fitted through its points, pixels. A shorter edge is
drawn from vertex to vertex."""

STRAIGHT_TOLERANCE = 0.75
"""Two neighboring edges become one when no traced point between their ends is farther from one line
through them, pixels."""

MIN_CORNERS = 3
"""Smallest number of vertices that a ring keeps."""

MIN_SINE = 0.1
"""Sine of the angle between two fitted lines below which their intersection is too uncertain to be
a vertex."""

MAX_MOVE = 1.5
"""Farthest that a vertex is moved to an intersection, pixels."""

Points = Array
"""Points (k, 2), pixels. Those of a ring are without the first one repeated at the end."""


Ring = TypeVar("Ring", Points, LinearRing)


class Line(NamedTuple):
    """A straight line.

    Attributes:
        middle: (2,) a point on it, pixels.
        normal: (2,) its unit normal.
    """

    middle: Array
    normal: Array

    def measure(self, points: Points) -> Array:
        """Signed distances (...,) of points (..., 2) from the line, pixels."""
        return (points - self.middle) @ self.normal


def calc_contour(coverage: Array, smoothing: float = MASK_SMOOTHING) -> Polygon:
    """Traces the outline of a mask, one 8-connected piece.

    Args:
        coverage: (height, width) fraction of each pixel that is object, 0 to 1.
        smoothing: standard deviation of the Gaussian, pixels; a smaller one rounds corners less,
            but wants a coverage finer than yes and no.

    Returns:
        A valid polygon with holes in pixels from the upper left corner, x right and y *down*, its
        outer ring counterclockwise in these axes.
    """
    # A boundary that is noise is traced at a coarser scale.
    scale = 1
    while _count_steps(coverage) > MAX_STEPS:
        coverage = _halve(coverage)
        scale *= 2

    # Smoothing swallows what is thinner than itself; there the pixels' own boundary is better.
    outline = _trace_smooth(coverage, smoothing)
    if outline is None or not _has_area(outline, coverage.sum()):
        outline = _trace_pixels(coverage)
    return orient(shapely.transform(outline, lambda points: points * scale))


def _count_steps(coverage: Array) -> int:
    """Counts the pixel sides between object and background."""
    solid = coverage >= HALF_PIXEL
    between_rows = np.diff(solid, axis=0)
    between_columns = np.diff(solid, axis=1)
    count = np.count_nonzero(between_rows) + np.count_nonzero(between_columns)
    return int(count)


def _halve(coverage: Array) -> Array:
    """Averages squares of four pixels; an odd side is filled up with background."""
    height, width = coverage.shape
    missing_rows = (0, height % 2)
    missing_columns = (0, width % 2)
    missing = [missing_rows, missing_columns]
    even = np.pad(coverage, missing)
    # rows of squares, rows within a square, columns of squares, columns within a square
    squares = even.reshape(len(even) // 2, 2, -1, 2)
    return squares.mean(axis=(1, 3))


def _trace_smooth(coverage: Array, smoothing: float) -> Polygon | None:
    """Traces the contour of the smoothed mask, and fits its edges.

    Returns:
        The largest piece; None where smoothing leaves none, or it cannot be simplified.
    """
    margin = int(np.ceil(SMOOTHING_REACH * smoothing))
    padded = np.pad(coverage, margin)
    field = gaussian_filter(padded, smoothing)
    generator = contour_generator(z=field, fill_type=FillType.OuterOffset)

    # Contourpy gives all rings of a piece in one array, the outer one first, and where each begins.
    # Its points are counted from the center of the first pixel, the outline's from its corner.
    pieces = []
    filled = generator.filled(HALF_PIXEL, np.inf)
    for points, offsets in zip(*filled, strict=True):
        rings = []
        for first, end in pairwise(offsets):
            ring = _begin_at_a_corner(points[first:end])
            rings.append(ring + (HALF_PIXEL - margin))
        pieces.append(Polygon(rings[0], _keep_large(rings[1:])))
    if not pieces:
        return None
    traced = max(pieces, key=lambda piece: piece.area)
    simple = _simplify(traced)
    return None if simple is None else _fit(traced, simple)


def _keep_large(holes: Iterable[Ring]) -> list[Ring]:
    """Leaves out the holes that are too small to be of the object."""
    return [ring for ring in holes if Polygon(ring).area >= MIN_HOLE]


def _fit(traced: Polygon, simple: Polygon) -> Polygon:
    """Fits the edges of a simplified polygon to the polygon that it was made from.

    Returns:
        The fitted polygon; the simplified one where that is not valid or of another area.
    """
    # Simplification drops rings but keeps the first point of each, which tells what it came from.
    traced_rings = {tuple(ring[0]): ring for ring in _list_rings(traced)}
    fitted_rings = []
    for ring in _list_rings(simple):
        points = traced_rings.get(tuple(ring[0]))
        if points is None:
            return simple
        fitted_rings.append(fit_edges(points, ring))
    fitted = Polygon(fitted_rings[0], fitted_rings[1:])
    is_usable = fitted.is_valid and _has_area(fitted, traced.area)
    return fitted if is_usable else simple


def _has_area(polygon: Polygon, expected: float) -> bool:
    """Whether a polygon has about the area that is expected, pixels²."""
    change = abs(polygon.area / expected - 1)
    return bool(change <= AREA_TOLERANCE)


def _list_rings(polygon: Polygon) -> list[Points]:
    """Lists a polygon's rings, the outer one first."""
    rings = [polygon.exterior, *polygon.interiors]
    return [np.array(ring.coords)[:-1] for ring in rings]


def _begin_at_a_corner(ring: Points) -> Points:
    """Begins a closed ring at its point farthest from the middle.

    Simplification never moves a ring's first point, so that it should be a corner of the object.

    Args:
        ring: (k+1, 2) with the first point once more at the end.

    Returns:
        (k, 2) without it.
    """
    ring = ring[:-1]
    middle = ring.mean(axis=0)
    arm = ring - middle
    squared_distance = (arm**2).sum(axis=1)
    farthest = int(np.argmax(squared_distance))
    return np.roll(ring, -farthest, axis=0)


def _trace_pixels(coverage: Array) -> Polygon:
    """Unites the pixels that are at least half object, and simplifies the union's boundary.

    Where they are in several pieces, all pixels that are touched are united; of several pieces
    even then, the largest is taken.
    """
    for min_fraction in (HALF_PIXEL, np.finfo(float).tiny):
        row, column = np.nonzero(coverage >= min_fraction)
        if not len(row):
            continue
        squares = shapely.box(column, row, column + 1, row + 1)
        union = shapely.union_all(squares).buffer(STITCH_HALF_WIDTH, join_style="mitre")
        if isinstance(union, Polygon):
            holes = _keep_large(union.interiors)
            union = Polygon(union.exterior, holes)
            return _simplify(union) or union
    return max(union.geoms, key=lambda piece: piece.area)


def _simplify(polygon: Polygon) -> Polygon | None:
    """Leaves out vertices (Douglas and Peucker); None where that leaves no valid polygon."""
    simple = polygon.simplify(CONTOUR_TOLERANCE, preserve_topology=True)
    if not isinstance(simple, Polygon) or simple.is_empty or not simple.is_valid:
        return None
    return simple if simple.area > 0 else None


def fit_edges(ring: Points, simple: Points) -> Points:
    """Fits the edges of a simplified ring to the points it was made from.

    Args:
        ring: (k, 2) traced points of a closed ring, first one not repeated, pixels.
        simple: (v, 2) vertices of the simplified ring, some of those points in the same order.

    Returns:
        (w, 2) vertices, w <= v: near-straight corners are dropped, the others are where fitted
        edges meet.
    """
    index = {tuple(point): i for i, point in enumerate(ring)}
    all_corners = [index[tuple(vertex)] for vertex in simple]
    corners = _drop_straight(ring, all_corners)

    # Edge i runs from corner i to the next one; so edges i - 1 and i meet at corner i.
    following = corners[1:] + corners[:1]
    lines = []
    for corner, after in zip(corners, following, strict=True):
        points = _take_between(ring, corner, after)
        lines.append(_fit_line(points))
    vertices = []
    for i, corner in enumerate(corners):
        vertex = _meet(lines[i - 1], lines[i], ring[corner])
        vertices.append(vertex)
    return np.array(vertices)


def _drop_straight(ring: Points, corners: list[int]) -> list[int]:
    """Drops the corners of a ring at which the traced points go on nearly straight.

    Args:
        ring: (k, 2) traced points, pixels.
        corners: indices of those that are corners, in order.

    Returns:
        The indices that are left, in order.
    """
    after = dict(zip(corners, corners[1:] + corners[:1], strict=True))
    before = {next_one: corner for corner, next_one in after.items()}
    waiting = list(reversed(corners))
    while waiting and len(after) > MIN_CORNERS:
        corner = waiting.pop()
        if corner not in after:
            continue  # it was dropped before its turn came again
        previous = before[corner]
        following = after[corner]
        points = _take_between(ring, previous, following)
        line = _fit_line(points)
        distances = np.abs(line.measure(points))
        if distances.max() > STRAIGHT_TOLERANCE:
            continue
        # The corner goes. Its neighbors have longer edges now, and are looked at again.
        after[previous] = following
        before[following] = previous
        del after[corner], before[corner]
        waiting += [following, previous]
    return list(after)


def _take_between(ring: Points, first: int, last: int) -> Points:
    """Takes a ring's points from one index to another, both included, past its end if need be."""
    end = last + 1
    if first < last:
        return ring[first:end]
    return np.concatenate([ring[first:], ring[:end]])


def _trim(points: Points) -> Points:
    """Leaves out the points near the ends of an edge; of a short edge the two ends are left."""
    ends = points[[0, -1]]
    first, last = ends
    from_first = np.linalg.norm(points - first, axis=1)
    from_last = np.linalg.norm(points - last, axis=1)
    nearest = np.minimum(from_first, from_last)
    inner = points[nearest >= EDGE_TRIM]
    length = np.linalg.norm(last - first)
    is_short = length < MIN_FITTED
    return ends if is_short or len(inner) < 2 else inner


def _fit_line(points: Points) -> Line:
    """Fits a line through the points of an edge, by total least squares."""
    inner = _trim(points)
    middle = inner.mean(axis=0)
    # The normal is the direction in which the points spread least.
    directions = np.linalg.svd(inner - middle, full_matrices=False)[2]
    return Line(middle=middle, normal=directions[1])


def _meet(one: Line, other: Line, corner: Array) -> Array:
    """Finds the vertex between two edges.

    Args:
        one: the line of the edge before it.
        other: the line of the edge after it.
        corner: (2,) the traced point there, pixels.

    Returns:
        (2,) where the lines intersect, if that is near the corner. Else the corner moved half of
        its way to each of the lines, pixels.
    """
    # A point corner + d is on both lines when n_1 . d = gap_1 and n_2 . d = gap_2.
    lines = (one, other)
    normals = np.array([line.normal for line in lines])
    gaps = np.array([-line.measure(corner) for line in lines])
    sine = abs(np.linalg.det(normals))
    if sine >= MIN_SINE:
        move = np.linalg.solve(normals, gaps)
        if np.linalg.norm(move) <= MAX_MOVE:
            return corner + move
    return corner + gaps @ normals / 2

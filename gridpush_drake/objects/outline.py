"""A polygon and the square cells that fill it: `make_polygon` checks it, `fill_outline` fills it.

Which cells are chosen is decided in `lattice`. Masks are filled in `mask`.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import MultiPolygon, Polygon
from shapely.geometry.polygon import orient
from shapely.validation import explain_validity

from gridpush_drake.errors import ObjectError
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.objects.cells import CellGrid, Cells, check_max_cells
from gridpush_drake.objects.lattice import Region, choose_cells

MAX_SIZE = 1e4
"""Largest coordinate of an object, m. Nothing so large is pushed."""

MAX_POINTS = 50_000
"""Largest number of points of an outline with its holes. Outlines of masks have fewer."""

MIN_AREA_FRACTION = 1e-12
"""Fraction of its squared diameter below which an outline's area counts as none."""

EDGE_SLACK = 1e-9
"""Distance from the outline within which a center counts as inside, in the outline's diameters."""

MAX_REMEMBERED = 64
"""Number of polygons whose cells are remembered. A search takes a tenth of a second, and a bench or
a station reads the same few objects again and again."""


def fill_outline(
    outline: ArrayLike | Polygon,
    parts: Mapping[int, ArrayLike | Polygon | MultiPolygon],
    max_cells: int,
    *,
    name: str,
) -> CellGrid:
    """Fills a polygon with square cells whose centers are inside it.

    Args:
        outline: (k, 2) vertices, or a Polygon (with holes), body frame, m.
        parts: polygons by label >= 1, body frame, m; the first to cover a cell's center names its
            part, and a cell that none covers belongs to part 1.
        max_cells: largest number of cells.
        name: the object's name, for messages.

    Returns:
        The cells and the outline, which runs counterclockwise, holes clockwise.

    Raises:
        ObjectError: a polygon crosses itself or has no area, a label is below 1, or the count is
            not positive.
    """
    check_max_cells(name, max_cells)
    polygon = make_polygon(outline, f"{name}: outline")
    polygons = {label: _make_part(label, part, name) for label, part in parts.items()}
    cells = _choose_cells(polygon, int(max_cells))
    return CellGrid(
        p_BC=cells.centers,
        cell_size=cells.size,
        labels=_find_parts(cells.centers, polygons),
        outline=polygon,
    )


@lru_cache(maxsize=MAX_REMEMBERED)
def _choose_cells(polygon: Polygon, max_cells: int) -> Cells:
    """Chooses the cells that fill a polygon, m; the same polygon's are searched for only once."""
    region = _measure(polygon)
    # Centers on the outline count as inside, whatever round-off says.
    slack = EDGE_SLACK * float(np.linalg.norm(region.extent))
    slightly_larger = polygon.buffer(slack, join_style="mitre")
    shapely.prepare(slightly_larger)

    def fraction(corners: Array, size: float) -> Array:
        """Tells cells by their centers: whole where the center is inside, else nothing."""
        x, y = (corners + size / 2).T
        return shapely.contains_xy(slightly_larger, x, y).astype(np.float64)

    def overlap(corners: Array, size: float) -> Array:
        """Measures the fraction of each cell's area that is inside."""
        boxes = shapely.box(*corners.T, *(corners + size).T)
        return shapely.area(shapely.intersection(boxes, polygon)) / size**2

    # The lattice is chosen by these two measures of its cells.
    return choose_cells(region, fraction, overlap, max_cells)


def make_polygon(
    points: ArrayLike | Polygon, what: str, holes: tuple[ArrayLike, ...] = ()
) -> Polygon:
    """Makes a valid polygon without repeated vertices, counterclockwise, holes clockwise.

    Args:
        points: (k, 2) vertices, k >= 3, either way round, first one repeated or not, m; or a
            Polygon.
        what: what it is, at the head of an error's message.
        holes: vertices of its holes, m.

    Raises:
        ObjectError: it is not finite, has no area, crosses itself, or a hole is not inside it.
    """
    if isinstance(points, Polygon):
        polygon = points
        _check_coordinates(shapely.get_coordinates(polygon), what)
    else:
        rings = [_ring(hole, f"{what}, hole {i}") for i, hole in enumerate(holes)]
        polygon = Polygon(_ring(points, what), rings)
    if polygon.is_empty:
        raise ObjectError(f"{what} is empty; expected at least three vertices")
    count = shapely.get_num_coordinates(polygon)
    if count > MAX_POINTS:
        raise ObjectError(f"{what} has {count} points; expected at most {MAX_POINTS}")
    # The hull's area is looked at, for that of a polygon that crosses itself may be anything.
    width, height = np.subtract(polygon.bounds[2:], polygon.bounds[:2])
    least_area = MIN_AREA_FRACTION * (width**2 + height**2)
    if not (np.isfinite(polygon.area) and polygon.convex_hull.area > least_area):
        raise ObjectError(
            f"{what} encloses no area; expected vertices in meters, not all on one line"
        )
    if not polygon.is_valid:
        raise ObjectError(
            f"{what} is not a simple polygon ({explain_validity(polygon)}); it must not cross "
            "itself"
        )
    return orient(shapely.force_2d(shapely.remove_repeated_points(polygon)))


def _ring(points: ArrayLike, what: str) -> Array:
    """Checks the vertices of a ring, m, and makes them an array (k, 2); `what` heads a message."""
    try:
        ring = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ObjectError(f"{what} is not a list of [x, y] points, in meters") from error
    if ring.ndim != 2 or ring.shape[1] != 2 or len(ring) < 3:
        raise ObjectError(
            f"{what} has shape {ring.shape}; expected at least three [x, y] points, in meters"
        )
    _check_coordinates(ring, what)
    return ring


def _check_coordinates(points: Array, what: str) -> None:
    """Refuses coordinates, m, that are not finite or too large; `what` heads the message."""
    if not np.isfinite(points).all():
        raise ObjectError(f"{what} has a coordinate that is not finite; expected numbers in meters")
    farthest = np.abs(points).max(initial=0.0)
    if farthest > MAX_SIZE:
        raise ObjectError(
            f"{what} has a coordinate of {farthest:g} m; expected at most {MAX_SIZE:g} m"
        )


def _make_part(
    label: int, part: ArrayLike | Polygon | MultiPolygon, name: str
) -> Polygon | MultiPolygon:
    if isinstance(label, bool) or not isinstance(label, int | np.integer) or label < 1:
        raise ObjectError(f"{name}: part label is {label!r}; expected a whole number, 1 or more")
    if isinstance(part, MultiPolygon):
        return MultiPolygon([make_polygon(piece, f"{name}: part {label}") for piece in part.geoms])
    return make_polygon(part, f"{name}: part {label}")


def _measure(polygon: Polygon) -> Region:
    """Measures a polygon, m: bounding box, area, centroid and second moments of its area.

    The moments are by Green's theorem, with an edge from a to b of each ring, about the centroid:

        sum over edges (a x b) (2 a_i a_j + a_i b_j + b_i a_j + 2 b_i b_j) / 24

    Holes run the other way round, and so are taken off.
    """
    center = np.array(polygon.centroid.coords[0])
    moments = np.zeros((2, 2))
    for ring in (polygon.exterior, *polygon.interiors):
        p = np.asarray(ring.coords) - center
        a = p[:-1].T
        b = p[1:].T
        cross = a[0] * b[1] - a[1] * b[0]
        for i, j in np.ndindex(2, 2):
            mixed = a[i] * b[j] + b[i] * a[j]
            moments[i, j] += cross @ (2 * a[i] * a[j] + mixed + 2 * b[i] * b[j]) / 24
    low, high = np.array(polygon.bounds).reshape(2, 2)
    return Region(
        low=low,
        extent=high - low,
        area=polygon.area,
        centroid=center,
        covariance=moments / polygon.area,
    )


def _find_parts(centers: Array, parts: Mapping[int, Polygon | MultiPolygon]) -> IntArray:
    """Finds the part (n,) of each cell: the first one that covers its center (n, 2), else 1."""
    labels = np.zeros(len(centers), dtype=np.int64)
    for label, part in parts.items():
        is_new = shapely.intersects_xy(part, *centers.T) & (labels == 0)
        labels[is_new] = label
    return np.where(labels == 0, 1, labels)

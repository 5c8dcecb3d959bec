"""An outline made a valid polygon, and filled with square cells."""

from collections.abc import Mapping

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPolygon, Polygon
from shapely.geometry.polygon import orient
from shapely.validation import explain_validity

from gridpush_drake.errors import ObjectError
from gridpush_drake.objects.cells import MAX_SIZE, CellGrid, Region, check_max_cells, choose_cells

THINNEST = 1e-12
"""An outline whose area is below this share of its squared diameter has none."""

EDGE_SLACK = 1e-9
"""A center this near the outline, in diameters, is on it and counts as inside."""


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
        parts: polygons by label >= 1, body frame, m; the first to cover a cell's center names its part, and a
            cell that none covers belongs to part 1.
        max_cells: the most cells to make.
        name: of the object, for messages.

    Returns:
        The cells and the outline, which runs counterclockwise, holes clockwise.

    Raises:
        ObjectError: a polygon crosses itself or has no area, a label is below 1, or the count is not positive.
    """
    check_max_cells(name, max_cells)
    polygon = make_polygon(outline, f"{name}: outline")
    polygons = {label: _make_part(label, part, name) for label, part in parts.items()}
    region = _describe(polygon)
    slightly_larger = polygon.buffer(EDGE_SLACK * float(np.linalg.norm(region.extent)), join_style="mitre")
    shapely.prepare(slightly_larger)

    def share(corners: NDArray[np.float64], size: float) -> NDArray[np.float64]:
        return shapely.contains_xy(slightly_larger, *(corners + size / 2).T).astype(np.float64)

    def overlap(corners: NDArray[np.float64], size: float) -> NDArray[np.float64]:
        boxes = shapely.box(*corners.T, *(corners + size).T)
        return shapely.area(shapely.intersection(boxes, polygon)) / size**2

    cells = choose_cells(region, share, overlap, int(max_cells))
    return CellGrid(cells.centers, cells.size, _label(cells.centers, polygons), polygon)


def make_polygon(points: ArrayLike | Polygon, what: str, holes: tuple[ArrayLike, ...] = ()) -> Polygon:
    """Makes a valid polygon.

    Args:
        points: (k, 2) vertices, k >= 3, either way round, first one repeated or not, m; or a Polygon.
        what: what it is, at the head of an error's message.
        holes: vertices of its holes, m.

    Returns:
        The polygon without repeated vertices, counterclockwise, holes clockwise.

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
    width, height = np.subtract(polygon.bounds[2:], polygon.bounds[:2])
    if not (np.isfinite(polygon.area) and polygon.convex_hull.area > THINNEST * (width**2 + height**2)):
        raise ObjectError(f"{what} encloses no area; expected vertices in meters, not all on one line")
    if not polygon.is_valid:
        raise ObjectError(f"{what} is not a simple polygon ({explain_validity(polygon)}); it must not cross itself")
    return orient(shapely.force_2d(shapely.remove_repeated_points(polygon)))


def _ring(points: ArrayLike, what: str) -> NDArray[np.float64]:
    try:
        ring = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ObjectError(f"{what} is not a list of [x, y] points, in meters") from error
    if ring.ndim != 2 or ring.shape[1] != 2 or len(ring) < 3:
        raise ObjectError(f"{what} has shape {ring.shape}; expected at least three [x, y] points, in meters")
    _check_coordinates(ring, what)
    return ring


def _check_coordinates(points: NDArray[np.float64], what: str) -> None:
    if not np.isfinite(points).all():
        raise ObjectError(f"{what} has a coordinate that is not finite; expected numbers in meters")
    farthest = np.abs(points).max(initial=0.0)
    if farthest > MAX_SIZE:
        raise ObjectError(f"{what} has a coordinate of {farthest:g} m; expected at most {MAX_SIZE:g} m")


def _make_part(label: int, part: ArrayLike | Polygon | MultiPolygon, name: str) -> Polygon | MultiPolygon:
    if isinstance(label, bool) or not isinstance(label, int | np.integer) or label < 1:
        raise ObjectError(f"{name}: part label is {label!r}; expected a whole number, 1 or more")
    if isinstance(part, MultiPolygon):
        return MultiPolygon([make_polygon(piece, f"{name}: part {label}") for piece in part.geoms])
    return make_polygon(part, f"{name}: part {label}")


def _describe(polygon: Polygon) -> Region:
    """Area, centroid and second moments by Green's theorem over the rings, outer +, holes -."""
    center = np.array(polygon.centroid.coords[0])
    moments = np.zeros((2, 2))
    for ring in (polygon.exterior, *polygon.interiors):
        p = np.asarray(ring.coords) - center
        a, b = p[:-1], p[1:]
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        for i, j in np.ndindex(2, 2):
            mixed = a[:, i] * b[:, j] + b[:, i] * a[:, j]
            moments[i, j] += cross @ (2 * a[:, i] * a[:, j] + mixed + 2 * b[:, i] * b[:, j]) / 24
    low, high = np.array(polygon.bounds).reshape(2, 2)
    return Region(low, high - low, polygon.area, center, moments / polygon.area)


def _label(centers: NDArray[np.float64], parts: Mapping[int, Polygon | MultiPolygon]) -> NDArray[np.int64]:
    labels = np.zeros(len(centers), dtype=np.int64)
    for label, part in parts.items():
        labels[shapely.intersects_xy(part, *centers.T) & (labels == 0)] = label
    return np.where(labels == 0, 1, labels)

"""Square cells that fill an outline: how large they are, where their lattice lies, and which of them touch."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import Delaunay, QhullError, cKDTree
from shapely import MultiPolygon, Polygon
from shapely.geometry.polygon import orient
from shapely.validation import explain_validity

from gridpush_drake.errors import ObjectError
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.notebook import MM, count, draw_cells, make_page

DEFAULT_MAX_CELLS = 127  # the paper's largest grid
MAX_CELLS = 10_000  # of an object; what learning keeps grows with the square of their number
MAX_LABEL = 2**31 - 1  # of a part

MIN_SIZE, MAX_SIZE = 1e-6, 1e4
"""Of a cell's side, least, and of any coordinate of an object, greatest, m; beyond them no object
is pushed."""


MAX_POINTS = 50_000
"""Of an outline, its holes included; masks give fewer."""


class CellGrid(NamedTuple):
    """The geometry of a grid object, body frame; see `GridObject`."""

    p_BC: Array  # (n, 2) cell centers, m
    cell_size: float  # side of a cell, m
    labels: IntArray  # (n,) the part each cell belongs to, >= 1
    outline: Polygon  # contour with holes, m

    def __repr__(self) -> str:
        """Number of cells and their side, in a line."""
        return f"CellGrid of {count(len(self.p_BC), 'cell')} of {self.cell_size * MM:.1f} mm"

    def _repr_html_(self) -> str:
        """Outline and cells."""
        return make_page(repr(self), draw_cells(self.outline, self.p_BC, self.cell_size))


Share = Callable[[Array, float], Array]
"""Given the lower corners (k, 2) of square cells and their size, how much of each is object: (k,),
0 to 1."""

MIN_SHARE = 0.5 - 1e-9  # a cell belongs to the object when at least half of it does

SIZES_FROM, SIZES_TO = 0.9, 1.6
"""Range of sizes tried, in sides of the square cell whose `max_cells` copies have the shape's
area."""

MAX_SIZES, MIN_SIZES = 80, 24
"""How many sizes are tried in that range; as many again that divide a side of the bounding box."""

POINT_BUDGET = (
    3_000_000  # cells that may be tested in a range of sizes before fewer sizes are tried
)
MAX_PHASED = (
    20_000  # in a lattice of more cells than this its phase hardly matters, and only one is tried
)

MAX_LATTICE_PER_CELL = 20
"""A lattice this many times `max_cells` (and above MAX_PHASED) means a shape far thinner than its
bounding box."""

EXACT = 1e-6  # below this error the cells tile the shape

EXACT_LOSS, EXACT_DISCOUNT = 0.11, 0.25
"""Cells that tile the shape are preferred while they leave no more than this part of `max_cells`
unused: it then counts with this weight."""

ERROR_WEIGHT = (
    2.0  # a relative error weighs as much as this many times that part of `max_cells` left unused
)

AREA_WEIGHT = 0.5
"""Weight of the area's error (logarithmic): the cells' area matters less to sliding than where they
are."""

ROUNDING = 1e-9  # relative slack within which a size divides a side


@dataclass(frozen=True)
class Region:
    """What a lattice is to be true to."""

    low: Array  # (2,) lower corner of the bounding box
    extent: Array  # (2,) its sides
    area: float  # of the shape
    centroid: Array  # (2,) of the shape
    covariance: Array  # (2, 2) second central moments of its area over its area


@dataclass(frozen=True)
class Cells:
    """Square cells."""

    corners: Array  # (n, 2) their lower corners
    size: float  # their side

    def __repr__(self) -> str:
        """Their number and side, in a line; the side is in m or, of a mask, in pixels."""
        return f"Cells: {count(len(self.corners), 'square')}, side {self.size:.4g}"

    @property
    def centers(self) -> Array:
        """(n, 2)."""
        return self.corners + self.size / 2


NEAREST = 0.99
"""Cells whose centers are closer than this many sides lie on top of each other."""


def check_cells(grid: CellGrid) -> None:
    """Refuses cells, given one by one, that lie outside the outline or on top of each other.

    Raises:
        ObjectError: a center is further than a cell's side from the outline's inside, or nearer than
            that to another one.
    """
    size, centers = grid.cell_size, grid.p_BC
    away = shapely.distance(grid.outline, shapely.points(centers))
    farthest = int(np.argmax(away))
    if away[farthest] > size:
        x, y = centers[farthest]
        raise ObjectError(
            f"cells.centers[{farthest}] is [{x:g}, {y:g}] m, {away[farthest]:g} m outside the outline; "
            "expected cells that the object has"
        )
    if len(centers) == 1:
        return
    distances, neighbors = cKDTree(centers).query(centers, k=2)
    nearest = int(np.argmin(distances[:, 1]))
    if distances[nearest, 1] < NEAREST * size:
        pair = sorted({nearest, int(neighbors[nearest, 1]), int(neighbors[nearest, 0])})[:2]
        raise ObjectError(
            f"cells.centers[{pair[0]}] and [{pair[1]}] are {distances[nearest, 1]:g} m apart; "
            f"expected squares of {size:g} m that do not overlap"
        )


def check_max_cells(name: str, max_cells: int) -> None:
    """Refuses a `max_cells` that is not a whole number from 1 to MAX_CELLS, with an ObjectError on object `name`."""
    whole = isinstance(max_cells, int | np.integer) and not isinstance(max_cells, bool)
    if not (whole and 1 <= max_cells <= MAX_CELLS):
        raise ObjectError(
            f"{name}: max_cells is {max_cells!r}; expected a whole number, 1 or more, at most {MAX_CELLS}"
        )


def choose_cells(
    region: Region, share: Share, overlap: Share, max_cells: int, min_size: float = 0.0
) -> Cells:
    """Fills a shape with at most `max_cells` cells, weighing their number against their likeness to the shape.

    Sizes from just below the ideal one upwards are tried, with lattices centered on the bounding
    box or aligned with a side of it. The cost is the part of `max_cells` not used plus the relative
    errors of the centroid, of the second moments and of the area. The choice is deterministic.

    Args:
        share: decides which cells belong (at least half).
        overlap: exact share of each cell's area, for shapes so thin that no cell is half full.
        min_size: no smaller cells than this, in the region's unit.
    """
    low = max(min_size, SIZES_FROM * float(np.sqrt(region.area / max_cells)))
    high = low * (SIZES_TO / SIZES_FROM)
    while low <= region.extent.max():
        points = float(np.prod(region.extent / low + 1))
        if points > max(MAX_PHASED, MAX_LATTICE_PER_CELL * max_cells):
            break
        best = _find_best(region, share, max_cells, low, high, points)
        if best is not None:
            return best
        low, high = high, high * (SIZES_TO / SIZES_FROM)
    return _take_touched(region, overlap, max_cells, min_size)


def _find_best(
    region: Region, share: Share, max_cells: int, low: float, high: float, points: float
) -> Cells | None:
    best, min_cost = None, np.inf
    for size in _candidate_sizes(region, low, high, points):
        for corners in _lattices(region, float(size), phased=points < MAX_PHASED):
            cells = Cells(corners[share(corners, float(size)) >= MIN_SHARE], float(size))
            if not 0 < len(cells.corners) <= max_cells:
                continue
            cost = _calc_cost(region, cells, max_cells)
            if cost < min_cost:
                best, min_cost = cells, cost
    return best


def _candidate_sizes(region: Region, low: float, high: float, points: float) -> Array:
    count = int(np.clip(POINT_BUDGET / points, MIN_SIZES, MAX_SIZES))
    sizes = [np.geomspace(low, high, count)]
    for side in region.extent:
        divisions = np.arange(
            max(1, np.ceil(side / high)), np.floor(side / low * (1 + ROUNDING)) + 1
        )
        sizes.append(side / divisions[:: 1 + len(divisions) // count])
    return np.unique(np.concatenate(sizes))


def _calc_cost(region: Region, cells: Cells, max_cells: int) -> float:
    arm = cells.centers - region.centroid
    offset = arm.mean(axis=0)
    covariance = arm.T @ arm / len(arm) - np.outer(offset, offset) + cells.size**2 / 12 * np.eye(2)
    spread = float(np.trace(region.covariance))
    error = (
        np.linalg.norm(offset) / np.sqrt(spread)
        + np.abs(covariance - region.covariance).sum() / spread
    )
    error += AREA_WEIGHT * abs(np.log(len(arm) * cells.size**2 / region.area))
    unused = 1 - len(arm) / max_cells
    return float(
        ERROR_WEIGHT * error
        + unused * (EXACT_DISCOUNT if error < EXACT and unused <= EXACT_LOSS else 1)
    )


def _lattices(region: Region, size: float, phased: bool) -> Iterator[Array]:
    """Lower corners (k, 2) of the cells of each lattice that covers the bounding box, but for half cells."""
    axes = []
    for low, extent in zip(region.low, region.extent, strict=True):
        up = max(1, int(np.ceil(extent / size * (1 - ROUNDING))))
        down = max(1, int(np.floor(extent / size * (1 + ROUNDING))))
        starts = [(low + (extent - up * size) / 2, up)]
        if phased and up != down:
            starts += [
                (low + (extent - down * size) / 2, down),
                (low, up),
                (low + extent - up * size, up),
            ]
        axes.append([start + size * np.arange(k) for start, k in starts])
    for x, y in product(*axes):
        yield np.column_stack([axis.ravel() for axis in np.meshgrid(x, y)])


def _take_touched(region: Region, overlap: Share, max_cells: int, min_size: float) -> Cells:
    """The finest cells, halved from the bounding box, of which the shape touches at most `max_cells`."""
    size = max(min_size, float(region.extent.max()))
    cells = Cells((region.low + (region.extent - size) / 2)[None], size)
    quarters = np.array(list(product((0.0, 0.5), repeat=2)))
    while cells.size / 2 >= min_size:
        corners = (cells.corners[:, None] + cells.size * quarters).reshape(-1, 2)
        corners = corners[overlap(corners, cells.size / 2) > 0]
        if not 0 < len(corners) <= max_cells:
            break
        cells = Cells(corners, cells.size / 2)
    return cells


SIDE_REACH = 1.2
"""Centers nearer than this many cell sides share a side; diagonal neighbors are sqrt(2) sides
apart."""

FLATNESS = 1e-9
"""Cells whose extent across their main direction is below this many cell sides stand in one
line."""


def calc_adjacency(p_BC: ArrayLike, cell_size: float) -> IntArray:
    """Finds the pairs of cells that share a side, and joins islands by their shortest links.

    Args:
        p_BC: (n, 2) cell centers on a square lattice, any one frame, m.

    Returns:
        (m, 2) pairs i < j in increasing order; as a graph they connect all n cells.
    """
    p_BC = np.asarray(p_BC, dtype=np.float64)
    pairs = (
        cKDTree(p_BC).query_pairs(SIDE_REACH * cell_size, output_type="ndarray").astype(np.int64)
    )
    islands = _find_islands(pairs, len(p_BC))
    if islands.max() > 0:
        pairs = np.concatenate([pairs, _calc_links(p_BC, cell_size, islands)])
    return _tidy(pairs)


def _find_islands(pairs: IntArray, n: int) -> IntArray:
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _calc_links(p_BC: Array, cell_size: float, islands: IntArray) -> IntArray:
    """Shortest tree of links between islands; the Delaunay edges contain the Euclidean spanning tree."""
    candidates = _tidy(_delaunay_edges(p_BC, cell_size))
    i, j = candidates[islands[candidates[:, 0]] != islands[candidates[:, 1]]].T
    length = np.linalg.norm(p_BC[i] - p_BC[j], axis=1)
    ends = np.sort(np.column_stack([islands[i], islands[j]]), axis=1)
    order = np.lexsort((length, ends[:, 1], ends[:, 0]))
    first = order[np.unique(ends[order], axis=0, return_index=True)[1]]
    count = int(islands.max()) + 1
    graph = coo_array((length[first], (ends[first, 0], ends[first, 1])), shape=(count, count))
    tree = minimum_spanning_tree(graph.tocsr()).tocoo()
    chosen = {(int(a), int(b)) for a, b in zip(*tree.coords, strict=True)}
    kept = [k for k in first if (int(ends[k, 0]), int(ends[k, 1])) in chosen]
    return np.column_stack([i[kept], j[kept]])


def _delaunay_edges(p_BC: Array, cell_size: float) -> IntArray:
    centered = (p_BC - p_BC.mean(axis=0)) / cell_size
    along, _, axes = np.linalg.svd(centered, full_matrices=False)
    across = centered @ axes[-1]
    if len(p_BC) > 2 and np.ptp(across) > FLATNESS:
        try:
            simplices = Delaunay(centered).simplices
            return np.concatenate(
                [simplices[:, [0, 1]], simplices[:, [1, 2]], simplices[:, [2, 0]]]
            ).astype(np.int64)
        except QhullError:
            pass
    order = np.argsort(along[:, 0], kind="stable")
    return np.column_stack([order[:-1], order[1:]]).astype(np.int64)


def _tidy(pairs: IntArray) -> IntArray:
    return np.unique(np.sort(pairs, axis=1), axis=0).reshape(-1, 2)


THINNEST = 1e-12  # an outline whose area is below this share of its squared diameter has none
EDGE_SLACK = 1e-9  # a center this near the outline, in diameters, is on it and counts as inside


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

    Returns:
        The cells and the outline, which runs counterclockwise, holes clockwise.

    Raises:
        ObjectError: a polygon crosses itself or has no area, a label is below 1, or the count is
            not positive.
    """
    check_max_cells(name, max_cells)
    polygon = make_polygon(outline, f"{name}: outline")
    polygons = {label: _make_part(label, part, name) for label, part in parts.items()}
    region = _describe(polygon)
    slightly_larger = polygon.buffer(
        EDGE_SLACK * float(np.linalg.norm(region.extent)), join_style="mitre"
    )
    shapely.prepare(slightly_larger)

    def share(corners: Array, size: float) -> Array:
        return shapely.contains_xy(slightly_larger, *(corners + size / 2).T).astype(np.float64)

    def overlap(corners: Array, size: float) -> Array:
        boxes = shapely.box(*corners.T, *(corners + size).T)
        return shapely.area(shapely.intersection(boxes, polygon)) / size**2

    cells = choose_cells(region, share, overlap, int(max_cells))
    return CellGrid(cells.centers, cells.size, _label(cells.centers, polygons), polygon)


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
    width, height = np.subtract(polygon.bounds[2:], polygon.bounds[:2])
    if not (
        np.isfinite(polygon.area) and polygon.convex_hull.area > THINNEST * (width**2 + height**2)
    ):
        raise ObjectError(
            f"{what} encloses no area; expected vertices in meters, not all on one line"
        )
    if not polygon.is_valid:
        raise ObjectError(
            f"{what} is not a simple polygon ({explain_validity(polygon)}); it must not cross itself"
        )
    return orient(shapely.force_2d(shapely.remove_repeated_points(polygon)))


def _ring(points: ArrayLike, what: str) -> Array:
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


def _label(centers: Array, parts: Mapping[int, Polygon | MultiPolygon]) -> IntArray:
    labels = np.zeros(len(centers), dtype=np.int64)
    for label, part in parts.items():
        labels[shapely.intersects_xy(part, *centers.T) & (labels == 0)] = label
    return np.where(labels == 0, 1, labels)

"""Square cells that fill an outline: their size, where their lattice lies, and which of them touch.

The size and the place of the lattice are chosen so that the cells have the shape's area, center and
second moments: on these it depends how the object slides. Masks are filled by the same choice, see
`objects.mask`. What the cells weigh, and how they rub, stands in `objects.parameters`.
"""

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

DEFAULT_MAX_CELLS = 127
"""Largest number of cells where nobody asks for another one; it is the paper's largest grid."""

MAX_CELLS = 10_000
"""Largest number of cells of an object. What learning keeps grows with its square."""

MAX_LABEL = 2**31 - 1
"""Largest label of a part."""

MIN_SIZE = 1e-6
"""Smallest side of a cell, m. Nothing so small is pushed."""

MAX_SIZE = 1e4
"""Largest coordinate of an object, m. Nothing so large is pushed."""

MAX_POINTS = 50_000
"""Largest number of points of an outline with its holes. Outlines of masks have fewer."""


class CellGrid(NamedTuple):
    """The geometry of a grid object, body frame; see `GridObject`.

    Attributes:
        p_BC: (n, 2) cell centers, m.
        cell_size: side of a cell, m.
        labels: (n,) the part each cell belongs to, >= 1.
        outline: contour with holes, m.
    """

    p_BC: Array
    cell_size: float
    labels: IntArray
    outline: Polygon

    def __repr__(self) -> str:
        """Number of cells and their side, in a line."""
        return f"CellGrid of {count(len(self.p_BC), 'cell')} of {self.cell_size * MM:.1f} mm"

    def _repr_html_(self) -> str:
        """Outline and cells."""
        return make_page(repr(self), draw_cells(self.outline, self.p_BC, self.cell_size))


Share = Callable[[Array, float], Array]
"""Says how much of square cells is object: from their lower corners (k, 2) and their side to the
shares (k,), 0 to 1."""

MIN_SHARE = 0.5 - 1e-9
"""Share of a cell that must be object for the cell to belong to the object: half, but for
round-off."""

SIZES_FROM = 0.9
"""Smallest size of the first range that is tried, in sides of the square cell whose `max_cells`
copies have the shape's area."""

SIZES_TO = 1.6
"""Largest size of that range, in the same sides."""

MAX_SIZES = 80
"""Largest number of sizes that are tried evenly within a range. About as many again divide a side
of the bounding box."""

MIN_SIZES = 24
"""Smallest number of sizes that are tried evenly within a range, however large the lattices are."""

POINT_BUDGET = 3_000_000
"""Number of cells that may be tested in a range of sizes before fewer sizes are tried."""

MAX_PHASED = 20_000
"""Number of cells of a lattice beyond which its place hardly matters, and only one is tried."""

MAX_LATTICE_PER_CELL = 20
"""A shape whose bounding box takes more than this many times `max_cells` (and more than
`MAX_PHASED`) is far thinner than that box. It is filled with the cells that it touches."""

EXACT = 1e-6
"""Error below which the cells are said to tile the shape."""

EXACT_LOSS = 0.11
"""Cells that tile the shape are preferred while they leave no larger part of `max_cells` unused."""

EXACT_DISCOUNT = 0.25
"""Weight of the part of `max_cells` that is left unused by cells that tile the shape and are
preferred for it. For other cells it is one."""

ERROR_WEIGHT = 2.0
"""Weight of a relative error of the moments, where the part of `max_cells` left unused has one."""

AREA_WEIGHT = 0.5
"""Weight of the logarithmic error of the area, where errors of the other moments have one: the
cells' area matters less to sliding than where they are."""

ROUNDING = 1e-9
"""Relative slack within which a size divides a side."""


@dataclass(frozen=True)
class Region:
    """The measures of a shape, to which its cells are to be true, m or, of a mask, in pixels.

    Attributes:
        low: (2,) lower corner of the bounding box.
        extent: (2,) its sides.
        area: area of the shape.
        centroid: (2,) centroid of the shape.
        covariance: (2, 2) second central moments of the shape's area, over its area.
    """

    low: Array
    extent: Array
    area: float
    centroid: Array
    covariance: Array


@dataclass(frozen=True)
class Cells:
    """Square cells, m or, of a mask, in pixels.

    Attributes:
        corners: (n, 2) their lower corners.
        size: their side.
    """

    corners: Array
    size: float

    def __repr__(self) -> str:
        """Number and side, in a line; the side is in m or, of a mask, in pixels."""
        return f"Cells: {count(len(self.corners), 'square')}, side {self.size:.4g}"

    @property
    def centers(self) -> Array:
        """Centers (n, 2) of the cells."""
        return self.corners + self.size / 2


NEAREST = 0.99
"""Two cells whose centers are closer than this many sides lie on top of each other."""


def check_cells(grid: CellGrid) -> None:
    """Refuses cells, given one by one, that lie outside the outline or on top of each other.

    Raises:
        ObjectError: a center is further than a cell's side from the outline's inside, or nearer
            than that to another one.
    """
    size = grid.cell_size
    centers = grid.p_BC
    away = shapely.distance(grid.outline, shapely.points(centers))
    farthest = int(np.argmax(away))
    if away[farthest] > size:
        x, y = centers[farthest]
        raise ObjectError(
            f"cells.centers[{farthest}] is [{x:g}, {y:g}] m, {away[farthest]:g} m outside "
            "the outline; expected cells that the object has"
        )
    if len(centers) == 1:
        return
    # Each center's nearest center is itself, unless two are at one place; the second one tells.
    distances, neighbors = cKDTree(centers).query(centers, k=2)
    nearest = int(np.argmin(distances[:, 1]))
    if distances[nearest, 1] < NEAREST * size:
        pair = sorted({nearest, int(neighbors[nearest, 1]), int(neighbors[nearest, 0])})[:2]
        raise ObjectError(
            f"cells.centers[{pair[0]}] and [{pair[1]}] are {distances[nearest, 1]:g} m apart; "
            f"expected squares of {size:g} m that do not overlap"
        )


def check_max_cells(name: str, max_cells: int) -> None:
    """Refuses a `max_cells` that is not a whole number from 1 to MAX_CELLS.

    Args:
        name: the object's name, for the message.
        max_cells: what was given.

    Raises:
        ObjectError: it is no such number.
    """
    # Python takes True for the number 1.
    whole = isinstance(max_cells, int | np.integer) and not isinstance(max_cells, bool)
    if not (whole and 1 <= max_cells <= MAX_CELLS):
        raise ObjectError(
            f"{name}: max_cells is {max_cells!r}; expected a whole number, 1 or more, at most "
            f"{MAX_CELLS}"
        )


def choose_cells(
    region: Region, share: Share, overlap: Share, max_cells: int, min_size: float = 0.0
) -> Cells:
    """Fills a shape with many cells that are true to it.

    Sizes from just below the ideal one upwards are tried, with lattices centered on the bounding
    box or aligned with a side of it. The cost is the part of `max_cells` not used plus the relative
    errors of the centroid, of the second moments and of the area. The choice is deterministic.

    Args:
        region: the shape's measures.
        share: tells which cells belong to the shape: those that are at least half object.
        overlap: exact share of each cell's area, for shapes so thin that no cell is half full.
        max_cells: largest number of cells.
        min_size: smallest side of a cell, in the region's unit.

    Returns:
        The cells.
    """
    factor = SIZES_TO / SIZES_FROM
    ideal = float(np.sqrt(region.area / max_cells))
    low = max(min_size, SIZES_FROM * ideal)
    high = low * factor
    # Where no size of a range gives few enough cells, larger ones are tried.
    while low <= region.extent.max():
        points = float(np.prod(region.extent / low + 1))
        if points > max(MAX_PHASED, MAX_LATTICE_PER_CELL * max_cells):
            break
        best = _find_best(region, share, max_cells, low, high, points)
        if best is not None:
            return best
        low = high
        high = high * factor
    return _take_touched(region, overlap, max_cells, min_size)


def _find_best(
    region: Region, share: Share, max_cells: int, low: float, high: float, points: float
) -> Cells | None:
    """Finds the cells of least cost whose size is within a range.

    Args:
        region: the shape's measures.
        share: tells which cells belong to the shape.
        max_cells: largest number of cells.
        low: smallest size.
        high: largest size.
        points: number of cells of the finest lattice over the bounding box.

    Returns:
        The cells; None where each lattice has too many cells, or none, that belong to the shape.
    """
    best = None
    min_cost = np.inf
    for size in _candidate_sizes(region, low, high, points).tolist():
        for corners in _lattices(region, size, phased=points < MAX_PHASED):
            belong = share(corners, size) >= MIN_SHARE
            cells = Cells(corners=corners[belong], size=size)
            if not 0 < len(cells.corners) <= max_cells:
                continue
            cost = _calc_cost(region, cells, max_cells)
            if cost < min_cost:
                best = cells
                min_cost = cost
    return best


def _candidate_sizes(region: Region, low: float, high: float, points: float) -> Array:
    """Lists the sizes to be tried in a range, in increasing order.

    They are spread evenly by their logarithms, and some more divide a side of the bounding box: of
    a rectangle such cells can be the exact tiling.
    """
    count = int(np.clip(POINT_BUDGET / points, MIN_SIZES, MAX_SIZES))
    sizes = [np.geomspace(low, high, count)]
    for side in region.extent:
        fewest = max(1, np.ceil(side / high))
        most = np.floor(side / low * (1 + ROUNDING))
        divisions = np.arange(fewest, most + 1)
        stride = 1 + len(divisions) // count
        sizes.append(side / divisions[::stride])
    return np.unique(np.concatenate(sizes))


def _calc_cost(region: Region, cells: Cells, max_cells: int) -> float:
    """Calculates how much cells differ from a shape, and how many more there might be.

        cost = ERROR_WEIGHT error + unused
        error = |offset| / sqrt(tr C) + sum |C_cells - C| / tr C + AREA_WEIGHT |log(area ratio)|

    C is the covariance of the shape's area, and offset leads from its centroid to the cells'.
    """
    arm = cells.centers - region.centroid
    n = len(arm)
    offset = arm.mean(axis=0)
    # Each cell's own area adds s²/12 per axis to that of the centers.
    covariance = arm.T @ arm / n - np.outer(offset, offset) + cells.size**2 / 12 * np.eye(2)
    spread = float(np.trace(region.covariance))
    offset_error = np.linalg.norm(offset) / np.sqrt(spread)
    covariance_error = np.abs(covariance - region.covariance).sum() / spread
    area_error = abs(np.log(n * cells.size**2 / region.area))
    error = offset_error + covariance_error
    error += AREA_WEIGHT * area_error

    # A tiling is worth some cells: it counts less that it leaves them unused.
    unused = 1 - n / max_cells
    is_preferred = error < EXACT and unused <= EXACT_LOSS
    return float(ERROR_WEIGHT * error + unused * (EXACT_DISCOUNT if is_preferred else 1))


def _lattices(region: Region, size: float, phased: bool) -> Iterator[Array]:
    """Makes lattices of square cells that cover the bounding box of a shape.

    Args:
        region: the shape's measures.
        size: side of a cell.
        phased: whether lattices in several places are made. Some then leave up to half a cell of
            the bounding box uncovered at two sides.

    Yields:
        The lower corners (k, 2) of each lattice's cells.
    """
    axes = []
    for low, extent in zip(region.low, region.extent, strict=True):
        up = max(1, int(np.ceil(extent / size * (1 - ROUNDING))))
        down = max(1, int(np.floor(extent / size * (1 + ROUNDING))))
        # Where the first cell begins, and how many there are: centered first.
        starts = [(low + (extent - up * size) / 2, up)]
        if phased and up != down:
            centered_within = low + (extent - down * size) / 2
            at_upper_end = low + extent - up * size
            starts += [(centered_within, down), (low, up), (at_upper_end, up)]
        axes.append([start + size * np.arange(number) for start, number in starts])
    for x, y in product(*axes):
        # The points of np.meshgrid, made faster: thousands of lattices are tried.
        corners = np.empty((len(y), len(x), 2))
        corners[..., 0] = x
        corners[..., 1] = y[:, np.newaxis]
        yield corners.reshape(-1, 2)


def _take_touched(region: Region, overlap: Share, max_cells: int, min_size: float) -> Cells:
    """Takes the finest cells of which a shape touches at most `max_cells`.

    The first cell covers the bounding box; each is cut in four again and again, and those that the
    shape does not touch are left out.
    """
    size = max(min_size, float(region.extent.max()))
    first_corner = region.low + (region.extent - size) / 2
    cells = Cells(corners=first_corner[None], size=size)
    quarters = np.array(list(product((0.0, 0.5), repeat=2)))
    while cells.size / 2 >= min_size:
        half = cells.size / 2
        corners = (cells.corners[:, None] + cells.size * quarters).reshape(-1, 2)
        corners = corners[overlap(corners, half) > 0]
        if not 0 < len(corners) <= max_cells:
            break
        cells = Cells(corners=corners, size=half)
    return cells


SIDE_REACH = 1.2
"""Two cells share a side if their centers are nearer than this many cell sides. Centers of diagonal
neighbors are sqrt(2) sides apart."""

FLATNESS = 1e-9
"""Cells stand in one line if their extent across it is below this many cell sides."""


def calc_adjacency(p_BC: ArrayLike, cell_size: float) -> IntArray:
    """Finds the pairs of cells that share a side, and joins islands by their shortest links.

    Args:
        p_BC: (n, 2) cell centers on a square lattice, any one frame, m.

    Returns:
        (m, 2) pairs i < j in increasing order; as a graph they connect all n cells.
    """
    p_BC = np.asarray(p_BC, dtype=np.float64)
    tree = cKDTree(p_BC)
    pairs = tree.query_pairs(SIDE_REACH * cell_size, output_type="ndarray").astype(np.int64)
    islands = _find_islands(pairs, len(p_BC))
    if islands.max() > 0:
        pairs = np.concatenate([pairs, _calc_links(p_BC, cell_size, islands)])
    return _tidy(pairs)


def _find_islands(pairs: IntArray, n: int) -> IntArray:
    """Numbers the groups of cells that are connected: (n,) each cell's group."""
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _calc_links(p_BC: Array, cell_size: float, islands: IntArray) -> IntArray:
    """Links islands of cells by the shortest tree.

    Args:
        p_BC: (n, 2) cell centers, m.
        cell_size: side of a cell, m.
        islands: (n,) number of each cell's island.

    Returns:
        (islands - 1, 2) pairs of cells, one for each branch of the tree.
    """
    # The Delaunay edges contain the Euclidean spanning tree. Only those between islands matter.
    candidates = _tidy(_delaunay_edges(p_BC, cell_size))
    islands_of = islands[candidates]
    i, j = candidates[islands_of[:, 0] != islands_of[:, 1]].T

    # Of all edges between the same two islands, the shortest is kept.
    length = np.linalg.norm(p_BC[i] - p_BC[j], axis=1)
    ends = np.sort(np.column_stack([islands[i], islands[j]]), axis=1)
    order = np.lexsort((length, ends[:, 1], ends[:, 0]))
    first = order[np.unique(ends[order], axis=0, return_index=True)[1]]

    # The tree, with an island as a node.
    count = int(islands.max()) + 1
    graph = coo_array((length[first], (ends[first, 0], ends[first, 1])), shape=(count, count))
    tree = minimum_spanning_tree(graph.tocsr()).tocoo()
    chosen = {(int(a), int(b)) for a, b in zip(*tree.coords, strict=True)}
    kept = [k for k in first if (int(ends[k, 0]), int(ends[k, 1])) in chosen]
    return np.column_stack([i[kept], j[kept]])


def _delaunay_edges(p_BC: Array, cell_size: float) -> IntArray:
    """Finds the edges (e, 2) of the Delaunay triangles of cell centers (n, 2), m.

    Centers in a line have no triangles; there each is joined to the next one.
    """
    centered = (p_BC - p_BC.mean(axis=0)) / cell_size
    along, _, axes = np.linalg.svd(centered, full_matrices=False)
    across = centered @ axes[-1]
    if len(p_BC) > 2 and np.ptp(across) > FLATNESS:
        try:
            corners = Delaunay(centered).simplices
        except QhullError:
            pass  # so nearly in a line that Qhull finds no triangle
        else:
            sides = [corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]
            return np.concatenate(sides).astype(np.int64)
    order = np.argsort(along[:, 0], kind="stable")
    return np.column_stack([order[:-1], order[1:]]).astype(np.int64)


def _tidy(pairs: IntArray) -> IntArray:
    """Puts pairs (m, 2) in increasing order, each i < j and once."""
    return np.unique(np.sort(pairs, axis=1), axis=0).reshape(-1, 2)


THINNEST = 1e-12
"""Share of its squared diameter below which an outline's area counts as none."""

EDGE_SLACK = 1e-9
"""Distance from the outline within which a center counts as inside, in the outline's diameters."""


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
    region = _describe(polygon)
    # Centers on the outline count as inside, whatever round-off says.
    slack = EDGE_SLACK * float(np.linalg.norm(region.extent))
    slightly_larger = polygon.buffer(slack, join_style="mitre")
    shapely.prepare(slightly_larger)

    def share(corners: Array, size: float) -> Array:
        """Tells cells by their centers: whole where the center is inside, else nothing."""
        x, y = (corners + size / 2).T
        return shapely.contains_xy(slightly_larger, x, y).astype(np.float64)

    def overlap(corners: Array, size: float) -> Array:
        """Measures the share of each cell's area that is inside."""
        boxes = shapely.box(*corners.T, *(corners + size).T)
        return shapely.area(shapely.intersection(boxes, polygon)) / size**2

    cells = choose_cells(region, share, overlap, int(max_cells))
    return CellGrid(
        p_BC=cells.centers,
        cell_size=cells.size,
        labels=_label(cells.centers, polygons),
        outline=polygon,
    )


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
    least_area = THINNEST * (width**2 + height**2)
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


def _describe(polygon: Polygon) -> Region:
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


def _label(centers: Array, parts: Mapping[int, Polygon | MultiPolygon]) -> IntArray:
    """Finds the part (n,) of each cell: the first one that covers its center (n, 2), else 1."""
    labels = np.zeros(len(centers), dtype=np.int64)
    for label, part in parts.items():
        is_new = shapely.intersects_xy(part, *centers.T) & (labels == 0)
        labels[is_new] = label
    return np.where(labels == 0, 1, labels)

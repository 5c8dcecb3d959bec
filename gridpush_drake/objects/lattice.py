"""The lattice of square cells that is truest to a shape: its cells' size, and where it lies.

Many sizes and places are tried, and the one of least cost is taken. The cost of n cells of side s,
of at most N, is

    cost = ERROR_WEIGHT error + (1 - n / N)
    error = |offset| / sqrt(tr C) + sum |C_cells - C| / tr C + AREA_WEIGHT |log(n s^2 / area)|

C is the covariance of the shape's area, and offset leads from its centroid to the cells': how an
object slides depends on these moments. Cells that tile the shape exactly are preferred, see
`EXACT_LOSS`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.cells import Cells

Proportion = Callable[[Array, float], Array]
"""Says how much of square cells is object: from their lower corners (k, 2) and their side to the
shares (k,), 0 to 1."""

MIN_FRACTION = 0.5 - 1e-9
"""Fraction of a cell that must be object for the cell to belong to the object: half, but for
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

EXACT_TILING_ERROR = 1e-6
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

DIVISION_SLACK = 1e-9
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


def choose_cells(
    region: Region, fraction: Proportion, overlap: Proportion, max_cells: int, min_size: float = 0.0
) -> Cells:
    """Fills a shape with many cells that are true to it.

    Sizes from just below the ideal one upwards are tried, with lattices centered on the bounding
    box or aligned with a side of it. The cost is the part of `max_cells` not used plus the relative
    errors of the centroid, of the second moments and of the area. The choice is deterministic.

    Args:
        region: the shape's measures.
        fraction: tells which cells belong to the shape: those that are at least half object.
        overlap: exact fraction of each cell's area, for shapes so thin that no cell is half full.
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
        best = _find_best(region, fraction, max_cells, low, high, points)
        if best is not None:
            return best
        low = high
        high = high * factor
    return _take_touched(region, overlap, max_cells, min_size)


def _find_best(
    region: Region, fraction: Proportion, max_cells: int, low: float, high: float, points: float
) -> Cells | None:
    """Finds the cells of least cost whose size is within a range.

    Args:
        region: the shape's measures.
        fraction: tells which cells belong to the shape.
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
            belong = fraction(corners, size) >= MIN_FRACTION
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
        most = np.floor(side / low * (1 + DIVISION_SLACK))
        divisions = np.arange(fewest, most + 1)
        stride = 1 + len(divisions) // count
        sizes.append(side / divisions[::stride])
    return np.unique(np.concatenate(sizes))


def _calc_cost(region: Region, cells: Cells, max_cells: int) -> float:
    """Calculates how much cells differ from a shape, and how many more there might be.

    The equation stands at the top of this file.
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
    is_preferred = error < EXACT_TILING_ERROR and unused <= EXACT_LOSS
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
        up = max(1, int(np.ceil(extent / size * (1 - DIVISION_SLACK))))
        down = max(1, int(np.floor(extent / size * (1 + DIVISION_SLACK))))
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


def _take_touched(region: Region, overlap: Proportion, max_cells: int, min_size: float) -> Cells:
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

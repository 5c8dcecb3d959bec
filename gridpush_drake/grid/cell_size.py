"""How large the cells are and where their lattice lies: as many as allowed, and true to the shape."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import ObjectError
from gridpush_drake.grid.object import MAX_CELLS

Share = Callable[[NDArray[np.float64], float], NDArray[np.float64]]
"""Given the lower corners (k, 2) of square cells and their size, how much of each is object: (k,), 0 to 1."""

LEAST_SHARE = 0.5 - 1e-9
"""A cell belongs to the object when at least half of it does."""

SIZES_FROM, SIZES_TO = 0.9, 1.6
"""Range of sizes tried, in sides of the square cell whose `max_cells` copies have the shape's area."""

MOST_SIZES, LEAST_SIZES = 80, 24
"""How many sizes are tried in that range; as many again that divide a side of the bounding box."""

POINT_BUDGET = 3_000_000
"""Cells that may be tested in a range of sizes before fewer sizes are tried."""

MOST_PHASED = 20_000
"""In a lattice of more cells than this its phase hardly matters, and only one is tried."""

MOST_LATTICE_PER_CELL = 20
"""A lattice this many times `max_cells` (and above MOST_PHASED) means a shape far thinner than its bounding box."""

EXACT = 1e-6
"""Below this error the cells tile the shape."""

EXACT_LOSS, EXACT_DISCOUNT = 0.11, 0.25
"""Cells that tile the shape are preferred while they leave no more than this part of `max_cells` unused: it then
counts with this weight."""

ERROR_WEIGHT = 2.0
"""A relative error weighs as much as this many times that part of `max_cells` left unused."""

AREA_WEIGHT = 0.5
"""Weight of the area's error (logarithmic): the cells' area matters less to sliding than where they are."""

ROUNDING = 1e-9
"""Relative slack within which a size divides a side."""


@dataclass(frozen=True)
class Region:
    """What a lattice is to be true to.

    Attributes:
        low: (2,) lower corner of the bounding box.
        extent: (2,) its sides.
        area: of the shape.
        centroid: (2,) of the shape.
        covariance: (2, 2) second central moments of its area over its area.
    """

    low: NDArray[np.float64]
    extent: NDArray[np.float64]
    area: float
    centroid: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True)
class Cells:
    """Square cells.

    Attributes:
        corners: (n, 2) their lower corners.
        size: their side.
    """

    corners: NDArray[np.float64]
    size: float

    @property
    def centres(self) -> NDArray[np.float64]:
        """(n, 2)."""
        return self.corners + self.size / 2


def check_max_cells(name: str, max_cells: int) -> None:
    """Refuses a `max_cells` that is not a whole number from 1 to MAX_CELLS, with an ObjectError on object `name`."""
    whole = isinstance(max_cells, int | np.integer) and not isinstance(max_cells, bool)
    if not (whole and 1 <= max_cells <= MAX_CELLS):
        raise ObjectError(
            f"{name}: max_cells is {max_cells!r}; expected a whole number, 1 or more, at most {MAX_CELLS}"
        )


def choose_cells(region: Region, share: Share, overlap: Share, max_cells: int, least_size: float = 0.0) -> Cells:
    """Fills a shape with at most `max_cells` cells, weighing their number against their likeness to the shape.

    Sizes from just below the ideal one upwards are tried, with lattices centred on the bounding box or aligned
    with a side of it. The cost is the part of `max_cells` not used plus the relative errors of the centroid, of
    the second moments and of the area. The choice is deterministic.

    Args:
        region: the shape.
        share: decides which cells belong (at least half).
        overlap: exact share of each cell's area, for shapes so thin that no cell is half full.
        max_cells: the most cells, >= 1.
        least_size: no smaller cells than this, in the region's unit.

    Returns:
        The cells, at least one.
    """
    low = max(least_size, SIZES_FROM * float(np.sqrt(region.area / max_cells)))
    high = low * (SIZES_TO / SIZES_FROM)
    while low <= region.extent.max():
        points = float(np.prod(region.extent / low + 1))
        if points > max(MOST_PHASED, MOST_LATTICE_PER_CELL * max_cells):
            break
        best = _find_best(region, share, max_cells, low, high, points)
        if best is not None:
            return best
        low, high = high, high * (SIZES_TO / SIZES_FROM)
    return _take_touched(region, overlap, max_cells, least_size)


def _find_best(region: Region, share: Share, max_cells: int, low: float, high: float, points: float) -> Cells | None:
    best, least_cost = None, np.inf
    for size in _candidate_sizes(region, low, high, points):
        for corners in _lattices(region, float(size), phased=points < MOST_PHASED):
            cells = Cells(corners[share(corners, float(size)) >= LEAST_SHARE], float(size))
            if not 0 < len(cells.corners) <= max_cells:
                continue
            cost = _calc_cost(region, cells, max_cells)
            if cost < least_cost:
                best, least_cost = cells, cost
    return best


def _candidate_sizes(region: Region, low: float, high: float, points: float) -> NDArray[np.float64]:
    count = int(np.clip(POINT_BUDGET / points, LEAST_SIZES, MOST_SIZES))
    sizes = [np.geomspace(low, high, count)]
    for side in region.extent:
        divisions = np.arange(max(1, np.ceil(side / high)), np.floor(side / low * (1 + ROUNDING)) + 1)
        sizes.append(side / divisions[:: 1 + len(divisions) // count])
    return np.unique(np.concatenate(sizes))


def _calc_cost(region: Region, cells: Cells, max_cells: int) -> float:
    arm = cells.centres - region.centroid
    offset = arm.mean(axis=0)
    covariance = arm.T @ arm / len(arm) - np.outer(offset, offset) + cells.size**2 / 12 * np.eye(2)
    spread = float(np.trace(region.covariance))
    error = np.linalg.norm(offset) / np.sqrt(spread) + np.abs(covariance - region.covariance).sum() / spread
    error += AREA_WEIGHT * abs(np.log(len(arm) * cells.size**2 / region.area))
    unused = 1 - len(arm) / max_cells
    return float(ERROR_WEIGHT * error + unused * (EXACT_DISCOUNT if error < EXACT and unused <= EXACT_LOSS else 1))


def _lattices(region: Region, size: float, phased: bool) -> Iterator[NDArray[np.float64]]:
    """Lower corners (k, 2) of the cells of each lattice that covers the bounding box, but for half cells."""
    axes = []
    for low, extent in zip(region.low, region.extent, strict=True):
        up = max(1, int(np.ceil(extent / size * (1 - ROUNDING))))
        down = max(1, int(np.floor(extent / size * (1 + ROUNDING))))
        starts = [(low + (extent - up * size) / 2, up)]
        if phased and up != down:
            starts += [(low + (extent - down * size) / 2, down), (low, up), (low + extent - up * size, up)]
        axes.append([start + size * np.arange(k) for start, k in starts])
    for x, y in product(*axes):
        yield np.column_stack([axis.ravel() for axis in np.meshgrid(x, y)])


def _take_touched(region: Region, overlap: Share, max_cells: int, least_size: float) -> Cells:
    """The finest cells, halved from the bounding box, of which the shape touches at most `max_cells`."""
    size = max(least_size, float(region.extent.max()))
    cells = Cells((region.low + (region.extent - size) / 2)[None], size)
    quarters = np.array(list(product((0.0, 0.5), repeat=2)))
    while cells.size / 2 >= least_size:
        corners = (cells.corners[:, None] + cells.size * quarters).reshape(-1, 2)
        corners = corners[overlap(corners, cells.size / 2) > 0]
        if not 0 < len(corners) <= max_cells:
            break
        cells = Cells(corners, cells.size / 2)
    return cells

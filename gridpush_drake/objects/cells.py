"""Square cells on a lattice, the geometry of a grid object: `CellGrid`.

How a lattice is chosen that is true to a shape stands in `lattice`, how an outline or a mask is
filled in `outline` and `mask`, and which cells touch in `adjacency`. What the cells weigh, and how
they rub, stands in `parameters`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from scipy.spatial import cKDTree
from shapely import Polygon

from gridpush_drake.errors import ObjectError
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.notebook import count, draw_cells, make_page
from gridpush_drake.units import MM_PER_M

DEFAULT_MAX_CELLS = 127
"""Largest number of cells where nobody asks for another one; it is the paper's largest grid."""

MAX_CELLS = 10_000
"""Largest number of cells of an object. What learning keeps grows with its square."""

MAX_LABEL = 2**31 - 1
"""Largest label of a part."""

MIN_SIZE = 1e-6
"""Smallest side of a cell, m. Nothing so small is pushed."""


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
        return f"CellGrid of {count(len(self.p_BC), 'cell')} of {self.cell_size * MM_PER_M:.1f} mm"

    def _repr_html_(self) -> str:
        """Outline and cells."""
        return make_page(repr(self), draw_cells(self.outline, self.p_BC, self.cell_size))


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


MIN_CELL_DISTANCE = 0.99
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
    if distances[nearest, 1] < MIN_CELL_DISTANCE * size:
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

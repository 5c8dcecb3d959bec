"""The grid object: square cells, the outline they stand for, and what is known of them beforehand.

The body frame B, said once: for an outline it is the outline's own coordinates; for a mask it is the cells' centroid,
x to the right and y up in the image.
"""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon

from gridpush_drake.errors import ObjectError
from gridpush_drake.grid.outline import OutlineEdges
from gridpush_drake.grid.prior import PhysicalPrior

DEFAULT_MAX_CELLS = 127
"""The paper's largest grid."""

MAX_CELLS = 4000
"""Of an object; what learning keeps grows with the square of their number."""

MAX_LABEL = 2**31 - 1
"""Of a part."""

MIN_SIZE, MAX_SIZE = 1e-6, 1e4
"""Of a cell's side, least, and of any coordinate of an object, greatest, m; beyond them no object is pushed."""


@dataclass(frozen=True, eq=False)
class GridObject:
    """A flat rigid object, as n square cells within an outline.

    Attributes:
        name: what to call it.
        p_BC: (n, 2) cell centres in the body frame, m.
        cell_size: side of a cell, m.
        labels: (n,) the part each cell belongs to, >= 1.
        outline: contour with holes, body frame, m; what the pusher touches.
        prior: what is known of mass and friction beforehand.

    Raises:
        ObjectError: shapes disagree, or a value is out of range.
    """

    name: str
    p_BC: NDArray[np.float64]
    cell_size: float
    labels: NDArray[np.int64]
    outline: Polygon
    prior: PhysicalPrior = field(default_factory=PhysicalPrior)

    def __post_init__(self) -> None:
        p_BC = np.array(self.p_BC, dtype=np.float64)
        try:
            labels = np.array(self.labels, dtype=np.int64)
        except (OverflowError, TypeError, ValueError) as error:
            raise ObjectError(f"{self.name}: labels: expected whole numbers, 1 to {MAX_LABEL}") from error
        if p_BC.ndim != 2 or p_BC.shape[1] != 2 or not len(p_BC) or labels.shape != p_BC.shape[:1]:
            raise ObjectError(
                f"{self.name}: p_BC of shape {p_BC.shape}, labels of shape {labels.shape}; expected (n, 2) and (n,)"
            )
        if len(p_BC) > MAX_CELLS:
            raise ObjectError(f"{self.name}: has {len(p_BC)} cells; expected at most {MAX_CELLS}")
        if not np.isfinite(p_BC).all():
            raise ObjectError(f"{self.name}: p_BC must be finite")
        if labels.min() < 1:
            raise ObjectError(f"{self.name}: a label is {labels.min()}; expected whole numbers, 1 or more")
        if not (np.isfinite(self.cell_size) and self.cell_size > 0):
            raise ObjectError(f"{self.name}: cell_size is {self.cell_size!r}; expected a positive number (m)")
        if not isinstance(self.outline, Polygon) or self.outline.is_empty or not self.outline.is_valid:
            raise ObjectError(f"{self.name}: the outline must be a simple polygon that does not cross itself")
        self._check_size(p_BC)
        for name, value in (("p_BC", p_BC), ("labels", labels)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "cell_size", float(self.cell_size))

    def _check_size(self, p_BC: NDArray[np.float64]) -> None:
        if not MIN_SIZE <= self.cell_size <= MAX_SIZE:
            raise ObjectError(
                f"{self.name}: cell_size is {self.cell_size:g} m; expected {MIN_SIZE:g} to {MAX_SIZE:g} m"
            )
        for what, farthest in (("p_BC", np.abs(p_BC).max()), ("outline", np.abs(self.outline.bounds).max())):
            if not farthest <= MAX_SIZE:
                raise ObjectError(
                    f"{self.name}: {what}: a coordinate is {farthest:g} m; expected at most {MAX_SIZE:g} m"
                )

    @classmethod
    def from_mask(
        cls,
        path: Path | str,
        *,
        metres_per_pixel: float,
        max_cells: int = DEFAULT_MAX_CELLS,
        largest_piece: bool = False,
        name: str | None = None,
        prior: PhysicalPrior | None = None,
    ) -> "GridObject":
        """Reads a label image (PGM, PNG): 0 is background, every other value a part.

        Args:
            path: the image.
            metres_per_pixel: its scale, m.
            max_cells: the most cells to make.
            largest_piece: keep the largest connected piece where there are several.
            name: what to call it; the file's stem where not given.
            prior: what is known of mass and friction.

        Returns:
            The object; B is at the cells' centroid, x right and y up in the image.

        Raises:
            ObjectError: the image cannot be read or is not a label image, is empty, has several pieces (and
                `largest_piece` is not set), or a scale or count is not positive.
        """
        from gridpush_drake.grid.mask import object_from_mask

        return object_from_mask(
            Path(path), metres_per_pixel, max_cells, largest_piece=largest_piece, name=name, prior=prior
        )

    @classmethod
    def from_outline(
        cls,
        outline: ArrayLike | Polygon,
        *,
        parts: dict[int, ArrayLike | Polygon] | None = None,
        max_cells: int = DEFAULT_MAX_CELLS,
        name: str = "object",
        prior: PhysicalPrior | None = None,
    ) -> "GridObject":
        """Fills a polygon with cells.

        Args:
            outline: (k, 2) vertices, or a Polygon (with holes), m; its coordinates are the body frame.
            parts: polygons by label >= 1; a cell whose centre none covers belongs to part 1.
            max_cells: the most cells to make.
            name: what to call it.
            prior: what is known of mass and friction.

        Returns:
            The object.

        Raises:
            ObjectError: the polygon crosses itself or has no area, or the count is not positive.
        """
        from gridpush_drake.grid.polygon import object_from_outline

        return object_from_outline(outline, parts or {}, max_cells, name=name, prior=prior)

    @classmethod
    def from_yaml(cls, path: Path | str, *, largest_piece: bool = False) -> "GridObject":
        """Reads an object file (README, "Bring your own object").

        Args:
            path: the YAML file; a mask it names is looked up beside it.
            largest_piece: as in `from_mask`.

        Returns:
            The object.

        Raises:
            ObjectError: the file cannot be read, has an unknown key or a value out of range; the message names
                the file, the field and the expected form.
        """
        from gridpush_drake.grid.object_file import read_object

        return read_object(Path(path), largest_piece=largest_piece)

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.p_BC)

    @cached_property
    def adjacency(self) -> NDArray[np.int64]:
        """(m, 2) pairs of cells that share a side; islands are joined by their shortest links, so it is connected."""
        from gridpush_drake.grid.adjacency import calc_adjacency

        return calc_adjacency(self.p_BC, self.cell_size)

    @cached_property
    def edges(self) -> OutlineEdges:
        """The outline as directed edges, body frame."""
        return OutlineEdges.from_polygon(self.outline)

    @cached_property
    def radius_of_gyration(self) -> float:
        """Root mean square distance of the (square) cells' points from their common centroid, m."""
        arm = self.p_BC - self.p_BC.mean(axis=0)
        return float(np.sqrt((arm**2).sum(axis=1).mean() + self.cell_size**2 / 6))

    def cells_at(self, pose: ArrayLike) -> NDArray[np.float64]:
        """p_WC (..., n, 2), m, of the cells at poses `(..., 3)` (x, y, theta)."""
        q = np.asarray(pose, dtype=np.float64)
        c, s = np.cos(q[..., 2, None]), np.sin(q[..., 2, None])
        x, y = self.p_BC.T
        return np.stack([q[..., 0, None] + c * x - s * y, q[..., 1, None] + s * x + c * y], axis=-1)

"""What is known of an object's mass and friction before any push: the physical part of its YAML.

Which cells touch: the pairs that share a side, made connected where the grid fell into islands.

The grid object: square cells, the outline they stand for, and what is known of them beforehand.

The body frame B, said once: for an outline it is the outline's own coordinates; for a mask it is the cells' centroid,
x to the right and y up in the image.
"""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import Delaunay, QhullError, cKDTree
from shapely import Polygon

from gridpush_drake.errors import ObjectError, ParameterError
from gridpush_drake.geometry.outline import OutlineEdges


@dataclass(frozen=True)
class PhysicalPrior:
    """Prior knowledge of an object, all of it optional.

    Attributes:
        total_mass: kg; None where it was not weighed.
        center_of_mass: (x, y) in the body frame, m; None where unknown.
        center_of_mass_std: its standard deviation per axis, m.
        friction: prior friction coefficient of the cells against the support.
        friction_min: smallest coefficient held possible.
        friction_max: largest coefficient held possible.
        contact_friction: prior friction coefficient of the pusher against the object.
        contact_friction_std: its standard deviation.
        pusher_radius: m; None where the object's file does not say.

    Raises:
        ParameterError: a value is out of range.
    """

    total_mass: float | None = None
    center_of_mass: tuple[float, float] | None = None
    center_of_mass_std: float = 0.002
    friction: float = 0.4
    friction_min: float = 0.05
    friction_max: float = 1.0
    contact_friction: float = 0.5
    contact_friction_std: float = 0.15
    pusher_radius: float | None = None

    def __post_init__(self) -> None:
        positive = (
            "total_mass", "center_of_mass_std", "friction", "friction_min", "friction_max",
            "contact_friction_std", "pusher_radius",
        )  # fmt: skip
        for name in positive:
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ParameterError(f"{name} is {value!r}; expected a positive number")
        if not (np.isfinite(self.contact_friction) and self.contact_friction >= 0):
            raise ParameterError(f"contact_friction is {self.contact_friction!r}; expected a number >= 0")
        if not self.friction_min <= self.friction <= self.friction_max:
            raise ParameterError(
                f"friction.prior is {self.friction!r}; expected min <= prior <= max, "
                f"here {self.friction_min} to {self.friction_max}"
            )
        if self.center_of_mass is not None and not np.isfinite(self.center_of_mass).all():
            raise ParameterError(f"center_of_mass.at is {self.center_of_mass!r}; expected two finite numbers")


SIDE_REACH = 1.2
"""Centers nearer than this many cell sides share a side; diagonal neighbors are sqrt(2) sides apart."""

FLATNESS = 1e-9
"""Cells whose extent across their main direction is below this many cell sides stand in one line."""


def calc_adjacency(p_BC: ArrayLike, cell_size: float) -> NDArray[np.int64]:
    """Finds the pairs of cells that share a side, and joins islands by their shortest links.

    Args:
        p_BC: (n, 2) cell centers on a square lattice, any one frame, m.
        cell_size: side of a cell, m.

    Returns:
        (m, 2) pairs i < j in increasing order; as a graph they connect all n cells.
    """
    p_BC = np.asarray(p_BC, dtype=np.float64)
    pairs = cKDTree(p_BC).query_pairs(SIDE_REACH * cell_size, output_type="ndarray").astype(np.int64)
    islands = _find_islands(pairs, len(p_BC))
    if islands.max() > 0:
        pairs = np.concatenate([pairs, _calc_links(p_BC, cell_size, islands)])
    return _tidy(pairs)


def _find_islands(pairs: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _calc_links(p_BC: NDArray[np.float64], cell_size: float, islands: NDArray[np.int64]) -> NDArray[np.int64]:
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


def _delaunay_edges(p_BC: NDArray[np.float64], cell_size: float) -> NDArray[np.int64]:
    centered = (p_BC - p_BC.mean(axis=0)) / cell_size
    along, _, axes = np.linalg.svd(centered, full_matrices=False)
    across = centered @ axes[-1]
    if len(p_BC) > 2 and np.ptp(across) > FLATNESS:
        try:
            simplices = Delaunay(centered).simplices
            return np.concatenate([simplices[:, [0, 1]], simplices[:, [1, 2]], simplices[:, [2, 0]]]).astype(np.int64)
        except QhullError:
            pass
    order = np.argsort(along[:, 0], kind="stable")
    return np.column_stack([order[:-1], order[1:]]).astype(np.int64)


def _tidy(pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(np.sort(pairs, axis=1), axis=0).reshape(-1, 2)


DEFAULT_MAX_CELLS = 127
"""The paper's largest grid."""

MAX_CELLS = 10_000
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
        p_BC: (n, 2) cell centers in the body frame, m.
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
        meters_per_pixel: float,
        max_cells: int = DEFAULT_MAX_CELLS,
        largest_piece: bool = False,
        name: str | None = None,
        prior: PhysicalPrior | None = None,
    ) -> "GridObject":
        """Reads a label image (PGM, PNG): 0 is background, every other value a part.

        Args:
            path: the image.
            meters_per_pixel: its scale, m.
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
        from gridpush_drake.objects.mask import object_from_mask

        return object_from_mask(
            Path(path), meters_per_pixel, max_cells, largest_piece=largest_piece, name=name, prior=prior
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
            parts: polygons by label >= 1; a cell whose center none covers belongs to part 1.
            max_cells: the most cells to make.
            name: what to call it.
            prior: what is known of mass and friction.

        Returns:
            The object.

        Raises:
            ObjectError: the polygon crosses itself or has no area, or the count is not positive.
        """
        from gridpush_drake.objects.cells import object_from_outline

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
        from gridpush_drake.objects.object_file import read_object

        return read_object(Path(path), largest_piece=largest_piece)

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.p_BC)

    @cached_property
    def adjacency(self) -> NDArray[np.int64]:
        """(m, 2) pairs of cells that share a side; islands are joined by their shortest links, so it is connected."""
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

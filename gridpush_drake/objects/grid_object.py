"""The grid object: square cells, the outline they stand for, and what is known of them beforehand.

All coordinates are in the body frame B. If the object was made of an outline, B is the frame in
which the outline was given. If it was made of a mask, the origin of B is the cells' centroid, x
points to the right and y up in the image.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from shapely import Point, Polygon

from gridpush_drake.errors import ObjectError, require_positive
from gridpush_drake.files import write_whole
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.polygons import OutlineEdges
from gridpush_drake.geometry.se2 import (
    Array,
    IntArray,
    check_vector,
    compose,
    transform,
    transform_shape,
)
from gridpush_drake.notebook import count, draw_cells, make_page
from gridpush_drake.objects.adjacency import calc_adjacency
from gridpush_drake.objects.cells import DEFAULT_MAX_CELLS, MAX_CELLS, MAX_LABEL, MIN_SIZE, CellGrid
from gridpush_drake.objects.mask import coarsen_mask
from gridpush_drake.objects.object_file import (
    EXPECTED_NAME,
    OutlinePose,
    PhysicalPrior,
    dump_object,
    is_name,
    make_cells,
    read_object_file,
)
from gridpush_drake.objects.outline import MAX_SIZE, fill_outline
from gridpush_drake.units import MM_PER_M
from gridpush_drake.yaml_file import shorten


@dataclass(frozen=True, eq=False)
class GridObject(Frozen):
    """A flat rigid object, as n square cells within an outline.

    Attributes:
        name: name of the object, for messages and files.
        p_BC: (n, 2) cell centers in the body frame, m.
        cell_size: side of a cell, m.
        labels: (n,) the part each cell belongs to, >= 1.
        outline: contour with holes, body frame, m; what the pusher touches.
        prior: what is known of mass and friction beforehand.
        height: height above the table, m; None where it is not known.
        outline_pose: where the frame in which the outline was given is in the body frame, and how
            surely; None where both are the same.

    Raises:
        ObjectError: shapes disagree, or a value is out of range.
    """

    name: str
    p_BC: Array
    cell_size: float
    labels: IntArray
    outline: Polygon
    prior: PhysicalPrior = field(default_factory=PhysicalPrior)
    height: float | None = None
    outline_pose: OutlinePose | None = None

    def __post_init__(self) -> None:
        if not is_name(self.name):
            raise ObjectError(f"name is {shorten(self.name)}; expected {EXPECTED_NAME}")
        p_BC = np.array(self.p_BC, dtype=np.float64)
        try:
            labels = np.array(self.labels, dtype=np.int64)
        except (OverflowError, TypeError, ValueError) as error:
            raise ObjectError(
                f"{self.name}: labels: expected whole numbers, 1 to {MAX_LABEL}"
            ) from error
        if p_BC.ndim != 2 or p_BC.shape[1] != 2 or not len(p_BC) or labels.shape != p_BC.shape[:1]:
            raise ObjectError(
                f"{self.name}: p_BC of shape {p_BC.shape}, labels of shape {labels.shape}; "
                "expected (n, 2) and (n,)"
            )
        if len(p_BC) > MAX_CELLS:
            raise ObjectError(f"{self.name}: has {len(p_BC)} cells; expected at most {MAX_CELLS}")
        if not np.isfinite(p_BC).all():
            raise ObjectError(f"{self.name}: p_BC must be finite")
        if labels.min() < 1:
            raise ObjectError(
                f"{self.name}: a label is {labels.min()}; expected whole numbers, 1 or more"
            )
        require_positive(ObjectError, f"{self.name}: ", "m", cell_size=self.cell_size)
        if (
            not isinstance(self.outline, Polygon)
            or self.outline.is_empty
            or not self.outline.is_valid
        ):
            raise ObjectError(
                f"{self.name}: the outline must be a simple polygon that does not cross itself"
            )
        self._check_size(p_BC)
        self._check_push_height()
        self._check_center_of_mass()
        if self.height is not None and not (np.isfinite(self.height) and self.height > 0):
            raise ObjectError(
                f"{self.name}: height is {self.height!r}; expected a positive number (m), or none"
            )
        for name, value in (("p_BC", p_BC), ("labels", labels)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "cell_size", float(self.cell_size))

    def __repr__(self) -> str:
        """Name, cells, parts and measures, in a line."""
        left, low, right, high = self.outline.bounds
        size = f"{(right - left) * MM_PER_M:.0f} x {(high - low) * MM_PER_M:.0f} mm"
        parts = count(len(np.unique(self.labels)), "part")
        height = "" if self.height is None else f", {self.height * MM_PER_M:.0f} mm high"
        cells = f"{count(self.n, 'cell')} of {self.cell_size * MM_PER_M:.1f} mm in {parts}"
        return f"GridObject {self.name!r}: {cells}, {size}{height}"

    def _repr_html_(self) -> str:
        """Outline and cells, colored by part."""
        labels = self.labels.astype(np.float64)
        drawing = draw_cells(self.outline, self.p_BC, self.cell_size, labels, "part of a cell")
        return make_page(repr(self), drawing)

    def _check_size(self, p_BC: Array) -> None:
        """Refuses cells and coordinates that are too small or too large."""
        if not MIN_SIZE <= self.cell_size <= MAX_SIZE:
            raise ObjectError(
                f"{self.name}: cell_size is {self.cell_size:g} m; expected {MIN_SIZE:g} to "
                f"{MAX_SIZE:g} m"
            )
        for what, farthest in (
            ("p_BC", np.abs(p_BC).max()),
            ("outline", np.abs(self.outline.bounds).max()),
        ):
            if not farthest <= MAX_SIZE:
                raise ObjectError(
                    f"{self.name}: {what}: a coordinate is {farthest:g} m; expected at most "
                    f"{MAX_SIZE:g} m"
                )

    def _check_push_height(self) -> None:
        """Refuses a pusher so high that the object would tip even with the least friction.

        A body of width w tips about its edge when it is pushed at a height h with h mu > w / 2.
        """
        height = self.prior.push_height
        least = self.prior.friction_min
        if height is None:
            return
        rectangle = np.asarray(self.outline.minimum_rotated_rectangle.exterior.coords)
        width = float(np.linalg.norm(np.diff(rectangle[:3], axis=0), axis=1).min())
        if height * least >= width / 2:
            most = width / 2 / least
            raise ObjectError(
                f"{self.name}: pusher.height is {height:g} m; expected less than {most:.3g} m, "
                f"from where on an object {width:.3g} m wide tips even with friction {least:g}"
            )

    def _check_center_of_mass(self) -> None:
        """Refuses a center of mass that no masses of the cells can have."""
        at = self.prior.center_of_mass
        if at is not None and self.outline.convex_hull.distance(Point(at)) > self.cell_size:
            raise ObjectError(
                f"{self.name}: center_of_mass.at is [{at[0]:g}, {at[1]:g}] m; expected a point "
                "within the outline's convex hull"
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
            meters_per_pixel: its scale, m.
            max_cells: the most cells to make.
            largest_piece: keep the largest connected piece where there are several.
            name: what to call it; the file's stem where not given.

        Returns:
            The object; B is at the cells' centroid, x right and y up in the image.

        Raises:
            ObjectError: the image cannot be read or is not a label image, is empty, has several
                pieces (and `largest_piece` is not set), or a scale or count is not positive.
        """
        path = Path(path)
        name = path.stem if name is None else name
        grid = coarsen_mask(
            path, meters_per_pixel, max_cells, largest_piece=largest_piece, name=name
        )
        return cls(name, *grid, prior or PhysicalPrior())

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
            outline: (k, 2) vertices, or a Polygon (with holes), m; its coordinates are the body
                frame.
            parts: polygons by label >= 1; a cell whose center none covers belongs to part 1.
            max_cells: the most cells to make.

        Raises:
            ObjectError: the polygon crosses itself or has no area, or the count is not positive.
        """
        return cls(
            name,
            *fill_outline(outline, parts or {}, max_cells, name=name),
            prior or PhysicalPrior(),
        )

    @classmethod
    def from_yaml(cls, path: Path | str, *, largest_piece: bool = False) -> "GridObject":
        """Reads an object file, whose form stands in `docs/howto/own_object.md`.

        Args:
            path: the file; a mask that it names is looked up beside it.
            largest_piece: whether the largest piece of that mask is taken where there are several.

        Raises:
            ObjectError: the file cannot be read, has an unknown key or a value out of range; the
                message names the file, the field and the expected form.
        """
        path = Path(path)
        schema = read_object_file(path)
        name = path.stem if schema.name is None else schema.name
        try:
            grid = make_cells(schema, name, path.parent, largest_piece)
            schema.check_materials(grid.labels)
            return cls(
                name,
                *grid,
                schema.to_prior(),
                schema.height,
                schema.to_outline_pose(),
            )
        except ObjectError as error:
            raise ObjectError(f"{path}: {error}") from error

    def write_yaml(self, path: Path | str, force: bool = False) -> None:
        """Writes the object as an outline with its cells and prior.

        `from_yaml` gives it back, bit for bit.

        Raises:
            OutputError: the file exists and `force` is not set, or it cannot be written.
        """
        text = dump_object(
            self.name, self.grid, self.prior, self.height, outline_pose=self.outline_pose
        )
        write_whole(path, text, force)

    def place(self, pose: ArrayLike, std: ArrayLike = (0.0, 0.0, 0.0)) -> "GridObject":
        """Moves outline and cells to a pose in the body frame, which stays where it is.

        Args:
            pose: (x, y, theta) of the frame of the present outline in the new body frame, m and
                rad.
            std: (3,) standard deviations of the pose, where it was measured, m and rad.

        Returns:
            The object. `outline_pose` says where the frame is in which its outline was given.

        Raises:
            ObjectError: a value is not finite, or the outline is moved too far.
        """
        X = check_vector(ObjectError, "pose", pose, 3)
        # X_BO = X_BB' X_B'O, where the object may have been moved before.
        before = (0.0, 0.0, 0.0) if self.outline_pose is None else self.outline_pose.pose
        # What was told of the center of mass moves along.
        center = self.prior.center_of_mass
        if center is not None:
            x, y = transform(X, center).tolist()
            center = (x, y)
        x, y, theta = compose(X, before).tolist()
        std_x, std_y, std_theta = check_vector(ObjectError, "std", std, 3).tolist()
        return replace(
            self,
            p_BC=transform(X, self.p_BC),
            outline=transform_shape(X, self.outline),
            prior=replace(self.prior, center_of_mass=center),
            outline_pose=OutlinePose(pose=(x, y, theta), std=(std_x, std_y, std_theta)),
        )

    def forget(self) -> "GridObject":
        """Makes the object of which nothing is told but its outline and height."""
        return replace(self, prior=self.prior.forget())

    @property
    def grid(self) -> CellGrid:
        """The geometry alone: cells and outline."""
        return CellGrid(self.p_BC, self.cell_size, self.labels, self.outline)

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.p_BC)

    @cached_property
    def adjacency(self) -> IntArray:
        """(m, 2) pairs of cells that share a side, and the shortest links between islands of cells.

        As a graph they connect all cells.
        """
        return calc_adjacency(self.p_BC, self.cell_size)

    @cached_property
    def edges(self) -> OutlineEdges:
        """The outline as directed edges, body frame."""
        return OutlineEdges.from_polygon(self.outline)

    @cached_property
    def radius_of_gyration(self) -> float:
        """Root mean square distance of the (square) cells' points from their common centroid, m."""
        # A square of side s by itself has a squared radius of gyration of s²/6.
        arm = self.p_BC - self.p_BC.mean(axis=0)
        return float(np.sqrt((arm**2).sum(axis=1).mean() + self.cell_size**2 / 6))

    def cells_at(self, pose: ArrayLike) -> Array:
        """Places p_WC (..., n, 2) of the cells, m, at poses q_WB (..., 3), m and rad."""
        return transform(pose, self.p_BC)

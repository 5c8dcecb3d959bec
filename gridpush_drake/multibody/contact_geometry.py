"""What a grid object touches the world with: spheres that it stands on, and boxes along its outline.

Cells stand on small contact spheres, pressed into the table by their weights. A sphere that carries the share m_i g of
the weight, pressed in by delta, has stiffness

    k_i = m_i g / delta

so that, pressed in by delta, it bears just that share, whatever the other spheres do.

A finger pushes at boxes. Contact of a sphere and a box is solved in closed form in Drake, that of sphere and convex
mesh by iteration. So each edge of the outline is the outer face of one box, as deep as the object lets it be. A
sphere's nearest point on these boxes is the nearest point of the outline, corners and holes included; a corner shared
by two boxes gives the same contact twice.

The inside is filled with boxes too, a little clear of the outline, so that whatever else comes down on the object or
grips it is not let through.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import ProximityProperties
from shapely import Polygon, box, prepare

from gridpush_drake.errors import ParameterError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.contact_material import MakeContactProperties, calc_own_friction
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

SPHERE_RADIUS = 0.002
"""m; more than the spheres are ever pressed in."""

SpheresPerCell = Literal[1, 4]


@dataclass(frozen=True, eq=False)
class ContactSphereLayout:
    """Where the spheres are.

    Attributes:
        p_BS: (f, 2) where they touch the table, body frame, m.
        cell: (f,) the cell that each belongs to.
        spheres_per_cell: 1: at the cells' centers; 4: at their corners.
    """

    p_BS: NDArray[np.float64]
    cell: NDArray[np.int64]
    spheres_per_cell: SpheresPerCell

    @classmethod
    def for_object(cls, obj: GridObject, spheres_per_cell: SpheresPerCell = 1) -> "ContactSphereLayout":
        """Lays out the spheres of an object.

        Args:
            obj: the object.
            spheres_per_cell: 1, or 4 to support it out to its edge.

        Returns:
            The layout, cell by cell.

        Raises:
            ParameterError: `spheres_per_cell` is neither.
        """
        if spheres_per_cell == 1:
            return cls(obj.p_BC, np.arange(obj.n), 1)
        if spheres_per_cell != 4:
            raise ParameterError(f"spheres_per_cell is {spheres_per_cell!r}; expected 1 or 4")
        corners = obj.cell_size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return cls((obj.p_BC[:, None] + corners).reshape(-1, 2), np.repeat(np.arange(obj.n), 4), 4)

    def make_properties(
        self, params: CellParameters, delta: float, gravity: float, support: Array | None = None
    ) -> list[ProximityProperties]:
        """Makes the spheres's contact properties.

        Args:
            params: what the cells weigh and how they rub.
            delta: how far the spheres are pressed in, m.
            gravity: m/s².
            support: (n,) what each cell's spheres bear where they are pressed in so far, kg; its own mass by default.

        Returns:
            Properties of the f spheres.

        Raises:
            ParameterError: a friction is 2 or more, which Drake's combination cannot give.
        """
        borne = params.mass if support is None else support
        stiffness = borne * gravity / (delta * self.spheres_per_cell)
        friction = [calc_own_friction(float(mu), f"friction of cell {i}") for i, mu in enumerate(params.friction)]
        return [MakeContactProperties(friction[i], float(stiffness[i])) for i in self.cell]


MAX_DEPTH = 0.01
"""m, of the boxes behind the edges."""

HALVINGS = 12
"""How often a box behind an edge is made half as deep for want of room."""

PROTRUSION = 1e-6
"""m by which boxes may stand out of the outline, next to a sharp corner."""

STRIPS = 24
"""Rows of boxes that fill the inside."""

CLEARANCE = 5e-4
"""m from the outline to the boxes that fill the inside; deeper than a finger ever presses in."""


@dataclass(frozen=True, eq=False)
class PlanarBox:
    """A rectangle in the body frame.

    Attributes:
        center: (2,) m.
        angle: of its length from the x axis, rad.
        size: (length, width), m.
    """

    center: Array
    angle: float
    size: tuple[float, float]


def make_edge_boxes(obj: GridObject) -> list[PlanarBox]:
    """Makes a box behind every edge of the outline, exterior first, its outer face being the edge."""
    room = obj.outline.buffer(PROTRUSION)
    prepare(room)
    boxes = []
    for start, end in zip(obj.edges.start, obj.edges.end, strict=True):
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        inward = np.array([-along[1], along[0]])
        depth = MAX_DEPTH
        for _ in range(HALVINGS):
            if room.covers(Polygon([start, end, end + depth * inward, start + depth * inward])):
                break
            depth /= 2
        center = (start + end) / 2 + depth / 2 * inward
        boxes.append(PlanarBox(center, float(np.arctan2(along[1], along[0])), (length, depth)))
    return boxes


def make_inner_boxes(obj: GridObject) -> list[PlanarBox]:
    """Fills the outline, clear of it, with boxes that lie in STRIPS rows along the x axis."""
    room = obj.outline.buffer(-CLEARANCE)
    if room.is_empty:
        return []
    left, bottom, right, top = room.bounds
    boxes = []
    for low, high in pairwise(np.linspace(bottom, top, STRIPS + 1)):
        outside = box(left, low, right, high).difference(room)
        # the row is free where nothing outside is seen along y
        seen = sorted((part.bounds[0], part.bounds[2]) for part in getattr(outside, "geoms", [outside]) if part.area)
        reached = left
        for start, end in [*seen, (right, right)]:
            if start - reached > CLEARANCE:
                boxes.append(PlanarBox(np.array([reached + start, low + high]) / 2, 0.0, (start - reached, high - low)))
            reached = max(reached, end)
    return boxes

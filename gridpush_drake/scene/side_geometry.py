"""An object's outline as boxes that a finger can push.

Contact of a sphere and a box is solved in closed form in Drake, that of sphere and convex mesh by iteration. So each
edge of the outline is the outer face of one box, as deep as the object lets it be. A sphere's nearest point on these
boxes is the nearest point of the outline, corners and holes included; a corner shared by two boxes gives the same
contact twice.

The inside is filled with boxes too, a little clear of the outline, so that whatever else comes down on the object or
grips it is not let through.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon, box, constrained_delaunay_triangles, prepare
from shapely.geometry.polygon import orient

from gridpush_drake.grid.object import GridObject

Array = NDArray[np.float64]

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
        centre: (2,) m.
        angle: of its length from the x axis, rad.
        size: (length, width), m.
    """

    centre: Array
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
        centre = (start + end) / 2 + depth / 2 * inward
        boxes.append(PlanarBox(centre, float(np.arctan2(along[1], along[0])), (length, depth)))
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


def make_outline_mesh(outline: Polygon, height: float) -> str:
    """Makes a prism of the outline as a mesh.

    Args:
        outline: body frame, m.
        height: from its bottom at z = 0 to its top, m.

    Returns:
        Wavefront OBJ text, faces outwards.
    """
    vertices: list[str] = []
    faces: list[str] = []

    def add(points: list[tuple[float, float, float]]) -> None:
        first = len(vertices) + 1
        vertices.extend(f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in points)
        faces.append("f " + " ".join(str(first + i) for i in range(len(points))))

    for triangle in constrained_delaunay_triangles(outline).geoms:
        corners = list(orient(triangle).exterior.coords)[:3]
        add([(x, y, height) for x, y in corners])
        add([(x, y, 0.0) for x, y in reversed(corners)])
    whole = orient(outline)
    for ring in (whole.exterior, *whole.interiors):
        points = [tuple(point[:2]) for point in ring.coords]
        for (ax, ay), (bx, by) in pairwise(points):
            quad = [(ax, ay, 0.0), (bx, by, 0.0), (bx, by, height), (ax, ay, height)]
            add(quad[:3])
            add([quad[0], *quad[2:]])
    return "\n".join(["# prism of an outline, m", *vertices, *faces, ""])

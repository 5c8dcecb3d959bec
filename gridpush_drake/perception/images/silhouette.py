"""The silhouette of a prism on the table, as a camera sees it, and points on its boundary.

How a silhouette is moved onto the edges in a picture stands in `registration`.
"""

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import Polygon
from shapely.geometry.polygon import orient

from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.pixel_kernels import EDGE_COVERAGE


def make_silhouette(outline: Polygon, pose: ArrayLike, height: float, camera: Camera) -> Polygon:
    """Makes the silhouette of a prism: all of the table that it hides from a camera.

    Args:
        outline: outline of the prism in B, m.
        pose: (3,) pose (x, y, theta) of the prism, W, m and rad.
        height: height of the prism, m.
        camera: camera above it, with X_WC.

    Returns:
        A polygon on the table's plane, W, m, counterclockwise.
    """
    bottom = orient(shapely.transform(outline, lambda points: transform(pose, points)))
    if height == 0:
        return bottom
    # The top's shadow on the table, if the camera were a lamp: the bottom, scaled from its foot.
    foot = camera.center[:2]
    distance = camera.center[2]
    scale = distance / (distance - height)
    pieces = [bottom]
    for ring in (bottom.exterior, *bottom.interiors):
        low = np.array(ring.coords)
        high = foot + scale * (low - foot)

        # Only sides that face away from the camera hide any of the table beyond the bottom.
        along = np.diff(low, axis=0)
        arm = low[:-1] - foot
        hides = along[:, 1] * arm[:, 0] - along[:, 0] * arm[:, 1] > 0

        # Such sides in a row hide one strip. Where the strip crosses itself, each side's own
        # quadrilateral is taken.
        ends = np.flatnonzero(np.diff(hides, prepend=False, append=False))
        for i, j in ends.reshape(-1, 2):
            there = low[i : j + 1]
            back = high[i : j + 1][::-1]
            strip = shapely.polygons(np.concatenate([there, back]))
            if strip.is_valid:
                pieces.append(strip)
                continue
            sides = [low[i:j], low[i + 1 : j + 1], high[i + 1 : j + 1], high[i:j]]
            pieces += list(shapely.polygons(np.stack(sides, axis=1)))

    # Slivers apart from the whole come of rounding alone.
    whole = shapely.union_all([piece for piece in pieces if piece.is_valid])
    return orient(max(shapely.get_parts(whole), key=lambda piece: piece.area))


def sample_boundary(polygon: Polygon, spacing: float) -> tuple[Array, Array]:
    """Samples points on all rings of a polygon, evenly along them.

    Args:
        polygon: polygon with its exterior counterclockwise and its holes clockwise, m.
        spacing: distance between two points along a ring, m.

    Returns:
        (n, 2) points, m, and (n, 2) outward unit normals.
    """
    points = []
    normals = []
    for ring in (polygon.exterior, *polygon.interiors):
        corners = np.array(ring.coords)
        sides = np.diff(corners, axis=0)
        lengths = np.linalg.norm(sides, axis=1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])

        # Distances along the ring, from half a spacing on: no point lies on the first corner. Even
        # a tiny hole has a few.
        count = max(3, round(ends[-1] / spacing))
        at = (np.arange(count) + EDGE_COVERAGE) * spacing
        at = at[at < ends[-1]]

        side = np.searchsorted(ends, at, side="right") - 1
        side = np.clip(side, 0, len(sides) - 1)
        direction = sides[side] / lengths[side, None]
        along = at - ends[side]
        points.append(corners[side] + along[:, None] * direction)
        normals.append(np.column_stack([direction[:, 1], -direction[:, 0]]))
    return np.concatenate(points), np.concatenate(normals)

"""Where a disc can touch an outline, and how it gets round it, as `kernels.walk_round` takes it."""

import numpy as np
from shapely import Polygon

from gridpush_drake.dynamics.kernels.walk_round import Ways

TOUCHES = 96
"""Places round the block where a stroke may touch."""

LEAST_RING = 32
"""Least number of points of the ring on which the disc goes round the block."""

RING_SPACING = 1.5
"""Greatest distance of two neighbors on the ring, in radii of the disc. Each must be in sight of
the next. At a corner of the hull the line between two points that are further apart than 1.8
radii comes nearer to the corner than CLEARANCE, and a disc that came there would get no further."""

STANDOFF = 0.4
"""Distance from the touch at which a stroke begins, in radii of the disc."""

CLEARANCE = 1.04
"""Distance of the disc's center from the outline on its way round, in radii of the disc."""

RING_DISTANCE = 1.4
"""Distance of the ring from the convex hull, in radii of the disc."""

ARRIVAL = 0.53
"""Distance from the beginning of a stroke at which the disc has arrived there, in its radii."""

ARC_SEGMENTS = 16
"""Segments of a quarter circle, where an outline is widened by the disc's radius."""


def make_ways(outline: Polygon, radius: float) -> Ways:
    """Makes what the kernels take of an outline, body frame, and a disc of a radius."""
    rim = outline.exterior
    widened = outline.buffer(radius, quad_segs=ARC_SEGMENTS).exterior
    places = [widened.interpolate(i / TOUCHES, normalized=True) for i in range(TOUCHES)]
    touch = np.array([place.coords[0] for place in places])
    nearest = np.array([rim.interpolate(rim.project(place)).coords[0] for place in places])
    inward = nearest - touch
    around = outline.convex_hull.buffer(RING_DISTANCE * radius).exterior
    if not around.is_ccw:
        around = around.reverse()
    count = max(LEAST_RING, int(np.ceil(around.length / (RING_SPACING * radius))))
    ring = np.array(
        [around.interpolate(i / count, normalized=True).coords[0] for i in range(count)]
    )
    corners = np.array(rim.coords)
    return Ways(
        touch=touch,
        inward=np.arctan2(inward[:, 1], inward[:, 0]),
        ring=ring,
        edges=np.column_stack([corners[:-1], corners[1:]]),
        standoff=STANDOFF * radius,
        clearance=CLEARANCE * radius,
        arrival=ARRIVAL * radius,
    )

"""Where a disc can touch an outline, and how it gets round it: `make_outline_path`.

The disc is the pusher. To begin a stroke it goes round the block on a ring of points about the
block's convex hull, and comes in where it is to touch. `kernels.walk_round` goes by what is made
here. A pusher of another shape goes round as the disc does that holds all of it; then it faces the
outline, and comes near.
"""

import numpy as np
from shapely import Polygon

from gridpush_drake.dynamics.kernels.contact.walk_round import OutlinePath
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.geometry.se2 import Array, make_direction

TOUCH_COUNT = 96
"""Number of places round the block where a stroke may touch it."""

LEAST_RING = 32
"""Least number of points of the ring on which the disc goes round the block."""

RING_SPACING = 1.5
"""Greatest distance of two neighbors on the ring, in radii of the disc. The disc must be able to go
straight from each to the next. If two points beside a corner of the hull are farther apart than 1.8
radii, the line between them is nearer to the corner than DISC_CLEARANCE, and the disc gets
stuck."""

PRIMITIVE_STANDOFF = 0.4
"""Distance from the touch at which a stroke begins, in radii of the disc."""

DISC_CLEARANCE = 1.04
"""Least distance of the disc's center from the outline on its way round, in radii of the disc."""

RING_DISTANCE = 1.4
"""Distance of the ring from the convex hull, in radii of the disc."""

ARRIVAL_DISTANCE = 0.53
"""The disc has arrived at the beginning of a stroke if it is nearer than this, in its radii."""

ARC_SEGMENTS = 16
"""Number of segments of a quarter circle in an outline that is widened by the disc's radius."""


NEAR_GAP = 0.001
"""Gap between outline and a shape that has come near, m."""

NEAR_STEPS = 10
"""Halvings by which the place of a shape that has come near is found."""


def make_outline_path(
    outline: Polygon, radius: float, shape: PusherShape | None = None
) -> OutlinePath:
    """Makes the ways of a disc round an outline, for the kernels.

    Args:
        outline: the block's outline, body frame, m.
        radius: the disc's radius, m.
        shape: of a pusher that is no disc; None of a disc. The ways are then those of the disc that
            holds all of it, whatever its angle.
    """
    if shape is not None:
        radius = shape.reach
    rim = outline.exterior
    widened = outline.buffer(radius, quad_segs=ARC_SEGMENTS).exterior
    places = [widened.interpolate(i / TOUCH_COUNT, normalized=True) for i in range(TOUCH_COUNT)]
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
    angles = np.arctan2(inward[:, 1], inward[:, 0])
    standoff = PRIMITIVE_STANDOFF * radius
    near = touch - standoff * make_direction(angles)
    if shape is not None:
        near = _come_near(outline, shape, near, angles)
    return OutlinePath(
        touch=touch,
        inward=angles,
        near=near,
        comes_near=shape is not None,
        period=2.0 * np.pi if shape is None else shape.period,
        ring=ring,
        edges=np.column_stack([corners[:-1], corners[1:]]),
        standoff=standoff,
        clearance=DISC_CLEARANCE * radius,
        arrival=ARRIVAL_DISTANCE * radius,
    )


def _come_near(outline: Polygon, shape: PusherShape, places: Array, angles: Array) -> Array:
    """Moves a shape from places (M, 2), where it is clear, inwards until it is next to the outline.

    Args:
        outline: the block's outline, body frame, m.
        shape: the shape.
        places: (M, 2) where its center is, m.
        angles: (M,) its angles, in which it moves, rad.

    Returns:
        (M, 2) places of its center, m.
    """
    near = np.empty_like(places)
    for i, (place, angle) in enumerate(zip(places, angles, strict=True)):
        way = make_direction(angle)
        # how far it is clear, and how far it is not, or is all the way across
        clear = 0.0
        far = 2.0 * shape.reach * (1.0 + PRIMITIVE_STANDOFF)
        for _ in range(NEAR_STEPS):
            middle = 0.5 * (clear + far)
            area = shape.at(np.append(place + middle * way, angle))
            if outline.distance(area) > NEAR_GAP:
                clear = middle
            else:
                far = middle
        near[i] = place + clear * way
    return near

"""The way of a disc round an outline without touching it, compiled.

The way leads along a ring about the outline, to the farthest point of it that is in sight.
Everything is in the body frame of the object, which may move meanwhile. `planning.feedback.ways`
makes the ring of an outline.
"""

from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel


class OutlinePath(NamedTuple):
    """Where the disc can touch, and how it gets round the block, all in the body frame.

    Attributes:
        touch: (M, 2) center of the disc where it touches; of another shape, that of the circle that
            holds all of it.
        inward: (M,) angle of the normal there, into the block.
        near: (M, 2) where the center of another shape, turned to `inward`, is next to the block; a
            disc's is where its stroke begins.
        comes_near: whether a stroke comes there before it pushes, as that of another shape does.
        period: angle after which that shape looks the same.
        ring: (R, 2) points round the convex hull, at a distance.
        edges: (E, 4) both ends of the outline's edges.
        standoff: distance from the touch at which a stroke begins.
        clearance: distance of the disc's center from the outline on its way round.
        arrival: distance from its beginning at which a stroke begins.
    """

    touch: Any
    inward: Any
    near: Any
    comes_near: Any
    period: Any
    ring: Any
    edges: Any
    standoff: Any
    clearance: Any
    arrival: Any


@kernel(allocates=False)
def calc_distance2(ax, ay, bx, by, px, py):
    """Squared distance of a point from the segment from a to b."""
    ex = bx - ax
    ey = by - ay
    length2 = ex * ex + ey * ey
    fraction = 0.0
    if length2 > 0.0:
        fraction = min(max(((px - ax) * ex + (py - ay) * ey) / length2, 0.0), 1.0)
    return (ax + fraction * ex - px) ** 2 + (ay + fraction * ey - py) ** 2


@kernel(allocates=False)
def _is_clear(edges, ax, ay, bx, by, clearance2):
    """Whether the segment from a to b keeps clear of all edges."""
    for i in range(edges.shape[0]):
        cx = edges[i, 0]
        cy = edges[i, 1]
        dx = edges[i, 2]
        dy = edges[i, 3]
        if (
            calc_distance2(ax, ay, bx, by, cx, cy) < clearance2
            or calc_distance2(ax, ay, bx, by, dx, dy) < clearance2
            or calc_distance2(cx, cy, dx, dy, bx, by) < clearance2
            or calc_distance2(cx, cy, dx, dy, ax, ay) < clearance2
        ):
            return False
        # they cross
        side_c = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        side_d = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
        side_a = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
        side_b = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
        if side_c * side_d < 0.0 and side_a * side_b < 0.0:
            return False
    return True


@kernel(allocates=False)
def find_way(ways, ax, ay, gx, gy, turn, at):
    """Finds the next point on the way from a to g round the block, and writes it to at (2,).

    Args:
        ways: the block's surroundings.
        ax, ay: where the disc is, body frame.
        gx, gy: where it should go, body frame.
        turn: 1 to go round counterclockwise, -1 clockwise.
        at: (2,) filled.
    """
    closest2 = np.inf
    for i in range(ways.edges.shape[0]):
        closest2 = min(
            closest2,
            calc_distance2(
                ways.edges[i, 0], ways.edges[i, 1], ways.edges[i, 2], ways.edges[i, 3], ax, ay
            ),
        )
    # a disc that touches may leave along a line that comes no closer
    clearance2 = min(ways.clearance * ways.clearance, 0.99 * closest2)
    at[0] = gx
    at[1] = gy
    if _is_clear(ways.edges, ax, ay, gx, gy, clearance2):
        return
    count = ways.ring.shape[0]
    last = 0
    best = np.inf
    for i in range(count):
        distance2 = (ways.ring[i, 0] - gx) ** 2 + (ways.ring[i, 1] - gy) ** 2
        if distance2 < best:
            best = distance2
            last = i
    # the farthest point along the ring that is in sight
    for i in range(count):
        k = (last - turn * i) % count
        if _is_clear(ways.edges, ax, ay, ways.ring[k, 0], ways.ring[k, 1], clearance2):
            at[0] = ways.ring[k, 0]
            at[1] = ways.ring[k, 1]
            return
    best = np.inf
    for i in range(count):
        distance2 = (ways.ring[i, 0] - ax) ** 2 + (ways.ring[i, 1] - ay) ** 2
        if distance2 < best:
            best = distance2
            at[0] = ways.ring[i, 0]
            at[1] = ways.ring[i, 1]

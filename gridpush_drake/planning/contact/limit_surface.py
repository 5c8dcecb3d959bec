"""What many pushes will roughly do, by the ellipsoidal limit surface; which to begin a search with.

All friction of the support together resists at most a force f_max = sum k_i, or a moment
m_max = sum k_i a_i about the center of friction c. Here a_i is the arm by which cell i resists
being turned about c; it is |p_i - c|, and a little more for a cell's own resistance to spinning.
What it resists in between is about an ellipsoid (Goyal, Ruina & Papadopoulos 1991; Lynch & Mason
1996).

With lambda = m_max / f_max, a force f at the point p, relative to c, gives the quasi-static
velocity v of c and the angular velocity w

    v ~ f,   w ~ (p x f) / lambda²

so that the body's point at the contact moves with

    v_p ~ B f,   B = I + p⊥ p⊥^T / lambda²,   p⊥ = z x p

The contact sticks, v_p is the pusher's velocity u, as long as f = B^-1 u is within the friction
cone. Otherwise it slides, and f is on the cone's edge.

This costs no simulation, and only says where simulations are worth their while: `screen` tries all
places along the reachable outline with several directions each, and takes the best of them that
are not near a better one. How near a disc is to the outline is read from a table of signed
distances. The theory is in `docs/theory/planning.md`, section 1.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray

from gridpush_drake.dynamics.kernels.friction.friction_law import calc_spin_lever_arm
from gridpush_drake.geometry.se2 import Array, compose, rotate, transform
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.contact_kernels import (
    follow_roughly,
)
from gridpush_drake.planning.contact.trial import TrialRunner

TABLE_STEP = 0.003
"""Distance between nodes of the table of signed distances, m."""

MAX_TABLE_NODES = 1000
"""Greatest number of nodes along a side of that table; a larger object has a coarser table."""

TABLE_ROOM = 0.02
"""By how much the table reaches beyond the outline grown by the disc, m."""

PUSH_STEPS = 16
"""Number of steps that a push is cut into."""

PLACE_COUNT = 96
"""Number of places along the outline that are ranked."""

DIRECTION_COUNT = 9
"""Number of directions at each place that are ranked."""

NEAR_PLACE = 0.05
"""Two pushes are near one another if their places are within this fraction of the perimeter, and
their directions within `NEAR_ANGLE`."""

NEAR_ANGLE = 0.3
"""Difference of direction below which two pushes may be near one another, rad; see `NEAR_PLACE`."""

BLOCK_SIZE = 16
"""Number of pushes that the rules are asked about at once."""


@dataclass(frozen=True, eq=False)
class DistanceTable:
    """Signed distance to the outline at the nodes of a square lattice, body frame.

    Attributes:
        corner: (2,) the first node, m.
        step: distance between nodes, m.
        values: (nx, ny) signed distances, m; positive outside.
    """

    corner: Array
    step: float
    values: Array


@lru_cache(maxsize=32)
def make_distance_table(obj: GridObject, radius: float) -> DistanceTable:
    """Tabulates the signed distance to the exterior outline, for a disc of a radius, m."""
    outline = shapely.Polygon(obj.outline.exterior)
    shapely.prepare(outline)
    low = np.array(outline.bounds[:2])
    high = np.array(outline.bounds[2:])
    room = radius + TABLE_ROOM
    step = max(TABLE_STEP, float((high - low).max() + 2 * room) / MAX_TABLE_NODES)
    x, y = (np.arange(low[i] - room, high[i] + room + step, step) for i in (0, 1))
    X, Y = np.meshgrid(x, y, indexing="ij")
    distance = shapely.distance(outline.exterior, shapely.points(X, Y))
    inside = shapely.contains_xy(outline, X, Y)
    return DistanceTable(
        corner=np.array([x[0], y[0]]), step=step, values=np.where(inside, -distance, distance)
    )


def predict_roughly(
    model: Model,
    start: Array,
    direction: Array,
    distance: float,
    radius: float,
) -> Array:
    """Follows N straight pushes of an object at (0, 0, 0) by the ellipsoidal limit surface.

    Args:
        model: one object, with its parameters.
        start: (N, 2) p_BP of the disc's center at the beginning, m.
        direction: (N, 2) unit vectors of the motion.
        distance: length of the motion, m.
        radius: of the disc, m.

    Returns:
        (PUSH_STEPS, N, 3) poses (x, y, theta) of the body frame after each step, m and rad.
    """
    obj = model.obj
    params = model.params
    table = make_distance_table(obj, radius)
    k = params.relative_friction()  # sums to one, so that f_max = 1 and lambda = m_max
    c = k @ obj.p_BC
    arm = np.hypot(np.linalg.norm(obj.p_BC - c, axis=1), calc_spin_lever_arm(obj, params))
    poses = np.empty((PUSH_STEPS, len(start), 3))
    follow_roughly(
        values=table.values,
        corner=table.corner,
        step=table.step,
        start=np.array(start, order="C"),
        direction=np.array(direction, order="C"),
        length=distance / PUSH_STEPS,
        radius=float(radius),
        center=c,
        inverse=1.0 / float(k @ arm) ** 2,  # 1 / lambda²
        mu=float(params.contact_friction),
        poses=poses,
    )
    return poses


@dataclass(frozen=True, eq=False)
class RankedPushes:
    """Pushes with which to begin a search, best first.

    Attributes:
        arc_length: (K,) m.
        piece: (K,) of the reachable outline.
        angle: (K,) of the motion from the inward normal, rad.
        rough_cost: (K,) cost that the limit surface expects, m.
    """

    arc_length: Array
    piece: NDArray[np.int64]
    angle: Array
    rough_cost: Array


def screen(runner: TrialRunner) -> RankedPushes:
    """Ranks pushes from the runner's pose towards its goal.

    Returns:
        At most as many as the search has starts; fewer where the rules forbid the others, or they
        are near one another.
    """
    options = runner.options
    # All places with all directions.
    s, piece = runner.reach.spread(runner.reach.length / PLACE_COUNT)
    angles = np.linspace(*options.angle_range, DIRECTION_COUNT)
    angle = np.tile(angles, len(s))
    s = np.repeat(s, DIRECTION_COUNT)
    piece = np.repeat(piece, DIRECTION_COUNT)
    normal = runner.reach.normal[piece]
    radius = options.pusher.choose_radius(runner.model.obj)
    start = runner.reach.point(s, piece) + (radius + options.pusher.clearance) * normal
    direction = -rotate(angle, normal)
    # Those that begin where the finger may be.
    keep = runner.checker.allows_finger(transform(runner.pose, start))
    s = s[keep]
    piece = piece[keep]
    angle = angle[keep]
    start = start[keep]
    direction = direction[keep]
    if not len(s):
        return RankedPushes(arc_length=s, piece=piece, angle=angle, rough_cost=np.empty(0))
    longest = runner.distance_range[1]
    poses = predict_roughly(runner.model, start, direction, longest, radius)
    costs = _calc_rough_costs(runner, poses)

    def count_allowed(some: NDArray[np.int64]) -> NDArray[np.int64]:
        return _count_allowed(runner, poses[:, some], start[some], direction[some])

    chosen, cost = _pick_apart(runner, s, angle, costs, count_allowed, options.starts)
    return RankedPushes(
        arc_length=s[chosen], piece=piece[chosen], angle=angle[chosen], rough_cost=cost
    )


def _calc_rough_costs(runner: TrialRunner, poses: Array) -> Array:
    """Calculates the root mean square distance of the cells from where they are at the goal.

    It is sqrt(|dc|² + 2 (1 - cos dtheta) rho²), where dc is the way of the cells' centroid, dtheta
    their turn and rho the radius of gyration.

    Args:
        runner: knows the goal.
        poses: (steps, N, 3) in the body's first frame, m and rad.

    Returns:
        (steps, N) m.
    """
    centroid = runner.model.obj.p_BC.mean(axis=0)
    rho = runner.model.obj.radius_of_gyration
    world = compose(runner.pose, poses)
    dc = transform(world, centroid[None])[..., 0, :] - transform(runner.goal, centroid[None])[0]
    dtheta = world[..., 2] - runner.goal[2]
    return np.sqrt((dc**2).sum(axis=-1) + 2 * (1 - np.cos(dtheta)) * rho**2)


def _count_allowed(
    runner: TrialRunner, poses: Array, start: Array, direction: Array
) -> NDArray[np.int64]:
    """Counts the steps of rough motions that the rules allow, from the first on.

    Args:
        runner: knows the rules.
        poses: (steps, N, 3) in the body's first frame, m and rad.
        start: (N, 2) of the disc's center, in that frame, m.
        direction: (N, 2) of its motion.

    Returns:
        (N,).
    """
    steps, count, _ = poses.shape
    if runner.checker.constraints.is_free:
        return np.full(count, steps)
    traveled = runner.distance_range[1] * np.arange(1, steps + 1) / steps
    places = start[:, None] + traveled[:, None] * direction[:, None]
    tip = transform(runner.pose, places.reshape(-1, 2))
    world = compose(runner.pose, poses.swapaxes(0, 1)).reshape(-1, 3)
    allowed = runner.checker.allows_finger(tip) & runner.checker.allows_poses(world)
    allowed = allowed.reshape(count, steps)
    return np.where(allowed.all(axis=1), steps, np.argmin(allowed, axis=1))


def _pick_apart(
    runner: TrialRunner,
    s: Array,
    angle: Array,
    costs: Array,
    count_allowed: Callable[[NDArray[np.int64]], NDArray[np.int64]],
    count: int,
) -> tuple[NDArray[np.int64], Array]:
    """Picks the cheapest pushes, each of them far from the cheaper ones.

    What a push costs as far as the rules allow it is at least what it costs without them. So the
    rules, which take longest, are asked only about those pushes whose turn comes, and about the
    next cheapest ones together with them.

    Args:
        runner: knows the outline.
        s: (N,) arc lengths, m.
        angle: (N,) angles, rad.
        costs: (steps, N) cost after each step, m.
        count_allowed: says how many steps of some pushes, given by their indices, the rules allow.
        count: how many to pick at most.

    Returns:
        Their indices and their costs.
    """
    perimeter = runner.reach.perimeter
    chosen: list[int] = []
    kept: list[float] = []

    # Whether each push is near one that was chosen.
    near = np.zeros(len(s), dtype=bool)
    # A queue of (cost, place in the order of costs without rules, whether the rules were asked),
    # cheapest first.
    least = costs.min(axis=0)
    order = np.argsort(least, kind="stable")
    queue = [(float(least[i]), rank, False) for rank, i in enumerate(order)]
    allowed_of: dict[int, int] = {}
    while queue and len(chosen) < count:
        cost, rank, asked = heapq.heappop(queue)
        i = int(order[rank])
        if near[i]:
            continue
        if asked:
            chosen.append(i)
            kept.append(cost)
            gap = np.abs(s - s[i])
            at_place = np.minimum(gap, perimeter - gap) < NEAR_PLACE * perimeter
            near |= at_place & (np.abs(angle - angle[i]) < NEAR_ANGLE)
            continue
        if i not in allowed_of:
            block = order[rank : rank + 2 * BLOCK_SIZE]
            block = block[~near[block]][:BLOCK_SIZE]
            allowed_of.update(zip(block.tolist(), count_allowed(block).tolist(), strict=True))
        allowed = allowed_of[i]
        if allowed:
            heapq.heappush(queue, (float(costs[:allowed, i].min()), rank, True))
    return np.array(chosen, dtype=np.int64), np.array(kept)

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

from gridpush_drake.dynamics.kernels.friction_law import calc_spin_arm
from gridpush_drake.geometry.se2 import Array, compose, rotate, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import TrialRunner

TABLE_STEP = 0.003
"""Distance between nodes of the table of signed distances, m."""

MAX_TABLE_NODES = 1000
"""Greatest number of nodes along a side of that table; a larger object has a coarser table."""

TABLE_ROOM = 0.02
"""By how much the table reaches beyond the outline grown by the disc, m."""

LAST_CELL = 1.001
"""Points beyond the table are brought this many nodes inside its last one, so that the node after
the one below them exists."""

STEPS = 16
"""Number of steps that a push is cut into."""

PLACES = 96
"""Number of places along the outline that are ranked."""

ANGLES = 9
"""Number of directions at each place that are ranked."""

NEAR_PLACE = 0.05
"""Two pushes are near one another if their places are within this share of the perimeter, and their
directions within `NEAR_ANGLE`."""

NEAR_ANGLE = 0.3
"""Difference of direction below which two pushes may be near one another, rad; see `NEAR_PLACE`."""

MIN_SLOPE = 1e-12
"""Least length of a gradient of the distance that a normal is made of, for it may be zero."""

MIN_SPEED = 1e-9
"""Least speed of the contact along its normal, per force, that is divided by."""


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

    def lookup(self, p: Array) -> tuple[Array, Array]:
        """Looks distances and normals up at points (N, 2), by bilinear interpolation.

        Points beyond the table have the values at its edge.

        Returns:
            Distances (N,), m, and outward unit normals (N, 2).
        """
        # Node (i, j) below each point, and how far (u, v) beyond it the point is, in cells.
        cell = np.clip((p - self.corner) / self.step, 0.0, np.array(self.values.shape) - LAST_CELL)
        i, j = cell.astype(int).T
        u = cell[:, 0] - i
        v = cell[:, 1] - j
        a = self.values[i, j]
        b = self.values[i + 1, j]
        c = self.values[i, j + 1]
        d = self.values[i + 1, j + 1]
        value = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
        slope = np.column_stack([(1 - v) * (b - a) + v * (d - c), (1 - u) * (c - a) + u * (d - b)])
        length = np.linalg.norm(slope, axis=1, keepdims=True)
        return value, slope / np.maximum(length, MIN_SLOPE)


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
    obj: GridObject,
    params: CellParameters,
    start: Array,
    direction: Array,
    distance: float,
    radius: float,
) -> Array:
    """Follows N straight pushes of an object at (0, 0, 0) by the ellipsoidal limit surface.

    Args:
        obj: the object.
        params: its masses and frictions.
        start: (N, 2) p_BP of the disc's center at the beginning, m.
        direction: (N, 2) unit vectors of the motion.
        distance: length of the motion, m.
        radius: of the disc, m.

    Returns:
        (STEPS, N, 3) poses (x, y, theta) of the body frame after each step, m and rad.
    """
    table = make_distance_table(obj, radius)
    k = params.relative_friction()  # sums to one, so that f_max = 1 and lambda = m_max
    c = k @ obj.p_BC
    arm = np.hypot(np.linalg.norm(obj.p_BC - c, axis=1), calc_spin_arm(obj, params))
    inverse = 1.0 / float(k @ arm) ** 2  # 1 / lambda²
    h = distance / STEPS
    # The center of friction of every push, and how far the body has turned.
    center = np.tile(c, (len(start), 1))
    theta = np.zeros(len(start))
    poses = np.empty((STEPS, len(start), 3))
    for step in range(STEPS):
        # The tip, and its motion u in this step, seen from the body; the contact below the tip.
        p_tip = rotate(-theta, start + h * step * direction - center)
        u = h * rotate(-theta, direction)
        away, outward = table.lookup(p_tip + c)
        twist = _calc_twist(
            p=p_tip - away[:, None] * outward,
            n=-outward,
            u=u,
            gap=away - radius,
            inverse=inverse,
            mu=params.contact_friction,
        )
        # The body moves along the mean of its headings before and after the step.
        center = center + rotate(theta + twist[:, 2] / 2, twist[:, :2])
        theta = theta + twist[:, 2]
        poses[step] = np.column_stack([center - rotate(theta, c), theta])
    return poses


def _calc_twist(p: Array, n: Array, u: Array, gap: Array, inverse: float, mu: float) -> Array:
    """Calculates by how much N bodies move in one step.

    Args:
        p: (N, 2) contact points, relative to the center of friction, m.
        n: (N, 2) unit normals there, into the body.
        u: (N, 2) motions of the tip, m.
        gap: (N,) between tip and body before the step, m; negative where they overlap.
        inverse: 1 / lambda², 1/m².
        mu: friction coefficient of the contact.

    Returns:
        (N, 3) displacement of the body's center of friction, m, and its turn, rad.
    """
    # How far the tip would enter the body, and its motion without the part that closes the gap.
    # Where they overlap, the body is moved out as well.
    closing = np.maximum((n * u).sum(axis=1) - gap, 0.0)
    u = u + np.minimum(0.0, -np.maximum(gap, 0.0))[:, None] * n + np.maximum(-gap, 0.0)[:, None] * n
    # Sticking: f = B^-1 u, by Sherman and Morrison.
    p_perp = np.column_stack([-p[:, 1], p[:, 0]])
    norm = 1.0 + inverse * (p**2).sum(axis=1)
    sticking = u - (inverse * (p_perp * u).sum(axis=1) / norm)[:, None] * p_perp
    # Is f outside the friction cone?
    t = np.column_stack([-n[:, 1], n[:, 0]])
    along_n = (sticking * n).sum(axis=1)
    along_t = (sticking * t).sum(axis=1)
    slides = np.abs(along_t) > mu * along_n
    # Sliding: f on the cone's edge, such that the contact moves out of the tip's way along n.
    edge = n + mu * np.sign(along_t)[:, None] * t
    speed = (edge * n).sum(axis=1)
    speed = speed + inverse * (p_perp * edge).sum(axis=1) * (p_perp * n).sum(axis=1)
    sliding = (closing / np.maximum(speed, MIN_SPEED))[:, None] * edge
    # Where the tip does not reach the body, nothing moves.
    f = np.where(slides[:, None], sliding, sticking) * (closing > 0)[:, None]
    return np.column_stack([f, inverse * (p_perp * f).sum(axis=1)])


@dataclass(frozen=True, eq=False)
class Screening:
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


def screen(runner: TrialRunner) -> Screening:
    """Ranks pushes from the runner's pose towards its goal.

    Returns:
        At most as many as the search has starts; fewer where the rules forbid the others, or they
        are near one another.
    """
    options = runner.options
    # All places with all directions.
    s, piece = runner.reach.spread(runner.reach.length / PLACES)
    angles = np.linspace(*options.angle_range, ANGLES)
    angle = np.tile(angles, len(s))
    s = np.repeat(s, ANGLES)
    piece = np.repeat(piece, ANGLES)
    normal = runner.reach.normal[piece]
    start = runner.reach.point(s, piece) + (options.radius + options.clearance) * normal
    direction = -rotate(angle, normal)
    # Those that begin where the finger may be.
    keep = runner.checker.allows_finger(transform(runner.pose, start))
    s = s[keep]
    piece = piece[keep]
    angle = angle[keep]
    start = start[keep]
    direction = direction[keep]
    if not len(s):
        return Screening(arc_length=s, piece=piece, angle=angle, rough_cost=np.empty(0))
    longest = runner.distance_range[1]
    poses = predict_roughly(runner.obj, runner.params, start, direction, longest, options.radius)
    costs = _calc_rough_costs(runner, poses)

    def count_allowed(i: int) -> int:
        return _count_allowed(runner, poses[:, i], start[i], direction[i])

    chosen, cost = _pick_apart(runner, s, angle, costs, count_allowed, options.starts)
    return Screening(
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
    centroid = runner.obj.p_BC.mean(axis=0)
    rho = runner.obj.radius_of_gyration
    world = compose(runner.pose, poses)
    dc = transform(world, centroid[None])[..., 0, :] - transform(runner.goal, centroid[None])[0]
    dtheta = world[..., 2] - runner.goal[2]
    return np.sqrt((dc**2).sum(axis=-1) + 2 * (1 - np.cos(dtheta)) * rho**2)


def _count_allowed(runner: TrialRunner, poses: Array, start: Array, direction: Array) -> int:
    """Counts the steps of a rough motion that the rules allow, from the first on.

    Args:
        runner: knows the rules.
        poses: (steps, 3) in the body's first frame, m and rad.
        start: (2,) of the disc's center, in that frame, m.
        direction: (2,) of its motion.
    """
    steps = len(poses)
    if runner.checker.constraints.is_free:
        return steps
    traveled = runner.distance_range[1] * np.arange(1, steps + 1) / steps
    tip = transform(runner.pose, start + traveled[:, None] * direction)
    world = compose(runner.pose, poses)
    allowed = runner.checker.allows_finger(tip) & runner.checker.allows_poses(world)
    return steps if allowed.all() else int(np.argmin(allowed))


def _pick_apart(
    runner: TrialRunner,
    s: Array,
    angle: Array,
    costs: Array,
    count_allowed: Callable[[int], int],
    count: int,
) -> tuple[NDArray[np.int64], Array]:
    """Picks the cheapest pushes, each of them far from the cheaper ones.

    What a push costs as far as the rules allow it is at least what it costs without them. So the
    rules, which take longest, are asked only about those pushes whose turn comes.

    Args:
        runner: knows the outline.
        s: (N,) arc lengths, m.
        angle: (N,) angles, rad.
        costs: (steps, N) cost after each step, m.
        count_allowed: says how many steps of a push, given by its index, the rules allow.
        count: how many to pick at most.

    Returns:
        Their indices and their costs.
    """
    perimeter = runner.reach.perimeter
    # A queue of (cost, index, whether the rules were asked), cheapest first.
    queue = [(float(cost), i, False) for i, cost in enumerate(costs.min(axis=0))]
    heapq.heapify(queue)
    chosen: list[int] = []
    kept: list[float] = []
    while queue and len(chosen) < count:
        cost, i, asked = heapq.heappop(queue)
        gap = np.abs(s[chosen] - s[i])
        near = np.minimum(gap, perimeter - gap) < NEAR_PLACE * perimeter
        if (near & (np.abs(angle[chosen] - angle[i]) < NEAR_ANGLE)).any():
            continue
        if asked:
            chosen.append(i)
            kept.append(cost)
            continue
        allowed = count_allowed(i)
        if allowed:
            heapq.heappush(queue, (float(costs[:allowed, i].min()), i, True))
    return np.array(chosen, dtype=np.int64), np.array(kept)

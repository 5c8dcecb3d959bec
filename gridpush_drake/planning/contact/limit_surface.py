"""What a push will roughly do, for a great many pushes at once: the ellipsoidal limit surface; and which to begin with.

The support's friction as a whole can resist a force f_max = sum k_i, or a moment m_max = sum k_i
|p_i - c| about the center of friction c; in between lies about an ellipsoid (Goyal, Ruina &
Papadopoulos 1991; Lynch & Mason 1996). With lambda = m_max / f_max the quasi-static twist about c
that a force f at the point p, relative to c, gives is

    v ~ f,   w ~ (p x f) / lambda²,   so that the contact moves with   v_p ~ B f,   B = I + p⊥ p⊥^T
    / lambda²,

with p⊥ = z x p. Where the pusher's velocity u asks for a force f = B^-1 u outside the friction
cone, the contact slides and f is on the cone's edge. Disc against outline is read from a table of
the signed distance to the outline.

This costs no simulation; it only says where simulations are worth their while: `screen` follows all
places along the reachable outline, with some directions each, and takes the best of them that are
not near a better one.
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

TABLE_STEP = 0.003  # m, of the table of signed distances
MAX_TABLE_NODES = 1000  # along a side of the table; what is larger than they span has wider steps
TABLE_ROOM = 0.02  # m, by which the table exceeds the outline grown by the disc
STEPS = 16  # steps that a push is cut into


@dataclass(frozen=True, eq=False)
class DistanceTable:
    """Signed distance to the outline at the nodes of a square lattice, body frame, m; positive outside."""

    corner: Array
    step: float
    values: Array

    def lookup(self, p: Array) -> tuple[Array, Array]:
        """Distances (N,) and outward unit normals (N, 2) at points (N, 2), by bilinear interpolation; held beyond."""
        cell = np.clip((p - self.corner) / self.step, 0.0, np.array(self.values.shape) - 1.001)
        i, j = cell.astype(int).T
        u, v = cell[:, 0] - i, cell[:, 1] - j
        a, b, c, d = (
            self.values[i, j],
            self.values[i + 1, j],
            self.values[i, j + 1],
            self.values[i + 1, j + 1],
        )
        value = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
        slope = np.column_stack([(1 - v) * (b - a) + v * (d - c), (1 - u) * (c - a) + u * (d - b)])
        return value, slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)


@lru_cache(maxsize=32)
def make_distance_table(obj: GridObject, radius: float) -> DistanceTable:
    """Tabulates the signed distance to the exterior outline as far as a disc of `radius` (m) may be."""
    outline = shapely.Polygon(obj.outline.exterior)
    shapely.prepare(outline)
    low, high = np.array(outline.bounds[:2]), np.array(outline.bounds[2:])
    room = radius + TABLE_ROOM
    step = max(TABLE_STEP, float((high - low).max() + 2 * room) / MAX_TABLE_NODES)
    x, y = (np.arange(low[i] - room, high[i] + room + step, step) for i in (0, 1))
    X, Y = np.meshgrid(x, y, indexing="ij")
    distance = shapely.distance(outline.exterior, shapely.points(X, Y))
    return DistanceTable(
        np.array([x[0], y[0]]),
        step,
        np.where(shapely.contains_xy(outline, X, Y), -distance, distance),
    )


def predict_roughly(
    obj: GridObject, params: CellParameters, start: Array, direction: Array, distance: float, radius: float
) -> Array:  # fmt: skip
    """Follows N straight pushes of an object at the pose (0, 0, 0) by the ellipsoidal limit surface.

    Args:
        start: (N, 2) p_BP of the disc's center at the beginning, m.
        direction: (N, 2) unit vectors of the motion, which goes `distance`, m.
        radius: of the disc, m.

    Returns:
        (STEPS, N, 3) poses (x, y, theta) of the body frame after each step, m and rad.
    """
    table = make_distance_table(obj, radius)
    share = params.relative_friction()
    c = share @ obj.p_BC
    arm = np.hypot(np.linalg.norm(obj.p_BC - c, axis=1), calc_spin_arm(obj, params))
    inverse = 1.0 / float(share @ arm) ** 2
    mu, h = params.contact_friction, distance / STEPS
    center, theta = np.tile(c, (len(start), 1)), np.zeros(len(start))
    poses = np.empty((STEPS, len(start), 3))
    for step in range(STEPS):
        p_tip = rotate(-theta, start + h * step * direction - center)
        u = h * rotate(-theta, direction)
        away, outward = table.lookup(p_tip + c)
        twist = _calc_twist(
            p_tip - away[:, None] * outward, -outward, u, away - radius, inverse, mu
        )
        center = center + rotate(theta + twist[:, 2] / 2, twist[:, :2])
        theta = theta + twist[:, 2]
        poses[step] = np.column_stack([center - rotate(theta, c), theta])
    return poses


def _calc_twist(p: Array, n: Array, u: Array, gap: Array, inverse: float, mu: float) -> Array:
    """Displacement (N, 3) of the body, at the center of friction: contacts p, inward normals n, the tip's motion u."""
    closing = np.maximum((n * u).sum(axis=1) - gap, 0.0)
    t = np.column_stack([-n[:, 1], n[:, 0]])
    u = u + np.minimum(0.0, -np.maximum(gap, 0.0))[:, None] * n + np.maximum(-gap, 0.0)[:, None] * n
    lever = np.column_stack([-p[:, 1], p[:, 0]])
    # B^-1 u by Sherman-Morrison
    norm = 1.0 + inverse * (p**2).sum(axis=1)
    force = u - (inverse * (lever * u).sum(axis=1) / norm)[:, None] * lever
    along, across = (force * n).sum(axis=1), (force * t).sum(axis=1)
    slides = np.abs(across) > mu * along
    edge = n + mu * np.sign(across)[:, None] * t
    speed = (edge * n).sum(axis=1) + inverse * (lever * edge).sum(axis=1) * (lever * n).sum(axis=1)
    sliding = (closing / np.maximum(speed, 1e-9))[:, None] * edge
    force = np.where(slides[:, None], sliding, force) * (closing > 0)[:, None]
    return np.column_stack([force, inverse * (lever * force).sum(axis=1)])


PLACES, ANGLES = 96, 9  # places along the outline and directions at each that are ranked

NEAR_PLACE, NEAR_ANGLE = 0.05, 0.3
"""Share of the perimeter and rad within which two pushes count as near one another."""


@dataclass(frozen=True, eq=False)
class Screening:
    """Ranked beginnings, best first."""

    arc_length: Array  # (K,) m
    piece: NDArray[np.int64]  # (K,) of the reachable outline
    angle: Array  # (K,) rad
    rough_cost: Array  # (K,) what the limit surface expects, m


def screen(runner: TrialRunner) -> Screening:
    """Ranks pushes from the runner's pose towards its goal.

    At most as many as there are starts; fewer where the rules forbid the others, or they are near
    one another.
    """
    options = runner.options
    s, piece = runner.reach.spread(runner.reach.length / PLACES)
    angles = np.linspace(*options.angle_range, ANGLES)
    s, piece, angle = np.repeat(s, ANGLES), np.repeat(piece, ANGLES), np.tile(angles, len(s))
    normal = runner.reach.normal[piece]
    start = runner.reach.point(s, piece) + (options.radius + options.clearance) * normal
    direction = -rotate(angle, normal)
    keep = runner.checker.allows_finger(transform(runner.pose, start))
    s, piece, angle, start, direction = (
        s[keep],
        piece[keep],
        angle[keep],
        start[keep],
        direction[keep],
    )
    if not len(s):
        return Screening(s, piece, angle, np.empty(0))
    longest = runner.distance_range[1]
    poses = predict_roughly(runner.obj, runner.params, start, direction, longest, options.radius)
    costs = _calc_rough_costs(runner, poses)

    def count_allowed(i: int) -> int:
        return _count_allowed(runner, poses[:, i], start[i], direction[i])

    chosen, cost = _pick_apart(runner, s, angle, costs, count_allowed, options.starts)
    return Screening(s[chosen], piece[chosen], angle[chosen], cost)


def _calc_rough_costs(runner: TrialRunner, poses: Array) -> Array:
    """(steps, N) root mean square distance of the cells from the goal's: |dc|² + 2 (1 - cos dtheta) rho²."""
    centroid, rho = runner.obj.p_BC.mean(axis=0), runner.obj.radius_of_gyration
    world = compose(runner.pose, poses)
    at, aim = transform(world, centroid[None])[..., 0, :], transform(runner.goal, centroid[None])[0]
    turn = world[..., 2] - runner.goal[2]
    return np.sqrt(((at - aim) ** 2).sum(axis=-1) + 2 * (1 - np.cos(turn)) * rho**2)


def _count_allowed(runner: TrialRunner, poses: Array, start: Array, direction: Array) -> int:
    """How many steps of a rough motion, poses (steps, 3) in the body's first frame, the rules allow."""
    steps = len(poses)
    if runner.checker.constraints.is_free:
        return steps
    traveled = runner.distance_range[1] * np.arange(1, steps + 1) / steps
    tip = transform(runner.pose, start + traveled[:, None] * direction)
    fine = runner.checker.allows_finger(tip) & runner.checker.allows_poses(
        compose(runner.pose, poses)
    )
    return steps if fine.all() else int(np.argmin(fine))


def _pick_apart(
    runner: TrialRunner,
    s: Array,
    angle: Array,
    costs: Array,
    count_allowed: Callable[[int], int],
    count: int,
) -> tuple[NDArray[np.int64], Array]:
    """Indices and costs of the `count` cheapest, each far from the cheaper ones; `costs` (steps, N) after each step, m.

    What a push costs as far as the rules allow it is at least what it costs without them, so that
    only those pushes are looked up whose turn comes.
    """
    perimeter = runner.reach.perimeter
    queue = [(float(cost), i, False) for i, cost in enumerate(costs.min(axis=0))]
    heapq.heapify(queue)
    chosen: list[int] = []
    kept: list[float] = []
    while queue and len(chosen) < count:
        cost, i, checked = heapq.heappop(queue)
        gap = np.abs(s[chosen] - s[i])
        near = np.minimum(gap, perimeter - gap) < NEAR_PLACE * perimeter
        if (near & (np.abs(angle[chosen] - angle[i]) < NEAR_ANGLE)).any():
            continue
        if checked:
            chosen.append(i)
            kept.append(cost)
            continue
        allowed = count_allowed(i)
        if allowed:
            heapq.heappush(queue, (float(costs[:allowed, i].min()), i, True))
    return np.array(chosen, dtype=np.int64), np.array(kept)

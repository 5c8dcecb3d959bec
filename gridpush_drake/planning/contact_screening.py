"""Where a contact search should begin: places and directions ranked without a simulation.

All places along the reachable outline, with some directions each, are followed by the ellipsoidal limit surface
(`limit_surface`), and the best of them taken that are not near a better one.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.planning.limit_surface import predict_roughly
from gridpush_drake.planning.push_trial import TrialRunner

Array = NDArray[np.float64]

PLACES, ANGLES = 96, 9
"""Places along the outline and directions at each that are ranked."""

NEAR_PLACE, NEAR_ANGLE = 0.05, 0.3
"""Share of the perimeter and rad within which two pushes count as near one another."""


@dataclass(frozen=True, eq=False)
class Screening:
    """Ranked beginnings, best first.

    Attributes:
        arc_length: (K,) m.
        piece: (K,) of the reachable outline.
        angle: (K,) rad.
        rough_cost: (K,) what the limit surface expects, m.
    """

    arc_length: Array
    piece: NDArray[np.int64]
    angle: Array
    rough_cost: Array


def screen(runner: TrialRunner, angle_range: tuple[float, float], count: int) -> Screening:
    """Ranks pushes from the runner's pose towards its goal.

    Args:
        runner: pose, goal, outline and rules.
        angle_range: least and greatest angle from the inward normal, rad.
        count: how many are wanted.

    Returns:
        At most as many; fewer where the rules forbid the others, or they are near one another.
    """
    s, piece = runner.reach.spread(runner.reach.length / PLACES)
    angles = np.linspace(*angle_range, ANGLES)
    s, piece, angle = np.repeat(s, ANGLES), np.repeat(piece, ANGLES), np.tile(angles, len(s))
    normal = runner.reach.normal[piece]
    start = runner.reach.point(s, piece) + (runner.radius + runner.clearance) * normal
    c, w = np.cos(angle), np.sin(angle)
    direction = -np.column_stack([c * normal[:, 0] - w * normal[:, 1], w * normal[:, 0] + c * normal[:, 1]])
    keep = runner.checker.allows_finger(_to_world(start, runner.pose))
    s, piece, angle, start, direction = s[keep], piece[keep], angle[keep], start[keep], direction[keep]
    if not len(s):
        return Screening(s, piece, angle, np.empty(0))
    longest = runner.distance_range[1]
    poses = predict_roughly(runner.obj, runner.params, start, direction, longest, runner.radius)
    costs = _calc_rough_costs(runner, poses)

    def count_allowed(i: int) -> int:
        return _count_allowed(runner, poses[:, i], start[i], direction[i])

    chosen, cost = _pick_apart(runner, s, angle, costs, count_allowed, count)
    return Screening(s[chosen], piece[chosen], angle[chosen], cost)


def _calc_rough_costs(runner: TrialRunner, poses: Array) -> Array:
    """(steps, N) root mean square distance of the cells from the goal's: |dc|² + 2 (1 - cos dtheta) rho²."""
    centroid, rho = runner.obj.p_BC.mean(axis=0), runner.obj.radius_of_gyration
    x, y, theta = runner.pose
    goal = runner.goal
    at = _turned(centroid, poses[..., 2]) + poses[..., :2]
    world = np.array([x, y]) + _turn(at, theta)
    aim = goal[:2] + _turn(centroid, goal[2])
    turn = poses[..., 2] + theta - goal[2]
    return np.sqrt(((world - aim) ** 2).sum(axis=-1) + 2 * (1 - np.cos(turn)) * rho**2)


def _count_allowed(runner: TrialRunner, poses: Array, start: Array, direction: Array) -> int:
    """How many steps of a rough motion, poses (steps, 3) in the body's first frame, the rules allow."""
    steps = len(poses)
    if runner.checker.constraints.is_free:
        return steps
    travelled = runner.distance_range[1] * np.arange(1, steps + 1) / steps
    tip = _to_world(start + travelled[:, None] * direction, runner.pose)
    world = np.column_stack([_to_world(poses[:, :2], runner.pose), poses[:, 2] + runner.pose[2]])
    fine = runner.checker.allows_finger(tip) & runner.checker.allows_poses(world)
    return steps if fine.all() else int(np.argmin(fine))


def _pick_apart(
    runner: TrialRunner, s: Array, angle: Array, costs: Array, count_allowed: Callable[[int], int], count: int
) -> tuple[NDArray[np.int64], Array]:
    """The cheapest, each far from the cheaper ones.

    What a push costs as far as the rules allow it is at least what it costs without them, so that only those pushes are
    looked up whose turn comes.

    Args:
        runner: of the outline.
        s: (N,) arc lengths, m.
        angle: (N,) rad.
        costs: (steps, N) after each step, m.
        count_allowed: says how many of a push's steps are allowed.
        count: how many are wanted.

    Returns:
        Their indices and costs.
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


def _turned(p: Array, theta: Array) -> Array:
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([c * p[0] - s * p[1], s * p[0] + c * p[1]], axis=-1)


def _turn(p: Array, theta: float) -> Array:
    c, s = np.cos(theta), np.sin(theta)
    return p @ np.array([[c, s], [-s, c]])


def _to_world(p_BP: Array, pose: Array) -> Array:
    return pose[:2] + _turn(p_BP, pose[2])

"""Three ways to search for the push that comes nearest to a goal pose.

"gradient" minimizes f(s, phi) (see `trial`) by Levenberg-Marquardt steps

    (H + lambda diag H) dx = -grad C,   x = (s, phi, d),

from several starts. phi is the direction in the body frame: it is held while s runs across a vertex, and the angle from
the new edge's normal kept within its range. Starts are taken up best first: the one goes on whose step promises the
lowest cost, and the search ends when no start promises to do better than the best.

"finite_difference" is the paper's: from places spread along the outline it walks along it, and turns, by the sign of
finite differences, with steps that halve. "exhaustive" tries every place with every direction of a grid, and walks on
in the same manner from the best of its nodes: the yardstick.

`screen`: where a search should begin, places and directions ranked without a simulation.

All places along the reachable outline, with some directions each, are followed by the ellipsoidal limit surface
(`limit_surface`), and the best of them taken that are not near a better one.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.geometry.se2 import Array, compose, rotate, transform
from gridpush_drake.planning.contact.limit_surface import predict_roughly
from gridpush_drake.planning.contact.trial import Trial, TrialRunner

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


def screen(runner: TrialRunner) -> Screening:
    """Ranks pushes from the runner's pose towards its goal.

    Args:
        runner: pose, goal, outline, rules, and how many are wanted.

    Returns:
        At most as many as there are starts; fewer where the rules forbid the others, or they are near one another.
    """
    options = runner.options
    s, piece = runner.reach.spread(runner.reach.length / PLACES)
    angles = np.linspace(*options.angle_range, ANGLES)
    s, piece, angle = np.repeat(s, ANGLES), np.repeat(piece, ANGLES), np.tile(angles, len(s))
    normal = runner.reach.normal[piece]
    start = runner.reach.point(s, piece) + (options.radius + options.clearance) * normal
    direction = -rotate(angle, normal)
    keep = runner.checker.allows_finger(transform(runner.pose, start))
    s, piece, angle, start, direction = s[keep], piece[keep], angle[keep], start[keep], direction[keep]
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
    fine = runner.checker.allows_finger(tip) & runner.checker.allows_poses(compose(runner.pose, poses))
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


Search = Callable[[TrialRunner], list[Trial]]
"""From what simulates pushes to the trials found, best first."""

FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 0.03, 1e-3, 30.0
"""lambda at first, and between what it stays; above, a start has come to its end."""

LOOSEN, TIGHTEN = 0.3, 6.0
"""Factors of lambda after a step that helped and one that did not."""

MAX_STEP, MAX_TURN = 0.12, 0.5
"""Of a step: share of the perimeter, and rad."""

SAME_PLACE, SAME_TURN = 0.03, 0.2
"""Share of the perimeter and rad within which a start has run into a better one, and ends."""

GAIN_FACTOR = 2.0
"""How many times its next step's predicted gain a start may still improve."""

DIFFERENCE_PLACE, DIFFERENCE_TURN = 0.04, 0.25
"""First steps of the finite-difference walk: share of the perimeter, and rad."""

HALVINGS = 4
"""After so many the walk ends."""

REFINEMENTS = 6
"""Halvings of the exhaustive search's steps from the best nodes of its grid, half the grid's at first: of a long push a
millimeter along the outline may move the end by centimeters, which no grid resolves."""


@dataclass(eq=False)
class _Walk:
    """A start of the gradient search, and where it has come to."""

    trial: Trial
    damping: float = FIRST_DAMPING
    step: Array | None = None
    gain: float = 0.0

    @property
    def attainable_cost(self) -> float:
        return self.trial.cost - GAIN_FACTOR * self.gain


def search_by_gradient(runner: TrialRunner) -> list[Trial]:
    """Descends from screened starts; one trial a start, best first."""
    beginnings = screen(runner)
    walks, options = [], runner.options
    for s, piece, angle in zip(beginnings.arc_length, beginnings.piece, beginnings.angle, strict=True):
        walk = _Walk(runner.run(float(s), int(piece), float(angle), gradient=True))
        if np.isfinite(walk.trial.cost):
            _plan_step(walk, runner)
            walks.append(walk)
    while walks and runner.simulations < options.budget:
        best = min(walk.trial.cost for walk in walks)
        walk = min(walks, key=lambda walk: walk.attainable_cost if walk.step is not None else np.inf)
        if walk.step is None or walk.attainable_cost > best - options.min_improvement:
            break
        if any(_has_run_into(walk, other, runner) for other in walks):
            walk.step, walk.gain = None, 0.0
            continue
        _advance(walk, runner)
    return sorted((walk.trial for walk in walks), key=lambda trial: trial.cost)


def _has_run_into(walk: _Walk, other: _Walk, runner: TrialRunner) -> bool:
    """Whether another start is better, and near."""
    if other is walk or other.trial.cost > walk.trial.cost:
        return False
    gap = abs(walk.trial.arc_length - other.trial.arc_length)
    near = min(gap, runner.reach.perimeter - gap) < SAME_PLACE * runner.reach.perimeter
    return near and abs(walk.trial.angle - other.trial.angle) < SAME_TURN


def _plan_step(walk: _Walk, runner: TrialRunner) -> None:
    """Solves for the next step and what it is predicted to gain; none where it is not worth a simulation."""
    slope, H = walk.trial.slope, walk.trial.curvature
    assert slope is not None and H is not None
    free = np.ones(3, dtype=bool)
    low, high = runner.options.angle_range
    if (walk.trial.angle <= low and slope[1] > 0) or (walk.trial.angle >= high and slope[1] < 0):
        free[1] = False
    limit = np.array([MAX_STEP * runner.reach.perimeter, MAX_TURN, np.inf])
    while walk.damping <= MAX_DAMPING:
        damped = H + walk.damping * np.diag(np.maximum(np.diag(H), 1e-12))
        x = np.zeros(3)
        x[free] = np.linalg.solve(damped[np.ix_(free, free)], -slope[free])
        x *= min(1.0, float(np.min(limit / np.maximum(np.abs(x), 1e-12))))
        walk.step, walk.gain = x, float(-(slope @ x + x @ H @ x / 2))
        break
    if walk.damping > MAX_DAMPING or walk.gain * GAIN_FACTOR < runner.options.min_improvement:
        walk.step, walk.gain = None, 0.0


def _advance(walk: _Walk, runner: TrialRunner) -> None:
    """Tries the step; keeps it where it helps."""
    assert walk.step is not None
    s, piece, angle = move(runner, walk.trial, walk.step[0], walk.step[1])
    same_place = abs(s - walk.trial.arc_length) < 1e-6 and abs(angle - walk.trial.angle) < 1e-6
    trial = walk.trial if same_place else runner.run(s, piece, angle, gradient=True)
    if trial.cost < walk.trial.cost:
        walk.trial, walk.damping = trial, max(MIN_DAMPING, walk.damping * LOOSEN)
    else:
        walk.damping *= TIGHTEN
    _plan_step(walk, runner)


def move(runner: TrialRunner, trial: Trial, by: float, turn: float) -> tuple[float, int, float]:
    """Moves a trial along the outline and turns it, its direction held in the body frame.

    Args:
        runner: of the trial.
        trial: from which.
        by: m, counterclockwise.
        turn: rad.

    Returns:
        The nearest reachable arc length, m, its piece, and the angle from the normal there, rad.
    """
    places, pieces = runner.reach.find_nearest(trial.arc_length + by)
    piece = int(pieces)
    old, new = runner.reach.tangent[trial.piece], runner.reach.tangent[piece]
    bend = float(np.arctan2(old[0] * new[1] - old[1] * new[0], old @ new))
    return float(places), piece, float(np.clip(trial.angle + turn - bend, *runner.options.angle_range))


def search_by_differences(runner: TrialRunner) -> list[Trial]:
    """The paper's walk along the outline; one trial a start, best first."""
    options = runner.options
    spacing = runner.reach.perimeter / options.starts
    first = np.random.default_rng(options.seed).uniform(0, spacing)
    places, pieces = runner.reach.find_nearest(first + spacing * np.arange(options.starts))
    middle = float(np.mean(options.angle_range))
    trials = [runner.run(float(s), int(piece), middle) for s, piece in zip(places, pieces, strict=True)]
    trials = sorted((trial for trial in trials if np.isfinite(trial.cost)), key=lambda trial: trial.cost)
    first_step = DIFFERENCE_PLACE * runner.reach.perimeter
    for i, trial in enumerate(trials):
        trials[i] = _walk_along(runner, trial, first_step, DIFFERENCE_TURN, HALVINGS, options.budget)
    return sorted(trials, key=lambda trial: trial.cost)


def _walk_along(
    runner: TrialRunner, trial: Trial, place: float, turn: float, halvings: int, budget: float = np.inf
) -> Trial:
    """Walks to better neighbors, `place` (m) along the outline or `turn` (rad) away, with steps that halve."""
    for _ in range(halvings):
        moved = True
        while moved and runner.simulations < budget:
            moved = False
            for by, angle in ((place, 0.0), (-place, 0.0), (0.0, turn), (0.0, -turn)):
                if runner.simulations >= budget:
                    break
                other = runner.run(*move(runner, trial, by, angle))
                if other.cost < trial.cost:
                    trial, moved = other, True
                    break
        place, turn = place / 2, turn / 2
    return trial


def search_exhaustively(runner: TrialRunner) -> list[Trial]:
    """Every place with every direction of a grid, the best of them walked on between its nodes, best first."""
    options = runner.options
    spacing = runner.reach.length / options.places
    places, pieces = runner.reach.spread(spacing)
    angles = np.linspace(*options.angle_range, options.angles)
    trials = [
        runner.run(float(s), int(piece), float(angle))
        for s, piece in zip(places, pieces, strict=True)
        for angle in angles
    ]
    trials = sorted((trial for trial in trials if np.isfinite(trial.cost)), key=lambda trial: trial.cost)
    turn = float(np.ptp(angles)) / max(options.angles - 1, 1) / 2
    walked = [_walk_along(runner, trial, spacing / 2, turn, REFINEMENTS) for trial in trials[: options.refined]]
    trials[: options.refined] = walked
    return sorted(trials, key=lambda trial: trial.cost)


METHODS: dict[str, Search] = {
    "gradient": search_by_gradient,
    "finite_difference": search_by_differences,
    "exhaustive": search_exhaustively,
}
"""Names that `optimize_contact` takes."""

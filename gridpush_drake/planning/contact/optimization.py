"""Contact-point optimization: where on the outline, in which direction and how far to push.

The cost of a push is the mean distance of the cells' centers at its predicted end from where they
are at the goal pose (`docs/theory/planning.md`, section 1). There are three ways to search for the
cheapest.

"gradient" minimizes f(s, phi) (see `trial`) by Levenberg-Marquardt steps

    (H + lambda diag H) dx = -grad C,   x = (s, phi, d),

from several starts (`limit_surface.screen`). phi is the direction in the body frame: it is held
while s runs across a vertex, and the angle from the new edge's normal kept within its range. Starts
are taken up best first: the one goes on whose step promises the lowest cost, and the search ends
when no start promises to do better than the best.

"finite_difference" is the paper's: from places spread along the outline it walks along it, and
turns, by the sign of finite differences, with steps that halve. "exhaustive" tries every place with
every direction of a grid, and walks on in the same manner from the best of its nodes: the
yardstick.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from time import perf_counter
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.limit_surface import screen
from gridpush_drake.planning.contact.reachable_outline import find_reachable_outline
from gridpush_drake.planning.contact.trial import (
    ContactOptions,
    PlannedPush,
    Trial,
    TrialRunner,
    calc_goal_error,
)
from gridpush_drake.planning.push_constraints import PushConstraints

ContactMethod = Literal["gradient", "finite_difference", "exhaustive"]

REACH_FACTOR = 1.25
"""The longest push tried is this times the farthest that a cell has to go, unless the range ends
before."""


class ContactPlanStatus(StrEnum):
    """How a contact search ends."""

    OK = "ok"
    NO_IMPROVEMENT = "no_improvement"
    NO_REACHABLE_CONTACT = "no_reachable_contact"


@dataclass(frozen=True, eq=False)
class ContactPlan:
    """What a contact search found.

    Attributes:
        push: the best push; None where the finger reaches no place, or no push is allowed.
        candidates: what the search ended with from each of its starts (exhaustive: the best few),
            best first.
        start_cost: mean cell error before the push, m.
        method: of the search.
        simulations: simulated pushes; one with its Jacobian counts as one.
        seconds: wall-clock time.
        status: "ok"; "no_improvement" where the best allowed push leaves the object no nearer to
            the goal; "no_reachable_contact" where there is none.
    """

    push: PlannedPush | None
    candidates: tuple[PlannedPush, ...]
    start_cost: float
    method: str
    simulations: int
    seconds: float
    status: ContactPlanStatus

    @property
    def cost(self) -> float:
        """Mean cell error after the best push, or without one, m."""
        return self.start_cost if self.push is None else self.push.cost


MAX_CANDIDATES = 16


@threadpool_limits.wrap(limits=1, user_api="blas")
def optimize_contact(
    obj: GridObject,
    params: CellParameters,
    pose: ArrayLike,
    goal: ArrayLike,
    *,
    method: ContactMethod = "gradient",
    constraints: PushConstraints | None = None,
    options: ContactOptions | None = None,
) -> ContactPlan:
    """Chooses the push that brings an object nearest to a goal pose.

    Args:
        pose: (3,) q_W where it lies, m and rad.
        goal: (3,) where it should.
        method: "gradient", "finite_difference" (the paper's) or "exhaustive".
        constraints: table, obstacles and further rules; none by default.

    Raises:
        PlanningError: an argument is out of range, or the finger fits nowhere on the outline.
    """
    begin = perf_counter()
    if method not in METHODS:
        raise PlanningError(f"method is {method!r}; expected one of {', '.join(METHODS)}")
    options = options or ContactOptions()
    q, aim = (
        check_vector(PlanningError, "pose", pose, 3),
        check_vector(PlanningError, "goal", goal, 3),
    )
    runner = make_runner(obj, params, q, aim, constraints, options)
    trials = METHODS[method](runner)[:MAX_CANDIDATES]
    found = tuple(runner.finish(trial, runner.simulations) for trial in trials)
    start_cost = float(calc_goal_error(obj, q, aim))
    status = ContactPlanStatus.NO_REACHABLE_CONTACT
    if found:
        status = (
            ContactPlanStatus.OK if found[0].cost < start_cost else ContactPlanStatus.NO_IMPROVEMENT
        )
    return ContactPlan(
        found[0] if found else None,
        found,
        start_cost,
        method,
        runner.simulations,
        perf_counter() - begin,
        status,
    )


def make_runner(
    obj: GridObject, params: CellParameters, pose: Array, goal: Array, constraints: PushConstraints | None,
    options: ContactOptions,
) -> TrialRunner:  # fmt: skip
    """What simulates the pushes of a search, from a pose to a goal."""
    if params.n != obj.n:
        raise PlanningError(f"parameters of {params.n} cells; expected {obj.n}, as {obj.name} has")
    reach = find_reachable_outline(obj, options.radius, options.clearance)
    longest = float(np.linalg.norm(obj.cells_at(pose) - obj.cells_at(goal), axis=1).max())
    low, high = options.distance_range
    high = max(low, min(high, REACH_FACTOR * longest + options.clearance + low))
    checker = (constraints or PushConstraints()).start_at(obj, pose, options.radius)
    return TrialRunner(obj, params, pose, goal, reach, checker, options, (low, high))


Search = Callable[[TrialRunner], list[Trial]]
"""From what simulates pushes to the trials found, best first."""

FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 0.03, 1e-3, 30.0
"""lambda at first, and between what it stays; above, a start has come to its end."""

LOOSEN, TIGHTEN = 0.3, 6.0  # factors of lambda after a step that helped and one that did not
MAX_STEP, MAX_TURN = 0.12, 0.5  # of a step: share of the perimeter, and rad

SAME_PLACE, SAME_TURN = 0.03, 0.2
"""Share of the perimeter and rad within which a start has run into a better one, and ends."""

GAIN_FACTOR = 2.0  # how many times its next step's predicted gain a start may still improve

DIFFERENCE_PLACE, DIFFERENCE_TURN = 0.04, 0.25
"""First steps of the finite-difference walk: share of the perimeter, and rad."""

HALVINGS = 4  # after so many the walk ends

REFINEMENTS = 6
"""Halvings of the exhaustive search's steps from the best nodes of its grid, half the grid's at
first: of a long push a millimeter along the outline may move the end by centimeters, which no grid
resolves."""


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
    for s, piece, angle in zip(
        beginnings.arc_length, beginnings.piece, beginnings.angle, strict=True
    ):
        walk = _Walk(runner.run(float(s), int(piece), float(angle), gradient=True))
        if np.isfinite(walk.trial.cost):
            _plan_step(walk, runner)
            walks.append(walk)
    while walks and runner.simulations < options.budget:
        best = min(walk.trial.cost for walk in walks)
        walk = min(
            walks, key=lambda walk: walk.attainable_cost if walk.step is not None else np.inf
        )
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
    """Moves a trial by m along the outline, counterclockwise, and turns it by rad, its direction held in the body.

    Returns the nearest reachable arc length, m, its piece, and the angle from the normal there,
    rad.
    """
    places, pieces = runner.reach.find_nearest(trial.arc_length + by)
    piece = int(pieces)
    old, new = runner.reach.tangent[trial.piece], runner.reach.tangent[piece]
    bend = float(np.arctan2(old[0] * new[1] - old[1] * new[0], old @ new))
    return (
        float(places),
        piece,
        float(np.clip(trial.angle + turn - bend, *runner.options.angle_range)),
    )


def search_by_differences(runner: TrialRunner) -> list[Trial]:
    """The paper's walk along the outline; one trial a start, best first."""
    options = runner.options
    spacing = runner.reach.perimeter / options.starts
    first = np.random.default_rng(options.seed).uniform(0, spacing)
    places, pieces = runner.reach.find_nearest(first + spacing * np.arange(options.starts))
    middle = float(np.mean(options.angle_range))
    trials = [
        runner.run(float(s), int(piece), middle) for s, piece in zip(places, pieces, strict=True)
    ]
    trials = sorted(
        (trial for trial in trials if np.isfinite(trial.cost)), key=lambda trial: trial.cost
    )
    first_step = DIFFERENCE_PLACE * runner.reach.perimeter
    for i, trial in enumerate(trials):
        trials[i] = _walk_along(
            runner, trial, first_step, DIFFERENCE_TURN, HALVINGS, options.budget
        )
    return sorted(trials, key=lambda trial: trial.cost)


def _walk_along(
    runner: TrialRunner,
    trial: Trial,
    place: float,
    turn: float,
    halvings: int,
    budget: float = np.inf,
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
    trials = sorted(
        (trial for trial in trials if np.isfinite(trial.cost)), key=lambda trial: trial.cost
    )
    turn = float(np.ptp(angles)) / max(options.angles - 1, 1) / 2
    walked = [
        _walk_along(runner, trial, spacing / 2, turn, REFINEMENTS)
        for trial in trials[: options.refined]
    ]
    trials[: options.refined] = walked
    return sorted(trials, key=lambda trial: trial.cost)


METHODS: dict[str, Search] = {
    "gradient": search_by_gradient,
    "finite_difference": search_by_differences,
    "exhaustive": search_exhaustively,
}
"""Names that `optimize_contact` takes."""

"""Contact-point optimization: where on the outline, in which direction and how far to push.

The cost C of a push is the mean distance of the cells' centers at its predicted end from where they
are at the goal pose (`trial`, and `docs/theory/planning.md`, section 1). There are three methods to
search for the cheapest push.

"gradient" minimizes f(s, phi) by Levenberg-Marquardt steps

    (H + lambda diag H) dx = -dC/dx,   x = (s, phi, d),

from several starts (`limit_surface.screen`). phi is the direction in the body frame: it stays the
same while s runs across a vertex, as far as the angle from the new edge's normal is within its
range. It is always the start with the most promising next step that goes on, and the search ends
when no start promises to do better than the best has done.

"finite_difference" is the paper's method. From places spread along the outline it walks to better
neighbors, along the outline and turned, with steps that halve.

"exhaustive" tries every place with every direction of a grid, and walks on in the same manner from
the best of its nodes. It is slow, and what the other two are compared with.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from time import perf_counter
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.contact.contact_kernels import solve_damped_step
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
"""The longest push that is tried is this many times as long as the longest way that a cell has to
go, unless the range of distances ends before."""

MAX_CANDIDATES = 16
"""Greatest number of pushes that a search reports."""


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
        simulations: number of simulated pushes; one with its Jacobian counts as one.
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


@threadpool_limits.wrap(limits=1, user_api="blas")
def optimize_contact(
    model: Model,
    pose: ArrayLike,
    goal: ArrayLike,
    *,
    method: ContactMethod = "gradient",
    constraints: PushConstraints | None = None,
    options: ContactOptions | None = None,
) -> ContactPlan:
    """Chooses the push that brings an object nearest to a goal pose.

    Args:
        model: one object, with its parameters.
        pose: (3,) where it lies, X_WB, m and rad.
        goal: (3,) where it should, X_WB, m and rad.
        method: "gradient", "finite_difference" (the paper's) or "exhaustive". For a pusher that is
            no disc finite differences from the same starts take the place of the gradient.
        constraints: table, obstacles and further rules; none by default.
        options: what pushes may be chosen from, and how they are searched for.

    Raises:
        PlanningError: an argument is out of range, or the finger fits nowhere on the outline.
    """
    begin = perf_counter()
    if method not in SEARCH_METHODS:
        raise PlanningError(f"method is {method!r}; expected one of {', '.join(SEARCH_METHODS)}")
    options = options or ContactOptions()
    q = check_vector(PlanningError, "pose", pose, 3)
    aim = check_vector(PlanningError, "goal", goal, 3)
    runner = make_runner(model, q, aim, constraints, options)
    search = SEARCH_METHODS[method]
    if options.pusher.shape is not None and method == "gradient":
        method = "finite_difference"
        search = search_by_walks
    trials = search(runner)[:MAX_CANDIDATES]
    found = tuple(runner.finish(trial, runner.simulations) for trial in trials)
    start_cost = float(calc_goal_error(model.obj, q, aim))
    if not found:
        status = ContactPlanStatus.NO_REACHABLE_CONTACT
    elif found[0].cost < start_cost:
        status = ContactPlanStatus.OK
    else:
        status = ContactPlanStatus.NO_IMPROVEMENT
    return ContactPlan(
        push=found[0] if found else None,
        candidates=found,
        start_cost=start_cost,
        method=method,
        simulations=runner.simulations,
        seconds=perf_counter() - begin,
        status=status,
    )


def make_runner(
    model: Model,
    pose: Array,
    goal: Array,
    constraints: PushConstraints | None,
    options: ContactOptions,
) -> TrialRunner:
    """Makes what simulates the pushes of a search; arguments as of `optimize_contact`."""
    obj = model.obj
    radius = options.pusher.choose_radius(obj)
    reach = find_reachable_outline(obj, radius, options.pusher.clearance)
    longest = float(np.linalg.norm(obj.cells_at(pose) - obj.cells_at(goal), axis=1).max())
    least, greatest = options.distance_range
    greatest = max(least, min(greatest, REACH_FACTOR * longest + options.pusher.clearance + least))
    return TrialRunner(
        model=options.resolve(model),
        pose=pose,
        goal=goal,
        reach=reach,
        checker=(constraints or PushConstraints()).start_at(
            obj, pose, options.pusher.choose_reach(obj)
        ),
        options=options,
        distance_range=(least, greatest),
    )


Search = Callable[[TrialRunner], list[Trial]]
"""A method: takes what simulates pushes, and returns the trials that it found, best first."""

# Of the gradient search.

FIRST_DAMPING = 0.03
"""lambda of a start's first step."""

MIN_DAMPING = 1e-3
"""Least lambda, however many steps helped."""

MAX_DAMPING = 30.0
"""A start whose lambda becomes larger than this has come to its end."""

DAMPING_DECREASE = 0.3
"""lambda is multiplied by this after a step that helped."""

DAMPING_INCREASE = 6.0
"""lambda is multiplied by this after a step that did not help."""

MAX_STEP = 0.12
"""Greatest step along the outline, as a fraction of its perimeter."""

MAX_TURN = 0.5
"""Greatest step of the direction, rad."""

SAME_PLACE = 0.03
"""If a start comes as near as this to a better one, as a fraction of the perimeter, and as near as
`SAME_TURN` in direction, it ends."""

SAME_TURN = 0.2
"""Difference of direction below which two starts may be the same, rad; see `SAME_PLACE`."""

GAIN_FACTOR = 2.0
"""A start is taken to be able to improve by this many times the predicted gain of its next step."""

TINY_DIVISOR = 1e-12
"""Replaces a divisor or a diagonal element that may be zero."""

SAME_CONTACT = 1e-6
"""If neither the arc length, m, nor the angle, rad, changes by more than this, the step leads
nowhere new, and is not simulated."""

# Of the walks along the outline.

DIFFERENCE_PLACE = 0.04
"""First step of the finite-difference walk along the outline, as a fraction of its perimeter."""

DIFFERENCE_TURN = 0.25
"""First step of the finite-difference walk in direction, rad."""

WALK_BUDGET = 4
"""Simulations of the walks with a pusher that is no disc, as a multiple of the search's budget."""

MAX_HALVINGS = 4
"""Number of step sizes, each half the one before, after which the finite-difference walk ends."""

REFINEMENT_STEPS = 6
"""Number of step sizes with which the exhaustive search walks on from a node, the first half the
grid's spacing. With a long push, a millimeter along the outline may move the end by centimeters,
which no grid resolves."""


@dataclass(eq=False)
class _Walk:
    """A start of the gradient search, and where it has come to.

    Attributes:
        trial: the best trial so far.
        damping: lambda of the next step.
        step: (3,) dx, the next step in (s, phi, d); None where the walk has come to its end.
        gain: by how much the cost is predicted to fall in the next step, m.
    """

    trial: Trial
    damping: float = FIRST_DAMPING
    step: Array | None = None
    gain: float = 0.0

    @property
    def attainable_cost(self) -> float:
        """The lowest cost that the walk promises, m."""
        return self.trial.cost - GAIN_FACTOR * self.gain

    def end(self) -> None:
        """Takes no further step."""
        self.step = None
        self.gain = 0.0


def search_by_gradient(runner: TrialRunner) -> list[Trial]:
    """Descends from screened starts; returns one trial for each start, best first."""
    options = runner.options
    starts = screen(runner)
    walks: list[_Walk] = []
    for s, piece, angle in zip(starts.arc_length, starts.piece, starts.angle, strict=True):
        walk = _Walk(runner.run(float(s), int(piece), float(angle), gradient=True))
        if np.isfinite(walk.trial.cost):
            _plan_step(walk, runner)
            walks.append(walk)
    while walks and runner.simulations < options.budget:
        # The walk that promises most goes on, as long as it promises more than the best has got.
        lowest_cost = min(walk.trial.cost for walk in walks)
        walk = min(
            walks, key=lambda walk: walk.attainable_cost if walk.step is not None else np.inf
        )
        if walk.step is None or walk.attainable_cost > lowest_cost - options.min_improvement:
            break
        if any(_has_run_into(walk, other, runner) for other in walks):
            walk.end()
        else:
            _advance(walk, runner)
    return sorted((walk.trial for walk in walks), key=lambda trial: trial.cost)


def _has_run_into(walk: _Walk, other: _Walk, runner: TrialRunner) -> bool:
    """Whether another walk is at a better place, and near."""
    if other is walk or other.trial.cost > walk.trial.cost:
        return False
    gap = abs(walk.trial.arc_length - other.trial.arc_length)
    near = min(gap, runner.reach.perimeter - gap) < SAME_PLACE * runner.reach.perimeter
    return near and abs(walk.trial.angle - other.trial.angle) < SAME_TURN


def _plan_step(walk: _Walk, runner: TrialRunner) -> None:
    """Solves for the next step of a walk and its gain.

    The walk ends where the step is not worth a simulation.
    """
    slope = walk.trial.slope
    H = walk.trial.curvature
    assert slope is not None and H is not None
    if walk.damping > MAX_DAMPING:
        walk.end()
        return
    # An angle at the end of its range, beyond which the cost would fall, is no unknown.
    low, high = runner.options.angle_range
    angle = walk.trial.angle
    free = np.ones(3, dtype=bool)
    if (angle <= low and slope[1] > 0) or (angle >= high and slope[1] < 0):
        free[1] = False
    # (H + lambda diag H) dx = -dC/dx, shortened to what the model may be trusted for.
    dx = np.empty(3)
    walk.gain = solve_damped_step(
        H=H,
        slope=slope,
        damping=walk.damping,
        least=TINY_DIVISOR,
        free=free,
        limit=np.array([MAX_STEP * runner.reach.perimeter, MAX_TURN, np.inf]),
        dx=dx,
    )
    walk.step = dx
    if walk.gain * GAIN_FACTOR < runner.options.min_improvement:
        walk.end()


def _advance(walk: _Walk, runner: TrialRunner) -> None:
    """Tries the next step of a walk, keeps it where it helps, and plans the one after it."""
    assert walk.step is not None
    s, piece, angle = move(runner, walk.trial, walk.step[0], walk.step[1])
    trial = walk.trial
    moved = abs(s - trial.arc_length) >= SAME_CONTACT or abs(angle - trial.angle) >= SAME_CONTACT
    if moved:
        trial = runner.run(s, piece, angle, gradient=True, better_than=walk.trial.cost)
    if trial.cost < walk.trial.cost:
        walk.trial = trial
        walk.damping = max(MIN_DAMPING, walk.damping * DAMPING_DECREASE)
    else:
        walk.damping *= DAMPING_INCREASE
    _plan_step(walk, runner)


def move(runner: TrialRunner, trial: Trial, by: float, turn: float) -> tuple[float, int, float]:
    """Moves a trial along the outline and turns it, its direction held in the body frame.

    Args:
        runner: knows the outline.
        trial: the trial.
        by: how far to move along the outline, counterclockwise, m.
        turn: by how much to turn the direction, rad.

    Returns:
        The nearest reachable arc length, m, its piece, and the angle from the normal there, rad.
    """
    arc_length, piece_there = runner.reach.find_nearest(trial.arc_length + by)
    piece = int(piece_there)
    # The angle is from the normal, which turns with the edge.
    old = runner.reach.tangent[trial.piece]
    new = runner.reach.tangent[piece]
    bend = float(np.arctan2(old[0] * new[1] - old[1] * new[0], old @ new))
    angle = np.clip(trial.angle + turn - bend, *runner.options.angle_range)
    return float(arc_length), piece, float(angle)


def search_by_differences(runner: TrialRunner) -> list[Trial]:
    """Walks along the outline as the paper does; returns one trial for each start, best first."""
    options = runner.options
    # Starts are evenly spaced, straight pushes, the best of them first.
    spacing = runner.reach.perimeter / options.starts
    first = np.random.default_rng(options.seed).uniform(0, spacing)
    places, pieces = runner.reach.find_nearest(first + spacing * np.arange(options.starts))
    middle = float(np.mean(options.angle_range))
    trials = [
        runner.run(float(s), int(piece), middle) for s, piece in zip(places, pieces, strict=True)
    ]
    trials = _sort_allowed(trials)
    first_step = DIFFERENCE_PLACE * runner.reach.perimeter
    walked = [
        _walk_along(runner, trial, first_step, DIFFERENCE_TURN, MAX_HALVINGS, options.budget)
        for trial in trials
    ]
    return sorted(walked, key=lambda trial: trial.cost)


def search_by_walks(runner: TrialRunner) -> list[Trial]:
    """Walks from screened starts, for a pusher whose gradient by the place is not calculated.

    A disc in the middle of its front stands for the pusher where starts are screened. Returns one
    trial for each start, best first.
    """
    starts = screen(runner)
    ranked = zip(starts.arc_length, starts.piece, starts.angle, strict=True)
    trials = _sort_allowed([runner.run(float(s), int(p), float(angle)) for s, p, angle in ranked])
    first_step = DIFFERENCE_PLACE * runner.reach.perimeter
    budget = WALK_BUDGET * runner.options.budget
    for i, trial in enumerate(trials):
        trials[i] = _walk_along(runner, trial, first_step, DIFFERENCE_TURN, MAX_HALVINGS, budget)
    return sorted(trials, key=lambda trial: trial.cost)


def _sort_allowed(trials: Sequence[Trial]) -> list[Trial]:
    """The trials whose pushes are allowed, best first."""
    allowed = (trial for trial in trials if np.isfinite(trial.cost))
    return sorted(allowed, key=lambda trial: trial.cost)


def _walk_along(
    runner: TrialRunner,
    trial: Trial,
    place: float,
    turn: float,
    halvings: int,
    budget: float = np.inf,
) -> Trial:
    """Walks to better neighbors until there are none, then with steps half as long, and so on.

    Args:
        runner: simulates the pushes.
        trial: where the walk begins.
        place: first step along the outline, m.
        turn: first step of the direction, rad.
        halvings: number of step sizes.
        budget: number of the runner's simulations after which the walk ends.

    Returns:
        Where it ends.
    """
    for _ in range(halvings):
        moved = True
        while moved and runner.simulations < budget:
            moved = False
            for by, angle in ((place, 0.0), (-place, 0.0), (0.0, turn), (0.0, -turn)):
                if runner.simulations >= budget:
                    break
                neighbor = runner.run(*move(runner, trial, by, angle))
                if neighbor.cost < trial.cost:
                    trial = neighbor
                    moved = True
                    break
        place /= 2
        turn /= 2
    return trial


def search_exhaustively(runner: TrialRunner) -> list[Trial]:
    """Tries every place with every direction of a grid, and walks on from the best of its nodes.

    Returns a trial for each node, best first.
    """
    options = runner.options
    spacing = runner.reach.length / options.places
    places, pieces = runner.reach.spread(spacing)
    angles = np.linspace(*options.angle_range, options.angles)
    trials = [
        runner.run(float(s), int(piece), float(angle))
        for s, piece in zip(places, pieces, strict=True)
        for angle in angles
    ]
    trials = _sort_allowed(trials)
    # What lies between the nodes: the steps begin with half the grid's spacing.
    turn = float(np.ptp(angles)) / max(options.angles - 1, 1) / 2
    walked = [
        _walk_along(runner, trial, spacing / 2, turn, REFINEMENT_STEPS)
        for trial in trials[: options.refined]
    ]
    trials[: options.refined] = walked
    return sorted(trials, key=lambda trial: trial.cost)


SEARCH_METHODS: dict[str, Search] = {
    "gradient": search_by_gradient,
    "finite_difference": search_by_differences,
    "exhaustive": search_exhaustively,
}
"""The methods by the names that `optimize_contact` takes."""

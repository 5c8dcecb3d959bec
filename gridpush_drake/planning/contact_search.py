"""Three ways to search for the push that comes nearest to a goal pose.

"gradient" minimises f(s, phi) (see `push_trial`) by Levenberg-Marquardt steps

    (H + lambda diag H) dx = -grad C,   x = (s, phi, d),

from several starts. phi is the direction in the body frame: it is held while s runs across a vertex, and the angle from
the new edge's normal kept within its range. Starts are taken up best first: the one goes on whose step promises the
lowest cost, and the search ends when no start promises to do better than the best.

"finite_difference" is the paper's: from places spread along the outline it walks along it, and turns, by the sign of
finite differences, with steps that halve. "exhaustive" tries every place with every direction: the yardstick.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.planning.contact_screening import screen
from gridpush_drake.planning.push_trial import Trial, TrialRunner

Array = NDArray[np.float64]
Search = Callable[[TrialRunner, "SearchOptions"], list[Trial]]


@dataclass(frozen=True)
class SearchOptions:
    """How to search.

    Attributes:
        angle_range: least and greatest angle of the motion from the inward normal, rad.
        starts: of the gradient and the finite-difference search.
        budget: most simulations of the gradient and the finite-difference search.
        tolerance: improvement that is not worth a simulation, m.
        places: of the exhaustive search, along the outline.
        angles: of the exhaustive search, at each place.
        seed: of the finite-difference search's first place.
    """

    angle_range: tuple[float, float] = (-0.8, 0.8)
    starts: int = 12
    budget: int = 44
    tolerance: float = 2e-4
    places: int = 60
    angles: int = 7
    seed: int = 0


FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 0.03, 1e-3, 30.0
"""lambda at first, and between what it stays; above, a start has come to its end."""

LOOSEN, TIGHTEN = 0.3, 6.0
"""Factors of lambda after a step that helped and one that did not."""

LONGEST_STEP, LONGEST_TURN = 0.12, 0.5
"""Of a step: share of the perimeter, and rad."""

SAME_PLACE, SAME_TURN = 0.03, 0.2
"""Share of the perimeter and rad within which a start has run into a better one, and ends."""

HOPE = 2.0
"""How many times its next step's promise a start may still improve."""

DIFFERENCE_PLACE, DIFFERENCE_TURN = 0.04, 0.25
"""First steps of the finite-difference walk: share of the perimeter, and rad."""

HALVINGS = 4
"""After so many the walk ends."""


@dataclass(eq=False)
class _Walk:
    """A start of the gradient search, and where it has come to."""

    trial: Trial
    damping: float = FIRST_DAMPING
    step: Array | None = None
    promise: float = 0.0

    @property
    def hoped_cost(self) -> float:
        return self.trial.cost - HOPE * self.promise


def search_by_gradient(runner: TrialRunner, options: SearchOptions) -> list[Trial]:
    """Descends from screened starts; one trial a start, best first."""
    beginnings = screen(runner, options.angle_range, options.starts)
    walks = []
    for s, piece, angle in zip(beginnings.arc_length, beginnings.piece, beginnings.angle, strict=True):
        walk = _Walk(runner.run(float(s), int(piece), float(angle), gradient=True))
        if np.isfinite(walk.trial.cost):
            _plan_step(walk, runner, options)
            walks.append(walk)
    while walks and runner.simulations < options.budget:
        best = min(walk.trial.cost for walk in walks)
        walk = min(walks, key=lambda walk: walk.hoped_cost if walk.step is not None else np.inf)
        if walk.step is None or walk.hoped_cost > best - options.tolerance:
            break
        if any(_has_run_into(walk, other, runner) for other in walks):
            walk.step, walk.promise = None, 0.0
            continue
        _advance(walk, runner, options)
    return sorted((walk.trial for walk in walks), key=lambda trial: trial.cost)


def _has_run_into(walk: _Walk, other: _Walk, runner: TrialRunner) -> bool:
    """Whether another start is better, and near."""
    if other is walk or other.trial.cost > walk.trial.cost:
        return False
    gap = abs(walk.trial.arc_length - other.trial.arc_length)
    near = min(gap, runner.reach.perimeter - gap) < SAME_PLACE * runner.reach.perimeter
    return near and abs(walk.trial.angle - other.trial.angle) < SAME_TURN


def _plan_step(walk: _Walk, runner: TrialRunner, options: SearchOptions) -> None:
    """Solves for the next step and what it promises; none where it is not worth a simulation."""
    slope, H = walk.trial.slope, walk.trial.curvature
    assert slope is not None and H is not None
    free = np.ones(3, dtype=bool)
    low, high = options.angle_range
    if (walk.trial.angle <= low and slope[1] > 0) or (walk.trial.angle >= high and slope[1] < 0):
        free[1] = False
    limit = np.array([LONGEST_STEP * runner.reach.perimeter, LONGEST_TURN, np.inf])
    while walk.damping <= MOST_DAMPING:
        damped = H + walk.damping * np.diag(np.maximum(np.diag(H), 1e-12))
        x = np.zeros(3)
        x[free] = np.linalg.solve(damped[np.ix_(free, free)], -slope[free])
        x *= min(1.0, float(np.min(limit / np.maximum(np.abs(x), 1e-12))))
        walk.step, walk.promise = x, float(-(slope @ x + x @ H @ x / 2))
        break
    if walk.damping > MOST_DAMPING or walk.promise * HOPE < options.tolerance:
        walk.step, walk.promise = None, 0.0


def _advance(walk: _Walk, runner: TrialRunner, options: SearchOptions) -> None:
    """Tries the step; keeps it where it helps."""
    assert walk.step is not None
    s, piece, angle = move(runner, walk.trial, walk.step[0], walk.step[1], options.angle_range)
    same_place = abs(s - walk.trial.arc_length) < 1e-6 and abs(angle - walk.trial.angle) < 1e-6
    trial = walk.trial if same_place else runner.run(s, piece, angle, gradient=True)
    if trial.cost < walk.trial.cost:
        walk.trial, walk.damping = trial, max(LEAST_DAMPING, walk.damping * LOOSEN)
    else:
        walk.damping *= TIGHTEN
    _plan_step(walk, runner, options)


def move(
    runner: TrialRunner, trial: Trial, by: float, turn: float, angle_range: tuple[float, float]
) -> tuple[float, int, float]:
    """Moves a trial along the outline and turns it, its direction held in the body frame.

    Args:
        runner: of the trial.
        trial: from which.
        by: m, counterclockwise.
        turn: rad.
        angle_range: what the new angle is kept within, rad.

    Returns:
        The nearest reachable arc length, m, its piece, and the angle from the normal there, rad.
    """
    places, pieces = runner.reach.find_nearest(trial.arc_length + by)
    piece = int(pieces)
    old, new = runner.reach.tangent[trial.piece], runner.reach.tangent[piece]
    bend = float(np.arctan2(old[0] * new[1] - old[1] * new[0], old @ new))
    return float(places), piece, float(np.clip(trial.angle + turn - bend, *angle_range))


def search_by_differences(runner: TrialRunner, options: SearchOptions) -> list[Trial]:
    """The paper's walk along the outline; one trial a start, best first."""
    spacing = runner.reach.perimeter / options.starts
    first = np.random.default_rng(options.seed).uniform(0, spacing)
    places, pieces = runner.reach.find_nearest(first + spacing * np.arange(options.starts))
    middle = float(np.mean(options.angle_range))
    trials = [runner.run(float(s), int(piece), middle) for s, piece in zip(places, pieces, strict=True)]
    trials = sorted((trial for trial in trials if np.isfinite(trial.cost)), key=lambda trial: trial.cost)
    for i, trial in enumerate(trials):
        trials[i] = _walk_along(runner, options, trial)
    return sorted(trials, key=lambda trial: trial.cost)


def _walk_along(runner: TrialRunner, options: SearchOptions, trial: Trial) -> Trial:
    place, turn = DIFFERENCE_PLACE * runner.reach.perimeter, DIFFERENCE_TURN
    for _ in range(HALVINGS):
        moved = True
        while moved and runner.simulations < options.budget:
            moved = False
            for by, angle in ((place, 0.0), (-place, 0.0), (0.0, turn), (0.0, -turn)):
                if runner.simulations >= options.budget:
                    break
                other = runner.run(*move(runner, trial, by, angle, options.angle_range))
                if other.cost < trial.cost:
                    trial, moved = other, True
                    break
        place, turn = place / 2, turn / 2
    return trial


def search_exhaustively(runner: TrialRunner, options: SearchOptions) -> list[Trial]:
    """Every place with every direction, best first."""
    places, pieces = runner.reach.spread(runner.reach.length / options.places)
    angles = np.linspace(*options.angle_range, options.angles)
    trials = [
        runner.run(float(s), int(piece), float(angle))
        for s, piece in zip(places, pieces, strict=True)
        for angle in angles
    ]
    return sorted((trial for trial in trials if np.isfinite(trial.cost)), key=lambda trial: trial.cost)


METHODS: dict[str, Search] = {
    "gradient": search_by_gradient,
    "finite_difference": search_by_differences,
    "exhaustive": search_exhaustively,
}
"""Names that `optimise_contact` takes."""

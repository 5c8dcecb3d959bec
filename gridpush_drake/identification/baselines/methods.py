"""The methods that the paper compares with (its section VI.C), behind one interface (`search.SearchMethod`).

All begin at the start, then differ. They see nothing but the loss, at one simulation of every training push a value.

The searches that `identify` knows by name: the paper's descent and the baselines it was compared with.
"""

from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from gridpush_drake.identification.baselines.paper import search_paper
from gridpush_drake.identification.baselines.search import STATUS_STALLED, Search, SearchMethod, search_method

Array = NDArray[np.float64]

FIRST_STD = 0.5
"""Weighted sampling: standard deviation after the uniform round, as a share of the bounds' width (the paper's)."""

LAST_STD = 0.02
"""And the one it shrinks to, geometrically, as the budget is spent."""

UNIFORM_ROUND = 10
"""Weighted sampling: uniform draws at the beginning."""

DIFFERENCE = 0.02
"""Finite differences: length of a forward difference, as a share of the bounds' width."""

DIFFERENCE_STEP = 0.25
"""Finite differences: first step along a coordinate; each sweep over all of them halves it."""

MIN_STEP = 1e-3
"""Finite differences: the search has stalled when the step is below."""

CMA_STD = 0.25
"""CMA-ES: initial standard deviation, as a share of the bounds' width."""

SIMPLEX_STEP = 0.25
"""Nelder-Mead: edge of the initial simplex, as a share of the bounds' width."""


@search_method
def search_random(search: Search) -> str:
    """Random search: log-uniform draws within the bounds; the best is kept."""
    search(search.start, "start")
    while True:
        search(search.rng.random(len(search.start)), "random")


@search_method
def search_weighted(search: Search) -> str:
    """Weighted sampling: uniform draws first, then normal ones around the best so far, with a shrinking deviation."""
    best, lowest = search.start, search(search.start, "start")
    for draw in count():
        if draw < UNIFORM_ROUND:
            u, stage = search.rng.random(len(best)), "uniform"
        else:
            std = FIRST_STD * (LAST_STD / FIRST_STD) ** search.loss.spent
            u, stage = _draw_truncated_normal(search.rng, best, std), "normal"
        value = search(u, stage)
        if value < lowest:
            best, lowest = u, value
    raise AssertionError


@search_method
def search_finite_difference(search: Search) -> str:
    """Coordinate descent by forward differences, each coordinate updated at once; two evaluations a coordinate."""
    u, lowest = search.start.copy(), search(search.start, "start")
    step = DIFFERENCE_STEP
    while step > MIN_STEP:
        for j in search.rng.permutation(len(u)):
            ahead = DIFFERENCE if u[j] + DIFFERENCE <= 1 else -DIFFERENCE
            slope = (search(_moved(u, j, ahead), "difference") - lowest) / ahead
            if slope == 0:
                continue
            trial = _moved(u, j, -step * np.sign(slope))
            value = search(trial, "coordinate step")
            if value < lowest:
                u, lowest = trial, value
        step /= 2
    return STATUS_STALLED


@search_method
def search_cma_es(search: Search) -> str:
    """CMA-ES, by the package `cma`."""
    import cma  # imported here, as it takes half a second and few want it

    search(search.start, "start")
    options: dict[str, Any] = {
        "bounds": [0, 1],
        "randn": lambda *shape: search.rng.standard_normal(shape),
        "seed": np.nan,  # leaves NumPy's global generator alone
        "verbose": -9,
        "verb_log": 0,
    }
    strategy = cma.CMAEvolutionStrategy(search.start, CMA_STD, options)
    while not strategy.stop():
        population = strategy.ask()
        strategy.tell(population, [search(np.asarray(u), "generation") for u in population])
    return STATUS_STALLED


@search_method
def search_nelder_mead(search: Search) -> str:
    """Nelder-Mead, by SciPy, with coefficients adapted to the number of dimensions."""
    from scipy.optimize import minimize

    d = len(search.start)
    inward = np.where(search.start + SIMPLEX_STEP <= 1, SIMPLEX_STEP, -SIMPLEX_STEP)
    simplex = np.vstack([search.start, search.start + np.diag(inward)])
    budget = search.loss.budget
    minimize(
        lambda u: search(u, "simplex"), search.start, method="Nelder-Mead", bounds=[(0, 1)] * d,
        options={"initial_simplex": simplex, "adaptive": True, "maxiter": budget, "maxfev": budget},
    )  # fmt: skip
    return STATUS_STALLED


def _draw_truncated_normal(rng: np.random.Generator, mean: Array, std: float) -> Array:
    """Normal numbers around `mean`, within 0 and 1, by the inverse of their distribution."""
    low, high = ndtr((0 - mean) / std), ndtr((1 - mean) / std)
    return np.clip(mean + std * ndtri(low + (high - low) * rng.random(len(mean))), 0, 1)


def _moved(u: Array, j: int, by: float) -> Array:
    moved = u.copy()
    moved[j] = np.clip(moved[j] + by, 0, 1)
    return moved


SEARCH_METHODS: dict[str, SearchMethod] = {
    "paper": search_paper,
    "random_search": search_random,
    "weighted_sampling": search_weighted,
    "finite_difference": search_finite_difference,
    "cma_es": search_cma_es,
    "nelder_mead": search_nelder_mead,
}
"""By name."""

DEFAULT_BUDGET_PER_PUSH = 100
"""Simulations of each training push where no budget is given."""

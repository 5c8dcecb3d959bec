"""The methods that the paper compares with (section VI.C), and the registry of all searches.

All begin at the start, then differ. They see nothing but the loss, at one simulation of every
training push a value. Lengths are fractions of the bounds' width, in the logarithm.
"""

from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.baselines.paper import PaperDescent
from gridpush_drake.identification.baselines.search import LossSearch, SearchMethod, SearchStatus


@dataclass(frozen=True)
class RandomSearch:
    """Random search: log-uniform draws within the bounds; the best is kept."""

    physics: Physics | None = None

    def run(self, search: LossSearch) -> SearchStatus:
        """Draws until the budget is spent."""
        search(search.start, "start")
        while True:
            search(search.rng.random(len(search.start)), "random")


@dataclass(frozen=True)
class WeightedSampling:
    """Weighted sampling: uniform draws first, then normal ones around the best so far.

    Attributes:
        uniform_round: number of uniform draws at the beginning.
        first_std: standard deviation of the first normal draw (the paper's).
        last_std: standard deviation to which it shrinks, geometrically, as the budget is spent.
        physics: see `SearchMethod`.
    """

    uniform_round: int = 10
    first_std: float = 0.5
    last_std: float = 0.02
    physics: Physics | None = None

    def run(self, search: LossSearch) -> SearchStatus:
        """Draws until the budget is spent."""
        best = search.start
        lowest = search(best, "start")
        for draw in count():
            if draw < self.uniform_round:
                u = search.rng.random(len(best))
                stage = "uniform"
            else:
                std = self.first_std * (self.last_std / self.first_std) ** search.loss.spent
                u = _draw_truncated_normal(search.rng, best, std)
                stage = "normal"
            value = search(u, stage)
            if value < lowest:
                best = u
                lowest = value
        raise AssertionError


@dataclass(frozen=True)
class FiniteDifference:
    """Coordinate descent by forward differences; each coordinate takes two evaluations.

    Attributes:
        difference: length of a forward difference.
        first_step: first step along a coordinate; each sweep over all of them halves it.
        min_step: step below which the search has stalled.
        physics: see `SearchMethod`.
    """

    difference: float = 0.02
    first_step: float = 0.25
    min_step: float = 1e-3
    physics: Physics | None = None

    def run(self, search: LossSearch) -> SearchStatus:
        """Sweeps over the coordinates in random order."""
        u = search.start.copy()
        lowest = search(search.start, "start")
        step = self.first_step
        while step > self.min_step:
            for j in search.rng.permutation(len(u)):
                ahead = self.difference if u[j] + self.difference <= 1 else -self.difference
                slope = (search(_moved(u, j, ahead), "difference") - lowest) / ahead
                if slope == 0:
                    continue
                trial = _moved(u, j, -step * np.sign(slope))
                value = search(trial, "coordinate step")
                if value < lowest:
                    u = trial
                    lowest = value
            step /= 2
        return SearchStatus.STALLED


@dataclass(frozen=True)
class CmaEs:
    """CMA-ES, by the package `cma`, which `pip install '.[baselines]'` installs.

    Attributes:
        std: the initial standard deviation.
        physics: see `SearchMethod`.
    """

    std: float = 0.25
    physics: Physics | None = None

    def run(self, search: LossSearch) -> SearchStatus:
        """Breeds generations until the strategy stops."""
        cma = import_extra("cma", "baselines")

        search(search.start, "start")
        options: dict[str, Any] = {
            "bounds": [0, 1],
            "randn": lambda *shape: search.rng.standard_normal(shape),
            "seed": np.nan,  # leaves NumPy's global generator alone
            "verbose": -9,
            "verb_log": 0,
        }
        strategy = cma.CMAEvolutionStrategy(search.start, self.std, options)
        while not strategy.stop():
            population = strategy.ask()
            strategy.tell(population, [search(np.asarray(u), "generation") for u in population])
        return SearchStatus.STALLED


@dataclass(frozen=True)
class NelderMead:
    """Nelder-Mead, by SciPy, with coefficients adapted to the number of dimensions.

    Attributes:
        edge: length of the initial simplex's edges.
        physics: see `SearchMethod`.
    """

    edge: float = 0.25
    physics: Physics | None = None

    def run(self, search: LossSearch) -> SearchStatus:
        """Moves the simplex until SciPy stops."""
        from scipy.optimize import minimize  # only where it is used: it takes long to import

        inward = np.where(search.start + self.edge <= 1, self.edge, -self.edge)
        simplex = np.vstack([search.start, search.start + np.diag(inward)])
        budget = search.loss.budget
        minimize(
            lambda u: search(u, "simplex"),
            search.start,
            method="Nelder-Mead",
            bounds=[(0, 1)] * len(search.start),
            options={
                "initial_simplex": simplex,
                "adaptive": True,
                "maxiter": budget,
                "maxfev": budget,
            },
        )
        return SearchStatus.STALLED


SEARCH_METHODS: dict[str, SearchMethod] = {
    "paper": PaperDescent(),
    "random_search": RandomSearch(),
    "weighted_sampling": WeightedSampling(),
    "finite_difference": FiniteDifference(),
    "cma_es": CmaEs(),
    "nelder_mead": NelderMead(),
}
"""Searches by the name that `identify` takes."""


def _draw_truncated_normal(rng: np.random.Generator, mean: Array, std: float) -> Array:
    """Draws normal numbers (d,) around a mean (d,), within 0 and 1.

    A uniform number between the distribution's values at 0 and 1 is put into its inverse.
    """
    low = ndtr((0 - mean) / std)
    high = ndtr((1 - mean) / std)
    between = low + (high - low) * rng.random(len(mean))
    return np.clip(mean + std * ndtri(between), 0, 1)


def _moved(u: Array, j: int, by: float) -> Array:
    """Moves coordinate j of a point (d,), within the cube."""
    moved = u.copy()
    moved[j] = np.clip(moved[j] + by, 0, 1)
    return moved

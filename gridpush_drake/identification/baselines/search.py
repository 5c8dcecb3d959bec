"""What every search shares: bounds, the loss that it lowers, its budget, and its result.

A method (`SearchMethod`) works on a `LossSearch`: a loss over points u of the unit cube, one
coordinate for each free mass and friction, logarithmic between its bounds. `run_search` runs a
method on a log.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Protocol

import numpy as np

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.motion import Motion
from gridpush_drake.dynamics.physics import DEFAULT_PHYSICS, Physics
from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.identification.result import HistoryEntry, Progress
from gridpush_drake.identification.statistics.problem import TimedPush, resolve_physics
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

MASS_SPREAD = 50.0
"""Ratio of the largest to the smallest cell mass where nothing else is known: the paper's 5.0 kg to
0.1 kg."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of every cell's parameters; equal numbers hold a parameter where it is.

    Attributes:
        mass: smallest and largest mass of a cell, kg.
        friction: smallest and largest friction coefficient of a cell against the support.

    Raises:
        IdentificationError: a range is not positive and increasing.
    """

    mass: tuple[float, float]
    friction: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("mass", "friction"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise IdentificationError(
                    f"bounds.{name} is {(low, high)!r}; expected 0 < least <= greatest"
                )

    @classmethod
    def around(cls, obj: GridObject, start: CellParameters) -> "Bounds":
        """Makes bounds about a start, in the middle of masses that differ by `MASS_SPREAD`.

        Frictions are within the object's own bounds.
        """
        mean = start.total_mass / start.n
        factor = MASS_SPREAD**0.5
        return cls(
            mass=(mean / factor, mean * factor),
            friction=(obj.prior.friction_min, obj.prior.friction_max),
        )

    def clip(self, params: CellParameters) -> CellParameters:
        """Takes the nearest parameters within the bounds."""
        mass = np.clip(params.mass, *self.mass)
        friction = np.clip(params.friction, *self.friction)
        return replace(params, mass=mass, friction=friction)


LOSS_THRESHOLD = 1e-4
"""Mean cell error of the training pushes below which a search is done, m."""


class SearchStatus(StrEnum):
    """How a search ended."""

    CONVERGED = "converged"
    """The loss is below LOSS_THRESHOLD."""
    STALLED = "stalled"
    """No step helps any more."""
    BUDGET_SPENT = "budget_spent"


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search found.

    Attributes:
        params: the parameters of the lowest loss.
        history: the lowest loss so far, after each evaluation.
        simulations: pushes simulated.
        status: how it ended.
    """

    params: CellParameters
    history: tuple[HistoryEntry, ...]
    simulations: int
    status: SearchStatus


class SearchStopped(Exception):  # noqa: N818
    """The search is over: converged, or the budget is spent.

    It is a signal from the loss to whoever runs the search, and no error.
    """

    def __init__(self, status: SearchStatus) -> None:
        super().__init__(status)
        self.status = status


class CellLoss:
    """The loss of a search: the mean over pushes of the mean cell error (ADD), m.

    A push's mean cell error is the mean distance between predicted and observed cells over the
    observed times. The loss counts the pushes it simulates, keeps the best parameters and the
    history, and ends the search by `SearchStopped`.

    Attributes:
        simulations: number of pushes simulated so far.
        best: the parameters of the lowest loss.
        best_loss: the lowest loss, m.
        history: the lowest loss so far, after each evaluation.
    """

    def __init__(
        self,
        obj: GridObject,
        log: PushLog,
        start: CellParameters,
        *,
        budget: int,
        physics: Physics | None = None,
        progress: Progress | None = None,
        threshold: float = LOSS_THRESHOLD,
    ) -> None:
        """Prepares the log; nothing is simulated yet. The arguments are those of `run_search`."""
        if not len(log) or budget < len(log):
            raise IdentificationError(
                f"budget is {budget} simulations for {len(log)} pushes; expected enough to "
                "simulate each push once"
            )
        self.obj = obj
        self.budget = budget
        self.physics = resolve_physics(physics or DEFAULT_PHYSICS, obj, log)
        self.simulations = 0
        self.best = start
        self.best_loss = np.inf
        self.history: list[HistoryEntry] = []
        self._progress = progress
        self._threshold = threshold
        self._pushes = [TimedPush.of(seen, self.physics.regime) for seen in log]
        self._cells = [_observed_cells(obj, seen) for seen in log]

    def __len__(self) -> int:
        """Number of pushes: what an evaluation costs."""
        return len(self._pushes)

    @property
    def spent(self) -> float:
        """Fraction of the budget that is spent, 0 to 1."""
        return self.simulations / self.budget

    def __call__(self, params: CellParameters, stage: str) -> float:
        """Evaluates the loss, m. Raises SearchStopped once the search is over."""
        return self.evaluate(params, stage)[0]

    def evaluate(
        self, params: CellParameters, stage: str, **options: Any
    ) -> tuple[float, list[Motion]]:
        """Evaluates the loss, m, and hands out the simulations.

        Args:
            params: where.
            stage: what the search is doing, for the history.
            options: of `simulate`, besides its physics.

        Returns:
            The loss, and the pushes' simulations.

        Raises:
            SearchStopped: another evaluation would exceed the budget, or this one is below the
                threshold.
        """
        if self.simulations + len(self) > self.budget:
            raise SearchStopped(SearchStatus.BUDGET_SPENT)
        simulations = [
            push.simulate(Bodies(self.obj, params, self.physics), **options)
            for push in self._pushes
        ]
        self.simulations += len(self)
        errors = [np.linalg.norm(miss, axis=-1).mean() for miss in self.misses(simulations)]
        loss = float(np.mean(errors))
        loss = loss if np.isfinite(loss) else np.inf
        if loss < self.best_loss:
            self.best = params
            self.best_loss = loss
        self._record(stage)
        return loss, simulations

    def misses(self, simulations: list[Motion]) -> list[Array]:
        """Calculates predicted minus observed cell centers (K, n, 2), m, of each push."""
        return [
            self.obj.cells_at(simulation.poses[rows]) - cells
            for simulation, rows, cells in zip(simulations, self.rows, self._cells, strict=True)
        ]

    @property
    def rows(self) -> list[IntArray]:
        """The places (K,) of the observed poses among the simulated ones, for each push."""
        return [push.rows for push in self._pushes]

    def _record(self, stage: str) -> None:
        self.history.append(HistoryEntry(self.simulations, self.best_loss, stage))
        if self._progress:
            self._progress(self.history[-1])
        if self.best_loss < self._threshold:
            raise SearchStopped(SearchStatus.CONVERGED)


class LossSearch:
    """The loss on the unit cube, and a seeded generator: what a method works with.

    Attributes:
        loss: the loss of parameters.
        bounds: bounds of the parameters.
        first: the start's parameters, within the bounds.
        start: (d,) coordinates of `first`.
        rng: a seeded generator.
    """

    def __init__(self, loss: CellLoss, start: CellParameters, bounds: Bounds, seed: int) -> None:
        """Sets the cube up; parameters whose bounds are equal have no coordinate."""
        self.loss = loss
        self.bounds = bounds
        self.rng = np.random.default_rng(seed)
        self.first = bounds.clip(start)
        n = start.n
        ranges = np.log([bounds.mass] * n + [bounds.friction] * n)
        self._low = ranges[:, 0]
        self._width = np.diff(ranges, axis=1)[:, 0]
        self._free = self._width > 0
        values = np.log(np.concatenate([self.first.mass, self.first.friction]))
        fractions = (values - self._low)[self._free] / self._width[self._free]
        self.start: Array = fractions.clip(0, 1)

    def __call__(self, u: Array, stage: str) -> float:
        """Evaluates the loss, m, at u (d,), or at the nearest point of the cube."""
        return self.loss(self.params(u), stage)

    def params(self, u: Array) -> CellParameters:
        """Makes the parameters at u (d,), or at the nearest point of the cube."""
        n = self.first.n
        values = np.concatenate([self.first.mass, self.first.friction])
        low = self._low[self._free]
        width = self._width[self._free]
        values[self._free] = np.exp(low + width * np.clip(u, 0, 1))
        return replace(self.first, mass=values[:n], friction=values[n:])


class SearchMethod(Protocol):
    """A search method.

    Attributes:
        physics: physics of the model that it descends; None for the one that is asked for.
    """

    @property
    def physics(self) -> Physics | None:
        """The physics of the model that it descends; None for the one that is asked for."""
        ...

    def run(self, search: LossSearch) -> SearchStatus:
        """Searches until no step helps any more, or until `SearchStopped`."""
        ...


def run_search(
    method: SearchMethod,
    obj: GridObject,
    log: PushLog,
    start: CellParameters,
    bounds: Bounds,
    *,
    budget: int,
    seed: int = 0,
    physics: Physics | None = None,
    progress: Progress | None = None,
) -> SearchResult:
    """Runs a method to its end and collects what the loss saw.

    Args:
        method: the method.
        obj: the object.
        log: the training pushes, each with at least one later observation.
        start: where to begin; its contact friction is kept.
        bounds: what the cells' parameters lie between.
        budget: most pushes to simulate.
        seed: seed of everything random; the same seed gives the same result.
        physics: physics of the simulations, where the method has none of its own; `Physics()` by
            default. The regime "auto" becomes the one of the log's fastest push.
        progress: called after each evaluation.

    Returns:
        The result; its loss is never above the start's.

    Raises:
        IdentificationError: the budget does not reach for one simulation of each push, or a push
            has no observation to compare with.
    """
    loss = CellLoss(
        obj, log, start, budget=budget, physics=method.physics or physics, progress=progress
    )
    try:
        status = method.run(LossSearch(loss, start, bounds, seed))
    except SearchStopped as stop:
        status = stop.status
    return SearchResult(
        params=loss.best,
        history=tuple(loss.history),
        simulations=loss.simulations,
        status=status,
    )


def _observed_cells(obj: GridObject, seen: ObservedPush) -> Array:
    """Places the cells (K, n, 2), m, at the observed poses of a push, of which it needs one."""
    if not len(seen.poses_observed):
        raise IdentificationError(
            f"push {seen.name!r}: has no observation after its first; expected at least one"
        )
    return obj.cells_at(seen.poses_observed)

"""How far an identification has come."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.identification.default import STAGE_CHECKING
from gridpush_drake.identification.problem import PushProblem
from gridpush_drake.identification.result import HistoryEntry

Array = NDArray[np.float64]


class Tracker:
    """Keeps the best loss so far, and tells whoever wants to know."""

    def __init__(self, problem: PushProblem, progress: Callable[[HistoryEntry], None] | None) -> None:
        """Begins at nothing simulated."""
        self.problem, self.progress = problem, progress
        self.history: list[HistoryEntry] = []

    @property
    def simulations(self) -> int:
        """Pushes simulated, by the problem or by a search of its own."""
        searched = self.history[-1].simulations if self.history else 0
        return max(searched, self.problem.simulations)

    def report(self, z: Array, stage: str) -> None:
        """Notes where a fit is; while checking, z was fitted to some pushes only and its loss does not count."""
        best = self.history[-1].loss if self.history else np.inf
        if stage != STAGE_CHECKING:
            spent = self.problem.simulations
            best = min(best, float(self.problem.calc_cell_errors(self.problem.residuals(z)).mean()))
            self.problem.simulations = spent
        self.add(HistoryEntry(self.problem.simulations, best, stage))

    def add(self, entry: HistoryEntry) -> None:
        """Notes an entry."""
        self.history.append(entry)
        if self.progress is not None:
            self.progress(entry)

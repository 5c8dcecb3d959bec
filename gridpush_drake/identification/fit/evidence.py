"""How well parameters other than the estimate agree with the pushes, and draws that are made to.

The spread of what was learned is a normal about the best fit. Far from it the pushes may say more
than their derivatives there: a cell that bears next to nothing has next to no derivative, and yet
would be noticed if it bore much. Therefore the pushes are simulated with a draw z = mean + dz
itself. Its excess

    E(dz) = 2 sum_p rho(W_p r_p(z)) - 2 sum_p rho(W_p r_p(mean)),

with rho Huber's loss, r_p the residuals of push p and W_p its whitening, is at most a chi square of
three numbers a push. A draw whose excess is more than that can be is shortened, dz <- c dz, until
it is not, six times at most (`docs/theory/identification.md`, section 6).
"""

from copy import copy
from math import sqrt

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.statistics.noise import POSE_SIZE
from gridpush_drake.identification.statistics.outliers import remove_outliers
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.pushes.push_log import PushLog

MAX_SIGMAS = 3.0
"""Number of standard deviations above its mean up to which a chi square counts as possible. A draw
with a greater excess is shortened."""

DRAW_SHRINKAGE = 0.5
"""Factor c by which a draw that the pushes contradict is shortened."""

MAX_SHRINKS = 6
"""Most times that a draw is shortened. Then it is taken as it is."""


class PushEvidence:
    """What pushes say of parameters other than the estimate.

    Attributes:
        max_excess: the greatest excess of parameters that the pushes do not contradict.
    """

    def __init__(self, found: Identification, used: PushLog) -> None:
        """Simulates the pushes once with the estimate.

        Args:
            found: what was learned.
            used: the pushes that it was learned from, as `select_learned` gives them.
        """
        self._mean = found.posterior.mean
        self._noise = found.noise
        self._problem = PushProblem(found.obj, used, found.params, found.physics)

        # The whitening of the estimate is kept for all draws: losses are compared in one unit.
        linear = self._problem.linearize(self._mean)
        self._whitenings = self._noise.make_whitenings(linear.by_inputs, found.noise_scale)
        self._least = self._calc_loss(linear.residuals)

        # A chi square of N numbers has the mean N and the variance 2 N.
        numbers = POSE_SIZE * len(used)
        self.max_excess = numbers + MAX_SIGMAS * sqrt(2 * numbers)

    @classmethod
    def of_log(cls, found: Identification, log: PushLog | None) -> "PushEvidence | None":
        """Takes the pushes of a log that `found` was learned from; None if the log has none."""
        used = None if log is None else select_learned(found, log)
        return cls(found, used) if used else None

    def relax(self, factor: float) -> "PushEvidence":
        """The evidence as if all noise were larger by a factor."""
        relaxed = copy(self)
        # Losses are squares of residuals over their standard deviations.
        relaxed.max_excess = factor**2 * self.max_excess
        return relaxed

    def calc_excess(self, dz: Array) -> float:
        """Excess E of the parameters at dz (n+1,) from the posterior's mean."""
        return self._calc_loss(self._problem.residuals(self._mean + dz)) - self._least

    def draw_in(self, dz: Array) -> Array:
        """Shortens the draws that the pushes contradict, towards the mean.

        Args:
            dz: (count, n+1) draws, from the mean. They are not changed.

        Returns:
            (count, n+1) the draws that the pushes allow, and the others shortened.
        """
        kept = dz.copy()
        far = np.arange(len(dz))
        for _ in range(MAX_SHRINKS):
            # Written so that an excess that is not a number counts as too great.
            far = far[[not self.calc_excess(kept[i]) <= self.max_excess for i in far]]
            kept[far] *= DRAW_SHRINKAGE
        return kept

    def _calc_loss(self, residuals: list[Array]) -> float:
        """Twice the sum of the pushes' Huber losses, from their residuals (3K,), m."""
        whitened = (one.apply(r) for one, r in zip(self._whitenings, residuals, strict=True))
        return 2 * sum(self._noise.calc_loss(values) for values in whitened)


def select_learned(found: Identification, log: PushLog) -> PushLog:
    """Selects the pushes of a log that a model was learned from, without what was refused of them.

    Args:
        found: what was learned.
        log: the log that it was learned from, or one with the same pushes.

    Returns:
        The pushes as the model took them: with its pusher radius if they name none.
    """
    used = log.subset([i for i, seen in enumerate(log) if seen.name in found.push_names])
    radius = found.obj.prior.pusher_radius
    if not used.radius_given and radius is not None:
        used = used.with_radius(radius)
    return remove_outliers(used, found.outliers)

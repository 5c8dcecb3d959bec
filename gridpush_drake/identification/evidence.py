"""How well the pushes that were learned from bear a model out, and draws drawn in until they do.

The spread of what was learned is a normal about the best fit. Far from it the pushes may say more
than their derivatives there: a cell that bears next to nothing has next to no derivative, and yet
would be noticed if it bore much. Therefore the pushes are simulated with a draw z = mean + dz
itself. Its excess

    E(dz) = 2 sum_p rho(W_p r_p(z)) - 2 sum_p rho(W_p r_p(mean)),    rho Huber's loss, W_p the
    push's whitening

is at most a chi square of three numbers a push. A draw whose excess is more than that can be is
drawn in, dz <- c dz, until it is not, six times at most (`docs/theory/identification.md`, section
6).
"""

from math import sqrt

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.noise import POSE
from gridpush_drake.identification.outliers import remove_outliers
from gridpush_drake.identification.problem import PushProblem
from gridpush_drake.identification.result import Identification
from gridpush_drake.pushes.push_log import PushLog

MAX_SIGMAS = 3.0
"""How many standard deviations above its mean a chi square still counts as possible."""

SHRINK, MAX_SHRINKS = 0.5, 6
"""c, and how often at most."""


class PushEvidence:
    """What pushes say of parameters other than the estimate.

    Attributes:
        max_excess: the greatest excess of parameters that the pushes do not contradict.
    """

    def __init__(self, found: Identification, used: PushLog) -> None:
        """Takes what was learned, and the pushes that it was learned from, as `select_learned` gives them."""
        self._mean, self._noise = found.posterior.mean, found.noise
        self._problem = PushProblem(found.obj, used, found.params, found.physics)
        linear = self._problem.linearize(self._mean)
        self._whitenings = self._noise.make_whitenings(linear.by_inputs, found.noise_scale)
        self._least = self._calc_loss(linear.residuals)
        numbers = POSE * len(used)
        self.max_excess = numbers + MAX_SIGMAS * sqrt(2 * numbers)

    @classmethod
    def of_log(cls, found: Identification, log: PushLog | None) -> "PushEvidence | None":
        """Takes those pushes of a log that `found` was learned from; None where it holds none of them."""
        used = None if log is None else select_learned(found, log)
        return cls(found, used) if used else None

    def calc_excess(self, dz: Array) -> float:
        """E at dz (n+1,) from the posterior's mean."""
        return self._calc_loss(self._problem.residuals(self._mean + dz)) - self._least

    def draw_in(self, dz: Array) -> Array:
        """Draws dz (count, n+1), those that the pushes contradict drawn in towards the mean."""
        kept, far = dz.copy(), np.arange(len(dz))
        for _ in range(MAX_SHRINKS):
            far = far[[not self.calc_excess(kept[i]) <= self.max_excess for i in far]]
            kept[far] *= SHRINK
        return kept

    def _calc_loss(self, residuals: list[Array]) -> float:
        whitened = (one.apply(r) for one, r in zip(self._whitenings, residuals, strict=True))
        return 2 * sum(self._noise.calc_loss(values) for values in whitened)


def select_learned(found: Identification, log: PushLog) -> PushLog:
    """The pushes of a log that a model was learned from, without what was refused of them, as it took them."""
    used = log.subset([i for i, seen in enumerate(log) if seen.name in found.push_names])
    radius = found.obj.prior.pusher_radius
    if not used.radius_given and radius is not None:
        used = used.with_radius(radius)
    return remove_outliers(used, found.outliers)

"""`predict_spread`: how far a learned model's predictions may be off, said beforehand.

`docs/theory/identification.md`, sections 4 and 5.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtr, fdtri

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.statistics.noise import NORMAL_DOF, NoiseModel
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.pushes.arguments import LOG_TYPES, PushLogOrFile, check_types, read_log
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M

INTERVAL_PROBABILITY = 0.9
"""Probability with which an error is within a predicted interval."""


@dataclass(frozen=True, eq=False)
class Spread:
    """How far a push's predicted final pose may be off.

    Attributes:
        name: name of the push.
        std: (3,) standard deviations of the cells' centroid, x and y, m, world frame, and of theta,
            rad.
        covariance: (3, 3) of the centroid's place and of the turn at the radius of gyration, m², of
            a typical push.
        freedom: degrees of freedom of the Student's t distribution of these three.
    """

    name: str
    std: Array
    covariance: Array
    freedom: float

    @property
    def cell_error(self) -> float:
        """With probability INTERVAL_PROBABILITY the cell error is below it, m."""
        return calc_norm_quantile(self.covariance, self.freedom, INTERVAL_PROBABILITY)

    def calc_probability(self, cell_error: float) -> float:
        """Calculates the probability of a cell error, root mean square, below one, m.

        It is the rank of an error that was seen: over many pushes it is spread evenly from 0 to 1
        if what the model says of its errors is true.
        """
        return calc_norm_probability(self.covariance, self.freedom, cell_error)

    def __repr__(self) -> str:
        """Name and how far off the end may be, in a line."""
        x, y, theta = self.std
        return (
            f"Spread of {self.name!r}: "
            f"± {x * MM_PER_M:.1f} mm, ± {y * MM_PER_M:.1f} mm, ± {theta * DEG_PER_RAD:.1f}°; "
            f"cell error below {self.cell_error * MM_PER_M:.1f} mm with probability "
            f"{INTERVAL_PROBABILITY:g}"
        )


def predict_spread(
    model: Identification, log: PushLogOrFile, physics: Physics | None = None
) -> list[Spread]:
    """Predicts how far the final poses of a log's pushes may be off.

    Their covariance is J S J^T + Sigma, S that of z after the pushes learned from. The error is
    Student's t, with the freedom that these pushes leave it, and `interval_scale` times as wide.

    Args:
        model: what was learned, with its posterior, and the noise that its pushes showed.
        log: pushes, with or without later observations, or the name of their CSV file.
        physics: physics of the simulations; the model's by default.

    Returns:
        One spread a push.

    Raises:
        PushLogError: the log's file cannot be read.
        TypeError: an argument is of another type, or they are swapped.
    """
    check_types("predict_spread", model=(model, (Identification,)), log=(log, LOG_TYPES))
    log = read_log(log, model.objects, require_final=False)
    obj = model.obj

    # Residuals are in the axes of the observed pose. With a final pose whose angle is zero, they
    # are in the world's; where it is does not matter to their derivatives.
    ends = [
        ObservedPush(
            name=seen.name,
            push=seen.push,
            pose=seen.pose,
            t_observed=np.array([seen.push.duration]),
            poses_observed=np.zeros((1, 3)),
        )
        for seen in log
    ]
    log_of_ends = PushLog(tuple(ends), table=log.table)
    problem = PushProblem(obj, log_of_ends, model.params, physics or model.physics)
    linear = problem.linearize(model.posterior.mean)

    pushes = len(model.push_names)
    freedom = model.noise.calc_freedom(pushes)
    found = []
    for seen, J, inputs in zip(log, linear.by_z, linear.by_inputs, strict=True):
        covariance = calc_end_covariance(model, J, inputs)
        # The third residual is rho dtheta.
        std = np.sqrt(np.diag(covariance)) / (1.0, 1.0, obj.radius_of_gyration)
        typical = model.noise.calc_typical_fraction(pushes) * covariance
        found.append(Spread(name=seen.name, std=std, covariance=typical, freedom=freedom))
    return found


def calc_end_covariance(
    model: Identification, J: Array, inputs: Array, *, least_scale: float = 0.0
) -> Array:
    """Calculates the covariance of how far off a push's end is predicted.

    Args:
        model: what was learned, with its posterior, and the noise that its pushes showed.
        J: (3, n+1) derivatives of the end's residuals by z.
        inputs: (3, 5) their derivatives by the inputs, see `NoiseModel.calc_covariance`.
        least_scale: takes the place of the model's `interval_scale` if that is smaller.

    Returns:
        (3, 3), m².
    """
    # kappa² (J S J^T + Sigma)
    model_covariance = J @ model.posterior.covariance @ J.T
    covariance = model_covariance + model.noise.calc_covariance(inputs, model.noise_scale)
    covariance *= max(model.interval_scale, least_scale) ** 2
    return np.asarray(covariance)


def calc_end_quantile(model: Identification, covariance: Array, probability: float) -> float:
    """Calculates the distance from its predicted end that a push keeps with some probability.

    Args:
        model: what was learned.
        covariance: (3, 3) of the end, see `calc_end_covariance`, m².
        probability: the probability.

    Returns:
        The distance, root mean square over the cells, m.
    """
    return calc_pushed_quantile(model.noise, len(model.push_names), covariance, probability)


def calc_pushed_quantile(
    noise: NoiseModel, pushes: int, covariance: Array, probability: float
) -> float:
    """Calculates the quantile of `calc_end_quantile` after a number of pushes."""
    typical = noise.calc_typical_fraction(pushes) * covariance
    return calc_norm_quantile(typical, noise.calc_freedom(pushes), probability)


def calc_norm_quantile(
    covariance: Array, freedom: float = NORMAL_DOF, probability: float = INTERVAL_PROBABILITY
) -> float:
    """Calculates a quantile of |r|, where r has Student's t distribution.

    Args:
        covariance: (p, p) of r at infinite freedom, m².
        freedom: degrees of freedom; normal by default.
        probability: probability with which |r| is below the quantile.

    Returns:
        The quantile, m.
    """
    scale, numbers = _match_moments(covariance)
    return float(np.sqrt(scale * fdtri(numbers, freedom, probability)))


def calc_norm_probability(covariance: Array, freedom: float, norm: float) -> float:
    """Calculates the probability of |r| below a norm, m, the inverse of `calc_norm_quantile`."""
    scale, numbers = _match_moments(covariance)
    return float(fdtr(numbers, freedom, norm**2 / scale))


def _match_moments(covariance: Array) -> tuple[float, float]:
    """Finds scale and numbers of the scaled F for which |r|² is taken.

    It has as many numbers as give it the normal's first two moments.
    """
    values = np.linalg.eigvalsh(covariance)
    return float(values.sum()), float(values.sum() ** 2 / (values**2).sum())

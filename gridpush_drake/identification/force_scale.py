"""What measured forces add to poses: the absolute scale of friction.

Slow pushes show the shares x_i = k_i / sum k of the friction alone. With them the model says the
force of a push up to the scale, F(t) = K f(t), K = g sum k_i the friction of the whole object. Each
push p so measures K by least squares,

    K_p = sum_j f_j·y_j / sum_j f_j·f_j,    y_j the forces seen,

and their spread says how well (`docs/theory/identification.md`, section 10). It is not for fast
pushes, whose forces accelerate the object, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.dynamics.physics import GRAVITY, Physics
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.posterior import Posterior
from gridpush_drake.identification.problem import TimedPush
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

PUSH_STD = 0.15
"""Prior standard deviation of log K from push to push: the friction of a table differs by so much
from place to place."""

PUSH_STD_WEIGHT = 3.0
"""Number of pushes that the prior belief in `PUSH_STD` is worth."""

HUBER = 1.5
"""Distance from the mean, in standard deviations, beyond which a push counts less (Huber)."""

ROUNDS = 20
"""Number of times that the pushes' weights are computed anew."""

DRAWS = 8
"""Number of draws from the posterior whose K are compared, because K is only as sure as the
normalized loads are."""

MAX_DRAWN_PUSHES = 20
"""Most pushes that are simulated with each draw."""

SURE = 2.0
"""Number of standard deviations between K and each of its bounds."""


@dataclass(frozen=True)
class ForceScale:
    """What the measured forces say.

    Attributes:
        friction: K, N: the friction with the table that the whole object can carry.
        relative_std: standard deviation of K over K.
        pushes: number of pushes from whose forces it is known.
        against: number of pushes whose forces point against the pusher's motion, and were left out.
        gravity: gravity by which masses follow from forces, m/s².
    """

    friction: float
    relative_std: float
    pushes: int
    against: int = 0
    gravity: float = GRAVITY

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest K, N, SURE standard deviations below and above it."""
        # K is lognormal: the bounds are as many times smaller and larger.
        factor = float(np.exp(SURE * self.relative_std))
        return self.friction / factor, self.friction * factor

    def calc_mass_bounds(self, obj: GridObject) -> tuple[float, float]:
        """Least and greatest mass, kg, with friction coefficients within the object's bounds."""
        # Section 10: K_- / (g mu_max) <= M <= K_+ / (g mu_min).
        low, high = self.bounds
        lightest = low / (self.gravity * obj.prior.friction_max)
        heaviest = high / (self.gravity * obj.prior.friction_min)
        return lightest, heaviest

    def calc_mean_friction_bounds(self, obj: GridObject) -> tuple[float, float] | None:
        """Bounds of the mean coefficient t = sum mu_i m_i / sum m_i of an object of known mass.

        Returns:
            The least and the greatest, within the bounds of the cells' coefficients; None where the
            mass is not known, or does not agree with the forces.
        """
        if obj.prior.total_mass is None:
            return None
        # Section 10: t = K / (g M).
        weight = self.gravity * obj.prior.total_mass
        low = max(self.bounds[0] / weight, obj.prior.friction_min)
        high = min(self.bounds[1] / weight, obj.prior.friction_max)
        return (low, high) if low <= high else None

    def rescale(self, obj: GridObject, params: CellParameters) -> CellParameters:
        """Gives parameters the scale of the forces.

        The masses are scaled if the object's mass is not known, else the friction coefficients. If
        mass and forces contradict each other, the parameters stay as they are.
        """
        ratio = self.friction / (self.gravity * float(params.mass @ params.friction))
        if obj.prior.total_mass is None:
            return replace(params, mass=ratio * params.mass)
        bounds = self.calc_mean_friction_bounds(obj)
        if bounds is None:
            return params
        friction = np.clip(ratio * params.friction, obj.prior.friction_min, obj.prior.friction_max)
        return replace(params, friction=friction)


def calc_force_scale(
    obj: GridObject,
    params: CellParameters,
    posterior: Posterior,
    log: PushLog,
    physics: Physics,
    seed: int = 0,
) -> ForceScale | None:
    """Calculates the scale of the friction from the forces of slow pushes.

    Args:
        obj: the object.
        params: learned from the poses.
        posterior: their spread.
        log: the pushes learned from, some with forces on the object.
        physics: the physics that they were learned with, quasi-static.
        seed: seed of the draws from the posterior.

    Returns:
        The scale; None where no force was measured while an object was pushed, or most point
        against the pusher.
    """
    with_force = [seen for seen in log if seen.force is not None]
    timed = [TimedPush.of(seen, physics.regime, log.table) for seen in with_force]
    if not timed:
        return None

    # Forces against the pusher's motion are wrong: of sign or frame. If as many are wrong as
    # right, none can be trusted.
    scales = _calc_scales(obj, params, timed, physics)
    right = scales > 0
    against = int((np.isfinite(scales) & ~right).sum())
    if against >= right.sum():
        return None
    mean, variance = _average(np.log(scales[right]))

    # An error of the normalized loads is common to all pushes, and does not average out.
    few = [one for one, use in zip(timed, right, strict=True) if use][:MAX_DRAWN_PUSHES]
    draws = posterior.draw_parameters(params, DRAWS, seed)
    drawn = [_calc_scales(obj, draw, few, physics) for draw in draws]
    medians = [np.median(scales[scales > 0]) for scales in drawn if (scales > 0).any()]
    spread = float(np.var(np.log(medians))) if len(medians) > 1 else 0.0
    return ForceScale(
        friction=float(np.exp(mean)),
        relative_std=float(np.sqrt(variance + spread)),
        pushes=int(right.sum()),
        against=against,
        gravity=physics.gravity,
    )


def _calc_scales(
    obj: GridObject, params: CellParameters, pushes: Sequence[TimedPush], physics: Physics
) -> Array:
    """K_p (P,) of each push, N; NaN where the model has no force while one was measured."""
    whole = physics.gravity * float(params.mass @ params.friction)
    found = []
    for one in pushes:
        motion = one.simulate(obj, params, physics, record=[])
        force = motion.contact_forces.sum(axis=1)
        found.append(_calc_scale(one.observed, one.times, force, whole))
    return np.array(found)


def _calc_scale(seen: ObservedPush, times: Array, force: Array, whole: float) -> float:
    """Calculates K_p of one push by least squares.

    Args:
        seen: the push, with measured forces.
        times: (T+1,) times of the simulation's steps, s.
        force: (T, 2) simulated force on the object during each step, N.
        whole: friction of the whole object in the simulation, N.

    Returns:
        K_p, N; NaN if the simulated force is zero throughout.
    """
    assert seen.force_t is not None and seen.force is not None
    # The force of the step within which each sample was taken.
    steps = np.clip(np.searchsorted(times, seen.force_t, side="right") - 1, 0, len(force) - 1)
    # K_p = sum_j f_j·y_j / sum_j f_j·f_j
    f = force[steps] / whole
    size = float((f * f).sum())
    return float((f * seen.force).sum()) / size if size > 0 else np.nan


def _average(values: Array) -> tuple[float, float]:
    """Calculates Huber's robust mean of log K_p (P,), and the variance of that mean."""
    mean = float(np.median(values))
    variance = PUSH_STD**2
    weights = np.ones(len(values))
    for _ in range(ROUNDS):
        distance = np.maximum(np.abs(values - mean), np.finfo(float).tiny)
        weights = np.minimum(1.0, HUBER * np.sqrt(variance) / distance)
        mean = float(weights @ values / weights.sum())
        # Section 10: s² = (nu s_0² + sum w_p (log K_p - log K)²) / (nu + sum w_p - 1).
        squares = float(weights @ (values - mean) ** 2)
        variance = (PUSH_STD_WEIGHT * PUSH_STD**2 + squares) / (PUSH_STD_WEIGHT + weights.sum() - 1)
    return mean, variance / float(weights.sum())

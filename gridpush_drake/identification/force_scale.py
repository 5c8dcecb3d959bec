"""What measured forces add to poses: the absolute scale of friction (`docs/theory/identification.md`, section 10).

Slow pushes show the shares x_i = k_i / sum k of the friction alone. With them the model says the
force of a push up to the scale, F(t) = K f(t), K = g sum k_i the friction of the whole object. Each
push p so measures K by least squares,

    K_p = sum_j f_j·y_j / sum_j f_j·f_j,    y_j the forces seen,

and their spread says how well.
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
"""Of log K from push to push before any was seen: friction of a table differs by so much from place
to place."""

PUSH_STD_WEIGHT = 3.0
"""Pushes that this is worth."""

HUBER = 1.5
"""Standard deviations from which a push counts for less."""

ROUNDS = 20
"""Of renewing the pushes' weights."""

DRAWS = 8
"""Of parameters that agree with the poses, whose K differ as the shares are unsure."""

MAX_DRAWN_PUSHES = 20
"""Pushes that are simulated with each draw."""

SURE = 2.0
"""Standard deviations that bounds are away."""


@dataclass(frozen=True)
class ForceScale:
    """What the measured forces say.

    Attributes:
        friction: K, N: the friction with the table that the whole object can carry.
        relative_std: of it.
        pushes: whose forces it is from.
        against: pushes whose forces point against what the pusher did, and were left out.
        gravity: by which masses follow from forces, m/s².
    """

    friction: float
    relative_std: float
    pushes: int
    against: int = 0
    gravity: float = GRAVITY

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest K, N, SURE standard deviations away."""
        factor = float(np.exp(SURE * self.relative_std))
        return self.friction / factor, self.friction * factor

    def calc_mass_bounds(self, obj: GridObject) -> tuple[float, float]:
        """Least and greatest mass, kg, with friction coefficients within the object's bounds."""
        low, high = self.bounds
        return low / (self.gravity * obj.prior.friction_max), high / (
            self.gravity * obj.prior.friction_min
        )

    def calc_mean_friction_bounds(self, obj: GridObject) -> tuple[float, float] | None:
        """Bounds of the mean coefficient sum mu_i m_i / sum m_i of an object of known mass, within those of its cells.

        Returns:
            None where the mass is not known, or does not agree with the forces.
        """
        if obj.prior.total_mass is None:
            return None
        weight = self.gravity * obj.prior.total_mass
        low = max(self.bounds[0] / weight, obj.prior.friction_min)
        high = min(self.bounds[1] / weight, obj.prior.friction_max)
        return (low, high) if low <= high else None

    def rescale(self, obj: GridObject, params: CellParameters) -> CellParameters:
        """Gives parameters the scale of the forces: to the mass where it is not known, else to the friction.

        Where mass and forces contradict each other the parameters stay.
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
        physics: they were learned with, quasi-static.
        seed: of draws from the posterior.

    Returns:
        The scale; None where no force was measured while an object was pushed, or most point
        against the pusher.
    """
    timed = [
        TimedPush.of(seen, physics.regime, log.table) for seen in log if seen.force is not None
    ]
    if not timed:
        return None
    scales = _calc_scales(obj, params, timed, physics)
    felt, right = np.isfinite(scales), scales > 0
    against = int((felt & ~right).sum())
    if against >= right.sum():
        return None
    mean, variance = _average(np.log(scales[right]))
    few = [one for one, use in zip(timed, right, strict=True) if use][:MAX_DRAWN_PUSHES]
    drawn = [
        _calc_scales(obj, draw, few, physics)
        for draw in posterior.draw_parameters(params, DRAWS, seed)
    ]
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
    """(P,) K_p of each push, N; NaN where the model has no force while one was measured."""
    whole = physics.gravity * float(params.mass @ params.friction)
    return np.array(
        [_calc_scale(one.observed, *_simulate(obj, params, one, physics), whole) for one in pushes]
    )


def _simulate(
    obj: GridObject, params: CellParameters, one: TimedPush, physics: Physics
) -> tuple[Array, Array]:
    """The steps' times (T+1,), s, and forces on the object (T, 2), N."""
    motion = one.simulate(obj, params, physics, record=[])
    return one.times, motion.contact_forces.sum(axis=1)


def _calc_scale(seen: ObservedPush, times: Array, force: Array, whole: float) -> float:
    assert seen.force_t is not None and seen.force is not None
    steps = np.clip(np.searchsorted(times, seen.force_t, side="right") - 1, 0, len(force) - 1)
    f = force[steps] / whole
    size = float((f * f).sum())
    return float((f * seen.force).sum()) / size if size > 0 else np.nan


def _average(values: Array) -> tuple[float, float]:
    """Huber's mean of what pushes say, and its variance."""
    mean, variance, weights = float(np.median(values)), PUSH_STD**2, np.ones(len(values))
    for _ in range(ROUNDS):
        off = values - mean
        weights = np.minimum(
            1.0, HUBER * np.sqrt(variance) / np.maximum(np.abs(off), np.finfo(float).tiny)
        )
        mean = float(weights @ values / weights.sum())
        squares = float(weights @ (values - mean) ** 2)
        variance = (PUSH_STD_WEIGHT * PUSH_STD**2 + squares) / (PUSH_STD_WEIGHT + weights.sum() - 1)
    return mean, variance / float(weights.sum())

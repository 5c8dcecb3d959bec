"""What measured forces add to poses: the absolute scale of friction.

Slow pushes show the shares x_i = k_i / sum k of the friction alone. With them the model says the
force of a push up to the scale, F(t) = K f(t), K = g sum k_i the friction of the whole object. Each
push p so measures K by least squares,

    K_p = sum_j f_j·(y_j + mu s_j f_j) / sum_j f_j·f_j,    y_j the forces seen,

and their spread says how well (`docs/theory/identification.md`, section 10). Here s_j is the upward
part of the force, by which the finger takes weight off the table, and mu the mean friction
coefficient. Only forces count that were measured while the finger pushed steadily: as it meets the
object, and as it stops, the force is anything from nothing to all that friction can carry. It is
not for fast pushes, whose forces accelerate the object, too.

Where a part h_p of an object hangs over the table's edge, the rest bears its weight, and rubs more
or less than the whole did: how friction is spread, pushes and weighings leave open. All pushes over
the edge share that error,

    K_p = K (1 + w h_p + e_p),    w ~ N(0, s_w²), one for all pushes
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.posterior import Posterior
from gridpush_drake.identification.statistics.problem import TimedPush
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import PushLog

PUSH_STD = 0.15
"""Prior standard deviation of K from push to push, over K: the friction of a table differs by so
much from place to place."""

PUSH_STD_WEIGHT = 3.0
"""Number of pushes that the prior belief in `PUSH_STD` is worth."""

HUBER_DISTANCE = 1.5
"""Distance from the mean, in standard deviations, beyond which a push counts less (Huber)."""

REWEIGHTING_ROUNDS = 20
"""Number of times that the pushes' weights are computed anew."""

OVERHANG_STD = 0.4
"""Prior standard deviation of w: how far K is off where a part of the object hangs over the edge,
over K, for each unit of that part. Of the nine shipped objects, with hidden truths whose parts have
frictions from 0.1 to 0.9, it is 0.27 to 0.44 for parts of 6 to 47 %, even where loads and center of
mass are known exactly."""

SETTLE_DISTANCE = 0.003
"""Way of the finger after it meets the object, by the model, on which forces do not count, m. Where
it truly meets it is known to a millimeter or two, and an arm that is held by springs needs a moment
until it pushes with all of its force."""

STEADY_FRACTION = 0.9
"""A force counts only if the finger was at least this fraction as fast as in the middle of the
push. While it slows down to stop, an object that stands already may push back with less than its
friction."""

MIN_STEADY = 3
"""Least number of steady forces by which a push says anything. Only if no push has as many, as in a
log with few forces, do all forces of all pushes count."""

POSTERIOR_DRAWS = 8
"""Number of draws from the posterior whose K are compared, because K is only as sure as the
normalized loads are."""

MAX_DRAWN_PUSHES = 20
"""Most pushes that are simulated with each draw."""

BOUND_SIGMAS = 2.0
"""Number of standard deviations between K and each of its bounds."""


@dataclass(frozen=True, eq=False)
class _Felt:
    """Some forces of a push, and what the model says of them.

    Attributes:
        model: (F, 2) simulated force on the object, over the whole friction.
        taken: (F, N, 2) the part of it that each of N objects takes.
        seen: (F, 2) the measured one, N.
        lift: (F,) its upward part, N; 0 where it was not measured.
    """

    model: Array
    taken: Array
    seen: Array
    lift: Array

    def take(self, chosen: NDArray[np.bool_]) -> "_Felt":
        """Takes some of the forces by a mask (F,)."""
        return _Felt(*[each[chosen] for each in (self.model, self.taken, self.seen, self.lift)])


@dataclass(frozen=True, eq=False)
class MeasuredPushes:
    """How large the whole friction is by the forces of P pushes.

    Attributes:
        scales: (P,) K_p, N; NaN where none of the push's forces count, or the model has no force
            while one was measured.
        stds: (P,) standard deviations of K_p by the noise of single forces, N.
        lifts: (P,) weight that the finger carried, on average, N: dK_p/dmu.
        taken: (P, N) fraction of the force that each of N objects takes.
    """

    scales: Array
    stds: Array
    lifts: Array
    taken: Array

    @property
    def right(self) -> NDArray[np.bool_]:
        """(P,) which forces push the objects, as the pusher does."""
        return np.asarray(self.scales > 0)

    @property
    def against(self) -> int:
        """Number of pushes whose forces point against the pusher's motion."""
        return int((np.isfinite(self.scales) & ~self.right).sum())

    @property
    def is_trusted(self) -> bool:
        """Whether fewer forces are wrong, of sign or frame, than right."""
        return self.against < int(self.right.sum())


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
        """Least and greatest K, N, BOUND_SIGMAS standard deviations below and above it."""
        # K is lognormal: the bounds are as many times smaller and larger.
        factor = float(np.exp(BOUND_SIGMAS * self.relative_std))
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

    def rescale(self, model: Model) -> CellParameters:
        """Gives parameters the scale of the forces.

        The masses are scaled if the object's mass is not known, else the friction coefficients. If
        mass and forces contradict each other, the parameters stay as they are.
        """
        obj = model.obj
        params = model.params
        ratio = self.friction / (self.gravity * float(params.mass @ params.friction))
        if obj.prior.total_mass is None:
            return replace(params, mass=ratio * params.mass)
        bounds = self.calc_mean_friction_bounds(obj)
        if bounds is None:
            return params
        friction = np.clip(ratio * params.friction, obj.prior.friction_min, obj.prior.friction_max)
        return replace(params, friction=friction)


def calc_force_scale(
    model: Model,
    posterior: Posterior,
    log: PushLog,
    seed: int = 0,
) -> ForceScale | None:
    """Calculates the scale of the friction from the forces of slow pushes.

    Args:
        model: one object, with its parameters and physics.
        posterior: their spread.
        log: the pushes learned from, some with forces on the object.
        seed: seed of the draws from the posterior.

    Returns:
        The scale; None where no force was measured while an object was pushed steadily, or most
        point against the pusher.
    """
    physics = model.physics
    with_force = [seen for seen in log if seen.force is not None]
    timed = [TimedPush.of(seen, physics.regime, log.table) for seen in with_force]
    if not timed:
        return None

    measured = measure_pushes(model, timed)
    if not measured.is_trusted:
        return None
    scales = measured.scales
    right = measured.right
    parts = np.array([_calc_part_beyond(model.obj, one) for one in timed])
    mean, variance = _average(scales[right], measured.stds[right], parts[right])

    # How much the weight rubs that the finger carried is not known: its friction is that of the
    # object, and an error of that is common to all pushes.
    carried = float((model.obj.prior.friction_std * measured.lifts[right].mean() / mean) ** 2)

    # An error of the normalized loads is common to all pushes, and does not average out. What
    # hangs over the edge adds an error of its own, so that only pushes on the table are compared.
    chosen = right & (parts == 0)
    compared = np.flatnonzero(chosen if chosen.any() else right)
    few = [timed[i] for i in compared[:MAX_DRAWN_PUSHES]]
    draws = posterior.draw_parameters(model.params, POSTERIOR_DRAWS, seed)
    drawn = [measure_pushes(model.with_params(draw), few).scales for draw in draws]
    medians = [np.median(scales[scales > 0]) for scales in drawn if (scales > 0).any()]
    spread = float(np.var(np.log(medians))) if len(medians) > 1 else 0.0
    return ForceScale(
        friction=mean,
        relative_std=float(np.sqrt(variance + carried + spread)),
        pushes=int(right.sum()),
        against=measured.against,
        gravity=physics.gravity,
    )


def measure_pushes(model: Model, pushes: Sequence[TimedPush]) -> MeasuredPushes:
    """Calculates K_p of pushes of one object or of several, and how much of it may be noise.

    Args:
        model: the objects; K is that of all together.
        pushes: the pushes, with forces.
    """
    load = sum(float(params.mass @ params.friction) for params in model.parameters)
    whole = model.physics.gravity * load
    friction = load / model.total_mass
    scales = []
    taken = []
    sizes = []
    lifts = []
    squares = 0.0
    freedom = 0
    for felt in _choose_forces(model, pushes, whole):
        f = felt.model
        # Whatever weight the finger carries does not rub on the table: y_j = (K - mu s_j) f_j.
        y = felt.seen + friction * felt.lift[:, None] * f
        # K_p = sum_j f_j·(y_j + mu s_j f_j) / sum_j f_j·f_j
        size = float((f * f).sum())
        scale = float((f * y).sum()) / size if size > 0 else np.nan
        scales.append(scale)
        sizes.append(size)
        along = np.einsum("jd,jbd->b", f, felt.taken)
        taken.append(along / size if size > 0 else np.zeros(len(along)))
        lifts.append(float(felt.lift @ (f * f).sum(axis=1)) / size if size > 0 else 0.0)
        # What is left of the forces is their noise, for which all pushes speak together.
        if size > 0:
            squares += float(((y - scale * f) ** 2).sum())
            freedom += y.size - 1
    variance = squares / max(freedom, 1)
    with np.errstate(divide="ignore"):
        stds = np.sqrt(variance / np.array(sizes))
    return MeasuredPushes(np.array(scales), stds, np.array(lifts), np.array(taken))


def _calc_part_beyond(obj: GridObject, one: TimedPush) -> float:
    """The part of an object's cells that hung over the table's edge, on average of seen poses."""
    if one.table is None:
        return 0.0
    top = shapely.Polygon(one.table)
    cells = obj.cells_at(np.vstack([one.observed.pose, one.observed.poses_observed]))
    return float(np.mean(~shapely.contains_xy(top, cells[..., 0], cells[..., 1])))


def _choose_forces(
    model: Model,
    pushes: Sequence[TimedPush],
    whole: float,
) -> list[_Felt]:
    """Chooses the forces of each push that count; `whole` is the whole friction, N."""
    felt = []
    steady = []
    for one in pushes:
        motion = one.simulate(model, record=[])
        on_each = motion.calc_net_forces() / whole
        # What objects exert on each other cancels.
        force = on_each.sum(axis=1)
        seen = one.observed
        assert seen.force_t is not None and seen.force is not None
        lift = np.zeros(len(seen.force_t)) if seen.lift_force is None else seen.lift_force
        steps = _find_steps(one.times, seen.force_t, len(force))
        felt.append(_Felt(force[steps], on_each[steps], seen.force, lift))
        steady.append(_find_steady(one, force))
    # A push that was too short to become steady says nothing, as it met the object or stopped all
    # of the time: its forces are too small. It is left out unless all are like that.
    enough = [int(mask.sum()) >= MIN_STEADY for mask in steady]
    if not any(enough):
        return felt
    return [one.take(mask & there) for one, mask, there in zip(felt, steady, enough, strict=True)]


def _find_steady(one: TimedPush, force: Array) -> NDArray[np.bool_]:
    """Finds the forces that were measured while the finger pushed steadily.

    Args:
        one: the push, with measured forces.
        force: (T, 2) simulated force on the object during each step, over the whole friction.

    Returns:
        A mask (F,) of the measured forces.
    """
    seen = one.observed
    assert seen.force_t is not None and seen.force is not None
    # A force is the mean of all samples of about this time before and after.
    half = float(np.median(np.diff(seen.force_t))) / 2 if len(seen.force_t) > 1 else 0.0
    begin = seen.push.distance_at(seen.force_t - half)
    end = seen.push.distance_at(seen.force_t + half)

    # The force of the step within which each sample was taken, and that in which it began.
    steps = _find_steps(one.times, seen.force_t, len(force))
    first_steps = _find_steps(one.times, seen.force_t - half, len(force))

    # How far the finger has come since it met the object the last time, at each step's beginning.
    apart = np.asarray((force == 0.0).all(axis=1))
    way = seen.push.distance_at(one.times)
    met = np.maximum.accumulate(np.where(apart, way[1:], 0.0))
    settled = begin - met[first_steps] >= SETTLE_DISTANCE
    lost = apart[first_steps] | apart[steps]
    gone = end - begin
    return np.asarray(settled & ~lost & (gone >= STEADY_FRACTION * np.median(gone)))


def _find_steps(times: Array, wanted: Array, count: int) -> IntArray:
    """Finds the step of a simulation, of `count` steps, within which each of some times (F,) is."""
    return np.clip(np.searchsorted(times, wanted, side="right") - 1, 0, count - 1)


def _average(scales: Array, stds: Array, parts: Array) -> tuple[float, float]:
    """Averages the scales of pushes robustly.

    A push's scale differs from the mean by the table's friction there, whose spread s is found
    here, by the noise of its forces, and by w for what hangs over the table's edge.

    Args:
        scales: (P,) K_p, N.
        stds: (P,) their standard deviations by the noise of the forces, N.
        parts: (P,) h_p, the part of the object that hung over the edge; zero on the table.

    Returns:
        K, N, and the variance of K / K.
    """
    mean = float(np.median(scales))
    off = scales / mean - 1
    variance = PUSH_STD**2
    precision = 0.0
    for _ in range(REWEIGHTING_ROUNDS):
        total = variance + (stds / mean) ** 2
        distance = np.maximum(np.abs(off), np.finfo(float).tiny)
        weights = np.minimum(1.0, HUBER_DISTANCE * np.sqrt(total) / distance)
        # Section 10: the weighted least squares of K_p = K + K w h_p, with the prior of w.
        W = weights / total
        S_0, S_1, S_2 = W.sum(), W @ parts, W @ parts**2 + OVERHANG_STD**-2
        by_part = W @ (parts * scales)
        precision = float(S_0 - S_1**2 / S_2)
        mean = float((W @ scales - S_1 / S_2 * by_part) / precision)
        slope = float((by_part - S_1 * mean) / S_2)  # K w, N
        off = (scales - slope * parts) / mean - 1
        # s² = (nu s_0² + sum w_p e_p²) / (nu + sum w_p - 1 - gamma), with e_p² what the table's
        # part of the distance is expected to be, squared, and gamma how much of w is known.
        fraction = variance / total
        squares = float(weights @ ((fraction * off) ** 2 + variance * (1 - fraction)))
        gamma = 1 - OVERHANG_STD**-2 / (S_2 - S_1**2 / S_0)
        freedom = PUSH_STD_WEIGHT + weights.sum() - 1 - gamma
        variance = (PUSH_STD_WEIGHT * PUSH_STD**2 + squares) / freedom
    return mean, 1 / precision

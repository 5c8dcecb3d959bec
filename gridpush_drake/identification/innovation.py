"""Surprises: pushes that end where the model, as it was before them, said that they hardly could.

With r = (dx_c, dy_c, rho dtheta) the residual of a push's last pose, the model predicts

    r ~ t(0, max(kappa, LEAST_SCALE)² (J S J^T + Sigma))

(`prediction.calc_end_covariance`). The push is a surprise if |r| is above the quantile of 99 % of
that distribution. Then the object is not what the model says it is, or something else moved it: its
load has changed, it was exchanged, it caught on something. A surprise may also be bad luck. Two in
a row are hardly, and nor is a single one beyond the quantile of 99.99 %, which is as rare.

That distribution is a normal one about a single end. Some pushes have two: where the pusher just
meets a corner or just misses it, or slips off, a millimeter decides, and even the true model is off
by centimeters. So a push that ended outside of the region is simulated again by draws from all that
is uncertain of model, pusher and pose. If some of them end outside of the region, too, and where
the push did, as nearly as poses are seen, it is no surprise.

An object that jumped during a push, as no pusher can move it, was moved by something else, or the
tracker was wrong. That says nothing of what the object is: the push is judged by the rest of its
poses, as it is learned from.

Of several objects each is judged by itself, by its part of what was learned of all together,
wherever it moved or was to move.

A model that has learned from pushes which contradict each other explains them all by noise, and
nothing surprises it any more. So after a surprise, if the newer model has become much vaguer, the
model as it was before the surprise remains the judge.

Nothing is learned here, and what follows from a surprise is decided elsewhere: `InnovationRecord`
counts them, closed loops (`planning.closed_loop`) act on the count, and learners forget by it what
was seen before. Theory: `docs/theory/identification.md`, section 13.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gridpush_drake.geometry.se2 import Array, rotate, wrap_angle
from gridpush_drake.identification.multi_object.joint_problem import JointProblem, find_moved
from gridpush_drake.identification.multi_object.joint_result import JointIdentification
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.spread import (
    calc_end_covariance,
    calc_end_quantile,
    calc_pushed_quantile,
)
from gridpush_drake.identification.statistics.friction_gradient import draw_gradients
from gridpush_drake.identification.statistics.noise import NoiseModel
from gridpush_drake.identification.statistics.outliers import leave_out_jumps
from gridpush_drake.identification.statistics.problem import PushProblem, TimedPush
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.units import MM_PER_M

EXPECTED_PROBABILITY = 0.99
"""Probability with which a push ends within the region that is no surprise."""

MIN_LEARNED = 2
"""Number of pushes that a model must be learned from before it judges another one. After a single
push the object may be quite different from the most probable one, which the region does not
know."""

LEAST_SCALE = 0.5
"""Least factor kappa on the region in which a push is expected to end. The pushes that were learned
from may be predicted much better than was stated, which makes kappa small; a push of another kind,
such as a long slide over the edge after a few short pokes, need not be."""

FORGET_AFTER = 2
"""Number of surprises in a row after which what was seen before them is forgotten."""

HARDLY_CHANCE = 1 - (1 - EXPECTED_PROBABILITY) ** FORGET_AFTER
"""If a push ends outside of the region that holds this fraction of such pushes, it surprised
clearly: that is as rare as FORGET_AFTER surprises in a row, and the same follows from it."""

INNOVATION_DRAWS = 80
"""Number of draws by which a push is simulated again that ended outside of its region."""

ENOUGH_DRAWS = 0.05
"""Fraction of the draws that must end where the push did, outside of the region, for it to be no
surprise."""

MUCH_VAGUER = 3.0
"""If the region of a newer model is more than this many times as wide, the model as it was before a
surprise judges the next push."""


@dataclass(frozen=True)
class Judgment:
    """Where a push ended, compared with where a model that did not know it put it.

    Attributes:
        push: the push's name.
        distance: how far from the predicted end it ended, root mean square over the cells, m.
        limit: greatest distance that is no surprise, m.
        clear_limit: greatest distance that may well be bad luck, m.
        drawn: whether some draws of what is uncertain end where the push did, so that it is no
            surprise however far that is.
    """

    push: str
    distance: float
    limit: float
    clear_limit: float = np.inf
    drawn: bool = False

    @property
    def innovations(self) -> bool:
        """Whether the push ended outside of the region; so does one whose distance is no number."""
        return not (self.drawn or self.distance <= self.limit)

    @property
    def is_clear(self) -> bool:
        """Whether it ended so far outside of the region that this is hardly by chance."""
        return not (self.drawn or self.distance <= self.clear_limit)

    def describe(self) -> str:
        """The judgment of a surprise, in a sentence."""
        return (
            f"It ended {self.distance * MM_PER_M:.1f} mm from where it was predicted to, "
            f"and {EXPECTED_PROBABILITY:.0%} of such pushes end within "
            f"{self.limit * MM_PER_M:.1f} mm."
        )


@dataclass(frozen=True, eq=False)
class _EndForecast:
    """Where a model puts the end of a push, beside where it ended.

    Attributes:
        residual: (3,) of the end, m.
        calc_quantile: the distance that such a push keeps from its predicted end with some
            probability, m.
        near: how far off a pose may be seen, m, with the probability that is no surprise.
        draw: simulates the push by draws of what is uncertain; residuals (INNOVATION_DRAWS, 3), m.
    """

    residual: Array
    calc_quantile: Callable[[float], float]
    near: float
    draw: Callable[[], Array]


def check_innovation(
    model: Identification | JointIdentification,
    seen: ObservedPush,
    table: Array | None = None,
    body: int = 0,
) -> Judgment | None:
    """Judges a push by what the model said of it beforehand.

    Args:
        model: what was learned from pushes before this one.
        seen: the push.
        table: (K, 2) corners in W of the table's top, m, if loads shift at its edge.
        body: number of the object that is judged, of several.

    Returns:
        The judgment; None where next to nothing was learned before the push, or where its end
        cannot be judged: it was not seen, or the object hung over an edge that is not known, or it
        is one of several that neither moved nor was to move.
    """
    unknown_edge = seen.overhang and table is None
    if unknown_edge or not len(seen.t_observed):
        return None
    if isinstance(model, Identification):
        seen = leave_out_jumps(model.obj, seen)
    # Only the last pose counts: it is what plans are made of.
    end = replace(seen, t_observed=seen.t_observed[-1:], poses_observed=seen.poses_observed[-1:])
    if isinstance(model, JointIdentification):
        forecast = _forecast_one_of_several(model, end, body)
    else:
        forecast = _forecast(model, end, table)
    if forecast is None:
        return None
    judgment = Judgment(
        push=seen.name,
        distance=float(np.linalg.norm(forecast.residual)),
        limit=forecast.calc_quantile(EXPECTED_PROBABILITY),
        clear_limit=forecast.calc_quantile(HARDLY_CHANCE),
    )
    if not judgment.innovations:
        return judgment
    drawn = forecast.draw()
    outside = np.linalg.norm(drawn - forecast.residual, axis=1) > judgment.limit
    near = np.linalg.norm(drawn, axis=1) <= forecast.near
    return replace(judgment, drawn=float(np.mean(outside & near)) >= ENOUGH_DRAWS)


def _forecast(model: Identification, end: ObservedPush, table: Array | None) -> _EndForecast | None:
    """Predicts a push of one object, with its last pose alone; see `check_innovation`."""
    if len(model.push_names) < MIN_LEARNED:
        return None
    problem = PushProblem(model.obj, PushLog((end,), table=table), model.params, model.physics)
    linear = problem.linearize(model.posterior.mean)
    covariance = calc_end_covariance(
        model, linear.by_z[0], linear.by_inputs[0], least_scale=LEAST_SCALE
    )
    return _EndForecast(
        residual=linear.residuals[0],
        calc_quantile=partial(calc_end_quantile, model, covariance),
        near=_calc_near(model),
        draw=partial(_draw_ends, model, end, table),
    )


def _forecast_one_of_several(
    model: JointIdentification, end: ObservedPush, body: int
) -> _EndForecast | None:
    """Predicts one of several objects in a push, with their last poses alone."""
    pushes = int(model.moves[body])
    if pushes < MIN_LEARNED:
        return None
    residuals, derivatives = JointProblem(model, (end,), np.ones(3)).linearize(model.z)
    off = residuals[0].reshape(-1, 3)
    awaited = replace(end, poses_observed=end.poses_observed + off)
    if not (find_moved(end, model.noise) | find_moved(awaited, model.noise))[body]:
        return None
    # r = (dx_c, dy_c, rho dtheta), to first order T times how far the pose is off
    obj = model.objects[body]
    pose = awaited.final_pose[body]
    x, y = rotate(pose[2], obj.p_BC.mean(axis=0))
    T = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, obj.radius_of_gyration]])
    J = T @ derivatives[0].reshape(len(off), 3, -1)[body]
    std = T * (max(model.noise_scale, LEAST_SCALE) * np.asarray(model.noise))
    calc_quantile = partial(calc_pushed_quantile, NoiseModel(), pushes)
    return _EndForecast(
        residual=_calc_residual(obj, pose, end.final_pose[body]),
        calc_quantile=partial(calc_quantile, J @ model.covariance @ J.T + std @ std.T),
        near=calc_quantile(std @ std.T, EXPECTED_PROBABILITY),
        draw=partial(_draw_ends_of_several, model, end, body),
    )


def _calc_residual(obj: GridObject, pose: Array, seen: Array) -> Array:
    """Calculates the residual (3,), m, of a pose (3,) beside the one that was seen."""
    centroid = obj.p_BC.mean(axis=0)
    shift = pose[:2] + rotate(pose[2], centroid) - seen[:2] - rotate(seen[2], centroid)
    return np.append(shift, obj.radius_of_gyration * wrap_angle(pose[2] - seen[2]))


def _draw_ends_of_several(model: JointIdentification, end: ObservedPush, body: int) -> Array:
    """Simulates a push of several objects by draws of model and poses; see `_draw_ends`."""
    rng = np.random.default_rng(INNOVATION_DRAWS)
    std = max(model.noise_scale, LEAST_SCALE) * np.asarray(model.noise)
    ends = []
    for drawn in model.draws(INNOVATION_DRAWS, INNOVATION_DRAWS):
        shift = std * rng.standard_normal(end.pose.shape)
        timed = TimedPush.of(replace(end, pose=end.pose + shift), "quasi_static")
        pose = timed.simulate(drawn).poses[timed.rows[-1], body]
        ends.append(_calc_residual(model.objects[body], pose, end.final_pose[body]))
    return np.array(ends)


def _draw_ends(model: Identification, end: ObservedPush, table: Array | None) -> Array:
    """Simulates a push by draws of what is uncertain of model, pusher and pose.

    Args:
        model: what was learned before the push.
        end: the push, with its last pose alone.
        table: see `check_innovation`.

    Returns:
        (INNOVATION_DRAWS, 3) residuals of the last pose, m.
    """
    obj = model.obj
    noise = model.noise.scaled(model.noise_scale)
    rng = np.random.default_rng(INNOVATION_DRAWS)
    models = model.posterior.draw_parameters(model.params, INNOVATION_DRAWS, INNOVATION_DRAWS)
    models = draw_gradients(obj, models, noise.friction_gradient, INNOVATION_DRAWS)
    # The pusher's place relative to the object, and the object's heading, are seen with noise.
    moved = rng.standard_normal((INNOVATION_DRAWS, 3))
    moved *= (noise.tip, noise.tip, noise.pose / obj.radius_of_gyration)
    grip = np.exp(noise.log_contact_friction * rng.standard_normal(INNOVATION_DRAWS))
    ends = []
    for params, shift, factor in zip(models, moved, grip, strict=True):
        drawn = replace(params, contact_friction=params.contact_friction * float(factor))
        log = PushLog((replace(end, pose=end.pose + shift),), table=table)
        problem = PushProblem(obj, log, drawn, model.physics)
        ends.append(problem.residuals(problem.unknowns(drawn))[0])
    return np.array(ends)


def _calc_near(model: Identification) -> float:
    """Calculates how far off a pose may be seen, m, with the probability that is no surprise."""
    noise = model.noise.scaled(model.noise_scale)
    return calc_end_quantile(model, noise.pose**2 * np.eye(3), EXPECTED_PROBABILITY)


@dataclass(frozen=True, eq=False)
class InnovationRecord:
    """What surprises there were, push after push; never changed, only replaced.

    Attributes:
        total: number of surprises so far.
        in_row: number of the last pushes that were surprises, one after another. After
            `FORGET_AFTER`, or a clear one, it is counted anew, because the model is then learned
            anew.
        last: the surprise of the last push; None where it was none.
        forgotten: number of pushes, the first ones of the log, that are not learned from any more.
        trusted: what was learned before the first of the last surprises in a row; None where the
            last push was no surprise.
        body: number of the object that is judged, of several.
    """

    total: int = 0
    in_row: int = 0
    last: Judgment | None = None
    forgotten: int = 0
    trusted: Identification | JointIdentification | None = None
    body: int = 0

    @property
    def is_changed(self) -> bool:
        """Whether the last push says that the object is another one than was learned."""
        return self.last is not None and (self.last.is_clear or self.in_row >= FORGET_AFTER)

    def note(
        self, model: Identification | JointIdentification | None, log: PushLog
    ) -> "InnovationRecord":
        """The record with the last push of a log judged; itself where it cannot be judged.

        Args:
            model: what was learned from the pushes before it; None before anything was.
            log: all pushes so far.
        """
        begun = replace(self, in_row=0, trusted=None) if self.is_changed else self
        judgment = begun._judge(model, log)
        if judgment is None:
            return self
        if not judgment.innovations:
            return self if self.last is None else replace(begun, in_row=0, last=None, trusted=None)
        noted = replace(
            begun,
            total=begun.total + 1,
            in_row=begun.in_row + 1,
            last=judgment,
            trusted=begun.trusted or model,
        )
        if noted.is_changed:
            # The pushes that surprised were made with the object as it now is.
            noted = replace(noted, forgotten=len(log) - noted.in_row)
        return noted

    def _judge(
        self, model: Identification | JointIdentification | None, log: PushLog
    ) -> Judgment | None:
        """Judges the last push of a log by the model, or by the trusted one if that says more."""
        if model is None or not len(log):
            return None
        judgment = check_innovation(model, log[-1], log.table, self.body)
        if self.trusted is None or judgment is None:
            return judgment
        trusted = check_innovation(self.trusted, log[-1], log.table, self.body)
        if trusted is not None and judgment.limit > MUCH_VAGUER * trusted.limit:
            return trusted
        return judgment

    def select(self, log: PushLog) -> PushLog:
        """Selects the pushes of a log that may be learned from; itself if nothing is forgotten."""
        return log[self.forgotten :] if self.forgotten else log


def select_unchanged(
    records: Sequence[InnovationRecord],
    pushes: Sequence[ObservedPush],
    noise: tuple[float, float, float],
) -> tuple[ObservedPush, ...]:
    """Selects the pushes of several objects that may be learned from.

    A push tells nothing true any more where it moved an object that has changed since.

    Args:
        records: what surprises there were, of each object.
        pushes: all pushes so far.
        noise: standard deviations of poses, m, m and rad.
    """
    kept = []
    for i, seen in enumerate(pushes):
        stale = [record.body for record in records if i < record.forgotten]
        if not (stale and find_moved(seen, noise)[stale].any()):
            kept.append(seen)
    return tuple(kept)

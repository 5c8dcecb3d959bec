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

A model that has learned from pushes which contradict each other explains them all by noise, and
nothing surprises it any more. So after a surprise, if the newer model has become much vaguer, the
model as it was before the surprise remains the judge.

Nothing is learned here, and what follows from a surprise is decided elsewhere: `InnovationRecord`
counts them, closed loops (`planning.closed_loop`) act on the count, and learners forget by it what
was seen before. Theory: `docs/theory/identification.md`, section 13.
"""

from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.spread import calc_end_covariance, calc_end_quantile
from gridpush_drake.identification.statistics.friction_gradient import draw_gradients
from gridpush_drake.identification.statistics.problem import PushProblem
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


def check_innovation(
    model: Identification, seen: ObservedPush, table: Array | None = None
) -> Judgment | None:
    """Judges a push by what the model said of it beforehand.

    Args:
        model: what was learned from pushes before this one.
        seen: the push.
        table: (K, 2) corners in W of the table's top, m, if loads shift at its edge.

    Returns:
        The judgment; None where next to nothing was learned before the push, or where its end
        cannot be judged: it was not seen, or the object hung over an edge that is not known.
    """
    unknown_edge = seen.overhang and table is None
    knows_little = len(model.push_names) < MIN_LEARNED
    if knows_little or not len(seen.t_observed) or unknown_edge:
        return None

    # Only the last pose counts: it is what plans are made of.
    end = replace(seen, t_observed=seen.t_observed[-1:], poses_observed=seen.poses_observed[-1:])
    problem = PushProblem(model.obj, PushLog((end,), table=table), model.params, model.physics)
    linear = problem.linearize(model.posterior.mean)
    covariance = calc_end_covariance(
        model, linear.by_z[0], linear.by_inputs[0], least_scale=LEAST_SCALE
    )
    judgment = Judgment(
        push=seen.name,
        distance=float(np.linalg.norm(linear.residuals[0])),
        limit=calc_end_quantile(model, covariance, EXPECTED_PROBABILITY),
        clear_limit=calc_end_quantile(model, covariance, HARDLY_CHANCE),
    )
    if not judgment.innovations:
        return judgment
    drawn = _draw_ends(model, end, table)
    outside = np.linalg.norm(drawn - linear.residuals[0], axis=1) > judgment.limit
    near = np.linalg.norm(drawn, axis=1) <= _calc_near(model)
    return replace(judgment, drawn=float(np.mean(outside & near)) >= ENOUGH_DRAWS)


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
    """

    total: int = 0
    in_row: int = 0
    last: Judgment | None = None
    forgotten: int = 0
    trusted: Identification | None = None

    @property
    def is_changed(self) -> bool:
        """Whether the last push says that the object is another one than was learned."""
        return self.last is not None and (self.last.is_clear or self.in_row >= FORGET_AFTER)

    def note(self, model: Identification | None, log: PushLog) -> "InnovationRecord":
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

    def _judge(self, model: Identification | None, log: PushLog) -> Judgment | None:
        """Judges the last push of a log by the model, or by the trusted one if that says more."""
        if model is None or not len(log):
            return None
        judgment = check_innovation(model, log[-1], log.table)
        if self.trusted is None or judgment is None:
            return judgment
        trusted = check_innovation(self.trusted, log[-1], log.table)
        if trusted is not None and judgment.limit > MUCH_VAGUER * trusted.limit:
            return trusted
        return judgment

    def select(self, log: PushLog) -> PushLog:
        """Selects the pushes of a log that may be learned from; itself if nothing is forgotten."""
        return log[self.forgotten :] if self.forgotten else log

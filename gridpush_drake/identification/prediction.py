"""Predicting a log's pushes with a model, and how far off that is.

Errors are told push by push and over the whole log; `predict_spread` says beforehand how large they
may be (`docs/theory/identification.md`, sections 4 and 5). Nothing is learned here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import f

from gridpush_drake.dynamics.physics import Physics, Regime, make_physics
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.identification.center_of_mass import CenterOfMass
from gridpush_drake.identification.noise import NORMAL
from gridpush_drake.identification.outliers import remove_outliers
from gridpush_drake.identification.problem import PushProblem, TimedPush, resolve_physics
from gridpush_drake.identification.result import Identification, IdentificationStatus
from gridpush_drake.notebook import DEGREES, MM, describe_pose, draw_paths, make_page
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.arguments import LOG_TYPES, PushLogOrFile, check_types, read_log
from gridpush_drake.pushes.plausibility import check_plausible
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

P90 = 0.9
"""Share of the pushes whose errors are below the last figure of a summary."""

DOUBTFUL = 0.2
"""Largest error of the pushes learned from, as a share of how far the object moves. A model with a
larger error explains little."""

CONTRADICTED = 4.0
"""Distance, in standard deviations, of the center of friction from the center of mass that was
told, beyond which the pushes contradict that center of mass."""

INTERVAL = 0.9
"""Probability with which an error is within a predicted interval."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """One push, predicted.

    Attributes:
        name: name of the push.
        times: (T+1,) s from its beginning.
        poses: (T+1, 3) predicted q = (x, y, theta), m and rad, world frame.
        at_observations: (K, 3) predicted poses at the times the log observed one.
        status: how the simulation ended.
    """

    name: str
    times: Array
    poses: Array
    at_observations: Array
    status: str

    def __repr__(self) -> str:
        """Name, status and where the object ends, in a line."""
        return (
            f"Prediction of {self.name!r}, {self.status}: ends at {describe_pose(self.poses[-1])}"
        )

    def _repr_html_(self) -> str:
        """The object's predicted path."""
        return make_page(
            repr(self), draw_paths([(self.poses[:, :2], "teal", "object's body frame")])
        )


@dataclass(frozen=True)
class PoseError:
    """How far a predicted pose is from an observed one.

    Attributes:
        position: distance |dxy| of the body frame's origins, m.
        angle: |dtheta|, the short way round, rad.
        cell: mean distance of the cells' centers, m (the paper's ADD).
    """

    position: float
    angle: float
    cell: float

    def combined(self, radius: float) -> float:
        """Position and angle in one number: |dxy| + radius |dtheta|, m."""
        return self.position + radius * self.angle


def predict(
    obj: GridObject,
    params: CellParameters,
    log: PushLogOrFile,
    regime: Regime | None = None,
    *,
    physics: Physics | None = None,
) -> list[Prediction]:
    """Predicts every push of a log from its first observed pose.

    Args:
        obj: the object.
        params: the model.
        log: pushes, with or without later observations, or the name of their CSV file.
        regime: takes the place of the one in `physics`. "auto", the default, is the one that suits
            the log's fastest push, for all of them.
        physics: physics of the simulations, such as `Identification.physics`; `Physics()` by
            default.

    Returns:
        One prediction a push.

    Raises:
        PushLogError: the log cannot be true of the object, see `pushes.plausibility`, or its file
            cannot be read.
        TypeError: an argument is of another type, or they are swapped.
    """
    check_types(
        "predict",
        obj=(obj, (GridObject,)),
        params=(params, (CellParameters,)),
        log=(log, LOG_TYPES),
    )
    log = read_log(log, obj, require_final=False)
    check_plausible(obj, log, learning=False)
    used = resolve_physics(make_physics(physics, regime), obj, log, params)
    return [_predict_push(obj, params, push, used, log.table) for push in log]


@dataclass(frozen=True, eq=False)
class Spread:
    """How far a push's predicted final pose may be off.

    Attributes:
        name: name of the push.
        std: (3,) standard deviations of the cells' centroid, x and y, m, world frame, and of theta,
            rad.
        cell_error: m; with probability INTERVAL the cell error is below it.
    """

    name: str
    std: Array
    cell_error: float

    def __repr__(self) -> str:
        """Name and how far off the end may be, in a line."""
        x, y, theta = self.std
        return (
            f"Spread of {self.name!r}: "
            f"± {x * MM:.1f} mm, ± {y * MM:.1f} mm, ± {theta * DEGREES:.1f}°; "
            f"cell error below {self.cell_error * MM:.1f} mm with probability {INTERVAL:g}"
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
    log = read_log(log, model.obj, require_final=False)
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

    found = []
    for seen, J, inputs in zip(log, linear.by_z, linear.by_inputs, strict=True):
        covariance = calc_end_covariance(model, J, inputs)
        # The third residual is rho dtheta.
        std = np.sqrt(np.diag(covariance)) / (1.0, 1.0, obj.radius_of_gyration)
        cell_error = calc_end_quantile(model, covariance, INTERVAL)
        found.append(Spread(name=seen.name, std=std, cell_error=cell_error))
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
    left_open = J @ model.posterior.covariance @ J.T
    covariance = left_open + model.noise.calc_covariance(inputs, model.noise_scale)
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
    pushes = len(model.push_names)
    typical = model.noise.calc_typical_share(pushes) * covariance
    return calc_norm_quantile(typical, model.noise.calc_freedom(pushes), probability)


def calc_norm_quantile(
    covariance: Array, freedom: float = NORMAL, probability: float = INTERVAL
) -> float:
    """Calculates a quantile of |r|, where r has Student's t distribution.

    Args:
        covariance: (p, p) of r at infinite freedom, m².
        freedom: degrees of freedom; normal by default.
        probability: probability with which |r| is below the quantile.

    Returns:
        The quantile, m.
    """
    # |r|² is taken for a scaled F, with as many numbers as give it the normal's first two moments.
    values = np.linalg.eigvalsh(covariance)
    numbers = values.sum() ** 2 / (values**2).sum()
    return float(np.sqrt(values.sum() * f.ppf(probability, numbers, freedom)))


def calc_pose_error(obj: GridObject, predicted: ArrayLike, observed: ArrayLike) -> PoseError:
    """Compares two poses (3,), x, y in m and theta in rad, the angle the short way round."""
    difference = np.asarray(predicted, dtype=np.float64) - np.asarray(observed, dtype=np.float64)
    angle = abs(wrap_angle(difference[2]))
    cells = obj.cells_at(predicted) - obj.cells_at(observed)
    return PoseError(
        position=float(np.hypot(difference[0], difference[1])),
        angle=float(angle),
        cell=float(np.linalg.norm(cells, axis=-1).mean()),
    )


def _predict_push(
    obj: GridObject,
    params: CellParameters,
    push: ObservedPush,
    physics: Physics,
    table: Array | None,
) -> Prediction:
    """Predicts one push; the regime of the physics is not "auto"."""
    timed = TimedPush.of(push, physics.regime, table)
    motion = timed.simulate(obj, params, physics)
    return Prediction(
        name=push.name,
        times=motion.times,
        poses=motion.poses,
        at_observations=motion.poses[timed.rows],
        status=motion.status,
    )


@dataclass(frozen=True)
class ErrorSummary:
    """One kind of error over several pushes.

    Attributes:
        name: kind of the error, such as "position".
        mean: mean over the pushes, m or rad.
        median: error that half the pushes are below, m or rad.
        p90: error that nine in ten pushes are below, m or rad.
        pushes: number of pushes.
        unit: unit to show the error in, "mm" or "°".
        scale: how many of that unit make a meter or a radian.
    """

    name: str
    mean: float
    median: float
    p90: float
    pushes: int
    unit: str
    scale: float


def calc_final_errors(
    obj: GridObject, predictions: Sequence[Prediction], log: PushLog
) -> list[PoseError | None]:
    """Compares each push's predicted with its observed final pose; None where the log has none."""
    return [
        calc_pose_error(obj, prediction.at_observations[-1], seen.final_pose)
        if len(seen.poses_observed)
        else None
        for prediction, seen in zip(predictions, log, strict=True)
    ]


def summarize_errors(
    obj: GridObject, predictions: Sequence[Prediction], log: PushLog
) -> list[ErrorSummary]:
    """Sums up the errors of final poses: position, angle, cell, and combined, |dxy| + rho |dtheta|.

    Args:
        obj: the object; rho is its radius of gyration.
        predictions: one a push of the log.
        log: the pushes.

    Returns:
        The four summaries; empty where the log has no final pose.
    """
    errors = [error for error in calc_final_errors(obj, predictions, log) if error is not None]
    rho = obj.radius_of_gyration
    kinds = {
        "position": ([error.position for error in errors], "mm", MM),
        "angle": ([error.angle for error in errors], "°", DEGREES),
        "cell": ([error.cell for error in errors], "mm", MM),
        f"combined, rho {rho * MM:.1f} mm": ([error.combined(rho) for error in errors], "mm", MM),
    }
    return [
        ErrorSummary(
            name=name,
            mean=float(np.mean(values)),
            median=float(np.median(values)),
            p90=float(np.quantile(values, P90)),
            pushes=len(values),
            unit=unit,
            scale=scale,
        )
        for name, (values, unit, scale) in kinds.items()
        if values
    ]


def calc_training_errors(result: Identification, log: PushLog) -> tuple[float, float]:
    """Calculates how far off the final poses of the pushes learned from are predicted.

    Returns:
        Mean cell errors, m: with uniform parameters, as before any push, and as learned.
    """
    used = _select_used(result, log)
    uniform = CellParameters.uniform(result.obj)
    before = calc_mean_cell_error(result.obj, uniform, used, result.physics)
    after = calc_mean_cell_error(result.obj, result.params, used, result.physics)
    return before, after


def doubt_fit(result: Identification) -> str | None:
    """Says in sentences why a model should not be trusted; None where nothing speaks against it.

    That is a model that explains too little of the pushes it was learned from (its status is then
    "explains_little"), and a center of friction too far from the center of mass told.
    """
    if not result.push_names:
        return None
    poor = result.status == IdentificationStatus.EXPLAINS_LITTLE
    doubts = (result.message if poor else None, doubt_center(result))
    return " ".join(filter(None, doubts)) or None


def judge_fit(result: Identification, used: PushLog) -> tuple[IdentificationStatus, str] | None:
    """Says that a model is far off where pushes ended, or no better than an even object.

    Args:
        result: the model; the regime of its physics is not "auto".
        used: the pushes that it was learned from, without what was refused of them.

    Returns:
        The status that it deserves, and why, in sentences; None where nothing is wrong with it.
    """
    if not len(used):
        return None
    obj = result.obj
    physics = result.physics

    # How far the pushes moved the object's cells on average: what a model without any skill, by
    # which nothing moves, would be off by.
    moved = []
    for seen in used:
        cells = obj.cells_at([seen.pose, seen.final_pose])
        moved.append(np.linalg.norm(np.diff(cells, axis=0), axis=2).mean())
    mean = float(np.mean(moved))

    # By how much the model is off, in the same measure, and by how much an even object is.
    error = _calc_mean_error(obj, result.params, used, physics)
    even = _calc_mean_error(obj, CellParameters.uniform(obj), used, physics)
    off = (
        f"it is off by {error * MM:.1f} mm on average, an even object by {even * MM:.1f} mm, "
        f"while the object moves by {mean * MM:.1f} mm."
    )
    if error > DOUBTFUL * mean or error > even + result.noise_std:
        return (
            IdentificationStatus.EXPLAINS_LITTLE,
            f"This model explains these pushes poorly: {off} "
            "Is object_theta in rad and counterclockwise, are all poses in one frame, "
            f"and are all pushes of {obj.name} and its outline right?",
        )
    if error > even:
        return (
            IdentificationStatus.PRIOR_KEPT,
            f"This model predicts these pushes no better than an even object would: {off}",
        )
    return None


def _calc_mean_error(
    obj: GridObject, params: CellParameters, log: PushLog, physics: Physics
) -> float:
    """Mean cell error of a log's final poses, m; the regime of the physics is not "auto"."""
    predictions = [_predict_push(obj, params, seen, physics, log.table) for seen in log]
    errors = calc_final_errors(obj, predictions, log)
    return float(np.mean([each.cell for each in errors if each is not None]))


def doubt_center(result: Identification) -> str | None:
    """Says that the center of friction is too far from the center of mass that was told.

    Returns:
        The sentences; None where both agree, or no center of mass was told.
    """
    told = CenterOfMass.of_prior(result.obj.prior)
    z = result.posterior.mean
    if told is None:
        return None
    # In standard deviations: frictions that scatter move the center of friction, too (section 4).
    off, _ = told.linearize(result.obj, z, told.make_whitening(result.obj, z)[0])
    if np.linalg.norm(off) < CONTRADICTED:
        return None
    x, y = told.at
    distance = float(np.linalg.norm(result.identifiability.center_of_friction - told.at))
    return (
        f"The pushes put the center of friction {distance * MM:.1f} mm "
        f"from the center of mass that was told, [{x:g}, {y:g}] m. Is center_of_mass.at right?"
    )


def calc_mean_cell_error(
    obj: GridObject, params: CellParameters, log: PushLog, physics: Physics
) -> float:
    """Mean cell error of a log's final poses, m; NaN where it has no push."""
    errors = calc_final_errors(obj, predict(obj, params, log, physics=physics), log)
    if not len(log):
        return nan
    return float(np.mean([error.cell for error in errors if error is not None]))


def _select_used(result: Identification, log: PushLog) -> PushLog:
    """Selects the pushes learned from, without what was refused of them."""
    used = remove_outliers(log, result.outliers)
    return used.subset([i for i, seen in enumerate(used) if seen.name in result.push_names])

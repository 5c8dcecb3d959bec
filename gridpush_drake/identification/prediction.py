"""Predicting a log's pushes with a model, and how far off that is, push by push and over the whole log."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import f

from gridpush_drake.dynamics.physics import Physics, Regime, make_physics
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.identification.map_fit import CenterOfMass
from gridpush_drake.identification.noise import NORMAL
from gridpush_drake.identification.outliers import remove_outliers
from gridpush_drake.identification.problem import PushProblem, TimedPush, resolve_physics
from gridpush_drake.identification.result import Identification, IdentificationStatus
from gridpush_drake.notebook import DEGREES, MM, describe_pose, draw_paths, make_page
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.plausibility import check_plausible
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

P90 = 0.9
"""Share of the errors that are below the last figure of a summary."""

DOUBTFUL = 0.2
"""Of how far the object moves, an error of the pushes learned from that is too large for their
model."""

CONTRADICTED = 4.0
"""Standard deviations of the center of friction from a center of mass, beyond which the pushes
contradict that."""

INTERVAL = 0.9
"""Probability of a predicted interval."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """One push, predicted.

    Attributes:
        name: of the push.
        times: (T+1,) s from its beginning.
        poses: (T+1, 3) predicted q = (x, y, theta), m and rad, world frame.
        at_observations: (K, 3) predicted poses at the times the log observed one.
        status: of the simulation.
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
        position: |dxy| of the body frame's origin, m.
        angle: |dtheta|, rad.
        cell: mean distance of the cells' centers, m (the paper's ADD).
    """

    position: float
    angle: float
    cell: float

    def combined(self, radius: float) -> float:
        """|dxy| + radius |dtheta|, m."""
        return self.position + radius * self.angle


def predict(
    obj: GridObject,
    params: CellParameters,
    log: PushLog,
    regime: Regime | None = None,
    *,
    physics: Physics | None = None,
) -> list[Prediction]:
    """Predicts every push of a log from its first observed pose.

    Args:
        obj: the object.
        params: the model.
        log: pushes, with or without later observations.
        regime: takes the place of the one in `physics`. "auto", the default, is the one that suits
            the log's fastest push, for all of them.
        physics: of the simulations, such as `Identification.physics`; `Physics()` by default.

    Returns:
        One prediction a push.

    Raises:
        PushLogError: the log cannot be true of the object, see `pushes.plausibility`.
    """
    check_plausible(obj, log, learning=False)
    used = resolve_physics(make_physics(physics, regime), obj, log, params)
    return [_predict_push(obj, params, push, used, log.table) for push in log]


@dataclass(frozen=True, eq=False)
class Spread:
    """How far a push's predicted final pose may be off.

    Attributes:
        name: of the push.
        std: (3,) of the cells' centroid, x and y, m, world frame, and of theta, rad.
        cell_error: below which the cell error is with probability INTERVAL, m.
    """

    name: str
    std: Array
    cell_error: float

    def __repr__(self) -> str:
        """Name and how far off the end may be, in a line."""
        x, y, theta = self.std
        return (
            f"Spread of {self.name!r}: ± {x * MM:.1f} mm, ± {y * MM:.1f} mm, ± {theta * DEGREES:.1f}°; cell error "
            f"below {self.cell_error * MM:.1f} mm with probability {INTERVAL:g}"
        )


def predict_spread(
    model: Identification, log: PushLog, physics: Physics | None = None
) -> list[Spread]:
    """Predicts how far the final poses of a log's pushes may be off: J S J^T + Sigma, S what is left open of z.

    The error is Student's t, with the freedom that the pushes learned from leave it, and
    `interval_scale` as wide.

    Args:
        model: what was learned, with its posterior, and the noise that its pushes showed.
        log: pushes, with or without later observations.
        physics: of the simulations; the model's by default.

    Returns:
        One spread a push.
    """
    obj, noise = model.obj, model.noise
    ends = [
        ObservedPush(
            seen.name, seen.push, seen.pose, np.array([seen.push.duration]), np.zeros((1, 3))
        )
        for seen in log
    ]  # in the axes of the pose given as the final one, here the world's
    problem = PushProblem(
        obj, PushLog(tuple(ends), table=log.table), model.params, physics or model.physics
    )
    linear = problem.linearize(model.posterior.mean)
    scale2, freedom, found = model.interval_scale**2, noise.calc_freedom(len(model.push_names)), []
    for seen, J, inputs in zip(log, linear.by_z, linear.by_inputs, strict=True):
        covariance = J @ model.posterior.covariance @ J.T + noise.calc_covariance(
            inputs, model.noise_scale
        )
        covariance *= scale2
        std = np.sqrt(np.diag(covariance)) / (1.0, 1.0, obj.radius_of_gyration)
        found.append(Spread(seen.name, std, calc_norm_quantile(covariance, freedom)))
    return found


def calc_norm_quantile(covariance: Array, freedom: float = NORMAL) -> float:
    """Quantile INTERVAL of |r|, r Student's t, |r|² taken for a scaled F with the normal's first two moments."""
    values = np.linalg.eigvalsh(covariance)
    numbers = values.sum() ** 2 / (values**2).sum()
    return float(np.sqrt(values.sum() * f.ppf(INTERVAL, numbers, freedom)))


def calc_pose_error(obj: GridObject, predicted: ArrayLike, observed: ArrayLike) -> PoseError:
    """Compares two poses (3,), x, y in m and theta in rad; the angle is taken the short way round."""
    difference = np.asarray(predicted, dtype=np.float64) - np.asarray(observed, dtype=np.float64)
    angle = abs(wrap_angle(difference[2]))
    cells = obj.cells_at(predicted) - obj.cells_at(observed)
    return PoseError(
        float(np.hypot(difference[0], difference[1])),
        float(angle),
        float(np.linalg.norm(cells, axis=-1).mean()),
    )


def _predict_push(
    obj: GridObject,
    params: CellParameters,
    push: ObservedPush,
    physics: Physics,
    table: Array | None,
) -> Prediction:
    timed = TimedPush.of(push, physics.regime, table)
    motion = timed.simulate(obj, params, physics)
    return Prediction(
        push.name, motion.times, motion.poses, motion.poses[timed.rows], motion.status
    )


@dataclass(frozen=True)
class ErrorSummary:
    """One kind of error over several pushes.

    Attributes:
        name: which.
        mean: in m or rad, as are the other two.
        median: half the pushes are below.
        p90: nine in ten are below.
        pushes: how many.
        unit: to show it in, "mm" or "°".
        scale: of that unit: so many of it make a m or a rad.
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
    """Sums up the errors of final poses: position, angle, cell, and combined: |dxy| + rho |dtheta|.

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
            name, float(np.mean(values)), float(np.median(values)), float(np.quantile(values, P90)), len(values),
            unit, scale,
        )
        for name, (values, unit, scale) in kinds.items()
        if values
    ]  # fmt: skip


def calc_training_errors(result: Identification, log: PushLog) -> tuple[float, float]:
    """Mean cell error, m, of the final poses of the pushes learned from: with uniform parameters, and as learned."""
    used = _select_used(result, log)
    before, after = (
        calc_mean_cell_error(result.obj, params, used, result.physics)
        for params in (CellParameters.uniform(result.obj), result.params)
    )
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


def explain_poor_fit(
    obj: GridObject, params: CellParameters, used: PushLog, physics: Physics
) -> str | None:
    """Says in sentences that a model is far off where pushes ended; None where it is not.

    Args:
        obj: the object.
        params: the model.
        used: the pushes that it was learned from, without what was refused of them.
        physics: of the simulations; its regime is not "auto".
    """
    if not len(used):
        return None
    moved = [
        np.linalg.norm(np.diff(obj.cells_at([seen.pose, seen.final_pose]), axis=0), axis=2).mean()
        for seen in used
    ]
    mean = float(np.mean(moved))
    predictions = [_predict_push(obj, params, seen, physics, used.table) for seen in used]
    errors = calc_final_errors(obj, predictions, used)
    error = float(np.mean([each.cell for each in errors if each is not None]))
    if error <= DOUBTFUL * mean:
        return None
    return (
        f"This model explains these pushes poorly: it is off by {error * MM:.1f} mm on average, while the object moves "
        f"by {mean * MM:.1f} mm. Is object_theta in rad and counterclockwise, are all poses in one frame, and are all "
        f"pushes of {obj.name} and its outline right?"
    )


def doubt_center(result: Identification) -> str | None:
    """Says that the center of friction is too far from the center of mass told; None where that agrees."""
    told, z = CenterOfMass.of_prior(result.obj.prior), result.posterior.mean
    if told is None:
        return None
    off, _ = told.linearize(result.obj, z, told.make_whitening(result.obj, z)[0])
    if np.linalg.norm(off) < CONTRADICTED:
        return None
    x, y = told.at
    distance = float(np.linalg.norm(result.identifiability.center_of_friction - told.at))
    return (
        f"The pushes put the center of friction {distance * MM:.1f} mm from the center of mass that was told, "
        f"[{x:g}, {y:g}] m. Is center_of_mass.at right?"
    )


def calc_mean_cell_error(
    obj: GridObject, params: CellParameters, log: PushLog, physics: Physics
) -> float:
    """Mean cell error of a log's final poses, m; NaN where it has no push."""
    errors = calc_final_errors(obj, predict(obj, params, log, physics=physics), log)
    return (
        float(np.mean([error.cell for error in errors if error is not None])) if len(log) else nan
    )


def _select_used(result: Identification, log: PushLog) -> PushLog:
    """The pushes learned from, without what was refused of them."""
    used = remove_outliers(log, result.outliers)
    return used.subset([i for i, seen in enumerate(used) if seen.name in result.push_names])

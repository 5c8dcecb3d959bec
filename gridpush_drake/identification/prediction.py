"""Predicting a log's pushes with a model, and how far off that is.

Errors are told push by push and over the whole log. How large they may be is said beforehand by
`predict_spread`, in `spread`. Nothing is learned here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.physics import Regime
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.identification.statistics.problem import TimedPush, find_fastest
from gridpush_drake.notebook import describe_pose, draw_paths, make_page
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.arguments import LOG_TYPES, PushLogOrFile, check_types, read_log
from gridpush_drake.pushes.plausibility import check_plausible
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M

SUMMARY_QUANTILE = 0.9
"""Fraction of the pushes whose errors are below the last figure of a summary."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """One push, predicted.

    Attributes:
        name: name of the push.
        times: (T+1,) s from its beginning.
        poses: (T+1, 3) predicted q = (x, y, theta), m and rad, world frame; (T+1, N, 3) of several
            objects.
        at_observations: (K, 3), or (K, N, 3), predicted poses at the times the log observed one.
        status: how the simulation ended.
    """

    name: str
    times: Array
    poses: Array
    at_observations: Array
    status: str

    def __repr__(self) -> str:
        """Name, status and where the object ends, in a line."""
        ends = "; ".join(describe_pose(pose) for pose in self.poses[-1].reshape(-1, 3))
        return f"Prediction of {self.name!r}, {self.status}: ends at {ends}"

    def _repr_html_(self) -> str:
        """The predicted path of each object."""
        several = self.poses.reshape(len(self.poses), -1, 3)
        paths = [
            (several[:, b, :2], "teal", "object's body frame") for b in range(several.shape[1])
        ]
        return make_page(repr(self), draw_paths(paths))


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
    bodies: Bodies,
    log: PushLogOrFile,
    regime: Regime | None = None,
) -> list[Prediction]:
    """Predicts every push of a log from its first observed pose.

    Args:
        bodies: the object, or the objects in the order of the log's, with parameters and physics.
        log: pushes, with or without later observations, or the name of their CSV file.
        regime: takes the place of the one in the physics. "auto", the default, is the one that
            suits the log's fastest push, for all of them.

    Returns:
        One prediction a push.

    Raises:
        PushLogError: the log cannot be true of the object, see `pushes.plausibility`, or its file
            cannot be read.
        TypeError: an argument is of another type, or they are swapped.
    """
    check_types("predict", model=(bodies, (Bodies,)), log=(log, LOG_TYPES))
    log = read_log(log, bodies.objects, require_final=False)
    if len(bodies) == 1:
        check_plausible(bodies.obj, log, learning=False)
    resolved = bodies.resolve(find_fastest(log), regime)
    return [_predict_push(resolved, push, log.table) for push in log]


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


def calc_cell_errors(
    objects: Sequence[GridObject], predicted: ArrayLike, observed: ArrayLike
) -> list[float]:
    """Calculates the cell error of each of N objects between poses (N, 3) and others, m."""
    each = zip(objects, np.asarray(predicted), np.asarray(observed), strict=True)
    return [calc_pose_error(obj, mine, theirs).cell for obj, mine, theirs in each]


def _predict_push(
    bodies: Bodies,
    push: ObservedPush,
    table: Array | None,
) -> Prediction:
    """Predicts one push; the regime of the physics is not "auto"."""
    timed = TimedPush.of(push, bodies.physics.regime, table)
    motion = timed.simulate(bodies)
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
        "position": ([error.position for error in errors], "mm", MM_PER_M),
        "angle": ([error.angle for error in errors], "°", DEG_PER_RAD),
        "cell": ([error.cell for error in errors], "mm", MM_PER_M),
        f"combined, rho {rho * MM_PER_M:.1f} mm": (
            [error.combined(rho) for error in errors],
            "mm",
            MM_PER_M,
        ),
    }
    return [
        ErrorSummary(
            name=name,
            mean=float(np.mean(values)),
            median=float(np.median(values)),
            p90=float(np.quantile(values, SUMMARY_QUANTILE)),
            pushes=len(values),
            unit=unit,
            scale=scale,
        )
        for name, (values, unit, scale) in kinds.items()
        if values
    ]


def calc_mean_cell_error(bodies: Bodies, log: PushLog) -> float:
    """Mean cell error of a log's final poses, m; NaN where it has no push."""
    return float(np.mean(calc_final_cell_errors(bodies, log))) if len(log) else nan


def calc_final_cell_errors(bodies: Bodies, log: PushLog) -> Array:
    """Cell errors (P,) of a log's final poses, m; pushes that were not seen to end are left out."""
    resolved = bodies.resolve(find_fastest(log))
    predictions = [_predict_push(resolved, seen, log.table) for seen in log]
    errors = calc_final_errors(bodies.obj, predictions, log)
    return np.array([error.cell for error in errors if error is not None])

"""Errors of predictions over a whole log, summed up."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np

from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.prediction import PoseError, Prediction, calc_pose_error, predict
from gridpush_drake.identification.result import Identification
from gridpush_drake.pushes.log import PushLog


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


def calc_final_errors(obj: GridObject, predictions: Sequence[Prediction], log: PushLog) -> list[PoseError | None]:
    """Compares each push's predicted with its observed final pose; None where the log has none."""
    return [
        calc_pose_error(obj, prediction.at_observations[-1], seen.final_pose) if len(seen.poses_observed) else None
        for prediction, seen in zip(predictions, log, strict=True)
    ]


def summarise_errors(obj: GridObject, predictions: Sequence[Prediction], log: PushLog) -> list[ErrorSummary]:
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
        "position": ([error.position for error in errors], "mm", 1e3),
        "angle": ([error.angle for error in errors], "°", 180 / np.pi),
        "cell": ([error.cell for error in errors], "mm", 1e3),
        f"combined, rho {rho * 1e3:.1f} mm": ([error.combined(rho) for error in errors], "mm", 1e3),
    }
    return [
        ErrorSummary(
            name, float(np.mean(values)), float(np.median(values)), float(np.quantile(values, 0.9)), len(values),
            unit, scale,
        )
        for name, (values, unit, scale) in kinds.items()
        if values
    ]  # fmt: skip


def calc_training_errors(result: Identification, log: PushLog) -> tuple[float, float]:
    """Mean cell error, m, of the final poses of the pushes learned from: with uniform parameters, and as learned."""
    used = log.subset([i for i, seen in enumerate(log) if seen.name in result.push_names])
    before, after = (
        calc_mean_cell_error(result.obj, params, used, result.regime)
        for params in (CellParameters.uniform(result.obj), result.params)
    )
    return before, after


def calc_mean_cell_error(obj: GridObject, params: CellParameters, log: PushLog, regime: str) -> float:
    """Mean cell error of a log's final poses, m; NaN where it has no push."""
    errors = calc_final_errors(obj, predict(obj, params, log, regime), log)
    return float(np.mean([error.cell for error in errors if error is not None])) if len(log) else nan

"""Predicting a log's pushes with a model, and how far off that is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.simulate import simulate
from gridpush_drake.dynamics.time_grid import make_path_times
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.pushes.log import ObservedPush, PushLog
from gridpush_drake.pushes.plausibility import check_plausible

Array = NDArray[np.float64]


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


@dataclass(frozen=True)
class PoseError:
    """How far a predicted pose is from an observed one.

    Attributes:
        position: |dxy| of the body frame's origin, m.
        angle: |dtheta|, rad.
        cell: mean distance of the cells' centres, m (the paper's ADD).
    """

    position: float
    angle: float
    cell: float

    def combined(self, radius: float) -> float:
        """|dxy| + radius |dtheta|, m."""
        return self.position + radius * self.angle


def predict(obj: GridObject, params: CellParameters, log: PushLog, regime: str = "quasi_static") -> list[Prediction]:
    """Predicts every push of a log from its first observed pose.

    Args:
        obj: the object.
        params: the model.
        log: pushes, with or without later observations.
        regime: of the simulation, see `simulate`.

    Returns:
        One prediction a push.

    Raises:
        PushLogError: the log cannot be true of the object, see `pushes.plausibility`.
    """
    check_plausible(obj, log, learning=False)
    return [_predict_push(obj, params, push, regime) for push in log]


def calc_pose_error(obj: GridObject, predicted: ArrayLike, observed: ArrayLike) -> PoseError:
    """Compares two poses (3,), x, y in m and theta in rad; the angle is taken the short way round."""
    difference = np.asarray(predicted, dtype=np.float64) - np.asarray(observed, dtype=np.float64)
    angle = abs((difference[2] + np.pi) % (2 * np.pi) - np.pi)
    cells = obj.cells_at(predicted) - obj.cells_at(observed)
    return PoseError(
        float(np.hypot(difference[0], difference[1])), float(angle), float(np.linalg.norm(cells, axis=-1).mean())
    )


def _predict_push(obj: GridObject, params: CellParameters, push: ObservedPush, regime: str) -> Prediction:
    grid = np.union1d(make_path_times(push.push, regime), push.t_observed)
    simulation = simulate(obj, params, push.push, push.pose, times=grid, regime=regime)  # type: ignore[arg-type]
    at = np.searchsorted(grid, push.t_observed)
    return Prediction(push.name, simulation.times, simulation.poses, simulation.poses[at], simulation.status)

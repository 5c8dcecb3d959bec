"""Made logs: a block with a heavy end, pushed in simulation, and logs in other frames."""

from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import compose, invert
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

OUTLINE = [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]
HEAVY_END = [[0.02, -0.03], [0.06, -0.03], [0.06, 0.03], [0.02, 0.03]]
RADIUS = 0.005
OBSERVED_EVERY = 10
"""Steps."""


@dataclass(frozen=True)
class PushedBlock:
    """The block, what it really weighs, how it was pushed, and what a search starts from."""

    obj: GridObject
    truth: CellParameters
    log: PushLog

    @property
    def start(self) -> CellParameters:
        return CellParameters.uniform(self.obj, total_mass=self.truth.total_mass)


def make_pushed_block(max_cells: int = 8) -> PushedBlock:
    """Three pushes at 0.05 m/s for 1 s, onto the long sides and an end."""
    obj = GridObject.from_outline(OUTLINE, parts={2: HEAVY_END}, max_cells=max_cells, name="block")
    truth = CellParameters.by_part(obj, {1: 0.02, 2: 0.1})
    gap = 0.03 + RADIUS
    pushes = [
        Push(np.array([-0.02, gap]), np.array([0.0, -0.05]), 1.0, RADIUS),
        Push(np.array([0.04, -gap]), np.array([0.0, 0.05]), 1.0, RADIUS),
        Push(np.array([0.06 + RADIUS, 0.015]), np.array([-0.05, 0.0]), 1.0, RADIUS),
    ]
    return PushedBlock(
        obj, truth, PushLog(tuple(_observe(obj, truth, i, push) for i, push in enumerate(pushes)))
    )


def _observe(obj: GridObject, truth: CellParameters, i: int, push: Push) -> ObservedPush:
    times = make_path_times(push, "inertial")
    poses = simulate(Model(obj, truth), push, times=times, regime="inertial").poses
    rows = slice(OBSERVED_EVERY, None, OBSERVED_EVERY)
    return ObservedPush(f"push_{i}", push, poses[0], times[rows], poses[rows])


def log_elsewhere(log: PushLog, frame: np.ndarray) -> PushLog:
    """Logs the same pushes in a frame of the object in which the outline's is at `frame`."""
    back = invert(frame)
    pushes = [
        replace(
            seen,
            pose=compose(seen.pose, back),
            poses_observed=compose(seen.poses_observed, back),
        )
        for seen in log
    ]
    return replace(log, pushes=tuple(pushes))

"""A push that was chosen, and what the model expects of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.grid.object import GridObject

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlannedPush:
    """One push of a plan, by its parameters, as a motion, and with its predicted outcome.

    Attributes:
        arc_length: where on the exterior outline the disc touches, m (see `Push.on_outline`).
        angle: of the motion from the inward normal there, rad, counterclockwise.
        distance: of the motion, the clearance included, m.
        push: the disc's motion, world frame.
        pose: (3,) predicted pose q_W of the object at the push's end, m and rad.
        cost: mean distance of the cells' centres at `pose` from where they are at the goal pose, m.
        simulations: simulated pushes that the choice took.
    """

    arc_length: float
    angle: float
    distance: float
    push: Push
    pose: Array
    cost: float
    simulations: int


def calc_goal_error(obj: GridObject, pose: ArrayLike, goal: ArrayLike) -> Array:
    """Mean distance of the cells' centres between poses (..., 3) and one goal pose (3,), (...,) m (the paper's ADD)."""
    difference = obj.cells_at(pose) - obj.cells_at(goal)
    return np.asarray(np.hypot(difference[..., 0], difference[..., 1]).mean(axis=-1))

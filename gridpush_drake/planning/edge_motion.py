"""Pushes of an object that may hang over the table's edge, up to where it falls.

`simulate_near_edge` follows a push by one model, as exactly as all simulations. `follow_near_edge`
follows it by many models, which are only compared: in steps twice as long, and with each step
solved only as well as `PushBatch` does it where poses may be approximate. At the ends of pushes of
up to 15 cm the mean cell error of that was at most 0.16 mm (`docs/measurements/speed.md`). The
loads of an overhanging object are `dynamics.kernels.support_loads`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.model_batch import simulate_models
from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.dynamics.push import DEFAULT_TIP_STEP, Push, make_path_times
from gridpush_drake.dynamics.simulation import calc_loads, simulate
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface

COMPARED_TIP_STEP = 2 * DEFAULT_TIP_STEP
"""Longest way of the pusher in a step, where a push is followed by many models, m."""


@dataclass(frozen=True, eq=False)
class EdgeMotion:
    """What became of an object pushed near the edge.

    Attributes:
        poses: (K, 3) X_WB along the push, the first before it, m and rad; the last one is where the
            object fell, if it did.
        traveled: (K,) length of the pusher's path up to each pose, m.
        fell: whether the object fell off the table.
    """

    poses: Array
    traveled: Array
    fell: bool

    @property
    def final_pose(self) -> Array:
        """(3,) the last pose."""
        return self.poses[-1]


def simulate_near_edge(
    model: Bodies,
    push: Push,
    pose: ArrayLike,
    surface: SupportSurface,
) -> EdgeMotion:
    """Simulates a slow push of an object that may hang over the edge, up to where it falls.

    Args:
        model: one object, with its parameters and physics; the regime is quasi-static in any case.
        push: the push.
        pose: (3,) where it lies, X_WB, m and rad.
        surface: the table.

    Returns:
        The motion.
    """
    model = model.with_physics(model.physics.with_regime("quasi_static"))
    q = np.asarray(pose, dtype=np.float64)
    # Without loads that bear it, the object falls where it lies.
    if calc_loads(model, q, surface.corners) is None:
        return EdgeMotion(poses=q[None].copy(), traveled=np.zeros(1), fell=True)
    times = make_path_times(push, model.physics.regime)
    traveled = push.distance_at(times)
    motion = simulate(model, push, q, times=times, table=surface.corners)
    fell = bool(motion.tips.any())
    # The simulation says of every step whether the object tips in it, but not of the last pose.
    if not fell and calc_loads(model, motion.final_pose, surface.corners) is None:
        return EdgeMotion(poses=motion.poses, traveled=traveled, fell=True)
    count = int(np.argmax(motion.tips)) + 1 if fell else len(times)
    return EdgeMotion(poses=motion.poses[:count], traveled=traveled[:count], fell=fell)


@dataclass(frozen=True, eq=False)
class EdgeMotions:
    """What became of an object pushed near the edge, by each of M models.

    Attributes:
        poses: (M, C, 3) X_WB at C places along the push, m and rad; without meaning from where the
            object fell.
        counts: (M,) number of places, from the first on, at which it has not fallen.
    """

    poses: Array
    counts: IntArray


def follow_near_edge(
    obj: GridObject,
    models: Sequence[CellParameters],
    push: Push,
    pose: ArrayLike,
    surface: SupportSurface,
    places: Array,
    physics: Physics = QUASI_STATIC,
    tip_step: float = COMPARED_TIP_STEP,
) -> EdgeMotions:
    """Follows a slow push of an object that may hang over the edge, by each of M models.

    Args:
        obj: the object.
        models: its masses and frictions, by each model.
        push: the push.
        pose: (3,) where the object lies, X_WB, m and rad.
        surface: the table.
        places: (C,) lengths of the pusher's path at which the poses are wanted, ascending, m.
        physics: of the simulation, quasi-static.
        tip_step: longest way of the pusher in a step, m.

    Returns:
        The motions.
    """
    times = make_path_times(push, physics.regime, tip_step)
    traveled = push.distance_at(times)
    made = simulate_models(
        obj,
        models,
        push,
        pose,
        times=times,
        physics=physics,
        table=surface.corners,
        approximate=True,
    )
    # Linear between the steps. The last place is where the push ends.
    after = np.clip(np.searchsorted(traveled, places), 1, len(times) - 1)
    fraction = (places - traveled[after - 1]) / (traveled[after] - traveled[after - 1])
    fraction = np.clip(fraction, 0.0, 1.0)[:, None]
    poses = (1.0 - fraction) * made.poses[:, after - 1] + fraction * made.poses[:, after]
    # A model's object lies on the table at all places before the step in which it falls.
    fell_at = np.append(traveled, np.inf)[made.upright]
    counts = np.searchsorted(places, fell_at, side="left")
    return EdgeMotions(poses=poses, counts=counts)

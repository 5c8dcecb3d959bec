"""A push near the table's rim: the loads that the cells bear follow what still lies on the table.

While all of the object is on the table this is `simulate`, quasi-static. Once some of it hangs over, the push is cut
into short pieces; before each, the loads are calculated anew (`edge_loads`), and with them the friction of every cell.
The object falls where no loads can hold it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulate import simulate
from gridpush_drake.dynamics.time_grid import make_path_times
from gridpush_drake.errors import PlanningError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.planning.edge_loads import calc_edge_loads
from gridpush_drake.planning.held_cells import find_held
from gridpush_drake.planning.surface import SupportSurface

Array = NDArray[np.float64]

PIECE = 0.003
"""m of the pusher's path between calculations of the loads."""

NO_LOAD = 1e-9
"""Share of the total mass that a cell without a load is given, for masses must be positive."""


@dataclass(frozen=True, eq=False)
class EdgeMotion:
    """What became of the object.

    Attributes:
        poses: (K, 3) along the push, the first before it, m and rad.
        travelled: (K,) m of the pusher's path at each.
        fell: whether the object fell off the table; the poses end where it did.
    """

    poses: Array
    travelled: Array
    fell: bool

    @property
    def final_pose(self) -> Array:
        """(3,) the last pose."""
        return self.poses[-1]


def is_held(obj: GridObject, params: CellParameters, pose: ArrayLike, surface: SupportSurface) -> bool:
    """Whether an object at rest at a pose (3,) stays on the table."""
    return calc_edge_loads(obj, params.mass, find_held(obj, pose, surface)) is not None


def simulate_near_edge(
    obj: GridObject,
    params: CellParameters,
    push: Push,
    pose: ArrayLike,
    surface: SupportSurface,
    piece: float = PIECE,
) -> EdgeMotion:
    """Simulates a slow push of an object that may hang over the rim.

    Args:
        obj: the object.
        params: its cells' masses and frictions.
        push: the pusher's motion.
        pose: (3,) X_WB at the beginning, m and rad.
        surface: the table.
        piece: m of the pusher's path between calculations of the loads.

    Returns:
        The motion.

    Raises:
        PlanningError: `piece` is not positive.
    """
    if not (np.isfinite(piece) and piece > 0):
        raise PlanningError(f"piece is {piece!r}; expected a positive number (m)")
    q = np.array(pose, dtype=np.float64)
    times = make_path_times(push, "quasi_static")
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(push.tip_at(times), axis=0), axis=1)))
    whole = simulate(obj, params, push, q, times=times, regime="quasi_static")
    on_table = find_held(obj, whole.poses, surface).all(axis=1)
    if on_table.all():
        return EdgeMotion(whole.poses, travelled, False)
    # up to here nothing hangs over; go on from there in pieces
    first = max(int(np.argmin(on_table)) - 1, 0)
    poses, done, q = [whole.poses[: first + 1]], [travelled[: first + 1]], whole.poses[first]
    while first < len(times) - 1:
        load = calc_edge_loads(obj, params.mass, find_held(obj, q, surface))
        if load is None:
            return EdgeMotion(np.concatenate(poses), np.concatenate(done), True)
        last = min(max(int(np.searchsorted(travelled, travelled[first] + piece)), first + 1), len(times) - 1)
        part = Push.along(times[first : last + 1], push.tip_at(times[first : last + 1]), push.radius)
        loaded = CellParameters(
            np.maximum(load, NO_LOAD * load.sum()), params.friction, params.contact_friction
        )  # fmt: skip
        motion = simulate(obj, loaded, part, q, times=times[first : last + 1] - times[first], regime="quasi_static")
        poses.append(motion.poses[1:])
        done.append(travelled[first + 1 : last + 1])
        q, first = motion.final_pose, last
    fell = not is_held(obj, params, q, surface)
    return EdgeMotion(np.concatenate(poses), np.concatenate(done), fell)

"""`simulate_models`: one push of one object, simulated with the parameters of many models.

It is for decisions that compare what a push does by the draws of a posterior, on a table with an
edge. Many pushes by one model after another are `push_batch`'s.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernel_call import calc_reach, find_rest_loads, run_models
from gridpush_drake.dynamics.kernels.inputs import Load
from gridpush_drake.dynamics.kernels.support_loads import measure_depth
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push, measure_steps
from gridpush_drake.dynamics.scene.simulation import simulate_one
from gridpush_drake.dynamics.simulation import find_edges_near
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, IntArray, check_vector
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters


class ModelMotions(NamedTuple):
    """Motions of one object under one push, by each of M models.

    Attributes:
        poses: (M, T+1, 3) q at the steps' times, m and rad.
        upright: (M,) number of poses, from the first on, in which the object does not tip; T+1
            where it never does.
    """

    poses: Array
    upright: IntArray


def simulate_models(
    obj: GridObject,
    models: Sequence[CellParameters],
    push: Push,
    pose: ArrayLike,
    *,
    times: Array,
    physics: Physics,
    table: ArrayLike | None = None,
    approximate: bool = False,
) -> ModelMotions:
    """Simulates one slow push with each of M models.

    Args:
        obj: the object.
        models: its masses and frictions, by each model.
        push: the push.
        pose: (3,) q of the object at the beginning, m and rad.
        times: (T+1,) the steps' times, s from the push's beginning.
        physics: quasi-static.
        table: (K, 2) corners in W of the table's top, m; endless by default.
        approximate: whether poses may be off as much as `PushBatch` says, which takes less time.

    Returns:
        The motions.

    Raises:
        SimulationError: the physics is not quasi-static, or the object is not on the table.
    """
    if physics.regime != "quasi_static":
        raise SimulationError(f"regime is {physics.regime!r}; expected 'quasi_static'")
    q = check_vector(SimulationError, "pose", pose, 3)
    edges = find_edges_near(obj, push, q, table, inertial=False)
    if push.shape is not None:
        # by the kernel of several contacts, one model after another
        motions = [
            simulate_one(Bodies(obj, params, physics), push, q, times=times, edges=edges)
            for params in models
        ]
        steps = len(times) - 1
        poses = np.array([motion.poses for motion in motions]).reshape(-1, steps + 1, 3)
        tips = np.array([motion.tips for motion in motions], dtype=bool).reshape(-1, steps)
    else:
        load = Load(
            tip=push.tip_at(times),
            path_length=push.length,
            radius=push.radius,
            wrench=np.zeros((len(times) - 1, 3)),
            point=np.zeros(2),
        )
        poses, tips = run_models(
            obj,
            models,
            physics,
            pose=q,
            dts=measure_steps(push, times, physics.regime),
            load=load,
            table=edges,
            approximate=approximate,
        )
    upright = np.where(tips.any(axis=1), np.argmax(tips, axis=1), len(times))
    # The simulation says of every step whether the object tips in it, but not of the last pose.
    if edges is not None:
        room = calc_reach(obj) + obj.cell_size
        for m in np.flatnonzero(upright == len(times)).tolist():
            end = poses[m, -1]
            if measure_depth(edges, end[0], end[1])[0] < room:
                held = find_rest_loads(Bodies(obj, models[m], physics), end, edges)
                upright[m] -= held is None
    return ModelMotions(poses=poses, upright=upright)

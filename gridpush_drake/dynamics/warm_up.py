"""Compiling the kernels before they are needed, by tiny calls of them.

The rollout takes nearly all of the time, and Numba compiles it function by function. A second
process can compile one of the largest of them, the derivative's columns, at the same time, and
leave it in the cache: the first one finds it there when it gets so far.
"""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.compiled import compile_for, get_cache
from gridpush_drake.dynamics.kernels.forward_sensitivity import Columns, step_columns
from gridpush_drake.dynamics.kernels.inputs import Body
from gridpush_drake.dynamics.kernels.integrate_pose import PoseMaps
from gridpush_drake.dynamics.kernels.rollout import rollout, rollout_pushes
from gridpush_drake.dynamics.kernels.step_derivative import StepDerivative
from gridpush_drake.dynamics.kernels.step_start import StepStart
from gridpush_drake.dynamics.physics import Physics, Regime
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.push_batch import BatchPush, PushBatch
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.objects.grid_object import GridObject

SQUARE_SIDE = 0.02
"""Side of a small square, m."""

DISC_RADIUS = 0.005
"""Radius of the disc that pushes it, m."""

DISC_SPEED = 0.1
"""Speed of the disc, m/s."""

PUSH_DURATION = 0.02
"""Duration of the push, s."""

COMPILED_REGIMES: tuple[Regime, ...] = ("inertial", "quasi_static")


def make_square() -> GridObject:
    """Makes the smallest object, of one cell."""
    corners = [[0, 0], [SQUARE_SIDE, 0], [SQUARE_SIDE, SQUARE_SIDE], [0, SQUARE_SIDE]]
    return GridObject.from_outline(corners, max_cells=1)


def make_push() -> Push:
    """Makes a push of this object."""
    start = (-DISC_RADIUS, SQUARE_SIDE / 3)
    return Push(start, (DISC_SPEED, 0.0), PUSH_DURATION, DISC_RADIUS)


def is_compiled(*kernels: Callable[..., Any]) -> bool:
    """Whether kernels are in the cache, as it seems by the names of its files.

    Args:
        kernels: the kernels; the rollouts of pushes by a disc if none is named.
    """
    return all(get_cache(each).list_files() for each in kernels or (rollout, rollout_pushes))


def compile_rollouts() -> None:
    """Loads or compiles the kernels, by a push in each regime, by itself and in a batch."""
    obj = make_square()
    bodies = Bodies(obj)
    push = make_push()
    times = np.array([0.0, PUSH_DURATION])
    rows = np.array([1])
    for regime in COMPILED_REGIMES:
        simulate(bodies, push, gradients=True, regime=regime)
        batch = PushBatch(
            obj, [BatchPush(push, np.zeros(3), times, rows, None)], Physics(regime=regime)
        )
        batch.differentiate(bodies.params)


def compile_scenes() -> None:
    """Loads or compiles the kernels of several contacts: of two objects, a plate, fingertips."""
    obj = make_square()
    poses = np.array([[0.0, 0.0, 0.0], [2 * SQUARE_SIDE, 0.0, 0.0]])
    simulate(Bodies([obj, obj]), make_push(), poses, gradients=True)


def find_columns_signature() -> tuple[numba.types.Type, ...]:
    """The types of the arguments with which the rollout calls `step_columns`."""
    matrix = np.zeros((1, 1))
    vector = np.zeros(1)
    number = 0.0
    records = {
        "columns": Columns(*[matrix] * len(Columns._fields)),
        "n": 1,
        "body": Body(matrix, vector, *[number] * (len(Body._fields) - 2)),
        "inertial": True,
        "maps": PoseMaps(*[matrix] * len(PoseMaps._fields)),
        "derivative": StepDerivative(*[matrix] * len(StepDerivative._fields)),
        "xi": vector,
        "start": StepStart(*[number] * len(StepStart._fields)),
        "path_length": number,
        "point": vector,
        "new_x": number,
        "new_y": number,
        "H2": matrix,
    }
    return tuple(numba.typeof(value) for value in records.values())


def compile_columns() -> None:
    """Compiles the columns of the derivative, for a rollout that another process compiles."""
    compile_for(step_columns, find_columns_signature())

"""Compiling the kernels before they are needed, by tiny calls of them."""

from collections.abc import Callable
from typing import Any

import numpy as np

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.compiled import get_cache
from gridpush_drake.dynamics.kernels.rollout import rollout, rollout_pushes
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
    """Loads or compiles the kernels of one push by a disc, by one in each regime."""
    for regime in COMPILED_REGIMES:
        simulate(Bodies(make_square()), make_push(), gradients=True, regime=regime)


def compile_batches() -> None:
    """Loads or compiles the kernels of many pushes by discs, by a batch of one in each regime."""
    obj = make_square()
    times = np.array([0.0, PUSH_DURATION])
    pushes = [BatchPush(make_push(), np.zeros(3), times, np.array([1]), None)]
    for regime in COMPILED_REGIMES:
        PushBatch(obj, pushes, Physics(regime=regime)).differentiate(Bodies(obj).params)


def compile_scenes() -> None:
    """Loads or compiles the kernels of several contacts: of two objects, a plate, fingertips."""
    obj = make_square()
    poses = np.array([[0.0, 0.0, 0.0], [2 * SQUARE_SIDE, 0.0, 0.0]])
    simulate(Bodies([obj, obj]), make_push(), poses, gradients=True)

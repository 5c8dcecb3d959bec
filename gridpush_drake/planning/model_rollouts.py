"""Pushes followed by many models at once: what a decision for a push is weighed with.

A posterior is weighed by its draws: what a push does is simulated with each of them, and a decision
looks at the mean of the outcomes, or at what all but a small fraction of them keep to. Such pushes
are only compared, so that they are simulated as `PushBatch` does it where poses may be approximate.
"""

from collections.abc import Sequence
from math import floor

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.push_batch import BatchPush, PushBatch
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

WEIGHED_DRAWS = 100
"""Number of draws from a posterior that decisions are weighed with."""

ROUND_OFF = 1e-9
"""Fraction of a draw that is added before fractions are rounded down to whole draws."""


def follow_pushes(
    obj: GridObject,
    models: Sequence[CellParameters],
    pushes: Sequence[Push],
    pose: Array,
    physics: Physics,
) -> list[Array]:
    """Follows pushes from one pose by each of M models.

    Args:
        obj: the object.
        models: its masses and frictions, by each model.
        pushes: the pushes.
        pose: (3,) where the object lies, X_WB, m and rad.
        physics: of the simulations, with a regime other than "auto".

    Returns:
        Of each push the poses (M, T+1, 3) at the times that `make_path_times` gives it, m and rad.
    """
    planned = []
    for push in pushes:
        times = make_path_times(push, physics.regime)
        planned.append(BatchPush(push, pose, times, np.arange(len(times)), None))
    batch = PushBatch(obj, planned, physics, approximate=True)
    poses = np.array([batch.simulate(params)[0] for params in models])
    return [
        poses[:, begin:end] for begin, end in zip(batch.offsets, batch.offsets[1:], strict=False)
    ]


def count_kept(held: NDArray[np.bool_]) -> IntArray:
    """Counts the steps, from the first on, at which each model keeps a rule.

    Args:
        held: (M, T), T >= 1, whether each model keeps it at each step.

    Returns:
        (M,).
    """
    return np.where(held.all(axis=1), held.shape[1], np.argmin(held, axis=1))


def count_exceptions(draws: int, confidence: float) -> int:
    """Counts how many of some draws need not keep to what the fraction `confidence` keeps to.

    With few draws it is none.
    """
    return floor((1.0 - confidence) * draws + ROUND_OFF)


def count_agreed(counts: IntArray, confidence: float) -> int:
    """Counts the steps of a push that the estimate and nearly all draws allow.

    Args:
        counts: (M,) steps that each model allows, from the first on, the estimate's first.
        confidence: fraction of the draws that must allow a step.
    """
    by_draws = np.sort(counts[1:])[count_exceptions(len(counts) - 1, confidence) :]
    return int(min(counts[0], by_draws[0])) if len(by_draws) else int(counts[0])

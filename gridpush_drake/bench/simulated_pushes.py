"""Simulated pushes of a shipped object that stand in for a real robot's, where those are not at hand.

Masses and frictions are hidden, drawn by part; every push begins at a random place of the outline, and the object is
seen with noise at its beginning and its end.
"""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gridpush_drake.bench.plant import DISTANCE, SPEED, draw_push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS, ObservedPush, PushLog

PUSHES = 50
"""A log, as many as the CMU's."""

MASS_RANGE = (0.1, 5.0)
"""Of a part's cells, kg a cell, log-uniform."""

FRICTION_RANGE = (0.2, 0.5)
"""Of a part's cells against the support."""

POSITION_STD, ANGLE_STD = 0.0005, 0.003
"""Noise of the poses that are seen, m per axis and rad."""


@lru_cache(maxsize=1)
def simulate_log(path: Path, seed: int, number: int) -> tuple[PushLog, GridObject]:
    """Simulates a log, quasi-static.

    Args:
        path: of the object.
        seed: of everything random.
        number: of the log; the hidden parameters, pushes and noise of each are its own.

    Returns:
        The pushes as seen, and the object as whoever learns sees it: one part of unknown mass.

    Raises:
        ObjectError: the file cannot be read.
        PushError: hardly any push moves the object.
    """
    obj = GridObject.from_yaml(path)
    rng = np.random.default_rng([seed, number])
    truth_seed, first = (int(value) for value in rng.integers(2**31, size=2))
    truth = CellParameters.random(obj, truth_seed, MASS_RANGE, FRICTION_RANGE)
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    noise = np.array([POSITION_STD, POSITION_STD, ANGLE_STD])
    pushes = []
    for i in range(PUSHES):
        push, pose = draw_push(obj, truth, first + i, radius)
        last = simulate(obj, truth, push, pose, regime="quasi_static").final_pose
        before, after = (at + noise * rng.standard_normal(3) for at in (pose, last))
        pushes.append(ObservedPush(f"push_{i + 1:02d}", push, before, np.array([push.duration]), after[None]))
    prior = replace(obj.prior, total_mass=None)
    plain = GridObject(obj.name, obj.p_BC, obj.cell_size, np.ones_like(obj.labels), obj.outline, prior)
    return PushLog(tuple(pushes), source=f"{obj.name}, simulated, number {number}"), plain


def describe_pushes() -> str:
    """How the pushes are made, in a sentence."""
    return (
        f"Simulated by our own model: hidden masses and frictions by part, {PUSHES} pushes of {100 * DISTANCE:g} cm at "
        f"{100 * SPEED:g} cm/s from random places, poses seen with {1e3 * POSITION_STD:g} mm and {ANGLE_STD:g} rad of "
        "noise."
    )

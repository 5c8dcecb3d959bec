"""Pokes of an object with hidden parameters, simulated, with seeded noise on the observed poses."""

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog


def make_pokes(
    obj: GridObject,
    truth: CellParameters,
    count: int,
    seed: int,
    *,
    length: float = 0.05,
    observations: int = 5,
    noise: tuple[float, float] = (0.0, 0.0),
    radius: float = 0.008,
    regime: str = "quasi_static",
) -> PushLog:
    """Pushes inwards from random places of the outline, off the normal by up to half a radian."""
    rng = np.random.default_rng(seed)
    pushes = []
    for i in range(count):
        point, _, normal = obj.edges.at(rng.uniform(0, obj.edges.perimeter))
        angle = rng.uniform(-0.5, 0.5)
        c, s = np.cos(angle), np.sin(angle)
        direction = np.array([[c, -s], [s, c]]) @ -normal
        push = Push(point + normal * (radius + 0.001), 0.02 * direction, length / 0.02, radius)
        times = np.linspace(0, push.duration, observations + 1)
        grid = np.linspace(0, push.duration, 20 * observations + 1)
        simulation = simulate(Model(obj, truth), push, times=grid, regime=regime)
        poses = simulation.poses[::20][1:] + rng.normal(size=(observations, 3)) * [
            noise[0],
            noise[0],
            noise[1],
        ]
        pushes.append(ObservedPush(f"poke_{i}", push, np.zeros(3), times[1:], poses))
    return PushLog(tuple(pushes))

"""Pushes of an object with a hidden truth, in the LCP model, and what a camera would have seen of them."""

from dataclasses import dataclass
from math import radians

import numpy as np
from shapely import Point

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.geometry.se2 import rotate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

TRIES = 100
"""Pushes drawn, for each that is wanted, before giving up."""


@dataclass(frozen=True)
class PushStyle:
    """How the demo pushes, and how well it sees.

    Attributes:
        shortest: path, m.
        longest: path, m.
        speed: of the pusher, m/s.
        slant: furthest from the outline's normal, rad.
        min_motion: of the cells, mean, m; pushes that move the object less are drawn again.
        samples: poses seen a push, after the first.
        position_noise: standard deviation per axis of a pose seen, m.
        angle_noise: standard deviation, rad.
    """

    shortest: float = 0.05
    longest: float = 0.08
    speed: float = 0.03
    slant: float = radians(30)
    min_motion: float = 0.01
    samples: int = 10
    position_noise: float = 0.0005
    angle_noise: float = radians(0.2)


def make_pushes(
    obj: GridObject, truth: CellParameters, count: int, seed: int, style: PushStyle | None = None
) -> PushLog:
    """Pushes the object with its hidden truth, by random places of its outline, inwards.

    Args:
        obj: the object.
        truth: what its cells weigh and how they rub.
        count: how many pushes.
        seed: of the places, directions, lengths and noise.
        style: how to push.

    Returns:
        What was seen: exact first poses, later ones with noise.

    Raises:
        PushError: hardly any push moves the object.
    """
    style = style or PushStyle()
    rng = np.random.default_rng((seed, 2))
    digits = len(str(count))
    seen: list[ObservedPush] = []
    for _ in range(TRIES * count):
        observed = _try_push(obj, truth, f"push_{len(seen) + 1:0{digits}}", rng, style)
        if observed is not None:
            seen.append(observed)
        if len(seen) == count:
            return PushLog(tuple(seen), "simulated pushes")
    raise PushError(
        f"{obj.name}: {len(seen)} of {TRIES * count} random pushes move it by {style.min_motion * 1e3:g} mm; "
        f"expected {count}: is it of a size that a disc can push by {style.shortest * 1e3:g} mm?"
    )


def _try_push(
    obj: GridObject, truth: CellParameters, name: str, rng: np.random.Generator, style: PushStyle
) -> ObservedPush | None:
    """Draws a push; None where the pusher does not fit there, or hardly moves the object."""
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    point, _, normal = obj.edges.at(rng.uniform(0, obj.edges.perimeter))
    p_BP = point + normal * radius
    turn, length = (
        rng.uniform(-style.slant, style.slant),
        rng.uniform(style.shortest, style.longest),
    )
    pose = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-np.pi, np.pi)])
    noise = rng.normal(size=(style.samples, 3)) * (
        style.position_noise,
        style.position_noise,
        style.angle_noise,
    )
    if obj.outline.distance(Point(p_BP)) < (1 - 1e-6) * radius:
        return None
    direction = rotate(turn + pose[2], -normal)
    push = Push(
        pose[:2] + rotate(pose[2], p_BP), style.speed * direction, length / style.speed, radius
    )
    motion = simulate(Model(obj, truth), push, pose)
    moved = np.linalg.norm(obj.cells_at(motion.final_pose) - obj.cells_at(pose), axis=1).mean()
    if moved < style.min_motion:
        return None
    rows = np.rint(np.linspace(0, len(motion.times) - 1, style.samples + 1)).astype(int)[1:]
    return ObservedPush(name, push, pose, motion.times[rows], motion.poses[rows] + noise)

"""Seeded random steps of the maximal LCP (moving, at rest below and above the static limit) and random pushes."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.reference.maximal_lcp import (
    MaximalLcp,
    make_maximal_lcp,
    twist_to_cells,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.random_objects import (
    make_random_object,
    make_random_parameters,
    make_random_pose,
    make_random_twist,
)

DT = 0.01
"""Time step, s."""


@dataclass(frozen=True)
class RandomStep:
    """One step's data: nu and the cells' xdot before it, F on the cells."""

    obj: GridObject
    params: CellParameters
    q: NDArray[np.float64]
    nu: NDArray[np.float64]
    F: NDArray[np.float64]

    @property
    def T(self) -> NDArray[np.float64]:
        return twist_to_cells(self.obj, self.q)

    def make_lcp(
        self, params: CellParameters | None = None, *, spanning_tree: bool = True
    ) -> MaximalLcp:
        return make_maximal_lcp(
            Model(self.obj, params or self.params),
            self.q,
            self.T @ self.nu,
            self.F,
            DT,
            spanning_tree=spanning_tree,
        )


def make_random_step(
    seed: int,
    *,
    n: int | None = None,
    speed: float = 1.0,
    force: float = 0.5,
    friction_range=(0.1, 0.8),
) -> RandomStep:
    """Speeds are multiples of 0.3 m/s; the force, on one cell, is a multiple of the object's weight."""
    rng = np.random.default_rng(seed)
    obj = make_random_object(rng, int(rng.integers(2, 20)) if n is None else n)
    params = make_random_parameters(rng, obj, friction_range=friction_range)
    q, nu = make_random_pose(rng), speed * make_random_twist(rng)
    F = np.zeros(3 * obj.n)
    i = 3 * rng.integers(obj.n)
    angle = rng.uniform(-np.pi, np.pi)
    weight = 9.81 * params.total_mass
    F[i : i + 3] = (
        force
        * weight
        * np.array([0.1 * obj.cell_size * rng.normal(), np.cos(angle), np.sin(angle)])
    )
    return RandomStep(obj, params, q, nu, F)


def make_random_push(
    rng: np.random.Generator,
    obj: GridObject,
    pose=(0.0, 0.0, 0.0),
    *,
    length: float = 0.2,
    speeds=(0.01, 0.05, 0.1),
) -> Push:
    """A straight push that starts 1 µm clear of the outline, within 1 rad of its normal; three radii as users have."""
    radius = rng.choice([0.0005, 0.005, 0.015])
    point, tangent, normal = obj.edges.at(rng.uniform(0, obj.edges.perimeter))
    angle = rng.uniform(-1, 1)
    direction = -(np.cos(angle) * normal + np.sin(angle) * tangent)
    start = point + (radius + 1e-6) * normal
    while shapely.distance(obj.outline, shapely.Point(start)) < radius:
        start = start - 0.002 * direction  # in a corner or a jaw
    c, s = np.cos(pose[2]), np.sin(pose[2])
    R, speed = np.array([[c, -s], [s, c]]), rng.choice(speeds)
    return Push(pose[:2] + R @ start, speed * R @ direction, length / speed, radius)


def make_random_contents(rng: np.random.Generator, obj: GridObject) -> CellParameters:
    """Masses of 5 to 50 g a cell, friction 0.2 to 0.6, contact friction 0.1 to 0.6."""
    return CellParameters(
        rng.uniform(0.005, 0.05, obj.n), rng.uniform(0.2, 0.6, obj.n), rng.uniform(0.1, 0.6)
    )


def refine(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Halves every step."""
    return np.sort(np.concatenate([times, (times[1:] + times[:-1]) / 2]))

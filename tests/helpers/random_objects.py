"""Seeded random grid objects, parameters, poses and velocities."""

import numpy as np
from numpy.typing import NDArray
from shapely import box, unary_union

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

NEIGHBORS = ((1, 0), (-1, 0), (0, 1), (0, -1))


def make_random_object(
    rng: np.random.Generator, n: int = 12, cell_size: float = 0.02
) -> GridObject:
    """Grows n connected square cells (side m); the body frame's origin lies off their centroid."""
    cells = [(0, 0)]
    while len(cells) < n:
        i, j = cells[rng.integers(len(cells))]
        di, dj = NEIGHBORS[rng.integers(len(NEIGHBORS))]
        if (i + di, j + dj) not in cells:
            cells.append((i + di, j + dj))
    p_BC = cell_size * (np.array(cells) + rng.uniform(-1, 1, 2))
    h = cell_size / 2 * (1 + 1e-9)
    outline = unary_union([box(x - h, y - h, x + h, y + h) for x, y in p_BC])
    return GridObject("random", p_BC, cell_size, rng.integers(1, 4, n), outline)


def make_random_parameters(
    rng: np.random.Generator,
    obj: GridObject,
    mass_range: tuple[float, float] = (0.01, 0.2),
    friction_range: tuple[float, float] = (0.1, 0.8),
) -> CellParameters:
    """Draws every cell's mass (kg, log-uniform) and friction, and the pusher's contact friction."""
    mass = np.exp(rng.uniform(*np.log(mass_range), obj.n))
    return CellParameters(mass, rng.uniform(*friction_range, obj.n), rng.uniform(0.1, 0.6))


def make_random_pose(rng: np.random.Generator) -> NDArray[np.float64]:
    """X_WB = (x, y, theta), m and rad."""
    return rng.uniform((-0.5, -0.5, -np.pi), (0.5, 0.5, np.pi))


def make_random_twist(
    rng: np.random.Generator, speed: float = 0.3, yaw_rate: float = 3.0
) -> NDArray[np.float64]:
    """nu = (vx, vy, w) of the body frame's origin, m/s and rad/s, each within +-(speed, speed, yaw_rate)."""
    return rng.uniform(-1, 1, 3) * (speed, speed, yaw_rate)

"""The pushes of `limit_surface` in NumPy, by which its compiled form is checked."""

import numpy as np
from scipy.ndimage import map_coordinates

from gridpush_drake.dynamics.kernels.friction.friction_law import calc_spin_lever_arm
from gridpush_drake.geometry.se2 import Array, rotate
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.contact_kernels import LAST_CELL, MIN_SLOPE, MIN_SPEED
from gridpush_drake.planning.contact.limit_surface import (
    PUSH_STEPS,
    DistanceTable,
    make_distance_table,
)


def look_up(table: DistanceTable, p: Array) -> tuple[Array, Array]:
    """Looks up distances (N,), m, and outward unit normals (N, 2) at points (N, 2)."""
    # Beyond the table, the values at its edge.
    cell = np.clip((p - table.corner) / table.step, 0.0, np.array(table.values.shape) - LAST_CELL)

    def interpolate(x: Array, y: Array) -> Array:
        return map_coordinates(table.values, [x, y], order=1)

    x, y = cell.T
    i, j = np.floor(cell.T)
    slope = np.column_stack(
        [
            interpolate(i + 1, y) - interpolate(i, y),
            interpolate(x, j + 1) - interpolate(x, j),
        ]
    )
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    return interpolate(x, y), slope / np.maximum(length, MIN_SLOPE)


def predict_roughly(
    obj: GridObject,
    params: CellParameters,
    start: Array,
    direction: Array,
    distance: float,
    radius: float,
) -> Array:
    """Follows N straight pushes of an object at (0, 0, 0) by the ellipsoidal limit surface.

    Args:
        obj: the object.
        params: its masses and frictions.
        start: (N, 2) p_BP of the disc's center at the beginning, m.
        direction: (N, 2) unit vectors of the motion.
        distance: length of the motion, m.
        radius: of the disc, m.

    Returns:
        (PUSH_STEPS, N, 3) poses (x, y, theta) of the body frame after each step, m and rad.
    """
    table = make_distance_table(obj, radius)
    k = params.relative_friction()  # sums to one, so that f_max = 1 and lambda = m_max
    c = k @ obj.p_BC
    arm = np.hypot(np.linalg.norm(obj.p_BC - c, axis=1), calc_spin_lever_arm(obj, params))
    inverse = 1.0 / float(k @ arm) ** 2  # 1 / lambda²
    h = distance / PUSH_STEPS
    # The center of friction of every push, and how far the body has turned.
    center = np.tile(c, (len(start), 1))
    theta = np.zeros(len(start))
    poses = np.empty((PUSH_STEPS, len(start), 3))
    for step in range(PUSH_STEPS):
        # The tip, and its motion u in this step, seen from the body; the contact below the tip.
        p_tip = rotate(-theta, start + h * step * direction - center)
        u = h * rotate(-theta, direction)
        away, outward = look_up(table, p_tip + c)
        twist = _calc_twist(
            p=p_tip - away[:, None] * outward,
            n=-outward,
            u=u,
            gap=away - radius,
            inverse=inverse,
            mu=params.contact_friction,
        )
        # The body moves along the mean of its headings before and after the step.
        center = center + rotate(theta + twist[:, 2] / 2, twist[:, :2])
        theta = theta + twist[:, 2]
        poses[step] = np.column_stack([center - rotate(theta, c), theta])
    return poses


def _calc_twist(p: Array, n: Array, u: Array, gap: Array, inverse: float, mu: float) -> Array:
    """Calculates by how much N bodies move in one step.

    Args:
        p: (N, 2) contact points, relative to the center of friction, m.
        n: (N, 2) unit normals there, into the body.
        u: (N, 2) motions of the tip, m.
        gap: (N,) between tip and body before the step, m; negative where they overlap.
        inverse: 1 / lambda², 1/m².
        mu: friction coefficient of the contact.

    Returns:
        (N, 3) displacement of the body's center of friction, m, and its turn, rad.
    """
    # How far the tip would enter the body, and its motion without the part that closes the gap.
    # Where they overlap, the body is moved out as well.
    closing = np.maximum((n * u).sum(axis=1) - gap, 0.0)
    u = u + np.minimum(0.0, -np.maximum(gap, 0.0))[:, None] * n + np.maximum(-gap, 0.0)[:, None] * n
    # Sticking: f = B^-1 u, by Sherman and Morrison.
    p_perp = np.column_stack([-p[:, 1], p[:, 0]])
    norm = 1.0 + inverse * (p**2).sum(axis=1)
    sticking = u - (inverse * (p_perp * u).sum(axis=1) / norm)[:, None] * p_perp
    # Is f outside the friction cone?
    t = np.column_stack([-n[:, 1], n[:, 0]])
    along_n = (sticking * n).sum(axis=1)
    along_t = (sticking * t).sum(axis=1)
    slides = np.abs(along_t) > mu * along_n
    # Sliding: f on the cone's edge, such that the contact moves out of the tip's way along n.
    edge = n + mu * np.sign(along_t)[:, None] * t
    speed = (edge * n).sum(axis=1)
    speed = speed + inverse * (p_perp * edge).sum(axis=1) * (p_perp * n).sum(axis=1)
    sliding = (closing / np.maximum(speed, MIN_SPEED))[:, None] * edge
    # Where the tip does not reach the body, nothing moves.
    f = np.where(slides[:, None], sliding, sticking) * (closing > 0)[:, None]
    return np.column_stack([f, inverse * (p_perp * f).sum(axis=1)])

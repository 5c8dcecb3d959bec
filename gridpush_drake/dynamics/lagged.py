"""The directions of the paper's lagged friction, one a cell (`maximal_lcp._friction_directions`, in the kernel)."""

from math import sqrt

import numpy as np

from gridpush_drake.dynamics.compiled import kernel

SPEED_AT_REST = 1e-9
"""m/s; a cell slower than this has no direction of its own."""

YAW_RATE_AT_REST = 1e-8
"""rad/s; a cell that turns more slowly has no sense of rotation of its own."""

IMPENDING_AT_REST = 1e-9
"""Share of the fastest cell's impending speed below which a cell's impending direction is undefined."""


@kernel()
def fill_lagged_directions(px, py, cx, cy, velocity, push, cell_size, dx, dy):
    """Fills in the unit directions of the cells' current velocities or, at rest, of the motion the force would start.

    Args:
        px, py: (n,) cell centres, m.
        cx, cy: centre of mass, m.
        velocity: (3,) of the centre of mass, m/s, and yaw rate, rad/s, body frame.
        push: (3,) the same that the applied force alone would give from rest.
        cell_size: m.
        dx, dy: (n,) out; zero where neither exists.

    Returns:
        The sense of rotation: -1, 0 or 1.
    """
    vx, vy, w = velocity[0], velocity[1], velocity[2]
    ux, uy, r = push[0], push[1], push[2]
    fastest = cell_size * abs(r)
    for i in range(px.shape[0]):
        x, y = px[i] - cx, py[i] - cy
        fastest = max(fastest, sqrt((ux - r * y) ** 2 + (uy + r * x) ** 2))
    slow = IMPENDING_AT_REST * fastest
    for i in range(px.shape[0]):
        x, y = px[i] - cx, py[i] - cy
        cell_x, cell_y = vx - w * y, vy + w * x
        size = sqrt(cell_x * cell_x + cell_y * cell_y)
        if size <= SPEED_AT_REST:
            cell_x, cell_y = ux - r * y, uy + r * x
            size = sqrt(cell_x * cell_x + cell_y * cell_y)
            if size <= slow:
                size = np.inf
        dx[i], dy[i] = cell_x / size, cell_y / size
    if abs(w) > YAW_RATE_AT_REST:
        return np.sign(w)
    return np.sign(r) if abs(r) > slow / cell_size else 0.0

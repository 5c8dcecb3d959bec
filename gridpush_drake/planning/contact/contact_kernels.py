"""The sums of contact search over cells and pushes, compiled.

`limit_surface` and `trial` have the equations, and the names of what is calculated here.
"""

from math import cos, sin, sqrt

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.small_matrix import solve_dense

LAST_CELL = 1.001
"""Points beyond a table are brought this many nodes inside its last one, so that the node after the
one below them exists."""

MIN_SLOPE = 1e-12
"""Least length of a gradient of the distance that a normal is made of, for it may be zero."""

MIN_SPEED = 1e-9
"""Least speed of the contact along its normal, per force, that is divided by."""


@kernel(allocates=False, fast_sums=True)
def fill_goal_errors(cells, poses, goal, errors):
    """Fills in the mean distance of the cells from where they are at the goal pose.

        p_i(q) - p_i(goal) = (dx, dy) + (R(theta) - R(theta_goal)) p_i

    Args:
        cells: (2, n) cell centers, body frame, m.
        poses: (K, 3) X_WB, m and rad.
        goal: (3,) the goal pose.
        errors: (K,) filled, m.
    """
    px = cells[0]
    py = cells[1]
    n = px.shape[0]
    for j in range(poses.shape[0]):
        dx = poses[j, 0] - goal[0]
        dy = poses[j, 1] - goal[1]
        c = cos(poses[j, 2]) - cos(goal[2])
        s = sin(poses[j, 2]) - sin(goal[2])
        total = 0.0
        for i in range(n):
            x = dx + c * px[i] - s * py[i]
            y = dy + s * px[i] + c * py[i]
            total += sqrt(x * x + y * y)
        errors[j] = total / n


@kernel(allocates=False, fast_sums=True)
def fill_cost_derivatives(cells, pose, goal, least, slope, H):
    """Fills in the derivatives of the cost by the pose, with u_i the unit vector of r_i.

        dC/dq = 1/n sum_i u_i^T dp_i/dq,     H = 1/n sum_i (dp_i/dq)^T (dp_i/dq) / |r_i|

    With a_i = p_i(q) - (x, y), which turns by z × a_i, dp_i/dq = (I, z × a_i).

    Args:
        cells: (2, n) cell centers, body frame, m.
        pose: (3,) q, X_WB, m and rad.
        goal: (3,) the goal pose.
        least: length that a shorter r_i is taken to have, m.
        slope: (3,) filled.
        H: (3, 3) filled.
    """
    px = cells[0]
    py = cells[1]
    n = px.shape[0]
    dx = pose[0] - goal[0]
    dy = pose[1] - goal[1]
    c = cos(pose[2])
    s = sin(pose[2])
    c_off = c - cos(goal[2])
    s_off = s - sin(goal[2])
    slope_x = slope_y = slope_w = 0.0
    weights = along_x = along_y = turning = 0.0
    for i in range(n):
        rx = dx + c_off * px[i] - s_off * py[i]
        ry = dy + s_off * px[i] + c_off * py[i]
        # z × a_i
        tx = -(s * px[i] + c * py[i])
        ty = c * px[i] - s * py[i]
        weight = 1.0 / max(sqrt(rx * rx + ry * ry), least)
        slope_x += weight * rx
        slope_y += weight * ry
        slope_w += weight * (rx * tx + ry * ty)
        weights += weight
        along_x += weight * tx
        along_y += weight * ty
        turning += weight * (tx * tx + ty * ty)
    slope[0] = slope_x / n
    slope[1] = slope_y / n
    slope[2] = slope_w / n
    H[0, 0] = H[1, 1] = weights / n
    H[0, 1] = H[1, 0] = 0.0
    H[0, 2] = H[2, 0] = along_x / n
    H[1, 2] = H[2, 1] = along_y / n
    H[2, 2] = turning / n


@kernel()
def solve_damped_step(H, slope, damping, least, free, limit, dx):
    """Solves (H + lambda diag H) dx = -dC/dx, and shortens dx to the limits.

    Args:
        H: (3, 3) second derivatives of the cost, about.
        slope: (3,) dC/dx.
        damping: lambda.
        least: smallest element of the diagonal that lambda multiplies, and of |dx| that a limit is
            divided by.
        free: (3,) whether each unknown may change.
        limit: (3,) greatest change of each.
        dx: (3,) filled; zero where there is no solution.

    Returns:
        By how much the cost is predicted to fall.
    """
    K = np.zeros((3, 3))
    X = np.zeros((3, 1))
    for i in range(3):
        if free[i]:
            for j in range(3):
                if free[j]:
                    K[i, j] = H[i, j]
            K[i, i] += damping * max(H[i, i], least)
            X[i, 0] = -slope[i]
        else:
            K[i, i] = 1.0
    solved = solve_dense(K, X, 3, 1)
    fraction = 1.0
    for i in range(3):
        dx[i] = X[i, 0] if solved else 0.0
        fraction = min(fraction, limit[i] / max(abs(dx[i]), least))
    gain = 0.0
    for i in range(3):
        dx[i] *= fraction
    for i in range(3):
        gain -= slope[i] * dx[i]
        for j in range(3):
            gain -= 0.5 * dx[i] * H[i, j] * dx[j]
    return gain


@kernel(allocates=False)
def _look_up(values, step, x, y):
    """Interpolates a table of distances at a point (x, y) from its corner, m.

    Args:
        values: (nx, ny) the table.
        step: distance between its nodes, m.
        x, y: the point.

    Returns:
        The distance, m, and its slope in x and y, a number.
    """
    u = min(max(x / step, 0.0), values.shape[0] - LAST_CELL)
    v = min(max(y / step, 0.0), values.shape[1] - LAST_CELL)
    i = int(u)
    j = int(v)
    u -= i
    v -= j
    a = values[i, j]
    b = values[i + 1, j]
    c = values[i, j + 1]
    d = values[i + 1, j + 1]
    value = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
    return value, (1 - v) * (b - a) + v * (d - c), (1 - u) * (c - a) + u * (d - b)


@kernel(allocates=False)
def _calc_twist(px, py, nx, ny, ux, uy, gap, inverse, mu):
    """Calculates by how much a body moves in one step, see `limit_surface`.

    Args:
        px, py: contact point, relative to the center of friction, m.
        nx, ny: unit normal there, into the body.
        ux, uy: motion of the tip, m.
        gap: between tip and body before the step, m; negative where they overlap.
        inverse: 1 / lambda², 1/m².
        mu: friction coefficient of the contact.

    Returns:
        Displacement of the body's center of friction, two numbers in m, and its turn, rad.
    """
    # How far the tip would enter the body; nothing moves where it does not reach it.
    closing = nx * ux + ny * uy - gap
    if not closing > 0.0:
        return 0.0, 0.0, 0.0
    # The tip's motion without the part that closes the gap. Where they overlap, the body is moved
    # out as well.
    ux -= gap * nx
    uy -= gap * ny
    # Sticking: f = B^-1 u, by Sherman and Morrison, with p⊥ = (-p_y, p_x).
    norm = 1.0 + inverse * (px * px + py * py)
    fraction = inverse * (px * uy - py * ux) / norm
    fx = ux + fraction * py
    fy = uy - fraction * px
    # Is f outside the friction cone? Then it is on the cone's edge, such that the contact moves
    # out of the tip's way along n.
    along_n = nx * fx + ny * fy
    along_t = nx * fy - ny * fx
    if abs(along_t) > mu * along_n:
        sense = mu * np.sign(along_t)
        edge_x = nx - sense * ny
        edge_y = ny + sense * nx
        turn = px * edge_y - py * edge_x
        speed = edge_x * nx + edge_y * ny + inverse * turn * (px * ny - py * nx)
        size = closing / max(speed, MIN_SPEED)
        fx = size * edge_x
        fy = size * edge_y
    return fx, fy, inverse * (px * fy - py * fx)


@kernel(allocates=False)
def follow_roughly(
    values, corner, step, start, direction, length, radius, center, inverse, mu, poses
):
    """Follows N straight pushes of a body at (0, 0, 0) by the ellipsoidal limit surface.

    Args:
        values, corner, step: of a `limit_surface.DistanceTable`.
        start: (N, 2) the disc's center at the beginning, m.
        direction: (N, 2) unit vectors of the motion.
        length: of a step, m.
        radius: of the disc, m.
        center: (2,) of friction, m.
        inverse: 1 / lambda², 1/m².
        mu: friction coefficient of the contact.
        poses: (T, N, 3) filled with the poses after each step, m and rad.
    """
    for i in range(start.shape[0]):
        # The center of friction, and how far the body has turned.
        x = center[0]
        y = center[1]
        theta = 0.0
        for t in range(poses.shape[0]):
            # The tip, and its motion in this step, seen from the body; the contact below the tip.
            c = cos(theta)
            s = sin(theta)
            tip_x = start[i, 0] + length * t * direction[i, 0] - x
            tip_y = start[i, 1] + length * t * direction[i, 1] - y
            px = c * tip_x + s * tip_y
            py = c * tip_y - s * tip_x
            ux = length * (c * direction[i, 0] + s * direction[i, 1])
            uy = length * (c * direction[i, 1] - s * direction[i, 0])
            away, slope_x, slope_y = _look_up(
                values, step, px + center[0] - corner[0], py + center[1] - corner[1]
            )
            size = max(sqrt(slope_x * slope_x + slope_y * slope_y), MIN_SLOPE)
            nx = -slope_x / size
            ny = -slope_y / size
            dx, dy, turn = _calc_twist(
                px + away * nx,
                py + away * ny,
                nx,
                ny,
                ux,
                uy,
                away - radius,
                inverse,
                mu,
            )
            # The body moves along the mean of its headings before and after the step.
            c = cos(theta + turn / 2)
            s = sin(theta + turn / 2)
            x += c * dx - s * dy
            y += s * dx + c * dy
            theta += turn
            c = cos(theta)
            s = sin(theta)
            poses[t, i, 0] = x - (c * center[0] - s * center[1])
            poses[t, i, 1] = y - (s * center[0] + c * center[1])
            poses[t, i, 2] = theta

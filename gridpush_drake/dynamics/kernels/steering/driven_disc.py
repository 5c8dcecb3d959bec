"""A block that a disc pushes without contact friction, compiled: its law, strokes, and their costs.

The block is a rigid union of convex parts. Its support friction is an ellipsoidal limit surface, so
that without load it stands still, and under a contact impulse j along the unit normal n at the
point r (from the center of friction) it moves with

    u = j n,        w = j (r × n) / rho²,

where rho² is the ratio of the ellipsoid's moment to its force. (A free body that is stopped anew in
every step follows the same law, with rho its radius of gyration.) The disc is a kinematic body that
a PD law draws to a target,

    v' = v + dt (kp (target - p) - kd v),        p' = p + dt v',

and that no contact holds back. Where the disc overlaps the block, the block's normal velocity is at
least the disc's, plus `correction` / dt times the depth beyond `slop`. Walls hold the block only.

`docs/theory/feedback.md` has the equations. Lengths are in the unit of the caller, such as pixels.
"""

from math import cos, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel

MAX_CONTACTS = 12
"""Contacts that a step can have: of the disc with each part, and of corners with walls."""

CONTACT_SIZE = 7
"""Numbers that describe a contact."""

MAX_SWEEPS = 12
"""Sweeps of the projected Gauss-Seidel method, where there are several contacts."""

STATE_SIZE = 10
"""Numbers in a state: disc x, y, vx, vy; block x, y, theta; and its velocity ux, uy, w."""

PX, PY, VX, VY, X, Y, THETA, UX, UY, W = range(STATE_SIZE)
"""Places in a state. u is the velocity of the center of friction, corrections included."""

_TINY = 1e-12
"""Distance from the outline below which the disc's center has no normal there."""


class Block(NamedTuple):
    """A block, its walls, and the disc that pushes it.

    Attributes:
        parts: (P, K, 2) corners of the convex parts, counterclockwise, body frame.
        circles: (P, 3) center and radius of a circle about each part.
        center_x: center of friction, body frame.
        center_y: likewise along y.
        rho2: squared arm of the limit surface.
        low_x: walls hold the block's corners within low_x..high_x and low_y..high_y.
        low_y: lower wall.
        high_x: right wall.
        high_y: upper wall.
        radius: radius of the disc.
        kp: stiffness of the disc's law, 1/s².
        kd: damping of the disc's law, 1/s.
        dt: step of the law, s.
        substeps: steps of the law for each decision.
        slop: overlap that is not corrected.
        correction: fraction of the overlap beyond it that is corrected in a step.
    """

    parts: Any
    circles: Any
    center_x: Any
    center_y: Any
    rho2: Any
    low_x: Any
    low_y: Any
    high_x: Any
    high_y: Any
    radius: Any
    kp: Any
    kd: Any
    dt: Any
    substeps: Any
    slop: Any
    correction: Any


@kernel(allocates=False)
def _find_nearest(parts, part, x, y, nearest):
    """Finds the point of a convex part's outline that is nearest to a point x, y; body frame.

    Fills nearest (2,). Returns the signed distance, negative inside.
    """
    count = parts.shape[1]
    best = np.inf
    inside = True
    deepest = -np.inf
    deep_x = 0.0
    deep_y = 0.0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        ax = parts[part, i, 0]
        ay = parts[part, i, 1]
        ex = parts[part, j, 0] - ax
        ey = parts[part, j, 1] - ay
        rx = x - ax
        ry = y - ay
        length2 = ex * ex + ey * ey
        along = (rx * ex + ry * ey) / length2
        # the outward normal of a counterclockwise edge is (ey, -ex)
        outside = (rx * ey - ry * ex) / sqrt(length2)
        if outside > 0.0:
            inside = False
        fraction = min(max(along, 0.0), 1.0)
        fx = ax + fraction * ex
        fy = ay + fraction * ey
        distance2 = (x - fx) ** 2 + (y - fy) ** 2
        if distance2 < best:
            best = distance2
            nearest[0] = fx
            nearest[1] = fy
        if outside > deepest:
            deepest = outside
            deep_x = ax + along * ex
            deep_y = ay + along * ey
    if inside:
        nearest[0] = deep_x
        nearest[1] = deep_y
        return deepest
    return sqrt(best)


@kernel(allocates=False)
def set_velocity(block, state, contacts, nearest):
    """Finds the block's velocity from the contacts at the present state, and writes it there.

    Args:
        block: the block.
        state: (STATE_SIZE,) UX, UY and W are filled.
        contacts: (MAX_CONTACTS, CONTACT_SIZE) room for contacts: normal, arm × normal, depth, the
            disc's speed along the normal, and the two accumulated impulses.
        nearest: (2,) room.

    Returns:
        The number of contacts of the disc.
    """
    c = cos(state[THETA])
    s = sin(state[THETA])
    # the disc's center in the body frame
    dx = state[PX] - state[X]
    dy = state[PY] - state[Y]
    bx = c * dx + s * dy
    by = c * dy - s * dx
    count = 0
    for part in range(block.parts.shape[0]):
        ox = bx - block.circles[part, 0]
        oy = by - block.circles[part, 1]
        if ox * ox + oy * oy > (block.circles[part, 2] + block.radius) ** 2:
            continue
        distance = _find_nearest(block.parts, part, bx, by, nearest)
        if distance > block.radius:
            continue
        # the normal points from the disc into the block
        nx = nearest[0] - bx
        ny = nearest[1] - by
        if distance < 0.0:
            nx = -nx
            ny = -ny
        length = sqrt(nx * nx + ny * ny)
        if length < _TINY:
            continue
        nx /= length
        ny /= length
        arm = (nearest[0] - block.center_x) * ny - (nearest[1] - block.center_y) * nx
        contacts[count, 0] = c * nx - s * ny
        contacts[count, 1] = s * nx + c * ny
        contacts[count, 2] = arm
        contacts[count, 3] = block.radius - distance
        contacts[count, 4] = contacts[count, 0] * state[VX] + contacts[count, 1] * state[VY]
        count += 1
    touching = count
    count = _add_walls(block, state, c, s, contacts, count)
    state[UX] = 0.0
    state[UY] = 0.0
    state[W] = 0.0
    if count == 1:
        _push_once(block, state, contacts)
    elif count > 1:
        _push_together(block, state, contacts, count)
    return touching


@kernel(allocates=False)
def _add_walls(block, state, c, s, contacts, count):
    """Adds the contacts of corners that are beyond a wall. Returns the number of all contacts."""
    for part in range(block.parts.shape[0]):
        # most of the time, a part is in the middle
        mx = state[X] + c * block.circles[part, 0] - s * block.circles[part, 1]
        my = state[Y] + s * block.circles[part, 0] + c * block.circles[part, 1]
        reach = block.circles[part, 2]
        if (
            mx - reach > block.low_x
            and mx + reach < block.high_x
            and my - reach > block.low_y
            and my + reach < block.high_y
        ):
            continue
        for corner in range(block.parts.shape[1]):
            px = block.parts[part, corner, 0]
            py = block.parts[part, corner, 1]
            wx = state[X] + c * px - s * py
            wy = state[Y] + s * px + c * py
            # arm of the corner from the center of friction, world frame
            ax = px - block.center_x
            ay = py - block.center_y
            rx = c * ax - s * ay
            ry = s * ax + c * ay
            for side in range(4):
                nx = 0.0
                ny = 0.0
                if side == 0:
                    depth = block.low_x - wx
                    nx = 1.0
                elif side == 1:
                    depth = wx - block.high_x
                    nx = -1.0
                elif side == 2:
                    depth = block.low_y - wy
                    ny = 1.0
                else:
                    depth = wy - block.high_y
                    ny = -1.0
                if depth >= 0.0 and count < MAX_CONTACTS:
                    contacts[count, 0] = nx
                    contacts[count, 1] = ny
                    contacts[count, 2] = rx * ny - ry * nx
                    contacts[count, 3] = depth
                    contacts[count, 4] = 0.0
                    count += 1
    return count


@kernel(allocates=False)
def _push_once(block, state, contacts):
    """Sets the block's velocity where there is a single contact."""
    nx = contacts[0, 0]
    ny = contacts[0, 1]
    arm = contacts[0, 2]
    speed = max(contacts[0, 4], 0.0)
    speed += block.correction * max(contacts[0, 3] - block.slop, 0.0) / block.dt
    impulse = speed / (1.0 + arm * arm / block.rho2)
    state[UX] = impulse * nx
    state[UY] = impulse * ny
    state[W] = impulse * arm / block.rho2


@kernel(allocates=False)
def _push_together(block, state, contacts, count):
    """Sets the block's velocity where there are several contacts, by projected Gauss-Seidel.

    Velocities and corrections are two problems of complementarity, solved side by side.
    """
    vx = vy = w = 0.0
    qx = qy = q = 0.0
    for i in range(count):
        contacts[i, 5] = 0.0
        contacts[i, 6] = 0.0
    for _ in range(MAX_SWEEPS):
        for i in range(count):
            nx = contacts[i, 0]
            ny = contacts[i, 1]
            arm = contacts[i, 2]
            mass = 1.0 / (1.0 + arm * arm / block.rho2)
            lacking = contacts[i, 4] - (nx * vx + ny * vy + arm * w)
            after = max(contacts[i, 5] + lacking * mass, 0.0)
            change = after - contacts[i, 5]
            contacts[i, 5] = after
            vx += change * nx
            vy += change * ny
            w += change * arm / block.rho2
            wanted = block.correction * max(contacts[i, 3] - block.slop, 0.0) / block.dt
            after = max(contacts[i, 6] + (wanted - (nx * qx + ny * qy + arm * q)) * mass, 0.0)
            change = after - contacts[i, 6]
            contacts[i, 6] = after
            qx += change * nx
            qy += change * ny
            q += change * arm / block.rho2
    state[UX] = vx + qx
    state[UY] = vy + qy
    state[W] = w + q


@kernel(allocates=False)
def _move(block, state):
    """Moves disc and block for one step of the law, with the velocities of the state."""
    dt = block.dt
    state[PX] += dt * state[VX]
    state[PY] += dt * state[VY]
    turn = dt * state[W]
    if turn == 0.0:
        state[X] += dt * state[UX]
        state[Y] += dt * state[UY]
        return
    # the body turns about its center of friction
    c = cos(state[THETA])
    s = sin(state[THETA])
    c2 = cos(state[THETA] + turn)
    s2 = sin(state[THETA] + turn)
    mx = block.center_x
    my = block.center_y
    state[X] += dt * state[UX] + (c - c2) * mx - (s - s2) * my
    state[Y] += dt * state[UY] + (s - s2) * mx + (c - c2) * my
    state[THETA] += turn


@kernel(allocates=False)
def advance_disc(block, state, target_x, target_y, contacts, nearest):
    """Lets the disc follow a target for one decision's time.

    Returns in how many steps of the law it touched the block.
    """
    touched = 0
    for _ in range(block.substeps):
        ax = block.kp * (target_x - state[PX]) - block.kd * state[VX]
        ay = block.kp * (target_y - state[PY]) - block.kd * state[VY]
        state[VX] += block.dt * ax
        state[VY] += block.dt * ay
        _move(block, state)
        touched += set_velocity(block, state, contacts, nearest) > 0
    return touched


@kernel()
def advance(block, state, target):
    """Lets the disc follow a target for one decision's time.

    Args:
        block: the block.
        state: (STATE_SIZE,) changed in place; the block's velocity in it is found anew.
        target: (2,) target of the disc.

    Returns:
        In how many steps of the law the disc touched the block.
    """
    contacts = np.empty((MAX_CONTACTS, CONTACT_SIZE))
    nearest = np.empty(2)
    set_velocity(block, state, contacts, nearest)
    return advance_disc(block, state, target[0], target[1], contacts, nearest)


@kernel()
def predict_poses(block, states, targets, poses):
    """Predicts where the block is after one decision, from each of several states.

    Args:
        block: the block.
        states: (n, STATE_SIZE) disc and pose before; the block's velocity in them is not read.
        targets: (n, 2) target of the disc.
        poses: (n, 3) filled with the block's poses afterwards.
    """
    contacts = np.empty((MAX_CONTACTS, CONTACT_SIZE))
    nearest = np.empty(2)
    state = np.empty(STATE_SIZE)
    for n in range(states.shape[0]):
        for i in range(STATE_SIZE):
            state[i] = states[n, i]
        set_velocity(block, state, contacts, nearest)
        advance_disc(block, state, targets[n, 0], targets[n, 1], contacts, nearest)
        poses[n, 0] = state[X]
        poses[n, 1] = state[Y]
        poses[n, 2] = state[THETA]

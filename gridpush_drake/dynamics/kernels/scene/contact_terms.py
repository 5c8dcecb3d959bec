"""A contact's part in the equations of a step, as an analytic function of the step's start.

`contacts` decides which vertex touches which edge. With that held, place, normal and gap of a
contact, the forces' wrenches and the velocities follow from poses and twists by arithmetic, roots,
sines and cosines alone. So

    d f / d z = Im f(z + i delta) / delta

for any delta, exact to round-off where delta is so small that its square vanishes: nothing is
subtracted. That is how `step_derivative` differentiates a step by what it starts from. The sine and
the cosine of such a number are as short, cos(x + i y) = cos x - i y sin x. Where such a number is
divided by a real one it is multiplied by the inverse, which the compiler does not do by itself.
"""

from cmath import sqrt
from math import cos, sin

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.scene.contacts import name_touched_vertex
from gridpush_drake.dynamics.kernels.scene.records import (
    FIRST_BEND,
    FIRST_BODY,
    FIRST_X,
    FIRST_Y,
    ROW_BEND,
    ROW_FEATURE,
    ROW_GAP,
    SECOND_BODY,
    VERTEX,
)

POSE_INPUT = 0
TWIST_INPUT = 3
OTHER_POSE = 6
OTHER_TWIST = 9
TIP_INPUT = 12
TIP_VELOCITY = 14
TIP_YAW = 16
TIP_RATE = 17
"""Places in what a contact depends on: pose (W) and twist (body frame) of its first body and of its
second, and of the pusher place, velocity, yaw and angular velocity (W); the last four are used
where the second body is the pusher."""

INPUT_COUNT = 18
"""Number of them."""

WRENCH_OUTPUT = 0
OTHER_WRENCH = 3
APPROACH_OUTPUT = 6
SLIP_OUTPUT = 7
"""Places in what comes of it: wrench of the contact on its first body and on its second, each in
the frame of its step; and the velocities J_n xi - N·v_p + gap/dt and J_t xi - T·v_p."""

OUTPUT_COUNT = 8
"""Number of them."""

_SAME_GAP = 1e-12
"""Difference of two gaps that is a rounding error, m."""


@kernel(allocates=False)
def calc_contact_terms(z, bodies, ids, numbers, tool, h, dt, xi, lam, out):
    """Calculates a contact's wrenches and velocities.

    Args:
        z: (18,) complex, what it depends on, see above.
        bodies: `BodyArrays`.
        ids: (4,) identity of the contact.
        numbers: (16,) its numbers, of which those that say which features touch are used.
        tool: `Tool`, the pusher's shape.
        h: time after which the step looks at the bodies, s.
        dt: the step, s.
        xi: (N, 3) twists of the step.
        lam: (2,) its forces lam_n, lam_t, N.
        out: (8,) complex, filled.
    """
    i = ids[FIRST_BODY]
    j = ids[SECOND_BODY]
    if j < 0 and ids[VERTEX] < 0:
        _calc_face_terms(z, bodies, ids, tool, h, dt, xi, lam, out)
        return
    x = z[POSE_INPUT]
    y = z[POSE_INPUT + 1]
    theta = z[POSE_INPUT + 2]
    c, s = _turn(theta)
    u = z[TWIST_INPUT]
    v = z[TWIST_INPUT + 1]
    w = z[TWIST_INPUT + 2]
    other_theta = z[OTHER_POSE + 2]
    other_w = z[OTHER_TWIST + 2]
    normal_force = lam[0]
    tangential_force = lam[1]
    per_dt = 1.0 / dt

    # The disc's center t and velocity v, seen from the first body: that at a vertex p of the
    # pusher, or of the second body, which moves as it did.
    px = 0.0
    py = 0.0
    corner = 0.0
    own_corner = 0.0
    if j < 0:
        disc = tool.radius
        edges = bodies.outline
        first = bodies.first_edge[i]
        px = tool.core.ax[ids[VERTEX]]
        py = tool.core.ay[ids[VERTEX]]
        tool_c, tool_s = _turn(z[TIP_YAW])
        # their mean change in the step
        next_c, next_s = _turn(z[TIP_YAW] + z[TIP_RATE] * dt)
        turn_vc = (next_c - tool_c) * per_dt
        turn_vs = (next_s - tool_s) * per_dt
        world_x = z[TIP_INPUT] + (tool_c * px - tool_s * py)
        world_y = z[TIP_INPUT + 1] + (tool_s * px + tool_c * py)
        world_vx = z[TIP_VELOCITY] + (turn_vc * px - turn_vs * py)
        world_vy = z[TIP_VELOCITY + 1] + (turn_vs * px + turn_vc * py)
    else:
        edges = bodies.core
        first = bodies.first_corner[i]
        vertex = bodies.first_corner[j] + ids[VERTEX]
        corner = bodies.corner[j]
        own_corner = bodies.corner[i]
        disc = corner + own_corner
        px = edges.ax[vertex]
        py = edges.ay[vertex]
        cj, sj = _turn(other_theta)
        # u_j + w_j z × p in the second body's frame, and x_j + R_j p
        ux = z[OTHER_TWIST] - other_w * py
        uy = z[OTHER_TWIST + 1] + other_w * px
        world_x = z[OTHER_POSE] + cj * px - sj * py
        world_y = z[OTHER_POSE + 1] + sj * px + cj * py
        world_vx = cj * ux - sj * uy
        world_vy = sj * ux + cj * uy
    dx = world_x - x
    dy = world_y - y
    tx = c * dx + s * dy
    ty = -s * dx + c * dy
    vx = c * world_vx + s * world_vy
    vy = -s * world_vx + c * world_vy
    # v - u - w z × t: its motion seen from the moving body
    rx = vx - u + w * ty
    ry = vy - v - w * tx

    # Where the disc is expected halfway through the step: t_m = t + h T_0 (T_0·r).
    first_x = numbers[FIRST_X]
    first_y = numbers[FIRST_Y]
    first_nx = first_x + 0.0 * tx
    first_ny = first_y + 0.0 * ty
    if numbers[FIRST_BEND] > 0.0:
        # the normal to a vertex turns as the disc moves
        first_nx = first_x - tx
        first_ny = first_y - ty
        distance = sqrt(first_nx * first_nx + first_ny * first_ny)
        first_nx = first_nx / distance
        first_ny = first_ny / distance
    slide = h * (first_nx * ry - first_ny * rx)
    mx = tx - slide * first_ny
    my = ty + slide * first_nx

    # Normal and contact point there, and the gap now.
    edge = first + ids[ROW_FEATURE]
    ax = edges.ax[edge]
    ay = edges.ay[edge]
    ex = edges.bx[edge] - ax
    ey = edges.by[edge] - ay
    if numbers[ROW_BEND] > 0.0:
        nx = ax - mx
        ny = ay - my
        distance = sqrt(nx * nx + ny * ny)
        nx = nx / distance
        ny = ny / distance
        cx = ax + 0.0 * tx
        cy = ay + 0.0 * ty
        before = first + edges.previous[edge]
        bx = ax - edges.ax[before]
        by = ay - edges.ay[before]
        gap = _calc_distance(tx - ax, ty - ay, ex, ey)
        other_gap = _calc_distance(tx - edges.ax[before], ty - edges.ay[before], bx, by)
        if other_gap.real < gap.real:
            gap = other_gap
        gap = gap - disc
    else:
        length = (ex * ex + ey * ey) ** 0.5
        nx = -ey / length + 0.0 * tx
        ny = ex / length + 0.0 * ty
        along = ((mx - ax) * ex + (my - ay) * ey) * (1.0 / (length * length))
        cx = ax + along * ex
        cy = ay + along * ey
        gap = nx * (cx - tx) + ny * (cy - ty) - disc

    if gap.real < numbers[ROW_GAP] - _SAME_GAP:
        # so deep an overlap is undone at a given speed, whatever it is
        gap = numbers[ROW_GAP] + 0.0 * tx

    # Wrench and velocity of the first body, in the frame of its step, turned by a = h w.
    px_contact = cx - own_corner * nx
    py_contact = cy - own_corner * ny
    fx = nx * normal_force - ny * tangential_force
    fy = ny * normal_force + nx * tangential_force
    out[WRENCH_OUTPUT] = fx
    out[WRENCH_OUTPUT + 1] = fy
    out[WRENCH_OUTPUT + 2] = px_contact * fy - py_contact * fx
    new_w = xi[i, 2]
    slip_x = xi[i, 0] - new_w * py_contact
    slip_y = xi[i, 1] + new_w * px_contact
    a = h * w
    if j < 0:
        # the pusher's velocity in that frame, where it touches
        ca, sa = _turn(a)
        spin = z[TIP_RATE] * disc
        slip_x = slip_x - ca * vx - sa * vy + spin * ny
        slip_y = slip_y + sa * vx - ca * vy - spin * nx
        out[APPROACH_OUTPUT] = nx * slip_x + ny * slip_y + gap * per_dt
        out[SLIP_OUTPUT] = nx * slip_y - ny * slip_x
        for k in range(3):
            out[OTHER_WRENCH + k] = 0.0
        return

    # The same of the second body, whose frame is turned by its own angle.
    turn = theta + a - other_theta - h * other_w
    turn_c, turn_s = _turn(turn)
    other_nx = turn_c * nx - turn_s * ny
    other_ny = turn_s * nx + turn_c * ny
    dx = px + corner * other_nx
    dy = py + corner * other_ny
    fx = other_ny * tangential_force - other_nx * normal_force
    fy = -other_nx * tangential_force - other_ny * normal_force
    out[OTHER_WRENCH] = fx
    out[OTHER_WRENCH + 1] = fy
    out[OTHER_WRENCH + 2] = dx * fy - dy * fx
    new_w = xi[j, 2]
    other_x = xi[j, 0] - new_w * dy
    other_y = xi[j, 1] + new_w * dx
    # N·v and T·v of either body, each in its own frame
    normal_speed = nx * slip_x + ny * slip_y
    other_normal_speed = other_nx * other_x + other_ny * other_y
    tangential_speed = nx * slip_y - ny * slip_x
    other_tangential_speed = other_nx * other_y - other_ny * other_x
    out[APPROACH_OUTPUT] = normal_speed - other_normal_speed + gap * per_dt
    out[SLIP_OUTPUT] = tangential_speed - other_tangential_speed


@kernel(allocates=False)
def _calc_face_terms(z, bodies, ids, tool, h, dt, xi, lam, out):
    """Calculates wrench and velocities where a face of the pusher touches a vertex of the body.

    The arguments are those of `calc_contact_terms`.
    """
    i = ids[FIRST_BODY]
    touched = bodies.first_edge[i] + name_touched_vertex(ids[VERTEX])
    px = bodies.outline.ax[touched]
    py = bodies.outline.ay[touched]
    edge = ids[ROW_FEATURE]
    ax = tool.core.ax[edge]
    ay = tool.core.ay[edge]
    ex = tool.core.bx[edge] - ax
    ey = tool.core.by[edge] - ay
    length = (ex * ex + ey * ey) ** 0.5

    # The vertex in the pusher's frame, and its gap now.
    theta = z[POSE_INPUT + 2]
    c, s = _turn(theta)
    tool_c, tool_s = _turn(z[TIP_YAW])
    dx = z[POSE_INPUT] - z[TIP_INPUT]
    dy = z[POSE_INPUT + 1] - z[TIP_INPUT + 1]
    dx += c * px - s * py
    dy += s * px + c * py
    lx = tool_c * dx + tool_s * dy
    ly = -tool_s * dx + tool_c * dy
    rx = lx - ax
    ry = ly - ay
    outward_x = ey / length
    outward_y = -ex / length
    gap = rx * outward_x + ry * outward_y - tool.radius

    # The face's normal halfway through the step, in the body's frame there.
    angle = theta + h * z[TWIST_INPUT + 2]
    turn = z[TIP_YAW] + h * z[TIP_RATE] - angle
    turn_c, turn_s = _turn(turn)
    nx = turn_c * outward_x - turn_s * outward_y
    ny = turn_s * outward_x + turn_c * outward_y

    # The velocity of the pusher's point that is there now, in that frame.
    per_dt = 1.0 / dt
    next_c, next_s = _turn(z[TIP_YAW] + z[TIP_RATE] * dt)
    turn_vc = (next_c - tool_c) * per_dt
    turn_vs = (next_s - tool_s) * per_dt
    world_vx = z[TIP_VELOCITY] + (turn_vc * lx - turn_vs * ly)
    world_vy = z[TIP_VELOCITY + 1] + (turn_vs * lx + turn_vc * ly)
    ca, sa = _turn(angle)
    vx = ca * world_vx + sa * world_vy
    vy = ca * world_vy - sa * world_vx

    fx = nx * lam[0] - ny * lam[1]
    fy = ny * lam[0] + nx * lam[1]
    out[WRENCH_OUTPUT] = fx
    out[WRENCH_OUTPUT + 1] = fy
    out[WRENCH_OUTPUT + 2] = px * fy - py * fx
    # the body's velocity there, seen from the pusher
    new_w = xi[i, 2]
    slip_x = xi[i, 0] - new_w * py - vx
    slip_y = xi[i, 1] + new_w * px - vy
    out[APPROACH_OUTPUT] = nx * slip_x + ny * slip_y + gap * per_dt
    out[SLIP_OUTPUT] = nx * slip_y - ny * slip_x
    for k in range(3):
        out[OTHER_WRENCH + k] = 0.0


@kernel(allocates=False, inlined=True)
def _turn(z):
    """Calculates cosine and sine of an angle whose imaginary part is all but zero, rad."""
    c = cos(z.real)
    s = sin(z.real)
    return complex(c, -s * z.imag), complex(s, c * z.imag)


@kernel(allocates=False)
def _calc_distance(rx, ry, ex, ey):
    """Calculates how far a point is from an edge (ex, ey), from whose beginning it is r off."""
    along = (rx * ex + ry * ey) * (1.0 / (ex * ex + ey * ey))
    # beyond the edge's ends these are nearest, and stay where they are
    if along.real < 0.0:
        along = along - along
    elif along.real > 1.0:
        along = along - along + 1.0
    rx = rx - along * ex
    ry = ry - along * ey
    return sqrt(rx * rx + ry * ry)

"""Where bodies and pusher touch: every contact of a step, as a row.

The pusher is one disc or more against each outline, as in `dynamics.kernels.contact.contact`. One
with a polygon for its core has a disc at every vertex, and faces that touch the outline's convex
vertices.

Two bodies touch by their cores, the outlines moved inwards by the radius of their corners: each
convex vertex of one core is a disc of both radii against the other core. A corner is so round, and
the normal of a contact turns evenly as it goes round it. Two edges that lie on each other touch at
the two ends of what they have in common.

As in the step of one body, gaps are those when the step begins, while place and normal are those
expected halfway through it (`contact.look_ahead`).
"""

from math import cos, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.contact import (
    BEND,
    CX,
    CY,
    FEATURE,
    GAP,
    NX,
    NY,
    Edges,
    NearEdges,
    find_contacts,
    find_contacts_near,
    look_ahead,
    look_ahead_near,
)
from gridpush_drake.dynamics.kernels.contact.contact_modes import SEPARATE, STICK
from gridpush_drake.dynamics.kernels.scene.records import (
    FINGER_BODY,
    FIRST_BEND,
    FIRST_BODY,
    FIRST_X,
    FIRST_Y,
    FRICTION,
    IDENTITY_SIZE,
    OTHER_CX,
    OTHER_CY,
    OTHER_NX,
    OTHER_NY,
    ROW_BEND,
    ROW_CX,
    ROW_CY,
    ROW_FEATURE,
    ROW_GAP,
    ROW_NX,
    ROW_NY,
    SECOND_BODY,
    TIP_VX,
    TIP_VY,
    VERTEX,
)

_REACH = 2.0
"""Contacts are watched from as far away as pusher and bodies move in this many steps."""

OVERLAP_RECOVERY = 0.5
"""Most of an overlap of two bodies that is undone in a step, as a fraction of the pusher's way in
it. They overlap a little where a corner is turned in a step, and must not be thrown apart."""

_SLACK = 0.2
"""Sine of the angle by which a vertex may be less deep than its neighbor and still be watched. Two
edges that all but lie on each other then keep both their contacts."""


class ContactSearch(NamedTuple):
    """What contacts are searched with, for N bodies and K vertices of the pusher's core.

    Attributes:
        found, ahead: (2, 9) workspace.
        chosen: (N, K, E) edges of each body that the disc at each vertex can touch soon.
        size: (N, K, 1) their numbers.
        place: (N, K, 3) where they were chosen; all three as `NearEdges` has them.
    """

    found: Any
    ahead: Any
    chosen: Any
    size: Any
    place: Any


@kernel()
def make_contact_search(bodies, tool):
    """Makes the workspace for a pusher, with nothing chosen yet."""
    n = bodies.cell_size.shape[0]
    edges = 0
    for b in range(n):
        edges = max(edges, bodies.first_edge[b + 1] - bodies.first_edge[b])
    vertices = tool.core.ax.shape[0]
    return ContactSearch(
        found=np.zeros((2, 9)),
        ahead=np.zeros((2, 9)),
        chosen=np.zeros((n, vertices, edges), np.int64),
        size=np.zeros((n, vertices, 1), np.int64),
        place=np.full((n, vertices, 3), -1.0),
    )


@kernel(allocates=False)
def take_edges(edges, first, last):
    """Takes the edges of one body out of those of all."""
    return Edges(
        ax=edges.ax[first:last],
        ay=edges.ay[first:last],
        bx=edges.bx[first:last],
        by=edges.by[first:last],
        previous=edges.previous[first:last],
    )


@kernel(allocates=False)
def find_scene_contacts(bodies, state, motion, dt, h, search, contacts):
    """Finds the contacts of a step; their modes are those of the step before, where they were.

    Args:
        bodies: `BodyArrays`.
        state: `SceneState`.
        motion: `ToolMotion`, the pusher.
        dt, h: the step, and the time after which it looks at the bodies, s.
        search: `ContactSearch`.
        contacts: `Contacts`, filled.

    Returns:
        The least gap between the pusher and an outline, m; infinite where it is far.
    """
    count = contacts.counts[0]
    contacts.counts[1] = count
    contacts.counts[0] = 0
    for r in range(count):
        contacts.last_modes[r] = contacts.modes[r]
        for column in range(IDENTITY_SIZE):
            contacts.last_ids[r, column] = contacts.ids[r, column]
    tip_speed, _ = find_fastest_vertex(motion)
    recovery = OVERLAP_RECOVERY * tip_speed * dt
    n = state.q.shape[0]
    gap = _find_finger_contacts(bodies, state, motion, tip_speed, dt, h, search, contacts)
    for i in range(n):
        for j in range(n):
            if i == j:
                continue
            # How far the two may be from each other and still meet soon.
            speed_i = _calc_speed(bodies, state, i)
            speed_j = _calc_speed(bodies, state, j)
            reach = _REACH * (tip_speed + speed_i + speed_j) * dt
            dx = state.q[j, 0] - state.q[i, 0]
            dy = state.q[j, 1] - state.q[i, 1]
            limit = bodies.reach[i] + bodies.reach[j] + reach
            if dx * dx + dy * dy <= limit * limit:
                _find_pair_contacts(bodies, state, i, j, reach, recovery, h, search, contacts)
    for r in range(contacts.counts[0]):
        contacts.modes[r] = _recall_mode(contacts, r)
    return gap


@kernel(allocates=False)
def _calc_speed(bodies, state, b):
    """Bounds the speed of the points of a body in the step before, m/s."""
    ux = state.twist[b, 0]
    uy = state.twist[b, 1]
    turning = bodies.reach[b] * abs(state.twist[b, 2])
    return sqrt(ux * ux + uy * uy) + turning


@kernel(allocates=False, inlined=True)
def calc_place(motion, px, py):
    """Calculates where a point p of the pusher, in its frame, is in W, and its mean velocity."""
    c = motion.turn_c
    s = motion.turn_s
    arm_x = c * px - s * py
    arm_y = s * px + c * py
    # how the arm changes on average, by the chord of its arc
    vc = motion.turn_vc
    vs = motion.turn_vs
    change_x = vc * px - vs * py
    change_y = vs * px + vc * py
    return motion.x + arm_x, motion.y + arm_y, motion.vx + change_x, motion.vy + change_y


@kernel(allocates=False, inlined=True)
def _see_vertex(state, i, motion, px, py):
    """Calculates where a point p of body i, in its frame, is in the pusher's frame, m."""
    c = state.turn[i, 0]
    s = state.turn[i, 1]
    # from the pusher's origin, in W
    dx = state.q[i, 0] - motion.x
    dy = state.q[i, 1] - motion.y
    dx += c * px - s * py
    dy += s * px + c * py
    c = motion.turn_c
    s = motion.turn_s
    return c * dx + s * dy, c * dy - s * dx


@kernel(allocates=False)
def find_fastest_vertex(motion):
    """Finds how fast the fastest vertex of the pusher's core is, m/s, and which one it is."""
    core = motion.tool.core
    fastest2 = -1.0
    vertex = 0
    for k in range(core.ax.shape[0]):
        _, _, vx, vy = calc_place(motion, core.ax[k], core.ay[k])
        speed2 = vx * vx + vy * vy
        if speed2 > fastest2:
            fastest2 = speed2
            vertex = k
    return sqrt(max(fastest2, 0.0)), vertex


@kernel(allocates=False)
def name_touched_vertex(v):
    """The number that stands in a contact's identity where a face of the pusher touches vertex v.

    It is its own inverse.
    """
    return -1 - v


@kernel(allocates=False)
def _find_finger_contacts(bodies, state, motion, tip_speed, dt, h, search, contacts):
    """Finds the contacts of the pusher with every outline; returns its least gap, m."""
    least = float("inf")
    tool = motion.tool
    if tool.radius <= 0.0:
        return least
    reach = _REACH * tip_speed * dt
    for i in range(state.q.shape[0]):
        dx = motion.x - state.q[i, 0]
        dy = motion.y - state.q[i, 1]
        limit = bodies.reach[i] + tool.reach + reach
        if dx * dx + dy * dy > limit * limit:
            continue
        edges = take_edges(bodies.outline, bodies.first_edge[i], bodies.first_edge[i + 1])
        for k in range(tool.core.ax.shape[0]):
            gap = _find_vertex_contacts(
                bodies, state, i, edges, motion, k, reach, h, search, contacts
            )
            least = min(least, gap)
        if tool.joined:
            gap = _find_face_contacts(bodies, state, i, edges, motion, reach, h, contacts)
            least = min(least, gap)
    return least


@kernel(allocates=False)
def _find_vertex_contacts(bodies, state, i, edges, motion, k, reach, h, search, contacts):
    """Finds where the disc at vertex k of the pusher touches body i; returns its least gap, m."""
    tool = motion.tool
    core = tool.core
    x, y, world_vx, world_vy = calc_place(motion, core.ax[k], core.ay[k])
    c = state.turn[i, 0]
    s = state.turn[i, 1]
    dx = x - state.q[i, 0]
    dy = y - state.q[i, 1]

    # The disc's center and velocity in the body frame, and its motion seen from the body.
    tx = c * dx + s * dy
    ty = -s * dx + c * dy
    vx = c * world_vx + s * world_vy
    vy = -s * world_vx + c * world_vy
    found = search.found
    ahead = search.ahead
    near = NearEdges(chosen=search.chosen[i, k], size=search.size[i, k], place=search.place[i, k])
    count = find_contacts_near(edges, near, tx, ty, tool.radius, reach, found)
    if count > 0:
        rx, ry = _see_velocity(state, i, tx, ty, vx, vy)
        count = look_ahead_near(
            edges, near, tx, ty, h * rx, h * ry, tool.radius, reach, found, ahead
        )
    if count == 0:
        return float("inf")
    for row in range(count):
        if tool.joined and _stands_back(state, i, motion, k, tx, ty, h, ahead, row):
            continue
        r = _take_row(contacts, ahead[row, GAP])
        if r >= 0:
            _write_row(contacts, r, i, FINGER_BODY, k, found, ahead, row)
            numbers = contacts.numbers[r]
            # the pusher's velocity in the frame of the step, which is turned by a = h w
            a = h * state.twist[i, 2]
            ca = cos(a)
            sa = sin(a)
            # where it touches, a radius from the disc's center: v + rate z x (r N)
            spin = motion.rate * tool.radius
            numbers[TIP_VX] = ca * vx + sa * vy - spin * ahead[row, NY]
            numbers[TIP_VY] = -sa * vx + ca * vy + spin * ahead[row, NX]
            numbers[FRICTION] = bodies.finger_friction[i]
    return found[0, GAP]


@kernel(allocates=False)
def _stands_back(state, i, motion, k, tx, ty, h, ahead, row):
    """Whether vertex k of a polygon leaves a contact with body i to its neighbors or a face."""
    core = motion.tool.core
    # the normal in the pusher's frame, both frames halfway through the step
    turn = state.q[i, 2] + h * state.twist[i, 2] - motion.yaw - h * motion.rate
    c = cos(turn)
    s = sin(turn)
    nx = ahead[row, NX]
    ny = ahead[row, NY]
    if not _is_deep(core, k, c * nx - s * ny, s * nx + c * ny):
        return True
    if ahead[row, BEND] == 0.0:
        return False
    # Two vertices meet: only where neither is beside an edge.
    ox = ahead[row, CX] - tx
    oy = ahead[row, CY] - ty
    return _is_beside(core, k, c * ox - s * oy, s * ox + c * oy)


@kernel(allocates=False)
def find_face(core, lx, ly):
    """Finds the edge of a convex core that is nearest to a point beside it.

    Args:
        core: `Edges` of the pusher.
        lx, ly: the point, in the pusher's frame, m.

    Returns:
        The edge, -1 where the point is beside none; and its distance from it, m, negative inside.
    """
    edge = -1
    best = -float("inf")
    for e in range(core.ax.shape[0]):
        ex = core.bx[e] - core.ax[e]
        ey = core.by[e] - core.ay[e]
        rx = lx - core.ax[e]
        ry = ly - core.ay[e]
        length = sqrt(ex * ex + ey * ey)
        distance = (rx * ey - ry * ex) / length
        if distance > best:
            best = distance
            along = rx * ex + ry * ey
            edge = e if along > 0.0 and along < length * length else -1
    return edge, best


@kernel(allocates=False)
def _find_face_contacts(bodies, state, i, edges, motion, reach, h, contacts):
    """Finds where faces of the pusher touch convex vertices of body i; returns the least gap, m."""
    tool = motion.tool
    core = tool.core
    least = float("inf")
    limit = tool.reach + reach
    for v in range(edges.ax.shape[0]):
        px = edges.ax[v]
        py = edges.ay[v]
        lx, ly = _see_vertex(state, i, motion, px, py)
        if lx * lx + ly * ly > limit * limit:
            continue
        e, distance = find_face(core, lx, ly)
        gap = distance - tool.radius
        if e < 0 or gap > reach or not _is_convex(edges, v):
            continue
        least = min(least, gap)
        # the normal in the body's frame, both frames halfway through the step
        ex = core.bx[e] - core.ax[e]
        ey = core.by[e] - core.ay[e]
        length = sqrt(ex * ex + ey * ey)
        angle = state.q[i, 2] + h * state.twist[i, 2]
        turn = motion.yaw + h * motion.rate - angle
        ct = cos(turn)
        st = sin(turn)
        outward_x = ey / length
        outward_y = -ex / length
        nx = ct * outward_x - st * outward_y
        ny = st * outward_x + ct * outward_y
        if not _is_deep(edges, v, -nx, -ny):
            continue
        r = _take_row(contacts, gap)
        if r < 0:
            continue
        ids = contacts.ids[r]
        ids[FIRST_BODY] = i
        ids[SECOND_BODY] = FINGER_BODY
        ids[VERTEX] = name_touched_vertex(v)
        ids[ROW_FEATURE] = e
        numbers = contacts.numbers[r]
        numbers[ROW_NX] = nx
        numbers[ROW_NY] = ny
        numbers[ROW_CX] = px
        numbers[ROW_CY] = py
        numbers[ROW_GAP] = gap
        numbers[ROW_BEND] = 0.0
        # the velocity of the pusher's point that is there now, in the frame of the step
        _, _, vx, vy = calc_place(motion, lx, ly)
        ca = cos(angle)
        sa = sin(angle)
        numbers[TIP_VX] = ca * vx + sa * vy
        numbers[TIP_VY] = -sa * vx + ca * vy
        numbers[FRICTION] = bodies.finger_friction[i]
    return least


@kernel(allocates=False)
def _is_convex(edges, v):
    """Whether the outline turns left at the vertex where edge v begins."""
    before = edges.previous[v]
    qx = edges.bx[before] - edges.ax[before]
    qy = edges.by[before] - edges.ay[before]
    ex = edges.bx[v] - edges.ax[v]
    ey = edges.by[v] - edges.ay[v]
    return qx * ey - qy * ex > 0.0


@kernel(allocates=False)
def measure_finger_gap(bodies, state, motion, found):
    """The least gap of the pusher, m; infinite where it is further than its radius."""
    least = float("inf")
    tool = motion.tool
    radius = tool.radius
    if radius <= 0.0:
        return least
    for i in range(state.q.shape[0]):
        edges = take_edges(bodies.outline, bodies.first_edge[i], bodies.first_edge[i + 1])
        c = state.turn[i, 0]
        s = state.turn[i, 1]
        for k in range(tool.core.ax.shape[0]):
            x, y, _, _ = calc_place(motion, tool.core.ax[k], tool.core.ay[k])
            dx = x - state.q[i, 0]
            dy = y - state.q[i, 1]
            tx = c * dx + s * dy
            ty = -s * dx + c * dy
            if find_contacts(edges, tx, ty, radius, radius, found) > 0:
                least = min(least, found[0, GAP])
        if not tool.joined:
            continue
        for v in range(edges.ax.shape[0]):
            lx, ly = _see_vertex(state, i, motion, edges.ax[v], edges.ay[v])
            e, distance = find_face(tool.core, lx, ly)
            if e >= 0 and distance <= 2.0 * radius:
                least = min(least, distance - radius)
    return least


@kernel(allocates=False)
def _find_pair_contacts(bodies, state, i, j, reach, recovery, h, search, contacts):
    """Finds where convex vertices of body j's core touch the core of body i.

    Overlaps deeper than `recovery`, m, are taken for so deep ones.
    """
    first = bodies.first_corner[i]
    last = bodies.first_corner[i + 1]
    edges = take_edges(bodies.core, first, last)
    start = bodies.first_corner[j]
    corners = take_edges(bodies.core, start, bodies.first_corner[j + 1])
    radius = bodies.corner[i] + bodies.corner[j]
    found = search.found
    ahead = search.ahead
    # Only what is within this box can touch body i soon.
    limit = radius + reach
    left = bodies.box[i, 0] - limit
    bottom = bodies.box[i, 1] - limit
    right = bodies.box[i, 2] + limit
    top = bodies.box[i, 3] + limit

    # Body j seen from body i: p_i = shift + turn p_j.
    ci = state.turn[i, 0]
    si = state.turn[i, 1]
    cj = state.turn[j, 0]
    sj = state.turn[j, 1]
    dx = state.q[j, 0] - state.q[i, 0]
    dy = state.q[j, 1] - state.q[i, 1]
    shift_x = ci * dx + si * dy
    shift_y = -si * dx + ci * dy
    c = ci * cj + si * sj
    s = ci * sj - si * cj
    twist = state.twist
    for vertex in range(corners.ax.shape[0]):
        px = corners.ax[vertex]
        py = corners.ay[vertex]
        tx = shift_x + c * px - s * py
        ty = shift_y + s * px + c * py
        if tx < left or tx > right or ty < bottom or ty > top:
            continue
        if not bodies.convex[start + vertex]:
            continue
        # The vertex moves as its body did in the step before.
        w = twist[j, 2]
        ux = twist[j, 0] - w * py
        uy = twist[j, 1] + w * px
        vx = c * ux - s * uy
        vy = s * ux + c * uy
        count = _look(edges, state, i, tx, ty, vx, vy, radius, reach, h, found, ahead)
        for row in range(count):
            # The normal in the frame of j's step, for which both frames are turned by h w.
            a = h * (twist[i, 2] - w)
            ca = cos(a)
            sa = sin(a)
            turn_c = c * ca + s * sa
            turn_s = c * sa - s * ca
            own_nx = ahead[row, NX]
            own_ny = ahead[row, NY]
            nx = turn_c * own_nx - turn_s * own_ny
            ny = turn_s * own_nx + turn_c * own_ny
            # Vertices that lie deeper stand for this one.
            if not _is_deep(corners, vertex, nx, ny):
                continue
            if ahead[row, BEND] > 0.0:
                # Two vertices meet: counted once, and only where neither is beside an edge.
                ox = ahead[row, CX] - tx
                oy = ahead[row, CY] - ty
                if j < i or _is_beside(corners, vertex, c * ox + s * oy, -s * ox + c * oy):
                    continue
            r = _take_row(contacts, ahead[row, GAP])
            if r < 0:
                continue
            _write_row(contacts, r, i, j, vertex, found, ahead, row)
            numbers = contacts.numbers[r]
            # The contact point lies on the round corners.
            corner_i = bodies.corner[i]
            corner_j = bodies.corner[j]
            numbers[ROW_CX] -= corner_i * own_nx
            numbers[ROW_CY] -= corner_i * own_ny
            numbers[OTHER_NX] = nx
            numbers[OTHER_NY] = ny
            numbers[OTHER_CX] = px + corner_j * nx
            numbers[OTHER_CY] = py + corner_j * ny
            numbers[FRICTION] = bodies.pair_friction[i, j]
            numbers[ROW_GAP] = max(numbers[ROW_GAP], -recovery)


@kernel(allocates=False)
def _look(edges, state, i, tx, ty, vx, vy, radius, reach, h, found, ahead):
    """Finds the contacts of a disc with body i now, `found`, and halfway through the step, `ahead`.

    The disc's center t, m, and velocity v, m/s, are in the body frame. Returns their number.
    """
    count = find_contacts(edges, tx, ty, radius, reach, found)
    if count == 0:
        return 0
    rx, ry = _see_velocity(state, i, tx, ty, vx, vy)
    return look_ahead(edges, tx, ty, h * rx, h * ry, radius, reach, found, ahead)


@kernel(allocates=False, inlined=True)
def _see_velocity(state, i, tx, ty, vx, vy):
    """Calculates v - u - w z × t: a disc's motion seen from body i, which moves as it did, m/s."""
    twist = state.twist
    w = twist[i, 2]
    return vx - twist[i, 0] + w * ty, vy - twist[i, 1] - w * tx


@kernel(allocates=False)
def _is_deep(corners, vertex, nx, ny):
    """Whether a vertex is nearly the deepest of its neighborhood along the normal (nx, ny)."""
    # the neighbor at the end of the edge that begins here, then the one before
    before = corners.previous[vertex]
    x = corners.ax[vertex]
    y = corners.ay[vertex]
    ex = corners.bx[vertex] - x
    ey = corners.by[vertex] - y
    if ex * nx + ey * ny > _SLACK * sqrt(ex * ex + ey * ey):
        return False
    ex = corners.ax[before] - x
    ey = corners.ay[before] - y
    return ex * nx + ey * ny <= _SLACK * sqrt(ex * ex + ey * ey)


@kernel(allocates=False)
def _is_beside(corners, vertex, ox, oy):
    """Whether a point, at (ox, oy) from a vertex, is beside an edge that begins or ends there."""
    before = corners.previous[vertex]
    x = corners.ax[vertex]
    y = corners.ay[vertex]
    # in front of the vertex along the edge that begins here, or along the one before
    ex = corners.bx[vertex] - x
    ey = corners.by[vertex] - y
    if ox * ex + oy * ey > 0.0:
        return True
    ex = corners.ax[before] - x
    ey = corners.ay[before] - y
    return ox * ex + oy * ey > 0.0


@kernel(allocates=False)
def _take_row(contacts, gap):
    """Takes a row for a contact: a free one, or that of the widest gap if this one is closer.

    Returns:
        The row; -1 where there is none.
    """
    count = contacts.counts[0]
    if count < contacts.modes.shape[0]:
        contacts.counts[0] = count + 1
        return count
    contacts.lost[0] += 1
    widest = 0
    for r in range(count):
        if contacts.numbers[r, ROW_GAP] > contacts.numbers[widest, ROW_GAP]:
            widest = r
    return widest if gap < contacts.numbers[widest, ROW_GAP] else -1


@kernel(allocates=False)
def _write_row(contacts, r, i, j, vertex, found, ahead, row):
    """Writes what a contact is and where it is on body i, as the disc's row of `contact` has it."""
    ids = contacts.ids[r]
    ids[FIRST_BODY] = i
    ids[SECOND_BODY] = j
    ids[VERTEX] = vertex
    ids[ROW_FEATURE] = int(ahead[row, FEATURE])
    numbers = contacts.numbers[r]
    numbers[ROW_NX] = ahead[row, NX]
    numbers[ROW_NY] = ahead[row, NY]
    numbers[ROW_CX] = ahead[row, CX]
    numbers[ROW_CY] = ahead[row, CY]
    numbers[ROW_GAP] = ahead[row, GAP]
    numbers[ROW_BEND] = ahead[row, BEND]
    numbers[TIP_VX] = 0.0
    numbers[TIP_VY] = 0.0
    # the direction along which the look ahead went
    at_vertex = found[0, BEND] > 0.0
    numbers[FIRST_BEND] = found[0, BEND]
    numbers[FIRST_X] = found[0, CX] if at_vertex else found[0, NX]
    numbers[FIRST_Y] = found[0, CY] if at_vertex else found[0, NY]


@kernel(allocates=False)
def _recall_mode(contacts, r):
    """Looks up the mode that a contact had in the step before; sticking where it is a new one."""
    ids = contacts.ids[r]
    similar = -1
    for old in range(contacts.counts[1]):
        last = contacts.last_ids[old]
        same = (
            last[FIRST_BODY] == ids[FIRST_BODY]
            and last[SECOND_BODY] == ids[SECOND_BODY]
            and last[VERTEX] == ids[VERTEX]
        )
        if same:
            if last[ROW_FEATURE] == ids[ROW_FEATURE]:
                return contacts.last_modes[old]
            similar = old
    if similar >= 0:
        return contacts.last_modes[similar]
    return STICK if contacts.numbers[r, ROW_GAP] <= 0.0 else SEPARATE

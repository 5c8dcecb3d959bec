"""The rows of a step's contacts, and what a linearized step is solved with.

See `contact_problem`.
"""

from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.scene.complementary_pivoting import make_pivoting
from gridpush_drake.dynamics.kernels.scene.records import (
    FIRST_BODY,
    OTHER_CX,
    OTHER_CY,
    OTHER_NX,
    OTHER_NY,
    ROW_CX,
    ROW_CY,
    ROW_GAP,
    ROW_NX,
    ROW_NY,
    SECOND_BODY,
    TIP_VX,
    TIP_VY,
)

PUSHER_COMPLIANCE = 1e-9
"""Compliance of a disc's contacts where there is more than one, as a fraction of speed/load.

It makes contacts that share a load in more than one way well posed."""

PAIR_COMPLIANCE = 1e-5
"""Compliance of two bodies' contacts, and of a pusher's that is no single disc, as a fraction of
speed/load.

Bodies that touch at three places and more would squeeze each other by any force wherever their gaps
disagree by a rounding error. So soft, a contact that bears the whole load gives way by 10 µm for
each meter of the push, along the contact; across it, the gap that this leaves is closed again in
the next step."""


CONTACT_UNKNOWNS = 4
"""Unknowns of a contact in the complementarity problem, see `contact_problem`."""


class SceneScales(NamedTuple):
    """What is large in a step.

    Attributes:
        load: friction with the table that all cells of all bodies can carry, N.
        speed: of the pusher and of the fastest approach, m/s.
        tip_speed: of the pusher; `speed` where it stands still, m/s.
        disc: whether the pusher is one disc.
    """

    load: float
    speed: float
    tip_speed: float
    disc: bool


class ContactWork(NamedTuple):
    """What a linearized step is solved with, for N bodies and R contacts.

    Attributes:
        inverse: (N, 3, 3) S^-1, body by body.
        free: (N, 3) S^-1 rhs: the twists without contacts.
        weight: (N,) sigma; zero of a body that rests.
        load: (N,) sigma a·xi, N.
        start: (N, 3) twists without contacts of bodies that keep their speed.
        rows: (2R+N, 6) J_n and J_t of each contact, three numbers for each of its bodies; then the
            axis a of each body.
        ends: (2R+N, 2) the bodies of each row; -1 where there is no second one.
        asked: (2R+N,) what J_n xi and J_t xi should be.
        sequence: (R+N,) the order in which contacts and axes become unknowns: r of a contact, -1-b
            of the axis of body b. Neighbors in it share bodies, so that W is banded.
        length: (1,) how many entries of `sequence` count.
        used: (2R+N,) the row that each unknown stands for; its column of E is in `columns`.
        place: (R,) the first unknown of each contact; -1 where it is separate.
        columns: (2R+N, 6) the columns of E.
        responses: (2R+N, 6) S^-1 E.
        window: (N, 2) the first and the last unknown of each body.
        right: (2R+N,) the last unknown that shares a body with each one.
        W, B: workspace (2R+N, 2R+N) and (2R+N, 1).
        next_modes: (R,) the modes that the solution speaks for.
        included: (R,) the contacts that take part in the complementarity problem.
        pivoting: `Pivoting`, with that problem.
    """

    inverse: Any
    free: Any
    weight: Any
    load: Any
    start: Any
    rows: Any
    ends: Any
    asked: Any
    sequence: Any
    length: Any
    used: Any
    place: Any
    columns: Any
    responses: Any
    window: Any
    right: Any
    W: Any
    B: Any
    next_modes: Any
    included: Any
    pivoting: Any


@kernel()
def make_contact_work(n, room):
    """Makes the workspace for n bodies and so many contacts."""
    size = 2 * room + n
    return ContactWork(
        inverse=np.zeros((n, 3, 3)),
        free=np.zeros((n, 3)),
        weight=np.zeros(n),
        load=np.zeros(n),
        start=np.zeros((n, 3)),
        rows=np.zeros((size, 6)),
        ends=np.zeros((size, 2), np.int64),
        asked=np.zeros(size),
        sequence=np.zeros(room + n, np.int64),
        length=np.zeros(1, np.int64),
        used=np.zeros(size, np.int64),
        place=np.zeros(room, np.int64),
        columns=np.zeros((size, 6)),
        responses=np.zeros((size, 6)),
        window=np.zeros((n, 2), np.int64),
        right=np.zeros(size, np.int64),
        W=np.zeros((size, size)),
        B=np.zeros((size, 1)),
        next_modes=np.zeros(room, np.int64),
        included=np.zeros(room, np.int64),
        pivoting=make_pivoting(CONTACT_UNKNOWNS * room),
    )


@kernel(allocates=False)
def fill_rows(contacts, dt, work):
    """Fills in J_n, J_t and what they ask for, which stay the same throughout a step."""
    for r in range(contacts.counts[0]):
        numbers = contacts.numbers[r]
        nx = numbers[ROW_NX]
        ny = numbers[ROW_NY]
        cx = numbers[ROW_CX]
        cy = numbers[ROW_CY]
        normal = work.rows[2 * r]
        tangent = work.rows[2 * r + 1]
        # (N, c × N) and (T, c × T), with T = z × N
        normal[0] = nx
        normal[1] = ny
        normal[2] = cx * ny - cy * nx
        tangent[0] = -ny
        tangent[1] = nx
        tangent[2] = cx * nx + cy * ny
        mx = numbers[OTHER_NX]
        my = numbers[OTHER_NY]
        dx = numbers[OTHER_CX]
        dy = numbers[OTHER_CY]
        if contacts.ids[r, SECOND_BODY] < 0:
            mx = 0.0
            my = 0.0
        normal[3] = -mx
        normal[4] = -my
        normal[5] = -(dx * my - dy * mx)
        tangent[3] = my
        tangent[4] = -mx
        tangent[5] = -(dx * mx + dy * my)
        vx = numbers[TIP_VX]
        vy = numbers[TIP_VY]
        for k in range(2 * r, 2 * r + 2):
            work.ends[k, 0] = contacts.ids[r, FIRST_BODY]
            work.ends[k, 1] = contacts.ids[r, SECOND_BODY]
        work.asked[2 * r] = nx * vx + ny * vy - numbers[ROW_GAP] / dt
        work.asked[2 * r + 1] = nx * vy - ny * vx
    first = 2 * contacts.modes.shape[0]
    for b in range(work.weight.shape[0]):
        work.ends[first + b, 0] = b
        work.ends[first + b, 1] = -1
        work.asked[first + b] = 0.0


@kernel(allocates=False)
def calc_row_velocity(row, i, j, twists):
    """Multiplies a row of J, of the bodies i and j, with the twists (N, 3)."""
    mine = twists[i]
    total = row[0] * mine[0] + row[1] * mine[1] + row[2] * mine[2]
    if j >= 0:
        other = twists[j]
        total += row[3] * other[0] + row[4] * other[1] + row[5] * other[2]
    return total


@kernel(allocates=False)
def respond(inverse, column, i, j, response):
    """Fills in H^-1 times a column of E (6,) of the bodies i and j."""
    for a in range(3):
        row = inverse[i, a]
        response[a] = row[0] * column[0] + row[1] * column[1] + row[2] * column[2]
        if j >= 0:
            row = inverse[j, a]
            response[3 + a] = row[0] * column[3] + row[1] * column[4] + row[2] * column[5]


@kernel(allocates=False)
def couple(row, i, j, response, k, m):
    """Multiplies a row of C, of the bodies i and j, with a response of the bodies k and m."""
    total = 0.0
    # the part of each body that the two have in common
    if i == k:
        total += row[0] * response[0] + row[1] * response[1] + row[2] * response[2]
    elif i == m:
        total += row[0] * response[3] + row[1] * response[4] + row[2] * response[5]
    if j >= 0:
        if j == k:
            total += row[3] * response[0] + row[4] * response[1] + row[5] * response[2]
        elif j == m:
            total += row[3] * response[3] + row[4] * response[4] + row[5] * response[5]
    return total


@kernel(allocates=False)
def calc_compliance(contacts, scales):
    """Calculates the compliance of the pusher's contacts and of two bodies', (m/s)/N.

    That of two bodies goes with the pusher's speed, which does not hang on where the bodies are.
    """
    pair = PAIR_COMPLIANCE * scales.tip_speed / scales.load
    if not scales.disc:
        return pair, pair
    several = contacts.counts[0] > 1
    finger = PUSHER_COMPLIANCE * scales.speed / scales.load if several else 0.0
    return finger, pair


@kernel(allocates=False)
def order_unknowns(contacts, order, count, work):
    """Orders contacts and axes along the chain of bodies, so that W is banded.

    Args:
        contacts: `Contacts` of the step.
        order: (N,) the bodies that take part first, each beside one that wakes it.
        count: how many do.
        work: `ContactWork`; its `sequence` and `length` are filled.
    """
    # the place of every body in the chain
    length = 0
    for b in range(count):
        work.window[order[b], 0] = b
    for k in range(count):
        work.sequence[length] = -1 - order[k]
        length += 1
        # after its axis, the contacts that it has with bodies that come later, or with the pusher
        for r in range(contacts.counts[0]):
            first = work.window[contacts.ids[r, FIRST_BODY], 0]
            second = contacts.ids[r, SECOND_BODY]
            if second >= 0:
                first = min(first, work.window[second, 0])
            if first == k:
                work.sequence[length] = r
                length += 1
    work.length[0] = length

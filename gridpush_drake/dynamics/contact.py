"""Contact of the disc pusher with the object's outline: where, with which normal, at which gap.

All in the body frame. The signed distance from the disc's centre t to the outline has a local minimum on an edge, or at
a convex vertex, for each place the disc can touch; a concave outline has two such places. A contact is a row of

    nx, ny   unit normal N, into the object; the tangent is T = z × N
    cx, cy   the contact point on the outline, m
    gap      distance from the disc's rim to the outline, m; negative where they overlap
    bend     1/|t - vertex| at a vertex (the normal turns as t moves along T), 0 on an edge, 1/m
"""

from math import sqrt

import numpy as np

from gridpush_drake.dynamics.compiled import kernel

MAX_CONTACTS = 2
NX, NY, CX, CY, GAP, BEND = range(6)

_CONVEX_VERTEX, _REFLEX_VERTEX = -1, -2


@kernel()
def find_contacts(ax, ay, bx, by, previous, tx, ty, radius, reach, contacts):
    """Finds the at most two contacts whose gap is within `reach`.

    Args:
        ax, ay, bx, by: (E,) ends of the outline's directed edges, the object on their left, m.
        previous: (E,) index of the edge before each.
        tx, ty: centre of the disc, m.
        radius: of the disc, m.
        reach: contacts with a larger gap are left out, m.
        contacts: (2, 6) filled with the contacts found, nearest first.

    Returns:
        The number of contacts.
    """
    nearest, nearest2 = _CONVEX_VERTEX, np.inf
    best = second = np.inf
    inside_distance2 = np.inf
    inside_edge = -1
    count = 0
    limit = radius + reach
    limit2 = limit * limit
    for i in range(ax.shape[0]):
        ex, ey = bx[i] - ax[i], by[i] - ay[i]
        rx, ry = tx - ax[i], ty - ay[i]
        length2 = ex * ex + ey * ey
        along = rx * ex + ry * ey
        if along < 0.0:
            distance2 = rx * rx + ry * ry
            j = previous[i]
            qx, qy = ax[i] - ax[j], ay[i] - ay[j]
            convex = qx * ey - qy * ex > 0.0
            if distance2 < nearest2:
                nearest2, nearest = distance2, (_CONVEX_VERTEX if convex else _REFLEX_VERTEX)
            if distance2 > limit2 or not convex or rx * qx + ry * qy < 0.0:
                continue
            distance = sqrt(distance2)
            if distance == 0.0:
                continue
            nx, ny = -rx / distance, -ry / distance
            cx, cy, bend = ax[i], ay[i], 1.0 / distance
        elif along < length2:
            across = rx * ey - ry * ex
            distance2 = across * across / length2
            if distance2 < nearest2:
                nearest2, nearest = distance2, i
            if across < 0.0:
                if distance2 < inside_distance2:
                    inside_distance2, inside_edge = distance2, i
                continue
            if distance2 > limit2:
                continue
            length = sqrt(length2)
            distance = across / length
            nx, ny = -ey / length, ex / length
            cx, cy, bend = ax[i] + along / length2 * ex, ay[i] + along / length2 * ey, 0.0
        else:
            continue
        gap = distance - radius
        if gap < best:
            second = best
            for column in range(6):
                contacts[1, column] = contacts[0, column]
            best = gap
            _put(contacts, 0, nx, ny, cx, cy, gap, bend)
        elif gap < second:
            second = gap
            _put(contacts, 1, nx, ny, cx, cy, gap, bend)
        else:
            continue
        count = min(count + 1, MAX_CONTACTS)
    if inside_edge >= 0 and (nearest == inside_edge or nearest == _REFLEX_VERTEX):
        count = _contact_from_inside(ax, ay, bx, by, inside_edge, tx, ty, radius, contacts)
    return count


@kernel()
def _contact_from_inside(ax, ay, bx, by, i, tx, ty, radius, contacts):
    """The disc's centre is inside the object: it leaves through the nearest edge."""
    ex, ey = bx[i] - ax[i], by[i] - ay[i]
    length = sqrt(ex * ex + ey * ey)
    along = ((tx - ax[i]) * ex + (ty - ay[i]) * ey) / length
    distance = ((tx - ax[i]) * ey - (ty - ay[i]) * ex) / length
    _put(
        contacts, 0, -ey / length, ex / length, ax[i] + along * ex / length, ay[i] + along * ey / length,
        distance - radius, 0.0,
    )  # fmt: skip
    return 1


@kernel()
def _put(contacts, row, nx, ny, cx, cy, gap, bend):
    contacts[row, 0] = nx
    contacts[row, 1] = ny
    contacts[row, 2] = cx
    contacts[row, 3] = cy
    contacts[row, 4] = gap
    contacts[row, 5] = bend

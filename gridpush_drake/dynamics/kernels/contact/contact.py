"""Contact of the disc pusher with the object's outline: where, with which normal, at which gap.

All in the body frame. The signed distance from the disc's center t to the outline has a local
minimum on an edge, or at a convex vertex, for each place the disc can touch; a concave outline has
two such places. A contact is a row of

    nx, ny   unit normal N, into the object; the tangent is T = z × N
    cx, cy   the contact point on the outline, m
    gap      distance from the disc's edge to the outline, m; negative where they overlap
    bend     1/|t - vertex| at a vertex (the normal turns as t moves along T), 0 on an edge, 1/m
    feature  index of the edge, or of the edge that starts at the vertex
    gx, gy   -d gap/dt, unit vector; N itself unless `look_ahead` took the two at different places
"""

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.walk_round import calc_distance2

MAX_CONTACTS = 2
"""Contacts that a step can have."""

CONTACT_COLUMNS = 9
"""Numbers in a row that describes a contact."""

NX, NY, CX, CY, GAP, BEND, FEATURE, GX, GY = range(CONTACT_COLUMNS)
"""Places in such a row, see above."""

_CONVEX_VERTEX = -1
_REFLEX_VERTEX = -2
"""What the feature nearest to the disc may be other than an edge, whose index says which it is."""

_STRAIGHT = 1e-9
"""Sine of the turn below which a vertex counts as straight.

It is then convex as seen from outside, and reflex from inside."""


_SKIN = 0.5
"""How far the disc may move before the edges near it are chosen anew, in its radii.

Below 1: a disc that was outside then cannot have come in by more than its radius since."""

_SAFETY = 1e-9
"""Share by which edges are chosen from farther away than they must be, for rounding's sake."""


class Edges(NamedTuple):
    """The outline's directed edges, the object on their left.

    Attributes:
        ax, ay: (E,) where each begins, m.
        bx, by: (E,) where it ends, m.
        previous: (E,) index of the edge before it.
    """

    ax: Any
    ay: Any
    bx: Any
    by: Any
    previous: Any


class NearEdges(NamedTuple):
    """The few edges that the disc can touch before it has moved far, see `find_contacts_near`.

    Attributes:
        chosen: (E,) indices of these edges, ascending, in the first `size[0]` places.
        size: (1,) their number; -1 where the disc was inside the outline, so that all count.
        place: (3,) center of the disc, m, when they were chosen, and how far from it they are at
            most, m; below 0 before the first choice.
    """

    chosen: Any
    size: Any
    place: Any


@kernel()
def make_near_edges(edges):
    """Makes the record of the edges near the disc, with nothing chosen yet."""
    near = NearEdges(
        chosen=np.zeros(edges.ax.shape[0], np.int64),
        size=np.zeros(1, np.int64),
        place=np.zeros(3),
    )
    near.place[2] = -1.0
    return near


@kernel(allocates=False)
def _choose_near_edges(edges, near, tx, ty, limit):
    """Chooses the edges within `limit` of the disc's center, m, or all if that is inside."""
    reach2 = limit * limit * (1.0 + _SAFETY)
    size = 0
    inside = False
    for i in range(edges.ax.shape[0]):
        ax = edges.ax[i]
        ay = edges.ay[i]
        bx = edges.bx[i]
        by = edges.by[i]
        if calc_distance2(ax, ay, bx, by, tx, ty) <= reach2:
            near.chosen[size] = i
            size += 1
        # by how often a ray crosses the outline
        if (ay > ty) != (by > ty) and tx < ax + (ty - ay) / (by - ay) * (bx - ax):
            inside = not inside
    near.size[0] = -1 if inside else size
    near.place[0] = tx
    near.place[1] = ty
    near.place[2] = limit


@kernel(allocates=False)
def find_contacts_near(edges, near, tx, ty, radius, reach, contacts):
    """Finds what `find_contacts` finds, number for number, but looks at the edges near the disc.

    They are chosen anew when the disc has moved away from where it was. Until then every edge that
    is near enough to touch, or to say whether the disc's center is inside, is among them.

    Args:
        near: `NearEdges` of these edges, kept from call to call.

    The other arguments, and what is returned, are those of `find_contacts`.
    """
    dx = tx - near.place[0]
    dy = ty - near.place[1]
    spare = near.place[2] - radius - reach
    if spare < 0.0 or dx * dx + dy * dy > min(spare, _SKIN * radius) ** 2:
        _choose_near_edges(edges, near, tx, ty, radius + reach + _SKIN * radius)
    size = near.size[0]
    count = _find_contacts_among(edges, near.chosen, size, tx, ty, radius, reach, contacts)
    if count < 0:
        count = find_contacts(edges, tx, ty, radius, reach, contacts)
    return count


@kernel(allocates=False)
def find_contacts(edges, tx, ty, radius, reach, contacts):
    """Finds the at most two contacts whose gap is within `reach`.

    Args:
        edges: the outline.
        tx, ty: center of the disc, m.
        radius: of the disc, m.
        reach: contacts with a larger gap are left out, m.
        contacts: (2, 9) filled with the contacts found, nearest first.

    Returns:
        The number of contacts.
    """
    return _find_contacts_among(edges, edges.previous, -1, tx, ty, radius, reach, contacts)


@kernel(allocates=False, inlined=True)
def _find_contacts_among(edges, chosen, size, tx, ty, radius, reach, contacts):
    """Finds contacts among the first `size` of the chosen edges; among all if `size` is negative.

    Returns:
        As `find_contacts`; -1 where a reflex vertex is nearest and not all edges were looked at:
        the edge by which the disc would leave may then be far away.
    """
    ax = edges.ax
    ay = edges.ay
    bx = edges.bx
    by = edges.by
    previous = edges.previous
    # The nearest feature of all says whether the disc's center is inside the object: if that is an
    # edge seen from its inner side, or a reflex vertex.
    nearest = _CONVEX_VERTEX
    nearest2 = np.inf
    best = second = np.inf
    inside_distance2 = np.inf
    inside_edge = -1
    count = 0
    limit = radius + reach
    limit2 = limit * limit
    whole = size < 0
    for n in range(ax.shape[0] if whole else size):
        i = n if whole else chosen[n]
        ex = bx[i] - ax[i]
        ey = by[i] - ay[i]
        rx = tx - ax[i]
        ry = ty - ay[i]
        length2 = ex * ex + ey * ey
        along = rx * ex + ry * ey
        if along < 0.0:
            # Before the edge's beginning: its first vertex is nearest.
            distance2 = rx * rx + ry * ry
            j = previous[i]
            qx = ax[i] - ax[j]
            qy = ay[i] - ay[j]
            turn = qx * ey - qy * ex
            convex = turn > _STRAIGHT * length2 or (
                turn > -_STRAIGHT * length2 and rx * ey > ry * ex
            )
            if distance2 < nearest2:
                nearest2 = distance2
                nearest = _CONVEX_VERTEX if convex else _REFLEX_VERTEX
            # word for word the test of edge j below: where it ends, the vertex begins
            if (
                distance2 > limit2
                or not convex
                or (tx - ax[j]) * qx + (ty - ay[j]) * qy < qx * qx + qy * qy
            ):
                continue
            distance = sqrt(distance2)
            if distance == 0.0:
                continue
            nx = -rx / distance
            ny = -ry / distance
            cx = ax[i]
            cy = ay[i]
            bend = 1.0 / distance
        elif along < length2:
            # Beside the edge: positive `across` is outside.
            across = rx * ey - ry * ex
            distance2 = across * across / length2
            if distance2 < nearest2:
                nearest2 = distance2
                nearest = i
            if across < 0.0:
                if distance2 < inside_distance2:
                    inside_distance2 = distance2
                    inside_edge = i
                continue
            if distance2 > limit2 or (
                along < _STRAIGHT * length2 and _is_on_straight(ax, ay, previous, i, ex, ey, tx, ty)
            ):
                continue
            length = sqrt(length2)
            distance = across / length
            nx = -ey / length
            ny = ex / length
            cx = ax[i] + along / length2 * ex
            cy = ay[i] + along / length2 * ey
            bend = 0.0
        else:
            continue  # beyond the edge's end, which is the next edge's business

        # Keep the two nearest, nearest first.
        gap = distance - radius
        if gap < best:
            second = best
            for column in range(CONTACT_COLUMNS):
                contacts[1, column] = contacts[0, column]
            best = gap
            _write_contact(contacts, 0, nx, ny, cx, cy, gap, bend, i)
        elif gap < second:
            second = gap
            _write_contact(contacts, 1, nx, ny, cx, cy, gap, bend, i)
        else:
            continue
        count = min(count + 1, MAX_CONTACTS)

    if nearest == _REFLEX_VERTEX and not whole:
        return -1
    if inside_edge >= 0 and nearest in (inside_edge, _REFLEX_VERTEX):
        count = _contact_from_inside(ax, ay, bx, by, inside_edge, tx, ty, radius, contacts)
    return count


@kernel(allocates=False)
def _is_on_straight(ax, ay, previous, i, ex, ey, tx, ty):
    """Whether edge i goes straight on from the one before, with the disc beside both."""
    j = previous[i]
    qx = ax[i] - ax[j]
    qy = ay[i] - ay[j]
    straight = abs(qx * ey - qy * ex) <= _STRAIGHT * (ex * ex + ey * ey)
    return straight and (tx - ax[j]) * qx + (ty - ay[j]) * qy < qx * qx + qy * qy


@kernel(allocates=False)
def look_ahead(edges, tx, ty, dx, dy, radius, reach, contacts, ahead):
    """Finds the contacts of the disc where it will be, but with the gaps from where it is.

    Of the displacement expected only the part along the outline counts: it decides which way the
    normal will point and where the contact will be, while the part across is for the contact itself
    to resolve.

    Args:
        edges, tx, ty, radius, reach: as in `find_contacts`.
        dx, dy: displacement of the disc's center that is expected, seen from the body, m.
        contacts: (2, 9) the contacts at (tx, ty), at least one.
        ahead: (2, 9) filled.

    Returns:
        The number of contacts.
    """
    sx, sy = _slide_along(contacts, tx, ty, dx, dy)
    count = find_contacts(edges, sx, sy, radius, reach, ahead)
    _carry_gaps_back(edges, tx, ty, radius, ahead, count)
    return count


@kernel(allocates=False, inlined=True)
def look_ahead_near(edges, near, tx, ty, dx, dy, radius, reach, contacts, ahead):
    """Finds what `look_ahead` finds, among the edges near the disc, see `find_contacts_near`."""
    sx, sy = _slide_along(contacts, tx, ty, dx, dy)
    count = find_contacts_near(edges, near, sx, sy, radius, reach, ahead)
    _carry_gaps_back(edges, tx, ty, radius, ahead, count)
    return count


@kernel(allocates=False, inlined=True)
def _slide_along(contacts, tx, ty, dx, dy):
    """Moves the disc's center by what (dx, dy) has along the outline: t + T (T·(dx, dy))."""
    nx = contacts[0, NX]
    ny = contacts[0, NY]
    slide = nx * dy - ny * dx
    return tx - slide * ny, ty + slide * nx


@kernel(allocates=False, inlined=True)
def _carry_gaps_back(edges, tx, ty, radius, ahead, count):
    """Sets the gaps of contacts that were found further on to those of the disc where it is."""
    ax = edges.ax
    ay = edges.ay
    bx = edges.bx
    by = edges.by
    previous = edges.previous
    for c in range(count):
        i = int(ahead[c, FEATURE])
        if ahead[c, BEND] > 0.0:
            # round a vertex the disc comes from one edge and goes to the other: it must overlap
            # neither
            ahead[c, GAP] = np.inf
            _measure_gap(ax, ay, bx, by, previous[i], tx, ty, radius, ahead, c)
            _measure_gap(ax, ay, bx, by, i, tx, ty, radius, ahead, c)
        else:
            # N·(c - t) - radius, with t where the disc is now.
            ahead[c, GAP] = (
                ahead[c, NX] * (ahead[c, CX] - tx) + ahead[c, NY] * (ahead[c, CY] - ty) - radius
            )


@kernel(allocates=False, inlined=True)
def _measure_gap(ax, ay, bx, by, i, tx, ty, radius, contacts, row):
    """Sets the row's gap, and its direction, to those of the disc and edge i if that is nearer."""
    ex = bx[i] - ax[i]
    ey = by[i] - ay[i]
    rx = ax[i] - tx
    ry = ay[i] - ty
    # from the disc's center to the nearest point of the edge
    length2 = ex * ex + ey * ey
    along = min(max(-(rx * ex + ry * ey) / length2, 0.0), 1.0)
    rx += along * ex
    ry += along * ey
    distance = sqrt(rx * rx + ry * ry)
    if 0.0 < distance < contacts[row, GAP] + radius:
        contacts[row, GAP] = distance - radius
        contacts[row, GX] = rx / distance
        contacts[row, GY] = ry / distance


@kernel(allocates=False)
def _contact_from_inside(ax, ay, bx, by, i, tx, ty, radius, contacts):
    """Writes the contact of a disc whose center is inside: it leaves by edge i, the nearest."""
    ex = bx[i] - ax[i]
    ey = by[i] - ay[i]
    length = sqrt(ex * ex + ey * ey)
    along = ((tx - ax[i]) * ex + (ty - ay[i]) * ey) / length
    distance = ((tx - ax[i]) * ey - (ty - ay[i]) * ex) / length
    cx = ax[i] + along * ex / length
    cy = ay[i] + along * ey / length
    _write_contact(contacts, 0, -ey / length, ex / length, cx, cy, distance - radius, 0.0, i)
    return 1


@kernel(allocates=False, inlined=True)
def _write_contact(contacts, row, nx, ny, cx, cy, gap, bend, feature):
    """Fills in a row; the gap's direction is the normal."""
    contacts[row, NX] = nx
    contacts[row, NY] = ny
    contacts[row, CX] = cx
    contacts[row, CY] = cy
    contacts[row, GAP] = gap
    contacts[row, BEND] = bend
    contacts[row, FEATURE] = feature
    contacts[row, GX] = nx
    contacts[row, GY] = ny

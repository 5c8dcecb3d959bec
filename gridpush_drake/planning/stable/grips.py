"""Grips: places where a pusher of two contacts or more lies flush against an object's outline.

While a push is stable, object and pusher move as one body. A frame S of that body, at X_BS, is then
led as a car is: along its own x axis, with a curvature k between the limits

    k_right <= k <= k_left,      all twists (t + k (y, -x), k) between them being stable,

t the direction of S's x axis and (x, y) its place in B. Which frame allows the tightest turns is
found by trying some: before the contacts, about as far as the object's centroid is, and pointing
about along their normals.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.geometry.polygons import hull_of
from gridpush_drake.geometry.se2 import (
    Array,
    compose,
    invert,
    make_direction,
    turn_left,
    turn_right,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.stable.dubins import FULL_TURN
from gridpush_drake.planning.stable.stable_push import (
    MotionCone,
    PusherContacts,
    calc_turn_twists,
    find_pusher_contacts,
    find_stable_range,
    list_curvatures,
)

STABLE_MARGIN = 0.05
"""Margin that a stable push must have by a draw, sine of an angle: room for what no draw knows."""

GRIP_SPACING = 0.015
"""Distance between grips along a side of the outline, m."""

CHORD_STEP = 0.0005
"""Distance between places of a fingertip's center along the outline, m, between which the other
one's place is interpolated."""

ALIGNED = 0.95
"""Least cosine of the angle between a grip's direction and the normals of its contacts."""

CONTACT_SPREAD = 0.5
"""Least distance of a grip's contacts, as a fraction of the pusher's front."""

HEADINGS = (-0.2, 0.0, 0.2)
"""Directions in which the body is pushed from a grip that are tried, rad from the grip's own."""

AXLES = (0.5, 1.0, 1.5, 2.0)
"""Where S is put, ahead of the contacts in that direction, as fractions of the distance of the
cells' centroid from them."""

FRAME_DRAWS = 5
"""Draws of a model by which the frame S of a grip is chosen."""

MAX_CURVATURE = 20.0
"""The tightest turn that is tried, 1/m."""

FRACTIONS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Curvatures of which arcs are made: fractions of the limit to the right, if negative, or left."""

MAX_GRIPS = 12
"""Grips of which paths are made at most, one of each side of the outline first."""

SIDE_ANGLE = np.pi / 8
"""Two grips whose directions differ by less than this are on the same side, rad."""

AGILITY_OF_ONE_HAND = 0.1
"""How much the greater of both limits counts beside the lesser, where grips are compared."""

END_ROOM = 0.005
"""Distance about a fingertip's contact within which the outline must be about straight, m."""

GRIP_TOLERANCE = 0.0003
"""Gap up to which a grip's contact counts as closed, and depth by which shapes may overlap, m."""


@dataclass(frozen=True, eq=False)
class Grip:
    """A place where the pusher lies flush, and how the body is steered from there.

    Attributes:
        X_BT: (3,) the pusher's frame in the body's, m and rad.
        contacts: where it touches.
        X_BS: (3,) the frame that moves as a car, in the body's, m and rad.
        right: the tightest turn to the right that is stable, 1/m; 0 or less.
        left: that to the left, 0 or more.
        margins: (M, 5) by each draw, those of `curvatures`.
    """

    X_BT: Array
    contacts: PusherContacts
    X_BS: Array
    right: float
    left: float
    margins: Array = field(default_factory=lambda: np.empty((0, len(FRACTIONS))))

    @property
    def curvatures(self) -> Array:
        """(5,) curvatures of which arcs are made, 1/m, those of `FRACTIONS`."""
        fractions = np.array(FRACTIONS)
        return np.where(fractions < 0, -self.right, self.left) * fractions

    @property
    def agility(self) -> float:
        """How tightly the body can be turned to both hands, 1/m: the lesser limit counts most."""
        least, most = sorted((-self.right, self.left))
        return least + AGILITY_OF_ONE_HAND * most


def find_grips(
    bodies: Bodies, shape: PusherShape, draws: Sequence[CellParameters], probability: float
) -> list[Grip]:
    """Finds where the pusher can lie flush and push straight ahead, and how tightly it may turn.

    Args:
        bodies: the object.
        shape: the pusher's, of two contacts or more.
        draws: of the object's parameters.
        probability: least probability that a turn is stable.

    Returns:
        At most `MAX_GRIPS`: of each side of the outline that from which the object can be turned
        most tightly first, and then the next ones.
    """
    obj = bodies.obj
    found = []
    for X_BT in _list_flush_poses(obj, shape):
        contacts = find_pusher_contacts(obj, shape, X_BT, GRIP_TOLERANCE)
        if _is_grip(shape, X_BT, contacts):
            cones = [MotionCone(obj, params, contacts, bodies.physics) for params in draws]
            grip = _steer(obj, cones, X_BT, contacts, probability)
            if grip is not None:
                found.append(grip)

    # the best of each side, then the second of each, and so on
    found.sort(key=lambda grip: -grip.agility)
    taken: Counter[int] = Counter()
    ranks = []
    for grip in found:
        side = round(float(grip.X_BT[2] % FULL_TURN) / SIDE_ANGLE) % round(FULL_TURN / SIDE_ANGLE)
        taken[side] += 1
        ranks.append(taken[side])
    return [found[i] for i in np.argsort(ranks, kind="stable")[:MAX_GRIPS]]


def _list_flush_poses(obj: GridObject, shape: PusherShape) -> list[Array]:
    """Lists poses X_BT (3,) in which the pusher's front may touch the outline at both ends."""
    X_TF, width = _find_front(shape)
    X_FT = invert(X_TF)
    fronts = _list_faces(obj, width) if shape.joined else _list_chords(obj, shape.radius, width)
    return [compose(X_BF, X_FT) for X_BF in fronts]


def _find_front(shape: PusherShape) -> tuple[Array, float]:
    """Finds the straight front of a shape: the one that looks most nearly along T's x axis.

    Returns:
        X_TF (3,) of the frame at its middle, whose x axis points ahead, m and rad; and the distance
        of its ends, m.
    """
    corners = hull_of(shape.core)
    if not len(corners):
        corners = shapely.get_coordinates(shapely.MultiPoint(shape.core).convex_hull)
    after = np.roll(corners, -1, axis=0)
    widths = np.linalg.norm(after - corners, axis=1)
    ahead = turn_right(after - corners) / widths[:, None]
    front = int(np.argmax(ahead[:, 0]))
    middle = (corners[front] + after[front]) / 2 + shape.radius * ahead[front]
    X_TF = np.array([*middle, np.arctan2(ahead[front, 1], ahead[front, 0])])
    return X_TF, float(widths[front])


def _list_faces(obj: GridObject, width: float) -> list[Array]:
    """Lists places X_BF (3,) of a flat front of a width, m, along the sides of the hull."""
    corners = hull_of(obj.edges.start)
    after = np.roll(corners, -1, axis=0)
    places = []
    for begin, end in zip(corners, after, strict=True):
        side = float(np.linalg.norm(end - begin))
        ahead = turn_left(end - begin) / side
        angle = np.arctan2(ahead[1], ahead[0])
        # the shorter of both stays wholly against the longer
        steps = int(abs(side - width) / 2 / GRIP_SPACING)
        for offset in GRIP_SPACING * np.arange(-steps, steps + 1):
            place = (begin + end) / 2 + offset * (end - begin) / side
            places.append(np.array([*place, angle]))
    return places


def _list_chords(obj: GridObject, radius: float, width: float) -> list[Array]:
    """Lists places X_BF (3,) of two fingertips, a width apart, that both touch the outline."""
    ring = obj.outline.buffer(radius).exterior
    if not ring.is_ccw:
        ring = ring.reverse()
    count = int(ring.length / CHORD_STEP)
    places = shapely.line_interpolate_point(ring, ring.length * np.arange(count) / count)
    centers = shapely.get_coordinates(places)
    room = round(END_ROOM / CHORD_STEP)
    tangents = (np.roll(centers, -room, axis=0) - centers) / (room * CHORD_STEP)
    found = []
    for i in range(0, count, round(GRIP_SPACING / CHORD_STEP)):
        # the first place further on that is as far away as the other fingertip
        further = np.roll(centers, -i, axis=0)
        away = np.linalg.norm(further - further[0], axis=1) - width
        beyond = int(np.argmax(away > 0))
        if beyond == 0:
            continue
        fraction = -away[beyond - 1] / (away[beyond] - away[beyond - 1])
        other = further[beyond - 1] + fraction * (further[beyond] - further[beyond - 1])
        along = (other - further[0]) / width
        # at neither of them is a corner, or a side that looks elsewhere
        ends = np.array([i, i + beyond])
        beside = tangents[np.concatenate([ends, ends - room]) % count]
        if (beside @ along < ALIGNED).any():
            continue
        # counterclockwise along the outline, the inside is to the left
        ahead = turn_left(along)
        place = (further[0] + other) / 2 + radius * ahead
        found.append(np.array([*place, np.arctan2(ahead[1], ahead[0])]))
    return found


def _is_grip(shape: PusherShape, X_BT: Array, contacts: PusherContacts) -> bool:
    """Whether contacts hold an object: two or more, far apart, and ahead of the pusher."""
    if len(contacts.points) < 2 or (contacts.gaps < -GRIP_TOLERANCE).any():
        return False
    X_TF, width = _find_front(shape)
    ahead = make_direction(X_BT[2] + X_TF[2])
    spread = np.ptp(contacts.points @ turn_left(ahead))
    return bool((contacts.normals @ ahead >= ALIGNED).all() and spread >= CONTACT_SPREAD * width)


def _steer(
    obj: GridObject,
    cones: Sequence[MotionCone],
    X_BT: Array,
    contacts: PusherContacts,
    probability: float,
) -> Grip | None:
    """Chooses the frame S of a grip that can turn most tightly; None where none goes straight."""
    middle = contacts.points.mean(axis=0)
    normal = contacts.normals.sum(axis=0)
    angle = np.arctan2(normal[1], normal[0])
    depth = float((obj.p_BC.mean(axis=0) - middle) @ make_direction(angle))
    frames = [
        np.array([*(middle + axle * depth * make_direction(heading)), heading])
        for heading in angle + np.array(HEADINGS)
        for axle in AXLES
    ]
    curvature = list_curvatures(MAX_CURVATURE)

    # some of the draws choose the frame, all of them its limits
    best: Grip | None = None
    for X_BS in frames:
        limits = _find_limits(cones[:FRAME_DRAWS], X_BS, curvature, probability)
        if limits is not None:
            grip = Grip(X_BT, contacts, X_BS, *limits)
            if best is None or grip.agility > best.agility:
                best = grip
    limits = None if best is None else _find_limits(cones, best.X_BS, curvature, probability)
    if best is None or limits is None:
        return None
    grip = replace(best, right=limits[0], left=limits[1])
    twists = calc_turn_twists(grip.X_BS, grip.curvatures)
    return replace(grip, margins=np.array([cone.calc_margins(twists) for cone in cones]))


def _find_limits(
    cones: Sequence[MotionCone], X_BS: Array, curvature: Array, probability: float
) -> tuple[float, float] | None:
    """Finds how tightly a frame S may turn to both hands, 1/m; None where it cannot go straight."""
    twists = calc_turn_twists(X_BS, curvature)
    margins = np.array([cone.calc_margins(twists) for cone in cones])
    stable = (margins > STABLE_MARGIN).mean(axis=0) >= probability
    return find_stable_range(curvature, stable)

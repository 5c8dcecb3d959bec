"""What all searches for plans share: plans, the strokes that end them, and small changes of them.

A plan is a sequence of places, one a decision, to which a finger or a disc goes. A search makes a
candidate from the best plan known: it replaces the plan's end with a *stroke* (go round the object
to a place of its outline, and push there), or shifts some of its places a little. How the object
moves under a candidate, and what that costs, is each search's own business:
`planning.feedback.push_search` and `bench.pusht.stroke_search`.

The theory is in `docs/theory/feedback.md`.
"""

from math import cos, sin
from typing import Any, NamedTuple

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.walk_round import find_way

PRIMITIVE_SIZE = 7
"""Numbers that describe a stroke."""

PLACE, ANGLE, LENGTH, BEND, WALK, ROUND, SPIN = range(PRIMITIVE_SIZE)
"""Places in a stroke: where round the object it touches, 0 to 1, or below 0 for a push at once; its
angle from the inward normal there, rad, or from the body's x axis for a push at once; how far ahead
the next place is while it pushes; by how much it turns in a decision, rad, seen from the object;
how far ahead the next place is on the way round, in a measure that each search chooses; 1 or -1
for the way round, counterclockwise or clockwise; and by how much a finger that is no disc turns
itself in a decision while it pushes, rad."""

CHANGE_POINTS = 3
"""A change of a plan is described by all coordinates of a place at the window's begin, end and
middle."""

WINDOW_COUNT = 3
"""Number of windows of a plan that are changed in turn."""

WHOLE, SECOND_HALF, END = range(WINDOW_COUNT)
"""These windows: the whole plan, its second half, and its last decisions."""

END_DECISIONS = 4
"""Decisions in the window END."""


class Plan(NamedTuple):
    """Places of the finger, one a decision, and where they lead.

    Attributes:
        targets: (T, D) places: x and y, and the angle of a finger that is no disc.
        states: (T + 1, S) states before and after them, each as the search's law of motion has it.
    """

    targets: Any
    states: Any


class Aim(NamedTuple):
    """Where a stroke begins, body frame.

    Attributes:
        pushing: whether it pushes at once.
        heading: direction of the push, rad.
        x, y: place of the finger from which it pushes, or comes near; unused where it pushes at
            once, as what follows.
        yaw: angle of a finger that is no disc, rad.
        near_x, near_y: place to which it comes near before it pushes; x and y of a disc.
    """

    pushing: Any
    heading: Any
    x: Any
    y: Any
    yaw: Any
    near_x: Any
    near_y: Any


@kernel(allocates=False)
def take_plan(candidate, plan, first, end):
    """Makes the best plan the candidate, from decision `first` on.

    Args:
        candidate: a record with `targets` and `states` of the shapes that those of `plan` have.
        plan: the best plan.
        first, end: decisions; the candidate begins with the state before `first`.
    """
    for k in range(first, end):
        for j in range(plan.targets.shape[1]):
            candidate.targets[k, j] = plan.targets[k, j]
    for i in range(plan.states.shape[1]):
        candidate.states[first, i] = plan.states[first, i]


@kernel(allocates=False)
def keep_plan(candidate, plan, first, end):
    """Makes the candidate the best plan; both are the same before decision `first`.

    The arguments are those of `take_plan`.
    """
    for k in range(first, end):
        for j in range(plan.targets.shape[1]):
            plan.targets[k, j] = candidate.targets[k, j]
        for i in range(plan.states.shape[1]):
            plan.states[k + 1, i] = candidate.states[k + 1, i]


@kernel(allocates=False)
def find_cut(fraction, length, limit):
    """Finds the decision at which a stroke begins, by the fraction, 0 to 1, of the plan's `length`.

    At least the last of the `limit` decisions that a plan may have is left to the stroke.
    """
    return min(int(fraction * (length + 1)), length, limit - 1)


@kernel(allocates=False)
def aim_primitive(ways, primitive):
    """Finds where a stroke begins, as an `Aim`; `ways` are `walk_round.OutlinePath`."""
    heading = primitive[ANGLE]
    if primitive[PLACE] < 0.0:
        return Aim(pushing=True, heading=heading, x=0.0, y=0.0, yaw=0.0, near_x=0.0, near_y=0.0)
    count = ways.touch.shape[0]
    touch = min(int(primitive[PLACE] * count), count - 1)
    inward = ways.inward[touch]
    return Aim(
        pushing=False,
        heading=heading + inward,
        x=ways.touch[touch, 0] - ways.standoff * cos(inward),
        y=ways.touch[touch, 1] - ways.standoff * sin(inward),
        yaw=inward,
        near_x=ways.near[touch, 0],
        near_y=ways.near[touch, 1],
    )


@kernel(allocates=False)
def walk_to_aim(ways, primitive, aim, x, y, theta, tip_x, tip_y, at):
    """Finds the farthest point in sight on the way to where a stroke begins.

    Args:
        ways: `walk_round.OutlinePath` of the object.
        primitive: (PRIMITIVE_SIZE,) the stroke.
        aim: its `Aim`.
        x, y, theta: pose of the object in W.
        tip_x, tip_y: where the finger is, W.
        at: (2,) filled with that point, W, unless the finger has arrived.

    Returns:
        Whether the finger has arrived.
    """
    # the finger, seen from the body
    c = cos(theta)
    s = sin(theta)
    dx = tip_x - x
    dy = tip_y - y
    ax = c * dx + s * dy
    ay = c * dy - s * dx
    if (aim.x - ax) ** 2 + (aim.y - ay) ** 2 < ways.arrival**2:
        return True
    turn = 1 if primitive[ROUND] > 0.0 else -1
    find_way(ways, ax, ay, aim.x, aim.y, turn, at)
    # back to W
    body_x = at[0]
    body_y = at[1]
    at[0] = x + c * body_x - s * body_y
    at[1] = y + s * body_x + c * body_y
    return False


@kernel(allocates=False)
def begin_window(turn, length):
    """Finds the first decision of the window of a plan that is changed in a turn, 0, 1, ..."""
    window = turn % WINDOW_COUNT
    if window == SECOND_HALF:
        return length // 2
    if window == END:
        return max(length - END_DECISIONS, 0)
    return 0


@kernel(allocates=False)
def shift_places(targets, change, scale, first, stop):
    """Shifts the places of a window of a plan by a parabola in time.

    Args:
        targets: (T, D) places, of which those from `first` to before `stop` are shifted.
        change: (CHANGE_POINTS D,) the parabola: shifts at begin and end, and what is added in the
            middle.
        scale: factor of the shifts.
        first, stop: the window.
    """
    width = max(stop - first - 1, 1)
    size = targets.shape[1]
    for k in range(first, stop):
        t = (k - first) / width
        u = 1.0 - t
        for j in range(size):
            middle = change[2 * size + j]
            shift = u * change[j] + t * change[size + j] + 2.0 * u * t * middle
            targets[k, j] += scale * shift

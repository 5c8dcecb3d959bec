"""`ScenePush`: a push of several objects that was tried, and where such a push may be cut.

How pushes are searched for is in `search`.
"""

from dataclasses import dataclass

from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array


@dataclass(frozen=True, eq=False)
class ScenePush:
    """A push that was tried, cut to its best length.

    Attributes:
        body: number of the object on whose outline it begins.
        arc_length: where on its exterior outline, m; see `Push.on_outline`.
        angle: of the motion from the inward normal there, rad.
        push: the push.
        poses: (N, 3) where the best model leaves the objects, m and rad.
        cost: time of the push and what is left then, s.
        left: what is left alone, s.
    """

    body: int
    arc_length: float
    angle: float
    push: Push
    poses: Array
    cost: float
    left: float


@dataclass(frozen=True, eq=False)
class PushStop:
    """Where a push is cut.

    Attributes:
        traveled: length of the pusher's path until then, m.
        poses: (N, 3) the objects then, m and rad.
        left: what is left then, s.
    """

    traveled: float
    poses: Array
    left: float


def cut_push(push: Push, distance: float) -> Push:
    """Returns the beginning of a straight push, up to a distance, m."""
    fraction = min(distance / push.length, 1.0)
    return push.shorten(push.duration * fraction)

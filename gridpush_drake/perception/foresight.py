"""Where a push takes an object that a camera does not see meanwhile.

While the arm hides an object, the finger's tip is known all the same, and a model says where its
push takes the object. That tells apart the poses at which it looks the same turned round, see
docs/theory/perception.md, section 3. The model need not be exact: it is believed to a part of the
way that it foretells.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.look_alikes import Expectation

PLACE_SHARE = 0.3
"""Standard deviation of the place that a model predicts, as a part of the way."""

TURN_SHARE = 0.4
"""Standard deviation of the angle that a model predicts, as a part of the turn."""

LEAST_DEVIATIONS = (0.005, 0.1)
"""Least standard deviations of place, m, and angle, rad, of what a model predicts."""

LEAST_STEP = 1e-6
"""A tip that moved by less than this between two pictures pushes nothing, m."""


@dataclass(frozen=True, eq=False)
class PushModel:
    """What a push does to an object, as far as it is known.

    Attributes:
        obj: the object, in the body frame that is tracked.
        top: height of the object, m; a tip above it pushes nothing.
        radius: radius of the finger's tip, m.
    """

    obj: GridObject
    top: float
    radius: float


class Tip(NamedTuple):
    """A place of the finger's tip.

    Attributes:
        t: when it was there, s.
        place: (3,) p_WP of its center, m; NaN where it pushes nothing and yet may move the object,
            as in a grasp.
    """

    t: float
    place: Array


@dataclass(frozen=True, eq=False)
class Foresight:
    """Where an object is foretold to be since it was last seen.

    Attributes:
        told: (3,) the pose last told, W, m and rad.
        pose: (3,) where the pushes since then take it.
        known: whether the model has been told of all that may have moved it.
        pushed: whether a push has moved it in the model.
    """

    told: Array
    pose: Array
    known: bool = True
    pushed: bool = False

    def expect(self) -> Expectation | None:
        """Says where the object is expected; None where the model says nothing of it."""
        if not (self.known and self.pushed):
            return None
        way = float(np.linalg.norm(self.pose[:2] - self.told[:2]))
        turn = abs(float(wrap_angle(self.pose[2] - self.told[2])))
        return make_expectation(self.pose, way, turn)


def make_expectation(pose: Array, way: float, turn: float) -> Expectation:
    """Makes the expectation of an object that a model foretells.

    Args:
        pose: (3,) where it is foretold, W, m and rad.
        way: how far it moves in the model, m.
        turn: how far it turns in the model, rad.

    Returns:
        The expectation: the longer the way, the less sure.
    """
    return Expectation(
        pose=pose,
        place_deviation=max(LEAST_DEVIATIONS[0], PLACE_SHARE * way),
        turn_deviation=max(LEAST_DEVIATIONS[1], TURN_SHARE * turn),
    )


def foresee(
    before: Foresight,
    model: PushModel,
    read_params: Callable[[], CellParameters],
    last: Tip,
    now: Tip,
) -> Foresight:
    """Foretells where an object is after the tip went straight from one place to another.

    Args:
        before: where it was foretold before.
        model: the object and the tip.
        read_params: gives masses and frictions of the object's cells; it is called only where the
            tip may have pushed.
        last: the tip in the picture before.
        now: the tip now.

    Returns:
        Where it is now. The model is not known any more where the tip was not, or where it cannot
        follow the push.
    """
    places = np.array([last.place, now.place])
    if not np.isfinite(places).all() or now.t <= last.t:
        return replace(before, known=False)

    # A tip above the object moves nothing, nor does one that rests.
    on_table = places[:, :2]
    if places[:, 2].min() > model.top or np.ptp(on_table, axis=0).max() < LEAST_STEP:
        return before
    try:
        push = Push.along([last.t, now.t], on_table, model.radius)
        motion = simulate(model.obj, read_params(), push, before.pose, regime="quasi_static")
    except GridPushError:
        return replace(before, known=False)
    if motion.status == MotionStatus.NO_CONTACT:
        return before
    if motion.status != MotionStatus.OK:
        return replace(before, known=False)
    return replace(before, pose=motion.final_pose, pushed=True)

"""The pose of an object in the plane as Drake's LCM message `lcmt_planar_manipuland_status`, of whoever tracks it."""

import numpy as np
from drake import lcmt_planar_manipuland_status
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly

MICROSECONDS = 1e6
"""Microseconds in a second."""

KEPT = 32
"""Number of last poses that a receiver remembers."""

LARGEST_POSE = 1e6
"""A pose with a number beyond this, m or rad, was not measured, and counts as not seen."""


class PlanarManipulandStatusReceiver(LeafSystem):
    """Reads an object's pose from messages; what is too old counts as not seen.

    .. pydrake_system::

        name: PlanarManipulandStatusReceiver
        input_ports:
        - message
        - time
        output_ports:
        - object_pose
        - newest_pose

    * message: abstract `lcmt_planar_manipuland_status`, X_WB of the object's body frame; its
      `utime` grows from message to message, and is 0 before the first. Where it is smaller than
      before, its clock was set back, and the poses before that are forgotten. A pose that is not
      finite says that the object is not seen.
    * time: vector of 1, s, by the clock that `utime` is of. It need not be connected.
    * object_pose: vector of 3, x and y in W, m, and yaw, rad; the yaw is continuous, it counts
      whole turns. It is of `delay` ago, between the messages before and after; as last seen where
      none came since, or where the time is not known. NaN where the object was not seen then, or no
      message came for `max_age`.
    * newest_pose: vector of 3, as the last message has it, whatever the delay: for who must notice
      a jump at once.
    """

    __slots__ = NO_SLOTS

    def __init__(self, period: float, max_age: float, delay: float = 0.0) -> None:
        """Makes the receiver.

        Args:
            period: between two looks at the message, s.
            max_age: since the last message, after which the object is not seen, s.
            delay: see above, s.
        """
        super().__init__()
        self._max_age, self._delay = max_age, delay
        self._message = self.DeclareAbstractInputPort(
            "message", AbstractValue.Make(lcmt_planar_manipuland_status())
        )
        self._time = self.DeclareVectorInputPort("time", 1)
        self._pose = self.DeclareDiscreteState(np.full(3, np.nan))
        self._kept = self.DeclareDiscreteState(
            np.tile([-np.inf, np.nan, np.nan, np.nan], KEPT)
        )  # rows: s, and a pose
        self._newest = self.DeclareDiscreteState(np.full(3, np.nan))
        self._yaw = self.DeclareDiscreteState(1)
        self._last = self.DeclareDiscreteState(
            2
        )  # the last message's utime, us, and when it came, s
        self.DeclareStateOutputPort("object_pose", self._pose)
        self.DeclareStateOutputPort("newest_pose", self._newest)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._look)

    def _look(self, context: Context, state: DiscreteValues) -> None:
        message, time = self._message.Eval(context), context.get_time()
        utime, came = context.get_discrete_state(self._last).value()
        kept = context.get_discrete_state(self._kept).value().reshape(KEPT, 4)
        if message.utime != utime:
            state.set_value(self._last, [message.utime, time])
            yaw = float(context.get_discrete_state(self._yaw).value()[0])
            seen = np.array([*message.position, message.theta])
            pose = np.full(3, np.nan)
            if (np.abs(seen) <= LARGEST_POSE).all():  # false for NaN
                pose = np.array([*seen[:2], yaw + wrap_angle(seen[2] - yaw)])
                state.set_value(self._yaw, pose[2:])
            if message.utime < utime:
                kept = np.tile([-np.inf, np.nan, np.nan, np.nan], (KEPT, 1))
            came, kept = time, np.vstack([kept[1:], [message.utime / MICROSECONDS, *pose]])
            state.set_value(self._kept, kept.ravel())
        clock = (
            float(self._time.Eval(context)[0]) - self._delay
            if self._time.HasValue(context)
            else np.inf
        )
        lost = time - came > self._max_age
        state.set_value(self._pose, np.full(3, np.nan) if lost else find_pose(kept, clock))
        state.set_value(self._newest, np.full(3, np.nan) if lost else kept[-1, 1:])


def find_pose(kept: Array, time: float) -> Array:
    """Finds a pose (3,) at a time, s, in rows (n, 4) of times that increase and poses; beyond them the next one.

    It is NaN where a row beside it is.
    """
    after = int(np.searchsorted(kept[:, 0], time))
    if after in (0, len(kept)):
        return kept[min(after, len(kept) - 1), 1:]
    (t0, *_), (t1, *_) = kept[after - 1], kept[after]
    share = (time - t0) / (t1 - t0) if np.isfinite(t0) else 1.0
    return (
        kept[after, 1:]
        if share == 1.0
        else (1 - share) * kept[after - 1, 1:] + share * kept[after, 1:]
    )


class PlanarManipulandStatusSender(LeafSystem):
    """Makes messages of an object's pose.

    .. pydrake_system::

        name: PlanarManipulandStatusSender
        input_ports:
        - object_pose
        output_ports:
        - message

    * object_pose: vector of 3, x and y in W, m, and yaw, rad; NaN where the object is not seen.
    * message: abstract `lcmt_planar_manipuland_status` with the Context's time; its velocities are
      0.
    """

    __slots__ = NO_SLOTS

    def __init__(self) -> None:
        """Declares the ports."""
        super().__init__()
        self._pose = self.DeclareVectorInputPort("object_pose", 3)
        self.DeclareAbstractOutputPort(
            "message",
            lambda: AbstractValue.Make(lcmt_planar_manipuland_status()),
            weakly(self._calc),
        )

    def _calc(self, context: Context, output: AbstractValue) -> None:
        output.set_value(make_status(context.get_time(), self._pose.Eval(context)))


def make_status(time: float, pose: Array) -> lcmt_planar_manipuland_status:
    """Makes the message of a pose (3,), m and rad, that was seen at a time, s; NaN where it was not."""
    message = lcmt_planar_manipuland_status()
    message.utime = round(MICROSECONDS * time)
    *message.position, message.theta = pose.tolist()
    return message

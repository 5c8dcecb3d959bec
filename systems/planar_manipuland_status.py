"""An object's pose in the plane as Drake's LCM message `lcmt_planar_manipuland_status`."""

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

UNKNOWN_ROW = (-np.inf, np.nan, np.nan, np.nan)
"""Time and pose of a message that did not come yet."""

LARGEST_POSE = 1e6
"""A pose with a number beyond this, m or rad, was not measured, and counts as not seen."""


class PlanarManipulandStatusReceiver(LeafSystem):
    """Reads an object's pose from messages; an object with no recent message counts as not seen.

    .. pydrake_system::

        name: PlanarManipulandStatusReceiver
        input_ports:
        - message
        - time
        output_ports:
        - object_pose
        - newest_pose

    * message: abstract `lcmt_planar_manipuland_status`, with X_WB of the object's body frame. Its
      `utime` grows from message to message, and is 0 before the first. If it is smaller than
      before, the sender's clock was set back, and the poses before that are forgotten. A pose that
      is not finite says that the object is not seen.
    * time: vector of 1, time by the clock of `utime`, s. It need not be connected.
    * object_pose: vector of 3, x and y of B in W, m, and yaw, rad, which counts whole turns. It is
      the pose of `delay` ago, interpolated between the messages before and after. If no message
      came since, or the time is not known, it is the newest pose. NaN if the object was not seen
      then, or no message came for `max_age`.
    * newest_pose: vector of 3, the pose of the last message, whatever the delay, m and rad. A guard
      reads it, which must notice a jump at once.
    """

    __slots__ = NO_SLOTS

    def __init__(self, period: float, max_age: float, delay: float = 0.0) -> None:
        """Makes the receiver.

        Args:
            period: time between two looks at the message, s.
            max_age: if the last message is older than this, the object is not seen, s.
            delay: age of the pose on `object_pose`, s.
        """
        super().__init__()
        self._max_age = max_age
        self._delay = delay
        self._message = self.DeclareAbstractInputPort(
            "message", AbstractValue.Make(lcmt_planar_manipuland_status())
        )
        self._time = self.DeclareVectorInputPort("time", 1)
        self._pose = self.DeclareDiscreteState(np.full(3, np.nan))
        # The last poses, row by row: time, s, x, y and yaw.
        self._kept = self.DeclareDiscreteState(np.tile(UNKNOWN_ROW, KEPT))
        self._newest = self.DeclareDiscreteState(np.full(3, np.nan))
        # The last yaw that was seen, with its whole turns, rad.
        self._yaw = self.DeclareDiscreteState(1)
        # The last message: its utime, us, and when it came, s.
        self._last = self.DeclareDiscreteState(2)
        self.DeclareStateOutputPort("object_pose", self._pose)
        self.DeclareStateOutputPort("newest_pose", self._newest)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._look)

    def _look(self, context: Context, state: DiscreteValues) -> None:
        """Takes in a new message, and sets the poses on the ports."""
        message = self._message.Eval(context)
        time = context.get_time()
        utime, came = context.get_discrete_state(self._last).value()
        kept = context.get_discrete_state(self._kept).value().reshape(KEPT, 4)
        if message.utime != utime:
            came = time
            state.set_value(self._last, [message.utime, time])
            if message.utime < utime:
                kept = np.tile(UNKNOWN_ROW, (KEPT, 1))
            pose = self._read_pose(context, state, message)
            kept = np.vstack([kept[1:], [message.utime / MICROSECONDS, *pose]])
            state.set_value(self._kept, kept.ravel())
        if time - came > self._max_age:
            state.set_value(self._pose, np.full(3, np.nan))
            state.set_value(self._newest, np.full(3, np.nan))
            return
        wanted = np.inf
        if self._time.HasValue(context):
            wanted = float(self._time.Eval(context)[0]) - self._delay
        state.set_value(self._pose, find_pose(kept, wanted))
        state.set_value(self._newest, kept[-1, 1:])

    def _read_pose(
        self, context: Context, state: DiscreteValues, message: lcmt_planar_manipuland_status
    ) -> Array:
        """Reads the pose (3,) in a message, with the whole turns of the yaw; NaN if not seen."""
        seen = np.array([*message.position, message.theta])
        if not (np.abs(seen) <= LARGEST_POSE).all():  # also true of NaN
            return np.full(3, np.nan)
        yaw = float(context.get_discrete_state(self._yaw).value()[0])
        pose = np.array([*seen[:2], yaw + wrap_angle(seen[2] - yaw)])
        state.set_value(self._yaw, pose[2:])
        return pose


def find_pose(kept: Array, time: float) -> Array:
    """Finds the pose at a time by interpolation.

    Args:
        kept: (n, 4) rows of time, s, and pose, m and rad; the times increase.
        time: time of the wanted pose, s.

    Returns:
        (3,) the pose; the first or the last one if the time is before or after all of them. NaN
        if a pose between which it lies is NaN.
    """
    after = int(np.searchsorted(kept[:, 0], time))
    if after == 0:
        return kept[0, 1:]
    if after == len(kept):
        return kept[-1, 1:]
    t0 = kept[after - 1, 0]
    t1 = kept[after, 0]
    share = (time - t0) / (t1 - t0) if np.isfinite(t0) else 1.0
    if share == 1.0:  # here the pose before does not matter, which may be NaN
        return kept[after, 1:]
    interpolated: Array = (1 - share) * kept[after - 1, 1:] + share * kept[after, 1:]
    return interpolated


class PlanarManipulandStatusSender(LeafSystem):
    """Makes messages of an object's pose.

    .. pydrake_system::

        name: PlanarManipulandStatusSender
        input_ports:
        - object_pose
        output_ports:
        - message

    * object_pose: vector of 3, x and y of B in W, m, and yaw, rad; NaN if the object is not seen.
    * message: abstract `lcmt_planar_manipuland_status` with this pose and the Context's time; its
      velocities are 0.
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
    """Makes the message of a pose (3,), m and rad, that was seen at a time, s; NaN if not seen."""
    message = lcmt_planar_manipuland_status()
    message.utime = round(MICROSECONDS * time)
    *message.position, message.theta = pose.tolist()
    return message

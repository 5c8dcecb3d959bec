"""The pose of an object in the plane as Drake's LCM message `lcmt_planar_manipuland_status`, of whoever tracks it."""

from typing import Any

import numpy as np
from drake import lcmt_planar_manipuland_status
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly

MICROSECONDS = 1e6
"""In a second."""


class PlanarManipulandStatusReceiver(LeafSystem):
    """Reads an object's pose from messages; what is too old counts as not seen.

    .. pydrake_system::

        name: PlanarManipulandStatusReceiver
        input_ports:
        - message
        output_ports:
        - object_pose

    * message: abstract `lcmt_planar_manipuland_status`, X_WB of the object's body frame; its `utime` differs from
      message to message, and is 0 before the first. A pose that is not finite says that the object is not seen.
    * object_pose: vector of 3, x and y in W, m, and yaw, rad, as last seen; the yaw is continuous, it counts whole
      turns. NaN where the object is not seen, or no message came for `max_age`.
    """

    __slots__ = NO_SLOTS

    def __init__(self, period: float, max_age: float) -> None:
        """Makes the receiver.

        Args:
            period: between two looks at the message, s.
            max_age: since the last message, after which the object is not seen, s.
        """
        super().__init__()
        self._max_age = max_age
        self._message = self.DeclareAbstractInputPort("message", AbstractValue.Make(lcmt_planar_manipuland_status()))
        self._pose = self.DeclareDiscreteState(np.full(3, np.nan))
        self._yaw = self.DeclareDiscreteState(1)
        self._last = self.DeclareDiscreteState(2)  # the last message's utime, us, and when it came, s
        self.DeclareStateOutputPort("object_pose", self._pose)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._look)

    def _look(self, context: Context, state: Any) -> None:
        message, time = self._message.Eval(context), context.get_time()
        utime, came = context.get_discrete_state(self._last).value()
        if message.utime != utime:
            state.set_value(self._last, [message.utime, time])
            yaw = float(context.get_discrete_state(self._yaw).value()[0])
            pose = np.array([*message.position, yaw + wrap_angle(message.theta - yaw)])
            if np.isfinite(pose).all():
                state.set_value(self._yaw, pose[2:])
            state.set_value(self._pose, pose if np.isfinite(pose).all() else np.full(3, np.nan))
        elif time - came > self._max_age:
            state.set_value(self._pose, np.full(3, np.nan))


class PlanarManipulandStatusSender(LeafSystem):
    """Makes messages of an object's pose.

    .. pydrake_system::

        name: PlanarManipulandStatusSender
        input_ports:
        - object_pose
        output_ports:
        - message

    * object_pose: vector of 3, x and y in W, m, and yaw, rad; NaN where the object is not seen.
    * message: abstract `lcmt_planar_manipuland_status` with the Context's time; its velocities are 0.
    """

    __slots__ = NO_SLOTS

    def __init__(self) -> None:
        """Declares the ports."""
        super().__init__()
        self._pose = self.DeclareVectorInputPort("object_pose", 3)
        self.DeclareAbstractOutputPort(
            "message", lambda: AbstractValue.Make(lcmt_planar_manipuland_status()), weakly(self._calc)
        )

    def _calc(self, context: Context, output: AbstractValue) -> None:
        message, (x, y, theta) = lcmt_planar_manipuland_status(), self._pose.Eval(context).tolist()
        message.utime = round(MICROSECONDS * context.get_time())
        message.position, message.theta = [x, y], theta
        output.set_value(message)

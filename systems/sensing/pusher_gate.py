"""`PusherGate`: hides the finger's tip from the identifier in grasps and presses, no pushes."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.systems.base.messages import GraspStatus, PressStatus

PUSHER_STATE_SIZE = 6
"""Length of the tip's state: p_WP, m, and v_WP, m/s."""


class PusherGate(LeafSystem):
    """Passes the tip's state on, but not during a grasp or a press.

    .. pydrake_system::

        name: PusherGate
        input_ports:
        - pusher_state
        - grasp_status
        - press_status
        output_ports:
        - pusher_state

    * pusher_state (input): vector of 6, position p_WP of the tip's center, m, and its velocity
      v_WP, m/s.
    * grasp_status: abstract `GraspStatus` of the executor of grasps.
    * press_status: abstract `PressStatus` of the executor of presses; it need not be connected.
    * pusher_state (output): vector of 6, the input's value while both executors are idle, else NaN.
    """

    __slots__ = NO_SLOTS

    def __init__(self) -> None:
        """Declares the ports."""
        super().__init__()
        self._pusher = self.DeclareVectorInputPort("pusher_state", PUSHER_STATE_SIZE)
        self._status = self.DeclareAbstractInputPort(
            "grasp_status", AbstractValue.Make(GraspStatus())
        )
        self._press_status = self.DeclareAbstractInputPort(
            "press_status", AbstractValue.Make(PressStatus())
        )
        self.DeclareVectorOutputPort(
            "pusher_state",
            PUSHER_STATE_SIZE,
            weakly(self._calc),
            {self._pusher.ticket(), self._status.ticket(), self._press_status.ticket()},
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        press = self._press_status
        pressing = press.HasValue(context) and not press.Eval(context).ready
        if self._status.Eval(context).ready and not pressing:
            output.SetFromVector(self._pusher.Eval(context))
        else:
            output.SetFromVector(np.full(PUSHER_STATE_SIZE, np.nan))

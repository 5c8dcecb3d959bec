"""Hides the finger's tip from whoever learns from pushes while the tool grasps: those motions are no pushes."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.systems.messages import GraspStatus

PUSHER_STATE_SIZE = 6


class PusherGate(LeafSystem):
    """Passes the tip's state on, but not during a grasp.

    .. pydrake_system::

        name: PusherGate
        input_ports:
        - pusher_state
        - grasp_status
        output_ports:
        - pusher_state

    * pusher_state (input): vector of 6, the tip's center p_WP, m, and its velocity v_WP, m/s, in W.
    * grasp_status: abstract `GraspStatus` of the grasp executor.
    * pusher_state (output): vector of 6, the same while the grasp executor is idle, else NaN.
    """

    __slots__ = NO_SLOTS

    def __init__(self) -> None:
        """Declares the ports."""
        super().__init__()
        self._pusher = self.DeclareVectorInputPort("pusher_state", PUSHER_STATE_SIZE)
        self._status = self.DeclareAbstractInputPort(
            "grasp_status", AbstractValue.Make(GraspStatus())
        )
        self.DeclareVectorOutputPort(
            "pusher_state",
            PUSHER_STATE_SIZE,
            weakly(self._calc),
            {self._pusher.ticket(), self._status.ticket()},
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        idle = self._status.Eval(context).ready
        output.SetFromVector(
            self._pusher.Eval(context) if idle else np.full(PUSHER_STATE_SIZE, np.nan)
        )

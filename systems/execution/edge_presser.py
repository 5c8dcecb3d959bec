"""`EdgePresser`: presses on what hangs over the table's edge; `planning.weighing` between ports."""

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.planning.weighing.press import (
    PressOptions,
    PressSample,
    PressState,
    advance_press,
)
from gridpush_drake.systems.base.messages import PRESS_COMMAND_SIZE, PressCommand

DEFAULT_PERIOD = 0.01
"""Time between two samples, s."""


class EdgePresser(LeafSystem):
    """Presses on a part of an object that hangs over the table's edge, as a command says.

    Each new command is one press, see `planning.weighing.press`. The tip goes straight to its
    place over the object, so that it is to be near there, and higher than the object.

    .. pydrake_system::

        name: EdgePresser
        input_ports:
        - press_command
        - pusher_state
        - force
        output_ports:
        - tip_command
        - press_status

    * press_command: vector of 11, see `PressCommand`; a command is new when its id is.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity v_WP, m/s.
    * force: vector of 3, force on the tip in W, N, with whatever offset it has.
    * tip_command: vector of 6, where the tip's center is to be, m, and its velocity, m/s. Before
      the first command, and after a press, it stays where it is.
    * press_status: abstract `PressState` of the last command.

    Abstract states: the last `PressCommand`, and its `PressState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        tip_radius: float,
        options: PressOptions | None = None,
        *,
        period: float = DEFAULT_PERIOD,
    ) -> None:
        """Declares the system.

        Args:
            tip_radius: radius of the tip's sphere, m.
            options: how presses are made.
            period: time between two samples, s.
        """
        super().__init__()
        self._tip_radius = tip_radius
        self._options = options or PressOptions()
        self._command = self.DeclareVectorInputPort("press_command", PRESS_COMMAND_SIZE)
        self._tip = self.DeclareVectorInputPort("pusher_state", 6)
        self._force = self.DeclareVectorInputPort("force", 3)
        self._taken = self.DeclareAbstractState(Value(PressCommand()))
        self._state = self.DeclareAbstractState(Value(PressState()))
        states = {
            self.abstract_state_ticket(self._taken),
            self.abstract_state_ticket(self._state),
        }
        self.DeclareVectorOutputPort(
            "tip_command",
            6,
            weakly(self._calc_tip_command),
            states | {self._tip.ticket()},
        )
        self.DeclareAbstractOutputPort(
            "press_status", lambda: Value(PressState()), weakly(self._calc_status), states
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state: State) -> EventStatus:
        command = PressCommand.from_vector(self._command.Eval(context))
        taken: PressCommand = context.get_abstract_state(self._taken).get_value()
        now: PressState = context.get_abstract_state(self._state).get_value()
        if command.command_id != taken.command_id:
            taken = command
            now = PressState()
            state.get_mutable_abstract_state(self._taken).set_value(taken)
            state.get_mutable_abstract_state(self._state).set_value(now)
        if taken.command_id == 0 or now.over:
            return EventStatus.Succeeded()
        target = taken.make_target(self._tip_radius)
        sample = PressSample(
            time=context.get_time(),
            tip=np.array(self._tip.Eval(context)[:3]),
            force=np.array(self._force.Eval(context)),
        )
        after = advance_press(target, self._options, now, sample)
        state.get_mutable_abstract_state(self._state).set_value(after)
        return EventStatus.Succeeded()

    def _calc_tip_command(self, context: Context, output: BasicVector) -> None:
        now: PressState = context.get_abstract_state(self._state).get_value()
        if now.command is None:
            place = self._tip.Eval(context)[:3]
            output.SetFromVector(np.concatenate([place, np.zeros(3)]))
            return
        output.SetFromVector(np.concatenate([now.command, now.velocity]))

    def _calc_status(self, context: Context, output: AbstractValue) -> None:
        output.set_value(context.get_abstract_state(self._state).get_value())

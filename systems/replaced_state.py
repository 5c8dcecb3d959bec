"""`ReplacedStateSystem`: a system that remembers one thing, never changed but replaced, now and then."""

from typing import Generic, TypeVar

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from gridpush_drake.systems.weak_calc import NO_SLOTS

S = TypeVar("S")


class ReplacedStateSystem(LeafSystem, Generic[S]):
    """Base of systems whose only state is one S, an abstract value."""

    __slots__ = NO_SLOTS

    def __init__(self, begin: S, period: float) -> None:
        """Declares the state.

        Args:
            begin: the state at the beginning.
            period: between two updates, s.
        """
        super().__init__()
        self._state = self.DeclareAbstractState(AbstractValue.Make(begin))
        self._remembered = self.abstract_state_ticket(self._state)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def _go_on(self, context: Context, now: S) -> S:
        """The state after an update; `now` itself where nothing is new."""
        raise NotImplementedError

    def _get_state(self, context: Context) -> S:
        state: S = context.get_abstract_state(int(self._state)).get_value()
        return state

    def _update(self, context: Context, state: State) -> EventStatus:
        now = self._get_state(context)
        new = self._go_on(context, now)
        if new is now:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(int(self._state)).set_value(new)
        return EventStatus.Succeeded()

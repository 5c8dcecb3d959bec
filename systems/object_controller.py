"""`AbstractStateSystem`: a system that remembers one thing, never changed but replaced, now and then.

`ObjectController`: what systems share that push an object about by what is seen and learned of it.
"""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.messages import PushStatus

S = TypeVar("S")


class AbstractStateSystem(LeafSystem, Generic[S]):
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


Array = NDArray[np.float64]


class ObjectController(AbstractStateSystem[S]):
    """Base of controllers: a state that is replaced at every look, and ports that show parts of it.

    .. pydrake_system::

        name: ObjectController
        input_ports:
        - object_pose
        - identification
        - push_log
        - push_status
        output_ports:
        - status

    * object_pose: vector of 3, observed (x, y, theta) of B in W, m and rad; NaN where the object was not seen.
    * identification: abstract `Identification`; without `push_names` before the first push.
    * push_log: abstract `PushLog`, all pushes so far.
    * push_status: abstract `PushStatus` of the push executor.
    * status: abstract, the state's `status`.

    Abstract state: one S, which has a `status`.
    """

    __slots__ = NO_SLOTS

    def __init__(self, obj: GridObject, begin: S, period: float) -> None:
        """Declares the ports.

        Args:
            obj: the object.
            begin: the state at the beginning.
            period: between two looks, s.
        """
        super().__init__(begin, period)
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._identification = self.DeclareAbstractInputPort("identification", AbstractValue.Make(describe_prior(obj)))
        self._push_log = self.DeclareAbstractInputPort("push_log", AbstractValue.Make(PushLog(())))
        self._push_status = self.DeclareAbstractInputPort("push_status", AbstractValue.Make(PushStatus()))
        status: Any = begin.status  # type: ignore[attr-defined]
        self.DeclareAbstractOutputPort(
            "status",
            lambda: AbstractValue.Make(type(status)()),
            weakly(self._calc_status),
            {self._remembered},
        )

    def _declare_command(self, name: str, size: int, show: Callable[[S], Array]) -> None:
        """Declares an output port for a vector that a state shows."""
        self.DeclareVectorOutputPort(
            name,
            size,
            weakly(self._calc_command, show),
            {self._remembered},
        )

    def _calc_status(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._get_state(context).status)  # type: ignore[attr-defined]

    def _calc_command(self, context: Context, output: BasicVector, show: Callable[[S], Array]) -> None:
        output.SetFromVector(show(self._get_state(context)))

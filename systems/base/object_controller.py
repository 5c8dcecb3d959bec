"""Bases of systems whose state is one Python record, and of controllers that step a closed loop.

`AbstractStateSystem` has one abstract state, a frozen record that is replaced now and then.
`LoopController` is one that steps a closed loop (`planning.closed_loop`) over one object or
several; `ObjectController` has the ports of one object.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Generic, TypeVar

from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    EventStatus,
    InputPort,
    LeafSystem,
    State,
)

from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.closed_loop import FAILED_MODE, ClosedLoop, LoopStateType, Observation
from gridpush_drake.planning.robot_status import GraspStatus, PushStatus
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.base.messages import GRASP_COMMAND_SIZE, GraspCommand
from gridpush_drake.systems.base.worker import Worker, make_worker

StateType = TypeVar("StateType")


class _NotAskedFor:
    """Stands in a port whose value nobody has asked for yet."""


class AbstractStateSystem(LeafSystem, Generic[StateType]):
    """Base of systems whose only state is one S, an abstract value."""

    __slots__ = NO_SLOTS

    def __init__(self, begin: StateType, period: float) -> None:
        """Declares the state.

        Args:
            begin: the state at the beginning.
            period: time between two updates, s.
        """
        super().__init__()
        self._begin = begin
        self._state = self.DeclareAbstractState(AbstractValue.Make(begin))
        self._remembered = self.abstract_state_ticket(self._state)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def _go_on(self, context: Context, now: StateType) -> StateType:
        """Returns the state after an update; `now` itself if nothing is new."""
        raise NotImplementedError

    def _get_state(self, context: Context) -> StateType:
        """Returns the state in a Context."""
        state: StateType = context.get_abstract_state(int(self._state)).get_value()
        return state

    def _update(self, context: Context, state: State) -> EventStatus:
        now = self._get_state(context)
        new = self._go_on(context, now)
        if new is now:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(int(self._state)).set_value(new)
        return EventStatus.Succeeded()

    def _declare_vector(self, name: str, size: int, show: Callable[[StateType], ArrayLike]) -> None:
        """Declares an output port for a vector that is a function of the state."""
        self.DeclareVectorOutputPort(
            name, size, weakly(self._calc_vector, show), {self._remembered}
        )

    def _declare_value(
        self, name: str, show: Callable[[StateType], Any], lazily: bool = False
    ) -> None:
        """Declares an output port for an abstract value that is a function of the state.

        Args:
            name: of the port.
            show: gives the port's value; its type is the one that it gives for the state at the
                beginning.
            lazily: True where this first value is not to be made before somebody asks for it. Then
                it must be of a class of this project, all of which are of one type for Drake.
        """
        first = _NotAskedFor() if lazily else show(self._begin)
        self.DeclareAbstractOutputPort(
            name,
            lambda: AbstractValue.Make(first),
            weakly(self._calc_value, show),
            {self._remembered},
        )

    def _calc_vector(
        self, context: Context, output: BasicVector, show: Callable[[StateType], ArrayLike]
    ) -> None:
        output.SetFromVector(show(self._get_state(context)))

    def _calc_value(
        self, context: Context, output: AbstractValue, show: Callable[[StateType], Any]
    ) -> None:
        output.set_value(show(self._get_state(context)))


class LoopController(AbstractStateSystem[LoopStateType]):
    """Base of controllers: steps a closed loop (`planning.closed_loop`) with what is on its ports.

    .. pydrake_system::

        name: LoopController
        output_ports:
        - status

    * status: abstract status of the loop, of the loop's own type.

    A decision takes long. With an answer delay it is made in a worker, see `systems.base.worker`.
    Until then the outputs hold, and the decision does not count if an object lies somewhere else
    by then. Abstract state: that of the loop.
    """

    __slots__ = NO_SLOTS

    def __init__(self, loop: ClosedLoop[LoopStateType], answer_delay: float | None = 0.0) -> None:
        """Declares the state and the status.

        Args:
            loop: the loop, which decides what to do.
            answer_delay: time after which a decision is taken, s; None for real time, see
                `make_worker`.

        Raises:
            PlanningError: the delay is negative.
        """
        super().__init__(loop.begin(), loop.options.period)
        self._worker = make_worker(answer_delay)
        self.loop = loop
        self._declare_value("status", lambda now: now.status)

    def _declare_grasp(self, grasp_height: float, lift: float) -> InputPort:
        """Declares the ports of a loop that grasps, and returns that of the executor's status.

        Args:
            grasp_height: height of the grasp above the table, m.
            lift: height to which the object is lifted, m.
        """

        def show(now: Any) -> ArrayLike:
            return GraspCommand.from_grasp(now.grasp_id, now.grasp, grasp_height, lift).to_vector()

        self._declare_vector("grasp_command", GRASP_COMMAND_SIZE, show)
        return self.DeclareAbstractInputPort("grasp_status", AbstractValue.Make(GraspStatus()))

    def _observe(self, context: Context) -> Observation:
        """Returns what is on the input ports."""
        raise NotImplementedError

    def _go_on(self, context: Context, now: LoopStateType) -> LoopStateType:
        seen = self._observe(context)
        if self._worker is None:
            return self.loop.step(now, seen)
        if now.request is not None:
            return self._take_decision(self._worker, now, seen)
        now, due = self.loop.observe(now, seen)
        if not due:
            return now
        request = self._worker.ask(partial(self.loop.decide, now, seen), seen.time)
        return replace(now, request=request)

    def _take_decision(
        self, worker: Worker, now: LoopStateType, seen: Observation
    ) -> LoopStateType:
        """Returns the state after a decision in a worker; `now` if that is still under way.

        A decision counts only if it still fits what is seen.
        """
        answer = worker.take(now.request, seen.time)
        if answer is None:
            return now
        now = replace(now, request=None)
        if answer.error:
            return now.turn_to(FAILED_MODE, f"No decision could be made: {answer.error}.")
        if self.loop.is_outdated(now, seen):
            return replace(now, filter=now.filter.forget())
        decided: LoopStateType = answer.value
        return decided


class ObjectController(LoopController[LoopStateType]):
    """Base of controllers of one object.

    .. pydrake_system::

        name: ObjectController
        input_ports:
        - object_pose
        - identification
        - push_log
        - push_status
        output_ports:
        - status

    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad; NaN if the object was not
      seen.
    * identification: abstract `Identification`, what was learned; without `push_names` before
      anything was.
    * push_log: abstract `PushLog`, all pushes so far; it need not be connected.
    * push_status: abstract `PushStatus` of the executor of pushes.
    * status: abstract status of the loop, of the loop's own type.

    Abstract state: that of the loop.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self, obj: GridObject, loop: ClosedLoop[LoopStateType], answer_delay: float | None = 0.0
    ) -> None:
        """Declares the ports.

        Args:
            obj: the object.
            loop: the loop, which decides what to do.
            answer_delay: time after which a decision is taken, s; None for real time, see
                `make_worker`.

        Raises:
            PlanningError: the delay is negative.
        """
        super().__init__(loop, answer_delay)
        self.obj = obj
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._identification = self.DeclareAbstractInputPort(
            "identification", AbstractValue.Make(describe_prior(obj))
        )
        self._push_log = self.DeclareAbstractInputPort("push_log", AbstractValue.Make(PushLog(())))
        self._push_status = self.DeclareAbstractInputPort(
            "push_status", AbstractValue.Make(PushStatus())
        )

    def _observe(self, context: Context) -> Observation:
        """Returns what is on the input ports."""
        learned: Identification = self._identification.Eval(context)
        log = self._push_log.Eval(context) if self._push_log.HasValue(context) else PushLog(())
        return Observation(
            context.get_time(),
            self._object_pose.Eval(context),
            self._push_status.Eval(context),
            log,
            learned if learned.push_names else None,
        )

"""`PokePolicy`: a Drake system that commands random pokes, one whenever the executor is ready.

Which pokes they are is `planning.exploration.RandomPokes`' affair.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.planning.closed_loop import LoopOptions, Pose
from gridpush_drake.planning.exploration.random_pokes import RandomPokes
from gridpush_drake.planning.exploration.strategy import PokeProposal, lacks_pokes
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.base.messages import PUSH_COMMAND_SIZE, PushCommand, PushStatus
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.base.worker import Request, Worker, make_worker

DEFAULT_PERIOD = 0.05
"""Time between two looks at the executor's status, s."""

LOGGING_TIME = 2.0
"""Time after a poke within which it is logged, if it is at all, s."""


@dataclass(frozen=True)
class PokePolicyState:
    """All that the policy remembers.

    Attributes:
        command: the command on the port.
        attempts: number of candidates that were looked at for the next command, none of which fits.
        request: the choice under way in a worker; None if there is none.
        looked_at: (3,) X_WB of the object when that choice was asked for, m and rad.
        ready_at: time at which the executor was found ready after the command, s; inf before.
        reason: why the last choice could not be made; empty if it could.
    """

    command: PushCommand = field(default_factory=PushCommand)
    attempts: int = 0
    request: Request | None = None
    looked_at: Pose | None = None
    ready_at: float = np.inf
    reason: str = ""


class PokePolicy(AbstractStateSystem[PokePolicyState]):
    """Commands one exploratory push after another, see `RandomPokes`.

    .. pydrake_system::

        name: PokePolicy
        input_ports:
        - object_pose
        - status
        - push_log
        output_ports:
        - push_command
        - message

    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad; while it is NaN the policy
      waits.
    * status: abstract `PushStatus` of the executor.
    * push_log: abstract `PushLog`, the pushes that could be written down. It need not be connected.
    * push_command: vector of 6, see `PushCommand`; its id is 0 before the first. It stays until the
      executor is ready again and has taken up, or refused, its id.
    * message: abstract `str`, why the choice of a push has failed in a worker; else empty.

    A refused command is replaced by another one, with the next id. After `num_pushes` executed
    commands, and `test_pushes` more with a distance of their own, the last command stays. A push
    that was not written down, such as one before or after which the arm hid the object, is made up
    for by another one where the log is connected; twice as many are made at most. Abstract
    state: one `PokePolicyState`. Numeric parameter 0: the seed.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        model: Model,
        pokes: RandomPokes,
        rules: PushConstraints | None = None,
        num_pushes: int = 8,
        *,
        test_pushes: int = 0,
        test_distance: float = 0.10,
        period: float = DEFAULT_PERIOD,
        answer_delay: float | None = 0.0,
    ) -> None:
        """Declares the system.

        Args:
            model: one object, with its parameters.
            pokes: draws the pokes, with the seed that numeric parameter 0 begins with.
            rules: where the tip may be, and what the arm can carry out; None for no rules.
            num_pushes: number of pushes to be executed.
            test_pushes: number of pushes to be executed after those.
            test_distance: length of these pushes, m.
            period: time between two looks at the status, s.
            answer_delay: time after which a choice is taken, s; None for real time, see
                `worker.make_worker`.

        Raises:
            PushError: a number is negative, or the period is not positive.
            PlanningError: the delay is negative.
        """
        for name, value in (("num_pushes", num_pushes), ("test_pushes", test_pushes)):
            if value < 0:
                raise PushError(f"{name} is {value!r}; expected 0 or more")
        if not (np.isfinite(period) and period > 0):
            raise PushError(f"period is {period!r}; expected a positive number (s)")
        super().__init__(PokePolicyState(), period)
        self._worker = make_worker(answer_delay)
        self.obj = model.obj
        self.pokes = pokes
        self.rules = rules or PushConstraints()
        self._seed = self.DeclareNumericParameter(BasicVector([float(pokes.seed)]))
        self.num_pushes = num_pushes
        self.test_pushes = test_pushes
        self._test_options = replace(pokes.options, distance=(test_distance, test_distance))
        self._model = model
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._status = self.DeclareAbstractInputPort("status", AbstractValue.Make(PushStatus()))
        self._push_log = self.DeclareAbstractInputPort("push_log", AbstractValue.Make(PushLog(())))
        self._declare_vector("push_command", PUSH_COMMAND_SIZE, lambda now: now.command.to_vector())
        self._declare_value("message", lambda now: now.reason)

    def SetSeed(self, root_context: Context, seed: int) -> None:
        """Sets the seed of the draws in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(int(self._seed)).SetFromVector([float(seed)])

    def _go_on(self, context: Context, now: PokePolicyState) -> PokePolicyState:
        status: PushStatus = self._status.Eval(context)
        pose = self._object_pose.Eval(context)
        is_idle = status.ready and status.command_id == now.command.command_id
        if is_idle and now.ready_at == np.inf:
            now = replace(now, ready_at=context.get_time())
        is_due = is_idle and np.isfinite(pose).all() and self._wants_more(context, now, status)
        if not is_due:
            # A choice under way is of no use any more.
            return now if now.request is None else replace(now, request=None, looked_at=None)
        if now.request is not None and self._worker is not None:
            return self._take_choice(self._worker, now, pose, context.get_time())

        # A new choice, at once or in a worker.
        planned = self.num_pushes + self.test_pushes
        is_test = self.num_pushes <= status.executed < planned
        pokes = replace(
            self.pokes,
            options=self._test_options if is_test else self.pokes.options,
            seed=int(context.get_numeric_parameter(int(self._seed)).value()[0]),
            number=now.command.command_id + 1,
            first=now.attempts,
        )
        propose = partial(pokes.propose, self._model, np.array(pose), self.rules)
        if self._worker is None:
            return self._apply(now, propose())
        x, y, theta = pose.tolist()
        request = self._worker.ask(propose, context.get_time())
        return replace(now, request=request, looked_at=(x, y, theta))

    def _wants_more(self, context: Context, now: PokePolicyState, status: PushStatus) -> bool:
        """Whether another push is wanted: not all were made, or one of them was not logged."""
        planned = self.num_pushes + self.test_pushes
        if status.executed < planned:
            return True
        if not self._push_log.HasValue(context):
            return False
        if context.get_time() < now.ready_at + LOGGING_TIME:
            return False
        log: PushLog = self._push_log.Eval(context)
        return lacks_pokes(planned, status.executed, len(log))

    def _take_choice(
        self, worker: Worker, now: PokePolicyState, pose: Array, time: float
    ) -> PokePolicyState:
        """Returns the state after a choice in a worker; `now` if that is still under way.

        A choice counts only if the object still lies where it did when the choice was asked for.
        """
        assert now.request is not None and now.looked_at is not None
        answer = worker.take(now.request, time)
        if answer is None:
            return now
        looked_at = now.looked_at
        now = replace(now, request=None, looked_at=None, reason=answer.error)
        if answer.error or not LoopOptions().are_of_one_rest([looked_at], pose):
            return now
        return self._apply(now, answer.value)

    def _apply(self, now: PokePolicyState, proposal: PokeProposal) -> PokePolicyState:
        """Returns the state after a choice: with the new command, or with the draws in vain."""
        if proposal.push is None:
            return PokePolicyState(
                command=now.command, attempts=proposal.candidates, ready_at=now.ready_at
            )
        number = now.command.command_id + 1
        return PokePolicyState(
            command=make_command(number, proposal.push, self.pokes.options.speed)
        )


def make_command(number: int, poke: Push, speed: float) -> PushCommand:
    """Makes the command of a number for a poke of exactly this speed, m/s."""
    return replace(PushCommand.from_push(number, poke), speed=speed)

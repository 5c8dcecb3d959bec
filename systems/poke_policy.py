"""Which push comes next, as a Drake system: random pokes, one whenever the executor is ready for it."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from gridpush_drake.errors import PushError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.systems.poke_choice import PokeRegion, PokeStyle, Reach, choose_poke
from gridpush_drake.systems.push_command import PUSH_COMMAND_SIZE, PushCommand
from gridpush_drake.systems.push_status import PushStatus
from gridpush_drake.systems.weak_calc import NO_SLOTS, weakly

DEFAULT_PERIOD = 0.05
"""s."""


@dataclass(frozen=True)
class PokePolicyState:
    """All that the policy remembers.

    Attributes:
        command: on the port.
        attempts: candidates looked at for the next command, where none was found so far.
    """

    command: PushCommand = field(default_factory=PushCommand)
    attempts: int = 0


class PokePolicy(LeafSystem):
    """Commands one exploratory push after another, see `poke_choice`.

    .. pydrake_system::

        name: PokePolicy
        input_ports:
        - object_pose
        - status
        output_ports:
        - push_command

    * object_pose: vector of 3, observed (x, y, theta) of B in W, m and rad; while it is NaN the policy waits.
    * status: abstract `PushStatus` of the executor.
    * push_command: vector of 6, see `PushCommand`; number 0 before the first. It stays until the executor is ready
      again and has taken up, or refused, its number.

    A refused command is replaced by another one, with the next number. After `num_pushes` executed commands, and
    `test_pushes` more of their own style, the last one stays. Abstract state: one `PokePolicyState`. Numeric parameter
    0: the seed.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        obj: GridObject,
        region: PokeRegion,
        seed: int = 0,
        num_pushes: int = 8,
        style: PokeStyle | None = None,
        *,
        params: CellParameters | None = None,
        reach: Reach | None = None,
        test_pushes: int = 0,
        test_distance: float = 0.10,
        period: float = DEFAULT_PERIOD,
    ) -> None:
        """Declares the system.

        Args:
            obj: the object.
            region: where the tip may be, and the object must stay.
            seed: of the draws.
            num_pushes: to be executed.
            style: how to push.
            params: by which the object's motion is predicted; the prior's by default.
            reach: whether the arm can carry out a command; None trusts it.
            test_pushes: to be executed after that.
            test_distance: of those, m.
            period: between two looks at the status, s.

        Raises:
            PushError: a number is negative, or the period is not positive.
        """
        super().__init__()
        for name, value in (("num_pushes", num_pushes), ("test_pushes", test_pushes)):
            if value < 0:
                raise PushError(f"{name} is {value!r}; expected 0 or more")
        if not (np.isfinite(period) and period > 0):
            raise PushError(f"period is {period!r}; expected a positive number (s)")
        self.obj, self.region, self.style = obj, region, style or PokeStyle()
        self._seed = self.DeclareNumericParameter(BasicVector([float(seed)]))
        self.num_pushes, self.test_pushes = num_pushes, test_pushes
        self._test_style = replace(self.style, distance=(test_distance, test_distance))
        self._params = CellParameters.uniform(obj) if params is None else params
        self._reach = reach
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._status = self.DeclareAbstractInputPort("status", AbstractValue.Make(PushStatus()))
        self._state = self.DeclareAbstractState(AbstractValue.Make(PokePolicyState()))
        self.DeclareVectorOutputPort(
            "push_command",
            PUSH_COMMAND_SIZE,
            weakly(self._calc_push_command),
            {self.abstract_state_ticket(self._state)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def SetSeed(self, root_context: Context, seed: int) -> None:
        """Sets the seed of the draws in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(int(self._seed)).SetFromVector([float(seed)])

    def _get_state(self, context: Context) -> PokePolicyState:
        return context.get_abstract_state(int(self._state)).get_value()

    def _calc_push_command(self, context: Context, output: Any) -> None:
        output.SetFromVector(self._get_state(context).command.to_vector())

    def _update(self, context: Context, state: State) -> EventStatus:
        before = self._get_state(context)
        status: PushStatus = self._status.Eval(context)
        pose = self._object_pose.Eval(context)
        wanted = status.executed < self.num_pushes + self.test_pushes
        if not (wanted and status.ready and status.number == before.command.number and np.isfinite(pose).all()):
            return EventStatus.DidNothing()
        style = self.style if status.executed < self.num_pushes else self._test_style
        seed = int(context.get_numeric_parameter(int(self._seed)).value()[0])
        command, attempts = choose_poke(
            self.obj, self._params, pose, before.command.number + 1, seed, style, self.region, self._reach,
            before.attempts,
        )  # fmt: skip
        after = PokePolicyState(command) if command else PokePolicyState(before.command, attempts)
        state.get_mutable_abstract_state(int(self._state)).set_value(after)
        return EventStatus.Succeeded()

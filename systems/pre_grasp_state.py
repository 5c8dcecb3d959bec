"""What a pre-grasp controller remembers, and the numbers by which it goes about it."""

from dataclasses import dataclass, field, replace
from typing import Any

from gridpush_drake.systems import pre_grasp_status
from gridpush_drake.systems.grasp_command import GraspCommand
from gridpush_drake.systems.pre_grasp_status import PreGraspMode, PreGraspStatus
from gridpush_drake.systems.push_command import PushCommand
from gridpush_drake.systems.push_guard import PushGuard
from gridpush_drake.systems.rest_looks import LookOptions, RestLooks

GRASPING = (pre_grasp_status.VERIFYING, pre_grasp_status.GRASPING, pre_grasp_status.HOLDING)
"""Modes in which nothing is pushed."""


@dataclass(frozen=True)
class ControllerOptions(LookOptions):
    """How the controller goes about it.

    Attributes:
        most_refusals: pushes in a row that the executor refuses before it is given up.
        most_grasps: grasps before it is given up.
    """

    looks: int = 8
    patience: float = 2.0
    most_refusals: int = 5
    most_grasps: int = 3


@dataclass(frozen=True, eq=False)
class ControllerState:
    """All that the controller remembers; never changed, only replaced.

    Attributes:
        status: as on the port.
        push: the last push command.
        grasp: the last grasp command.
        guard: of that push.
        looks: what was seen since everything came to rest.
        refused: pushes in a row that the executor refused.
    """

    status: PreGraspStatus = field(default_factory=PreGraspStatus)
    push: PushCommand = field(default_factory=PushCommand)
    grasp: GraspCommand = field(default_factory=GraspCommand)
    guard: PushGuard | None = None
    looks: RestLooks = field(default_factory=RestLooks)
    refused: int = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> "ControllerState":
        """Itself: Drake copies the state at every update, and nothing in it is ever changed."""
        return self

    @property
    def shown_push(self) -> PushCommand:
        """The push command on the port: none while a push is broken off, and once the object is grasped."""
        without = (pre_grasp_status.STOPPING, *GRASPING)
        return PushCommand() if self.status.mode in without else self.push

    def turn_to(self, mode: PreGraspMode, reason: str, **others: Any) -> "ControllerState":
        """In another mode, with nothing seen yet."""
        return replace(self, status=replace(self.status, mode=mode, reason=reason, **others), looks=self.looks.forget())

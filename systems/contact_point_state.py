"""What a contact-point controller remembers, and the numbers by which it goes about it."""

from dataclasses import dataclass, field, replace
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.planning.way_to_goal import WayToGoal
from gridpush_drake.systems.contact_point_status import ContactPointMode, ContactPointStatus
from gridpush_drake.systems.push_command import PushCommand
from gridpush_drake.systems.rest_looks import LookOptions, Pose, RestLooks

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ControllerOptions(LookOptions):
    """How the controller goes about it.

    Attributes:
        most_refusals: pushes in a row that the executor refuses before it is given up.
        apart: pushes that begin nearer to a refused one than this, m,
        turned: in a direction less different than this, rad, are like it, and not tried.
        moved: mean cell distance by which somebody must have moved an object for a new attempt after the end, m.
    """

    most_refusals: int = 10
    apart: float = 0.01
    turned: float = 0.2
    moved: float = 0.01


@dataclass(frozen=True, eq=False)
class ControllerState:
    """All that the controller remembers; never changed, only replaced.

    Attributes:
        status: as on the port.
        goal: that is pushed to; None before the first.
        command: on the port.
        issued: the greatest number of a command so far.
        executed: of the executor when the goal was given, or the last command issued.
        looks: what was seen since everything came to rest.
        decided_at: where the object lay at the last decision.
        way: to the goal.
        refused: pushes that were refused since the last one that was not, (4,) each, see `push_decision.forbid`.
        logged: pushes in the log when the last command was issued.
    """

    status: ContactPointStatus = field(default_factory=ContactPointStatus)
    goal: Pose | None = None
    command: PushCommand = field(default_factory=PushCommand)
    issued: int = 0
    executed: int = 0
    looks: RestLooks = field(default_factory=RestLooks)
    decided_at: Array | None = None
    way: WayToGoal | None = None
    refused: tuple[Array, ...] = ()
    logged: int = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> "ControllerState":
        """Itself: Drake copies the state at every update, and nothing in it is ever changed."""
        return self

    def turn_to(self, mode: ContactPointMode, reason: str, cause: str = "", **others: Any) -> "ControllerState":
        """In another mode, with nothing seen yet, and no push under way."""
        none = {"expected_pose": None, "expected_error": nan}
        status = replace(self.status, mode=mode, reason=reason, cause=cause, **{**none, **others})
        return replace(self, status=status, looks=self.looks.forget())

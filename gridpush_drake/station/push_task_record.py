"""What came of pushing an object to a goal in the station."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.planning.surface import SupportSurface
from gridpush_drake.station.task_record import TaskRecord
from gridpush_drake.systems.contact_point_status import ContactPointStatus
from gridpush_drake.systems.push_command import PushCommand

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PushTaskStep:
    """A change of what the controller says.

    Attributes:
        time: s.
        status: of the controller.
        pose: (3,) where the object was seen, X_WB, m and rad; NaN where it was not.
        push: the command, where a push began.
    """

    time: float
    status: ContactPointStatus
    pose: Array
    push: PushCommand | None = None


@dataclass
class PushTaskRecord(TaskRecord):
    """What came of a run: "reached", "failed", "lost", "stuck" or "interrupted"; filled while it runs.

    Attributes:
        surface: the table.
        goal: (3,) where it should lie, X_WB, m and rad.
        tolerance: mean cell error at which the goal counts as reached, m.
        steps: what the controller said, in order.
        pose: (3,) where the object truly lay at the end, X_WB, m and rad; NaN where it had fallen.
        error: mean cell error to the goal there, m.
    """

    surface: SupportSurface
    goal: Array
    tolerance: float
    steps: list[PushTaskStep] = field(default_factory=list)
    pose: Array = field(default_factory=lambda: np.full(3, np.nan))
    error: float = float("nan")

    @property
    def last(self) -> ContactPointStatus:
        """The controller's last status."""
        return self.steps[-1].status if self.steps else ContactPointStatus()

    @property
    def statuses(self) -> list[ContactPointStatus]:
        """All that the controller said, in order."""
        return [step.status for step in self.steps]

    @property
    def pushes(self) -> int:
        """How many were made."""
        return self.last.pushes

    @property
    def rest_poses(self) -> list[Array]:
        """(3,) where the object was seen at rest, before the first push in the log and after each."""
        return [*(seen.pose for seen in self.log[:1]), *(seen.final_pose for seen in self.log)]

    @property
    def expected_errors(self) -> list[float]:
        """Mean cell error to the goal that was expected after each push that began, m."""
        return [step.status.expected_error for step in self.steps if step.push is not None]

"""What came of exploring, sliding and grasping in the station."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.planning.surface import SupportSurface
from gridpush_drake.station.task_record import TaskRecord
from gridpush_drake.systems.grasp_command import GraspCommand
from gridpush_drake.systems.pre_grasp_status import PreGraspStatus
from gridpush_drake.systems.push_command import PushCommand

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PreGraspStep:
    """Something that the controller did.

    Attributes:
        time: when it began, s.
        status: of the controller.
        pose: (3,) where the object was seen, X_WB, m and rad; NaN where it was not.
        push: the command, where it was a push.
        grasp: the command, where it was a grasp.
        pushes_learned_from: by then.
    """

    time: float
    status: PreGraspStatus
    pose: Array
    push: PushCommand | None = None
    grasp: GraspCommand | None = None
    pushes_learned_from: int = 0


@dataclass
class PreGraspRecord(TaskRecord):
    """What came of a run: "held", "dropped", "failed", "lost", "stuck" or "interrupted"; filled while it runs.

    Attributes:
        surface: the table.
        steps: what the controller did.
        raised: how far the object's lowest point was above the table at the end, m.
    """

    surface: SupportSurface
    steps: list[PreGraspStep] = field(default_factory=list)
    raised: float = float("nan")

    @property
    def last(self) -> PreGraspStatus:
        """The controller's last status."""
        return self.steps[-1].status if self.steps else PreGraspStatus()

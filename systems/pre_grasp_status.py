"""What a pre-grasp controller says of itself on its port."""

from dataclasses import dataclass
from enum import StrEnum

from gridpush_drake.planning.pregrasp_goal import PreGraspGoal


class PreGraspMode(StrEnum):
    """What a pre-grasp controller is doing."""

    WAITING = "waiting"
    EXPLORING = "exploring"
    SLIDING = "sliding"
    STOPPING = "stopping"
    VERIFYING = "verifying"
    GRASPING = "grasping"
    HOLDING = "holding"
    LOST = "lost"
    FAILED = "failed"


WAITING, EXPLORING, SLIDING, STOPPING, VERIFYING, GRASPING, HOLDING, LOST, FAILED = PreGraspMode


@dataclass(frozen=True, eq=False)
class PreGraspStatus:
    """Where a controller stands.

    Attributes:
        mode: "waiting" (to see the object at rest), "exploring", "sliding", "stopping" (a push that is broken off),
            "verifying" (that it can be grasped where it lies), "grasping" (until it is lifted), "holding", "lost" (from
            sight) or "failed".
        reason: for the mode, in a sentence.
        pokes: commanded so far.
        slides: likewise.
        grasps: likewise.
        goal: that it slides to or grasps at; None where there is none.
        expected_pose: (x, y, theta) where the push under way is expected to leave the object, m and rad; None without.
        margin: stability margin of the goal at the worst, m; NaN without one.
    """

    mode: PreGraspMode = WAITING
    reason: str = "The object was not looked at yet."
    pokes: int = 0
    slides: int = 0
    grasps: int = 0
    goal: PreGraspGoal | None = None
    expected_pose: tuple[float, float, float] | None = None
    margin: float = float("nan")

    @property
    def over(self) -> bool:
        """Whether nothing more is done."""
        return self.mode in (HOLDING, FAILED)

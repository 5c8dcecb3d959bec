"""What a robot's arm can do, as far as pre-grasp decisions need to know it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from shapely.geometry.base import BaseGeometry

from gridpush_drake.planning.push_constraints import PushRule

if TYPE_CHECKING:
    from gridpush_drake.planning.pregrasp_goal import PreGraspGoal


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """What the arm can do; None everywhere stands for an arm that can do anything.

    Attributes:
        finger_region: where the finger's centre may be, W.
        rim_region: where on the table's rim the gripper may take something, W.
        can_push: whether the arm can carry out a push.
        can_grasp: whether the gripper can take the object where a goal has it.
    """

    finger_region: BaseGeometry | None = None
    rim_region: BaseGeometry | None = None
    can_push: PushRule | None = None
    can_grasp: Callable[["PreGraspGoal"], bool] | None = None


ANY_ARM = ArmLimits()
"""An arm that can do anything."""

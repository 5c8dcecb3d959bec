"""A whole slide to the table's edge, planned as one model predicts it: `plan_pregrasp`.

The planner decides as it would on a robot, with the object at each predicted pose; nothing is
learned on the way.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.identification.model import Model
from gridpush_drake.notebook import count, describe_pose, draw_paths, make_page, make_table
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.edge_motion import simulate_near_edge
from gridpush_drake.planning.pregrasp.goals import PreGraspGoal
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.units import MM_PER_M


class PreGraspPlanStatus(StrEnum):
    """How a plan of slides ends."""

    READY = "ready"
    POKE_FIRST = "poke_first"
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class PreGraspPlan:
    """Pushes that bring an object to the edge, and how they end.

    Attributes:
        status: "ready": at the end of the pushes a part can be grasped; "poke_first": no goal is
            safe enough yet, and a poke would help; "failed".
        message: the status in a sentence.
        pushes: the P pushes of the slide; none where the object can be grasped where it lies, and
            where there is no safe way.
        poses: (P+1, 3) poses predicted before and after each push, X_WB, m and rad.
        goal: the goal that is reached at the end; where nothing is safe enough, the safest goal;
            None where there is none.
        poke: the poke that would help most, where one would; None otherwise.
    """

    status: PreGraspPlanStatus
    message: str
    pushes: tuple[Push, ...]
    poses: Array
    goal: PreGraspGoal | None
    poke: Push | None

    def __repr__(self) -> str:
        """Status, pushes and the reason, in two lines."""
        return f"PreGraspPlan, {self.status}: {count(len(self.pushes), 'push')}\n{self.message}"

    def _repr_html_(self) -> str:
        """A table with a row for each push, and a drawing of the predicted path."""
        rows = [
            (number, f"{push.length * MM_PER_M:.0f}", describe_pose(pose))
            for number, (push, pose) in enumerate(
                zip(self.pushes, self.poses[1:], strict=True), start=1
            )
        ]
        heads = ("push", "path, mm", "the object afterwards")
        path = draw_paths([(self.poses[:, :2], "teal", "object's body frame, push by push")])
        return make_page(repr(self), path, make_table(heads, rows))


def plan_pregrasp(planner: PreGraspPlanner, model: Belief, pose: ArrayLike) -> PreGraspPlan:
    """Plans a whole slide, predicting motions with the model's `params`.

    Args:
        planner: decides, as it would with the object at each predicted pose.
        model: what is known of the object; it stays the same, for a plan learns nothing.
        pose: (3,) where the slide begins, X_WB, m and rad.

    Raises:
        PlanningError: the pose is not three finite numbers.
    """
    poses = [check_vector(PlanningError, "pose", pose, 3)]
    pushes: list[Push] = []
    # The pokes that are made first count as made: what they would tell is not known here.
    pokes = planner.options.min_pokes
    while True:
        decision = planner.decide(poses[-1], model, pokes, len(pushes))
        if decision.action != "slide" or decision.push is None:
            break
        motion = simulate_near_edge(
            Model(planner.obj, model.params, model.physics),
            push=decision.push,
            pose=poses[-1],
            surface=planner.surface,
        )
        pushes.append(decision.push)
        poses.append(motion.final_pose)
    ends = {"grasp": PreGraspPlanStatus.READY, "poke": PreGraspPlanStatus.POKE_FIRST}
    return PreGraspPlan(
        status=ends.get(decision.action, PreGraspPlanStatus.FAILED),
        message=decision.reason,
        pushes=tuple(pushes),
        poses=np.array(poses),
        goal=decision.goal,
        poke=decision.push if decision.action == "poke" else None,
    )

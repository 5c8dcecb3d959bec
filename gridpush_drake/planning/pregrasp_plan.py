"""A whole pre-grasp slide as one model predicts it: the decisions of `pregrasp`, made on predicted poses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.edge_push import simulate_near_edge
from gridpush_drake.planning.pregrasp import PreGraspPlanner
from gridpush_drake.planning.pregrasp_goal import PreGraspGoal

Array = NDArray[np.float64]

STATUS_READY = "ready"
STATUS_POKE_FIRST = "poke_first"
STATUS_FAILED = "failed"


@dataclass(frozen=True, eq=False)
class PreGraspPlan:
    """Pushes that bring an object to the rim, and how they end.

    Attributes:
        status: "ready": at the end of the pushes a part can be grasped; "poke_first": no goal is safe enough yet, and a
            poke would help; "failed".
        message: the status in a sentence.
        pushes: of the slide; empty where the object can be grasped where it lies, and where there is no safe way.
        poses: (P+1, 3) predicted before and after each push, X_WB, m and rad.
        goal: what hangs over at the end; where nothing is safe enough, the safest goal; None where there is none.
        poke: that would help most, where one would.
    """

    status: str
    message: str
    pushes: tuple[Push, ...]
    poses: Array
    goal: PreGraspGoal | None
    poke: Push | None


def plan_pregrasp(planner: PreGraspPlanner, belief: Belief, pose: ArrayLike) -> PreGraspPlan:
    """Plans a slide to the end.

    Args:
        planner: object, table and options.
        belief: what is believed of the object. Motions are predicted with its `params`.
        pose: (3,) where the object lies, X_WB, m and rad.

    Returns:
        The plan.
    """
    poses, pushes = [np.array(pose, dtype=np.float64)], list[Push]()
    while True:
        decision = planner.decide(poses[-1], belief, planner.options.least_pokes, len(pushes))
        if decision.action != "slide" or decision.push is None:
            break
        pushes.append(decision.push)
        poses.append(
            simulate_near_edge(planner.obj, belief.params, decision.push, poses[-1], planner.surface).final_pose
        )
    status = {"grasp": STATUS_READY, "poke": STATUS_POKE_FIRST}.get(decision.action, STATUS_FAILED)
    poke = decision.push if decision.action == "poke" else None
    return PreGraspPlan(status, decision.reason, tuple(pushes), np.array(poses), decision.goal, poke)

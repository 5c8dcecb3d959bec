"""Who decides in a task with several objects, and who learns: look, decide, push, learn.

A planner decides by what is seen and believed now and by the pushes made so far, on nothing else.
So the same planner leads a simulated world and a robot in a station (`joint_loop`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from gridpush_drake.dynamics.bodies import describe_object
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.identification.fit.hypotheses import LoadHypothesis, SmoothField
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.multi_object.joint_fit import NOISE, JointEnsemble
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.pregrasp.goals import PreGraspGoal
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.units import MM_PER_M


class SceneAction(StrEnum):
    """What to do next."""

    PUSH = "push"
    GRASP = "grasp"
    DONE = "done"
    FAIL = "fail"


@dataclass(frozen=True, eq=False)
class SceneDecision:
    """A decision of a task with several objects.

    Attributes:
        action: a push to make; or how the task ends: "grasp" and "done" well, "fail" not.
        reason: why, in half a sentence.
        push: the push to make; None at the end.
        body: number of the object that is pushed, or to be grasped; -1 for none.
        expected: (N, 3) where the push is expected to leave the objects, m and rad; None at the
            end, and where nothing is expected.
        kind: what the push is for, in a word, where a task makes pushes of several kinds.
        goal: where the object is to be grasped, or slid to; None in other tasks.
    """

    action: SceneAction
    reason: str
    push: Push | None = None
    body: int = -1
    expected: Array | None = None
    kind: str = ""
    goal: PreGraspGoal | None = None


@dataclass(frozen=True, eq=False)
class SceneStep:
    """A push that was made.

    Attributes:
        poses: (N, 3) where the objects were seen before it, m and rad.
        decision: the decision to make it.
        refused: why a robot did not make it; empty where it did.
    """

    poses: Array
    decision: SceneDecision
    refused: str = ""


class ScenePlanner(Protocol):
    """Decides what to do next in a task with several objects."""

    def decide(self, poses: Array, belief: Belief, steps: Sequence[SceneStep]) -> SceneDecision:
        """Decides what to do next.

        Args:
            poses: (N, 3) where the objects are seen, m and rad.
            belief: what is believed of them.
            steps: the pushes made so far.
        """
        ...


class SceneLearner(Protocol):
    """Learns the objects of a scene from pushes."""

    def learn(
        self,
        belief: Belief,
        pushes: Sequence[ObservedPush],
        seed: int,
        *,
        last: bool = False,
        anew: bool = False,
    ) -> Belief | None:
        """Learns anew, if that is worth it now.

        Args:
            belief: what is believed of the objects.
            pushes: all pushes so far, the last one new.
            seed: seed of what is drawn of the models.
            last: whether no push follows, so that whatever was not learned yet is learned now; then
                the last push need not be new.
            anew: whether an object has changed, so that it is learned anew now; `pushes` are then
                those that may still be believed.

        Returns:
            What is believed then; None where nothing was learned.
        """
        ...


@dataclass(frozen=True)
class SceneLearning:
    """Learns all objects together, by `identify`, after certain numbers of pushes.

    Attributes:
        after: numbers of pushes after which the objects are learned anew.
        hypotheses: how each object may bear on the table. With more than smooth fields, learning
            takes three to four times as long.
        noise: standard deviations of the poses about their predictions, m, m and rad.
        min_move: least distance by which a pose must change in a push for it to tell something, m.

    Raises:
        PlanningError: a number is not positive.
    """

    after: tuple[int, ...] = (2, 4, 7, 11, 16)
    hypotheses: tuple[LoadHypothesis, ...] = (SmoothField(0.3), SmoothField(0.7))
    noise: tuple[float, float, float] = NOISE
    min_move: float = 0.003

    def __post_init__(self) -> None:
        require_positive(PlanningError, min_move=self.min_move)

    def learn(
        self,
        belief: Belief,
        pushes: Sequence[ObservedPush],
        seed: int,
        *,
        last: bool = False,
        anew: bool = False,
    ) -> Belief | None:
        """Learns from all pushes in which something moved; see `SceneLearner`."""
        telling = [seen for seen in pushes if _moves(seen) >= self.min_move]
        if not telling or not (last or anew or len(pushes) in self.after):
            return None
        known = belief.identification
        if known is not None and known.push_names == tuple(seen.name for seen in telling):
            return None
        found = identify(
            Model(belief.objects, physics=belief.bodies.physics),
            PushLog(tuple(telling), names=name_objects(len(belief.objects))),
            JointEnsemble(self.noise, self.hypotheses),
            start=belief.identification,
        )
        count = belief.sample_count
        learned = Belief.of_identification(found, sample_count=count, seed=seed)
        return replace(learned, alone=belief.alone)


def name_objects(count: int) -> tuple[str, ...]:
    """Names the objects of a scene in its log of pushes."""
    return tuple(f"object_{i}" for i in range(count))


def _moves(seen: ObservedPush) -> float:
    """Says by how much the object that moved most was seen to move in a push, m."""
    change = seen.final_pose - seen.pose
    return float(np.linalg.norm(change[:, :2], axis=1).max())


def straighten(poses: Array, before: Sequence[Array]) -> Array:
    """Returns poses (N, 3) with angles within half a turn of those seen before, if any were."""
    straight = np.array(poses, dtype=np.float64)
    if before:
        turned = wrap_angle(straight[:, 2] - before[-1][:, 2])
        straight[:, 2] = before[-1][:, 2] + turned
    return straight


def describe_no_room(objects: Sequence[GridObject], bodies: Sequence[int], pusher: Pusher) -> str:
    """Says that a pusher fits nowhere beside some objects, and between which others they lie.

    Args:
        objects: the objects.
        bodies: numbers of those that should be pushed.
        pusher: what pushes.
    """
    size = f"{pusher.choose_reach(objects) * MM_PER_M:.3g} mm"
    what = f"a finger of {size}" if pusher.shape is None else f"a pusher that reaches {size}"
    names = ", ".join(describe_object(objects, b) for b in bodies)
    others = ", ".join(describe_object(objects, b) for b in range(len(objects)) if b not in bodies)
    between = f", between {others}" if others else ""
    return f"{names}: no place was found where {what} fits beside it and can push it{between}"

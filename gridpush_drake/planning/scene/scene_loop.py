"""`SceneLoop`: a robot carries a task with several objects out, step by step: a pure function.

    waiting --- ready, all objects seen at rest ---> a decision ---> pushing ---> waiting
       |                                                 |
       +--> lost                                         +--> grasping ---> holding
                                                         +--> done, failed

A planner decides (`loop.ScenePlanner`), by the mean of several looks at all objects at rest. What
was seen before and after each push is learned from. A LeafSystem steps the loop with what is on its
ports; the state holds the push, or the grasp, that is asked for.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.scene.bodies import describe_object
from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.planning.closed_loop import LoopOptions
from gridpush_drake.planning.pregrasp.side_grasp import SideGrasp
from gridpush_drake.planning.robot_status import GraspOutcome, GraspStatus, PushStatus
from gridpush_drake.planning.scene.belief import SceneBelief
from gridpush_drake.planning.scene.loop import (
    SceneAction,
    SceneDecision,
    SceneLearner,
    ScenePlanner,
    SceneStep,
    straighten,
)
from gridpush_drake.pushes.scene_log import ObservedScenePush

FindSceneGrasp = Callable[[Array, SceneDecision, SceneBelief], SideGrasp | None]
"""Finds a grasp of the object of a decision at poses (N, 3); None where the robot has none."""


class SceneMode(StrEnum):
    """What a loop is doing."""

    WAITING = "waiting"
    PUSHING = "pushing"
    GRASPING = "grasping"
    HOLDING = "holding"
    DONE = "done"
    LOST = "lost"
    FAILED = "failed"


@dataclass(frozen=True)
class SceneStatus(Unchanging):
    """What a loop says of itself.

    Attributes:
        mode: what it is doing.
        reason: why, in a sentence.
        pushes: number of pushes that were made.
        body: number of the object that is pushed or grasped; -1 for none.
        kind: what the push is for, in a word; empty in tasks with one kind of pushes.
    """

    mode: SceneMode = SceneMode.WAITING
    reason: str = "Nothing was seen yet."
    pushes: int = 0
    body: int = -1
    kind: str = ""

    @property
    def over(self) -> bool:
        """Whether the task has ended."""
        return self.mode in (SceneMode.DONE, SceneMode.FAILED, SceneMode.HOLDING, SceneMode.LOST)


@dataclass(frozen=True, eq=False)
class SceneLoopState(Unchanging):
    """All that a loop remembers; never changed, only replaced.

    Attributes:
        status: what it says of itself.
        belief: what is believed of the objects.
        seen: poses (N, 3) of the same rest, the last ones that were seen, m and rad.
        last_seen: when all objects were last seen, or the robot was last at work, s.
        push: the last push asked for; None before the first.
        push_id: its number, counted from 1; 0 before the first.
        asked: where the objects were before it, and the decision; None where it was dealt with.
        steps: the pushes that were made or refused.
        log: what was seen of those that were made.
        refused: number of pushes refused in a row.
        grasp: the grasp asked for; None before one is.
        grasp_id: its number, counted from 1; 0 before one is asked for.
    """

    status: SceneStatus
    belief: SceneBelief
    seen: tuple[Array, ...] = ()
    last_seen: float = 0.0
    push: Push | None = None
    push_id: int = 0
    asked: SceneStep | None = None
    steps: tuple[SceneStep, ...] = ()
    log: tuple[ObservedScenePush, ...] = ()
    refused: int = 0
    grasp: SideGrasp | None = None
    grasp_id: int = 0

    def turn_to(
        self, mode: SceneMode, reason: str, *, body: int = -1, kind: str = ""
    ) -> "SceneLoopState":
        """The state in another mode, with nothing seen yet."""
        status = replace(self.status, mode=mode, reason=reason, body=body, kind=kind)
        return replace(self, status=status, seen=())


@dataclass(frozen=True, eq=False)
class SceneObservation:
    """What a loop is shown at one time.

    Attributes:
        time: of the observation, s.
        poses: (N, 3) of the objects, m and rad; NaN for one that is not seen.
        robot: status of what carries out pushes.
        gripper: status of what carries out grasps.
    """

    time: float
    poses: Array
    robot: PushStatus
    gripper: GraspStatus = field(default_factory=GraspStatus)


@dataclass(frozen=True, eq=False)
class SceneLoop:
    """Carries a task with several objects out.

    Attributes:
        planner: decides.
        belief: what is believed of the objects beforehand.
        learning: learns them from the pushes; None for nobody.
        max_pushes: number of pushes after which the task is given up.
        find_grasp: finds a grasp where the planner wants one; None where the robot has no gripper.
        options: how objects are observed, and when the loop gives up.
        seed: seed of what is drawn of the models.
    """

    planner: ScenePlanner
    belief: SceneBelief
    learning: SceneLearner | None = None
    max_pushes: int = 60
    find_grasp: FindSceneGrasp | None = None
    options: LoopOptions = field(default_factory=LoopOptions)
    seed: int = 0

    def begin(self) -> SceneLoopState:
        """The state before the first observation."""
        return SceneLoopState(status=SceneStatus(), belief=self.belief)

    def step(self, now: SceneLoopState, seen: SceneObservation) -> SceneLoopState:
        """The state after an observation; `now` itself where nothing is new."""
        if now.status.over:
            return now
        if now.status.mode is SceneMode.GRASPING:
            return self._follow_grasp(now, seen.gripper)
        # The robot is waited for.
        under_way = now.push is not None and seen.robot.command_id != now.push_id
        if not seen.robot.ready or not seen.gripper.ready or under_way:
            # Meanwhile the arm may hide objects: they are not missed before it is at rest.
            return replace(now, seen=(), last_seen=seen.time)
        if now.status.mode is SceneMode.PUSHING:
            now = self._end_push(now, seen)
        # Then the objects, until they lie still.
        now = self._look(now, seen)
        if now.status.over or len(now.seen) < self.options.observations:
            return now
        poses = np.mean(now.seen, axis=0)
        return self._decide(self._learn(now, poses), poses)

    def _look(self, now: SceneLoopState, seen: SceneObservation) -> SceneLoopState:
        """The state with one more look at all objects."""
        if not np.isfinite(seen.poses).all():
            hidden = np.flatnonzero(~np.isfinite(seen.poses).all(axis=1)).tolist()
            if seen.time - now.last_seen > self.options.timeout:
                objects = now.belief.objects
                names = " and ".join(describe_object(objects, b) for b in hidden)
                reason = f"Not seen for {self.options.timeout:g} s: {names}."
                return now.turn_to(SceneMode.LOST, reason)
            return replace(now, seen=())
        before = now.seen or tuple(step.poses for step in now.steps[-1:])
        poses = straighten(seen.poses, before)
        # Looks from before something moved are forgotten.
        kept = [
            each
            for each in now.seen[1 - self.options.observations :]
            if np.abs(each - poses)[:, :2].max() <= self.options.rest_distance
            and np.abs(each - poses)[:, 2].max() <= self.options.rest_angle
        ]
        return replace(now, seen=(*kept, poses), last_seen=seen.time)

    def _end_push(self, now: SceneLoopState, seen: SceneObservation) -> SceneLoopState:
        """The state after a push that was carried out, or refused."""
        asked = now.asked
        assert asked is not None
        if not seen.robot.reason:
            status = replace(now.status, pushes=now.status.pushes + 1)
            now = replace(now, status=status, refused=0, steps=(*now.steps, asked))
            return now.turn_to(SceneMode.WAITING, "A push was made.")
        refused = replace(asked, refused=seen.robot.reason)
        now = replace(now, asked=None, refused=now.refused + 1, steps=(*now.steps, refused))
        if now.refused >= self.options.max_refusals:
            reason = f"The last {now.refused} pushes were refused: {seen.robot.reason}."
            return now.turn_to(SceneMode.FAILED, reason)
        return now.turn_to(SceneMode.WAITING, f"A push was refused: {seen.robot.reason}.")

    def _learn(self, now: SceneLoopState, poses: Array) -> SceneLoopState:
        """The state with the last push in the log, now that it is seen where it ended."""
        asked = now.asked
        if asked is None or asked.decision.push is None:
            return now
        push = asked.decision.push
        made = ObservedScenePush(
            name=f"push_{len(now.log) + 1}",
            push=push,
            poses=asked.poses,
            t_observed=np.array([push.duration]),
            poses_observed=poses[None],
        )
        now = replace(now, asked=None, log=(*now.log, made))
        if self.learning is None:
            return now
        found = self.learning.learn(now.belief, now.log, self.seed)
        return now if found is None else replace(now, belief=found)

    def _learn_last(self, now: SceneLoopState) -> SceneLoopState:
        """The state with everything learned that the pushes tell, now that none follows."""
        if self.learning is None:
            return now
        found = self.learning.learn(now.belief, now.log, self.seed, last=True)
        return now if found is None else replace(now, belief=found)

    def _decide(self, now: SceneLoopState, poses: Array) -> SceneLoopState:
        """The state with the next push or grasp asked for, or at the end."""
        decision = self.planner.decide(poses, now.belief, now.steps)
        if decision.push is None or now.status.pushes >= self.max_pushes:
            now = self._learn_last(now)
        words = decision.reason.replace("_", " ")
        reason = f"{words[0].upper()}{words[1:]}."
        if decision.action is SceneAction.DONE:
            return now.turn_to(SceneMode.DONE, reason)
        if decision.action is SceneAction.FAIL or now.status.pushes >= self.max_pushes:
            if decision.action is not SceneAction.FAIL:
                reason = f"Not done after {now.status.pushes} pushes."
            return now.turn_to(SceneMode.FAILED, reason)
        if decision.action is SceneAction.GRASP:
            return self._ask_grasp(now, poses, decision, reason)
        asked = replace(
            now,
            push=decision.push,
            push_id=now.push_id + 1,
            asked=SceneStep(poses, decision),
        )
        return asked.turn_to(SceneMode.PUSHING, reason, body=decision.body, kind=decision.kind)

    def _ask_grasp(
        self, now: SceneLoopState, poses: Array, decision: SceneDecision, reason: str
    ) -> SceneLoopState:
        """The state with a grasp asked for; done, where the robot has no gripper."""
        if self.find_grasp is None:
            return now.turn_to(SceneMode.DONE, reason, body=decision.body)
        grasp = self.find_grasp(poses, decision, now.belief)
        if grasp is None:
            why = "No grasp is in reach that holds the object where it lies."
            return now.turn_to(SceneMode.FAILED, why, body=decision.body)
        asked = replace(now, grasp=grasp, grasp_id=now.grasp_id + 1)
        return asked.turn_to(SceneMode.GRASPING, reason, body=decision.body)

    def _follow_grasp(self, now: SceneLoopState, gripper: GraspStatus) -> SceneLoopState:
        """The state while a grasp is under way, and after it."""
        if gripper.command_id != now.grasp_id or not gripper.outcome:
            return now
        body = now.status.body
        if gripper.outcome == GraspOutcome.HELD:
            return now.turn_to(SceneMode.HOLDING, "The object is lifted and held.", body=body)
        reason = f"The grasp was {gripper.outcome}: {gripper.reason}."
        return now.turn_to(SceneMode.FAILED, reason, body=body)

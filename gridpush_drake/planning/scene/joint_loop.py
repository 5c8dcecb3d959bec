"""`JointLoop`: a task with several objects is carried out, step by step: a pure function.

    waiting --- ready, all objects seen at rest ---> a decision ---> pushing ---> waiting
       |                                                 |
       +--> lost                                         +--> grasping ---> holding
                                                         +--> done, failed

It is a `ClosedLoop` whose poses are those of N objects. A planner decides (`loop.ScenePlanner`), by
the mean of several looks at all objects at rest. What was seen before and after each push is
learned from. A LeafSystem steps the loop with what is on its ports, `loop_run.run_loop` in a world;
the state holds the push, or the grasp, that is asked for.

A loop of one object is shown what was learned. This one learns by itself: which pushes tell of
which object, and when it is worth its time to learn all of them together, is a matter of the task.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from gridpush_drake.dynamics.bodies import describe_object
from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.innovation import InnovationRecord, select_unchanged
from gridpush_drake.identification.multi_object.joint_fit import NOISE
from gridpush_drake.identification.multi_object.joint_result import JointIdentification
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.closed_loop import (
    ClosedLoop,
    LoopOptions,
    LoopState,
    Observation,
    PoseFilter,
)
from gridpush_drake.planning.pregrasp.grasp.side_grasp import SideGrasp
from gridpush_drake.planning.robot_status import GraspOutcome
from gridpush_drake.planning.scene.loop import (
    SceneAction,
    SceneDecision,
    SceneLearner,
    ScenePlanner,
    SceneStep,
    name_objects,
    straighten,
)
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog

FindSceneGrasp = Callable[[Array, SceneDecision, Belief], SideGrasp | None]
"""Finds a grasp of the object of a decision at poses (N, 3); None where the robot has none."""

STILL_WORLD = LoopOptions(observations=1, max_refusals=8)
"""Options of a loop in a world in which nothing moves between two pushes."""


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
        expected_pose: None; where a push is expected to leave the objects is in its decision.
        innovations: number of the last pushes that surprised, one after another, of the object of
            which that are most.
        surprise: how the last push surprised, object by object; empty where it did not.
    """

    mode: SceneMode = SceneMode.WAITING
    reason: str = "Nothing was seen yet."
    pushes: int = 0
    body: int = -1
    kind: str = ""
    expected_pose: None = None
    innovations: int = 0
    surprise: str = ""

    @property
    def over(self) -> bool:
        """Whether the task has ended."""
        return self.mode in (SceneMode.DONE, SceneMode.FAILED, SceneMode.HOLDING, SceneMode.LOST)


@dataclass(frozen=True, eq=False, kw_only=True)
class JointState(LoopState):
    """All that a loop remembers; never changed, only replaced. See `LoopState`, too.

    Attributes:
        belief: what is believed of the objects.
        asked: where the objects were before the last push asked for, and the decision; None where
            it was dealt with.
        steps: the pushes that were made or refused.
        log: what was seen of those that were made.
        last: the decision that ended the task; None before it did.
        learned: numbers of pushes after which the objects were learned anew.
        grasp: the grasp asked for; None before one is.
        grasp_id: its number, counted from 1; 0 before one is asked for.
        object_innovations: (N,) what surprises there were among the pushes of each object.
    """

    status: SceneStatus
    belief: Belief
    asked: SceneStep | None = None
    steps: tuple[SceneStep, ...] = ()
    log: tuple[ObservedPush, ...] = ()
    last: SceneDecision | None = None
    learned: tuple[int, ...] = ()
    grasp: SideGrasp | None = None
    grasp_id: int = 0
    object_innovations: tuple[InnovationRecord, ...] = ()

    def turn_to(self, mode: str, reason: str, **others: Any) -> "JointState":
        """The state in another mode; no object is pushed or grasped in it but the one in `others`.

        See `LoopState.turn_to`.
        """
        return super().turn_to(mode, reason, **{"body": -1, "kind": "", **others})

    @property
    def done(self) -> bool:
        """Whether the task has ended well."""
        return self.status.mode in (SceneMode.DONE, SceneMode.HOLDING)

    @property
    def poses(self) -> Array:
        """(P, N, 3) the objects before each push that was made, as they were seen, m and rad."""
        return np.array([step.poses for step in self.steps if not step.refused])


@dataclass(frozen=True, eq=False)
class JointLoop(ClosedLoop[JointState]):
    """Carries a task with several objects out.

    Attributes:
        planner: decides.
        belief: what is believed of the objects beforehand.
        learning: learns them from the pushes; None for nobody.
        max_pushes: number of pushes after which the task is given up.
        find_grasp: finds a grasp where the planner wants one; None where the robot has no gripper.
        options: how objects are observed, and when the loop gives up.
        seed: seed of what is drawn of the models.
        pushing_modes: modes that last as long as a push.
    """

    planner: ScenePlanner
    belief: Belief
    learning: SceneLearner | None = None
    max_pushes: int = 60
    find_grasp: FindSceneGrasp | None = None
    options: LoopOptions = field(default_factory=LoopOptions)
    seed: int = 0
    pushing_modes: tuple[str, ...] = (SceneMode.PUSHING,)

    def begin(self) -> JointState:
        """The state before the first observation."""
        records = tuple(InnovationRecord(body=b) for b in range(len(self.belief.objects)))
        return JointState(status=SceneStatus(), belief=self.belief, object_innovations=records)

    def observe(self, now: JointState, seen: Observation) -> tuple[JointState, bool]:
        """The state after an observation, but for the decision; see `ClosedLoop.observe`."""
        if now.status.over:
            return now, False
        if now.status.mode is SceneMode.GRASPING:
            return self._follow_grasp(now, seen), False
        return super().observe(now, seen)

    def is_outdated(self, now: JointState, seen: Observation) -> bool:
        """Whether a decision is of no use any more; angles may have jumped by a whole turn."""
        before = [np.asarray(each) for each in now.filter.poses]
        return super().is_outdated(now, replace(seen, pose=straighten(seen.pose, before)))

    def is_idle(self, now: JointState) -> bool:
        """Whether the task has ended."""
        return now.status.over

    def decide(self, now: JointState, seen: Observation) -> JointState:
        """The state with the next push or grasp asked for, or at the end."""
        poses = now.filter.calc_mean()
        now = self._learn(now, poses, seen)
        decision = self.planner.decide(poses, now.belief, now.steps)
        given_up = now.status.pushes >= self.max_pushes
        if decision.push is None or given_up:
            now = self._learn_last(replace(now, last=decision))
        words = decision.reason.replace("_", " ")
        reason = f"{words[0].upper()}{words[1:]}."
        if decision.action is SceneAction.DONE:
            return now.turn_to(SceneMode.DONE, reason)
        if decision.action is SceneAction.FAIL or given_up:
            if decision.action is not SceneAction.FAIL:
                reason = f"Not done after {now.status.pushes} pushes."
            return now.turn_to(SceneMode.FAILED, reason)
        if decision.action is SceneAction.GRASP:
            return self._ask_grasp(now, poses, decision, reason)
        assert decision.push is not None
        asked = replace(now, asked=SceneStep(poses, decision))
        return asked.ask(
            decision.push,
            SceneMode.PUSHING,
            reason,
            seen,
            body=decision.body,
            kind=decision.kind,
        )

    def _wait(self, now: JointState, seen: Observation) -> JointState:
        """The state while the robot is at work: meanwhile the arm may hide objects."""
        return replace(now, filter=PoseFilter(last_seen=seen.time))

    def _observe(self, now: JointState, seen: Observation) -> JointState:
        """The state with one more look at all objects."""
        if np.isfinite(seen.pose).all():
            before = now.filter.poses or tuple(step.poses for step in now.steps[-1:])
            poses = straighten(seen.pose, [np.asarray(each) for each in before])
            return replace(now, filter=now.filter.take_in(seen.time, poses, self.options))
        if not now.filter.is_overdue(seen.time, self.options):
            return replace(now, filter=now.filter.forget())
        objects = now.belief.objects
        hidden = np.broadcast_to(~np.isfinite(seen.pose).all(axis=-1), len(objects))
        names = " and ".join(describe_object(objects, int(b)) for b in np.flatnonzero(hidden))
        reason = f"Not seen for {self.options.timeout:g} s: {names}."
        return now.turn_to(SceneMode.LOST, reason)

    def _end_push(self, now: JointState, seen: Observation) -> JointState:
        """The state after a push that was carried out, or refused."""
        asked = now.asked
        assert asked is not None
        why = seen.robot.reason
        step = replace(asked, refused=why)
        now = replace(now, steps=(*now.steps, step), asked=None if why else asked)
        return super()._end_push(now, seen)

    def _count_made(self, now: JointState, seen: Observation) -> dict[str, Any]:
        return {"pushes": now.status.pushes + 1}

    def _count_refused(self, now: JointState) -> dict[str, Any]:
        return {}

    def _judge(self, now: JointState, seen: Observation) -> JointState:
        """The state itself: a push is judged when the objects are seen at rest after it."""
        return now

    def _learn(self, now: JointState, poses: Array, seen: Observation) -> JointState:
        """The state with the last push in the log, now that it is seen where it ended.

        Where whoever shows the loop what happens has seen more of the push than its end, that is
        learned from.
        """
        asked = now.asked
        if asked is None or asked.decision.push is None:
            return now
        if len(seen.log) > len(now.log):
            made = seen.log[len(now.log)]
        else:
            push = asked.decision.push
            made = ObservedPush(
                name=f"push_{len(now.log) + 1}",
                push=push,
                pose=asked.poses,
                t_observed=np.array([push.duration]),
                poses_observed=poses[None],
            )
        now = replace(now, asked=None, log=(*now.log, made))
        judged = self._judge_objects(now)
        changed = [
            one.body
            for one, before in zip(judged.object_innovations, now.object_innovations, strict=True)
            if one is not before and one.is_changed
        ]
        # An object that has just changed is learned anew at once.
        judged = replace(judged, belief=judged.belief.forget(changed))
        return self._learn_from(judged, anew=bool(changed))

    def _judge_objects(self, now: JointState) -> JointState:
        """The state with the last push judged, object by object, by what was known before it."""
        objects = now.belief.objects
        log = PushLog(now.log, names=name_objects(len(objects)))
        records = tuple(one.note(now.belief.identification, log) for one in now.object_innovations)
        sentences = [
            f"{describe_object(objects, one.body)}: {one.last.describe()}"
            for one, before in zip(records, now.object_innovations, strict=True)
            if one is not before and one.last is not None
        ]
        status = replace(
            now.status,
            innovations=max(one.in_row for one in records),
            surprise=" ".join(sentences),
        )
        return replace(now, object_innovations=records, status=status)

    def _learn_last(self, now: JointState) -> JointState:
        """The state with everything learned that the pushes show, now that none follows."""
        return self._learn_from(now, last=True)

    def _learn_from(self, now: JointState, *, last: bool = False, anew: bool = False) -> JointState:
        """The state with what is learned of the log, if that is worth it now.

        Pushes that moved an object which has changed since are left out.
        """
        if self.learning is None:
            return now
        known = now.belief.identification
        noise = known.noise if isinstance(known, JointIdentification) else NOISE
        pushes = select_unchanged(now.object_innovations, now.log, noise)
        found = self.learning.learn(now.belief, pushes, self.seed, last=last, anew=anew)
        if found is None:
            return now
        return replace(now, belief=found, learned=(*now.learned, len(now.log)))

    def _ask_grasp(
        self, now: JointState, poses: Array, decision: SceneDecision, reason: str
    ) -> JointState:
        """The state with a grasp asked for; done, where the robot has no gripper."""
        if self.find_grasp is None:
            return now.turn_to(SceneMode.DONE, reason, body=decision.body)
        grasp = self.find_grasp(poses, decision, now.belief)
        if grasp is None:
            why = "No grasp is in reach that holds the object where it lies."
            return now.turn_to(SceneMode.FAILED, why, body=decision.body)
        asked = replace(now, grasp=grasp, grasp_id=now.grasp_id + 1)
        return asked.turn_to(SceneMode.GRASPING, reason, body=decision.body)

    def _follow_grasp(self, now: JointState, seen: Observation) -> JointState:
        """The state while a grasp is under way, and after it."""
        gripper = seen.gripper
        if gripper.command_id != now.grasp_id or not gripper.outcome:
            return now
        body = now.status.body
        if gripper.outcome == GraspOutcome.HELD:
            return now.turn_to(SceneMode.HOLDING, "The object is lifted and held.", body=body)
        reason = f"The grasp was {gripper.outcome}: {gripper.reason}."
        return now.turn_to(SceneMode.FAILED, reason, body=body)

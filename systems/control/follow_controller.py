"""`FollowController`: pushes a learned object along a path, with a finger that is steered.

It waits until the object was poked and learned, plans a path around whatever stands on the table,
has the finger come down beside the object, and steers it ten times a second. How it steers is
decided by `planning.feedback.PushFollower`, and what takes long is calculated by the functions of
`planning.feedback.follow_calculations`. The pokes are another system's affair (`PokePolicy`), and
so is how the finger comes down and moves (`SteerExecutor`).

`FeedbackPushController` is the bare follower between ports, for a finger that is on the table
already and calculations that take no time.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context

from gridpush_drake.frozen import Unchanging
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.exploration.strategy import lacks_pokes
from gridpush_drake.planning.feedback.follow_calculations import (
    FollowProgress,
    FollowRules,
    Prepared,
    decide,
    learn_on,
    prepare_after,
)
from gridpush_drake.planning.feedback.follow_log import SeenPose
from gridpush_drake.planning.feedback.follow_options import (
    FOLLOW_REASONS,
    FollowDecision,
    FollowStatus,
)
from gridpush_drake.planning.feedback.pose_track import is_plausible
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.base.messages import (
    STEER_COMMAND_SIZE,
    PushStatus,
    SteerCommand,
    SteerPhase,
    SteerStatus,
)
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.base.worker import Request, WorkerResult, answer_now, make_worker
from gridpush_drake.systems.execution.push_executor import find_tool_yaw

SAMPLE_PERIOD = 0.01
"""Time between two looks at the ports, s."""

TIME_ROUNDING = 1e-9
"""A decision may be early by this much, s: the times of periodic updates are sums, with round-off.
"""

REPEATED_AFTER = 0.1
"""A pose on the port that has not changed for this time counts as seen anew, s: the object rests,
and the camera does not say when it looks."""

HELD_PERIODS = 2.0
"""Periods of decisions for which a velocity is kept while the next decision is under way."""

LEAD_GAIN = 0.3
"""Fraction of the latest one in how long decisions take."""

MAX_BLIND_TIME = 3.0
"""Time for which the finger waits for a pose, or for its own place, s. Then it goes up: it may be
the arm that hides the object from the camera."""

LEARNING_TIME = 10.0
"""Longest wait for the last poke to be learned from, s."""

LEARN_EVERY = 1.5
"""Time from one learning on the way to the next, s."""

BLIND_STATUSES = (FollowStatus.NO_POSE, FollowStatus.NO_FINGER)
"""Statuses of a follower in which the finger rests until object or finger are seen again."""

GIVING_UP = (FollowStatus.STUCK, FollowStatus.UNLIKE_MODEL, FollowStatus.DISTURBED)
"""Statuses of a follower after which another path is planned, from where the object then lies."""

UNKNOWN_POSE = (np.nan, np.nan, np.nan)
"""A pose that is not known."""


class FollowMode(StrEnum):
    """What a `FollowController` does."""

    POKING = "poking"
    PLANNING = "planning"
    GOING = "going"
    FOLLOWING = "following"
    REACHED = "reached"
    FAILED = "failed"


POKING_REASON = "The object is poked, to learn where it is heavy."
"""Reason in the status before all pokes were made."""

PUSHING_REASON = "The object is pushed along its path."
"""Reason in the status while the finger is steered and moves."""


@dataclass(frozen=True)
class FollowControlStatus:
    """How a `FollowController` stands.

    Attributes:
        mode: what it does.
        reason: the mode in a sentence.
        cause: what the follower or the planner of paths said last.
        plans: number of paths that were planned, or tried to be.
    """

    mode: FollowMode = FollowMode.POKING
    reason: str = POKING_REASON
    cause: FollowStatus = FollowStatus.NO_GOAL
    plans: int = 0


@dataclass(frozen=True, eq=False)
class FollowControlState(Unchanging):
    """All that a `FollowController` remembers; never changed, only replaced.

    Attributes:
        status: where it stands.
        command: the command on the port.
        prepared: path and follower; without them before a path was planned.
        place: number of the place, of those in `prepared`, where the finger comes down.
        progress: how far the object came on its path, m.
        request: the calculation under way; None if there is none.
        decide_at: time of the next decision, s.
        lead: how long the last decisions took, s, the latest counting most.
        blind_since: time from which on no pose came while the finger was steered, s; inf if one
            did.
        tips: (time, x, y) of the finger's center since the last decision, s and m; with the angle,
            rad, of one that is no disc.
        seen: poses that came since the last decision.
        follow_run: tips and poses of all decisions so far.
        study: the learning under way; None if there is none.
        learn_at: when is learned next, s.
        learned: what was learned on the way, and the follower has not been told; None if nothing.
        shown: (3,) the pose that was on the port at the last look, m and rad.
        shown_at: when it was last taken for a new one, s.
        poked_at: when the last poke was found in the log, s; inf before.
    """

    status: FollowControlStatus = field(default_factory=FollowControlStatus)
    command: SteerCommand = field(default_factory=SteerCommand)
    prepared: Prepared = field(
        default_factory=lambda: Prepared(FollowStatus.NO_GOAL, FOLLOW_REASONS[FollowStatus.NO_GOAL])
    )
    place: int = 0
    progress: float = 0.0
    request: Request | None = None
    decide_at: float = 0.0
    lead: float = 0.0
    blind_since: float = np.inf
    tips: tuple[tuple[float, ...], ...] = ()
    seen: tuple[SeenPose, ...] = ()
    follow_run: FollowProgress = field(default_factory=FollowProgress)
    study: Request | None = None
    learn_at: float = np.inf
    learned: Identification | None = None
    shown: tuple[float, ...] = UNKNOWN_POSE
    shown_at: float = -np.inf
    poked_at: float = np.inf

    def turn_to(
        self, mode: FollowMode, reason: str, cause: FollowStatus | None = None
    ) -> "FollowControlState":
        """Returns the state in another mode."""
        cause = self.status.cause if cause is None else cause
        status = replace(self.status, mode=mode, reason=reason, cause=cause)
        return replace(self, status=status, request=None)

    def explain(self, reason: str, cause: FollowStatus) -> "FollowControlState":
        """Returns the state in the same mode for another reason; itself if nothing changes."""
        status = replace(self.status, reason=reason, cause=cause)
        return self if status == self.status else replace(self, status=status)

    def give_up(self, reason: str, cause: FollowStatus | None = None) -> "FollowControlState":
        """Returns the state after which nothing more is done; the finger goes up."""
        return replace(self.turn_to(FollowMode.FAILED, reason, cause), command=SteerCommand())


class FollowController(AbstractStateSystem[FollowControlState]):
    """Plans a path for a learned object, and steers the finger that pushes it along.

    .. pydrake_system::

        name: FollowController
        input_ports:
        - object_pose
        - pusher_state
        - pusher_yaw
        - identification
        - push_log
        - push_status
        - steer_status
        output_ports:
        - steer_command
        - status
        - progress
        - prepared

    * object_pose: vector of 3, X_WB as it was last seen, (x, y, theta), m and rad; NaN if the
      object was not seen.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity, m/s.
    * pusher_yaw: vector of 1, angle of a finger that is no disc, rad; of a disc it need not be
      connected.
    * identification: abstract `Identification`, what was learned.
    * push_log: abstract `PushLog`, the pokes so far.
    * push_status: abstract `PushStatus` of the executor of pushes, which pokes.
    * steer_status: abstract `SteerStatus` of the executor of steering.
    * steer_command: vector of 7, see `SteerCommand`.
    * status: abstract `FollowControlStatus`; it changes with the mode, not with every decision.
    * progress: vector of 1, how far the object came on its path, m.
    * prepared: abstract `Prepared`, with the path that is followed.

    Once so many pokes were made and learned from as the rules say, a path is planned from where the
    object lies, and the finger comes down on the side that it will push from. While it is steered,
    it rests where no pose comes, and what is seen is learned from. If the object does not get on,
    or moves unlike its model, the finger goes up, and another path is planned. At the end, or if
    nothing more can be done, it goes up, too.

    A calculation takes long. With an answer delay it is made in a worker, see
    `systems.base.worker`; the finger keeps its velocity until the next decision is there. Abstract
    state: one `FollowControlState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self, obj: GridObject, rules: FollowRules, answer_delay: float | None = 0.0
    ) -> None:
        """Declares the system.

        Args:
            obj: the object.
            rules: where to, and how.
            answer_delay: time after which a calculation's answer is taken, s; None for real time,
                see `worker.make_worker`.

        Raises:
            PlanningError: the delay is negative.
        """
        super().__init__(FollowControlState(), SAMPLE_PERIOD)
        self.obj = obj
        self.rules = rules
        self._worker = make_worker(answer_delay)
        # learning takes longer than a decision may wait
        self._teacher = make_worker(answer_delay)
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._pusher_state = self.DeclareVectorInputPort("pusher_state", 6)
        self._pusher_yaw = self.DeclareVectorInputPort("pusher_yaw", 1)
        self._identification = self.DeclareAbstractInputPort(
            "identification", AbstractValue.Make(describe_prior(obj))
        )
        self._push_log = self.DeclareAbstractInputPort("push_log", AbstractValue.Make(PushLog(())))
        self._push_status = self.DeclareAbstractInputPort(
            "push_status", AbstractValue.Make(PushStatus())
        )
        self._steer_status = self.DeclareAbstractInputPort(
            "steer_status", AbstractValue.Make(SteerStatus())
        )
        self._declare_vector(
            "steer_command", STEER_COMMAND_SIZE, lambda now: now.command.to_vector()
        )
        self._declare_value("status", lambda now: now.status)
        self._declare_vector("progress", 1, lambda now: [now.progress])
        self._declare_value("prepared", lambda now: now.prepared)

    def _go_on(self, context: Context, now: FollowControlState) -> FollowControlState:
        mode = now.status.mode
        if mode in (FollowMode.REACHED, FollowMode.FAILED):
            return now
        if mode == FollowMode.POKING:
            return self._wait_for_pokes(context, now)
        if mode == FollowMode.PLANNING:
            return self._plan(context, now)
        if mode == FollowMode.GOING:
            return self._come_down(context, now)
        return self._follow(context, now)

    def _wait_for_pokes(self, context: Context, now: FollowControlState) -> FollowControlState:
        """Waits until all pokes were made, and were learned from."""
        time = context.get_time()
        log: PushLog = self._push_log.Eval(context)
        count = self.rules.pokes
        status: PushStatus = self._push_status.Eval(context)
        # Not every poke can be written down; the policy repeats them, but not for ever.
        if not status.ready or lacks_pokes(count, status.executed, len(log)):
            return now
        # A poke is learned from a little after it was made, and in real time later still.
        if now.poked_at == np.inf:
            now = replace(now, poked_at=time)
        learned: Identification = self._identification.Eval(context)
        known = {*learned.push_names, *learned.unused_pushes}
        if not {seen.name for seen in log[:count]} <= known and time < now.poked_at + LEARNING_TIME:
            return now
        if not learned.push_names:
            return now.give_up(f"Nothing was learned of the object from {count} pokes.")
        return now.turn_to(FollowMode.PLANNING, "A path is planned.")

    def _plan(self, context: Context, now: FollowControlState) -> FollowControlState:
        """Plans a path from where the object lies, once the finger is out of the way."""
        time = context.get_time()
        if now.request is None:
            pose = np.array(self._object_pose.Eval(context))
            is_due = (
                self._push_status.Eval(context).ready
                and self._steer_status.Eval(context).ready
                and np.isfinite(pose).all()
            )
            if not is_due:
                return now
            learned = self._identification.Eval(context)
            plans = now.status.plans + 1
            now = replace(now, status=replace(now.status, plans=plans))
            pokes = self._push_log.Eval(context)[: self.rules.pokes]
            work = partial(
                prepare_after,
                self.obj,
                learned,
                pose,
                self.rules,
                pokes=pokes,
                follow_run=replace(now.follow_run, path=now.prepared.path, progress=now.progress),
            )
            now, answer = self._ask(now, work, time)
        else:
            now, answer = self._take(now, time)
        if answer is None:
            return now
        # What cannot be followed ends the task; else the finger is sent down.
        if answer.error:
            return now.give_up(f"No path could be planned: {answer.error}.")
        prepared: Prepared = answer.value
        now = replace(now, prepared=prepared, place=0, progress=0.0)
        if prepared.follower is None:
            return now.give_up(prepared.reason, prepared.status)
        if not len(prepared.places):
            return now.give_up("Beside the object there is no room for the finger.")
        return self._send_down(now)

    def _send_down(self, now: FollowControlState) -> FollowControlState:
        """Commands the finger to come down at the present place."""
        x, y, *yaw = now.prepared.places[now.place].tolist()
        # no number is used twice, whatever was commanded and withdrawn before
        number = 1 + max(now.command.command_id, now.place, 100 * now.status.plans)
        now = now.turn_to(FollowMode.GOING, "The finger goes to the object's side.")
        shape = self.rules.finger.shape
        turned = 0.0 if shape is None else find_tool_yaw(yaw[0], shape.period)
        return replace(now, command=SteerCommand(command_id=number, x=x, y=y, yaw=turned))

    def _read_tip(self, context: Context) -> tuple[float, ...]:
        """Reads where the finger is: (x, y), and the angle of one that is no disc, m and rad."""
        x, y = self._pusher_state.Eval(context)[:2].tolist()
        if self.rules.finger.shape is None:
            return x, y
        return x, y, float(self._pusher_yaw.Eval(context)[0])

    def _come_down(self, context: Context, now: FollowControlState) -> FollowControlState:
        """Waits until the finger is down; if the arm does not get there, tries the next place."""
        steer: SteerStatus = self._steer_status.Eval(context)
        if steer.command_id != now.command.command_id:
            return now
        if steer.refused:
            if now.place + 1 == len(now.prepared.places):
                return now.give_up(f"The finger gets nowhere beside the object: {steer.reason}.")
            return self._send_down(replace(now, place=now.place + 1))
        if steer.phase != SteerPhase.STEERING:
            return now
        now = now.turn_to(FollowMode.FOLLOWING, PUSHING_REASON, FollowStatus.PUSHING)
        time = context.get_time()
        return replace(
            now,
            decide_at=time,
            tips=(),
            seen=(),
            shown=UNKNOWN_POSE,
            shown_at=-np.inf,
            study=None,
            learn_at=time + LEARN_EVERY,
            blind_since=np.inf,
        )

    def _follow(self, context: Context, now: FollowControlState) -> FollowControlState:
        """Notes where finger and object are, and decides when it is time to."""
        time = context.get_time()
        tip = self._read_tip(context)
        now = self._look(context, replace(now, tips=(*now.tips, (time, *tip))))
        # The finger goes up by itself where it presses too hard.
        steer: SteerStatus = self._steer_status.Eval(context)
        if steer.phase != SteerPhase.STEERING:
            return self._plan_anew(now, f"The finger went up: {steer.reason}.", FollowStatus.STUCK)
        follower = now.prepared.follower
        assert follower is not None
        # Whatever comes while a decision is under way, the next one is told.
        if now.request is None:
            if time < now.decide_at - TIME_ROUNDING:
                return now
            now = self._learn(context, now)
            # the finger goes on until the decision is there, but for no longer than HELD_PERIODS
            # periods
            held = min(1.0, HELD_PERIODS * self.rules.options.period / max(now.lead, TIME_ROUNDING))
            work = partial(
                decide,
                follower,
                now.tips,
                now.seen,
                now.learned,
                lead=now.lead,
                velocity=held * now.command.velocity[: self.rules.finger.coordinates],
            )
            # a place that is not known tells nothing of the way
            known = (tip for tip in now.tips if is_plausible(tip[1:]))
            follow_run = FollowProgress(
                (*now.follow_run.tips, *known), (*now.follow_run.seen, *now.seen)
            )
            now = replace(
                now,
                tips=(),
                seen=(),
                follow_run=follow_run,
                learned=None,
                decide_at=time + self.rules.options.period,
            )
            now, answer = self._ask(now, work, time)
            asked_at = time
        else:
            now, answer = self._take(now, time)
            asked_at = now.decide_at - self.rules.options.period
        if answer is None:
            # What was decided last holds for a while, but the finger goes nowhere blindly.
            if time > asked_at + HELD_PERIODS * self.rules.options.period:
                now = replace(now, command=replace(now.command, vx=0.0, vy=0.0, yaw_rate=0.0))
            return now
        lead = now.lead + LEAD_GAIN * (time - asked_at - now.lead)
        now = replace(now, lead=lead)
        if answer.error:
            return now.give_up(f"No decision could be made: {answer.error}.")
        after, decision = answer.value
        now = replace(now, prepared=replace(now.prepared, follower=after))
        is_blind = decision.status in BLIND_STATUSES
        now = replace(now, blind_since=min(now.blind_since, time) if is_blind else np.inf)
        if time > now.blind_since + MAX_BLIND_TIME:
            return self._plan_anew(now, decision.reason, decision.status)
        return self._heed(now, decision)

    def _learn(self, context: Context, now: FollowControlState) -> FollowControlState:
        """Learns from the way so far, now and then, beside the decisions."""
        time = context.get_time()
        if now.study is None:
            if time < now.learn_at - TIME_ROUNDING:
                return now
            now = replace(now, learn_at=time + LEARN_EVERY)
            pokes = self._push_log.Eval(context)[: self.rules.pokes]
            learned = self._identification.Eval(context)
            work = partial(
                learn_on, self.obj, learned, self.rules, pokes=pokes, follow_run=now.follow_run
            )
            if self._teacher is not None:
                return replace(now, study=self._teacher.ask(work, time))
            answer: WorkerResult | None = answer_now(work)
        else:
            assert self._teacher is not None
            answer = self._teacher.take(now.study, time)
        if answer is None:
            return now
        # where nothing could be learned, the follower goes on with what it knows
        return replace(now, study=None, learned=answer.value)

    def _heed(self, now: FollowControlState, decision: FollowDecision) -> FollowControlState:
        """Does what was decided."""
        vx, vy, *turning = decision.velocity.tolist()
        rate = turning[0] if turning else 0.0
        command = replace(now.command, vx=vx, vy=vy, yaw_rate=rate)
        now = replace(now, progress=decision.progress, command=command)
        status = decision.status
        if status == FollowStatus.PUSHING or status in BLIND_STATUSES:
            return now.explain(decision.reason or PUSHING_REASON, status)
        if status == FollowStatus.REACHED:
            now = now.turn_to(FollowMode.REACHED, "The object is at the end of its path.", status)
            return replace(now, command=SteerCommand())
        if status in GIVING_UP:
            return self._plan_anew(now, decision.reason, status)
        return now.give_up(decision.reason, status)

    def _plan_anew(
        self, now: FollowControlState, reason: str, cause: FollowStatus
    ) -> FollowControlState:
        """Has another path planned, if there were not too many, for a reason, a sentence."""
        if now.status.plans >= self.rules.plans:
            return now.give_up(reason, cause)
        now = now.turn_to(FollowMode.PLANNING, f"{reason} Another path is planned.", cause)
        return replace(now, command=SteerCommand())

    def _look(self, context: Context, now: FollowControlState) -> FollowControlState:
        """Notes the pose on the port, if it is a new one."""
        time = context.get_time()
        shown = tuple(self._object_pose.Eval(context).tolist())
        if shown == now.shown and time < now.shown_at + REPEATED_AFTER:
            return now
        now = replace(now, shown=shown, shown_at=time)
        if not is_plausible(shown):
            return now
        seen = SeenPose(time - self.rules.pose_delay, np.array(shown))
        return replace(now, seen=(*now.seen, seen))

    def _ask(
        self, now: FollowControlState, work: Callable[[], object], time: float
    ) -> tuple[FollowControlState, WorkerResult | None]:
        """Has something calculated: at once, or in the worker, so that there is no answer yet."""
        if self._worker is None:
            return now, answer_now(work)
        return replace(now, request=self._worker.ask(work, time)), None

    def _take(
        self, now: FollowControlState, time: float
    ) -> tuple[FollowControlState, WorkerResult | None]:
        """Takes the worker's answer, if it is there."""
        assert self._worker is not None and now.request is not None
        answer = self._worker.take(now.request, time)
        return (now if answer is None else replace(now, request=None)), answer

"""What closed loops that push an object share: pure functions of a state and an observation.

    waiting --- the robot is ready, the object seen at rest ---> a decision ---> a push ---> waiting
       |
       +--> lost, while the object is out of sight

`ClosedLoop.step` takes a frozen state and an `Observation` to the next state; the state holds the
push asked for. A LeafSystem steps the loop with what is on its ports, a benchmark with what a
simulated world shows (`loop_run.run_loop`).

A single observation is noisy, and the object may still be moving in it. The latest poses q_1 .. q_k
belong to the same rest if

    |x_i - x_k|, |y_i - y_k| <= rest_distance   and   |theta_i - theta_k| <= rest_angle   for all i,

and their mean says where the object lies. Poses from before one that differs from the last are
forgotten.

Every push that was made is judged by the model as it was before it (`identification.innovation`). A
loop says of a push that it surprised. After two surprises in a row, or a clear one, the object is
another one than was learned: the loop falls back to pokes, and does not slide on. Where the object
hangs over the edge, any surprise is enough to stop.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Generic, TypeVar

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError
from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.innovation import InnovationRecord
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.robot_status import GraspStatus, PressStatus, PushStatus
from gridpush_drake.pushes.push_log import PushLog

Pose = tuple[float, float, float]
"""A pose (x, y, theta), X_WB, m and rad."""

# Every loop has these modes, beside its own.

WAITING_MODE = "waiting"
"""Mode of a loop that waits for the robot to be ready, or for the object to be seen at rest."""

LOST_MODE = "lost"
"""Mode of a loop whose object is out of sight."""

FAILED_MODE = "failed"
"""Mode of a loop that gave up."""

MAX_FALLBACKS = 2
"""Number of times that a loop falls back to pokes, because the object moved unlike what was learned
of it. The next time it gives up."""


@dataclass(frozen=True)
class LoopOptions:
    """How a loop observes and when it gives up. Every number is positive.

    Attributes:
        period: between two observations, s.
        observations: number of observations of the object at rest that a decision needs; it takes
            their mean.
        rest_distance: two poses closer than this along x and along y may belong to the same rest,
            m.
        rest_angle: two poses whose headings differ by less than this may belong to the same rest,
            rad.
        timeout: how long the object may be out of sight before it counts as lost, s.
        max_refusals: number of pushes in a row that the robot refuses before the loop gives up.

    Raises:
        PlanningError: a number is out of range.
    """

    period: float = 0.05
    observations: int = 6
    rest_distance: float = 0.004
    rest_angle: float = 0.04
    timeout: float = 1.0
    max_refusals: int = 10

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(each.default, int):
                if value < 1:
                    raise PlanningError(f"{each.name} is {value!r}; expected 1 or more")
            elif not (np.isfinite(value) and value > 0):
                raise PlanningError(f"{each.name} is {value!r}; expected a positive number")

    def are_of_one_rest(self, poses: Sequence[Any], pose: Array) -> bool:
        """Whether a pose may belong to the same rest as others do.

        Args:
            poses: the others; their mean counts.
            pose: (3,) X_WB, m and rad, or (N, 3) of several; NaN belongs to no rest.
        """
        difference = np.abs(pose - np.mean(poses, axis=0))
        moved = difference[..., :2].max()
        return bool(moved <= self.rest_distance and difference[..., 2].max() <= self.rest_angle)


@dataclass(frozen=True)
class PoseFilter:
    """What was seen since everything came to rest; never changed, only replaced.

    Attributes:
        poses: poses of the object at rest, X_WB, m and rad, in order of time; of several objects,
            (N, 3) each.
        last_seen: when the object was last seen, s.
    """

    poses: tuple[Any, ...] = ()
    last_seen: float = 0.0

    def __len__(self) -> int:
        return len(self.poses)

    def calc_mean(self) -> Array:
        """(3,), or (N, 3), the mean of the poses, m and rad; there must be one."""
        mean: Array = np.mean(self.poses, axis=0)
        return mean

    def forget(self) -> "PoseFilter":
        """The filter without its poses."""
        return replace(self, poses=()) if self.poses else self

    def wait(self, time: float, pose: Array) -> "PoseFilter":
        """The filter while the robot is at work.

        It keeps no poses, only the time at which the object was last seen.

        Args:
            time: now, s.
            pose: (3,) of the object; NaN where it is not seen.
        """
        return PoseFilter(last_seen=time if np.isfinite(pose).all() else self.last_seen)

    def is_overdue(self, time: float, options: LoopOptions) -> bool:
        """Whether the object has been out of sight for longer than the timeout at `time`, s."""
        return time - self.last_seen > options.timeout

    def take_in(self, time: float, pose: Array, options: LoopOptions) -> "PoseFilter":
        """The filter with one more pose, and of the others those that belong to the same rest.

        Args:
            time: when the pose was seen, s.
            pose: (3,) of the object, or (N, 3); NaN where it, or one of them, is not seen, and then
                no poses are kept.
            options: says what belongs to the same rest, and how many poses are needed.
        """
        if not np.isfinite(pose).all():
            return self.forget()
        poses = np.array([*self.poses, pose])[-options.observations :]
        difference = np.abs(poses - poses[-1]).reshape(len(poses), -1, 3)
        moved = difference[..., :2].max(axis=(1, 2)) > options.rest_distance
        moved |= difference[..., 2].max(axis=1) > options.rest_angle
        kept = poses[int(np.flatnonzero(moved)[-1]) + 1 :] if moved.any() else poses
        return PoseFilter(tuple(_to_tuple(each) for each in kept.tolist()), time)


def _to_tuple(pose: list[Any]) -> tuple[Any, ...]:
    """Makes tuples of a pose's numbers, or of those of several."""
    return tuple(_to_tuple(each) if isinstance(each, list) else each for each in pose)


@dataclass(frozen=True, eq=False)
class Observation:
    """What a loop is shown at one time.

    Attributes:
        time: of the observation, s.
        pose: (3,) X_WB of the object, m and rad, or (N, 3); NaN where it is not seen.
        robot: status of what carries out pushes.
        log: all pushes so far.
        identification: what was learned from them; None before anything was.
        gripper: status of what carries out grasps.
        presser: status of what carries out presses at the table's edge.
        goal: (3,) pose that is asked for from outside, X_WB, m and rad; NaN for none.
    """

    time: float
    pose: Array
    robot: PushStatus
    log: PushLog
    identification: Identification | None = None
    gripper: GraspStatus = field(default_factory=GraspStatus)
    presser: PressStatus = field(default_factory=PressStatus)
    goal: Array = field(default_factory=lambda: np.full(3, np.nan))

    @property
    def seen(self) -> bool:
        """Whether the object is seen."""
        return bool(np.isfinite(self.pose).all())

    @property
    def robot_ready(self) -> bool:
        """Whether the robot neither pushes nor grasps nor presses."""
        return self.robot.ready and self.gripper.ready and self.presser.ready


@dataclass(frozen=True, eq=False)
class LoopState(Unchanging):
    """All that a loop remembers; never changed, only replaced.

    Attributes:
        status: what the loop says of itself: frozen, with a `mode`, a `reason`, an
            `expected_pose`, and the fields `innovations` and `surprise`.
        filter: poses seen since everything came to rest.
        push: the last push asked for; None before the first, and where it was withdrawn.
        push_id: number of the last push asked for, counted from 1; a number is never used again.
        refused: the pushes that were refused since the last one that was not.
        request: the decision that is being calculated beside the loop; None where none is.
        believed: what was learned before the last push was asked for; None where that was nothing.
        logged: number of pushes in the log when the last push was asked for.
        innovations: what surprises there were among the pushes made.
        fallbacks: how often the loop fell back to pokes.
    """

    status: Any
    filter: PoseFilter = field(default_factory=PoseFilter)
    push: Push | None = None
    push_id: int = 0
    refused: tuple[Push, ...] = ()
    request: Any = None
    believed: Identification | None = None
    logged: int = 0
    innovations: InnovationRecord = field(default_factory=InnovationRecord)
    fallbacks: int = 0

    def is_pending(self, robot: PushStatus) -> bool:
        """Whether the robot has not taken the push up yet."""
        return self.push is not None and robot.command_id != self.push_id

    def turn_to(self: "LoopStateType", mode: str, reason: str, **others: Any) -> "LoopStateType":
        """The state in another mode, with nothing seen yet.

        Args:
            mode: of the status.
            reason: for the mode, in a sentence.
            **others: further fields of the status; the expected pose is None unless it is here.
        """
        changes = {"expected_pose": None, **others}
        status = replace(self.status, mode=type(self.status.mode)(mode), reason=reason, **changes)
        return replace(self, status=status, filter=self.filter.forget())

    def ask(
        self: "LoopStateType", push: Push, mode: str, reason: str, seen: Observation, **others: Any
    ) -> "LoopStateType":
        """The state with another push asked for.

        Args:
            push: the push.
            mode: of the status.
            reason: for the mode, in a sentence.
            seen: what the push was chosen by.
            **others: further fields of the status, see `turn_to`.
        """
        asked = replace(
            self,
            push=push,
            push_id=self.push_id + 1,
            believed=seen.identification,
            logged=len(seen.log),
        )
        return asked.turn_to(mode, reason, **others)

    def check_innovation(self: "LoopStateType", log: PushLog) -> "LoopStateType":
        """The state after a push was made: whether it surprised is in the status.

        A push that is not in the log, because it was not seen, is not judged.

        Args:
            log: all pushes so far.
        """
        if len(log) <= self.logged:
            return self
        innovations = self.innovations.note(self.believed, log)
        if innovations is self.innovations:
            return self
        sentence = "" if innovations.last is None else innovations.last.describe()
        status = replace(self.status, innovations=innovations.in_row, surprise=sentence)
        return replace(self, innovations=innovations, status=status)


LoopStateType = TypeVar("LoopStateType", bound=LoopState)
"""The state of a loop."""


class ClosedLoop(Generic[LoopStateType]):
    """Decides again and again what to do with an object, by what is seen.

    It holds what never changes; whatever does is in the state, so that one loop may be stepped with
    many states.

    Attributes:
        options: how it observes, and when it gives up.
        pushing_modes: modes that last as long as a push.
    """

    options: LoopOptions
    pushing_modes: tuple[str, ...] = ()

    def begin(self) -> LoopStateType:
        """The state before the first observation."""
        raise NotImplementedError

    def step(self, now: LoopStateType, seen: Observation) -> LoopStateType:
        """The state after an observation; `now` itself where nothing is new.

        The robot is waited for, then the object until it lies still; then the next push, or the
        end, is decided on.
        """
        now, due = self.observe(now, seen)
        return self.decide(now, seen) if due else now

    def observe(self, now: LoopStateType, seen: Observation) -> tuple[LoopStateType, bool]:
        """The state after an observation, but for the decision, which takes long.

        Returns:
            The state, and whether a decision is due.
        """
        if not seen.robot_ready or now.is_pending(seen.robot):
            return self._wait(now, seen), False
        if now.status.mode in self.pushing_modes:
            now = self._end_push(now, seen)
        now = self._prepare(now, seen)
        if self.is_idle(now):
            return now, False
        now = self._observe(now, seen)
        return now, len(now.filter) >= self.options.observations

    def decide(self, now: LoopStateType, seen: Observation) -> LoopStateType:
        """The state after the decision that is due, with the object observed at rest.

        This is a pure function, so that it may be calculated beside the loop.
        """
        raise NotImplementedError

    def is_outdated(self, now: LoopStateType, seen: Observation) -> bool:
        """Whether a decision that was begun for `now` is of no use any more.

        It is not if the robot is at work, or the object no longer where it was.
        """
        at_rest = seen.robot_ready and self.options.are_of_one_rest(now.filter.poses, seen.pose)
        return not at_rest or now.is_pending(seen.robot)

    def is_idle(self, now: LoopStateType) -> bool:
        """Whether there is nothing to decide, so that the object need not be observed."""
        raise NotImplementedError

    def _prepare(self, now: LoopStateType, seen: Observation) -> LoopStateType:
        """The state with what is new from outside, such as another goal.

        It is called between pushes only.
        """
        return now

    def _count_made(self, now: LoopStateType, seen: Observation) -> dict[str, Any]:
        """Fields of the status that change once a push was made."""
        raise NotImplementedError

    def _count_refused(self, now: LoopStateType) -> dict[str, Any]:
        """Fields of the status that change once a push was refused or withdrawn.

        `now.refused` holds the pushes that were refused in a row.
        """
        raise NotImplementedError

    def _judge(self, now: LoopStateType, seen: Observation) -> LoopStateType:
        """The state after a push was made, judged by what the model said of it beforehand."""
        return now.check_innovation(seen.log)

    def _wait(self, now: LoopStateType, seen: Observation) -> LoopStateType:
        """The state while the robot is at work, or about to be.

        A push that was not taken up yet when the object went out of sight is withdrawn: when the
        object is seen again, it may lie elsewhere.
        """
        now = replace(now, filter=now.filter.wait(seen.time, seen.pose))
        if seen.seen or not seen.robot.ready or not now.is_pending(seen.robot):
            return now
        return replace(now, push=None).turn_to(
            WAITING_MODE, "The object is not seen.", **self._count_refused(now)
        )

    def _end_push(self, now: LoopStateType, seen: Observation) -> LoopStateType:
        """The state after a push that was carried out, broken off, or refused."""
        why = seen.robot.reason
        if not why:
            changes = {"reason": "A push was made.", **self._count_made(now, seen)}
            judged = self._judge(replace(now, refused=()), seen)
            if judged.innovations is not now.innovations and judged.innovations.last is not None:
                changes["reason"] += f" {judged.status.surprise}"
            return judged.turn_to(WAITING_MODE, **changes)
        assert now.push is not None
        now = replace(now, refused=(*now.refused, now.push))
        changes = self._count_refused(now)
        count = len(now.refused)
        if count < self.options.max_refusals:
            return now.turn_to(WAITING_MODE, f"A push was refused: {why}.", **changes)
        reason = f"The last {count} pushes were refused; the last one because {why}."
        return now.turn_to(FAILED_MODE, reason, **changes)

    def _observe(self, now: LoopStateType, seen: Observation) -> LoopStateType:
        """The state with what is seen of the object at rest."""
        seen_now = now.filter.take_in(seen.time, seen.pose, self.options)
        lost = now.status.mode == LOST_MODE
        if not lost and seen_now.is_overdue(seen.time, self.options):
            reason = f"The object has not been seen for {self.options.timeout:g} s."
            return now.turn_to(LOST_MODE, reason)
        if lost and len(seen_now):
            now = now.turn_to(WAITING_MODE, "The object is seen again.")
        return now if seen_now is now.filter else replace(now, filter=seen_now)

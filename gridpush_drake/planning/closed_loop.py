"""What closed loops that push an object have in common: pure functions of a state and an observation.

    waiting --- the robot is ready, the object seen at rest ---> a decision ---> a push ---> waiting
       |
       +--> lost, while the object is out of sight

`ClosedLoop.step` takes a frozen state and an `Observation` to the next state; the state holds the
push asked for. A LeafSystem steps it with what is on its ports, a benchmark with what a simulated
world shows (`loop_run.run_loop`).

A single observation is noisy, and may show an object that moves still. The latest poses q_1 .. q_k
are of one rest if

    |x_i - x_k|, |y_i - y_k| <= rest   and   |theta_i - theta_k| <= rest_angle   for all i,

and their mean says where the object lies. A pose that differs from the last one ends the rest that
it was of.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Generic, TypeVar

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError
from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.robot_status import GraspStatus, PushStatus
from gridpush_drake.pushes.push_log import PushLog

Pose = tuple[float, float, float]

WAITING, LOST, FAILED = "waiting", "lost", "failed"  # modes of every loop


@dataclass(frozen=True)
class LoopOptions:
    """How a loop observes and when it gives up; every number is positive, and what is counted 1 or more.

    Attributes:
        period: between two observations, s.
        observations: of the object at rest, whose mean counts.
        rest: poses further apart than this are not of one rest, m,
        rest_angle: likewise, rad.
        timeout: how long the object may be out of sight before it counts as lost, s.
        max_refusals: pushes in a row that the robot refuses before the loop gives up.

    Raises:
        PlanningError: a number is out of range.
    """

    period: float = 0.05
    observations: int = 6
    rest: float = 0.004
    rest_angle: float = 0.04
    timeout: float = 1.0
    max_refusals: int = 10

    def __post_init__(self) -> None:
        for name, default in ((one.name, one.default) for one in fields(self)):
            value = getattr(self, name)
            if isinstance(default, int):
                if value < 1:
                    raise PlanningError(f"{name} is {value!r}; expected 1 or more")
            elif not (np.isfinite(value) and value > 0):
                raise PlanningError(f"{name} is {value!r}; expected a positive number")

    def are_of_one_rest(self, poses: Sequence[Pose], pose: Array) -> bool:
        """Whether a pose (3,), m and rad, may be of one rest with others, at their mean; not where it is NaN."""
        off = np.abs(pose - np.mean(poses, axis=0))
        return bool(off[:2].max() <= self.rest and off[2] <= self.rest_angle)


@dataclass(frozen=True)
class PoseFilter:
    """What was seen since everything came to rest; never changed, only replaced."""

    poses: tuple[Pose, ...] = ()  # (x, y, theta) of B in W, m and rad, the last one last
    last_seen: float = 0.0  # when the object was, s

    def __len__(self) -> int:
        return len(self.poses)

    def calc_mean(self) -> Array:
        """(3,) the mean pose, m and rad; there must be one."""
        mean: Array = np.mean(self.poses, axis=0)
        return mean

    def forget(self) -> "PoseFilter":
        """Without the poses."""
        return replace(self, poses=()) if self.poses else self

    def wait(self, time: float, pose: Array) -> "PoseFilter":
        """Without the poses, while the robot is at work; only whether the object was seen, `pose` (3,), counts."""
        return PoseFilter(last_seen=time if np.isfinite(pose).all() else self.last_seen)

    def is_overdue(self, time: float, options: LoopOptions) -> bool:
        """Whether the object has been out of sight for longer than the timeout at `time`, s."""
        return time - self.last_seen > options.timeout

    def take_in(self, time: float, pose: Array, options: LoopOptions) -> "PoseFilter":
        """With the pose (3,) seen at `time`, s: the latest of one rest with it; none where it is NaN, not seen."""
        if not np.isfinite(pose).all():
            return self.forget()
        poses = np.array([*self.poses, pose])[-options.observations :]
        off = np.abs(poses - poses[-1])
        moved = (off[:, :2].max(axis=1) > options.rest) | (off[:, 2] > options.rest_angle)
        kept = poses[int(np.flatnonzero(moved)[-1]) + 1 :] if moved.any() else poses
        return PoseFilter(tuple((x, y, theta) for x, y, theta in kept.tolist()), time)


@dataclass(frozen=True, eq=False)
class Observation:
    """What a loop is shown at one time.

    Attributes:
        time: s.
        pose: (3,) X_WB of the object, m and rad; NaN where it is not seen.
        robot: of its pushes.
        log: all pushes so far.
        identification: learned from them; None before anything was.
        gripper: of its grasps.
        goal: (3,) that is asked for from outside, X_WB, m and rad; NaN for none.
    """

    time: float
    pose: Array
    robot: PushStatus
    log: PushLog
    identification: Identification | None = None
    gripper: GraspStatus = field(default_factory=GraspStatus)
    goal: Array = field(default_factory=lambda: np.full(3, np.nan))

    @property
    def seen(self) -> bool:
        """Whether the object is."""
        return bool(np.isfinite(self.pose).all())


@dataclass(frozen=True, eq=False)
class LoopState(Unchanging):
    """All that a loop remembers."""

    status: Any  # what it says of itself: frozen, with a `mode`, a `reason` and an `expected_pose`
    filter: PoseFilter = field(
        default_factory=PoseFilter
    )  # poses seen since everything came to rest
    push: Push | None = (
        None  # the last one asked for; None before the first, and where it was withdrawn
    )
    push_id: int = 0  # of the last one asked for, counted from 1; an id is never used again
    refused: tuple[Push, ...] = ()  # pushes that were refused since the last one that was not
    request: Any = None  # the decision under way beside the loop; None where none is

    def is_pending(self, robot: PushStatus) -> bool:
        """Whether the robot has not taken the push up yet."""
        return self.push is not None and robot.command_id != self.push_id

    def turn_to(self: "L", mode: str, reason: str, **others: Any) -> "L":
        """In another mode, with nothing seen yet, and no push under way unless `others` says so."""
        changes = {"expected_pose": None, **others}
        status = replace(self.status, mode=type(self.status.mode)(mode), reason=reason, **changes)
        return replace(self, status=status, filter=self.filter.forget())

    def ask(self: "L", push: Push, mode: str, reason: str, **others: Any) -> "L":
        """With another push asked for."""
        return replace(self, push=push, push_id=self.push_id + 1).turn_to(mode, reason, **others)


L = TypeVar("L", bound=LoopState)


class ClosedLoop(Generic[L]):
    """One decision after another on what to do with an object, by what is seen.

    It holds what never changes; whatever does is in the state, so that one loop may be stepped with
    many states.
    """

    options: LoopOptions  # how it observes, and when it gives up

    def begin(self) -> L:
        """The state before the first observation."""
        raise NotImplementedError

    def step(self, now: L, seen: Observation) -> L:
        """The state after an observation; `now` itself where nothing is new.

        The robot is waited for, then the object until it lies still; then the next push, or the
        end, is decided on.
        """
        now, due = self.observe(now, seen)
        return self.decide(now, seen) if due else now

    def observe(self, now: L, seen: Observation) -> tuple[L, bool]:
        """The state after an observation but for the decision, which takes long; and whether that is due."""
        if not seen.robot.ready or not seen.gripper.ready or now.is_pending(seen.robot):
            return self._wait(now, seen), False
        if now.status.mode in self.pushing_modes:
            now = self._end_push(now, seen)
        now = self._prepare(now, seen)
        if self.is_idle(now):
            return now, False
        now = self._observe(now, seen)
        return now, len(now.filter) >= self.options.observations

    def decide(self, now: L, seen: Observation) -> L:
        """The state after the decision that is due, with the object observed at rest: a pure function.

        It may be calculated beside the loop.
        """
        raise NotImplementedError

    def is_outdated(self, now: L, seen: Observation) -> bool:
        """Whether a decision for `now` is of no use any more: the robot is at work, or the object not where it was."""
        at_rest = (
            seen.robot.ready
            and seen.gripper.ready
            and self.options.are_of_one_rest(now.filter.poses, seen.pose)
        )
        return not at_rest or now.is_pending(seen.robot)

    pushing_modes: tuple[str, ...] = ()
    """Modes that last as long as a push."""

    def is_idle(self, now: L) -> bool:
        """Whether there is nothing to decide, so that the object need not be observed."""
        raise NotImplementedError

    def _prepare(self, now: L, seen: Observation) -> L:
        """What is new from outside, such as another goal, taken in between pushes."""
        return now

    def _count_made(self, now: L, seen: Observation) -> dict[str, Any]:
        """What the status says once a push was made."""
        raise NotImplementedError

    def _count_refused(self, now: L) -> dict[str, Any]:
        """What the status says once a push was refused, or withdrawn; `now.refused` holds those in a row."""
        raise NotImplementedError

    def _wait(self, now: L, seen: Observation) -> L:
        """While the robot is at work; takes a push back that was not taken up when the object went out of sight."""
        now = replace(now, filter=now.filter.wait(seen.time, seen.pose))
        if seen.seen or not seen.robot.ready or not now.is_pending(seen.robot):
            return now
        # when the object is seen again it may lie elsewhere
        return replace(now, push=None).turn_to(
            WAITING, "The object is not seen.", **self._count_refused(now)
        )

    def _end_push(self, now: L, seen: Observation) -> L:
        """After a push that was carried out, broken off, or refused."""
        if not seen.robot.reason:
            changes = self._count_made(now, seen)
            return replace(now, refused=()).turn_to(
                WAITING, **{"reason": "A push was made.", **changes}
            )
        assert now.push is not None
        now = replace(now, refused=(*now.refused, now.push))
        count, why, changes = len(now.refused), seen.robot.reason, self._count_refused(now)
        if count < self.options.max_refusals:
            return now.turn_to(WAITING, f"A push was refused: {why}.", **changes)
        reason = f"The last {count} pushes were refused; the last one because {why}."
        return now.turn_to(FAILED, reason, **changes)

    def _observe(self, now: L, seen: Observation) -> L:
        """Takes in what is seen of the object at rest."""
        poses, lost = (
            now.filter.take_in(seen.time, seen.pose, self.options),
            now.status.mode == LOST,
        )
        if not lost and poses.is_overdue(seen.time, self.options):
            return now.turn_to(
                LOST, f"The object has not been seen for {self.options.timeout:g} s."
            )
        if lost and len(poses):
            now = now.turn_to(WAITING, "The object is seen again.")
        return now if poses is now.filter else replace(now, filter=poses)

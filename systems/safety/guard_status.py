"""What an `ArmGuard` allows an arm, and what it says of itself: `GuardLimits` and `GuardStatus`.

Plain records; `arm_guard` decides what goes into them.
"""

from dataclasses import dataclass, replace
from enum import StrEnum

from gridpush_drake.geometry.se2 import Array

STOPPED_BY_USER = "stopped by the user"
WORK_DONE = "the work is done"
"""Reasons of stops that are no faults."""

BY_USER = 1.0
RETREAT_DONE = 2.0
BY_SILENCE = 3.0
"""Values of the port `stop`, which say what the arm is stopped for."""


@dataclass(frozen=True, eq=False)
class GuardLimits:
    """What an `ArmGuard` allows an arm of n joints.

    Where a joint slides, read m for rad and N for N m.

    Attributes:
        speed: (n,) greatest speed of each joint in the commands, rad/s.
        acceleration: (n,) greatest acceleration of each joint in the commands, rad/s².
        torque: (n,) greatest torque on each joint from outside, N m; beyond it the arm goes back.
        position_lower: (n,) least position of each joint, rad; a desired position below it stops
            the arm, and no command goes beyond it.
        position_upper: (n,) greatest position of each joint, rad; likewise.
        force: greatest force on the finger's tip, N; beyond it the arm goes back.
        status_age: greatest age of the robot's last status, s; beyond it the arm is stopped.
        pose_jump: farthest that the object may be seen to move from one look to the next, m.
        pose_turn: farthest that the object may be seen to turn from one look to the next, rad.
        retreat: farthest that the tip travels back after a torque or a force over its limit, m.
        following_error: how far a joint may be measured from all positions that it was told within
            the last `following_time`, rad.
        following_time: how long a joint may be farther off than `following_error`, s; and how late
            a joint may be without being off at all.
        sliding: numbers, from 0, of the joints that slide; the others turn.
    """

    speed: Array
    acceleration: Array
    torque: Array
    position_lower: Array
    position_upper: Array
    force: float = 30.0
    status_age: float = 0.05
    pose_jump: float = 0.03
    pose_turn: float = 0.3
    retreat: float = 0.01
    following_error: float = 0.02
    following_time: float = 0.05
    sliding: tuple[int, ...] = ()

    def name_unit(self, joint: int) -> str:
        """Names the unit of a joint's position, by the joint's number from 0: rad or m."""
        return "m" if joint in self.sliding else "rad"


class GuardMode(StrEnum):
    """The present mode of a guard.

    WAITING: the arm was not measured yet; no command goes out, and a stop is kept. FOLLOWING:
    commands are passed on. STOPPING: the arm is brought to rest, or goes back from a collision.
    HOLDING: the arm is commanded to stay, and is measured at rest there. UNCONFIRMED: the arm is
    commanded to stay, but is not measured at rest there, or not measured at all.
    """

    WAITING = "waiting"
    FOLLOWING = "following"
    STOPPING = "stopping"
    HOLDING = "holding"
    UNCONFIRMED = "holding, not seen at rest"


class StopKind(StrEnum):
    """Kinds of reasons for which a guard stops an arm; each is noted once."""

    USER = "user"
    DONE = "done"
    SILENCE = "silence"
    NOT_FINITE = "not finite"
    JOINT_LIMIT = "joint limit"
    TORQUE = "torque"
    FORCE = "force"
    JOINT_SPEED = "joint speed"
    FOLLOWING = "following"
    TIP = "tip"
    OBJECT = "object"


COLLISION_KINDS = (StopKind.TORQUE, StopKind.FORCE)
"""Kinds after which the arm goes back along the way that it has come."""


@dataclass(frozen=True)
class Fault:
    """Something that is wrong, or another reason to stop.

    Attributes:
        kind: kind of the reason.
        reason: a sentence about it, without a full stop.
    """

    kind: StopKind
    reason: str


@dataclass(frozen=True)
class GuardStatus:
    """The status of a guard, as it is on its port.

    Attributes:
        mode: what the guard does.
        reason: why it stopped the arm, and what went wrong after that; empty if it did not.
        since: time at which it stopped the arm, s; NaN if it did not.
        kinds: kinds of all reasons, that of the stop first; empty if it did not stop the arm.
        back_at: time at which the arm will have gone back from a collision as far as it may, s; NaN
            if it does not go back.
    """

    mode: GuardMode = GuardMode.WAITING
    reason: str = ""
    since: float = float("nan")
    kinds: tuple[StopKind, ...] = ()
    back_at: float = float("nan")

    @property
    def by_user(self) -> bool:
        """Whether the arm was stopped because the user said so."""
        return self.kinds[:1] == (StopKind.USER,)

    @property
    def stopped(self) -> bool:
        """Whether the arm was stopped, or is just being."""
        return bool(self.reason)

    @property
    def ended(self) -> bool:
        """Whether the arm was stopped and nothing more is to come: it holds, as far as is known.

        An arm that was stopped before it was measured has had no command.
        """
        held = (GuardMode.HOLDING, GuardMode.UNCONFIRMED)
        return self.mode in held or (self.stopped and self.mode == GuardMode.WAITING)

    @property
    def failed(self) -> bool:
        """Whether something was wrong, be it while the arm was at work or after it was stopped.

        A robot that falls silent only after the work was done does no harm any more.
        """
        harmless = (StopKind.USER, StopKind.DONE, StopKind.SILENCE)
        return self.kinds[:1] == (StopKind.SILENCE,) or any(
            kind not in harmless for kind in self.kinds
        )

    def stop_for(self, fault: Fault, time: float) -> "GuardStatus":
        """Notes a fault: the first one stops the arm, those after it are added to the reason.

        An arm that was not measured yet cannot be stopped: the mode stays `WAITING`.
        """
        if not self.stopped:
            waits = self.mode == GuardMode.WAITING
            mode = GuardMode.WAITING if waits else GuardMode.STOPPING
            return GuardStatus(mode, fault.reason, time, (fault.kind,))
        then = "while it was held" if self.ended else "while it was stopped"
        reason = f"{self.reason}; then, {then}, {fault.reason}"
        return replace(self, reason=reason, kinds=(*self.kinds, fault.kind))

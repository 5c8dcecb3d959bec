"""`ArmGuard`: what stands last between all that commands an arm and the arm.

It lets positions through no faster than the joints may move, and where something is wrong it stops
the arm smoothly and holds it there, until a new Context begins.

`CommandRamp`: what stands on the robot's side of the commands. Where they stop coming, because
whoever sends them has stalled or died, it brings the arm to rest smoothly; where they come again,
it follows them again.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.systems.object_controller import AbstractStateSystem

MAX_OBJECT_SPEED = 0.5
"""m/s and rad/s, by which an object may have moved on while it was not seen."""

PUSHER_STATE_SIZE = 6

ROUNDING = 1e-9
"""s, of times that are compared."""

STOPPED_BY_USER, WORK_DONE = "stopped by the user", "the work is done"

BY_USER, DONE, BY_SILENCE = 1.0, 2.0, 3.0
"""What a guard is told to stop for."""


@dataclass(frozen=True, eq=False)
class GuardLimits:
    """What an `ArmGuard` allows an arm of n joints.

    Attributes:
        speed: (n,) of the commands, rad/s.
        acceleration: (n,) of the commands, rad/s².
        torque: (n,) greatest external torque, N m.
        force: greatest on the finger's tip, N.
        status_age: greatest age of what the robot says of itself, s.
        pose_jump: farthest that the object may be seen to move at once, m.
        pose_turn: likewise, rad.
    """

    speed: Array
    acceleration: Array
    torque: Array
    force: float = 30.0
    status_age: float = 0.05
    pose_jump: float = 0.03
    pose_turn: float = 0.3


class GuardMode(StrEnum):
    """What a guard does."""

    WAITING = "waiting"
    FOLLOWING = "following"
    STOPPING = "stopping"
    HOLDING = "holding"


@dataclass(frozen=True)
class GuardStatus:
    """What a guard says of itself.

    Attributes:
        mode: what it does.
        reason: why it stopped the arm; empty where it did not.
        since: when it noticed that, s; NaN where it did not.
    """

    mode: GuardMode = GuardMode.WAITING
    reason: str = ""
    since: float = float("nan")

    @property
    def by_user(self) -> bool:
        """Whether the arm was stopped because `stop` said so."""
        return self.reason == STOPPED_BY_USER

    @property
    def stopped(self) -> bool:
        """Whether the arm was stopped, or is just being."""
        return bool(self.reason)


@dataclass(frozen=True, eq=False)
class GuardState(Unchanging):
    """All that a guard remembers.

    Attributes:
        status: as on the port.
        position: (n,) commanded, rad; None before anything was measured.
        velocity: (n,) of that, rad/s.
        desired: (n,) wanted at the last update, rad.
        retreat: (n,) where to hold after a collision, rad; None to hold where the arm comes to
            rest.
        time_measured: of the robot's last status, by its clock, s.
        fresh: when that came, s.
        pose: (3,) where the object was last seen, m and rad.
        seen: when, s.
    """

    status: GuardStatus = GuardStatus()
    position: Array | None = None
    velocity: Array | None = None
    desired: Array | None = None
    retreat: Array | None = None
    time_measured: float = float("nan")
    fresh: float = 0.0
    pose: Array | None = None
    seen: float = 0.0


class ArmGuard(AbstractStateSystem[GuardState]):
    """Passes the positions for an arm's n joints on, within limits, and stops the arm where something is wrong.

    .. pydrake_system::

        name: ArmGuard
        input_ports:
        - position_desired
        - position_measured
        - torque_external
        - force
        - time_measured
        - pusher_state
        - object_pose
        - stop
        output_ports:
        - position
        - status

    * position_desired: vector of n, where the joints should be, rad.
    * position_measured: vector of n, where they are, rad.
    * torque_external: vector of n, on the joints from outside, N m.
    * force: vector of 3, on the finger's tip, N.
    * time_measured: vector of 1, of the robot's status by the robot's clock, s; it changes with
      every status.
    * pusher_state: vector of 6, the tip's center p_WP in m and its velocity v_WP in m/s, in W, as
      measured.
    * object_pose: vector of 3, observed (x, y, theta) of B in W, m and rad; NaN while the object is
      not seen.
    * stop: vector of 1; anything but 0 stops the arm: `BY_USER`; `BY_SILENCE`, where whoever moves
      the time on, and sends the commands, has done neither for `status_age`, as the robot was not
      heard of; else the work is done.
    * position: vector of n, for the robot, rad; it begins where the joints were first measured. NaN
      before.
    * status: abstract `GuardStatus`.

    The arm is stopped where the status is as old as `GuardLimits.status_age`, a torque from outside
    or the force on the tip is beyond its limit, the pose of the object jumps, the tip leaves where
    it may be, a number is not finite, or `stop` says so. A stop is a straight line in the joints'
    space, as short as the accelerations allow; after a collision the arm goes back to where it was
    when that was noticed, so that it does not press. Where the robot's clock went on by more than
    `status_age` between two updates, it was the commands that paused: the arm rests, and they begin
    at rest again.

    Abstract state: one `GuardState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        limits: GuardLimits,
        validator: Callable[[Array], str | None] | None = None,
        period: float = 0.005,
    ) -> None:
        """Declares the system.

        Args:
            limits: what it allows; their sizes say how many joints there are.
            validator: of the tip's place p_WP (3,), m: None where it may be there, else a sentence;
                None allows all.
            period: of the commands, s.
        """
        super().__init__(GuardState(), period)
        self.limits, self._validator, self._period = limits, validator, period
        n = len(limits.speed)
        self._desired = self.DeclareVectorInputPort("position_desired", n)
        self._measured = self.DeclareVectorInputPort("position_measured", n)
        self._torque = self.DeclareVectorInputPort("torque_external", n)
        self._force = self.DeclareVectorInputPort("force", 3)
        self._time_measured = self.DeclareVectorInputPort("time_measured", 1)
        self._pusher = self.DeclareVectorInputPort("pusher_state", PUSHER_STATE_SIZE)
        self._pose = self.DeclareVectorInputPort("object_pose", 3)
        self._stop = self.DeclareVectorInputPort("stop", 1)
        self._declare_vector(
            "position", n, lambda now: np.full(n, np.nan) if now.position is None else now.position
        )
        self._declare_value("status", lambda now: now.status)

    def _go_on(self, context: Context, now: GuardState) -> GuardState:
        """Looks whether all is well, and makes the next command."""
        time = context.get_time()
        now = self._look(context, now, time)
        measured, desired = (
            np.array(port.Eval(context)) for port in (self._measured, self._desired)
        )
        if now.position is None or now.velocity is None:
            if not (np.isfinite(measured).all() and np.isfinite(desired).all()):
                return now
            following = GuardStatus(GuardMode.FOLLOWING)
            return replace(
                now,
                status=following,
                position=measured,
                velocity=np.zeros_like(measured),
                desired=desired,
            )
        if not now.status.stopped:
            fault, collided = self._find_fault(context, now, time)
            if fault is not None:
                still = self._stop.Eval(context)[0] == BY_SILENCE  # no command went out meanwhile
                velocity = np.zeros_like(now.velocity) if still else now.velocity
                now = replace(
                    now, status=fault, velocity=velocity, retreat=measured if collided else None
                )
        pose = np.array(self._pose.Eval(context))
        if np.isfinite(pose).all():
            now = replace(now, pose=pose, seen=time)
        return self._stop_on(now) if now.status.stopped else self._follow(now, desired)

    def _look(self, context: Context, now: GuardState, time: float) -> GuardState:
        """Notes the robot's time."""
        measured = float(self._time_measured.Eval(context)[0])
        if measured == now.time_measured:
            return now
        paused = (
            measured - now.time_measured > self.limits.status_age + ROUNDING
            and now.velocity is not None
        )
        velocity = np.zeros_like(now.velocity) if paused else now.velocity
        return replace(now, time_measured=measured, fresh=time, velocity=velocity)

    def _follow(self, now: GuardState, desired: Array) -> GuardState:
        assert now.position is not None and now.velocity is not None and now.desired is not None
        position, velocity = follow(
            now.position,
            now.velocity,
            now.desired,
            desired,
            self.limits.speed,
            self.limits.acceleration,
            self._period,
        )
        return replace(now, position=position, velocity=velocity, desired=desired)

    def _brake(self, now: GuardState) -> GuardState:
        assert now.position is not None and now.velocity is not None
        velocity = brake(now.velocity, self.limits.acceleration, self._period)
        return replace(now, position=now.position + self._period * velocity, velocity=velocity)

    def _stop_on(self, now: GuardState) -> GuardState:
        assert now.velocity is not None
        if now.status.mode == GuardMode.HOLDING:
            return now
        now = (
            self._brake(now)
            if now.retreat is None
            else self._follow(replace(now, desired=now.retreat), now.retreat)
        )
        at_rest = now.velocity is not None and not now.velocity.any()
        return replace(now, status=replace(now.status, mode=GuardMode.HOLDING)) if at_rest else now

    def _find_fault(
        self, context: Context, now: GuardState, time: float
    ) -> tuple[GuardStatus | None, bool]:
        """What is wrong, None for nothing; and whether the arm has run into something."""
        limits, torque = self.limits, np.abs(self._torque.Eval(context))
        stop, age, force = (
            self._stop.Eval(context)[0],
            time - now.fresh,
            np.linalg.norm(self._force.Eval(context)),
        )
        noticed = GuardStatus(
            GuardMode.STOPPING, STOPPED_BY_USER if stop == BY_USER else WORK_DONE, time
        )
        if stop == BY_SILENCE or (not stop and age > limits.status_age - ROUNDING):
            text = f"the robot has sent no status for {1e3 * max(age, limits.status_age):.0f} ms"
            reason = f"{text}; {1e3 * limits.status_age:.0f} ms are allowed"
            return replace(noticed, reason=reason), False
        if stop:
            return noticed, False
        for port in (self._measured, self._torque, self._force, self._desired):
            if not np.isfinite(port.Eval(context)).all():
                return replace(
                    noticed, reason=f"{port.get_name()} has numbers that are not finite"
                ), False
        if (torque > limits.torque).any():
            k = int((torque / limits.torque).argmax())
            allowed = f"{limits.torque[k]:.1f} N m are allowed"
            reason = f"the external torque on joint {k + 1} is {torque[k]:.1f} N m; {allowed}"
            return replace(noticed, reason=reason), True
        if force > limits.force:
            reason = (
                f"the force on the finger's tip is {force:.1f} N; {limits.force:.1f} N are allowed"
            )
            return replace(noticed, reason=reason), True
        breach = self._validator and self._validator(np.array(self._pusher.Eval(context)[:3]))
        breach = breach or self._find_jump(context, now, time)
        return (replace(noticed, reason=breach) if breach else None), False

    def _find_jump(self, context: Context, now: GuardState, time: float) -> str | None:
        """How far the object was seen to jump; None where it did not."""
        pose = self._pose.Eval(context)
        if now.pose is None or not np.isfinite(pose).all():
            return None
        moved = MAX_OBJECT_SPEED * (time - now.seen)
        jump, turn = (
            float(np.linalg.norm(pose[:2] - now.pose[:2])),
            abs(float(wrap_angle(pose[2] - now.pose[2]))),
        )
        if jump > self.limits.pose_jump + moved or turn > self.limits.pose_turn + moved:
            return f"the object was seen to jump by {1e3 * jump:.0f} mm and {turn:.2f} rad"
        return None


@dataclass(frozen=True, eq=False)
class RampState(Unchanging):
    """All that a `CommandRamp` remembers.

    Attributes:
        status: as on the port.
        position: (n,) for the joints, rad; None before the first update.
        velocity: (n,) of that, rad/s.
        target: (n,) of the last command, rad.
        sent: that command's time, s, by its sender's clock.
        came: when it was taken, s.
    """

    status: GuardStatus = GuardStatus()
    position: Array | None = None
    velocity: Array | None = None
    target: Array | None = None
    sent: float = float("nan")
    came: float = 0.0


class CommandRamp(AbstractStateSystem[RampState]):
    """Passes commands for an arm's n joints on, and brings the arm to rest where none come.

    .. pydrake_system::

        name: CommandRamp
        input_ports:
        - position_desired
        - time_sent
        output_ports:
        - position
        - status

    * position_desired: vector of n, of the last command, rad; before the first one, where the arm
      is.
    * time_sent: vector of 1, of the last command by its sender's clock, s; it changes with every
      command.
    * position: vector of n, for the joints' servos, rad.
    * status: abstract `GuardStatus`.

    A command counts as long as it is no older than `max_age`; until then the arm goes on as it
    went. Then it brakes. A command that was sent before the last one and comes within that time was
    overtaken, and is left out; so is one that is not finite. Whatever comes, speeds and
    accelerations are kept.

    Abstract state: one `RampState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self, speed: Array, acceleration: Array, max_age: float, period: float = 0.005
    ) -> None:
        """Declares the system.

        Args:
            speed: (n,) greatest of the joints, rad/s.
            acceleration: (n,) greatest, rad/s²: that of the commands, or more.
            max_age: of a command, s.
            period: of the updates, s.
        """
        super().__init__(RampState(), period)
        self._speed, self._acceleration, self._max_age, self._period = (
            speed,
            acceleration,
            max_age,
            period,
        )
        n = len(speed)
        self._desired = self.DeclareVectorInputPort("position_desired", n)
        self._sent = self.DeclareVectorInputPort("time_sent", 1)
        inputs = {self._remembered, self._desired.ticket()}
        self.DeclareVectorOutputPort("position", n, weakly(self._calc_position), inputs)
        self._declare_value("status", lambda now: now.status)

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        position = self._get_state(context).position
        output.SetFromVector(self._desired.Eval(context) if position is None else position)

    def _go_on(self, context: Context, now: RampState) -> RampState:
        """Takes a new command, or does without."""
        time, sent = context.get_time(), float(self._sent.Eval(context)[0])
        target = np.array(self._desired.Eval(context))
        if now.position is None or now.velocity is None or now.target is None:
            return replace(
                now,
                position=target,
                velocity=np.zeros_like(target),
                target=target,
                sent=sent,
                came=time,
            )
        age = time - now.came
        overtaken = sent < now.sent and age < self._max_age - ROUNDING
        if sent != now.sent and not overtaken and np.isfinite(target).all():
            before = target - self._period * (target - now.target) / max(age, self._period)
            position, velocity = follow(
                now.position,
                now.velocity,
                before,
                target,
                self._speed,
                self._acceleration,
                self._period,
            )
            following = GuardStatus(GuardMode.FOLLOWING)
            return RampState(following, position, velocity, target, sent, time)
        if now.status.mode in (GuardMode.WAITING, GuardMode.HOLDING):
            return now
        status, velocity = now.status, now.velocity
        if age > self._max_age - ROUNDING:
            if not status.stopped:
                reason = f"no command has come for {1e3 * age:.0f} ms; {1e3 * self._max_age:.0f} ms are allowed"
                status = GuardStatus(GuardMode.STOPPING, reason, time)
            velocity = brake(velocity, self._acceleration, self._period)
            status = status if velocity.any() else replace(status, mode=GuardMode.HOLDING)
        return replace(
            now, status=status, position=now.position + self._period * velocity, velocity=velocity
        )


def follow(
    position: ArrayLike,
    velocity: ArrayLike,
    before: ArrayLike,
    target: ArrayLike,
    speed: Array,
    acceleration: Array,
    period: float,
) -> tuple[Array, Array]:
    """One step after a target that moves, each joint by itself.

    A target that keeps the limits is met exactly; behind one that does not, the step is the longest
    after which the joint can still come to rest, seen from the target, before it overshoots. With
    the gap e, the acceleration a and the period h, the speed v from which braking in whole periods
    is just enough is

        v (v / a + h) / 2 = |e|,  hence  v = (a h / 2) (sqrt(1 + 8 |e| / (a h^2)) - 1)

    Args:
        position: (n,) rad.
        velocity: (n,) rad/s.
        before: (n,) the target at the step's beginning, rad.
        target: (n,) at its end, rad.
        speed: (n,) greatest, rad/s.
        acceleration: (n,) greatest, rad/s².
        period: s.

    Returns:
        Position (n,), rad, and velocity (n,), rad/s, after the step.
    """
    q, v, start, end = (np.asarray(value, float) for value in (position, velocity, before, target))
    gap, unit = start - q, acceleration * period
    braking = unit / 2 * (np.sqrt(1 + 8 * np.abs(gap) / (unit * period)) - 1)
    wanted = (end - start) / period + np.sign(gap) * np.minimum(np.abs(gap) / period, braking)
    v = np.clip(np.clip(wanted, -speed, speed), v - unit, v + unit)
    return q + period * v, v


def brake(velocity: Array, acceleration: Array, period: float) -> Array:
    """Velocity (n,), rad/s, one step later of joints that all come to rest together, as soon as they can."""
    left = float(np.max(np.abs(velocity) / acceleration))
    return velocity * (1 - period / left) if left > period else np.zeros_like(velocity)

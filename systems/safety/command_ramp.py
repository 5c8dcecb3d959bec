"""`CommandRamp`: what stands on the robot's side of the commands.

Where they stop coming, because whoever sends them has stalled or died, it brings the arm to rest
smoothly; where they come again, it follows them again. What stands on the sender's side is
`ArmGuard`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.robot_records import ArmCommand
from gridpush_drake.systems.safety.arm_path import brake, follow
from gridpush_drake.systems.safety.guard_status import GuardMode, GuardStatus

TIME_ROUNDING = 1e-9
"""s, of times that are compared."""


@dataclass(frozen=True, eq=False)
class RampState(Unchanging):
    """All that a `CommandRamp` remembers.

    Attributes:
        status: what the ramp does, as it is on the port `status`.
        position: (n,) positions for the joints' servos, rad; None before the first update.
        velocity: (n,) how fast these positions move, rad/s.
        target: (n,) positions in the last command, rad.
        sent: when the last command was sent, s, by its sender's clock; 0 before the first one.
        came: when the last command was taken up, s, by this system's clock.
    """

    status: GuardStatus = field(default_factory=GuardStatus)
    position: Array | None = None
    velocity: Array | None = None
    target: Array | None = None
    sent: float = 0.0
    came: float = 0.0


class CommandRamp(AbstractStateSystem[RampState]):
    """Passes commands for an arm's n joints on, and brings the arm to rest where none come.

    .. pydrake_system::

        name: CommandRamp
        input_ports:
        - command
        - position_measured
        output_ports:
        - position
        - status

    * command: abstract `ArmCommand`, the last one, whose time changes with every command. It need
      not be connected: then there is none yet.
    * position_measured: vector of n, where the joints are, rad. Before the first command they stay
      there.
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
            speed: (n,) greatest speed of each joint, rad/s.
            acceleration: (n,) greatest acceleration of each joint, rad/s²: that which the commands
                keep, or more.
            max_age: greatest age of the last command, s, beyond which the arm is brought to rest.
            period: between two updates, s.
        """
        super().__init__(RampState(), period)
        self._speed = speed
        self._acceleration = acceleration
        self._max_age = max_age
        self._period = period
        n = len(speed)
        nothing = ArmCommand(float("nan"), np.full(n, np.nan))
        self._command = self.DeclareAbstractInputPort("command", AbstractValue.Make(nothing))
        self._measured = self.DeclareVectorInputPort("position_measured", n)
        inputs = {self._remembered, self._command.ticket(), self._measured.ticket()}
        self.DeclareVectorOutputPort("position", n, weakly(self._calc_position), inputs)
        self._declare_value("status", lambda now: now.status)

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        position = self._get_state(context).position
        if position is None:
            position = self._get_command(context)[1]
        output.SetFromVector(position)

    def _get_command(self, context: Context) -> tuple[float, Array]:
        """Returns when the last command was sent, s, and its positions (n,), rad.

        Before the first one they are 0, and where the arm is.
        """
        if self._command.HasValue(context):
            command: ArmCommand = self._command.Eval(context)
            return command.time, np.array(command.position, dtype=np.float64).ravel()
        return 0.0, np.array(self._measured.Eval(context))

    def _go_on(self, context: Context, now: RampState) -> RampState:
        """Takes a new command, or does without."""
        time = context.get_time()
        sent, target = self._get_command(context)
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
        overtaken = sent < now.sent and age < self._max_age - TIME_ROUNDING
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
            return RampState(
                status=following,
                position=position,
                velocity=velocity,
                target=target,
                sent=sent,
                came=time,
            )
        if now.status.mode in (GuardMode.WAITING, GuardMode.HOLDING):
            return now
        status = now.status
        velocity = now.velocity
        if age > self._max_age - TIME_ROUNDING:
            if not status.stopped:
                allowed = f"{1e3 * self._max_age:.0f} ms are allowed"
                reason = f"no command has come for {1e3 * age:.0f} ms; {allowed}"
                status = GuardStatus(GuardMode.STOPPING, reason, time)
            velocity = brake(velocity, self._acceleration, self._period)
            status = status if velocity.any() else replace(status, mode=GuardMode.HOLDING)
        return replace(
            now, status=status, position=now.position + self._period * velocity, velocity=velocity
        )

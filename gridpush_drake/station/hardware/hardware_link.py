"""`HardwareLink`: connects a `HardwareStation` with its robot, and moves the station's time on.

The station's time is the robot's. With every status it goes on by the time between this status and
the one before, as in `drake-iiwa-driver` and Drake's own controllers. While no status comes, the
station's time stands still and no command goes out; the robot's driver then brings the arm to rest.

* If it turns out that the robot's clock went on meanwhile by more than a status may be old, or if
  nothing comes for long, the guard is told, and the arm is stopped for good.
* If the robot's clock stood still, too, as a twin's does on a busy computer, nothing is wrong.
* If the controller itself was late by more than a period, its time has stood still for that long.
  It goes on from there: the motion is delayed, and never made up for by hurrying.

Records in both directions pass through here. What comes in passes a `Channel`: a record that cannot
be used is left out and counted, so that the station's systems never see one. If the robot's clock
jumps, the arm is stopped for good, as if the robot were silent. Whatever fails in the loop,
`finish` brings the arm to rest: by the guard if that still works, else by itself from the last
commands. Until `armed`, no command goes out. A `LinkReport` says how a run went.
"""

import traceback
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from time import monotonic
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from gridpush_drake.errors import StationError
from gridpush_drake.station.hardware.hardware_station import HardwareStation
from gridpush_drake.station.hardware.link_report import NOTED, LinkReport
from gridpush_drake.station.links.channel import ArrivalClock, Channel, count_reason
from gridpush_drake.station.links.link import (
    ARM_PERIOD,
    GRIPPER_PERIOD,
    MILLISECONDS,
    Link,
    LinkMessage,
    Unusable,
)
from gridpush_drake.station.links.record_forms import find_other_robot
from gridpush_drake.station.robot.robot import Robot
from gridpush_drake.station.schema.scenario import SafetyConfig
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperStatus,
    PoseObservation,
)
from gridpush_drake.systems.safety.arm_path import brake
from gridpush_drake.systems.safety.guard_status import (
    BY_SILENCE,
    BY_USER,
    RETREAT_DONE,
    GuardMode,
    GuardStatus,
    StopKind,
)

PATIENCE = 5.0
"""Longest time that the first status, and the first pose of the object, are waited for, s."""

LISTENING_TIME = 0.3
"""Time during which statuses come before the first command goes out, s. A driver that has just
started takes an earlier command for one that was meant for another driver, and ends."""

LARGEST_CATCH_UP = ARM_PERIOD
"""Longest time by which the station's time may leap to keep up with the robot's, s. If it is
further behind, it stays behind."""

MAX_POLL_TIME = 0.005
"""Longest time that one poll for records should take, s. If a poll takes longer, our own
process was suspended, and the time beyond does not count as the robot's silence."""

SILENCE = 1.0
"""If no status of the robot comes for this long, the arm is stopped for good, s."""

STOPPING_TIME = 2.0
"""Time within which any arm has braked, and was measured at rest or not, s; beside the time for
which it goes back after a collision."""

BY_LATENESS = (StopKind.SILENCE, StopKind.JOINT_SPEED, StopKind.FOLLOWING, StopKind.OBJECT)
"""Kinds of stops that a slow computer can cause."""

ROUNDING = 1e-9
"""Times that differ by less than this are the same, s."""

LISTENING_PERIOD = 0.001
"""Longest time that one poll waits for records, s."""

HALF = 0.5
"""Fraction of a period after each status at which the station's time is, see `_receive`."""


class HardwareLink:
    """Passes records between a station and its robot, and moves the station's time on.

    It is the `Drive` of a task with a real robot.

    Attributes:
        report: an account of how the loop went.
        armed: whether commands go out.
    """

    def __init__(
        self,
        link: Link,
        arm: Robot,
        *,
        others: Sequence[str] = (),
        realtime_rate: float = 1.0,
        clock_jump: float = SafetyConfig().clock_jump,
        robot: Callable[[], object] | None = None,
        clock: Callable[[], float] | None = None,
    ) -> None:
        """Has heard nothing yet.

        Args:
            link: what the robot is linked by.
            arm: the robot, which says how many joints there are, and whether there is a gripper.
            others: what the user calls the other objects on the table, whose poses come, too, such
                as "others[0]".
            realtime_rate: number of the robot's seconds in a second; other than 1 for a twin that
                is slower.
            clock_jump: a record that is further ahead of its sender's clock than this is left out,
                s.
            robot: moves a twin in the same process on by `ARM_PERIOD`. None for a robot that moves
                by itself.
            clock: returns the time by which records arrive, in the robot's seconds; None for the
                computer's clock times `realtime_rate`. A twin in the same process needs a clock
                that goes on by `ARM_PERIOD` whenever the twin is moved.
        """
        self.report = LinkReport()
        self.armed = False
        self._link = link
        self._rate = realtime_rate
        self._robot = robot
        self._clock = clock or self._read_clock
        self._clock_jump = clock_jump
        self._joints = len(arm.arm.posture)
        self._arm = self._make_channel(ArmStatus)
        # The times in observations of objects are by the robot's clock.
        self._objects = tuple(
            self._make_channel(PoseObservation, number, self._arm.clock)
            for number in range(len(others) + 1)
        )
        self._others = tuple(others)
        self._channels: dict[tuple[type | None, int], Channel] = {(ArmStatus, 0): self._arm}
        for number, channel in enumerate(self._objects):
            self._channels[PoseObservation, number] = channel
        if arm.gripper is not None:
            self._channels[GripperStatus, 0] = self._make_channel(GripperStatus)
        # Channels with a record that the station has not had yet, in their order.
        self._not_passed: dict[Channel, None] = {}
        self._sent: deque[ArmCommand] = deque(maxlen=2)  # the arm's last commands
        self._station: HardwareStation | None = None
        # What is on the station's port `stop`, and whether the robot is taken for silent.
        self._stop = 0.0
        self._silent = False
        # When a command last went out, and when records were last listened to, by the computer's
        # clock, s.
        self._stepped = 0.0
        self._listened = 0.0
        # The station's time at the last step; the time since the robot's last status; and the
        # robot's time when the station's was 0; all in s.
        self._command_time = 0.0
        self._waited = 0.0
        self._base = 0.0
        # Number of the gripper's periods at its last command.
        self._gripper_commands = -1
        # The guard's last status.
        self._said = GuardStatus()

    def wait(self, patience: float = PATIENCE) -> None:
        """Waits until records of robot and object have come for long enough, without clock jumps.

        Args:
            patience: longest time to wait, s.

        Raises:
            StationError: they have not come within this time, or are of another robot. The error
                says what came, and why it could not be used.
        """
        begin = monotonic()
        first = begin
        changes = self._count_clock_changes()
        while True:
            self._listen()
            now = monotonic()
            refused = self._arm.refused
            another = refused and find_other_robot(refused, self._arm.name, self._joints)
            if another:
                raise StationError(another)
            silent = [channel for channel in self._channels.values() if channel.record is None]
            if silent or self._count_clock_changes() != changes:
                first = now
                changes = self._count_clock_changes()
            if self._robot is not None and not silent:
                return
            if now - first > LISTENING_TIME / self._rate:
                return
            if now - begin > patience / self._rate:
                break
        if not silent:
            raise StationError(
                f"within {patience:g} s the clocks of robot, gripper and tracker jumped "
                f"{changes} times; expected one sender on each channel"
            )
        who = "nobody says how the gripper is"
        if silent[0] is self._arm:
            who = "the robot sends no status"
        elif silent[0] is self._objects[0]:
            who = "nobody says where the object is"
        elif silent[0] in self._objects:
            who = f"nobody says where {self._others[self._objects.index(silent[0]) - 1]} is"
        unusable = silent[0].describe_unusable()
        raise StationError(
            f"{who} on {silent[0].name} within {patience:g} s{unusable and f' ({unusable})'}; "
            f"expected a driver, or gridpush twin, {self._link.place}"
        )

    @property
    def status_age(self) -> float:
        """Age of the robot's last status, in its own time, s."""
        return self._clock() - self._arm.came

    def request_stop(self) -> None:
        """Stops the arm as soon as possible; a signal's handler may call it."""
        self._stop = BY_USER

    def begin(self, diagram: Diagram, station: Any, context: Context) -> None:
        """Writes the robot's status into a fresh Context of the station's Diagram; see `Drive`."""
        self._station = station
        self._stop = 0.0
        self._said = GuardStatus()
        self._silent = False
        self.report.causes.clear()
        self._sent.clear()
        self._gripper_commands = -1
        self._listen()
        heard = [channel for channel in self._channels.values() if channel.record is not None]
        self._not_passed = dict.fromkeys(heard)
        self._pass_in(context)
        self._base = self._arm.time
        self._stepped = self._listened = monotonic()
        self._waited = 0.0

    def advance(self, simulator: Simulator, time: float) -> None:
        """Goes on to a time of the station's, s, with the robot; see `Drive`."""
        while simulator.get_context().get_time() < time - ROUNDING:
            self._step(simulator)

    def fail(self, error: BaseException) -> None:
        """Notes that the loop has failed; `finish` still brings the arm to rest. See `Drive`."""
        text = " ".join(str(error).split()) or "without a message"
        cause = f"The controller failed: {type(error).__name__}: {text}"
        if cause not in self.report.causes:
            self.report.causes.append(cause)
            self.report.traces.append("".join(traceback.format_exception(error)))
            self.note(cause)
        self._stop = self._stop or RETREAT_DONE

    def finish(self, simulator: Simulator) -> None:
        """Brings the arm to rest and holds it; from then on no command goes out. See `Drive`.

        If the station or its guard fails, too, the arm is brought to rest from its last commands.
        """
        self._stop = self._stop or RETREAT_DONE
        try:
            self._finish_by_guard(simulator)
        except (Exception, SystemExit) as error:
            self.fail(error)
            self._finish_alone()
        finally:
            self.armed = False

    def explain(self) -> str:
        """Says in sentences what went wrong beside what the guard says; see `Drive`."""
        sentences = [f"{cause.rstrip('.')}." for cause in self.report.causes]
        # A twin in the same process moves only when it is told to: it cannot be late.
        if self._robot is None and self._said.kinds[:1] and self._said.kinds[0] in BY_LATENESS:
            sentences.append(self.report.describe_slowness())
        return " ".join(filter(None, sentences))

    def note(self, text: str) -> None:
        """Adds to the log, at the station's time."""
        self.report.events.append((self._command_time, text))

    def _leave_out(self, why: str) -> None:
        """Counts what came and cannot be used, by why."""
        if count_reason(self.report.left_out, why):
            self.note(f"left out: {why}")

    def _finish_by_guard(self, simulator: Simulator) -> None:
        """Goes on until the guard holds the arm, which may first go back from a collision."""
        begin = simulator.get_context().get_time()
        while self._said.mode == GuardMode.STOPPING or not self._said.stopped:
            # Until the arm has braked nobody knows how long its way back is.
            latest = np.nanmax([begin, self._said.back_at]) + STOPPING_TIME
            late = simulator.get_context().get_time() > latest
            if late or self._said.mode == GuardMode.WAITING:
                break
            self._step(simulator)

    def _finish_alone(self) -> None:
        """Brings the arm to rest from its last two commands, without the station.

        One command goes out for every status. If none comes, no command goes out: then the robot's
        driver brings the arm to rest.
        """
        if not self.armed or self._silent or len(self._sent) < 2 or self._station is None:
            return
        safety = self._station.scenario.safety
        before, last = self._sent
        position = np.asarray(last.position)
        velocity = (position - before.position) / ARM_PERIOD
        acceleration = np.full_like(velocity, safety.acceleration)
        try:
            while velocity.any():
                if not self._wait_for_status(safety.status_age):
                    self.note("the arm was left to its driver: no status came while it was braked")
                    return
                velocity = brake(velocity, acceleration, ARM_PERIOD)
                position = position + ARM_PERIOD * velocity
                last = replace(last, time=last.time + ARM_PERIOD, position=position)
                self._link.send(last)
            self.note("the arm was brought to rest from its last commands, without the guard")
        except (Exception, SystemExit) as error:
            self.fail(error)

    def _wait_for_status(self, patience: float) -> bool:
        """Waits for another status of the arm; returns whether one came within a time, s."""
        count = self._arm.count
        begin = self._clock()
        while self._arm.count == count:
            if self._clock() - begin > patience:
                return False
            if self._robot is not None:
                self._robot()
            self._listen()
        return True

    def _step(self, simulator: Simulator) -> None:
        """Takes one status in, or none if it is overdue, and sends one command out."""
        assert self._station is not None
        context = simulator.get_mutable_context()
        now = context.get_time()
        target = self._receive(context)
        self._pass_in(context)
        if self._stop:
            self._station.RequestStop(context, self._stop)
        if target > now + ROUNDING:
            simulator.AdvanceTo(target)
        self._command_time = context.get_time()
        self._pass_out(context)
        own = self._station.GetMyContextFromRoot(context)
        status: GuardStatus = self._station.GetOutputPort("guard.status").Eval(own)
        force = float(np.linalg.norm(self._station.GetOutputPort("pusher.force").Eval(own)))
        self.report.force = max(self.report.force, force)
        if (status.mode, status.reason) != (self._said.mode, self._said.reason):
            self.note(f"guard {status.mode}{status.reason and f': {status.reason}'}")
        self._said = status

    def _receive(self, context: Context) -> float:
        """Waits for the next status, or takes the robot for silent.

        Returns:
            The time to which the station goes on, s.
        """
        assert self._station is not None
        now = context.get_time()
        before = self._arm.time
        count = self._arm.count
        clock_changes = self._arm.clock_changes
        greatest_age = self._station.scenario.safety.status_age
        last = self._listened
        self._listened = monotonic()
        # How long our process did not listen, because it worked or was suspended, s.
        inattentive = self._listened - last
        while True:
            if self._robot is not None:
                self._robot()
            self._listen()
            last = self._listened
            self._listened = monotonic()
            inattentive += max(self._listened - last - MAX_POLL_TIME, 0.0)
            if self._arm.count > count:
                break
            self._waited = self.status_age if self._robot is None else self._waited + ARM_PERIOD
            if self._waited > (greatest_age if self._stop else SILENCE) - ROUNDING:
                self._give_up(context)
                self._wait_period()
                return now + ARM_PERIOD
        jumped = self._arm.clock_changes != clock_changes
        if jumped:
            self._note_clock_jump(context)
        elif self._waited > greatest_age:
            went_on = self._arm.time - before
            if self._robot is None:
                # Of all records that came while our process did not listen only the last is kept.
                went_on -= inattentive * self._rate
            self._note_silence(context, went_on > greatest_age + ROUNDING)
        self._waited = 0.0
        # The station's time goes on in whole periods, and is half a period past a status, so that a
        # status that is a little early or late brings exactly one command.
        periods = round((self._arm.time - self._base) / ARM_PERIOD)
        target = (periods + HALF) * ARM_PERIOD
        late = target - now - ARM_PERIOD
        if abs(late) < LARGEST_CATCH_UP + ROUNDING:
            return target
        if late > greatest_age and not jumped:
            self.report.pauses += 1
            if self.report.pauses <= NOTED:
                self.note(
                    f"the controller was late by {MILLISECONDS * late:.0f} ms; "
                    "it went on from where it was"
                )
        self._base += late
        return now + ARM_PERIOD

    def _give_up(self, context: Context, jumped: bool = False) -> None:
        """Stops the arm over a robot that is not heard of, or whose clock has jumped.

        Its driver has brought it to rest, and from now on no command moves it.
        """
        assert self._station is not None
        self._station.RequestStop(context, BY_SILENCE)
        if self._silent:
            return
        self._silent = True
        if not jumped:
            # the guard cannot say this: its time goes on only with the robot's
            silence = (
                f"No usable status of the robot came for {self._waited:.2f} s; no command went out "
                "meanwhile, and none will: the robot's driver brings the arm to rest"
            )
            if self._stop:  # the work was over anyway
                self.note(silence)
            else:
                self._note_cause(silence)
        unusable = self._arm.describe_unusable()
        if unusable:
            self._note_cause(f"Since the last usable status {unusable}")

    def _note_clock_jump(self, context: Context) -> None:
        """Stops the arm because the robot's clock has jumped.

        No command went out while this was found out.
        """
        if not self._silent:
            self._note_cause(f"The robot's clock jumped by {self._arm.jump:.3f} s")
        self._give_up(context, jumped=True)

    def _note_cause(self, cause: str) -> None:
        self.report.causes.append(cause)
        self.note(cause)

    def _note_silence(self, context: Context, went_on: bool) -> None:
        """Takes a long silence in: where the robot went on meanwhile, the arm is stopped."""
        assert self._station is not None
        self._stepped = monotonic()  # it was not the controller that was late
        if went_on:
            self._give_up(context)
            return
        self.report.silences += 1
        if self.report.silences <= NOTED:
            self.note(
                f"the robot stood still for {MILLISECONDS * self._waited:.0f} ms, "
                "by its own clock, too; it was waited for"
            )

    def _wait_period(self) -> None:
        """Lets a period pass since the last step, by the clock."""
        if self._robot is None:
            left = self._stepped + ARM_PERIOD / self._rate - monotonic()
            if left > 0:
                self._listen(left)

    def _listen(self, timeout: float = LISTENING_PERIOD) -> None:
        """Takes in what comes within a time, s; a twin in the same process is not waited for."""
        for message in self._link.receive(0.0 if self._robot is not None else timeout):
            self._take(message)

    def _take(self, message: LinkMessage) -> None:
        """Gives what came to its channel; what nobody here reads is left alone."""
        kind = message.kind if isinstance(message, Unusable) else type(message)
        channel = self._channels.get((kind, getattr(message, "number", 0)))
        if isinstance(message, Unusable):
            leave_out = self._leave_out if channel is None else channel.leave_out
            leave_out(message.why)
        elif channel is not None and channel.take(message):
            self._not_passed[channel] = None

    def _pass_in(self, context: Context) -> None:
        """Gives the station the newest record of each channel that it has not had yet."""
        assert self._station is not None
        for channel in self._not_passed:
            self._station.TakeRecord(context, channel.record)
        self._not_passed.clear()

    def _pass_out(self, context: Context) -> None:
        """Sends the station's commands, if commands go out."""
        assert self._station is not None
        arm = self._station.GetArmCommand(context)
        is_finite = bool(np.isfinite(arm.position).all())
        if is_finite:
            now = monotonic()
            self.report.note_period((now - self._stepped) * self._rate)
            self._stepped = now
        gripper = None
        count = int(arm.time / GRIPPER_PERIOD)
        if count != self._gripper_commands:
            self._gripper_commands = count
            gripper = self._station.GetGripperCommand(context)
        if not self.armed or self._silent:
            return
        if gripper is not None:
            self._link.send(gripper)
        if is_finite:
            self._link.send(arm)
            self._sent.append(arm)

    def _read_clock(self) -> float:
        """The computer's clock, in the robot's seconds."""
        return monotonic() * self._rate

    def _count_clock_changes(self) -> int:
        return sum(channel.clock_changes for channel in self._channels.values())

    def _make_channel(
        self, kind: type, number: int = 0, reference: ArrivalClock | None = None
    ) -> Channel:
        """Makes the channel of the records of a type, and of an object's number."""
        return Channel(
            self._link.get_name(kind, number),
            joints=self._joints,
            now=self._clock,
            clock_jump=self._clock_jump,
            leave_out=self._leave_out,
            reference=reference,
        )

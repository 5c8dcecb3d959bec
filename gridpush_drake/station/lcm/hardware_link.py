"""`HardwareLink`: between a `HardwareStation` and the LCM that its robot is on; it moves the station's time on.

The station's time is the robot's: with every status it goes on by what has passed between two of
them, as `drake-iiwa-driver` and Drake's own controllers have it. Where none comes it stands still,
and no command goes out: the robot's driver brings the arm to rest. Where the robot's clock turns
out to have gone on meanwhile by more than a status may be old, or nothing comes for long, the guard
is told, and the arm is stopped for good. Where the robot's clock stood still, too, a twin's on a
busy computer, nothing is amiss. Where the controller itself was late by more than a period, its
time has stood still for that long, and nothing is made up for: it becomes slower, and hurries
never.

Messages in both directions pass through here. One that cannot be read, is of another size, or is
not newer than the last one is left out and noted. Until `armed`, no command goes out.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

import numpy as np
from drake import lcmt_planar_manipuland_status, lcmt_schunk_wsg_status
from pydrake.lcm import DrakeLcm, DrakeLcmInterface
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from gridpush_drake.errors import StationError
from gridpush_drake.station.lcm.hardware_station import HardwareStation
from gridpush_drake.station.lcm.robot_messages import (
    ARM_PERIOD,
    GRIPPER_COMMAND,
    GRIPPER_STATUS,
    OBJECT_STATUS,
    decode_message,
    find_arm_messages,
)
from gridpush_drake.station.robot import Robot
from gridpush_drake.systems.arm_guard import BY_SILENCE, BY_USER, DONE, GuardMode, GuardStatus
from gridpush_drake.systems.planar_manipuland_status import MICROSECONDS

DEFAULT_URL = "udpm://239.255.76.67:7667?ttl=0"
"""Of LCM, where nobody says anything else: this computer only."""

URL = re.compile(r"udpm://(22[4-9]|23\d)\.(\d{1,3})\.(\d{1,3})\.(\d{1,3}):(\d{1,5})(\?ttl=\d+)?")

MAX_BYTE, MAX_PORT = 255, 65535

PATIENCE = 5.0
"""For the first status, and for the object to be seen, s."""

QUIET = 0.3
"""Of statuses before the first command, s: a driver that has just started takes one for somebody
else's."""

MADE_UP = ARM_PERIOD
"""By how much the station's time may leap to keep up with the robot's, s."""

LATE = 0.01
"""Between two commands, that counts as late, s."""

ATTENTIVE = 0.005
"""A look for messages takes, at most; in one that took longer the process itself was kept waiting,
s."""

SILENCE = 1.0
"""Of a robot before it is given up, s."""

NOTED = 10
"""How often the log says of a kind of lateness when it was; all are counted."""

STOPPING_TIME = 2.0
"""Within which the guard has brought any arm to rest, s."""

ROUNDING = 1e-9
"""s."""

HALF = 0.5


def open_lcm(url: str) -> DrakeLcm:
    """Opens LCM. Raises StationError where the URL is none, or there is no network for it."""
    match = URL.fullmatch(url)
    good = (
        match
        and all(int(part) <= MAX_BYTE for part in match.groups()[1:4])
        and 0 < int(match[5]) <= MAX_PORT
    )
    if not good:
        raise StationError(
            f"--lcm: {url!r}; expected udpm://ADDRESS:PORT?ttl=N such as {DEFAULT_URL}"
        )
    lcm = DrakeLcm(url)
    if not lcm.available():
        raise StationError(f"--lcm: {url}: no network takes multicast; see docs/hardware.md")
    return lcm


@dataclass
class LinkReport:
    """How the loop went.

    Attributes:
        steps: commands made.
        worst_period: longest between two, s.
        late: how many came later than `LATE`.
        pauses: how often the controller itself was late by more than a status may be old.
        silences: how often the robot itself paused for as long, and went on.
        force: greatest on the finger's tip, N.
        left_out: messages that were not taken, by why.
        events: (s, text) what happened when.
    """

    steps: int = 0
    worst_period: float = 0.0
    late: int = 0
    pauses: int = 0
    silences: int = 0
    force: float = 0.0
    left_out: dict[str, int] = field(default_factory=dict)
    events: list[tuple[float, str]] = field(default_factory=list)

    @property
    def late_share(self) -> float:
        """Of the commands, how many came late."""
        return self.late / max(self.steps, 1)

    def note_period(self, period: float) -> None:
        """Counts a command that came so long, s, after the last one."""
        self.steps += 1
        self.worst_period = max(self.worst_period, period)
        self.late += period > LATE

    def describe(self) -> str:
        """In a sentence."""
        text = (
            f"{self.steps} commands, the longest period {1e3 * self.worst_period:.1f} ms, "
            f"{100 * self.late_share:.2f} % over {1e3 * LATE:.0f} ms; at most {self.force:.1f} N on the finger's tip"
        )
        if self.pauses:
            text += f"; the controller paused {self.pauses} times"
        if self.silences:
            text += f"; the robot paused {self.silences} times"
        return text + "".join(
            f"; {count} messages left out: {why}" for why, count in self.left_out.items()
        )


@dataclass
class _Channel:
    """What came on a channel: the newest whole message, whether it was passed on, and when it was sent and came."""

    kind: Any
    data: bytes | None = None
    passed: bool = True
    utime: int = -1
    came: float = 0.0


class HardwareLink:
    """Passes messages between a station and its robot, and moves the station's time on; a `Drive` for tasks.

    Attributes:
        bus: the station's own LCM.
        report: how the loop went.
        armed: whether commands go out.
    """

    def __init__(
        self,
        lcm: DrakeLcmInterface,
        arm: Robot,
        *,
        realtime_rate: float = 1.0,
        robot: Callable[[], object] | None = None,
    ) -> None:
        """Listens from now on.

        Args:
            lcm: that the robot is on.
            arm: the robot: how many joints it has, what its driver speaks, and whether there is a
                gripper.
            realtime_rate: how many of the robot's seconds pass in one, where it is a twin that goes
                slower.
            robot: moves a twin in the same process on by `ARM_PERIOD`; no clock is looked at then.
                None for a robot that moves by itself.
        """
        self.bus, self.report, self.armed = DrakeLcm("memq://"), LinkReport(), False
        self._lcm, self._rate, self._robot, self._n = (
            lcm,
            realtime_rate,
            robot,
            len(arm.arm.posture),
        )
        self._messages = find_arm_messages(arm)
        self._arm, self._object = (
            _Channel(self._messages.status_type),
            _Channel(lcmt_planar_manipuland_status),
        )
        self._gripper = _Channel(lcmt_schunk_wsg_status)
        self._channels = {self._messages.status: self._arm, OBJECT_STATUS: self._object}
        if arm.gripper is not None:
            self._channels[GRIPPER_STATUS] = self._gripper
        for name, channel in self._channels.items():
            lcm.Subscribe(name, self._make_taker(name, channel))
        self._out: dict[str, bytes] = {}
        for name in (self._messages.command, GRIPPER_COMMAND):
            self.bus.Subscribe(name, self._make_collector(name))
        self._fault = ""
        self._station: HardwareStation | None = None
        self._stop, self._silent = 0.0, False
        self._stepped = self._told = self._waited = self._listened = (
            0.0  # waited: since the last status, s
        )
        self._base = 0.0  # the robot's time when the station's was 0, s
        self._said = GuardStatus()

    def wait(self, patience: float = PATIENCE) -> None:
        """Waits until robot and object have been heard of for long enough.

        Raises:
            StationError: they were not within the time, s, or speak of another robot.
        """
        begin = first = monotonic()
        while True:
            self._listen()
            now = monotonic()
            if self._fault:
                raise StationError(self._fault)
            silent = [name for name, channel in self._channels.items() if channel.data is None]
            if silent:
                first = now
            if self._robot is not None and not silent:
                return
            if now - first > QUIET / self._rate:
                return
            if now - begin > patience / self._rate:
                break
        arm = self._messages.status in silent
        who = "the robot sends no status" if arm else "nobody says how the gripper is"
        if silent == [OBJECT_STATUS]:
            who = "nobody says where the object is"
        channel = self._messages.status if arm else silent[0]
        raise StationError(
            f"{who} on {channel} within {patience:g} s; expected a driver, or gridpush twin, on this --lcm"
        )

    @property
    def status_age(self) -> float:
        """Of the robot's last status, in its own time, s."""
        return (monotonic() - self._arm.came) * self._rate

    def request_stop(self) -> None:
        """Stops the arm as soon as it can; a signal's handler may call it."""
        self._stop = BY_USER

    def begin(self, diagram: Diagram, station: Any, context: Context) -> None:
        """Writes the robot's status into a fresh Context of the Diagram that the station is in; see `Drive`."""
        self._station, self._stop, self._said, self._silent = station, 0.0, GuardStatus(), False
        self._listen()
        for channel in self._channels.values():
            channel.passed = channel.data is None
        self._pass_in()
        diagram.ExecuteInitializationEvents(context)
        self._base = self._arm.utime / MICROSECONDS
        self._out.clear()
        self._stepped = self._listened = monotonic()
        self._waited = 0.0

    def advance(self, simulator: Simulator, time: float) -> None:
        """Goes on to a time of the station's, s, with the robot; see `Drive`."""
        while simulator.get_context().get_time() < time - ROUNDING:
            self._step(simulator)

    def finish(self, simulator: Simulator) -> None:
        """Brings the arm to rest and holds it; from then on no command goes out. See `Drive`."""
        self._stop = self._stop or DONE
        end = simulator.get_context().get_time() + STOPPING_TIME
        while self._said.mode == GuardMode.STOPPING or not self._said.stopped:
            if simulator.get_context().get_time() > end or self._said.mode == GuardMode.WAITING:
                break
            self._step(simulator)
        self.armed = False

    def note(self, text: str) -> None:
        """Adds to the log, at the station's time."""
        self.report.events.append((self._told, text))

    def _step(self, simulator: Simulator) -> None:
        """One status in, or none where it is overdue, and one command out."""
        assert self._station is not None
        context = simulator.get_mutable_context()
        now, target = context.get_time(), self._receive(context)
        self._pass_in()
        if self._stop:
            self._station.RequestStop(context, self._stop)
        if target > now + ROUNDING:
            simulator.AdvanceTo(target)
        self._told = context.get_time()
        self._station.PublishCommand(context)
        self.bus.HandleSubscriptions(0)
        self._pass_out()
        own = self._station.GetMyContextFromRoot(context)
        status: GuardStatus = self._station.GetOutputPort("guard.status").Eval(own)
        force = float(np.linalg.norm(self._station.GetOutputPort("pusher.force").Eval(own)))
        self.report.force = max(self.report.force, force)
        if (status.mode, status.reason) != (self._said.mode, self._said.reason):
            self.note(f"guard {status.mode}{status.reason and f': {status.reason}'}")
        self._said = status

    def _receive(self, context: Context) -> float:
        """Waits for the next status; returns the time of the station's that it, or its absence, brings, s."""
        assert self._station is not None
        now, before, greatest_age = (
            context.get_time(),
            self._arm.utime,
            self._station.scenario.safety.status_age,
        )
        heard, self._listened = self._listened, monotonic()
        inattentive = self._listened - heard
        while True:
            if self._robot is not None:
                self._robot()
            self._listen()
            last, self._listened = self._listened, monotonic()
            inattentive += max(self._listened - last - ATTENTIVE, 0.0)
            if self._arm.utime > before:
                break
            self._waited = self.status_age if self._robot is None else self._waited + ARM_PERIOD
            if self._waited > (greatest_age if self._stop else SILENCE) - ROUNDING:
                self._give_up(context)
                self._wait_period()
                return now + ARM_PERIOD
        went_on = (self._arm.utime - before) / MICROSECONDS
        if self._robot is None:
            went_on -= (
                inattentive * self._rate
            )  # of what the robot said meanwhile only the last is kept
        if self._waited > greatest_age:
            self._note_silence(context, went_on > greatest_age + ROUNDING)
        self._waited = 0.0
        # in whole periods, and half of one beyond: so that a status that is a little early or late
        # brings one command
        target = (
            round((self._arm.utime / MICROSECONDS - self._base) / ARM_PERIOD) + HALF
        ) * ARM_PERIOD
        late = target - now - ARM_PERIOD
        if abs(late) < MADE_UP + ROUNDING:
            return target
        if late > greatest_age:
            self.report.pauses += 1
            if self.report.pauses <= NOTED:
                self.note(
                    f"the controller was late by {1e3 * late:.0f} ms; it went on from where it was"
                )
        self._base += late
        return now + ARM_PERIOD

    def _give_up(self, context: Context) -> None:
        """Stops the arm over a robot that is not heard of: its driver has brought it to rest, and nothing moves it."""
        assert self._station is not None
        self._station.RequestStop(context, BY_SILENCE)
        self._silent = True

    def _note_silence(self, context: Context, went_on: bool) -> None:
        """What a long silence means: where the robot went on meanwhile, the arm is stopped."""
        assert self._station is not None
        self._stepped = monotonic()  # it was not the controller that was late
        if went_on:
            self._give_up(context)
            return
        self.report.silences += 1
        if self.report.silences <= NOTED:
            self.note(
                f"the robot stood still for {1e3 * self._waited:.0f} ms, by its own clock, too; it was waited for"
            )

    def _wait_period(self) -> None:
        """Lets a period pass since the last step, by the clock."""
        if self._robot is None:
            left = self._stepped + ARM_PERIOD / self._rate - monotonic()
            if left > 0:
                self._lcm.HandleSubscriptions(int(1e3 * left))

    def _listen(self) -> None:
        self._lcm.HandleSubscriptions(0 if self._robot is not None else 1)

    def _pass_in(self) -> None:
        for name, channel in self._channels.items():
            if not channel.passed and channel.data is not None:
                self.bus.Publish(name, channel.data)
                channel.passed = True
        self.bus.HandleSubscriptions(0)

    def _pass_out(self) -> None:
        now = monotonic()
        if self._messages.command in self._out:
            self.report.note_period((now - self._stepped) * self._rate)
            self._stepped = now
        if self.armed and not self._silent:
            for name, data in self._out.items():
                self._lcm.Publish(name, data)
        self._out.clear()

    def _make_taker(self, name: str, channel: _Channel) -> Callable[[bytes], None]:
        def take(data: bytes) -> None:
            try:
                message = decode_message(channel.kind, name, data)
            except StationError as error:  # the caller is C and takes no exceptions
                self._leave_out(str(error))
                return
            fault = self._messages.find_fault(message, self._n) if channel is self._arm else ""
            if fault:
                self._fault = fault
                self._leave_out(fault)
            elif message.utime <= channel.utime:
                self._leave_out(f"{name} was not newer than the one before")
            else:
                channel.data, channel.utime, channel.came, channel.passed = (
                    data,
                    message.utime,
                    monotonic(),
                    False,
                )

        return take

    def _make_collector(self, name: str) -> Callable[[bytes], None]:
        def collect(data: bytes) -> None:
            arm = name == self._messages.command
            if not arm or self._messages.is_finite(self._messages.command_type.decode(data)):
                self._out[name] = data

        return collect

    def _leave_out(self, why: str) -> None:
        count = self.report.left_out.get(why, 0)
        self.report.left_out[why] = count + 1
        if not count:
            self.note(f"left out: {why}")

"""`Channel`: takes the messages of one LCM channel, and leaves out those that are unusable.

A message is left out if it cannot be read, has another form than `message_forms` wants, is not
newer than the last one, or comes from the future. It comes from the future if its time is further
ahead of its sender's clock than a clock may be wrong; the times of arrival tell where that clock
is. So one message with a wrong time changes nothing for those after it.

A sender's clock may also truly jump, because a driver was restarted or its computer's time was set.
Then several messages in a row agree with each other and not with the clock before. The channel
follows the new clock, and counts it (`Channel.clock_changes`). What this means for the arm is
decided by whoever reads the channel.
"""

from collections import Counter, deque
from collections.abc import Callable
from typing import Any

from gridpush_drake.errors import StationError
from gridpush_drake.station.links.lcm.message_forms import FindFault, decode_message
from gridpush_drake.systems.planar_manipuland_status import MICROSECONDS

CLOCK_MEMORY = 100
"""Number of last messages by which a sender's clock is known. One of them at least should not have
been kept waiting on its way."""

NEW_CLOCK_MESSAGES = 10
"""Number of messages in a row that establish a new clock when they agree with each other and not
with the clock before."""

MAX_REASONS = 50
"""Number of different reasons for leaving messages out that are counted one by one."""

OTHER_REASONS = "for other reasons"
"""The reason under which messages are counted once there are `MAX_REASONS` others."""


def count_reason(counts: Counter[str], why: str) -> bool:
    """Counts a message by the reason why it was left out; returns whether it is the first one."""
    if why not in counts and len(counts) >= MAX_REASONS:
        why = OTHER_REASONS
    counts[why] += 1
    return counts[why] == 1


class ArrivalClock:
    """The clock of a sender, as the times in its messages and the times of their arrival show it.

    A message may be kept waiting on its way, or by a busy reader, but it cannot arrive before it
    was sent. The greatest lead of a message's time over its arrival, among the last ones, is
    therefore the best that is known of how far the sender's clock is ahead of the reader's.
    """

    def __init__(self) -> None:
        """Knows nothing yet."""
        self._leads: deque[float] = deque(maxlen=CLOCK_MEMORY)

    def add(self, time: float, arrival: float) -> None:
        """Learns from a message.

        Args:
            time: time in the message, by its sender's clock, s.
            arrival: time when it arrived, by the reader's clock, s.
        """
        self._leads.append(time - arrival)

    def calc_advance(self, time: float, arrival: float) -> float:
        """Calculates how far a message's time is ahead of the sender's clock when it arrives, s.

        It is 0 if no clock is known yet. The arguments are those of `add`.
        """
        return time - arrival - max(self._leads) if self._leads else 0.0

    def restart(self) -> None:
        """Forgets the clock, for a new one."""
        self._leads.clear()


class Channel:
    """The newest usable message of a channel, and an account of those that were left out.

    Attributes:
        name: name of the channel.
        data: the newest usable message, as it came; None before the first.
        message: the newest usable message, decoded; None before the first.
        utime: its time by the sender's clock, us; -1 before the first.
        came: time when it arrived, by the reader's clock, s.
        count: number of usable messages.
        clock: the sender's clock.
        clock_changes: number of times that a new clock was established.
        jump: difference of the last new clock from the clock before it, s.
        unusable: number of messages in a row that were left out since the last usable one.
        why: the reason for the last of those.
    """

    def __init__(
        self,
        name: str,
        kind: Any,
        *,
        now: Callable[[], float],
        clock_jump: float,
        find_fault: FindFault,
        leave_out: Callable[[str], None],
        reference: ArrivalClock | None = None,
    ) -> None:
        """Has heard nothing yet; subscribe `take`.

        Args:
            name: name of the channel.
            kind: type of its messages.
            now: returns the time by the reader's clock, s, which goes as fast as the sender's.
            clock_jump: greatest time by which a message may be ahead of the sender's clock, s.
            find_fault: says why a message cannot be used.
            leave_out: is told, for each message that is left out, why.
            reference: the clock by which the messages' times are, if it is that of another
                channel's sender; None for the clock of this channel's own sender.
        """
        self.name = name
        self._kind = kind
        self._now = now
        self._clock_jump = clock_jump
        self._find_fault = find_fault
        self._leave_out = leave_out
        self.clock = ArrivalClock()
        self._reference = reference or self.clock
        self.data: bytes | None = None
        self.message: Any = None
        self.utime = -1
        self.came = 0.0
        self.count = 0
        self.clock_changes = 0
        self.jump = 0.0
        self.unusable = 0
        self.why = ""
        # The last message that agrees with no known clock: its time and its arrival, s, and the
        # number of such messages in a row that agree with each other.
        self._stray: tuple[float, float, int] | None = None

    def take(self, data: bytes) -> bool:
        """Takes a message as it came; returns whether it can be used.

        Raises nothing: the caller may be a callback of C code, which takes no exceptions.
        """
        arrival = self._now()
        try:
            message = decode_message(self._kind, self.name, data)
            why = self._find_fault(message) or self._find_clock_fault(message.utime, arrival)
        except StationError as error:
            why = str(error)
        except Exception as error:
            why = f"{self.name} could not be looked at ({type(error).__name__})"
        if why:
            self.unusable += 1
            self.why = why
            self._leave_out(why)
            return False
        self.clock.add(message.utime / MICROSECONDS, arrival)
        self.data = data
        self.message = message
        self.utime = message.utime
        self.came = arrival
        self.count += 1
        self.unusable = 0
        self.why = ""
        self._stray = None
        return True

    def describe_unusable(self) -> str:
        """Says how many messages were left out since the last usable one, and why."""
        if not self.unusable:
            return ""
        messages = "message was" if self.unusable == 1 else "messages were"
        return f"{self.unusable} {messages} left out: {self.why}"

    def _find_clock_fault(self, utime: int, arrival: float) -> str:
        """Says why a message's time will not do; empty if it will, or establishes a new clock.

        Args:
            utime: time in the message, by its sender's clock, us.
            arrival: time when it arrived, by the reader's clock, s.
        """
        time = utime / MICROSECONDS
        ahead = self._reference.calc_advance(time, arrival) > self._clock_jump
        if ahead and self._reference is not self.clock:
            return f"{self.name} is from the future, by the robot's clock"
        if not ahead and utime > self.utime:
            return ""
        if self._is_new_clock(time, arrival):
            self.jump = time - arrival - self._calc_lead()
            self.clock_changes += 1
            self.clock.restart()
            return ""
        if ahead:
            return f"{self.name} is from the future, by its sender's own clock"
        return f"{self.name} was not newer than the one before"

    def _calc_lead(self) -> float:
        """Calculates how far the last usable message's time was ahead of its arrival, s."""
        return self.utime / MICROSECONDS - self.came

    def _is_new_clock(self, time: float, arrival: float) -> bool:
        """Returns whether enough messages in a row agree with each other, this one included.

        Two messages agree if as much time passed between them by their own times as between their
        arrivals.
        """
        count = 1
        if self._stray is not None:
            last_time, last_arrival, agreeing = self._stray
            went_on = time - last_time
            passed = arrival - last_arrival
            if went_on > 0.0 and abs(went_on - passed) <= self._clock_jump:
                count = agreeing + 1
        self._stray = (time, arrival, count)
        return count >= NEW_CLOCK_MESSAGES

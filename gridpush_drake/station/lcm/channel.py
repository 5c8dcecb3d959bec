"""`Channel`: takes the messages of one LCM channel; those that cannot be used are left out and counted.

A message is left out where it cannot be read, has another form than `message_forms` wants, is not
newer than the last one, or comes from the future: its time is further ahead of its sender's clock,
as the times of arrival show that, than a clock may be wrong. So one message with a wrong time
changes nothing for those after it.

A clock that truly jumps, since a driver was restarted or its computer's time was set, is told by
several messages in a row that agree with each other and not with the clock before. The channel then
follows the new clock, and says so (`Channel.clock_changes`); what that means for the arm is decided
by whoever reads the channel.
"""

from collections import Counter, deque
from collections.abc import Callable
from typing import Any

from gridpush_drake.errors import StationError
from gridpush_drake.station.lcm.message_forms import FindFault, decode_message
from gridpush_drake.systems.planar_manipuland_status import MICROSECONDS

CLOCK_MEMORY = 100
"""Number of last messages by which a sender's clock is known. One of them at least should not have been
kept waiting on its way."""

NEW_CLOCK_MESSAGES = 10
"""Number of messages in a row that establish a new clock when they agree with each other and not with the
clock before."""

MAX_REASONS = 50
"""Number of different reasons for leaving messages out that are counted one by one."""

OTHER_REASONS = "for other reasons"


def count_reason(counts: Counter[str], why: str) -> bool:
    """Counts a message that was left out, by why; returns whether it is the first of its kind."""
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
        """Learns from a message's time, s, by its sender's clock, and its arrival, s, by the reader's."""
        self._leads.append(time - arrival)

    def calc_advance(self, time: float, arrival: float) -> float:
        """How far a message's time is ahead of the sender's clock at its arrival, s; 0 where no clock is known."""
        return time - arrival - max(self._leads) if self._leads else 0.0

    def restart(self) -> None:
        """Forgets the clock, for a new one."""
        self._leads.clear()


class Channel:
    """The newest usable message of a channel, and an account of those that were left out.

    Attributes:
        name: of the channel.
        data: the newest message that could be used, as it came; None before the first.
        message: the same, decoded.
        utime: its time by the sender's clock, us; -1 before the first.
        came: when it arrived, s, by the reader's clock.
        count: how many could be used.
        clock: of the sender.
        clock_changes: how often a new clock was established.
        jump: by how much it then differed from the clock before, s.
        unusable: how many in a row were left out since the last that could be used.
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
            name: of the channel.
            kind: of its messages.
            now: the reader's clock, s, as fast as the sender's.
            clock_jump: how far a message may be ahead of the sender's clock, s.
            find_fault: says why a message cannot be used.
            leave_out: is told of each message that is left out, and why.
            reference: the clock that the messages' times are of, where that is the clock of another
                channel's sender; this channel's own where None.
        """
        self.name, self._kind = name, kind
        self._now, self._clock_jump = now, clock_jump
        self._find_fault, self._leave_out = find_fault, leave_out
        self.clock = ArrivalClock()
        self._reference = reference or self.clock
        self.data: bytes | None = None
        self.message: Any = None
        self.utime, self.came = -1, 0.0
        self.count = self.clock_changes = self.unusable = 0
        self.jump, self.why = 0.0, ""
        # the last message that agrees with no known clock: its time and arrival, s, and how many
        # of them agree with each other
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
            self.unusable, self.why = self.unusable + 1, why
            self._leave_out(why)
            return False
        self.clock.add(message.utime / MICROSECONDS, arrival)
        self.data, self.message = data, message
        self.utime, self.came = message.utime, arrival
        self.count += 1
        self.unusable, self.why, self._stray = 0, "", None
        return True

    def describe_unusable(self) -> str:
        """Says how many messages came since the last usable one, and why they were left out; empty where none did."""
        if not self.unusable:
            return ""
        messages = "message was" if self.unusable == 1 else "messages were"
        return f"{self.unusable} {messages} left out: {self.why}"

    def _find_clock_fault(self, utime: int, arrival: float) -> str:
        """Says why a message's time will not do; empty where it will, or where it establishes a new clock."""
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
        """How far the last usable message's time was ahead of its arrival, s."""
        return self.utime / MICROSECONDS - self.came

    def _is_new_clock(self, time: float, arrival: float) -> bool:
        """Whether enough messages in a row agree with each other, this one included."""
        count = 1
        if self._stray is not None:
            last_time, last_arrival, agreeing = self._stray
            went_on, passed = time - last_time, arrival - last_arrival
            if went_on > 0.0 and abs(went_on - passed) <= self._clock_jump:
                count = agreeing + 1
        self._stray = (time, arrival, count)
        return count >= NEW_CLOCK_MESSAGES

"""`Channel`: takes the records of one kind from a link, and leaves out those that are unusable.

A record is left out if it has another form than `record_forms` wants, is not newer than the last
one, or comes from the future. It comes from the future if its time is further ahead of its sender's
clock than a clock may be wrong; the times of arrival tell where that clock is. So one record with a
wrong time changes nothing for those after it.

A sender's clock may also truly jump, because a driver was restarted or its computer's time was set.
Then several records in a row agree with each other and not with the clock before. The channel
follows the new clock, and counts it (`Channel.clock_changes`). What this means for the arm is
decided by whoever reads the channel.
"""

from collections import Counter, deque
from collections.abc import Callable
from typing import Any

from gridpush_drake.station.links.record_forms import find_form_fault

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
    """The newest usable record of one kind, and an account of those that were left out.

    Attributes:
        name: what the network calls such records.
        record: the newest usable record; None before the first.
        time: its time by the sender's clock, s; -1 before the first.
        came: time when it arrived, by the reader's clock, s.
        count: number of usable records.
        clock: the sender's clock.
        clock_changes: number of times that a new clock was established.
        jump: difference of the last new clock from the clock before it, s.
        unusable: number of records in a row that were left out since the last usable one.
        why: the reason for the last of those.
        refused: the last record that was left out; None before the first.
    """

    def __init__(
        self,
        name: str,
        *,
        joints: int,
        now: Callable[[], float],
        clock_jump: float,
        leave_out: Callable[[str], None],
        reference: ArrivalClock | None = None,
    ) -> None:
        """Has heard nothing yet.

        Args:
            name: what the network calls such records, for messages to the user.
            joints: number of the arm's joints.
            now: returns the time by the reader's clock, s, which goes as fast as the sender's.
            clock_jump: greatest time by which a record may be ahead of the sender's clock, s.
            leave_out: is told, for each record that is left out, why.
            reference: the clock by which the records' times are, if it is that of another channel's
                sender; None for the clock of this channel's own sender.
        """
        self.name = name
        self._joints = joints
        self._now = now
        self._clock_jump = clock_jump
        self._leave_out = leave_out
        self.clock = ArrivalClock()
        self._reference = reference or self.clock
        self.record: Any = None
        self.time = -1.0
        self.came = 0.0
        self.count = 0
        self.clock_changes = 0
        self.jump = 0.0
        self.unusable = 0
        self.why = ""
        self.refused: Any = None
        # The last record that agrees with no known clock: its time and its arrival, s, and the
        # number of such records in a row that agree with each other.
        self._stray: tuple[float, float, int] | None = None

    def take(self, record: Any) -> bool:
        """Takes a record as it came, whatever it holds; returns whether it can be used."""
        arrival = self._now()
        try:
            why = find_form_fault(record, self.name, self._joints)
            why = why or self._find_clock_fault(record.time, arrival)
        except Exception as error:
            why = f"{self.name} could not be looked at ({type(error).__name__})"
        if why:
            self.refused = record
            self.leave_out(why)
            return False
        self.clock.add(record.time, arrival)
        self.record = record
        self.time = record.time
        self.came = arrival
        self.count += 1
        self.unusable = 0
        self.why = ""
        self._stray = None
        return True

    def leave_out(self, why: str) -> None:
        """Counts what came and cannot be used, and why."""
        self.unusable += 1
        self.why = why
        self._leave_out(why)

    def describe_unusable(self) -> str:
        """Says how many messages were left out since the last usable one, and why."""
        if not self.unusable:
            return ""
        messages = "message was" if self.unusable == 1 else "messages were"
        return f"{self.unusable} {messages} left out: {self.why}"

    def _find_clock_fault(self, time: float, arrival: float) -> str:
        """Says why a record's time will not do; empty if it will, or establishes a new clock.

        Args:
            time: time in the record, by its sender's clock, s.
            arrival: time when it arrived, by the reader's clock, s.
        """
        ahead = self._reference.calc_advance(time, arrival) > self._clock_jump
        if ahead and self._reference is not self.clock:
            return f"{self.name} is from the future, by the robot's clock"
        if not ahead and time > self.time:
            return ""
        if self._is_new_clock(time, arrival):
            # by how much the last usable record's time was ahead of its arrival before
            self.jump = time - arrival - (self.time - self.came)
            self.clock_changes += 1
            self.clock.restart()
            return ""
        if ahead:
            return f"{self.name} is from the future, by its sender's own clock"
        return f"{self.name} was not newer than the one before"

    def _is_new_clock(self, time: float, arrival: float) -> bool:
        """Returns whether enough records in a row agree with each other, this one included.

        Two records agree if as much time passed between them by their own times as between their
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

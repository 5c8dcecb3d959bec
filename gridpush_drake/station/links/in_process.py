"""`InProcessLink`: a link whose two ends are in one process, without any network.

With it control and a twin, or control and a program that drives an arm in the same process, speak
with each other in lockstep. It is also the shortest example of a `Link`.
"""

from collections import deque
from collections.abc import Sequence

from gridpush_drake.station.links.link import Link, LinkMessage

MAX_QUEUED_RECORDS = 1000
"""Largest number of records that wait for one end to receive them. Beyond it the oldest one is
dropped, as by a network whose buffers are full."""


class InProcessLink(Link):
    """One end of a link within a process."""

    def __init__(self, incoming: deque[LinkMessage], outgoing: deque[LinkMessage]) -> None:
        """Takes the queues of the two directions; `make_pair` makes both ends."""
        self._incoming = incoming
        self._outgoing = outgoing

    @classmethod
    def make_pair(cls) -> tuple["InProcessLink", "InProcessLink"]:
        """The two ends of a link: what is sent at one is received at the other."""
        there: deque[LinkMessage] = deque(maxlen=MAX_QUEUED_RECORDS)
        back: deque[LinkMessage] = deque(maxlen=MAX_QUEUED_RECORDS)
        return cls(there, back), cls(back, there)

    def receive(self, timeout: float) -> Sequence[LinkMessage]:
        """Returns what the other end has sent since the last call; it never waits."""
        messages = list(self._incoming)
        self._incoming.clear()
        return messages

    def send(self, record: LinkMessage) -> None:
        """Leaves a record for the other end."""
        self._outgoing.append(record)

"""`LinkReport`: what a `HardwareLink` noted of a run, such as late periods and bad messages."""

from collections import Counter
from dataclasses import dataclass, field

from gridpush_drake.station.links.link import MILLISECONDS

LATE_PERIOD = 0.01
"""A command that goes out longer than this after the last one counts as late, s."""

SLOW_FRACTION = 0.05
"""If more than this fraction of the commands came late, or the controller paused, the computer was
too slow."""

NOTED = 10
"""The log tells when a pause happened for the first so many of each kind; all are counted."""


@dataclass
class LinkReport:
    """An account of how the loop went.

    Attributes:
        steps: number of commands that were made.
        worst_period: longest time between two commands, s.
        late: number of commands that came later than `LATE_PERIOD` after the last one.
        pauses: number of times that the controller was late by more than a status may be old.
        silences: number of times that the robot paused for as long, and went on.
        force: greatest force on the finger's tip, N.
        left_out: number of messages that could not be used, by the reason.
        events: the station's time, s, and a text, for whatever happened.
        causes: what went wrong with the link or the controller, each as a sentence.
        traces: for each failure of the controller, where in the program it arose.
    """

    steps: int = 0
    worst_period: float = 0.0
    late: int = 0
    pauses: int = 0
    silences: int = 0
    force: float = 0.0
    left_out: Counter[str] = field(default_factory=Counter)
    events: list[tuple[float, str]] = field(default_factory=list)
    causes: list[str] = field(default_factory=list)
    traces: list[str] = field(default_factory=list)

    @property
    def late_fraction(self) -> float:
        """The fraction of the commands that came late, 0 to 1."""
        return self.late / max(self.steps, 1)

    @property
    def slow(self) -> bool:
        """Whether this computer was too slow for the control loop."""
        return self.pauses > 0 or self.late_fraction > SLOW_FRACTION

    def describe_slowness(self) -> str:
        """Says how late the control loop was and what helps; "" if it was in time."""
        if not self.slow:
            return ""
        return (
            f"The likely cause is a slow computer: {100 * self.late_fraction:.0f} % of the "
            "commands "
            f"came more than {MILLISECONDS * LATE_PERIOD:.0f} ms after the last one, the latest "
            f"after {MILLISECONDS * self.worst_period:.0f} ms. Close other programs; with a twin, "
            "start it and gridpush robot again with a smaller --realtime-rate."
        )

    def note_period(self, period: float) -> None:
        """Counts a command that came a period, s, after the last one."""
        self.steps += 1
        self.worst_period = max(self.worst_period, period)
        self.late += period > LATE_PERIOD

    def describe(self) -> str:
        """Returns the report in words."""
        text = (
            f"{self.steps} commands, "
            f"the longest period {MILLISECONDS * self.worst_period:.1f} ms, "
            f"{100 * self.late_fraction:.2f} % over {MILLISECONDS * LATE_PERIOD:.0f} ms; "
            f"at most {self.force:.1f} N on the finger's tip"
        )
        if self.pauses:
            text += f"; the controller paused {self.pauses} times"
        if self.silences:
            text += f"; the robot paused {self.silences} times"
        return text + "".join(
            f"; {count} messages left out: {why}" for why, count in self.left_out.items()
        )

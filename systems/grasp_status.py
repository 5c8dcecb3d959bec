"""What a grasp executor says of itself on its port."""

from dataclasses import dataclass
from enum import StrEnum


class GraspPhase(StrEnum):
    """What a grasp executor is doing."""

    IDLE = "idle"
    APPROACHING = "approaching"
    ENTERING = "entering"
    CLOSING = "closing"
    LIFTING = "lifting"
    HOLDING = "holding"
    OPENING = "opening"
    RETREATING = "retreating"


class GraspOutcome(StrEnum):
    """What came of a grasp command; NONE while it is under way, and false."""

    NONE = ""
    REFUSED = "refused"
    MISSED = "missed"
    SLIPPED = "slipped"
    HELD = "held"


IDLE, APPROACHING, ENTERING, CLOSING, LIFTING, HOLDING, OPENING, RETREATING = GraspPhase
NONE, REFUSED, MISSED, SLIPPED, HELD = GraspOutcome


@dataclass(frozen=True)
class GraspStatus:
    """Where an executor stands.

    Attributes:
        phase: "idle", "approaching", "entering", "closing", "lifting", "holding", "opening" or "retreating".
        number: of the last command taken up or refused; 0 before the first.
        outcome: of that command: "" (under way), "refused", "missed" (closed on nothing), "slipped" (lost while lifting
            or holding) or "held" (lifted, and held for the time: the phase stays "holding").
        reason: why it was refused, or what went wrong; empty where nothing did.
    """

    phase: GraspPhase = IDLE
    number: int = 0
    outcome: GraspOutcome = NONE
    reason: str = ""

    @property
    def ready(self) -> bool:
        """Whether a new command is taken up."""
        return self.phase == IDLE

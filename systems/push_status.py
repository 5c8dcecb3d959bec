"""What a push executor says of itself on its port."""

from dataclasses import dataclass
from enum import StrEnum


class PushPhase(StrEnum):
    """What a push executor is doing."""

    IDLE = "idle"
    APPROACHING = "approaching"
    DESCENDING = "descending"
    PUSHING = "pushing"
    SETTLING = "settling"
    RETRACTING = "retracting"


IDLE, APPROACHING, DESCENDING, PUSHING, SETTLING, RETRACTING = PushPhase


@dataclass(frozen=True)
class PushStatus:
    """Where an executor stands.

    Attributes:
        phase: "idle", "approaching", "descending", "pushing", "settling" or "retracting".
        number: of the last command taken up or refused; 0 before the first.
        executed: commands carried out to the end, or broken off.
        refused: commands refused.
        reason: why the last command was refused; empty where it was not.
    """

    phase: PushPhase = IDLE
    number: int = 0
    executed: int = 0
    refused: int = 0
    reason: str = ""

    @property
    def ready(self) -> bool:
        """Whether a new command is taken up."""
        return self.phase == IDLE

"""What a push executor says of itself on its port."""

from dataclasses import dataclass

IDLE = "idle"
APPROACHING = "approaching"
DESCENDING = "descending"
PUSHING = "pushing"
SETTLING = "settling"
RETRACTING = "retracting"


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

    phase: str = IDLE
    number: int = 0
    executed: int = 0
    refused: int = 0
    reason: str = ""

    @property
    def ready(self) -> bool:
        """Whether a new command is taken up."""
        return self.phase == IDLE

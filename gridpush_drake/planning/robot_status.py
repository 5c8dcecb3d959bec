"""What the robot's executors say of themselves, as closed loops and controllers read it.

The executors are systems (`systems.execution.push_executor`, `systems.execution.grasp_executor`,
`systems.execution.steer_executor`); a simulated world
reports the same statuses for pushes that it carries out at once (`world.run_loop`).
"""

from dataclasses import dataclass
from enum import StrEnum

from gridpush_drake.planning.weighing.press import PressOutcome


class PushPhase(StrEnum):
    """What a push executor is doing."""

    IDLE = "idle"
    APPROACHING = "approaching"
    DESCENDING = "descending"
    PUSHING = "pushing"
    SETTLING = "settling"
    RETRACTING = "retracting"
    CLEARING = "clearing"


@dataclass(frozen=True)
class PushStatus:
    """What a push executor reports: what it is doing, and what became of its commands.

    Attributes:
        phase: what it is doing; "clearing" moves the arm out of the camera's view.
        command_id: number of the last command that was taken up or refused; 0 before the first.
        executed: how many commands were carried out to the end, or broken off.
        refused: how many commands were refused.
        reason: why the last command was refused; empty where it was not.
    """

    phase: PushPhase = PushPhase.IDLE
    command_id: int = 0
    executed: int = 0
    refused: int = 0
    reason: str = ""

    @property
    def ready(self) -> bool:
        """Whether a new command would be taken up now."""
        return self.phase == PushPhase.IDLE


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
    """What came of a grasp command; NONE, which is false, while it is under way."""

    NONE = ""
    REFUSED = "refused"
    MISSED = "missed"
    SLIPPED = "slipped"
    HELD = "held"


@dataclass(frozen=True)
class GraspStatus:
    """What a grasp executor says of itself.

    Attributes:
        phase: what it is doing.
        command_id: number of the last command that was taken up or refused; 0 before the first.
        outcome: what came of that command: "" (under way), "refused", "missed" (closed on nothing),
            "slipped" (lost while lifting or holding) or "held" (lifted, and held for as long as was
            asked; the phase stays "holding").
        reason: why it was refused, or what went wrong; empty where nothing did.
    """

    phase: GraspPhase = GraspPhase.IDLE
    command_id: int = 0
    outcome: GraspOutcome = GraspOutcome.NONE
    reason: str = ""

    @property
    def ready(self) -> bool:
        """Whether a new command would be taken up now."""
        return self.phase == GraspPhase.IDLE


class PressStep(StrEnum):
    """What a press executor is doing."""

    IDLE = "idle"
    APPROACHING = "approaching"
    PRESSING = "pressing"
    RETURNING = "returning"


@dataclass(frozen=True)
class PressStatus:
    """What a press executor says of itself.

    Attributes:
        step: what it is doing.
        command_id: number of the last command that was taken up or refused; 0 before the first.
        outcome: how that press ended; None while it is under way, and before the first.
        reason: what came of it, in half a sentence.
        weighed: whether it gave a weighing.
    """

    step: PressStep = PressStep.IDLE
    command_id: int = 0
    outcome: PressOutcome | None = None
    reason: str = ""
    weighed: bool = False

    @property
    def ready(self) -> bool:
        """Whether a new command would be taken up now."""
        return self.step == PressStep.IDLE


class SteerPhase(StrEnum):
    """What an executor of steering is doing."""

    IDLE = "idle"
    APPROACHING = "approaching"
    DESCENDING = "descending"
    STEERING = "steering"
    RETRACTING = "retracting"
    RETURNING = "returning"


@dataclass(frozen=True)
class SteerStatus:
    """What an executor of steering says of itself.

    Attributes:
        phase: what it is doing; in "steering" the finger is down and follows its velocity.
        command_id: number of the last command that was taken up or refused; 0 before the first.
        refused: whether that command was refused.
        reason: why it was refused, why the finger is held back at present, or why it went up by
            itself; empty where none of these.
    """

    phase: SteerPhase = SteerPhase.IDLE
    command_id: int = 0
    refused: bool = False
    reason: str = ""

    @property
    def ready(self) -> bool:
        """Whether nobody steers, and a new command would be taken up now."""
        return self.phase == SteerPhase.IDLE

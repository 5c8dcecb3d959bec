"""What a push command is on a port: a vector of six numbers.

What a push executor says of itself on its port.

What a grasp command is on a port: a vector of six numbers.

What a grasp executor says of itself on its port.

What a contact-point controller says of itself on its port.

What a pre-grasp controller says of itself on its port.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import atan2, cos, isfinite, nan, sin

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.planning.pregrasp.goals import PreGraspGoal

PUSH_COMMAND_SIZE = 6


@dataclass(frozen=True)
class PushCommand:
    """A straight push of the finger's tip in the plane of the table, world frame.

    Attributes:
        command_id: counts the commands from 1; a command is new when its id is. 0 stands for no command.
        x: of the tip's center where the push begins, m.
        y: likewise.
        direction: of the motion, rad from W's x axis, counterclockwise.
        distance: to move, m.
        speed: on the way, m/s.
    """

    command_id: int = 0
    x: float = 0.0
    y: float = 0.0
    direction: float = 0.0
    distance: float = 0.0
    speed: float = 0.0

    @property
    def start(self) -> NDArray[np.float64]:
        """(2,) p_WP of the tip's center at the beginning, m."""
        return np.array([self.x, self.y])

    @property
    def end(self) -> NDArray[np.float64]:
        """(2,) p_WP at the end, m."""
        return self.start + self.distance * np.array([cos(self.direction), sin(self.direction)])

    def to_vector(self) -> NDArray[np.float64]:
        """(6,) as on a port: command_id, x, y, direction, distance, speed."""
        return np.array([self.command_id, self.x, self.y, self.direction, self.distance, self.speed])

    @classmethod
    def from_vector(cls, vector: NDArray[np.float64]) -> "PushCommand":
        """Reads what `to_vector` wrote; an id that is not finite is none, 0."""
        command_id, *rest = vector.tolist()
        return cls(round(command_id) if isfinite(command_id) else 0, *rest)

    @classmethod
    def from_push(cls, command_id: int, push: Push) -> "PushCommand":
        """The command for a straight push."""
        x, y = push.start.tolist()
        direction = atan2(push.velocity[1], push.velocity[0])
        return cls(command_id, x, y, direction, push.length, push.length / push.duration)


class PushPhase(StrEnum):
    """What a push executor is doing."""

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
        command_id: of the last command taken up or refused; 0 before the first.
        executed: commands carried out to the end, or broken off.
        refused: commands refused.
        reason: why the last command was refused; empty where it was not.
    """

    phase: PushPhase = PushPhase.IDLE
    command_id: int = 0
    executed: int = 0
    refused: int = 0
    reason: str = ""

    @property
    def ready(self) -> bool:
        """Whether a new command is taken up."""
        return self.phase == PushPhase.IDLE


GRASP_COMMAND_SIZE = 6


@dataclass(frozen=True)
class GraspCommand:
    """A grasp from beyond the table's edge, one jaw under the object and one over it, world frame.

    Attributes:
        command_id: counts the commands from 1; a command is new when its id is. 0 stands for no command.
        x: of the grasp point p_WG, the middle between the pads, m.
        y: likewise.
        z: likewise; half the object's thickness where it lies on the table.
        approach: heading in which the fingers point while they go in, level, rad from W's x axis, counterclockwise.
        lift: how high to lift what was grasped, m.
    """

    command_id: int = 0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    approach: float = 0.0
    lift: float = 0.0

    @property
    def p_WG(self) -> NDArray[np.float64]:
        """(3,) the grasp point, m."""
        return np.array([self.x, self.y, self.z])

    @property
    def heading(self) -> NDArray[np.float64]:
        """(2,) unit vector in which the fingers point, in W."""
        return np.array([cos(self.approach), sin(self.approach)])

    def to_vector(self) -> NDArray[np.float64]:
        """(6,) as on a port: command_id, x, y, z, approach, lift."""
        return np.array([self.command_id, self.x, self.y, self.z, self.approach, self.lift])

    @classmethod
    def from_vector(cls, vector: NDArray[np.float64]) -> "GraspCommand":
        """Reads what `to_vector` wrote; an id that is not finite is none, 0."""
        command_id, *rest = vector.tolist()
        return cls(round(command_id) if isfinite(command_id) else 0, *rest)


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


@dataclass(frozen=True)
class GraspStatus:
    """Where an executor stands.

    Attributes:
        phase: "idle", "approaching", "entering", "closing", "lifting", "holding", "opening" or "retreating".
        command_id: of the last command taken up or refused; 0 before the first.
        outcome: of that command: "" (under way), "refused", "missed" (closed on nothing), "slipped" (lost while lifting
            or holding) or "held" (lifted, and held for the time: the phase stays "holding").
        reason: why it was refused, or what went wrong; empty where nothing did.
    """

    phase: GraspPhase = GraspPhase.IDLE
    command_id: int = 0
    outcome: GraspOutcome = GraspOutcome.NONE
    reason: str = ""

    @property
    def ready(self) -> bool:
        """Whether a new command is taken up."""
        return self.phase == GraspPhase.IDLE


class ContactPointMode(StrEnum):
    """What a contact-point controller is doing."""

    WAITING = "waiting"
    PUSHING = "pushing"
    REACHED = "reached"
    FAILED = "failed"
    LOST = "lost"


@dataclass(frozen=True)
class ContactPointStatus:
    """Where a contact-point controller stands.

    Attributes:
        mode: "waiting" for a goal, for the robot, or for the object to be seen at rest; "pushing"; "reached" the goal;
            "failed"; or "lost" the object out of sight.
        reason: the mode in a sentence.
        cause: of "reached" or "failed": a key of `planning.push_plan.REASONS`, "refused" or "error"; else empty.
        pushes: commanded towards this goal and carried out.
        refused: commanded in a row and refused.
        error: mean cell error to the goal where the object was last seen at rest, m; NaN before.
        expected_pose: (x, y, theta) in which the push under way is predicted to leave the object, W, m and rad.
        expected_error: mean cell error to the goal there, m; NaN where no push is under way.
        prediction_error: mean cell distance of where the last push left the object from where it was predicted to, m;
            NaN before.
    """

    mode: ContactPointMode = ContactPointMode.WAITING
    reason: str = "Nothing was seen yet."
    cause: str = ""
    pushes: int = 0
    refused: int = 0
    error: float = nan
    expected_pose: tuple[float, float, float] | None = None
    expected_error: float = nan
    prediction_error: float = nan


class PreGraspMode(StrEnum):
    """What a pre-grasp controller is doing."""

    WAITING = "waiting"
    EXPLORING = "exploring"
    SLIDING = "sliding"
    STOPPING = "stopping"
    VERIFYING = "verifying"
    GRASPING = "grasping"
    HOLDING = "holding"
    LOST = "lost"
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class PreGraspStatus:
    """Where a controller stands.

    Attributes:
        mode: "waiting" (to see the object at rest), "exploring", "sliding", "stopping" (a push that is broken off),
            "verifying" (that it can be grasped where it lies), "grasping" (until it is lifted), "holding", "lost" (from
            sight) or "failed".
        reason: for the mode, in a sentence.
        pokes: commanded so far.
        slides: likewise.
        grasps: likewise.
        goal: that it slides to or grasps at; None where there is none.
        expected_pose: (x, y, theta) where the push under way is expected to leave the object, m and rad; None without.
        margin: stability margin of the goal at the worst, m; NaN without one.
    """

    mode: PreGraspMode = PreGraspMode.WAITING
    reason: str = "The object was not looked at yet."
    pokes: int = 0
    slides: int = 0
    grasps: int = 0
    goal: PreGraspGoal | None = None
    expected_pose: tuple[float, float, float] | None = None
    margin: float = float("nan")

    @property
    def over(self) -> bool:
        """Whether nothing more is done."""
        return self.mode in (PreGraspMode.HOLDING, PreGraspMode.FAILED)

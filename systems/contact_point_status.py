"""What a contact-point controller says of itself on its port."""

from dataclasses import dataclass
from enum import StrEnum
from math import nan


class ContactPointMode(StrEnum):
    """What a contact-point controller is doing."""

    WAITING = "waiting"
    PUSHING = "pushing"
    REACHED = "reached"
    FAILED = "failed"
    LOST = "lost"


WAITING, PUSHING, REACHED, FAILED, LOST = ContactPointMode


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

    mode: ContactPointMode = WAITING
    reason: str = "Nothing was seen yet."
    cause: str = ""
    pushes: int = 0
    refused: int = 0
    error: float = nan
    expected_pose: tuple[float, float, float] | None = None
    expected_error: float = nan
    prediction_error: float = nan

"""`FollowConfig`: the section of a scenario for the tasks that push along a path."""

from math import radians
from typing import Annotated

from pydantic import Field

from gridpush_drake.station.schema.fields import Config, Number, Pose, positive, whole


class FollowConfig(Config):
    """How the object is pushed along a path, with a finger that is steered while it pushes.

    The path ends at `goal.pose`.

    Attributes:
        path: poses [x, y, theta] of B in W that the object is to go through, m and rad, the last of
            them the end; null to plan a path to `goal.pose` around whatever stands on the table.
        speed: speed of the object's centroid on the path, m/s.
        finger_speed: greatest speed of the finger while it pushes, m/s.
        walking_speed: greatest speed of the finger on its way round the object, m/s.
        position_tolerance: distance from the path's end at which the object has arrived, m.
        angle_tolerance: angle from that of the path's end at which it has arrived, rad.
        plans: number of paths that are planned, one after another, if the object does not get on.
    """

    path: Annotated[
        list[Pose] | None,
        Field(min_length=2, description="a list of poses [x, y, theta], two or more, or null"),
    ] = None
    speed: Annotated[Number, positive("m/s", low=1e-3, high=0.5)] = 0.05
    finger_speed: Annotated[Number, positive("m/s", low=1e-3, high=0.5)] = 0.1
    walking_speed: Annotated[Number, positive("m/s", low=1e-3, high=0.5)] = 0.15
    position_tolerance: Annotated[Number, positive("m", low=1e-4)] = 0.005
    angle_tolerance: Annotated[Number, positive("rad", low=1e-3)] = radians(3)
    plans: Annotated[int, whole(1)] = 3

    @property
    def steer_speed(self) -> float:
        """Greatest speed of the finger while it is steered, m/s."""
        return max(self.finger_speed, self.walking_speed)

"""The task `line`: an unknown object is poked, learned, and pushed along a line on the table.

It is the task `follow` with another path: whoever draws a line need not say how the object should
turn on it, for it turns with the line.
"""

import numpy as np

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.feedback.pose_path import PosePath
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.tasks.follow_config import FollowConfig
from gridpush_drake.station.tasks.follow_task import FollowKind, FollowTask
from gridpush_drake.station.tasks.line_config import LineConfig


class LineTask(FollowTask):
    """The station with what pokes, and a controller that pushes along a line."""

    path_field = "line.points"

    @classmethod
    def make_path(cls, obj: GridObject, scenario: PushScenario) -> PosePath:
        """Makes the path from where the object lies along the scenario's line.

        Raises:
            PlanningError: there is no point, or two in a row are the same.
        """
        points = scenario.section(LineConfig).points
        if not points:
            raise PlanningError("path: empty; expected a list of places [x, y] (m)")
        pose = np.array(scenario.object_pose)
        begin = transform(pose, obj.p_BC.mean(axis=0)[None])
        places = np.vstack([begin, points])
        x, y = places[1] - places[0]
        turn = pose[2] - float(np.arctan2(y, x))
        return PosePath.through(obj, places, scenario.section(FollowConfig).speed, turn)

    @classmethod
    def list_places(cls, obj: GridObject, scenario: PushScenario) -> dict[str, Array]:
        """Lists the poses of the object at the line's points; see `FollowTask.list_places`."""
        poses = cls.make_path(obj, scenario).poses[1:]
        return {f"the pose at {cls.path_field}[{at}]": pose for at, pose in enumerate(poses)}


class LineKind(FollowKind):
    """A robot pokes an object, learns it, and pushes it along a line on the table."""

    help = "poke and learn it, and push it along a line that is drawn on the table, to its end"
    sentence = "Push the {} along the line to its end."
    station = LineTask
    scenario = "line"

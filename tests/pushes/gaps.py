"""How far the pusher's disc is from the object's outline: a check of frames and calibration."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Point

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import PushLog


def gap(obj: GridObject, pose: ArrayLike, tip: ArrayLike, radius: float) -> float:
    """Distance from the disc at `tip` to the outline at `pose`, m; negative where they overlap."""
    x, y, theta = np.asarray(pose)
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    point = Point(turn @ (np.asarray(tip) - (x, y)))
    distance = obj.outline.exterior.distance(point)
    return (-distance if obj.outline.contains(point) else distance) - radius


def gaps(log: PushLog, obj: GridObject) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The gaps at the pushes' beginnings and at their ends, mm."""
    start = [gap(obj, seen.pose, seen.push.xy[0], seen.push.radius) for seen in log]
    end = [gap(obj, seen.final_pose, seen.push.xy[-1], seen.push.radius) for seen in log]
    return 1e3 * np.array(start), 1e3 * np.array(end)

"""Where a camera's frame is in the robot's, found from where the pusher lies on the outline.

Poses that a camera tells may be off those that the robot knows by a pose X_RC of the whole frame.
It shows where several tips push an object, for there each of them lies on the outline: X_RC is what
makes the gaps between tips and outline small. The outline may be off in the logged body frame, too.
Its pose there is fitted beside and not returned, for `identify` with `fit_frame` finds it better,
from how the object moves. Pushes at several angles of the object tell both frames apart.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import shapely
from scipy.optimize import least_squares

from gridpush_drake.errors import PushLogError
from gridpush_drake.geometry.se2 import Array, compose, transform, transform_back
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.observed_push import ObservedPush

CONTACT_DISTANCE = 0.015
"""How far the pusher has gone when all its tips are taken to touch, m."""

GAP_STD = 0.0005
"""Standard deviation of a seen gap, m. Gaps much larger count by their size, not by its square: a
tip may be off the object. All gaps of a push together count as one, for they err alike."""

CAMERA_STD = np.array([0.003, 0.003, 0.01])
"""Standard deviations, beforehand, of the camera's place, at the object, and of its angle, m, m and
rad."""

BODY_STD = np.array([0.003, 0.003, 0.03])
"""Standard deviations, beforehand, of the outline's place and angle in the body frame, m, m and
rad."""

MAX_STEPS = 100
"""Largest number of steps of the least squares; about ten are enough."""


def find_camera_frame(obj: GridObject, pushes: Iterable[ObservedPush]) -> Array:
    """Finds where a camera's frame is in the robot's.

    Args:
        obj: the object, whose frame is about that of the logged pose.
        pushes: by several discs, each observed on its way, with poses as the camera tells them.

    Returns:
        (3,) X_RC, m and rad.

    Raises:
        PushLogError: a push is not by discs, or no pose was seen while they touched.
    """
    poses, tips, weights, radius = _list_contacts(pushes)
    # a turn about the mean place of the object moves it least
    middle = np.array([*poses[:, :2].mean(axis=0), 0.0])

    def place_camera(u: Array) -> Array:
        return compose(compose(middle, u * CAMERA_STD), -middle)

    def calc_residuals(u: Array) -> Array:
        X_RC = place_camera(u[:3])
        X_RO = compose(compose(X_RC, poses), u[3:] * BODY_STD)
        points = shapely.points(transform_back(X_RO, tips).reshape(-1, 2))
        outside = shapely.distance(obj.outline, points)
        inside = np.where(outside > 0, 0.0, shapely.distance(obj.outline.boundary, points))
        gaps = (outside - inside - radius).reshape(tips.shape[:2]) / GAP_STD
        # the pseudo-Huber loss as a square: r² for small r, 2 |r| for large ones
        robust = np.sign(gaps) * np.sqrt(2.0 * (np.sqrt(1.0 + gaps**2) - 1.0))
        return np.concatenate([(np.sqrt(weights)[:, None] * robust).ravel(), u])

    found = least_squares(calc_residuals, np.zeros(6), max_nfev=MAX_STEPS)
    return place_camera(found.x[:3])


def place_in_robot_frame(seen: ObservedPush, X_RC: Array) -> ObservedPush:
    """Moves the poses of a push from the camera's frame to the robot's, where the pusher is."""
    poses = compose(X_RC, seen.poses_observed)
    return replace(seen, pose=compose(X_RC, seen.pose), poses_observed=poses)


def _list_contacts(pushes: Iterable[ObservedPush]) -> tuple[Array, Array, Array, float]:
    """Lists what was seen while all tips touched.

    Returns:
        Poses X_CB (K, 3) of the object, m and rad; the tips' centers p_RT (K, N, 2), m; weights
        (K,) of the poses, which of a push add up to one; and the tips' radius, m.
    """
    poses = []
    tips = []
    weights: list[float] = []
    radius = 0.0
    for seen in pushes:
        shape = seen.push.shape
        if shape is None or shape.joined:
            raise PushLogError(f"push {seen.name}: is by one disc or a polygon; expected discs")
        radius = shape.radius
        times = seen.t_observed
        touching = seen.push.distance_at(times) >= CONTACT_DISTANCE
        frames = np.column_stack([seen.push.tip_at(times), seen.push.yaw_at(times)])
        poses += list(seen.poses_observed[touching])
        tips += [transform(frame, shape.core) for frame in frames[touching]]
        weights += [1.0 / touching.sum()] * int(touching.sum())
    if not poses:
        raise PushLogError("no pose was seen while all tips touched; expected one or more")
    return np.array(poses), np.array(tips), np.array(weights), radius

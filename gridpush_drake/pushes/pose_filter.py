"""Looking at an object until it lies still: what controllers do before they decide anything.

A single look is noisy, and shows an object that may be moving still. The latest looks q_1 .. q_k are of one rest where

    |x_i - x_k|, |y_i - y_k| <= rest   and   |theta_i - theta_k| <= rest_angle   for all i,

and their mean tells where the object lies. A look that differs from the last one ends the rest that it was of.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import PlanningError

Array = NDArray[np.float64]
Pose = tuple[float, float, float]


@dataclass(frozen=True)
class PoseFilterOptions:
    """How a controller looks; every number in it, and in its children, is positive, and what is counted 1 or more.

    Attributes:
        period: between two looks, s.
        looks: at the object at rest, whose mean counts.
        rest: looks further apart than this are not of one rest, m,
        rest_angle: likewise, rad.
        timeout: how long the object may be out of sight before it counts as lost, s.
    """

    period: float = 0.05
    looks: int = 6
    rest: float = 0.004
    rest_angle: float = 0.04
    timeout: float = 1.0

    def __post_init__(self) -> None:
        for name, default in ((field.name, field.default) for field in fields(self)):
            value = getattr(self, name)
            if isinstance(default, int):
                if value < 1:
                    raise PlanningError(f"{name} is {value!r}; expected 1 or more")
            elif not (np.isfinite(value) and value > 0):
                raise PlanningError(f"{name} is {value!r}; expected a positive number")


@dataclass(frozen=True)
class PoseFilter:
    """What was seen since everything came to rest; never changed, only replaced.

    Attributes:
        poses: (x, y, theta) of B in W, m and rad, the last one last.
        last_seen: when the object was, s.
    """

    poses: tuple[Pose, ...] = ()
    last_seen: float = 0.0

    def __len__(self) -> int:
        return len(self.poses)

    def calc_mean(self) -> Array:
        """(3,) the mean pose, m and rad; there must be one."""
        mean: Array = np.mean(self.poses, axis=0)
        return mean

    def forget(self) -> "PoseFilter":
        """Without the poses."""
        return replace(self, poses=()) if self.poses else self

    def wait(self, time: float, pose: Array) -> "PoseFilter":
        """Without the poses, while the robot is at work; only whether the object was seen, `pose` (3,), counts."""
        return PoseFilter(last_seen=time if np.isfinite(pose).all() else self.last_seen)

    def is_overdue(self, time: float, options: PoseFilterOptions) -> bool:
        """Whether the object has been out of sight for longer than one is patient, at `time`, s."""
        return time - self.last_seen > options.timeout

    def take_in(self, time: float, pose: Array, options: PoseFilterOptions) -> "PoseFilter":
        """With another look.

        Args:
            time: of the look, s.
            pose: (3,) seen, m and rad; NaN where the object was not.
            options: what is of one rest, and how many looks are kept.

        Returns:
            The latest looks that are of one rest with this one; none where the object was not seen.
        """
        if not np.isfinite(pose).all():
            return self.forget()
        looks = np.array([*self.poses, pose])[-options.looks :]
        off = np.abs(looks - looks[-1])
        moved = (off[:, :2].max(axis=1) > options.rest) | (off[:, 2] > options.rest_angle)
        kept = looks[int(np.flatnonzero(moved)[-1]) + 1 :] if moved.any() else looks
        return PoseFilter(tuple((x, y, theta) for x, y, theta in kept.tolist()), time)

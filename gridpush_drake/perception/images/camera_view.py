"""What a robot's camera saw in a run: the records that the station makes and the report draws.

How an object is found and tracked is in `detection` and `tracking`, and how several of known
outlines are in `scene_tracking`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.geometry.se2 import Array


@dataclass(frozen=True, eq=False)
class CameraView:
    """What the camera saw in a run.

    Attributes:
        picture: (height, width, 3) uint8, the part of the photograph near the object, with the
            outline that was found.
        t: (K,) times of the pictures since the run began, s.
        errors: (K, 3) poses tracked less the true ones, (x, y, theta), m and rad; NaN where the
            object was not seen.
        std: (K, 3) standard deviations that the tracker states, m and rad.
    """

    picture: NDArray[np.uint8]
    t: Array
    errors: Array
    std: Array

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(K,) whether the object was seen in each picture."""
        return np.asarray(np.isfinite(self.errors).all(axis=1))

    def calc_rms(self) -> tuple[float, float]:
        """Calculates how far off the tracked poses were.

        Returns:
            Root mean square error of the position, m, and of the angle, rad, over the pictures in
            which the object was seen; NaN where there are none.
        """
        return calc_rms(self.errors[self.seen])

    def until(self, time: float) -> "CameraView":
        """The pictures taken before a time, s."""
        before = self.t < time
        return replace(self, t=self.t[before], errors=self.errors[before], std=self.std[before])


@dataclass(frozen=True, eq=False)
class SceneCameraView:
    """What the camera saw of N objects in a run.

    Attributes:
        t: (K,) times of the pictures since the run began, s.
        errors: (K, N, 3) poses tracked less the true ones, (x, y, theta), m and rad; NaN where an
            object was not seen.
    """

    t: Array
    errors: Array

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(K, N) whether each object was seen in each picture."""
        return np.asarray(np.isfinite(self.errors).all(axis=2))

    def calc_rms(self) -> tuple[float, float]:
        """Calculates how far off the tracked poses of all objects were, as `Sight.calc_rms`."""
        return calc_rms(self.errors[self.seen])

    def until(self, time: float) -> "SceneCameraView":
        """The pictures taken before a time, s."""
        before = self.t < time
        return SceneCameraView(self.t[before], self.errors[before])


def calc_rms(errors: Array) -> tuple[float, float]:
    """Calculates the root mean squares of errors of poses.

    Args:
        errors: (K, 3) errors, (x, y, theta), m and rad.

    Returns:
        Root mean square error of the position, m, and of the angle, rad; NaN where there are none.
    """
    if not len(errors):
        return float("nan"), float("nan")
    # The square of the distance, and of the turn, in each picture.
    position = np.square(errors[:, :2]).sum(axis=1)
    angle = np.square(errors[:, 2])
    return float(np.sqrt(position.mean())), float(np.sqrt(angle.mean()))

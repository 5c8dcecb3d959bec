"""The pose of a known outline, from frame to frame."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon

from gridpush_drake.perception.camera import Camera
from gridpush_drake.perception.frames import Frame

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackerOptions:
    """How the pose is found.

    Attributes:
        max_step: furthest that the object goes from one frame to the next, m.
        max_turn: likewise, rad.
        lost_share: the object is lost where less of its visible outline than this is found.
        pixel_noise: standard deviation of an edge's place that neighboring pixels share, pixels.
    """

    max_step: float = 0.03
    max_turn: float = 0.3
    lost_share: float = 0.5
    pixel_noise: float = 0.3


@dataclass(frozen=True, eq=False)
class TrackerState:
    """What the tracker remembers; nobody edits it.

    Attributes:
        pose: (3,) the last pose (x, y, theta) found, W, m and rad; NaN before the first.
        lost: whether the object was not found in the last frame.
        t: of the last frame, s.
        appearance: what table and object look like.
    """

    pose: Array
    lost: bool
    t: float
    appearance: Any


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """What one frame told.

    Attributes:
        pose: (3,) (x, y, theta) of the object, W, m and rad, theta without jumps; NaN where it was not seen.
        covariance: (3, 3) of it, m^2, m rad and rad^2; NaN where it was not seen. It is large along what cannot be
            seen: the angle of a disc, what the arm covers.
        seen: whether the object was found.
    """

    pose: Array
    covariance: Array
    seen: bool


class PoseTracker:
    """Registers a known outline to what a camera sees. It holds no state; `start` and `track` are pure."""

    def __init__(
        self, outline: Polygon | ArrayLike, height: float, camera: Camera, options: TrackerOptions = TrackerOptions()
    ) -> None:
        """Takes the object and the camera.

        Args:
            outline: of the object, B: a polygon, or (k, 2) vertices, m.
            height: of the object, m.
            camera: with X_WC; the table's top is at z = 0.
            options: see `TrackerOptions`.

        Raises:
            CameraError: X_WC is not known.
            ObjectError: the outline is none.
        """
        raise NotImplementedError

    def start(self, frame: Frame, guess: ArrayLike | None = None) -> TrackerState:
        """Learns what table and object look like.

        Args:
            frame: the first; the object lies in it, seen whole.
            guess: (3,) its pose (x, y, theta), W, about, m and rad; None to search everywhere.

        Returns:
            The state before the first `track`, which may be of the same frame.

        Raises:
            PerceptionError: as `detect_object`; or the object that lies there does not have the outline.
        """
        raise NotImplementedError

    def track(
        self, state: TrackerState, frame: Frame, unseen: NDArray[np.bool_] | None = None
    ) -> tuple[TrackerState, TrackedPose]:
        """Finds the object in a frame.

        Args:
            state: after the frame before.
            frame: the next one.
            unseen: (height, width) bool, pixels of the frame which something covers, such as the arm; None where
                nothing is known to.

        Returns:
            The state after it, and the pose.

        Raises:
            ImageError: an image has another size than the camera.
        """
        raise NotImplementedError

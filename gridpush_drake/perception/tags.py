"""AprilTags of the family 36h11: found in a photograph, placed in the world, and aligned with an object's body."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.perception.camera import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DetectedTag:
    """A tag that was found.

    Attributes:
        id: its number in the family.
        corners: (4, 2) pixels of its black square, clockwise in the image from the tag's own upper left.
        X_CT: (4, 4) pose of the tag in the camera: x to the tag's right, y up, z out of its face; origin in its middle.
        X_WT: (4, 4) likewise in the world; None where the camera's pose is not known.
    """

    id: int
    corners: Array
    X_CT: Array
    X_WT: Array | None

    @property
    def planar_pose(self) -> Array:
        """(3,) pose (x, y, theta) of the tag in W, m and rad. Raises CameraError where X_WT is not known."""
        raise NotImplementedError


def detect_tags(gray: NDArray[np.uint8], camera: Camera, size: float) -> dict[int, DetectedTag]:
    """Finds the tags in a photograph.

    Args:
        gray: (height, width) uint8, or (height, width, 3) color.
        camera: that took it.
        size: side of a tag's black square, m.

    Returns:
        The tags by id.

    Raises:
        ImageError: the image has another size than the camera.
    """
    raise NotImplementedError


def solve_tag_to_body(tag: DetectedTag, X_WB: ArrayLike) -> Array:
    """The pose of a body in a tag that is fixed to it, from one photograph that shows the tag and told the body's pose.

    Args:
        tag: with X_WT.
        X_WB: (3,) the body's pose (x, y, theta), m and rad.

    Returns:
        (3,) the body's planar pose (x, y, theta) in the tag, X_TB: with a later tag,
        `geometry.compose(tag.planar_pose, X_TB)` is the body's pose.

    Raises:
        CameraError: the camera's pose is not known.
    """
    raise NotImplementedError

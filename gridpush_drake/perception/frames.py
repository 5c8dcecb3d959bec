"""What a camera gives: frames of color and depth, and the files they are read from."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.perception.camera import Camera

Color = NDArray[np.uint8]
Depth = NDArray[np.float32]


class Frame(NamedTuple):
    """One look.

    Attributes:
        color: (height, width, 3) uint8, red, green, blue.
        depth: (height, width) float32, m along the camera's z axis, registered to `color`; 0 or not finite where it was
            not measured; None without a depth camera.
        t: when it was taken, s.
    """

    color: Color
    depth: Depth | None
    t: float


def read_color(path: Path | str, camera: Camera) -> Color:
    """Reads a photograph.

    Args:
        path: PNG, JPEG or any other image that OpenCV reads.
        camera: that took it.

    Returns:
        (height, width, 3) uint8, red, green, blue.

    Raises:
        ImageError: the file cannot be read, is no image, or has another size than the camera.
    """
    raise NotImplementedError


def read_depth(path: Path | str, camera: Camera) -> Depth:
    """Reads a depth image: 16 bit PNG in mm, or 32 bit float TIFF or .npy in m.

    Args:
        path: the file.
        camera: that took it.

    Returns:
        (height, width) float32, m; 0 where it was not measured.

    Raises:
        ImageError: the file cannot be read, has another size than the camera, is of 8 bit or of several channels, or
            its unit is not the one expected.
    """
    raise NotImplementedError


def read_frames(path: Path | str, camera: Camera) -> Iterator[Frame]:
    """Reads a video, or a folder of images.

    Args:
        path: a video (its own frame rate is the clock), or a folder: NAME.png or NAME.jpg, or NAME_color.png with
            NAME_depth.png, in the order of their names; `times.csv` (name,t) gives their times.
        camera: that took them.

    Yields:
        The frames, in order of time.

    Raises:
        ImageError: there is no such video or folder, it is empty or cannot be read, times are missing or do not
            increase, or a frame has another size than the camera.
    """
    raise NotImplementedError

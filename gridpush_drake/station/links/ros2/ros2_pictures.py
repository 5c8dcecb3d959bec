"""A camera's pictures in the messages of ROS 2: `sensor_msgs/Image` and `CameraInfo`.

The functions read what any message of that form holds, and say what will not do. Nothing of ROS is
needed for it; topics are received and sent by `ros2.Ros2Link`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import ImageError
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.station.links.pixels import convert_depth, read_rows

COLOR = "camera/color/image_raw"
DEPTH = "camera/depth/image_raw"
CAMERA_INFO = "camera/color/camera_info"
"""Topics of a camera, relative names."""

COLOR_FORMS = {
    "rgb8": (3, (0, 1, 2)),
    "rgba8": (4, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "bgra8": (4, (2, 1, 0)),
}
"""Bytes a pixel, and where red, green and blue are, by an image's encoding."""

DEPTH_FORMS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
"""NumPy's name of a pixel's type, by a depth image's encoding: mm in 16 bit, m in 32 bit."""

FOCAL_TOLERANCE = 0.01
"""How far K in a camera's `CameraInfo` may differ from the scenario's, as a fraction of the focal
length."""


def read_color(message: Any) -> NDArray[np.uint8]:
    """The pixels (height, width, 3) of a `sensor_msgs/Image`.

    Raises:
        ImageError: its form will not do.
    """
    if message.encoding not in COLOR_FORMS:
        raise ImageError(
            f"{COLOR}: encoding is {message.encoding}; expected one of {', '.join(COLOR_FORMS)}"
        )
    count, order = COLOR_FORMS[message.encoding]
    return np.ascontiguousarray(_read_rows(COLOR, message, np.dtype("u1"), count)[..., order])


def read_depth(message: Any) -> NDArray[np.float32]:
    """The depth (height, width) in m of a `sensor_msgs/Image`; 0 where it is not known.

    Raises:
        ImageError: its form will not do.
    """
    if message.encoding not in DEPTH_FORMS:
        raise ImageError(
            f"{DEPTH}: encoding is {message.encoding}; expected one of {', '.join(DEPTH_FORMS)}"
        )
    kind = np.dtype(DEPTH_FORMS[message.encoding])
    return convert_depth(_read_rows(DEPTH, message, kind, 1)[..., 0])


def _read_rows(topic: str, message: Any, kind: np.dtype[Any], channels: int) -> NDArray[Any]:
    return read_rows(
        bytes(message.data),
        (message.height, message.width, channels),
        kind,
        step=message.step,
        big_endian=bool(message.is_bigendian),
        name=topic,
    )


def find_camera_fault(message: Any, camera: Camera | None) -> str:
    """Says how a `CameraInfo` differs from the scenario's camera; empty where it does not."""
    if camera is None:
        return ""
    if (message.width, message.height) != (camera.width, camera.height):
        return (
            f"{CAMERA_INFO}: the picture is {message.width} x {message.height} pixels; expected "
            f"{camera.width} x {camera.height}, as the scenario's camera.rgbd"
        )
    if np.any(np.asarray(message.d, float)):
        return f"{CAMERA_INFO}: d is not zero; expected pictures without distortion (image_rect)"
    K = np.asarray(message.k, float).reshape(3, 3)
    if np.abs(K - camera.K).max() > FOCAL_TOLERANCE * camera.K[0, 0]:
        fx, cx = float(K[0, 0]), float(K[0, 2])
        return (
            f"{CAMERA_INFO}: fx is {fx:.1f} and cx {cx:.1f}; expected {camera.K[0, 0]:.1f} and "
            f"{camera.K[0, 2]:.1f}, as the scenario's camera.rgbd"
        )
    return ""

"""Finds a camera's intrinsics and distortion from photographs of a printed board of tags.

It is for phones, webcams and industrial cameras, whose makers publish no intrinsics. Depth cameras
know theirs; `docs/howto/camera.md` says how to ask them. The method is Zhang's (2000), as OpenCV
has it: every photograph shows the same plane from another side, and the projections of its known
points determine the camera. From one side alone they do not; how well they do is told by the
standard deviations of the result.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import TagError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.calibration.tags import MIN_TAGS, TagBoard, find_tag_corners
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import COLOR_ENDINGS, Color, read_any_color

MIN_PHOTOS = 5
"""Least number of photographs that show the board well."""

MAX_FOCAL_DEVIATION = 0.01
"""Greatest standard deviation of the focal length, as a fraction of it."""

MIN_TILT = np.radians(20.0)
"""Two of the photographs at least must show the board from sides this far apart, rad: photographs
from one side cannot tell the focal length from the distance."""

MAX_CORNER_ERROR = 3.0
"""Greatest root mean square error of the corners in a photograph, pixels; beyond it the board is
another one, or not flat."""

DISTORTION_SIZE = 5
"""Number of distortion coefficients: k1, k2, p1, p2, k3."""

CALIBRATION_FLAGS = cv2.CALIB_FIX_K3
"""The sixth-order radial coefficient is held at 0: only very wide lenses need it."""


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """What photographs say of a camera.

    Attributes:
        camera: the camera; its pose is not known.
        error: root mean square error of all corners, pixels.
        focal_deviation: standard deviation of the focal length, as a fraction of it.
        used: names of the photographs that were used.
        unused: names of those in which too few tags were found.
    """

    camera: Camera
    error: float
    focal_deviation: float
    used: tuple[str, ...]
    unused: tuple[str, ...]


def read_photographs(folder: Path) -> list[tuple[str, Color]]:
    """Reads all photographs in a folder, by name.

    Raises:
        ImageError: there is none, or one cannot be read.
    """
    files = []
    if folder.is_dir():
        files = [path for path in folder.iterdir() if path.suffix.lower() in COLOR_ENDINGS]
    if not files:
        raise TagError(
            f"{folder}: holds no photographs; expected a folder with at least {MIN_PHOTOS}, "
            f"{', '.join(COLOR_ENDINGS)}"
        )
    return [(str(path), read_any_color(path)) for path in sorted(files)]


def calibrate_intrinsics(
    photographs: Sequence[tuple[str, NDArray[np.uint8]]], board: TagBoard
) -> Intrinsics:
    """Finds a camera's intrinsics and distortion.

    Args:
        photographs: names, and pictures (height, width, 3) or (height, width) uint8, all of one
            camera, with the same zoom and focus.
        board: the board that is in all of them; nothing but it needs to be there.

    Returns:
        The camera, and how well it is known.

    Raises:
        TagError: pictures are of different sizes, fewer than MIN_PHOTOS show MIN_TAGS of the
            board's tags, the corners do not lie as on the board, or the board was seen from too few
            sides.
    """
    known = board.corners
    size: tuple[int, int] | None = None
    used: list[str] = []
    unused: list[str] = []
    places: list[Array] = []
    pixels: list[Array] = []
    for name, picture in photographs:
        height, width = picture.shape[:2]
        if size is None:
            size = (width, height)
        if (width, height) != size:
            raise TagError(
                f"{name}: is {width} x {height} pixels; expected {size[0]} x {size[1]}, as the "
                "first photograph"
            )
        found = find_tag_corners(picture)
        common = sorted(found.keys() & known.keys())
        if len(common) < MIN_TAGS:
            unused.append(name)
            continue
        used.append(name)
        places.append(np.concatenate([known[tag] for tag in common]).astype(np.float32))
        pixels.append(np.concatenate([found[tag] for tag in common]).astype(np.float32))
    if size is None or len(used) < MIN_PHOTOS:
        raise TagError(
            f"{len(used)} of {len(photographs)} photographs show at least {MIN_TAGS} of the "
            f"board's tags ({board.first} to {max(known)}); expected {MIN_PHOTOS}"
        )

    # OpenCV's own first guess, and Levenberg and Marquardt's method from there.
    error, K, distortion, turns, _, deviations, _, errors = cv2.calibrateCameraExtended(
        places, pixels, size, np.eye(3), np.zeros(DISTORTION_SIZE), flags=CALIBRATION_FLAGS
    )

    # A sheet at another scale does no harm here, but one that is bent, or another board, shows.
    worst = int(np.argmax(errors))
    if not float(errors[worst, 0]) <= MAX_CORNER_ERROR:
        raise TagError(
            f"{used[worst]}: the tags' corners are {float(errors[worst, 0]):.1f} pixels from where "
            f"the board would have them; expected at most {MAX_CORNER_ERROR:g}: check --board, and "
            "that the sheet is flat"
        )
    advice = "take photographs in which the board is tilted by 30 to 60 degrees, to all sides"
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    tilt = float(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max())
    if tilt < MIN_TILT:
        raise TagError(
            f"the photographs show the board from sides at most {np.degrees(tilt):.0f} degrees "
            f"apart; expected {np.degrees(MIN_TILT):.0f}: {advice}"
        )
    focal_deviation = float(max(deviations[0, 0] / K[0, 0], deviations[1, 0] / K[1, 1]))
    if not focal_deviation <= MAX_FOCAL_DEVIATION:
        raise TagError(
            f"the focal length is known to {100 * focal_deviation:.1f} % only; expected "
            f"{100 * MAX_FOCAL_DEVIATION:g} %: {advice}"
        )
    camera = Camera(
        width=size[0],
        height=size[1],
        K=np.asarray(K, dtype=np.float64),
        distortion=np.asarray(distortion, dtype=np.float64).ravel(),
    )
    return Intrinsics(camera, float(error), focal_deviation, tuple(used), tuple(unused))

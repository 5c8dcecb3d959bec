"""What a camera gives: frames of color and depth, and the files they are read from."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import ImageError
from gridpush_drake.files import MEGABYTE, is_file, read_bytes, read_text, write_whole
from gridpush_drake.perception.camera import Camera

Color = NDArray[np.uint8]
Depth = NDArray[np.float32]

MAX_IMAGE_SIZE = 256 * MEGABYTE
"""Of an image file, bytes."""

MILLIMETERS = 1e3
"""In a meter."""

MIN_DEPTH, MAX_DEPTH = 0.05, 20.0
"""m, of a depth image's median; beyond, its unit is another."""

MIN_MEASURED = 0.01
"""Least share of a depth image that must be measured."""

COLOR_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
COLOR_MARK, DEPTH_MARK = "_color", "_depth"
"""At the end of a file's name in a folder of frames, before the ending."""

TIMES = "times.csv"
TIMES_FORM = "lines NAME,t after the line name,t"


class Frame(NamedTuple):
    """One look.

    Attributes:
        color: (height, width, 3) uint8, red, green, blue.
        depth: (height, width) float32, m along the camera's z axis, registered to `color`; 0 or not
            finite where it was not measured; None without a depth camera.
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
    image = _decode(path, "a photograph", cv2.IMREAD_COLOR)
    _check_size(path, camera, image)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))


def read_depth(path: Path | str, camera: Camera) -> Depth:
    """Reads a depth image: 16 bit in mm (PNG), or 32 bit float in m (TIFF, EXR).

    Args:
        path: the file.
        camera: that took it.

    Returns:
        (height, width) float32, m; 0 where it was not measured.

    Raises:
        ImageError: the file cannot be read, has another size than the camera, is of 8 bit or of
            several channels, or its unit is not the one expected.
    """
    image = _decode(path, "a depth image", cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype not in (np.uint16, np.float32):
        found = f"{1 if image.ndim == 2 else image.shape[2]} channels of {image.dtype}"
        raise ImageError(
            f"{path}: has {found}; expected a depth image: 16 bit in mm, or 32 bit float in m"
        )
    _check_size(path, camera, image)
    scale, unit = (MILLIMETERS, "mm") if image.dtype == np.uint16 else (1.0, "m")
    depth = np.nan_to_num(image.astype(np.float32) / np.float32(scale), posinf=0.0, neginf=0.0)
    measured = depth[depth > 0]
    if len(measured) < MIN_MEASURED * depth.size:
        raise ImageError(
            f"{path}: is measured in {len(measured) / depth.size:.1%} of its pixels; expected a depth image"
        )
    median = float(np.median(measured)) * scale
    if not MIN_DEPTH * scale <= median <= MAX_DEPTH * scale:
        low, high = MIN_DEPTH * scale, MAX_DEPTH * scale
        raise ImageError(f"{path}: its median is {median:g}; expected {unit}, {low:g} to {high:g}")
    return depth


def read_frames(path: Path | str, camera: Camera) -> Iterator[Frame]:
    """Reads a video, or a folder of images.

    Args:
        path: a video (its own frame rate is the clock), or a folder: NAME.png or NAME.jpg, or
            NAME_color.png with NAME_depth.png, in the order of their names; `times.csv` (name,t)
            gives their times, s.
        camera: that took them.

    Yields:
        The frames, in order of time.

    Raises:
        ImageError: there is no such video or folder, it is empty or cannot be read, times are
            missing or do not increase, or a frame has another size than the camera.
    """
    path = Path(path)
    return _read_folder(path, camera) if path.is_dir() else _read_video(path, camera)


def write_picture(path: Path | str, picture: Color, force: bool = False) -> None:
    """Writes a picture (height, width, 3) uint8 as PNG. Raises OutputError as `write_whole`."""
    done, data = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    assert done
    write_whole(path, data.tobytes(), force)


def _decode(path: Path | str, what: str, flags: int) -> NDArray[Any]:
    data = np.frombuffer(read_bytes(path, what, ImageError, MAX_IMAGE_SIZE), np.uint8)
    try:
        image = cv2.imdecode(data, flags) if len(data) else None
    except cv2.error:
        image = None
    if image is None:
        raise ImageError(
            f"{path}: is no image that can be read; expected {what}, such as a PNG file"
        )
    return np.asarray(image)


def _check_size(path: Path | str, camera: Camera, image: NDArray[Any]) -> None:
    try:
        camera.check_size(image)
    except ImageError as error:
        raise ImageError(f"{path}: {error}") from error


def _read_video(path: Path, camera: Camera) -> Iterator[Frame]:
    if not is_file(path):
        raise ImageError(
            f"{path}: cannot be read: no such file; expected a video, or a folder of images"
        )
    video = cv2.VideoCapture(str(path))
    try:
        rate = video.get(cv2.CAP_PROP_FPS) if video.isOpened() else 0.0
        count = 0
        while rate > 0:
            there, image = video.read()
            if not there:
                break
            _check_size(path, camera, image)
            yield Frame(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB)), None, count / rate)
            count += 1
        if not count:
            raise ImageError(
                f"{path}: no frame can be read; expected a video, or a folder of images"
            )
    finally:
        video.release()


def _read_folder(path: Path, camera: Camera) -> Iterator[Frame]:
    images = sorted(
        p
        for p in path.iterdir()
        if p.suffix.lower() in COLOR_ENDINGS and not p.stem.endswith(DEPTH_MARK)
    )
    if not images:
        raise ImageError(
            f"{path}: holds no images; expected NAME.png, or NAME_color.png and NAME_depth.png"
        )
    times = _read_times(path / TIMES)
    before = -math.inf
    for image in images:
        name = image.stem.removesuffix(COLOR_MARK)
        if name not in times:
            raise ImageError(
                f"{path / TIMES}: has no line for {name}; expected {TIMES_FORM}, one for each image"
            )
        if not times[name] > before:
            raise ImageError(
                f"{path / TIMES}: {name} is at {times[name]} s, not later than the image before it"
            )
        before = times[name]
        depth = image.with_name(f"{name}{DEPTH_MARK}.png")
        yield Frame(
            read_color(image, camera), read_depth(depth, camera) if is_file(depth) else None, before
        )


def _read_times(path: Path) -> dict[str, float]:
    rows = list(
        csv.reader(read_text(path, f"the images' times: {TIMES_FORM}", ImageError).splitlines())
    )
    times = {}
    for line, row in enumerate(rows[1:], start=2):
        try:
            name, text = row
            times[Path(name.strip()).stem.removesuffix(COLOR_MARK)] = float(text)
        except ValueError:
            raise ImageError(
                f"{path}, line {line}: is {','.join(row)!r}; expected {TIMES_FORM}"
            ) from None
    return times

"""What a camera gives: frames of color and depth, and the files they are read from.

How the camera sees is in `camera`; nothing here takes distortion out of an image.
"""

import csv
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from gridpush_drake.errors import ImageError
from gridpush_drake.files import is_file, read_bytes, read_text, write_whole
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.units import BYTES_PER_MEGABYTE, MM_PER_M

Color = NDArray[np.uint8]
"""A color image (height, width, 3): red, green, blue."""

Depth = NDArray[np.float32]
"""A depth image (height, width), m; 0 where it was not measured."""

Mask = NDArray[np.bool_]
"""Which pixels (height, width) of an image are meant."""

MAX_IMAGE_SIZE = 256 * BYTES_PER_MEGABYTE
"""Largest image file that is read, bytes; a larger one is refused before it fills the memory."""

FILM_DIAGONAL = 43.267
"""Diagonal of a picture on 35 mm film, mm, to which EXIF's equivalent focal lengths refer."""


MIN_DEPTH = 0.05
"""Least median of a depth image, m; with less its unit is taken to be another."""

MAX_DEPTH = 20.0
"""Greatest median of a depth image, m; with more its unit is taken to be another."""

MIN_MEASURED = 0.01
"""Least fraction of a depth image that must be measured; with less it is taken for something
else."""

COLOR_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
"""Endings of the files in a folder of frames that are taken for images; others are left alone."""

COLOR_MARK = "_color"
"""End of the name of a color image in a folder of frames, before the ending; may be left out."""

DEPTH_MARK = "_depth"
"""End of the name of a depth image in a folder of frames, before the ending."""

TIMES_FILE = "times.csv"
"""Name of the file in a folder of frames that says when each was taken."""

TIMES_FORM = "lines NAME,t after the line name,t"
"""Form of that file, in messages."""


class Frame(NamedTuple):
    """The images of one moment.

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
        camera: camera that took it.

    Returns:
        (height, width, 3) uint8, red, green, blue.

    Raises:
        ImageError: the file cannot be read, is no image, or has another size than the camera.
    """
    image = read_any_color(path)
    _check_size(path, camera, image)
    return image


def read_any_color(path: Path | str) -> Color:
    """Reads a photograph of a camera that is not known yet; see `read_color`."""
    image = _decode(path, "a photograph", cv2.IMREAD_COLOR)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))


def read_focal_length(path: Path | str) -> float | None:
    """Reads a photograph's focal length from its EXIF data, where phones and cameras write it.

    Args:
        path: the file of the photograph, as it was taken: neither cropped nor straightened.

    Returns:
        The focal length, pixels; None if the file does not say it.
    """
    try:
        with Image.open(path) as image:
            length = (
                image.getexif().get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm)
            )
            diagonal = math.hypot(*image.size)
    except (OSError, ValueError, SyntaxError):
        return None
    if not isinstance(length, int) or length <= 0:
        return None
    return length / FILM_DIAGONAL * diagonal


def read_depth(path: Path | str, camera: Camera) -> Depth:
    """Reads a depth image: 16 bit in mm (PNG), or 32 bit float in m (TIFF, EXR).

    Args:
        path: the file.
        camera: camera that took it.

    Returns:
        (height, width) float32, m; 0 where it was not measured.

    Raises:
        ImageError: the file cannot be read, has another size than the camera, is of 8 bit or of
            several channels, or its unit is not the one expected.
    """
    image = _decode(path, "a depth image", cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype not in (np.uint16, np.float32):
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise ImageError(
            f"{path}: has {channels} channels of {image.dtype}; expected a depth image: 16 bit in"
            " mm, or 32 bit float in m"
        )
    _check_size(path, camera, image)

    # Whole numbers are millimeters, as depth cameras write them.
    if image.dtype == np.uint16:
        scale = MM_PER_M
        unit = "mm"
    else:
        scale = 1.0
        unit = "m"
    meters = image.astype(np.float32) / np.float32(scale)
    depth = np.nan_to_num(meters, posinf=0.0, neginf=0.0)

    # An image of another kind or unit would give poses that are wrong in silence.
    measured = depth[depth > 0]
    if len(measured) < MIN_MEASURED * depth.size:
        fraction = len(measured) / depth.size
        raise ImageError(
            f"{path}: is measured in {fraction:.1%} of its pixels; expected a depth image"
        )
    median = float(np.median(measured)) * scale
    low = MIN_DEPTH * scale
    high = MAX_DEPTH * scale
    if not low <= median <= high:
        raise ImageError(f"{path}: its median is {median:g}; expected {unit}, {low:g} to {high:g}")
    return depth


def read_mask(path: Path | str, camera: Camera) -> NDArray[np.bool_]:
    """Reads a mask: an image whose pixels are 0, or black, where the object is not.

    Args:
        path: PNG or any other image that OpenCV reads, of any number of channels; an alpha channel
            is not looked at.
        camera: camera that took the photograph that the mask is of.

    Returns:
        (height, width) bool, True where the object is.

    Raises:
        ImageError: the file cannot be read, is no image, or has another size than the camera.
    """
    what = "a mask (an image that is black where the object is not)"
    image = _decode(path, what, cv2.IMREAD_UNCHANGED)
    _check_size(path, camera, image)
    if image.ndim == 2:
        return np.asarray(image > 0)
    colors = image[..., :3] if image.shape[2] > 2 else image[..., :1]
    return np.asarray((colors > 0).any(axis=2))


def read_frames(path: Path | str, camera: Camera) -> Iterator[Frame]:
    """Reads a video, or a folder of images.

    Args:
        path: a video (its own frame rate is the clock), or a folder: NAME.png or NAME.jpg, or
            NAME_color.png with NAME_depth.png, in the order of their names; `times.csv` (name,t)
            gives their times, s.
        camera: camera that took them.

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
    """Reads an image file by OpenCV; `what` is expected, in messages."""
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
    """Raises ImageError, with the file's name, where an image has another size than the camera."""
    try:
        camera.check_size(image)
    except ImageError as error:
        raise ImageError(f"{path}: {error}") from error


def _read_video(path: Path, camera: Camera) -> Iterator[Frame]:
    """Reads the frames of a video, whose frame rate is the clock; see `read_frames`."""
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
            color = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)
            yield Frame(color=color, depth=None, t=count / rate)
            count += 1
        if not count:
            raise ImageError(
                f"{path}: no frame can be read; expected a video, or a folder of images"
            )
    finally:
        video.release()


def _read_folder(path: Path, camera: Camera) -> Iterator[Frame]:
    """Reads the frames of a folder of images, in the order of their names; see `read_frames`."""
    images = sorted(
        p
        for p in path.iterdir()
        if p.suffix.lower() in COLOR_ENDINGS and not p.stem.endswith(DEPTH_MARK)
    )
    if not images:
        raise ImageError(
            f"{path}: holds no images; expected NAME.png, or NAME_color.png and NAME_depth.png"
        )
    times = _read_times(path / TIMES_FILE)
    before = -math.inf
    for image in images:
        name = image.stem.removesuffix(COLOR_MARK)
        if name not in times:
            raise ImageError(
                f"{path / TIMES_FILE}: has no line for {name}; expected {TIMES_FORM}, one for "
                "each image"
            )
        if not times[name] > before:
            raise ImageError(
                f"{path / TIMES_FILE}: {name} is at {times[name]} s, not later than the image "
                "before it"
            )
        before = times[name]
        color = read_color(image, camera)
        depth = None
        depth_file = image.with_name(f"{name}{DEPTH_MARK}.png")
        if is_file(depth_file):
            depth = read_depth(depth_file, camera)
        yield Frame(color=color, depth=depth, t=before)


def _read_times(path: Path) -> dict[str, float]:
    """Reads when each image of a folder was taken, s, by the image's name without its mark."""
    text = read_text(path, f"the images' times: {TIMES_FORM}", ImageError)
    rows = list(csv.reader(text.splitlines()))
    times = {}
    for line, row in enumerate(rows[1:], start=2):
        try:
            name, time = row
            times[Path(name.strip()).stem.removesuffix(COLOR_MARK)] = float(time)
        except ValueError:
            raise ImageError(
                f"{path}, line {line}: is {','.join(row)!r}; expected {TIMES_FORM}"
            ) from None
    return times

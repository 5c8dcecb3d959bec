"""Color and depth pictures as Drake's LCM message `lcmt_image_array`: made of a frame, and read.

Drake's own `LcmImageArrayToImages` is not used, for it reads neither JPEG nor PNG. Without these, a
raw or zlib-compressed pair of 640 x 480 pixels is too large for the buffers that a computer has for
LCM's UDP by default. Messages of any camera's driver are read, in all forms that Drake defines.
"""

import warnings
import zlib
from io import BytesIO
from typing import Any

import cv2
import numpy as np
from drake import lcmt_header, lcmt_image, lcmt_image_array
from numpy.typing import NDArray
from PIL import Image

from gridpush_drake.errors import ImageError
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Color, Depth, Frame
from gridpush_drake.station.links.lcm.lcm_messages import MICROSECONDS, calc_utime
from gridpush_drake.station.links.pixels import convert_depth, read_rows
from gridpush_drake.units import MM_PER_M

JPEG_QUALITY = 95
"""Quality of the color pictures that are sent, 0 to 100."""

PNG_LEVEL = 3
"""Level of compression of the depth pictures that are sent, 0 to 9."""

MAX_DEPTH = 2**16 - 1
"""Greatest depth that 16 bit hold, mm."""

CHANNELS = {
    lcmt_image.PIXEL_FORMAT_RGB: (3, [0, 1, 2]),
    lcmt_image.PIXEL_FORMAT_RGBA: (4, [0, 1, 2]),
    lcmt_image.PIXEL_FORMAT_BGR: (3, [2, 1, 0]),
    lcmt_image.PIXEL_FORMAT_BGRA: (4, [2, 1, 0]),
}
"""The number of values of a pixel, and the places of red, green and blue, for each color format."""

DEPTHS = {lcmt_image.CHANNEL_TYPE_UINT16: "u2", lcmt_image.CHANNEL_TYPE_FLOAT32: "f4"}
"""NumPy's names of the types in which depth may come: mm in 16 bit, m in 32 bit."""

FILES = {lcmt_image.COMPRESSION_METHOD_JPEG: "JPEG", lcmt_image.COMPRESSION_METHOD_PNG: "PNG"}
"""Pillow's names of the kinds of image files that an image's `data` may be."""

EXPECTED = (
    "expected a color image (RGB, RGBA, BGR or BGRA of 8 bit) "
    "and none or one of depth (16 bit, mm, or 32, m)"
)
"""What a message should hold, in an error's words."""

JPEG_OPTIONS = [
    cv2.IMWRITE_JPEG_QUALITY,
    JPEG_QUALITY,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
]
"""OpenCV's options for a color picture, in pairs of name and value. Colors have the full
resolution: a tag's or an object's edge is found in them."""


def encode_frame(frame: Frame, count: int = 0) -> lcmt_image_array:
    """Makes a message of a frame: color as JPEG, depth as PNG of 16 bit, mm.

    Args:
        frame: color, with or without depth, and the time when it was taken.
        count: number of frames before it.

    Returns:
        The message. Its `utime`, and that of each image, is the frame's time.
    """
    header = lcmt_header()
    header.utime = calc_utime(frame.t)
    header.seq = count
    bgr = cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR)
    data = _encode(".jpg", bgr, JPEG_OPTIONS)
    images = [_make_image(header, frame.color, data, lcmt_image.COMPRESSION_METHOD_JPEG)]
    if frame.depth is not None:
        meters = np.nan_to_num(frame.depth, nan=0.0, posinf=0.0, neginf=0.0)
        depth = np.clip(np.rint(MM_PER_M * meters), 0, MAX_DEPTH).astype(np.uint16)
        data = _encode(".png", depth, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
        images.append(_make_image(header, depth, data, lcmt_image.COMPRESSION_METHOD_PNG))
    message = lcmt_image_array()
    message.header = header
    message.num_images = len(images)
    message.images = images
    return message


def decode_frame(message: lcmt_image_array, camera: Camera) -> Frame:
    """Makes a frame of a message's color and depth; other images, such as labels, are ignored.

    Args:
        message: the message; its images are raw, or compressed as zlib, JPEG or PNG.
        camera: the camera that took them.

    Returns:
        The frame; its time is that of the color image.

    Raises:
        ImageError: there is no color image, or two; one has another size than the camera, is
            shorter than it says, or is in a form that nobody knows.
    """
    colors = [image for image in message.images if image.pixel_format in CHANNELS]
    depths = [
        image for image in message.images if image.pixel_format == lcmt_image.PIXEL_FORMAT_DEPTH
    ]
    if len(colors) != 1 or len(depths) > 1:
        raise ImageError(
            f"the message has {len(colors)} color and {len(depths)} depth images; {EXPECTED}"
        )
    color = _decode_color(colors[0], camera)
    depth = _decode_depth(depths[0], camera) if depths else None
    # Some drivers leave the images' own headers empty.
    utime = colors[0].header.utime or message.header.utime
    return Frame(color, depth, utime / MICROSECONDS)


def _make_image(header: lcmt_header, pixels: NDArray[Any], data: bytes, method: int) -> lcmt_image:
    """Makes one image of a message of its compressed data.

    Args:
        header: its header.
        pixels: color (height, width, 3) of 8 bit, or depth (height, width) of 16 bit.
        data: the pixels, compressed.
        method: how they are compressed.
    """
    image = lcmt_image()
    image.header = header
    image.height, image.width = pixels.shape[:2]
    image.row_stride = pixels.strides[0]
    image.size = len(data)
    image.data = data
    image.compression_method = method
    if pixels.ndim > 2:
        image.pixel_format = lcmt_image.PIXEL_FORMAT_RGB
        image.channel_type = lcmt_image.CHANNEL_TYPE_UINT8
    else:
        image.pixel_format = lcmt_image.PIXEL_FORMAT_DEPTH
        image.channel_type = lcmt_image.CHANNEL_TYPE_UINT16
    return image


def _encode(ending: str, pixels: NDArray[Any], options: list[int]) -> bytes:
    """Compresses pixels as the file of an ending would hold them."""
    done, data = cv2.imencode(ending, pixels, options)
    assert done
    return bytes(data.tobytes())


def _decode_color(image: lcmt_image, camera: Camera) -> Color:
    """Reads a color image of a message; raises ImageError where that cannot be done."""
    if image.channel_type != lcmt_image.CHANNEL_TYPE_UINT8:
        raise ImageError(f"the color image's channel_type is {image.channel_type}; {EXPECTED}")
    if image.compression_method in FILES:
        read = _read_file(image, "color", camera, cv2.IMREAD_COLOR)
        return np.asarray(cv2.cvtColor(read, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    count, order = CHANNELS[image.pixel_format]
    return np.ascontiguousarray(
        _read_rows(image, "color", camera, np.dtype("u1"), count)[..., order]
    )


def _decode_depth(image: lcmt_image, camera: Camera) -> Depth:
    """Reads a depth image of a message, in m; raises ImageError where that cannot be done."""
    if image.channel_type not in DEPTHS:
        raise ImageError(f"the depth image's channel_type is {image.channel_type}; {EXPECTED}")
    kind = np.dtype(DEPTHS[image.channel_type])
    if image.compression_method in FILES:
        pixels = _read_file(image, "depth", camera, cv2.IMREAD_UNCHANGED)
        if pixels.ndim != 2 or pixels.dtype != kind:
            raise ImageError(
                f"the depth image's file holds {pixels.dtype} in shape {pixels.shape}; "
                f"expected {kind}"
            )
    else:
        pixels = _read_rows(image, "depth", camera, kind, 1)[..., 0]
    return convert_depth(pixels)


def _read_file(image: lcmt_image, what: str, camera: Camera, flags: int) -> NDArray[Any]:
    """Decodes the image file that an image's data are.

    Its size is read first: a small file may unpack to more than the memory holds.
    """
    kind = FILES[image.compression_method]
    try:
        with warnings.catch_warnings():
            # A size that Pillow warns of is refused below.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            size = Image.open(BytesIO(image.data), formats=[kind]).size
    except Exception as error:  # whatever Pillow makes of the bytes
        raise ImageError(f"the {what} image's data are no {kind} file") from error
    _check_size(size, what, camera)
    try:
        pixels = cv2.imdecode(np.frombuffer(image.data, np.uint8), flags)
    except cv2.error as error:
        raise ImageError(f"the {what} image's data are no whole {kind} file") from error
    if pixels is None:
        raise ImageError(f"the {what} image's data are no whole {kind} file")
    return np.asarray(pixels)


def _read_rows(
    image: lcmt_image, what: str, camera: Camera, kind: np.dtype[Any], channels: int
) -> NDArray[Any]:
    """Reads the pixels (height, width, channels) of data that are raw, or compressed by zlib."""
    _check_size((image.width, image.height), what, camera)
    used = image.width * channels * kind.itemsize
    stride = image.row_stride or used
    data = bytes(image.data)
    if image.compression_method == lcmt_image.COMPRESSION_METHOD_ZLIB:
        try:
            # One byte more than expected is enough to tell that there are too many.
            data = zlib.decompressobj().decompress(data, image.height * stride + 1)
        except zlib.error as error:
            raise ImageError(f"the {what} image's data are not compressed by zlib") from error
    elif image.compression_method != lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED:
        raise ImageError(
            f"the {what} image's compression_method is {image.compression_method}; expected 0 to 3"
        )
    return read_rows(
        data,
        (image.height, image.width, channels),
        kind,
        step=stride,
        big_endian=bool(image.bigendian),
        name=f"the {what} image",
    )


def _check_size(size: tuple[int, int], what: str, camera: Camera) -> None:
    """Checks that an image, (width, height), is as large as its camera's."""
    if size != (camera.width, camera.height):
        width, height = size
        raise ImageError(
            f"the {what} image is {width} x {height} pixels; "
            f"expected {camera.width} x {camera.height}, as the camera's"
        )

"""Color and depth pictures as Drake's LCM message `lcmt_image_array`, of whatever camera says them.

Drake's own `LcmImageArrayToImages` knows neither JPEG nor PNG, and a raw or zlib-compressed pair of
640 x 480 pixels is too large for the buffers that a computer has for LCM's UDP by default.
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
from gridpush_drake.perception.camera import Camera
from gridpush_drake.perception.frames import MILLIMETERS, Color, Depth, Frame
from gridpush_drake.systems.planar_manipuland_status import MICROSECONDS

JPEG_QUALITY = 95
"""Quality of the color pictures that are sent, 0 to 100."""

PNG_LEVEL = 3
"""Level of compression of the depth pictures that are sent, 0 to 9."""

MAX_DEPTH = 2**16 - 1
"""Greatest depth that 16 bit hold, mm."""

FARTHEST = 1e3
"""Greatest depth that counts as measured, m; beyond it, and below 0, the depth of a pixel is not known."""

CHANNELS = {
    lcmt_image.PIXEL_FORMAT_RGB: (3, [0, 1, 2]),
    lcmt_image.PIXEL_FORMAT_RGBA: (4, [0, 1, 2]),
    lcmt_image.PIXEL_FORMAT_BGR: (3, [2, 1, 0]),
    lcmt_image.PIXEL_FORMAT_BGRA: (4, [2, 1, 0]),
}
"""How many values a pixel has, and where red, green and blue are, by the formats of colors."""

DEPTHS = {lcmt_image.CHANNEL_TYPE_UINT16: "u2", lcmt_image.CHANNEL_TYPE_FLOAT32: "f4"}
"""NumPy's names of the types that depth comes in: mm in 16 bit, m in 32."""

FILES = {lcmt_image.COMPRESSION_METHOD_JPEG: "JPEG", lcmt_image.COMPRESSION_METHOD_PNG: "PNG"}
"""What `data` is where it is an image file, as Pillow names it."""

EXPECTED = "expected a color image (RGB, RGBA, BGR or BGRA of 8 bit) and none or one of depth (16 bit, mm, or 32, m)"


def encode_frame(frame: Frame, count: int = 0) -> lcmt_image_array:
    """Makes a message of a frame: color as JPEG, depth as PNG of 16 bit, mm.

    Args:
        frame: color, with depth or not, and when it was taken.
        count: of the frames before it.

    Returns:
        The message; its `utime`, and that of each image, is the frame's time.
    """
    header = lcmt_header()
    header.utime, header.seq = round(MICROSECONDS * frame.t), count
    bgr = cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR)
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
               cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]  # fmt: skip
    images = [
        _make_image(
            header, frame.color, _encode(".jpg", bgr, options), lcmt_image.COMPRESSION_METHOD_JPEG
        )
    ]
    if frame.depth is not None:
        meters = np.nan_to_num(frame.depth, nan=0.0, posinf=0.0, neginf=0.0)
        depth = np.clip(np.rint(MILLIMETERS * meters), 0, MAX_DEPTH).astype(np.uint16)
        data = _encode(".png", depth, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
        images.append(_make_image(header, depth, data, lcmt_image.COMPRESSION_METHOD_PNG))
    message = lcmt_image_array()
    message.header, message.num_images, message.images = header, len(images), images
    return message


def decode_frame(message: lcmt_image_array, camera: Camera) -> Frame:
    """Makes a frame of a message; labels and what else is in it are left out.

    Args:
        message: raw, or compressed as zlib, JPEG or PNG.
        camera: that took it.

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
    return Frame(color, depth, (colors[0].header.utime or message.header.utime) / MICROSECONDS)


def _make_image(header: lcmt_header, pixels: NDArray[Any], data: bytes, method: int) -> lcmt_image:
    image = lcmt_image()
    image.header, image.height, image.width = header, *pixels.shape[:2]
    image.row_stride = pixels.strides[0]
    image.size, image.data, image.compression_method = len(data), data, method
    is_color = pixels.ndim > 2
    image.pixel_format = lcmt_image.PIXEL_FORMAT_RGB if is_color else lcmt_image.PIXEL_FORMAT_DEPTH
    image.channel_type = (
        lcmt_image.CHANNEL_TYPE_UINT8 if is_color else lcmt_image.CHANNEL_TYPE_UINT16
    )
    return image


def _encode(ending: str, pixels: NDArray[Any], options: list[int]) -> bytes:
    done, data = cv2.imencode(ending, pixels, options)
    assert done
    return bytes(data.tobytes())


def _decode_color(image: lcmt_image, camera: Camera) -> Color:
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
    if image.channel_type not in DEPTHS:
        raise ImageError(f"the depth image's channel_type is {image.channel_type}; {EXPECTED}")
    kind = np.dtype(DEPTHS[image.channel_type])
    if image.compression_method in FILES:
        pixels = _read_file(image, "depth", camera, cv2.IMREAD_UNCHANGED)
        if pixels.ndim != 2 or pixels.dtype != kind:
            raise ImageError(
                f"the depth image's file holds {pixels.dtype} in shape {pixels.shape}; expected {kind}"
            )
    else:
        pixels = _read_rows(image, "depth", camera, kind, 1)[..., 0]
    meters = pixels / MILLIMETERS if kind.kind == "u" else pixels
    known = (meters >= 0) & (meters <= FARTHEST)  # false for NaN
    return np.where(known, meters, 0.0).astype(np.float32)


def _read_file(image: lcmt_image, what: str, camera: Camera, flags: int) -> NDArray[Any]:
    """Decodes an image file, whose size is looked at first."""
    kind = FILES[image.compression_method]
    try:
        with warnings.catch_warnings():
            # a size that Pillow warns of is refused below
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
    """The pixels (height, width, channels) of data that are raw, or raw but for zlib."""
    _check_size((image.width, image.height), what, camera)
    used = image.width * channels * kind.itemsize
    stride = image.row_stride or used
    data = bytes(image.data)
    if image.compression_method == lcmt_image.COMPRESSION_METHOD_ZLIB:
        try:
            data = zlib.decompressobj().decompress(data, image.height * stride + 1)
        except zlib.error as error:
            raise ImageError(f"the {what} image's data are not compressed by zlib") from error
    elif image.compression_method != lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED:
        raise ImageError(
            f"the {what} image's compression_method is {image.compression_method}; expected 0 to 3"
        )
    if stride < used or len(data) != image.height * stride:
        raise ImageError(
            f"the {what} image has {len(data)} bytes in rows of {stride}; "
            f"expected {image.height} rows of at least {used}"
        )
    rows = np.frombuffer(data, np.uint8).reshape(image.height, stride)[:, :used]
    sent = kind.newbyteorder(">" if image.bigendian else "<")
    pixels = np.ascontiguousarray(rows).view(sent).astype(kind)
    return pixels.reshape(image.height, image.width, channels)


def _check_size(size: tuple[int, int], what: str, camera: Camera) -> None:
    if size != (camera.width, camera.height):
        width, height = size
        raise ImageError(
            f"the {what} image is {width} x {height} pixels; expected {camera.width} x {camera.height}, as the camera's"
        )

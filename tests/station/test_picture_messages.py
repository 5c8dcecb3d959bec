import zlib

import cv2
import numpy as np
import pytest
from drake import lcmt_image, lcmt_image_array

from gridpush_drake.errors import ImageError
from gridpush_drake.perception import Camera, Frame
from gridpush_drake.station.links.lcm.picture_messages import decode_frame, encode_frame

WIDTH, HEIGHT = 64, 48
CAMERA = Camera(WIDTH, HEIGHT, np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.zeros(0))


def make_frame(depth=True):
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    color = np.stack([2 * x + 40, 3 * y + 50, 200 - x], axis=-1).astype(np.uint8)
    z = (0.7 + 0.001 * x + 0.00013 * y).astype(np.float32)
    z[3:6, 4:9] = 0.0
    return Frame(color, z if depth else None, 12.345)


def make_image(pixels, pixel_format, channel_type, method=0, data=None, bigendian=False, pad=0):
    image = lcmt_image()
    image.header.utime = 12_345_000
    image.height, image.width = pixels.shape[:2]
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(HEIGHT, -1)
    rows = np.hstack([rows, np.full((HEIGHT, pad), 7, np.uint8)])
    image.row_stride, image.bigendian = rows.shape[1], bigendian
    image.data = rows.tobytes() if data is None else data
    image.size, image.pixel_format = len(image.data), pixel_format
    image.channel_type, image.compression_method = channel_type, method
    return image


def make_message(*images):
    message = lcmt_image_array()
    message.num_images, message.images = len(images), list(images)
    return lcmt_image_array.decode(message.encode())


RGB = (lcmt_image.PIXEL_FORMAT_RGB, lcmt_image.CHANNEL_TYPE_UINT8)
METERS = (lcmt_image.PIXEL_FORMAT_DEPTH, lcmt_image.CHANNEL_TYPE_FLOAT32)
MILLIMETERS = (lcmt_image.PIXEL_FORMAT_DEPTH, lcmt_image.CHANNEL_TYPE_UINT16)


def test_what_is_sent_is_what_is_read():
    frame = make_frame()
    message = lcmt_image_array.decode(encode_frame(frame, 5).encode())
    read = decode_frame(message, CAMERA)
    assert (message.header.seq, message.num_images, read.t) == (5, 2, pytest.approx(frame.t))
    assert np.abs(read.color.astype(int) - frame.color).mean() < 1.5
    assert np.abs(read.depth - frame.depth).max() < 0.51e-3
    np.testing.assert_array_equal(read.depth == 0, frame.depth == 0)
    assert decode_frame(encode_frame(make_frame(depth=False)), CAMERA).depth is None


@pytest.mark.parametrize("pad", [0, 4])
@pytest.mark.parametrize("method", [0, lcmt_image.COMPRESSION_METHOD_ZLIB])
def test_raw_and_compressed_rows_in_every_order_are_read_exactly(method, pad):
    frame = make_frame()
    alpha = np.full((HEIGHT, WIDTH, 1), 255, np.uint8)
    orders = {
        lcmt_image.PIXEL_FORMAT_RGB: frame.color,
        lcmt_image.PIXEL_FORMAT_BGR: frame.color[..., ::-1],
        lcmt_image.PIXEL_FORMAT_RGBA: np.concatenate([frame.color, alpha], axis=-1),
        lcmt_image.PIXEL_FORMAT_BGRA: np.concatenate([frame.color[..., ::-1], alpha], axis=-1),
    }
    millimeters = np.rint(1e3 * frame.depth)
    depths = [
        (frame.depth.astype("<f4"), METERS, False),
        (frame.depth.astype(">f4"), METERS, True),
        (millimeters.astype("<u2"), MILLIMETERS, False),
        (millimeters.astype(">u2"), MILLIMETERS, True),
    ]
    for (order, pixels), (depth, kind, big) in zip(orders.items(), depths, strict=True):
        images = [
            make_image(pixels, order, RGB[1], pad=pad),
            make_image(depth, *kind, bigendian=big, pad=pad),
        ]
        for image in images:
            image.compression_method = method
            image.data = zlib.compress(image.data) if method else image.data
            image.size = len(image.data)
        labels = make_image(
            millimeters.astype("<u2"), lcmt_image.PIXEL_FORMAT_LABEL, lcmt_image.CHANNEL_TYPE_INT16
        )
        read = decode_frame(make_message(labels, *images), CAMERA)
        np.testing.assert_array_equal(read.color, frame.color)
        np.testing.assert_allclose(
            read.depth, frame.depth, rtol=0, atol=1e-7 if kind is METERS else 0.51e-3
        )
        assert read.t == pytest.approx(frame.t)


def spoil(image, **changed):
    for name, value in changed.items():
        setattr(image, name, value)
    image.size = len(image.data)
    return image


def test_bad_pictures_are_named():
    frame = make_frame()
    png = cv2.imencode(".png", frame.color)[1].tobytes()
    huge = cv2.imencode(".png", np.zeros((3000, 4000), np.uint8))[1].tobytes()

    def color(**changed):
        return spoil(make_image(frame.color, *RGB), **changed)

    def depth(**changed):
        return spoil(make_image(frame.depth, *METERS), **changed)

    row = 3 * WIDTH
    refused = [
        ([], "0 color and 0 depth images; expected a color image"),
        ([color(), color()], "2 color"),
        ([color(), depth(), depth()], "2 depth"),
        (
            [color(channel_type=lcmt_image.CHANNEL_TYPE_INT16)],
            "the color image's channel_type is 2",
        ),
        (
            [color(), depth(channel_type=lcmt_image.CHANNEL_TYPE_FLOAT64)],
            "the depth image's channel_type is 7",
        ),
        ([color(width=32)], "the color image is 32 x 48 pixels; expected 64 x 48"),
        ([color(data=color().data[:-1])], f"{row * HEIGHT - 1} bytes in rows of {row}"),
        ([color(row_stride=row - 1)], f"rows of {row - 1}; expected 48 rows of at least {row}"),
        ([color(row_stride=-row)], f"rows of -{row}"),
        ([color(compression_method=7)], "compression_method is 7"),
        ([color(compression_method=1)], "not compressed by zlib"),
        (
            [color(compression_method=1, data=zlib.compress(bytes(100_000_000)))],
            f"{row * HEIGHT + 1} bytes",
        ),
        ([color(compression_method=2)], "no JPEG file"),
        ([color(compression_method=3, data=huge)], "is 4000 x 3000 pixels; expected 64 x 48"),
        ([color(compression_method=3, data=png[: len(png) // 2])], "PNG file"),
        ([color(), depth(compression_method=3, data=png)], "holds uint8 in shape"),
    ]
    for images, says in refused:
        with pytest.raises(ImageError, match=says.replace("(", r"\(")):
            decode_frame(make_message(*images), CAMERA)

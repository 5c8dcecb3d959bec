"""Pixels in the messages of pictures, whatever the network: rows of bytes, and depth."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import ImageError
from gridpush_drake.perception.images.frames import Depth
from gridpush_drake.units import MM_PER_M

FARTHEST = 1e3
"""Greatest depth that counts as measured, m. Beyond it, and below 0, a pixel's depth is unknown."""


def read_rows(
    data: bytes,
    shape: tuple[int, int, int],
    kind: np.dtype[Any],
    *,
    step: int,
    big_endian: bool,
    name: str,
) -> NDArray[Any]:
    """Reads pixels (height, width, channels) from rows of bytes, which may be longer than needed.

    Args:
        data: the rows.
        shape: height, width and channels.
        kind: type of the values.
        step: length of a row, bytes.
        big_endian: whether the first byte of a value is its greatest.
        name: what the image is called in an error.

    Raises:
        ImageError: there are more or fewer bytes than that.
    """
    height, width, channels = shape
    used = width * channels * kind.itemsize
    if step < used or len(data) != height * step or not data:
        raise ImageError(
            f"{name} has {len(data)} bytes in rows of {step}; "
            f"expected {height} rows of at least {used}"
        )
    rows = np.frombuffer(data, np.uint8).reshape(height, step)[:, :used]
    sent = kind.newbyteorder(">" if big_endian else "<")
    return np.ascontiguousarray(rows).view(sent).astype(kind).reshape(shape)


def convert_depth(pixels: NDArray[Any]) -> Depth:
    """Converts depth that came in mm (whole numbers) or m to m; 0 where it is not known."""
    meters = pixels / MM_PER_M if pixels.dtype.kind == "u" else pixels
    known = (meters >= 0.0) & (meters <= FARTHEST)  # false for NaN
    return np.where(known, meters, 0.0).astype(np.float32)

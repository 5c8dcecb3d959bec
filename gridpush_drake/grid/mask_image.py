"""Label images read from PGM and PNG files, with the labels as they were stored and bounded memory."""

import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL.PngImagePlugin import PngImageFile

from gridpush_drake.errors import ObjectError
from gridpush_drake.files import MEGABYTE, open_file, read_bytes

MOST_PIXELS = 400_000_000
"""Larger images are refused before they are decoded."""

MAX_SIZE = 1024 * MEGABYTE
"""Of an image file, bytes: more than the most pixels take at 16 bit."""

STRIP_PIXELS = 4_000_000
"""Pixels looked at in one go."""

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"

PNG_MODES = ("1", "L", "P", "I", "I;16")
"""Pillow's names of images with one number per pixel."""

PNG_DEPTH_AT = 24
"""Place of the bit depth in a PNG file."""

PNG_GREY_STRETCH = {2: 85, 4: 17}
"""Pillow stretches grey of so few bits to 0 to 255 by this factor; labels are wanted as stored."""

PGM_GAP = rb"(?:\s|#[^\r\n]*+[\r\n])++"
"""Blanks and comments between the numbers of a header; possessive, so that it is read once and never again."""

PGM_HEADER = re.compile(rb"(P[25])" + (PGM_GAP + rb"(\d{1,9}+)") * 3 + rb"(?:[ \t]*+#[^\r\n]*+)?\s")

MAX_PLAIN_SIZE = 32 * MEGABYTE
"""Of a plain PGM, whose numbers are text, bytes."""

PGM_HEADER_ROOM = 4096
"""Bytes within which a PGM header must end."""

FORM = "a PGM or PNG label image: 0 is background, every other value a part"

WANTED = f"expected {FORM}"

Rows = Callable[[int, int], NDArray[np.generic]]
"""Rows from the first number to before the second, (rows, width)."""


def read_labels(path: Path) -> NDArray[np.uint16]:
    """Reads a label image, cropped to what is not background.

    Args:
        path: a PGM (plain or raw, 8 or 16 bit) or PNG (grey of 1 to 16 bit, or palette) file.

    Returns:
        (height, width) labels, 0 is background; rows run down the image.

    Raises:
        ObjectError: the file cannot be read, is a colour image or another kind of file, is too large, or holds
            background only.
    """
    with open_file(path, FORM, ObjectError, MAX_SIZE) as file:
        head = file.read(PGM_HEADER_ROOM)
        file.seek(0)
        if head.startswith(PNG_SIGNATURE):
            return _read_png(path, file, head)
        if head[:2] in (b"P2", b"P5"):
            return _read_pgm(path, file, head)
    if head[:2] in (b"P3", b"P6"):
        raise ObjectError(f"{path}: is a colour image (PPM); {WANTED}")
    raise ObjectError(f"{path}: is neither PGM nor PNG; {WANTED}")


def crop(path: Path, rows: Rows, width: int, height: int) -> NDArray[np.uint16]:
    """Cuts the bounding box of what is not 0 out of an image that is read strip by strip."""
    used_rows, used_columns = np.zeros(height, dtype=bool), np.zeros(width, dtype=bool)
    step = max(1, STRIP_PIXELS // width)
    for top in range(0, height, step):
        object_here = rows(top, min(height, top + step)) != 0
        used_rows[top : top + step] = object_here.any(axis=1)
        used_columns |= object_here.any(axis=0)
    if not used_rows.any():
        raise ObjectError(f"{path}: holds background (0) only; {WANTED}")
    (top, bottom), (left, right) = ((int(i[0]), int(i[-1]) + 1) for i in map(np.flatnonzero, (used_rows, used_columns)))
    labels = np.empty((bottom - top, right - left), dtype=np.uint16)
    for first in range(top, bottom, step):
        last = min(bottom, first + step)
        labels[first - top : last - top] = rows(first, last)[:, left:right]
    return labels


def _read_png(path: Path, file: BinaryIO, head: bytes) -> NDArray[np.uint16]:
    # The plugin is opened itself: Image.open would measure it by Pillow's global limit instead of MOST_PIXELS.
    try:
        with PngImageFile(file) as image:
            _check_size(path, *image.size)
            if image.mode not in PNG_MODES:
                raise ObjectError(f"{path}: is a colour or transparent image ({image.mode}); {WANTED}")
            stretch = PNG_GREY_STRETCH.get(head[PNG_DEPTH_AT], 1) if image.mode == "L" else 1
            image.load()
            width, height = image.size

            def rows(first: int, last: int) -> NDArray[np.generic]:
                return np.asarray(image.crop((0, first, width, last))) // np.uint8(stretch)

            return crop(path, rows, width, height)
    except (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error) as error:
        raise ObjectError(f"{path}: is a damaged PNG ({error}); {WANTED}") from error


def _read_pgm(path: Path, file: BinaryIO, head: bytes) -> NDArray[np.uint16]:
    header = PGM_HEADER.match(head)
    if header is None:
        raise ObjectError(f"{path}: is a PGM with a damaged header; {WANTED}")
    width, height, greatest = (int(number) for number in header.groups()[1:])
    _check_size(path, width, height)
    if not 0 < greatest <= np.iinfo(np.uint16).max:
        raise ObjectError(f"{path}: is a PGM of greatest value {greatest}; expected 1 to 65535")
    try:
        if header[1] == b"P2":
            numbers = re.sub(rb"#[^\r\n]*", b"", _read_plain(path)[header.end() :]).split()
            pixels = np.array(numbers[: width * height], dtype=np.uint16).reshape(height, width)
        else:
            kind = np.dtype(np.uint8 if greatest <= np.iinfo(np.uint8).max else ">u2")
            pixels = np.memmap(file, dtype=kind, mode="r", offset=header.end(), shape=(height, width))
    except (OSError, ValueError, OverflowError) as error:
        raise ObjectError(f"{path}: is a damaged PGM, shorter than its {width} x {height} pixels") from error
    return crop(path, lambda first, last: pixels[first:last], width, height)


def _read_plain(path: Path) -> bytes:
    return read_bytes(path, "a raw PGM (P5), which takes less room", ObjectError, MAX_PLAIN_SIZE)


def _check_size(path: Path, width: int, height: int) -> None:
    if not 0 < width * height <= MOST_PIXELS:
        raise ObjectError(
            f"{path}: has {width} x {height} pixels; expected at least one and at most {MOST_PIXELS // 10**6} million"
        )

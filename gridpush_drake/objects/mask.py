"""A label image (PGM, PNG), read with the labels as they were stored, and turned into cells and an outline."""

import re
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL.PngImagePlugin import PngImageFile
from scipy.ndimage import find_objects, label, map_coordinates
from shapely.geometry.polygon import orient

from gridpush_drake.errors import ObjectError, ObjectWarning, require_positive
from gridpush_drake.files import MEGABYTE, open_file, read_bytes
from gridpush_drake.geometry.contour import calc_contour
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.objects.cells import (
    CellGrid,
    Cells,
    Region,
    Share,
    check_max_cells,
    choose_cells,
)

MAX_PIXELS = 100_000_000
"""Larger images are refused before they are decoded; this many take a gigabyte and some seconds."""

MAX_FILE_SIZE = 1024 * MEGABYTE  # of an image file, bytes: more than the most pixels take at 16 bit
STRIP_PIXELS = 4_000_000  # pixels looked at in one go

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"

PNG_MODES = ("1", "L", "P", "I", "I;16")  # Pillow's names of images with one number per pixel
PNG_DEPTH_AT = 24  # place of the bit depth in a PNG file

PNG_GRAY_STRETCH = {2: 85, 4: 17}
"""Pillow stretches gray of so few bits to 0 to 255 by this factor; labels are wanted as stored."""

PGM_GAP = rb"(?:\s|#[^\r\n]*+[\r\n])++"
"""Blanks and comments between the numbers of a header; possessive, so that it is read once and
never again."""

PGM_HEADER = re.compile(rb"(P[25])" + (PGM_GAP + rb"(\d{1,9}+)") * 3 + rb"(?:[ \t]*+#[^\r\n]*+)?\s")

MAX_PLAIN_SIZE = 32 * MEGABYTE  # of a plain PGM, whose numbers are text, bytes
PGM_HEADER_ROOM = 4096  # bytes within which a PGM header must end

FORM = "a PGM or PNG label image: 0 is background, every other value a part"

WANTED = f"expected {FORM}"

Rows = Callable[[int, int], NDArray[np.generic]]
"""Rows from the first number to before the second, (rows, width)."""


def read_labels(path: Path) -> NDArray[np.uint16]:
    """Reads a label image, cropped to what is not background, 0: (height, width), rows run down the image.

    A PGM (plain or raw, 8 or 16 bit) or PNG (gray of 1 to 16 bit, or palette) file.

    Raises:
        ObjectError: the file cannot be read, is a color image or another kind of file, is too
            large, or holds background only.
    """
    with open_file(path, FORM, ObjectError, MAX_FILE_SIZE) as file:
        head = file.read(PGM_HEADER_ROOM)
        file.seek(0)
        if head.startswith(PNG_SIGNATURE):
            return _read_png(path, file, head)
        if head[:2] in (b"P2", b"P5"):
            return _read_pgm(path, file, head)
    if head[:2] in (b"P3", b"P6"):
        raise ObjectError(f"{path}: is a color image (PPM); {WANTED}")
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
    (top, bottom), (left, right) = (
        (int(i[0]), int(i[-1]) + 1) for i in map(np.flatnonzero, (used_rows, used_columns))
    )
    labels = np.empty((bottom - top, right - left), dtype=np.uint16)
    for first in range(top, bottom, step):
        last = min(bottom, first + step)
        labels[first - top : last - top] = rows(first, last)[:, left:right]
    if labels.shape == (height, width):
        _doubt_inverted(path, labels)
    return labels


INVERTED_SHARE, MAIN_SHARE = 0.01, 0.9
"""Least share of a picture, and of all background, that a hole has which is the object of an
inverted mask."""


def _doubt_inverted(path: Path, labels: NDArray[np.uint16]) -> None:
    """Warns where all of the border is object and one hole is all there is of background."""
    edges = (labels[0], labels[-1], labels[:, 0], labels[:, -1])
    if not all(edge.all() for edge in edges):
        return
    holes, count = label(labels == 0)
    sizes = np.bincount(holes.ravel())[1:]
    if count and sizes.max() >= max(INVERTED_SHARE * labels.size, MAIN_SHARE * sizes.sum()):
        warnings.warn(
            f"{path}: is the mask inverted? The object takes all of the picture's border and has a hole of "
            f"{sizes.max()} pixels; expected 0 for background, beyond the border too",
            ObjectWarning,
            stacklevel=2,
        )


def _read_png(path: Path, file: BinaryIO, head: bytes) -> NDArray[np.uint16]:
    # The plugin is opened itself: Image.open would measure it by Pillow's global limit instead of
    # MAX_PIXELS.
    try:
        with PngImageFile(file) as image:
            _check_size(path, *image.size)
            if image.mode not in PNG_MODES:
                raise ObjectError(
                    f"{path}: is a color or transparent image ({image.mode}); {WANTED}"
                )
            stretch = PNG_GRAY_STRETCH.get(head[PNG_DEPTH_AT], 1) if image.mode == "L" else 1
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
            text = read_bytes(
                path, "a raw PGM (P5), which takes less room", ObjectError, MAX_PLAIN_SIZE
            )
            numbers = re.sub(rb"#[^\r\n]*", b"", text[header.end() :]).split()
            pixels = np.array(numbers[: width * height], dtype=np.uint16).reshape(height, width)
        else:
            kind = np.dtype(np.uint8 if greatest <= np.iinfo(np.uint8).max else ">u2")
            pixels = np.memmap(
                file, dtype=kind, mode="r", offset=header.end(), shape=(height, width)
            )
    except (OSError, ValueError, OverflowError) as error:
        raise ObjectError(
            f"{path}: is a damaged PGM, shorter than its {width} x {height} pixels"
        ) from error
    return crop(path, lambda first, last: pixels[first:last], width, height)


def _check_size(path: Path, width: int, height: int) -> None:
    if not 0 < width * height <= MAX_PIXELS:
        raise ObjectError(
            f"{path}: has {width} x {height} pixels; expected at least one and at most {MAX_PIXELS // 10**6} million"
        )


WORKING_PIXELS = 4_000_000
"""Larger masks are averaged over square blocks of pixels down to about this many before they are
traced."""

MAX_PARTS = 100  # more labels than this are taken for a photograph or a softened edge


def coarsen_mask(
    path: Path, meters_per_pixel: float, max_cells: int, *, largest_piece: bool = False, name: str
) -> CellGrid:
    """Reads a label image and coarsens it to square cells, none smaller than a pixel; as `GridObject.from_mask`.

    A cell belongs to the object when at least half its area does, and to the part that covers most
    of it.
    """
    check_max_cells(name, max_cells)
    require_positive(ObjectError, f"{path}: ", "m", meters_per_pixel=meters_per_pixel)
    labels = _keep_one_piece(path, read_labels(path), largest_piece)
    values = _find_values(path, labels)
    block = int(np.ceil(np.sqrt(labels.size / WORKING_PIXELS)))
    coverage = _average(labels, None, block)
    share = _make_share(coverage)
    cells = choose_cells(_describe(coverage), share, share, int(max_cells), min_size=1.0)
    majority = _vote(labels, values, block, cells)
    center = cells.centers.mean(axis=0)
    scale = meters_per_pixel * block * np.array([1.0, -1.0])
    outline = shapely.transform(calc_contour(coverage), lambda p: (p - center) * scale)
    return CellGrid(
        (cells.centers - center) * scale, cells.size * float(scale[0]), majority, orient(outline)
    )


def _keep_one_piece(
    path: Path, labels: NDArray[np.uint16], largest_piece: bool
) -> NDArray[np.uint16]:
    """Leaves the largest piece of pixels that touch along a side or at a corner, cropped to it."""
    pieces, count = label(labels != 0, np.ones((3, 3)))
    if count == 1:
        return labels
    sizes = np.bincount(pieces.ravel())[1:]
    if not largest_piece:
        largest = ", ".join(str(size) for size in np.sort(sizes)[::-1][:4]) + (
            ", ..." if count > 4 else ""
        )
        raise ObjectError(
            f"{path}: the mask has {count} separate pieces (of {largest} pixels); expected one; "
            "pass --largest-piece to keep the largest and leave out the others"
        )
    kept = int(np.argmax(sizes)) + 1
    box = find_objects(pieces, kept)[-1]
    return np.where(pieces[box] == kept, labels[box], 0).astype(np.uint16)


def _find_values(path: Path, labels: NDArray[np.uint16]) -> IntArray:
    counts = np.zeros(np.iinfo(np.uint16).max + 1, dtype=np.int64)
    flat = labels.ravel()
    for start in range(0, flat.size, WORKING_PIXELS):
        counts += np.bincount(flat[start : start + WORKING_PIXELS], minlength=len(counts))
    values = np.flatnonzero(counts[1:]) + 1
    if len(values) > MAX_PARTS:
        raise ObjectError(
            f"{path}: has {len(values)} different labels; expected a label image of at most {MAX_PARTS} parts, "
            "not a photograph or an image with softened edges"
        )
    return values


def _average(labels: NDArray[np.uint16], value: int | None, block: int) -> Array:
    """Share of each block of pixels that is `value` (None: anything but background), padded with background."""
    height, width = labels.shape
    rows, columns = -(-height // block), -(-width // block)
    share = np.empty((rows, columns))
    step = max(1, WORKING_PIXELS // (width * block))
    for first in range(0, rows, step):
        strip = labels[first * block : (first + step) * block]
        wanted = strip != 0 if value is None else strip == value
        padded = np.pad(wanted, ((0, -len(strip) % block), (0, columns * block - width)))
        share[first : first + step] = padded.reshape(-1, block, columns, block).mean(axis=(1, 3))
    return share


def _make_share(coverage: Array) -> Share:
    """Exact share of square cells by the summed-area table, which is bilinear within a pixel."""
    table = np.zeros(np.add(coverage.shape, 1))
    table[1:, 1:] = coverage.cumsum(axis=0).cumsum(axis=1)

    def share(corners: Array, size: float) -> Array:
        (x0, y0), (x1, y1) = corners.T, corners.T + size
        at = np.array([[y0, y1, y0, y1], [x0, x1, x1, x0]])
        below, above, right, left = map_coordinates(table, at, order=1, mode="nearest")
        return (below + above - right - left) / size**2

    return share


def _describe(coverage: Array) -> Region:
    area = float(coverage.sum())
    by_axis = [coverage.sum(axis=0), coverage.sum(axis=1)]
    middles = [np.arange(len(mass)) + 0.5 for mass in by_axis]
    centroid = (
        np.array([mass @ middle for mass, middle in zip(by_axis, middles, strict=True)]) / area
    )
    dx, dy = (middle - c for middle, c in zip(middles, centroid, strict=True))
    covariance = np.full((2, 2), dy @ coverage @ dx)
    np.fill_diagonal(covariance, [by_axis[0] @ dx**2, by_axis[1] @ dy**2])
    covariance = (covariance + area / 12 * np.eye(2)) / area
    extent = np.array(coverage.shape[::-1], dtype=np.float64)
    return Region(np.zeros(2), extent, area, centroid, covariance)


def _vote(labels: NDArray[np.uint16], values: IntArray, block: int, cells: Cells) -> IntArray:
    """The label with the largest share of each cell; the lowest of equals."""
    if len(values) == 1:
        return np.full(len(cells.corners), values[0])
    best = np.zeros(len(cells.corners))
    winner = np.full(len(cells.corners), values[0])
    for value in values:
        share = _make_share(_average(labels, int(value), block))(cells.corners, cells.size)
        winner = np.where(share > best, value, winner)
        best = np.maximum(share, best)
    return winner

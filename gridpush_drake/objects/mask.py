"""Label images (PGM, PNG): read with their labels as stored, and turned into cells and an outline.

In a label image 0 is background, and every other value a part of the object. (Pictures and depth
images of a camera are made into objects in `perception.detection.detection`.)
"""

import math
import re
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL.PngImagePlugin import PngImageFile
from scipy.ndimage import find_objects, label, map_coordinates
from shapely.geometry.polygon import orient

from gridpush_drake.errors import ObjectError, ObjectWarning, require_positive
from gridpush_drake.files import open_file, read_bytes
from gridpush_drake.geometry.contour import calc_contour
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.objects.cells import CellGrid, Cells, check_max_cells
from gridpush_drake.objects.lattice import Proportion, Region, choose_cells
from gridpush_drake.units import BYTES_PER_MEGABYTE

MAX_PIXELS = 100_000_000
"""Largest number of pixels. An image with more is refused before it is decoded; one with so many
takes a gigabyte and some seconds."""

MAX_FILE_SIZE = 1024 * BYTES_PER_MEGABYTE
"""Largest size of an image file, bytes. It is more than `MAX_PIXELS` pixels of 16 bit take."""

STRIP_PIXELS = 4_000_000
"""Number of pixels that are looked at in one go."""

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""First bytes of a PNG file."""

PNG_MODES = ("1", "L", "P", "I", "I;16")
"""Pillow's names of images with one number per pixel."""

PNG_DEPTH_AT = 24
"""Place of the bit depth in a PNG file, bytes from its beginning."""

PNG_GRAY_STRETCH = {2: 85, 4: 17}
"""Factor by which Pillow stretches gray of 2 or 4 bits to 0 to 255. Labels are wanted as stored."""

PGM_GAP = rb"(?:\s|#[^\r\n]*+[\r\n])++"
"""Blanks and comments between the numbers of a header. It is possessive: read once, never again, so
that no header can keep the reader busy."""

PGM_HEADER = re.compile(rb"(P[25])" + (PGM_GAP + rb"(\d{1,9}+)") * 3 + rb"(?:[ \t]*+#[^\r\n]*+)?\s")
"""Header of a plain (P2) or raw (P5) PGM: kind, width, height and greatest value."""

MAX_PLAIN_SIZE = 32 * BYTES_PER_MEGABYTE
"""Largest size of a plain PGM, whose numbers are text, bytes."""

PGM_HEADER_ROOM = 4096
"""Number of bytes within which a PGM's header must end."""

MASK_FORM = "a PGM or PNG label image: 0 is background, every other value a part"
"""The expected form of a mask, for messages."""

EXPECTED_MASK = f"expected {MASK_FORM}"
"""End of the messages that refuse a mask."""

Rows = Callable[[int, int], NDArray[np.generic]]
"""Reads an image's rows (rows, width) from the first number to before the second."""


class CroppedImage(NamedTuple):
    """A label image, cropped to what is not background.

    Attributes:
        labels: (height, width) labels; rows run down the image, and 0 is background.
        left: pixels of the whole image to the left of it.
        top: pixels of the whole image above it.
    """

    labels: NDArray[np.uint16]
    left: int
    top: int


def read_labels(path: Path) -> CroppedImage:
    """Reads a label image, cropped to what is not background.

    Args:
        path: a PGM (plain or raw, 8 or 16 bit) or PNG (gray of 1 to 16 bit, or palette) file.

    Returns:
        The labels, and where they are in the image.

    Raises:
        ObjectError: the file cannot be read, is a color image or another kind of file, is too
            large, or holds background only.
    """
    with open_file(path, MASK_FORM, ObjectError, MAX_FILE_SIZE) as file:
        head = file.read(PGM_HEADER_ROOM)
        file.seek(0)
        if head.startswith(PNG_SIGNATURE):
            return _read_png(path, file, head)
        if head[:2] in (b"P2", b"P5"):
            return _read_pgm(path, file, head)
    if head[:2] in (b"P3", b"P6"):
        raise ObjectError(f"{path}: is a color image (PPM); {EXPECTED_MASK}")
    raise ObjectError(f"{path}: is neither PGM nor PNG; {EXPECTED_MASK}")


def crop(path: Path, rows: Rows, width: int, height: int) -> CroppedImage:
    """Cuts the bounding box of what is not 0 out of an image that is read strip by strip.

    Args:
        path: the image's file, for messages.
        rows: reads some of its rows.
        width: of the image, pixels.
        height: of the image, pixels.

    Returns:
        The labels within the box, and where it is.

    Raises:
        ObjectError: all of the image is 0.
    """
    # The first reading finds the box, a second one fills it: no whole image is held in memory.
    used_rows = np.zeros(height, dtype=bool)
    used_columns = np.zeros(width, dtype=bool)
    step = max(1, STRIP_PIXELS // width)
    for top in range(0, height, step):
        object_here = rows(top, min(height, top + step)) != 0
        used_rows[top : top + step] = object_here.any(axis=1)
        used_columns |= object_here.any(axis=0)
    if not used_rows.any():
        raise ObjectError(f"{path}: holds background (0) only; {EXPECTED_MASK}")
    top, bottom = _find_range(used_rows)
    left, right = _find_range(used_columns)
    labels = np.empty((bottom - top, right - left), dtype=np.uint16)
    for first in range(top, bottom, step):
        last = min(bottom, first + step)
        labels[first - top : last - top] = rows(first, last)[:, left:right]
    if labels.shape == (height, width):
        _warn_of_inversion(path, labels)
    return CroppedImage(labels, left, top)


def _find_range(used: NDArray[np.bool_]) -> tuple[int, int]:
    """Finds the first place that is used, and the one after the last."""
    places = np.flatnonzero(used)
    return int(places[0]), int(places[-1]) + 1


INVERTED_FRACTION = 0.01
"""Fraction of a picture from which on a hole may be the object of an inverted mask."""

MAIN_FRACTION = 0.9
"""Fraction of all background from which on a hole may be the object of an inverted mask."""


def _warn_of_inversion(path: Path, labels: NDArray[np.uint16]) -> None:
    """Warns where all of the border is object, and one hole is nearly all of the background."""
    edges = (labels[0], labels[-1], labels[:, 0], labels[:, -1])
    if not all(edge.all() for edge in edges):
        return
    holes, count = label(labels == 0)
    sizes = np.bincount(holes.ravel())[1:]
    if count and sizes.max() >= max(INVERTED_FRACTION * labels.size, MAIN_FRACTION * sizes.sum()):
        warnings.warn(
            f"{path}: is the mask inverted? The object takes all of the picture's border and has "
            f"a hole of {sizes.max()} pixels; expected 0 for background, beyond the border too",
            ObjectWarning,
            stacklevel=2,
        )


def _read_png(path: Path, file: BinaryIO, head: bytes) -> CroppedImage:
    """Reads a PNG file, which begins with `head`, and crops it."""
    # The plugin is opened itself: Image.open would measure it by Pillow's global limit instead of
    # MAX_PIXELS.
    try:
        with PngImageFile(file) as image:
            _check_size(path, *image.size)
            if image.mode not in PNG_MODES:
                raise ObjectError(
                    f"{path}: is a color or transparent image ({image.mode}); {EXPECTED_MASK}"
                )
            stretch = PNG_GRAY_STRETCH.get(head[PNG_DEPTH_AT], 1) if image.mode == "L" else 1
            image.load()
            width, height = image.size

            def rows(first: int, last: int) -> NDArray[np.generic]:
                return np.asarray(image.crop((0, first, width, last))) // np.uint8(stretch)

            return crop(path, rows, width, height)
    except (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error) as error:
        raise ObjectError(f"{path}: is a damaged PNG ({error}); {EXPECTED_MASK}") from error


def _read_pgm(path: Path, file: BinaryIO, head: bytes) -> CroppedImage:
    """Reads a PGM file, which begins with `head`, and crops it."""
    header = PGM_HEADER.match(head)
    if header is None:
        raise ObjectError(f"{path}: is a PGM with a damaged header; {EXPECTED_MASK}")
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
            # Numbers of two bytes have the greater one first.
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
    """Refuses an image of no pixels, or of too many."""
    if not 0 < width * height <= MAX_PIXELS:
        raise ObjectError(
            f"{path}: has {width} x {height} pixels; expected at least one and at most "
            f"{MAX_PIXELS // 10**6} million"
        )


WORKING_PIXELS = 4_000_000
"""Number of pixels beyond which a mask is averaged over square blocks, down to about this many,
before it is traced."""

MAX_SHOWN = 4
"""Number of pieces whose sizes a message tells."""

MAX_PARTS = 100
"""Largest number of labels. An image with more is taken for a photograph, or for a mask with
softened edges."""

PIXEL_CENTER = 0.5
"""Distance of a pixel's center from its corner in x and y, pixels."""


def coarsen_mask(
    path: Path,
    meters_per_pixel: float,
    max_cells: int,
    *,
    largest_piece: bool = False,
    name: str,
    origin: tuple[float, float] | None = None,
) -> CellGrid:
    """Reads a label image and coarsens it to square cells, as `GridObject.from_mask` does.

    A cell belongs to the object when at least half its area does, and to the part that covers most
    of it.

    Args:
        path: the image.
        meters_per_pixel: its scale, m.
        max_cells: largest number of cells; none is smaller than a pixel.
        largest_piece: whether the largest piece is taken where there are several.
        name: the object's name, for messages.
        origin: (x, y) of the body frame's origin in the image, pixels from its upper left corner, y
            down; the cells' centroid where None.

    Returns:
        Cells and outline; x of the body frame points right and y up in the image.

    Raises:
        ObjectError: the image cannot be read or is no label image, is empty or in several pieces,
            or a number is out of range.
    """
    check_max_cells(name, max_cells)
    require_positive(ObjectError, f"{path}: ", "m", meters_per_pixel=meters_per_pixel)
    image = _keep_one_piece(path, read_labels(path), largest_piece)
    labels = image.labels
    values = _find_values(path, labels)

    # From here to the last step, lengths are in blocks of pixels, with y down.
    block = int(np.ceil(np.sqrt(labels.size / WORKING_PIXELS)))
    coverage = _average(labels, None, block)
    fraction = _make_fraction(coverage)
    cells = choose_cells(_describe(coverage), fraction, fraction, int(max_cells), min_size=1.0)
    majority = _vote(labels, values, block, cells)
    contour = calc_contour(coverage)

    # The body frame's origin: where it was told to be in the whole image, or the cells' centroid.
    center = cells.centers.mean(axis=0)
    if origin is not None:
        center = (np.array(origin) - [image.left, image.top]) / block
    scale = meters_per_pixel * block * np.array([1.0, -1.0])
    outline = shapely.transform(contour, lambda p: (p - center) * scale)
    return CellGrid(
        p_BC=(cells.centers - center) * scale,
        cell_size=cells.size * float(scale[0]),
        labels=majority,
        outline=orient(outline),
    )


def _keep_one_piece(path: Path, image: CroppedImage, largest_piece: bool) -> CroppedImage:
    """Leaves one piece of pixels that touch along a side or at a corner, cropped to it.

    Args:
        path: the image's file, for messages.
        image: the labels.
        largest_piece: whether the largest piece is taken where there are several.

    Returns:
        The labels of the piece.

    Raises:
        ObjectError: there are several, and `largest_piece` is not set.
    """
    pieces, count = label(image.labels != 0, np.ones((3, 3)))
    if count == 1:
        return image
    sizes = np.bincount(pieces.ravel())[1:]
    if not largest_piece:
        shown = [str(size) for size in np.sort(sizes)[::-1][:MAX_SHOWN]]
        largest = ", ".join([*shown, "..."] if count > MAX_SHOWN else shown)
        raise ObjectError(
            f"{path}: the mask has {count} separate pieces (of {largest} pixels); expected one; "
            "pass --largest-piece to keep the largest and leave out the others"
        )
    kept = int(np.argmax(sizes)) + 1
    box = find_objects(pieces, kept)[-1]
    return CroppedImage(
        labels=np.where(pieces[box] == kept, image.labels[box], 0).astype(np.uint16),
        left=image.left + box[1].start,
        top=image.top + box[0].start,
    )


def _find_values(path: Path, labels: NDArray[np.uint16]) -> IntArray:
    """Lists the labels that occur, in increasing order; refuses too many with an ObjectError."""
    counts = np.zeros(np.iinfo(np.uint16).max + 1, dtype=np.int64)
    flat = labels.ravel()
    for start in range(0, flat.size, WORKING_PIXELS):
        counts += np.bincount(flat[start : start + WORKING_PIXELS], minlength=len(counts))
    values = np.flatnonzero(counts[1:]) + 1
    if len(values) > MAX_PARTS:
        raise ObjectError(
            f"{path}: has {len(values)} different labels; expected a label image of at most "
            f"{MAX_PARTS} parts, not a photograph or an image with softened edges"
        )
    return values


def _average(labels: NDArray[np.uint16], value: int | None, block: int) -> Array:
    """Calculates which fraction of each square block of pixels has a label.

    Args:
        labels: (height, width) labels.
        value: the label; None for anything but background.
        block: side of a block, pixels.

    Returns:
        (rows, columns) shares, 0 to 1; blocks that reach over the image have background there.
    """
    height, width = labels.shape
    rows = math.ceil(height / block)
    columns = math.ceil(width / block)
    fraction = np.empty((rows, columns))
    # Strip by strip, for the comparison and the padding take memory.
    step = max(1, WORKING_PIXELS // (width * block))
    for first in range(0, rows, step):
        strip = labels[first * block : (first + step) * block]
        wanted = strip != 0 if value is None else strip == value
        missing_rows = -len(strip) % block
        missing_columns = columns * block - width
        padded = np.pad(wanted, ((0, missing_rows), (0, missing_columns)))
        blocks = padded.reshape(-1, block, columns, block)
        fraction[first : first + step] = blocks.mean(axis=(1, 3))
    return fraction


def _make_fraction(coverage: Array) -> Proportion:
    """Makes the function that calculates the exact fraction of square cells that is object.

    It is by the summed-area table S, which is bilinear within a pixel:

        share = (S(x0, y0) + S(x1, y1) - S(x1, y0) - S(x0, y1)) / size²
    """
    table = np.zeros(np.add(coverage.shape, 1))
    table[1:, 1:] = coverage.cumsum(axis=0).cumsum(axis=1)

    def fraction(corners: Array, size: float) -> Array:
        x0, y0 = corners.T
        x1, y1 = corners.T + size
        # The table's first index is the row.
        at = np.array([[y0, y1, y0, y1], [x0, x1, x1, x0]])
        S_00, S_11, S_10, S_01 = map_coordinates(table, at, order=1, mode="nearest")
        return (S_00 + S_11 - S_10 - S_01) / size**2

    return fraction


def _describe(coverage: Array) -> Region:
    """Measures a mask (height, width), pixels: bounding box, area, centroid, second moments."""
    area = float(coverage.sum())
    by_x = coverage.sum(axis=0)
    by_y = coverage.sum(axis=1)
    x = np.arange(len(by_x)) + PIXEL_CENTER
    y = np.arange(len(by_y)) + PIXEL_CENTER
    centroid = np.array([by_x @ x, by_y @ y]) / area
    dx = x - centroid[0]
    dy = y - centroid[1]
    # Each pixel's own area adds 1/12 per axis to the moments of the pixels' centers.
    moments = np.full((2, 2), dy @ coverage @ dx)
    np.fill_diagonal(moments, [by_x @ dx**2, by_y @ dy**2])
    covariance = (moments + area / 12 * np.eye(2)) / area
    return Region(
        low=np.zeros(2),
        extent=np.array(coverage.shape[::-1], dtype=np.float64),
        area=area,
        centroid=centroid,
        covariance=covariance,
    )


def _vote(labels: NDArray[np.uint16], values: IntArray, block: int, cells: Cells) -> IntArray:
    """Finds the label with the largest fraction of each cell: (n,), the lowest of equals."""
    if len(values) == 1:
        return np.full(len(cells.corners), values[0])
    best = np.zeros(len(cells.corners))
    winner = np.full(len(cells.corners), values[0])
    for value in values:
        calc_fraction = _make_fraction(_average(labels, int(value), block))
        fraction = calc_fraction(cells.corners, cells.size)
        winner = np.where(fraction > best, value, winner)
        best = np.maximum(fraction, best)
    return winner

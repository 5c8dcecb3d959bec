"""A label image turned into cells and an outline."""

from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from shapely.geometry.polygon import orient

from gridpush_drake.errors import ObjectError
from gridpush_drake.grid.cell_size import Cells, Region, Share, check_max_cells, choose_cells
from gridpush_drake.grid.mask_contour import calc_contour
from gridpush_drake.grid.mask_image import read_labels
from gridpush_drake.grid.mask_pieces import erase, find_pieces, find_runs
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.prior import PhysicalPrior

WORKING_PIXELS = 4_000_000
"""Larger masks are averaged over square blocks of pixels down to about this many before they are traced."""

MOST_PARTS = 100
"""More labels than this are taken for a photograph or a softened edge."""


def object_from_mask(
    path: Path,
    metres_per_pixel: float,
    max_cells: int,
    *,
    largest_piece: bool,
    name: str | None,
    prior: PhysicalPrior | None,
) -> GridObject:
    """Reads a label image and coarsens it to square cells (`GridObject.from_mask`).

    A cell belongs to the object when at least half its area does, and to the part that covers most of it.

    Args:
        path: PGM or PNG; 0 is background, every other value a part.
        metres_per_pixel: its scale, m.
        max_cells: the most cells to make; cells are not made smaller than a pixel.
        largest_piece: keep the largest connected piece where there are several.
        name: what to call it; the file's stem where None.
        prior: what is known of mass and friction.

    Returns:
        The object; B is at the cells' centroid, x right and y up in the image.

    Raises:
        ObjectError: the image cannot be read or is not a label image, is empty, has several pieces (and
            `largest_piece` is not set), or a scale or count is not positive.
    """
    name = path.stem if name is None else name
    check_max_cells(name, max_cells)
    if not (np.isfinite(metres_per_pixel) and metres_per_pixel > 0):
        raise ObjectError(f"{path}: metres_per_pixel is {metres_per_pixel!r}; expected a positive number (m)")
    labels = _keep_one_piece(path, read_labels(path), largest_piece)
    values = _find_values(path, labels)
    block = int(np.ceil(np.sqrt(labels.size / WORKING_PIXELS)))
    coverage = _average(labels, None, block)
    share = _make_share(coverage)
    cells = choose_cells(_describe(coverage), share, share, int(max_cells), least_size=1.0)
    majority = _vote(labels, values, block, cells)
    centre = cells.centres.mean(axis=0)
    scale = metres_per_pixel * block * np.array([1.0, -1.0])
    outline = shapely.transform(calc_contour(coverage), lambda p: (p - centre) * scale)
    p_BC = (cells.centres - centre) * scale
    return GridObject(name, p_BC, cells.size * scale[0], majority, orient(outline), prior or PhysicalPrior())


def _keep_one_piece(path: Path, labels: NDArray[np.uint16], largest_piece: bool) -> NDArray[np.uint16]:
    runs = find_runs(labels)
    piece, sizes = find_pieces(runs, labels.shape[1])
    if len(sizes) == 1:
        return labels
    if not largest_piece:
        largest = ", ".join(str(size) for size in np.sort(sizes)[::-1][:4]) + (", ..." if len(sizes) > 4 else "")
        raise ObjectError(
            f"{path}: the mask has {len(sizes)} separate pieces (of {largest} pixels); expected one; "
            "pass --largest-piece to keep the largest and leave out the others"
        )
    erase(labels, runs, piece != int(np.argmax(sizes)))
    rows, columns = (np.flatnonzero((labels != 0).any(axis=axis)) for axis in (1, 0))
    return labels[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _find_values(path: Path, labels: NDArray[np.uint16]) -> NDArray[np.int64]:
    counts = np.zeros(np.iinfo(np.uint16).max + 1, dtype=np.int64)
    flat = labels.ravel()
    for start in range(0, flat.size, WORKING_PIXELS):
        counts += np.bincount(flat[start : start + WORKING_PIXELS], minlength=len(counts))
    values = np.flatnonzero(counts[1:]) + 1
    if len(values) > MOST_PARTS:
        raise ObjectError(
            f"{path}: has {len(values)} different labels; expected a label image of at most {MOST_PARTS} parts, "
            "not a photograph or an image with softened edges"
        )
    return values


def _average(labels: NDArray[np.uint16], value: int | None, block: int) -> NDArray[np.float64]:
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


def _make_share(coverage: NDArray[np.float64]) -> Share:
    """Exact share of square cells by the summed-area table, which is bilinear within a pixel."""
    table = np.zeros(np.add(coverage.shape, 1))
    table[1:, 1:] = coverage.cumsum(axis=0).cumsum(axis=1)

    def share(corners: NDArray[np.float64], size: float) -> NDArray[np.float64]:
        (x0, y0), (x1, y1) = corners.T, corners.T + size
        at = np.array([[y0, y1, y0, y1], [x0, x1, x1, x0]])
        below, above, right, left = map_coordinates(table, at, order=1, mode="nearest")
        return (below + above - right - left) / size**2

    return share


def _describe(coverage: NDArray[np.float64]) -> Region:
    area = float(coverage.sum())
    by_axis = [coverage.sum(axis=0), coverage.sum(axis=1)]
    middles = [np.arange(len(mass)) + 0.5 for mass in by_axis]
    centroid = np.array([mass @ middle for mass, middle in zip(by_axis, middles, strict=True)]) / area
    dx, dy = (middle - c for middle, c in zip(middles, centroid, strict=True))
    covariance = np.full((2, 2), dy @ coverage @ dx)
    np.fill_diagonal(covariance, [by_axis[0] @ dx**2, by_axis[1] @ dy**2])
    covariance = (covariance + area / 12 * np.eye(2)) / area
    extent = np.array(coverage.shape[::-1], dtype=np.float64)
    return Region(np.zeros(2), extent, area, centroid, covariance)


def _vote(labels: NDArray[np.uint16], values: NDArray[np.int64], block: int, cells: Cells) -> NDArray[np.int64]:
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
